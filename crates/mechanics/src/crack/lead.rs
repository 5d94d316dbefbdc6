use super::cut_edges::CutEdges;
use crate::geometry::{Aabb, TetLocator, TetMesh, TriMesh, Vec3, closest_on_triangle};

/// The surface ahead of a front along which mechanics is cut already: the mechanical front lags the geometric one.
#[derive(Clone, Debug, Default)]
pub struct Lead {
    /// From the front to the end of the lead.
    pub mesh: TriMesh,
    /// From the front to where the polygons of the last cut elements may reach.
    reach: TriMesh,
    /// How far each vertex of `reach` lies beyond the end of the lead; negative before it \[mm\].
    beyond: Vec<f64>,
}

impl Lead {
    /// Between the points of a front and `lengths` ahead of them along unit `directions`; elements may reach `margin` farther.
    pub(super) fn new(front: &[Vec3], directions: &[Vec3], lengths: &[f64], margin: f64) -> Self {
        let n = front.len() as u32;
        let strip = |extra: f64| {
            let ahead = (0..front.len()).map(|k| front[k] + directions[k] * (lengths[k] + extra));
            TriMesh {
                vertices: front.iter().copied().chain(ahead).collect(),
                triangles: (0..n.saturating_sub(1))
                    .flat_map(|k| [[k, n + k, n + k + 1], [k, n + k + 1, k + 1]])
                    .collect(),
            }
        };
        let beyond = lengths
            .iter()
            .map(|l| -l)
            .chain(lengths.iter().map(|_| margin));
        Self {
            mesh: strip(0.0),
            reach: strip(margin),
            beyond: beyond.collect(),
        }
    }

    /// Appends another lead.
    pub fn append(&mut self, other: &Self) {
        self.mesh.append(&other.mesh);
        self.reach.append(&other.reach);
        self.beyond.extend_from_slice(&other.beyond);
    }

    /// Cuts the body along the lead; returns the edges newly cut.
    pub fn cut(
        &self,
        cuts: &mut CutEdges,
        mesh: &TetMesh,
        locator: &TetLocator,
        chip_nodes: usize,
    ) -> Vec<u32> {
        cuts.cut_ahead(
            mesh,
            locator,
            &self.reach,
            |p| self.is_reached(p),
            chip_nodes,
        )
    }

    /// Seats the nodes near the lead; see [`CutEdges::seat_nodes`].
    pub fn seat(&self, cuts: &mut CutEdges, mesh: &TetMesh, locator: &TetLocator) {
        cuts.seat_nodes(mesh, locator, &self.reach);
    }

    /// Whether a point of the surface ahead lies before the end of the lead.
    fn is_reached(&self, p: &Vec3) -> bool {
        let mut best = (f64::INFINITY, false);
        for (t, triangle) in self.reach.triangles.iter().enumerate() {
            let corners = self.reach.corners(t);
            if best.0 < f64::INFINITY && !Aabb::around(&corners).grown(best.0).contains(p) {
                continue;
            }
            let w = closest_on_triangle(p, &corners);
            let foot: Vec3 = (0..3).map(|k| corners[k] * w[k]).sum();
            let distance = (foot - p).norm();
            if distance < best.0 {
                let beyond: f64 = (0..3)
                    .map(|k| self.beyond[triangle[k] as usize] * w[k])
                    .sum();
                best = (distance, beyond <= 0.0);
            }
        }
        best.1
    }
}
