use super::{BoundingVolumes, NearPoints, PointShell, RigidShape};
use crate::geometry::{Pose, Vec3};
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
    scene: &ContactScene,
    near: &NearPoints,
    contacts: &mut Vec<Contact>,
) {
    contacts.clear();
    let shape_from_world = world_from_shape.inverse();
    for group in near.groups() {
        let Some(d) = scene.deformation.get(group.cell as usize) else {
            continue;
        };
        let m = shape_from_cell(&shape_from_world, d);
        for p in near.points(group) {
            let position = at(&m, &p.weights);
            let wall = wall_normal(shape, &shape_from_world, &p.normal);
            let Some(sample) = shape.penetration(position, wall.as_ref()) else {
                continue;
            };
            if contacts.len() == contacts.capacity() {
                return;
            }
            contacts.push(Contact {
                cell: group.cell,
                place: p.place,
                id: p.id,
                area: p.area,
                depth: -sample.distance,
                gradient: sample.gradient,
                position,
                friction: [0.0; 3],
                anchor: position,
            });
        }
    }
}

/// `M = shape_from_world D`: takes shape functions straight to the shape's frame (paper eq. 9).
pub(super) fn shape_from_cell(shape_from_world: &Pose, d: &Matrix3x4<f32>) -> Matrix3x4<f32> {
    let mut m = Matrix3x4::zeros();
    for (to, from) in m.column_iter_mut().zip(d.column_iter()) {
        let p = from.map(f64::from);
        let q = shape_from_world.rotation * p + shape_from_world.translation.vector;
        { to }.copy_from(&q.map(|v| v as f32));
    }
    m
}

/// `M N` for one point, summed as [`transform`] does.
fn at(m: &Matrix3x4<f32>, weights: &[f32; 4]) -> [f32; 3] {
    let [a, b, c, d] = *weights;
    std::array::from_fn(|row| {
        let [ma, mb, mc, md] = [m[(row, 0)], m[(row, 1)], m[(row, 2)], m[(row, 3)]];
        (ma * a + mb * b) + (mc * c + md * d)
    })
}

/// A wall's normal in the frame of a shape that asks for it.
pub(super) fn wall_normal(
    shape: &RigidShape,
    shape_from_world: &Pose,
    normal: &[f32; 3],
) -> Option<[f32; 3]> {
    (shape.sided.is_some() && *normal != [0.0; 3]).then(|| {
        let turned = shape_from_world.rotation * Vec3::from(normal.map(f64::from));
        turned.map(|v| v as f32).into()
    })
}
