//! A scene's triangles in the device's buffers.
use super::buffers::Growing;
use super::device::{Device, Fault};
use crate::scene::{Kind, Mesh, Scene, Texture};
use std::ops::Range;

/// Numbers of triangles have 28 bits.
const MOST_TRIANGLES: usize = 1 << 28;

pub struct Geometry {
    pub positions: Growing,
    /// Normal and undeformed position of each vertex.
    pub attributes: Growing,
    /// Three vertices and a mesh each.
    pub triangles: Growing,
    pub meshes: Growing,
    pub n_vertices: u32,
    /// For each mesh what it means and which triangles it has.
    pub parts: Vec<(Kind, Range<u32>)>,
}

impl Geometry {
    pub fn new() -> Self {
        Self {
            positions: Growing::storage("positions"),
            attributes: Growing::storage("attributes"),
            triangles: Growing::storage("triangles"),
            meshes: Growing::storage("meshes"),
            n_vertices: 0,
            parts: Vec::new(),
        }
    }

    /// Takes a scene's place.
    pub fn upload(&mut self, device: &Device, scene: &Scene) -> Result<(), Fault> {
        let n: usize = scene.meshes.iter().map(|m| m.triangles.len()).sum();
        let n_vertices: usize = scene.meshes.iter().map(|m| m.positions.len()).sum();
        if n >= MOST_TRIANGLES || u32::try_from(n_vertices).is_err() {
            return Err(Fault::TooLarge);
        }
        let mut positions: Vec<[f32; 3]> = Vec::with_capacity(n_vertices);
        let mut attributes: Vec<[[f32; 3]; 2]> = Vec::with_capacity(n_vertices);
        let mut triangles: Vec<[u32; 4]> = Vec::with_capacity(n);
        let mut meshes: Vec<[u32; 8]> = Vec::with_capacity(scene.meshes.len());
        self.parts.clear();
        for (number, mesh) in (0u32..).zip(&scene.meshes) {
            let first = positions.len() as u32;
            let start = triangles.len() as u32;
            positions.extend(mesh.positions);
            attributes.extend((0..mesh.positions.len()).map(|v| {
                let of = |list: &[[f32; 3]]| list.get(v).copied().unwrap_or_default();
                [of(mesh.normals), of(mesh.rest)]
            }));
            let numbered = |t: &[u32; 3]| [t[0] + first, t[1] + first, t[2] + first, number];
            triangles.extend(mesh.triangles.iter().map(numbered));
            meshes.push(described(mesh));
            self.parts.push((mesh.kind, start..triangles.len() as u32));
        }
        self.n_vertices = positions.len() as u32;
        self.positions.write(device, &positions)?;
        self.attributes.write(device, &attributes)?;
        self.triangles.write(device, &triangles)?;
        self.meshes.write(device, &meshes)
    }

    /// The mesh of a triangle.
    pub fn mesh_of(&self, triangle: u32) -> u32 {
        self.parts.partition_point(|(_, of)| of.end <= triangle) as u32
    }
}

/// `Mesh` of frame.wgsl.
fn described(mesh: &Mesh) -> [u32; 8] {
    let m = &mesh.material;
    let flags = u32::from(!mesh.normals.is_empty()) | u32::from(!mesh.rest.is_empty()) << 1;
    let [r, g, b] = m.color.map(f32::to_bits);
    [
        r,
        g,
        b,
        m.opacity.to_bits(),
        m.gloss.to_bits(),
        texture(m.texture),
        kind(mesh.kind),
        flags,
    ]
}

fn kind(kind: Kind) -> u32 {
    match kind {
        Kind::Bone => 0,
        Kind::Seam => 1,
        Kind::Kerf => 2,
        Kind::Gap => 3,
        Kind::Within => 4,
        Kind::Solid => 5,
    }
}

fn texture(texture: Texture) -> u32 {
    match texture {
        Texture::Plain => 0,
        Texture::Cortical => 1,
        Texture::Sawn => 2,
        Texture::Broken => 3,
        Texture::Steel => 4,
        Texture::Signal => 5,
    }
}
