//! How the tools give way when the bone does: the part of the coupled equations that plain sweeps leave out.
//!
//! A sweep solves the bone under forces that were computed for where it stood. Stiffly held tools against a soft fragment
//! then overshoot more with each sweep. Here each tool's contacts are taken as one patch that moves with the bone as a rigid
//! body; as the patch moves, the wrench on it falls by the virtual coupling's own stiffness S. With B the unknowns' forces of
//! a unit wrench on the patch, the sweep becomes (K + B S B^T) x = F + B S B^T x_old, solved with the kept factor of K by
//! the formula of Sherman, Morrison and Woodbury (twelve columns a main step). Its fixed point is the same.
use super::bone::Bone;
use crate::bone::SolveScratch;
use crate::contact::Matrix6;
use crate::crack::stress_intensity::CellForce;
use crate::geometry::{Pose, Vec3};
use nalgebra::{DMatrix, DVector, Matrix6x3, Vector6};

/// The tools' yielding in one main step.
#[derive(Debug, Default)]
pub struct Yielding {
    n: usize,
    /// B and K^-1 B, column by column.
    forces: Vec<f64>,
    columns: Vec<f64>,
    /// (I + S C)^-1 S with C = B^T K^-1 B.
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
    /// Prepares the correction for these contacts; without contacts it does nothing.
    pub fn prepare(&mut self, bone: &Bone, patches: &[Patch; 2], solve: &mut SolveScratch) {
        let n = bone.system.n();
        self.n = 0;
        self.forces.clear();
        let mut stiffness = Vec::new();
        for patch in patches {
            if let Some(spread) = spread(patch) {
                for k in 0..6 {
                    let start = self.forces.len();
                    self.forces.resize(start + n, 0.0);
                    for ((_, load), row) in patch.contacts.iter().zip(&spread) {
                        let force = row.row(k).transpose();
                        let unit = CellForce { force, ..*load };
                        bone.add_loads([&unit], &mut self.forces[start..]);
                    }
                }
                stiffness.push(patch.stiffness);
            }
        }
        if stiffness.is_empty() {
            return;
        }
        self.n = 6 * stiffness.len();
        self.columns.clone_from(&self.forces);
        for column in self.columns.chunks_mut(n) {
            bone.system.solve(column, solve);
        }
        let m = self.n;
        let c = DMatrix::from_fn(m, m, |i, j| {
            dot(self.force(i), &self.columns[j * n..(j + 1) * n])
        });
        self.stiffness = DMatrix::zeros(m, m);
        for (t, s) in stiffness.iter().enumerate() {
            self.stiffness
                .fixed_view_mut::<6, 6>(6 * t, 6 * t)
                .copy_from(s);
        }
        let system = DMatrix::identity(m, m) + &self.stiffness * c;
        match system.lu().solve(&self.stiffness) {
            Some(correction) if correction.iter().all(|v| v.is_finite()) => {
                self.correction = correction;
            }
            _ => self.n = 0,
        }
    }

    /// Turns K^-1 F, in `x`, into the solution of the corrected sweep from `old`.
    pub fn apply(&self, x: &mut [f64], old: &[f64]) {
        if self.n == 0 {
            return;
        }
        let project = |v: &[f64]| DVector::from_fn(self.n, |k, _| dot(self.force(k), v));
        // x + Y S q, then minus Y (I + S C)^-1 S B^T (...), both along Y = K^-1 B.
        let pull = &self.stiffness * project(old);
        self.add(x, &pull);
        let back = &self.correction * project(x);
        self.add(x, &-back);
    }

    fn add(&self, x: &mut [f64], amount: &DVector<f64>) {
        let n = x.len();
        for (k, a) in amount.iter().enumerate() {
            let column = &self.columns[k * n..(k + 1) * n];
            x.iter_mut().zip(column).for_each(|(x, c)| *x += a * c);
        }
    }

    fn force(&self, k: usize) -> &[f64] {
        let n = self.forces.len() / self.n;
        &self.forces[k * n..(k + 1) * n]
    }
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

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
