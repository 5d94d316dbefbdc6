//! The broken face against the planned sagittal plane.
use super::hands::At;
use osteotome_anatomy::{Osteotomy, PartKind};
use osteotome_mechanics::geometry::{SignedDistance, Vec3};
use serde::Serialize;

/// The plane that the saw cuts plan: least squares through the points of the ridge's slit (mouth and bottom) and the bottoms of the other cuts.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// On it \[mm\].
    pub centre: Vec3,
    /// Unit vector towards the cheek.
    pub normal: Vec3,
}

impl Plane {
    /// From the line. Where no part is a ridge, all count as one.
    pub fn planned(osteotomy: &Osteotomy) -> Self {
        let has_ridge = osteotomy.part(&PartKind::Ridge).is_some();
        let mut points: Vec<Vec3> = vec![];
        for part in &osteotomy.parts {
            points.extend(part.points.iter().map(|p| p.at + p.toward * p.depth));
            if part.kind == PartKind::Ridge || !has_ridge {
                points.extend(part.points.iter().map(|p| p.at));
            }
        }
        let centre = points.iter().sum::<Vec3>() / points.len() as f64;
        let mut spread = nalgebra::Matrix3::zeros();
        for p in &points {
            spread += (p - centre) * (p - centre).transpose();
        }
        let eigen = spread.symmetric_eigen();
        let normal: Vec3 = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
        let sign = osteotomy.side.sign() * normal.x;
        Self {
            centre,
            normal: if sign < 0.0 { -normal } else { normal },
        }
    }

    /// Towards the cheek positive \[mm\].
    pub fn off(&self, p: &Vec3) -> f64 {
        self.normal.dot(&(p - self.centre))
    }
}

/// How far the bone broke beside the plan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PathFindings {
    /// Mean over the broken area \[mm\].
    pub mean_mm: f64,
    /// Largest, and when the crack got there.
    pub max_mm: At,
    /// Broken area that was looked at, within the bone \[mm2\].
    pub area_mm2: f64,
}

/// A triangle of the crack.
#[derive(Clone, Copy, Debug)]
pub struct CrackTriangle {
    /// \[mm\]
    pub corners: [Vec3; 3],
    /// When it was there \[s\].
    pub born: f64,
}

impl CrackTriangle {
    fn centre(&self) -> Vec3 {
        self.corners.iter().sum::<Vec3>() / 3.0
    }

    /// Whether its middle is within the bone.
    pub fn is_in(&self, bone: &dyn SignedDistance) -> bool {
        bone.signed(&self.centre()) < 0.0
    }
}

/// Distances of broken triangles, by area; `None` where nothing broke.
pub fn deviation(plane: &Plane, broken: &[CrackTriangle]) -> Option<PathFindings> {
    let (mut sum, mut area) = (0.0, 0.0);
    let mut most: Option<At> = None;
    for t in broken {
        let [a, b, c] = t.corners;
        let own = 0.5 * (b - a).cross(&(c - a)).norm();
        let off = plane.off(&t.centre()).abs();
        sum += own * off;
        area += own;
        if most.is_none_or(|m| off > m.value) {
            most = Some(At {
                value: off,
                time_s: t.born,
            });
        }
    }
    (area > 0.0).then(|| PathFindings {
        mean_mm: sum / area,
        max_mm: most.unwrap_or_default(),
        area_mm2: area,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_anatomy::{LinePoint, OsteotomyPart, Side};

    #[test]
    fn a_slit_plans_its_own_plane_and_a_face_beside_it_is_off() {
        // Along y, down -z, at x = -20: a right side's ridge, with a medial cut whose bottom reaches the plane.
        let point = |x: f64, y: f64, toward: Vec3, depth: f64| LinePoint {
            at: Vec3::new(x, y, 0.0),
            toward,
            depth,
        };
        let ridge = (0..5).map(|i| point(-20.0, f64::from(i), -Vec3::z(), 4.0));
        let medial = (0..3).map(|i| point(-14.0, 5.0 + f64::from(i), -Vec3::x(), 6.0));
        let part = |kind, points| OsteotomyPart { kind, points };
        let plane = Plane::planned(&Osteotomy {
            side: Side::Right,
            kerf: 0.8,
            parts: vec![
                part(PartKind::Medial, medial.collect()),
                part(PartKind::Ridge, ridge.collect()),
            ],
        });
        assert!((plane.normal + Vec3::x()).norm() < 1e-9, "{}", plane.normal);
        let strip = |x: f64, width: f64, born: f64| CrackTriangle {
            corners: [
                Vec3::new(x, 0.0, -4.0),
                Vec3::new(x, width, -4.0),
                Vec3::new(x, 0.0, -8.0),
            ],
            born,
        };
        let found = deviation(&plane, &[strip(-21.0, 1.0, 2.0), strip(-17.0, 3.0, 3.5)]).unwrap();
        assert!((found.mean_mm - (1.0 + 3.0 * 3.0) / 4.0).abs() < 1e-9);
        assert!((found.max_mm.value - 3.0).abs() < 1e-9 && found.max_mm.time_s == 3.5);
        assert!((found.area_mm2 - 8.0).abs() < 1e-9);
        assert_eq!(deviation(&plane, &[]), None);
    }
}
