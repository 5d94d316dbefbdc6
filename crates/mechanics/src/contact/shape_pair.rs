use super::{ContactLaw, RigidShape, SurfaceSample, Vector6, Wrench};
use crate::geometry::{DistanceGrid, DistanceSample, Pose, Vec3};
use std::sync::Arc;

type Vector12 = nalgebra::SVector<f64, 12>;
type Matrix12 = nalgebra::SMatrix<f64, 12, 12>;

/// What two rigid shapes do to each other.
#[derive(Clone, Copy, Debug)]
pub struct PairResponse {
    /// On each shape, about its own origin, in world axes.
    pub wrenches: [Wrench; 2],
    /// `sum 1/2 k A d^2` over the samples in touch \[N mm\].
    pub energy: f64,
    /// Minus the derivative of both wrenches by both motions: symmetric, not negative.
    pub stiffness: Matrix12,
    /// How many samples of the shapes touch the other shape.
    pub n_contacts: usize,
    /// How many samples of each shape touch what stands still.
    pub n_static: [usize; 2],
}

impl PairResponse {
    /// Nothing touches.
    pub const NONE: Self = Self {
        wrenches: [Wrench::ZERO; 2],
        energy: 0.0,
        stiffness: Matrix12::from_array_storage(nalgebra::ArrayStorage([[0.0; 12]; 12])),
        n_contacts: 0,
        n_static: [0; 2],
    };

    /// A sample of shape `t` at `lever` from its origin inside something that stands still.
    fn push_back(&mut self, t: usize, lever: &Vec3, found: &DistanceSample, stiffness: f64) {
        let out = Vec3::from(found.gradient.map(f64::from));
        let depth = -f64::from(found.distance);
        let moment = lever.cross(&out);
        let mut j = Vector12::zeros();
        j.fixed_rows_mut::<3>(6 * t).copy_from(&out);
        j.fixed_rows_mut::<3>(6 * t + 3).copy_from(&moment);
        let own: Vector6 = j.fixed_rows::<6>(6 * t) * (stiffness * depth);
        self.wrenches[t] = self.wrenches[t] + Wrench::from_vector(&own);
        self.energy += 0.5 * stiffness * depth * depth;
        self.stiffness.ger(stiffness, &j, &j, 1.0);
        self.n_static[t] += 1;
    }

    /// Whether anything touches.
    pub fn touches(&self) -> bool {
        self.n_contacts > 0 || self.n_static != [0; 2]
    }
}

/// Penalty between two shapes without friction: samples of each against the distance field of the other, half the
/// stiffness each way.
pub fn respond_pair(
    shapes: [&RigidShape; 2],
    world_from_shape: &[Pose; 2],
    law: &ContactLaw,
) -> PairResponse {
    let mut response = PairResponse::NONE;
    if apart(shapes, world_from_shape) || apart_swapped(shapes, world_from_shape) {
        return response;
    }
    for (field, sampled) in [(0, 1), (1, 0)] {
        let field_from_sampled = world_from_shape[field].inv_mul(&world_from_shape[sampled]);
        for sample in &shapes[sampled].samples {
            let touch = Touch::find(shapes[field], &field_from_sampled, sample, law);
            if let Some(touch) = touch {
                touch.add_to(&mut response, world_from_shape, field, sampled);
            }
        }
    }
    response
}

/// Adds the penalty between the shapes and what stands still around the bone: their samples against distance fields in world axes.
pub fn add_static(
    response: &mut PairResponse,
    shapes: [&RigidShape; 2],
    world_from_shape: &[Pose; 2],
    surroundings: &[Arc<DistanceGrid>],
    law: &ContactLaw,
) {
    for (t, shape) in shapes.into_iter().enumerate() {
        let pose = &world_from_shape[t];
        let around = shape.bounds.moved(pose);
        for field in surroundings.iter().filter(|f| around.overlaps(f.bounds())) {
            for sample in &shape.samples {
                let position = (pose * nalgebra::Point3::from(sample.position)).coords;
                let Some(found) = field.look_up([0, 1, 2].map(|k| position[k] as f32)) else {
                    continue;
                };
                if found.distance < 0.0 {
                    let lever = position - pose.translation.vector;
                    let stiffness = law.stiffness() * sample.area;
                    response.push_back(t, &lever, &found, stiffness);
                }
            }
        }
    }
}

/// Whether the box of the second shape misses that of the first, in the first's frame.
fn apart(shapes: [&RigidShape; 2], world_from_shape: &[Pose; 2]) -> bool {
    let first_from_second = world_from_shape[0].inv_mul(&world_from_shape[1]);
    let moved = shapes[1].bounds.moved(&first_from_second);
    !moved.overlaps(&shapes[0].bounds)
}

fn apart_swapped(shapes: [&RigidShape; 2], p: &[Pose; 2]) -> bool {
    apart([shapes[1], shapes[0]], &[p[1], p[0]])
}

/// A sample inside the other shape; everything in the field's frame.
struct Touch {
    position: Vec3,
    gradient: Vec3,
    stiffness: f64,
    depth: f64,
}

impl Touch {
    fn find(
        field: &RigidShape,
        field_from_sampled: &Pose,
        sample: &SurfaceSample,
        law: &ContactLaw,
    ) -> Option<Self> {
        let position = (field_from_sampled * nalgebra::Point3::from(sample.position)).coords;
        let found = field.field.look_up([0, 1, 2].map(|k| position[k] as f32))?;
        (found.distance < 0.0).then(|| Self {
            position,
            gradient: Vec3::from(found.gradient.map(f64::from)),
            stiffness: 0.5 * law.stiffness() * sample.area,
            depth: -f64::from(found.distance),
        })
    }

    fn add_to(&self, sum: &mut PairResponse, poses: &[Pose; 2], field: usize, sampled: usize) {
        let world = (poses[field] * nalgebra::Point3::from(self.position)).coords;
        let g = poses[field].rotation * self.gradient;
        // Motion that deepens the touch: the field's own along g, the sampled shape's against it.
        let mut j = Vector12::zeros();
        for (shape, direction) in [(field, g), (sampled, -g)] {
            let lever = world - poses[shape].translation.vector;
            let moment = lever.cross(&direction);
            j.fixed_rows_mut::<3>(6 * shape).copy_from(&direction);
            j.fixed_rows_mut::<3>(6 * shape + 3).copy_from(&moment);
        }
        let push = self.stiffness * self.depth;
        for shape in 0..2 {
            let part: Vector6 = j.fixed_rows::<6>(6 * shape) * -push;
            sum.wrenches[shape] = sum.wrenches[shape] + Wrench::from_vector(&part);
        }
        sum.energy += 0.5 * push * self.depth;
        sum.stiffness.ger(self.stiffness, &j, &j, 1.0);
        sum.n_contacts += 1;
    }
}
