//! Lines by named techniques, placed on landmarks.
use super::{LinePoint, Osteotomy, OsteotomyPart, PartKind, Side};
use crate::error::AnatomyError;
use crate::landmarks::{Landmarks, SideLandmarks, cast};
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use serde::{Deserialize, Serialize};

/// Named ways of sawing: three cuts, medial, along the ridge, and buccal.
///
/// They differ in how far the medial cut goes back and in where the buccal one runs. Sizes are this program's choice within what
/// textbooks describe; no more than that is claimed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Technique {
    /// Medial cut to the posterior border; buccal cut on the ramus, from the ridge back to just above the jaw's angle.
    Obwegeser,
    /// Medial cut to the posterior border; buccal cut upright at the second molar, through the lower border.
    DalPont,
    /// Medial cut to just behind the lingula; buccal cut as Dal Pont's.
    Hunsuck,
}

impl Technique {
    /// All, in the order of their age.
    pub const ALL: [Self; 3] = [Self::Obwegeser, Self::DalPont, Self::Hunsuck];

    /// As in scenarios.
    pub fn name(self) -> &'static str {
        match self {
            Self::Obwegeser => "obwegeser",
            Self::DalPont => "dal-pont",
            Self::Hunsuck => "hunsuck",
        }
    }
}

/// Distance between generated points \[mm\].
pub(super) const STEP: f64 = 1.5;
/// Hunsuck's medial cut ends so far behind the lingula \[mm\]: half way to the posterior border, which is 15 to 16 mm away.
const BEHIND_LINGULA: f64 = 7.3;
/// No ramus goes on further behind that \[mm\].
const WIDEST_RAMUS: f64 = 30.0;
/// Obwegeser's buccal cut leaves the ridge at most so far below the medial one \[mm\].
const OBWEGESER_DROP: f64 = 20.0;
/// A saw goes no less deep \[mm\].
const LEAST_DEPTH: f64 = 1.0;

impl Osteotomy {
    /// A line by a technique, on landmarks.
    ///
    /// Points every 1.5 mm on the surface. Medial: horizontal, 2.5 mm above the lingula, half of the local thickness deep (1 to
    /// 4.3 mm). Ridge: 4 mm deep, into the bone. Buccal: 3.5 mm deep, 4 mm around the border, in one plane; on the ramus no deeper
    /// than half of the bone.
    ///
    /// # Errors
    /// [`AnatomyError::Osteotomy`] if landmarks and surface do not belong together.
    pub fn by_technique(
        technique: Technique,
        landmarks: &Landmarks,
        side: Side,
        kerf: f64,
        surface: &MeshDistance,
    ) -> Result<Self, AnatomyError> {
        let marks = match side {
            Side::Right => &landmarks.right,
            Side::Left => &landmarks.left,
        };
        let ridge = ridge_part(marks, technique, surface)?;
        let medial = medial_part(marks, technique, side, &ridge, surface)?;
        let buccal = buccal_part(marks, technique, side, &ridge, surface)?;
        let part = |kind, points| OsteotomyPart { kind, points };
        let parts = [
            part(PartKind::Medial, medial),
            part(PartKind::Ridge, ridge),
            part(PartKind::Buccal, buccal),
        ];
        Self::by_parts(side, kerf, &parts, surface)
    }
}

/// How far the bone goes on from a point of its surface along a unit vector into it, at most 60 mm; 0 where that leads out.
pub fn thickness(surface: &MeshDistance, at: &Vec3, toward: &Vec3) -> f64 {
    const START: f64 = 0.3; // mm; a point is on the surface only so nearly
    const MOST: f64 = 60.0; // mm
    let mut along = START;
    while along < MOST {
        let d = surface.signed(&(at + toward * along));
        if d >= 0.0 {
            return if along > START { along } else { 0.0 };
        }
        along += (-d).max(0.05);
    }
    MOST
}

fn lost(what: &str) -> AnatomyError {
    AnatomyError::Osteotomy {
        reason: format!("no bone found at {what}; do the landmarks belong to this surface?"),
    }
}

/// Along the ridge from the medial cut's height to the second molar.
fn ridge_part(
    marks: &SideLandmarks,
    technique: Technique,
    surface: &MeshDistance,
) -> Result<Vec<LinePoint>, AnatomyError> {
    let top = medial_height(marks) - 1.7;
    let mut line: Vec<Vec3> = marks.external_oblique_ridge.clone();
    line.retain(|p| p.z < top && p.z > marks.second_molar_buccal.z);
    line.push(marks.second_molar_buccal);
    if technique == Technique::Obwegeser {
        let lowest = medial_height(marks) - OBWEGESER_DROP;
        line.retain(|p| p.z > lowest);
    }
    if line.len() < 3 {
        return Err(lost("the external oblique ridge"));
    }
    let points = resample(&line, STEP);
    let n = points.len();
    let mut out = Vec::with_capacity(n);
    for i in 0..n {
        let tangent = points[(i + 1).min(n - 1)] - points[i.saturating_sub(1)];
        let inward = -smooth_normal(&points[i], surface);
        let Some(toward) = across(&inward, &tangent) else {
            return Err(lost("the external oblique ridge"));
        };
        out.push(onto(&points[i], toward, 4.0, surface));
    }
    Ok(out)
}

/// The medial cut runs this high: just above the lingula.
fn medial_height(marks: &SideLandmarks) -> f64 {
    marks.lingula.z + 2.5
}

/// From behind the lingula forward to the ridge, on the medial surface.
fn medial_part(
    marks: &SideLandmarks,
    technique: Technique,
    side: Side,
    ridge: &[LinePoint],
    surface: &MeshDistance,
) -> Result<Vec<LinePoint>, AnatomyError> {
    let outward = Vec3::x() * side.sign();
    let z = medial_height(marks);
    let (back, front) = (marks.lingula.y + BEHIND_LINGULA, ridge[0].at.y + 1.2);
    let n = ((back - front) / STEP).floor().max(1.0) as i32;
    let beyond_back = match technique {
        Technique::Hunsuck => 0,
        // As far as there is bone.
        Technique::Obwegeser | Technique::DalPont => (WIDEST_RAMUS / STEP) as i32,
    };
    let mut points = Vec::new();
    for i in -beyond_back..=n {
        let y = back - STEP * f64::from(i);
        let start = Vec3::new(marks.lingula.x, y, z);
        let Some(at) = cast(surface, &(start - outward * 20.0), &outward) else {
            continue;
        };
        let Some(beyond) = cast(surface, &(start + outward * 30.0), &-outward) else {
            continue;
        };
        let thickness = (beyond - at).dot(&outward);
        if i < 0 && thickness < 2.0 * LEAST_DEPTH {
            continue;
        }
        points.push(LinePoint {
            at,
            toward: outward,
            depth: (0.5 * thickness).clamp(LEAST_DEPTH, 4.3),
        });
    }
    if points.len() < 3 {
        return Err(lost("the medial side of the ramus above the lingula"));
    }
    Ok(points)
}

/// From the ridge's end over the buccal surface to the lower border, after Obwegeser to the posterior one, and around it.
fn buccal_part(
    marks: &SideLandmarks,
    technique: Technique,
    side: Side,
    ridge: &[LinePoint],
    surface: &MeshDistance,
) -> Result<Vec<LinePoint>, AnatomyError> {
    let outward = Vec3::x() * side.sign();
    let start = ridge.last().map_or(marks.second_molar_buccal, |p| p.at);
    let end = match technique {
        Technique::Obwegeser => marks.gonion,
        Technique::DalPont | Technique::Hunsuck => marks.lower_border,
    };
    let down = (end - start).normalize();
    // The plane of the cut holds `down` and the direction across the jaw.
    let Some(normal) = down.cross(&outward).try_normalize(1e-6) else {
        return Err(lost("the buccal cut"));
    };
    let flat = |v: Vec3| v - normal * v.dot(&normal);
    let centre = start + flat(end - start) * 0.5;
    let mut outline = Vec::new();
    // Rays from around the body's cheek side towards its middle, from the crest to just past the lower border.
    let half = 0.5 * (end - start).norm();
    for i in 0..=120 {
        let angle = f64::from(i) / 120.0 * 205.0f64.to_radians();
        let from = centre - down * (angle.cos() * (half + 15.0)) + outward * (angle.sin() * 40.0);
        let ray = flat(centre - from).normalize();
        if let Some(at) = cast(surface, &from, &ray) {
            outline.push(at);
        }
    }
    if outline.len() < 60 {
        return Err(lost("the buccal side of the body"));
    }
    // From the ridge's end on, and round the border by 3 mm.
    let begin = (0..outline.len())
        .min_by(|a, b| {
            (outline[*a] - start)
                .norm()
                .total_cmp(&(outline[*b] - start).norm())
        })
        .unwrap_or(0);
    // Where the wall has arrived at the lower border; a broad one may go on lower by a trifle.
    let depths: Vec<f64> = outline.iter().map(|p| p.dot(&down)).collect();
    let deepest = depths.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let arrived = depths.iter().position(|d| *d > deepest - 0.6);
    let lowest = arrived.unwrap_or(outline.len() - 1);
    let mut end = lowest;
    let mut past = 0.0;
    while end + 1 < outline.len() && past < 2.0 * STEP {
        past += (outline[end + 1] - outline[end]).norm();
        end += 1;
    }
    if begin + 10 > end {
        return Err(lost("the buccal side of the body"));
    }
    let points = resample(&outline[begin..=end], STEP);
    let border = outline[lowest];
    let mut out = Vec::new();
    // The first one is the ridge's own end.
    for p in points.iter().skip(1) {
        let inward = -flat(smooth_normal(p, surface));
        let Some(toward) = inward.try_normalize(1e-6) else {
            return Err(lost("the buccal side of the body"));
        };
        let wanted = if (p - border).norm() < 2.5 * STEP {
            4.0
        } else {
            3.5
        };
        let mut point = onto(p, toward, wanted, surface);
        if technique == Technique::Obwegeser {
            // The ramus is thinner than the body.
            let most = 0.5 * thickness(surface, &point.at, &toward);
            point.depth = wanted.min(most).max(LEAST_DEPTH);
        }
        out.push(point);
    }
    Ok(out)
}

pub(super) fn onto(p: &Vec3, toward: Vec3, depth: f64, surface: &MeshDistance) -> LinePoint {
    LinePoint {
        at: surface.closest(p).map_or(*p, |c| c.point),
        toward,
        depth,
    }
}

/// The part of `v` across `tangent`, as a unit vector.
pub(super) fn across(v: &Vec3, tangent: &Vec3) -> Option<Vec3> {
    let t = tangent.try_normalize(1e-9)?;
    (v - t * v.dot(&t)).try_normalize(1e-6)
}

/// Mean outward normal of the surface about `p`, over about 2 mm: the direction in which the distance grows.
pub(super) fn smooth_normal(p: &Vec3, surface: &MeshDistance) -> Vec3 {
    const REACH: f64 = 2.0;
    Vec3::from_fn(|k, _| {
        let step = Vec3::from_fn(|j, _| if j == k { REACH } else { 0.0 });
        surface.signed(&(p + step)) - surface.signed(&(p - step))
    })
}

/// Points every `step` along a polyline, its ends kept.
pub(super) fn resample(line: &[Vec3], step: f64) -> Vec<Vec3> {
    let length: f64 = line.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
    let n = (length / step).round().max(1.0) as usize;
    let spacing = length / n as f64;
    let mut out = vec![line[0]];
    let mut travelled = 0.0;
    for pair in line.windows(2) {
        let edge = pair[1] - pair[0];
        let end = travelled + edge.norm();
        while out.len() < n && out.len() as f64 * spacing <= end {
            let s = (out.len() as f64 * spacing - travelled) / edge.norm();
            out.push(pair[0] + edge * s);
        }
        travelled = end;
    }
    out.push(line[line.len() - 1]);
    out
}
