//! The three steps of the simulation, each a page of calls in the paper's order, and what they work on.
//!
//! [`Bone`] is everything that is constant between two growths, [`BoneState`] what is computed on it.
mod balance;
mod bone;
mod crack_faces;
pub mod haptic;
mod ligament;
pub mod main;
mod meeting;
mod propagation;
mod relaxation;
mod search;
mod sweep_region;
mod under_loads;
mod walls;
mod yielding;

pub use bone::{Body, Bone, BoneState, Region};
pub use crack_faces::{CrackFaces, FaceContact, FacePlace};
pub use propagation::{FrontPoint, GrowthReport, PropagationSettings, Rest, propagation_step};
