//! The guided first run: one thing after another, each done by the trainee's own doing.
use super::live::Live;
use osteotome_mechanics::geometry::{Pose, Vec3};

/// What the guide sees of a frame.
pub struct Sight<'a> {
    /// Whether a session runs.
    pub is_running: bool,
    /// Whether a chisel is held, be it by the mouse or by a device.
    pub holds: bool,
    /// The session.
    pub live: &'a Live,
}

/// A thing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lesson {
    /// Begin.
    Start,
    /// Take hold of a chisel.
    Hold,
    /// Touch the bone.
    Touch,
    /// Go in.
    Drive,
    /// Turn.
    Twist,
    /// Let the crack grow.
    Crack,
    /// Bring the split to its end.
    Split,
    /// Come out.
    Withdraw,
    /// All is done.
    Done,
}

/// So far a blade goes in before the next lesson \[mm\], turns \[rad\], and comes out at the end \[mm\].
const DEPTH: f64 = 2.0;
const TURN: f64 = 0.087;
const OUT: f64 = 5.0;

impl Lesson {
    /// In their order.
    pub const ALL: [Self; 8] = [
        Self::Start,
        Self::Hold,
        Self::Touch,
        Self::Drive,
        Self::Twist,
        Self::Crack,
        Self::Split,
        Self::Withdraw,
    ];

    /// What is to be done, in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Start => "Press Start, or the space bar. Nothing can be hurt; F5 begins anew.",
            Self::Hold => {
                "Take hold: 1 the left chisel, 2 the right, 3 both mirrored. Under Hands, a hand must be led by mouse or device."
            }
            Self::Touch => "Drive the blade down with W or the wheel until it touches the bone.",
            Self::Drive => {
                "Go on until the edge is 2 mm deep in the slit. Force shows on the right."
            }
            Self::Twist => "Twist the blade by 5 degrees with A or D, or Shift and drag.",
            Self::Crack => "Twist on, or drive deeper, until the crack begins to grow.",
            Self::Split => "Follow the crack along the slit until the split is complete.",
            Self::Withdraw => {
                "The bone is apart: stop pushing at once and draw the blades out with S."
            }
            Self::Done => {
                "That was a whole split. End the session (F4) and look at what it came to."
            }
        }
    }
}

/// See the module.
pub struct Guide {
    at: usize,
    /// Where each chisel first touched.
    touched: [Option<Pose>; 2],
    /// Where they were when the bone came apart.
    apart: Option<[Pose; 2]>,
}

impl Guide {
    /// Before the first lesson.
    pub fn new() -> Self {
        Self {
            at: 0,
            touched: [None; 2],
            apart: None,
        }
    }

    /// What is to be done now.
    pub fn lesson(&self) -> Lesson {
        Lesson::ALL.get(self.at).copied().unwrap_or(Lesson::Done)
    }

    /// How many lessons are done.
    pub fn n_done(&self) -> usize {
        self.at
    }

    /// Sees what the trainee does, and goes on where a lesson is done.
    pub fn see(&mut self, sight: &Sight) {
        let live = sight.live;
        if live.time == 0.0 && self.at > 1 {
            // A session that begins anew begins the lessons on the bone anew.
            *self = Self {
                at: 1,
                ..Self::new()
            };
        }
        if let Some(sample) = &live.hands {
            for (first, hand) in self.touched.iter_mut().zip(&sample.hands) {
                if hand.contacts > 0 {
                    first.get_or_insert(hand.tool_pose);
                }
            }
            if live.severed_at.is_some() {
                self.apart.get_or_insert(sample.hands.map(|h| h.tool_pose));
            }
        }
        while self.lesson() != Lesson::Done && self.has_done(self.lesson(), sight) {
            self.at += 1;
        }
    }

    fn has_done(&self, lesson: Lesson, sight: &Sight) -> bool {
        let live = sight.live;
        match lesson {
            Lesson::Start => sight.is_running,
            Lesson::Hold => sight.is_running && sight.holds,
            Lesson::Touch => self.touched.iter().any(Option::is_some),
            Lesson::Drive => self.ways(live).any(|(from, to)| depth(&from, &to) >= DEPTH),
            Lesson::Twist => self.ways(live).any(|(from, to)| turn(&from, &to) >= TURN),
            Lesson::Crack => live.growth.len() > 1,
            Lesson::Split => live.severed_at.is_some(),
            Lesson::Withdraw => self.is_out(live),
            Lesson::Done => false,
        }
    }

    /// From where each chisel first touched to where it is.
    fn ways(&self, live: &Live) -> impl Iterator<Item = (Pose, Pose)> {
        let now = live.hands.map(|h| h.hands.map(|h| h.tool_pose));
        let way = move |i: usize| Some((self.touched[i]?, now?[i]));
        (0..2).filter_map(way)
    }

    fn is_out(&self, live: &Live) -> bool {
        let (Some(apart), Some(now)) = (self.apart, live.hands) else {
            return false;
        };
        (0..2).all(|i| {
            let touched = self.touched[i].is_some();
            !touched || -depth(&apart[i], &now.hands[i].tool_pose) >= OUT
        })
    }
}

/// How far a blade has gone the way that it pointed \[mm\].
fn depth(from: &Pose, to: &Pose) -> f64 {
    (from.rotation * Vec3::z()).dot(&(to.translation.vector - from.translation.vector))
}

/// How far it has turned about the way that it pointed \[rad\].
fn turn(from: &Pose, to: &Pose) -> f64 {
    let turned = (from.rotation.inverse() * to.rotation).scaled_axis();
    turned.z.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::{HapticSample, tests::hand};

    fn live(time: f64, z: f64, twist: f64, contacts: u32) -> Live {
        let mut hand = hand(0.0);
        hand.tool_pose = Pose::new(Vec3::new(0.0, 0.0, z), Vec3::z() * twist);
        hand.contacts = contacts;
        Live {
            time,
            hands: Some(HapticSample {
                step: 0,
                time,
                hands: [hand; 2],
            }),
            ..Live::default()
        }
    }

    fn see(guide: &mut Guide, is_running: bool, holds: bool, live: &Live) -> Lesson {
        guide.see(&Sight {
            is_running,
            holds,
            live,
        });
        guide.lesson()
    }

    #[test]
    fn each_lesson_waits_for_what_is_really_done() {
        let mut g = Guide::new();
        let nothing = Live::default();
        assert_eq!(see(&mut g, false, true, &nothing), Lesson::Start);
        assert_eq!(see(&mut g, true, false, &nothing), Lesson::Hold);
        assert_eq!(
            see(&mut g, true, true, &live(0.1, -3.0, 0.0, 0)),
            Lesson::Touch
        );
        assert_eq!(
            see(&mut g, true, true, &live(0.2, 0.0, 0.0, 4)),
            Lesson::Drive
        );
        assert_eq!(
            see(&mut g, true, true, &live(0.3, 1.9, 0.0, 4)),
            Lesson::Drive
        );
        assert_eq!(
            see(&mut g, true, true, &live(0.4, 2.0, 0.05, 4)),
            Lesson::Twist
        );
        assert_eq!(
            see(&mut g, true, true, &live(0.5, 2.5, -0.09, 4)),
            Lesson::Crack
        );
        let mut apart = live(1.0, 6.0, 0.3, 4);
        apart.severed_at = Some(1.0);
        assert_eq!(
            see(&mut g, true, true, &apart),
            Lesson::Crack,
            "no growth was seen"
        );
    }

    #[test]
    fn the_end_is_to_come_out_and_a_new_session_begins_the_lessons_anew() {
        let mut g = Guide {
            at: 6,
            ..Guide::new()
        };
        let mut at = |z: f64| {
            let mut live = live(2.0, z, 0.0, u32::from(z > 0.0));
            live.severed_at = Some(1.9);
            see(&mut g, true, true, &live)
        };
        assert_eq!(at(8.0), Lesson::Withdraw);
        assert_eq!(at(3.1), Lesson::Withdraw);
        assert_eq!(at(3.0), Lesson::Done);
        assert_eq!(see(&mut g, true, true, &Live::default()), Lesson::Touch);
    }
}
