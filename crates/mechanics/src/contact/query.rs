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
    /// The cells' volumes in the same state as `deformation`.
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
    let Some(middle) = near.middle() else {
        return;
    };
    let into = IntoShape::new(world_from_shape, middle);
    for points in near.fours() {
        for at in (0..LANES).step_by(L::N) {
            let position = into.place_exactly(points.coarse(at), points.fine(at));
            let facing = into.facing::<L>(points.normals.each_ref(), at);
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

/// The way from places about `middle` in the world's axes into a shape's frame.
pub(super) struct IntoShape {
    /// Of the rotation.
    rows: [[f32; 3]; 3],
    /// Where the shape's origin is: coarse and fine part.
    origin: [[f32; 3]; 2],
}

impl IntoShape {
    pub fn new(world_from_shape: &Pose, middle: &Vec3) -> Self {
        let turn = world_from_shape.rotation.to_rotation_matrix();
        let origin = world_from_shape.translation.vector - middle;
        let coarse = [0, 1, 2].map(|k| origin[k] as f32);
        Self {
            rows: [0, 1, 2].map(|r| [0, 1, 2].map(|k| turn[(k, r)] as f32)),
            origin: [
                coarse,
                [0, 1, 2].map(|k| (origin[k] - f64::from(coarse[k])) as f32),
            ],
        }
    }

    /// Where places are in the shape's frame.
    #[inline]
    pub fn place<L: Lanes>(&self, place: [L; 3]) -> [L; 3] {
        self.place_exactly(place, [L::splat(0.0); 3])
    }

    /// Where places are that come in a coarse and a fine part. The shape's origin is taken off the coarse parts first, which is exact near
    /// the shape, so that nothing is rounded but what is small.
    #[inline]
    pub fn place_exactly<L: Lanes>(&self, coarse: [L; 3], fine: [L; 3]) -> [L; 3] {
        let [origin, rest] = &self.origin;
        let about = |k: usize| (coarse[k] - L::splat(origin[k])) + (fine[k] - L::splat(rest[k]));
        self.turned([about(0), about(1), about(2)])
    }

    #[inline]
    fn turned<L: Lanes>(&self, [x, y, z]: [L; 3]) -> [L; 3] {
        self.rows
            .map(|r| L::splat(r[0]) * x + L::splat(r[1]) * y + L::splat(r[2]) * z)
    }

    /// How much walls look to a blade's +y; 0 for points on no wall.
    #[inline]
    pub fn facing<L: Lanes>(&self, normals: [&[f32; LANES]; 3], at: usize) -> L {
        let [_, y, _] = self.turned(normals.map(|n| L::load(n, at)));
        y
    }
}

/// Takes shape functions of a cell to places about a middle: a row an axis, a column a node.
#[derive(Clone, Copy)]
pub(super) struct FromCell([[f32; LANES]; 3]);

impl FromCell {
    /// The cell's nodes less the middle, so that f32 is fine enough.
    #[inline]
    pub fn new(d: &Matrix3x4<f32>, middle: &Vec3) -> Self {
        let about = |axis: usize, k: usize| (f64::from(d[(axis, k)]) - middle[axis]) as f32;
        Self([0, 1, 2].map(|axis| [0, 1, 2, 3].map(|k| about(axis, k))))
    }

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
