//! The canal with its nerve: how near tools and crack came, how far it was stretched, with which fragment it went.
use super::course::{Course, place};
use super::hands::{At, stride};
use super::path::CrackTriangle;
use crate::picture::Anchor;
use crate::session::Recording;
use osteotome_anatomy::Canal;
use osteotome_mechanics::geometry::{Pose, Vec3, closest_on_triangle};
use osteotome_mechanics::tool::Chisel;
use serde::Serialize;

/// Findings about the canal.
#[derive(Clone, Debug, Serialize)]
pub struct NerveFindings {
    /// Smallest distance of a tool to the canal's wall; below 0 within it \[mm\].
    pub tool_mm: At,
    /// Likewise of the broken face; `null` where nothing broke.
    pub crack_mm: Option<At>,
    /// Largest stretch over 10 mm of its line, as a share; the nerve is taken to follow the bone.
    pub max_stretch: At,
    /// Share of its length that stays with the tooth-bearing fragment; `null` before the split.
    pub kept_by_distal: Option<f64>,
    /// Whether the canal was placed by published means rather than seen in images.
    pub is_constructed: bool,
}

impl NerveFindings {
    /// The nearest that tool or crack came.
    pub fn nearest(&self) -> At {
        let crack = self.crack_mm.unwrap_or(self.tool_mm);
        if crack.value < self.tool_mm.value {
            crack
        } else {
            self.tool_mm
        }
    }
}

/// Points on the canal's line are this far apart \[mm\].
const STEP: f64 = 0.5;
/// Stretch is taken over so much of the line \[mm\].
const WINDOW: f64 = 10.0;

/// Points every [`STEP`] on a line.
pub fn dense(line: &[Vec3]) -> Vec<Vec3> {
    let piece = |p: &[Vec3]| {
        let n = ((p[1] - p[0]).norm() / STEP).ceil().max(1.0) as usize;
        let (a, b) = (p[0], p[1]);
        (0..n).map(move |k| a.lerp(&b, k as f64 / n as f64))
    };
    line.windows(2)
        .flat_map(piece)
        .chain(line.last().copied())
        .collect()
}

/// Looks at a canal. `distal`: the tooth-bearing fragment, once the bone is apart.
pub fn nerve(
    course: &Course,
    recording: &Recording,
    canal: &Canal,
    chisels: &[Chisel; 2],
    broken: &[CrackTriangle],
    distal: Option<u32>,
) -> NerveFindings {
    let line = dense(&canal.line);
    let anchors: Vec<Anchor> = line.iter().map(|p| course.anchor(p)).collect();
    let kept = distal.map(|distal| {
        let stays = anchors.iter().filter(|a| course.fragment_of(a) == distal);
        stays.count() as f64 / anchors.len() as f64
    });
    let (tool_mm, max_stretch) = through_time(course, recording, &anchors, &line, chisels, canal);
    NerveFindings {
        tool_mm,
        max_stretch,
        crack_mm: nearest_crack(&line, broken, canal.radius),
        kept_by_distal: kept,
        is_constructed: canal.is_constructed,
    }
}

fn through_time(
    course: &Course,
    recording: &Recording,
    anchors: &[Anchor],
    rest: &[Vec3],
    chisels: &[Chisel; 2],
    canal: &Canal,
) -> (At, At) {
    let scenario = &recording.scenario.scenario;
    let (every, dt) = (stride(scenario), scenario.loops.dt());
    let mut nearest = At {
        value: f64::INFINITY,
        time_s: 0.0,
    };
    let mut stretched = At::default();
    let mut shown: Option<(usize, Vec<Vec3>)> = None;
    for k in (0..recording.hands[0].len()).step_by(every) {
        let time_s = k as f64 * dt;
        let state = course.state_at(time_s);
        if shown.as_ref().is_none_or(|s| s.0 != state) {
            let moved = course.moved(state);
            let line: Vec<Vec3> = anchors.iter().map(|a| place(a, &moved)).collect();
            let value = stretch(rest, &line);
            if value > stretched.value {
                stretched = At { value, time_s };
            }
            shown = Some((state, line));
        }
        let Some((_, line)) = &shown else { continue };
        for (chisel, hand) in chisels.iter().zip(&recording.hands) {
            let value = reach(chisel, &hand[k].tool_pose, line) - canal.radius;
            if value < nearest.value {
                nearest = At { value, time_s };
            }
        }
    }
    (nearest, stretched)
}

/// Distance of a blade to the nearest of some points \[mm\].
pub fn reach(chisel: &Chisel, pose: &Pose, points: &[Vec3]) -> f64 {
    let to_tool = pose.inverse();
    let at = |p: &Vec3| chisel.distance(&(to_tool * nalgebra::Point3::from(*p)).coords);
    points.iter().map(at).fold(f64::INFINITY, f64::min)
}

/// Largest relative lengthening over [`WINDOW`] of a line.
fn stretch(rest: &[Vec3], now: &[Vec3]) -> f64 {
    let along = |line: &[Vec3]| {
        let mut sums = vec![0.0];
        for p in line.windows(2) {
            sums.push(sums[sums.len() - 1] + (p[1] - p[0]).norm());
        }
        sums
    };
    let (rest, now) = (along(rest), along(now));
    let of = |i: usize| {
        let j = rest.partition_point(|s| *s < rest[i] + WINDOW);
        (j < rest.len()).then(|| (now[j] - now[i]) / (rest[j] - rest[i]) - 1.0)
    };
    (0..rest.len()).filter_map(of).fold(0.0, f64::max)
}

/// The nearest that any of these came to the wall of a canal around `line`.
pub fn nearest_crack(line: &[Vec3], broken: &[CrackTriangle], radius: f64) -> Option<At> {
    let of = |t: &CrackTriangle| {
        let distance = |p: &Vec3| {
            let w = closest_on_triangle(p, &t.corners);
            let on: Vec3 = (0..3).map(|k| t.corners[k] * w[k]).sum();
            (on - p).norm()
        };
        At {
            value: line.iter().map(distance).fold(f64::INFINITY, f64::min) - radius,
            time_s: t.born,
        }
    };
    broken
        .iter()
        .map(of)
        .min_by(|a, b| a.value.total_cmp(&b.value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_mechanics::tool::ChiselParameters;

    fn straight() -> Vec<Vec3> {
        dense(&[Vec3::zeros(), Vec3::new(0.0, 40.0, 0.0)])
    }

    #[test]
    fn a_gap_of_two_millimetres_stretches_ten_by_a_fifth() {
        let rest = straight();
        let now: Vec<Vec3> = rest
            .iter()
            .map(|p| p + Vec3::new(0.0, if p.y > 20.2 { 2.0 } else { 0.0 }, 0.0))
            .collect();
        assert!((stretch(&rest, &now) - 0.2).abs() < 1e-9);
        assert_eq!(stretch(&rest, &rest), 0.0);
        // A rigid motion stretches nothing.
        let turn = Pose::new(Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.3, 0.2, 0.1));
        let turned: Vec<Vec3> = rest
            .iter()
            .map(|p| (turn * nalgebra::Point3::from(*p)).coords)
            .collect();
        assert!(stretch(&rest, &turned) < 1e-12);
    }

    #[test]
    fn distances_to_crack_and_blade_are_those_to_the_wall() {
        let line = straight();
        let face = |x: f64, born| CrackTriangle {
            corners: [
                Vec3::new(x, 0.0, -50.0),
                Vec3::new(x, 80.0, -50.0),
                Vec3::new(x, 20.0, 50.0),
            ],
            born,
        };
        let near = nearest_crack(&line, &[face(7.0, 1.0), face(-5.0, 2.0)], 1.4).unwrap();
        assert!((near.value - 3.6).abs() < 1e-9 && near.time_s == 2.0);
        let through = nearest_crack(&line, &[face(0.0, 1.0)], 1.4).unwrap();
        assert!((through.value + 1.4).abs() < 1e-9);
        assert_eq!(nearest_crack(&line, &[], 1.4), None);
        let chisel = Chisel::new(ChiselParameters {
            width: 6.0,
            thickness: 2.0,
            bevel_deg: 8.0,
            length: 60.0,
        })
        .unwrap();
        // Driven along +x, its edge's middle 9 mm before the line.
        let pose = Pose::from_parts(
            Vec3::new(-9.0, 20.0, 0.0).into(),
            nalgebra::UnitQuaternion::from_axis_angle(&Vec3::y_axis(), std::f64::consts::FRAC_PI_2),
        );
        assert!((reach(&chisel, &pose, &line) - 9.0).abs() < 0.05);
    }
}
