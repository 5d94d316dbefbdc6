//! `fields_NNN.vtu`: what the body looks like at one step, open where the crack is.
use super::study::State;
use crate::session::VtuWriter;
use nalgebra::Matrix3;
use osteotome_mechanics::bone::stiffness;
use osteotome_mechanics::crack::{Cell, CrackedBody};
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use std::collections::HashMap;

/// Tetrahedra with the points they stand on.
struct Grid<'a> {
    body: &'a CrackedBody,
    state: &'a State,
    sheets: Vec<MeshDistance>,
    known: HashMap<(u32, u32), u32>,
    points: Vec<[f64; 3]>,
    displacement: Vec<[f64; 3]>,
    level_set: Vec<f64>,
    cells: Vec<[u32; 4]>,
    energy: Vec<f64>,
    mises: Vec<f64>,
    fragment: Vec<u32>,
}

/// The body as VTU: an element that the crack divides appears as the pieces of its sides, cut into tetrahedra, and points on
/// the crack appear once for each side.
///
/// Arrays: `displacement` \[mm\] and `level_set` (signed distance to the nearest sheet \[mm\], positive where its normals look
/// to) at the points; `strain_energy_density` \[MPa\], `von_mises_stress` \[MPa\] and `fragment` in the cells.
pub fn write(body: &CrackedBody, state: &State) -> String {
    let sheets = body.crack.sheets.iter();
    let mut grid = Grid {
        body,
        state,
        sheets: sheets.map(|s| MeshDistance::new(s.mesh.clone())).collect(),
        known: HashMap::new(),
        points: Vec::new(),
        displacement: Vec::new(),
        level_set: Vec::new(),
        cells: Vec::new(),
        energy: Vec::new(),
        mises: Vec::new(),
        fragment: Vec::new(),
    };
    for cell in body.topology.cells() {
        grid.add(cell);
    }
    VtuWriter::new("osteotome.fracture_fields/1, mm, MPa")
        .points(&grid.points)
        .tetrahedra(&grid.cells)
        .point_vectors("displacement", &grid.displacement)
        .point_numbers("level_set", &grid.level_set)
        .cell_numbers("strain_energy_density", &grid.energy)
        .cell_numbers("von_mises_stress", &grid.mises)
        .cell_indices("fragment", &grid.fragment)
        .finish()
}

impl Grid<'_> {
    fn add(&mut self, cell: &Cell) {
        let solid = &self.body.solid;
        let t = cell.tet as usize;
        let u = self
            .body
            .system
            .cell_displacements(&solid.mesh, cell, &self.state.x)
            .map(|u| u * self.state.load_factor);
        let grad_u = stiffness::displacement_gradient(&solid.mesh.gradients()[t], &u);
        let stress = solid.materials[t].elasticity().stress(&grad_u);
        let node = solid.mesh.tets()[t][first(cell.mask)];
        for piece in pieces(self.body, cell) {
            let corners = piece.map(|n| self.point(cell, &n, &u));
            self.cells.push(corners);
            self.energy
                .push(stiffness::energy_density(&stress, &grad_u));
            self.mises.push(von_mises(&stress));
            self.fragment
                .push(self.body.fragments.of_node[node as usize]);
        }
    }

    /// The point of a cell with these shape functions; nodes are shared by the cells that move alike there.
    fn point(&mut self, cell: &Cell, n: &[f64; 4], u: &[Vec3; 4]) -> u32 {
        let mesh = &self.body.solid.mesh;
        let next = self.points.len() as u32;
        if let Some(k) = (0..4).find(|&k| n[k] == 1.0) {
            let key = (mesh.tets()[cell.tet as usize][k], cell.enrichment[k]);
            if let Some(&known) = self.known.get(&key) {
                return known;
            }
            self.known.insert(key, next);
        }
        let x = mesh.corners(cell.tet as usize);
        let mix = |v: &[Vec3; 4]| (0..4).map(|k| v[k] * n[k]).sum::<Vec3>();
        let at = mix(&x);
        self.points.push(at.into());
        self.displacement.push(mix(u).into());
        let own: Vec<Vec3> = (0..4)
            .filter(|k| cell.mask >> k & 1 == 1)
            .map(|k| x[k])
            .collect();
        let side = own.iter().sum::<Vec3>() / own.len().max(1) as f64;
        let level = self.level(&at, if cell.mask == 0b1111 { &at } else { &side });
        self.level_set.push(level);
        next
    }

    /// Distance to the nearest sheet, with the sign of the side on which `witness` lies.
    fn level(&self, p: &Vec3, witness: &Vec3) -> f64 {
        let closest = self.sheets.iter().filter_map(|s| s.closest(p));
        let nearest = closest
            .map(|c| ((p - c.point).norm(), c))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.map_or(0.0, |(distance, c)| {
            if (witness - c.point).dot(&c.normal) < 0.0 {
                -distance
            } else {
                distance
            }
        })
    }
}

fn first(mask: u8) -> usize {
    (0..4).find(|k| mask >> k & 1 == 1).unwrap_or(0)
}

fn von_mises(stress: &Matrix3<f64>) -> f64 {
    let mean = stress.trace() / 3.0;
    (1.5_f64).sqrt() * (stress - Matrix3::from_diagonal_element(mean)).norm()
}

type Piece = [[f64; 4]; 4];

/// The part of its tetrahedron that a cell fills, as tetrahedra in shape functions.
fn pieces(body: &CrackedBody, cell: &Cell) -> Vec<Piece> {
    let node = |k: usize| -> [f64; 4] { std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }) };
    let own: Vec<usize> = (0..4).filter(|k| cell.mask >> k & 1 == 1).collect();
    let other: Vec<usize> = (0..4).filter(|k| cell.mask >> k & 1 == 0).collect();
    let cut = |a: usize, b: usize| body.crossing_in(cell.tet, a, b);
    let parts = body.topology.cells_of(cell.tet).len();
    let found = match (own[..].len(), &own[..], &other[..]) {
        (1, &[a], &[b, c, d]) if parts == 4 => corner_of_four(a, [b, c, d], &cut),
        (1, &[a], &[b, c, d]) => vec![[node(a), cut(a, b), cut(a, c), cut(a, d)]],
        (2, &[a, b], &[c, d]) => {
            let (low, high) = (
                [node(a), cut(a, c), cut(a, d)],
                [node(b), cut(b, c), cut(b, d)],
            );
            let mut found = prism(&low, &high);
            if parts == 3 {
                // Beyond the quadrilateral lies what two corners leave over.
                let apex = cut(c, d);
                found.push([low[1], low[2], high[2], apex]);
                found.push([low[1], high[2], high[1], apex]);
            }
            found
        }
        (3, &[a, b, c], &[d]) => prism(
            &[node(a), node(b), node(c)],
            &[cut(a, d), cut(b, d), cut(c, d)],
        ),
        _ => vec![[node(0), node(1), node(2), node(3)]],
    };
    found.into_iter().map(positive).collect()
}

/// The three tetrahedra of a prism between two triangles.
fn prism(low: &[[f64; 4]; 3], high: &[[f64; 4]; 3]) -> Vec<Piece> {
    vec![
        [low[0], low[1], low[2], high[2]],
        [low[0], low[1], high[2], high[1]],
        [low[0], high[1], high[2], high[0]],
    ]
}

/// What is nearest to corner `a` where all six edges are cut.
fn corner_of_four(
    a: usize,
    [b, c, d]: [usize; 3],
    cut: &dyn Fn(usize, usize) -> [f64; 4],
) -> Vec<Piece> {
    let mean = |p: &[[f64; 4]]| {
        std::array::from_fn(|i| p.iter().map(|q| q[i]).sum::<f64>() / p.len() as f64)
    };
    let corner: [f64; 4] = std::array::from_fn(|i| if i == a { 1.0 } else { 0.0 });
    let edges = [
        cut(a, b),
        cut(a, c),
        cut(a, d),
        cut(b, c),
        cut(b, d),
        cut(c, d),
    ];
    let centre: [f64; 4] = mean(&edges);
    let mut found = Vec::new();
    for [p, q] in [[b, c], [c, d], [d, b]] {
        let face: [f64; 4] = mean(&[cut(a, p), cut(a, q), cut(p, q)]);
        found.push([corner, cut(a, p), face, centre]);
        found.push([corner, face, cut(a, q), centre]);
    }
    found
}

/// Turned so that its volume is positive.
fn positive(piece: Piece) -> Piece {
    let [p, q, r, s] = piece;
    let m = nalgebra::Matrix4::from_fn(|i, j| piece[i][j]);
    if m.determinant() < 0.0 {
        [p, r, q, s]
    } else {
        [p, q, r, s]
    }
}
