//! What stands around the bone: chisels with their handles, and arrows of the load.
use super::look;
use osteotome_mechanics::geometry::{Pose, TriMesh, Vec3};
use osteotome_mechanics::tool::Chisel;
use osteotome_render::{Kind, Material, Mesh, scene::vertex_normals};

/// A mesh of its own.
#[derive(Clone, Debug)]
pub struct Prop {
    /// What it is to the CSG.
    pub kind: Kind,
    /// How it looks.
    pub material: Material,
    /// \[mm\]
    pub positions: Vec<[f32; 3]>,
    /// Where textures are: positions in the prop's own frame; empty: where it is.
    pub rest: Vec<[f32; 3]>,
    /// Empty for flat triangles.
    pub normals: Vec<[f32; 3]>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Prop {
    /// For the renderer.
    pub fn mesh(&self) -> Mesh<'_> {
        Mesh {
            kind: self.kind,
            material: self.material,
            positions: &self.positions,
            rest: &self.rest,
            normals: &self.normals,
            triangles: &self.triangles,
        }
    }

    /// Of a surface that shows both its sides, smooth.
    pub(super) fn surface(material: Material, mesh: &TriMesh) -> Self {
        Self::solid(material, &mesh.vertices, mesh.triangles.clone(), true)
    }

    /// The same with edges.
    pub(super) fn flat(material: Material, mesh: &TriMesh) -> Self {
        Self::solid(material, &mesh.vertices, mesh.triangles.clone(), false)
    }

    fn moved(&self, pose: &Pose) -> Self {
        let turn = *pose.rotation.to_rotation_matrix().matrix();
        let turned = |p: &[f32; 3]| turn * Vec3::from(p.map(f64::from));
        let single = |p: Vec3| -> [f32; 3] { p.cast::<f32>().into() };
        let at = |p| single(turned(p) + pose.translation.vector);
        Self {
            positions: self.positions.iter().map(at).collect(),
            normals: self.normals.iter().map(|n| single(turned(n))).collect(),
            rest: self.rest.clone(),
            triangles: self.triangles.clone(),
            ..*self
        }
    }

    fn solid(
        material: Material,
        vertices: &[Vec3],
        triangles: Vec<[u32; 3]>,
        is_round: bool,
    ) -> Self {
        let positions: Vec<[f32; 3]> = vertices.iter().map(|p| p.cast::<f32>().into()).collect();
        let normals = if is_round {
            vertex_normals(&positions, &triangles)
        } else {
            vec![]
        };
        Self {
            kind: Kind::Solid,
            material,
            positions,
            rest: vec![],
            normals,
            triangles,
        }
    }
}

/// Radius and place along the shaft of a handle's rings, from its ferrule back \[mm\].
const HANDLE: [[f64; 2]; 8] = [
    [2.2, 2.0],
    [2.6, -1.0],
    [3.0, -6.0],
    [5.0, -10.0],
    [5.6, -30.0],
    [5.0, -70.0],
    [6.0, -92.0],
    [3.5, -96.0],
];

/// A chisel: the blade as mechanics knows it, and a handle behind it.
pub struct Figure([Prop; 2]);

impl Figure {
    /// Of a chisel.
    pub fn of(chisel: &Chisel) -> Self {
        let surface = chisel.surface();
        let mut blade = Prop::solid(look::STEEL, &surface.vertices, surface.triangles, false);
        // Textures stay with the tool.
        blade.rest.clone_from(&blade.positions);
        let back = Vec3::z() * -chisel.parameters().length;
        let rings = HANDLE.map(|[r, z]| (back + Vec3::z() * z, r));
        Self([blade, tube(look::HANDLE, &rings)])
    }

    /// At a pose of the tool.
    pub fn at(&self, pose: &Pose) -> [Prop; 2] {
        self.0.each_ref().map(|p| p.moved(pose))
    }
}

/// A chisel at a pose.
pub fn chisel(chisel: &Chisel, pose: &Pose) -> [Prop; 2] {
    Figure::of(chisel).at(pose)
}

const ROUND: u32 = 24;

/// A round bar through rings of given centres and radii, closed at both ends.
pub(super) fn tube(material: Material, rings: &[(Vec3, f64)]) -> Prop {
    let n = rings.len();
    let way = |k: usize| {
        let (from, to) = (rings[k.saturating_sub(1)].0, rings[(k + 1).min(n - 1)].0);
        (to - from).try_normalize(1e-12).unwrap_or(Vec3::z())
    };
    let mut aside = perpendicular(&way(0));
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (k, (centre, radius)) in rings.iter().enumerate() {
        let along = way(k);
        // Carried along the bar, so that it does not twist.
        aside = (aside - along * aside.dot(&along))
            .try_normalize(1e-9)
            .unwrap_or(perpendicular(&along));
        let other = along.cross(&aside);
        for i in 0..ROUND {
            let a = f64::from(i) / f64::from(ROUND) * std::f64::consts::TAU;
            vertices.push(centre + (aside * a.cos() + other * a.sin()) * *radius);
        }
    }
    for k in 0..n as u32 - 1 {
        for i in 0..ROUND {
            let (a, b) = (k * ROUND + i, k * ROUND + (i + 1) % ROUND);
            triangles.extend([[a, b, b + ROUND], [a, b + ROUND, a + ROUND]]);
        }
    }
    let last = (n as u32 - 1) * ROUND;
    for i in 1..ROUND - 1 {
        triangles.extend([[0, i + 1, i], [last, last + i, last + i + 1]]);
    }
    Prop::solid(material, &vertices, triangles, true)
}

fn perpendicular(v: &Vec3) -> Vec3 {
    let aside = if v.x.abs() < 0.7 {
        Vec3::x()
    } else {
        Vec3::y()
    };
    v.cross(&aside).normalize()
}

/// Length of an arrow a newton \[mm/N\], and the shortest and longest that are drawn \[mm\].
const ARROW: [f64; 3] = [0.22, 4.0, 45.0];
/// Angle of a torque's arc a newton millimetre \[rad/(N mm)\], and the least and most \[rad\].
const ARC: [f64; 3] = [4.5e-4, 0.35, 5.2];
const SHAFT: f64 = 0.5;
const HEAD: [f64; 2] = [1.4, 4.2];

/// The load of one hand on the bone \[N, N mm\]: an arrow that pushes on the blade's edge, and an arc about the blade. None
/// where there is hardly any.
pub fn load(material: Material, pose: &Pose, force: &Vec3, torque: &Vec3) -> Vec<Prop> {
    let edge = pose.translation.vector;
    let mut props = Vec::new();
    if force.norm() > 2.0 {
        let length = (ARROW[0] * force.norm()).clamp(ARROW[1], ARROW[2]);
        let along = force.normalize();
        let at = |s: f64| edge - along * s;
        let neck = HEAD[1].min(0.6 * length);
        let rings = [
            (at(length), SHAFT),
            (at(neck), SHAFT),
            (at(neck), HEAD[0]),
            (at(0.0), 0.02),
        ];
        props.push(tube(material, &rings));
    }
    if torque.norm() > 50.0 {
        props.push(arc(material, pose, torque));
    }
    props
}

/// Around the blade, where it is seen above the bone.
fn arc(material: Material, pose: &Pose, torque: &Vec3) -> Prop {
    const RADIUS: f64 = 7.0;
    const BACK: f64 = 27.0;
    let centre = pose * nalgebra::Point3::new(0.0, 0.0, -BACK);
    let axis = torque.normalize();
    let start = perpendicular(&axis);
    let other = axis.cross(&start);
    let at = |a: f64| centre.coords + (start * a.cos() + other * a.sin()) * RADIUS;
    let sweep = (ARC[0] * torque.norm()).clamp(ARC[1], ARC[2]);
    let n = 40;
    let mut rings: Vec<(Vec3, f64)> = (0..=n)
        .map(|k| (at(sweep * f64::from(k) / f64::from(n)), SHAFT))
        .collect();
    let head = HEAD[1] / RADIUS;
    rings.extend([(at(sweep), HEAD[0]), (at(sweep + head), 0.02)]);
    tube(material, &rings)
}
