//! The points of the bone near a shape: found once, used as long as shape and bone stay about where they are.
use super::point_shell::{BLOCK, BlockExtent, BlockPoints};
use super::query::{ContactScene, shape_from_cell, wall_normal};
use super::rigid_shape::SIDE_DEPTH;
use super::{BoundingVolumes, RigidShape};
use crate::geometry::{Aabb, DistanceSample, Pose};
use nalgebra::Matrix3x4;

/// Points within this distance of a shape \[mm\] are kept: the shape may move as far before they are looked for again. Less than
/// the margin of the shapes' grids, which know nothing beyond.
const MARGIN: f32 = 0.25;

/// The points near one shape, by ascending cell, then place, and the memory to find them. Nothing here allocates after
/// construction.
#[derive(Clone, Debug)]
pub struct NearPoints {
    cells: NearCells,
    groups: Vec<Group>,
    points: Vec<NearPoint>,
    found: Option<Found>,
    n_dropped: usize,
}

/// Where the shape was and in which state the scene when the points were found.
#[derive(Clone, Copy, Debug)]
struct Found {
    at: Pose,
    state: u64,
}

/// The near points of one cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    pub cell: u32,
    first: u32,
    end: u32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct NearPoint {
    pub weights: [f32; 4],
    pub normal: [f32; 3],
    pub area: f32,
    pub place: u32,
    pub id: u32,
}

impl NearPoints {
    /// Room for `n_cells` near cells and `n_points` near points.
    pub fn with_capacity(n_cells: usize, n_points: usize) -> Self {
        Self {
            cells: NearCells::with_capacity(n_cells),
            groups: Vec::with_capacity(n_cells),
            points: Vec::with_capacity(n_points),
            found: None,
            n_dropped: 0,
        }
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// How many points found no room. The deepest never are among them.
    pub fn n_dropped(&self) -> usize {
        self.n_dropped
    }

    pub(super) fn groups(&self) -> &[Group] {
        &self.groups
    }

    pub(super) fn points(&self, group: &Group) -> &[NearPoint] {
        let range = group.first as usize..group.end as usize;
        self.points.get(range).unwrap_or(&[])
    }

    /// Makes sure that the points near the shape at `world_from_shape` are here. Looks for them only if the scene is in another
    /// state or the shape has moved by more than the margin.
    pub fn follow(&mut self, shape: &RigidShape, world_from_shape: &Pose, scene: &ContactScene) {
        let is_seen = |f: &Found| scene.state != 0 && f.state == scene.state;
        if self.found.as_ref().is_some_and(is_seen) && self.holds(shape, world_from_shape) {
            return;
        }
        self.find(shape, world_from_shape, scene);
        self.found = Some(Found {
            at: *world_from_shape,
            state: scene.state,
        });
    }

    /// Whether they serve the shape at `world_from_shape` in the state in which they were found.
    pub fn holds(&self, shape: &RigidShape, world_from_shape: &Pose) -> bool {
        let near = |f: &Found| way(shape, &f.at, world_from_shape) < f64::from(MARGIN - ROUNDING);
        self.found.as_ref().is_some_and(near)
    }

    /// As [`follow`](Self::follow), from anew.
    pub fn find(&mut self, shape: &RigidShape, world_from_shape: &Pose, scene: &ContactScene) {
        self.cells.find(shape, world_from_shape, scene.volumes);
        let mut depths = Depths::default();
        self.collect(
            shape,
            world_from_shape,
            scene,
            f32::NEG_INFINITY,
            &mut depths,
        );
        self.n_dropped = depths.n.saturating_sub(self.points.len());
        if self.n_dropped > 0 {
            let deeper = depths.deepest(self.points.capacity());
            self.collect(
                shape,
                world_from_shape,
                scene,
                deeper,
                &mut Depths::default(),
            );
            self.n_dropped = depths.n.saturating_sub(self.points.len());
        }
    }

    /// Gathers the near points that are deeper than `deeper` (negative outside) while there is room, and counts all.
    fn collect(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
        deeper: f32,
        depths: &mut Depths,
    ) {
        self.groups.clear();
        self.points.clear();
        let shape_from_world = world_from_shape.inverse();
        for &c in &self.cells.cells {
            let Some(d) = scene.deformation.get(c as usize) else {
                continue;
            };
            let m = shape_from_cell(&shape_from_world, d);
            if cell_is_away(shape, &m, scene.shell.overhang(c as usize)) {
                continue;
            }
            let cell = CellQuery {
                shape,
                lengths: [0, 1, 2, 3].map(|k| (m.column(k) - m.column(0)).norm()),
                m: &m,
                shape_from_world: &shape_from_world,
            };
            let first = self.points.len() as u32;
            for block in scene.shell.blocks(c as usize) {
                if !cell.is_away(block.extent) {
                    cell.collect(&block, deeper, depths, &mut self.points);
                }
            }
            let end = self.points.len() as u32;
            if end > first && self.groups.len() < self.groups.capacity() {
                self.groups.push(Group {
                    cell: c,
                    first,
                    end,
                });
            }
        }
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
    fn find(&mut self, shape: &RigidShape, world_from_shape: &Pose, volumes: &BoundingVolumes) {
        self.cells.clear();
        self.next_stamp();
        let (cells, places, stamp) = (&mut self.cells, &mut self.seen, self.stamp);
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
    let shape_from_world = world_from_shape.inverse();
    let reach = f64::from(way + reach_beyond(shape));
    for slice in slices(&shape.bounds) {
        let query = slice.moved(world_from_shape).grown(reach);
        volumes.query(&query, |c, volume| {
            let may_touch = || {
                let centre = shape_from_world * nalgebra::Point3::from(volume.centre());
                let centre = centre.coords.map(|v| v as f32).into();
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

fn cell_is_away(shape: &RigidShape, m: &Matrix3x4<f32>, overhang: f32) -> bool {
    let centre = m.column_mean();
    let radius2 = m
        .column_iter()
        .fold(0.0f32, |r, p| r.max((p - centre).norm_squared()));
    ball_is_away(
        shape,
        centre.into(),
        (1.0 + 4.0 * overhang) * radius2.sqrt(),
    )
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
    let radius = radius + reach_beyond(shape);
    let beside = (0..3).any(|k| {
        centre[k] + radius < shape.bounds.min[k] as f32 - ROUNDING
            || centre[k] - radius > shape.bounds.max[k] as f32 + ROUNDING
    });
    // The distance to a convex body is convex, so that interpolation only ever adds to it, and only here does it mislead.
    let away = |s: DistanceSample| s.distance > radius + shape.field.error_bound();
    beside || shape.field.look_up(centre).is_some_and(away)
}

struct CellQuery<'a> {
    shape: &'a RigidShape,
    m: &'a Matrix3x4<f32>,
    /// Of the edges from the first node to each.
    lengths: [f32; 4],
    shape_from_world: &'a Pose,
}

impl CellQuery<'_> {
    fn is_away(&self, extent: &BlockExtent) -> bool {
        let centre = self.m * nalgebra::Vector4::from(extent.centre);
        let radius: f32 = (0..4).map(|k| extent.reach[k] * self.lengths[k]).sum();
        ball_is_away(self.shape, centre.into(), radius + ROUNDING)
    }

    fn collect(
        &self,
        block: &BlockPoints,
        deeper: f32,
        depths: &mut Depths,
        points: &mut Vec<NearPoint>,
    ) {
        let mut q = [[0.0f32; BLOCK]; 3];
        transform(self.m, block.weights, &mut q);
        let [x, y, z] = &q;
        let positions = x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z]);
        for (k, position) in positions.enumerate().take(block.ids.len()) {
            let normal = &block.normals[k];
            let wall = wall_normal(self.shape, self.shape_from_world, normal);
            let Some(sample) = self.shape.nearness(position, wall.as_ref(), MARGIN) else {
                continue;
            };
            depths.add(-sample.distance);
            if -sample.distance > deeper && points.len() < points.capacity() {
                points.push(NearPoint {
                    weights: [0, 1, 2, 3].map(|c: usize| block.weights[c][k]),
                    normal: *normal,
                    area: block.areas[k],
                    place: (block.first + k) as u32,
                    id: block.ids[k],
                });
            }
        }
    }
}

/// `q = M N` for a block of points; straight loops over slices, so that the compiler vectorises them.
fn transform(m: &Matrix3x4<f32>, weights: [&[f32]; 4], q: &mut [[f32; BLOCK]; 3]) {
    let [a, b, c, d] = weights;
    for (row, out) in q.iter_mut().enumerate() {
        let [ma, mb, mc, md] = [m[(row, 0)], m[(row, 1)], m[(row, 2)], m[(row, 3)]];
        let ab = a.iter().zip(b).map(|(a, b)| ma * a + mb * b);
        let cd = c.iter().zip(d).map(|(c, d)| mc * c + md * d);
        for (out, (ab, cd)) in out.iter_mut().zip(ab.zip(cd)) {
            *out = ab + cd;
        }
    }
}
