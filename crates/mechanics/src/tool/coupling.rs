use crate::contact::{Matrix6, Wrench};
use crate::geometry::{Pose, Vec3};
use nalgebra::Matrix3;

/// A 6-dof spring between a tool and the hand's device, in bone units, which saturates where the device does.
///
/// The force along the distance d is `F_max tanh(k d / F_max)`: stiffness k for small d, never above `F_max`; the torque
/// alike along the rotation vector (Barbic & James 2008 saturate the same way, with another curve).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    linear: Spring,
    angular: Spring,
}

/// Why a coupling was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("coupling {name} is {value}; it must be a positive number")]
pub struct CouplingError {
    name: &'static str,
    value: f64,
}

/// What the spring does at one pose.
#[derive(Clone, Copy, Debug)]
pub struct CouplingResponse {
    /// On the tool, about its origin: minus the gradient of `energy`.
    pub wrench: Wrench,
    /// \[N mm\]
    pub energy: f64,
    /// Minus the derivative of the wrench by the tool's motion (translation above rotation, about its origin). Its
    /// rotational block has a skew part, as rotations do not commute; the gradient's own curvature is the symmetric part.
    pub stiffness: Matrix6,
    /// Share of the largest force in use, 0 to 1.
    pub force_saturation: f64,
    /// Share of the largest torque in use, 0 to 1.
    pub torque_saturation: f64,
}

impl CouplingResponse {
    /// Tool and device agree.
    pub const NONE: Self = Self {
        wrench: Wrench::ZERO,
        energy: 0.0,
        stiffness: Matrix6::from_array_storage(nalgebra::ArrayStorage([[0.0; 6]; 6])),
        force_saturation: 0.0,
        torque_saturation: 0.0,
    };
}

impl Coupling {
    /// Stiffnesses \[N/mm\], \[N mm/rad\] and limits \[N\], \[N mm\], all in bone units.
    ///
    /// # Errors
    /// [`CouplingError`] unless all are positive numbers.
    pub fn new(
        linear_stiffness: f64,
        angular_stiffness: f64,
        max_force: f64,
        max_torque: f64,
    ) -> Result<Self, CouplingError> {
        let positive = |name, value: f64| {
            let ok = value > 0.0 && value.is_finite();
            if ok {
                Ok(value)
            } else {
                Err(CouplingError { name, value })
            }
        };
        Ok(Self {
            linear: Spring {
                stiffness: positive("linear_stiffness", linear_stiffness)?,
                limit: positive("max_force", max_force)?,
            },
            angular: Spring {
                stiffness: positive("angular_stiffness", angular_stiffness)?,
                limit: positive("max_torque", max_torque)?,
            },
        })
    }

    /// Largest force \[N\].
    pub fn max_force(&self) -> f64 {
        self.linear.limit
    }

    /// Largest torque \[N mm\].
    pub fn max_torque(&self) -> f64 {
        self.angular.limit
    }

    /// The spring's wrench on the tool at `world_from_tool`, drawn to the device's pose.
    pub fn respond(&self, world_from_device: &Pose, world_from_tool: &Pose) -> CouplingResponse {
        let way = world_from_device.translation.vector - world_from_tool.translation.vector;
        let turn = (world_from_device.rotation * world_from_tool.rotation.inverse()).scaled_axis();
        let (pull, twist) = (self.linear.at(&way), self.angular.at(&turn));
        let mut stiffness = Matrix6::zeros();
        stiffness
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&pull.stiffness);
        stiffness
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(twist.stiffness * inverse_right_jacobian(&turn)));
        CouplingResponse {
            wrench: Wrench {
                force: pull.force,
                torque: twist.force,
            },
            energy: pull.energy + twist.energy,
            stiffness,
            force_saturation: pull.saturation,
            torque_saturation: twist.saturation,
        }
    }
}

/// A spring of three dimensions that saturates.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spring {
    stiffness: f64,
    limit: f64,
}

struct SpringResponse {
    force: Vec3,
    energy: f64,
    /// Derivative of the force by the way.
    stiffness: Matrix3<f64>,
    saturation: f64,
}

impl Spring {
    fn at(&self, way: &Vec3) -> SpringResponse {
        let length = way.norm();
        let (k, limit) = (self.stiffness, self.limit);
        let x = k * length / limit;
        let saturation = x.tanh();
        // Along the way f' = k (1 - tanh^2), across it f / d.
        let along = k * (1.0 - saturation * saturation);
        let across = if x < 1e-6 {
            k
        } else {
            limit * saturation / length
        };
        let direction = if length > 0.0 { way / length } else { *way };
        let stiffness = Matrix3::from_diagonal_element(across)
            + (along - across) * direction * direction.transpose();
        SpringResponse {
            force: direction * (limit * saturation),
            energy: limit * limit / k * ln_cosh(x),
            stiffness,
            saturation,
        }
    }
}

/// `ln cosh x` for x >= 0 without overflow, nor loss near 0.
fn ln_cosh(x: f64) -> f64 {
    if x < 1e-4 {
        return 0.5 * x * x;
    }
    x + (-2.0 * x).exp().ln_1p() - std::f64::consts::LN_2
}

/// How the rotation vector t of `R_device R_tool^-1` answers a small rotation w of the tool: `dt = -J w`.
///
/// `J = I + [t]/2 + (1 - (|t|/2) cot(|t|/2)) [t]^2 / |t|^2`; finite up to |t| = pi.
fn inverse_right_jacobian(t: &Vec3) -> Matrix3<f64> {
    let cross = t.cross_matrix();
    let angle2 = t.norm_squared();
    let c = if angle2 < 1e-6 {
        1.0 / 12.0
    } else {
        let half = 0.5 * angle2.sqrt();
        (1.0 - half / half.tan()) / angle2
    };
    Matrix3::identity() + 0.5 * cross + c * cross * cross
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn coupling() -> Coupling {
        Coupling::new(160.0, 12_000.0, 660.0, 4_700.0).unwrap()
    }

    fn pose(t: Vec3, r: Vec3) -> Pose {
        Pose::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(r))
    }

    /// Repeatable numbers in [-1, 1].
    fn noise(seed: u32) -> impl FnMut() -> f64 {
        let mut state = u64::from(seed).wrapping_mul(2) + 1;
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }
    }

    fn random_pose(next: &mut impl FnMut() -> f64, reach: f64, angle: f64) -> Pose {
        let t = Vec3::from_fn(|_, _| next()) * reach;
        let r = Vec3::from_fn(|_, _| next()).normalize() * next() * angle;
        pose(t, r)
    }

    #[test]
    fn never_exceeds_its_limits() {
        let (c, mut next) = (coupling(), noise(1));
        for i in 0..20_000 {
            let reach = 10f64.powi(i % 12 - 4);
            let device = random_pose(&mut next, reach, std::f64::consts::PI);
            let tool = random_pose(&mut next, reach, std::f64::consts::PI);
            let r = c.respond(&device, &tool);
            assert!(r.wrench.force.norm() <= 660.0 * (1.0 + 1e-14));
            assert!(r.wrench.torque.norm() <= 4_700.0 * (1.0 + 1e-14));
            assert!(r.wrench.is_finite() && r.energy.is_finite() && r.energy >= 0.0);
        }
    }

    #[test]
    fn small_motions_feel_the_stiffness_and_force_grows_with_distance() {
        let c = coupling();
        let force = |d: f64| {
            let device = pose(Vec3::new(0.0, d, 0.0), Vec3::zeros());
            c.respond(&device, &Pose::identity()).wrench.force.y
        };
        assert!((force(1e-3) / 0.16 - 1.0).abs() < 1e-6);
        let mut last = 0.0;
        for i in 1..200 {
            let f = force(0.1 * f64::from(i));
            assert!(f >= last && f <= 660.0);
            last = f;
        }
    }

    #[test]
    fn a_half_turn_is_finite_and_full() {
        for axis in [Vec3::x(), Vec3::y(), Vec3::new(0.6, 0.0, -0.8)] {
            let device = pose(Vec3::zeros(), axis * std::f64::consts::PI);
            let r = coupling().respond(&device, &Pose::identity());
            assert!(r.wrench.is_finite() && r.stiffness.iter().all(|v| v.is_finite()));
            let expected = 4_700.0 * (12_000.0 * std::f64::consts::PI / 4_700.0).tanh();
            assert!((r.wrench.torque.norm() - expected).abs() < 1e-6);
        }
    }

    /// Wrench = minus the gradient of the energy, and stiffness = minus the derivative of the wrench.
    #[test]
    fn derivatives_by_finite_differences() {
        let (c, mut next) = (coupling(), noise(7));
        let h = 1e-5;
        for _ in 0..200 {
            let device = random_pose(&mut next, 5.0, 2.5);
            let tool = random_pose(&mut next, 5.0, 0.5);
            let moved = |k: usize, h: f64| {
                let mut x = [Vec3::zeros(), Vec3::zeros()];
                x[k / 3][k % 3] = h;
                let t = tool.translation.vector + x[0];
                let r = UnitQuaternion::from_scaled_axis(x[1]) * tool.rotation;
                c.respond(&device, &Pose::from_parts(Translation3::from(t), r))
            };
            let here = c.respond(&device, &tool);
            for k in 0..6 {
                let (hi, lo) = (moved(k, h), moved(k, -h));
                let slope = -(hi.energy - lo.energy) / (2.0 * h);
                let wrench = here.wrench.to_vector();
                assert!((slope - wrench[k]).abs() < 1e-4 * (1.0 + wrench.norm()));
                let column = -(hi.wrench.to_vector() - lo.wrench.to_vector()) / (2.0 * h);
                let error = (column - here.stiffness.column(k)).norm();
                assert!(error < 1e-4 * (160.0 + column.norm()), "{error}");
            }
        }
    }

    #[test]
    fn bad_numbers_are_named() {
        let e = Coupling::new(160.0, -1.0, 660.0, 4_700.0).unwrap_err();
        assert_eq!(
            e.to_string(),
            "coupling angular_stiffness is -1; it must be a positive number"
        );
    }
}
