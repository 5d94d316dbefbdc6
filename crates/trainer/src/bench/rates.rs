//! The same hands against the clock, on three threads.
use super::times::Times;
use crate::engine::Engine;
use crate::input::Input;
use crate::loops::{Sink, realtime};
use crate::scenario::Scenario;
use crate::session::{GrowthSample, HapticSample, Loop, MainSample, Pace, StepTime};
use anyhow::Result;
use std::time::Instant;

/// What was seen of a session in real time.
#[derive(Default)]
pub struct Paced {
    /// Of the haptic, main and propagation loop.
    pub pace: [Pace; 3],
    /// How long haptic steps took \[ms\].
    pub haptic_times: Times,
    /// Every haptic step.
    pub haptic: Vec<HapticSample>,
    /// When main steps ended, by the haptic loop's clock \[s\].
    pub main: Vec<f64>,
    /// Every growth.
    pub growth: Vec<GrowthSample>,
    /// Now and then: wall time \[s\], and the haptic loop's.
    pub clock: Vec<[f64; 2]>,
}

impl Paced {
    /// Steps a second of the haptic, main and propagation loop.
    pub fn hz(&self) -> [f64; 3] {
        self.pace.map(|p| p.steps as f64 / p.seconds)
    }

    /// When the bone came apart \[s\].
    pub fn broken(&self) -> Option<f64> {
        self.growth.iter().find(|g| g.severed).map(|g| g.time)
    }
}

impl Sink for Paced {
    fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        self.haptic.push(*sample);
        Ok(())
    }
    fn main(&mut self, sample: &MainSample) -> Result<()> {
        self.main.push(sample.time);
        Ok(())
    }
    fn growth(&mut self, sample: GrowthSample) -> Result<()> {
        self.growth.push(sample);
        Ok(())
    }
    fn timing(&mut self, step: &StepTime, _: bool) -> Result<()> {
        if step.of == Loop::Haptic {
            self.haptic_times.push(1e-3 * step.step_us);
        }
        Ok(())
    }
    fn event(&mut self, _: f64, _: &str) -> Result<()> {
        Ok(())
    }
    fn pace(&mut self, of: Loop, pace: Pace) {
        self.pace[of as usize] = pace;
    }
}

/// Runs a session. `progress` is told the simulated time \[s\].
///
/// # Errors
/// That a loop panicked.
pub fn run(
    engine: Engine,
    input: Input,
    scenario: &Scenario,
    progress: &mut dyn FnMut(f64),
) -> Result<Paced> {
    let mut paced = Paced::default();
    let mut clock = Vec::new();
    let start = Instant::now();
    let mut watch = |time: f64, _: bool| {
        clock.push([start.elapsed().as_secs_f64(), time]);
        progress(time);
    };
    realtime(engine, input, scenario, &mut paced, &mut watch)?;
    paced.clock = clock;
    Ok(paced)
}
