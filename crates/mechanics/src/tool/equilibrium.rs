use super::{Coupling, CouplingResponse, Matrix12, Vector12, bounded_step};
use crate::contact::{
    Anchors, Candidates, Contact, ContactLaw, ContactScene, PairResponse, PointForce, Response,
    RigidShape, Vector6, Wrench, append_point_forces, penetrations, respond, respond_pair,
};
use crate::geometry::{Pose, Vec3};
use nalgebra::{Translation3, UnitQuaternion};

/// One tool; constant.
#[derive(Clone, Debug)]
pub struct Tool {
    /// Its blade, as contact sees it.
    pub shape: RigidShape,
    /// Its spring to the hand.
    pub coupling: Coupling,
}

/// Both tools and how they touch; constant.
#[derive(Clone, Debug)]
pub struct ToolModel {
    /// First and second hand.
    pub tools: [Tool; 2],
    /// Between steel and bone, and steel and steel.
    pub law: ContactLaw,
}

/// Bounds of one solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveSettings {
    /// Contact queries after the first, at most.
    pub max_iterations: usize,
    /// Longest step of a tool in one iteration \[mm\]: translation and scaled rotation together.
    pub max_step: f64,
    /// What turns an angle into a length \[mm\]: 1 rad counts as much as this.
    pub characteristic_length: f64,
    /// At rest if the force (and torque over the characteristic length) left over is below this share of the coupling's.
    pub tolerance: f64,
    /// ... or below this \[N\].
    pub force_floor: f64,
}

impl SolveSettings {
    /// For one haptic step: few iterations, a tenth of a newton in bone units (a five-hundredth at the device).
    pub const HAPTIC: Self = Self {
        max_iterations: 5,
        max_step: 1.0,
        characteristic_length: 10.0,
        tolerance: 1e-3,
        force_floor: 0.05,
    };
    /// For the main loop: to convergence.
    pub const MAIN: Self = Self {
        max_iterations: 30,
        tolerance: 2e-4,
        force_floor: 0.01,
        ..Self::HAPTIC
    };
}

/// Where the tools are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolsState {
    /// World from tool.
    pub poses: [Pose; 2],
}

/// What one solve or evaluation is about.
#[derive(Clone, Copy, Debug)]
pub struct ToolInput<'a> {
    /// The bone.
    pub scene: ContactScene<'a>,
    /// World from device, already mapped into the bone's space.
    pub devices: &'a [Pose; 2],
    /// Where the bone's points cling to each tool.
    pub anchors: &'a [Anchors; 2],
}

/// What came of it; per tool, in bone units.
#[derive(Clone, Copy, Debug)]
pub struct ToolsResult {
    /// Of the virtual coupling on the tool, about its origin, in world axes. The device feels the opposite.
    pub coupling: [Wrench; 2],
    /// Of bone and other tool on the tool.
    pub contact: [Wrench; 2],
    /// Share of the coupling's largest force and torque in use, 0 to 1.
    pub saturation: [[f64; 2]; 2],
    /// Length of force (and torque over the characteristic length) left over \[N\].
    pub residual: [f64; 2],
    /// Whether both tools are at rest within the tolerance.
    pub converged: bool,
    /// Queries after the first.
    pub iterations: usize,
    /// Bone points inside each tool.
    pub n_contacts: [usize; 2],
    /// Samples of one tool inside the other.
    pub n_pair_contacts: usize,
    /// Bone points that found no room: the limits of the scratch were too small.
    pub n_dropped: usize,
    /// Energy of all penalties \[N mm\].
    pub contact_energy: f64,
}

impl ToolsResult {
    /// Nothing was solved.
    pub const NONE: Self = Self {
        coupling: [Wrench::ZERO; 2],
        contact: [Wrench::ZERO; 2],
        saturation: [[0.0; 2]; 2],
        residual: [0.0; 2],
        converged: false,
        iterations: 0,
        n_contacts: [0; 2],
        n_pair_contacts: 0,
        n_dropped: 0,
        contact_energy: 0.0,
    };
}

/// How large a scene the scratch can take without losing anything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScratchLimits {
    /// Cells near one tool.
    pub n_cells: usize,
    /// Points inside one tool.
    pub n_contacts: usize,
}

impl Default for ScratchLimits {
    /// 16,384 of each: a 60 mm chisel sunk into 100,000 points holds some thousand.
    fn default() -> Self {
        Self {
            n_cells: 16_384,
            n_contacts: 16_384,
        }
    }
}

/// The memory of [`solve_tools`] and its last contacts. Nothing allocates after construction.
#[derive(Clone, Debug)]
pub struct ToolScratch {
    near: [Near; 2],
    now: [Evaluation; 2],
    trial: [Evaluation; 2],
    pair: PairResponse,
    forces: Vec<PointForce>,
}

/// Cells near a tool, and where it was when they were found.
#[derive(Clone, Debug)]
struct Near {
    candidates: Candidates,
    found_at: Pose,
}

/// One tool at one pose.
#[derive(Clone, Debug)]
struct Evaluation {
    pose: Pose,
    contacts: Vec<Contact>,
    n_dropped: usize,
    response: Response,
    coupling: CouplingResponse,
}

/// Cells are gathered this far around a tool \[mm\], and again when it has moved farther.
const GATHER_MARGIN: f64 = 1.0;

impl ToolScratch {
    /// Room for scenes within `limits`.
    pub fn new(limits: ScratchLimits) -> Self {
        let evaluation = || Evaluation {
            pose: Pose::identity(),
            contacts: Vec::with_capacity(limits.n_contacts),
            n_dropped: 0,
            response: Response::NONE,
            coupling: CouplingResponse::NONE,
        };
        let near = || Near {
            candidates: Candidates::with_capacity(limits.n_cells),
            found_at: Pose::identity(),
        };
        Self {
            near: [near(), near()],
            now: [evaluation(), evaluation()],
            trial: [evaluation(), evaluation()],
            pair: PairResponse::NONE,
            forces: Vec::with_capacity(2 * limits.n_contacts),
        }
    }

    /// The bone's points inside tool `t` at its last pose, by ascending cell.
    pub fn contacts(&self, t: usize) -> &[Contact] {
        &self.now[t].contacts
    }

    /// The forces of both tools on the bone at their last poses.
    pub fn point_forces(&mut self, model: &ToolModel, scene: &ContactScene) -> &[PointForce] {
        self.forces.clear();
        for e in &self.now {
            append_point_forces(&e.contacts, &model.law, scene, &e.pose, &mut self.forces);
        }
        &self.forces
    }

    /// Ends a step: the bone's points cling to the tools where the last response left them.
    pub fn commit(&self, anchors: &mut [Anchors; 2]) {
        for (anchors, e) in anchors.iter_mut().zip(&self.now) {
            anchors.commit(&e.contacts);
        }
    }
}

/// Brings both tools to rest between their hands and the bone: steps 4 to 6 of the paper's relaxation, repeated until the
/// forces balance or `settings` says enough.
///
/// Never lets the energy of couplings and penalties less the work of friction rise. Anchors are read, not moved: call
/// [`ToolScratch::commit`] when the step is over. Neither allocates, waits nor panics; bounded in work.
pub fn solve_tools(
    model: &ToolModel,
    settings: &SolveSettings,
    input: &ToolInput,
    state: &mut ToolsState,
    scratch: &mut ToolScratch,
) -> ToolsResult {
    let mut solve = Solve::start(model, settings, input, state, scratch);
    let mut iterations = 0;
    while iterations < settings.max_iterations && solve.advance() {
        iterations += 1;
    }
    state.poses = [0, 1].map(|t| solve.scratch.now[t].pose);
    solve.result(iterations)
}

/// The forces at given poses, for a bone that may have moved since; the tools stay.
pub fn evaluate_contacts(
    model: &ToolModel,
    settings: &SolveSettings,
    input: &ToolInput,
    state: &ToolsState,
    scratch: &mut ToolScratch,
) -> ToolsResult {
    Solve::start(model, settings, input, state, scratch).result(0)
}

struct Solve<'a> {
    model: &'a ToolModel,
    settings: &'a SolveSettings,
    input: &'a ToolInput<'a>,
    scratch: &'a mut ToolScratch,
    radius: [f64; 2],
}

impl<'a> Solve<'a> {
    fn start(
        model: &'a ToolModel,
        settings: &'a SolveSettings,
        input: &'a ToolInput<'a>,
        state: &ToolsState,
        scratch: &'a mut ToolScratch,
    ) -> Self {
        let mut solve = Self {
            model,
            settings,
            input,
            scratch,
            radius: [settings.max_step; 2],
        };
        for t in 0..2 {
            solve.gather(t, &state.poses[t]);
            solve.evaluate(t, &state.poses[t]);
        }
        std::mem::swap(&mut solve.scratch.now, &mut solve.scratch.trial);
        solve.scratch.pair = solve.pair_at(&state.poses);
        solve
    }

    /// One step of the trust region; false once there is nothing left to do.
    fn advance(&mut self) -> bool {
        let touching = self.scratch.pair.n_contacts > 0;
        let rest = [0, 1].map(|t| self.at_rest(t));
        let idle = if touching {
            [rest[0] && rest[1]; 2]
        } else {
            rest
        };
        if idle == [true; 2] || !self.forces().iter().all(|v| v.is_finite()) {
            return false;
        }
        let step = self.step(&idle);
        for t in 0..2 {
            let pose = moved(&self.scratch.now[t].pose, &self.motion(&step, t));
            if idle[t] {
                continue;
            }
            if self.has_left(t, &pose) {
                self.gather(t, &pose);
            }
            self.evaluate(t, &pose);
        }
        self.decide(&step, &idle);
        true
    }

    /// Takes or refuses the trial: tool by tool, or both at once if they touch before or after.
    fn decide(&mut self, step: &Vector12, idle: &[bool; 2]) {
        let pose = |t: usize| {
            let s = &self.scratch;
            if idle[t] {
                s.now[t].pose
            } else {
                s.trial[t].pose
            }
        };
        let pair = self.pair_at(&[pose(0), pose(1)]);
        let touching = self.scratch.pair.n_contacts + pair.n_contacts > 0;
        let active = idle.map(|i| !i);
        let taken = if touching {
            [self.judge(active, step, Some(&pair)); 2]
        } else {
            [[true, false], [false, true]]
                .map(|only| self.judge([0, 1].map(|t| only[t] && active[t]), step, None))
        };
        for t in 0..2 {
            if taken[t] && active[t] {
                let s = &mut *self.scratch;
                std::mem::swap(&mut s.now[t], &mut s.trial[t]);
            }
        }
        let mixed = active[0] && active[1] && taken[0] != taken[1];
        if mixed {
            self.scratch.pair = self.pair_at(&[0, 1].map(|t| self.scratch.now[t].pose));
        } else if (0..2).any(|t| active[t] && taken[t]) {
            self.scratch.pair = pair;
        }
    }

    /// Whether the trial of the `tools` together is better than where they are; adapts their radii.
    fn judge(&mut self, tools: [bool; 2], step: &Vector12, pair: Option<&PairResponse>) -> bool {
        let members = || (0..2).filter(|&t| tools[t]);
        let (mut gain, mut scale) = (0.0, 0.0);
        let none = PairResponse::NONE;
        let pair = [&self.scratch.pair, pair.unwrap_or(&none)];
        gain += pair[0].energy - pair[1].energy;
        let (mut before, mut after) = (0.0, 0.0);
        for t in members() {
            let (now, trial) = (&self.scratch.now[t], &self.scratch.trial[t]);
            let friction = now.response.friction.to_vector() + trial.response.friction.to_vector();
            let work = 0.5 * friction.dot(&self.motion(step, t));
            gain += now.energy() - trial.energy() + work;
            scale += now.energy();
            before += self
                .scaled(&(now.wrench() + pair[0].wrenches[t]))
                .norm_squared();
            after += self
                .scaled(&(trial.wrench() + pair[1].wrenches[t]))
                .norm_squared();
        }
        let hoped = self.predicted_gain(tools, step);
        let noise = ENERGY_NOISE * (1.0 + scale);
        let better = gain >= 1e-4 * hoped && gain.is_finite();
        let settled = gain >= -noise && after < before;
        for t in members() {
            let length = part(step, t).norm();
            if !(better || settled) {
                self.radius[t] = 0.3 * length;
            } else if gain > 0.5 * hoped && length > 0.9 * self.radius[t] {
                self.radius[t] = (2.0 * self.radius[t]).min(self.settings.max_step);
            }
        }
        better || settled
    }

    /// `f p - 1/2 p H p` of the tools' blocks.
    fn predicted_gain(&self, tools: [bool; 2], step: &Vector12) -> f64 {
        let mut p = *step;
        for t in (0..2).filter(|&t| !tools[t]) {
            p.fixed_rows_mut::<6>(6 * t).fill(0.0);
        }
        self.forces().dot(&p) - 0.5 * p.dot(&(self.stiffness() * p))
    }

    fn step(&self, idle: &[bool; 2]) -> Vector12 {
        let mut f = self.forces();
        for t in (0..2).filter(|&t| idle[t]) {
            f.fixed_rows_mut::<6>(6 * t).fill(0.0);
        }
        bounded_step(&self.stiffness(), &f, &self.radius)
    }

    /// What pulls at both tools, rotations scaled to lengths.
    fn forces(&self) -> Vector12 {
        let mut f = Vector12::zeros();
        for t in 0..2 {
            let sum = self.scratch.now[t].wrench() + self.scratch.pair.wrenches[t];
            f.fixed_rows_mut::<6>(6 * t).copy_from(&self.scaled(&sum));
        }
        f
    }

    /// Minus the derivative of [`forces`](Self::forces), symmetric.
    fn stiffness(&self) -> Matrix12 {
        let mut h = self.scratch.pair.stiffness;
        for t in 0..2 {
            let e = &self.scratch.now[t];
            let own = e.response.stiffness + e.coupling.stiffness;
            let mut block = h.fixed_view_mut::<6, 6>(6 * t, 6 * t);
            block += 0.5 * (own + own.transpose());
        }
        let scale = 1.0 / self.settings.characteristic_length;
        for i in 0..12 {
            if i % 6 >= 3 {
                h.column_mut(i).scale_mut(scale);
                h.row_mut(i).scale_mut(scale);
            }
        }
        h
    }

    fn scaled(&self, wrench: &Wrench) -> Vector6 {
        Wrench {
            force: wrench.force,
            torque: wrench.torque / self.settings.characteristic_length,
        }
        .to_vector()
    }

    /// Tool `t`'s part of a scaled step, as translation and rotation vector.
    fn motion(&self, step: &Vector12, t: usize) -> Vector6 {
        let mut motion = part(step, t);
        let mut turn = motion.fixed_rows_mut::<3>(3);
        turn /= self.settings.characteristic_length;
        motion
    }

    fn residual(&self, t: usize) -> f64 {
        part(&self.forces(), t).norm()
    }

    fn at_rest(&self, t: usize) -> bool {
        let pull = self.scaled(&self.scratch.now[t].coupling.wrench).norm();
        self.residual(t)
            <= self
                .settings
                .force_floor
                .max(self.settings.tolerance * pull)
    }

    fn gather(&mut self, t: usize, pose: &Pose) {
        let near = &mut self.scratch.near[t];
        let shape = &self.model.tools[t].shape;
        let volumes = self.input.scene.volumes;
        near.candidates.gather(shape, pose, GATHER_MARGIN, volumes);
        near.found_at = *pose;
    }

    fn has_left(&self, t: usize, pose: &Pose) -> bool {
        let bounds = &self.model.tools[t].shape.bounds;
        let reach = bounds.min.abs().sup(&bounds.max.abs()).norm();
        let found_at = &self.scratch.near[t].found_at;
        let way = (pose.translation.vector - found_at.translation.vector).norm();
        way + reach * pose.rotation.angle_to(&found_at.rotation) > GATHER_MARGIN
    }

    /// Puts tool `t` at `pose` for trial.
    fn evaluate(&mut self, t: usize, pose: &Pose) {
        let tool = &self.model.tools[t];
        let trial = &mut self.scratch.trial[t];
        trial.pose = *pose;
        trial.n_dropped = penetrations(
            &tool.shape,
            pose,
            &self.input.scene,
            &self.scratch.near[t].candidates,
            &mut trial.contacts,
        );
        let anchors = &self.input.anchors[t];
        trial.response = respond(&mut trial.contacts, &self.model.law, anchors, pose);
        trial.coupling = tool.coupling.respond(&self.input.devices[t], pose);
    }

    fn pair_at(&self, poses: &[Pose; 2]) -> PairResponse {
        let [a, b] = &self.model.tools;
        respond_pair([&a.shape, &b.shape], poses, &self.model.law)
    }

    fn result(&self, iterations: usize) -> ToolsResult {
        let s = &self.scratch;
        let each = |f: &dyn Fn(&Evaluation) -> f64| s.now.iter().map(f).sum::<f64>();
        ToolsResult {
            coupling: [0, 1].map(|t| s.now[t].coupling.wrench),
            contact: [0, 1].map(|t| s.now[t].response.total() + s.pair.wrenches[t]),
            saturation: [0, 1].map(|t| {
                let c = &s.now[t].coupling;
                [c.force_saturation, c.torque_saturation]
            }),
            residual: [0, 1].map(|t| self.residual(t)),
            converged: (0..2).all(|t| self.at_rest(t)),
            iterations,
            n_contacts: [0, 1].map(|t| s.now[t].contacts.len()),
            n_pair_contacts: s.pair.n_contacts,
            n_dropped: s.now.iter().map(|e| e.n_dropped).sum(),
            contact_energy: each(&|e| e.response.energy) + s.pair.energy,
        }
    }
}

/// Rounding of contact energies, whose depths are f32, relative to the energy.
const ENERGY_NOISE: f64 = 1e-6;

impl Evaluation {
    fn energy(&self) -> f64 {
        self.coupling.energy + self.response.energy
    }

    fn wrench(&self) -> Wrench {
        self.coupling.wrench + self.response.total()
    }
}

fn part(v: &Vector12, t: usize) -> Vector6 {
    v.fixed_rows::<6>(6 * t).into()
}

/// A pose after a small motion in world axes about its own origin.
fn moved(pose: &Pose, motion: &Vector6) -> Pose {
    let way: Vec3 = motion.fixed_rows::<3>(0).into();
    let turn: Vec3 = motion.fixed_rows::<3>(3).into();
    let mut rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    rotation.renormalize();
    Pose::from_parts(Translation3::from(pose.translation.vector + way), rotation)
}
