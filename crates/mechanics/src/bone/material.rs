use super::orthotropy::Orthotropic;
use super::stiffness;
use crate::geometry::Vec3;
use nalgebra::Matrix3;

/// Elasticity and toughness of one tetrahedron, already mixed by volume fraction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetMaterial {
    /// Young's modulus E \[MPa\]; of an orthotropic material that of its isotropic mean.
    pub young_modulus: f64,
    /// Poisson's ratio nu; of an orthotropic material that of its isotropic mean.
    pub poisson_ratio: f64,
    /// The elastic law where it is not isotropic.
    pub orthotropic: Option<Orthotropic>,
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
    /// A modulus of an orthotropic material.
    #[error("{name} is {value}; it must be positive and finite [MPa]")]
    Modulus {
        /// Which constant.
        name: &'static str,
        /// What it is.
        value: f64,
    },
    /// A Poisson's ratio of an orthotropic material by itself.
    #[error(
        "{name} is {value}; not positive definite: its size must be below sqrt({over}) = {limit:.4}"
    )]
    Contraction {
        /// Which constant.
        name: &'static str,
        /// What it is.
        value: f64,
        /// The ratio under the root.
        over: &'static str,
        /// The root.
        limit: f64,
    },
    /// The three Poisson's ratios of an orthotropic material.
    #[error(
        "nu12, nu23 and nu13 together are too large; not positive definite: 1 - nu12 nu21 - nu23 nu32 - nu13 nu31 - 2 nu21 nu32 nu13 is {0:.4} and must be above 0"
    )]
    Contractions(f64),
    /// Axes of an orthotropic material.
    #[error("the two directions of the axes are parallel or zero; give two that are not")]
    Axes,
    /// Toughness.
    #[error("toughness is {0}; it must be positive and finite [N/mm]")]
    Toughness(f64),
}

/// Lame's constants \[MPa\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lame {
    /// First constant.
    pub lambda: f64,
    /// Shear modulus.
    pub mu: f64,
}

/// An elastic law, ready for many evaluations.
#[derive(Clone, Copy, Debug)]
pub enum Elasticity {
    /// The same in all directions.
    Isotropic(Lame),
    /// With three planes of symmetry.
    Orthotropic(Orthotropic),
}

impl Elasticity {
    /// As [`stiffness::block`].
    pub fn block(&self, ga: &Vec3, gb: &Vec3) -> Matrix3<f64> {
        match self {
            Self::Isotropic(lame) => stiffness::block(lame, ga, gb),
            Self::Orthotropic(law) => law.block(ga, gb),
        }
    }

    /// Cauchy stress \[MPa\] of small strains.
    pub fn stress(&self, grad_u: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            Self::Isotropic(lame) => stiffness::stress(lame, grad_u),
            Self::Orthotropic(law) => law.stress(grad_u),
        }
    }
}

impl TetMaterial {
    /// An isotropic material of one toughness.
    pub fn isotropic(young_modulus: f64, poisson_ratio: f64, toughness: f64) -> Self {
        Self {
            young_modulus,
            poisson_ratio,
            orthotropic: None,
            toughness_along: toughness,
            toughness_across: toughness,
            osteon: Vec3::z(),
        }
    }

    /// An orthotropic material of one toughness; its osteons run along axis 1.
    pub fn orthotropic(law: Orthotropic, toughness: f64) -> Self {
        let (young_modulus, poisson_ratio) = law.isotropic_mean();
        Self {
            orthotropic: Some(law),
            osteon: law.axes().column(0).into(),
            ..Self::isotropic(young_modulus, poisson_ratio, toughness)
        }
    }

    /// The elastic law.
    pub fn elasticity(&self) -> Elasticity {
        match self.orthotropic {
            None => Elasticity::Isotropic(self.lame()),
            Some(law) => Elasticity::Orthotropic(law),
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

    /// Lame's constants; of an orthotropic material those of its isotropic mean.
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
