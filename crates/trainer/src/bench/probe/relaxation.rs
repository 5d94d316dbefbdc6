//! The main step, against one that starts from nothing.
use super::in_ms;
use crate::bench::rows::{Part, Row};
use crate::bench::times::{Pairs, Times};
use anyhow::{Result, ensure};
use osteotome_mechanics::bone::Supports;
use osteotome_mechanics::contact::{BoundingVolumes, ContactLaw};
use osteotome_mechanics::crack::System;
use osteotome_mechanics::geometry::Pose;
use osteotome_mechanics::step::main::{MainInput, MainSettings, MainState, main_step};
use osteotome_mechanics::step::{Bone, BoneState};
use osteotome_mechanics::tool::{ScratchLimits, ToolModel, ToolsState};
use std::sync::Arc;
use std::time::Instant;

/// The baseline is tried at every so many main steps.
const EVERY: u64 = 9;
/// Main steps that either start is given to come to rest.
const PATIENCE: usize = 40;
/// And further ones before the two are compared.
const SETTLING: usize = 6;

/// Main steps.
pub struct Relaxations {
    /// Without friction: where tools come to rest then does not depend on how they came.
    model: ToolModel,
    n_ids: usize,
    times: Times,
    cold: Pairs,
    n_steps: u64,
    n_compared: usize,
    /// Trials in which the two came to different rests: chisels in a slit have more than one.
    n_apart: usize,
}

impl Relaxations {
    /// With these tools and room for point ids below `n_ids`.
    ///
    /// # Errors
    /// A contact law that mechanics refuses.
    pub fn new(mut model: ToolModel, stiffness: f64, n_ids: usize) -> Result<Self> {
        model.law = ContactLaw::new(stiffness, 0.0)?;
        Ok(Self {
            model,
            n_ids,
            times: Times::default(),
            cold: Pairs::new("from a bone at rest and tools in the hands, to the same rest"),
            n_steps: 0,
            n_compared: 0,
            n_apart: 0,
        })
    }

    /// Whether the next step will be compared: it needs the state before.
    pub fn is_due(&self) -> bool {
        (self.n_steps + 1).is_multiple_of(EVERY) && self.cold.is_open()
    }

    /// A main step that took `ms`.
    pub fn stepped(&mut self, ms: f64) {
        self.times.push(ms);
        self.n_steps += 1;
    }

    /// Brings `bone` to rest from the state before a main step, and from nothing. Nothing is learnt where no tool touches, where no
    /// rest is found (a bone that hangs by its last ligaments is soft, and without drag nothing slows it), or where the two come to
    /// different rests: chisels in a slit have more than one.
    ///
    /// # Errors
    /// If they come to different rests more often than not.
    pub fn compare(&mut self, bone: &Bone, before: &BoneState, input: &MainInput) -> Result<()> {
        if bone.is_severed() {
            // Without drag next to nothing holds the loose piece.
            return Ok(());
        }
        let start = Instant::now();
        self.n_compared += 1;
        let bone = undamped(bone)?;
        let Some(settled) = self.rest(&bone, before.clone(), input) else {
            self.cold.leave_out(elapsed_ms(start));
            return Ok(());
        };
        if settled.contacts == 0 {
            return Ok(());
        }
        let in_hands = MainInput {
            tools: ToolsState {
                poses: moved(input).devices,
            },
            ..moved(input)
        };
        // Warm: what the last main step left, the hands having moved on a little.
        let warm = self.rest(&bone, settled.state, &moved(input));
        let cold = self.rest(&bone, bone.at_rest(), &in_hands);
        let spent = elapsed_ms(start);
        let (Some(warm), Some(cold)) = (warm, cold) else {
            self.cold.leave_out(spent);
            return Ok(());
        };
        let off = difference(&warm.state.x, &cold.state.x);
        let scale = warm.state.x.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let settings = MainSettings::default();
        let allowed = 4.0 * (settings.relative_tolerance * scale).max(settings.absolute_tolerance);
        if off > allowed {
            self.n_apart += 1;
            ensure!(
                self.n_apart <= 2 + self.n_compared / 2,
                "from nothing the bone comes to rest {off:.3} mm from where it does from the last state ({allowed:.3} mm allowed), in {} of {} trials",
                self.n_apart,
                self.n_compared
            );
            self.cold.leave_out(spent);
            return Ok(());
        }
        self.cold.push(warm.ms, cold.ms, spent);
        Ok(())
    }

    /// Main steps until the bone stands still. How long they took; and then, not timed, some more: the last change is within the
    /// tolerance, but the rest may be a few of them away. None if it does not come to stand still.
    fn rest(&self, bone: &Bone, from: BoneState, input: &MainInput) -> Option<Rest> {
        let mut state = MainState::new(bone, self.n_ids, ScratchLimits::default());
        state.volumes = BoundingVolumes::new(&bone.shell, &from.deformation);
        state.bone = from;
        let settings = MainSettings::default();
        let mut input = *input;
        let mut step = || {
            let (report, ms) =
                in_ms(|| main_step(bone, &self.model, &settings, &mut state, &input));
            input.tools = report.tools;
            (report, ms)
        };
        let mut ms = 0.0;
        let mut converges = || {
            let (report, took) = step();
            ms += took;
            report.converged
        };
        if !(0..PATIENCE).any(|_| converges()) {
            return None;
        }
        let last = (0..SETTLING).map(|_| step().0).last();
        Some(Rest {
            ms,
            contacts: last.map_or(0, |r| r.n_contacts),
            state: state.bone,
        })
    }

    /// The row.
    pub fn row(self) -> Row {
        Row::new(Part::MainStep, self.times).against(self.cold)
    }
}

struct Rest {
    ms: f64,
    contacts: usize,
    state: BoneState,
}

fn elapsed_ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// How far a hand comes in a main step \[mm\].
const MOVED: f64 = 0.05;

/// The hands a main step later.
fn moved(input: &MainInput) -> MainInput {
    let moved = |p: &Pose| {
        let mut p = *p;
        p.translation.vector += p.rotation * nalgebra::Vector3::z() * MOVED;
        p
    };
    MainInput {
        devices: input.devices.each_ref().map(moved),
        ..*input
    }
}

/// The same bone without the soft tissue's drag, which pulls towards where the bone was: then its rest is the same from anywhere.
fn undamped(bone: &Bone) -> Result<Bone> {
    let solid = &bone.body.solid;
    let supports = Supports {
        drag: 0.0,
        ..solid.supports.clone()
    };
    let system = System::new(&solid.mesh, &solid.materials, &bone.topology, &supports)?;
    let mut bone = bone.clone();
    bone.cracked.system = Arc::new(system);
    Ok(bone)
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    let pairs = a.iter().zip(b);
    pairs.fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()))
}
