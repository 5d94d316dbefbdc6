//! Pictures of the split: the image-space CSG of the paper (section 4.3) arrives here with the renderer.
