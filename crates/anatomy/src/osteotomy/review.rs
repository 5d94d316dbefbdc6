//! What can be said of a planned line before anybody saws.
use super::plan::Plan;
use super::technique::{smooth_normal, thickness};
use super::{PartKind, Side, middle_of};
use crate::canal::Canal;
use osteotome_mechanics::geometry::{MeshDistance, Vec3};

/// What a line is held against.
#[derive(Clone, Copy)]
pub struct Situation<'a> {
    /// The bone's surface.
    pub surface: &'a MeshDistance,
    /// The canals that are known.
    pub canals: &'a [Canal],
    /// Thickness of the dense layer under a place of the surface \[mm\].
    pub cortical_thickness: &'a dyn Fn(&Vec3) -> f64,
}

/// Figures of one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointFigures {
    /// Depth of the slit \[mm\].
    pub depth: f64,
    /// Thickness of the bone in its direction \[mm\].
    pub thickness: f64,
    /// Thickness of the dense layer that the saw enters \[mm\].
    pub cortex: f64,
    /// From the slit, with half its width, to the wall of the canal on its side; negative: it is cut open \[mm\].
    pub canal: Option<f64>,
}

/// What was found about a line.
#[derive(Clone, Debug, PartialEq)]
pub struct Review {
    /// For each point.
    pub points: Vec<PointFigures>,
    /// What must be changed.
    pub faults: Vec<String>,
    /// What is to be known.
    pub remarks: Vec<String>,
    /// Whether the canal was placed by mean distances, not seen; `None` if none is known on this side.
    pub canal_is_constructed: Option<bool>,
}

impl Review {
    /// Least distance to the canal's wall \[mm\].
    pub fn canal(&self) -> Option<f64> {
        self.points
            .iter()
            .filter_map(|p| p.canal)
            .min_by(f64::total_cmp)
    }
}

/// Nearer to the canal than this deserves a word \[mm\].
const NEAR_CANAL: f64 = 1.0;
/// Cuts that meet are no farther apart than this at their ends \[mm\].
const MEETING: f64 = 5.0;

impl Plan {
    /// Looks at all of it.
    pub fn review(&self, situation: &Situation) -> Review {
        let canal = situation.canals.iter().find(|c| c.side == self.side);
        let points: Vec<_> = (0..self.points.len())
            .map(|i| self.figures(i, situation, canal))
            .collect();
        let mut review = Review {
            points,
            faults: Vec::new(),
            remarks: Vec::new(),
            canal_is_constructed: canal.map(|c| c.is_constructed),
        };
        self.reach(situation.surface, &mut review);
        self.meet(&mut review);
        self.depths(&mut review);
        self.clear_canal(&mut review);
        self.round_border(situation.surface, &mut review);
        review
    }

    fn figures(&self, i: usize, s: &Situation, canal: Option<&Canal>) -> PointFigures {
        let p = &self.points[i].point;
        let tip = p.at + p.toward * p.depth;
        PointFigures {
            depth: p.depth,
            thickness: thickness(s.surface, &p.at, &p.toward),
            cortex: (s.cortical_thickness)(&p.at),
            canal: canal.map(|c| {
                let pieces = c.line.windows(2);
                let nearest = pieces.map(|w| between_segments([p.at, tip], [w[0], w[1]]));
                nearest.fold(f64::INFINITY, f64::min) - c.radius - 0.5 * self.kerf
            }),
        }
    }

    /// Each point must reach the bone, or a scenario would refuse it.
    fn reach(&self, surface: &MeshDistance, review: &mut Review) {
        let refused = |i: usize| {
            let reason = self.refusal(i, surface)?;
            Some(format!("point {i} ({}) {reason}", self.name(i)))
        };
        review
            .faults
            .extend((0..self.points.len()).find_map(refused));
        let middle = middle_of(surface);
        let wrong = |x: f64| (x - middle) * self.side.sign() < 0.0;
        if !self.points.is_empty() && self.points.iter().all(|p| wrong(p.point.at.x)) {
            let side = match self.side {
                Side::Right => "right",
                Side::Left => "left",
            };
            review.faults.push(format!(
                "all of the line is on the other side than the {side} one (x = patient left)"
            ));
        }
    }

    fn name(&self, i: usize) -> &str {
        self.points[i].part.name()
    }

    /// Neighbouring cuts must join into one line.
    fn meet(&self, review: &mut Review) {
        for i in 1..self.points.len() {
            let [a, b] = [&self.points[i - 1], &self.points[i]];
            let gap = (b.point.at - a.point.at).norm();
            if a.part != b.part && gap > MEETING {
                review.faults.push(format!(
                    "{} and {} do not meet: {gap:.1} mm between their ends, at most {MEETING} mm is bridged",
                    a.part.name(),
                    b.part.name()
                ));
            }
        }
    }

    /// The saw must pass the cortex and stay within the bone.
    fn depths(&self, review: &mut Review) {
        for part in self.parts() {
            let of_part =
                || (0..self.points.len()).filter(|i| self.points[*i].part.name() == part.name());
            let out = |i: &usize| {
                let p = &review.points[*i];
                p.depth - p.thickness
            };
            let through: Vec<usize> = of_part().filter(|i| out(i) > 0.0).collect();
            let shallow: Vec<f64> = of_part()
                .map(|i| review.points[i])
                .filter(|p| p.depth < p.cortex)
                .map(|p| p.cortex)
                .collect();
            let n = of_part().count();
            if let Some(worst) = through.iter().max_by(|a, b| out(a).total_cmp(&out(b))) {
                let p = review.points[*worst];
                let text = format!(
                    "{}: at {} of {n} points the saw comes out of the bone again; at point {worst} by {:.1} mm ({:.1} mm deep, the bone is {:.1} mm thick)",
                    part.name(),
                    through.len(),
                    p.depth - p.thickness,
                    p.depth,
                    p.thickness
                );
                review.faults.push(text);
            }
            if !shallow.is_empty() {
                let least = shallow.iter().copied().fold(f64::INFINITY, f64::min);
                let most = shallow.iter().copied().fold(0.0, f64::max);
                let cortex = if most - least < 0.05 {
                    format!("{most:.1}")
                } else {
                    format!("{least:.1} to {most:.1}")
                };
                review.remarks.push(format!(
                    "{}: at {} of {n} points the saw does not pass the cortex ({cortex} mm)",
                    part.name(),
                    shallow.len()
                ));
            }
        }
    }

    fn clear_canal(&self, review: &mut Review) {
        let nearest = (0..self.points.len())
            .filter_map(|i| Some((i, review.points[i].canal?)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((i, distance)) = nearest else {
            review
                .remarks
                .push("no canal is known on this side, so none is looked out for".to_owned());
            return;
        };
        let kind = match review.canal_is_constructed {
            Some(true) => "canal (constructed, not measured)",
            _ => "canal",
        };
        let part = self.name(i);
        if distance < 0.0 {
            review.faults.push(format!(
                "{part}: the saw cuts into the {kind} at point {i}, by {:.1} mm",
                -distance
            ));
        } else if distance < NEAR_CANAL {
            review.remarks.push(format!(
                "{part}: the saw passes the {kind} at point {i} at {distance:.1} mm"
            ));
        }
    }

    /// A buccal cut that ends on the cheek's side leaves the border's cortex to the chisels.
    fn round_border(&self, surface: &MeshDistance, review: &mut Review) {
        let of_buccal = |p: &&super::PlanPoint| p.part == PartKind::Buccal;
        let Some(last) = self.points.iter().rfind(of_buccal) else {
            return;
        };
        let outward = smooth_normal(&last.point.at, surface);
        let cheek = outward.x * self.side.sign() / outward.norm().max(1e-9);
        if cheek > 0.8 {
            review.remarks.push(
                "buccal: the cut ends on the cheek's side, not around the border, which is left to the chisels"
                    .to_owned(),
            );
        }
    }

    fn parts(&self) -> Vec<PartKind> {
        let mut parts: Vec<PartKind> = Vec::new();
        for p in &self.points {
            if parts.last() != Some(&p.part) {
                parts.push(p.part.clone());
            }
        }
        parts
    }
}

/// Least distance between two segments (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
fn between_segments([a, b]: [Vec3; 2], [c, d]: [Vec3; 2]) -> f64 {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, vv, uv) = (u.norm_squared(), v.norm_squared(), u.dot(&v));
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    let share = |n: f64, d: f64| {
        if d > 1e-12 {
            (n / d).clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    let s = share(uv * vw - uw * vv, uu * vv - uv * uv);
    let t = share(uv * s + vw, vv);
    let s = share(uv * t - uw, uu);
    (w + u * s - v * t).norm()
}

#[cfg(test)]
mod tests {
    use super::super::tests::mandible;
    use super::*;
    use crate::osteotomy::{Osteotomy, Technique};
    use crate::parametric::{Parameters, ParametricMandible};

    #[test]
    fn segments_are_as_far_apart_as_their_samples() {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        for _ in 0..200 {
            let mut p = || Vec3::new(next(), next(), next());
            let (a, b, c, d) = (p(), p(), p(), p());
            let mut least = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 {
                    let q = a.lerp(&b, f64::from(i) / 60.0) - c.lerp(&d, f64::from(j) / 60.0);
                    least = least.min(q.norm());
                }
            }
            let found = between_segments([a, b], [c, d]);
            assert!(
                found <= least + 1e-12 && found > least - 0.03,
                "{found} {least}"
            );
        }
    }

    /// All techniques on all jaws: the line stands, clear of the canal; then each fault is made and told.
    #[test]
    fn techniques_pass_and_each_fault_is_told() {
        for parameters in [
            Parameters::default(),
            Parameters {
                scale: 0.8,
                ..Parameters::default()
            },
            Parameters {
                gonial_angle: 136.0,
                ..Parameters::default()
            },
            Parameters {
                ramus_thickness: 6.0,
                ..Parameters::default()
            },
        ] {
            let (surface, landmarks) = mandible(parameters);
            let canals = ParametricMandible::new(parameters).unwrap().canals();
            let situation = Situation {
                surface: &surface,
                canals: &canals,
                cortical_thickness: &|_| 2.2,
            };
            for technique in Technique::ALL {
                for side in [Side::Right, Side::Left] {
                    let line = Osteotomy::by_technique(technique, &landmarks, side, 0.8, &surface)
                        .unwrap_or_else(|e| panic!("{technique:?} {side:?} {parameters:?}: {e}"));
                    let review = Plan::of(&line).review(&situation);
                    assert_eq!(
                        review.faults,
                        Vec::<String>::new(),
                        "{technique:?} {side:?} {parameters:?}"
                    );
                    assert_eq!(review.canal_is_constructed, Some(true));
                }
            }
        }
    }

    /// A scan's frame has its origin anywhere.
    #[test]
    fn sides_are_told_from_the_jaws_middle() {
        let (surface, landmarks) = mandible(Parameters::default());
        let shift = Vec3::new(170.0, -20.0, 900.0);
        let mut mesh = surface.mesh().clone();
        mesh.vertices.iter_mut().for_each(|p| *p += shift);
        let mut marks = landmarks.to_file();
        marks.menton = (Vec3::from(marks.menton) + shift).into();
        for s in [&mut marks.right, &mut marks.left] {
            let single = [
                &mut s.condyle_centre,
                &mut s.condyle_top,
                &mut s.coronoid_tip,
                &mut s.sigmoid_notch,
                &mut s.gonion,
                &mut s.lingula,
                &mut s.second_molar_buccal,
                &mut s.lower_border,
            ];
            for p in single.into_iter().chain(&mut s.external_oblique_ridge) {
                *p = (Vec3::from(*p) + shift).into();
            }
        }
        let bytes = serde_json::to_vec(&marks).unwrap();
        let landmarks = crate::landmarks::parse_landmarks(&bytes, "marks").unwrap();
        let surface = MeshDistance::new(mesh);
        let situation = Situation {
            surface: &surface,
            canals: &[],
            cortical_thickness: &|_| 2.2,
        };
        for side in [Side::Right, Side::Left] {
            let line = Osteotomy::by_technique(Technique::Hunsuck, &landmarks, side, 0.8, &surface);
            let mut plan = Plan::of(&line.unwrap());
            assert_eq!(plan.review(&situation).faults, Vec::<String>::new());
            plan.side = match side {
                Side::Right => Side::Left,
                Side::Left => Side::Right,
            };
            let text = plan.review(&situation).faults.join("; ");
            assert!(text.contains("on the other side than the"), "{text}");
            let error = plan.osteotomy(&surface).unwrap_err().to_string();
            assert!(
                error.contains("other side of the jaw's middle at x = 170"),
                "{error}"
            );
        }
    }

    #[test]
    fn each_fault_is_told() {
        let (surface, landmarks) = mandible(Parameters::default());
        let canals = ParametricMandible::new(Parameters::default())
            .unwrap()
            .canals();
        let situation = Situation {
            surface: &surface,
            canals: &canals,
            cortical_thickness: &|_| 2.2,
        };
        let line =
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, Side::Right, 0.8, &surface);
        let good = Plan::of(&line.unwrap());
        let told = |change: &dyn Fn(&mut Plan)| {
            let mut plan = good.clone();
            change(&mut plan);
            let review = plan.review(&situation);
            review.faults.join("; ") + " | " + &review.remarks.join("; ")
        };
        let n_medial = good
            .points
            .iter()
            .filter(|p| p.part == PartKind::Medial)
            .count();
        let text = told(&|p| p.points[2].point.depth = 15.0);
        assert!(
            text.contains("medial: at 1 of") && text.contains("comes out of the bone"),
            "{text}"
        );
        let text = told(&|p| p.points[n_medial + 3].point.at.y -= 9.0);
        assert!(text.contains("mm outside the bone"), "{text}");
        let text = told(&|p| {
            p.points.drain(n_medial..n_medial + 8);
        });
        assert!(text.contains("medial and ridge do not meet"), "{text}");
        let text = told(&|p| p.points[n_medial].point.depth = 1.0);
        assert!(text.contains("does not pass the cortex (2.2 mm)"), "{text}");
        let text = told(&|p| {
            let n = p.points.len();
            p.points.truncate(n - 8);
        });
        assert!(text.contains("not around the border"), "{text}");
        let text = told(&|p| {
            let buccal = |p: &&mut super::super::PlanPoint| p.part == PartKind::Buccal;
            for p in p.points.iter_mut().filter(buccal) {
                p.point.depth = 9.0;
            }
        });
        assert!(
            text.contains("cuts into the canal (constructed, not measured)"),
            "{text}"
        );
        // By region: the ramus' inner plate thinner than the medial cut is deep, the ridge thicker than its own.
        let by_region = Situation {
            cortical_thickness: &|p| {
                if p.y > landmarks.right.lingula.y {
                    0.5
                } else {
                    9.0
                }
            },
            ..situation
        };
        let text = good.review(&by_region).remarks.join("; ");
        assert!(
            text.contains("ridge: at ") && text.contains("the cortex (9.0 mm)"),
            "{text}"
        );
        assert!(
            !text.contains(&format!("medial: at {n_medial} of")),
            "{text}"
        );
        let text = told(&|p| p.side = Side::Left);
        assert!(
            text.contains("on the other side than the left one"),
            "{text}"
        );
    }
}
