//! The fields near a crack front that interaction integrals weigh the real field with.
use super::front::{LocalFrame, Place};
use crate::bone::{Lame, stiffness};
use crate::geometry::Vec3;
use nalgebra::Matrix3;

/// Which face of the crack a point behind the front belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Side {
    Above,
    Below,
    /// As its position says.
    Plain,
}

/// The field of a unit stress intensity at a point, in world axes.
pub(super) struct Auxiliary {
    /// Displacement gradient, turned with the front's frame.
    pub grad_u: Matrix3<f64>,
    /// Strain by Hooke's law from `stress`: that of a straight front.
    pub strain: Matrix3<f64>,
    pub stress: Matrix3<f64>,
    /// div stress.
    pub body_force: Vec3,
    /// d/dq of sym grad_u - strain.
    pub misfit_slope: Matrix3<f64>,
}

/// The fields of unit K_I, K_II, K_III beside a front of constant in-plane curvature.
///
/// Along t the frame turns: dq/dt = t / rho, dt/dt = - q / rho with rho = 1 / curvature + x.
pub(super) fn auxiliary(
    place: &Place,
    frame: &LocalFrame,
    side: Side,
    lame: &Lame,
) -> [Auxiliary; 3] {
    let axes = Matrix3::from_columns(&[
        frame.advance,
        frame.normal,
        frame.advance.cross(&frame.normal),
    ]);
    let turned = |m: Matrix3<f64>| axes * m * axes.transpose();
    let per_rho = frame.curvature / (1.0 + frame.curvature * place.x).max(0.15);
    williams(place.x, place.y, side, lame).map(|w| {
        let strain = (w.gradient + w.gradient.transpose()) * 0.5;
        let stress = stiffness::stress(lame, &w.gradient);
        let mut gradient = w.gradient;
        gradient[(2, 2)] += w.u.x * per_rho;
        gradient[(0, 2)] -= w.u.z * per_rho;
        let mut slope = Matrix3::zeros();
        let slide = |u: f64, du: f64| (du - u * per_rho) * per_rho;
        slope[(2, 2)] = slide(w.u.x, w.gradient[(0, 0)]);
        slope[(0, 2)] = -0.5 * slide(w.u.z, w.gradient[(2, 0)]);
        slope[(2, 0)] = slope[(0, 2)];
        let force = Vec3::new(
            stress[(0, 0)] - stress[(2, 2)],
            stress[(0, 1)],
            2.0 * stress[(0, 2)],
        ) * per_rho;
        Auxiliary {
            grad_u: turned(gradient),
            strain: turned(strain),
            stress: turned(stress),
            body_force: axes * force,
            misfit_slope: turned(slope),
        }
    })
}

/// d/dq of the stresses of unit K_I, K_II, K_III beside a straight front, in world axes.
pub(super) fn stress_slopes(
    place: &Place,
    frame: &LocalFrame,
    side: Side,
    lame: &Lame,
) -> [Matrix3<f64>; 3] {
    let d = 1e-4 * place.x.hypot(place.y);
    let at = |shift: f64| {
        let place = Place {
            x: place.x + shift,
            ..*place
        };
        auxiliary(&place, frame, side, lame).map(|aux| aux.stress)
    };
    let (ahead, behind) = (at(d), at(-d));
    [0, 1, 2].map(|m| (ahead[m] - behind[m]) / (2.0 * d))
}

/// Displacement and its gradient in the frame of a straight front.
pub(super) struct Williams {
    u: Vec3,
    pub(super) gradient: Matrix3<f64>,
}

/// Williams' fields of unit K_I, K_II, K_III at (x, y), plane strain. Behind the front the side decides on which sheet of the
/// square root a point lies; past the plane of the front the fields are continued.
pub(super) fn williams(x: f64, y: f64, side: Side, lame: &Lame) -> [Williams; 3] {
    use std::f64::consts::PI;
    let r = x.hypot(y).max(1e-9);
    let plain = y.atan2(x);
    let theta = match side {
        Side::Above if x < 0.0 && y < 0.0 => plain + 2.0 * PI,
        Side::Below if x < 0.0 && y >= 0.0 => plain - 2.0 * PI,
        _ => plain,
    };
    let nu = lame.lambda / (2.0 * (lame.lambda + lame.mu));
    let kappa = 3.0 - 4.0 * nu;
    let (s, c) = (0.5 * theta).sin_cos();
    let (sin, cos) = theta.sin_cos();
    let scale = 1.0 / (2.0 * PI * r).sqrt();
    // A displacement factor sqrt(r / 2 pi) f(theta), given f and df/dtheta: value and gradient.
    let row = |factor: f64, f: f64, df: f64| {
        let v = factor * scale;
        (
            v * r * f,
            [
                v * (0.5 * cos * f - sin * df),
                v * (0.5 * sin * f + cos * df),
            ],
        )
    };
    let field = |rows: [(f64, [f64; 2]); 3]| Williams {
        u: Vec3::new(rows[0].0, rows[1].0, rows[2].0),
        gradient: Matrix3::from_fn(|i, j| if j < 2 { rows[i].1[j] } else { 0.0 }),
    };
    let plane = 0.5 / lame.mu;
    let none = (0.0, [0.0; 2]);
    [
        field([
            row(plane, c * (kappa - cos), -0.5 * s * (kappa - cos) + c * sin),
            row(plane, s * (kappa - cos), 0.5 * c * (kappa - cos) + s * sin),
            none,
        ]),
        field([
            row(
                plane,
                s * (kappa + 2.0 + cos),
                0.5 * c * (kappa + 2.0 + cos) - s * sin,
            ),
            row(
                plane,
                -c * (kappa - 2.0 + cos),
                0.5 * s * (kappa - 2.0 + cos) + c * sin,
            ),
            none,
        ]),
        field([none, none, row(2.0 / lame.mu, s, 0.5 * c)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::TetMaterial;

    /// The auxiliary fields are in equilibrium and leave the faces free: checked by finite differences.
    #[test]
    fn auxiliary_fields_are_in_equilibrium() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        let stress = |mode: usize, x: f64, y: f64| {
            stiffness::stress(&lame, &williams(x, y, Side::Plain, &lame)[mode].gradient)
        };
        let d = 1e-5;
        for mode in 0..3 {
            for (x, y) in [(0.7, 0.4), (-0.3, 0.8), (-0.5, -0.2), (0.1, -0.9)] {
                let along = (stress(mode, x + d, y) - stress(mode, x - d, y)) / (2.0 * d);
                let across = (stress(mode, x, y + d) - stress(mode, x, y - d)) / (2.0 * d);
                let force = along.column(0) + across.column(1);
                assert!(
                    force.norm() < 1e-6 * stress(mode, x, y).norm(),
                    "mode {mode} at ({x}, {y}): {force}"
                );
            }
            for y in [1e-12, -1e-12] {
                let face = stress(mode, -1.0, y).column(1).norm();
                assert!(face < 1e-8, "mode {mode}: traction {face} on the face");
            }
        }
    }

    /// Unit K_I means sigma_yy = 1 / sqrt(2 pi r) ahead of the front; likewise the others.
    #[test]
    fn auxiliary_fields_have_unit_intensity() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        for (mode, component) in [(0, (1, 1)), (1, (0, 1)), (2, (2, 1))] {
            let s = stiffness::stress(
                &lame,
                &williams(2.0, 0.0, Side::Plain, &lame)[mode].gradient,
            );
            let expected = 1.0 / (2.0 * std::f64::consts::PI * 2.0).sqrt();
            assert!(
                (s[component] - expected).abs() < 1e-12,
                "mode {mode}: {}",
                s[component]
            );
        }
    }
}
