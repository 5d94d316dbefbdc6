//! What a coach would say during a session: loads against the scenario's targets, how near the canal is, where the plan lies.
//!
//! Only hints: nothing here goes into the score, and in an exam none is shown.
use super::conductor::Ready;
use super::live::Live;
use crate::debrief::{CrackTriangle, Plane, dense, nearest_crack, reach};
use crate::picture::tet_at;
use crate::scenario::Target;
use crate::session::{BoneSample, GrowthSample};
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::tool::Chisel;
use std::sync::Arc;

/// How a figure stands to its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All points.
    Good,
    /// Some.
    Fair,
    /// None.
    Bad,
}

impl Verdict {
    fn of(target: &Target, value: f64) -> Self {
        match target.share(value) {
            s if s >= 1.0 => Self::Good,
            s if s > 0.0 => Self::Fair,
            _ => Self::Bad,
        }
    }
}

/// A figure, its target and how it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hint {
    /// Now.
    pub value: f64,
    /// Where all points are to be had.
    pub good: f64,
    /// How it stands.
    pub verdict: Verdict,
}

impl Hint {
    fn of(target: &Target, value: f64) -> Self {
        Self {
            value,
            good: target.good,
            verdict: Verdict::of(target, value),
        }
    }
}

/// What is to be said now.
#[derive(Clone, Debug, PartialEq)]
pub struct Hints {
    /// Force and torque of each hand on the bone \[N, N mm\].
    pub loads: [[Hint; 2]; 2],
    /// Each blade to the canal's wall \[mm\]; nothing where the canal is not known.
    pub tools: [Option<Hint>; 2],
    /// The broken face to the canal's wall \[mm\].
    pub crack: Option<Hint>,
}

/// See the module.
pub struct Coach {
    ready: Arc<Ready>,
    chisels: Option<[Chisel; 2]>,
    canal: Option<CanalLine>,
    /// Generation of the crack whose distance is known, and that distance.
    crack: Option<(u64, Option<f64>)>,
    plan: Vec<Vec3>,
}

/// The canal's line, held by the tetrahedra of the bone that it runs through.
struct CanalLine {
    rest: Vec<Vec3>,
    held_by: Vec<(u32, [f64; 4])>,
    radius: f64,
}

impl CanalLine {
    /// Where it is as the bone is deformed: by the nodes' displacements, without the jumps across the crack.
    fn moved(&self, ready: &Ready, bone: Option<&BoneSample>) -> Vec<Vec3> {
        let Some(bone) = bone else {
            return self.rest.clone();
        };
        let body = &ready.prepared.bone.cracked;
        let x: Vec<f64> = bone.x_um.iter().map(|v| f64::from(*v) * 1e-3).collect();
        if x.len() < body.system.n() {
            return self.rest.clone();
        }
        let tets = body.solid.mesh.tets();
        let moved = |(p, (tet, weights)): (&Vec3, &(u32, [f64; 4]))| {
            let nodes = tets[*tet as usize].iter().zip(weights);
            let way: Vec3 = nodes
                .map(|(n, w)| body.system.displacement(*n as usize, &x) * *w)
                .sum();
            p + way
        };
        self.rest.iter().zip(&self.held_by).map(moved).collect()
    }
}

impl Coach {
    /// For a patient.
    pub fn new(ready: &Arc<Ready>) -> Self {
        let patient = &ready.prepared.patient;
        let body = &ready.prepared.bone.cracked;
        let side = patient.osteotomy.side;
        let canal = patient.canals.iter().find(|c| c.side == side);
        let canal = canal.map(|c| {
            let rest = dense(&c.line);
            CanalLine {
                held_by: rest.iter().map(|p| tet_at(body, p)).collect(),
                radius: c.radius,
                rest,
            }
        });
        Self {
            // A shape that mechanics refuses does not get as far as this.
            chisels: crate::debrief::Findings::chisels(&ready.scenario).ok(),
            canal,
            crack: None,
            plan: plan(ready),
            ready: ready.clone(),
        }
    }

    /// Whether it is for this patient.
    pub fn is_for(&self, ready: &Arc<Ready>) -> bool {
        Arc::ptr_eq(&self.ready, ready)
    }

    /// The planned plane where it crosses the bone: corners of a rectangle \[mm\].
    pub fn plan(&self) -> &[Vec3] {
        &self.plan
    }

    /// What is to be said of a session as it stands.
    pub fn hints(&mut self, live: &Live) -> Hints {
        let targets = self.ready.scenario.targets.clone();
        let load = |i: usize| {
            let [force, torque] = live.loads[i];
            [
                Hint::of(&targets.peak_force, force),
                Hint::of(&targets.peak_torque, torque),
            ]
        };
        let canal = self.canal.as_ref();
        let line = canal.map(|c| (c.moved(&self.ready, live.bone.as_deref()), c.radius));
        let tool = |i: usize| {
            let ((line, radius), chisels) = (line.as_ref()?, self.chisels.as_ref()?);
            let distance = reach(&chisels[i], &live.hands?.hands[i].tool_pose, line) - radius;
            Some(Hint::of(&targets.nerve_distance, distance))
        };
        let hints = Hints {
            loads: [load(0), load(1)],
            tools: [tool(0), tool(1)],
            crack: None,
        };
        let crack = live.growth.last().and_then(|g| self.crack_distance(g));
        Hints {
            crack: crack.map(|d| Hint::of(&targets.nerve_distance, d)),
            ..hints
        }
    }

    /// Of the broken face, looked at once a growth, undeformed as in the debrief.
    fn crack_distance(&mut self, growth: &GrowthSample) -> Option<f64> {
        if let Some((generation, distance)) = self.crack
            && generation == growth.generation
        {
            return distance;
        }
        let canal = self.canal.as_ref()?;
        let region = &*self.ready.prepared.bone.body.region.0;
        let distance = nearest_crack(&canal.rest, &broken(growth, region), canal.radius);
        let distance = distance.map(|at| at.value);
        self.crack = Some((growth.generation, distance));
        distance
    }
}

fn broken(
    growth: &GrowthSample,
    region: &dyn osteotome_mechanics::geometry::SignedDistance,
) -> Vec<CrackTriangle> {
    let triangle = |t: &[u32; 3]| {
        let is_sawn = (t.iter()).all(|v| growth.kerf.get(*v as usize).is_some_and(|k| *k > 0.0));
        let corner = |k: usize| growth.vertices.get(t[k] as usize).map(|p| Vec3::from(*p));
        let triangle = CrackTriangle {
            corners: [corner(0)?, corner(1)?, corner(2)?],
            born: growth.time,
        };
        (!is_sawn && triangle.is_in(region)).then_some(triangle)
    };
    growth.triangles.iter().filter_map(triangle).collect()
}

/// How far the shown plane reaches beyond the saw's line \[mm\].
const BEYOND: f64 = 6.0;

/// Around what the saw's line covers on its plane.
fn plan(ready: &Ready) -> Vec<Vec3> {
    let osteotomy = &ready.prepared.patient.osteotomy;
    let plane = Plane::planned(osteotomy);
    let points = osteotomy.parts.iter().flat_map(|p| &p.points);
    let points: Vec<Vec3> = points
        .flat_map(|p| [p.at, p.at + p.toward * p.depth])
        .collect();
    let u = Vec3::z() - plane.normal * plane.normal.z;
    let Some(u) = u.try_normalize(1e-6) else {
        return Vec::new();
    };
    let v = plane.normal.cross(&u);
    let range = |axis: &Vec3| {
        let along = points.iter().map(|p| axis.dot(&(p - plane.centre)));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), s| {
            (a.min(s), b.max(s))
        });
        [low - BEYOND, high + BEYOND]
    };
    let ([a, b], [c, d]) = (range(&u), range(&v));
    let corner = |s: f64, t: f64| plane.centre + u * s + v * t;
    vec![corner(a, c), corner(b, c), corner(b, d), corner(a, d)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::prepare;
    use crate::input::Input;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::session::HapticSample;
    use crate::session::tests::hand;
    use osteotome_mechanics::geometry::Pose;

    fn ready() -> Arc<Ready> {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let sets = ["mesh.nodes=200", "mesh.shell_points=4000"].map(|s| s.parse().unwrap());
        let scenario = load(&source, &sets, std::path::Path::new("/")).unwrap();
        let prepared = prepare(&scenario, &mut |_, _| {}).unwrap();
        let start = Input::built_in(&scenario, prepared.line.clone())
            .unwrap()
            .read();
        Arc::new(Ready {
            scenario,
            prepared,
            start: start.map(|r| r.pose),
        })
    }

    #[test]
    fn hints_stand_as_the_targets_say() {
        let ready = ready();
        let mut coach = Coach::new(&ready);
        let canal = coach.canal.as_ref().unwrap();
        let middle = canal.rest[canal.rest.len() / 2];
        let radius = canal.radius;
        // Edge down, above and outside the jaw: 30 mm over the canal.
        let pose = |height: f64| {
            let down =
                nalgebra::UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
            Pose::from_parts((middle + Vec3::z() * height).into(), down)
        };
        let mut hands = [hand(0.0), hand(0.0)];
        (hands[0].tool_pose, hands[1].tool_pose) = (pose(30.0), pose(radius));
        let mut live = Live {
            loads: [[100.0, 1000.0], [300.0, 1e6]],
            hands: Some(HapticSample {
                step: 0,
                time: 0.0,
                hands,
            }),
            ..Live::default()
        };
        let hints = coach.hints(&live);
        let verdicts = hints.loads.map(|h| h.map(|h| h.verdict));
        assert_eq!(verdicts[0], [Verdict::Good, Verdict::Good]);
        assert_eq!(verdicts[1], [Verdict::Fair, Verdict::Bad]);
        let far = hints.tools[0].unwrap();
        // The canal rises behind, so that its nearest point is not the one straight below.
        assert!((10.0..30.0 - radius + 0.1).contains(&far.value), "{far:?}");
        assert_eq!(far.verdict, Verdict::Good);
        let near = hints.tools[1].unwrap();
        assert!(
            near.value < 0.5 && near.verdict != Verdict::Good,
            "{near:?}"
        );
        // The whole jaw goes 5 mm up: it is the same once the blade does so too, and nearer before.
        let n = ready.prepared.bone.cracked.system.n();
        let x_um = (0..n).map(|k| if k % 3 == 2 { 5000 } else { 0 }).collect();
        live.bone = Some(Arc::new(BoneSample {
            time: 0.0,
            generation: 0,
            x_um,
        }));
        let moved = coach.hints(&live).tools[0].unwrap();
        assert!(moved.value < far.value - 1.0, "{moved:?}");
        hands[0].tool_pose = pose(35.0);
        live.hands = live.hands.map(|h| HapticSample { hands, ..h });
        let both = coach.hints(&live).tools[0].unwrap();
        assert!((both.value - far.value).abs() < 0.01, "{both:?} {far:?}");
        assert_eq!(hints.crack, None, "nothing broke");
    }

    #[test]
    fn the_plan_lies_in_its_plane_around_the_line() {
        let ready = ready();
        let coach = Coach::new(&ready);
        let plane = Plane::planned(&ready.prepared.patient.osteotomy);
        assert_eq!(coach.plan().len(), 4);
        assert!(coach.plan().iter().all(|p| plane.off(p).abs() < 1e-9));
        let sides = [0, 1].map(|k| (coach.plan()[k + 1] - coach.plan()[k]).norm());
        assert!(sides.iter().all(|s| (20.0..120.0).contains(s)), "{sides:?}");
    }
}
