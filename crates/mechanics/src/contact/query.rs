use super::near::NearFour;
use super::{BoundingVolumes, NearPoints, PointShell, RigidShape};
use crate::geometry::{DistanceSamples, LANES, Lanes, Pose, Vec3, set_bits};
use nalgebra::Matrix3x4;
use wide::f32x4;

/// What a tool sees of the bone.
#[derive(Clone, Copy, Debug)]
pub struct ContactScene<'a> {
    /// The bone's points, by cell.
    pub shell: &'a PointShell,
    /// The cells' boxes in the same state as `deformation`.
    pub volumes: &'a BoundingVolumes,
    /// Deformed positions of each cell's four virtual nodes \[mm\].
    pub deformation: &'a [Matrix3x4<f32>],
    /// Tells states apart: within one number nothing of the scene changes. 0: not known.
    pub state: u64,
    /// The points near each tool where it was when somebody looked for them in this very state.
    pub near: Option<&'a [NearPoints; 2]>,
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

/// Collects the bone's points inside a shape, by ascending cell, then place. `near` must have been brought to this place and scene
/// by [`NearPoints::follow`].
///
/// Contacts beyond the capacity of `contacts`, which is kept, are left out: give it that of `near`. Neither allocates nor waits.
pub fn penetrations(
    shape: &RigidShape,
    world_from_shape: &Pose,
    near: &NearPoints,
    contacts: &mut Vec<Contact>,
) {
    penetrations_in::<f32x4>(shape, world_from_shape, near, contacts);
}

/// As [`penetrations`], with so many points at a time.
pub fn penetrations_in<L: Lanes>(
    shape: &RigidShape,
    world_from_shape: &Pose,
    near: &NearPoints,
    contacts: &mut Vec<Contact>,
) {
    contacts.clear();
    let Some(found_at) = near.found_at() else {
        return;
    };
    let into = IntoShape::new(world_from_shape);
    let moved = into.moved(found_at);
    for points in near.fours() {
        for at in (0..LANES).step_by(L::N) {
            let [x, y, z] = points.positions.each_ref().map(|p| L::load(p, at));
            let position = moved.place([x, y, z]);
            let facing = into.facing::<L>(shape, points.normals.each_ref(), at);
            let found = shape.inside(position, facing);
            let hits = L::bits(found.distance.less(L::splat(0.0)));
            if hits != 0 {
                keep::<L>(points, at, hits << at, position, &found, contacts);
            }
        }
    }
}

/// Appends the contacts of the places in `hits`, while there is room.
fn keep<L: Lanes>(
    points: &NearFour,
    at: usize,
    hits: u32,
    position: [L; 3],
    found: &DistanceSamples<L>,
    contacts: &mut Vec<Contact>,
) {
    let spread = |v: L| {
        let mut four = [0.0; LANES];
        v.store(&mut four, at);
        four
    };
    let ([x, y, z], [u, v, w]) = (position, found.gradient);
    let (x, y, z) = (spread(x), spread(y), spread(z));
    let (u, v, w) = (spread(u), spread(v), spread(w));
    let distance = spread(found.distance);
    for k in set_bits(hits) {
        if contacts.len() == contacts.capacity() {
            return;
        }
        let position = [x[k], y[k], z[k]];
        contacts.push(Contact {
            cell: points.cells[k],
            place: points.places[k],
            id: points.ids[k],
            area: points.areas[k],
            depth: -distance[k],
            gradient: [u[k], v[k], w[k]],
            position,
            friction: [0.0; 3],
            anchor: position,
        });
    }
}

/// The way from the world into a shape's frame.
pub(super) struct IntoShape {
    /// Of the rotation.
    rows: [[f32; 3]; 3],
    exact: [[f64; 3]; 3],
    origin: Vec3,
}

/// A rigid motion.
struct Moved {
    rows: [[f32; 3]; 3],
    shift: [f32; 3],
}

impl Moved {
    #[inline]
    fn place<L: Lanes>(&self, [x, y, z]: [L; 3]) -> [L; 3] {
        [0, 1, 2].map(|k| {
            let r = &self.rows[k];
            (L::splat(r[0]) * x + L::splat(r[1]) * y)
                + (L::splat(r[2]) * z + L::splat(self.shift[k]))
        })
    }
}

impl IntoShape {
    pub fn new(world_from_shape: &Pose) -> Self {
        let turn = world_from_shape.rotation.to_rotation_matrix();
        let exact = [0, 1, 2].map(|r| [0, 1, 2].map(|k| turn[(k, r)]));
        Self {
            rows: exact.map(|r| r.map(|v| v as f32)),
            exact,
            origin: world_from_shape.translation.vector,
        }
    }

    /// `shape_from_world D` (paper, equation 9). About the shape's origin, so that f32 is fine enough near it.
    #[inline]
    pub fn cell<L: Lanes>(&self, d: &Matrix3x4<f32>) -> FromCell {
        let axis = |axis: usize| {
            let about = |k: usize| (f64::from(d[(axis, k)]) - self.origin[axis]) as f32;
            [about(0), about(1), about(2), about(3)]
        };
        let (x, y, z) = (axis(0), axis(1), axis(2));
        let row = |r: &[f32; 3]| {
            let mut row = [0.0; LANES];
            for at in (0..LANES).step_by(L::N) {
                let (x, y, z) = (L::load(&x, at), L::load(&y, at), L::load(&z, at));
                let turned = L::splat(r[0]) * x + L::splat(r[1]) * y + L::splat(r[2]) * z;
                turned.store(&mut row, at);
            }
            row
        };
        let [a, b, c] = &self.rows;
        FromCell([row(a), row(b), row(c)])
    }

    /// The shape's.
    pub fn origin(&self) -> [f32; 3] {
        [0, 1, 2].map(|k| self.origin[k] as f32)
    }

    /// The way from the shape's origin to a place, in the world's axes.
    pub fn way_to(&self, p: &Vec3) -> [f32; 3] {
        [0, 1, 2].map(|k| (p[k] - self.origin[k]) as f32)
    }

    /// Ways in the world's axes in those of the shape.
    pub fn turned<L: Lanes>(&self, [x, y, z]: [L; 3]) -> [L; 3] {
        self.rows
            .map(|r| L::splat(r[0]) * x + L::splat(r[1]) * y + L::splat(r[2]) * z)
    }

    /// Takes places in the shape's frame as it stood at `before` to its frame now.
    fn moved(&self, before: &Pose) -> Moved {
        let turn = before.rotation.to_rotation_matrix();
        let shift = before.translation.vector - self.origin;
        let row = |r: &[f64; 3], k: usize| (0..3).map(|i| r[i] * turn[(i, k)]).sum::<f64>() as f32;
        Moved {
            rows: self.exact.each_ref().map(|r| [0, 1, 2].map(|k| row(r, k))),
            shift: self
                .exact
                .map(|r| (0..3).map(|i| r[i] * shift[i]).sum::<f64>() as f32),
        }
    }

    /// How much walls look to a blade's +y.
    #[inline]
    pub fn facing<L: Lanes>(
        &self,
        shape: &RigidShape,
        normals: [&[f32; LANES]; 3],
        at: usize,
    ) -> L {
        if shape.sided.is_none() {
            return L::splat(0.0);
        }
        let [x, y, z] = normals;
        let (x, y, z) = (L::load(x, at), L::load(y, at), L::load(z, at));
        let r = &self.rows[1];
        L::splat(r[0]) * x + L::splat(r[1]) * y + L::splat(r[2]) * z
    }
}

/// Takes shape functions of a cell straight to a shape's frame: a row an axis, a column a node.
#[derive(Clone, Copy)]
pub(super) struct FromCell([[f32; LANES]; 3]);

impl FromCell {
    /// Takes all points nowhere.
    pub const NOWHERE: Self = Self([[f32::NAN; LANES]; 3]);

    /// Where points with these shape functions are.
    #[inline]
    pub fn place<L: Lanes>(&self, weights: [&[f32; LANES]; 4], at: usize) -> [L; 3] {
        let [a, b, c, d] = weights;
        let load = |w: &[f32; LANES]| L::load(w, at);
        self.places([load(a), load(b), load(c), load(d)])
    }

    /// Likewise.
    #[inline]
    pub fn places<L: Lanes>(&self, weights: [L; 4]) -> [L; 3] {
        let [a, b, c, d] = weights;
        let along = |row: &[f32; LANES]| {
            let splat = |k: usize| L::splat(row[k]);
            (splat(0) * a + splat(1) * b) + (splat(2) * c + splat(3) * d)
        };
        let [x, y, z] = &self.0;
        [along(x), along(y), along(z)]
    }

    /// Centre and radius of a ball about all points that reach out of the cell by `overhang`.
    pub fn ball(&self, overhang: f32) -> [f32; 4] {
        let [x, y, z] = self.0.map(|row| 0.25 * row.iter().sum::<f32>());
        let away = |k: usize| {
            let [a, b, c] = [self.0[0][k] - x, self.0[1][k] - y, self.0[2][k] - z];
            a * a + b * b + c * c
        };
        let radius2 = (0..4).map(away).fold(0.0, f32::max);
        [x, y, z, (1.0 + 4.0 * overhang) * radius2.sqrt()]
    }

    /// Lengths of the edges from the first node to each.
    pub fn lengths(&self) -> [f32; 4] {
        let way = |k: usize| {
            (0..3)
                .map(|r| (self.0[r][k] - self.0[r][0]).powi(2))
                .sum::<f32>()
        };
        [0, 1, 2, 3].map(|k| way(k).sqrt())
    }
}
