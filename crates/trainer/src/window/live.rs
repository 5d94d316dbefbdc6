//! What the window knows of the running session: written by the recording thread, read by the window and its eye.
use crate::loops::Sink;
use crate::picture::load_on_bone;
use crate::scenario::Scenario;
use crate::session::{BoneSample, GrowthSample, HapticSample, Loop, MainSample, Pace, StepTime};
use anyhow::Result;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// A point of the load plots every so many seconds, the largest of its haptic steps.
pub const TRACE_EVERY: f64 = 0.02;
/// Points of a plot at most: the oldest go.
pub const MOST_POINTS: usize = 6000;
/// Loop rates are taken over so many seconds of the clock.
const RATE_EVERY: f64 = 0.5;
/// Events at most.
const MOST_EVENTS: usize = 500;

/// A session as it stands.
#[derive(Default)]
pub struct Live {
    /// Changes with whatever the scene shows.
    pub revision: u64,
    /// Simulated time \[s\].
    pub time: f64,
    /// The newest haptic step.
    pub hands: Option<HapticSample>,
    /// Load of each hand on the bone now: force \[N\], torque \[N mm\].
    pub loads: [[f64; 2]; 2],
    /// Whether each device has been at its limit within the last trace point.
    pub saturated: [bool; 2],
    /// Time, then the loads of both hands, in turn: time \[s\], [force, torque] by hand.
    pub traces: VecDeque<(f64, [[f64; 2]; 2])>,
    /// Time \[s\] and steps a second of the clock, by loop.
    pub rates: [VecDeque<[f64; 2]>; 3],
    /// Mean duration of the steps of late, by loop \[ms\].
    pub step_ms: [f64; 3],
    /// The newest state of the bone.
    pub bone: Option<Arc<BoneSample>>,
    /// `growth[k]` led to generation `k`.
    pub growth: Vec<Arc<GrowthSample>>,
    /// What happened, and when \[s\].
    pub events: VecDeque<(f64, String)>,
    /// When the bone came apart \[s\].
    pub severed_at: Option<f64>,
    /// Whether the last main step has converged.
    pub is_at_rest: bool,
    /// Whether its loops have ended.
    pub has_ended: bool,
}

impl Live {
    /// Broken so far \[mm2\].
    pub fn area(&self) -> f64 {
        self.growth.last().map_or(0.0, |g| g.area)
    }

    /// Pieces.
    pub fn fragments(&self) -> usize {
        self.growth.last().map_or(1, |g| g.fragments)
    }

    fn tell(&mut self, time: f64, event: impl Into<String>) {
        push(&mut self.events, (time, event.into()), MOST_EVENTS);
    }
}

/// Shared between the recording thread, which writes, and the window.
pub type SharedLive = Arc<Mutex<Live>>;

/// Looks at it; whoever panicked while holding it has left it whole enough to look at.
pub fn look(live: &SharedLive) -> MutexGuard<'_, Live> {
    live.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Fills a [`Live`]. No real-time loop calls this: it sits behind the recorder's rings.
pub struct Feed {
    live: SharedLive,
    scenario: Scenario,
    /// The largest of the trace point in the making.
    peak: [[f64; 2]; 2],
    saturated: [bool; 2],
    next_trace: f64,
    since: Instant,
    counts: [(u32, f64); 3],
}

impl Feed {
    /// Into `live`, from its beginning.
    pub fn new(live: SharedLive, scenario: &Scenario) -> Self {
        *look(&live) = Live::default();
        Self {
            live,
            scenario: scenario.clone(),
            peak: [[0.0; 2]; 2],
            saturated: [false; 2],
            next_trace: TRACE_EVERY,
            since: Instant::now(),
            counts: [(0, 0.0); 3],
        }
    }

    fn close_rates(&mut self) {
        let seconds = self.since.elapsed().as_secs_f64();
        if seconds < RATE_EVERY {
            return;
        }
        let counts = std::mem::take(&mut self.counts);
        self.since = Instant::now();
        // The loops end one after another: their last share of an interval is no rate.
        if counts[Loop::Haptic as usize].0 == 0 {
            return;
        }
        let mut live = look(&self.live);
        let time = live.time;
        for (i, (n, us)) in counts.iter().enumerate() {
            push(
                &mut live.rates[i],
                [time, f64::from(*n) / seconds],
                MOST_POINTS,
            );
            if *n > 0 {
                live.step_ms[i] = us * 1e-3 / f64::from(*n);
            }
        }
    }
}

fn push<T>(list: &mut VecDeque<T>, value: T, most: usize) {
    if list.len() >= most {
        list.pop_front();
    }
    list.push_back(value);
}

impl Sink for Feed {
    fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        let loads = [0, 1].map(|i| {
            let (force, torque) = load_on_bone(&sample.hands[i], &self.scenario, i);
            [force.norm(), torque.norm()]
        });
        for (i, load) in loads.iter().enumerate() {
            (0..2).for_each(|k| self.peak[i][k] = self.peak[i][k].max(load[k]));
            self.saturated[i] |= sample.hands[i].saturated;
        }
        if sample.time < self.next_trace {
            return Ok(());
        }
        self.next_trace += TRACE_EVERY;
        let mut live = look(&self.live);
        live.time = sample.time;
        live.revision += 1;
        live.hands = Some(*sample);
        live.loads = loads;
        live.saturated = std::mem::take(&mut self.saturated);
        let peak = std::mem::take(&mut self.peak);
        push(&mut live.traces, (sample.time, peak), MOST_POINTS);
        Ok(())
    }

    fn main(&mut self, sample: &MainSample) -> Result<()> {
        look(&self.live).is_at_rest = sample.converged;
        Ok(())
    }

    fn bone(&mut self, sample: &BoneSample) -> Result<()> {
        let mut live = look(&self.live);
        live.bone = Some(Arc::new(sample.clone()));
        live.revision += 1;
        Ok(())
    }

    fn growth(&mut self, sample: GrowthSample) -> Result<()> {
        let mut live = look(&self.live);
        let time = sample.time;
        if live.growth.len() == 1 {
            live.tell(time, "the crack begins to grow");
        }
        if sample.severed && live.severed_at.is_none() {
            live.severed_at = Some(time);
            live.tell(
                time,
                format!("split complete: {} fragments", sample.fragments),
            );
        }
        live.growth.push(Arc::new(sample));
        Ok(())
    }

    fn timing(&mut self, sample: &StepTime, _: bool) -> Result<()> {
        let (n, us) = &mut self.counts[sample.of as usize];
        *n += 1;
        *us += sample.step_us;
        self.close_rates();
        Ok(())
    }

    fn event(&mut self, time: f64, event: &str) -> Result<()> {
        look(&self.live).tell(time, event);
        // The clock went on while the session stood still.
        self.counts = Default::default();
        self.since = Instant::now();
        Ok(())
    }

    fn pace(&mut self, _: Loop, _: Pace) {
        look(&self.live).has_ended = true;
    }
}
