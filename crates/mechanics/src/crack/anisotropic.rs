//! What the interaction with isotropic fields means in an anisotropic body: from its integrals to the stress intensity factors.
//!
//! Near a front both the body's field and the auxiliary one go with 1 / sqrt(r), so the interaction through a circle round the front
//! does not depend on its radius, though the two fields obey different laws, and a plateau domain integral has the value of any of
//! its circles. It is linear in K_I, K_II, K_III: the 3 x 3 matrix is integrated here round a circle, with the body's own field by
//! Stroh's formalism (Stroh 1958; Ting 1996), and solved for K.
use super::criterion::StressIntensity;
use super::williams::{Side, williams};
use crate::bone::{Lame, Orthotropic, stiffness};
use nalgebra::{Complex, Matrix3, Matrix6, Vector3};

type C = Complex<f64>;

/// Fields near a straight front in one frame of an orthotropic law.
pub(super) struct NearField {
    /// The law's stress of a gradient in the front's frame.
    law: Orthotropic,
    /// Front's axes q, n, t as columns.
    axes: Matrix3<f64>,
    /// Stroh's eigenvalues with positive imaginary part.
    p: Vector3<C>,
    /// Displacement vectors of the eigenvalues as columns.
    a: Matrix3<C>,
    /// Inverse of the stress function vectors.
    b_inverse: Matrix3<C>,
}

/// Tractions on the plane of the crack, in the order of the frame's axes, of unit K_I, K_II, K_III.
const MODES: [usize; 3] = [1, 0, 2];

impl NearField {
    /// `axes`: q, n, t as columns. `None` if the eigenvalue problem fails, which no positive definite law should make it do.
    pub(super) fn new(law: &Orthotropic, axes: &Matrix3<f64>) -> Option<Self> {
        let [q, r, t] = stroh_matrices(law, axes);
        let t_inverse = t.try_inverse()?;
        let mut n = Matrix6::zeros();
        n.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(-t_inverse * r.transpose()));
        n.fixed_view_mut::<3, 3>(0, 3).copy_from(&t_inverse);
        n.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(r * t_inverse * r.transpose() - q));
        n.fixed_view_mut::<3, 3>(3, 3).copy_from(&(-r * t_inverse));
        let values: Vec<C> = n
            .complex_eigenvalues()
            .iter()
            .filter(|p| p.im > 0.0)
            .copied()
            .collect();
        let [p0, p1, p2] = values[..] else {
            return None;
        };
        let complex = |m: &Matrix3<f64>| m.map(|v| C::new(v, 0.0));
        let (q, r, t) = (complex(&q), complex(&r), complex(&t));
        let vector = |p: C| null_vector(&(q + (r + r.transpose()) * p + t * (p * p)));
        let a = Matrix3::from_columns(&[vector(p0), vector(p1), vector(p2)]);
        let stress_function = |k: usize, p: C| (r.transpose() + t * p) * a.column(k);
        let b = Matrix3::from_columns(&[
            stress_function(0, p0),
            stress_function(1, p1),
            stress_function(2, p2),
        ]);
        Some(Self {
            law: *law,
            axes: *axes,
            p: Vector3::new(p0, p1, p2),
            a,
            b_inverse: b.try_inverse()?,
        })
    }

    /// Displacement gradient at distance 1 and angle `theta` of unit intensity of `mode` (I, II, III), in the front's frame.
    fn gradient(&self, mode: usize, theta: f64) -> Matrix3<f64> {
        let (sin, cos) = theta.sin_cos();
        let mut gradient = Matrix3::zeros();
        for k in 0..3 {
            let z = self.p[k] * sin + cos;
            let slope =
                self.b_inverse[(k, MODES[mode])] / (z.sqrt() * (2.0 * std::f64::consts::PI).sqrt());
            for i in 0..3 {
                let along = self.a[(i, k)] * slope;
                gradient[(i, 0)] += along.re;
                gradient[(i, 1)] += (along * self.p[k]).re;
            }
        }
        gradient
    }

    fn stress(&self, gradient: &Matrix3<f64>) -> Matrix3<f64> {
        let world = self.axes * gradient * self.axes.transpose();
        self.axes.transpose() * self.law.stress(&world) * self.axes
    }

    /// K from the interaction integrals with the isotropic fields of unit K_I, K_II, K_III under `lame`.
    pub(super) fn intensities(
        &self,
        lame: &Lame,
        interaction: [f64; 3],
    ) -> Option<StressIntensity> {
        /// Points round the circle; the fields are smooth but for the jump across the crack, where the circle is cut.
        const POINTS: u32 = 60;
        let mut through = Matrix3::zeros();
        let step = 2.0 * std::f64::consts::PI / f64::from(POINTS);
        for i in 0..POINTS {
            let theta = (f64::from(i) + 0.5) * step - std::f64::consts::PI;
            let (sin, cos) = theta.sin_cos();
            let auxiliary = williams(cos, sin, Side::Plain, lame).map(|w| w.gradient);
            for k in 0..3 {
                let grad = self.gradient(k, theta);
                let stress = self.stress(&grad);
                for (a, aux) in auxiliary.iter().enumerate() {
                    let density = stress.dot(aux) * cos;
                    let outward = Vector3::new(cos, sin, 0.0);
                    let pull = (stress * outward).dot(&aux.column(0))
                        + (stiffness::stress(lame, aux) * outward).dot(&grad.column(0));
                    through[(a, k)] += (density - pull) * step;
                }
            }
        }
        let k = through.lu().solve(&Vector3::from(interaction))?;
        Some(StressIntensity {
            k1: k[0],
            k2: k[1],
            k3: k[2],
        })
    }

    /// Energy release rate of straight growth \[N/mm\]: half K . L^-1 K with Barnett and Lothe's tensor L^-1 = Re(i A B^-1).
    pub(super) fn release(&self, k: &StressIntensity) -> f64 {
        let opening = (self.a * self.b_inverse).map(|v| -v.im);
        let pull = Vector3::new(k.k2, k.k1, k.k3);
        0.5 * pull.dot(&(opening * pull))
    }
}

/// Q_ik = C_i1k1, R_ik = C_i1k2, T_ik = C_i2k2 in the front's frame, nudged by a hundred-thousandth: where eigenvalues coincide, as
/// in an isotropic plane, the formalism has no three vectors.
fn stroh_matrices(law: &Orthotropic, axes: &Matrix3<f64>) -> [Matrix3<f64>; 3] {
    const NUDGE: f64 = 1e-5;
    let axis = |j: usize| axes.column(j).into_owned();
    let block = |j: usize, l: usize| axes.transpose() * law.block(&axis(j), &axis(l)) * axes;
    let (q, r, t) = (block(0, 0), block(0, 1), block(1, 1));
    let nudge = Matrix3::new(1.0, 0.3, -0.2, 0.3, -0.7, 0.4, -0.2, 0.4, 0.5) * (NUDGE * q.trace());
    [q + nudge, r, t]
}

/// The vector that a singular matrix maps to zero: the largest cross product of two of its rows.
fn null_vector(m: &Matrix3<C>) -> Vector3<C> {
    let row = |i: usize| m.row(i).transpose();
    let crosses = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| row(i).cross(&row(j)));
    let largest = crosses
        .into_iter()
        .max_by(|a, b| a.norm().total_cmp(&b.norm()))
        .unwrap_or_else(Vector3::zeros);
    let size = largest.norm();
    largest.map(|v| v / size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::{EngineeringConstants, TetMaterial};
    use nalgebra::Rotation3;

    fn constants() -> EngineeringConstants {
        EngineeringConstants {
            e1: 20_000.0,
            e2: 12_000.0,
            e3: 11_000.0,
            nu12: 0.3,
            nu23: 0.0,
            nu13: 0.0,
            g12: 5500.0,
            g23: 4000.0,
            g13: 5000.0,
        }
    }

    /// In an isotropic body K_I = E' I / 2, K_II likewise, K_III = mu I, and G is Irwin's.
    #[test]
    fn an_isotropic_law_gives_the_isotropic_factors() {
        let material = TetMaterial::isotropic(1000.0, 0.3, 1.0);
        let nine = EngineeringConstants::isotropic(1000.0, 0.3);
        let law = Orthotropic::new(&nine, &Vector3::x(), &Vector3::y()).unwrap();
        let axes = Rotation3::from_euler_angles(0.3, 0.7, -0.4).into_inner();
        let near = NearField::new(&law, &axes).unwrap();
        let (lame, e) = (material.lame(), material.plane_strain_modulus());
        let k = near.intensities(&lame, [2.0, 3.0, 4.0]).unwrap();
        for (found, expected) in [(k.k1, e), (k.k2, 1.5 * e), (k.k3, 4.0 * lame.mu)] {
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
        let g = k.straight_release(0.3) / e;
        assert!((near.release(&k) / g - 1.0).abs() < 1e-3);
    }

    /// Sih, Paris & Irwin (1965) for a crack along axis 1 in the plane of axes 1 and 2.
    #[test]
    fn an_aligned_crack_releases_what_the_closed_form_says() {
        let c = constants();
        let law = Orthotropic::new(&c, &Vector3::x(), &Vector3::y()).unwrap();
        let near = NearField::new(&law, &Matrix3::identity()).unwrap();
        let (a11, a22, a12, a66) = (1.0 / c.e1, 1.0 / c.e2, -c.nu12 / c.e1, 1.0 / c.g12);
        let b = (a22 / a11).sqrt() + (2.0 * a12 + a66) / (2.0 * a11);
        let one = StressIntensity {
            k1: 1.0,
            ..Default::default()
        };
        let two = StressIntensity {
            k2: 1.0,
            ..Default::default()
        };
        let three = StressIntensity {
            k3: 1.0,
            ..Default::default()
        };
        for (k, expected) in [
            (one, (a11 * a22 / 2.0).sqrt() * b.sqrt()),
            (two, a11 * (b / 2.0).sqrt()),
            (three, 0.5 / (c.g13 * c.g23).sqrt()),
        ] {
            let found = near.release(&k);
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
    }

    /// The field is in equilibrium and leaves the faces free, for a law askew to the front.
    #[test]
    fn the_near_field_leaves_the_faces_free() {
        let law =
            Orthotropic::new(&constants(), &Vector3::new(1.0, 0.4, 0.3), &Vector3::y()).unwrap();
        let near = NearField::new(&law, &Matrix3::identity()).unwrap();
        for (mode, &along) in MODES.iter().enumerate() {
            let ahead = near
                .stress(&near.gradient(mode, 0.0))
                .column(1)
                .into_owned();
            let expected = 1.0 / (2.0 * std::f64::consts::PI).sqrt();
            for (axis, value) in ahead.iter().enumerate() {
                let own = if axis == along { expected } else { 0.0 };
                assert!((value - own).abs() < 1e-3, "mode {mode}: {ahead}");
            }
            for side in [1.0, -1.0] {
                let angle = side * (std::f64::consts::PI - 1e-9);
                let face = near.stress(&near.gradient(mode, angle)).column(1).norm();
                assert!(face < 1e-3, "mode {mode}: {face} on the face");
            }
        }
    }
}
