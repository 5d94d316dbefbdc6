use super::point_shell::{BLOCK, BlockExtent, BlockPoints};
use super::{BoundingVolumes, PointShell, RigidShape};
use crate::geometry::{Aabb, DistanceSample, Pose, Vec3};
use nalgebra::Matrix3x4;

/// What a tool sees of the bone.
#[derive(Clone, Copy, Debug)]
pub struct ContactScene<'a> {
    /// The bone's points, by cell.
    pub shell: &'a PointShell,
    /// The cells' boxes in the same state as `deformation`.
    pub volumes: &'a BoundingVolumes,
    /// Deformed positions of each cell's four virtual nodes \[mm\].
    pub deformation: &'a [Matrix3x4<f32>],
}

/// A point of the bone inside a rigid shape. Positions and directions in the shape's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The cell that carries the point.
    pub cell: u32,
    /// Place of the point in the shell's sorted arrays.
    pub place: u32,
    /// The point's stable id.
    pub id: u32,
    /// \[mm2\]
    pub area: f32,
    /// How deep it is inside \[mm\], positive.
    pub depth: f32,
    /// Gradient of the distance: the way out.
    pub gradient: [f32; 3],
    /// Where it is.
    pub position: [f32; 3],
    /// Friction on the bone \[N\]; set by the response.
    pub friction: [f32; 3],
    /// Where it clings to the shape if the step ends here; set by the response.
    pub anchor: [f32; 3],
}

/// The cells near one shape, and the memory to find them. Nothing here allocates after construction.
#[derive(Clone, Debug)]
pub struct Candidates {
    cells: Vec<u32>,
    stamps: Vec<u32>,
    stamp: u32,
}

/// A shape is looked up in this many slices along its longest axis, so that a slanted blade does not drag in the cells
/// of the whole box around it.
const SLICES: usize = 5;
/// Rounding of f32 at the coordinates of a head \[mm\].
const ROUNDING: f32 = 1e-3;

impl Candidates {
    /// Room for `n_cells` near cells; more are left out.
    pub fn with_capacity(n_cells: usize) -> Self {
        Self {
            cells: Vec::with_capacity(n_cells),
            stamps: vec![0; n_cells],
            stamp: 0,
        }
    }

    /// The near cells, ascending.
    pub fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// Finds the cells within about `margin` \[mm\] of the shape at `world_from_shape`.
    pub fn gather(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        margin: f64,
        volumes: &BoundingVolumes,
    ) {
        self.cells.clear();
        self.next_stamp();
        let (cells, stamps, stamp) = (&mut self.cells, &mut self.stamps, self.stamp);
        for slice in slices(&shape.bounds) {
            let query = box_in_world(&slice, world_from_shape).grown(margin);
            volumes.query(&query, |c| {
                let seen = stamps.get_mut(c as usize).is_none_or(|s| {
                    let seen = *s == stamp;
                    *s = stamp;
                    seen
                });
                if !seen && cells.len() < cells.capacity() {
                    cells.push(c);
                }
            });
        }
        cells.sort_unstable();
    }

    fn next_stamp(&mut self) {
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.stamps.fill(0);
            self.stamp = 1;
        }
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

fn box_in_world(b: &Aabb, world_from_shape: &Pose) -> Aabb {
    let centre = (world_from_shape * nalgebra::Point3::from(b.centre())).coords;
    let turn = world_from_shape.rotation.to_rotation_matrix();
    let half = turn.matrix().abs() * (b.extent() * 0.5);
    Aabb {
        min: centre - half,
        max: centre + half,
    }
}

/// Collects the bone's points inside a shape, by ascending cell, then place. Returns how many found no room in `contacts`,
/// which keeps its capacity: this neither allocates nor waits, and visits each point of the candidate cells once at most.
pub fn penetrations(
    shape: &RigidShape,
    world_from_shape: &Pose,
    scene: &ContactScene,
    candidates: &Candidates,
    contacts: &mut Vec<Contact>,
) -> usize {
    contacts.clear();
    let shape_from_world = world_from_shape.inverse();
    let mut n_dropped = 0;
    for &c in &candidates.cells {
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
            cell: c,
            shape_from_world: &shape_from_world,
        };
        for block in scene.shell.blocks(c as usize) {
            if !cell.is_away(block.extent) {
                n_dropped += cell.collect(&block, contacts);
            }
        }
    }
    n_dropped
}

/// `M = shape_from_world D`: takes shape functions straight to the shape's frame (paper eq. 9).
fn shape_from_cell(shape_from_world: &Pose, d: &Matrix3x4<f32>) -> Matrix3x4<f32> {
    let mut m = Matrix3x4::zeros();
    for (to, from) in m.column_iter_mut().zip(d.column_iter()) {
        let p = from.map(f64::from);
        let q = shape_from_world.rotation * p + shape_from_world.translation.vector;
        { to }.copy_from(&q.map(|v| v as f32));
    }
    m
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

/// Whether no point of a ball can be inside the shape, nor in what a thin blade shadows on its far side.
fn ball_is_away(shape: &RigidShape, centre: [f32; 3], radius: f32) -> bool {
    let shadow = if shape.sided.is_some() {
        SIDE_DEPTH as f32
    } else {
        0.0
    };
    let radius = radius + shadow;
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
    cell: u32,
    shape_from_world: &'a Pose,
}

impl CellQuery<'_> {
    fn is_away(&self, extent: &BlockExtent) -> bool {
        let centre = self.m * nalgebra::Vector4::from(extent.centre);
        let radius: f32 = (0..4).map(|k| extent.reach[k] * self.lengths[k]).sum();
        ball_is_away(self.shape, centre.into(), radius + ROUNDING)
    }

    fn collect(&self, points: &BlockPoints, contacts: &mut Vec<Contact>) -> usize {
        let mut n_dropped = 0;
        let mut q = [[0.0f32; BLOCK]; 3];
        transform(self.m, points.weights, &mut q);
        let [x, y, z] = &q;
        let positions = x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z]);
        for (k, position) in positions.enumerate().take(points.ids.len()) {
            let Some(sample) = self.inside(position, &points.normals[k]) else {
                continue;
            };
            if contacts.len() == contacts.capacity() {
                n_dropped += 1;
                continue;
            }
            contacts.push(Contact {
                cell: self.cell,
                place: (points.first + k) as u32,
                id: points.ids[k],
                area: points.areas[k],
                depth: -sample.distance,
                gradient: sample.gradient,
                position,
                friction: [0.0; 3],
                anchor: position,
            });
        }
        n_dropped
    }

    fn inside(&self, position: [f32; 3], normal: &[f32; 3]) -> Option<DistanceSample> {
        // NaN is not inside.
        let own = self.on_own_side(position, normal);
        let sample = own.or_else(|| self.shape.field.look_up(position))?;
        (sample.distance < 0.0).then_some(sample)
    }

    /// For a point of a wall that looks at a side of a blade: how deep it is behind that side, even where it has come out
    /// of the blade's other side. A thin blade that twists in the crack must not slip through its walls.
    fn on_own_side(&self, position: [f32; 3], normal: &[f32; 3]) -> Option<DistanceSample> {
        let sided = self.shape.sided.as_ref()?;
        if *normal == [0.0; 3] {
            return None;
        }
        let n = self.shape_from_world.rotation * Vec3::from(normal.map(f64::from));
        let sample = if n.y > SIDE_COSINE {
            sided[0].look_up(position)?
        } else if n.y < -SIDE_COSINE {
            sided[1].look_up(position)?
        } else {
            return None;
        };
        (sample.distance > -SIDE_DEPTH as f32).then_some(sample)
    }
}

/// A wall looks at the blade's side if its normal is within 70 degrees of the blade's.
const SIDE_COSINE: f64 = 0.34;
/// Deeper than this behind its own side \[mm\] a wall's point takes the nearest way out after all: then the blade did not
/// come down the crack, and a first contact must not begin with the whole thickness of the blade.
pub const SIDE_DEPTH: f64 = 2.5;

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
