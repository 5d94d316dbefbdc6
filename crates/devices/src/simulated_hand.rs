use crate::{DeviceFault, HapticDevice, Pose, Reading, Specification, Vec3, Wrench, limited};
use nalgebra::UnitQuaternion;

/// A hand holding a handle: mass, spring and damper in six degrees of freedom, and the device it holds.
///
/// Ranges for translation from human studies: mass .05-.2 kg, damping 2-10 N s/m, stiffness 100-1000 N/m. The
/// rotational values are chosen alike (natural frequency about 140 rad/s, damping .7 of critical).
#[derive(Clone, Debug, PartialEq)]
pub struct HandParameters {
    /// Mass \[kg\].
    pub mass: f64,
    /// Damping \[N s/m\].
    pub damping: f64,
    /// Stiffness \[N/m = 1e-3 N/mm\].
    pub stiffness: f64,
    /// Moment of inertia \[kg m2\], the same about every axis.
    pub inertia: f64,
    /// Rotational damping \[N m s/rad\].
    pub angular_damping: f64,
    /// Rotational stiffness \[N m/rad\].
    pub angular_stiffness: f64,
    /// Largest force the device displays \[N\].
    pub max_force: f64,
    /// Largest torque the device displays \[N mm\].
    pub max_torque: f64,
}

impl Default for HandParameters {
    /// Limits: Phantom Premium 1.5/6DOF, the paper's device (8.5 N, .188 N m).
    fn default() -> Self {
        Self {
            mass: 0.1,
            damping: 5.0,
            stiffness: 500.0,
            inertia: 1e-4,
            angular_damping: 0.02,
            angular_stiffness: 2.0,
            max_force: 8.5,
            max_torque: 188.0,
        }
    }
}

impl HandParameters {
    /// What a hand with these parameters shows as its device.
    pub fn specification(&self) -> Specification {
        Specification {
            model: "simulated".to_owned(),
            serial: String::new(),
            max_force: self.max_force,
            max_torque: self.max_torque,
            dofs_in: 6,
            dofs_out: 6,
            ..Specification::default()
        }
    }
}

/// Why a hand was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadHand {
    /// A parameter must be above zero.
    #[error("hand.{name} is {value}; it must be a finite number above 0")]
    NotPositive {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The step is too long for the stiffness.
    #[error(
        "the hand's {motion} is too stiff or too strongly damped for a step of {dt} s; it must satisfy 2 b dt + k dt^2 < 4 m"
    )]
    Unstable {
        /// Translation or rotation.
        motion: &'static str,
        /// The step \[s\].
        dt: f64,
    },
}

const MM: f64 = 1e-3; // m

/// Follows a target pose as a hand would, and gives way to the displayed wrench.
///
/// One [`read`](HapticDevice::read), one [`write`](HapticDevice::write) a step; `write` advances the hand by `dt` with
/// semi-implicit Euler: velocities first, then the pose. Deterministic; allocates nothing after [`new`](Self::new).
#[derive(Clone, Debug)]
pub struct SimulatedHand {
    specification: Specification,
    parameters: HandParameters,
    dt: f64,
    time: f64,
    target: Pose,
    target_before: Pose,
    pose: Pose,
    velocity: Vec3,
    angular_velocity: Vec3,
}

impl SimulatedHand {
    /// A hand at rest at `pose`, advanced by `dt` \[s\] a step.
    ///
    /// # Errors
    /// [`BadHand`] for a parameter that is not positive, or a step too long for the integration to stay stable.
    pub fn new(parameters: HandParameters, pose: Pose, dt: f64) -> Result<Self, BadHand> {
        let p = &parameters;
        for (name, value) in [
            ("mass", p.mass),
            ("damping", p.damping),
            ("stiffness", p.stiffness),
            ("inertia", p.inertia),
            ("angular_damping", p.angular_damping),
            ("angular_stiffness", p.angular_stiffness),
            ("max_force", p.max_force),
            ("max_torque", p.max_torque),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(BadHand::NotPositive { name, value });
            }
        }
        // Semi-implicit Euler with an explicit damper on m x'' + b x' + k x is stable for 2 b dt + k dt^2 < 4 m.
        let stable = |m: f64, b: f64, k: f64| 2.0 * b * dt + k * dt * dt < 4.0 * m;
        for (motion, [m, b, k]) in [
            ("translation", [p.mass, p.damping, p.stiffness]),
            (
                "rotation",
                [p.inertia, p.angular_damping, p.angular_stiffness],
            ),
        ] {
            if !stable(m, b, k) {
                return Err(BadHand::Unstable { motion, dt });
            }
        }
        Ok(Self {
            specification: parameters.specification(),
            parameters,
            dt,
            time: 0.0,
            target: pose,
            target_before: pose,
            pose,
            velocity: Vec3::zeros(),
            angular_velocity: Vec3::zeros(),
        })
    }

    /// Where the hand wants to be at the end of the next step.
    pub fn follow(&mut self, target: Pose) {
        self.target = target;
    }

    /// Advances one step under `felt`. Damping acts against the motion relative to the target's, so that a hand that
    /// follows a steady motion does not lag behind.
    fn advance(&mut self, felt: &Wrench) {
        let p = &self.parameters;
        let dt = self.dt;
        let toward = (self.target_before.translation.vector - self.pose.translation.vector) * MM;
        let target_velocity =
            (self.target.translation.vector - self.target_before.translation.vector) * (MM / dt);
        let force =
            felt.force + p.stiffness * toward + p.damping * (target_velocity - self.velocity * MM);
        self.velocity += force * (dt / p.mass / MM);
        self.pose.translation.vector += self.velocity * dt;

        let turn = (self.target_before.rotation * self.pose.rotation.inverse()).scaled_axis();
        let target_spin =
            (self.target.rotation * self.target_before.rotation.inverse()).scaled_axis() / dt;
        let torque = felt.torque * MM
            + p.angular_stiffness * turn
            + p.angular_damping * (target_spin - self.angular_velocity);
        self.angular_velocity += torque * (dt / p.inertia);
        self.pose.rotation =
            UnitQuaternion::from_scaled_axis(self.angular_velocity * dt) * self.pose.rotation;
        self.pose.rotation.renormalize();

        self.target_before = self.target;
        self.time += dt;
    }
}

impl HapticDevice for SimulatedHand {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self) -> Reading {
        Reading {
            pose: self.pose,
            velocity: self.velocity,
            angular_velocity: self.angular_velocity,
            buttons: 0,
            time: self.time,
        }
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault> {
        let felt = limited(wrench, &self.specification);
        self.advance(&felt.unwrap_or_default());
        felt.map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    fn hand() -> SimulatedHand {
        SimulatedHand::new(HandParameters::default(), Pose::identity(), DT).unwrap()
    }

    fn pose(x: f64, angle: f64) -> Pose {
        Pose::new(Vec3::new(x, 0.0, 0.0), Vec3::new(0.0, 0.0, angle))
    }

    fn settle(hand: &mut SimulatedHand, target: Pose, wrench: &Wrench) -> Pose {
        hand.follow(target);
        for _ in 0..3000 {
            hand.write(wrench).unwrap();
        }
        hand.read().pose
    }

    #[test]
    fn settles_at_the_target() {
        let end = settle(&mut hand(), pose(12.0, 0.6), &Wrench::default());
        assert!((end.translation.x - 12.0).abs() < 1e-9);
        assert!(end.rotation.angle_to(&pose(12.0, 0.6).rotation) < 1e-9);
    }

    /// F / k: 5 N on 500 N/m is 10 mm; 100 N mm on 2 N m/rad is .05 rad.
    #[test]
    fn gives_way_by_force_over_stiffness() {
        let wrench = Wrench {
            force: Vec3::new(0.0, 5.0, 0.0),
            torque: Vec3::new(0.0, 0.0, 100.0),
        };
        let end = settle(&mut hand(), Pose::identity(), &wrench);
        assert!((end.translation.y - 10.0).abs() < 1e-9);
        assert!((end.rotation.scaled_axis().z - 0.05).abs() < 1e-9);
    }

    #[test]
    fn never_feels_more_than_the_device_displays() {
        let wrench = Wrench {
            force: Vec3::new(-1e6, 0.0, 0.0),
            torque: Vec3::zeros(),
        };
        let end = settle(&mut hand(), Pose::identity(), &wrench);
        assert!((end.translation.x + 17.0).abs() < 1e-9, "8.5 N on 500 N/m");
    }

    #[test]
    fn a_steady_motion_is_followed_without_lag() {
        let mut hand = hand();
        for i in 1..=3000 {
            hand.follow(pose(0.01 * f64::from(i), 0.0));
            hand.write(&Wrench::default()).unwrap();
        }
        assert!((hand.read().pose.translation.x - 30.0).abs() < 1e-6);
    }

    #[test]
    fn a_fault_displays_zero() {
        let mut hand = hand();
        let bad = Wrench {
            force: Vec3::new(f64::NAN, 0.0, 0.0),
            torque: Vec3::zeros(),
        };
        assert_eq!(hand.write(&bad), Err(DeviceFault::NotFinite));
        assert_eq!(hand.read().pose, Pose::identity());
    }

    #[test]
    fn the_same_input_gives_the_same_bits() {
        let run = || {
            let mut hand = hand();
            for i in 0..500 {
                hand.follow(pose(f64::from(i % 37), f64::from(i % 11) * 0.05));
                let force = Vec3::new(f64::from(i % 5), 1.0, -0.3);
                let torque = Vec3::new(0.0, f64::from(i % 7), 3.0);
                hand.write(&Wrench { force, torque }).unwrap();
            }
            let r = hand.read();
            let q = r.pose.rotation.coords;
            [
                r.pose.translation.x,
                r.pose.translation.y,
                q.x,
                q.y,
                q.z,
                q.w,
            ]
            .map(f64::to_bits)
        };
        assert_eq!(run(), run());
    }

    #[test]
    fn bad_parameters_are_named() {
        let with = |f: fn(&mut HandParameters)| {
            let mut p = HandParameters::default();
            f(&mut p);
            SimulatedHand::new(p, Pose::identity(), DT)
                .unwrap_err()
                .to_string()
        };
        assert!(with(|p| p.mass = -1.0).contains("hand.mass is -1"));
        assert!(with(|p| p.stiffness = 1e9).contains("translation"));
    }
}
