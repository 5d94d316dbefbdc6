use super::bone_compliance::{Carried, Held, hold, shifted};
use super::{BoneCompliance, Coupling, Matrix12, Vector12, bounded_step};
use crate::contact::{
    Anchors, Contact, ContactLaw, ContactScene, NearPlaces, NearPoints, PairResponse, PointForce,
    Response, RigidShape, Vector6, Wrench, add_static, append_point_forces, penetrations, respond,
    respond_pair,
};
use crate::geometry::{DistanceGrid, Pose};
use std::sync::Arc;

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
    /// What stands still around the bone (upper jaw, skull): distance fields in world axes.
    pub surroundings: Vec<Arc<DistanceGrid>>,
}

/// Bounds of one solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveSettings {
    /// Contact queries after the first, at most.
    pub max_iterations: usize,
    /// Longest step of a tool in one iteration \[mm\]: translation and scaled rotation together.
    pub max_step: f64,
    /// Whether a solve that was cut short is gone on with: the next begins with steps of at most twice the length that this one had
    /// come to, instead of trying again what was refused.
    pub goes_on: bool,
    /// What turns an angle into a length \[mm\]: 1 rad counts as much as this.
    pub characteristic_length: f64,
    /// At rest if the force (and torque over the characteristic length) left over is below this share of the coupling's.
    pub tolerance: f64,
    /// ... or below this \[N\].
    pub force_floor: f64,
    /// From how many points near each tool on [`solve_tools_on_threads`] evaluates both at a time.
    pub points_for_two_threads: usize,
}

impl SolveSettings {
    /// For one haptic step: few iterations, a tenth of a newton in bone units (a five-hundredth at the device).
    pub const HAPTIC: Self = Self {
        max_iterations: 5,
        max_step: 1.0,
        goes_on: true,
        characteristic_length: 10.0,
        tolerance: 1e-3,
        force_floor: 0.05,
        points_for_two_threads: usize::MAX,
    };
    /// For the main loop: to convergence.
    pub const MAIN: Self = Self {
        max_iterations: 30,
        goes_on: false,
        tolerance: 2e-4,
        force_floor: 0.01,
        points_for_two_threads: 1024,
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
    /// How the bone gives way about the state that `scene` shows; without it the bone stands still.
    pub compliance: Option<&'a BoneCompliance>,
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
    /// Samples of each tool inside what stands still.
    pub n_static_contacts: [usize; 2],
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
        n_static_contacts: [0; 2],
        n_dropped: 0,
        contact_energy: 0.0,
    };
}

/// How large a scene the scratch can take without losing anything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScratchLimits {
    /// Points near one tool: inside it or within a quarter of a millimetre.
    pub n_contacts: usize,
}

impl Default for ScratchLimits {
    /// 16,384: a 60 mm chisel sunk into 100,000 points holds some thousand.
    fn default() -> Self {
        Self { n_contacts: 16_384 }
    }
}

/// The memory of [`solve_tools`] and its last contacts. Nothing allocates after construction.
#[derive(Clone, Debug)]
pub struct ToolScratch {
    near: [NearPlaces; 2],
    n_dropped: [usize; 2],
    now: [Evaluation; 2],
    trial: [Evaluation; 2],
    held: Held,
    pair: PairResponse,
    /// How long steps the last solve had come to \[mm\]; infinite if it came to rest.
    radius: [f64; 2],
    forces: Vec<PointForce>,
}

/// One tool at one pose relative to the bone.
#[derive(Clone, Debug)]
struct Evaluation {
    pose: Pose,
    contacts: Vec<Contact>,
    response: Response,
}

impl Evaluation {
    /// Puts tool `t` at `pose`. How many points found no room.
    fn put(
        &mut self,
        t: usize,
        pose: &Pose,
        model: &ToolModel,
        input: &ToolInput,
        own: &mut NearPlaces,
    ) -> usize {
        let (shape, scene) = (&model.tools[t].shape, &input.scene);
        self.pose = *pose;
        let found = scene.near.map(|near| &near[t]);
        let near = match found.filter(|near| near.holds(shape, pose)) {
            Some(near) => near,
            None => own.follow(shape, pose, scene, found),
        };
        penetrations(shape, pose, near, &mut self.contacts);
        self.response = respond(&mut self.contacts, &model.law, &input.anchors[t], pose);
        near.n_dropped()
    }
}

impl ToolScratch {
    /// Room for scenes within `limits`.
    pub fn new(limits: ScratchLimits) -> Self {
        let evaluation = || Evaluation {
            pose: Pose::identity(),
            contacts: Vec::with_capacity(limits.n_contacts),
            response: Response::NONE,
        };
        let near = || NearPlaces::with_capacity(limits.n_contacts);
        Self {
            near: [near(), near()],
            n_dropped: [0; 2],
            now: [evaluation(), evaluation()],
            trial: [evaluation(), evaluation()],
            held: Held::none(),
            pair: PairResponse::NONE,
            radius: [f64::INFINITY; 2],
            forces: Vec::with_capacity(2 * limits.n_contacts),
        }
    }

    /// The bone's points inside tool `t` at its last pose, by ascending cell.
    pub fn contacts(&self, t: usize) -> &[Contact] {
        &self.now[t].contacts
    }

    /// Looks for the points near the tools, for whoever sees the same scene next.
    pub fn look_about(&mut self, model: &ToolModel, tools: &ToolsState, scene: &ContactScene) {
        let tools = model.tools.iter().zip(&tools.poses);
        for (near, (tool, pose)) in self.near.iter_mut().zip(tools) {
            near.follow(&tool.shape, pose, scene, None);
        }
    }

    /// The points near the tools that were looked for last.
    pub fn near(&self) -> [&NearPoints; 2] {
        self.near.each_ref().map(NearPlaces::last)
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
/// [`ToolScratch::commit`] when the step is over. Neither allocates, waits nor panics; bounded in work. Hands no work to other
/// threads: there is no way from here to a lock, whatever the settings.
pub fn solve_tools(
    model: &ToolModel,
    settings: &SolveSettings,
    input: &ToolInput,
    state: &mut ToolsState,
    scratch: &mut ToolScratch,
) -> ToolsResult {
    solve::<false>(model, settings, input, state, scratch)
}

/// Likewise, where it may wait: rayon's threads evaluate both tools at a time. The result is the same to the last bit.
pub fn solve_tools_on_threads(
    model: &ToolModel,
    settings: &SolveSettings,
    input: &ToolInput,
    state: &mut ToolsState,
    scratch: &mut ToolScratch,
) -> ToolsResult {
    solve::<true>(model, settings, input, state, scratch)
}

fn solve<const ON_THREADS: bool>(
    model: &ToolModel,
    settings: &SolveSettings,
    input: &ToolInput,
    state: &mut ToolsState,
    scratch: &mut ToolScratch,
) -> ToolsResult {
    let mut solve = Solve::<ON_THREADS>::start(model, settings, input, state, scratch);
    let mut iterations = 0;
    let mut is_cut_short = true;
    while iterations < settings.max_iterations {
        if !solve.advance() {
            is_cut_short = false;
            break;
        }
        iterations += 1;
    }
    solve.scratch.radius = if is_cut_short {
        solve.radius
    } else {
        [f64::INFINITY; 2]
    };
    state.poses = solve.scratch.held.poses;
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
    Solve::<false>::start(model, settings, input, state, scratch).result(0)
}

struct Solve<'a, const ON_THREADS: bool> {
    model: &'a ToolModel,
    settings: &'a SolveSettings,
    input: &'a ToolInput<'a>,
    scratch: &'a mut ToolScratch,
    radius: [f64; 2],
    bone: Option<Carried>,
}

impl<'a, const ON_THREADS: bool> Solve<'a, ON_THREADS> {
    fn start(
        model: &'a ToolModel,
        settings: &'a SolveSettings,
        input: &'a ToolInput<'a>,
        state: &ToolsState,
        scratch: &'a mut ToolScratch,
    ) -> Self {
        let radius = if settings.goes_on {
            scratch.radius.map(|r| (2.0 * r).min(settings.max_step))
        } else {
            [settings.max_step; 2]
        };
        let mut solve = Self {
            model,
            settings,
            input,
            scratch,
            radius,
            bone: input.compliance.map(|c| c.carried_to(&state.poses)),
        };
        let (relative, motion) = match &mut solve.bone {
            Some(bone) => bone.relative(model, input.devices, &state.poses),
            None => (state.poses, Vector12::zeros()),
        };
        solve.scratch.held.motion = motion;
        solve.evaluate(relative.map(Some));
        std::mem::swap(&mut solve.scratch.now, &mut solve.scratch.trial);
        solve.scratch.held = solve.hold(&relative);
        solve.scratch.pair = solve.pair_at(&solve.scratch.held.poses);
        solve
    }

    /// One step of the trust region; false once there is nothing left to do.
    fn advance(&mut self) -> bool {
        let touching = self.bone.is_some() || self.scratch.pair.touches();
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
        let pose = |t: usize| shifted(&self.scratch.now[t].pose, &self.motion(&step, t));
        self.evaluate([0, 1].map(|t| (!idle[t]).then(|| pose(t))));
        self.decide(&step, &idle);
        true
    }

    /// Takes or refuses the trial: tool by tool, or both at once if they touch before or after, or share a bone that yields.
    fn decide(&mut self, step: &Vector12, idle: &[bool; 2]) {
        let pose = |t: usize| {
            let s = &self.scratch;
            if idle[t] {
                s.now[t].pose
            } else {
                s.trial[t].pose
            }
        };
        let held = self.hold(&[pose(0), pose(1)]);
        let pair = self.pair_at(&held.poses);
        let together = self.bone.is_some() || self.scratch.pair.touches() || pair.touches();
        let active = idle.map(|i| !i);
        let taken = if together {
            [self.judge(active, step, &held, Some(&pair)); 2]
        } else {
            [[true, false], [false, true]]
                .map(|only| self.judge([0, 1].map(|t| only[t] && active[t]), step, &held, None))
        };
        for t in 0..2 {
            if taken[t] && active[t] {
                let s = &mut *self.scratch;
                std::mem::swap(&mut s.now[t], &mut s.trial[t]);
            }
        }
        let mixed = active[0] && active[1] && taken[0] != taken[1];
        if mixed {
            let poses = [0, 1].map(|t| self.scratch.now[t].pose);
            self.scratch.held = self.hold(&poses);
            self.scratch.pair = self.pair_at(&self.scratch.held.poses);
        } else if (0..2).any(|t| active[t] && taken[t]) {
            self.scratch.held = held;
            self.scratch.pair = pair;
        }
    }

    /// Whether the trial of the `tools` together is better than where they are; adapts their radii.
    fn judge(
        &mut self,
        tools: [bool; 2],
        step: &Vector12,
        held: &Held,
        pair: Option<&PairResponse>,
    ) -> bool {
        let verdict = self.compare(tools, step, held, pair);
        for t in (0..2).filter(|&t| tools[t]) {
            let length = part(step, t).norm();
            self.radius[t] = match verdict {
                Verdict::Better => (4.0 * length).clamp(self.radius[t], self.settings.max_step),
                Verdict::Settled => self.radius[t],
                Verdict::Worse { shorten } => shorten * length,
            };
        }
        !matches!(verdict, Verdict::Worse { .. })
    }

    fn compare(
        &self,
        tools: [bool; 2],
        step: &Vector12,
        held: &Held,
        pair: Option<&PairResponse>,
    ) -> Verdict {
        let none = PairResponse::NONE;
        let [old_pair, new_pair] = [&self.scratch.pair, pair.unwrap_or(&none)];
        let mut p = *step;
        let (mut before, mut after) = (Vector12::zeros(), Vector12::zeros());
        let old_held = &self.scratch.held;
        let mut gain = old_pair.energy - new_pair.energy;
        gain += old_held.bone_energy - held.bone_energy;
        let mut noise = 1e-9;
        for t in (0..2).filter(|&t| !tools[t]) {
            p.fixed_rows_mut::<6>(6 * t).fill(0.0);
        }
        for t in (0..2).filter(|&t| tools[t]) {
            let (now, trial) = (&self.scratch.now[t], &self.scratch.trial[t]);
            let friction = now.response.friction + trial.response.friction;
            let work = 0.5 * friction.to_vector().dot(&self.motion(step, t));
            let energy = |held: &Held, e: &Evaluation| held.couplings[t].energy + e.response.energy;
            gain += energy(old_held, now) - energy(held, trial) + work;
            noise += DEPTH_ROUNDING * trial.response.total().force.norm();
            let put = |sum: &mut Vector12, held: &Held, e: &Evaluation, pair: &PairResponse| {
                let own = held.couplings[t].wrench + e.response.total();
                let wrench = self.scaled(&(own + pair.wrenches[t]));
                sum.fixed_rows_mut::<6>(6 * t).copy_from(&wrench);
            };
            put(&mut before, old_held, now, old_pair);
            put(&mut after, held, trial, new_pair);
        }
        let slope = before.dot(&p);
        let curvature = p.dot(&(self.stiffness() * p));
        let hoped = slope - 0.5 * curvature;
        if gain.is_finite() && gain >= 0.1 * hoped {
            Verdict::Better
        } else if gain >= -noise && after.norm_squared() < before.norm_squared() {
            Verdict::Settled
        } else {
            let surplus = [hoped - gain, slope - curvature - after.dot(&p)];
            Verdict::Worse {
                shorten: onset(slope, curvature, surplus),
            }
        }
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
            let own = self.scratch.held.couplings[t].wrench + self.scratch.now[t].response.total();
            let sum = own + self.scratch.pair.wrenches[t];
            f.fixed_rows_mut::<6>(6 * t).copy_from(&self.scaled(&sum));
        }
        f
    }

    /// Minus the derivative of [`forces`](Self::forces), symmetric.
    fn stiffness(&self) -> Matrix12 {
        let mut h = self.scratch.pair.stiffness;
        let held = &self.scratch.held.stiffness;
        h += 0.5 * (held + held.transpose());
        for t in 0..2 {
            let own = &self.scratch.now[t].response.stiffness;
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
        let pull = self.scaled(&self.scratch.held.couplings[t].wrench).norm();
        self.residual(t)
            <= self
                .settings
                .force_floor
                .max(self.settings.tolerance * pull)
    }

    /// Puts tools at poses for trial; the two have nothing to do with each other.
    fn evaluate(&mut self, poses: [Option<Pose>; 2]) {
        let (model, input) = (self.model, self.input);
        let ToolScratch {
            near,
            n_dropped,
            trial,
            ..
        } = &mut *self.scratch;
        let least = self.settings.points_for_two_threads;
        let is_much = ON_THREADS && near.iter().all(|near| near.last().len() >= least);
        let ([near_a, near_b], [trial_a, trial_b]) = (near, trial);
        let [dropped_a, dropped_b] = n_dropped;
        let [pose_a, pose_b] = poses;
        let mut first = || pose_a.map(|p| *dropped_a = trial_a.put(0, &p, model, input, near_a));
        let mut second = || pose_b.map(|p| *dropped_b = trial_b.put(1, &p, model, input, near_b));
        if is_much && poses.iter().all(Option::is_some) {
            rayon::join(first, second);
        } else {
            first();
            second();
        }
    }

    fn hold(&mut self, relative: &[Pose; 2]) -> Held {
        let (devices, guess) = (self.input.devices, &self.scratch.held.motion);
        hold(self.model, devices, relative, self.bone.as_mut(), guess)
    }

    fn pair_at(&self, poses: &[Pose; 2]) -> PairResponse {
        let [a, b] = &self.model.tools;
        let (shapes, law) = ([&a.shape, &b.shape], &self.model.law);
        let mut response = respond_pair(shapes, poses, law);
        add_static(&mut response, shapes, poses, &self.model.surroundings, law);
        response
    }

    fn result(&self, iterations: usize) -> ToolsResult {
        let s = &self.scratch;
        let each = |f: &dyn Fn(&Evaluation) -> f64| s.now.iter().map(f).sum::<f64>();
        ToolsResult {
            coupling: s.held.couplings.map(|c| c.wrench),
            contact: [0, 1].map(|t| s.now[t].response.total() + s.pair.wrenches[t]),
            saturation: (s.held.couplings).map(|c| [c.force_saturation, c.torque_saturation]),
            residual: [0, 1].map(|t| self.residual(t)),
            converged: (0..2).all(|t| self.at_rest(t)),
            iterations,
            n_contacts: [0, 1].map(|t| s.now[t].contacts.len()),
            n_pair_contacts: s.pair.n_contacts,
            n_static_contacts: s.pair.n_static,
            n_dropped: s.n_dropped.iter().sum(),
            contact_energy: each(&|e| e.response.energy) + s.pair.energy,
        }
    }
}

/// What the f32 depths of contacts are off by at the coordinates of a head \[mm\].
const DEPTH_ROUNDING: f64 = 1e-5;

/// How a trial compares with where the tools are.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    /// A fair share of the hoped-for energy was gained.
    Better,
    /// As good in energy, as far as rounding tells, and nearer to balance.
    Settled,
    /// Try this share of the step.
    Worse { shorten: f64 },
}

/// Which share of a step to try next, when its end was stiffer than where it began.
///
/// The usual reason is a contact that begins on the way. Along the step the model's energy is `-slope a + curvature a^2/2`; a
/// contact from `a_0` on adds `K (a - a_0)^2 / 2`, and both are known from what it added to energy and slope at `a = 1`
/// (`surplus`). The answer is the lowest point of the two together.
fn onset(slope: f64, curvature: f64, surplus: [f64; 2]) -> f64 {
    let [energy, steepness] = surplus;
    let stiffness = 0.5 * steepness * steepness / energy;
    let begin = (1.0 - 2.0 * energy / steepness).max(0.0);
    let lowest = (slope + stiffness * begin) / (curvature.max(0.0) + stiffness);
    if lowest.is_finite() {
        lowest.clamp(0.02, 0.7)
    } else {
        0.1
    }
}

fn part(v: &Vector12, t: usize) -> Vector6 {
    v.fixed_rows::<6>(6 * t).into()
}
