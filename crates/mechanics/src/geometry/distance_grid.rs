use super::{Aabb, Lanes, Vec3};
use std::sync::Arc;

/// Why a distance grid was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum GridError {
    /// The spacing is not a positive number, or the box is empty.
    #[error("a distance grid needs a box with positive edges and a positive spacing")]
    Empty,
    /// More samples than fit.
    #[error("a distance grid of {0} samples is too large; at most {MAX_SAMPLES}")]
    TooLarge(usize),
    /// The distance function gave something that is not a finite number.
    #[error("the distance at ({0}, {1}, {2}) is not a finite number")]
    NotFinite(f64, f64, f64),
}

/// 256 MB of samples.
const MAX_SAMPLES: usize = 1 << 26;

/// What a [`DistanceGrid`] says about a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceSample {
    /// Signed distance \[mm\], negative inside.
    pub distance: f32,
    /// Gradient of the interpolated distance, exactly: not normalised.
    pub gradient: [f32; 3],
}

/// What a [`DistanceGrid`] says about several points.
#[derive(Clone, Copy)]
pub struct DistanceSamples<L: Lanes> {
    /// As in [`DistanceSample`]; infinite where nothing is known.
    pub distance: L,
    /// As in [`DistanceSample`]; nothing where nothing is known.
    pub gradient: [L; 3],
    /// Which points lie in the grid and were asked for.
    pub known: L::Mask,
}

impl<L: Lanes> DistanceSamples<L> {
    #[inline]
    fn unknown(none: L::Mask) -> Self {
        Self {
            distance: L::splat(f32::INFINITY),
            gradient: [L::splat(0.0); 3],
            known: none,
        }
    }

    /// These where `mask` says so, else the others.
    #[inline]
    pub fn or(self, mask: L::Mask, others: Self) -> Self {
        let pick = |own: L, other: L| L::choose(mask, own, other);
        let ([a, b, c], [d, e, f]) = (self.gradient, others.gradient);
        Self {
            distance: pick(self.distance, others.distance),
            gradient: [pick(a, d), pick(b, e), pick(c, f)],
            known: (mask & self.known) | others.known,
        }
    }
}

/// Signed distances on a regular grid, interpolated trilinearly.
///
/// The gradient is that of the interpolation itself, so a force made from both conserves energy. Flat faces are
/// reproduced exactly; near edges the error is below the spacing. Look-ups neither allocate nor panic. Clones share the values.
#[derive(Clone, Debug)]
pub struct DistanceGrid {
    origin: [f32; 3],
    inverse_spacing: [f32; 3],
    /// Highest cell coordinate an axis: number of cells.
    n_cells: [f32; 3],
    stride_y: usize,
    stride_z: usize,
    values: Arc<[f32]>,
    bounds: Aabb,
    error_bound: f32,
}

impl DistanceGrid {
    /// Samples `distance` at the corners of cells of about `spacing` \[mm\] an axis that fill `bounds` exactly.
    ///
    /// # Errors
    /// [`GridError`] for an empty box, a spacing that is not positive, too many samples, or a distance that is not finite.
    pub fn sample(
        bounds: Aabb,
        spacing: [f64; 3],
        distance: impl Fn(&Vec3) -> f64,
    ) -> Result<Self, GridError> {
        let extent = bounds.extent();
        let positive = |v: f64| v.is_finite() && v > 0.0;
        if !(0..3).all(|k| positive(extent[k]) && positive(spacing[k])) {
            return Err(GridError::Empty);
        }
        let cells = [0, 1, 2].map(|k| (extent[k] / spacing[k] - 1e-6).ceil().max(1.0) as usize);
        let n_samples = cells
            .iter()
            .fold(1usize, |n, c| n.saturating_mul(c.saturating_add(1)));
        if n_samples > MAX_SAMPLES {
            return Err(GridError::TooLarge(n_samples));
        }
        let step = Vec3::from_fn(|k, _| extent[k] / cells[k] as f64);
        Ok(Self {
            origin: [0, 1, 2].map(|k| bounds.min[k] as f32),
            inverse_spacing: [0, 1, 2].map(|k| (1.0 / step[k]) as f32),
            n_cells: cells.map(|n| n as f32),
            stride_y: cells[0] + 1,
            stride_z: (cells[0] + 1) * (cells[1] + 1),
            values: fill(&bounds.min, &step, cells, distance)?.into(),
            bounds,
            error_bound: (0.5 * step.norm()) as f32,
        })
    }

    /// The box in which distances are known.
    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Distance and gradient at `p`; `None` outside the grid, and for a point that is not finite.
    #[inline]
    pub fn look_up(&self, p: [f32; 3]) -> Option<DistanceSample> {
        let found = self.look_up_in(p, true);
        found.known.then_some(DistanceSample {
            distance: found.distance,
            gradient: found.gradient,
        })
    }

    /// As [`look_up`](Self::look_up) for several points, those that are `wanted`.
    #[inline]
    pub fn look_up_in<L: Lanes>(&self, p: [L; 3], wanted: L::Mask) -> DistanceSamples<L> {
        let zero = L::splat(0.0);
        let scaled =
            |k: usize| (p[k] - L::splat(self.origin[k])) * L::splat(self.inverse_spacing[k]);
        let (x, y, z) = (scaled(0), scaled(1), scaled(2));
        let [nx, ny, nz] = self.n_cells;
        // Written so that NaN fails.
        let above = x.at_least(zero) & y.at_least(zero) & z.at_least(zero);
        let below = x.less(L::splat(nx)) & y.less(L::splat(ny)) & z.less(L::splat(nz));
        let known = wanted & above & below;
        if L::bits(known) == 0 {
            return DistanceSamples::unknown(known);
        }
        let (x, y, z) = (
            L::choose(known, x, zero),
            L::choose(known, y, zero),
            L::choose(known, z, zero),
        );
        let ((whole_x, i), (whole_y, j), (whole_z, k)) = (x.whole(), y.whole(), z.whole());
        let (x, y, z) = (x - whole_x, y - whole_y, z - whole_z);
        let first = |l: usize| i[l] + j[l] * self.stride_y + k[l] * self.stride_z;
        // The four edges along x, at low and high y and z.
        let [a0, a1, b0, b1] = L::columns(|l| self.face(first(l)));
        let [c0, c1, d0, d1] = L::columns(|l| self.face(first(l) + self.stride_z));
        // Along x, then y, then z; each with its difference.
        let lerp = |lo: L, hi: L, w: L| lo + (hi - lo) * w;
        let (ax, bx, cx, dx) = (a1 - a0, b1 - b0, c1 - c0, d1 - d0);
        let (a, b, c, d) = (a0 + ax * x, b0 + bx * x, c0 + cx * x, d0 + dx * x);
        let (low, high) = (lerp(a, b, y), lerp(c, d, y));
        let [sx, sy, sz] = self.inverse_spacing;
        DistanceSamples {
            distance: L::choose(known, lerp(low, high, z), L::splat(f32::INFINITY)),
            gradient: [
                lerp(lerp(ax, bx, y), lerp(cx, dx, y), z) * L::splat(sx),
                lerp(b - a, d - c, z) * L::splat(sy),
                (high - low) * L::splat(sz),
            ],
            known,
        }
    }

    /// The values at the corners of a cell's face of constant z: two along x, then the two beside them along y.
    #[inline]
    fn face(&self, first: usize) -> [f32; 4] {
        let y = self.stride_y;
        match self.values.get(first..first + y + 2) {
            Some(v) => [v[0], v[1], v[y], v[y + 1]],
            None => [f32::NAN; 4],
        }
    }

    /// How far interpolation may lie off \[mm\]: half a cell's diagonal, since no distance changes faster than its point moves.
    pub fn error_bound(&self) -> f32 {
        self.error_bound
    }

    /// Distance from `p` to the grid's box \[mm\]: 0 inside; outside no surface in the grid is nearer.
    pub fn distance_to_bounds(&self, p: &Vec3) -> f64 {
        let outside = (self.bounds.min - p)
            .sup(&(p - self.bounds.max))
            .sup(&Vec3::zeros());
        outside.norm()
    }
}

fn fill(
    min: &Vec3,
    step: &Vec3,
    cells: [usize; 3],
    distance: impl Fn(&Vec3) -> f64,
) -> Result<Vec<f32>, GridError> {
    let mut values = Vec::with_capacity(cells.iter().map(|n| n + 1).product());
    for k in 0..=cells[2] {
        for j in 0..=cells[1] {
            for i in 0..=cells[0] {
                let p = min + Vec3::new(i as f64, j as f64, k as f64).component_mul(step);
                let d = distance(&p);
                if !d.is_finite() {
                    return Err(GridError::NotFinite(p.x, p.y, p.z));
                }
                values.push(d as f32);
            }
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(half: f64) -> Aabb {
        Aabb {
            min: Vec3::repeat(-half),
            max: Vec3::repeat(half),
        }
    }

    fn points(n: u32) -> impl Iterator<Item = Vec3> {
        (1..=n).map(|i| {
            // A low-discrepancy cloud in [-1, 1]^3 (the plastic number's powers).
            Vec3::from_fn(|k, _| {
                let a = [0.819_172_513_396, 0.671_043_606_704, 0.549_700_477_901][k];
                2.0 * (0.5 + a * f64::from(i)).fract() - 1.0
            })
        })
    }

    /// Trilinear interpolation of a function with second derivatives up to M errs by at most 3 h^2 M / 8; a sphere's
    /// distance has M = 1/r, so the bound is kept away from the centre.
    #[test]
    fn sphere_within_the_bound_of_interpolation() {
        for h in [0.4, 0.2, 0.1] {
            let grid = DistanceGrid::sample(cube(3.0), [h; 3], |p| p.norm() - 2.0).unwrap();
            let mut worst = 0.0f64;
            for p in points(4000).map(|p| p * 2.9).filter(|p| p.norm() > 1.0) {
                let s = grid.look_up([0, 1, 2].map(|k| p[k] as f32)).unwrap();
                worst = worst.max((f64::from(s.distance) - (p.norm() - 2.0)).abs());
                let g = Vec3::from_fn(|k, _| f64::from(s.gradient[k]));
                assert!((g - p.normalize()).norm() < 2.0 * h, "h {h}, gradient {g}");
            }
            assert!(worst < 3.0 * h * h / 8.0 / (1.0 - h), "h {h}: {worst}");
        }
    }

    #[test]
    fn gradient_is_that_of_the_interpolation() {
        let wavy = |p: &Vec3| p.norm() - 2.0 + 0.3 * (3.0 * p.x).sin() * p.y;
        let grid = DistanceGrid::sample(cube(3.0), [0.5, 0.4, 0.3], wavy).unwrap();
        let at = |p: &Vec3| grid.look_up([0, 1, 2].map(|k| p[k] as f32)).unwrap();
        let h = 0.01;
        for p in points(500).map(|p| p * 2.8) {
            for k in 0..3 {
                let mut e = Vec3::zeros();
                e[k] = h;
                // Inside one cell the interpolation is linear along an axis: the difference is exact up to f32.
                let cell = |q: f64| ((q + 3.0) / [0.5, 0.4, 0.3][k]).floor();
                if cell(p[k] - 1.01 * h) != cell(p[k] + 1.01 * h) {
                    continue;
                }
                let slope = f64::from(at(&(p + e)).distance - at(&(p - e)).distance) / (2.0 * h);
                assert!((slope - f64::from(at(&p).gradient[k])).abs() < 2e-4);
            }
        }
    }

    #[test]
    fn outside_is_none_and_bad_grids_are_named() {
        let grid = DistanceGrid::sample(cube(1.0), [0.5; 3], |p| p.x).unwrap();
        for p in [[1.1, 0.0, 0.0], [0.0, -1.1, 0.0], [f32::NAN, 0.0, 0.0]] {
            assert_eq!(grid.look_up(p), None);
        }
        assert!((grid.distance_to_bounds(&Vec3::new(4.0, 5.0, 0.0)) - 5.0).abs() < 1e-12);
        let bad = |spacing| DistanceGrid::sample(cube(1.0), [spacing; 3], |p| p.x).unwrap_err();
        assert_eq!(bad(0.0), GridError::Empty);
        assert!(matches!(bad(1e-6), GridError::TooLarge(_)));
        let nan = DistanceGrid::sample(cube(1.0), [0.5; 3], |_| f64::NAN).unwrap_err();
        assert_eq!(nan, GridError::NotFinite(-1.0, -1.0, -1.0));
    }
}
