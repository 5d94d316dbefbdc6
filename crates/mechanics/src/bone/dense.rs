//! The few dense kernels of the triangular solves: column-major, one right-hand side; several go to faer's products.
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

/// Values kept in double precision, and rounded to single for sweeps that need no more: those are as fast as memory.
#[derive(Clone, Debug)]
pub struct Stored {
    double: Vec<f64>,
    single: Vec<f32>,
}

impl Stored {
    pub fn new(double: Vec<f64>) -> Self {
        let single = double.iter().map(|v| *v as f32).collect();
        Self { double, single }
    }

    pub fn len(&self) -> usize {
        self.double.len()
    }

    pub fn double(&self) -> &[f64] {
        &self.double
    }
}

/// Which of the stored values a sweep reads; it always computes in double precision.
pub trait Precision {
    type Value: Copy + Into<f64>;

    fn of(stored: &Stored) -> &[Self::Value];
}

#[derive(Clone, Copy, Debug)]
pub struct Double;

#[derive(Clone, Copy, Debug)]
pub struct Single;

impl Precision for Double {
    type Value = f64;

    fn of(stored: &Stored) -> &[f64] {
        &stored.double
    }
}

impl Precision for Single {
    type Value = f32;

    fn of(stored: &Stored) -> &[f32] {
        &stored.single
    }
}

/// Runs `f` compiled for the widest vectors that this processor has. What `f` calls, and `f` itself, must be `inline(always)`: what is
/// not is compiled for any processor.
#[inline(always)]
pub fn vectorized<R>(f: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(f)
}

/// Reads a value of each cache line, from the first to the last. Several columns passed through together are several streams, which the
/// processor foresees badly: where they come from memory, a sweep up is a third faster with this; where they lie in the cache, a quarter
/// slower.
#[inline(always)]
pub fn touch<T: Copy + Into<f64>>(a: &[T]) {
    let mut sum = 0.0;
    for line in a.chunks(64 / size_of::<T>()) {
        sum += line[0].into();
    }
    std::hint::black_box(sum);
}

/// Columns that are passed through together: what they have in common is read once for all.
pub const TOGETHER: usize = 4;

/// out += A x for columns of length `out.len()`, `stride` apart.
pub fn add_columns<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, x: &[f64]) {
    vectorized(
        #[inline(always)]
        || inlined::add_columns(out, a, stride, x),
    );
}

/// out -= A^T y for columns of length `y.len()`, `stride` apart.
pub fn subtract_dots<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, y: &[f64]) {
    vectorized(
        #[inline(always)]
        || inlined::subtract_dots(out, a, stride, y),
    );
}

/// Sum of products.
pub fn dot<T: Copy + Into<f64>>(a: &[T], b: &[f64]) -> f64 {
    vectorized(
        #[inline(always)]
        || inlined::dot(a, b),
    )
}

/// The kernels themselves, to be called within [`vectorized`].
pub mod inlined {
    use super::{TOGETHER, dots};

    /// See [`add_columns`](super::add_columns).
    #[inline(always)]
    pub fn add_columns<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, x: &[f64]) {
        let n = out.len();
        let fours = x.chunks_exact(TOGETHER);
        let last = x.len() - fours.remainder().len();
        for (k, x) in fours.enumerate() {
            let [a0, a1, a2, a3] = [0, 1, 2, 3].map(|i| &a[(TOGETHER * k + i) * stride..][..n]);
            for ((((o, a0), a1), a2), a3) in out.iter_mut().zip(a0).zip(a1).zip(a2).zip(a3) {
                let (a0, a1, a2, a3) = ((*a0).into(), (*a1).into(), (*a2).into(), (*a3).into());
                *o += (a0 * x[0] + a1 * x[1]) + (a2 * x[2] + a3 * x[3]);
            }
        }
        for (c, x) in x.iter().enumerate().skip(last) {
            for (o, a) in out.iter_mut().zip(&a[c * stride..c * stride + n]) {
                *o += (*a).into() * x;
            }
        }
    }

    /// See [`subtract_dots`](super::subtract_dots).
    #[inline(always)]
    pub fn subtract_dots<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, y: &[f64]) {
        let mut fours = out.chunks_exact_mut(TOGETHER);
        let mut c = 0;
        for out in &mut fours {
            let columns = [0, 1, 2, 3].map(|i| &a[(c + i) * stride..(c + i) * stride + y.len()]);
            for (o, s) in out.iter_mut().zip(dots(columns, y)) {
                *o -= s;
            }
            c += TOGETHER;
        }
        for out in fours.into_remainder() {
            *out -= dot(&a[c * stride..c * stride + y.len()], y);
            c += 1;
        }
    }

    /// See [`dot`](super::dot).
    #[inline(always)]
    pub fn dot<T: Copy + Into<f64>>(a: &[T], b: &[f64]) -> f64 {
        dots([a], b)[0]
    }
}

/// Sums of products, in lanes that the compiler can keep in vector registers.
#[inline(always)]
fn dots<T: Copy + Into<f64>, const N: usize>(a: [&[T]; N], y: &[f64]) -> [f64; N] {
    const LANES: usize = 8;
    let whole = y.len() / LANES * LANES;
    let mut lanes = [[0.0; LANES]; N];
    for i in (0..whole).step_by(LANES) {
        let y = &y[i..i + LANES];
        for (lanes, a) in lanes.iter_mut().zip(a) {
            let a = &a[i..i + LANES];
            for k in 0..LANES {
                lanes[k] += a[k].into() * y[k];
            }
        }
    }
    std::array::from_fn(|n| {
        let [a0, a1, a2, a3, a4, a5, a6, a7] = lanes[n];
        let rest = a[n][whole..y.len()].iter().zip(&y[whole..]);
        let rest: f64 = rest.map(|(a, y)| (*a).into() * y).sum();
        (((a0 + a4) + (a2 + a6)) + ((a1 + a5) + (a3 + a7))) + rest
    })
}

/// Rows `row..row + n_rows` of the first `n` columns of a column-major matrix with `stride` rows.
pub fn view(a: &[f64], stride: usize, row: usize, n_rows: usize, n: usize) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(&a[..stride * n], stride, n).subrows(row, n_rows)
}

/// As [`view`], to write.
pub fn view_mut(
    a: &mut [f64],
    stride: usize,
    row: usize,
    n_rows: usize,
    n: usize,
) -> MatMut<'_, f64> {
    MatMut::from_column_major_slice_mut(&mut a[..stride * n], stride, n).subrows_mut(row, n_rows)
}

/// c -= a b on one thread.
pub fn subtract_product(c: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    matmul(c, Accum::Add, a, b, -1.0, Par::Seq);
}
