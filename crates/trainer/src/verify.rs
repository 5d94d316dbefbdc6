//! A recomputed session held against its recording.
use crate::loops::Sink;
use crate::retry::Schedule;
use crate::session::{
    Digest, GrowthSample, HandSample, HapticSample, Loop, MainSample, Pace, Recording, StepTime,
};
use anyhow::Result;

/// The largest deviations so far. A NaN on either side counts as infinite.
pub struct Comparison<'a> {
    recording: &'a Recording,
    /// Tool position \[mm\], tool rotation \[rad\], force \[N\], torque \[N mm\] at the device.
    worst: [f64; 4],
    steps: usize,
    digest: Digest,
    digests: usize,
    main: usize,
    growth: usize,
    different: Vec<String>,
    why_inexact: Option<String>,
}

impl<'a> Comparison<'a> {
    /// Nothing compared yet. The deviation is bounded by 0 where the schedule is known, and not at all otherwise.
    pub fn new(recording: &'a Recording, schedule: &Schedule) -> Self {
        Self {
            recording,
            worst: [0.0; 4],
            steps: 0,
            digest: Digest::default(),
            digests: 0,
            main: 0,
            growth: 0,
            different: vec![],
            why_inexact: schedule.why_unknown().map(str::to_owned),
        }
    }

    fn differs(&mut self, what: String) {
        self.different.push(what);
    }

    fn counts(&self) -> [(&'static str, usize, usize); 3] {
        let r = self.recording;
        [
            ("haptic steps", self.steps, r.hands[0].len()),
            ("main steps", self.main, r.main.len()),
            ("crack generations", self.growth, r.growth.len()),
        ]
    }

    /// Whether nothing differs by as much as a bit. What a recording that breaks off lacks is no difference.
    pub fn is_exact(&self) -> bool {
        let is_whole = !self.recording.is_cut_short;
        let same = self.counts().iter().all(|(_, now, before)| now == before);
        (same || !is_whole) && self.is_exact_so_far()
    }

    fn is_exact_so_far(&self) -> bool {
        self.different.is_empty() && self.worst == [0.0; 4]
    }

    /// What was compared until now, in words.
    pub fn deviation(&self) -> String {
        let [position, rotation, force, torque] = self.worst;
        if self.is_exact_so_far() {
            return "to the last bit".to_owned();
        }
        format!(
            "with tools up to {position:e} mm, {rotation:e} rad and what is displayed {force:e} N, {torque:e} N mm off"
        )
    }

    /// In words.
    pub fn report(&self) -> String {
        let [position, rotation, force, torque] = self.worst;
        let mut lines = vec![format!(
            "Largest deviation over {} haptic steps: tool {position:e} mm, {rotation:e} rad; displayed {force:e} N, {torque:e} N mm.",
            self.steps
        )];
        for (what, now, before) in self.counts() {
            if now != before {
                lines.push(format!("{now} {what}, {before} recorded."));
            }
        }
        if let Some(first) = self.different.first() {
            lines.push(format!(
                "First other difference: {first} ({} in all).",
                self.different.len()
            ));
        }
        if self.is_exact() {
            lines.push("Identical to the last bit.".to_owned());
        }
        lines.push(match &self.why_inexact {
            None => "Bound: 0, the recording says what each step read of the other loops.".to_owned(),
            Some(why) => format!(
                "No bound: {why}. The recording itself is exact: replay, render and report work from it."
            ),
        });
        lines.join("\n")
    }
}

/// Tools and wrenches are recorded rounded, in older recordings to the last bit.
fn deviation(now: &HandSample, before: &HandSample) -> [f64; 4] {
    let exact = difference(now, before);
    if exact == [0.0; 4] {
        return exact;
    }
    difference(&now.rounded(), before)
}

fn difference(now: &HandSample, before: &HandSample) -> [f64; 4] {
    let distance = (now.tool_pose.translation.vector - before.tool_pose.translation.vector).norm();
    let same_rotation = now.tool_pose.rotation.coords == before.tool_pose.rotation.coords;
    // The angle between equal quaternions comes out as 1e-8 by rounding.
    let angle = if same_rotation {
        0.0
    } else {
        now.tool_pose
            .rotation
            .angle_to(&before.tool_pose.rotation)
            .max(f64::MIN_POSITIVE)
    };
    [
        distance,
        angle,
        (now.wrench.force - before.wrench.force).norm(),
        (now.wrench.torque - before.wrench.torque).norm(),
    ]
}

impl Sink for Comparison<'_> {
    fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        for (now, before) in sample.hands.iter().zip(&self.recording.hands) {
            let Some(before) = before.get(self.steps) else {
                continue;
            };
            for (worst, d) in self.worst.iter_mut().zip(deviation(now, before)) {
                *worst = worst.max(if d.is_nan() { f64::INFINITY } else { d });
            }
        }
        self.steps += 1;
        self.digest.take(sample);
        if let Some(before) = self.recording.digests.get(self.digests)
            && before.steps == self.digest.steps
        {
            self.digests += 1;
            if *before != self.digest {
                self.differs(format!("digest of the first {} haptic steps", self.steps));
            }
        }
        Ok(())
    }

    fn main(&mut self, sample: &MainSample) -> Result<()> {
        if let Some(before) = self.recording.main.get(self.main) {
            let key = |m: &MainSample| (m.iterations, m.strain_energy.to_bits(), m.contacts);
            if key(sample) != key(before) {
                self.differs(format!(
                    "main step {}: strain energy {} N mm, recorded {}",
                    self.main, sample.strain_energy, before.strain_energy
                ));
            }
        }
        self.main += 1;
        Ok(())
    }

    fn growth(&mut self, sample: GrowthSample) -> Result<()> {
        if let Some(before) = self.recording.growth.get(self.growth)
            && (sample.vertices != before.vertices || sample.triangles != before.triangles)
        {
            self.differs(format!(
                "crack generation {}: area {} mm2, recorded {}",
                sample.generation, sample.area, before.area
            ));
        }
        self.growth += 1;
        Ok(())
    }

    fn timing(&mut self, _: &StepTime, _: bool) -> Result<()> {
        Ok(())
    }

    fn event(&mut self, _: f64, _: &str) -> Result<()> {
        Ok(())
    }

    fn pace(&mut self, _: Loop, _: Pace) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::session::{RecordingWriter, ScenarioMessage, tests::hand};
    use std::path::Path;

    fn sample(step: u64, off: f64) -> HapticSample {
        let mut hands = [hand(step as f64 / 7.0), hand(0.4)];
        hands[0].tool_pose.translation.vector.x += off;
        let time = step as f64 * 1e-3;
        HapticSample { step, time, hands }
    }

    /// Recorded numbers are rounded; the digest is of what they were.
    #[test]
    fn a_replay_that_is_off_by_less_than_is_recorded_is_not_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let first = ScenarioMessage {
            scenario: load(&source, &[], Path::new("/")).unwrap(),
            patient_digest: String::new(),
            mode: "lockstep".into(),
            start: None,
            retried: None,
        };
        let mut writer = RecordingWriter::create(&path, &first).unwrap();
        (0..100).for_each(|k| writer.haptic(&sample(k, 0.0)).unwrap());
        writer.finish().unwrap();
        let recording = Recording::read(&path).unwrap();
        let schedule = Schedule::of(&recording);
        let compared = |off: f64| {
            let mut comparison = Comparison::new(&recording, &schedule);
            for k in 0..100 {
                let off = if k == 40 { off } else { 0.0 };
                comparison.haptic(&sample(k, off)).unwrap();
            }
            (comparison.is_exact(), comparison.report())
        };
        assert!(compared(0.0).0);
        let (is_exact, told) = compared(1e-12);
        assert!(
            !is_exact && told.contains("digest of the first 100"),
            "{told}"
        );
        let (is_exact, told) = compared(1e-3);
        assert!(!is_exact && !told.contains("tool 0e0 mm"), "{told}");
    }
}
