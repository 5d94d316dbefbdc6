//! The elastic bone without its crack: material, element stiffness, supports, and the sparse factor.
mod factor;
mod material;
mod rigid_motion;
pub mod stiffness;
mod supports;

pub use factor::{Factor, FactorError, SolveScratch};
pub use material::{Lame, MaterialError, TetMaterial};
pub use rigid_motion::{FreeMotion, free_motion};
pub use supports::{Prescribed, Supports};
