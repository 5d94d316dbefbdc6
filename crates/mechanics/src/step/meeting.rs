//! Fronts about to meet another sheet of the crack.
//!
//! What is left between a front and a sheet an element or two ahead lies inside the domain of every integral, so K says nothing about
//! it. Such a front is moved straight to the sheet; the balance of the whole body tells whether that happens.
use crate::crack::growth::GrowthLengths;
use crate::crack::stress_intensity::Station;
use crate::crack::{CrackSurface, EvaluatedFront};
use crate::geometry::Vec3;

/// Sheets farther away than this many element sizes are not seen.
const REACH: f64 = 1.5;
/// A sheet is ahead if it lies within 60 degrees of the way the front would advance.
const AHEAD: f64 = 0.5;

/// For each front, the way of each vertex to another sheet \[mm\]; zero where there is none ahead.
pub(super) fn ways(
    fronts: &[EvaluatedFront],
    crack: &CrackSurface,
    lengths: &GrowthLengths,
) -> Vec<Vec<Vec3>> {
    let of = |front: &EvaluatedFront| {
        let way = |s: &Station| way(s, front.front.sheet, crack, lengths);
        front.stations.iter().map(way).collect()
    };
    fronts.iter().map(of).collect()
}

fn way(station: &Station, sheet: usize, crack: &CrackSurface, lengths: &GrowthLengths) -> Vec3 {
    if station.inside < 0.5 {
        return Vec3::zeros();
    }
    let others = crack.sheets.iter().enumerate().filter(|(k, _)| *k != sheet);
    let feet = others.filter_map(|(_, s)| s.closest_within(&station.position, REACH * lengths.h));
    let ways = feet.map(|foot| foot - station.position);
    let ahead = |w: &Vec3| w.dot(&station.advance) >= AHEAD * w.norm();
    let nearest = ways
        .filter(ahead)
        .min_by(|a, b| a.norm().total_cmp(&b.norm()));
    nearest.map_or_else(Vec3::zeros, |w| {
        w * (1.0 + lengths.overshoot() / w.norm().max(1e-9))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crack::{Front, Sheet};
    use crate::geometry::TriMesh;

    fn wall(x: f64) -> Sheet {
        let corner = |y: f64, z: f64| Vec3::new(x, y, z);
        Sheet {
            mesh: TriMesh {
                vertices: vec![corner(-9.0, 0.0), corner(9.0, 0.0), corner(0.0, 9.0)],
                triangles: vec![[0, 1, 2]],
            },
            ..Sheet::default()
        }
    }

    /// A front along y that advances along x, with a sheet ahead of it, one behind and one beyond reach.
    #[test]
    fn a_front_sees_the_sheet_ahead_of_it_and_no_other() {
        let lengths = GrowthLengths::for_element_size(1.0);
        let way = |walls: &[f64], inside: f64| {
            let sheets = std::iter::once(Sheet::default()).chain(walls.iter().map(|x| wall(*x)));
            let crack = CrackSurface {
                sheets: sheets.collect(),
            };
            let station = Station {
                position: Vec3::new(0.0, 0.0, 2.0),
                inside,
                ..Station::of_mode_one()
            };
            let front = EvaluatedFront {
                front: Front {
                    sheet: 0,
                    vertices: vec![0],
                    closed: false,
                },
                stations: vec![station],
            };
            ways(&[front], &crack, &lengths)[0][0]
        };
        let ahead = Vec3::x() * (1.2 + lengths.overshoot());
        assert!((way(&[1.2], 1.0) - ahead).norm() < 1e-12);
        assert!((way(&[-0.5, 1.2, 1.4], 1.0) - ahead).norm() < 1e-12);
        for (walls, inside) in [(&[-0.5][..], 1.0), (&[1.6], 1.0), (&[], 1.0), (&[1.2], 0.2)] {
            assert_eq!(way(walls, inside), Vec3::zeros(), "{walls:?} {inside}");
        }
    }
}
