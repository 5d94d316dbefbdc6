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

/// out += A x for columns of length `out.len()`, `stride` apart.
pub fn add_columns<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, x: &[f64]) {
    let n = out.len();
    let column = |c: usize| &a[c * stride..c * stride + n];
    let mut c = 0;
    // Four columns at a time: `out` is read and written once for all of them.
    while c + 4 <= x.len() {
        let (a0, a1, a2, a3) = (column(c), column(c + 1), column(c + 2), column(c + 3));
        let (x0, x1, x2, x3) = (x[c], x[c + 1], x[c + 2], x[c + 3]);
        for ((((o, a0), a1), a2), a3) in out.iter_mut().zip(a0).zip(a1).zip(a2).zip(a3) {
            let (a0, a1, a2, a3) = ((*a0).into(), (*a1).into(), (*a2).into(), (*a3).into());
            *o += (a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3);
        }
        c += 4;
    }
    for (c, x) in x.iter().enumerate().skip(c) {
        let own = out.iter_mut().zip(column(c));
        own.for_each(|(o, a)| *o += (*a).into() * x);
    }
}

/// out -= A^T y for columns of length `y.len()`, `stride` apart.
pub fn subtract_dots<T: Copy + Into<f64>>(out: &mut [f64], a: &[T], stride: usize, y: &[f64]) {
    for (c, o) in out.iter_mut().enumerate() {
        *o -= dot(&a[c * stride..c * stride + y.len()], y);
    }
}

/// Sum of products, in eight lanes that the compiler can keep in vector registers.
pub fn dot<T: Copy + Into<f64>>(a: &[T], b: &[f64]) -> f64 {
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .map(|(a, b)| (*a).into() * b)
        .sum();
    let mut lanes = [0.0; 8];
    for (a, b) in a_chunks.zip(b_chunks) {
        for k in 0..8 {
            lanes[k] += a[k].into() * b[k];
        }
    }
    rest + lanes.iter().sum::<f64>()
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
