//! A scene's triangles in the device's buffers: skins first, which stay there from frame to frame, then the other meshes.
use super::buffers::Growing;
use super::device::{Device, Fault};
use crate::project::NEAR;
use crate::scene::{Kind, Material, Mesh, Scene, Texture};
use crate::skin::{Anchor, Bounds, Skin};
use crate::vector::V3;
use std::ops::Range;

/// Numbers of triangles have 28 bits.
const MOST_TRIANGLES: usize = 1 << 28;

/// The device's copy of a scene.
pub struct Geometry {
    pub positions: Growing,
    /// Normal and undeformed position of each vertex.
    pub attributes: Growing,
    /// Three vertices and a mesh each.
    pub triangles: Growing,
    pub meshes: Growing,
    /// Place in the bone of each vertex that has one.
    pub anchors: Growing,
    /// Numbers of the triangles around each such vertex.
    pub incident: Growing,
    /// The cells' moved nodes.
    pub cells: Growing,
    pub n_vertices: u32,
    /// How many of them move with cells.
    pub n_anchored: u32,
    /// For each mesh what it means and which triangles it has.
    pub parts: Vec<(Kind, Range<u32>)>,
    /// The skins that are there.
    skins: Vec<u64>,
    /// Where all bone surely is, if it is closed.
    bone: Option<Bounds>,
}

/// How much there is of everything.
#[derive(Clone, Copy, Default)]
struct Count {
    vertices: usize,
    triangles: usize,
    meshes: usize,
}

impl Count {
    fn of_skins(skins: &[Skin]) -> Self {
        let parts = || skins.iter().flat_map(Skin::parts);
        Self {
            vertices: skins.iter().map(|s| s.anchors().len()).sum(),
            triangles: parts().map(|p| p.triangles.len()).sum(),
            meshes: parts().count(),
        }
    }

    fn and(self, meshes: &[Mesh]) -> Self {
        Self {
            vertices: self.vertices + meshes.iter().map(|m| m.positions.len()).sum::<usize>(),
            triangles: self.triangles + meshes.iter().map(|m| m.triangles.len()).sum::<usize>(),
            meshes: self.meshes + meshes.len(),
        }
    }
}

/// What is written of a list of meshes.
#[derive(Default)]
struct Lists {
    /// What there is before.
    from: Count,
    attributes: Vec<[[f32; 3]; 2]>,
    triangles: Vec<[u32; 4]>,
    meshes: Vec<[u32; 8]>,
}

impl Geometry {
    pub fn new() -> Self {
        Self {
            positions: Growing::storage("positions"),
            attributes: Growing::storage("attributes"),
            triangles: Growing::storage("triangles"),
            meshes: Growing::storage("meshes"),
            anchors: Growing::storage("anchors"),
            incident: Growing::storage("incident"),
            cells: Growing::storage("cells"),
            n_vertices: 0,
            n_anchored: 0,
            parts: Vec::new(),
            skins: Vec::new(),
            bone: None,
        }
    }

    /// Takes a scene's place. Of skins that are there already only the moved cells are sent.
    pub fn upload(&mut self, device: &Device, scene: &Scene) -> Result<(), Fault> {
        let of_skins = Count::of_skins(scene.skins);
        let all = of_skins.and(&scene.meshes);
        if all.triangles >= MOST_TRIANGLES || u32::try_from(all.vertices).is_err() {
            return Err(Fault::TooLarge);
        }
        let is_lost = [
            self.positions.reserve(device, 12 * all.vertices)?,
            self.attributes.reserve(device, 24 * all.vertices)?,
            self.triangles.reserve(device, 16 * all.triangles)?,
            self.meshes.reserve(device, 32 * all.meshes)?,
        ];
        let is_there = self
            .skins
            .iter()
            .copied()
            .eq(scene.skins.iter().map(Skin::number));
        if !is_there || is_lost.contains(&true) {
            self.upload_skins(device, scene.skins)?;
        }
        self.cells.write(device, scene.cells)?;
        self.parts.truncate(of_skins.meshes);
        self.upload_meshes(device, &scene.meshes, of_skins);
        self.bone = bounds_of_bone(scene);
        (self.n_vertices, self.n_anchored) = (all.vertices as u32, of_skins.vertices as u32);
        Ok(())
    }

    fn upload_skins(&mut self, device: &Device, skins: &[Skin]) -> Result<(), Fault> {
        self.parts.clear();
        self.skins.clear();
        let (mut lists, mut places) = (Lists::default(), Vec::new());
        let mut incident: Vec<u32> = Vec::new();
        for skin in skins {
            let (first, start) = (places.len() as u32, lists.triangles.len() as u32);
            lists
                .attributes
                .extend(skin.rest().iter().map(|r| [[0.0; 3], *r]));
            let mut around = vec![Vec::new(); skin.anchors().len()];
            let mut number = start;
            for part in skin.parts() {
                let flags = (u32::from(part.is_smooth) * SMOOTH) | HAS_REST;
                let described = described(part.kind, &part.material, flags);
                let range = lists.mesh(first, &part.triangles, described);
                self.parts.push((part.kind, range));
                for t in &part.triangles {
                    if part.is_smooth {
                        t.iter().for_each(|v| around[*v as usize].push(number));
                    }
                    number += 1;
                }
            }
            for (v, (anchor, around)) in (0u32..).zip(skin.anchors().iter().zip(&around)) {
                let range = [incident.len() as u32, around.len() as u32];
                places.push(placed(anchor, v, first, range));
                incident.extend(around);
            }
            self.skins.push(skin.number());
        }
        self.anchors.write(device, &places)?;
        self.incident.write(device, &incident)?;
        lists.write(self, device);
        Ok(())
    }

    fn upload_meshes(&mut self, device: &Device, meshes: &[Mesh], from: Count) {
        let mut lists = Lists {
            from,
            ..Lists::default()
        };
        let mut positions: Vec<[f32; 3]> = Vec::new();
        for mesh in meshes {
            let first = (from.vertices + positions.len()) as u32;
            positions.extend(mesh.positions);
            lists.attributes.extend((0..mesh.positions.len()).map(|v| {
                let of = |list: &[[f32; 3]]| list.get(v).copied().unwrap_or_default();
                [of(mesh.normals), of(mesh.rest)]
            }));
            let is_smooth = u32::from(!mesh.normals.is_empty());
            let has_rest = u32::from(!mesh.rest.is_empty());
            let flags = (is_smooth * SMOOTH) | (has_rest * HAS_REST);
            let described = described(mesh.kind, &mesh.material, flags);
            let range = lists.mesh(first, mesh.triangles, described);
            self.parts.push((mesh.kind, range));
        }
        self.positions.write_from(device, from.vertices, &positions);
        lists.write(self, device);
    }

    /// Whether an eye is surely outside of a bone that is surely closed.
    pub fn is_outside(&self, eye: V3) -> bool {
        let near =
            |b: &Bounds| (0..3).all(|k| eye[k] > b.low[k] - NEAR && eye[k] < b.high[k] + NEAR);
        self.bone.as_ref().is_some_and(|b| !near(b))
    }

    /// Draws the meshes of some kinds.
    pub fn draw(&self, pass: &mut wgpu::RenderPass, is_drawn: impl Fn(Kind) -> bool) {
        for (kind, triangles) in &self.parts {
            if is_drawn(*kind) && !triangles.is_empty() {
                pass.draw(3 * triangles.start..3 * triangles.end, 0..1);
            }
        }
    }

    /// How many triangles there are.
    pub fn n_triangles(&self) -> u32 {
        self.parts.last().map_or(0, |(_, of)| of.end)
    }

    /// The mesh of a triangle.
    pub fn mesh_of(&self, triangle: u32) -> u32 {
        self.parts.partition_point(|(_, of)| of.end <= triangle) as u32
    }
}

impl Lists {
    /// Adds a mesh whose vertices start at `first`; gives its range of triangles.
    fn mesh(&mut self, first: u32, triangles: &[[u32; 3]], described: [u32; 8]) -> Range<u32> {
        let number = (self.from.meshes + self.meshes.len()) as u32;
        let start = (self.from.triangles + self.triangles.len()) as u32;
        let numbered = |t: &[u32; 3]| [t[0] + first, t[1] + first, t[2] + first, number];
        self.triangles.extend(triangles.iter().map(numbered));
        self.meshes.push(described);
        start..start + triangles.len() as u32
    }

    fn write(&self, to: &Geometry, device: &Device) {
        let from = self.from;
        to.attributes
            .write_from(device, from.vertices, &self.attributes);
        to.triangles
            .write_from(device, from.triangles, &self.triangles);
        to.meshes.write_from(device, from.meshes, &self.meshes);
    }
}

/// `None` if some of the bone is open, or not a skin: then nobody has looked whether it is closed.
fn bounds_of_bone(scene: &Scene) -> Option<Bounds> {
    let is_bone = |kind| matches!(kind, Kind::Bone | Kind::Seam);
    let closed = scene.skins.iter().all(Skin::is_closed);
    let is_known = closed && !scene.meshes.iter().any(|m| is_bone(m.kind));
    let has_bone = |s: &&Skin| s.parts().iter().any(|p| is_bone(p.kind));
    let bone = scene.skins.iter().filter(has_bone);
    let beyond = bone.map(Skin::beyond).fold(0.0, f32::max);
    is_known.then(|| Bounds::of(scene.cells, beyond))
}

/// As in frame.wgsl.
const SMOOTH: u32 = 1;
const HAS_REST: u32 = 2;

/// `Mesh` of frame.wgsl.
fn described(of: Kind, m: &Material, flags: u32) -> [u32; 8] {
    let [r, g, b] = m.color.map(f32::to_bits);
    [
        r,
        g,
        b,
        m.opacity.to_bits(),
        m.gloss.to_bits(),
        texture(m.texture),
        kind(of),
        flags,
    ]
}

/// `Anchor` of deform.wgsl for vertex `v` of a skin whose vertices start at `first`.
fn placed(a: &Anchor, v: u32, first: u32, [from, n]: [u32; 2]) -> [u32; 12] {
    let [w0, w1, w2, w3] = a.weights.map(f32::to_bits);
    let (opposite, into) = a.wear.map_or((v, [0.0; 3]), |w| (w.opposite, w.into));
    let [x, y, z] = into.map(f32::to_bits);
    [
        w0,
        w1,
        w2,
        w3,
        x,
        y,
        z,
        a.cell,
        opposite + first,
        from,
        n,
        0,
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
        Kind::KerfSeam => 6,
        Kind::GapSeam => 7,
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
