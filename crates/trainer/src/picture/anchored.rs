//! Vertices that move with the bone's cells: the paper's geometric mapping (section 4.1) for what is drawn.
use osteotome_mechanics::crack::{Cell, CrackedBody, STANDARD, Sheet};
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use osteotome_render::skin::{self as render, MovedCell, Part, Skin as Drawn, Wear};
use std::sync::Arc;

/// A point's place in the bone: its cell (tetrahedron and side) and the shape functions there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Which cell of the topology.
    pub cell: u32,
    /// Below zero or above one where the point lies outside the tetrahedron: the cell's motion is continued.
    pub weights: [f64; 4],
}

/// A triangle mesh that moves with the bone.
#[derive(Clone, Debug, Default, PartialEq)]
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

    /// For the renderer.
    pub fn drawn(&self, parts: Vec<Part>) -> Drawn {
        self.drawn_with(parts, |_| None)
    }

    /// The same with what vertices lose where faces rub.
    pub fn drawn_with(&self, parts: Vec<Part>, wear: impl Fn(usize) -> Option<Wear>) -> Drawn {
        let anchor = |(v, a): (usize, &Anchor)| render::Anchor {
            cell: a.cell,
            weights: a.weights.map(|w| w as f32),
            wear: wear(v),
        };
        let anchors = self.anchors.iter().enumerate().map(anchor);
        Drawn::new(anchors.collect(), self.rest.clone(), parts)
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

/// The same for the renderer, as it is done for every frame.
pub fn drawn_cells(body: &CrackedBody, x: &[f64]) -> Arc<[MovedCell]> {
    let mesh = &body.solid.mesh;
    let single = |p: Vec3| -> [f32; 3] { p.cast::<f32>().into() };
    let of_node = |(i, p): (usize, &Vec3)| single(p + body.system.displacement(i, x));
    let moved: Vec<[f32; 3]> = mesh.nodes().iter().enumerate().map(of_node).collect();
    let one = |cell: &Cell| {
        let nodes = mesh.tets()[cell.tet as usize];
        if cell.enrichment == [STANDARD; 4] {
            return nodes.map(|n| moved[n as usize]);
        }
        let u = body.system.cell_displacements(mesh, cell, x);
        [0, 1, 2, 3].map(|k| single(mesh.nodes()[nodes[k] as usize] + u[k]))
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

/// Whether the bone does not part between two cells: they are of one fragment, and at every node of both they move alike.
pub fn are_joined(body: &CrackedBody, a: u32, b: u32) -> bool {
    let [ca, cb] = [a, b].map(|c| &body.topology.cells()[c as usize]);
    let [na, nb] = [ca, cb].map(|c| body.solid.mesh.tets()[c.tet as usize]);
    piece_of(body, a) == piece_of(body, b)
        && (0..4).all(|i| (0..4).all(|j| na[i] != nb[j] || ca.enrichment[i] == cb.enrichment[j]))
}

/// The fragment that a cell is of.
pub fn piece_of(body: &CrackedBody, cell: u32) -> u32 {
    let cell = &body.topology.cells()[cell as usize];
    let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap_or(0);
    body.fragments.of_node[body.solid.mesh.tets()[cell.tet as usize][own] as usize]
}

/// The triangles of a sheet that the saw made, over all its vertices.
pub fn sawn_part(sheet: &Sheet) -> TriMesh {
    let is_sawn = |t: &&[u32; 3]| t.iter().all(|v| sheet.kerf[*v as usize] > 0.0);
    TriMesh {
        vertices: sheet.mesh.vertices.clone(),
        triangles: sheet
            .mesh
            .triangles
            .iter()
            .filter(is_sawn)
            .copied()
            .collect(),
    }
}
