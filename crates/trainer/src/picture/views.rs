//! Where a picture is taken from.
use crate::engine::Prepared;
use clap::ValueEnum;
use osteotome_mechanics::geometry::Vec3;
use osteotome_render::Camera;
use serde::{Deserialize, Serialize};

/// Named views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// From before the patient.
    Front,
    /// From the patient's left.
    Left,
    /// From the patient's right.
    Right,
    /// From above.
    Top,
    /// From where the surgeon stands.
    Procedure,
    /// Close to the osteotomy, from the cheek.
    Close,
}

/// Vertical angle of view \[degrees\].
const ANGLE: f64 = 26.0;

impl View {
    /// The camera; `aspect` is the picture's width over its height.
    pub fn camera(self, prepared: &Prepared, aspect: f64) -> Camera {
        let patient = &prepared.patient;
        let bounds = patient.surface.bounds();
        let whole = (bounds.centre(), 0.5 * bounds.extent().norm() * 0.80);
        let side = patient.osteotomy.side.sign();
        let marks: Vec<Vec3> = patient
            .osteotomy
            .parts
            .iter()
            .flat_map(|p| &p.points)
            .map(|p| p.at)
            .collect();
        let middle = marks.iter().sum::<Vec3>() / marks.len().max(1) as f64;
        let reach = marks
            .iter()
            .map(|m| (m - middle).norm())
            .fold(10.0, f64::max);
        let near = (middle, 1.15 * reach);
        let up = Vec3::z();
        let ((target, radius), direction, up) = match self {
            Self::Front => (whole, Vec3::new(0.0, -1.0, 0.22), up),
            Self::Left => (whole, Vec3::new(1.0, -0.10, 0.12), up),
            Self::Right => (whole, Vec3::new(-1.0, -0.10, 0.12), up),
            Self::Top => (whole, Vec3::new(0.0, -0.02, 1.0), -Vec3::y()),
            Self::Procedure => (
                (middle, 1.9 * reach),
                Vec3::new(0.45 * side, -0.85, 0.72),
                up,
            ),
            Self::Close => (near, Vec3::new(0.80 * side, -0.52, 0.62), up),
        };
        let fit = (0.5 * ANGLE.to_radians()).sin() * aspect.min(1.0);
        let eye = target + direction.normalize() * (radius / fit);
        let f = |v: Vec3| -> [f32; 3] { v.cast::<f32>().into() };
        Camera::look_at(f(eye), f(target), f(up), ANGLE as f32)
    }
}
