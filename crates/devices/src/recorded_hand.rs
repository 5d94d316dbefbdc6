use crate::{DeviceFault, HapticDevice, Pose, Reading, Specification, Vec3, Wrench, limited};

/// A recording without a single pose cannot be played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the recording holds no pose")]
pub struct EmptyRecording;

/// Plays recorded poses, one a step, and holds the last. It feels nothing.
#[derive(Clone, Debug)]
pub struct RecordedHand {
    specification: Specification,
    poses: Vec<(Pose, u32)>,
    next: usize,
    dt: f64,
    displayed: Wrench,
}

impl RecordedHand {
    /// A hand that plays `poses` (each with its button bits), one every `dt` \[s\].
    ///
    /// # Errors
    /// [`EmptyRecording`].
    pub fn new(
        poses: Vec<(Pose, u32)>,
        dt: f64,
        specification: Specification,
    ) -> Result<Self, EmptyRecording> {
        if poses.is_empty() {
            return Err(EmptyRecording);
        }
        Ok(Self {
            specification,
            poses,
            next: 0,
            dt,
            displayed: Wrench::default(),
        })
    }

    /// Plays from the beginning again.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    /// Steps that are left to play.
    pub fn n_left(&self) -> usize {
        self.poses.len() - self.next
    }

    /// The pose read last.
    pub fn pose(&self) -> Pose {
        self.poses[self.next.saturating_sub(1)].0
    }

    /// The wrench displayed last.
    pub fn displayed(&self) -> Wrench {
        self.displayed
    }
}

impl HapticDevice for RecordedHand {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self) -> Reading {
        let at = self.next.min(self.poses.len() - 1);
        let (pose, buttons) = self.poses[at];
        let before = self.poses[at.saturating_sub(1)].0;
        let reading = Reading {
            pose,
            velocity: (pose.translation.vector - before.translation.vector) / self.dt,
            angular_velocity: turned(&before, &pose) / self.dt,
            buttons,
            time: at as f64 * self.dt,
        };
        self.next = (at + 1).min(self.poses.len());
        reading
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault> {
        self.displayed = Wrench::default();
        self.displayed = limited(wrench, &self.specification)?;
        Ok(())
    }
}

fn turned(before: &Pose, after: &Pose) -> Vec3 {
    (after.rotation * before.rotation.inverse()).scaled_axis()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated_hand::HandParameters;

    fn specification() -> Specification {
        HandParameters::default().specification()
    }

    #[test]
    fn plays_in_order_and_holds_the_last() {
        let poses = (0..3).map(|i| (Pose::translation(f64::from(i), 0.0, 0.0), i as u32));
        let mut hand = RecordedHand::new(poses.collect(), 1e-3, specification()).unwrap();
        let seen: Vec<_> = (0..5).map(|_| hand.read()).collect();
        let x: Vec<_> = seen.iter().map(|r| r.pose.translation.x).collect();
        assert_eq!(x, [0.0, 1.0, 2.0, 2.0, 2.0]);
        assert_eq!(seen[2].buttons, 2);
        assert!((seen[1].velocity.x - 1000.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_to_play_is_refused() {
        assert!(RecordedHand::new(vec![], 1e-3, specification()).is_err());
    }
}
