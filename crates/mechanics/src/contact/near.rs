//! The points of the bone near a shape: found once, used as long as shape and bone stay about where they are.
use super::point_shell::BlockPoints;
use super::query::{ContactScene, FromCell, IntoShape};
use super::rigid_shape::SIDE_DEPTH;
use super::{BoundingVolumes, RigidShape};
use crate::geometry::{Aabb, LANES, Lanes, Pose, set_bits};
use wide::f32x4;

/// Points within this distance of a shape \[mm\] are kept: the shape may move as far before they are looked for again. Less than
/// the margin of the shapes' grids, which know nothing beyond.
const MARGIN: f32 = 0.25;

/// The points near one shape, by ascending cell, then place, and the memory to find them. Nothing here allocates after
/// construction.
#[derive(Debug)]
pub struct NearPoints {
    cells: NearCells,
    groups: Vec<Group>,
    fours: Vec<NearFour>,
    n_points: usize,
    n_room: usize,
    found: Option<Found>,
    n_dropped: usize,
}

/// Where the shape was and in which state the scene when the points were found.
#[derive(Clone, Copy, Debug)]
struct Found {
    at: Pose,
    state: u64,
}

/// The near points of one cell: a range of fours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    pub cell: u32,
    first: u32,
    end: u32,
}

/// Up to four near points of one cell. Places without a point have shape functions that are NaN: they are nowhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearFour {
    pub weights: [[f32; LANES]; 4],
    pub normals: [[f32; LANES]; 3],
    pub areas: [f32; LANES],
    pub places: [u32; LANES],
    pub ids: [u32; LANES],
}

impl NearFour {
    const EMPTY: Self = Self {
        weights: [[f32::NAN; LANES]; 4],
        normals: [[0.0; LANES]; 3],
        areas: [0.0; LANES],
        places: [0; LANES],
        ids: [0; LANES],
    };
}

/// A copy made into memory that is there copies the points alone: what it looks for points with stays its own.
impl Clone for NearPoints {
    fn clone(&self) -> Self {
        let mut copy = Self::with_capacity(self.cells.cells.capacity(), self.n_room);
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        self.groups.clone_from(&other.groups);
        self.fours.clone_from(&other.fours);
        self.n_points = other.n_points;
        self.found = other.found;
        self.n_dropped = other.n_dropped;
    }
}

impl NearPoints {
    /// Room for `n_cells` near cells and `n_points` near points.
    pub fn with_capacity(n_cells: usize, n_points: usize) -> Self {
        Self {
            cells: NearCells::with_capacity(n_cells),
            groups: Vec::with_capacity(n_cells),
            // Each cell's last four may have empty places.
            fours: Vec::with_capacity(n_points / LANES + n_cells),
            n_points: 0,
            n_room: n_points,
            found: None,
            n_dropped: 0,
        }
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.n_points
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.n_points == 0
    }

    /// How many points found no room. The deepest never are among them.
    pub fn n_dropped(&self) -> usize {
        self.n_dropped
    }

    pub(super) fn groups(&self) -> &[Group] {
        &self.groups
    }

    pub(super) fn points(&self, group: &Group) -> &[NearFour] {
        let range = group.first as usize..group.end as usize;
        self.fours.get(range).unwrap_or(&[])
    }

    /// Makes sure that the points near the shape at `world_from_shape` are here. Looks for them only if the scene is in another
    /// state or the shape has moved by more than the margin.
    pub fn follow(&mut self, shape: &RigidShape, world_from_shape: &Pose, scene: &ContactScene) {
        self.follow_in::<f32x4>(shape, world_from_shape, scene);
    }

    /// As [`follow`](Self::follow), with so many points at a time.
    pub fn follow_in<L: Lanes>(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
    ) {
        if !self.serves(shape, world_from_shape, scene) {
            self.find_in::<L>(shape, world_from_shape, scene);
        }
    }

    /// Whether they are those near the shape at `world_from_shape` in this state of the scene.
    pub(super) fn serves(
        &self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
    ) -> bool {
        let is_seen = |f: &Found| scene.state != 0 && f.state == scene.state;
        self.found.as_ref().is_some_and(is_seen) && self.holds(shape, world_from_shape)
    }

    /// Whether they serve the shape at `world_from_shape` in the state in which they were found.
    pub fn holds(&self, shape: &RigidShape, world_from_shape: &Pose) -> bool {
        let near = |f: &Found| way(shape, &f.at, world_from_shape) < f64::from(MARGIN - ROUNDING);
        self.found.as_ref().is_some_and(near)
    }

    /// As [`follow`](Self::follow), from anew.
    pub fn find(&mut self, shape: &RigidShape, world_from_shape: &Pose, scene: &ContactScene) {
        self.find_in::<f32x4>(shape, world_from_shape, scene);
    }

    /// As [`find`](Self::find), with so many points at a time.
    pub fn find_in<L: Lanes>(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
    ) {
        let search = Search {
            shape,
            into: IntoShape::new(world_from_shape),
            scene,
        };
        self.cells.find(&search, world_from_shape);
        let depths = self.collect::<L>(&search, f32::NEG_INFINITY);
        self.n_dropped = depths.n.saturating_sub(self.n_points);
        if self.n_dropped > 0 {
            self.collect::<L>(&search, depths.deepest(self.n_room));
            self.n_dropped = depths.n.saturating_sub(self.n_points);
        }
        self.found = Some(Found {
            at: *world_from_shape,
            state: scene.state,
        });
    }

    /// Gathers the near points that are deeper than `deeper` (negative outside) while there is room, and counts all.
    fn collect<L: Lanes>(&mut self, search: &Search, deeper: f32) -> Depths {
        let mut depths = Depths::default();
        self.groups.clear();
        self.fours.clear();
        self.n_points = 0;
        let scene = search.scene;
        for c in 0..self.cells.cells.len() {
            let cell = self.cells.cells[c];
            let Some(d) = scene.deformation.get(cell as usize) else {
                continue;
            };
            let from_cell = search.into.cell::<L>(d);
            if search.cell_is_away(&from_cell, scene.shell.overhang(cell as usize)) {
                continue;
            }
            let first = self.fours.len() as u32;
            let mut found = FoundInCell {
                filled: LANES,
                deeper,
                depths: &mut depths,
                near: self,
            };
            search.blocks_near::<L>(cell as usize, &from_cell, |block| {
                search.points_near::<L>(block, &from_cell, &mut found);
            });
            let end = self.fours.len() as u32;
            if end > first {
                self.groups.push(Group { cell, first, end });
            }
        }
        depths
    }
}

/// Where the near points of one cell are put.
struct FoundInCell<'a> {
    near: &'a mut NearPoints,
    /// Places of the last four that hold a point.
    filled: usize,
    deeper: f32,
    depths: &'a mut Depths,
}

impl FoundInCell<'_> {
    fn put(&mut self, block: &BlockPoints, k: usize, distance: f32) {
        self.depths.add(-distance);
        let near = &mut *self.near;
        if -distance <= self.deeper || near.n_points == near.n_room {
            return;
        }
        if self.filled == LANES {
            // The cells are no more than their room, so that neither is this.
            near.fours.push(NearFour::EMPTY);
            self.filled = 0;
        }
        let (Some(four), at) = (near.fours.last_mut(), self.filled) else {
            return;
        };
        for (to, from) in four.weights.iter_mut().zip(block.weights) {
            to[at] = from[k];
        }
        for (to, from) in four.normals.iter_mut().zip(block.normals) {
            to[at] = from[k];
        }
        four.areas[at] = block.areas[k];
        four.places[at] = (block.first + k) as u32;
        four.ids[at] = block.ids[k];
        self.filled += 1;
        near.n_points += 1;
    }
}

/// The farthest that a point of the shape moves between two poses \[mm\], from above.
fn way(shape: &RigidShape, from: &Pose, to: &Pose) -> f64 {
    let bounds = &shape.bounds;
    let reach = bounds.min.abs().sup(&bounds.max.abs()).norm();
    let shift = (to.translation.vector - from.translation.vector).norm();
    shift + reach * to.rotation.angle_to(&from.rotation)
}

/// How many points lie how deep, to know which to leave out.
struct Depths {
    n: usize,
    bins: [u32; Self::BINS],
}

impl Default for Depths {
    fn default() -> Self {
        Self {
            n: 0,
            bins: [0; Self::BINS],
        }
    }
}

impl Depths {
    const BINS: usize = 64;
    /// Deeper points share the last bin \[mm\].
    const DEEPEST: f32 = 4.0;

    fn add(&mut self, depth: f32) {
        let place = (depth + MARGIN) / (Self::DEEPEST + MARGIN) * Self::BINS as f32;
        self.bins[(place.max(0.0) as usize).min(Self::BINS - 1)] += 1;
        self.n += 1;
    }

    /// The depth beyond which there are at most `n` points.
    fn deepest(&self, n: usize) -> f32 {
        let mut sum = 0;
        for (k, count) in self.bins.iter().enumerate().rev() {
            sum += *count as usize;
            if sum > n {
                let share = (k + 1) as f32 / Self::BINS as f32;
                return share * (Self::DEEPEST + MARGIN) - MARGIN;
            }
        }
        f32::NEG_INFINITY
    }
}

/// Cells near a shape.
#[derive(Clone, Debug)]
struct NearCells {
    cells: Vec<u32>,
    /// At a cell's number modulo their length, a cell and when it was last seen: of two cells at one place the earlier is forgotten
    /// and may come twice.
    seen: Vec<Seen>,
    stamp: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Seen {
    cell: u32,
    stamp: u32,
}

/// A shape is looked up in this many slices along its longest axis, so that a slanted blade does not drag in the cells
/// of the whole box around it.
const SLICES: usize = 5;
/// Rounding of f32 at the coordinates of a head \[mm\].
const ROUNDING: f32 = 1e-3;

impl NearCells {
    fn with_capacity(n_cells: usize) -> Self {
        Self {
            cells: Vec::with_capacity(n_cells),
            seen: vec![Seen::default(); n_cells],
            stamp: 0,
        }
    }

    /// Finds the cells whose volumes may hold points near the shape, ascending.
    fn find(&mut self, search: &Search, world_from_shape: &Pose) {
        self.cells.clear();
        self.next_stamp();
        let (cells, places, stamp) = (&mut self.cells, &mut self.seen, self.stamp);
        let (shape, volumes) = (search.shape, search.scene.volumes);
        volumes_about(shape, world_from_shape, volumes, 0.0, |c, may_touch| {
            let now = Seen { cell: c, stamp };
            let place = c as usize % places.len().max(1);
            let is_seen =
                (places.get_mut(place)).is_some_and(|last| std::mem::replace(last, now) == now);
            if !is_seen && cells.len() < cells.capacity() && may_touch() {
                cells.push(c);
            }
        });
        cells.sort_unstable();
        cells.dedup();
    }

    fn next_stamp(&mut self) {
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.seen.fill(Seen::default());
            self.stamp = 1;
        }
    }
}

/// Calls `visit` with each cell whose volume may hold points near the shape, were they to move by `way` \[mm\]; one may come more than
/// once.
pub fn cells_about(
    shape: &RigidShape,
    world_from_shape: &Pose,
    volumes: &BoundingVolumes,
    way: f32,
    mut visit: impl FnMut(u32),
) {
    volumes_about(shape, world_from_shape, volumes, way, |c, may_touch| {
        if may_touch() {
            visit(c);
        }
    });
}

/// Calls `visit` with each cell about the shape, and a closer test of whether it may hold near points.
fn volumes_about(
    shape: &RigidShape,
    world_from_shape: &Pose,
    volumes: &BoundingVolumes,
    way: f32,
    mut visit: impl FnMut(u32, &dyn Fn() -> bool),
) {
    let into = IntoShape::new(world_from_shape);
    let reach = f64::from(way + reach_beyond(shape));
    for slice in slices(&shape.bounds) {
        let query = slice.moved(world_from_shape).grown(reach);
        volumes.query(&query, |c, volume| {
            let may_touch = || {
                let centre = into.point(&volume.centre());
                let radius = (0.5 * volume.extent().norm()) as f32;
                !ball_is_away(shape, centre, radius + way + ROUNDING)
            };
            visit(c, &may_touch);
        });
    }
}

/// The shape's box cut across its longest axis.
fn slices(bounds: &Aabb) -> [Aabb; SLICES] {
    let axis = bounds.extent().imax();
    let length = bounds.extent()[axis] / SLICES as f64;
    std::array::from_fn(|i| {
        let mut slice = *bounds;
        slice.min[axis] += length * i as f64;
        slice.max[axis] = slice.min[axis] + length;
        slice
    })
}

/// How far outside a shape points matter \[mm\]: the margin, and what a thin blade shadows on its far side.
fn reach_beyond(shape: &RigidShape) -> f32 {
    let shadow = if shape.sided.is_some() {
        SIDE_DEPTH as f32
    } else {
        0.0
    };
    shadow + MARGIN
}

/// Whether no point of a ball can be near the shape.
fn ball_is_away(shape: &RigidShape, centre: [f32; 3], radius: f32) -> bool {
    balls_away(shape, centre, radius)
}

/// Which balls hold no point that can be near the shape.
fn balls_away<L: Lanes>(shape: &RigidShape, centre: [L; 3], radius: L) -> L::Mask {
    let radius = radius + L::splat(reach_beyond(shape));
    let zero = L::splat(0.0);
    let mut beside = zero.less(zero);
    for (k, c) in centre.into_iter().enumerate() {
        let low = L::splat(shape.bounds.min[k] as f32 - ROUNDING);
        let high = L::splat(shape.bounds.max[k] as f32 + ROUNDING);
        beside = beside | (c + radius).less(low) | high.less(c - radius);
    }
    // The distance to a convex body is convex, so that interpolation only ever adds to it, and only here does it mislead.
    let found = shape.field.look_up_in(centre, zero.at_least(zero));
    let enough = radius + L::splat(shape.field.error_bound());
    beside | (found.known & enough.less(found.distance))
}

/// What points are looked for near.
struct Search<'a> {
    shape: &'a RigidShape,
    into: IntoShape,
    scene: &'a ContactScene<'a>,
}

impl Search<'_> {
    fn cell_is_away(&self, from_cell: &FromCell, overhang: f32) -> bool {
        let (centre, radius) = from_cell.ball();
        ball_is_away(self.shape, centre, (1.0 + 4.0 * overhang) * radius)
    }

    /// Calls `visit` with the blocks of a cell that may hold near points.
    fn blocks_near<L: Lanes>(
        &self,
        cell: usize,
        from_cell: &FromCell,
        mut visit: impl FnMut(&BlockPoints),
    ) {
        let shell = self.scene.shell;
        let blocks = shell.blocks(cell);
        let lengths = from_cell.lengths().map(L::splat);
        for some in blocks.chunks(L::N) {
            let of = |l: usize| some.get(l).unwrap_or(&some[0]).extent();
            let centre = from_cell.places(L::columns(|l| of(l).centre));
            let reach = L::columns(|l| of(l).reach);
            let radius = (reach[0] * lengths[0] + reach[1] * lengths[1])
                + (reach[2] * lengths[2] + reach[3] * lengths[3]);
            let away = balls_away(self.shape, centre, radius + L::splat(ROUNDING));
            let near = !L::bits(away) & ((1 << some.len()) - 1);
            for l in set_bits(near) {
                if let Some(block) = shell.points_of(&some[l]) {
                    visit(&block);
                }
            }
        }
    }

    fn points_near<L: Lanes>(
        &self,
        block: &BlockPoints,
        from_cell: &FromCell,
        found: &mut FoundInCell,
    ) {
        let n = block.ids.len();
        let ([a, b, c, d], [x, y, z]) = (block.weights, block.normals);
        for first in (0..n).step_by(LANES) {
            let four = |list| four(list, first);
            let weights = [four(a), four(b), four(c), four(d)];
            let normals = [four(x), four(y), four(z)];
            let n_left = n - first;
            for at in (0..LANES.min(n_left)).step_by(L::N) {
                let position = from_cell.place::<L>(weights, at);
                let facing = self.into.facing::<L>(self.shape, normals, at);
                let samples = self.shape.nearness(position, facing, MARGIN);
                let near = L::bits(samples.distance.less(L::splat(MARGIN))) << at;
                let near = near & ((1 << n_left.min(LANES)) - 1);
                if near == 0 {
                    continue;
                }
                let mut distance = [0.0; LANES];
                samples.distance.store(&mut distance, at);
                for k in set_bits(near) {
                    found.put(block, first + k, distance[k]);
                }
            }
        }
    }
}

/// Four numbers of a list.
#[inline]
fn four(from: &[f32], first: usize) -> &[f32; LANES] {
    from.get(first..)
        .and_then(<[f32]>::first_chunk)
        .unwrap_or(&[f32::NAN; LANES])
}
