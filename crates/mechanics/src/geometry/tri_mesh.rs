use super::{Aabb, Vec3};
use rustc_hash::FxHashMap;

/// A triangle mesh with shared vertices \[mm\].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriMesh {
    /// Vertex positions.
    pub vertices: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from outside (closed meshes) or from the positive side (sheets).
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// Corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].map(|v| self.vertices[v as usize])
    }

    /// Twice the area times the unit normal of triangle `t`.
    pub fn area_normal(&self, t: usize) -> Vec3 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(&(c - a))
    }

    /// Adds the triangles of another mesh; vertices are not merged.
    pub fn append(&mut self, other: &Self) {
        let offset = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles
            .extend(other.triangles.iter().map(|t| t.map(|v| v + offset)));
    }

    /// Box around all vertices.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(&self.vertices)
    }

    /// Total area \[mm2\].
    pub fn area(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| 0.5 * self.area_normal(t).norm())
            .sum()
    }

    /// Enclosed volume \[mm3\] by the divergence theorem: positive for outward normals, meaningful for closed meshes.
    pub fn volume(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum()
    }

    /// Directed edges `(from, to)` that no neighbour runs the other way: the border, in the triangles' own sense.
    ///
    /// A closed, consistently oriented mesh has none. Sorted, so that the result does not depend on hashing.
    pub fn border_edges(&self) -> Vec<[u32; 2]> {
        let mut uses: FxHashMap<[u32; 2], i32> = FxHashMap::default();
        for t in &self.triangles {
            for k in 0..3 {
                *uses.entry([t[k], t[(k + 1) % 3]]).or_default() += 1;
            }
        }
        let mut border: Vec<_> = uses
            .iter()
            .filter(|(e, n)| **n > uses.get(&[e[1], e[0]]).copied().unwrap_or(0))
            .map(|(e, _)| *e)
            .collect();
        border.sort_unstable();
        border
    }
}
