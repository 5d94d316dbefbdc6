//! The crack: its explicit surface, what it cuts, how hard it is driven, and how it grows.
mod anisotropic;
mod area;
mod body;
pub mod criterion;
mod cut_edges;
mod cut_polygon;
mod enrichment;
mod fragments;
mod front;
pub mod growth;
mod lead;
pub mod level_set;
pub mod load_control;
pub mod stress_intensity;
mod surface;
mod surface_load;
mod system;

pub use body::{BodyError, CrackedBody, EvaluatedFront, Growth, Solid};
pub use cut_edges::CutEdges;
pub use cut_polygon::{FacePiece, cut_area, cut_polygon, face_pieces};
pub use enrichment::{Cell, STANDARD, Topology};
pub use fragments::{Fragments, SMALLEST_FRAGMENT, UnionFind, bridging_edges};
pub(crate) use fragments::{bridging_edges_among, edges_near_cuts};
pub use lead::Lead;
pub use surface::{CrackSurface, Front, LinePoint, Sheet};
pub use surface_load::{LoadKind, SurfaceLoad};
pub use system::System;
