//! Files in, a validated patient out.
//!
//! [`Patient::build`] reads or makes a surface, checks it, meshes it, gives each tetrahedron its material, spreads the point
//! shell and places the pre-sawn line. Whatever is wrong with a file comes back as one line of [`AnatomyError`]; nothing here
//! panics on a file. Frame everywhere: mm, LPS (x = patient left, y = posterior, z = superior).
pub mod canal;
mod error;
pub mod focus;
pub mod landmarks;
pub mod lattice;
pub mod materials;
pub mod mesher;
pub mod msh;
pub mod osteotomy;
pub mod parametric;
pub mod patient;
pub mod point_shell;
pub mod sheets;
pub mod stl;
pub mod surface;
pub mod teeth;
pub mod vtu;

pub use canal::Canal;
pub use error::AnatomyError;
pub use focus::Focus;
pub use landmarks::{JawFrame, Landmarks, SideLandmarks};
pub use materials::{MaterialSpec, Tissue};
pub use osteotomy::{LinePoint, Osteotomy, OsteotomyPart, PartKind, Side};
pub use parametric::{Parameters, ParametricMandible};
pub use patient::{MeshSource, OsteotomySource, Patient, PatientSpec, SurfaceSource};
pub use point_shell::SurfacePoint;
pub use surface::ClosedSurface;
pub use teeth::{Crown, Tooth, ToothKind};
