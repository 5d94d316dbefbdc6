//! Recorded hands played in lockstep, everything of Table 1 timed on the way.
//!
//! The order of steps is that of [`lockstep`](crate::loops::lockstep), so that the simulation is the same to the last bit; what is
//! timed beside it works on copies.
use super::export::{self, Touch};
use super::probe::{Contacts, Growths, Hands, Relaxations, Views};
use super::rows::Row;
use crate::engine::{self, Engine, Prepared, haptic_model, n_ids};
use crate::input::Input;
use crate::loops::{HandOutput, HapticPart, MainPart, Propagated, PropagationPart, timed};
use crate::scenario::Scenario;
use crate::session::{GrowthSample, HandSample};
use anyhow::Result;
use osteotome_devices::Reading;
use osteotome_mechanics::step::Bone;
use osteotome_mechanics::step::main::MainInput;
use osteotome_mechanics::tool::{ToolModel, ToolsState};

/// What a replay gives.
pub struct Replayed {
    /// In the order of the table.
    pub rows: Vec<Row>,
    /// The crack as it ended.
    pub crack: Option<GrowthSample>,
    /// Simulated time \[s\].
    pub seconds: f64,
    /// Where pictures were drawn.
    pub drawn_on: String,
    /// The bone as it ended.
    pub bone: Bone,
    /// Where the tools touched it, now and then.
    pub touches: Vec<Touch>,
}

/// Plays `input` and times everything. `progress` is told the simulated time \[s\].
///
/// # Errors
/// A scenario that mechanics refuses, or a baseline whose result is not ours.
pub fn replay(
    prepared: &Prepared,
    scenario: &Scenario,
    input: Input,
    progress: &mut dyn FnMut(f64),
) -> Result<Replayed> {
    let mut player = Player::new(prepared, scenario, input)?;
    let max_steps = (scenario.max_time * scenario.loops.haptic_hz).ceil() as u64;
    let per_main = u64::from(scenario.loops.haptic_per_main());
    let mut step = 0;
    while step < max_steps && !player.input.is_finished() {
        player.haptic()?;
        step += 1;
        if step % per_main == 0 {
            player.main()?;
            player.propagation()?;
            progress(step as f64 * scenario.loops.dt());
        }
    }
    let seconds = step as f64 * scenario.loops.dt();
    Ok(Replayed {
        crack: player.views.crack().cloned(),
        seconds,
        drawn_on: player.views.place(),
        bone: player.engine.main.bone().clone(),
        touches: std::mem::take(&mut player.touches),
        rows: player.rows(),
    })
}

struct Player<'a> {
    scenario: &'a Scenario,
    tools: ToolModel,
    input: Input,
    engine: Engine,
    last: [HandSample; 2],
    hands: Hands,
    contacts: Contacts,
    relaxations: Relaxations,
    growths: Growths,
    views: Views<'a>,
    /// A growth that took so long \[ms\] has not yet been taken over by the main loop.
    grown: Option<f64>,
    touches: Vec<Touch>,
    n_steps: u64,
}

impl<'a> Player<'a> {
    fn new(prepared: &'a Prepared, scenario: &'a Scenario, mut input: Input) -> Result<Self> {
        let first = input.read();
        input.rewind();
        let start = first.map(|r| r.pose);
        let engine = engine::connect(prepared, scenario, start)?;
        let n_ids = n_ids(&prepared.bone);
        let tools = engine::tools_among(prepared, scenario)?;
        let model = haptic_model(scenario, tools.clone())?;
        let sawn = engine.propagation.crack();
        let stiffness = scenario.contact.stiffness;
        Ok(Self {
            hands: Hands::new(model, start, n_ids),
            contacts: Contacts::default(),
            relaxations: Relaxations::new(tools.clone(), stiffness, n_ids)?,
            growths: Growths::default(),
            views: Views::new(prepared, scenario, sawn)?,
            last: first.map(|r| at_rest(&r)),
            grown: None,
            touches: Vec::new(),
            n_steps: 0,
            scenario,
            tools,
            input,
            engine,
        })
    }

    fn haptic(&mut self) -> Result<()> {
        let readings = self.input.read();
        let devices = readings.map(|r| r.pose);
        let dt = self.scenario.loops.dt();
        let engine = &mut self.engine;
        let (output, us) = timed(|| engine.haptic.step(&devices, dt));
        let bone = engine.main.whole_state();
        let scene = bone.scene(engine.main.bone());
        let compliance = bone.compliance.as_ref();
        (self.hands).step((&output, 1e-3 * us), scene, compliance, &devices, dt)?;
        let poses = output.map(|o| o.tool_pose);
        let query_ms = self.contacts.query(&self.tools, &poses, &scene)?;
        self.last = [0, 1].map(|i| sample(&readings[i], &output[i]));
        self.n_steps += 1;
        if self.n_steps.is_multiple_of(export::EVERY) {
            self.touches.push(Touch::new(&self.last, query_ms));
        }
        Ok(())
    }

    fn main(&mut self) -> Result<()> {
        let main = &mut self.engine.main;
        let before = self.relaxations.is_due().then(|| main.state().clone());
        let old = self.grown.map(|ms| (ms, main.bone().clone()));
        let (_, us) = timed(|| main.step());
        self.relaxations.stepped(1e-3 * us);
        let main = &self.engine.main;
        let (bone, state) = (main.bone(), main.state());
        if let Some((ms, old)) = old {
            self.growths.grew(ms, &old, bone)?;
            self.grown = None;
        }
        self.contacts.update(bone, state)?;
        if let Some(before) = before.filter(|b| b.generation == bone.generation) {
            let input = MainInput {
                devices: self.last.each_ref().map(|h| h.device_pose),
                tools: ToolsState {
                    poses: self.last.each_ref().map(|h| h.tool_pose),
                },
            };
            self.relaxations.compare(bone, &before, &input)?;
        }
        let [left, right] = &self.last;
        self.views.stepped(|| MainPart::bone(main), [left, right])
    }

    fn propagation(&mut self) -> Result<()> {
        let propagation = &mut self.engine.propagation;
        let looks = propagation.n_looks();
        let (propagated, us) = timed(|| propagation.step());
        match propagated {
            Propagated::Grown(growth) => {
                self.views.grew(*growth);
                self.grown = Some(1e-3 * us);
            }
            Propagated::Checked if propagation.n_looks() > looks => {
                self.growths.looked(1e-3 * us);
            }
            Propagated::Checked | Propagated::Idle => {}
        }
        Ok(())
    }

    fn rows(self) -> Vec<Row> {
        let [query, update] = self.contacts.rows();
        let [visual, csg] = self.views.rows();
        let [step, crack, linearisation, factorisation] = self.growths.rows();
        vec![
            self.hands.row(),
            self.relaxations.row(),
            query,
            update,
            visual,
            csg,
            step,
            crack,
            linearisation,
            factorisation,
        ]
    }
}

fn sample(reading: &Reading, output: &HandOutput) -> HandSample {
    HandSample {
        device_pose: reading.pose,
        device_buttons: reading.buttons,
        tool_pose: output.tool_pose,
        wrench: output.wrench,
        saturated: output.saturated,
        contacts: output.contacts,
    }
}

fn at_rest(reading: &Reading) -> HandSample {
    HandSample {
        device_pose: reading.pose,
        device_buttons: reading.buttons,
        tool_pose: reading.pose,
        wrench: osteotome_devices::Wrench::default(),
        saturated: false,
        contacts: 0,
    }
}
