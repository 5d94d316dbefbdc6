use crate::geometry::Vec3;

/// Where on the bone a point lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointOrigin {
    /// On the bone's surface before any cut.
    Surface,
    /// On a wall of the crack.
    Wall {
        /// Unit normal that points out of the bone of its own side, into the crack; undeformed.
        normal: Vec3,
    },
}

/// A point of the bone's surface or of a crack wall that stands for a patch of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShellPoint {
    /// Undeformed \[mm\].
    pub position: Vec3,
    /// The tetrahedron that holds it.
    pub tet: u32,
    /// The tetrahedron's shape functions there.
    pub weights: [f32; 4],
    /// The area it stands for \[mm2\].
    pub area: f32,
    /// Surface or crack wall.
    pub origin: PointOrigin,
}

/// The points of the bone sorted by cell, and within it into blocks of neighbours, as the contact query reads them.
///
/// A point's id is its index in the list it was grouped from; points are only ever appended to that list, so ids are stable.
#[derive(Clone, Debug, Default)]
pub struct PointShell {
    /// Range of each cell's blocks: `first_block[c]..first_block[c + 1]`.
    first_block: Vec<u32>,
    blocks: Vec<Block>,
    overhang: Vec<f32>,
    ids: Vec<u32>,
    weights: [Vec<f32>; 4],
    areas: Vec<f32>,
    /// Wall normals; zero for surface points.
    normals: Vec<[f32; 3]>,
    /// One past the highest id.
    n_ids: usize,
}

/// Points per block: few enough to be close together, enough to fill vector registers.
pub(super) const BLOCK: usize = 16;

/// Up to [`BLOCK`] neighbouring points of one cell.
#[derive(Clone, Copy, Debug)]
struct Block {
    first: u32,
    len: u32,
    extent: BlockExtent,
}

/// Where the shape functions of a block's points lie: within `reach` of `centre`, each.
///
/// In any state of the cell the points are no farther from the centre than `sum_k reach_k |x_k - x_0|`, `x_k` its nodes,
/// since shape functions add up to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockExtent {
    pub centre: [f32; 4],
    pub reach: [f32; 4],
}

/// The points of one block.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockPoints<'a> {
    /// Place of the first in the shell's arrays.
    pub first: usize,
    pub extent: &'a BlockExtent,
    pub weights: [&'a [f32]; 4],
    pub areas: &'a [f32],
    pub ids: &'a [u32],
    pub normals: &'a [[f32; 3]],
}

impl PointShell {
    /// The cell number of a point that is dropped (it lies in the kerf).
    pub const DROPPED: u32 = u32::MAX;

    /// Sorts the points by cell; `cell_of[i]` is the cell of point `i`, [`DROPPED`](Self::DROPPED) or beyond `n_cells` to leave it out.
    pub fn group(points: &[ShellPoint], cell_of: &[u32], n_cells: usize) -> Self {
        let mut ids: Vec<u32> = (0u32..)
            .zip(points.iter().zip(cell_of))
            .filter(|(_, (_, cell))| (**cell as usize) < n_cells)
            .map(|(id, _)| id)
            .collect();
        ids.sort_by_cached_key(|&id| {
            let i = id as usize;
            (cell_of[i], curve_place(&points[i].weights), id)
        });
        let (first_block, blocks) = cut_into_blocks(points, cell_of, &ids, n_cells);
        let point = |id: &u32| &points[*id as usize];
        let mut overhang = vec![0.0f32; n_cells];
        for id in &ids {
            let least = point(id).weights.iter().fold(0.0f32, |l, w| l.min(*w));
            let cell = &mut overhang[cell_of[*id as usize] as usize];
            *cell = cell.max(-least);
        }
        let weights = [0, 1, 2, 3].map(|k| ids.iter().map(|id| point(id).weights[k]).collect());
        Self {
            first_block,
            blocks,
            overhang,
            weights,
            areas: ids.iter().map(|id| point(id).area).collect(),
            normals: ids.iter().map(|id| normal(point(id))).collect(),
            n_ids: points.len(),
            ids,
        }
    }

    /// How far below zero the shape functions of the points of cell `c` reach: where the mesh cuts a corner of the bone, points
    /// lie outside their tetrahedron, inside its copy enlarged about its centroid by 1 + 4 times this.
    pub fn overhang(&self, c: usize) -> f32 {
        self.overhang.get(c).copied().unwrap_or(0.0)
    }

    /// How many points take part.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether no point takes part.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// How many cells there are, empty ones included.
    pub fn n_cells(&self) -> usize {
        self.first_block.len().saturating_sub(1)
    }

    /// One past the highest id: the length of the list that was grouped.
    pub fn n_ids(&self) -> usize {
        self.n_ids
    }

    /// Whether cell `c` holds any point.
    pub fn cell_is_empty(&self, c: usize) -> bool {
        self.first_block[c] == self.first_block[c + 1]
    }

    /// The shape functions of the point at place `k` of the sorted list; `None` beyond its end.
    pub fn weights(&self, k: usize) -> Option<[f32; 4]> {
        let [a, b, c, d] = &self.weights;
        Some([*a.get(k)?, *b.get(k)?, *c.get(k)?, *d.get(k)?])
    }

    /// The blocks of cell `c`; none if there is no such cell.
    pub(super) fn blocks(&self, c: usize) -> impl Iterator<Item = BlockPoints<'_>> {
        let bound = |c: usize| self.first_block.get(c).map_or(0, |&b| b as usize);
        let blocks = self.blocks.get(bound(c)..bound(c + 1)).unwrap_or(&[]);
        blocks.iter().filter_map(|b| self.points_of(b))
    }

    fn points_of<'a>(&'a self, block: &'a Block) -> Option<BlockPoints<'a>> {
        let first = block.first as usize;
        let range = first..first + block.len as usize;
        let [a, b, c, d] = &self.weights;
        Some(BlockPoints {
            first,
            extent: &block.extent,
            weights: [
                a.get(range.clone())?,
                b.get(range.clone())?,
                c.get(range.clone())?,
                d.get(range.clone())?,
            ],
            areas: self.areas.get(range.clone())?,
            ids: self.ids.get(range.clone())?,
            normals: self.normals.get(range)?,
        })
    }
}

type Blocks = (Vec<u32>, Vec<Block>);

fn cut_into_blocks(points: &[ShellPoint], cell_of: &[u32], ids: &[u32], n_cells: usize) -> Blocks {
    let mut first_block = vec![0u32; n_cells + 1];
    let mut blocks = Vec::new();
    let mut first = 0;
    for cell in ids.chunk_by(|a, b| cell_of[*a as usize] == cell_of[*b as usize]) {
        for members in cell.chunks(BLOCK) {
            let weights = members.iter().map(|&id| &points[id as usize].weights);
            blocks.push(Block {
                first,
                len: members.len() as u32,
                extent: BlockExtent::around(weights),
            });
            first += members.len() as u32;
        }
        first_block[cell_of[cell[0] as usize] as usize + 1] = blocks.len() as u32;
    }
    // Empty cells end where the last full one before them ended.
    for c in 1..=n_cells {
        first_block[c] = first_block[c].max(first_block[c - 1]);
    }
    (first_block, blocks)
}

impl BlockExtent {
    fn around<'a>(weights: impl Iterator<Item = &'a [f32; 4]>) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
        for w in weights {
            for k in 0..4 {
                low[k] = low[k].min(w[k]);
                high[k] = high[k].max(w[k]);
            }
        }
        let centre: [f32; 4] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        Self {
            centre,
            reach: std::array::from_fn(|k| high[k] - centre[k]),
        }
    }
}

/// Place on a curve that keeps neighbours together: interleaved bits (Morton) of three of the shape functions.
fn curve_place(weights: &[f32; 4]) -> u32 {
    let mut place = 0;
    for bit in (0..10).rev() {
        for w in &weights[1..] {
            let q = (w * 1023.0) as u32;
            place = place << 1 | (q >> bit & 1);
        }
    }
    place
}

fn normal(point: &ShellPoint) -> [f32; 3] {
    match point.origin {
        PointOrigin::Surface => [0.0; 3],
        PointOrigin::Wall { normal } => [0, 1, 2].map(|k| normal[k] as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::boundary_points;
    use crate::geometry::block_mesh;

    #[test]
    fn points_are_grouped_in_order_and_dropped_ones_left_out() {
        let point = |i: u32| ShellPoint {
            position: Vec3::zeros(),
            tet: 0,
            weights: [1.0, 0.0, 0.0, i as f32 * 1e-6],
            area: 1.0,
            origin: PointOrigin::Surface,
        };
        let points: Vec<_> = (0..6).map(point).collect();
        let shell = PointShell::group(&points, &[2, 0, u32::MAX, 2, 9, 0], 3);
        assert_eq!((shell.len(), shell.n_cells(), shell.n_ids()), (4, 3, 6));
        let ids = |c| {
            shell
                .blocks(c)
                .flat_map(|b| b.ids.to_vec())
                .collect::<Vec<_>>()
        };
        assert_eq!(ids(0), [1, 5]);
        assert!(shell.cell_is_empty(1));
        assert_eq!(ids(2), [0, 3]);
        assert!(ids(3).is_empty());
    }

    #[test]
    fn blocks_hold_neighbours_within_their_extent() {
        let mesh = block_mesh(Vec3::zeros(), Vec3::repeat(6.0), [2, 2, 2]);
        let points = boundary_points(&mesh, 12);
        let cells: Vec<u32> = points.iter().map(|p| p.tet).collect();
        let shell = PointShell::group(&points, &cells, mesh.tets().len());
        assert_eq!(shell.len(), points.len());
        let mut widest = 0.0f32;
        for c in 0..shell.n_cells() {
            for block in shell.blocks(c) {
                for i in 0..block.ids.len() {
                    for k in 0..4 {
                        let off = (block.weights[k][i] - block.extent.centre[k]).abs();
                        assert!(off <= block.extent.reach[k] + 1e-6);
                        assert_eq!(cells[block.ids[i] as usize], c as u32);
                    }
                }
                widest = block.extent.reach[1..]
                    .iter()
                    .fold(widest, |w, r| w.max(*r));
            }
        }
        assert!(widest < 0.5, "{widest}: a block spans its whole cell");
    }
}
