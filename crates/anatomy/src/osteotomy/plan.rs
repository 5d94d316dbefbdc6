//! Planning a line: points dragged over the surface, depths changed, the other side's made by reflection.
//!
//! A [`Plan`] may be wrong at any moment, so that one can go on from there; [`Plan::review`](super::Review) says what is, and
//! [`Plan::osteotomy`] gives a line only if nothing is that would be refused in a scenario.
use super::technique::{STEP, across, resample, smooth_normal};
use super::{LinePoint, Osteotomy, PartKind, PointSpec, Side, check_point};
use crate::error::AnatomyError;
use crate::landmarks::{JawFrame, cast};
use osteotome_mechanics::geometry::{MeshDistance, Vec3};

/// A point of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanPoint {
    /// Place on the surface, direction and depth.
    pub point: LinePoint,
    /// Which cut it belongs to.
    pub part: PartKind,
}

/// A line that is being planned.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Side of the patient.
    pub side: Side,
    /// Width of the saw cut \[mm\].
    pub kerf: f64,
    /// In order; those of one part follow each other.
    pub points: Vec<PlanPoint>,
}

/// Points within this arc length of a dragged one come with it, the less the farther \[mm\].
const FALLOFF: f64 = 8.0;
/// Depths that can be planned \[mm\].
pub const DEPTHS: [f64; 2] = [0.5, 20.0];
/// Depth of the slit where free points are given without one \[mm\].
pub const FREE_DEPTH: f64 = 4.0;

impl Plan {
    /// From a line.
    pub fn of(line: &Osteotomy) -> Self {
        let points = line.parts.iter().flat_map(|part| {
            part.points.iter().map(|point| PlanPoint {
                point: *point,
                part: part.kind.clone(),
            })
        });
        Self {
            side: line.side,
            kerf: line.kerf,
            points: points.collect(),
        }
    }

    /// Along free points, in one cut: every 1.5 mm a point snapped to the surface, straight into the bone.
    ///
    /// # Errors
    /// [`AnatomyError::Osteotomy`] for fewer than two points apart from each other, or a line that the surface has no way for.
    pub fn free(
        side: Side,
        kerf: f64,
        knots: &[Vec3],
        depth: f64,
        surface: &MeshDistance,
    ) -> Result<Self, AnatomyError> {
        let refuse = |reason: &str| AnatomyError::Osteotomy {
            reason: reason.to_owned(),
        };
        let apart = |p: &[Vec3]| (p[1] - p[0]).norm() > 1e-6;
        if knots.len() < 2 || !knots.windows(2).all(apart) {
            return Err(refuse(
                "free points are too few; a line needs two or more, apart from each other",
            ));
        }
        let places: Vec<Vec3> = resample(knots, STEP)
            .iter()
            .map(|p| snapped(p, surface))
            .collect();
        let last = places.len() - 1;
        let point = |i: usize| {
            let tangent = places[(i + 1).min(last)] - places[i.saturating_sub(1)];
            let inward = -smooth_normal(&places[i], surface);
            let toward = across(&inward, &tangent)?;
            let point = LinePoint {
                at: places[i],
                toward,
                depth,
            };
            Some(PlanPoint {
                point,
                part: PartKind::Other("free".to_owned()),
            })
        };
        let points: Option<Vec<_>> = (0..=last).map(point).collect();
        let points = points.ok_or_else(|| refuse("the free points lead nowhere on the surface"))?;
        Ok(Self { side, kerf, points })
    }

    /// The line, as a scenario would take it.
    ///
    /// # Errors
    /// As [`Osteotomy::from_points`].
    pub fn osteotomy(&self, surface: &MeshDistance) -> Result<Osteotomy, AnatomyError> {
        let spec = |p: &PlanPoint| PointSpec {
            at: p.point.at.into(),
            toward: p.point.toward.into(),
            depth: p.point.depth,
            part: p.part.name().to_owned(),
        };
        let specs: Vec<_> = self.points.iter().map(spec).collect();
        Osteotomy::from_points(self.side, self.kerf, &specs, surface)
    }

    /// Whether a scenario would take this point.
    pub(super) fn refusal(&self, i: usize, surface: &MeshDistance) -> Option<String> {
        let mut point = self.points[i].point;
        check_point(&mut point, surface).err()
    }

    /// Brings a point to a place, snapped to the surface, and its neighbours along, the less the farther they are along the
    /// line. Directions turn with the surface.
    pub fn drag(&mut self, index: usize, to: &Vec3, surface: &MeshDistance) {
        let Some(dragged) = self.points.get(index) else {
            return;
        };
        let shift = snapped(to, surface) - dragged.point.at;
        for (p, weight) in self.weights(index) {
            let p = &mut self.points[p].point;
            let before = smooth_normal(&p.at, surface);
            p.at = snapped(&(p.at + shift * weight), surface);
            p.toward = turned(&p.toward, &before, &smooth_normal(&p.at, surface));
        }
    }

    /// Gives the slit a depth at a point, and its neighbours so much more or less, the less the farther they are.
    pub fn set_depth(&mut self, index: usize, depth: f64) {
        let Some(chosen) = self.points.get(index) else {
            return;
        };
        let change = depth.clamp(DEPTHS[0], DEPTHS[1]) - chosen.point.depth;
        for (p, weight) in self.weights(index) {
            let depth = &mut self.points[p].point.depth;
            *depth = (*depth + change * weight).clamp(DEPTHS[0], DEPTHS[1]);
        }
    }

    /// Points that come with this one, and how much of its way they go: all of it at the point, smoothly none at `FALLOFF`.
    fn weights(&self, index: usize) -> Vec<(usize, f64)> {
        let mut weights = vec![(index, 1.0)];
        let mut walk = |indices: &mut dyn Iterator<Item = usize>| {
            let (mut arc, mut last) = (0.0, index);
            for i in indices {
                arc += (self.points[i].point.at - self.points[last].point.at).norm();
                last = i;
                if arc >= FALLOFF {
                    break;
                }
                weights.push((i, (1.0 - (arc / FALLOFF).powi(2)).powi(2)));
            }
        };
        walk(&mut (index + 1..self.points.len()));
        walk(&mut (0..index).rev());
        weights
    }

    /// For the other side: reflected in the plane half way between the condyles and snapped to the surface there. Also how far
    /// the farthest point was from it \[mm\]: much on a jaw that is not its own mirror image.
    pub fn mirrored(&self, frame: &JawFrame, surface: &MeshDistance) -> (Self, f64) {
        let [right, left] = frame.condyles;
        let middle = 0.5 * (right + left);
        let normal = (left - right).try_normalize(1e-9).unwrap_or(Vec3::x());
        let reflected = |v: &Vec3| v - normal * (2.0 * normal.dot(v));
        let mut farthest = 0.0f64;
        let mut point = |p: &PlanPoint| {
            let at = middle + reflected(&(p.point.at - middle));
            let on = snapped(&at, surface);
            farthest = farthest.max((on - at).norm());
            let was = reflected(&smooth_normal(&p.point.at, surface));
            let toward = turned(
                &reflected(&p.point.toward),
                &was,
                &smooth_normal(&on, surface),
            );
            PlanPoint {
                point: LinePoint {
                    at: on,
                    toward,
                    depth: p.point.depth,
                },
                part: p.part.clone(),
            }
        };
        let plan = Self {
            side: match self.side {
                Side::Right => Side::Left,
                Side::Left => Side::Right,
            },
            kerf: self.kerf,
            points: self.points.iter().map(&mut point).collect(),
        };
        (plan, farthest)
    }
}

/// Middle of the bone along a line of sight from outside: a click's place for a canal that is drawn. `None`: no bone is met.
pub fn middle_of_sight(surface: &MeshDistance, eye: &Vec3, sight: &Vec3) -> Option<Vec3> {
    let entry = cast(surface, eye, sight)?;
    let through = super::technique::thickness(surface, &entry, sight);
    (through > 0.0).then(|| entry + sight * (0.5 * through))
}

fn snapped(p: &Vec3, surface: &MeshDistance) -> Vec3 {
    surface.closest(p).map_or(*p, |c| c.point)
}

/// `v` by the shortest turn that brings one direction to another (Rodrigues); as it is where there is none.
fn turned(v: &Vec3, from: &Vec3, to: &Vec3) -> Vec3 {
    let (Some(a), Some(b)) = (from.try_normalize(1e-9), to.try_normalize(1e-9)) else {
        return *v;
    };
    let (axis, cos) = (a.cross(&b), a.dot(&b));
    if cos < -0.999 {
        return *v;
    }
    let turned = v + axis.cross(v) + axis.cross(&axis.cross(v)) / (1.0 + cos);
    turned.try_normalize(1e-9).unwrap_or(*v)
}

#[cfg(test)]
mod tests {
    use super::super::tests::mandible;
    use super::*;
    use crate::osteotomy::Technique;
    use crate::parametric::Parameters;

    fn hunsuck(parameters: Parameters) -> (MeshDistance, Plan, JawFrame) {
        let (surface, landmarks) = mandible(parameters);
        let line =
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, Side::Right, 0.8, &surface);
        let frame = JawFrame::find(surface.mesh(), "jaw").unwrap();
        (surface, Plan::of(&line.unwrap()), frame)
    }

    #[test]
    fn a_dragged_point_goes_there_neighbours_follow_and_the_rest_stays() {
        let (surface, plan, _) = hunsuck(Parameters::default());
        let ridge = |p: &PlanPoint| p.part == PartKind::Ridge;
        let index = plan.points.iter().position(ridge).unwrap() + 6;
        let mut changed = plan.clone();
        let wish = plan.points[index].point.at + Vec3::new(-2.0, 0.0, 1.0);
        changed.drag(index, &wish, &surface);
        let moved = |i: usize| (changed.points[i].point.at - plan.points[i].point.at).norm();
        assert!(moved(index) > 0.8, "{}", moved(index));
        assert!(moved(index + 1) < moved(index) && moved(index + 1) > 0.2);
        assert!(
            (0..plan.points.len())
                .filter(|i| i.abs_diff(index) > 8)
                .all(|i| moved(i) == 0.0)
        );
        for p in &changed.points {
            assert!(surface.unsigned(&p.point.at) < 1e-3);
            assert!((p.point.toward.norm() - 1.0).abs() < 1e-9);
        }
        changed.osteotomy(&surface).unwrap();
    }

    #[test]
    fn depth_changes_about_a_point_and_stays_possible() {
        let (_, mut plan, _) = hunsuck(Parameters::default());
        plan.set_depth(20, 6.0);
        assert_eq!(plan.points[20].point.depth, 6.0);
        let far: Vec<f64> = plan.points.iter().map(|p| p.point.depth).collect();
        plan.set_depth(20, -3.0);
        assert_eq!(plan.points[20].point.depth, DEPTHS[0]);
        assert_eq!(far[40], plan.points[40].point.depth);
        plan.set_depth(10_000, 3.0);
    }

    /// A mirrored jaw's line is the line's mirror image, whatever its place; twice mirrored it is the line again.
    #[test]
    fn the_other_side_is_the_mirror_image_where_the_jaw_is() {
        let (surface, plan, frame) = hunsuck(Parameters::default());
        let (left, farthest) = plan.mirrored(&frame, &surface);
        assert_eq!(left.side, Side::Left);
        assert!(farthest < 1.0, "{farthest}");
        left.osteotomy(&surface).unwrap();
        let (again, _) = left.mirrored(&frame, &surface);
        for (a, b) in plan.points.iter().zip(&again.points) {
            assert!((a.point.at - b.point.at).norm() < 1.0);
            assert!(a.point.toward.dot(&b.point.toward) > 0.9);
        }
        let crooked = Parameters {
            chin_deviation: 6.0,
            ..Parameters::default()
        };
        let (surface, plan, frame) = hunsuck(crooked);
        let (left, farthest) = plan.mirrored(&frame, &surface);
        assert!(farthest > 1.0, "a crooked jaw is not its mirror image");
        left.osteotomy(&surface).unwrap();
    }

    #[test]
    fn free_points_give_a_line_on_the_surface() {
        let (surface, plan, _) = hunsuck(Parameters::default());
        let buccal: Vec<Vec3> = (plan.points.iter())
            .filter(|p| p.part == PartKind::Buccal)
            .map(|p| p.point.at)
            .collect();
        let knots = [buccal[0], buccal[8], buccal[14]];
        let free = Plan::free(Side::Right, 0.8, &knots, FREE_DEPTH, &surface).unwrap();
        let length: f64 = knots.windows(2).map(|k| (k[1] - k[0]).norm()).sum();
        assert_eq!(free.points.len(), (length / STEP).round() as usize + 1);
        assert_eq!(free.osteotomy(&surface).unwrap().parts.len(), 1);
        let one = Plan::free(Side::Right, 0.8, &knots[..1], 4.0, &surface);
        assert!(one.unwrap_err().to_string().contains("two or more"));
    }

    #[test]
    fn a_look_at_the_bone_gives_its_middle() {
        let (surface, plan, _) = hunsuck(Parameters::default());
        let p = plan
            .points
            .iter()
            .find(|p| p.part == PartKind::Buccal)
            .unwrap();
        let (at, sight) = (p.point.at, Vec3::x());
        let eye = at - sight * 60.0 - Vec3::z() * 6.0;
        let middle = middle_of_sight(&surface, &eye, &sight).unwrap();
        assert!(surface.signed(&middle) < -1.0);
        assert!(middle_of_sight(&surface, &eye, &-sight).is_none());
    }
}
