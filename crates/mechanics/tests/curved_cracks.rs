//! Curved fronts and surfaces: an elliptic crack under tension, a spherical cap under all-round tension.
//!
//! Ellipse of half axes a = 2 b: K_I = s sqrt(pi b) / E(k) (sin^2 w + (b/a)^2 cos^2 w)^(1/4), k^2 = 1 - b^2 / a^2 (code_aster
//! V3.04.110); b/h 3.4, a/h 6.8, block of half width 4.5 b = 2.3 a, of which the finite size raises G by 2 to 3 %.
//! Cap of half angle 45 degrees, rim radius a, nu = .22: K_I = .877, K_II = .235 in units of (2/pi) s sqrt(pi a) (code_aster
//! V3.04.155); a/h 4.9, block of half width 4 a (against 7 a it raises G by 2 %).
//!
//! Measured, error in % as mean +- sd over 6 placements (`OSTEOTOME_LONG=1`; else one): ellipse G +5.1 +- 1.4, K_I +3.2 +- .5 (by
//! station +14 at the sharp ends, radius of curvature 1.7 h, +3 to +8 along the sides); cap G +8.0 +- 1.4, K_I +7.9 +- .5, K_II
//! -10.1 +- .8. Limit for the front's mean of G: 10; a single placement of the cap may reach 12.
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use nalgebra::Matrix3;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::f64::consts::PI;
use support::cracked::*;

const YOUNG: f64 = 1000.0;

/// A block about a crack of half extents `reach`, even near it.
fn block(reach: Vec3, far: f64, h: f64, nu: f64, seed: u64) -> Specimen {
    let step = h / 0.91;
    let near = |k: usize| ((reach[k] + 2.5 * h) / step).ceil() * step;
    let lines = [0, 1, 2].map(|k| graded(near(k), far, step, 1.55));
    let mesh = centred_block([&lines[0], &lines[1], &lines[2]], 0.12, seed);
    let corner = reach.add_scalar(2.0 * h);
    let h = element_size(&mesh, [-corner, corner]);
    Specimen::new(mesh, YOUNG, nu, 1.0, h)
}

fn somewhere(h: f64, seed: u64) -> Vec3 {
    let mut random = support::noise(seed + 5);
    Vec3::new(random(), random(), random()) * (0.5 * h)
}

fn check(name: &str, errors: &[f64], limit: f64) {
    let (mean, sd) = mean_sd(errors);
    measured(&format!(
        "{name} off by {mean:+.4} +- {sd:.4} (limit {limit})"
    ));
    assert!(
        mean.abs() < limit,
        "{name} off by {mean:+.4} +- {sd:.4}, limit {limit}"
    );
}

#[test]
fn ellipse_under_tension() {
    const N: u32 = 64;
    let (a, b, nu): (f64, f64, f64) = (6.0, 3.0, 0.3);
    let modulus = 1.0 - (b / a).powi(2);
    // Complete elliptic integral of the second kind: the midpoint rule is exact for a smooth periodic integrand.
    let quarter = |i: u32| 0.5 * PI * (f64::from(i) + 0.5) / 100.0;
    let integral = (0..100)
        .map(|i| (1.0 - modulus * quarter(i).sin().powi(2)).sqrt())
        .sum::<f64>()
        * 0.005
        * PI;
    let (mut g, mut k1) = (Vec::new(), Vec::new());
    for seed in 0..if long() { 6 } else { 1 } {
        let specimen = block(Vec3::new(a, b, 0.5), 4.5 * b, b / 3.5, nu, seed);
        let body = specimen.cut(vec![ellipse(
            somewhere(specimen.h, seed),
            Vec3::x() * a,
            Vec3::y() * b,
            N,
        )]);
        let solved =
            body.solve(body.at_points(&specimen.remote(Matrix3::from_diagonal(&Vec3::z()))));
        let front = body.fronts().remove(0);
        let stations = body.stations(&solved, &front);
        let exact = |v: u32| {
            let w = 2.0 * PI * f64::from(v - 1) / f64::from(N);
            (PI * b).sqrt() / integral * (w.sin().powi(2) + (b / a * w.cos()).powi(2)).powf(0.25)
        };
        let pairs: Vec<_> = stations
            .iter()
            .zip(front.vertices.iter().map(|v| exact(*v)))
            .collect();
        let release = |k: f64| k * k * (1.0 - nu * nu) / YOUNG;
        g.push(
            mean_sd(
                &pairs
                    .iter()
                    .map(|(s, k)| s.g / release(*k) - 1.0)
                    .collect::<Vec<_>>(),
            )
            .0,
        );
        k1.push(
            mean_sd(
                &pairs
                    .iter()
                    .map(|(s, k)| s.k.k1 / k - 1.0)
                    .collect::<Vec<_>>(),
            )
            .0,
        );
    }
    check("ellipse: G", &g, 0.10);
    check("ellipse: K_I", &k1, 0.05);
}

/// A spherical cap about the z axis whose rim lies in the plane of `centre`; normals upwards, outside.
fn cap(radius: f64, half_angle: f64, centre: Vec3) -> TriMesh {
    const RINGS: u32 = 8;
    const N: u32 = 48;
    let at = |t: f64, w: f64| {
        centre
            + Vec3::new(
                w.cos() * t.sin(),
                w.sin() * t.sin(),
                t.cos() - half_angle.cos(),
            ) * radius
    };
    let mut mesh = TriMesh {
        vertices: vec![at(0.0, 0.0)],
        triangles: vec![],
    };
    for i in 1..=RINGS {
        let t = half_angle * f64::from(i) / f64::from(RINGS);
        mesh.vertices
            .extend((0..N).map(|k| at(t, 2.0 * PI * f64::from(k) / f64::from(N))));
    }
    for k in 0..N {
        let next = (k + 1) % N;
        mesh.triangles.push([0, 1 + k, 1 + next]);
        for i in 0..RINGS - 1 {
            let (p, q) = (1 + i * N + k, 1 + i * N + next);
            mesh.triangles.extend([[p, p + N, q + N], [p, q + N, q]]);
        }
    }
    mesh
}

#[test]
fn spherical_cap_under_all_round_tension() {
    let (a, nu, half_angle): (f64, f64, f64) = (5.0, 0.22, PI / 4.0);
    let unit = 2.0 / PI * (PI * a).sqrt();
    let (mut g, mut k1, mut k2) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..if long() { 6 } else { 1 } {
        let specimen = block(Vec3::new(a, a, 1.5), 4.0 * a, a / 5.0, nu, seed);
        let centre = somewhere(specimen.h, seed) - Vec3::z();
        let body = specimen.cut(vec![cap(a / half_angle.sin(), half_angle, centre)]);
        let solved = body.solve(body.at_points(&specimen.remote(Matrix3::identity())));
        let stations = body.stations(&solved, &body.fronts()[0]);
        let mean = |f: &dyn Fn(&osteotome_mechanics::crack::stress_intensity::Station) -> f64| {
            mean_sd(&stations.iter().map(f).collect::<Vec<_>>()).0
        };
        let exact = [0.877 * unit, 0.235 * unit];
        let release = (exact[0].powi(2) + exact[1].powi(2)) * (1.0 - nu * nu) / YOUNG;
        g.push(mean(&|s| s.g) / release - 1.0);
        k1.push(mean(&|s| s.k.k1) / exact[0] - 1.0);
        // The upper, outer face slides inwards: K_II < 0 in the frame of the outward normal.
        k2.push(-mean(&|s| s.k.k2) / exact[1] - 1.0);
    }
    check("cap: G", &g, if long() { 0.10 } else { 0.12 });
    check("cap: K_I", &k1, 0.12);
    check("cap: K_II", &k2, 0.15);
}
