//! From a device's workspace to the world and back.
use crate::{Pose, Vec3, Wrench};
use nalgebra::{Quaternion, UnitQuaternion};

/// How a device's workspace lies in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Workspace {
    /// Where the tool is, and how it lies, with the handle untouched: the session's start.
    pub start: Pose,
    /// World mm a device mm.
    pub scale: f64,
    /// Turns the device's frame into the world.
    pub rotation: UnitQuaternion<f64>,
    /// Turns the tool within the handle.
    pub handle: UnitQuaternion<f64>,
    /// Swaps the user's left and right.
    pub is_mirrored: bool,
    /// The button (0 the first) that lets the tool stand while it is held down.
    pub clutch: Option<u8>,
    /// For a device without torque: shows the torque across the tool's shaft as a force at this lever \[mm\].
    pub torque_lever: Option<f64>,
}

impl Workspace {
    /// Unscaled, upright, without clutch.
    pub fn at(start: Pose) -> Self {
        Self {
            start,
            scale: 1.0,
            rotation: UnitQuaternion::identity(),
            handle: UnitQuaternion::identity(),
            is_mirrored: false,
            clutch: None,
            torque_lever: None,
        }
    }

    /// A length or velocity of the device in the world.
    pub(crate) fn vector(&self, v: &Vec3) -> Vec3 {
        self.rotation * self.mirrored(v) * self.scale
    }

    /// A turn (or angular velocity) of the device in the world.
    pub(crate) fn turn(&self, v: &Vec3) -> Vec3 {
        self.rotation * self.mirrored_axial(v)
    }

    /// How the tool lies in the world for an orientation of the handle.
    pub(crate) fn orientation(&self, handle: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        let q = if self.is_mirrored {
            // A reflection of x keeps turns about x and reverses the others.
            let c = handle.quaternion();
            UnitQuaternion::new_unchecked(Quaternion::new(c.w, c.i, -c.j, -c.k))
        } else {
            *handle
        };
        self.rotation * q * self.rotation.inverse() * self.start.rotation * self.handle
    }

    /// A wrench of the world in the device's frame; `tool`: how the tool lies in the world.
    pub(crate) fn wrench(&self, world: &Wrench, tool: &UnitQuaternion<f64>) -> Wrench {
        let leverage = self.torque_lever.map_or_else(Vec3::zeros, |lever| {
            let to_hand = tool * -Vec3::z();
            world.torque.cross(&to_hand) / lever
        });
        let back = self.rotation.inverse();
        Wrench {
            force: self.mirrored(&(back * (world.force + leverage))),
            torque: self.mirrored_axial(&(back * world.torque)),
        }
    }

    fn mirrored(&self, v: &Vec3) -> Vec3 {
        let side = if self.is_mirrored { -1.0 } else { 1.0 };
        Vec3::new(side * v.x, v.y, v.z)
    }

    fn mirrored_axial(&self, v: &Vec3) -> Vec3 {
        let side = if self.is_mirrored { -1.0 } else { 1.0 };
        Vec3::new(v.x, side * v.y, side * v.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skew() -> Workspace {
        Workspace {
            scale: 2.0,
            rotation: UnitQuaternion::from_euler_angles(0.3, -1.1, 0.7),
            handle: UnitQuaternion::from_euler_angles(-0.2, 0.5, 1.9),
            is_mirrored: true,
            ..Workspace::at(Pose::rotation(Vec3::new(0.8, 0.1, -0.4)))
        }
    }

    /// Virtual work: the power of the wrench in the world is that at the device times the scale of lengths.
    #[test]
    fn force_and_motion_are_dual() {
        let w = skew();
        let (v, f) = (Vec3::new(0.3, -2.0, 1.0), Vec3::new(1.0, 0.5, -0.7));
        let (spin, torque) = (Vec3::new(-1.0, 0.2, 0.4), Vec3::new(3.0, -2.0, 0.9));
        let world = Wrench { force: f, torque };
        let device = w.wrench(&world, &UnitQuaternion::identity());
        assert!((w.vector(&v).dot(&f) - 2.0 * v.dot(&device.force)).abs() < 1e-12);
        assert!((w.turn(&spin).dot(&torque) - spin.dot(&device.torque)).abs() < 1e-12);
    }

    /// The orientation's rate of change is the mapped angular velocity.
    #[test]
    fn orientation_turns_by_the_mapped_spin() {
        let w = skew();
        let q = UnitQuaternion::from_euler_angles(0.4, 0.1, -0.9);
        let spin = Vec3::new(0.5, -0.3, 0.8);
        let eps = 1e-6;
        let next = UnitQuaternion::from_scaled_axis(spin * eps) * q;
        let rate = (w.orientation(&next) * w.orientation(&q).inverse()).scaled_axis() / eps;
        assert!((rate - w.turn(&spin)).norm() < 1e-5);
    }

    /// By hand: x right, y away, z up; a device turned by 90 degrees about z, its x to the world's y.
    #[test]
    fn turned_and_mirrored_devices_go_where_they_should() {
        let quarter = UnitQuaternion::from_euler_angles(0.0, 0.0, 90_f64.to_radians());
        let turned = Workspace {
            rotation: quarter,
            scale: 3.0,
            ..Workspace::at(Pose::identity())
        };
        assert!((turned.vector(&Vec3::x()) - 3.0 * Vec3::y()).norm() < 1e-12);
        let pitch = UnitQuaternion::from_euler_angles(0.2, 0.0, 0.0);
        let roll = UnitQuaternion::from_euler_angles(0.0, 0.2, 0.0);
        assert!(turned.orientation(&pitch).angle_to(&roll) < 1e-12);
        // What the world pushes along y is felt along the device's x.
        let push = Wrench {
            force: Vec3::y(),
            torque: 5.0 * Vec3::y(),
        };
        let felt = turned.wrench(&push, &UnitQuaternion::identity());
        assert!((felt.force - Vec3::x()).norm() < 1e-12);
        assert!((felt.torque - 5.0 * Vec3::x()).norm() < 1e-12);

        // In the other hand: right is left, a turn to the right one to the left, nodding stays nodding.
        let mirrored = Workspace {
            is_mirrored: true,
            ..Workspace::at(Pose::identity())
        };
        let moved = mirrored.vector(&Vec3::new(1.0, 2.0, 3.0));
        assert_eq!(moved, Vec3::new(-1.0, 2.0, 3.0));
        assert!(mirrored.orientation(&pitch).angle_to(&pitch) < 1e-12);
        assert!(mirrored.orientation(&quarter).angle_to(&quarter.inverse()) < 1e-12);
        let felt = mirrored.wrench(&push, &UnitQuaternion::identity());
        assert_eq!((felt.force, felt.torque), (Vec3::y(), -5.0 * Vec3::y()));
    }

    #[test]
    fn an_untouched_handle_lies_as_the_start_and_the_offset_say() {
        let w = skew();
        let lies = w.orientation(&UnitQuaternion::identity());
        assert!(lies.angle_to(&(w.start.rotation * w.handle)) < 1e-12);
    }

    #[test]
    fn torque_across_the_shaft_is_shown_as_a_force_and_twist_is_not() {
        let mut w = Workspace::at(Pose::identity());
        w.torque_lever = Some(50.0);
        let at = |torque| {
            let world = Wrench {
                force: Vec3::zeros(),
                torque,
            };
            w.wrench(&world, &UnitQuaternion::identity()).force
        };
        let torque = Vec3::new(100.0, -30.0, 0.0);
        let hand = -50.0 * Vec3::z();
        assert!((hand.cross(&at(torque)) - torque).norm() < 1e-9);
        assert_eq!(at(Vec3::new(0.0, 0.0, 500.0)), Vec3::zeros());
    }
}
