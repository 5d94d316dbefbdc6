//! No axis and no hand is special: a problem turned or mirrored as a whole gives the same energy, G and |K|.
//!
//! An inclined edge crack in a small plate under tension, turned by a general rotation, mirrored, and both. Energy to 1e-8; G and K
//! to .5 %: which of two equally near front points a node belongs to, and which nodes are snapped, may change by rounding.
mod support;
use nalgebra::{Matrix3, Rotation3};
use osteotome_mechanics::geometry::{TetMesh, TriMesh, Vec3};
use support::cracked::*;

struct Answer {
    work: f64,
    stations: Vec<osteotome_mechanics::crack::stress_intensity::Station>,
}

fn solve(map: &Matrix3<f64>) -> Answer {
    let step = 1.0 / 0.91;
    let lines = [
        even(0.0, 10.0, 9),
        even(0.0, 4.0, 4),
        graded(3.0 * step, 8.0, step, 1.35),
    ];
    let plain = centred_block([&lines[0], &lines[1], &lines[2]], 0.12, 1);
    let mirrored = map.determinant() < 0.0;
    let mesh = TetMesh::new(
        plain.nodes().iter().map(|p| map * p).collect(),
        plain
            .tets()
            .iter()
            .map(|t| {
                if mirrored {
                    [t[0], t[2], t[1], t[3]]
                } else {
                    *t
                }
            })
            .collect(),
    )
    .unwrap();
    let h = element_size(
        &plain,
        [Vec3::new(0.0, 0.0, -3.0), Vec3::new(10.0, 4.0, 3.0)],
    );
    let specimen = Specimen::new(mesh, 1000.0, 0.3, 1.0, h);
    let line = |d: f64| -> Vec<Vec3> {
        let through = even(-1.0, 5.0, 12).into_iter();
        through
            .map(|y| Vec3::new(0.9 * d, y, 0.436 * d - 0.93))
            .collect()
    };
    let flat = strip(&line(-1.0), &line(4.7));
    let sheet = TriMesh {
        vertices: flat.vertices.iter().map(|p| map * p).collect(),
        // A mirrored crack keeps its upper side.
        triangles: flat
            .triangles
            .iter()
            .map(|t| if mirrored { [t[0], t[2], t[1]] } else { *t })
            .collect(),
    };
    let body = specimen.cut(vec![sheet]);
    let up = map * Vec3::z();
    let solved =
        body.solve(body.at_points(&specimen.tractions(|_, n| n.dot(&up).abs() > 0.9, |_, n| *n)));
    let front = body.fronts().remove(0);
    Answer {
        work: solved.work,
        stations: body.stations(&solved, &front),
    }
}

#[test]
fn turned_and_mirrored_problems_agree() {
    let plain = solve(&Matrix3::identity());
    let turn = Rotation3::from_euler_angles(0.7, -1.1, 2.3).into_inner();
    let mirror = Matrix3::from_diagonal(&Vec3::new(1.0, -1.0, 1.0));
    for (name, map) in [
        ("turned", turn),
        ("mirrored", mirror),
        ("both", turn * mirror),
    ] {
        let other = solve(&map);
        let energy = (other.work / plain.work - 1.0).abs();
        assert!(energy < 1e-8, "{name}: energy off by {energy:e}");
        assert_eq!(other.stations.len(), plain.stations.len(), "{name}");
        for s in &plain.stations {
            let image = map * s.position;
            let nearest = other.stations.iter().min_by(|a, b| {
                (a.position - image)
                    .norm()
                    .total_cmp(&(b.position - image).norm())
            });
            let o = nearest.unwrap();
            assert!(
                (o.position - image).norm() < 1e-9,
                "{name}: no station at {image}"
            );
            assert!(
                (o.g - s.g).abs() <= 0.005 * s.g.abs().max(1e-3),
                "{name}: G {} instead of {}",
                o.g,
                s.g
            );
            for (a, b) in [
                (o.k.k1, s.k.k1),
                (o.k.k2, s.k.k2),
                (o.k.k3.abs(), s.k.k3.abs()),
            ] {
                assert!(
                    (a - b).abs() <= 0.005 * s.k.k1.abs().max(1e-3),
                    "{name}: K {a} instead of {b}"
                );
            }
        }
    }
}
