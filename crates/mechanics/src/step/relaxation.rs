//! Faster convergence of the relaxation from the sweeps already made (interface quasi-Newton by least squares, the
//! Anderson mixing of partitioned solvers).

/// Sweeps of this main step that are remembered. Those of earlier steps mislead: their contacts were others.
const MEMORY: usize = 6;
/// Without memory a sweep may move no unknown farther than this \[mm\]: just broken off, a fragment would otherwise leap.
const FIRST_MOVE: f64 = 1.0;
/// No sweep may move an unknown farther than this \[mm\].
const LONGEST_MOVE: f64 = 4.0;

/// The fixed point x = G(x), G = one sweep. Only the first unknowns are looked at; the rest is what depends linearly on them, and
/// goes along.
#[derive(Clone, Debug, Default)]
pub struct Acceleration {
    /// Differences of residuals G(x) - x and of results G(x) between consecutive sweeps.
    residuals: Vec<Vec<f64>>,
    results: Vec<Vec<f64>>,
    /// Residual and result of the last sweep of this step.
    last: Option<(Vec<f64>, Vec<f64>)>,
}

impl Acceleration {
    /// Forgets everything: a new step, another bone.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Replaces `x` by a better guess than `result` = G(x), going by the first `n_seen` unknowns.
    pub fn next(&mut self, x: &mut [f64], result: &[f64], n_seen: usize) {
        let residual = difference(&result[..n_seen], &x[..n_seen]);
        if let Some((r, g)) = self.last.take() {
            self.residuals.push(difference(&residual, &r));
            self.results.push(difference(result, &g));
            if self.residuals.len() > MEMORY {
                self.residuals.remove(0);
                self.results.remove(0);
            }
        }
        let mixed = self.mix(&residual, result);
        let limit = if self.residuals.is_empty() {
            FIRST_MOVE
        } else {
            LONGEST_MOVE
        };
        let longest = mixed[..n_seen]
            .iter()
            .zip(x.iter())
            .fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        let share = if longest > limit {
            limit / longest
        } else {
            1.0
        };
        x.iter_mut()
            .zip(&mixed)
            .for_each(|(x, m)| *x += share * (m - *x));
        self.last = Some((residual, result.to_vec()));
    }

    /// result + sum_j c_j (difference of results)_j with c the least squares of residual + sum_j c_j (...)_j = 0.
    fn mix(&self, residual: &[f64], result: &[f64]) -> Vec<f64> {
        let m = self.residuals.len();
        let mut mixed = result.to_vec();
        if m == 0 {
            return mixed;
        }
        let gram =
            nalgebra::DMatrix::from_fn(m, m, |i, j| dot(&self.residuals[i], &self.residuals[j]));
        let rhs = nalgebra::DVector::from_fn(m, |i, _| -dot(&self.residuals[i], residual));
        // Nearly dependent sweeps are left out by the pseudo-inverse.
        let largest = gram.diagonal().max();
        if let Ok(c) = gram.svd(true, true).solve(&rhs, 1e-8 * largest)
            && c.iter().all(|v| v.is_finite())
        {
            for (c, g) in c.iter().zip(&self.results) {
                mixed.iter_mut().zip(g).for_each(|(x, g)| *x += c * g);
            }
        }
        mixed
    }
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map that plain iteration would leave: spectral radius 1.8. The last value goes along: 2 x_0 + x_2 of each guess and result.
    #[test]
    fn converges_where_plain_sweeps_diverge() {
        let map = |x: &[f64]| {
            let (a, b, c) = (
                1.0 - 1.8 * x[0] + 0.1 * x[1],
                0.5 - 0.9 * x[1],
                0.2 * x[2] + 0.1,
            );
            vec![a, b, c, 2.0 * a + c]
        };
        let mut x = vec![0.0; 4];
        let mut acceleration = Acceleration::default();
        for _ in 0..8 {
            let g = map(&x);
            acceleration.next(&mut x, &g, 3);
        }
        let g = map(&x);
        let residual = difference(&g, &x)
            .iter()
            .fold(0.0, |m: f64, v| m.max(v.abs()));
        assert!(residual < 1e-6, "residual {residual}");
        assert!((x[3] - 2.0 * x[0] - x[2]).abs() < 1e-12);
    }
}
