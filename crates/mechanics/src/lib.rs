//! The physics of splitting a bone: numbers in, numbers out.
//!
//! No file, thread, clock, GPU or log. Folders use only those listed above them:
//! [`geometry`] -> [`bone`] -> [`crack`] -> [`contact`] -> [`tool`] -> [`step`].
//! Units everywhere: mm, N, MPa, N mm, s, rad.
pub mod bone;
pub mod contact;
pub mod crack;
pub mod geometry;
pub mod step;
pub mod tool;
