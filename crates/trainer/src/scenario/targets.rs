//! `[targets]`: what a debrief scores.
use serde::{Deserialize, Serialize};

/// One line of the rubric: all points up to `good`, none from `bad` on, in proportion between them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// All points here, and beyond it away from `bad`.
    pub good: f64,
    /// No points here, and beyond it.
    pub bad: f64,
    /// Points to be had; 0 leaves the line out.
    pub weight: f64,
}

impl Target {
    const fn new(good: f64, bad: f64, weight: f64) -> Self {
        Self { good, bad, weight }
    }

    /// Share of the points for a value.
    pub fn share(&self, value: f64) -> f64 {
        ((value - self.bad) / (self.good - self.bad)).clamp(0.0, 1.0)
    }
}

/// The rubric. The thresholds shipped are assumptions to start from, not validated ones; a training centre sets its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Targets {
    /// Points for a split that is complete.
    pub complete: f64,
    /// Points for a split that is none of the published bad types.
    pub no_bad_split: f64,
    /// Mean distance of the broken face from the planned sagittal plane \[mm\].
    pub path_deviation: Target,
    /// Smallest distance of tools and crack to the canal's wall \[mm\]; below 0 within it.
    pub nerve_distance: Target,
    /// Largest stretch of the nerve's line over 10 mm.
    pub nerve_stretch: Target,
    /// Share of the canal that stays with the tooth-bearing fragment.
    pub nerve_kept: Target,
    /// How far an edge went on into the bone after the break \[mm\].
    pub overshoot: Target,
    /// Tool slips.
    pub slips: Target,
    /// Time in contact with teeth \[s\].
    pub teeth: Target,
    /// Smaller over larger impulse of the hands.
    pub balance: Target,
    /// Time until the split \[s\].
    pub time: Target,
    /// Largest force of either hand on the bone \[N\]; also what the coach shows.
    pub peak_force: Target,
    /// Likewise torque \[N mm\].
    pub peak_torque: Target,
    /// Path of both edges together \[mm\].
    pub path_length: Target,
    /// Spectral arc length of the less smooth hand.
    pub smoothness: Target,
}

impl Default for Targets {
    fn default() -> Self {
        Self {
            complete: 20.0,
            no_bad_split: 20.0,
            path_deviation: Target::new(3.0, 10.0, 10.0),
            nerve_distance: Target::new(1.0, 0.0, 10.0),
            nerve_stretch: Target::new(0.05, 0.20, 5.0),
            nerve_kept: Target::new(1.0, 0.5, 5.0),
            overshoot: Target::new(2.0, 10.0, 10.0),
            slips: Target::new(0.0, 3.0, 5.0),
            teeth: Target::new(0.0, 1.0, 3.0),
            balance: Target::new(0.7, 0.2, 3.0),
            time: Target::new(60.0, 300.0, 3.0),
            peak_force: Target::new(200.0, 500.0, 0.0),
            peak_torque: Target::new(16_000.0, 20_000.0, 0.0),
            path_length: Target::new(300.0, 2000.0, 3.0),
            smoothness: Target::new(-3.0, -12.0, 3.0),
        }
    }
}

impl Targets {
    /// The lines with a scale, by key.
    pub fn scaled(&self) -> [(&'static str, Target); 13] {
        [
            ("path_deviation", self.path_deviation),
            ("nerve_distance", self.nerve_distance),
            ("nerve_stretch", self.nerve_stretch),
            ("nerve_kept", self.nerve_kept),
            ("overshoot", self.overshoot),
            ("slips", self.slips),
            ("teeth", self.teeth),
            ("balance", self.balance),
            ("time", self.time),
            ("peak_force", self.peak_force),
            ("peak_torque", self.peak_torque),
            ("path_length", self.path_length),
            ("smoothness", self.smoothness),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_go_in_proportion_either_way_round() {
        let falling = Target::new(2.0, 10.0, 10.0);
        assert_eq!(
            [1.0, 2.0, 6.0, 10.0, 11.0].map(|v| falling.share(v)),
            [1.0, 1.0, 0.5, 0.0, 0.0]
        );
        let rising = Target::new(1.0, 0.0, 10.0);
        assert_eq!([-1.0, 0.25, 2.0].map(|v| rising.share(v)), [0.0, 0.25, 1.0]);
    }
}
