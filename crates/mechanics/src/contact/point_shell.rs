use crate::geometry::{LANES, Vec3};
use std::ops::Range;
use std::sync::Arc;

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

/// All points of a bone; a point's id is its place. Points are only ever appended, so that ids are stable, and a grown list
/// shares the points of the uncut surface with the one it came from.
#[derive(Clone, Debug)]
pub struct ShellPoints {
    surface: Arc<[ShellPoint]>,
    walls: Vec<ShellPoint>,
}

impl ShellPoints {
    /// The points of a surface, no walls yet.
    pub fn new(surface: Arc<[ShellPoint]>) -> Self {
        Self {
            surface,
            walls: Vec::new(),
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.surface.len() + self.walls.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The points of crack walls, to append to.
    pub fn walls_mut(&mut self) -> &mut Vec<ShellPoint> {
        &mut self.walls
    }

    /// The point with this id, which must be there.
    pub fn get(&self, id: u32) -> &ShellPoint {
        let id = id as usize;
        match id.checked_sub(self.surface.len()) {
            None => &self.surface[id],
            Some(k) => &self.walls[k],
        }
    }
}

/// Cells of a shell whose points are sorted anew.
#[derive(Clone, Debug)]
pub struct RenewedCells {
    /// The cells that they replace.
    pub old: Range<usize>,
    /// Their own numbers; those between the renewed are the kept ones, in their old order.
    pub new: Range<usize>,
    /// (cell, point): all points in them.
    pub members: Vec<(u32, u32)>,
}

/// The points of the bone sorted by cell, and within it into blocks of neighbours, as the contact query reads them.
#[derive(Clone, Debug, Default)]
pub struct PointShell {
    /// Range of each cell's blocks: `first_block[c]..first_block[c + 1]`.
    first_block: Vec<u32>,
    blocks: Vec<Block>,
    overhang: Vec<f32>,
    /// Which cells hold points of walls.
    walled: Vec<bool>,
    /// The cells that hold points, ascending.
    occupied: Vec<u32>,
    ids: Vec<u32>,
    /// Some numbers longer than the others, so that the last can be read four at a time.
    weights: [Vec<f32>; 4],
    areas: Vec<f32>,
    /// Wall normals, a list an axis; zero for surface points. Longer, too.
    normals: [Vec<f32>; 3],
    /// One past the highest id.
    n_ids: usize,
}

/// Points per block: few enough to be close together, enough to fill vector registers.
const BLOCK: usize = 16;

/// Up to [`BLOCK`] neighbouring points of one cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    first: u32,
    len: u32,
    extent: BlockExtent,
    is_walled: bool,
}

impl Block {
    /// Whether it holds points of walls.
    pub fn is_walled(&self) -> bool {
        self.is_walled
    }

    pub fn extent(&self) -> &BlockExtent {
        &self.extent
    }
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
    /// In whole fours: beyond the last point come others.
    pub weights: [&'a [f32]; 4],
    pub areas: &'a [f32],
    pub ids: &'a [u32],
    /// In whole fours, too.
    pub normals: [&'a [f32]; 3],
}

impl PointShell {
    /// The cell number of a point that is dropped (it lies in the kerf).
    pub const DROPPED: u32 = u32::MAX;

    /// Sorts the points by cell; `cell_of[i]` is the cell of point `i`, [`DROPPED`](Self::DROPPED) or beyond `n_cells` to leave it out.
    pub fn group(points: &ShellPoints, cell_of: &[u32], n_cells: usize) -> Self {
        let all = cell_of.iter().copied().zip(0u32..);
        let renewed = RenewedCells {
            old: 0..0,
            new: 0..n_cells,
            members: all.filter(|m| (m.0 as usize) < n_cells).collect(),
        };
        Self::default().regrouped(points, vec![renewed])
    }

    /// The shell after some cells were divided or gained points. All others are copied as they are.
    ///
    /// `renewed`: by ascending cell.
    pub fn regrouped(&self, points: &ShellPoints, renewed: Vec<RenewedCells>) -> Self {
        let mut next = Self {
            first_block: vec![0],
            n_ids: points.len(),
            ..Self::default()
        };
        let mut from = 0;
        for cells in renewed {
            next.copy(self, from..cells.old.start);
            from = cells.old.end;
            next.push(points, cells);
        }
        next.copy(self, from..self.n_cells());
        let cells = 0..next.n_cells() as u32;
        next.occupied = cells.filter(|c| !next.cell_is_empty(*c as usize)).collect();
        for list in next.weights.iter_mut().chain(&mut next.normals) {
            list.resize(next.ids.len() + LANES - 1, 0.0);
        }
        next
    }

    /// Appends cells of another shell.
    fn copy(&mut self, other: &Self, cells: Range<usize>) {
        if cells.is_empty() {
            return;
        }
        let blocks = other.block_range(cells.clone());
        let points = other.point_range(blocks.clone());
        let (moved, shift) = (self.ids.len() as u32, self.blocks.len() as u32);
        let ends = &other.first_block[cells.start + 1..=cells.end];
        let first = blocks.start as u32;
        (self.first_block).extend(ends.iter().map(|b| b - first + shift));
        self.blocks
            .extend(other.blocks[blocks].iter().map(|b| Block {
                first: b.first - points.start as u32 + moved,
                ..*b
            }));
        self.overhang
            .extend_from_slice(&other.overhang[cells.clone()]);
        self.walled.extend_from_slice(&other.walled[cells]);
        self.ids.extend_from_slice(&other.ids[points.clone()]);
        for (own, other) in self.weights.iter_mut().zip(&other.weights) {
            own.extend_from_slice(&other[points.clone()]);
        }
        for (own, other) in self.normals.iter_mut().zip(&other.normals) {
            own.extend_from_slice(&other[points.clone()]);
        }
        self.areas.extend_from_slice(&other.areas[points]);
    }

    /// Appends cells with their points.
    fn push(&mut self, points: &ShellPoints, mut cells: RenewedCells) {
        let place = |m: &(u32, u32)| (m.0, curve_place(&points.get(m.1).weights), m.1);
        cells.members.sort_by_cached_key(place);
        let mut members = &cells.members[..];
        for cell in cells.new {
            let n = members.partition_point(|m| m.0 as usize <= cell);
            let (own, rest) = members.split_at(n);
            members = rest;
            let is_wall = |m: &(u32, u32)| points.get(m.1).origin != PointOrigin::Surface;
            for block in own.chunks(BLOCK) {
                let weights = block.iter().map(|m| &points.get(m.1).weights);
                self.blocks.push(Block {
                    first: self.ids.len() as u32,
                    len: block.len() as u32,
                    extent: BlockExtent::around(weights),
                    is_walled: block.iter().any(is_wall),
                });
                block.iter().for_each(|m| self.push_point(points, m.1));
            }
            let least = own.iter().flat_map(|m| points.get(m.1).weights);
            self.overhang.push(-least.fold(0.0f32, f32::min));
            self.walled.push(own.iter().any(is_wall));
            self.first_block.push(self.blocks.len() as u32);
        }
    }

    fn push_point(&mut self, points: &ShellPoints, id: u32) {
        let point = points.get(id);
        self.ids.push(id);
        for (own, w) in self.weights.iter_mut().zip(point.weights) {
            own.push(w);
        }
        self.areas.push(point.area);
        for (own, n) in self.normals.iter_mut().zip(normal(point)) {
            own.push(n);
        }
    }

    fn block_range(&self, cells: Range<usize>) -> Range<usize> {
        let bound = |c: usize| self.first_block.get(c).map_or(0, |b| *b as usize);
        bound(cells.start)..bound(cells.end)
    }

    fn point_range(&self, blocks: Range<usize>) -> Range<usize> {
        let bound = |b: usize| {
            self.blocks
                .get(b)
                .map_or(self.ids.len(), |b| b.first as usize)
        };
        bound(blocks.start)..bound(blocks.end)
    }

    /// The points in some cells.
    pub fn ids_in(&self, cells: Range<usize>) -> &[u32] {
        &self.ids[self.point_range(self.block_range(cells))]
    }

    /// How far below zero the shape functions of the points of cell `c` reach: where the mesh cuts a corner of the bone, points
    /// lie outside their tetrahedron, inside its copy enlarged about its centroid by 1 + 4 times this.
    pub fn overhang(&self, c: usize) -> f32 {
        self.overhang.get(c).copied().unwrap_or(0.0)
    }

    /// Whether cell `c` holds points of walls.
    pub(super) fn is_walled(&self, c: usize) -> bool {
        self.walled.get(c).is_some_and(|w| *w)
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

    /// The cells that hold points, ascending.
    pub fn occupied(&self) -> &[u32] {
        &self.occupied
    }

    /// Places in the sorted list of the points of some cells.
    pub fn places(&self, cells: Range<usize>) -> Range<usize> {
        self.point_range(self.block_range(cells))
    }

    /// Wall normal of the point at place `k` of the sorted list: zero for points of the surface; `None` beyond its end.
    pub fn normal(&self, k: usize) -> Option<[f32; 3]> {
        let [x, y, z] = &self.normals;
        (k < self.len()).then(|| [x[k], y[k], z[k]])
    }

    /// The shape functions of the point at place `k` of the sorted list; `None` beyond its end.
    pub fn weights(&self, k: usize) -> Option<[f32; 4]> {
        let [a, b, c, d] = &self.weights;
        (k < self.len()).then(|| [a[k], b[k], c[k], d[k]])
    }

    /// The blocks of cell `c`; none if there is no such cell.
    pub(super) fn blocks(&self, c: usize) -> &[Block] {
        let bound = |c: usize| self.first_block.get(c).map_or(0, |&b| b as usize);
        self.blocks.get(bound(c)..bound(c + 1)).unwrap_or(&[])
    }

    /// The points of a block of this shell.
    pub(super) fn points_of(&self, block: &Block) -> Option<BlockPoints<'_>> {
        let first = block.first as usize;
        let range = first..first + block.len as usize;
        let fours = first..first + (block.len as usize).next_multiple_of(LANES);
        let [a, b, c, d] = &self.weights;
        let [x, y, z] = &self.normals;
        Some(BlockPoints {
            first,
            weights: [
                a.get(fours.clone())?,
                b.get(fours.clone())?,
                c.get(fours.clone())?,
                d.get(fours.clone())?,
            ],
            normals: [x.get(fours.clone())?, y.get(fours.clone())?, z.get(fours)?],
            areas: self.areas.get(range.clone())?,
            ids: self.ids.get(range)?,
        })
    }
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
        let mut centre: [f32; 4] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        // The middles of all four need not add up to 1, and then would be a place that hangs on where the origin is.
        centre[0] = 1.0 - (centre[1] + centre[2] + centre[3]);
        let reach = |k: usize| (high[k] - centre[k]).max(centre[k] - low[k]);
        Self {
            centre,
            reach: [0, 1, 2, 3].map(reach),
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
        let points = ShellPoints::new((0..6).map(point).collect());
        let shell = PointShell::group(&points, &[2, 0, u32::MAX, 2, 9, 0], 3);
        assert_eq!((shell.len(), shell.n_cells(), shell.n_ids()), (4, 3, 6));
        let ids = |c| {
            let blocks = shell.blocks(c).iter().filter_map(|b| shell.points_of(b));
            blocks.flat_map(|b| b.ids.to_vec()).collect::<Vec<_>>()
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
        let points = ShellPoints::new(points.into());
        let shell = PointShell::group(&points, &cells, mesh.tets().len());
        assert_eq!(shell.len(), points.len());
        let mut widest = 0.0f32;
        for c in 0..shell.n_cells() {
            for block in shell.blocks(c) {
                let (extent, block) = (block.extent, shell.points_of(block).unwrap());
                for i in 0..block.ids.len() {
                    for k in 0..4 {
                        let off = (block.weights[k][i] - extent.centre[k]).abs();
                        assert!(off <= extent.reach[k] + 1e-6);
                        assert_eq!(cells[block.ids[i] as usize], c as u32);
                    }
                }
                widest = extent.reach[1..].iter().fold(widest, |w, r| w.max(*r));
            }
        }
        assert!(widest < 0.5, "{widest}: a block spans its whole cell");
    }
}
