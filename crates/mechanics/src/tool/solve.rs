/// One value a degree of freedom of both tools: translation above rotation, first tool above second.
pub type Vector12 = nalgebra::SVector<f64, 12>;
/// Maps motions of both tools to their wrenches.
pub type Matrix12 = nalgebra::SMatrix<f64, 12, 12>;

/// At most this many factorisations of 12 x 12.
const MAX_FACTORISATIONS: usize = 24;
/// Smallest shift, relative to the stiffest direction: far below what f64 resolves of a step.
const LEAST_SHIFT: f64 = 1e-12;
/// A step may be longer than its radius by this factor: it is not worth another factorisation.
const SLACK: f64 = 1.05;

/// The step of a trust region for two tools: `(H + diag(m_1 I, m_2 I)) p = f` with the smallest shifts for which the matrix
/// is positive definite and no tool's part of `p` is longer than its radius (Moré & Sorensen's condition, a tool each).
///
/// `h`: minus the derivative of the force, of which the lower triangle is read; it may be singular (saturated coupling, no
/// contact) or indefinite. Two tools that do not touch (zero off-diagonal blocks) do not influence each other in any bit.
/// Bounded work on the stack, never NaN for finite input: else the step is zero.
pub fn bounded_step(h: &Matrix12, f: &Vector12, radius: &[f64; 2]) -> Vector12 {
    let least = [0, 1].map(|t| LEAST_SHIFT * block_scale(h, t));
    let mut shift = least;
    for _ in 0..MAX_FACTORISATIONS {
        match factorise(h, &shift) {
            Err(pivot) => {
                let t = pivot.index / 6;
                shift[t] = (4.0 * shift[t]).max(shift[t] + 2.0 * pivot.value.abs());
            }
            Ok(l) => {
                let p = solve_factorised(&l, f);
                if !widen(&l, &p, radius, &mut shift) {
                    return clipped(p, radius);
                }
            }
        }
    }
    steepest(f, radius)
}

/// Largest diagonal entry of a tool's block.
fn block_scale(h: &Matrix12, tool: usize) -> f64 {
    let diagonal = (6 * tool..6 * tool + 6).map(|i| h[(i, i)].abs());
    diagonal.fold(1e-9, f64::max)
}

struct BadPivot {
    index: usize,
    value: f64,
}

/// Lower Cholesky factor of the shifted matrix, or the first pivot that is not positive.
fn factorise(h: &Matrix12, shift: &[f64; 2]) -> Result<Matrix12, BadPivot> {
    let mut l = Matrix12::zeros();
    for j in 0..12 {
        let least = 1e-14 * (h[(j, j)].abs() + shift[j / 6]);
        let row = (0..j).map(|k| l[(j, k)] * l[(j, k)]).sum::<f64>();
        let value = h[(j, j)] + shift[j / 6] - row;
        if value <= least || value.is_nan() {
            return Err(BadPivot { index: j, value });
        }
        let root = value.sqrt();
        l[(j, j)] = root;
        for i in j + 1..12 {
            let dot = (0..j).map(|k| l[(i, k)] * l[(j, k)]).sum::<f64>();
            l[(i, j)] = (h[(i, j)] - dot) / root;
        }
    }
    Ok(l)
}

fn forward(l: &Matrix12, b: &Vector12) -> Vector12 {
    let mut y = *b;
    for i in 0..12 {
        let dot = (0..i).map(|k| l[(i, k)] * y[k]).sum::<f64>();
        y[i] = (y[i] - dot) / l[(i, i)];
    }
    y
}

fn solve_factorised(l: &Matrix12, b: &Vector12) -> Vector12 {
    let mut x = forward(l, b);
    for i in (0..12).rev() {
        let dot = (i + 1..12).map(|k| l[(k, i)] * x[k]).sum::<f64>();
        x[i] = (x[i] - dot) / l[(i, i)];
    }
    x
}

/// Raises the shift of each tool whose step is too long by a Newton step on `1 / |p| = 1 / radius`; whether it raised any.
fn widen(l: &Matrix12, p: &Vector12, radius: &[f64; 2], shift: &mut [f64; 2]) -> bool {
    let mut raised = false;
    for (t, radius) in radius.iter().enumerate() {
        let length = p.fixed_rows::<6>(6 * t).norm();
        if length <= SLACK * radius {
            continue;
        }
        let mut part = Vector12::zeros();
        part.fixed_rows_mut::<6>(6 * t)
            .copy_from(&p.fixed_rows::<6>(6 * t));
        let q2 = forward(l, &part).norm_squared();
        shift[t] += (length / radius - 1.0) * length * length / q2;
        raised = true;
    }
    raised
}

/// Takes off what the slack left over.
fn clipped(mut p: Vector12, radius: &[f64; 2]) -> Vector12 {
    for (t, radius) in radius.iter().enumerate() {
        let mut part = p.fixed_rows_mut::<6>(6 * t);
        let length = part.norm();
        if !length.is_finite() {
            part.fill(0.0);
        } else if length > *radius {
            part *= radius / length;
        }
    }
    p
}

/// Along the force: for a matrix that no shift mends.
fn steepest(f: &Vector12, radius: &[f64; 2]) -> Vector12 {
    let mut p = Vector12::zeros();
    for (t, radius) in radius.iter().enumerate() {
        let part = f.fixed_rows::<6>(6 * t);
        let length = part.norm();
        if length > 0.0 && length.is_finite() {
            p.fixed_rows_mut::<6>(6 * t)
                .copy_from(&(part * (radius / length)));
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = 2 * seed + 1;
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }
    }

    fn random(seed: u64, eigenvalues: impl Fn(usize) -> f64) -> (Matrix12, Vector12) {
        let mut next = noise(seed);
        let q = Matrix12::from_fn(|_, _| next()).qr().q();
        let d = Vector12::from_fn(|i, _| eigenvalues(i));
        let h = q * Matrix12::from_diagonal(&d) * q.transpose();
        (h, Vector12::from_fn(|_, _| next()))
    }

    #[test]
    fn a_short_step_is_newtons() {
        for seed in 0..50 {
            let (h, f) = random(seed, |i| 10f64.powi(i as i32 / 2));
            let p = bounded_step(&h, &f, &[1e3; 2]);
            assert!((h * p - f).norm() < 1e-6 * f.norm());
        }
    }

    #[test]
    fn singular_and_indefinite_matrices_give_bounded_steps_downhill() {
        for seed in 0..300 {
            let (h, f) = random(seed, |i| match (seed % 3, i) {
                (0, 0..4) => 0.0,
                (1, 0..3) => -100.0 * (i + 1) as f64,
                (2, _) => 0.0,
                _ => 10f64.powi(i as i32 % 5),
            });
            let p = bounded_step(&h, &f, &[1.0, 0.5]);
            assert!(p.iter().all(|v| v.is_finite()));
            assert!(p.fixed_rows::<6>(0).norm() <= 1.0 + 1e-12);
            assert!(p.fixed_rows::<6>(6).norm() <= 0.5 + 1e-12);
            assert!(p.dot(&f) > 0.0, "seed {seed}: not downhill");
        }
    }

    #[test]
    fn a_flat_direction_is_followed_to_the_radius() {
        let mut h = Matrix12::identity() * 100.0;
        h[(0, 0)] = 0.0;
        let mut f = Vector12::zeros();
        f[0] = 660.0;
        f[7] = 10.0;
        let p = bounded_step(&h, &f, &[1.0; 2]);
        assert!((p[0] - 1.0).abs() < 0.06 && (p[7] - 0.1).abs() < 1e-9);
    }

    #[test]
    fn tools_apart_do_not_influence_each_other() {
        let (a, f) = random(3, |i| i as f64 - 2.0);
        let (b, g) = random(4, |i| 1e6 * i as f64);
        let block = |m: &Matrix12, n: &Matrix12| {
            let mut h = Matrix12::zeros();
            h.fixed_view_mut::<6, 6>(0, 0)
                .copy_from(&m.fixed_view::<6, 6>(0, 0));
            h.fixed_view_mut::<6, 6>(6, 6)
                .copy_from(&n.fixed_view::<6, 6>(6, 6));
            h
        };
        let mut other = f;
        other
            .fixed_rows_mut::<6>(6)
            .copy_from(&g.fixed_rows::<6>(6));
        let alone = bounded_step(&block(&a, &a), &f, &[1.0; 2]);
        let beside = bounded_step(&block(&a, &b), &other, &[1.0, 1e-3]);
        assert_eq!(alone.fixed_rows::<6>(0), beside.fixed_rows::<6>(0));
    }

    #[test]
    fn what_is_not_finite_moves_nothing() {
        let (mut h, f) = random(5, |_| 1.0);
        h[(4, 2)] = f64::NAN;
        let p = bounded_step(&h, &f, &[1.0; 2]);
        assert!(p.iter().all(|v| v.is_finite()));
        let p = bounded_step(
            &Matrix12::identity(),
            &Vector12::repeat(f64::NAN),
            &[1.0; 2],
        );
        assert_eq!(p, Vector12::zeros());
    }
}
