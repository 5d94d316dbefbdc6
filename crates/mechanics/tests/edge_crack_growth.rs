//! Growth of a 45 degree edge crack in a plate under tension: the first kink, and the straight path after it.
//!
//! Plate 16 x 32 x 4 (element size 1, nu = 0), crack of length 5.6 from the left edge, pulled along z. By the maximum hoop
//! stress the crack kinks by -40.2 degrees (fine mesh; K_II / K_I = .5), by the energy release rate of Amestoy & Leblond by -42.0;
//! then it runs on across the pull. Body-centred mesh jittered by .12, the notch's height at random, 3 placements, 7 further
//! steps of .8 h. Limits: first kink within 3 degrees; later kinks (mean over the front) below 3 degrees rms; front level to .15 h;
//! compliance never falls; K and J agree within 10 % at every step.
//!
//! Measured: hoop stress -39.5, -40.0, -40.5, later 2.1 rms; energy release -41.2, -41.7, -42.3, later 1.9 rms; level to .04 h;
//! K and J within 4 %, 2 % in the mean, right behind the kink as well.
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use osteotome_mechanics::crack::criterion::Criterion;
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::geometry::Vec3;
use support::cracked::*;

const THICKNESS: f64 = 4.0;
const WIDTH: f64 = 16.0;
const YOUNG: f64 = 1000.0;

fn plate(seed: u64) -> Specimen {
    let step = 1.0 / 0.91;
    let along = even(0.0, WIDTH, (WIDTH / step).round() as usize);
    let through = even(0.0, THICKNESS, (THICKNESS / step).round() as usize);
    let up = graded(7.0 * step, 16.0, step, 1.35);
    let mesh = centred_block([&along, &through, &up], 0.12, seed);
    let near = [Vec3::new(0.0, 0.0, -5.0), Vec3::new(WIDTH, THICKNESS, 5.0)];
    let h = element_size(&mesh, near);
    // So weak that the whole front runs at any load.
    Specimen::new(mesh, YOUNG, 0.0, 1e-9, h)
}

/// Kinks of each step in degrees (mean over the front inside the body).
fn kinks(criterion: Criterion, seed: u64) -> Vec<f64> {
    let specimen = plate(seed);
    let z = -2.0 + 0.5 * support::noise(seed + 3)();
    let line = |d: f64| -> Vec<Vec3> {
        let through = even(-1.0, THICKNESS + 1.0, 12).into_iter();
        through
            .map(|y| Vec3::new(d, y * 2.0_f64.sqrt(), z * 2.0_f64.sqrt() + d) / 2.0_f64.sqrt())
            .collect()
    };
    let mut body = specimen.cut(vec![strip(&line(-1.0), &line(5.6))]);
    let lengths = GrowthLengths {
        criterion,
        ..GrowthLengths::for_element_size(specimen.h)
    };
    let (mut found, mut compliance) = (Vec::new(), 0.0);
    for step in 0..8 {
        let pull = specimen.tractions(|_, n| n.z.abs() > 0.9, |_, n| *n);
        let solved = body.solve(body.at_points(&pull));
        assert!(
            solved.work >= compliance,
            "step {step}: the compliance fell"
        );
        compliance = solved.work;
        let (next, grown) = body.grown(&solved, lengths).expect("the crack runs");
        assert_eq!(grown.len(), 1, "step {step}: one front");
        let front = &grown[0];
        let inside: Vec<usize> = (0..front.stations.len())
            .filter(|&k| front.stations[k].inside > 0.5)
            .collect();
        let of =
            |f: &dyn Fn(usize) -> f64| mean_sd(&inside.iter().map(|&k| f(k)).collect::<Vec<_>>());
        let (kink, _) = of(&|k| front.drives[k].kink.to_degrees());
        let (_, ragged) = of(&|k| front.stations[k].position.z / specimen.h);
        let (j, _) = of(&|k| front.stations[k].g);
        let (by_k, _) = of(&|k| front.stations[k].k.straight_release(0.0) / YOUNG);
        assert!(
            ragged < 0.15,
            "step {step}: the front is ragged by {ragged} h"
        );
        assert!(
            (by_k / j - 1.0).abs() < 0.10,
            "step {step}: K gives {by_k}, J {j} N/mm"
        );
        found.push(kink);
        body = next;
    }
    found
}

fn check(criterion: Criterion, first: f64) {
    for seed in 0..3 {
        let kinks = kinks(criterion, seed);
        let later = &kinks[1..];
        let rms = (later.iter().map(|k| k * k).sum::<f64>() / later.len() as f64).sqrt();
        measured(&format!(
            "{criterion:?}, placement {seed}: first kink {:.1}, later {rms:.1} rms",
            kinks[0]
        ));
        assert!(
            (kinks[0] - first).abs() < 3.0,
            "first kink {} degrees instead of {first}",
            kinks[0]
        );
        assert!(rms < 3.0, "later kinks {later:?} degrees, {rms} rms");
    }
}

#[test]
fn by_hoop_stress() {
    check(Criterion::HoopStress, -40.2);
}

#[test]
fn by_energy_release() {
    check(Criterion::EnergyRelease, -42.0);
}
