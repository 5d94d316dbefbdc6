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
        let sense = if m.osteon.dot(&self.osteon) < 0.0 {
            -weight
        } else {
            weight
        };
        self.osteon += m.osteon * sense;
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
