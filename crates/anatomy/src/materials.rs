//! Cortical bone, trabecular bone and teeth, mixed in each tetrahedron by how much of it lies how deep.
use crate::cortex::CorticalRegions;
use crate::density::Density;
use crate::error::{AnatomyError, in_range};
use crate::landmarks::JawFrame;
use crate::teeth::ToothBody;
use osteotome_mechanics::bone::{EngineeringConstants, Orthotropic, TetMaterial};
use osteotome_mechanics::geometry::{Aabb, MeshDistance, TetMesh, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Stiffness and toughness of one kind of bone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tissue {
    /// \[MPa\].
    pub young_modulus: f64,
    /// Between -1 and 0.5.
    pub poisson_ratio: f64,
    /// Critical energy release rate of a crack along and across the osteons \[N/mm\].
    pub toughness: [f64; 2],
}

/// The bone's regions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaterialSpec {
    /// The outer layer.
    pub cortical: Tissue,
    /// The outer layer's elasticity if it is not isotropic: axis 1 along the jaw's centre line, axis 2 up, axis 3 across.
    pub cortical_orthotropic: Option<EngineeringConstants>,
    /// The core.
    pub trabecular: Tissue,
    /// Teeth, where their crowns reach into the bone's mesh.
    pub teeth: Tissue,
    /// Thickness of the outer layer \[mm\].
    pub cortical_thickness: f64,
    /// Its thickness by region, in place of that.
    pub cortical_regions: Option<CorticalRegions>,
}

impl Default for MaterialSpec {
    fn default() -> Self {
        Self {
            cortical: Tissue {
                young_modulus: 15_000.0,
                poisson_ratio: 0.3,
                toughness: [0.5, 2.0],
            },
            cortical_orthotropic: None,
            trabecular: Tissue {
                young_modulus: 1_500.0,
                poisson_ratio: 0.3,
                toughness: [0.2, 0.2],
            },
            // Stiffness as in published finite element studies; toughness as of cortical bone, for want of a figure for whole teeth.
            teeth: Tissue {
                young_modulus: 20_000.0,
                poisson_ratio: 0.3,
                toughness: [0.5, 2.0],
            },
            cortical_thickness: 2.2,
            cortical_regions: None,
        }
    }
}

impl MaterialSpec {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`AnatomyError::OutOfRange`] naming the first number that is not possible.
    pub fn check(&self) -> Result<(), AnatomyError> {
        for (name, tissue) in [
            ("cortical", &self.cortical),
            ("trabecular", &self.trabecular),
            ("teeth", &self.teeth),
        ] {
            let key = |field: &str| format!("material.{name}.{field}");
            in_range(&key("young_modulus"), tissue.young_modulus, 1e-3, 1e7)?;
            let nu = tissue.poisson_ratio;
            if !(nu > -1.0 && nu < 0.5) {
                return Err(AnatomyError::OutOfRange {
                    key: key("poisson_ratio"),
                    value: nu,
                    range: "it must lie above -1 and below 0.5".to_owned(),
                });
            }
            for toughness in tissue.toughness {
                in_range(&key("toughness"), toughness, 1e-6, 1e6)?;
            }
        }
        if let Some(nine) = &self.cortical_orthotropic {
            nine.check().map_err(|source| AnatomyError::Material {
                key: "material.cortical_orthotropic",
                source,
            })?;
        }
        self.cortical_regions.map_or(Ok(()), |r| r.check())?;
        in_range(
            "material.cortical_thickness",
            self.cortical_thickness,
            0.0,
            50.0,
        )
    }

    /// Materials of all tetrahedra. Every property is the volume-weighted arithmetic mean of the tissues, their shares counted
    /// at 35 points of the tetrahedron (of an orthotropic layer and the rest, the mean of the stiffnesses): tooth inside a crown, else by depth; what the mesh has outside the surface counts as cortical. Osteons follow the
    /// jaw's centre line.
    ///
    /// With `density`, Young's modulus of bone follows the scan where it reaches, in every tetrahedron as the mean of the points';
    /// all else stays by depth.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn assign(
        &self,
        mesh: &TetMesh,
        surface: &MeshDistance,
        frame: &JawFrame,
        teeth: &[&dyn ToothBody],
        density: Option<&Density>,
    ) -> Result<Vec<TetMaterial>, AnatomyError> {
        self.check()?;
        let samples = samples();
        let material = |t: usize| {
            let corners = mesh.corners(t);
            let by_density = |p: &Vec3| density.and_then(|d| d.modulus(p));
            let ([cortical, trabecular, tooth], seen) =
                self.shares(&corners, surface, frame, teeth, &samples, &by_density);
            let mix = |f: fn(&Tissue) -> f64| {
                cortical * f(&self.cortical)
                    + trabecular * f(&self.trabecular)
                    + tooth * f(&self.teeth)
            };
            let osteon = frame.along(&(corners.iter().sum::<Vec3>() * 0.25));
            let mut material = TetMaterial {
                young_modulus: seen.unwrap_or_else(|| mix(|m| m.young_modulus)),
                poisson_ratio: mix(|m| m.poisson_ratio),
                orthotropic: None,
                toughness_along: mix(|m| m.toughness[0]),
                toughness_across: mix(|m| m.toughness[1]),
                osteon,
            };
            let Some(nine) = self.cortical_orthotropic.filter(|_| cortical > 0.0) else {
                return Ok(material);
            };
            // The rest is isotropic, so the mean of the stiffnesses keeps the layer's axes.
            let rest = (1.0 - cortical).max(1e-9);
            let of_rest = |f: fn(&Tissue) -> f64| {
                (trabecular * f(&self.trabecular) + tooth * f(&self.teeth)) / rest
            };
            let law = Orthotropic::new(&nine, &osteon, &across_of(&osteon))
                .map_err(|source| AnatomyError::Material {
                    key: "material.cortical_orthotropic",
                    source,
                })?
                .mixed_with_isotropic(
                    cortical,
                    of_rest(|m| m.young_modulus),
                    of_rest(|m| m.poisson_ratio),
                );
            (material.young_modulus, material.poisson_ratio) = law.isotropic_mean();
            material.orthotropic = Some(law);
            Ok(material)
        };
        (0..mesh.tets().len())
            .into_par_iter()
            .map(material)
            .collect()
    }

    /// Thickness of the outer layer under the surface's point nearest to `p` \[mm\].
    pub fn cortex_at(&self, p: &Vec3, surface: &MeshDistance, frame: &JawFrame) -> f64 {
        let regions = self.cortical_regions;
        regions.map_or(self.cortical_thickness, |r| r.at(p, surface, frame))
    }

    /// Parts of a tetrahedron that are cortical, trabecular and tooth; and its mean modulus, if that of any bone in it is known.
    fn shares(
        &self,
        corners: &[Vec3; 4],
        surface: &MeshDistance,
        frame: &JawFrame,
        teeth: &[&dyn ToothBody],
        samples: &[[f64; 4]],
        modulus: &dyn Fn(&Vec3) -> Option<f64>,
    ) -> ([f64; 3], Option<f64>) {
        let around = Aabb::around(corners);
        let near: Vec<&&dyn ToothBody> = teeth
            .iter()
            .filter(|c| c.bounds().overlaps(&around))
            .collect();
        let mut count = [0u32; 3];
        let of_tissue = [&self.cortical, &self.trabecular, &self.teeth].map(|t| t.young_modulus);
        let (mut sum, mut is_known) = (0.0, false);
        for w in samples {
            let p: Vec3 = (0..4).map(|k| corners[k] * w[k]).sum();
            let tissue = if near.iter().any(|c| c.signed(&p) < 0.0) {
                2
            } else {
                let thickness = self.cortex_at(&p, surface, frame);
                usize::from(surface.signed(&p) <= -thickness)
            };
            count[tissue] += 1;
            let known = if tissue == 2 { None } else { modulus(&p) };
            sum += known.unwrap_or(of_tissue[tissue]);
            is_known |= known.is_some();
        }
        let n = samples.len() as f64;
        (count.map(|k| f64::from(k) / n), is_known.then_some(sum / n))
    }
}

/// A vector that, made square to the osteons, points up; where the osteons do so, as in the ramus, forwards.
/// Its sense does not matter.
fn across_of(osteon: &Vec3) -> Vec3 {
    if osteon.z.abs() < 0.9 {
        Vec3::z()
    } else {
        Vec3::y()
    }
}

/// Barycentric coordinates of 35 points that stand for about equal volumes: the centres of a tetrahedral stack of 5 layers.
fn samples() -> Vec<[f64; 4]> {
    const LAYERS: u32 = 5;
    let at = |i: u32| (f64::from(i) + 0.25) / f64::from(LAYERS);
    let mut points = Vec::new();
    for i in 0..LAYERS {
        for j in 0..LAYERS - i {
            for k in 0..LAYERS - i - j {
                let l = LAYERS - 1 - i - j - k;
                points.push([at(i), at(j), at(k), at(l)]);
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_inside_and_balanced() {
        let samples = samples();
        assert_eq!(samples.len(), 35);
        let mut mean = [0.0; 4];
        for w in &samples {
            assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12 && w.iter().all(|c| *c > 0.0));
            (0..4).for_each(|k| mean[k] += w[k] / 35.0);
        }
        assert!(mean.iter().all(|m| (m - 0.25).abs() < 1e-12));
    }

    #[test]
    fn impossible_materials_are_named() {
        let mut spec = MaterialSpec::default();
        spec.cortical.young_modulus = -3.0;
        let text = spec.check().unwrap_err().to_string();
        assert!(
            text.starts_with("material.cortical.young_modulus = -3 is outside its range"),
            "{text}"
        );
        let mut spec = MaterialSpec::default();
        spec.trabecular.poisson_ratio = 0.5;
        let text = spec.check().unwrap_err().to_string();
        assert_eq!(
            text,
            "material.trabecular.poisson_ratio = 0.5 is outside its range; it must lie above -1 and below 0.5"
        );
    }
}
