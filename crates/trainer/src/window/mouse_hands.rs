//! Mouse and keyboard as hands: where a trainee without a device wants the chisels.
use crate::loops::Published;
use nalgebra::UnitQuaternion;
use osteotome_mechanics::geometry::{Pose, Vec3};

/// Which chisel the mouse holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Held {
    /// None: the mouse turns the view.
    #[default]
    None,
    /// The left hand's.
    Left,
    /// The right hand's.
    Right,
    /// Both; the right does the mirror image of the left.
    Both,
}

/// A wish to move, in one frame of the window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// To the right and up in the picture \[mm\].
    pub in_view: [f64; 2],
    /// Along the blade, into the bone \[mm\].
    pub drive: f64,
    /// About the blade's own axis \[rad\].
    pub twist: f64,
    /// About the blade's width and thickness: prying \[rad\].
    pub lever: [f64; 2],
}

/// A hand goes no farther than this ahead of its chisel \[mm\]: the device is at its limit long before.
const MOST_AHEAD: f64 = 40.0;

/// Both hands.
pub struct MouseHands {
    /// Which moves.
    pub held: Held,
    guides: [Option<Published<Pose>>; 2],
    targets: [Pose; 2],
    start: [Pose; 2],
}

impl MouseHands {
    /// Of a session that begins at `start`, with the ends of those hands that are the user's.
    pub fn new(guides: [Option<Published<Pose>>; 2], start: [Pose; 2]) -> Self {
        let held = match guides.each_ref().map(Option::is_some) {
            [true, true] => Held::Both,
            [true, false] => Held::Left,
            [false, true] => Held::Right,
            [false, false] => Held::None,
        };
        Self {
            held,
            guides,
            targets: start,
            start,
        }
    }

    /// Whether the user leads a hand at all.
    pub fn leads_any(&self) -> bool {
        self.guides.iter().any(Option::is_some)
    }

    /// Takes hold of a chisel, as far as it is the user's.
    pub fn hold(&mut self, held: Held) {
        let [left, right] = self.guides.each_ref().map(Option::is_some);
        let may = match held {
            Held::None => true,
            Held::Left => left,
            Held::Right => right,
            Held::Both => left && right,
        };
        if may {
            self.held = held;
        }
    }

    fn holds(&self, i: usize) -> bool {
        match self.held {
            Held::None => false,
            Held::Left => i == 0,
            Held::Right => i == 1,
            Held::Both => true,
        }
    }

    /// Moves what is held; `axes`: right, up and forward of the picture; `tools`: where the chisels are.
    pub fn go(&mut self, motion: &Motion, axes: &[Vec3; 3], tools: Option<[Pose; 2]>) {
        for i in 0..2 {
            if !self.holds(i) {
                continue;
            }
            // The second of two hands mirrors the first.
            let side = if self.held == Held::Both && i == 1 {
                -1.0
            } else {
                1.0
            };
            let target = &mut self.targets[i];
            let [right, up] = motion.in_view;
            let own = target.rotation;
            target.translation.vector +=
                axes[0] * (side * right) + axes[1] * up + own * Vec3::z() * motion.drive;
            let [about_x, about_y] = motion.lever;
            let turn = Vec3::new(side * about_x, side * about_y, side * motion.twist);
            target.rotation = own * UnitQuaternion::from_scaled_axis(turn);
            if let Some(tools) = tools {
                let from = tools[i].translation.vector;
                let ahead = target.translation.vector - from;
                target.translation.vector = from + ahead.cap_magnitude(MOST_AHEAD);
            }
        }
        self.publish();
    }

    /// Brings what is held back to where it began.
    pub fn go_back(&mut self) {
        for i in 0..2 {
            if self.holds(i) {
                self.targets[i] = self.start[i];
            }
        }
        self.publish();
    }

    fn publish(&mut self) {
        for (guide, target) in self.guides.iter_mut().zip(self.targets) {
            if let Some(guide) = guide {
                guide.write(target);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loops::latest;

    #[test]
    fn one_hand_moves_alone_and_both_mirror_each_other() {
        let start = [-5.0, 5.0].map(|x| Pose::translation(x, 0.0, 0.0));
        let (left, mut sees_left) = latest(&start[0]);
        let (right, mut sees_right) = latest(&start[1]);
        let mut hands = MouseHands::new([Some(left), Some(right)], start);
        assert_eq!(hands.held, Held::Both);
        let axes = [Vec3::x(), Vec3::z(), Vec3::y()];
        let motion = Motion {
            in_view: [1.0, 2.0],
            drive: 3.0,
            twist: 0.1,
            ..Motion::default()
        };
        hands.go(&motion, &axes, None);
        let [a, b] = [*sees_left.read(), *sees_right.read()];
        assert_eq!(a.translation.vector, Vec3::new(-4.0, 0.0, 5.0));
        assert_eq!(b.translation.vector, Vec3::new(4.0, 0.0, 5.0));
        assert!((a.rotation.scaled_axis() + b.rotation.scaled_axis()).norm() < 1e-12);
        hands.hold(Held::Right);
        hands.go(&motion, &axes, Some(start));
        assert_eq!(*sees_left.read(), a);
        assert_ne!(*sees_right.read(), b);
        hands.go_back();
        assert_eq!(*sees_right.read(), start[1]);
    }

    #[test]
    fn only_the_users_hands_can_be_held_and_none_runs_away() {
        let start = [Pose::identity(); 2];
        let (left, mut sees) = latest(&start[0]);
        let mut hands = MouseHands::new([Some(left), None], start);
        assert!(hands.leads_any());
        hands.hold(Held::Both);
        assert_eq!(hands.held, Held::Left);
        let motion = Motion {
            drive: 500.0,
            ..Motion::default()
        };
        hands.go(&motion, &[Vec3::x(), Vec3::y(), Vec3::z()], Some(start));
        assert_eq!(sees.read().translation.vector.norm(), MOST_AHEAD);
    }
}
