//! A recomputed session held against its recording.
use crate::loops::Sink;
use crate::session::{
    GrowthSample, HandSample, HapticSample, Loop, MainSample, Pace, Recording, StepTime,
};
use anyhow::Result;

/// The largest deviations so far. A NaN on either side counts as infinite.
pub struct Comparison<'a> {
    recording: &'a Recording,
    /// Tool position \[mm\], tool rotation \[rad\], force \[N\], torque \[N mm\] at the device.
    worst: [f64; 4],
    steps: usize,
    main: usize,
    growth: usize,
    different: Vec<String>,
}

/// What may be expected of a session against the clock.
const TOLERANCE: &str = "Recorded in real time: its loops read each other's states at moments that lockstep does not repeat, so the \
    deviation has no bound, least of all once the crack has grown otherwise. The recording itself is exact: replay, render and report work from it.";

impl<'a> Comparison<'a> {
    /// Nothing compared yet.
    pub fn new(recording: &'a Recording) -> Self {
        Self {
            recording,
            worst: [0.0; 4],
            steps: 0,
            main: 0,
            growth: 0,
            different: vec![],
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

    /// Whether nothing differs by as much as a bit.
    pub fn is_exact(&self) -> bool {
        let same = self.counts().iter().all(|(_, now, before)| now == before);
        same && self.different.is_empty() && self.worst == [0.0; 4]
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
        } else if self.recording.scenario.mode == "realtime" {
            lines.push(TOLERANCE.to_owned());
        }
        lines.join("\n")
    }
}

fn deviation(now: &HandSample, before: &HandSample) -> [f64; 4] {
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
