use super::cut_edges::CutEdges;
use super::enrichment::{Cell, Topology};
use crate::geometry::{TET_EDGES, TetMesh, Vec3};

/// The polygon through the crossing points on the edges that leave a cell: its face on the crack.
///
/// Three corners, or four in the order of its border; not always flat.
pub fn cut_polygon(mesh: &TetMesh, cuts: &CutEdges, cell: &Cell) -> Vec<Vec3> {
    let inside = |k: usize| cell.mask >> k & 1 == 1;
    let mut corners = Vec::with_capacity(4);
    for (l, [a, b]) in TET_EDGES.iter().enumerate() {
        if inside(*a) != inside(*b) {
            corners.push(cuts.crossing_point(mesh, mesh.tet_edges()[cell.tet as usize][l]));
        }
    }
    if corners.len() == 4 {
        // Edges come as (a c) (a d) (b c) (b d); round the polygon it is ac, ad, bd, bc.
        corners.swap(2, 3);
    }
    corners
}

/// Centre and area vector \[mm2\] of the polygon by which a cell borders on the crack; the sense of the vector says nothing.
pub fn cut_area(mesh: &TetMesh, cuts: &CutEdges, cell: &Cell) -> (Vec3, Vec3) {
    let corners = cut_polygon(mesh, cuts, cell);
    let n = corners.len();
    let centre = corners.iter().sum::<Vec3>() / n as f64;
    let sum: Vec3 = (0..n)
        .map(|k| (corners[k] - centre).cross(&(corners[(k + 1) % n] - centre)))
        .sum();
    (centre, sum * 0.5)
}

/// A triangle of the crack as mechanics knows it, and how far it is free to open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FacePiece {
    /// The tetrahedron it divides.
    pub tet: u32,
    /// Its centre.
    pub centre: Vec3,
    /// Half the cross product of its edges; the sign says nothing.
    pub area_normal: Vec3,
    /// Sum of the shape functions of the enriched nodes at its centre: 1 where both faces move freely, falling to 0 at the front.
    pub freedom: f64,
}

/// Cuts the crack in the given tetrahedra into triangles of about a quarter of an element; calls `visit` with each.
///
/// A tetrahedron in three or four pieces gives each of its faces twice, once for either side, with half its area.
pub fn face_pieces(
    mesh: &TetMesh,
    cuts: &CutEdges,
    topology: &Topology,
    t: u32,
    mut visit: impl FnMut(FacePiece),
) {
    let cells = &topology.cells()[topology.cells_of(t)];
    if cells.len() < 2 {
        return;
    }
    let (sides, share) = if cells.len() == 2 {
        (&cells[..1], 1.0)
    } else {
        (cells, 0.5)
    };
    for cell in sides {
        let corners = cut_polygon(mesh, cuts, cell);
        let n = corners.len();
        let centre = corners.iter().sum::<Vec3>() / n as f64;
        for k in 0..n {
            let (a, b) = (corners[k], corners[(k + 1) % n]);
            let middle = (a + b) * 0.5;
            for [p, q, r] in [[a, middle, centre], [middle, b, centre]] {
                let at = (p + q + r) / 3.0;
                visit(FacePiece {
                    tet: t,
                    centre: at,
                    area_normal: (q - p).cross(&(r - p)) * (0.5 * share),
                    freedom: freedom(cells, &mesh.barycentric(t as usize, &at)),
                });
            }
        }
    }
}

/// Sum of the shape functions `weights` over the nodes at which the cells of a tetrahedron move apart.
fn freedom(cells: &[Cell], weights: &[f64; 4]) -> f64 {
    let parted = |k: usize| {
        cells
            .iter()
            .any(|c| c.enrichment[k] != cells[0].enrichment[k])
    };
    (0..4).filter(|k| parted(*k)).map(|k| weights[k]).sum()
}
