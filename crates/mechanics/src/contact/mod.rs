//! Rigid shapes against the deformed bone and each other: who touches, and what force follows (paper 3.2, 4.1, 4.2).
mod boundary_points;
mod bounding_volumes;
mod friction;
mod near;
mod near_places;
mod point_shell;
mod query;
mod response;
mod rigid_shape;
mod shape_pair;
mod wrench;

pub use boundary_points::boundary_points;
pub use bounding_volumes::BoundingVolumes;
pub use friction::Anchors;
pub use near::{NearPoints, cells_about};
pub use near_places::NearPlaces;
pub use point_shell::{PointOrigin, PointShell, RenewedCells, ShellPoint, ShellPoints};
pub use query::{Contact, ContactScene, penetrations, penetrations_in};
pub use response::{
    ContactLaw, ContactLawError, PointForce, Response, append_point_forces, respond,
};
pub(crate) use rigid_shape::SIDE_DEPTH;
pub use rigid_shape::{RigidShape, SurfaceSample};
pub use shape_pair::{PairResponse, add_static, respond_pair};
pub use wrench::{Matrix6, Vector6, Wrench};
