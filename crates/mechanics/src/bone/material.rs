use crate::geometry::Vec3;

/// Elasticity and toughness of one tetrahedron, already mixed by volume fraction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetMaterial {
    /// Young's modulus E \[MPa\].
    pub young_modulus: f64,
    /// Poisson's ratio nu.
    pub poisson_ratio: f64,
    /// Critical energy release rate of a crack that runs between the osteons (its normal across them) \[N/mm\].
    pub toughness_along: f64,
    /// Critical energy release rate of a crack that cuts the osteons (its normal along them) \[N/mm\].
    pub toughness_across: f64,
    /// Unit direction of the osteons.
    pub osteon: Vec3,
}

/// Why a material was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum MaterialError {
    /// Young's modulus.
    #[error("young_modulus is {0}; it must be positive and finite [MPa]")]
    YoungModulus(f64),
    /// Poisson's ratio.
    #[error("poisson_ratio is {0}; it must lie between -1 and 0.5, both excluded")]
    PoissonRatio(f64),
    /// Toughness.
    #[error("toughness is {0}; it must be positive and finite [N/mm]")]
    Toughness(f64),
}

/// Lame's constants \[MPa\].
#[derive(Clone, Copy, Debug)]
pub struct Lame {
    /// First constant.
    pub lambda: f64,
    /// Shear modulus.
    pub mu: f64,
}

impl TetMaterial {
    /// An isotropic material of one toughness.
    pub fn isotropic(young_modulus: f64, poisson_ratio: f64, toughness: f64) -> Self {
        Self {
            young_modulus,
            poisson_ratio,
            toughness_along: toughness,
            toughness_across: toughness,
            osteon: Vec3::z(),
        }
    }

    /// Checks the physical ranges.
    ///
    /// # Errors
    /// [`MaterialError`] names the first value that is out of its range.
    pub fn check(&self) -> Result<(), MaterialError> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if !positive(self.young_modulus) {
            return Err(MaterialError::YoungModulus(self.young_modulus));
        }
        if !(self.poisson_ratio > -1.0 && self.poisson_ratio < 0.5) {
            return Err(MaterialError::PoissonRatio(self.poisson_ratio));
        }
        for g in [self.toughness_along, self.toughness_across] {
            if !positive(g) {
                return Err(MaterialError::Toughness(g));
            }
        }
        Ok(())
    }

    /// Lame's constants.
    pub fn lame(&self) -> Lame {
        let (e, nu) = (self.young_modulus, self.poisson_ratio);
        Lame {
            lambda: e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)),
            mu: e / (2.0 * (1.0 + nu)),
        }
    }

    /// Plane-strain modulus E' = E / (1 - nu^2) \[MPa\].
    pub fn plane_strain_modulus(&self) -> f64 {
        self.young_modulus / (1.0 - self.poisson_ratio * self.poisson_ratio)
    }

    /// Critical energy release rate of a crack with unit normal `normal` \[N/mm\].
    ///
    /// Between the two measured directions it is interpolated by the squared cosine: the simplest even, smooth choice.
    pub fn toughness(&self, normal: &Vec3) -> f64 {
        let c = self.osteon.dot(normal);
        self.toughness_along + (self.toughness_across - self.toughness_along) * c * c
    }
}
