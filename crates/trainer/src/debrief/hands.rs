//! What the hands did, from `/haptic` alone.
use super::motion::{movements, path_length, smoothness, speeds};
use crate::scenario::Scenario;
use crate::session::{HandSample, Recording};
use osteotome_mechanics::geometry::{Pose, Vec3};
use serde::Serialize;

/// A value and when it came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct At {
    /// In the unit of its field.
    pub value: f64,
    /// \[s\]
    pub time_s: f64,
}

impl At {
    fn raise(&mut self, value: f64, time_s: f64) {
        if value > self.value {
            *self = Self { value, time_s };
        }
    }
}

/// One hand. Loads are those on the bone: displayed ones over the scenario's scales.
#[derive(Clone, Debug, Default, Serialize)]
pub struct HandFindings {
    /// \[N\]
    pub peak_force: At,
    /// \[N mm\]
    pub peak_torque: At,
    /// Of the force \[N s\].
    pub impulse: f64,
    /// Of the torque \[N mm s\].
    pub angular_impulse: f64,
    /// Of the cutting edge's middle \[mm\].
    pub path_length_mm: f64,
    /// See [`movements`].
    pub movements: usize,
    /// See [`smoothness`].
    pub smoothness: Option<f64>,
    /// How far the edge went on into the bone after the break \[mm\].
    pub overshoot_mm: Option<At>,
    /// When the tool slipped \[s\].
    pub slips_s: Vec<f64>,
    /// Time in contact with bone or teeth \[s\].
    pub contact_s: f64,
    /// Time at the device's limit \[s\].
    pub saturated_s: f64,
}

/// Ends of the phases \[s\]; each begins where the one before ends, and may be empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Phases {
    /// Until a tool first touches the bone.
    pub approach: f64,
    /// Until a tool in contact has been twisted by 5 degrees.
    pub insertion: f64,
    /// Until the crack first grows.
    pub twisting: f64,
    /// Until the bone is apart; without a break until the end.
    pub r#break: f64,
    /// Until the end.
    pub after: f64,
}

impl Phases {
    /// Names and lengths \[s\].
    pub fn lengths(&self) -> [(&'static str, f64); 5] {
        [
            ("approach", self.approach),
            ("insertion", self.insertion - self.approach),
            ("twisting", self.twisting - self.insertion),
            ("break", self.r#break - self.twisting),
            ("after", self.after - self.r#break),
        ]
    }
}

/// Motion is looked at this often \[s\].
pub const LOOK: f64 = 0.01;
/// A twist by more than this is meant \[rad\].
const TWISTED: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Haptic steps to a look.
pub fn stride(scenario: &Scenario) -> usize {
    ((LOOK / scenario.loops.dt()).round() as usize).max(1)
}

/// Force \[N\] and torque \[N mm\] on the bone.
pub fn load(hand: &HandSample, scenario: &Scenario, i: usize) -> [f64; 2] {
    let tool = &scenario.tool[i];
    [
        hand.wrench.force.norm() / tool.force_scale,
        hand.wrench.torque.norm() / tool.torque_scale,
    ]
}

/// Everything about hand `i`; `broken`: when the bone came apart \[s\].
pub fn hand(recording: &Recording, i: usize, broken: Option<f64>) -> HandFindings {
    let scenario = &recording.scenario.scenario;
    let (samples, dt) = (&recording.hands[i], scenario.loops.dt());
    let mut found = HandFindings::default();
    for (k, sample) in samples.iter().enumerate() {
        let [force, torque] = load(sample, scenario, i);
        found.peak_force.raise(force, k as f64 * dt);
        found.peak_torque.raise(torque, k as f64 * dt);
        found.impulse += force * dt;
        found.angular_impulse += torque * dt;
        found.contact_s += if sample.contacts > 0 { dt } else { 0.0 };
        found.saturated_s += if sample.saturated { dt } else { 0.0 };
    }
    let every = stride(scenario);
    let looked: Vec<&HandSample> = samples.iter().step_by(every).collect();
    let edge: Vec<Vec3> = looked
        .iter()
        .map(|s| s.tool_pose.translation.vector)
        .collect();
    let look = every as f64 * dt;
    let speed = speeds(&edge, look);
    found.path_length_mm = path_length(&edge);
    found.movements = movements(&speed, look).len();
    found.smoothness = smoothness(&speed, look);
    let forces: Vec<f64> = looked.iter().map(|s| load(s, scenario, i)[0]).collect();
    found.slips_s = slips(&forces, &edge, look, broken);
    found.overshoot_mm = broken.map(|t| overshoot(samples, dt, t));
    found
}

fn overshoot(samples: &[HandSample], dt: f64, broken: f64) -> At {
    let first = ((broken / dt).ceil() as usize).min(samples.len() - 1);
    let start = samples[first].tool_pose;
    let into_bone = start.rotation * Vec3::z();
    let mut most = At {
        value: 0.0,
        time_s: broken,
    };
    for (k, sample) in samples.iter().enumerate().skip(first) {
        let on = sample.tool_pose.translation.vector - start.translation.vector;
        most.raise(into_bone.dot(&on), k as f64 * dt);
    }
    most
}

/// A slip: within 30 ms a force of at least 20 N falls to less than half, while the edge goes 2 mm or more; not from the break on.
fn slips(forces: &[f64], edge: &[Vec3], look: f64, broken: Option<f64>) -> Vec<f64> {
    const LEAST: f64 = 20.0;
    const FAR: f64 = 2.0;
    const WITHIN: f64 = 0.03;
    const PAUSE: f64 = 0.3;
    let window = ((WITHIN / look).round() as usize).max(1);
    let mut times: Vec<f64> = vec![];
    for k in window..forces.len() {
        let (before, time) = (forces[k - window], k as f64 * look);
        let is_slip = before >= LEAST
            && forces[k] < 0.5 * before
            && (edge[k] - edge[k - window]).norm() >= FAR;
        let is_break = broken.is_some_and(|t| time >= t - WITHIN);
        let is_new = times.last().is_none_or(|t| time - t > PAUSE);
        if is_slip && !is_break && is_new {
            times.push(time);
        }
    }
    times
}

/// The phases; `grown`: when the crack first grew \[s\].
pub fn phases(recording: &Recording, grown: Option<f64>, broken: Option<f64>) -> Phases {
    let dt = recording.scenario.scenario.loops.dt();
    let end = recording.hands[0].len() as f64 * dt;
    let starts = recording.hands.each_ref().map(|samples| {
        let touch = samples.iter().position(|s| s.contacts > 0)?;
        let start = samples[touch].tool_pose;
        let twisted = |s: &HandSample| s.contacts > 0 && twist(&start, &s.tool_pose) > TWISTED;
        let turn = samples[touch..].iter().position(twisted);
        Some((touch as f64 * dt, turn.map(|k| (touch + k) as f64 * dt)))
    });
    let touched = starts.iter().flatten().map(|s| s.0);
    let twisted = starts.iter().flatten().filter_map(|s| s.1);
    let broken = broken.unwrap_or(end).min(end);
    let grown = grown.unwrap_or(end).min(broken);
    let twisted = twisted.fold(grown, f64::min);
    Phases {
        approach: touched.fold(twisted, f64::min),
        insertion: twisted,
        twisting: grown,
        r#break: broken,
        after: end,
    }
}

/// Turn about the tool's own shaft \[rad\].
fn twist(from: &Pose, to: &Pose) -> f64 {
    let q = from.rotation.inverse() * to.rotation;
    let angle = 2.0 * q.k.atan2(q.w).abs();
    angle.min(std::f64::consts::TAU - angle)
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load as load_scenario};
    use crate::session::ScenarioMessage;
    use osteotome_devices::Wrench;

    /// A recording of both hands alike: pose, force and torque on the bone, contact.
    pub fn recording(seconds: f64, at: impl Fn(f64) -> (Pose, f64, f64, bool)) -> Recording {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let scenario = load_scenario(&source, &[], std::path::Path::new("/")).unwrap();
        let sample = |k: usize, i: usize| {
            let (tool_pose, force, torque, is_touching) = at(k as f64 * 1e-3);
            HandSample {
                device_pose: tool_pose,
                device_buttons: 0,
                tool_pose,
                wrench: Wrench {
                    force: Vec3::x() * (force * scenario.tool[i].force_scale),
                    torque: Vec3::y() * (torque * scenario.tool[i].torque_scale),
                },
                saturated: false,
                contacts: u32::from(is_touching),
            }
        };
        let n = (seconds * 1e3) as usize;
        let hands = [0, 1].map(|i| (0..n).map(|k| sample(k, i)).collect());
        Recording {
            hands,
            ..Recording::empty(ScenarioMessage {
                start: None,
                retried: None,
                scenario: scenario.clone(),
                patient_digest: String::new(),
                mode: "lockstep".into(),
            })
        }
    }

    /// 1 s down at 10 mm/s, touching from 6 mm on, then a twist of 20 degrees/s, then out.
    fn strike(t: f64) -> (Pose, f64, f64, bool) {
        let z = (10.0 * t).min(10.0);
        let turn = 20f64.to_radians() * (t - 1.0).clamp(0.0, 1.0);
        let pose = Pose::new(Vec3::new(0.0, 0.0, z), Vec3::z() * turn);
        (pose, 50.0, 2000.0, z > 6.0)
    }

    #[test]
    fn phases_begin_with_touch_twist_and_growth() {
        let r = recording(4.0, strike);
        let p = phases(&r, Some(2.0), Some(3.0));
        let near = |a: f64, b: f64| (a - b).abs() < 2e-3;
        assert!(near(p.approach, 0.6) && near(p.insertion, 1.25), "{p:?}");
        assert_eq!([p.twisting, p.r#break, p.after], [2.0, 3.0, 4.0]);
        let whole: f64 = p.lengths().iter().map(|l| l.1).sum();
        assert!((whole - 4.0).abs() < 1e-12);
        // Wedged apart before any twist; never touched.
        let p = phases(&r, Some(0.9), None);
        assert_eq!([p.insertion, p.twisting, p.r#break], [0.9, 0.9, 4.0]);
        let p = phases(
            &recording(1.0, |_| (Pose::identity(), 0.0, 0.0, false)),
            None,
            None,
        );
        assert_eq!([p.approach, p.after], [1.0, 1.0]);
    }

    #[test]
    fn impulse_peak_path_and_overshoot_of_a_known_strike() {
        let f = hand(&recording(4.0, strike), 0, Some(0.5));
        assert!((f.impulse - 200.0).abs() < 1e-6 && (f.angular_impulse - 8000.0).abs() < 1e-6);
        assert!((f.peak_force.value - 50.0).abs() < 1e-9);
        assert!(
            (f.path_length_mm - 10.0).abs() < 1e-6,
            "{}",
            f.path_length_mm
        );
        assert!((f.overshoot_mm.unwrap().value - 5.0).abs() < 0.02);
        assert!((f.contact_s - 3.4).abs() < 2e-3);
        assert_eq!((f.movements, f.slips_s.len()), (1, 0));
    }

    #[test]
    fn a_slip_is_a_fall_of_force_with_a_leap_before_the_break() {
        let slipping = |t: f64| {
            let leap = 4.0 * ((t - 1.0) / 0.02).clamp(0.0, 1.0);
            let force = if t < 1.01 { 60.0 } else { 5.0 };
            (Pose::translation(0.0, leap, 0.0), force, 0.0, true)
        };
        let r = recording(2.0, slipping);
        let found = hand(&r, 1, None).slips_s;
        assert!(
            found.len() == 1 && (found[0] - 1.02).abs() < 0.03,
            "{found:?}"
        );
        assert!(hand(&r, 1, Some(1.0)).slips_s.is_empty());
        // Force taken off without a leap is none.
        let eased = |t: f64| {
            (
                Pose::identity(),
                if t < 1.0 { 60.0 } else { 0.0 },
                0.0,
                true,
            )
        };
        assert!(hand(&recording(2.0, eased), 1, None).slips_s.is_empty());
    }
}
