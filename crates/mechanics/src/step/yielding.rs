//! How the tools give way when the bone does: the part of the coupled equations that plain sweeps leave out.
//!
//! A sweep solves the bone under forces that were computed for where it stood. Stiffly held tools against a soft fragment
//! then overshoot more with each sweep. Here each tool's contacts are taken as one patch that moves with the bone as a rigid
//! body; as the patch moves, the wrench on it falls by the virtual coupling's own stiffness S. With B the unknowns' forces of
//! a unit wrench on the patch, the sweep becomes (K + B S B^T) x = F + B S B^T x_old. By the formula of Sherman, Morrison and
//! Woodbury that is K x = F + B q, with q from the compliance C = B^T K^-1 B, and for C the forward half of a solve is
//! enough. Its fixed point is that of the plain sweep.
use super::bone::Bone;
use crate::bone::{HalfSolved, Swept};
use crate::contact::{Matrix6, Wrench};
use crate::crack::stress_intensity::CellForce;
use crate::geometry::{Pose, Vec3};
use crate::tool::{BoneCompliance, Matrix12, ToolsState};
use nalgebra::{DMatrix, DVector, Matrix6x3, Vector6};
use std::collections::BTreeMap;

/// The tools' yielding in one main step.
#[derive(Debug)]
pub struct Yielding {
    /// The tools that touch, and where each was.
    touching: Vec<(usize, Vec3)>,
    /// B, column by column: (unknown, value).
    forces: Vec<Vec<(u32, f64)>>,
    half: HalfSolved,
    /// C = B^T K^-1 B.
    compliance: DMatrix<f64>,
    /// (I + S C)^-1 S.
    correction: DMatrix<f64>,
    stiffness: DMatrix<f64>,
}

/// The contacts of one tool and the stiffness of its coupling about its origin.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Its contacts: deformed position and force on the bone.
    pub contacts: Vec<(Vec3, CellForce)>,
    /// World from tool.
    pub tool: Pose,
    /// 6 x 6, force and torque against translation and rotation.
    pub stiffness: Matrix6,
}

impl Yielding {
    /// The correction for these contacts; none without contacts.
    pub fn new(bone: &Bone, patches: &[Patch; 2]) -> Option<Self> {
        let (mut touching, mut forces) = (Vec::new(), Vec::new());
        for (t, patch) in patches.iter().enumerate() {
            if let Some(unit) = unit_wrenches(bone, patch) {
                touching.push((t, patch.tool.translation.vector));
                forces.extend(unit);
            }
        }
        if forces.is_empty() {
            return None;
        }
        let m = forces.len();
        let mut stiffness = DMatrix::zeros(m, m);
        for (k, (t, _)) in touching.iter().enumerate() {
            let mut own = stiffness.fixed_view_mut::<6, 6>(6 * k, 6 * k);
            own.copy_from(&patches[*t].stiffness);
        }
        let half = bone.system.half_solve(&forces);
        let compliance = DMatrix::from_vec(m, m, half.compliance(&half));
        let system = DMatrix::identity(m, m) + &stiffness * &compliance;
        let correction = system.lu().solve(&stiffness)?;
        let is_sound = correction.iter().all(|v| v.is_finite());
        is_sound.then_some(Self {
            touching,
            forces,
            half,
            compliance,
            correction,
            stiffness,
        })
    }

    /// Adds B q to what is half solved of all other loads on the way from `before`, so that the sweep down gives the corrected sweep
    /// from `old`.
    pub fn correct(&self, bone: &Bone, before: &[f64], old: &[f64], swept: &mut Swept) {
        let way = DVector::from_vec(bone.system.project(&self.half, swept));
        let free = self.patches(before) + way;
        let pull = &self.stiffness * self.patches(old);
        let q = &pull - &self.correction * (free + &self.compliance * &pull);
        bone.system.add_half(&self.half, q.as_slice(), swept);
    }

    /// What the haptic loop needs to let the bone yield, about a state in which the tools rest at `tools` and their couplings pull
    /// with `pull` (about the tools' origins).
    pub fn bone_compliance(&self, tools: &ToolsState, pull: &[Wrench; 2]) -> BoneCompliance {
        let mut matrix = Matrix12::zeros();
        let mut origins = tools.poses.map(|p| p.translation.vector);
        for (i, (t, origin)) in self.touching.iter().enumerate() {
            origins[*t] = *origin;
            for (j, (u, _)) in self.touching.iter().enumerate() {
                let block = self.compliance.fixed_view::<6, 6>(6 * i, 6 * j);
                let mut to = matrix.fixed_view_mut::<6, 6>(6 * t, 6 * u);
                to.copy_from(&block);
            }
        }
        let load = [0, 1].map(|t| {
            let arm = tools.poses[t].translation.vector - origins[t];
            Wrench {
                force: pull[t].force,
                torque: pull[t].torque + arm.cross(&pull[t].force),
            }
        });
        BoneCompliance {
            matrix,
            origins,
            load,
        }
    }

    /// B^T x: how the patches move when the bone does.
    fn patches(&self, x: &[f64]) -> DVector<f64> {
        let along = |f: &Vec<(u32, f64)>| f.iter().map(|(i, v)| v * x[*i as usize]).sum();
        DVector::from_iterator(self.forces.len(), self.forces.iter().map(along))
    }
}

/// The unknowns' forces of the six unit wrenches on a patch; none if nothing presses.
fn unit_wrenches(bone: &Bone, patch: &Patch) -> Option<Vec<Vec<(u32, f64)>>> {
    // Contacts are many, cells few: summed by cell and corner before the unknowns are looked up.
    let mut corners: BTreeMap<u32, [Matrix6x3<f64>; 4]> = BTreeMap::new();
    for ((_, load), row) in patch.contacts.iter().zip(spread(patch)?) {
        let cell = corners.entry(load.cell).or_default();
        for (sum, w) in cell.iter_mut().zip(load.weights) {
            *sum += row * w;
        }
    }
    let mesh = &bone.body.mesh;
    let mut columns = vec![Vec::new(); 6];
    for (cell, rows) in &corners {
        let cell = &bone.topology.cells()[*cell as usize];
        for (k, column) in columns.iter_mut().enumerate() {
            let forces = rows.each_ref().map(|r| r.row(k).transpose());
            bone.system.push_corner_forces(mesh, cell, &forces, column);
        }
    }
    Some(columns)
}

/// For each contact the force (3) that a unit wrench (6) on the patch means there: weighted by how hard it presses.
fn spread(patch: &Patch) -> Option<Vec<Matrix6x3<f64>>> {
    /// Keeps a patch of few or collinear points regular: a radius \[mm\] that every contact has at least.
    const RADIUS: f64 = 0.5;
    let total: f64 = patch.contacts.iter().map(|c| c.1.force.norm()).sum();
    if total <= 0.0 {
        return None;
    }
    let origin = patch.tool.translation.vector;
    let arm = |p: &Vec3| {
        let mut j = Matrix6x3::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        j.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(p - origin).cross_matrix());
        j
    };
    let mut mass =
        Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)) * (RADIUS * RADIUS);
    for (p, load) in &patch.contacts {
        let j = arm(p);
        mass += j * j.transpose() * (load.force.norm() / total);
    }
    let inverse = mass.try_inverse()?;
    Some(
        patch
            .contacts
            .iter()
            .map(|(p, load)| inverse * arm(p) * (load.force.norm() / total))
            .collect(),
    )
}
