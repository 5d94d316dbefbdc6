//! Meshes, distances, and where a point lies in them.
mod aabb;
mod block;
mod distance_grid;
mod lanes;
mod signed_distance;
mod spatial_hash;
mod tet_mesh;
mod tri_mesh;
mod triangle;

pub use aabb::Aabb;
pub use block::block_mesh;
pub use distance_grid::{DistanceGrid, DistanceSample, DistanceSamples, GridError};
pub(crate) use lanes::set_bits;
pub use lanes::{LANES, Lanes};
pub use signed_distance::{Closest, MeshDistance, SignedDistance};
pub use spatial_hash::SpatialHash;
pub use tet_mesh::{MeshError, NO_TET, TET_EDGES, TET_FACES, TetLocator, TetMesh};
pub use tri_mesh::TriMesh;
pub use triangle::{closest_on_triangle, segment_crosses};

/// A position or a direction \[mm\].
pub type Vec3 = nalgebra::Vector3<f64>;
/// A rigid motion, named `to_from_from`: `world_from_tool * point_in_tool`.
pub type Pose = nalgebra::Isometry3<f64>;
