//! draft
mod support;
use osteotome_mechanics::bone::Supports;
use osteotome_mechanics::crack::growth::{GrowthLengths, Surroundings, grow};
use osteotome_mechanics::crack::stress_intensity::front_frames;
use osteotome_mechanics::crack::{CrackSurface, Fragments};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use support::cracked::*;

fn notch(r: &mut impl FnMut() -> f64) -> TriMesh {
    let z = 4.0 + 0.8 * r();
    let tilt = 0.3 * r();
    let line = |x: f64| -> Vec<Vec3> {
        even(-1.0, 7.0, 14)
            .into_iter()
            .map(|y| Vec3::new(x, y, z + tilt * (y - 3.0) + 0.2 * x))
            .collect()
    };
    strip(&line(-1.0), &line(2.5 + r()))
}

#[test]
fn survey() {
    let n = if long() { 500 } else { 40 };
    let lines = [even(0.0, 10.0, 9), even(0.0, 6.0, 6), even(0.0, 8.0, 7)];
    let mut bad = std::collections::BTreeMap::<String, usize>::new();
    for seed in 0..n {
        let mesh = centred_block([&lines[0], &lines[1], &lines[2]], 0.12, seed);
        let h = element_size(&mesh, [Vec3::zeros(), Vec3::new(10.0, 6.0, 8.0)]);
        let s = Specimen::new(mesh, 1000.0, 0.3, 1.0, h);
        let mut r = support::noise(seed + 1000);
        let mut body = s.cut(vec![notch(&mut r)]);
        let lengths = GrowthLengths::for_element_size(s.h);
        let around = Surroundings {
            lengths,
            ..s.surroundings()
        };
        let pull = s.tractions(|_, n| n.z.abs() > 0.9, |_, n| *n);
        let mut work = body.solve(body.at_points(&pull)).work;
        let mut area = body.crack.sheets[0].mesh.area();
        let mut severed = false;
        let mut say = |what: String, k: usize| {
            *bad.entry(what.clone()).or_default() += 1;
            eprintln!("seed {seed} step {k}: {what}");
        };
        for k in 0..16 {
            let fronts = body.fronts();
            if fronts.is_empty() {
                break;
            }
            let (mut crack, mut cuts) = (body.crack.clone(), body.cuts.clone());
            let (steer, wave, rest) = (0.5 * r(), 0.4 * r(), r());
            for front in &fronts {
                let (points, advance) = front_frames(&crack.sheets[front.sheet], front, s.h);
                let moves: Vec<Vec3> = points
                    .iter()
                    .zip(&advance)
                    .map(|(p, q)| {
                        let v = (0.9 * p.y + 3.0 * wave).sin();
                        let step = lengths.increment * (0.55 + 0.45 * v);
                        let kink = steer + 0.3 * (1.3 * p.y).cos() * wave + 0.15 * r();
                        let n = q.cross(&Vec3::y()).try_normalize(1e-9).unwrap_or(Vec3::z());
                        if rest > 0.5 && p.y > 3.0 {
                            return Vec3::zeros();
                        }
                        (q * kink.cos() + n * kink.sin()) * step
                    })
                    .collect();
                let before = crack.sheets[front.sheet].mesh.triangles.len();
                let strip = grow(&mut crack, front, &moves, &around);
                strip.cut(&mut cuts, &s.mesh, &s.locator, 1);
                let m = &crack.sheets[front.sheet].mesh;
                for t in before..m.triangles.len() {
                    let a = m.area_normal(t).norm();
                    if !(a > 1e-3 * h * h) {
                        say(format!("flat triangle"), k);
                    }
                }
                check_mesh(m, before, &mut |w| say(w, k));
            }
            let next = Cracked::new(&s, crack, cuts);
            let new_area: f64 = next.crack.sheets.iter().map(|x| x.mesh.area()).sum();
            if new_area < area {
                say("area fell".into(), k);
            }
            let solved = next.solve(next.at_points(&pull));
            if !(solved.work >= work * (1.0 - 1e-9)) {
                say("compliance fell".into(), k);
            }
            if !solved.work.is_finite() {
                say("nan".into(), k);
            }
            let fragments = Fragments::find(&s.mesh, &next.cuts);
            let now = fragments.count() >= 2;
            severed |= now;
            work = solved.work;
            area = new_area;
            body = next;
        }
        if body.fronts().is_empty() != severed {
            say(
                format!("fronts {} severed {severed}", body.fronts().len()),
                99,
            );
        }
        let _ = (Supports::default(), CrackSurface::default());
    }
    eprintln!("{bad:?}");
}

/// Folds: neighbouring triangles whose normals oppose; edges used more than twice or in the same sense twice.
fn check_mesh(m: &TriMesh, from: usize, say: &mut impl FnMut(String)) {
    let mut edges = std::collections::BTreeMap::<[u32; 2], usize>::new();
    for (t, tri) in m.triangles.iter().enumerate() {
        for k in 0..3 {
            if edges.insert([tri[k], tri[(k + 1) % 3]], t).is_some() {
                say("edge twice".into());
            }
        }
    }
    for (e, t) in &edges {
        if let Some(o) = edges.get(&[e[1], e[0]]) {
            if t < o && (*t >= from || *o >= from) {
                let (a, b) = (m.area_normal(*t).normalize(), m.area_normal(*o).normalize());
                if a.dot(&b) < -0.2 {
                    say(format!("fold"));
                }
            }
        }
    }
}
