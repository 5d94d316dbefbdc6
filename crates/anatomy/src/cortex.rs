//! How thick the cortical layer is, region by region.
use crate::error::{AnatomyError, in_range};
use crate::landmarks::JawFrame;
use crate::parametric::smoothstep;
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use serde::{Deserialize, Serialize};

/// Thickness of the cortical layer by region \[mm\]; between them it changes gradually.
///
/// Body: as on computed tomograms of twenty dry mandibles at the first molar, buccal 2.2 (sd 0.4) and lingual 2.0 (sd 0.6); there the
/// buccal plate thickens backwards and the lingual one thins (J Korean Acad Oral Maxillofac Radiol 1997, 27:217, abstract). The
/// lower border is the thickest region (Swasty et al. 2009, J Oral Maxillofac Surg, abstract). How thick it and the ramus' plates
/// are is assumed, in that order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CorticalRegions {
    /// The body's outer plate.
    pub body_buccal: f64,
    /// The body's inner plate.
    pub body_lingual: f64,
    /// The ramus' outer plate.
    pub ramus_buccal: f64,
    /// The ramus' inner plate.
    pub ramus_lingual: f64,
    /// The lower border.
    pub lower_border: f64,
}

impl Default for CorticalRegions {
    fn default() -> Self {
        Self {
            body_buccal: 2.2,
            body_lingual: 2.0,
            ramus_buccal: 2.5,
            ramus_lingual: 1.6,
            lower_border: 2.9,
        }
    }
}

/// Where the body becomes the ramus: from so much of the way from angle to chin to so much of it.
const RAMUS: [f64; 2] = [0.5, 0.2];
/// The surface faces down by so much (the sine) where it begins to be the lower border, and where it is that wholly.
const BORDER: [f64; 2] = [0.3, 0.8];

impl CorticalRegions {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`AnatomyError::OutOfRange`] naming the first thickness that is not possible.
    pub fn check(&self) -> Result<(), AnatomyError> {
        for (name, value) in [
            ("body_buccal", self.body_buccal),
            ("body_lingual", self.body_lingual),
            ("ramus_buccal", self.ramus_buccal),
            ("ramus_lingual", self.ramus_lingual),
            ("lower_border", self.lower_border),
        ] {
            let key = format!("material.cortical_regions.{name}");
            in_range(&key, value, 0.0, 50.0)?;
        }
        Ok(())
    }

    /// The thickness under the surface's point nearest to `p`.
    pub fn at(&self, p: &Vec3, surface: &MeshDistance, frame: &JawFrame) -> f64 {
        let Some(nearest) = surface.closest(p) else {
            return self.body_buccal;
        };
        let gonion = 0.5 * (frame.gonions[0] + frame.gonions[1]);
        let chin = frame.path.iter().map(|q| q.y).fold(gonion.y, f64::min);
        let ahead = (gonion.y - nearest.point.y) / (gonion.y - chin).max(1e-9);
        let ramus = smoothstep(RAMUS[0], RAMUS[1], ahead);
        // Away from the tongue: from between the jaw angles, a quarter of the way to the chin.
        let tongue = Vec3::new(gonion.x, gonion.y + 0.25 * (chin - gonion.y), 0.0);
        let away = (nearest.point - tongue).xy();
        let outward = away.try_normalize(1e-9).unwrap_or_default();
        let buccal = smoothstep(-1.0, 1.0, nearest.normal.xy().dot(&outward));
        let plates = mix(
            mix(self.body_lingual, self.body_buccal, buccal),
            mix(self.ramus_lingual, self.ramus_buccal, buccal),
            ramus,
        );
        mix(
            plates,
            self.lower_border,
            smoothstep(BORDER[0], BORDER[1], -nearest.normal.z),
        )
    }
}

fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::landmarks::cast;
    use crate::{Parameters, ParametricMandible, mesher};

    /// From within the bone out to every side, each region has its own thickness, on both sides of the jaw.
    #[test]
    fn each_region_has_its_own() {
        let jaw = ParametricMandible::new(Parameters::default()).unwrap();
        let mesh = mesher::contour(&jaw, 2.0).unwrap();
        let frame = JawFrame::find(&mesh, "the jaw").unwrap();
        let surface = MeshDistance::new(mesh);
        let marks = jaw.landmarks(&surface).unwrap();
        let regions = CorticalRegions::default();
        for (side, sign) in [(&marks.right, -1.0), (&marks.left, 1.0)] {
            let from = |p: Vec3, direction: Vec3| {
                let start = p + direction * 30.0;
                let there = cast(&surface, &start, &-direction).unwrap();
                regions.at(&(there - direction * 0.5), &surface, &frame)
            };
            let out = Vec3::x() * sign;
            let buccal = from(side.lingula, out);
            let lingual = from(side.lingula, -out);
            assert!((buccal - 2.5).abs() < 0.1, "ramus, buccal: {buccal}");
            assert!((lingual - 1.6).abs() < 0.1, "ramus, lingual: {lingual}");
            let border = from(side.lower_border, -Vec3::z());
            assert!((border - 2.9).abs() < 0.15, "lower border: {border}");
        }
        let start = marks.menton + Vec3::new(0.0, -40.0, 15.0);
        let chin = cast(&surface, &start, &Vec3::y()).unwrap();
        let chin = regions.at(&(chin + Vec3::y() * 0.5), &surface, &frame);
        assert!((chin - 2.2).abs() < 0.15, "chin: {chin}");
    }

    #[test]
    fn an_impossible_thickness_is_named() {
        let regions = CorticalRegions {
            lower_border: -1.0,
            ..CorticalRegions::default()
        };
        let text = regions.check().unwrap_err().to_string();
        assert!(
            text.starts_with("material.cortical_regions.lower_border = -1 is outside its range"),
            "{text}"
        );
    }
}
