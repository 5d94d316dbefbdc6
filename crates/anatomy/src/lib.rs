//! Files in, a validated patient out.
mod error;
pub mod landmarks;
pub mod lattice;
pub mod mesher;
pub mod parametric;
pub mod stl;
pub mod surface;

pub use error::AnatomyError;
pub use surface::ClosedSurface;
