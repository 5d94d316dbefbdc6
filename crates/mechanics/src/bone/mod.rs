//! The elastic bone without its crack: material, element stiffness, supports, and the sparse factor
//! with the border that a crack appends to it.
mod block_matrix;
mod bordered;
mod dense;
mod factor;
mod material;
mod ordering;
mod orthotropy;
mod rigid_motion;
pub mod stiffness;
mod supports;

pub use block_matrix::{BlockMatrix, add_product, decouple};
pub use bordered::{BorderRow, Bordered, HalfSolved, Region, SolveScratch, Swept};
pub use factor::{Factor, FactorError, Path};
pub use material::{Elasticity, Lame, MaterialError, TetMaterial};
pub use orthotropy::{EngineeringConstants, Orthotropic};
pub use rigid_motion::{FreeMotion, free_motion};
pub use supports::{Prescribed, Supports};
