use crate::geometry::Vec3;

/// Force above torque, or translation above rotation.
pub type Vector6 = nalgebra::SVector<f64, 6>;
/// Maps a small motion (translation above rotation) to a wrench.
pub type Matrix6 = nalgebra::SMatrix<f64, 6, 6>;

/// A force and a torque about the tool's origin, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// \[N\]
    pub force: Vec3,
    /// About the tool's origin \[N mm\].
    pub torque: Vec3,
}

impl Default for Wrench {
    fn default() -> Self {
        Self::ZERO
    }
}

impl Wrench {
    /// No force, no torque.
    pub const ZERO: Self = Self {
        force: Vec3::new(0.0, 0.0, 0.0),
        torque: Vec3::new(0.0, 0.0, 0.0),
    };

    /// Force above torque.
    pub fn to_vector(&self) -> Vector6 {
        let (f, t) = (&self.force, &self.torque);
        Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
    }

    /// From force above torque.
    pub fn from_vector(v: &Vector6) -> Self {
        Self {
            force: v.fixed_rows::<3>(0).into(),
            torque: v.fixed_rows::<3>(3).into(),
        }
    }

    /// Whether every component is a finite number.
    pub fn is_finite(&self) -> bool {
        self.force.iter().chain(&self.torque).all(|c| c.is_finite())
    }
}

impl std::ops::Add for Wrench {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            force: self.force + other.force,
            torque: self.torque + other.torque,
        }
    }
}

impl std::ops::Mul<f64> for Wrench {
    type Output = Self;

    fn mul(self, by: f64) -> Self {
        Self {
            force: self.force * by,
            torque: self.torque * by,
        }
    }
}

impl std::ops::Neg for Wrench {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            force: -self.force,
            torque: -self.torque,
        }
    }
}
