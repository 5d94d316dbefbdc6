//! A block of bone and a pair of chisels, shared by the contact tests; cracked blocks, shared by the fracture tests.
#![allow(dead_code)]
pub mod cracked;

use nalgebra::{Matrix3x4, Translation3, UnitQuaternion};
use osteotome_mechanics::contact::{
    BoundingVolumes, ContactLaw, ContactScene, PointShell, ShellPoints, boundary_points,
};
use osteotome_mechanics::geometry::{Pose, TetMesh, Vec3, block_mesh};
use osteotome_mechanics::tool::{Chisel, ChiselParameters, Coupling, Tool, ToolModel};

/// A block with its shell, a cell a tetrahedron.
pub struct Block {
    pub mesh: TetMesh,
    pub points: ShellPoints,
    pub shell: PointShell,
    pub deformation: Vec<Matrix3x4<f32>>,
    pub volumes: BoundingVolumes,
}

impl Block {
    /// 40 x 24 x 20 mm with its top at z = 0, deformed by `map`; `n * n` points a boundary triangle.
    pub fn new(n: usize, map: impl Fn(&Vec3) -> Vec3) -> Self {
        let (min, max) = (Vec3::new(-20.0, -12.0, -20.0), Vec3::new(20.0, 12.0, 0.0));
        let mesh = block_mesh(min, max, [8, 6, 5]);
        let points = boundary_points(&mesh, n);
        let cells: Vec<u32> = points.iter().map(|p| p.tet).collect();
        let points = ShellPoints::new(points.into());
        let shell = PointShell::group(&points, &cells, mesh.tets().len());
        let deformation = deformed(&mesh, map);
        let volumes = BoundingVolumes::new(&shell, &deformation);
        Self {
            mesh,
            points,
            shell,
            deformation,
            volumes,
        }
    }

    pub fn still(n: usize) -> Self {
        Self::new(n, |p| *p)
    }

    pub fn scene(&self) -> ContactScene<'_> {
        ContactScene {
            shell: &self.shell,
            volumes: &self.volumes,
            deformation: &self.deformation,
            state: 0,
            near: None,
        }
    }

    pub fn deform(&mut self, map: impl Fn(&Vec3) -> Vec3) {
        self.deformation = deformed(&self.mesh, map);
        self.volumes.update(&self.shell, &self.deformation);
    }

    /// Deformed position of point `i`.
    pub fn deformed_point(&self, i: usize) -> Vec3 {
        let p = self.points.get(i as u32);
        let n = nalgebra::Vector4::from(p.weights).map(f64::from);
        self.deformation[p.tet as usize].map(f64::from) * n
    }
}

fn deformed(mesh: &TetMesh, map: impl Fn(&Vec3) -> Vec3) -> Vec<Matrix3x4<f32>> {
    let columns = |t: usize| mesh.corners(t).map(|x| map(&x).map(|v| v as f32));
    (0..mesh.tets().len())
        .map(|t| Matrix3x4::from_columns(&columns(t)))
        .collect()
}

/// Two chisels of 10 x 3 x 60 mm, coupled as strongly as two real devices.
pub fn model(friction: f64) -> ToolModel {
    let shape = Chisel::new(ChiselParameters::default()).unwrap().shape();
    let tool = |force: f64| Tool {
        shape: shape.clone(),
        coupling: Coupling::new(160.0, 12_000.0, force, 4_700.0).unwrap(),
    };
    ToolModel {
        tools: [tool(660.0), tool(1_700.0)],
        law: ContactLaw::new(500.0, friction).unwrap(),
        surroundings: Vec::new(),
    }
}

/// World from tool: at `at`, driven along -z of the world, then turned by the rotation vector `turn`.
pub fn downward(at: Vec3, turn: Vec3) -> Pose {
    let down = UnitQuaternion::from_scaled_axis(Vec3::x() * std::f64::consts::PI);
    Pose::from_parts(
        Translation3::from(at),
        UnitQuaternion::from_scaled_axis(turn) * down,
    )
}

/// Far away from the block, where nothing touches.
pub fn aside() -> Pose {
    downward(Vec3::new(0.0, 0.0, 300.0), Vec3::zeros())
}

/// A small motion in world axes about the pose's origin: translation above rotation vector.
pub fn moved(pose: &Pose, motion: &[f64; 6]) -> Pose {
    let [x, y, z, a, b, c] = *motion;
    let at = pose.translation.vector + Vec3::new(x, y, z);
    let turn = UnitQuaternion::from_scaled_axis(Vec3::new(a, b, c));
    Pose::from_parts(Translation3::from(at), turn * pose.rotation)
}

/// Repeatable numbers in [-1, 1].
pub fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = 2 * seed + 1;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
