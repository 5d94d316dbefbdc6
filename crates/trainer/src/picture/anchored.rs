//! Vertices that move with the bone's cells: the paper's geometric mapping (section 4.1) for what is drawn.
use osteotome_mechanics::crack::{Cell, CrackedBody};
use osteotome_mechanics::geometry::Vec3;

/// A point's place in the bone: its cell (tetrahedron and side) and the shape functions there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Which cell of the topology.
    pub cell: u32,
    /// Below zero or above one where the point lies outside the tetrahedron: the cell's motion is continued.
    pub weights: [f64; 4],
}

/// A triangle mesh that moves with the bone.
#[derive(Clone, Debug, Default)]
pub struct Skin {
    /// Of each vertex.
    pub anchors: Vec<Anchor>,
    /// Undeformed positions \[mm\].
    pub rest: Vec<[f32; 3]>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Skin {
    /// Adds a vertex; gives its number.
    pub fn push(&mut self, anchor: Anchor, rest: &Vec3) -> u32 {
        self.anchors.push(anchor);
        self.rest.push((*rest).cast::<f32>().into());
        self.anchors.len() as u32 - 1
    }

    /// Where the vertices are.
    pub fn positions(&self, moved: &[[Vec3; 4]]) -> Vec<[f32; 3]> {
        let at = |a: &Anchor| -> [f32; 3] {
            let nodes = &moved[a.cell as usize];
            let p: Vec3 = (0..4).map(|k| nodes[k] * a.weights[k]).sum();
            p.cast::<f32>().into()
        };
        self.anchors.iter().map(at).collect()
    }
}

/// Deformed positions of each cell's virtual nodes: D_T of the paper's equation 7.
pub fn moved_cells(body: &CrackedBody, x: &[f64]) -> Vec<[Vec3; 4]> {
    let mesh = &body.solid.mesh;
    let one = |cell: &Cell| {
        let u = body.system.cell_displacements(mesh, cell, x);
        let at = mesh.corners(cell.tet as usize);
        [0, 1, 2, 3].map(|k| at[k] + u[k])
    };
    body.topology.cells().iter().map(one).collect()
}

/// The tetrahedron at a point, or the nearest one however far, with the shape functions there.
pub fn tet_at(body: &CrackedBody, p: &Vec3) -> (u32, [f64; 4]) {
    let s = &body.solid;
    let near = |reach: f64| s.locator.find_near(&s.mesh, p, reach * s.lengths.h);
    let found = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0].into_iter().find_map(near);
    found.unwrap_or_else(|| (0, s.mesh.barycentric(0, p)))
}

/// Whether the bone does not part between two cells: at every node of both they move alike. Cells with no common node are taken
/// to hang together.
pub fn are_joined(body: &CrackedBody, a: u32, b: u32) -> bool {
    let [ca, cb] = [a, b].map(|c| &body.topology.cells()[c as usize]);
    let [na, nb] = [ca, cb].map(|c| body.solid.mesh.tets()[c.tet as usize]);
    (0..4).all(|i| (0..4).all(|j| na[i] != nb[j] || ca.enrichment[i] == cb.enrichment[j]))
}
