//! The walk along a ray: which surfaces are seen once crack and kerf are taken out of the bone.
use crate::scene::Kind;

/// A surface that a ray meets, in order from the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// What it bounds.
    pub kind: Kind,
    /// Whether the ray goes in.
    pub is_front: bool,
}

/// Crack faces closer together than this are closed: nobody sees in \[mm\].
pub const CLOSED: f32 = 0.03;

/// How often the ray is inside of each volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    bone: i32,
    kerf: i32,
    gap: i32,
}

impl Counts {
    fn of(&mut self, kind: Kind) -> Option<&mut i32> {
        match kind {
            Kind::Bone | Kind::Seam => Some(&mut self.bone),
            Kind::Kerf | Kind::KerfSeam => Some(&mut self.kerf),
            Kind::Gap | Kind::GapSeam => Some(&mut self.gap),
            Kind::Within | Kind::Solid => None,
        }
    }

    fn is_cut(&self) -> bool {
        self.kerf > 0 || self.gap > 0
    }

    /// Where the eye is: every volume it is in is left once more than entered.
    fn at_eye(events: impl Iterator<Item = Event>) -> Self {
        let mut counts = Self::default();
        for e in events {
            if let Some(n) = counts.of(e.kind) {
                *n += if e.is_front { -1 } else { 1 };
            }
        }
        counts
    }
}

/// Calls `visit` with the index of each visible event, front to back, until it says no.
///
/// The bone is shown where it is not cut away and the ray goes in or out of it; walls of kerf and crack where there is bone
/// and the ray goes into or out of what is cut away. Counts, not parity: overlapping shells are one bone. `ahead` tells how far
/// behind one event another is \[mm\].
pub fn walk<E>(
    events: &[E],
    as_event: impl Fn(&E) -> Event,
    ahead: impl Fn(&E, &E) -> f32,
    mut visit: impl FnMut(usize) -> bool,
) {
    let mut counts = Counts::at_eye(events.iter().map(&as_event));
    for (k, event) in events.iter().enumerate() {
        let e = as_event(event);
        let before = counts;
        if let Some(n) = counts.of(e.kind) {
            *n += if e.is_front { 1 } else { -1 };
        }
        let is_visible = match e.kind {
            Kind::Solid => true,
            Kind::Seam | Kind::KerfSeam | Kind::GapSeam => false,
            Kind::Within => counts.bone > 0,
            Kind::Bone => !counts.is_cut() && (before.bone > 0) != (counts.bone > 0),
            Kind::Kerf => counts.bone > 0 && before.is_cut() != counts.is_cut(),
            Kind::Gap => {
                counts.bone > 0
                    && before.is_cut() != counts.is_cut()
                    && !is_closed(events, k, &as_event, &ahead)
            }
        };
        if is_visible && !visit(k) {
            return;
        }
    }
}

/// Whether a face of the crack that looks the other way is right behind or before this one: nothing is between them, or no bone to
/// speak of. Which of two such faces comes first is a matter of rounding, and must not be seen.
fn is_closed<E>(
    events: &[E],
    k: usize,
    as_event: &impl Fn(&E) -> Event,
    ahead: &impl Fn(&E, &E) -> f32,
) -> bool {
    let is_face = |e: &&E| as_event(e).kind == Kind::Gap;
    let is_front = as_event(&events[k]).is_front;
    let before = events[..k].iter().rev().find(is_face);
    let behind = events[k + 1..].iter().find(is_face);
    before
        .into_iter()
        .chain(behind)
        .any(|o| as_event(o).is_front != is_front && ahead(&events[k], o).abs() < CLOSED)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(list: &[(f32, Kind, bool)]) -> Vec<usize> {
        let mut found = Vec::new();
        walk(
            list,
            |&(_, kind, is_front)| Event { kind, is_front },
            |a, b| b.0 - a.0,
            |k| {
                found.push(k);
                true
            },
        );
        found
    }

    use Kind::{Bone, Gap, GapSeam, Kerf, KerfSeam, Seam, Solid, Within};

    #[test]
    fn a_slit_shows_its_far_wall_only() {
        // Kerf around the near surface of the bone.
        let list = [
            (1.0, Kerf, true),
            (2.0, Bone, true),
            (3.0, Kerf, false),
            (9.0, Bone, false),
        ];
        assert_eq!(seen(&list), [2, 3]);
    }

    #[test]
    fn from_inside_the_bone_a_crack_has_two_walls() {
        let list = [(1.0, Gap, true), (2.0, Gap, false), (3.0, Bone, false)];
        assert_eq!(seen(&list), [0, 1, 2]);
        let closed = [(1.0, Gap, true), (1.01, Gap, false), (3.0, Bone, false)];
        assert_eq!(seen(&closed), [2]);
        // The same pair inside out, in a wide gap: rounding alone may have turned it.
        let turned = [
            (0.5, Gap, true),
            (1.0, Gap, false),
            (1.01, Gap, true),
            (2.0, Gap, false),
            (3.0, Bone, false),
        ];
        assert_eq!(seen(&turned), [0, 3, 4]);
    }

    #[test]
    fn a_crack_inside_out_does_not_fill_the_kerf() {
        let list = [
            (1.0, Bone, true),
            (2.0, Kerf, true),
            (2.5, Gap, false),
            (2.6, Gap, true),
            (3.0, Kerf, false),
            (4.0, Bone, false),
        ];
        assert_eq!(seen(&list), [0, 1, 4, 5]);
    }

    #[test]
    fn nested_shells_are_one_bone() {
        let list = [
            (1.0, Bone, true),
            (2.0, Bone, true),
            (3.0, Bone, false),
            (4.0, Bone, false),
        ];
        assert_eq!(seen(&list), [0, 3]);
    }

    #[test]
    fn seams_count_but_are_not_shown_and_marks_only_within_bone() {
        let list = [
            (0.5, Within, true),
            (1.0, Seam, true),
            (2.0, Within, false),
            (3.0, Bone, false),
            (4.0, Solid, true),
        ];
        assert_eq!(seen(&list), [2, 3, 4]);
    }

    #[test]
    fn what_a_kerf_or_gap_leaves_between_seams_is_not_shown() {
        // Between two seams of the bone, beside a gap and before a kerf that do not reach to them.
        let list = [
            (1.0, Seam, true),
            (2.0, GapSeam, true),
            (3.0, GapSeam, false),
            (4.0, KerfSeam, true),
            (5.0, KerfSeam, false),
            (6.0, Seam, false),
            (7.0, Bone, true),
            (8.0, GapSeam, true),
            (9.0, Kerf, true),
            (9.5, GapSeam, false),
            (9.6, Kerf, false),
            (10.0, Bone, false),
        ];
        assert_eq!(seen(&list), [6, 10, 11]);
    }
}
