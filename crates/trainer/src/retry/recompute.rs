use super::schedule::{Schedule, View};
use crate::engine::{Engine, EngineUnderway, Held, MainOfEngine, Prepared, PropagationOfEngine};
use crate::input::Input;
use crate::loops::{
    BoneClock, Control, HapticLoop, HapticPart, MainPart, Progress, Propagated, PropagationPart,
    Sink, Underway, view,
};
use crate::scenario::Scenario;
use crate::session::{BoneSample, Loop, Recording};
use crate::surgeon::CrackView;
use anyhow::Result;

/// What is computed anew.
pub struct Recomputing<'a> {
    /// The recording.
    pub recording: &'a Recording,
    /// In which order.
    pub schedule: &'a Schedule,
    /// Up to how many haptic steps.
    pub steps: u64,
    /// Who may end it before.
    pub control: Control,
}

/// Makes the steps of a recording once more, in the order in which they had read each other, and tells `sink` of them; gives back the
/// session after them, and how many haptic steps were made: fewer than wanted only if the recording breaks off, or somebody ended it.
///
/// # Errors
/// What the sink reports, or a scenario that the mechanics refuses.
pub fn recompute(
    what: &Recomputing,
    prepared: &Prepared,
    scenario: &Scenario,
    input: Input,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<(EngineUnderway, u64)> {
    let (held, parts) = Held::connect(prepared, scenario, what.recording.start())?;
    let Engine {
        haptic,
        main,
        propagation,
    } = parts;
    let start = propagation.crack();
    let crack = view(&start);
    sink.growth(start)?;
    let mut stage = Stage {
        what,
        held,
        main,
        propagation,
        crack,
        n_main: 0,
        n_growth: 1,
        bone_clock: BoneClock::default(),
    };
    let mut haptic = HapticLoop::new(haptic, input, scenario);
    let dt = scenario.loops.dt();
    let mut made = 0;
    stage.main_steps(0, 0.0, sink)?;
    while made < what.steps && !what.control.is_stopped() {
        match what.schedule.view(made) {
            View::Newest => stage.held.show_newest(),
            View::AsBefore => {}
            View::State(number) if stage.held.show(number) => {}
            View::State(_) => break,
        }
        let sample = haptic.tick(&stage.crack);
        sink.haptic(&sample)?;
        sink.seen(sample.time, Loop::Haptic, haptic.part.seen())?;
        made += 1;
        stage.main_steps(made, sample.time, sink)?;
        progress(made as f64 * dt, stage.crack.severed);
    }
    let Stage {
        held,
        main,
        propagation,
        bone_clock,
        ..
    } = stage;
    let mut underway = Underway {
        haptic,
        main,
        propagation,
        bone_clock,
    };
    held.release(&mut underway);
    Ok((underway, made))
}

struct Stage<'a> {
    what: &'a Recomputing<'a>,
    held: Held,
    main: MainOfEngine,
    propagation: PropagationOfEngine,
    crack: CrackView,
    n_main: usize,
    n_growth: usize,
    bone_clock: BoneClock,
}

impl Stage<'_> {
    /// The main steps that read the hands after so many haptic ones, each with its look at the crack.
    fn main_steps(&mut self, after: u64, time: f64, sink: &mut impl Sink) -> Result<()> {
        let what = self.what;
        while let Some(turn) = what.schedule.main().get(self.n_main)
            && turn.after <= after
        {
            let recorded = what.recording.main.get(self.n_main).map(|m| m.time);
            let time = recorded.unwrap_or(time);
            let mut sample = self.held.main_step(&mut self.main, turn.generation);
            sample.time = time;
            self.n_main += 1;
            sink.main(&sample)?;
            sink.seen(time, Loop::Main, self.main.seen())?;
            if self.bone_clock.is_due(self.main.generation())
                && let Some(bone) = MainPart::bone(&self.main)
            {
                sink.bone(&BoneSample { time, ..bone })?;
            }
            if what.schedule.is_looked_at(self.n_main as u64) {
                self.look(time, sink)?;
            }
        }
        Ok(())
    }

    fn look(&mut self, time: f64, sink: &mut impl Sink) -> Result<()> {
        let propagated = self.held.propagation_step(&mut self.propagation);
        if !matches!(propagated, Propagated::Idle) {
            sink.seen(time, Loop::Propagation, self.propagation.seen())?;
        }
        if let Propagated::Grown(mut growth) = propagated {
            let recorded = self.what.recording.growth.get(self.n_growth);
            growth.time = recorded.map_or(time, |g| g.time);
            self.n_growth += 1;
            self.crack = view(&growth);
            sink.growth(*growth)?;
        }
        Ok(())
    }
}
