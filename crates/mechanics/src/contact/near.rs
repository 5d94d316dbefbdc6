//! The points of the bone near a shape: found once, used as long as shape and bone stay about where they are.
use super::point_shell::BlockPoints;
use super::query::{ContactScene, FromCell, IntoShape};
use super::rigid_shape::SIDE_DEPTH;
use super::{BoundingVolumes, RigidShape};
use crate::geometry::{Aabb, LANES, Lanes, Pose, Vec3, set_bits};
use wide::f32x4;

/// Points within this distance of a shape \[mm\] are kept: the shape may move as far before they are looked for again. Less than
/// the margin of the shapes' grids, which know nothing beyond.
const MARGIN: f32 = 0.25;

/// Neither may it turn by more than this \[rad\]: whether a wall looks at a side of a blade is asked with as much to spare.
pub(super) const TURN: f32 = 0.05;

/// The points near one shape, by ascending cell, then place, and the memory to find them. Nothing here allocates after
/// construction.
#[derive(Debug)]
pub struct NearPoints {
    cells: NearCells,
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

/// Four near points, fewer at the end. Places without a point have positions that are NaN: they are nowhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearFour {
    /// In the frame of the shape as it stood when they were found: within one state of the scene they do not move.
    pub positions: [[f32; LANES]; 3],
    pub normals: [[f32; LANES]; 3],
    pub areas: [f32; LANES],
    pub cells: [u32; LANES],
    pub places: [u32; LANES],
    pub ids: [u32; LANES],
}

impl NearFour {
    const EMPTY: Self = Self {
        positions: [[f32::NAN; LANES]; 3],
        normals: [[0.0; LANES]; 3],
        areas: [0.0; LANES],
        cells: [0; LANES],
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
            fours: Vec::with_capacity(n_points.div_ceil(LANES)),
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

    pub(super) fn fours(&self) -> &[NearFour] {
        &self.fours
    }

    /// Where the shape stood when they were found.
    pub(super) fn found_at(&self) -> Option<&Pose> {
        self.found.as_ref().map(|f| &f.at)
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
        let near = |f: &Found| {
            way(shape, &f.at, world_from_shape) < f64::from(MARGIN - ROUNDING)
                && f.at.rotation.angle_to(&world_from_shape.rotation) < f64::from(TURN)
        };
        self.found.as_ref().is_some_and(near)
    }

    /// Takes over the cells that another place of the same shape knows about it, and gives away its own.
    pub(super) fn take_cells(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.cells, &mut other.cells);
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
        self.cells.find::<L>(&search, world_from_shape);
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
        self.fours.clear();
        self.n_points = 0;
        for first in (0..self.cells.cells.len()).step_by(L::N) {
            let mut cells = [0; LANES];
            let left = &self.cells.cells[first..];
            let n = left.len().min(L::N);
            cells[..n].copy_from_slice(&left[..n]);
            let (from_cells, near) = search.cells_near::<L>(&cells[..n]);
            for l in set_bits(near) {
                let (cell, from_cell) = (cells[l], &from_cells[l]);
                let mut found = FoundInCell {
                    cell,
                    deeper,
                    depths: &mut depths,
                    near: self,
                };
                search.blocks_near::<L>(cell as usize, from_cell, |block| {
                    search.points_near::<L>(block, from_cell, &mut found);
                });
            }
        }
        depths
    }
}

/// Where the near points of one cell are put.
struct FoundInCell<'a> {
    near: &'a mut NearPoints,
    cell: u32,
    deeper: f32,
    depths: &'a mut Depths,
}

impl FoundInCell<'_> {
    /// Point `k` of a block, at `position` in the shape's frame.
    fn put(&mut self, block: &BlockPoints, k: usize, position: [f32; 3], distance: f32) {
        self.depths.add(-distance);
        let near = &mut *self.near;
        if -distance <= self.deeper || near.n_points == near.n_room {
            return;
        }
        let at = near.n_points % LANES;
        if at == 0 {
            near.fours.push(NearFour::EMPTY);
        }
        let Some(four) = near.fours.last_mut() else {
            return;
        };
        for (to, from) in four.positions.iter_mut().zip(position) {
            to[at] = from;
        }
        for (to, from) in four.normals.iter_mut().zip(block.normals) {
            to[at] = from[k];
        }
        four.areas[at] = block.areas[k];
        four.cells[at] = self.cell;
        four.places[at] = (block.first + k) as u32;
        four.ids[at] = block.ids[k];
        near.n_points += 1;
    }
}

/// The farthest that a point moves \[mm\] that is tied to the shape and lies within the reach of contact: the way is longest at a corner
/// of the box around those.
fn way(shape: &RigidShape, from: &Pose, to: &Pose) -> f64 {
    let bounds = shape.bounds.grown(f64::from(reach_beyond(shape, true)));
    let turn = |pose: &Pose| *pose.rotation.to_rotation_matrix().matrix();
    let (turned, shift) = (
        turn(to) - turn(from),
        to.translation.vector - from.translation.vector,
    );
    let way2 = |k: usize| {
        let corner = |axis: usize| [bounds.min, bounds.max][k >> axis & 1][axis];
        (turned * Vec3::new(corner(0), corner(1), corner(2)) + shift).norm_squared()
    };
    (0..8).map(way2).fold(0.0, f64::max).sqrt()
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
    /// Places among the volumes of all that may come near while the shape moves by up to [`ABOUT`], ascending.
    about: Vec<u32>,
    /// Where the shape was then, and which boxes were hashed.
    looked: Option<(Pose, u64)>,
}

/// A shape may move by this \[mm\] before the hash is asked again for the cells about it: a trial step is at most 1 mm.
const ABOUT: f32 = 1.5;

/// A shape is looked up in this many slices along its longest axis, so that a slanted blade does not drag in the cells
/// of the whole box around it.
const SLICES: usize = 5;
/// Rounding of f32 at the coordinates of a head \[mm\].
const ROUNDING: f32 = 1e-3;

impl NearCells {
    fn with_capacity(n_cells: usize) -> Self {
        Self {
            cells: Vec::with_capacity(n_cells),
            // The balls are larger than the volumes, and these are to be those of a while.
            about: Vec::with_capacity(4 * n_cells),
            looked: None,
        }
    }

    /// Finds the cells whose volumes may hold points near the shape, ascending.
    fn find<L: Lanes>(&mut self, search: &Search, world_from_shape: &Pose) {
        let (shape, volumes) = (search.shape, search.scene.volumes);
        let serves = |(at, hash): &(Pose, u64)| {
            *hash == volumes.hash_number()
                && way(shape, at, world_from_shape) < f64::from(ABOUT - ROUNDING)
        };
        if !self.looked.as_ref().is_some_and(serves) {
            let found_room = self.look_about::<L>(search, ABOUT);
            self.looked = found_room.then_some((*world_from_shape, volumes.hash_number()));
            if !found_room {
                self.look_about::<L>(search, 0.0);
            }
        }
        self.cells.clear();
        for some in self.about.chunks(L::N) {
            let volume = |place| volumes.at(place).map(|(_, volume)| volume);
            let near = boxes_near::<L>(shape, &search.into, some, 0.0, volume);
            let cells = set_bits(near).filter_map(|l| volumes.at(some[l]));
            self.cells.extend(cells.map(|(cell, _)| cell));
        }
    }

    /// Looks through all cells for those about the shape: what is cheap for each is sooner done than a hash is asked for many. Whether
    /// there was room for all.
    fn look_about<L: Lanes>(&mut self, search: &Search, way: f32) -> bool {
        self.about.clear();
        let volumes = search.scene.volumes;
        let (origin, reach) = (search.into.origin(), reach_beyond(search.shape, true));
        for (first, balls) in (0..).step_by(LANES).zip(volumes.balls()) {
            for at in (0..LANES).step_by(L::N) {
                let [x, y, z, radius] = balls.numbers.each_ref().map(|n| L::load(n, at));
                let [a, b, c] = origin.map(L::splat);
                let centre = search.into.turned([x - a, y - b, z - c]);
                let radius = radius + L::splat(way + ROUNDING);
                let away = balls_away(search.shape, centre, radius, L::splat(reach));
                let near = !L::bits(away) & ((1 << L::N) - 1);
                for l in set_bits(near) {
                    let place = first + (at + l) as u32;
                    if place as usize >= volumes.len() {
                        return true;
                    }
                    if self.about.len() == self.about.capacity() {
                        return false;
                    }
                    self.about.push(place);
                }
            }
        }
        true
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
    let into = IntoShape::new(world_from_shape);
    for_slices(shape, world_from_shape, way, |slice| {
        volumes.query(slice, |cell, volume| {
            if boxes_near::<f32>(shape, &into, &[cell], way, |_| Some(volume)) != 0 {
                visit(cell);
            }
        });
    });
}

/// Calls `visit` with boxes that hold all that may be near the shape once it has moved by `way` \[mm\].
fn for_slices(shape: &RigidShape, world_from_shape: &Pose, way: f32, mut visit: impl FnMut(&Aabb)) {
    let reach = f64::from(way + reach_beyond(shape, true));
    for slice in slices(&shape.bounds) {
        visit(&slice.moved(world_from_shape).grown(reach));
    }
}

/// Which of up to as many boxes as there are lanes may hold points near the shape once it has moved by `way` \[mm\], a bit each.
fn boxes_near<'a, L: Lanes>(
    shape: &RigidShape,
    into: &IntoShape,
    places: &[u32],
    way: f32,
    of: impl Fn(u32) -> Option<&'a Aabb>,
) -> u32 {
    let Some(first) = places.first() else {
        return 0;
    };
    let [x, y, z, radius] = L::columns(|l| {
        of(*places.get(l).unwrap_or(first)).map_or([f32::NAN; 4], |b| {
            let [x, y, z] = into.way_to(&b.centre());
            [x, y, z, (0.5 * b.extent().norm()) as f32]
        })
    });
    let reach = L::splat(reach_beyond(shape, true));
    let radius = radius + L::splat(way + ROUNDING);
    let away = balls_away(shape, into.turned([x, y, z]), radius, reach);
    !L::bits(away) & ((1 << places.len()) - 1)
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

/// How far outside a shape points matter \[mm\]: the margin, and for those of walls what a thin blade shadows on its far side.
fn reach_beyond(shape: &RigidShape, is_walled: bool) -> f32 {
    let shadow = if shape.sided.is_some() && is_walled {
        SIDE_DEPTH as f32
    } else {
        0.0
    };
    shadow + MARGIN
}

/// Which balls hold no point that can be near the shape; points matter within `reach` of it, but beside a blade's width and before
/// its edge never beyond the margin.
fn balls_away<L: Lanes>(shape: &RigidShape, centre: [L; 3], radius: L, reach: L) -> L::Mask {
    let margin = L::splat(MARGIN);
    let zero = L::splat(0.0);
    let mut beside = zero.less(zero);
    for (k, (c, reach)) in centre.into_iter().zip([margin, reach, margin]).enumerate() {
        let low = L::splat(shape.bounds.min[k] as f32 - ROUNDING);
        let high = L::splat(shape.bounds.max[k] as f32 + ROUNDING);
        let radius = radius + reach;
        beside = beside | (c + radius).less(low) | high.less(c - radius);
    }
    // The distance to a convex body is convex, so that interpolation only ever adds to it, and only here does it mislead.
    let found = shape.field.look_up_in(centre, zero.at_least(zero));
    let enough = radius + reach + L::splat(shape.field.error_bound());
    beside | (found.known & enough.less(found.distance))
}

/// What points are looked for near.
struct Search<'a> {
    shape: &'a RigidShape,
    into: IntoShape,
    scene: &'a ContactScene<'a>,
}

impl Search<'_> {
    /// The ways from some cells to the shape, and which of them may hold near points, a bit each.
    fn cells_near<L: Lanes>(&self, cells: &[u32]) -> ([FromCell; LANES], u32) {
        let scene = self.scene;
        let mut from_cells = [FromCell::NOWHERE; LANES];
        for (from, cell) in from_cells.iter_mut().zip(cells) {
            if let Some(d) = scene.deformation.get(*cell as usize) {
                *from = self.into.cell::<L>(d);
            }
        }
        let [x, y, z, radius] = L::columns(|l| {
            let cell = cells.get(l).unwrap_or(&cells[0]);
            from_cells[l].ball(scene.shell.overhang(*cell as usize))
        });
        let [reach, ..] = L::columns(|l| {
            let cell = cells.get(l).unwrap_or(&cells[0]);
            [reach_beyond(self.shape, scene.shell.is_walled(*cell as usize)); 4]
        });
        let away = balls_away(self.shape, [x, y, z], radius, reach);
        (from_cells, !L::bits(away) & ((1 << cells.len()) - 1))
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
            let of = |l: usize| some.get(l).unwrap_or(&some[0]);
            let centre = from_cell.places(L::columns(|l| of(l).extent().centre));
            let reach = L::columns(|l| of(l).extent().reach);
            let radius = (reach[0] * lengths[0] + reach[1] * lengths[1])
                + (reach[2] * lengths[2] + reach[3] * lengths[3]);
            let [beyond, ..] = L::columns(|l| [reach_beyond(self.shape, of(l).is_walled()); 4]);
            let away = balls_away(self.shape, centre, radius + L::splat(ROUNDING), beyond);
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
                let spread = |v: L| {
                    let mut four = [0.0; LANES];
                    v.store(&mut four, at);
                    four
                };
                let ([x, y, z], distance) = (position.map(spread), spread(samples.distance));
                for k in set_bits(near) {
                    found.put(block, first + k, [x[k], y[k], z[k]], distance[k]);
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
