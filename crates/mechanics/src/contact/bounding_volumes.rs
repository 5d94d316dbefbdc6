use super::PointShell;
use crate::geometry::{Aabb, LANES, SpatialHash, Vec3};
use nalgebra::Matrix3x4;
use std::sync::atomic::{AtomicU64, Ordering};

/// A box around each cell that holds points, in a spatial hash (paper 4.2).
///
/// The box of a cell is that of its deformed virtual nodes, since a point inside is their convex combination: the points
/// themselves are not touched. The hash is made anew only once a box has moved out of the room that it was given there.
/// Double-buffer by owning two. [`update`](Self::update) allocates only while it grows past
/// its largest size so far; queries never do.
#[derive(Debug)]
pub struct BoundingVolumes {
    boxes: Vec<(u32, Aabb)>,
    bounds: Aabb,
    hash: SpatialHash,
    /// The boxes that the hash knows: those of an earlier state, grown by [`SLACK`].
    hashed: Vec<(u32, Aabb)>,
    /// Balls about these, four at a time in their order.
    balls: Vec<Balls>,
    /// Tells what the hash holds from whatever any other has held.
    hash_number: u64,
}

/// Four balls, fewer at the end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Balls {
    /// Centres \[mm\], then radii.
    pub numbers: [[f32; LANES]; 4],
}

impl Balls {
    fn about(boxes: &[(u32, Aabb)]) -> Self {
        let mut numbers = [[f32::NAN; LANES]; 4];
        for (l, (_, b)) in boxes.iter().enumerate() {
            let (c, radius) = (b.centre(), 0.5 * b.extent().norm());
            for (to, v) in numbers.iter_mut().zip([c.x, c.y, c.z, radius]) {
                to[l] = v as f32;
            }
        }
        Self { numbers }
    }
}

/// The last [`BoundingVolumes::hash_number`] given out.
static LAST_HASH: AtomicU64 = AtomicU64::new(0);

/// Copies into the memory that is there: a main step hands a copy on, and memory given back to the system would be taken from under
/// all threads.
impl Clone for BoundingVolumes {
    fn clone(&self) -> Self {
        let mut copy = Self::default();
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        self.bounds = other.bounds;
        self.boxes.clone_from(&other.boxes);
        self.hashed.clone_from(&other.hashed);
        self.balls.clone_from(&other.balls);
        self.hash.clone_from(&other.hash);
        self.hash_number = other.hash_number;
    }
}

/// Boxes may move this far \[mm\] before they are hashed anew.
const SLACK: f64 = 0.5;

impl Default for BoundingVolumes {
    fn default() -> Self {
        Self {
            boxes: Vec::new(),
            bounds: Aabb::EMPTY,
            hash: SpatialHash::default(),
            hashed: Vec::new(),
            balls: Vec::new(),
            hash_number: 0,
        }
    }
}

/// Nodes are used up to this far from the origin \[mm\]; beyond lies only a deformation that has blown up.
const REACH: f32 = 1e5;

impl BoundingVolumes {
    /// Volumes of a shell in a first state.
    pub fn new(shell: &PointShell, deformation: &[Matrix3x4<f32>]) -> Self {
        let mut volumes = Self::default();
        volumes.update(shell, deformation);
        volumes
    }

    /// Follows the bone to a new state. A cell whose nodes are not finite or farther than 100 m is left out.
    pub fn update(&mut self, shell: &PointShell, deformation: &[Matrix3x4<f32>]) {
        self.boxes.clear();
        self.bounds = Aabb::EMPTY;
        for (c, d) in deformation.iter().enumerate().take(shell.n_cells()) {
            if shell.cell_is_empty(c) || !is_near(d) {
                continue;
            }
            let cell_box = enlarged(&box_of(d), d, shell.overhang(c));
            self.add_bounds(&cell_box);
            self.boxes.push((c as u32, cell_box));
        }
        let holds =
            |(own, kept): (&(u32, Aabb), &(u32, Aabb))| own.0 == kept.0 && kept.1.holds(&own.1);
        let kept =
            self.hashed.len() == self.boxes.len() && self.boxes.iter().zip(&self.hashed).all(holds);
        if !kept {
            self.rehash();
        }
    }

    /// Follows the bone where only some cells have moved, ascending; the others keep their volumes.
    pub fn update_cells(
        &mut self,
        shell: &PointShell,
        deformation: &[Matrix3x4<f32>],
        cells: &[u32],
    ) {
        let mut left_room = false;
        let mut place = 0;
        for &c in cells.iter().filter(|c| !shell.cell_is_empty(**c as usize)) {
            let d = &deformation[c as usize];
            place += self.boxes[place..].partition_point(|b| b.0 < c);
            let is_known = self.boxes.get(place).is_some_and(|b| b.0 == c);
            if !is_near(d) || !is_known {
                return self.update(shell, deformation);
            }
            let cell_box = enlarged(&box_of(d), d, shell.overhang(c as usize));
            self.add_bounds(&cell_box);
            self.boxes[place].1 = cell_box;
            left_room |= !self.hashed[place].1.holds(&cell_box);
        }
        if left_room {
            self.rehash();
        }
    }

    fn add_bounds(&mut self, volume: &Aabb) {
        self.bounds.add(&volume.min);
        self.bounds.add(&volume.max);
    }

    fn rehash(&mut self) {
        self.hashed.clear();
        let grown = self.boxes.iter().map(|(c, b)| (*c, b.grown(SLACK)));
        self.hashed.extend(grown);
        self.balls.clear();
        (self.balls).extend(self.hashed.chunks(LANES).map(Balls::about));
        let size: f64 = self.boxes.iter().map(|b| b.1.extent().max()).sum();
        let mean = size / self.boxes.len().max(1) as f64;
        let places = self.hashed.iter().enumerate();
        let places = places.map(|(k, (_, b))| (k as u32, *b));
        self.hash.rebuild(mean.max(1e-3), places);
        self.hash_number = 1 + LAST_HASH.fetch_add(1, Ordering::Relaxed);
    }

    /// Changes whenever boxes have been hashed anew: until then all volumes stay within their [`balls`](Self::balls).
    pub(super) fn hash_number(&self) -> u64 {
        self.hash_number
    }

    /// Balls about the volumes as large as these may become, in the order of their places.
    pub(super) fn balls(&self) -> &[Balls] {
        &self.balls
    }

    /// The cell at a place, and its volume.
    #[inline]
    pub(super) fn at(&self, place: u32) -> Option<(u32, &Aabb)> {
        self.boxes.get(place as usize).map(|(cell, b)| (*cell, b))
    }

    /// How many cells hold points.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// Whether no cell holds points.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// Box around all volumes.
    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Calls `visit` with each cell whose volume may meet `query`, and the volume; one may come more than once.
    pub fn query(&self, query: &Aabb, mut visit: impl FnMut(u32, &Aabb)) {
        // Only the common part: a tool that sticks far out, or has flown off, costs nothing there. NaN overlaps nothing.
        if query.overlaps(&self.bounds) {
            let common = Aabb {
                min: query.min.sup(&self.bounds.min),
                max: query.max.inf(&self.bounds.max),
            };
            self.hash.query(&common, |place| {
                if let Some((cell, volume)) = self.boxes.get(place as usize) {
                    visit(*cell, volume);
                }
            });
        }
    }
}

/// Whether a cell's nodes are finite and no farther than a deformation that has not blown up.
fn is_near(d: &Matrix3x4<f32>) -> bool {
    d.iter().all(|v| v.abs() < REACH)
}

/// The box for points that reach out of the cell by `overhang` (see [`PointShell::overhang`]).
fn enlarged(b: &Aabb, d: &Matrix3x4<f32>, overhang: f32) -> Aabb {
    if overhang <= 0.0 {
        return *b;
    }
    let centre = d.column_mean().cast::<f64>();
    let scale = 1.0 + 4.0 * f64::from(overhang);
    Aabb {
        min: centre + (b.min - centre) * scale,
        max: centre + (b.max - centre) * scale,
    }
}

fn box_of(d: &Matrix3x4<f32>) -> Aabb {
    let mut b = Aabb::EMPTY;
    for column in d.column_iter() {
        b.add(&Vec3::new(
            f64::from(column[0]),
            f64::from(column[1]),
            f64::from(column[2]),
        ));
    }
    b
}
