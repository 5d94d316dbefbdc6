//! (see the crate's own page)
pub mod haptic;
