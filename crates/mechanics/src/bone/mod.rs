//! The elastic bone without its crack: material, element stiffness, supports, and the sparse factor.
mod factor;
mod material;
pub mod stiffness;
mod supports;

pub use factor::{Factor, FactorError, SolveScratch};
pub use material::{Lame, MaterialError, TetMaterial};
pub use supports::{Prescribed, Supports};
