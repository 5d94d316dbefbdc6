//! What a growth would have to tear: toughness by direction, in the material that lies there.
//!
//! The integrals see what surrounds a front; the growth goes through what is ahead. Where layers differ in toughness, a crack that looks
//! ahead stays in the weaker one, and turns before it enters the tougher.
use super::domain::Domain;
use super::stress_intensity::Fields;
use crate::bone::TetMaterial;

/// Angles off the front's plane, from minus to plus `WIDEST` \[rad\]; between them toughness is linear.
const ANGLES: usize = 13;
const WIDEST: f64 = 1.309;
/// How far it is looked ahead, in element sizes: an increment is .8 of one.
const REACH: [f64; 3] = [0.4, 0.8, 1.2];

/// Toughness by angle at one point of a front \[N/mm\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToughnessAhead([f64; ANGLES]);

impl ToughnessAhead {
    /// Looks ahead from a vertex of a front; none where all that is seen is of one toughness.
    pub(super) fn new(domain: &Domain, fields: &Fields, vertex: usize) -> Option<Self> {
        let line = &domain.line;
        let (p, q, n) = (
            line.points[vertex],
            line.advance[vertex],
            line.normal[vertex],
        );
        let alike = |a: &TetMaterial, b: &TetMaterial| {
            (a.toughness_along, a.toughness_across) == (b.toughness_along, b.toughness_across)
                && (a.toughness_along == a.toughness_across || a.osteon == b.osteon)
        };
        let mut first: Option<&TetMaterial> = None;
        let mut is_uniform = true;
        let table = std::array::from_fn(|k| {
            let (sin, cos) = angle(k).sin_cos();
            let (way, across) = (q * cos + n * sin, n * cos - q * sin);
            let mut here = &domain.materials[vertex];
            let toughness = REACH.map(|r| {
                // Beyond the body's face nothing has to be torn: what lies before it counts.
                if let Some((tet, _)) = fields
                    .locator
                    .find(fields.mesh, &(p + way * (r * domain.h)))
                {
                    here = &fields.materials[tet as usize];
                    is_uniform &= alike(first.get_or_insert(here), here);
                }
                here.toughness(&across)
            });
            toughness.iter().sum::<f64>() / REACH.len() as f64
        });
        (!is_uniform).then_some(Self(table))
    }

    /// Toughness against a kink at `angle` \[rad\], from q towards n.
    pub fn at(&self, angle: f64) -> f64 {
        let place = (angle + WIDEST) / (2.0 * WIDEST) * (ANGLES - 1) as f64;
        let place = place.clamp(0.0, (ANGLES - 1) as f64);
        let k = (place as usize).min(ANGLES - 2);
        let share = place - k as f64;
        self.0[k] * (1.0 - share) + self.0[k + 1] * share
    }

    /// The least of all directions.
    pub fn least(&self) -> f64 {
        self.0.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

fn angle(k: usize) -> f64 {
    WIDEST * (2.0 * k as f64 / (ANGLES - 1) as f64 - 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::growth::{GrowthLengths, drive};
    use super::super::stress_intensity::Station;
    use super::*;

    #[test]
    fn toughness_is_linear_between_angles() {
        let ahead = ToughnessAhead(std::array::from_fn(|k| k as f64));
        assert_eq!(ahead.least(), 0.0);
        for (at, expected) in [(-2.0, 0.0), (0.0, 6.0), (angle(7), 7.0), (2.0, 12.0)] {
            assert!((ahead.at(at) - expected).abs() < 1e-12, "{at}");
        }
        assert!((ahead.at(0.5 * (angle(3) + angle(4))) - 3.5).abs() < 1e-12);
    }

    /// Under mode I: as far as G(theta) falls less than the toughness, and no farther.
    #[test]
    fn a_kink_goes_where_it_costs_less_for_what_it_releases() {
        let lengths = GrowthLengths::for_element_size(1.0);
        let kink = |walls: f64| {
            let table = |k| if angle(k) > 0.4 { 1.0 } else { walls };
            let ahead = ToughnessAhead(std::array::from_fn(table));
            let station = Station {
                ahead: Some(ahead),
                ..Station::of_mode_one()
            };
            let found = drive(&station, &lengths);
            let share = station.k.kinked_release(found.kink, 0.3) / station.k.straight_release(0.3);
            (found.kink, found.ratio, share)
        };
        let (turned, ratio, share) = kink(3.0);
        assert!((turned - angle(8)).abs() < 0.01, "{turned}");
        assert!(
            (ratio - share).abs() < 1e-3 && (0.85..0.95).contains(&share),
            "{ratio} {share}"
        );
        let (straight, ratio, _) = kink(1.05);
        assert!(
            straight.abs() < 1e-3 && (ratio - 1.0 / 1.05).abs() < 1e-9,
            "{straight} {ratio}"
        );
    }
}
