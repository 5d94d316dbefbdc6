//! Linear elasticity on linear tetrahedra.
use super::material::Lame;
use crate::geometry::Vec3;
use nalgebra::Matrix3;

/// The 3 x 3 block K_ab / V of an element's stiffness for nodes with shape function gradients `ga`, `gb` \[MPa/mm2\].
///
/// K_ab = V (lambda ga gb^T + mu gb ga^T + mu (ga . gb) I).
pub fn block(lame: &Lame, ga: &Vec3, gb: &Vec3) -> Matrix3<f64> {
    ga * gb.transpose() * lame.lambda
        + gb * ga.transpose() * lame.mu
        + Matrix3::from_diagonal_element(lame.mu * ga.dot(gb))
}

/// Displacement gradient, `(i, j) = du_i/dx_j`, of an element whose nodes move by `u`.
pub fn displacement_gradient(gradients: &[Vec3; 4], u: &[Vec3; 4]) -> Matrix3<f64> {
    (0..4).map(|a| u[a] * gradients[a].transpose()).sum()
}

/// Cauchy stress \[MPa\] of small strains.
pub fn stress(lame: &Lame, grad_u: &Matrix3<f64>) -> Matrix3<f64> {
    let strain = (grad_u + grad_u.transpose()) * 0.5;
    Matrix3::from_diagonal_element(lame.lambda * strain.trace()) + strain * (2.0 * lame.mu)
}

/// The symmetric strain that answers a symmetric stress.
pub fn strain(lame: &Lame, stress: &Matrix3<f64>) -> Matrix3<f64> {
    let spread = lame.lambda / (3.0 * lame.lambda + 2.0 * lame.mu) * stress.trace();
    (stress - Matrix3::from_diagonal_element(spread)) * (0.5 / lame.mu)
}

/// Strain energy density \[MPa\].
pub fn energy_density(stress: &Matrix3<f64>, grad_u: &Matrix3<f64>) -> f64 {
    0.5 * stress.dot(grad_u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::TetMaterial;

    #[test]
    fn block_is_the_second_derivative_of_the_energy() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
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
        let grad = displacement_gradient(&g, &u);
        let energy = energy_density(&stress(&lame, &grad), &grad);
        let quadratic: f64 = (0..4)
            .flat_map(|a| (0..4).map(move |b| (a, b)))
            .map(|(a, b)| 0.5 * u[a].dot(&(block(&lame, &g[a], &g[b]) * u[b])))
            .sum();
        assert!((energy - quadratic).abs() < 1e-12 * energy);
    }
}
