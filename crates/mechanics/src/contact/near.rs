//! The points of the bone near a shape: found once, used as long as shape and bone stay about where they are.
use super::point_shell::BlockPoints;
use super::query::{ContactScene, FromCell, IntoShape};
use super::rigid_shape::Faces;
use super::{BoundingVolumes, RigidShape};
use crate::geometry::{LANES, Lanes, Pose, Vec3, set_bits};
use nalgebra::Matrix3x4;
use wide::f32x4;

/// Points within this distance of a shape \[mm\] are kept: the shape may move as far before others are picked.
const MARGIN: f32 = 0.25;

/// Neither may it turn by more than this \[rad\]: whether a wall looks at a side of a blade is asked with as much to spare.
pub(super) const TURN: f32 = 0.05;

/// They are picked among those within this distance \[mm\], which are looked for in the bone: a trial step is at most 1 mm.
const AROUND: f32 = 2.25;

/// Within this distance of a blade \[mm\] the bone is looked at to know how far back along it there is any.
const AFAR: f32 = 5.0;

/// Rounding of f32 at the coordinates of a head \[mm\].
const ROUNDING: f32 = 1e-3;

/// The points near one shape, by ascending cell, then place, and the memory to find them. Nothing here allocates after
/// construction.
#[derive(Debug)]
pub struct NearPoints {
    around: Around,
    points: Points,
    found: Option<Found>,
    n_dropped: usize,
}

/// Where the shape was and in which state the scene when the points were found.
#[derive(Clone, Copy, Debug)]
struct Found {
    at: Pose,
    state: u64,
    /// Of the scene's volumes.
    middle: Vec3,
    /// Farther back along the shape than this (z in its frame, \[mm\]) there was no bone within [`AFAR`].
    back: f32,
}

/// Four points, fewer at the end. Places without a point have positions that are NaN: they are nowhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearFour {
    /// From the middle of the scene's volumes, in the world's axes, as coarse and fine part: they hang on the state alone, not on where a
    /// shape was. A single f32 is off by 1e-6 mm there, by which a stiff contact on a soft bone never comes to rest.
    positions: [[[f32; LANES]; 3]; 2],
    pub normals: [[f32; LANES]; 3],
    pub areas: [f32; LANES],
    pub cells: [u32; LANES],
    pub places: [u32; LANES],
    pub ids: [u32; LANES],
}

impl NearFour {
    const EMPTY: Self = Self {
        positions: [[[f32::NAN; LANES]; 3]; 2],
        normals: [[0.0; LANES]; 3],
        areas: [0.0; LANES],
        cells: [0; LANES],
        places: [0; LANES],
        ids: [0; LANES],
    };

    #[inline]
    pub fn coarse<L: Lanes>(&self, at: usize) -> [L; 3] {
        self.positions[0].each_ref().map(|p| L::load(p, at))
    }

    #[inline]
    pub fn fine<L: Lanes>(&self, at: usize) -> [L; 3] {
        self.positions[1].each_ref().map(|p| L::load(p, at))
    }
}

/// A point that was found.
struct Point<'a> {
    cell: u32,
    block: &'a BlockPoints<'a>,
    /// Its place in the block.
    k: usize,
    /// Coarse and fine part.
    position: [[f32; 3]; 2],
}

/// A list of points.
#[derive(Debug)]
struct Points {
    fours: Vec<NearFour>,
    n: usize,
    n_room: usize,
}

impl Points {
    fn with_capacity(n_room: usize) -> Self {
        Self {
            fours: Vec::with_capacity(n_room.div_ceil(LANES)),
            n: 0,
            n_room,
        }
    }

    fn clear(&mut self) {
        self.fours.clear();
        self.n = 0;
    }

    fn copy(&mut self, other: &Self) {
        self.fours.clone_from(&other.fours);
        self.n = other.n;
        self.n_room = self.n_room.max(other.n_room);
    }

    /// The next place, with the number of its lane; none if there is no room.
    fn next(&mut self) -> Option<(&mut NearFour, usize)> {
        if self.n == self.n_room {
            return None;
        }
        let at = self.n % LANES;
        if at == 0 {
            self.fours.push(NearFour::EMPTY);
        }
        self.n += 1;
        Some((self.fours.last_mut()?, at))
    }

    fn put(&mut self, point: &Point) -> bool {
        let Some((four, at)) = self.next() else {
            return false;
        };
        let Point { block, k, .. } = *point;
        for (to, from) in four.positions.iter_mut().zip(point.position) {
            (0..3).for_each(|axis| to[axis][at] = from[axis]);
        }
        for (to, from) in four.normals.iter_mut().zip(block.normals) {
            to[at] = from[k];
        }
        four.areas[at] = block.areas[k];
        four.cells[at] = point.cell;
        four.places[at] = (block.first + k) as u32;
        four.ids[at] = block.ids[k];
        true
    }

    /// Point `l` of four.
    fn pick(&mut self, from: &NearFour, l: usize) {
        let Some((four, at)) = self.next() else {
            return;
        };
        for k in 0..3 {
            four.positions[0][k][at] = from.positions[0][k][l];
            four.positions[1][k][at] = from.positions[1][k][l];
            four.normals[k][at] = from.normals[k][l];
        }
        four.areas[at] = from.areas[l];
        four.cells[at] = from.cells[l];
        four.places[at] = from.places[l];
        four.ids[at] = from.ids[l];
    }
}

/// A copy made into memory that is there.
impl Clone for NearPoints {
    fn clone(&self) -> Self {
        let mut copy = Self::with_capacity(self.points.n_room);
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        self.around.points.copy(&other.around.points);
        self.around.found = other.around.found;
        self.points.copy(&other.points);
        self.found = other.found;
        self.n_dropped = other.n_dropped;
    }
}

impl NearPoints {
    /// Room for `n_points` near points.
    pub fn with_capacity(n_points: usize) -> Self {
        Self {
            around: Around {
                points: Points::with_capacity(2 * n_points),
                found: None,
            },
            points: Points::with_capacity(n_points),
            found: None,
            n_dropped: 0,
        }
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.n
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.n == 0
    }

    /// How many points found no room. The deepest never are among them.
    pub fn n_dropped(&self) -> usize {
        self.n_dropped
    }

    pub(super) fn fours(&self) -> &[NearFour] {
        &self.points.fours
    }

    /// What their positions are from.
    pub(super) fn middle(&self) -> Option<&Vec3> {
        self.found.as_ref().map(|f| &f.middle)
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
            self.renew::<L>(shape, world_from_shape, scene, None);
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
            f.way(shape, world_from_shape) < f64::from(MARGIN - ROUNDING)
                && f.at.rotation.angle_to(&world_from_shape.rotation) < f64::from(TURN)
        };
        self.found.as_ref().is_some_and(near)
    }

    /// Whether those near the shape at `world_from_shape` can be picked without another look at the bone.
    pub(super) fn knows(
        &self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
    ) -> bool {
        self.around.serves(shape, world_from_shape, scene)
    }

    /// The surroundings, if they are of the same state as the points: places give theirs away.
    fn own_around(&self) -> Option<&Around> {
        let state = |found: &Option<Found>| found.as_ref().map(|f| f.state);
        (state(&self.around.found) == state(&self.found)).then_some(&self.around)
    }

    /// Takes over what another place of the same shape knows about its surroundings, and gives away its own.
    pub(super) fn take_around(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.around, &mut other.around);
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
        self.around.found = None;
        self.renew::<L>(shape, world_from_shape, scene, None);
    }

    /// Picks them anew from what is known of the surroundings, by itself or in the same state by `lent`, or else looks there.
    pub(super) fn renew<L: Lanes>(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
        lent: Option<&Self>,
    ) {
        let search = Search::new(shape, world_from_shape, scene);
        self.points.clear();
        self.n_dropped = 0;
        let lent = lent.and_then(Self::own_around);
        let lent = lent.filter(|l| l.holds(shape, world_from_shape));
        let mut from = &self.around;
        if !from.serves(shape, world_from_shape, scene) {
            if let Some(lent) = lent {
                from = lent;
            } else {
                self.around.look::<L>(&search, world_from_shape, scene);
                from = &self.around;
            }
        }
        match from.found {
            Some(_) => self.points.pick_near::<L>(&from.points, &search),
            None => self.n_dropped = self.points.find_deepest::<L>(&search),
        }
        self.found = Some(Found {
            at: *world_from_shape,
            state: scene.state,
            middle: *scene.volumes.middle(),
            back: from.found.map_or(f32::NEG_INFINITY, |f| f.back),
        });
    }
}

impl Points {
    /// Picks those near the shape.
    fn pick_near<L: Lanes>(&mut self, around: &Self, search: &Search) {
        for four in &around.fours {
            let near = (0..LANES)
                .step_by(L::N)
                .fold(0, |near, at| near | search.near::<L>(four, at) << at);
            for l in set_bits(near) {
                self.pick(four, l);
            }
        }
    }

    /// Finds those near the shape straight in the bone, the deepest first if there is no room for all; how many found none.
    fn find_deepest<L: Lanes>(&mut self, search: &Search) -> usize {
        let mut depths = Depths::default();
        search.each_about::<L>(MARGIN, |point| {
            depths.add(search.depth(point));
            true
        });
        let deeper = depths.deepest(self.n_room);
        search.each_about::<L>(MARGIN, |point| {
            search.depth(point) <= deeper || self.put(point)
        });
        depths.n - self.n
    }
}

/// The points within [`AROUND`] of a shape.
#[derive(Debug)]
struct Around {
    points: Points,
    /// None if there was no room for all.
    found: Option<Found>,
}

impl Around {
    fn serves(&self, shape: &RigidShape, world_from_shape: &Pose, scene: &ContactScene) -> bool {
        let is_seen = |f: &Found| scene.state != 0 && f.state == scene.state;
        self.found.as_ref().is_some_and(is_seen) && self.holds(shape, world_from_shape)
    }

    /// Whether all points near the shape at `world_from_shape` are among these, in the state in which they were found.
    fn holds(&self, shape: &RigidShape, world_from_shape: &Pose) -> bool {
        let farthest = f64::from(AROUND - MARGIN - ROUNDING);
        let has_all = |f: &Found| f.way(shape, world_from_shape) < farthest;
        self.found.as_ref().is_some_and(has_all)
    }

    /// Looks for them.
    fn look<L: Lanes>(&mut self, search: &Search, at: &Pose, scene: &ContactScene) {
        self.points.clear();
        let points = &mut self.points;
        let is_all = search.each_about::<L>(AROUND, |point| points.put(point));
        self.found = is_all.then_some(Found {
            at: *at,
            state: scene.state,
            middle: *scene.volumes.middle(),
            back: search.back::<L>(),
        });
    }
}

impl Found {
    /// The farthest that a place moves \[mm\] that is tied to the shape and where bone may come into it: the way is longest at a corner of
    /// a box around those. Infinite if bone may come there that was not looked at.
    fn way(&self, shape: &RigidShape, to: &Pose) -> f64 {
        let turn = |pose: &Pose| *pose.rotation.to_rotation_matrix().matrix();
        let turned = turn(to) - turn(&self.at);
        let shift = to.translation.vector - self.at.translation.vector;
        let reach = shape.reach().grown(f64::from(MARGIN));
        let (low, high) = (reach.min, reach.max);
        let farthest = |back: f64| {
            let z = [back.clamp(low.z, high.z), high.z];
            let way2 = |k: usize| {
                let (x, y) = ([low.x, high.x][k & 1], [low.y, high.y][k >> 1 & 1]);
                (turned * Vec3::new(x, y, z[k >> 2 & 1]) + shift).norm_squared()
            };
            (0..8).map(way2).fold(0.0, f64::max).sqrt()
        };
        // A blade's handle moves most when it tilts, and no bone is there. Half: points are picked among those looked for elsewhere.
        if farthest(low.z) < f64::from(0.5 * AFAR) {
            farthest(f64::from(self.back - AFAR))
        } else {
            f64::INFINITY
        }
    }
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

/// Calls `visit` with each of the `cells` that hold points whose volume may hold points near the shape, were they to move by `way`
/// \[mm\]; ascending.
pub fn cells_about(
    shape: &RigidShape,
    world_from_shape: &Pose,
    volumes: &BoundingVolumes,
    cells: &[u32],
    way: f32,
    mut visit: impl FnMut(u32),
) {
    let from_world = IntoShape::new(world_from_shape, &Vec3::zeros());
    let balls = BallSearch {
        faces: shape.faces(),
        from_world: &from_world,
        volumes,
        within: MARGIN + way,
    };
    balls.each_near::<f32x4>(|place, _| cells.get(place).into_iter().for_each(|c| visit(*c)));
}

/// Looks through the volumes.
struct BallSearch<'a> {
    faces: Faces,
    from_world: &'a IntoShape,
    volumes: &'a BoundingVolumes,
    within: f32,
}

impl BallSearch<'_> {
    /// Calls `visit` with the place of each cell that may have points of walls near the shape, and whether other points could be, too.
    fn each_near<L: Lanes>(&self, mut visit: impl FnMut(usize, bool)) {
        let fours = self.volumes.balls();
        for (first, groups) in (0..).step_by(LANES).zip(self.volumes.groups()) {
            let (_, near_groups) = self.near::<L>(&groups.numbers);
            for four in set_bits(near_groups).map(|l| LANES * (first + l)) {
                let own = fours.iter().skip(four).take(LANES);
                for (place, balls) in (LANES * four..).step_by(LANES).zip(own) {
                    let (near, near_walls) = self.near::<L>(&balls.numbers);
                    for l in set_bits(near_walls) {
                        visit(place + l, near >> l & 1 == 1);
                    }
                }
            }
        }
    }

    /// Which of four balls are near for the whole shape, and which for the walls at its sides, a bit each.
    fn near<L: Lanes>(&self, balls: &[[f32; LANES]; 4]) -> (u32, u32) {
        let (mut near, mut near_walls) = (0, 0);
        for at in (0..LANES).step_by(L::N) {
            let [x, y, z, radius] = balls.each_ref().map(|n| L::load(n, at));
            let centre = self.from_world.place([x, y, z]);
            let within = radius + L::splat(self.within + ROUNDING);
            let [body, right, left] = self.faces.near_sides(centre, within);
            near |= L::bits(body) << at;
            near_walls |= L::bits(body | right | left) << at;
        }
        (near, near_walls)
    }
}

/// What points are looked for near.
struct Search<'a> {
    faces: Faces,
    from_world: IntoShape,
    from_middle: IntoShape,
    scene: &'a ContactScene<'a>,
}

impl<'a> Search<'a> {
    fn new(shape: &RigidShape, world_from_shape: &Pose, scene: &'a ContactScene<'a>) -> Self {
        Self {
            faces: shape.faces(),
            from_world: IntoShape::new(world_from_shape, &Vec3::zeros()),
            from_middle: IntoShape::new(world_from_shape, scene.volumes.middle()),
            scene,
        }
    }

    fn balls(&self, within: f32) -> BallSearch<'_> {
        BallSearch {
            faces: self.faces,
            from_world: &self.from_world,
            volumes: self.scene.volumes,
            within,
        }
    }

    /// How far back along the shape there is bone within [`AFAR`], if not nearer.
    fn back<L: Lanes>(&self) -> f32 {
        let balls = self.balls(AFAR);
        let mut back = f32::INFINITY;
        for groups in self.scene.volumes.groups() {
            let (_, near) = balls.near::<L>(&groups.numbers);
            for l in set_bits(near) {
                let [x, y, z, radius] = groups.numbers.map(|n| n[l]);
                let [.., z] = self.from_world.place([x, y, z]);
                back = back.min(z - radius);
            }
        }
        back
    }

    /// Which points of four are within the margin of the shape, a bit each.
    #[inline]
    fn near<L: Lanes>(&self, four: &NearFour, at: usize) -> u32 {
        let facing = self.from_middle.facing::<L>(four.normals.each_ref(), at);
        let place = self.from_middle.place(four.coarse(at));
        let within = L::splat(MARGIN + ROUNDING);
        L::bits(self.faces.near_facing(place, within, facing))
    }

    fn depth(&self, point: &Point) -> f32 {
        let normals = point.block.normals.map(|n| [n[point.k]; LANES]);
        let facing = self.from_middle.facing::<f32>(normals.each_ref(), 0);
        let place = self.from_middle.place(point.position[0]);
        self.faces.depth(place, facing)
    }

    /// Calls `visit` with each point that may come within `margin`, until it says no; whether it never did. Points of walls count
    /// whichever side they look to.
    fn each_about<L: Lanes>(&self, margin: f32, mut visit: impl FnMut(&Point) -> bool) -> bool {
        let shell = self.scene.shell;
        let mut goes_on = true;
        self.balls(margin).each_near::<L>(|place, is_near| {
            let Some(&cell) = shell.occupied().get(place) else {
                return;
            };
            let deformed = self.scene.deformation.get(cell as usize);
            let wanted = goes_on && (is_near || shell.is_walled(cell as usize));
            let Some(d) = deformed.filter(|_| wanted) else {
                return;
            };
            let from_cell = FromCell::new(d, self.scene.volumes.middle());
            self.blocks_near::<L>(cell as usize, &from_cell, margin, |block, is_walled| {
                self.points_near::<L>(block, is_walled, &from_cell, margin, |k| {
                    if goes_on {
                        let position = exactly(d, block, k, self.scene.volumes.middle());
                        goes_on = visit(&Point {
                            cell,
                            block,
                            k,
                            position,
                        });
                    }
                });
            });
        });
        goes_on
    }

    /// Calls `visit` with the blocks of a cell that may hold points within `margin`, and whether they hold points of walls.
    fn blocks_near<L: Lanes>(
        &self,
        cell: usize,
        from_cell: &FromCell,
        margin: f32,
        mut visit: impl FnMut(&BlockPoints, bool),
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
            let within = radius + L::splat(margin + ROUNDING);
            let near = self.near_walled(centre, within, |l| of(l).is_walled());
            for l in set_bits(near & ((1 << some.len()) - 1)) {
                if let Some(block) = shell.points_of(&some[l]) {
                    visit(&block, some[l].is_walled());
                }
            }
        }
    }

    fn points_near<L: Lanes>(
        &self,
        block: &BlockPoints,
        is_walled: bool,
        from_cell: &FromCell,
        margin: f32,
        mut visit: impl FnMut(usize),
    ) {
        let n = block.ids.len();
        let [a, b, c, d] = block.weights;
        let within = L::splat(margin + ROUNDING);
        for first in (0..n).step_by(LANES) {
            let weights = [a, b, c, d].map(|list| four(list, first));
            let n_left = LANES.min(n - first);
            for at in (0..n_left).step_by(L::N) {
                let position = from_cell.place::<L>(weights, at);
                let near = self.near_walled(position, within, |_| is_walled) << at;
                for k in set_bits(near & ((1 << n_left) - 1)) {
                    visit(first + k);
                }
            }
        }
    }

    /// Which balls are near, those with points of walls at the shape's sides, too; a bit each.
    #[inline]
    fn near_walled<L: Lanes>(
        &self,
        centre: [L; 3],
        within: L,
        is_walled: impl Fn(usize) -> bool,
    ) -> u32 {
        let [walled, ..] = L::columns(|l| [f32::from(u8::from(is_walled(l))); 4]);
        let walls = L::splat(0.0).less(walled);
        let place = self.from_middle.place(centre);
        L::bits(self.faces.near(place, within, walls, walls))
    }
}

/// Four numbers of a list.
#[inline]
fn four(from: &[f32], first: usize) -> &[f32; LANES] {
    from.get(first..)
        .and_then(<[f32]>::first_chunk)
        .unwrap_or(&[f32::NAN; LANES])
}

/// Where point `k` of a block lies from `middle` in a deformed cell, as coarse and fine part.
fn exactly(d: &Matrix3x4<f32>, block: &BlockPoints, k: usize, middle: &Vec3) -> [[f32; 3]; 2] {
    let weights = block.weights.map(|w| f64::from(w[k]));
    let along = |axis: usize| {
        let node = |n: usize| f64::from(d[(axis, n)]) - middle[axis];
        (weights[0] * node(0) + weights[1] * node(1))
            + (weights[2] * node(2) + weights[3] * node(3))
    };
    let position = [0, 1, 2].map(along);
    let coarse = position.map(|v| v as f32);
    let fine = [0, 1, 2].map(|axis| (position[axis] - f64::from(coarse[axis])) as f32);
    [coarse, fine]
}
