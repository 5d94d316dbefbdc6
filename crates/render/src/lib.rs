//! Pictures of the split by image-space CSG on an A-buffer (paper, section 4.3): slices in, pixels out.
//!
//! Knows no physics, no window and no file. A frame is made in four steps: [`scene`] triangles are projected and binned
//! (`project`), rasterised into lists of fragments (`raster`), walked front to back with winding counts ([`csg`]) and shaded
//! (`shade`, `ambient`). Lengths are mm, colours linear RGB.
mod ambient;
mod annotate;
pub mod chart;
pub mod csg;
mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
mod project;
mod raster;
mod renderer;
pub mod scene;
mod shade;
pub mod skin;
mod stereo;
mod vector;

pub use annotate::Canvas;
pub use frame::{Frame, Image, Options, render, z_buffer};
pub use renderer::Renderer;
pub use scene::{Camera, Kind, Material, Mesh, Scene, Texture};
pub use skin::Skin;
pub use stereo::{Stereo, compose};
