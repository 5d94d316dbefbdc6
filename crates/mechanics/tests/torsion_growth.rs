//! Notched prism in torsion (after Brokenshire): the crack leaves the plane of its notch on a curved, antisymmetric surface.
//!
//! Concrete prism 100 x 100 x 270 mm, notch 50 deep at 45 degrees to the axis, E 35 GPa, nu .2, G_c .08 N/mm; twisted by
//! tractions on its ends (the rig with its lever arms is not modelled). h = 11: four and a half elements below the notch.
//! Body-centred mesh jittered by .1, 8 steps of .8 h. The problem is its own image when turned by half a turn about the depth
//! axis, so the front's height obeys z(-y) = -z(y): to .6 h rms here, as the mesh obeys it only to h. Curved: the front ends up
//! twice as steep as the notch. The compliance never falls.
//!
//! Measured: torque for G_max = G_c 795 N m at the notch, falling at every step while the front crosses the section (140 N m with
//! 10 mm left, less than one element, where it stands still within 2 %): the peak is where the crack starts. No published peak
//! stands beside it: geometry, material and the lever arm of 250 mm could be checked (MoFEM's account of the test), the measured load not.
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::geometry::Vec3;
use support::cracked::*;

const SIDE: f64 = 100.0;
const H: f64 = 11.0;
const TOUGHNESS: f64 = 0.08;
/// So weak that the whole front runs at any load.
const WEAK: f64 = 1e-9;

fn prism() -> Specimen {
    let step = H / 0.91;
    let n = (SIDE / step).round() as usize;
    let (deep, wide) = (even(0.0, SIDE, n), even(-0.5 * SIDE, 0.5 * SIDE, n));
    let along = graded(6.0 * step, 135.0, step, 1.3);
    let mesh = centred_block([&deep, &wide, &along], 0.10, 4);
    let near = [Vec3::new(0.0, -50.0, -60.0), Vec3::new(SIDE, 50.0, 60.0)];
    let h = element_size(&mesh, near);
    Specimen::new(mesh, 35_000.0, 0.2, WEAK, h)
}

/// Height of a front at `y`, between its two nearest vertices on either side.
fn height(front: &[Vec3], y: f64) -> Option<f64> {
    front.windows(2).find_map(|w| {
        let s = (y - w[0].y) / (w[1].y - w[0].y);
        (0.0..=1.0)
            .contains(&s)
            .then(|| w[0].z + s * (w[1].z - w[0].z))
    })
}

#[test]
fn the_crack_curves_and_stays_antisymmetric() {
    let specimen = prism();
    let line = |x: f64| -> Vec<Vec3> {
        even(-56.0, 56.0, 22)
            .into_iter()
            .map(|y| Vec3::new(x, y, y + 0.7))
            .collect()
    };
    let mut body = specimen.cut(vec![strip(&line(-5.0), &line(50.0))]);
    let swirl = |p: &Vec3, n: &Vec3| Vec3::new(-p.y, p.x - 50.0, 0.0) * n.z;
    let twist = specimen.tractions(|_, n| n.z.abs() > 0.9, swirl);
    let far_end = twist.iter().filter(|(p, _)| p.z > 0.0);
    let torque: f64 = far_end.map(|(p, f)| (p.x - 50.0) * f.y - p.y * f.x).sum();
    let lengths = GrowthLengths::for_element_size(specimen.h);
    let (mut compliance, mut torques, mut front) = (0.0, Vec::new(), Vec::new());
    for step in 0..8 {
        let solved = body.solve(body.at_points(&twist));
        assert!(
            solved.work >= compliance,
            "step {step}: the compliance fell"
        );
        compliance = solved.work;
        let (next, grown) = body.grown(&solved, lengths).expect("the crack runs");
        assert_eq!(grown.len(), 1, "step {step}: one front");
        let strongest = grown[0]
            .drives
            .iter()
            .map(|d| d.ratio * WEAK)
            .fold(0.0, f64::max);
        torques.push(1e-3 * torque * (TOUGHNESS / strongest).sqrt());
        front = grown[0].stations.iter().map(|s| s.position).collect();
        body = next;
    }
    measured(&format!("torsion: torque {torques:.0?} N m"));
    assert!(
        torques[..7].windows(2).all(|w| w[1] < w[0]) && torques[7] < 1.02 * torques[6],
        "torques {torques:?} N m"
    );
    front.sort_by(|a: &Vec3, b: &Vec3| a.y.total_cmp(&b.y));
    let (mut sum, mut n) = (0.0, 0.0);
    for y in [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0] {
        let (above, below) = (height(&front, y).unwrap(), height(&front, -y).unwrap());
        sum += (above + below).powi(2);
        n += 1.0;
    }
    let skew = (sum / n).sqrt() / specimen.h;
    let slope = (height(&front, 30.0).unwrap() - height(&front, -30.0).unwrap()) / 60.0;
    measured(&format!(
        "torsion: off antisymmetry by {skew:.2} h rms, front {slope:.2} times as steep as its notch"
    ));
    assert!(skew < 0.6, "off antisymmetry by {skew} h");
    assert!(slope > 1.5, "the surface is not curved: slope {slope}");
}
