//! Everything that a recording says about a session.
use super::bad_split::Region;
use super::bad_split::{BadSplit, classify, home, layout, regions};
use super::context::{ContextFindings, context};
use super::course::{Course, place};
use super::hands::{self, HandFindings, Phases, stride};
use super::nerve::{NerveFindings, nerve, reach};
use super::path::{CrackTriangle, PathFindings, Plane, deviation};
use super::score::Score;
use crate::engine::Prepared;
use crate::scenario::{Chisel as Blade, Scenario};
use crate::session::Recording;
use anyhow::Result;
use osteotome_anatomy::Tooth;
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::tool::{Chisel, ChiselParameters};
use serde::Serialize;

/// What was found; where something cannot be known, why.
#[derive(Clone, Debug)]
pub struct Findings {
    /// When the bone came apart \[s\].
    pub broken_s: Option<f64>,
    /// When the phases ended.
    pub phases: Phases,
    /// Left, right.
    pub hands: [HandFindings; 2],
    /// Smaller over larger impulse; `None` where no force was applied.
    pub balance: Option<f64>,
    /// The broken face against the plan; `None` where nothing broke.
    pub path: Option<PathFindings>,
    /// The canal.
    pub nerve: Result<NerveFindings, String>,
    /// The verdict on the split.
    pub bad_split: Result<BadSplit, String>,
    /// Tools touching teeth.
    pub teeth: Result<TeethFindings, String>,
    /// Tools touching what stands still around the jaw; empty where nothing does.
    pub context: Vec<ContextFindings>,
}

/// Contact of tools with crowns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TeethFindings {
    /// How long \[s\].
    pub seconds: f64,
    /// Since when \[s\].
    pub first_s: Option<f64>,
}

/// Why there is no verdict before the break.
const UNBROKEN: &str = "the bone did not come apart";

impl Findings {
    /// From a recording and the bone built from its scenario.
    ///
    /// # Errors
    /// A recording that does not fit the bone.
    pub fn of(prepared: &Prepared, recording: &Recording) -> Result<Self> {
        let patient = &prepared.patient;
        let scenario = &recording.scenario.scenario;
        let grown = recording.growth.iter().find(|g| g.generation > 0);
        let broken_s = recording.growth.iter().find(|g| g.severed).map(|g| g.time);
        let hands = [0, 1].map(|i| hands::hand(recording, i, broken_s));
        let course = Course::new(prepared, recording)?;
        let broken = broken_triangles(&course, prepared, recording)?;
        let regions = regions(patient);
        let layout = regions.map(|r| layout(&r, |p| course.fragment(p)));
        let bad_split = match (&layout, broken_s) {
            (_, None) => Err(UNBROKEN.to_owned()),
            (None, _) => Err("this patient has no landmarks to name regions by".to_owned()),
            (Some(l), Some(_)) => {
                classify(l).ok_or_else(|| "ramus and chin are not apart".to_owned())
            }
        };
        let chin = || course.fragment(&patient.frame.path[patient.frame.path.len() / 2]);
        let of_chin = layout.as_ref().and_then(|l| home(l, Region::Chin));
        let distal = broken_s.map(|_| of_chin.unwrap_or_else(chin));
        let chisels = Self::chisels(scenario)?;
        let canal = patient
            .canals
            .iter()
            .find(|c| c.side == patient.osteotomy.side);
        Ok(Self {
            phases: hands::phases(recording, grown.map(|g| g.time), broken_s),
            balance: balance(&hands),
            hands,
            path: deviation(&Plane::planned(&patient.osteotomy), &broken),
            nerve: canal
                .map(|c| nerve(&course, recording, c, &chisels, &broken, distal))
                .ok_or_else(|| {
                    "no canal of the operated side is known; name a file in patient.canal"
                        .to_owned()
                }),
            context: context(&prepared.surroundings, recording, &chisels),
            teeth: teeth(&course, recording, &patient.teeth, &chisels),
            bad_split,
            broken_s,
        })
    }

    /// The scenario's blades.
    ///
    /// # Errors
    /// A shape that mechanics refuses.
    pub fn chisels(scenario: &Scenario) -> Result<[Chisel; 2]> {
        Ok([
            chisel(&scenario.tool[0].chisel)?,
            chisel(&scenario.tool[1].chisel)?,
        ])
    }

    /// The score by the scenario's rubric.
    pub fn score(&self, recording: &Recording) -> Score {
        Score::of(self, &recording.scenario.scenario.targets)
    }
}

fn balance([left, right]: &[HandFindings; 2]) -> Option<f64> {
    let (a, b) = (left.impulse, right.impulse);
    (a.max(b) > 0.0).then(|| a.min(b) / a.max(b))
}

fn chisel(blade: &Blade) -> Result<Chisel> {
    Ok(Chisel::new(ChiselParameters {
        width: blade.width,
        thickness: blade.thickness,
        bevel_deg: blade.bevel_deg,
        length: blade.length,
    })?)
}

/// What broke, within the bone; the saw's part is left out.
pub fn broken_triangles(
    course: &Course,
    prepared: &Prepared,
    recording: &Recording,
) -> Result<Vec<CrackTriangle>> {
    let Some(last) = recording.growth.last() else {
        return Ok(vec![]);
    };
    let (_, born) = course.births()?;
    let bone = &*prepared.bone.body.region.0;
    let all = last.triangles.iter().zip(&born).filter_map(|(t, born)| {
        let is_sawn = t
            .iter()
            .all(|v| last.kerf.get(*v as usize).is_some_and(|k| *k > 0.0));
        let corner = |v: u32| last.vertices.get(v as usize).map(|p| Vec3::from(*p));
        let corners = [corner(t[0])?, corner(t[1])?, corner(t[2])?];
        (!is_sawn).then_some(CrackTriangle {
            corners,
            born: *born,
        })
    });
    Ok(all.filter(|t| t.is_in(bone)).collect())
}

/// A blade this near to a crown's vertex touches it \[mm\]: crowns are sampled about every millimetre.
const TOUCHES: f64 = 0.3;

fn teeth(
    course: &Course,
    recording: &Recording,
    teeth: &[Tooth],
    chisels: &[Chisel; 2],
) -> Result<TeethFindings, String> {
    if teeth.is_empty() {
        return Err("this patient's teeth are not known".to_owned());
    }
    let scenario = &recording.scenario.scenario;
    let crowns: Vec<_> = teeth
        .iter()
        .map(|t| {
            let vertices = &t.surface.vertices;
            let middle = vertices.iter().sum::<Vec3>() / vertices.len().max(1) as f64;
            (course.anchor(&middle), middle, vertices)
        })
        .collect();
    let (every, dt) = (2 * stride(scenario), scenario.loops.dt());
    let mut found = TeethFindings::default();
    let mut shown: Option<(usize, Vec<Vec3>)> = None;
    for k in (0..recording.hands[0].len()).step_by(every) {
        let time = k as f64 * dt;
        let state = course.state_at(time);
        if shown.as_ref().is_none_or(|s| s.0 != state) {
            let moved = course.moved(state);
            shown = Some((
                state,
                crowns.iter().map(|c| place(&c.0, &moved) - c.1).collect(),
            ));
        }
        let Some((_, shifts)) = &shown else { continue };
        let touches = |i: usize| {
            let pose = &recording.hands[i][k].tool_pose;
            crowns
                .iter()
                .zip(shifts)
                .any(|((_, middle, vertices), shift)| {
                    let near = reach(&chisels[i], pose, &[middle + shift]) < 10.0;
                    near && {
                        let at: Vec<Vec3> = vertices.iter().map(|p| p + shift).collect();
                        reach(&chisels[i], pose, &at) < TOUCHES
                    }
                })
        };
        if touches(0) || touches(1) {
            found.seconds += every as f64 * dt;
            found.first_s.get_or_insert(time);
        }
    }
    Ok(found)
}

#[cfg(test)]
pub mod tests {
    use super::super::hands::At;
    use super::*;
    use std::collections::BTreeMap;

    /// A session in which all went well.
    pub fn findings() -> Findings {
        let hand = HandFindings {
            impulse: 100.0,
            path_length_mm: 80.0,
            smoothness: Some(-2.0),
            overshoot_mm: Some(At {
                value: 0.5,
                time_s: 8.1,
            }),
            ..HandFindings::default()
        };
        Findings {
            broken_s: Some(8.0),
            phases: Phases {
                approach: 1.0,
                insertion: 2.0,
                twisting: 3.0,
                r#break: 8.0,
                after: 9.0,
            },
            hands: [hand.clone(), hand],
            balance: Some(1.0),
            path: Some(PathFindings {
                mean_mm: 1.0,
                max_mm: At {
                    value: 2.0,
                    time_s: 7.0,
                },
                area_mm2: 800.0,
            }),
            nerve: Ok(NerveFindings {
                tool_mm: At {
                    value: 3.0,
                    time_s: 5.0,
                },
                crack_mm: Some(At {
                    value: 1.5,
                    time_s: 7.5,
                }),
                max_stretch: At {
                    value: 0.01,
                    time_s: 8.0,
                },
                kept_by_distal: Some(1.0),
                is_constructed: true,
            }),
            bad_split: Ok(BadSplit {
                kind: None,
                reason: String::new(),
                fragments: [1, 0],
                regions: BTreeMap::new(),
            }),
            teeth: Ok(TeethFindings::default()),
            context: vec![],
        }
    }

    #[test]
    fn balance_is_the_smaller_over_the_larger() {
        let with = |impulse| HandFindings {
            impulse,
            ..HandFindings::default()
        };
        assert_eq!(balance(&[with(30.0), with(40.0)]), Some(0.75));
        assert_eq!(balance(&[with(40.0), with(30.0)]), Some(0.75));
        assert_eq!(balance(&[with(0.0), with(0.0)]), None);
    }
}
