//! Growths that the balance of the whole body finds by itself.
//!
//! Where bone is in layers thinner than the integrals' domain, K can be several times off, in size and in direction: the body then stores
//! many times what a growth costs, fronts seem to be driven tenfold, and no growth along their kinks pays. What MSERRC asks for, the
//! direction of the largest energy release, is then sought as it is written: by releasing it.
use super::balance::{Balance, Trial, most_gaining};
use crate::crack::growth::{Drive, GrowthLengths};
use crate::crack::load_control::FrontDrives;
use crate::crack::stress_intensity::Station;
use crate::crack::{BodyError, EvaluatedFront};
use crate::geometry::Vec3;

/// Where no growth pays though the body's energy would pay so many times for it, K is wrong. Below, the load may well have to rise.
const RESERVE: f64 = 10.0;
/// So it may where a growth sets free this share of the body's energy. What is stored grows with the lever between load and front, and
/// with it what a growth costs is a smaller part of it: the arms of a beam give up a tenth over an increment when the crack is thirty
/// increments long (U goes with a^-3).
const SHARE: f64 = 0.05;
/// Fronts that are driven less than this are left alone.
const LEAST: f64 = 0.1;
/// Turns off the front's own plane, or off its kink \[deg\]: no criterion kinks by more.
const TURNS: [f64; 7] = [0.0, 25.0, -25.0, 50.0, -50.0, 75.0, -75.0];
/// How far a front moves, in increments.
const FAR: [f64; 2] = [1.0, 2.0];

/// Whether K is so wrong that a growth has to be sought.
pub(super) fn is_due(balance: &Balance) -> bool {
    is_stuck(balance.reserve(), balance.best())
}

/// For so many of the dearest growth the energy would pay, and such a share of its cost the best sets free.
fn is_stuck(reserve: f64, best: f64) -> bool {
    reserve >= RESERVE && best < SHARE * reserve
}

/// The growth of one front that gains most; none if none pays.
pub(super) fn best(
    balance: &Balance,
    fronts: &[EvaluatedFront],
    drives: &FrontDrives,
    lengths: &GrowthLengths,
) -> Result<Option<Trial>, BodyError> {
    let mut best = None;
    for (front, drives) in fronts.iter().zip(&drives.smooth) {
        let largest = drives.iter().fold(0.0, |most: f64, d| d.ratio.max(most));
        if largest >= LEAST {
            let ways = ways(&front.stations, drives, largest, lengths.increment);
            best = most_gaining(best, balance.best_way(&front.front, ways)?);
        }
    }
    Ok(best)
}

/// How a front moves: all of it alike straight ahead, or each vertex along its kink in proportion to its drive.
#[derive(Clone, Copy)]
enum Profile {
    Even,
    Driven,
}

/// Ways for a front, every profile turned to either side.
fn ways<'a>(
    stations: &'a [Station],
    drives: &'a [Drive],
    largest: f64,
    increment: f64,
) -> impl Iterator<Item = Vec<Vec3>> + 'a {
    let profiles = [Profile::Even, Profile::Driven].into_iter();
    let all = profiles.flat_map(|p| FAR.map(|far| (p, far)));
    let all = all.flat_map(|(p, far)| TURNS.map(|turn| (p, far, turn)));
    all.map(move |(profile, far, turn)| {
        let step = |(s, d): (&Station, &Drive)| {
            let (share, kink) = match profile {
                _ if d.ratio == 0.0 => (0.0, 0.0),
                Profile::Even => (1.0, 0.0),
                Profile::Driven => (d.ratio / largest, d.kink),
            };
            let (sin, cos) = (kink + turn.to_radians()).sin_cos();
            (s.advance * cos + s.normal * sin) * (share * far * increment)
        };
        stations.iter().zip(drives).map(step).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Little energy, or a growth that sets enough of it free: the load may have to rise.
    #[test]
    fn k_is_wrong_where_nothing_releases_a_share_of_what_is_stored() {
        for (reserve, best, wrong) in [
            (9.0, 0.0, false),
            (12.0, 0.7, false),
            (12.0, 0.5, true),
            (40.0, 0.99, true),
        ] {
            assert_eq!(is_stuck(reserve, best), wrong, "{reserve}, {best}");
        }
    }

    /// Straight ahead and mirrored to both sides, at most two increments far; what K does not drive at all stays.
    #[test]
    fn a_front_is_tried_evenly_and_as_driven_to_either_side() {
        let drive = |ratio: f64, kink: f64| Drive { ratio, kink };
        let drives = [drive(4.0, 0.5), drive(1.0, -0.5), drive(0.0, 0.0)];
        let all: Vec<_> = ways(&[Station::of_mode_one(); 3], &drives, 4.0, 0.8).collect();
        assert_eq!(all.len(), 2 * FAR.len() * TURNS.len());
        assert_eq!(all[0], [0.8 * Vec3::x(), 0.8 * Vec3::x(), Vec3::zeros()]);
        let sideways: Vec3 = all.iter().map(|w| w[0]).sum::<Vec3>();
        let even: Vec3 = all[..14].iter().map(|w| w[0]).sum();
        assert!(even.z.abs() < 1e-12 && even.x > 0.0, "{even}");
        assert!(sideways.y == 0.0 && sideways.z > 0.1, "{sideways}");
        let driven = &all[14];
        assert!(
            (driven[0].norm() - 0.8).abs() < 1e-12
                && (driven[0].z / driven[0].x - 0.5f64.tan()).abs() < 1e-12
        );
        assert!((driven[1].norm() - 0.2).abs() < 1e-12);
        assert!(all.iter().flatten().all(|m| m.norm() < 1.6 + 1e-12));
    }
}
