use super::body::CrackedBody;
use super::cut_edges::CutEdges;
use super::enrichment::Topology;
use super::stress_intensity::CellForce;
use crate::geometry::{NO_TET, TET_EDGES, TET_FACES, TetMesh, Vec3};

/// A load on a part of the body's boundary.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceLoad {
    /// Indices into the mesh's boundary faces.
    pub faces: Vec<u32>,
    /// What acts there.
    pub kind: LoadKind,
}

/// What acts on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadKind {
    /// The same stress vector everywhere \[MPa\].
    Traction(Vec3),
    /// This force in all, spread evenly \[N\].
    Force(Vec3),
    /// This moment in all, by tractions in proportion to `axis` x distance from it.
    Torque {
        /// Unit direction of the axis.
        axis: Vec3,
        /// A point of the axis \[mm\].
        origin: Vec3,
        /// \[N mm\]
        moment: f64,
    },
}

/// A point of the boundary with its share of the area.
struct FacePoint {
    cell: u32,
    weights: [f64; 4],
    position: Vec3,
    area: f64,
}

impl CrackedBody {
    /// The forces of a load; where the crack divides a face, each side takes those on its own part.
    ///
    /// Mid-edge quadrature: exact for all three kinds. A torque on faces that all lie on its axis gives nothing.
    pub fn surface_forces(&self, load: &SurfaceLoad) -> Vec<CellForce> {
        let points = self.face_points(&load.faces);
        let area: f64 = points.iter().map(|p| p.area).sum();
        let traction: Box<dyn Fn(&Vec3) -> Vec3> = match load.kind {
            LoadKind::Traction(t) => Box::new(move |_| t),
            LoadKind::Force(f) => Box::new(move |_| f / area),
            LoadKind::Torque {
                axis,
                origin,
                moment,
            } => {
                let turn = move |p: &Vec3| axis.cross(&(p - origin));
                let inertia: f64 = points
                    .iter()
                    .map(|p| p.area * turn(&p.position).norm_squared())
                    .sum();
                let scale = if inertia > 0.0 { moment / inertia } else { 0.0 };
                Box::new(move |p| turn(p) * scale)
            }
        };
        points
            .iter()
            .map(|p| CellForce {
                cell: p.cell,
                weights: p.weights,
                force: traction(&p.position) * p.area,
            })
            .collect()
    }

    fn face_points(&self, faces: &[u32]) -> Vec<FacePoint> {
        let mesh = &self.solid.mesh;
        let holders = face_holders(mesh);
        let mut points = Vec::with_capacity(3 * faces.len());
        for &f in faces {
            let (t, k) = holders[f as usize];
            for (cell, triangle) in face_pieces(mesh, &self.cuts, &self.topology, t, k) {
                push_points(mesh, t, cell, &triangle, &mut points);
            }
        }
        points
    }

    /// Shape functions where the crack crosses the edge between local nodes `a` and `b` of tetrahedron `t`; the middle if it
    /// does not.
    pub fn crossing_in(&self, t: u32, a: usize, b: usize) -> [f64; 4] {
        crossing_in(&self.solid.mesh, &self.cuts, t, [a, b])
    }
}

/// Triangles of the face opposite local node `k` of tetrahedron `t`, in its shape functions, each with the cell it belongs to.
pub(super) fn face_pieces(
    mesh: &TetMesh,
    cuts: &CutEdges,
    topology: &Topology,
    t: u32,
    k: usize,
) -> Vec<(u32, [[f64; 4]; 3])> {
    let nodes = TET_FACES[k];
    let corner = |n: usize| std::array::from_fn(|i| if i == n { 1.0 } else { 0.0 });
    let cells = nodes.map(|n| cell_of_node(topology, t, n));
    let [a, b, c] = nodes;
    if cells[0] == cells[1] && cells[1] == cells[2] {
        return vec![(cells[0], [corner(a), corner(b), corner(c)])];
    }
    let cut = |i: usize, j: usize| crossing_in(mesh, cuts, t, [i, j]);
    if let Some(lone) = (0..3).find(|&i| cells[(i + 1) % 3] == cells[(i + 2) % 3]) {
        let [a, b, c] = [0, 1, 2].map(|i| nodes[(lone + i) % 3]);
        let other = cells[(lone + 1) % 3];
        let (ab, ac) = (cut(a, b), cut(a, c));
        return vec![
            (cells[lone], [corner(a), ab, ac]),
            (other, [ab, corner(b), corner(c)]),
            (other, [ab, corner(c), ac]),
        ];
    }
    let (ab, bc, ca) = (cut(a, b), cut(b, c), cut(c, a));
    let middle = std::array::from_fn(|i| (ab[i] + bc[i] + ca[i]) / 3.0);
    vec![
        (cells[0], [corner(a), ab, middle]),
        (cells[0], [corner(a), middle, ca]),
        (cells[1], [corner(b), bc, middle]),
        (cells[1], [corner(b), middle, ab]),
        (cells[2], [corner(c), ca, middle]),
        (cells[2], [corner(c), middle, bc]),
    ]
}

fn crossing_in(mesh: &TetMesh, cuts: &CutEdges, t: u32, [a, b]: [usize; 2]) -> [f64; 4] {
    let edge = TET_EDGES.iter().position(|e| *e == [a.min(b), a.max(b)]);
    let from_low = cuts.crossing(mesh.tet_edges()[t as usize][edge.unwrap_or(0)]);
    let from_low = if from_low.is_nan() { 0.5 } else { from_low };
    let tet = &mesh.tets()[t as usize];
    let s = if tet[a] < tet[b] {
        from_low
    } else {
        1.0 - from_low
    };
    let mut n = [0.0; 4];
    n[a] = 1.0 - s;
    n[b] = s;
    n
}

/// The cell of tetrahedron `t` that holds its local node `n`.
fn cell_of_node(topology: &Topology, t: u32, n: usize) -> u32 {
    let range = topology.cells_of(t);
    let first = range.start;
    range
        .into_iter()
        .find(|&c| topology.cells()[c].mask >> n & 1 == 1)
        .unwrap_or(first) as u32
}

/// For each boundary face its tetrahedron and the local node opposite.
fn face_holders(mesh: &TetMesh) -> Vec<(u32, usize)> {
    let open = |(t, n): (usize, &[u32; 4])| {
        let n = *n;
        (0..4)
            .filter(move |&k| n[k] == NO_TET)
            .map(move |k| (t as u32, k))
    };
    mesh.neighbours()
        .iter()
        .enumerate()
        .flat_map(open)
        .collect()
}

fn push_points(
    mesh: &TetMesh,
    t: u32,
    cell: u32,
    triangle: &[[f64; 4]; 3],
    points: &mut Vec<FacePoint>,
) {
    let x = mesh.corners(t as usize);
    let place = |n: &[f64; 4]| (0..4).map(|i| x[i] * n[i]).sum::<Vec3>();
    let [a, b, c] = [0, 1, 2].map(|i| place(&triangle[i]));
    let area = (b - a).cross(&(c - a)).norm() / 6.0;
    for i in 0..3 {
        let (p, q) = (&triangle[i], &triangle[(i + 1) % 3]);
        let weights = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
        points.push(FacePoint {
            cell,
            weights,
            position: place(&weights),
            area,
        });
    }
}
