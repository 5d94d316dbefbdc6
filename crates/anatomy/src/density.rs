//! Stiffness from a scan's grey values: calibrated to a density, and that by a named relation to Young's modulus. Off unless asked
//! for.
//!
//! No relation for the mandible is known to this project. Those named here were measured on trabecular bone of other sites, and
//! such relations depend on the site (Morgan, Bayraktar and Keaveny 2003, Journal of Biomechanics 36, 897: 142 specimens from 61
//! cadavers; exponents 1.49 to 2.18, leading coefficients differ). Of that paper only the abstract was seen; the coefficients
//! are as published programs quote them (the vertebra's several, the femoral neck's one). For cortical bone they are extrapolations.
use crate::error::{AnatomyError, in_range};
use crate::labels::{Volume, Voxel};
use crate::nifti::read_nifti;
use crate::nrrd::read_nrrd;
use osteotome_mechanics::geometry::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Young's modulus \[MPa\] by apparent density \[g/cm3\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Relation {
    /// 6850 rho^1.49: trabecular bone of the femoral neck (Morgan 2003).
    MorganFemoralNeck,
    /// 4730 rho^1.56: trabecular bone of the vertebra (Morgan 2003).
    MorganVertebra,
}

impl Relation {
    /// \[MPa\]; `density` in g/cm3, not negative.
    pub fn modulus(self, density: f64) -> f64 {
        let (coefficient, exponent) = match self {
            Self::MorganFemoralNeck => (6850.0, 1.49),
            Self::MorganVertebra => (4730.0, 1.56),
        };
        coefficient * density.max(0.0).powf(exponent)
    }

    /// As in scenarios.
    pub fn name(self) -> &'static str {
        match self {
            Self::MorganFemoralNeck => "morgan-femoral-neck",
            Self::MorganVertebra => "morgan-vertebra",
        }
    }
}

/// Where densities come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensitySpec {
    /// A scan in the patient's frame (NIfTI, NRRD).
    pub scan: PathBuf,
    /// From density to modulus.
    pub relation: Relation,
    /// Apparent density \[g/cm3\] = the first times the grey value plus the second: the scanner's own, from a phantom.
    pub calibration: [f64; 2],
}

/// Grey values, rounded to whole numbers.
type Scan = Volume<i16>;

impl Voxel for i16 {
    fn of(value: f64, i: usize) -> Result<Self, String> {
        if value.is_finite() {
            Ok(value
                .round()
                .clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as Self)
        } else {
            Err(format!(
                "voxel {i} is {value}; grey values are finite numbers"
            ))
        }
    }
}

/// A modulus at every place of a scan.
pub struct Density {
    scan: Scan,
    relation: Relation,
    calibration: [f64; 2],
}

/// Young's modulus of what was bone to the segmentation, whatever the scan shows there \[MPa\]: marrow at the least, mineral at the
/// most.
const RANGE: [f64; 2] = [20.0, 30_000.0];

impl Density {
    /// Reads the scan. It must reach all of `bone`.
    ///
    /// # Errors
    /// [`AnatomyError`] for a calibration that is not possible, a file that cannot be read, or a scan of another place.
    pub fn read(spec: &DensitySpec, bone: &[Vec3]) -> Result<Self, AnatomyError> {
        let [slope, shift] = spec.calibration;
        in_range("material.density.calibration.0", slope, 1e-6, 1.0)?;
        in_range("material.density.calibration.1", shift, -10.0, 10.0)?;
        let path = &spec.scan;
        let name = path.display().to_string();
        let lower = name.to_lowercase();
        let scan: Scan = if lower.ends_with(".nii") || lower.ends_with(".nii.gz") {
            read_nifti(path)?
        } else if lower.ends_with(".nrrd") || lower.ends_with(".nhdr") {
            read_nrrd(path)?
        } else {
            return Err(AnatomyError::Foreign {
                path: name,
                what: "no scan that can be read",
                mend: "a NIfTI (.nii, .nii.gz) or NRRD (.nrrd, .nhdr) file",
            });
        };
        let density = Self {
            scan,
            relation: spec.relation,
            calibration: spec.calibration,
        };
        let outside = bone.iter().filter(|p| density.grey(p).is_none()).count();
        if outside > 0 {
            return Err(AnatomyError::Format {
                path: name,
                format: "scan",
                reason: format!(
                    "it does not reach {outside} of the bone's {} nodes; scan and patient must be in one frame (LPS, mm)",
                    bone.len()
                ),
            });
        }
        Ok(density)
    }

    /// Grey value at a place, linear between the middles of voxels, held at the border voxels' own half; `None` beyond.
    fn grey(&self, p: &Vec3) -> Option<f64> {
        let at = self.scan.affine.index(p);
        let size = self.scan.size;
        let mut low = [0usize; 3];
        let mut share = [0.0; 3];
        for k in 0..3 {
            let last = size[k] as f64 - 1.0;
            if !(-0.5..=last + 0.5).contains(&at[k]) {
                return None;
            }
            let inner = at[k].clamp(0.0, last);
            low[k] = (inner.floor() as usize).min(size[k].saturating_sub(2));
            share[k] = inner - low[k] as f64;
        }
        let value = |corner: usize| {
            let step = |k: usize| (low[k] + (corner >> k & 1)).min(size[k] - 1);
            let i = (step(2) * size[1] + step(1)) * size[0] + step(0);
            f64::from(self.scan.voxels[i])
        };
        let weight = |corner: usize| -> f64 {
            let of = |k: usize| match corner >> k & 1 {
                1 => share[k],
                _ => 1.0 - share[k],
            };
            of(0) * of(1) * of(2)
        };
        Some((0..8).map(|c| weight(c) * value(c)).sum())
    }

    /// Young's modulus at a place \[MPa\]; `None` beyond the scan.
    pub fn modulus(&self, p: &Vec3) -> Option<f64> {
        let density = self.calibration[0] * self.grey(p)? + self.calibration[1];
        Some(self.relation.modulus(density).clamp(RANGE[0], RANGE[1]))
    }

    /// What is to be known of it, in words.
    pub fn note(&self) -> String {
        format!(
            "bone's stiffness follows the scan's density by {}, measured on trabecular bone of another site",
            self.relation.name()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::labels::Affine;

    fn slope_along_x() -> Density {
        let size = [4, 3, 2];
        let voxels = (0..24).map(|i| 100 * (i % 4) as i16).collect();
        let steps = [Vec3::x() * 2.0, Vec3::y(), Vec3::z()];
        Density {
            scan: Scan {
                size,
                voxels,
                affine: Affine::new(steps, Vec3::new(10.0, 0.0, 0.0)).unwrap(),
            },
            relation: Relation::MorganFemoralNeck,
            calibration: [1e-3, 0.1],
        }
    }

    #[test]
    fn grey_values_are_linear_between_voxels_and_end_with_the_scan() {
        let density = slope_along_x();
        for (x, grey) in [
            (10.0, 0.0),
            (13.0, 150.0),
            (16.0, 300.0),
            (9.2, 0.0),
            (16.9, 300.0),
        ] {
            let found = density.grey(&Vec3::new(x, 1.3, 0.4)).unwrap();
            assert!((found - grey).abs() < 1e-9, "{found} at {x}");
        }
        assert!(density.grey(&Vec3::new(17.1, 1.0, 0.0)).is_none());
        assert!(density.grey(&Vec3::new(12.0, -0.6, 0.0)).is_none());
    }

    /// 6850 rho^1.49 at .25 g/cm3; nothing is softer than marrow.
    #[test]
    fn the_relation_is_what_its_name_says() {
        let density = slope_along_x();
        let at = |x: f64| density.modulus(&Vec3::new(x, 1.0, 0.0)).unwrap();
        assert!((at(13.0) - 6850.0 * 0.25f64.powf(1.49)).abs() < 1e-9);
        assert_eq!(Relation::MorganVertebra.modulus(1.0), 4730.0);
        let mut empty = slope_along_x();
        empty.calibration = [1e-3, -1.0];
        assert_eq!(empty.modulus(&Vec3::new(13.0, 1.0, 0.0)), Some(RANGE[0]));
    }
}
