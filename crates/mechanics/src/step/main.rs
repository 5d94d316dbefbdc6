//! The main loop's step: the relaxation between bone and tools (paper, section 3.3, steps 1 to 7).
use super::bone::{Bone, BoneState};
use super::crack_faces::FaceContact;
use super::relaxation::Acceleration;
use super::sweep_region::SweepRegion;
use super::yielding::{Patch, Yielding};
use crate::bone::{SolveScratch, Swept};
use crate::contact::{Anchors, BoundingVolumes, ContactScene, NearPoints, PointForce, Wrench};
use crate::crack::stress_intensity::CellForce;
use crate::geometry::{Pose, Vec3};
use crate::tool::{
    BoneCompliance, ScratchLimits, SolveSettings, ToolInput, ToolModel, ToolScratch, ToolsResult,
    ToolsState, solve_tools_on_threads,
};

/// Bounds of the relaxation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MainSettings {
    /// Sweeps, at most.
    pub max_iterations: usize,
    /// Converged when no unknown changes by more than this share of the largest ...
    pub relative_tolerance: f64,
    /// ... or by more than this \[mm\].
    pub absolute_tolerance: f64,
    /// Bounds of the tools' part.
    pub tools: SolveSettings,
}

impl Default for MainSettings {
    /// One per cent of the deformation, or 0.01 mm. Chosen, not derived: through the shipped linear coupling of 80 N/mm it is
    /// 0.8 N at the bone, but through the angular one (50 N m/rad at a 4 mm arm) up to 0.13 N m. How many sweeps suffice
    /// depends on it, so quote it beside any count.
    fn default() -> Self {
        Self {
            max_iterations: 12,
            relative_tolerance: 1e-2,
            absolute_tolerance: 1e-2,
            tools: SolveSettings::MAIN,
        }
    }
}

/// What a main step is given.
#[derive(Clone, Copy, Debug)]
pub struct MainInput {
    /// World from device, already in the bone's space.
    pub devices: [Pose; 2],
    /// The haptic loop's tools, to start from.
    pub tools: ToolsState,
}

/// What came of a main step.
#[derive(Clone, Copy, Debug)]
pub struct MainReport {
    /// Sweeps made.
    pub iterations: usize,
    /// Last change of any unknown \[mm\].
    pub residual: f64,
    /// Whether the last change was within the tolerance.
    pub converged: bool,
    /// Bone points inside the tools.
    pub n_contacts: usize,
    /// Pairs of crack faces that press on each other.
    pub n_closed: usize,
    /// Largest displacement of a node \[mm\].
    pub max_displacement: f64,
    /// Elastic energy \[N mm\].
    pub strain_energy: f64,
    /// The tools at rest.
    pub tools: ToolsState,
    /// What pulls at each hand \[N, N mm\], bone units.
    pub wrenches: [Wrench; 2],
}

/// A bone that moved less than this in a step \[mm\] is not expected to go on: the tolerance is wider ...
const LEAST_WAY: f64 = 2e-3;
/// ... nor one that moved farther, which has broken or leapt \[mm\].
const MOST_WAY: f64 = 0.3;

/// What is computed from main step to main step.
#[derive(Debug)]
pub struct MainState {
    /// The bone.
    pub bone: BoneState,
    /// Its bounding volumes in that state.
    pub volumes: BoundingVolumes,
    /// How it gives way about that state where tools press on it; none if none does.
    pub compliance: Option<BoneCompliance>,
    anchors: [Anchors; 2],
    tools: ToolScratch,
    faces: FaceContact,
    solve: SolveScratch,
    acceleration: Acceleration,
    region: SweepRegion,
    yielding: Option<Yielding>,
    trial: Vec<f64>,
    /// Counts the states of the scene that contact has seen; from 1.
    scene_state: u64,
    /// What the bone as it stands pulls with at its loads: -K x, soft tissue's drag left out.
    pull: Vec<f64>,
    /// The unknowns at the start of the step; all else is solved for as the way from there, so that sweeps may be in single precision.
    before: Vec<f64>,
    /// The pull at the start of the step, half solved.
    pulled: Swept,
    /// What the last step's way is made of, half solved: what `trial` is until the next one begins.
    half_solved: Vec<f64>,
    swept: Swept,
}

impl MainState {
    /// A bone at rest; room for point ids below `n_ids` (allow for what the crack will add).
    pub fn new(bone: &Bone, n_ids: usize, limits: ScratchLimits) -> Self {
        let state = bone.at_rest();
        Self {
            volumes: BoundingVolumes::new(&bone.shell, &state.deformation),
            compliance: None,
            anchors: [Anchors::with_capacity(n_ids), Anchors::with_capacity(n_ids)],
            tools: ToolScratch::new(limits),
            faces: FaceContact::default(),
            solve: bone.system.scratch(),
            acceleration: Acceleration::default(),
            region: SweepRegion::default(),
            yielding: None,
            trial: Vec::new(),
            scene_state: 1,
            pull: bone.system.pull(&bone.body.mesh, &bone.topology, &state.x),
            before: Vec::new(),
            pulled: Swept::default(),
            half_solved: Vec::new(),
            swept: Swept::default(),
            bone: state,
        }
    }

    /// Takes over the next generation: the same loads on the grown bone, moved there by no more than a fraction of a
    /// millimetre at once, as a start for the relaxation.
    pub fn adopt(&mut self, old: &Bone, new: &Bone) {
        self.solve = new.system.scratch();
        let mut next = new.at_rest();
        next.loads = new.carry_loads(old, &self.bone.loads);
        next.loads.retain(|l| !new.is_debris(l.cell));
        (new.system).add_drag(&new.body.mesh, &new.topology, &self.bone.x, &mut next.x);
        new.add_loads(&next.loads, &mut next.x);
        new.system.solve(&mut next.x, &mut self.solve);
        new.limit_change(old, &self.bone, &mut next);
        new.deform(&mut next);
        next.strain_energy = self.bone.strain_energy;
        self.volumes.update(&new.shell, &next.deformation);
        self.scene_state += 1;
        self.pull = (new.system).pull(&new.body.mesh, &new.topology, &next.x);
        self.trial.clear();
        self.bone = next;
    }

    /// What the tools see of the bone.
    pub fn scene<'a>(&'a self, bone: &'a Bone) -> ContactScene<'a> {
        scene(bone, &self.bone, &self.volumes, self.scene_state)
    }

    /// The points near the tools where the last step left them.
    pub fn near(&self) -> [&NearPoints; 2] {
        self.tools.near()
    }
}

/// What the tools see of the bone: parts of a [`MainState`].
fn scene<'a>(
    bone: &'a Bone,
    state: &'a BoneState,
    volumes: &'a BoundingVolumes,
    number: u64,
) -> ContactScene<'a> {
    ContactScene {
        shell: &bone.shell,
        volumes,
        deformation: &state.deformation,
        state: number,
        near: None,
    }
}

/// Brings bone and tools to rest together. `state` must belong to `bone`.
pub fn main_step(
    bone: &Bone,
    model: &ToolModel,
    settings: &MainSettings,
    state: &mut MainState,
    input: &MainInput,
) -> MainReport {
    let mut tools = input.tools;
    // What sweeps taught while the contacts were others misleads the next ones.
    state.acceleration.forget();
    (state.region).follow(bone, &state.volumes, model, &tools);
    let mut guess = state.start(bone);
    let mut iterations = 0;
    loop {
        iterations += 1;
        // 4-6: query, both tools to rest against the bone as it stands.
        let result = rest_tools(bone, model, settings, state, input, &mut tools);
        // 1-2: the forces of those contacts, and the bone under them with the kept factor.
        let (trial, loads, are_apart) =
            solve_bone(bone, model, state, input, &tools, iterations == 1);
        // 7: convergence.
        let (residual, scale) = guess.change(&trial);
        let tolerance = settings
            .absolute_tolerance
            .max(settings.relative_tolerance * scale);
        let converged = residual <= tolerance && are_apart;
        let last = converged || iterations >= settings.max_iterations;
        if !converged {
            guess.improve(&mut state.acceleration, &trial);
        }
        // 3: collision detection follows the bone.
        if !last {
            state.show(bone, &guess);
            continue;
        }
        if converged {
            state.arrive(bone);
        } else {
            state.halt(bone, &guess);
        }
        let n_closed = loads.len() - loads.partition_point(|l| l.1 == Source::Tool);
        state.bone.loads = loads.into_iter().map(|l| l.0).collect();
        state.bone.strain_energy = state.strain_energy();
        state.bone.converged = converged;
        let yielding = state.yielding.as_ref();
        state.compliance = yielding.map(|y| y.bone_compliance(&tools, &result.coupling));
        state.tools.commit(&mut state.anchors);
        let scene = scene(bone, &state.bone, &state.volumes, state.scene_state);
        state.tools.look_about(model, &tools, &scene);
        return MainReport {
            iterations,
            residual,
            converged,
            n_contacts: result.n_contacts.iter().sum(),
            n_closed: n_closed / 2,
            max_displacement: largest(state.bone.x.iter().copied()),
            strain_energy: state.bone.strain_energy,
            tools,
            wrenches: result.coupling.map(|w| -w),
        };
    }
}

/// The bone in the course of a step: its unknowns in the region of the sweeps, and what the others will be made of.
struct Guess {
    /// The region's unknowns, then what is half solved of all on the way there.
    values: Vec<f64>,
    n_near: usize,
}

impl Guess {
    fn near(&self) -> &[f64] {
        &self.values[..self.n_near]
    }

    fn half_solved(&self) -> &[f64] {
        &self.values[self.n_near..]
    }

    /// Largest change of an unknown on the way to `trial`, and its largest unknown \[mm\].
    fn change(&self, trial: &Self) -> (f64, f64) {
        let pairs = self.near().iter().zip(trial.near());
        let change = largest(pairs.map(|(a, b)| a - b));
        (change, largest(trial.near().iter().copied()))
    }

    fn improve(&mut self, acceleration: &mut Acceleration, trial: &Self) {
        acceleration.next(&mut self.values, &trial.values, self.n_near);
    }
}

impl MainState {
    /// Begins a step: the bone where it would come if it went on as in the last one.
    fn start(&mut self, bone: &Bone) -> Guess {
        self.before.clone_from(&self.bone.x);
        (bone.system).sweep_up(&self.pull, &mut self.pulled, &mut self.solve);
        self.faces.start(bone, &self.before);
        let n = self.before.len();
        let farthest = largest(self.trial.iter().copied());
        let goes_on = self.bone.converged && (LEAST_WAY..MOST_WAY).contains(&farthest);
        if self.trial.len() != n || !goes_on {
            self.trial.clear();
            self.trial.resize(n, 0.0);
            return self.guess(&vec![0.0; n]);
        }
        let guess = self.guess(&self.half_solved);
        self.show(bone, &guess);
        guess
    }

    /// The guess that `trial` and its half-solved loads make from the start of the step.
    fn guess(&self, half_solved: &[f64]) -> Guess {
        let unknowns = self.region.region.unknowns().iter();
        let near = unknowns.map(|i| self.before[*i as usize] + self.trial[*i as usize]);
        let mut values: Vec<f64> = near.collect();
        let n_near = values.len();
        values.extend_from_slice(half_solved);
        Guess { values, n_near }
    }

    /// Shows the tools a guess of the bone, as far as they may touch it.
    fn show(&mut self, bone: &Bone, guess: &Guess) {
        (self.region).deform(bone, guess.near(), &mut self.bone, &mut self.volumes);
        self.scene_state += 1;
    }

    /// Moves all of the bone to where the last sweep has brought its region.
    fn arrive(&mut self, bone: &Bone) {
        let region = &self.region.region;
        self.half_solved.clear();
        self.half_solved.extend_from_slice(self.swept.values());
        (bone.system).sweep_down_rest(region, &mut self.swept, &mut self.trial, &mut self.solve);
        self.settle(bone);
    }

    /// Moves all of the bone to a guess that is no result of a sweep.
    fn halt(&mut self, bone: &Bone, guess: &Guess) {
        self.swept.set(guess.half_solved());
        self.half_solved.clear();
        (bone.system).sweep_down(&mut self.swept, &mut self.trial, &mut self.solve);
        self.settle(bone);
    }

    /// Moves the bone by `trial` from the start of the step.
    fn settle(&mut self, bone: &Bone) {
        let moved = self.before.iter().zip(&self.trial).map(|(b, t)| b + t);
        self.bone.x.clear();
        self.bone.x.extend(moved);
        self.pull = (bone.system).pull(&bone.body.mesh, &bone.topology, &self.bone.x);
        bone.deform(&mut self.bone);
        (self.volumes).update(&bone.shell, &self.bone.deformation);
        self.scene_state += 1;
    }

    /// Elastic energy, without what the soft tissue's drag would hold \[N mm\].
    fn strain_energy(&self) -> f64 {
        let work = self.pull.iter().zip(&self.bone.x).map(|(f, x)| f * x);
        -0.5 * work.sum::<f64>()
    }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |m, v| m.max(v.abs()))
}

fn rest_tools(
    bone: &Bone,
    model: &ToolModel,
    settings: &MainSettings,
    state: &mut MainState,
    input: &MainInput,
    tools: &mut ToolsState,
) -> ToolsResult {
    let scene = scene(bone, &state.bone, &state.volumes, state.scene_state);
    let input = ToolInput {
        scene,
        devices: &input.devices,
        anchors: &state.anchors,
        compliance: None,
    };
    solve_tools_on_threads(model, &settings.tools, &input, tools, &mut state.tools)
}

/// Where a load on the bone comes from.
#[derive(Clone, Copy, PartialEq)]
enum Source {
    Tool,
    Face,
}

/// The bone under the tools' present forces, its faces kept apart; whether they are.
fn solve_bone(
    bone: &Bone,
    model: &ToolModel,
    state: &mut MainState,
    input: &MainInput,
    tools: &ToolsState,
    is_first: bool,
) -> (Guess, Vec<(CellForce, Source)>, bool) {
    let scene = scene(bone, &state.bone, &state.volumes, state.scene_state);
    let forces = state.tools.point_forces(model, &scene);
    let load = |f: &PointForce| CellForce {
        cell: f.cell,
        weights: f.weights.map(f64::from),
        force: f.force,
    };
    let mut loads: Vec<_> = forces.iter().map(|f| (load(f), Source::Tool)).collect();
    if is_first {
        let points: Vec<_> = forces.iter().map(|f| (f.point, load(f))).collect();
        let patches = patches(model, input, tools, points, state.tools.contacts(0).len());
        state.yielding = Yielding::new(bone, &patches);
    }
    let swept = &mut state.swept;
    swept.clone_from(&state.pulled);
    let pushed = bone.sparse_loads(loads.iter().map(|l| &l.0));
    (bone.system).add_load(&pushed, swept, &mut state.solve);
    if let Some(yielding) = &state.yielding {
        yielding.correct(bone, &state.before, &state.bone.x, swept);
    }
    let MainState {
        region,
        trial,
        solve,
        faces,
        ..
    } = state;
    let (pressures, are_apart) = faces.press(bone, &region.region, swept, trial, solve);
    loads.extend(pressures.into_iter().map(|p| (p, Source::Face)));
    let trial = state.guess(state.swept.values());
    (trial, loads, are_apart)
}

/// The contacts of each tool (the first tool's come first) with its coupling's stiffness.
fn patches(
    model: &ToolModel,
    input: &MainInput,
    tools: &ToolsState,
    mut points: Vec<(Vec3, CellForce)>,
    n_first: usize,
) -> [Patch; 2] {
    let second = points.split_off(n_first.min(points.len()));
    let patch = |t: usize, contacts| Patch {
        contacts,
        tool: tools.poses[t],
        stiffness: model.tools[t]
            .coupling
            .respond(&input.devices[t], &tools.poses[t])
            .stiffness,
    };
    [patch(0, points), patch(1, second)]
}
