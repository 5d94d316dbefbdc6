//! `metrics.json`: the figures of a session, gathered sample by sample.
use super::sample::{GrowthSample, HapticSample, Loop, MainSample, StepTime};
use crate::debrief::{
    BadSplit, ContextFindings, Findings, HandFindings, NerveFindings, PathFindings, Score,
    TeethFindings,
};
use crate::scenario::Scenario;
use crate::step_times::StepTimes;
use osteotome_mechanics::geometry::{Pose, Vec3};
use serde::Serialize;

/// The document; `null` where nothing was computed. Timings are only in `loops` and `steps_us`.
#[derive(Clone, Debug, Serialize)]
pub struct MetricsDocument {
    schema: &'static str,
    units: &'static str,
    split: Split,
    nerve: Nerve,
    hands: Hands,
    solver: Solver,
    loops: Loops,
    steps_us: StepsUs,
    debrief: Option<Debrief>,
}

/// What the recording alone says; see `docs/debrief.md`.
#[derive(Clone, Debug, Serialize)]
struct Debrief {
    phases_s: std::collections::BTreeMap<&'static str, f64>,
    hands: [HandFindings; 2],
    balance: Option<f64>,
    teeth: Known<TeethFindings>,
    context: Vec<ContextFindings>,
    nerve: Known<NerveFindings>,
    path: Option<PathFindings>,
    bad_split: Known<BadSplit>,
    score: Score,
}

/// A finding, or why there is none.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
enum Known<T> {
    Found(T),
    Unknown { unknown: String },
}

impl<T: Clone> Known<T> {
    fn of(result: &Result<T, String>) -> Self {
        match result {
            Ok(found) => Self::Found(found.clone()),
            Err(why) => Self::Unknown {
                unknown: why.clone(),
            },
        }
    }
}

impl MetricsDocument {
    /// Fills in how long parts of steps take.
    pub fn time_steps(&mut self, times: &StepTimes) {
        let steps = &mut self.steps_us;
        for (row, values) in [
            (&mut steps.collision_query, &times.collision_query),
            (&mut steps.collision_update, &times.collision_update),
            (&mut steps.visual_update, &times.visual_update),
            (&mut steps.linearisation, &times.linearisation),
            (&mut steps.factorisation, &times.factorisation),
            (&mut steps.csg_render, &times.csg_render),
        ] {
            *row = Distribution::of(values);
        }
    }

    /// Fills in what the recording alone says.
    pub fn complete(&mut self, findings: &Findings, score: Score) {
        if let Some(path) = &findings.path {
            self.split.path_deviation_mm = MeanMax {
                mean: Some(path.mean_mm),
                max: Some(path.max_mm.value),
            };
        }
        if let Ok(bad) = &findings.bad_split {
            self.split.bad_split.clone_from(&bad.kind);
        }
        self.split.bad_split_reason = match &findings.bad_split {
            Ok(bad) => Some(bad.reason.clone()),
            Err(why) => Some(format!("not known: {why}")),
        };
        if let Ok(nerve) = &findings.nerve {
            let nearest = nerve.nearest().value;
            self.nerve = Nerve {
                min_distance_mm: Some(nearest),
                max_stretch: Some(nerve.max_stretch.value),
                violated: Some(nearest < 0.0),
            };
        }
        self.debrief = Some(Debrief {
            phases_s: findings.phases.lengths().into(),
            hands: findings.hands.clone(),
            balance: findings.balance,
            teeth: Known::of(&findings.teeth),
            context: findings.context.clone(),
            nerve: Known::of(&findings.nerve),
            path: findings.path,
            bad_split: Known::of(&findings.bad_split),
            score,
        });
    }
}

#[derive(Clone, Debug, Serialize)]
struct Split {
    complete: bool,
    time_s: Option<f64>,
    fragments: usize,
    crack_area_mm2: f64,
    /// Published type; `null` for none, and where it is not known: see the reason.
    bad_split: Option<String>,
    bad_split_reason: Option<String>,
    path_deviation_mm: MeanMax,
}

#[derive(Clone, Debug, Default, Serialize)]
struct MeanMax {
    mean: Option<f64>,
    max: Option<f64>,
}

#[derive(Clone, Debug, Default, Serialize)]
struct Nerve {
    min_distance_mm: Option<f64>,
    max_stretch: Option<f64>,
    violated: Option<bool>,
}

#[derive(Clone, Debug, Serialize)]
struct Hands {
    left: Hand,
    right: Hand,
}

/// Force and torque on the bone (displayed ones divided by the scenario's scales).
#[derive(Clone, Debug, Serialize)]
struct Hand {
    peak_force: f64,
    peak_torque: f64,
    path_length_mm: f64,
    /// How far the edge went on into the bone after the break; `null` where it did not break.
    overshoot_mm: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
struct Solver {
    iterations: MeanMax,
    unconverged: u64,
}

#[derive(Clone, Debug, Serialize)]
struct Loops {
    haptic: LoopFigures,
    main: LoopFigures,
    propagation: LoopFigures,
}

/// One loop's pace.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LoopFigures {
    /// Steps a second of wall time; `null` in lockstep, which keeps no pace.
    pub hz: Option<f64>,
    /// Deadlines missed; `null` likewise.
    pub missed: Option<u64>,
    /// How long its steps took.
    pub step_us: Option<Distribution>,
}

/// A distribution in short.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Distribution {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Distribution {
    /// Of a sample; `None` if it is empty.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        (!sorted.is_empty()).then(|| Self {
            mean: sorted.iter().sum::<f64>() / sorted.len() as f64,
            p50: at(0.5),
            p99: at(0.99),
            max: at(1.0),
        })
    }
}

/// Times of the paper's Table 1; `null` where the session had no such step: no growth, or no pictures drawn of it.
#[derive(Clone, Debug, Default, Serialize)]
struct StepsUs {
    collision_query: Option<Distribution>,
    collision_update: Option<Distribution>,
    visual_update: Option<Distribution>,
    crack_propagation: Option<Distribution>,
    linearisation: Option<Distribution>,
    factorisation: Option<Distribution>,
    csg_render: Option<Distribution>,
}

/// Pace of one loop, measured by who drives it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    /// Steps made.
    pub steps: u64,
    /// Wall time they took \[s\].
    pub seconds: f64,
    /// Deadlines missed.
    pub missed: u64,
    /// Of those, by steps that took longer than a period themselves: the others began too late, after such a step or because the
    /// system woke the loop late.
    pub overran: u64,
    /// How long after its deadline the latest step ended \[us\].
    pub latest_us: f64,
}

/// Gathers the figures; never looks back at the recording.
#[derive(Clone, Debug)]
pub struct Metrics {
    scales: [[f64; 2]; 2],
    hands: [HandGathered; 2],
    broken_at: Option<f64>,
    fragments: usize,
    area: f64,
    iterations: Vec<u32>,
    unconverged: u64,
    step_us: [Vec<f64>; 3],
    growth_us: Vec<f64>,
    pace: [Option<Pace>; 3],
    last_time: f64,
}

#[derive(Clone, Debug, Default)]
struct HandGathered {
    peak_force: f64,
    peak_torque: f64,
    path: f64,
    last: Option<Vec3>,
    at_break: Option<Pose>,
    overshoot: f64,
    /// Displayed torque of the last [`RECENT`] steps.
    recent: std::collections::VecDeque<f64>,
    torque_before: f64,
    torque_after: Option<f64>,
}

/// The torque before the break is its peak in these many steps, the one after it the least in as long \[steps of 1 ms\].
const RECENT: usize = 100;

impl Metrics {
    /// Nothing gathered yet.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            scales: [0, 1].map(|i| [scenario.tool[i].force_scale, scenario.tool[i].torque_scale]),
            hands: Default::default(),
            broken_at: None,
            fragments: 1,
            area: 0.0,
            iterations: vec![],
            unconverged: 0,
            step_us: Default::default(),
            growth_us: vec![],
            pace: [None; 3],
            last_time: 0.0,
        }
    }

    /// Takes a haptic step in.
    pub fn haptic(&mut self, sample: &HapticSample) {
        self.last_time = sample.time;
        let after = self.broken_at.map(|t| sample.time - t);
        for ((hand, scale), now) in self.hands.iter_mut().zip(self.scales).zip(&sample.hands) {
            let torque = now.wrench.torque.norm();
            hand.peak_force = hand.peak_force.max(now.wrench.force.norm() / scale[0]);
            hand.peak_torque = hand.peak_torque.max(torque / scale[1]);
            let at = now.tool_pose.translation.vector;
            hand.path += hand.last.map_or(0.0, |last| (at - last).norm());
            hand.last = Some(at);
            match after {
                None => {
                    if hand.recent.len() == RECENT {
                        hand.recent.pop_front();
                    }
                    hand.recent.push_back(torque);
                }
                Some(since) => hand.after_break(now.tool_pose, torque, since),
            }
        }
    }

    /// Takes a main step in.
    pub fn main(&mut self, sample: &MainSample) {
        self.iterations.push(sample.iterations);
        self.unconverged += u64::from(!sample.converged);
    }

    /// Takes a growth step in.
    pub fn growth(&mut self, sample: &GrowthSample) {
        self.area = sample.area;
        self.fragments = sample.fragments;
        if sample.severed && self.broken_at.is_none() {
            self.broken_at = Some(sample.time);
        }
    }

    /// Takes a step's duration in; `grew` marks a propagation step that grew the crack.
    pub fn timing(&mut self, sample: &StepTime, grew: bool) {
        self.step_us[sample.of as usize].push(sample.step_us);
        if grew {
            self.growth_us.push(sample.step_us);
        }
    }

    /// Takes a loop's pace in.
    pub fn pace(&mut self, of: Loop, pace: Pace) {
        self.pace[of as usize] = Some(pace);
    }

    /// Whether the bone has come apart.
    pub fn is_complete(&self) -> bool {
        self.broken_at.is_some()
    }

    fn share_within(&self, most: u32) -> Option<f64> {
        let within = self.iterations.iter().filter(|i| **i <= most).count();
        let converged = within.saturating_sub(self.unconverged as usize);
        (!self.iterations.is_empty()).then(|| converged as f64 / self.iterations.len() as f64)
    }

    /// What a person wants to know at the end.
    pub fn outcome(&self) -> Outcome {
        Outcome {
            time: self.broken_at,
            ended: self.last_time,
            fragments: self.fragments,
            area: self.area,
            peaks: [0, 1].map(|i| [self.hands[i].peak_force, self.hands[i].peak_torque]),
            torque_fall: [0, 1].map(|i| self.hands[i].torque_fall()),
            loops: [Loop::Haptic, Loop::Main, Loop::Propagation].map(|l| self.figures(l)),
            within_five: self.share_within(5),
        }
    }

    fn figures(&self, of: Loop) -> LoopFigures {
        let pace = self.pace[of as usize];
        LoopFigures {
            hz: pace.and_then(|p| (p.seconds > 0.0).then(|| p.steps as f64 / p.seconds)),
            missed: pace.map(|p| p.missed),
            step_us: Distribution::of(&self.step_us[of as usize]),
        }
    }

    /// The document as it stands.
    pub fn document(&self) -> MetricsDocument {
        let hand = |i: usize| {
            let h = &self.hands[i];
            Hand {
                peak_force: h.peak_force,
                peak_torque: h.peak_torque,
                path_length_mm: h.path,
                overshoot_mm: h.at_break.map(|_| h.overshoot),
            }
        };
        let n = self.iterations.len();
        let sum: f64 = self.iterations.iter().map(|i| f64::from(*i)).sum();
        MetricsDocument {
            schema: "osteotome.metrics/1",
            units: "mm, N, N mm, s",
            split: Split {
                complete: self.is_complete(),
                time_s: self.broken_at,
                fragments: self.fragments,
                crack_area_mm2: self.area,
                bad_split: None,
                bad_split_reason: None,
                path_deviation_mm: MeanMax::default(),
            },
            nerve: Nerve::default(),
            hands: Hands {
                left: hand(0),
                right: hand(1),
            },
            solver: Solver {
                iterations: MeanMax {
                    mean: (n > 0).then(|| sum / n as f64),
                    max: self.iterations.iter().max().map(|m| f64::from(*m)),
                },
                unconverged: self.unconverged,
            },
            loops: Loops {
                haptic: self.figures(Loop::Haptic),
                main: self.figures(Loop::Main),
                propagation: self.figures(Loop::Propagation),
            },
            steps_us: StepsUs {
                crack_propagation: Distribution::of(&self.growth_us),
                ..StepsUs::default()
            },
            debrief: None,
        }
    }
}

impl HandGathered {
    fn after_break(&mut self, pose: Pose, torque: f64, since: f64) {
        let at_break = *self.at_break.get_or_insert(pose);
        let into_bone = at_break.rotation * Vec3::z();
        let on = into_bone.dot(&(pose.translation.vector - at_break.translation.vector));
        self.overshoot = self.overshoot.max(on);
        self.torque_before = self.recent.iter().copied().fold(0.0, f64::max);
        if since <= 0.1 {
            let least = self.torque_after.map_or(torque, |t| t.min(torque));
            self.torque_after = Some(least);
        }
    }

    fn torque_fall(&self) -> Option<f64> {
        let after = self.torque_after?;
        (self.torque_before > 0.0).then(|| 1.0 - after / self.torque_before)
    }
}

/// The session in short, for the summary.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// When it broke \[s\].
    pub time: Option<f64>,
    /// When the session ended \[s\].
    pub ended: f64,
    /// Pieces.
    pub fragments: usize,
    /// Broken area \[mm2\].
    pub area: f64,
    /// Largest force and torque on the bone, by hand \[N, N mm\].
    pub peaks: [[f64; 2]; 2],
    /// Share by which the displayed torque fell within 100 ms of the break, by hand.
    pub torque_fall: [Option<f64>; 2],
    /// Haptic, main, propagation.
    pub loops: [LoopFigures; 3],
    /// Share of main steps that converged within 5 passes.
    pub within_five: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::super::sample::tests::hand;
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};

    fn metrics() -> Metrics {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        Metrics::new(&load(&source, &[], std::path::Path::new("/")).unwrap())
    }

    fn sample(step: u64, torque: f64, z: f64) -> HapticSample {
        let mut hand = hand(0.0);
        hand.wrench.force = Vec3::new(0.0, 3.0, 4.0);
        hand.wrench.torque = Vec3::x() * torque;
        hand.tool_pose = Pose::translation(0.0, 0.0, z);
        HapticSample {
            step,
            time: step as f64 * 1e-3,
            hands: [hand; 2],
        }
    }

    fn broken(time: f64) -> GrowthSample {
        GrowthSample {
            time,
            vertices: vec![],
            triangles: vec![],
            kerf: vec![],
            generation: 4,
            front: vec![],
            area: 300.0,
            fragments: 2,
            severed: true,
            sheets: vec![],
            cut: vec![],
            seats: vec![],
            tips: vec![],
        }
    }

    #[test]
    fn torque_fall_overshoot_and_peaks_around_a_break() {
        let mut metrics = metrics();
        for step in 0..500 {
            metrics.haptic(&sample(step, 80.0 * step as f64 / 500.0, 0.0));
        }
        metrics.growth(&broken(0.5));
        for step in 500..700 {
            metrics.haptic(&sample(step, 16.0, 0.01 * (step - 500) as f64));
        }
        let outcome = metrics.outcome();
        assert_eq!(outcome.time, Some(0.5));
        assert!(
            (outcome.peaks[0][0] - 1000.0).abs() < 1e-9,
            "5 N displayed at .005"
        );
        assert!((outcome.torque_fall[1].unwrap() - (1.0 - 16.0 / 79.84)).abs() < 1e-12);
        let json = serde_json::to_value(metrics.document()).unwrap();
        assert_eq!(json["schema"], "osteotome.metrics/1");
        assert!((json["hands"]["left"]["overshoot_mm"].as_f64().unwrap() - 1.99).abs() < 1e-9);
        assert_eq!(json["loops"]["haptic"]["hz"], serde_json::Value::Null);
    }

    #[test]
    fn unconverged_steps_do_not_count_as_within_five() {
        let mut metrics = metrics();
        let step = |iterations, converged| MainSample {
            time: 0.0,
            iterations,
            residual: 0.0,
            converged,
            contacts: 0,
            max_displacement: 0.0,
            strain_energy: 0.0,
        };
        for _ in 0..3 {
            metrics.main(&step(2, true));
        }
        metrics.main(&step(5, false));
        assert_eq!(metrics.outcome().within_five, Some(0.75));
    }

    #[test]
    fn percentiles_of_a_hundred_and_one() {
        let values: Vec<_> = (0..=100).map(f64::from).collect();
        let d = Distribution::of(&values).unwrap();
        assert_eq!([d.mean, d.p50, d.p99, d.max], [50.0, 50.0, 99.0, 100.0]);
        assert!(Distribution::of(&[]).is_none());
    }
}
