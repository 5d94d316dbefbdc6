//! How the bone under the tools gives way between two of its states, fast enough for every haptic step.
//!
//! The main loop knows the bone in one state, under the wrenches w_0 with which the tools pressed on it. Pressed otherwise, the
//! patch under each tool moves as a rigid body by xi = C (w - w_0), with the compliance C = B^T K^-1 B of both patches (12 x 12,
//! from half solves; see `step::yielding`). A tool at rest hands on what its coupling pulls with, so that the wrench on the patch
//! is the coupling's. Let r be a tool's pose relative to its patch: contact is a matter of r alone, and the coupling at the true
//! pose x = r + xi is a spring of stiffness K (I + C K)^-1: coupling and bone in series.
use super::{CouplingResponse, Matrix12, ToolModel, Vector12};
use crate::contact::{Vector6, Wrench};
use crate::geometry::{Pose, Vec3};
use nalgebra::{Matrix6, Translation3, UnitQuaternion};

/// The compliance of the bone under both tools about a known state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoneCompliance {
    /// Motion (translation above rotation, first tool's above the second's) by wrench on the bone \[mm/N\] and so on.
    pub matrix: Matrix12,
    /// What motions and wrenches are about, in world axes \[mm\].
    pub origins: [Vec3; 2],
    /// The tools' wrenches on the bone in the state itself.
    pub load: [Wrench; 2],
}

/// Under the wrenches with which a solve begins a patch is not carried farther than this \[mm\] from the bone's state, nor turned by more
/// than [`FARTHEST_TURN`]: beyond, as in a fragment just broken off, the bone counts as stiffer than it is. It stays a spring by that; a
/// motion cut off at the limit would have no energy, and no trial of a solve would seem to pay.
const FARTHEST: f64 = 2.0;
/// \[rad\]
const FARTHEST_TURN: f64 = 0.1;
/// Times that is tried, each for both patches.
const STIFFENINGS: usize = 4;
/// Steps of the chord method, at most; two are usual.
const ITERATIONS: usize = 6;
/// A patch that moves less than this in a step has arrived \[mm, rad\].
const CLOSE: f64 = 1e-6;

/// Both couplings as they act through the bone on tools at given poses relative to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Where the tools truly are.
    pub poses: [Pose; 2],
    /// How far the patches have moved from the state.
    pub motion: Vector12,
    pub couplings: [CouplingResponse; 2],
    /// What the bone has stored beyond its state \[N mm\].
    pub bone_energy: f64,
    /// Minus the derivative of the couplings' wrenches by the relative poses.
    pub stiffness: Matrix12,
}

impl Held {
    /// Nothing was evaluated.
    pub fn none() -> Self {
        Self {
            poses: [Pose::identity(); 2],
            motion: Vector12::zeros(),
            couplings: [CouplingResponse::NONE; 2],
            bone_energy: 0.0,
            stiffness: Matrix12::zeros(),
        }
    }
}

/// The compliance carried to the tools' own origins; constant within one solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    matrix: Matrix12,
    series: Option<Series>,
    /// w_0, about the tools' origins.
    load: Vector12,
    /// Motion under no wrench at all, negative: C w_0.
    from_load: Vector12,
    /// w_0 . C w_0.
    load_work: f64,
}

/// Coupling and bone in series, for couplings of one stiffness K. The one factorisation of a solve, unless a coupling comes into
/// its saturation on the way.
#[derive(Clone, Copy, Debug)]
struct Series {
    /// Diagonal of K.
    of: Vector12,
    /// (I + C K)^-1
    inverse: Matrix12,
}

/// A stiffness may differ by this share from the one that was inverted: the steps to balance get no less sure by it.
const SAME: f64 = 0.02;

impl Series {
    fn new(compliance: &Matrix12, k: &Matrix12) -> Option<Self> {
        let inverse = (Matrix12::identity() + compliance * k).try_inverse()?;
        Some(Self {
            of: k.diagonal(),
            inverse,
        })
    }

    fn serves(&self, k: &Matrix12) -> bool {
        let k = k.diagonal();
        let mut pairs = self.of.iter().zip(&k);
        pairs.all(|(a, b)| (a - b).abs() <= SAME * a.abs())
    }
}

impl BoneCompliance {
    /// Whether all of it is finite.
    pub fn is_finite(&self) -> bool {
        self.matrix.iter().all(|v| v.is_finite())
            && self.load.iter().all(Wrench::is_finite)
            && self.origins.iter().flatten().all(|v| v.is_finite())
    }

    pub(super) fn carried_to(&self, poses: &[Pose; 2]) -> Carried {
        let mut lever = Matrix12::identity();
        for (t, (pose, origin)) in poses.iter().zip(&self.origins).enumerate() {
            let arm = pose.translation.vector - origin;
            let mut block = lever.fixed_view_mut::<3, 3>(6 * t, 6 * t + 3);
            block.copy_from(&-arm.cross_matrix());
        }
        // Back with the inverse of the lever: the same with the arms the other way.
        let load = (2.0 * Matrix12::identity() - lever).transpose() * both(&self.load);
        Carried::new(lever * self.matrix * lever.transpose(), load)
    }
}

impl Carried {
    fn new(matrix: Matrix12, load: Vector12) -> Self {
        let from_load = matrix * load;
        Self {
            matrix,
            series: None,
            load,
            from_load,
            load_work: load.dot(&from_load),
        }
    }

    /// Makes the bone stiffer under each tool until these wrenches move no patch too far.
    fn stiffen(&mut self, wrenches: &Vector12) {
        for _ in 0..STIFFENINGS {
            let motion = self.motion(wrenches);
            let excess = |t: usize| {
                let length = |row: usize| motion.fixed_rows::<3>(6 * t + row).norm();
                (length(0) / FARTHEST).max(length(3) / FARTHEST_TURN)
            };
            let excess = [excess(0), excess(1)];
            if excess.iter().all(|e| *e <= 1.0) {
                return;
            }
            let share = Vector12::from_fn(|i, _| excess[i / 6].max(1.0).sqrt().recip());
            let share = Matrix12::from_diagonal(&share);
            *self = Self::new(share * self.matrix * share, self.load);
        }
    }

    /// Sees to it that the series is that of couplings of stiffness `k`, nearly enough.
    fn prepare(&mut self, k: &Matrix12) -> Option<&Series> {
        if !self.series.as_ref().is_some_and(|s| s.serves(k)) {
            self.series = Series::new(&self.matrix, k);
        }
        self.series.as_ref()
    }

    /// How far the patches have moved under these wrenches of the couplings.
    fn motion(&self, wrenches: &Vector12) -> Vector12 {
        self.matrix * wrenches - self.from_load
    }

    /// The relative poses of tools that are truly at `poses`, with the motion of the patches. A solve begins with this: see
    /// [`FARTHEST`].
    pub fn relative(
        &mut self,
        model: &ToolModel,
        devices: &[Pose; 2],
        poses: &[Pose; 2],
    ) -> ([Pose; 2], Vector12) {
        let couplings = [0, 1].map(|t| model.tools[t].coupling.respond(&devices[t], &poses[t]));
        let pull = wrenches(&couplings);
        self.stiffen(&pull);
        let motion = self.motion(&pull);
        let back = |t: usize| shifted(&poses[t], &-part(&motion, t));
        ([back(0), back(1)], motion)
    }
}

/// The couplings of tools at `relative` poses. Without `bone` these are their true poses. `guess`: a motion of the patches to start
/// from.
pub(super) fn hold(
    model: &ToolModel,
    devices: &[Pose; 2],
    relative: &[Pose; 2],
    bone: Option<&mut Carried>,
    guess: &Vector12,
) -> Held {
    let respond =
        |poses: &[Pose; 2]| [0, 1].map(|t| model.tools[t].coupling.respond(&devices[t], &poses[t]));
    let at = |motion: &Vector12| [0, 1].map(|t| shifted(&relative[t], &part(motion, t)));
    let Some(bone) = bone else {
        let couplings = respond(relative);
        return Held {
            poses: *relative,
            motion: Vector12::zeros(),
            stiffness: stiffness(&couplings),
            couplings,
            bone_energy: 0.0,
        };
    };
    let mut motion = *guess;
    let mut couplings = respond(&at(&motion));
    bone.prepare(&stiffness(&couplings));
    for _ in 0..ITERATIONS {
        let error = bone.motion(&wrenches(&couplings)) - motion;
        let Some(series) = &bone.series else {
            break;
        };
        let step = series.inverse * error;
        motion += step;
        couplings = respond(&at(&motion));
        if step.amax() < CLOSE {
            break;
        }
    }
    let k = stiffness(&couplings);
    let pull = wrenches(&couplings);
    Held {
        poses: at(&motion),
        motion,
        couplings,
        bone_energy: 0.5 * (motion.dot(&pull) + pull.dot(&bone.from_load) - bone.load_work),
        // K (I + C K)^-1, symmetric.
        stiffness: bone.prepare(&k).map_or(k, |series| k * series.inverse),
    }
}

fn stiffness(couplings: &[CouplingResponse; 2]) -> Matrix12 {
    let mut k = Matrix12::zeros();
    for (t, c) in couplings.iter().enumerate() {
        let own: Matrix6<f64> = 0.5 * (c.stiffness + c.stiffness.transpose());
        k.fixed_view_mut::<6, 6>(6 * t, 6 * t).copy_from(&own);
    }
    k
}

fn wrenches(couplings: &[CouplingResponse; 2]) -> Vector12 {
    both(&[couplings[0].wrench, couplings[1].wrench])
}

fn both(wrenches: &[Wrench; 2]) -> Vector12 {
    let mut v = Vector12::zeros();
    for (t, w) in wrenches.iter().enumerate() {
        v.fixed_rows_mut::<6>(6 * t).copy_from(&w.to_vector());
    }
    v
}

fn part(v: &Vector12, t: usize) -> Vector6 {
    v.fixed_rows::<6>(6 * t).into()
}

/// A pose after a motion in world axes about its own origin.
pub(super) fn shifted(pose: &Pose, motion: &Vector6) -> Pose {
    let way: Vec3 = motion.fixed_rows::<3>(0).into();
    let turn: Vec3 = motion.fixed_rows::<3>(3).into();
    let mut rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    rotation.renormalize();
    Pose::from_parts(Translation3::from(pose.translation.vector + way), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::ContactLaw;
    use crate::tool::{Chisel, ChiselParameters, Coupling, Tool};

    fn model() -> ToolModel {
        let tool = || Tool {
            shape: Chisel::new(ChiselParameters::default()).unwrap().shape(),
            coupling: Coupling::new(80.0, 2e4, 300.0, 9000.0).unwrap(),
        };
        ToolModel {
            tools: [tool(), tool()],
            law: ContactLaw::default(),
            surroundings: Vec::new(),
        }
    }

    /// Numbers in -1..1 without pattern.
    fn noise(i: usize) -> f64 {
        (i as f64 * 12.9898).sin()
    }

    fn compliance() -> BoneCompliance {
        let root = Matrix12::from_fn(|r, c| noise(1 + r + 12 * c));
        let scale = Vector12::from_fn(|i, _| if i % 6 < 3 { 0.02 } else { 1e-3 });
        let root = Matrix12::from_diagonal(&scale) * root;
        let wrench = |t: usize| Wrench {
            force: Vec3::new(8.0, -5.0, 3.0 + t as f64),
            torque: Vec3::new(-90.0, 40.0, 70.0),
        };
        BoneCompliance {
            matrix: root * root.transpose(),
            origins: [Vec3::new(1.0, 0.5, 0.0), Vec3::new(-11.0, 0.0, 1.0)],
            load: [wrench(0), wrench(1)],
        }
    }

    fn poses(seed: usize) -> [Pose; 2] {
        [0, 1].map(|t| {
            let k = 10 * seed + 100 * t;
            let at = Vec3::from_fn(|i, _| noise(k + i)) - Vec3::x() * (12.0 * t as f64);
            let turn = Vec3::from_fn(|i, _| 0.02 * noise(k + i + 3));
            Pose::from_parts(at.into(), UnitQuaternion::from_scaled_axis(turn))
        })
    }

    fn relative(step: &Vector12) -> [Pose; 2] {
        let start = poses(3);
        [0, 1].map(|t| shifted(&start[t], &part(step, t)))
    }

    #[test]
    fn series_of_coupling_and_bone_is_consistent() {
        check_series(compliance().carried_to(&poses(3)));
    }

    /// Of a fragment just broken off: under the hands' pull at the start it would fly away.
    #[test]
    fn a_bone_too_soft_to_be_carried_is_a_stiffer_spring() {
        let mut bone = compliance();
        bone.matrix *= 30.0;
        let mut carried = bone.carried_to(&poses(3));
        let (_, motion) = carried.relative(&model(), &poses(1), &poses(3));
        let length = |row: usize| motion.fixed_rows::<3>(row).norm();
        let reach = [0, 3, 6, 9].map(|row| length(row) / [FARTHEST, FARTHEST_TURN][row / 3 % 2]);
        let farthest = reach.into_iter().fold(0.0, f64::max);
        assert!(farthest > 0.5 && farthest < 1.2, "{reach:?} of the limits");
        check_series(carried);
    }

    /// The motion follows from the wrench, energy from neither: wrench = -dE/dr and stiffness = -d(wrench)/dr hold together only
    /// if the patches are in balance. Rotations do not commute, hence the tolerances.
    fn check_series(carried: Carried) {
        let (model, devices) = (model(), poses(1));
        let at = |step: &Vector12| {
            let (none, mut carried) = (Vector12::zeros(), carried);
            hold(&model, &devices, &relative(step), Some(&mut carried), &none)
        };
        let middle = at(&Vector12::zeros());
        let pull = wrenches(&middle.couplings);
        let balance = carried.motion(&pull) - middle.motion;
        assert!(balance.amax() < 1e-6, "patches off balance by {balance}");
        let energy = |h: &Held| h.bone_energy + h.couplings.iter().map(|c| c.energy).sum::<f64>();
        for i in 0..12 {
            let h = if i % 6 < 3 { 1e-4 } else { 1e-5 };
            let mut step = Vector12::zeros();
            step[i] = h;
            let [ahead, behind] = [at(&step), at(&-step)];
            let slope = (energy(&ahead) - energy(&behind)) / (2.0 * h);
            let scale = if i % 6 < 3 { 100.0 } else { 1000.0 };
            assert!(
                (slope + pull[i]).abs() < 0.025 * scale,
                "axis {i}: {slope} against {}",
                -pull[i]
            );
            let bent = (wrenches(&behind.couplings) - wrenches(&ahead.couplings)) / (2.0 * h);
            let own = middle.stiffness.column(i);
            assert!(
                (bent - own).norm() < 0.03 * own.norm(),
                "axis {i}: {bent} against {own}"
            );
        }
    }

    #[test]
    fn relative_poses_lead_back_to_the_true_ones() {
        let (model, bone, devices) = (model(), compliance(), poses(1));
        let mut carried = bone.carried_to(&poses(3));
        let (relative, motion) = carried.relative(&model, &devices, &poses(2));
        let held = hold(&model, &devices, &relative, Some(&mut carried), &motion);
        for (a, b) in held.poses.iter().zip(poses(2)) {
            assert!((a.translation.vector - b.translation.vector).norm() < 1e-6);
            assert!(a.rotation.angle_to(&b.rotation) < 1e-7);
        }
    }
}
