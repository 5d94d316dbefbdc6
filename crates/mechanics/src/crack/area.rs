use super::body::CrackedBody;
use crate::geometry::{Aabb, TetMesh, Vec3};

impl CrackedBody {
    /// Area of the explicit crack inside the body \[mm2\]: its triangles, clipped by the tetrahedra.
    pub fn explicit_area(&self) -> f64 {
        let s = &self.solid;
        let mut area = 0.0;
        let mut near = Vec::new();
        for sheet in &self.crack.sheets {
            for t in 0..sheet.mesh.triangles.len() {
                // A triangle that lies in a face between two tetrahedra belongs to one of them only.
                let aside = sheet.mesh.area_normal(t).try_normalize(1e-300);
                let aside = aside.unwrap_or_default() * (1e-7 * s.lengths.h);
                let triangle = sheet.mesh.corners(t).map(|p| p + aside);
                near.clear();
                let query = Aabb::around(&triangle);
                s.locator.tets_near(&query, |tet| near.push(tet));
                near.sort_unstable();
                near.dedup();
                area += near
                    .iter()
                    .map(|&tet| clipped_area(&s.mesh, tet, &triangle))
                    .sum::<f64>();
            }
        }
        area
    }

    /// Area of the crack as it is free to open \[mm2\]: the integral over its cut polygons of the sum of the shape functions of
    /// enriched nodes.
    pub fn effective_area(&self) -> f64 {
        let tets = 0..self.solid.mesh.tets().len() as u32;
        tets.map(|t| self.faces_in(t).0).sum()
    }
}

/// Area of the part of a triangle inside a tetrahedron: clipped by one face after the other.
fn clipped_area(mesh: &TetMesh, tet: u32, triangle: &[Vec3; 3]) -> f64 {
    let mut polygon: Vec<(Vec3, [f64; 4])> = triangle
        .iter()
        .map(|p| (*p, mesh.barycentric(tet as usize, p)))
        .collect();
    for face in 0..4 {
        if polygon.iter().all(|p| p.1[face] <= 0.0) {
            return 0.0;
        }
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for k in 0..polygon.len() {
            let (a, b) = (&polygon[k], &polygon[(k + 1) % polygon.len()]);
            if a.1[face] >= 0.0 {
                kept.push(*a);
            }
            if (a.1[face] >= 0.0) != (b.1[face] >= 0.0) {
                let w = a.1[face] / (a.1[face] - b.1[face]);
                let mut n = [0.0; 4];
                (0..4).for_each(|i| n[i] = a.1[i] * (1.0 - w) + b.1[i] * w);
                kept.push((a.0 * (1.0 - w) + b.0 * w, n));
            }
        }
        polygon = kept;
    }
    let Some(first) = polygon.first() else {
        return 0.0;
    };
    let fan = polygon.windows(2);
    let sum: Vec3 = fan
        .map(|w| (w[0].0 - first.0).cross(&(w[1].0 - first.0)))
        .sum();
    0.5 * sum.norm()
}
