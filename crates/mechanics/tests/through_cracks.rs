//! Through cracks in plates: single edge notch in tension, three-point bend bar, compact tension, double cantilever beam.
//!
//! Mesh: body-centred, h = 1, plate thickness 4 h, even within 3 h of the crack and along it, graded away from it; nodes
//! jittered by .12 of the spacing; a/W .40 to .46 with W = 20 h, the crack's height and length at random. nu = 0, so that the
//! plane solutions hold through the thickness and no face adds a third dimension of its own.
//!
//! Stress intensity (handbook): SENT Y = 1.12 - .231 x + 10.55 x^2 - 21.72 x^3 + 30.39 x^4; SE(B) of span 4 W and C(T) by
//! ASTM E399; G = K^2 / E. Finite size: all formulae are for the finite plate; what is left are the ends (SENT half height
//! 1.5 W, below 1 %; SE(B) overhang .2 W; C(T) loaded along two lines instead of in its holes, 1 to 2 %).
//!
//! SE(B) in coarser meshes: -12 +- 4 % at W = 12.5 h, a/h 5.7 (K -7 %). Not the integral (J is within 0 +- 6 % of the code's own
//! dU/dA, which is -11 +- 5 %) and not the arms' bending stiffness (the uncracked bar's compliance is within 1 %), but the ligament
//! of 8 h, where bending and the front's field share few elements. Tried: reading G at the effective front, which lags by .09 h
//! there, mends a quarter of it; elements a quarter smaller bring it to -3 +- 1 %. So: at least 10 elements in a bent ligament.
//!
//! Measured over 8 placements, error in % as mean +- sd: G at a/h 8.5 to 9.4: SENT -1.7 +- 4.5, SE(B) -4.4 +- 3.4,
//! C(T) -1.6 +- 4.6 (limit 10 for the mean). DCB with arms of 4 h: J against the code's own dU/dA_eff +2.2 +- 1.1 (limit 6);
//! against beam theory -5.9 +- 1.0, the bending stiffness again; compliance scatters by .8 % over placements (limit 3).
#![allow(clippy::print_stderr)] // figures for docs/validation.md, seen with --nocapture
mod support;
use osteotome_mechanics::crack::stress_intensity::evaluate;
use osteotome_mechanics::geometry::{TriMesh, Vec3, block_mesh};
use std::f64::consts::PI;
use support::cracked::*;

const YOUNG: f64 = 1000.0;
/// Element size aimed at, thickness and width of the plates \[mm\].
const H: f64 = 1.0;
const THICKNESS: f64 = 4.0;
const WIDTH: f64 = 20.0;
const PLACEMENTS: u64 = 8;

/// Plate x in `x`, y through the thickness, z in [-height, height]; even near z = 0.
fn plate(x: [f64; 2], height: f64, seed: u64) -> Specimen {
    let step = H / 0.91;
    let along = even(x[0], x[1], ((x[1] - x[0]) / step).round() as usize);
    let through = even(0.0, THICKNESS, (THICKNESS / step).round() as usize);
    let up = graded(3.0 * step, height, step, 1.35);
    let mesh = centred_block([&along, &through, &up], 0.12, seed);
    let near = [Vec3::new(x[0], 0.0, -3.0), Vec3::new(x[1], THICKNESS, 3.0)];
    let h = element_size(&mesh, near);
    Specimen::new(mesh, YOUNG, 0.0, 1.0, h)
}

/// A flat crack from beyond the edge at `from` to `to`.
fn edge_crack(from: f64, to: f64, z: f64) -> TriMesh {
    let line = |x: f64| -> Vec<Vec3> {
        even(-1.0, THICKNESS + 1.0, 12)
            .into_iter()
            .map(|y| Vec3::new(x, y, z))
            .collect()
    };
    strip(&line(from), &line(to))
}

/// A force spread over a line through the thickness.
fn line_load(x: f64, z: f64, force: Vec3) -> Vec<(Vec3, Vec3)> {
    let at = |k: u32| Vec3::new(x, THICKNESS * (f64::from(k) + 0.5) / 8.0, z);
    (0..8).map(|k| (at(k), force / 8.0)).collect()
}

/// Mean of G over the front inside the body.
fn front_mean(body: &Cracked, solved: &Solved) -> f64 {
    let fronts = body.fronts();
    assert_eq!(fronts.len(), 1);
    let stations = body.stations(solved, &fronts[0]);
    let inside: Vec<f64> = stations
        .iter()
        .filter(|s| s.inside > 0.5)
        .map(|s| s.g)
        .collect();
    mean_sd(&inside).0
}

/// Crack length and height of a placement.
fn placement(seed: u64) -> (f64, f64) {
    let (length, height) = (support::noise(seed + 70)(), support::noise(seed + 40)());
    (8.0 + 0.55 * (1.0 + length), 0.5 * H * height)
}

/// G of a plate with an edge crack over the closed form K^2 / E, minus 1.
fn error(
    x: [f64; 2],
    height: f64,
    seed: u64,
    loads: impl Fn(&Specimen) -> Vec<(Vec3, Vec3)>,
    k: impl Fn(f64) -> f64,
) -> f64 {
    let (a, z) = placement(seed);
    let specimen = plate(x, height, seed);
    let body = specimen.cut(vec![edge_crack(x[0] - 1.0, a, z)]);
    let solved = body.solve(body.at_points(&loads(&specimen)));
    front_mean(&body, &solved) / (k(a).powi(2) / YOUNG) - 1.0
}

fn check(name: &str, errors: &[f64], limit: f64) {
    let (mean, sd) = mean_sd(errors);
    measured(&format!(
        "{name}: G off by {mean:+.4} +- {sd:.4} (limit {limit})"
    ));
    assert!(
        mean.abs() < limit,
        "{name}: G off by {mean:+.4} +- {sd:.4}, limit {limit}"
    );
    let worst = errors.iter().fold(0.0f64, |w, e| w.max(e.abs()));
    assert!(
        worst < 2.0 * limit,
        "{name}: off by {worst} at one placement"
    );
}

#[test]
fn single_edge_notch_in_tension() {
    let k = |a: f64| {
        let x = a / WIDTH;
        let y = 1.12 - 0.231 * x + 10.55 * x.powi(2) - 21.72 * x.powi(3) + 30.39 * x.powi(4);
        y * (PI * a).sqrt()
    };
    let pull = |s: &Specimen| s.tractions(|_, n| n.z.abs() > 0.9, |_, n| *n);
    let errors: Vec<f64> = (0..PLACEMENTS)
        .map(|seed| error([0.0, WIDTH], 1.5 * WIDTH, seed, pull, k))
        .collect();
    check("SENT", &errors, 0.10);
}

#[test]
fn three_point_bending() {
    let k = |a: f64| {
        let x = a / WIDTH;
        let f = 3.0 * x.sqrt() * (1.99 - x * (1.0 - x) * (2.15 - 3.93 * x + 2.7 * x * x))
            / (2.0 * (1.0 + 2.0 * x) * (1.0 - x).powf(1.5));
        4.0 * WIDTH / (THICKNESS * WIDTH.powf(1.5)) * f
    };
    let bend = |_: &Specimen| {
        let mut loads = line_load(WIDTH, 0.0, -Vec3::x());
        loads.extend(line_load(0.0, 2.0 * WIDTH, 0.5 * Vec3::x()));
        loads.extend(line_load(0.0, -2.0 * WIDTH, 0.5 * Vec3::x()));
        loads
    };
    let errors: Vec<f64> = (0..PLACEMENTS)
        .map(|seed| error([0.0, WIDTH], 2.2 * WIDTH, seed, bend, k))
        .collect();
    check("SE(B)", &errors, 0.10);
}

#[test]
fn compact_tension() {
    let k = |a: f64| {
        let x = a / WIDTH;
        let f = (2.0 + x)
            * (0.886 + 4.64 * x - 13.32 * x.powi(2) + 14.72 * x.powi(3) - 5.6 * x.powi(4))
            / (1.0 - x).powf(1.5);
        f / (THICKNESS * WIDTH.sqrt())
    };
    let pull = |_: &Specimen| {
        let mut loads = line_load(0.0, 0.275 * WIDTH, Vec3::z());
        loads.extend(line_load(0.0, -0.275 * WIDTH, -Vec3::z()));
        loads
    };
    let errors: Vec<f64> = (0..PLACEMENTS)
        .map(|seed| error([-0.25 * WIDTH, WIDTH], 0.6 * WIDTH, seed, pull, k))
        .collect();
    check("C(T)", &errors, 0.10);
}

/// J against the energy that the code itself releases between two crack lengths, at fixed load; and tiny cuts must not sew the
/// crack shut, which would show in the compliance.
#[test]
fn double_cantilever_beam() {
    const ARM: f64 = 4.0;
    const LENGTH: f64 = 14.0;
    let (mut errors, mut compliances, mut beam) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..PLACEMENTS {
        let specimen = plate([0.0, 26.0], ARM, seed);
        let z = 0.4 * placement(seed).1;
        let found = [-1.5, 0.0, 1.5].map(|d| {
            let body = specimen.cut(vec![edge_crack(-1.0, LENGTH + d, z)]);
            let mut loads = line_load(0.0, ARM, Vec3::z());
            loads.extend(line_load(0.0, -ARM, -Vec3::z()));
            let solved = body.solve(body.at_points(&loads));
            (
                solved.work,
                body.effective_area(),
                front_mean(&body, &solved),
            )
        });
        let released = 0.5 * (found[2].0 - found[0].0) / (found[2].1 - found[0].1);
        let j = (found[0].2 + 4.0 * found[1].2 + found[2].2) / 6.0;
        errors.push(j / released - 1.0);
        compliances.push(found[1].0);
        let g = 12.0 * LENGTH.powi(2) / (THICKNESS.powi(2) * YOUNG * ARM.powi(3))
            * (1.0 + 0.66 * ARM / LENGTH).powi(2);
        beam.push(found[1].2 / g - 1.0);
    }
    check("DCB against dU/dA", &errors, 0.06);
    check("DCB against beam theory", &beam, 0.12);
    let (mean, sd) = mean_sd(&compliances);
    measured(&format!("DCB: compliance {mean:.4} +- {sd:.4} mm/N"));
    assert!(
        sd < 0.03 * mean,
        "the compliance scatters by {} over placements",
        sd / mean
    );
}

/// Two equal cracks from either edge that face each other across a short ligament (double edge notch): each front gets its own
/// G. Where the two domains overlap J is the difference of the two (-57 % at a ligament of 2 h), unless q keeps clear of the
/// other front (-8 +- 6 %). At 1.6 h the fronts are lost to each other (-75 %) and their stations no longer trusted.
///
/// K = s sqrt(pi a) (1.122 - .561 x - .205 x^2 + .471 x^3 - .19 x^4) / sqrt(1 - x), x = a / (W/2) (Tada). G goes with one over the
/// ligament, so that .1 h of effective front is worth 7 % at 3 h. Limits: 10, 15 and 20 % at 4, 3 and 2 h; measured -3, +5, -8.
#[test]
fn facing_fronts_do_not_share_their_release() {
    for (ligament, limit) in [(4.0, 0.10), (3.0, 0.15), (2.0, 0.20)] {
        let mut errors = Vec::new();
        for seed in 0..4 {
            let specimen = plate([0.0, WIDTH], 1.5 * WIDTH, seed);
            let z = placement(seed).1;
            let a = 0.5 * (WIDTH - ligament * specimen.h);
            let left = edge_crack(-1.0, a, z);
            let body = specimen.cut(vec![left, edge_crack(WIDTH + 1.0, WIDTH - a, z)]);
            let pull = specimen.tractions(|_, n| n.z.abs() > 0.9, |_, n| *n);
            let solved = body.solve(body.at_points(&pull));
            let fronts = body.fronts();
            assert_eq!(fronts.len(), 2);
            let all = evaluate(&body.fields(&solved), &body.crack, &fronts, specimen.h, 0.0);
            let inside = all.iter().flatten().filter(|s| s.inside > 0.5);
            let x = 2.0 * a / WIDTH;
            let y = 1.122 - 0.561 * x - 0.205 * x * x + 0.471 * x.powi(3) - 0.19 * x.powi(4);
            let g = PI * a * y * y / (1.0 - x) / YOUNG;
            errors.push(mean_sd(&inside.map(|s| s.g / g - 1.0).collect::<Vec<_>>()).0);
        }
        check(&format!("facing fronts {ligament} h apart"), &errors, limit);
    }
}

/// SENT in a regular mesh whose brick columns run along the front and whose node planes hold the crack: the effective front moves
/// column by column, by up to half an element off the geometric one, and G is that of the crack that ends there.
///
/// Measured over eight lengths within one brick (h 1.25): against the length of the sheet G is +5 +- 7 %, from -7 to +15 %, against
/// that of the effective area -1 +- 4 %. The same with the crack between node planes (+4 +- 10, to +20 %): it is the columns along
/// the front, not the planes. In unstructured meshes elements along the front average this out. Limits: 10 % for the mean, 10 %
/// for each against the effective length.
#[test]
fn a_front_along_mesh_columns_moves_in_jumps() {
    let g = |a: f64| {
        let x = a / WIDTH;
        let y = 1.12 - 0.231 * x + 10.55 * x.powi(2) - 21.72 * x.powi(3) + 30.39 * x.powi(4);
        y * y * PI * a / YOUNG
    };
    let (low, high) = (Vec3::new(0.0, 0.0, -24.0), Vec3::new(20.0, 3.0, 24.0));
    let mesh = block_mesh(low, high, [20, 3, 48]);
    let near = [Vec3::new(0.0, 0.0, -3.0), Vec3::new(20.0, 3.0, 3.0)];
    let h = element_size(&mesh, near);
    let specimen = Specimen::new(mesh, YOUNG, 0.0, 1.0, h);
    let (mut by_sheet, mut by_area) = (Vec::new(), Vec::new());
    for k in 0..8 {
        let a = 8.0 + 0.125 * f64::from(k);
        let body = specimen.cut(vec![edge_crack(-1.0, a, 0.0)]);
        let pull = specimen.tractions(|_, n| n.z.abs() > 0.9, |_, n| *n);
        let found = front_mean(&body, &body.solve(body.at_points(&pull)));
        by_sheet.push(found / g(a) - 1.0);
        by_area.push(found / g(body.effective_area() / 3.0) - 1.0);
    }
    check("front along mesh columns, by the sheet", &by_sheet, 0.10);
    check(
        "front along mesh columns, by the effective area",
        &by_area,
        0.05,
    );
}
