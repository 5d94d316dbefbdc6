//! The crack: its explicit surface, what it cuts, how hard it is driven, and how it grows.
mod body;
pub mod criterion;
mod cut_edges;
mod enrichment;
mod fragments;
pub mod growth;
pub mod load_control;
pub mod stress_intensity;
mod surface;
mod surface_load;
mod system;

pub use body::{BodyError, CrackedBody, EvaluatedFront, Solid};
pub use cut_edges::CutEdges;
pub use enrichment::{Cell, STANDARD, Topology};
pub use fragments::{Fragments, SMALLEST_FRAGMENT, UnionFind, bridging_edges};
pub use surface::{CrackSurface, Front, LinePoint, Sheet};
pub use surface_load::{LoadKind, SurfaceLoad};
pub use system::System;
