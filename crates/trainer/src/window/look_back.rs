//! A recorded session in the window: scrubbed and played, from any viewpoint, and where a session goes on from.
use super::live::{Live, MOST_POINTS, SharedLive, TRACE_EVERY, look};
use crate::picture::load_on_bone;
use crate::retry::Moment;
use crate::session::{BoneSample, GrowthSample, Recording};
use anyhow::{Result, ensure};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Paces of playing, against the session's own.
pub const SPEEDS: [f64; 5] = [0.1, 0.25, 0.5, 1.0, 2.0];

/// See the module.
pub struct LookBack {
    end: Moment,
    /// Its folder, or file.
    pub path: PathBuf,
    /// What is looked at \[s\].
    pub time: f64,
    /// How long it lasts \[s\].
    pub lasts: f64,
    /// Whether time goes on by itself.
    pub is_playing: bool,
    /// How fast.
    pub speed: f64,
    /// What happened, and when \[s\].
    pub marks: Vec<(f64, String)>,
    bone: Vec<Arc<BoneSample>>,
    growth: Vec<Arc<GrowthSample>>,
    traces: Vec<(f64, [[f64; 2]; 2])>,
}

impl LookBack {
    /// Reads a recording.
    ///
    /// # Errors
    /// A file that is none, or one without the bone's states.
    pub fn read(path: &Path) -> Result<Self> {
        let end = Moment::end(path)?;
        let recording = &end.recording;
        ensure!(
            !recording.bone.is_empty(),
            "{}: the bone's displacements are not recorded; record the session again",
            path.display()
        );
        Ok(Self {
            path: path.to_owned(),
            time: 0.0,
            lasts: end.time(),
            is_playing: false,
            speed: 1.0,
            marks: marks(recording),
            bone: recording.bone.iter().cloned().map(Arc::new).collect(),
            growth: recording.growth.iter().cloned().map(Arc::new).collect(),
            traces: traces(recording),
            end,
        })
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        &self.end.recording
    }

    /// The moment that is looked at, to go on from.
    ///
    /// # Errors
    /// One line: why it cannot be gone on from.
    pub fn moment(&self) -> Result<Moment> {
        self.moment_at(self.time)
    }

    /// Another moment of it \[s\].
    ///
    /// # Errors
    /// Likewise.
    pub fn moment_at(&self, time: f64) -> Result<Moment> {
        self.end.at(time)
    }

    /// Goes to a time; says whether it is another one.
    pub fn go_to(&mut self, time: f64) -> bool {
        let time = time.clamp(0.0, self.lasts);
        let is_other = time != self.time;
        self.time = time;
        is_other
    }

    /// The mark after or before what is looked at.
    pub fn mark(&self, is_next: bool) -> Option<f64> {
        const APART: f64 = 1e-3;
        let times = self.marks.iter().map(|m| m.0);
        if is_next {
            times.filter(|t| *t > self.time + APART).reduce(f64::min)
        } else {
            times.filter(|t| *t < self.time - APART).reduce(f64::max)
        }
    }

    /// Time has gone on by `dt` \[s\] of the clock; says whether something else is to be seen.
    pub fn tick(&mut self, dt: f64) -> bool {
        if !self.is_playing {
            return false;
        }
        let is_other = self.go_to(self.time + dt * self.speed);
        self.is_playing = self.time < self.lasts;
        is_other
    }

    /// Puts what there was at the time before the window's eyes.
    pub fn show(&self, live: &SharedLive) {
        let recording = self.recording();
        let t = self.time + 1e-9;
        let bone = self.bone.partition_point(|b| b.time <= t).saturating_sub(1);
        let bone = &self.bone[bone];
        let is_there = |g: &&Arc<GrowthSample>| g.time <= t || g.generation <= bone.generation;
        let growth: Vec<_> = self.growth.iter().filter(is_there).cloned().collect();
        let n = recording.hands[0].len();
        let dt = recording.scenario.scenario.loops.dt();
        let step = ((t / dt) as usize).min(n - 1);
        let hands = recording.haptic(dt).nth(step);
        let shown = self.traces.partition_point(|p| p.0 <= t);
        let first = shown.saturating_sub(MOST_POINTS);
        let mut live = look(live);
        let scenario = &recording.scenario.scenario;
        *live = Live {
            revision: live.revision + 1,
            time: self.time,
            loads: hands.map_or([[0.0; 2]; 2], |h| {
                [0, 1].map(|i| {
                    let (force, torque) = load_on_bone(&h.hands[i], scenario, i);
                    [force.norm(), torque.norm()]
                })
            }),
            saturated: hands.map_or([false; 2], |h| h.hands.map(|h| h.saturated)),
            hands,
            traces: self.traces[first..shown].iter().copied().collect(),
            bone: Some(bone.clone()),
            severed_at: growth.iter().find(|g| g.severed).map(|g| g.time),
            growth,
            events: self.marks.iter().filter(|m| m.0 <= t).cloned().collect(),
            is_at_rest: true,
            has_ended: true,
            ..Live::default()
        };
    }
}

/// First touch of each hand, first crack, break, and the recorded events.
fn marks(recording: &Recording) -> Vec<(f64, String)> {
    let dt = recording.scenario.scenario.loops.dt();
    let touch = |i: usize| recording.hands[i].iter().position(|h| h.contacts > 0);
    let mut marks: Vec<(f64, String)> = recording.events.clone();
    for (i, name) in ["left", "right"].into_iter().enumerate() {
        marks.extend(touch(i).map(|k| (k as f64 * dt, format!("the {name} chisel touches"))));
    }
    let grown = recording.growth.iter().find(|g| g.generation > 0);
    marks.extend(grown.map(|g| (g.time, "the crack begins to grow".to_owned())));
    let severed = recording.growth.iter().find(|g| g.severed);
    marks.extend(severed.map(|g| (g.time, "split complete".to_owned())));
    marks.sort_by(|a, b| a.0.total_cmp(&b.0));
    marks
}

/// As a running session leaves them.
fn traces(recording: &Recording) -> Vec<(f64, [[f64; 2]; 2])> {
    let scenario = &recording.scenario.scenario;
    let every = ((TRACE_EVERY * scenario.loops.haptic_hz).round() as usize).max(1);
    let n = recording.hands[0].len();
    let point = |first: usize| {
        let last = (first + every).min(n);
        let most = |i: usize| {
            let mut most = [0.0_f64; 2];
            for hand in &recording.hands[i][first..last] {
                let (force, torque) = load_on_bone(hand, scenario, i);
                most = [most[0].max(force.norm()), most[1].max(torque.norm())];
            }
            most
        };
        ((last - 1) as f64 * scenario.loops.dt(), [most(0), most(1)])
    };
    (0..n).step_by(every).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::session::{HapticSample, RecordingWriter, ScenarioMessage, tests::hand};

    fn recording(path: &Path, has_bone: bool) {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let first = ScenarioMessage {
            scenario: load(&source, &[], Path::new("/")).unwrap(),
            patient_digest: "abc".into(),
            mode: "lockstep".into(),
            start: None,
            retried: None,
        };
        let mut writer = RecordingWriter::create(path, &first).unwrap();
        for step in 0..1000u64 {
            let mut hands = [hand(step as f64), hand(0.0)];
            hands[0].contacts = u32::from(step >= 300);
            hands[1].contacts = 0;
            let time = step as f64 * 1e-3;
            writer.haptic(&HapticSample { step, time, hands }).unwrap();
            if has_bone && step % 100 == 0 {
                let x_um = vec![step as i32];
                let bone = BoneSample {
                    time,
                    generation: 0,
                    x_um,
                };
                writer.bone(&bone).unwrap();
            }
        }
        writer.event(0.5, "paused").unwrap();
        writer.finish().unwrap();
    }

    #[test]
    fn a_recording_is_scrubbed_played_and_gone_on_from() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        recording(&path, true);
        let mut back = LookBack::read(&path).unwrap();
        assert_eq!(back.lasts, 1.0);
        assert!(back.go_to(0.45) && !back.go_to(0.45));
        let live = SharedLive::default();
        back.show(&live);
        {
            let live = look(&live);
            assert_eq!(live.bone.as_ref().unwrap().x_um, [400]);
            assert_eq!(live.hands.unwrap().step, 450);
            assert_eq!(live.traces.len(), 22);
            assert_eq!(live.events.len(), 1, "the touch, not yet the pause");
        }
        assert_eq!((back.mark(false), back.mark(true)), (Some(0.3), Some(0.5)));
        assert_eq!(back.moment().unwrap().steps, 450);
        back.is_playing = true;
        back.speed = 0.5;
        assert!(back.tick(0.1) && (back.time - 0.5).abs() < 1e-12);
        assert!(back.tick(9.0) && back.time == 1.0 && !back.is_playing);
        assert!(!back.tick(1.0));
        back.go_to(0.0);
        assert!(
            back.moment()
                .err()
                .unwrap()
                .to_string()
                .contains("no moment at 0")
        );
    }

    #[test]
    fn what_cannot_be_looked_at_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bare.mcap");
        recording(&path, false);
        let told = LookBack::read(&path).err().unwrap().to_string();
        assert!(
            told.contains("bare.mcap") && told.contains("not recorded"),
            "{told}"
        );
    }
}
