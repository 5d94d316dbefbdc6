//! Penny-shaped crack of radius a in a large block: under remote tension s, inclined to it, and with pressure on its faces.
//!
//! Closed forms. Tension s or internal pressure s: K_I = 2 s sqrt(a / pi). Crack inclined at alpha to s, at angle w round the
//! front (code_aster V3.04.154): K_I = (2/pi) s sin^2(alpha) sqrt(pi a), K_II = 4 / (pi (2 - nu)) s sin(alpha) cos(alpha)
//! cos(w) sqrt(pi a), K_III = 4 (1 - nu) / (pi (2 - nu)) s sin(alpha) cos(alpha) sin(w) sqrt(pi a). The inclination is put into
//! the load: the crack stays in the plane z = 0 of its block, its upper face slides along +x.
//!
//! Mesh: body-centred block of half width 5 a (F = 1.005 for the finite size), even with step h / .91 near the crack, graded
//! outside; nodes jittered by .12 of the spacing; the disc's centre at random within half an element; 48 front vertices.
//! a = 3, nu = .3, alpha = 60 degrees. `OSTEOTOME_LONG=1` adds a/h = 6 and more placements.
//!
//! Measured, error in % as mean +- sd over placements (8 at a/h 3 and 4, 3 at 6), kinks in degrees:
//!
//! | a/h | G | K_I | K_II | K_III | K_I by pressure | kink rms | kink max | (a_eff - a) / h |
//! |---|---|---|---|---|---|---|---|---|
//! | 3 | +.5 +- 1.7 | +1.6 +- .9 | -3.7 +- 1.8 | -5.1 +- 1.9 | -.8 +- 1.2 | 1.3 | 2.6 | -.03 +- .04 |
//! | 4 | +1.5 +- .8 | +2.0 +- .6 | -.4 +- 1.0 | -1.2 +- 1.7 | +.5 +- .6 | 1.0 | 3.0 | .00 +- .04 |
//! | 6 | -.2 +- 1.2 | +.6 +- .8 | -.5 +- .8 | -1.1 +- .6 | .0 +- 1.1 | 1.0 | 3.1 | -.03 +- .04 |
//!
//! Limits are those of the project's validation table: G and K_I 8 % at a/h 3, 5 % from 4; amplitudes of K_II and K_III 10 %,
//! 5 % from 6; kink angle 3 degrees rms, 8 at most.
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use osteotome_mechanics::crack::criterion::{Criterion, StressIntensity};
use osteotome_mechanics::crack::stress_intensity::Station;
use osteotome_mechanics::geometry::Vec3;
use std::f64::consts::PI;
use support::cracked::*;

const NU: f64 = 0.3;
const YOUNG: f64 = 1000.0;
const RADIUS: f64 = 3.0;
const N_BORDER: u32 = 48;
const ALPHA: f64 = PI / 3.0;

fn specimen(a_over_h: f64, seed: u64) -> Specimen {
    let h = RADIUS / a_over_h;
    let step = h / 0.91;
    let even_up_to = |x: f64| (x / step).ceil() * step;
    let (near, flat) = (even_up_to(RADIUS + 2.5 * h), even_up_to(3.0 * h));
    let wide = graded(near, 5.0 * RADIUS, step, 1.5);
    let high = graded(flat, 5.0 * RADIUS, step, 1.5);
    let mesh = centred_block([&wide, &wide, &high], 0.12, seed);
    let corner = Vec3::new(near, near, flat);
    let h = element_size(&mesh, [-corner, corner]);
    Specimen::new(mesh, YOUNG, NU, 1.0, h)
}

/// Relative errors; kinks in degrees.
struct Errors {
    g: f64,
    k1: f64,
    k2: f64,
    k3: f64,
    pressure_g: f64,
    pressure_k1: f64,
    kink_rms: f64,
    kink_max: f64,
    /// (a_eff - a) / h, and the same from the energy that the crack releases.
    ahead: f64,
    ahead_by_energy: f64,
}

fn measure(a_over_h: f64, seed: u64) -> Errors {
    let specimen = specimen(a_over_h, seed);
    let mut random = support::noise(seed + 100);
    let centre = Vec3::new(random(), random(), random()) * (0.5 * specimen.h);
    let disc = ellipse(centre, Vec3::x() * RADIUS, Vec3::y() * RADIUS, N_BORDER);
    let body = specimen.cut(vec![disc]);
    let front = body.fronts().remove(0);
    let angle: Vec<f64> = front
        .vertices
        .iter()
        .map(|v| 2.0 * PI * f64::from(v - 1) / f64::from(N_BORDER))
        .collect();
    let remote = |d: Vec3| body.solve(body.at_points(&specimen.remote(d * d.transpose())));
    let tension = remote(Vec3::z());
    let inclined = remote(Vec3::new(ALPHA.cos(), 0.0, ALPHA.sin()));
    let pressed = body.solve(body.pressure(1.0));
    let [open, slid, pushed] = [&tension, &inclined, &pressed].map(|s| body.stations(s, &front));

    let root = (PI * RADIUS).sqrt();
    let k1 = 2.0 / PI * root;
    let g = k1 * k1 * (1.0 - NU * NU) / YOUNG;
    let shear = 4.0 / (PI * (2.0 - NU)) * ALPHA.sin() * ALPHA.cos() * root;
    let mean = |v: &[Station], f: &dyn Fn(&Station, f64) -> f64| {
        v.iter().zip(&angle).map(|(s, w)| f(s, *w)).sum::<f64>() / v.len() as f64
    };
    let kink = |s: &Station, w: f64| {
        let exact = StressIntensity {
            k1: k1 * ALPHA.sin().powi(2),
            k2: shear * w.cos(),
            k3: shear * (1.0 - NU) * w.sin(),
        };
        let of = |k: StressIntensity| {
            k.preferred_kink(Criterion::EnergyRelease, NU, 1.2, |_| 1.0)
                .0
        };
        (of(s.k) - of(exact)).to_degrees()
    };
    let released = 0.5 * (tension.work - specimen.mesh.volume() / YOUNG);
    let energy_radius = (released * 3.0 * YOUNG / (8.0 * (1.0 - NU * NU))).cbrt();
    Errors {
        g: mean(&open, &|s, _| s.g) / g - 1.0,
        k1: mean(&open, &|s, _| s.k.k1) / k1 - 1.0,
        k2: 2.0 * mean(&slid, &|s, w| s.k.k2 * w.cos()) / shear - 1.0,
        k3: 2.0 * mean(&slid, &|s, w| s.k.k3 * w.sin()) / shear / (1.0 - NU) - 1.0,
        pressure_g: mean(&pushed, &|s, _| s.g) / g - 1.0,
        pressure_k1: mean(&pushed, &|s, _| s.k.k1) / k1 - 1.0,
        kink_rms: mean(&slid, &|s, w| kink(s, w).powi(2)).sqrt(),
        kink_max: slid
            .iter()
            .zip(&angle)
            .map(|(s, w)| kink(s, *w).abs())
            .fold(0.0, f64::max),
        ahead: ((body.effective_area() / PI).sqrt() - RADIUS) / specimen.h,
        ahead_by_energy: (energy_radius - RADIUS) / specimen.h,
    }
}

/// Largest errors allowed: G and K_I, amplitudes of K_II and K_III.
struct Limits {
    opening: f64,
    shear: f64,
    kink_rms: f64,
    kink_max: f64,
}

/// The mean over placements must hold the limits; kinks hold them at every placement.
fn check(a_over_h: f64, placements: u64, limits: &Limits) {
    let all: Vec<Errors> = (0..placements)
        .map(|seed| measure(a_over_h, seed))
        .collect();
    let of = |f: &dyn Fn(&Errors) -> f64| all.iter().map(f).collect::<Vec<_>>();
    for (name, values, limit) in [
        ("G", of(&|e| e.g), limits.opening),
        ("K_I", of(&|e| e.k1), limits.opening),
        ("K_II", of(&|e| e.k2), limits.shear),
        ("K_III", of(&|e| e.k3), limits.shear),
        ("G under pressure", of(&|e| e.pressure_g), limits.opening),
        ("K_I under pressure", of(&|e| e.pressure_k1), limits.opening),
        ("(a_eff - a) / h", of(&|e| e.ahead), 0.1),
        ("(a_U - a) / h", of(&|e| e.ahead_by_energy), 0.12),
        ("kink rms", of(&|e| e.kink_rms), limits.kink_rms),
        ("kink max", of(&|e| e.kink_max), limits.kink_max),
    ] {
        let (mean, sd) = mean_sd(&values);
        measured(&format!(
            "penny, a/h {a_over_h}: {name} off by {mean:+.4} +- {sd:.4} (limit {limit})"
        ));
        assert!(
            mean.abs() < limit,
            "a/h {a_over_h}: {name} off by {mean:+.4} +- {sd:.4}, limit {limit}"
        );
    }
}

#[test]
fn three_elements_a_radius() {
    let placements = if long() { 8 } else { 2 };
    check(
        3.0,
        placements,
        &Limits {
            opening: 0.08,
            shear: 0.10,
            kink_rms: 3.0,
            kink_max: 8.0,
        },
    );
}

#[test]
fn four_elements_a_radius() {
    let placements = if long() { 8 } else { 2 };
    check(
        4.0,
        placements,
        &Limits {
            opening: 0.05,
            shear: 0.10,
            kink_rms: 3.0,
            kink_max: 8.0,
        },
    );
}

#[test]
fn six_elements_a_radius() {
    if !long() {
        measured("skipped: set OSTEOTOME_LONG=1");
        return;
    }
    check(
        6.0,
        3,
        &Limits {
            opening: 0.05,
            shear: 0.05,
            kink_rms: 3.0,
            kink_max: 8.0,
        },
    );
}
