//! Orthotropic elasticity: nine constants and the frame in which they hold.
use super::material::MaterialError;
use crate::geometry::Vec3;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// The nine engineering constants of an orthotropic solid in its own axes 1, 2, 3.
///
/// nu_ij is the contraction along j over the stretch along i under a pull along i: nu_ij / E_i = nu_ji / E_j.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EngineeringConstants {
    /// Young's modulus along axis 1 \[MPa\].
    pub e1: f64,
    /// Young's modulus along axis 2 \[MPa\].
    pub e2: f64,
    /// Young's modulus along axis 3 \[MPa\].
    pub e3: f64,
    /// Poisson's ratio of a pull along 1, seen along 2.
    pub nu12: f64,
    /// Poisson's ratio of a pull along 2, seen along 3.
    pub nu23: f64,
    /// Poisson's ratio of a pull along 1, seen along 3.
    pub nu13: f64,
    /// Shear modulus between axes 1 and 2 \[MPa\].
    pub g12: f64,
    /// Shear modulus between axes 2 and 3 \[MPa\].
    pub g23: f64,
    /// Shear modulus between axes 1 and 3 \[MPa\].
    pub g13: f64,
}

impl EngineeringConstants {
    /// Those of an isotropic solid.
    pub fn isotropic(young_modulus: f64, poisson_ratio: f64) -> Self {
        let (e, nu) = (young_modulus, poisson_ratio);
        let g = e / (2.0 * (1.0 + nu));
        Self {
            e1: e,
            e2: e,
            e3: e,
            nu12: nu,
            nu23: nu,
            nu13: nu,
            g12: g,
            g23: g,
            g13: g,
        }
    }

    /// Checks that every deformation costs energy.
    ///
    /// # Errors
    /// [`MaterialError`] names the first constant or condition that does not hold.
    pub fn check(&self) -> Result<(), MaterialError> {
        for (name, value) in [
            ("e1", self.e1),
            ("e2", self.e2),
            ("e3", self.e3),
            ("g12", self.g12),
            ("g23", self.g23),
            ("g13", self.g13),
        ] {
            // Squares and products of moduli must stay finite.
            if !(value > 0.0 && value < 1e100) {
                return Err(MaterialError::Modulus { name, value });
            }
        }
        for (name, value, over, ei, ej) in [
            ("nu12", self.nu12, "e1 / e2", self.e1, self.e2),
            ("nu23", self.nu23, "e2 / e3", self.e2, self.e3),
            ("nu13", self.nu13, "e1 / e3", self.e1, self.e3),
        ] {
            let limit = (ei / ej).sqrt();
            if value.is_nan() || value.abs() >= limit {
                return Err(MaterialError::Contraction {
                    name,
                    value,
                    over,
                    limit,
                });
            }
        }
        let rest = self.determinant();
        // So close to zero the stiffness has no digits left.
        if rest > 1e-9 {
            Ok(())
        } else {
            Err(MaterialError::Contractions(rest))
        }
    }

    /// E1 E2 E3 times the determinant of the compliance of normal strains.
    fn determinant(&self) -> f64 {
        let (nu21, nu32, nu31) = (
            self.nu12 * self.e2 / self.e1,
            self.nu23 * self.e3 / self.e2,
            self.nu13 * self.e3 / self.e1,
        );
        1.0 - self.nu12 * nu21 - self.nu23 * nu32 - self.nu13 * nu31 - 2.0 * nu21 * nu32 * self.nu13
    }

    /// Normal strains of unit normal stresses \[1/MPa\].
    fn compliance(&self) -> Matrix3<f64> {
        let (s12, s23, s13) = (
            -self.nu12 / self.e1,
            -self.nu23 / self.e2,
            -self.nu13 / self.e1,
        );
        Matrix3::new(
            1.0 / self.e1,
            s12,
            s13,
            s12,
            1.0 / self.e2,
            s23,
            s13,
            s23,
            1.0 / self.e3,
        )
    }
}

/// An orthotropic law with its axes: positive definite by construction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orthotropic {
    /// Normal stresses of unit normal strains \[MPa\].
    normal: Matrix3<f64>,
    /// Shear moduli G23, G13, G12 \[MPa\]: of the pair of axes that leaves out 1, 2, 3.
    shear: Vec3,
    /// Axes 1, 2, 3 as columns.
    axes: Matrix3<f64>,
}

impl Orthotropic {
    /// `first`: axis 1; `second`: a vector whose part square to axis 1 gives axis 2; axis 3 = 1 x 2. Their lengths do not matter.
    ///
    /// # Errors
    /// As [`EngineeringConstants::check`]; [`MaterialError::Axes`] if the two vectors are parallel or zero.
    pub fn new(
        constants: &EngineeringConstants,
        first: &Vec3,
        second: &Vec3,
    ) -> Result<Self, MaterialError> {
        constants.check()?;
        Ok(Self {
            normal: constants
                .compliance()
                .try_inverse()
                .ok_or_else(|| MaterialError::Contractions(constants.determinant()))?,
            shear: Vec3::new(constants.g23, constants.g13, constants.g12),
            axes: right_handed(first, second).ok_or(MaterialError::Axes)?,
        })
    }

    /// The mean of this law and `other`'s stiffness: `share` of this one, in this one's axes. The result is orthotropic if `other`
    /// is isotropic or has the same axes.
    pub fn mixed_with_isotropic(&self, share: f64, young_modulus: f64, poisson_ratio: f64) -> Self {
        let other = super::TetMaterial::isotropic(young_modulus, poisson_ratio, 1.0).lame();
        let bulk =
            Matrix3::from_element(other.lambda) + Matrix3::from_diagonal_element(2.0 * other.mu);
        Self {
            normal: self.normal * share + bulk * (1.0 - share),
            shear: self.shear * share + Vec3::repeat(other.mu) * (1.0 - share),
            axes: self.axes,
        }
    }

    /// Axes 1, 2, 3 as columns.
    pub fn axes(&self) -> &Matrix3<f64> {
        &self.axes
    }

    /// Shear modulus of the pair of different axes `i`, `j`.
    fn shear_of(&self, i: usize, j: usize) -> f64 {
        self.shear[3 - i - j]
    }

    /// As [`stiffness::block`](super::stiffness::block).
    pub fn block(&self, ga: &Vec3, gb: &Vec3) -> Matrix3<f64> {
        let (a, b) = (self.axes.tr_mul(ga), self.axes.tr_mul(gb));
        let own = Matrix3::from_fn(|i, j| {
            if i == j {
                let others = (0..3).filter(|k| *k != i);
                let shear: f64 = others.map(|k| self.shear_of(i, k) * a[k] * b[k]).sum();
                self.normal[(i, i)] * a[i] * b[i] + shear
            } else {
                self.normal[(i, j)] * a[i] * b[j] + self.shear_of(i, j) * a[j] * b[i]
            }
        });
        self.axes * own * self.axes.transpose()
    }

    /// Cauchy stress \[MPa\] of small strains.
    pub fn stress(&self, grad_u: &Matrix3<f64>) -> Matrix3<f64> {
        let own = self.axes.transpose() * (grad_u + grad_u.transpose()) * (0.5 * self.axes);
        let normal = self.normal * own.diagonal();
        let stress = Matrix3::from_fn(|i, j| {
            if i == j {
                normal[i]
            } else {
                2.0 * self.shear_of(i, j) * own[(i, j)]
            }
        });
        self.axes * stress * self.axes.transpose()
    }

    /// Young's modulus \[MPa\] and Poisson's ratio of the isotropic solid nearest to it: the mean of the bounds of Voigt and
    /// Reuss over all directions (Hill 1952).
    pub fn isotropic_mean(&self) -> (f64, f64) {
        let compliance = self.normal.try_inverse().unwrap_or_else(Matrix3::zeros);
        let pairs = |m: &Matrix3<f64>| m[(0, 1)] + m[(1, 2)] + m[(0, 2)];
        let (c, s) = (self.normal.trace(), compliance.trace());
        let (cp, sp) = (pairs(&self.normal), pairs(&compliance));
        let voigt = (
            (c + 2.0 * cp) / 9.0,
            (c - cp) / 15.0 + self.shear.sum() / 5.0,
        );
        let soft: f64 = self.shear.iter().map(|g| 1.0 / g).sum();
        let reuss = (1.0 / (s + 2.0 * sp), 15.0 / (4.0 * (s - sp) + 3.0 * soft));
        let (bulk, shear) = (0.5 * (voigt.0 + reuss.0), 0.5 * (voigt.1 + reuss.1));
        let young = 9.0 * bulk * shear / (3.0 * bulk + shear);
        (young, young / (2.0 * shear) - 1.0)
    }
}

/// Unit vectors along `first`, along the part of `second` square to it, and square to both; `None` if they are parallel.
fn right_handed(first: &Vec3, second: &Vec3) -> Option<Matrix3<f64>> {
    let one = first.try_normalize(1e-150)?;
    let second = second.try_normalize(1e-150)?;
    // Nearer than this to parallel, axis 2 would be round-off.
    let two = (second - one * one.dot(&second)).try_normalize(1e-6)?;
    Some(Matrix3::from_columns(&[one, two, one.cross(&two)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::{TetMaterial, stiffness};
    use nalgebra::{Rotation3, Unit};

    fn bone() -> EngineeringConstants {
        EngineeringConstants {
            e1: 20_000.0,
            e2: 13_000.0,
            e3: 11_000.0,
            nu12: 0.35,
            nu23: 0.4,
            nu13: 0.3,
            g12: 6000.0,
            g23: 4500.0,
            g13: 5500.0,
        }
    }

    fn gradient() -> Matrix3<f64> {
        Matrix3::new(0.1, 0.3, -0.2, 0.05, -0.2, 0.4, 0.3, -0.1, 0.15)
    }

    #[test]
    fn equal_constants_are_isotropic() {
        let law = Orthotropic::new(
            &EngineeringConstants::isotropic(1000.0, 0.3),
            &Vec3::new(1.0, 2.0, 0.5),
            &Vec3::new(0.0, 1.0, 3.0),
        )
        .unwrap();
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        let (a, b) = (Vec3::new(0.3, -0.2, 0.7), Vec3::new(-0.5, 0.1, 0.2));
        let block = stiffness::block(&lame, &a, &b);
        assert!((law.block(&a, &b) - block).norm() < 1e-12 * block.norm());
        let stress = stiffness::stress(&lame, &gradient());
        assert!((law.stress(&gradient()) - stress).norm() < 1e-12 * stress.norm());
        let (young, poisson) = law.isotropic_mean();
        assert!((young - 1000.0).abs() < 1e-9 && (poisson - 0.3).abs() < 1e-12);
    }

    /// Turning the axes and the deformation turns the stress.
    #[test]
    fn the_law_turns_with_its_axes() {
        let (one, two) = (Vec3::new(1.0, 0.2, 0.1), Vec3::new(0.0, 1.0, 0.4));
        let law = Orthotropic::new(&bone(), &one, &two).unwrap();
        let r = Rotation3::from_axis_angle(&Unit::new_normalize(Vec3::new(0.3, -0.5, 0.8)), 1.1);
        let r = *r.matrix();
        let turned = Orthotropic::new(&bone(), &(r * one), &(r * two)).unwrap();
        let expected = r * law.stress(&gradient()) * r.transpose();
        let stress = turned.stress(&(r * gradient() * r.transpose()));
        assert!((stress - expected).norm() < 1e-12 * expected.norm());
    }

    /// A pull along each axis stretches by 1 / E and contracts by nu / E; shear is 2 G times the strain.
    #[test]
    fn constants_mean_what_they_say() {
        let law = Orthotropic::new(&bone(), &Vec3::x(), &Vec3::y()).unwrap();
        let c = bone();
        let strain = Matrix3::from_diagonal(&Vec3::new(1.0, -c.nu12, -c.nu13)) / c.e1;
        let stress = law.stress(&strain);
        let pull = Matrix3::from_diagonal(&Vec3::x());
        assert!((stress - pull).norm() < 1e-12, "{stress}");
        let mut strain = Matrix3::zeros();
        strain[(1, 2)] = 1.0;
        let stress = law.stress(&strain);
        assert!((stress[(1, 2)] - c.g23).abs() < 1e-9 && stress[(0, 1)] == 0.0);
    }

    /// Blocks are the second derivatives of the energy, so that assembly and stress are one law.
    #[test]
    fn blocks_and_stress_are_one_law() {
        let law = Orthotropic::new(&bone(), &Vec3::new(1.0, 1.0, 0.2), &Vec3::z()).unwrap();
        let g = [
            Vec3::new(-0.3, -0.2, -0.7),
            Vec3::new(0.5, 0.1, 0.0),
            Vec3::new(-0.1, 0.4, 0.2),
            Vec3::new(-0.1, -0.3, 0.5),
        ];
        let u = [
            Vec3::new(0.1, 0.2, 0.3),
            Vec3::new(-0.2, 0.1, 0.0),
            Vec3::new(0.3, -0.1, 0.2),
            Vec3::new(0.0, 0.2, -0.3),
        ];
        let grad = stiffness::displacement_gradient(&g, &u);
        for a in 0..4 {
            let force = law.stress(&grad) * g[a];
            let blocks: Vec3 = (0..4).map(|b| law.block(&g[a], &g[b]) * u[b]).sum();
            assert!((force - blocks).norm() < 1e-12 * force.norm());
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_named() {
        for (change, part) in [
            (
                (|c| c.e2 = -1.0) as fn(&mut EngineeringConstants),
                "e2 is -1",
            ),
            (|c| c.g13 = 0.0, "g13 is 0"),
            (|c| c.e3 = f64::NAN, "e3 is NaN"),
            (|c| c.nu12 = 1.25, "nu12 is 1.25"),
            (|c| c.nu13 = f64::NAN, "nu13 is NaN"),
            (
                |c| (c.nu12, c.nu23, c.nu13) = (0.8, 0.8, 0.8),
                "nu12, nu23 and nu13 together",
            ),
        ] {
            let mut c = bone();
            change(&mut c);
            let error = c.check().unwrap_err().to_string();
            assert!(error.starts_with(part), "{error}");
        }
        let error = Orthotropic::new(&bone(), &Vec3::x(), &(-2.0 * Vec3::x())).unwrap_err();
        assert_eq!(error, MaterialError::Axes);
    }
}
