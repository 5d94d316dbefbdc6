//! What things look like.
use osteotome_render::{Material, Texture};

const fn material(color: [f32; 3], opacity: f32, gloss: f32, texture: Texture) -> Material {
    Material {
        color,
        opacity,
        gloss,
        texture,
    }
}

/// The bone's surface.
pub const CORTICAL: Material = material([0.70, 0.59, 0.43], 0.19, 0.28, Texture::Cortical);
/// Walls of the saw's slit.
pub const SAWN: Material = material([0.80, 0.50, 0.36], 0.20, 0.10, Texture::Sawn);
/// Faces along which the bone broke.
pub const BROKEN: Material = material([0.58, 0.22, 0.15], 0.22, 0.05, Texture::Broken);
/// The crack in a transparent bone.
pub const CRACK: Material = material([0.85, 0.03, 0.03], 0.80, 0.0, Texture::Signal);
/// Crowns.
pub const TOOTH: Material = material([0.72, 0.69, 0.60], 0.55, 0.75, Texture::Plain);
/// Gums, and what lines the mouth.
pub const MUCOSA: Material = material([0.52, 0.16, 0.15], 0.35, 0.55, Texture::Plain);
/// Lips.
pub const LIP: Material = material([0.50, 0.17, 0.15], 0.30, 0.35, Texture::Plain);
/// The face.
pub const SKIN: Material = material([0.60, 0.36, 0.26], 0.22, 0.12, Texture::Plain);
/// What holds the cheek away.
pub const RETRACTOR: Material = material([0.62, 0.64, 0.67], 0.60, 0.7, Texture::Steel);
/// Bone that only stands around.
pub const AROUND: Material = material([0.56, 0.50, 0.40], 0.16, 0.2, Texture::Cortical);
/// Blades.
pub const STEEL: Material = material([0.78, 0.80, 0.83], 1.0, 0.8, Texture::Steel);
/// Handles.
pub const HANDLE: Material = material([0.10, 0.11, 0.13], 1.0, 0.45, Texture::Plain);
/// Load of the left and the right hand: blue and green, as in the paper's figure 1.
pub const LOADS: [Material; 2] = [
    material([0.04, 0.22, 0.95], 1.0, 0.0, Texture::Signal),
    material([0.02, 0.66, 0.12], 1.0, 0.0, Texture::Signal),
];
/// The same colours for letters, sRGB.
pub const LOAD_LETTERS: [[u8; 3]; 2] = [[120, 165, 255], [110, 230, 130]];
/// Background, top and bottom, linear.
pub const BACKGROUND: [[f32; 3]; 2] = [[0.060, 0.078, 0.100], [0.016, 0.020, 0.026]];
