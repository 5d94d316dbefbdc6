//! Files in, a validated patient out.
//!
//! [`Patient::build`] reads or makes a surface, checks it, meshes it, gives each tetrahedron its material, spreads the point
//! shell and places the pre-sawn line. Whatever is wrong with a file comes back as one line of [`AnatomyError`]; nothing here
//! panics on a file. Frame everywhere: mm, LPS (x = patient left, y = posterior, z = superior).
pub mod canal;
pub mod canal_label;
pub mod cortex;
pub mod density;
pub mod deviation;
pub mod diagnosis;
mod dicom;
mod error;
pub mod fit;
pub mod focus;
pub mod folder;
pub mod input;
pub mod labels;
pub mod landmarks;
pub mod lattice;
pub mod materials;
pub mod mesher;
pub mod mouth;
pub mod msh;
pub mod nifti;
pub mod nrrd;
pub mod obj;
pub mod orient;
pub mod osteotomy;
pub mod parametric;
pub mod patient;
pub mod ply;
pub mod point_shell;
pub mod prepare;
pub mod roots;
pub mod segmentation;
pub mod sheets;
pub mod stl;
pub mod surface;
pub mod teeth;
pub mod vtu;
pub mod winding;

pub use canal::Canal;
pub use cortex::CorticalRegions;
pub use error::AnatomyError;
pub use focus::Focus;
pub use folder::PatientFolder;
pub use landmarks::{JawFrame, Landmarks, SideLandmarks};
pub use materials::{MaterialSpec, Tissue};
pub use osteotomy::{LinePoint, Osteotomy, OsteotomyPart, PartKind, Side, Technique};
pub use parametric::{Parameters, ParametricMandible};
pub use patient::{MeshSource, OsteotomySource, Patient, PatientSpec, SurfaceSource};
pub use point_shell::SurfacePoint;
pub use surface::ClosedSurface;
pub use teeth::{Crown, Tooth, ToothKind};
