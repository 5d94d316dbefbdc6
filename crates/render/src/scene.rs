//! What is to be seen, and from where.
use crate::skin::{MovedCell, Skin};
use crate::vector::{V3, cross, dot, scale, sub, unit};

/// What a mesh means to the CSG.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Surface of the bone; all bone meshes of a scene together are closed, normals outward.
    Bone,
    /// Part of the bone's closed surface that only counts and is never shown: what spans the crack's mouth.
    Seam,
    /// The slit that the saw left, a closed volume taken out of the bone.
    Kerf,
    /// The opened crack, a closed volume taken out of the bone. Counts apart from the kerf: where crack faces press into each
    /// other it is inside out, and must not fill the slit.
    Gap,
    /// Shown wherever it lies within the uncut bone: the crack surface in a transparent bone.
    Within,
    /// Shown as it is: tools, teeth, context, helper geometry.
    Solid,
    /// Part of the kerf's closed surface that only counts and is never shown: what spans two fragments.
    KerfSeam,
    /// The same of the gap's.
    GapSeam,
}

/// Pattern of a surface, in rest positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Texture {
    /// None.
    Plain,
    /// Cortical bone: faint mottling.
    Cortical,
    /// Sawn bone: fine scores.
    Sawn,
    /// Broken bone: rough and porous.
    Broken,
    /// Brushed steel; mirrors a bright surrounding.
    Steel,
    /// Helper geometry: hardly shaded, so that its colour is read at once.
    Signal,
}

/// How a surface looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Albedo, linear RGB.
    pub color: [f32; 3],
    /// Opacity seen head-on where the frame is transparent, 0 to 1; 1 hides what lies behind.
    pub opacity: f32,
    /// Strength of the highlight, 0 to 1.
    pub gloss: f32,
    /// Pattern.
    pub texture: Texture,
}

/// Triangles with one meaning and one look.
#[derive(Clone, Copy, Debug)]
pub struct Mesh<'a> {
    /// Meaning.
    pub kind: Kind,
    /// Look.
    pub material: Material,
    /// Vertex positions \[mm\].
    pub positions: &'a [[f32; 3]],
    /// Where the vertices were before deformation, for textures; empty: where they are.
    pub rest: &'a [[f32; 3]],
    /// Unit vertex normals; empty: flat triangles.
    pub normals: &'a [[f32; 3]],
    /// Counter-clockwise from outside.
    pub triangles: &'a [[u32; 3]],
}

/// All that is to be seen.
#[derive(Clone, Debug, Default)]
pub struct Scene<'a> {
    /// What moves with the bone's cells. Their parts come before the other meshes, in ids as in ties of depth.
    pub skins: &'a [Skin],
    /// The cells' moved nodes, for all skins.
    pub cells: &'a [MovedCell],
    /// All else, in any order.
    pub meshes: Vec<Mesh<'a>>,
    /// Colours of the background at the top and at the bottom, linear RGB.
    pub background: [[f32; 3]; 2],
}

/// A pinhole; any number of them may look at one scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Where it is \[mm\].
    pub eye: [f32; 3],
    /// Unit vectors to the right, up and forward.
    pub axes: [[f32; 3]; 3],
    /// Half the picture's height over the distance at which it is seen: tangent of half the vertical angle of view.
    pub tangent: f32,
    /// Shift of the picture to the right, in half heights: an eye beside the middle still looks straight ahead.
    pub shift: f32,
    /// Distance \[mm\] of what is looked at: where a scale bar is right, and where the two eyes' pictures meet.
    pub distance: f32,
}

impl Camera {
    /// Looks from `eye` at `target` with `up` upward.
    pub fn look_at(eye: [f32; 3], target: [f32; 3], up: [f32; 3], fov_deg: f32) -> Self {
        let forward = unit(sub(target, eye));
        let right = unit(cross(forward, up));
        Self {
            eye,
            axes: [right, cross(right, forward), forward],
            tangent: (0.5 * fov_deg.to_radians()).tan(),
            shift: 0.0,
            distance: dot(forward, sub(target, eye)),
        }
    }

    /// The eye `aside` \[mm\] to the right of this one, converging at [`distance`](Self::distance).
    pub fn aside(&self, aside: f32) -> Self {
        let eye = std::array::from_fn(|k| self.eye[k] + aside * self.axes[0][k]);
        // What is straight ahead at that distance moves by so much to the other side.
        let shift = self.shift + aside / (self.distance * self.tangent);
        Self {
            eye,
            shift,
            ..*self
        }
    }

    /// Right, up and forward coordinates of a point.
    pub(crate) fn to_view(self, p: V3) -> V3 {
        let d = sub(p, self.eye);
        self.axes.map(|a| dot(a, d))
    }

    /// Direction, one unit deep, through a point of the picture plane given in half heights from its middle.
    pub(crate) fn ray(&self, x: f32, y: f32) -> V3 {
        let [r, u, f] = self.axes;
        let (sx, sy) = ((x - self.shift) * self.tangent, y * self.tangent);
        std::array::from_fn(|k| f[k] + sx * r[k] + sy * u[k])
    }

    /// Size of a millimetre at [`distance`](Self::distance) in half heights.
    pub fn half_heights_per_mm(&self) -> f32 {
        1.0 / (self.distance * self.tangent)
    }
}

/// Vertex normals: those of the triangles, weighted by area.
pub fn vertex_normals(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0f32; 3]; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let n = cross(sub(b, a), sub(c, a));
        for v in t {
            let sum = &mut normals[*v as usize];
            (0..3).for_each(|k| sum[k] += n[k]);
        }
    }
    normals.iter().map(|n| unit(*n)).collect()
}

/// A triangle's normal, unit.
pub(crate) fn flat_normal([a, b, c]: [V3; 3]) -> V3 {
    let n = cross(sub(b, a), sub(c, a));
    scale(n, 1.0 / dot(n, n).sqrt().max(1e-20))
}
