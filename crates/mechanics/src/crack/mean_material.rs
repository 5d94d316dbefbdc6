use crate::bone::{Orthotropic, TetMaterial};
use crate::geometry::Vec3;

/// Mean of materials by weight. Osteons have no sense, so their directions are summed towards the first one met.
#[derive(Clone, Debug, Default)]
pub(super) struct MaterialSum {
    weight: f64,
    values: [f64; 4],
    osteon: Vec3,
    /// The orthotropic law of the largest part, and its weight.
    law: Option<(f64, Orthotropic)>,
    /// Least and largest Young's modulus and Poisson's ratio of the isotropic ones.
    range: Option<[(f64, f64); 2]>,
}

impl MaterialSum {
    pub fn add(&mut self, m: &TetMaterial, weight: f64) {
        self.weight += weight;
        let values = [
            m.young_modulus,
            m.poisson_ratio,
            m.toughness_along,
            m.toughness_across,
        ];
        self.values
            .iter_mut()
            .zip(values)
            .for_each(|(s, v)| *s += weight * v);
        if let Some(law) = m.orthotropic
            && self.law.is_none_or(|(w, _)| weight > w)
        {
            self.law = Some((weight, law));
        }
        if m.orthotropic.is_none() {
            let own = [m.young_modulus, m.poisson_ratio];
            let range = self.range.get_or_insert(own.map(|v| (v, v)));
            for ((least, most), v) in range.iter_mut().zip(own) {
                (*least, *most) = (least.min(v), most.max(v));
            }
        }
        let sense = if m.osteon.dot(&self.osteon) < 0.0 {
            -weight
        } else {
            weight
        };
        self.osteon += m.osteon * sense;
    }

    /// Whether all isotropic materials are the same.
    pub fn is_uniform(&self) -> bool {
        const ALIKE: f64 = 1e-9;
        let ranges = self.range.iter().flatten();
        ranges
            .clone()
            .all(|(least, most)| most - least <= ALIKE * most.abs())
    }

    pub fn mean(&self, fallback: &TetMaterial) -> TetMaterial {
        if self.weight <= 0.0 {
            return *fallback;
        }
        let [
            young_modulus,
            poisson_ratio,
            toughness_along,
            toughness_across,
        ] = self.values.map(|v| v / self.weight);
        TetMaterial {
            young_modulus,
            poisson_ratio,
            orthotropic: self.law.map(|l| l.1),
            toughness_along,
            toughness_across,
            osteon: self.osteon.try_normalize(1e-12).unwrap_or(fallback.osteon),
        }
    }
}
