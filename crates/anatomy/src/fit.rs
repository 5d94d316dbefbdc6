//! Pulls the boundary of a tetrahedral mesh onto a surface.
//!
//! Isosurface stuffing puts nodes on the surface, so that flat faces between them cut corners off. Here boundary nodes move to
//! where the faces lie nearest to the surface in the mean, both ways: least squares over points of the faces and of the surface,
//! node by node, a few times, the volume kept. A move that spoils an angle is halved, and given up in the end.
use crate::deviation::boundary;
use crate::error::AnatomyError;
use crate::mesher::dihedrals;
use crate::point_shell::{SurfacePoint, point_shell};
use osteotome_mechanics::geometry::{MeshDistance, TetMesh, Vec3, closest_on_triangle};
use rayon::prelude::*;

/// How often all nodes are moved.
const ROUNDS: usize = 20;
/// Points on the surface that pull at the mesh.
const PULLING: usize = 40_000;
/// No angle may fall below this, or rise above 180 degrees less 1.6 times this \[degrees\], unless it was there before.
const LEAST_ANGLE: f64 = 11.0;
/// Part of the found move that is made: neighbours move as well.
const DAMPING: f64 = 0.7;
/// Times that a move is halved before it is given up.
const HALVINGS: usize = 5;
/// What inner nodes follow of the mean move of their neighbours.
const FOLLOW: f64 = 0.6;

/// The same tetrahedra with their boundary nearer to the surface. Angles stay within the bounds above, or no worse than they were.
///
/// # Errors
/// [`AnatomyError`] for a surface without area.
pub fn fit(mesh: &TetMesh, surface: &MeshDistance) -> Result<TetMesh, AnatomyError> {
    let pulling = point_shell(surface.mesh(), PULLING)?;
    let mut fit = Fit::new(mesh);
    for _ in 0..ROUNDS {
        let moves = fit.moves(surface, &pulling);
        fit.make(moves);
    }
    let made = TetMesh::new(fit.nodes, mesh.tets().to_vec());
    made.map_err(|source| AnatomyError::Mesh {
        name: "the mesh pulled onto the surface".to_owned(),
        source,
    })
}

struct Fit<'a> {
    mesh: &'a TetMesh,
    nodes: Vec<Vec3>,
    is_outer: Vec<bool>,
    /// Bounds that each tetrahedron's angles must keep \[degrees\].
    bounds: Vec<[f64; 2]>,
}

impl<'a> Fit<'a> {
    fn new(mesh: &'a TetMesh) -> Self {
        let mut is_outer = vec![false; mesh.nodes().len()];
        for n in mesh.boundary_faces().iter().flatten() {
            is_outer[*n as usize] = true;
        }
        let limit = |t: usize| {
            let [low, high] = dihedrals(&mesh.corners(t));
            [low.min(LEAST_ANGLE), high.max(180.0 - 1.6 * LEAST_ANGLE)]
        };
        Self {
            mesh,
            nodes: mesh.nodes().to_vec(),
            is_outer,
            bounds: (0..mesh.tets().len()).map(limit).collect(),
        }
    }

    /// Where each node would go.
    fn moves(&self, surface: &MeshDistance, pulling: &[SurfacePoint]) -> Vec<Vec3> {
        let mut current = boundary(self.mesh);
        current.vertices.clone_from(&self.nodes);
        let current = MeshDistance::new(current);
        let faces = self.mesh.boundary_faces();
        let mut sums = Sums(vec![(Vec3::zeros(), 0.0); self.nodes.len()]);
        // Faces to the surface, each point standing for its share of the area.
        let outward: Vec<[(f64, Vec3); 6]> = faces
            .par_iter()
            .map(|f| {
                let corners = f.map(|n| self.nodes[n as usize]);
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
                let area = 0.5 * normal.norm();
                FACE_POINTS.map(|w| {
                    let p: Vec3 = (0..3).map(|k| corners[k] * w[k]).sum();
                    // Not to the far side of a thin part.
                    let near = surface.closest(&p).filter(|c| c.normal.dot(&normal) > 0.0);
                    let pull = near.map_or(Vec3::zeros(), |c| c.point - p);
                    (area / FACE_POINTS.len() as f64, pull)
                })
            })
            .collect();
        for (face, points) in faces.iter().zip(&outward) {
            for (w, (area, pull)) in FACE_POINTS.iter().zip(points) {
                sums.add(face, w, *area, pull);
            }
        }
        // The surface to the faces.
        let share = surface.mesh().area() / pulling.len() as f64;
        let inward: Vec<Option<(u32, [f64; 3], Vec3)>> = pulling
            .par_iter()
            .map(|p| {
                let found = current.closest(&p.position)?;
                if found.normal.dot(&p.normal) <= 0.0 {
                    return None;
                }
                let corners = current.mesh().corners(found.triangle as usize);
                let w = closest_on_triangle(&p.position, &corners);
                Some((found.triangle, w, p.position - found.point))
            })
            .collect();
        for (t, w, pull) in inward.iter().flatten() {
            sums.add(&faces[*t as usize], w, share, pull);
        }
        let mut moves = sums.means();
        // Chords of a coarse mesh lose volume at convex places: as much is added all over.
        let missing = surface.mesh().volume() - current.mesh().volume();
        let shift = DAMPING * missing / current.mesh().area();
        for (n, normal) in current.vertex_normals().iter().enumerate() {
            moves[n] += normal * shift;
        }
        self.followed(moves)
    }

    /// Inner nodes go along with their neighbours.
    fn followed(&self, mut moves: Vec<Vec3>) -> Vec<Vec3> {
        for _ in 0..2 {
            let mut sums = vec![(Vec3::zeros(), 0.0); moves.len()];
            for [a, b] in self.mesh.edges() {
                for (of, by) in [(*a, *b), (*b, *a)] {
                    let sum = &mut sums[of as usize];
                    *sum = (sum.0 + moves[by as usize], sum.1 + 1.0);
                }
            }
            for (n, (sum, count)) in sums.into_iter().enumerate() {
                if !self.is_outer[n] && count > 0.0 {
                    moves[n] = sum * (FOLLOW / count);
                }
            }
        }
        moves
    }

    /// Moves all nodes; where a tetrahedron would leave its bounds, its nodes move half as far, a quarter, and in the end not.
    fn make(&mut self, mut moves: Vec<Vec3>) {
        for halving in 0..=HALVINGS {
            let bad: Vec<u32> = (0..self.mesh.tets().len() as u32)
                .into_par_iter()
                .filter(|t| self.is_spoilt(*t as usize, &moves))
                .collect();
            if bad.is_empty() {
                break;
            }
            let factor = if halving + 1 < HALVINGS { 0.5 } else { 0.0 };
            let mut touched: Vec<u32> = bad
                .iter()
                .flat_map(|t| self.mesh.tets()[*t as usize])
                .collect();
            touched.sort_unstable();
            touched.dedup();
            touched.iter().for_each(|n| moves[*n as usize] *= factor);
        }
        // What is still bad has neighbours that moved while its own nodes stood still: they are called back until all is well.
        loop {
            let bad: Vec<u32> = (0..self.mesh.tets().len() as u32)
                .filter(|t| self.is_spoilt(*t as usize, &moves))
                .collect();
            if bad.is_empty() {
                break;
            }
            for t in bad {
                for n in self.mesh.tets()[t as usize] {
                    moves[n as usize] = Vec3::zeros();
                }
            }
        }
        self.nodes.iter_mut().zip(moves).for_each(|(p, m)| *p += m);
    }

    fn is_spoilt(&self, t: usize, moves: &[Vec3]) -> bool {
        let names = self.mesh.tets()[t].map(|n| n as usize);
        if names.iter().all(|n| moves[*n] == Vec3::zeros()) {
            return false;
        }
        let x = names.map(|n| self.nodes[n] + moves[n]);
        let volume = (x[1] - x[0]).dot(&(x[2] - x[0]).cross(&(x[3] - x[0])));
        let [low, high] = dihedrals(&x);
        let [least, most] = self.bounds[t];
        volume <= 0.0 || low < least - 1e-9 || high > most + 1e-9
    }
}

/// Points of a face that are held against the surface (degree-4 rule of six points).
const FACE_POINTS: [[f64; 3]; 6] = {
    const A: f64 = 0.445_948_490_915_965;
    const B: f64 = 0.091_576_213_509_771;
    [
        [A, A, 1.0 - 2.0 * A],
        [A, 1.0 - 2.0 * A, A],
        [1.0 - 2.0 * A, A, A],
        [B, B, 1.0 - 2.0 * B],
        [B, 1.0 - 2.0 * B, B],
        [1.0 - 2.0 * B, B, B],
    ]
};

/// By node: weighted pulls and weights.
struct Sums(Vec<(Vec3, f64)>);

impl Sums {
    fn add(&mut self, face: &[u32; 3], at: &[f64; 3], area: f64, pull: &Vec3) {
        for (n, w) in face.iter().zip(at) {
            let sum = &mut self.0[*n as usize];
            *sum = (sum.0 + pull * (w * area), sum.1 + w * area);
        }
    }

    fn means(self) -> Vec<Vec3> {
        let mean = |(sum, weight): (Vec3, f64)| {
            if weight > 0.0 {
                sum * (DAMPING / weight)
            } else {
                Vec3::zeros()
            }
        };
        self.0.into_iter().map(mean).collect()
    }
}
