//! Orthotropic bodies: patch test, limits and frames, and a centre crack against the closed forms of its energy release.
//!
//! Centre crack of length 2a along axis 1 of a wide plate, axis 2 across it, under remote tension s or shear t: K_I = s sqrt(pi a),
//! K_II = t sqrt(pi a) whatever the constants, and (Sih, Paris & Irwin 1965), with b = sqrt(a22/a11) + (2 a12 + a66) / (2 a11),
//! G_I = K_I^2 sqrt(a11 a22 / 2) sqrt(b), G_II = K_II^2 a11 sqrt(b / 2); a_ij are the compliances in the plane.
//! nu13 = nu23 = 0, so that the plate's faces add no third dimension. Finite size: half width 6 a, height 6 a (K +1 %).
//!
//! J needs no auxiliary field. K comes from the interaction with isotropic fields, whose matrix onto K_I, K_II, K_III is integrated
//! with the body's own near field (crack/anisotropic.rs). Measured at a/h 10, 2 placements, error in % against the closed form, and J
//! against the code's own dU/dA in tension and shear:
//!
//! | E1 : E2 | G_I | G_II | K_I | K_II | K_II / K_I | J_I, J_II against dU/dA |
//! |---|---|---|---|---|---|---|
//! | 1 : 1 | -2 | -4 | -0 | -2 | -1 | +3, +1 |
//! | 5 : 3 (crack along the osteons) | -3 | -5 | -1 | +0 | +1 | +3, +0 |
//! | 3 : 5 (across) | -2 | -4 | -0 | -3 | -3 | +3, +1 |
//! | 4 : 1 | -3 | -7 | -1 | +5 | +6 | +3, -2 |
//! | 1 : 4 | -0 | -3 | +1 | -6 | -7 | +5, +1 |
//!
//! Read as if the body were isotropic (E' and mu of Hill's mean), the same integrals gave K_II / K_I 19 % too low at 5 : 3, 39 % at
//! 4 : 1. What is left isotropic is the kink: Amestoy and Leblond's functions, with these K.
mod support;
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector6};
use osteotome_mechanics::bone::{
    EngineeringConstants, Orthotropic, Prescribed, Supports, TetMaterial,
};
use osteotome_mechanics::crack::stress_intensity::Station;
use osteotome_mechanics::geometry::{TetMesh, Vec3};
use std::f64::consts::PI;
use support::cracked::*;

/// Cortical bone with axis 1 along the osteons: the order of magnitude of published constants, not a measurement.
const BONE: EngineeringConstants = EngineeringConstants {
    e1: 20_000.0,
    e2: 12_000.0,
    e3: 11_000.0,
    nu12: 0.35,
    nu23: 0.4,
    nu13: 0.3,
    g12: 5500.0,
    g23: 4000.0,
    g13: 5000.0,
};

fn law(axes: &Matrix3<f64>) -> Orthotropic {
    Orthotropic::new(&BONE, &axes.column(0).into(), &axes.column(1).into()).unwrap()
}

/// The symmetric strain that `law` answers with `stress`.
fn strain_of(law: &Orthotropic, stress: &Matrix3<f64>) -> Matrix3<f64> {
    const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)];
    let unit = |k: usize| {
        let mut m = Matrix3::zeros();
        (m[PAIRS[k]], m[(PAIRS[k].1, PAIRS[k].0)]) = (1.0, 1.0);
        m
    };
    let list = |m: &Matrix3<f64>| Vector6::from_fn(|i, _| m[PAIRS[i]]);
    let columns: Vec<Vector6<f64>> = (0..6).map(|k| list(&law.stress(&unit(k)))).collect();
    let solved = Matrix6::from_columns(&columns)
        .lu()
        .solve(&list(stress))
        .unwrap();
    (0..6).map(|k| unit(k) * solved[k]).sum()
}

/// Uniform tension along a cut that goes right through leaves every cell with that stress, whatever the axes: 1e-9.
#[test]
fn uniform_stress_is_exact_whole_and_cut() {
    let axes = Rotation3::from_euler_angles(0.4, -0.9, 1.7).into_inner();
    let law = law(&axes);
    let stress = Matrix3::from_diagonal(&Vec3::new(3.0, 0.0, 0.0));
    let strain = strain_of(&law, &stress);
    let lines = even(0.0, 5.0, 5);
    let mut specimen = Specimen::new(
        centred_block([&lines; 3].map(|l| &l[..]), 0.0, 3),
        1.0,
        0.0,
        1.0,
        1.0,
    );
    specimen.materials.fill(TetMaterial::orthotropic(law, 1.0));
    let on_faces = |p: &Vec3| p.iter().any(|c| *c < 1e-9 || *c > 5.0 - 1e-9);
    let held = (0u32..)
        .zip(specimen.mesh.nodes())
        .filter(|(_, p)| on_faces(p));
    let moved = held.flat_map(|(node, p)| {
        let u = strain * p;
        (0..3u8).map(move |axis| Prescribed {
            node,
            axis,
            value: u[usize::from(axis)],
        })
    });
    specimen.supports = Supports {
        prescribed: moved.collect(),
        ..Default::default()
    };
    let wide = |y: f64| {
        even(-1.0, 6.0, 7)
            .into_iter()
            .map(|x| Vec3::new(x, y, 2.3))
            .collect::<Vec<_>>()
    };
    for sheets in [vec![], vec![strip(&wide(-1.0), &wide(6.0))]] {
        let body = specimen.cut(sheets);
        let mut x = vec![0.0; body.system.n()];
        body.system.add_prescribed(&mut x);
        body.system.solve(&mut x, &mut body.system.scratch());
        let off = body
            .stresses(&x)
            .iter()
            .map(|s| (s - stress).amax())
            .fold(0.0, f64::max);
        assert!(off < 1e-9 * 3.0, "a stress is off by {off:e} MPa");
    }
}

/// An inclined edge crack in a small plate, turned by `map` with everything in it.
fn edge_crack(
    map: &Matrix3<f64>,
    material: impl Fn(&Matrix3<f64>) -> TetMaterial,
) -> (f64, Vec<Station>) {
    let step = 1.0 / 0.91;
    let lines = [
        even(0.0, 10.0, 9),
        even(0.0, 4.0, 4),
        graded(3.0 * step, 8.0, step, 1.35),
    ];
    let plain = centred_block([&lines[0], &lines[1], &lines[2]], 0.12, 1);
    let h = element_size(
        &plain,
        [Vec3::new(0.0, 0.0, -3.0), Vec3::new(10.0, 4.0, 3.0)],
    );
    let nodes = plain.nodes().iter().map(|p| map * p).collect();
    let mesh = TetMesh::new(nodes, plain.tets().to_vec()).unwrap();
    let mut specimen = Specimen::new(mesh, 10_000.0, 0.3, 1.0, h);
    specimen.materials.fill(material(map));
    let line = |d: f64| -> Vec<Vec3> {
        let through = even(-1.0, 5.0, 12).into_iter();
        through
            .map(|y| map * Vec3::new(0.9 * d, y, 0.436 * d - 0.93))
            .collect()
    };
    let body = specimen.cut(vec![strip(&line(-1.0), &line(4.7))]);
    let up = map * Vec3::z();
    let pull = specimen.tractions(|_, n| n.dot(&up).abs() > 0.9, |_, n| *n);
    let solved = body.solve(body.at_points(&pull));
    let front = body.fronts().remove(0);
    (solved.work, body.stations(&solved, &front))
}

/// Energy 1e-8, G and K .5 %: as for isotropic bodies (`rotation_and_mirror.rs`).
#[test]
fn a_body_turned_with_its_axes_answers_alike() {
    let axes = Rotation3::from_euler_angles(0.2, 0.5, -0.3).into_inner();
    let turn = Rotation3::from_euler_angles(0.7, -1.1, 2.3).into_inner();
    let bone = |map: &Matrix3<f64>| TetMaterial::orthotropic(law(&(map * axes)), 1.0);
    let (plain, turned) = (
        edge_crack(&Matrix3::identity(), bone),
        edge_crack(&turn, bone),
    );
    assert!(
        (turned.0 / plain.0 - 1.0).abs() < 1e-8,
        "energy {} and {}",
        plain.0,
        turned.0
    );
    assert_eq!(plain.1.len(), turned.1.len());
    for (a, b) in plain.1.iter().zip(&turned.1) {
        assert!(
            (a.g - b.g).abs() <= 0.005 * a.g.abs().max(1e-4),
            "G {} and {}",
            a.g,
            b.g
        );
        for (p, q) in [(a.k.k1, b.k.k1), (a.k.k2, b.k.k2), (a.k.k3, b.k.k3)] {
            assert!(
                (p - q).abs() <= 0.005 * a.k.k1.abs().max(1e-3),
                "K {p} and {q}"
            );
        }
    }
}

/// Nine constants of an isotropic solid in any frame give what E and nu give: energy and G to 1e-9, K to .2 % of K_I, as the
/// formalism needs a nudge where its eigenvalues coincide.
#[test]
fn equal_constants_give_the_isotropic_answer() {
    let same = Orthotropic::new(
        &EngineeringConstants::isotropic(10_000.0, 0.3),
        &Vec3::new(1.0, 0.3, 0.2),
        &Vec3::y(),
    );
    let nine = TetMaterial::orthotropic(same.unwrap(), 1.0);
    let identity = Matrix3::identity();
    let (work, stations) = edge_crack(&identity, |_| nine);
    let (expected, two) = edge_crack(&identity, |_| TetMaterial::isotropic(10_000.0, 0.3, 1.0));
    assert!((work / expected - 1.0).abs() < 1e-9);
    for (a, b) in stations.iter().zip(&two) {
        assert!(
            (a.g - b.g).abs() < 1e-9 * b.g.abs().max(1e-4),
            "G {} and {}",
            a.g,
            b.g
        );
        for (p, q) in [(a.k.k1, b.k.k1), (a.k.k2, b.k.k2), (a.k.k3, b.k.k3)] {
            assert!(
                (p - q).abs() < 2e-3 * b.k.k1.abs().max(1e-3),
                "K {p} and {q}"
            );
        }
    }
}

/// Half length of the centre crack \[mm\]; the element size is about 1 mm.
const HALF: f64 = 9.0;

/// A centre crack of one material and placement under one remote stress.
struct CentreCrack {
    work: f64,
    area: f64,
    /// Means of G, K_I and |K_II| over both fronts inside the body: the fronts' frames differ in sense.
    front: [f64; 3],
}

fn plate(material: TetMaterial, seed: u64) -> Specimen {
    let step = 1.0 / 0.91;
    let lines = [
        graded(11.0 * step, 15.0 * HALF, step, 1.35),
        even(0.0, 3.0, 3),
        graded(3.0 * step, 15.0 * HALF, step, 1.35),
    ];
    let mesh = centred_block([&lines[0], &lines[1], &lines[2]], 0.12, seed);
    let near = [Vec3::new(-11.0, 0.0, -3.0), Vec3::new(11.0, 3.0, 3.0)];
    let h = element_size(&mesh, near);
    let mut specimen = Specimen::new(mesh, material.young_modulus, 0.0, 1.0, h);
    specimen.materials.fill(material);
    specimen
}

/// Answers to remote tension and to remote shear, 1 MPa each.
fn centre_crack(specimen: &Specimen, half: f64, seed: u64) -> [CentreCrack; 2] {
    let z = 0.5 * support::noise(seed + 40)();
    let line = |x: f64| -> Vec<Vec3> {
        let through = even(-1.0, 4.0, 10).into_iter();
        through.map(|y| Vec3::new(x, y, z)).collect()
    };
    let body = specimen.cut(vec![strip(&line(-half), &line(half))]);
    let tension = Matrix3::from_diagonal(&Vec3::z());
    let shear = Matrix3::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
    [tension, shear].map(|stress| {
        let solved = body.solve(body.at_points(&specimen.remote(stress)));
        let fronts = body.fronts();
        let all = fronts.iter().flat_map(|f| body.stations(&solved, f));
        let inside: Vec<Station> = all.filter(|s| s.inside > 0.5).collect();
        let mean = |f: fn(&Station) -> f64| mean_sd(&inside.iter().map(f).collect::<Vec<_>>()).0;
        CentreCrack {
            work: solved.work,
            area: body.effective_area(),
            front: [mean(|s| s.g), mean(|s| s.k.k1), mean(|s| s.k.k2.abs())],
        }
    })
}

fn in_plane(e1: f64, e2: f64, g12: f64) -> EngineeringConstants {
    EngineeringConstants {
        e1,
        e2,
        e3: e2,
        nu12: 0.3,
        nu23: 0.0,
        nu13: 0.0,
        g12,
        g23: g12,
        g13: g12,
    }
}

/// (G_I / K_I^2, G_II / K_II^2).
fn sih_paris_irwin(c: &EngineeringConstants) -> (f64, f64) {
    let (a11, a22, a12, a66) = (1.0 / c.e1, 1.0 / c.e2, -c.nu12 / c.e1, 1.0 / c.g12);
    let b = (a22 / a11).sqrt() + (2.0 * a12 + a66) / (2.0 * a11);
    ((a11 * a22 / 2.0).sqrt() * b.sqrt(), a11 * (b / 2.0).sqrt())
}

/// Errors of G_I, G_II, J in tension and in shear against the code's own dU/dA, K_I, K_II, K_II / K_I.
fn errors(c: &EngineeringConstants, seed: u64) -> [f64; 7] {
    let law = Orthotropic::new(c, &Vec3::x(), &Vec3::z()).unwrap();
    let specimen = plate(TetMaterial::orthotropic(law, 1.0), seed);
    let [short, middle, long] = [-2.0, 0.0, 2.0].map(|d| centre_crack(&specimen, HALF + d, seed));
    let against_energy = |mode: usize| {
        let [a, b, c] = [&short, &middle, &long].map(|x| &x[mode]);
        let released = 0.5 * (c.work - a.work) / (c.area - a.area);
        (a.front[0] + 4.0 * b.front[0] + c.front[0]) / (6.0 * released)
    };
    let (one, two) = sih_paris_irwin(c);
    let k = (PI * HALF).sqrt();
    let ([gi, k1, _], [gii, _, k2]) = (middle[0].front, middle[1].front);
    [
        gi / (one * k * k),
        gii / (two * k * k),
        against_energy(0),
        against_energy(1),
        k1 / k,
        k2 / k,
        k2 / k1,
    ]
    .map(|f| f - 1.0)
}

/// Limits: 8 % against the closed forms, 6 % for J against dU/dA, as in isotropic bodies. `OSTEOTOME_LONG=1`: all materials.
#[test]
fn centre_crack_meets_sih_paris_and_irwin() {
    let cases = [
        ("E1 : E2 = 5 : 3", in_plane(20_000.0, 12_000.0, 5500.0)),
        ("E1 : E2 = 3 : 5", in_plane(12_000.0, 20_000.0, 5500.0)),
        ("E1 = E2", in_plane(10_000.0, 10_000.0, 10_000.0 / 2.6)),
        ("E1 : E2 = 4 : 1", in_plane(40_000.0, 10_000.0, 5000.0)),
        ("E1 : E2 = 1 : 4", in_plane(10_000.0, 40_000.0, 5000.0)),
    ];
    let n_cases = if long() { cases.len() } else { 1 };
    let mut failed = Vec::new();
    for (name, c) in cases.into_iter().take(n_cases) {
        let found: Vec<[f64; 7]> = (0..2).map(|seed| errors(&c, seed)).collect();
        let limits = [0.08, 0.08, 0.06, 0.06, 0.08, 0.08, 0.08];
        let whats = [
            "G_I",
            "G_II",
            "J_I against dU/dA",
            "J_II against dU/dA",
            "K_I",
            "K_II",
            "K_II / K_I",
        ];
        for (i, (what, limit)) in whats.iter().zip(limits).enumerate() {
            let (mean, sd) = mean_sd(&found.iter().map(|f| f[i]).collect::<Vec<_>>());
            let line =
                format!("orthotropic {name}: {what} off by {mean:+.4} +- {sd:.4} (limit {limit})");
            measured(&line);
            if mean.abs() >= limit {
                failed.push(line);
            }
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

/// Axes turned by 30 degrees in the plane: K_I and K_II are those of the remote stress, as the loads on a hole's border balance
/// themselves, and tension opens no shear. Limits 8 %.
#[test]
fn askew_axes_change_no_stress_intensity() {
    let (sin, cos) = (PI / 6.0).sin_cos();
    let (one, two) = (Vec3::new(cos, 0.0, sin), Vec3::new(-sin, 0.0, cos));
    let law = Orthotropic::new(&in_plane(20_000.0, 12_000.0, 5500.0), &one, &two).unwrap();
    let specimen = plate(TetMaterial::orthotropic(law, 1.0), 1);
    let [tension, shear] = centre_crack(&specimen, HALF, 1).map(|c| c.front);
    let k = (PI * HALF).sqrt();
    let found = [tension[1] / k - 1.0, tension[2] / k, shear[2] / k - 1.0];
    measured(&format!("orthotropic, axes askew: {found:.3?}"));
    assert!(found.iter().all(|e| e.abs() < 0.08), "{found:?}");
}
