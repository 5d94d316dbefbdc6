//! Tools touching what stands still around the jaw: maxilla, skull, retractors.
use super::hands::stride;
use crate::engine::Surrounding;
use crate::session::Recording;
use osteotome_mechanics::geometry::{DistanceGrid, Pose};
use osteotome_mechanics::tool::Chisel;
use serde::Serialize;

/// Contact of tools with one surface around the jaw.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContextFindings {
    /// What it is.
    pub role: String,
    /// How long \[s\]; `null` for an open surface, which tools cannot touch.
    pub seconds: Option<f64>,
    /// Since when \[s\].
    pub first_s: Option<f64>,
}

/// Looks at every surface. A blade touches one where a sample of its own surface lies within it: the rule by which the loops make forces.
pub fn context(
    surroundings: &[Surrounding],
    recording: &Recording,
    chisels: &[Chisel; 2],
) -> Vec<ContextFindings> {
    let shapes = chisels.each_ref().map(Chisel::shape);
    let touches = |field: &DistanceGrid, i: usize, pose: &Pose| {
        let shape = &shapes[i];
        let is_in = |p: nalgebra::Point3<f64>| {
            let found = field.look_up([p.x, p.y, p.z].map(|v| v as f32));
            found.is_some_and(|f| f.distance < 0.0)
        };
        shape.bounds.moved(pose).overlaps(field.bounds())
            && (shape.samples.iter()).any(|s| is_in(pose * nalgebra::Point3::from(s.position)))
    };
    let scenario = &recording.scenario.scenario;
    let (every, dt) = (2 * stride(scenario), scenario.loops.dt());
    let look = |s: &Surrounding| {
        let mut found = ContextFindings {
            role: s.role.clone(),
            seconds: None,
            first_s: None,
        };
        let Some(field) = &s.field else { return found };
        let mut seconds = 0.0;
        for k in (0..recording.hands[0].len()).step_by(every) {
            let pose = |i: usize| &recording.hands[i][k].tool_pose;
            if (0..2).any(|i| touches(field, i, pose(i))) {
                seconds += every as f64 * dt;
                found.first_s.get_or_insert(k as f64 * dt);
            }
        }
        found.seconds = Some(seconds);
        found
    };
    surroundings.iter().map(look).collect()
}

#[cfg(test)]
mod tests {
    use super::super::hands::tests::recording;
    use super::*;
    use osteotome_mechanics::geometry::{Aabb, TriMesh, Vec3};
    use osteotome_mechanics::tool::ChiselParameters;
    use std::sync::Arc;

    /// A half space below z = 0, and a blade that goes down to it at 10 mm/s from 5 mm above, and out again after a second.
    #[test]
    fn a_blade_touches_from_where_its_edge_comes_in_to_where_it_goes_out() {
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
        let recording = recording(2.0, |t| {
            let z = if t < 1.0 {
                5.0 - 10.0 * t
            } else {
                -5.0 + 10.0 * (t - 1.0)
            };
            (
                Pose::from_parts(Vec3::new(0.0, 0.0, z).into(), down),
                0.0,
                0.0,
                false,
            )
        });
        let bounds = Aabb {
            min: Vec3::new(-40.0, -40.0, -20.0),
            max: Vec3::new(40.0, 40.0, 20.0),
        };
        let field = DistanceGrid::sample(bounds, [1.0; 3], |p| p.z).unwrap();
        let chisel = || {
            Chisel::new(ChiselParameters {
                width: 10.0,
                thickness: 3.0,
                bevel_deg: 20.0,
                length: 60.0,
            })
            .unwrap()
        };
        let surface = |role: &str, field| Surrounding {
            role: role.into(),
            mesh: TriMesh::default(),
            field,
        };
        let around = [
            surface("maxilla", Some(Arc::new(field))),
            surface("skull", None),
        ];
        let found = context(&around, &recording, &[chisel(), chisel()]);
        let seconds = found[0].seconds.unwrap();
        // In at .5 s, out at 1.5 s; samples of the blade begin within a millimetre of its edge.
        assert!((0.8..=1.02).contains(&seconds), "{seconds}");
        assert!(
            (0.5..0.62).contains(&found[0].first_s.unwrap()),
            "{found:?}"
        );
        assert_eq!((found[1].seconds, found[1].role.as_str()), (None, "skull"));
    }
}
