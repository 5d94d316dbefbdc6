//! `bench --soak S`: the recorded hands over and over in real time, and how well the haptic loop keeps its deadlines.
use super::rates::{Paced, run};
use super::times::Times;
use crate::cli::Failure;
use crate::engine::{self, Prepared};
use crate::input::Input;
use crate::scenario::Scenario;
use crate::session::{Pace, Recording};

/// All sessions of a soak together.
#[derive(Default)]
pub struct Soak {
    sessions: u32,
    /// Of the haptic loop.
    pace: Pace,
    haptic: Times,
    /// Steps of the main and the propagation loop, and seconds.
    others: [u64; 2],
}

impl Soak {
    fn add(&mut self, paced: &Paced) {
        let [haptic, main, propagation] = paced.pace;
        self.sessions += 1;
        self.pace.steps += haptic.steps;
        self.pace.missed += haptic.missed;
        self.pace.overran += haptic.overran;
        self.pace.seconds += haptic.seconds;
        self.pace.latest_us = self.pace.latest_us.max(haptic.latest_us);
        self.haptic.append(&paced.haptic_times);
        self.others[0] += main.steps;
        self.others[1] += propagation.steps;
    }

    /// What `bench --soak` says.
    pub fn text(&self) -> Option<String> {
        let (pace, t) = (&self.pace, self.haptic.in_short()?);
        let [main, propagation] = self.others.map(|n| n as f64 / pace.seconds);
        Some(format!(
            "{:.0} s in real time, {} sessions: {} of {} haptic deadlines missed ({:.4} %), the latest by {:.2} ms; {} by steps that \
             took longer than their period themselves.\n\
             Haptic step {:.3} ms on average, {:.3} at the median, {:.3} at the 99th percentile, {:.3} at most; main loop {main:.1} Hz, propagation {propagation:.0} looks a second.",
            pace.seconds,
            self.sessions,
            pace.missed,
            pace.steps,
            100.0 * pace.missed as f64 / pace.steps as f64,
            1e-3 * pace.latest_us,
            pace.overran,
            t.mean,
            t.median,
            t.p99,
            t.max
        ))
    }
}

/// Plays the recording until `seconds` have passed. `progress` is told how many have.
///
/// # Errors
/// A recording that does not fit, or a loop that panicked.
pub fn soak(
    recording: &Recording,
    scenario: &Scenario,
    prepared: &Prepared,
    seconds: f64,
    progress: &mut dyn FnMut(f64),
) -> Result<Soak, Failure> {
    let mut soak = Soak::default();
    while soak.pace.seconds < seconds {
        let before = soak.pace.seconds;
        let scenario = Scenario {
            max_time: scenario.max_time.min(seconds - before).max(1.0),
            ..scenario.clone()
        };
        let mut input = Input::recorded(&scenario, &recording.hands).map_err(Failure::Input)?;
        let start = input.read().map(|r| r.pose);
        input.rewind();
        let engine = engine::connect(prepared, &scenario, start).map_err(Failure::Input)?;
        let paced = run(engine, input, &scenario, &mut |t| progress(before + t));
        soak.add(&paced.map_err(Failure::Work)?);
    }
    Ok(soak)
}
