//! The main loop's step: the relaxation between bone and tools (paper, section 3.3, steps 1 to 7).
use super::bone::{Bone, BoneState};
use super::crack_faces::FaceContact;
use super::relaxation::Acceleration;
use super::yielding::{Patch, Yielding};
use crate::bone::{SolveScratch, Swept};
use crate::contact::{Anchors, BoundingVolumes, ContactScene, PointForce, Wrench};
use crate::crack::stress_intensity::CellForce;
use crate::geometry::{Pose, Vec3};
use crate::tool::{
    BoneCompliance, ScratchLimits, SolveSettings, ToolInput, ToolModel, ToolScratch, ToolsResult,
    ToolsState, solve_tools,
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
    yielding: Option<Yielding>,
    trial: Vec<f64>,
    /// Counts the states of the scene that contact has seen; from 1.
    scene_state: u64,
    /// The soft tissue's pull towards where the bone was at the start of the step, half solved.
    drag: Swept,
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
            yielding: None,
            trial: Vec::new(),
            scene_state: 1,
            drag: Swept::default(),
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
        (new.system).add_drag(&new.body.mesh, &new.topology, &self.bone.x, &mut next.x);
        new.add_loads(&next.loads, &mut next.x);
        new.system.solve(&mut next.x, &mut self.solve);
        new.limit_change(old, &self.bone, &mut next);
        new.deform(&mut next);
        next.strain_energy = self.bone.strain_energy;
        self.volumes.update(&new.shell, &next.deformation);
        self.scene_state += 1;
        self.bone = next;
    }

    /// What the tools see of the bone.
    pub fn scene<'a>(&'a self, bone: &'a Bone) -> ContactScene<'a> {
        ContactScene {
            shell: &bone.shell,
            volumes: &self.volumes,
            deformation: &self.bone.deformation,
            state: self.scene_state,
        }
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
    let mut pull = vec![0.0; bone.system.n()];
    let (mesh, topology) = (&bone.body.mesh, &bone.topology);
    (bone.system).add_drag(mesh, topology, &state.bone.x, &mut pull);
    (bone.system).sweep_up(&pull, &mut state.drag, &mut state.solve);
    let mut iterations = 0;
    loop {
        iterations += 1;
        // 4-6: query, both tools to rest against the bone as it stands.
        let result = rest_tools(bone, model, settings, state, input, &mut tools);
        // 1-2: the forces of those contacts, and the bone under them with the kept factor.
        let (trial, loads, are_apart) =
            solve_bone(bone, model, state, input, &tools, iterations == 1);
        // 7: convergence.
        let (residual, scale) = change(&state.bone.x, &trial);
        let tolerance = settings
            .absolute_tolerance
            .max(settings.relative_tolerance * scale);
        let converged = residual <= tolerance && are_apart;
        let last = converged || iterations >= settings.max_iterations;
        if converged {
            state.bone.x.copy_from_slice(&trial);
        } else {
            state.acceleration.next(&mut state.bone.x, &trial);
        }
        state.trial = trial;
        // 3: collision detection follows the bone.
        bone.deform(&mut state.bone);
        state.volumes.update(&bone.shell, &state.bone.deformation);
        state.scene_state += 1;
        if last {
            let n_closed = loads.len() - loads.partition_point(|l| l.1 == Source::Tool);
            state.bone.loads = loads.into_iter().map(|l| l.0).collect();
            state.bone.strain_energy = strain_energy(bone, &state.bone.x);
            state.bone.converged = converged;
            let yielding = state.yielding.as_ref();
            state.compliance = yielding.map(|y| y.bone_compliance(&tools, &result.coupling));
            state.tools.commit(&mut state.anchors);
            return MainReport {
                iterations,
                residual,
                converged,
                n_contacts: result.n_contacts.iter().sum(),
                n_closed: n_closed / 2,
                max_displacement: scale,
                strain_energy: state.bone.strain_energy,
                tools,
                wrenches: result.coupling.map(|w| -w),
            };
        }
    }
}

fn rest_tools(
    bone: &Bone,
    model: &ToolModel,
    settings: &MainSettings,
    state: &mut MainState,
    input: &MainInput,
    tools: &mut ToolsState,
) -> ToolsResult {
    let scene = ContactScene {
        shell: &bone.shell,
        volumes: &state.volumes,
        deformation: &state.bone.deformation,
        state: state.scene_state,
    };
    let input = ToolInput {
        scene,
        devices: &input.devices,
        anchors: &state.anchors,
        compliance: None,
    };
    solve_tools(model, &settings.tools, &input, tools, &mut state.tools)
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
) -> (Vec<f64>, Vec<(CellForce, Source)>, bool) {
    let forces = state.tools.point_forces(
        model,
        &ContactScene {
            shell: &bone.shell,
            volumes: &state.volumes,
            deformation: &state.bone.deformation,
            state: state.scene_state,
        },
    );
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
    swept.clone_from(&state.drag);
    let pushed = bone.sparse_loads(loads.iter().map(|l| &l.0));
    let pushed = bone.system.half_solve(&[pushed]);
    bone.system.add_half(&pushed, &[1.0], swept);
    if let Some(yielding) = &state.yielding {
        yielding.correct(bone, &state.bone.x, swept);
    }
    let mut x = std::mem::take(&mut state.trial);
    x.resize(bone.system.n(), 0.0);
    let (pressures, are_apart) = (state.faces).press(bone, swept, &mut x, &mut state.solve);
    loads.extend(pressures.into_iter().map(|p| (p, Source::Face)));
    (x, loads, are_apart)
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

/// Elastic energy without what the soft tissue's drag would hold \[N mm\].
fn strain_energy(bone: &Bone, x: &[f64]) -> f64 {
    let mut pull = vec![0.0; x.len()];
    (bone.system).add_drag(&bone.body.mesh, &bone.topology, x, &mut pull);
    let drag: f64 = pull.iter().zip(x).map(|(f, x)| 0.5 * f * x).sum();
    bone.system.energy(x) - drag
}

/// Largest change of an unknown, and the largest unknown \[mm\].
fn change(x: &[f64], trial: &[f64]) -> (f64, f64) {
    let largest =
        |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |m: f64, v| m.max(v.abs()));
    let change = largest(&mut x.iter().zip(trial).map(|(a, b)| a - b));
    (change, largest(&mut trial.iter().copied()))
}
