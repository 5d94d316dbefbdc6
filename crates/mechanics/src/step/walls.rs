//! Points on the walls of the crack: what a chisel pushes on.
use super::bone::Body;
use crate::contact::{PointOrigin, ShellPoint, ShellPoints};
use crate::crack::{CrackSurface, Sheet, Topology};
use crate::geometry::Vec3;
use std::collections::BTreeMap;
use std::ops::Range;

/// Appends points on both walls of the sheet's triangles from `first` on, wherever they lie inside the body.
pub fn push_walls(body: &Body, sheet: &Sheet, first: usize, points: &mut Vec<ShellPoint>) {
    for t in first..sheet.mesh.triangles.len() {
        let area_normal = sheet.mesh.area_normal(t);
        let area = 0.5 * area_normal.norm();
        let Some(normal) = area_normal.try_normalize(1e-12) else {
            continue;
        };
        let corners = sheet.mesh.corners(t);
        let kerf = sheet.mesh.triangles[t].map(|v| sheet.kerf[v as usize]);
        let n = (area * body.wall_density).ceil().max(1.0) as u32;
        for k in 0..n {
            let w = spread(k, n);
            let middle: Vec3 = (0..3).map(|c| corners[c] * w[c]).sum();
            let half_width: f64 = (0..3).map(|c| kerf[c] * w[c]).sum();
            for side in [1.0, -1.0] {
                let p = middle + normal * (side * half_width);
                if body.region.0.signed(&p) > 0.0 {
                    continue;
                }
                let Some((tet, weights)) = body.embed(&p) else {
                    continue;
                };
                points.push(ShellPoint {
                    position: p,
                    tet,
                    weights: weights.map(|v| v as f32),
                    area: (area / f64::from(n)) as f32,
                    origin: PointOrigin::Wall {
                        normal: normal * -side,
                    },
                });
            }
        }
    }
}

/// Point `k` of `n` spread evenly over a triangle: Kronecker sequence folded into it, as barycentric coordinates.
fn spread(k: u32, n: u32) -> [f64; 3] {
    // The fractional part of the golden ratio spreads the second coordinate.
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let a = (f64::from(k) + 0.5) / f64::from(n);
    let b = (f64::from(k) * GOLDEN + 0.5).fract();
    let root = a.sqrt();
    [1.0 - root, root * (1.0 - b), root * b]
}

/// The cell of a point.
pub fn side_cell(body: &Body, topology: &Topology, p: &ShellPoint) -> u32 {
    match p.origin {
        PointOrigin::Surface => topology.cell_at(p.tet, &p.weights.map(f64::from)),
        PointOrigin::Wall { normal } => {
            topology.cell_towards(&body.mesh, p.tet, &p.position, &-normal)
        }
    }
}

/// The tetrahedra that hold some points, with the points that each holds.
pub fn tets_with(points: &ShellPoints, ids: Range<u32>) -> BTreeMap<u32, Vec<u32>> {
    let mut held: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for id in ids {
        held.entry(points.get(id).tet).or_default().push(id);
    }
    held
}

/// Whether the saw took the material at `p`.
pub fn in_kerf(crack: &CrackSurface, p: &Vec3) -> bool {
    crack.sheets.iter().any(|s| {
        let widest = s.kerf.iter().copied().fold(0.0, f64::max);
        widest > 0.0
            && s.is_near(p, widest)
            && s.closest(p).is_some_and(|(distance, t, w)| {
                let half: f64 = (0..3)
                    .map(|c| s.kerf[s.mesh.triangles[t][c] as usize] * w[c])
                    .sum();
                distance < half
            })
    })
}
