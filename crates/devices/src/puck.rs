//! Input without force whose deflection is a velocity: SpaceMouse, gamepad.
use crate::{Pose, Reading, Vec3};
use nalgebra::UnitQuaternion;

/// Half of the box that a puck's handle stays in \[mm\].
const REACH: f64 = 100.0;

/// A handle moved by velocities.
#[derive(Default)]
pub(crate) struct Puck {
    reading: Reading,
}

impl Puck {
    /// Moves on by `dt` \[s\] at `velocity` \[mm/s\] and `spin` \[rad/s\].
    pub(crate) fn advance(&mut self, velocity: Vec3, spin: Vec3, buttons: u32, dt: f64) -> Reading {
        let Pose {
            translation,
            rotation,
        } = self.reading.pose;
        let place = (translation.vector + velocity * dt).map(|c| c.clamp(-REACH, REACH));
        let mut turn = UnitQuaternion::from_scaled_axis(spin * dt) * rotation;
        turn.renormalize();
        self.reading = Reading {
            pose: Pose::from_parts(place.into(), turn),
            velocity,
            angular_velocity: spin,
            buttons,
            time: 0.0,
        };
        self.reading
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_moves_and_stays_within_reach() {
        let mut puck = Puck::default();
        for _ in 0..1000 {
            puck.advance(
                Vec3::new(1.0, 500.0, 0.0),
                Vec3::new(0.0, 0.0, 0.5),
                2,
                1e-3,
            );
        }
        let end = puck.advance(Vec3::zeros(), Vec3::zeros(), 2, 1e-3);
        assert!((end.pose.translation.vector - Vec3::new(1.0, 100.0, 0.0)).norm() < 1e-9);
        assert!((end.pose.rotation.scaled_axis().z - 0.5).abs() < 1e-9);
    }
}
