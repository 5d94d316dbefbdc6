//! Where a picture is taken from.
use crate::engine::Prepared;
use clap::ValueEnum;
use osteotome_mechanics::geometry::{Aabb, Vec3};
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
        let whole = whole(&patient.surface.bounds());
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
        let (place, direction) = match self {
            Self::Front | Self::Left | Self::Right | Self::Top => (whole, self.direction(side)),
            Self::Procedure => ((middle, 1.9 * reach), self.direction(side)),
            Self::Close => (near, self.direction(side)),
        };
        self.from(place, direction, aspect)
    }

    /// The camera that sees all of a body from this side; close views see it from the right.
    pub fn of_whole(self, bounds: &Aabb, aspect: f64) -> Camera {
        self.from(whole(bounds), self.direction(-1.0), aspect)
    }

    /// Whence it looks; `side`: sign of x of the operated side.
    fn direction(self, side: f64) -> Vec3 {
        match self {
            Self::Front => Vec3::new(0.0, -1.0, 0.22),
            Self::Left => Vec3::new(1.0, -0.10, 0.12),
            Self::Right => Vec3::new(-1.0, -0.10, 0.12),
            Self::Top => Vec3::new(0.0, -0.02, 1.0),
            Self::Procedure => Vec3::new(0.45 * side, -0.85, 0.72),
            Self::Close => Vec3::new(0.80 * side, -0.52, 0.62),
        }
    }

    fn from(self, (target, radius): (Vec3, f64), direction: Vec3, aspect: f64) -> Camera {
        let up = match self {
            Self::Top => -Vec3::y(),
            _ => Vec3::z(),
        };
        let fit = (0.5 * ANGLE.to_radians()).sin() * aspect.min(1.0);
        let eye = target + direction.normalize() * (radius / fit);
        let f = |v: Vec3| -> [f32; 3] { v.cast::<f32>().into() };
        Camera::look_at(f(eye), f(target), f(up), ANGLE as f32)
    }
}

/// Middle of a body, and how far it reaches from there \[mm\].
fn whole(bounds: &Aabb) -> (Vec3, f64) {
    (bounds.centre(), 0.5 * bounds.extent().norm() * 0.80)
}
