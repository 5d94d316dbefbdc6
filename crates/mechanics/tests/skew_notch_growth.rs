//! Skew-notched beam in three-point bending (after Buchholz et al.): the front must turn from 45 degrees into the plane of mode I.
//!
//! PMMA, 260 x 60 x 10 mm, span 240, notch 20 deep at 45 degrees to the beam's axis, nu .38; h = 2.5, so the thickness holds four
//! elements; 10 steps of .8 h. Body-centred mesh jittered by .12; `OSTEOTOME_LONG=1` runs three placements. Limit: 8 degrees
//! after 10 steps; the front never turns beyond -10; one front throughout; the compliance never falls.
//!
//! Measured angle at steps 0 to 10, first placement: 45, 37, 26, 14, 7, 4, 2, 2, 2, 2, 1: K_II, which changes sign along the front,
//! turns it by itself. With a fifth of the twist of K_III fed back at each step: 45, 33, 20, 7, 0, -3, -2, -1, 0, 0, 0: sooner there,
//! 3 degrees over; with .4 alike. Off by default: on the torsion prism the last step before the back face then asks for more torque
//! than the one before (.1 of the twist and more), and at -.2 (the wrong sense) the notch's front is still at 8 degrees after 10 steps.
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::geometry::Vec3;
use support::cracked::*;

const DEPTH: f64 = 60.0;
const THICKNESS: f64 = 10.0;
const H: f64 = 2.5;

fn beam(seed: u64) -> Specimen {
    let step = H / 0.91;
    let down = even(0.0, DEPTH, (DEPTH / step).round() as usize);
    let through = even(0.0, THICKNESS, (THICKNESS / step).round() as usize);
    let along = graded(5.0 * step, 130.0, step, 1.5);
    let mesh = centred_block([&down, &through, &along], 0.12, seed);
    let near = [
        Vec3::new(0.0, 0.0, -10.0),
        Vec3::new(DEPTH, THICKNESS, 10.0),
    ];
    let h = element_size(&mesh, near);
    // So weak that the whole front runs at any load.
    Specimen::new(mesh, 2800.0, 0.38, 1e-9, h)
}

fn bend() -> Vec<(Vec3, Vec3)> {
    let line = |x: f64, z: f64, force: f64| {
        let y = |i: u32| THICKNESS * (f64::from(i) + 0.5) / 8.0;
        (0..8).map(move |i| (Vec3::new(x, y(i), z), Vec3::x() * (force / 8.0)))
    };
    line(DEPTH, 0.0, -1.0)
        .chain(line(0.0, 120.0, 0.5))
        .chain(line(0.0, -120.0, 0.5))
        .collect()
}

/// Angle in degrees between the front and the beam's cross-section: of the regression of z on y.
fn angle(points: &[Vec3]) -> f64 {
    let middle = points.iter().sum::<Vec3>() / points.len() as f64;
    let (mut yz, mut yy) = (0.0, 0.0);
    for p in points.iter().map(|p| p - middle) {
        yz += p.y * p.z;
        yy += p.y * p.y;
    }
    (yz / yy).atan().to_degrees()
}

#[test]
fn the_front_turns_into_the_plane_of_mode_one() {
    let n_placements = if long() { 3 } else { 1 };
    for (seed, twist) in (0..n_placements).flat_map(|seed| [(seed, 0.0), (seed, 0.2)]) {
        let specimen = beam(seed);
        let line = |x: f64| -> Vec<Vec3> {
            let through = even(-2.0, THICKNESS + 2.0, 14).into_iter();
            through
                .map(|y| Vec3::new(x, y, y - 5.0 + 0.3 * support::noise(seed)()))
                .collect()
        };
        let mut body = specimen.cut(vec![strip(&line(-1.0), &line(20.0))]);
        let lengths = GrowthLengths {
            twist,
            ..GrowthLengths::for_element_size(specimen.h)
        };
        let (mut compliance, mut angles) = (0.0, Vec::new());
        for step in 0..=10 {
            let solved = body.solve(body.at_points(&bend()));
            assert!(
                solved.work >= compliance,
                "step {step}: the compliance fell"
            );
            compliance = solved.work;
            let (next, grown) = body.grown(&solved, lengths).expect("the crack runs");
            assert_eq!(grown.len(), 1, "step {step}: one front");
            let inside = grown[0].stations.iter().filter(|s| s.inside > 0.5);
            angles.push(angle(&inside.map(|s| s.position).collect::<Vec<_>>()));
            body = next;
        }
        measured(&format!(
            "skew notch, placement {seed}, twist {twist}: {angles:.1?}"
        ));
        assert!((angles[0] - 45.0).abs() < 1.0);
        assert!(
            angles[10].abs() < 8.0 && angles.iter().all(|a| *a > -10.0),
            "{angles:?}"
        );
        // The twist turns it sooner.
        assert!(twist == 0.0 || angles[4] < 5.0, "{angles:?}");
    }
}
