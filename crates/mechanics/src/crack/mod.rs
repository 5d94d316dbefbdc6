//! The crack: its explicit surface, what it cuts, how hard it is driven, and how it grows.
pub mod criterion;
mod cut_edges;
mod enrichment;
mod fragments;
mod system;

pub use cut_edges::CutEdges;
pub use enrichment::{Cell, NO_CELL, STANDARD, Topology};
pub use fragments::{Fragments, UnionFind, bridging_edges};
pub use system::System;
