use super::dense::{
    Double, Precision, Single, Stored, add_columns, dot, subtract_dots, subtract_product, view,
    view_mut,
};
use super::factor::{Factor, FactorError, Path};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Par, Spec};
use std::sync::Arc;

/// Factor of a matrix that grows by rows and columns at its end; the base is factored once and for all.
///
/// With the base K_uu = L L^T and the border K_ua, K_aa: W = L^-1 K_ua, kept on its path in L, and the dense Cholesky factor
/// of S = K_aa - W^T W. Both are kept by batches of columns behind `Arc`, so that a grown factor shares all it had before.
/// A solve is a sweep up L, a dense one, and a sweep down L; it allocates nothing.
#[derive(Clone, Debug)]
pub struct Bordered {
    base: Arc<Factor>,
    batches: Vec<Arc<Batch>>,
    n_border: usize,
}

/// Some consecutive columns of the border.
#[derive(Debug)]
struct Batch {
    path: Path,
    /// W, packed along the path.
    w: Stored,
    /// Border columns before this batch, and in it.
    before: usize,
    m: usize,
    /// This batch's rows of the Cholesky factor of S: m x (before + m), column-major, lower.
    rows: Vec<f64>,
}

/// One scalar row of the border to be appended.
#[derive(Clone, Debug, Default)]
pub struct BorderRow {
    /// Couplings with unknowns of the base: which, and the value.
    pub base: Vec<(u32, f64)>,
    /// Couplings with unknowns of the border up to this row itself, counted from the border's first.
    pub border: Vec<(u32, f64)>,
}

/// Memory of a solve, kept so that solving allocates nothing.
#[derive(Debug)]
pub struct SolveScratch {
    y: Vec<f64>,
    below: Vec<f64>,
    packed: Vec<f64>,
    border: Vec<f64>,
    whole: Path,
}

/// Unknowns between which solves are wanted: where forces act, and where displacements are read.
#[derive(Clone, Debug, Default)]
pub struct Region {
    unknowns: Vec<u32>,
    path: Path,
    /// What is not on it.
    rest: Path,
}

impl Region {
    /// The unknowns asked for, ascending.
    pub fn unknowns(&self) -> &[u32] {
        &self.unknowns
    }

    /// Unknowns of the base that a solve in this region passes through.
    pub fn n_rows(&self) -> usize {
        self.path.n_rows()
    }
}

/// L^-1 B of the whole bordered factor for some columns B: products of two of them are compliances B^T K^-1 C.
#[derive(Clone, Debug)]
pub struct HalfSolved {
    path: Path,
    base: Vec<f64>,
    border: Vec<f64>,
    n_border: usize,
    m: usize,
}

/// L^-1 b of the whole bordered factor for one right-hand side b. Half-solved columns can be added to it before the sweep down.
#[derive(Clone, Debug, Default)]
pub struct Swept {
    /// In places of L, then the border's.
    values: Vec<f64>,
}

impl Swept {
    /// What is linear in the right-hand side: sums of these for several belong to the sum of those.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Takes over such values.
    pub fn set(&mut self, values: &[f64]) {
        self.values.clear();
        self.values.extend_from_slice(values);
    }
}

/// Most columns in a batch: enough for dense products, few enough that their paths have most in common (48 and 96 are a
/// tie).
const MOST_COLUMNS: usize = 96;

impl Bordered {
    /// A factor without border.
    pub fn new(base: Factor) -> Self {
        Self {
            base: Arc::new(base),
            batches: Vec::new(),
            n_border: 0,
        }
    }

    /// Number of unknowns.
    pub fn n(&self) -> usize {
        self.base.n() + self.n_border
    }

    /// Number of unknowns of the border.
    pub fn n_border(&self) -> usize {
        self.n_border
    }

    /// Values kept: (base, border).
    pub fn n_values(&self) -> (usize, usize) {
        let values = |b: &Arc<Batch>| b.w.len() + b.rows.len();
        (self.base.n_values(), self.batches.iter().map(values).sum())
    }

    /// The factor with further rows and columns at the end. Shares everything with this one.
    ///
    /// # Errors
    /// [`FactorError::NotPositiveDefinite`] if the grown matrix is not positive definite.
    pub fn grown(&self, rows: &[BorderRow]) -> Result<Self, FactorError> {
        let mut grown = self.clone();
        for rows in rows.chunks(MOST_COLUMNS) {
            grown.append(rows)?;
        }
        Ok(grown)
    }

    fn append(&mut self, rows: &[BorderRow]) -> Result<(), FactorError> {
        let (m, before) = (rows.len(), self.n_border);
        let base: Vec<_> = rows.iter().map(|r| r.base.as_slice()).collect();
        let (path, w) = self.forward_base(&base);
        // Rows of S, then of its factor.
        let mut s = vec![0.0; m * (before + m)];
        for (i, row) in rows.iter().enumerate() {
            for &(j, v) in &row.border {
                s[i + m * j as usize] = v;
            }
        }
        for b in &self.batches {
            let columns = &mut s[m * b.before..m * (b.before + b.m)];
            subtract_common(columns, m, (&path, &w, m), (&b.path, b.w.double(), b.m));
        }
        subtract_common(&mut s[m * before..], m, (&path, &w, m), (&path, &w, m));
        self.forward_border(&mut s, m);
        let (known, own) = s.split_at_mut(m * before);
        let known = view(known, m, 0, m, before);
        subtract_product(view_mut(own, m, 0, m, m), known, known.transpose());
        let need = cholesky_in_place_scratch::<f64>(m, Par::Seq, Spec::default());
        cholesky_in_place(
            view_mut(own, m, 0, m, m),
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(need)),
            Spec::default(),
        )
        .map_err(|_| FactorError::NotPositiveDefinite)?;
        self.batches.push(Arc::new(Batch {
            path,
            w: Stored::new(w),
            before,
            m,
            rows: s,
        }));
        self.n_border += m;
        Ok(())
    }

    /// L^-1 of sparse columns of the base, packed along their common path.
    fn forward_base(&self, columns: &[&[(u32, f64)]]) -> (Path, Vec<f64>) {
        let path = self
            .base
            .path(columns.iter().flat_map(|c| c.iter().map(|e| e.0)));
        let n_rows = path.n_rows();
        let mut panel = vec![0.0; n_rows * columns.len()];
        if n_rows > 0 {
            for (column, packed) in columns.iter().zip(panel.chunks_exact_mut(n_rows)) {
                for &(i, v) in *column {
                    packed[self.base.packed_row(&path, i as usize)] += v;
                }
            }
            self.base.forward_packed(&path, &mut panel, columns.len());
        }
        (path, panel)
    }

    /// X <- X L_S^-T for `m` rows X of the border, column-major: the dense forward sweep, batch by batch.
    fn forward_border(&self, x: &mut [f64], m: usize) {
        for b in &self.batches {
            let (known, rest) = x.split_at_mut(m * b.before);
            let own = &mut rest[..m * b.m];
            if own.iter().chain(&*known).all(|v| *v == 0.0) {
                continue;
            }
            let left = view(&b.rows, b.m, 0, b.m, b.before);
            let known = view(known, m, 0, m, b.before);
            subtract_product(view_mut(own, m, 0, m, b.m), known, left.transpose());
            let triangle = view(&b.rows[b.m * b.before..], b.m, 0, b.m, b.m);
            let own = view_mut(own, m, 0, m, b.m);
            solve_lower_triangular_in_place(triangle, own.transpose_mut(), Par::Seq);
        }
    }

    /// b . K^-1 b for a right-hand side that is zero but for the last `b.len()` unknowns, which belong to the border.
    pub fn work_of_last(&self, b: &[f64]) -> f64 {
        let first = self.n_border - b.len();
        let mut x = vec![0.0; self.n_border];
        x[first..].copy_from_slice(b);
        self.forward_border(&mut x, 1);
        dot(&x, &x)
    }

    /// Memory for [`solve`](Self::solve).
    pub fn scratch(&self) -> SolveScratch {
        SolveScratch {
            y: vec![0.0; self.base.n()],
            below: vec![0.0; self.base.longest_column()],
            packed: vec![0.0; self.base.n()],
            border: vec![0.0; self.n_border],
            whole: self.base.whole(),
        }
    }

    /// Solves K x = b in place for right-hand sides stored one after the other. Allocates nothing.
    ///
    /// `x`: n values a right-hand side.
    pub fn solve(&self, x: &mut [f64], scratch: &mut SolveScratch) {
        for x in x.chunks_exact_mut(self.n().max(1)) {
            self.solve_one(x, scratch);
        }
    }

    /// The region of the given unknowns; the border is always part of it.
    pub fn region(&self, unknowns: impl IntoIterator<Item = u32>) -> Region {
        let mut unknowns: Vec<u32> = unknowns.into_iter().collect();
        unknowns.sort_unstable();
        unknowns.dedup();
        let in_base = |i: &u32| (*i as usize) < self.base.n();
        let path = self.base.path(unknowns.iter().copied().filter(in_base));
        Region {
            rest: self.base.rest(&path),
            path,
            unknowns,
        }
    }

    /// As [`solve`](Self::solve) for one right-hand side that is zero outside the region; of the result only what lies in
    /// the region is computed, the rest of `x` keeps what it held. Allocates nothing.
    pub fn solve_region(&self, region: &Region, x: &mut [f64], scratch: &mut SolveScratch) {
        let (u, a) = x.split_at_mut(self.base.n());
        let SolveScratch {
            y, below, packed, ..
        } = scratch;
        let path = &region.path;
        let packed = &mut packed[..path.n_rows()];
        self.base.place_all(path, u, y);
        self.base.forward::<Double>(path, y, below);
        // Off the path the right-hand side is zero and the result is not wanted: W's rows there are passed over.
        self.base.gather(path, y, packed);
        for b in &self.batches {
            let own = &mut a[b.before..b.before + b.m];
            for (i, j, n) in path.common(&b.path) {
                subtract_dots(own, &b.w.double()[j..], b.path.n_rows(), &packed[i..i + n]);
            }
        }
        self.border_up(a);
        self.down_region::<Double>(path, y, a, below, packed);
        self.base.take_all(path, y, u);
    }

    /// (y, a) <- L^-T (y, a) as far as `path` goes, y in places of L.
    fn down_region<P: Precision>(
        &self,
        path: &Path,
        y: &mut [f64],
        a: &mut [f64],
        below: &mut [f64],
        packed: &mut [f64],
    ) {
        self.border_down(a);
        packed.fill(0.0);
        for b in &self.batches {
            let own = &a[b.before..b.before + b.m];
            for (i, j, n) in path.common(&b.path) {
                add_columns(
                    &mut packed[i..i + n],
                    &P::of(&b.w)[j..],
                    b.path.n_rows(),
                    own,
                );
            }
        }
        self.base.scatter_subtract(path, packed, y);
        self.base.backward::<P>(path, y, below);
    }

    fn solve_one(&self, x: &mut [f64], scratch: &mut SolveScratch) {
        let (u, a) = x.split_at_mut(self.base.n());
        let SolveScratch {
            y,
            below,
            packed,
            whole: path,
            ..
        } = scratch;
        self.base.place_all(path, u, y);
        self.up::<Double>(path, y, a, below, packed);
        self.down::<Double>(path, y, a, below, packed);
        self.base.take_all(path, y, u);
    }

    /// (y, a) <- L^-1 (y, a) of the whole factor, y in places of L.
    fn up<P: Precision>(
        &self,
        path: &Path,
        y: &mut [f64],
        a: &mut [f64],
        below: &mut [f64],
        packed: &mut [f64],
    ) {
        self.base.forward::<P>(path, y, below);
        for b in &self.batches {
            let packed = &mut packed[..b.path.n_rows()];
            self.base.gather(&b.path, y, packed);
            subtract_dots(
                &mut a[b.before..b.before + b.m],
                P::of(&b.w),
                packed.len(),
                packed,
            );
        }
        self.border_up(a);
    }

    /// (y, a) <- L^-T (y, a) of the whole factor, y in places of L.
    fn down<P: Precision>(
        &self,
        path: &Path,
        y: &mut [f64],
        a: &mut [f64],
        below: &mut [f64],
        packed: &mut [f64],
    ) {
        self.border_down(a);
        self.subtract_border::<P>(y, a, packed);
        self.base.backward::<P>(path, y, below);
    }

    /// y <- y - W a.
    fn subtract_border<P: Precision>(&self, y: &mut [f64], a: &[f64], packed: &mut [f64]) {
        for b in &self.batches {
            let (packed, own) = (&mut packed[..b.path.n_rows()], &a[b.before..b.before + b.m]);
            packed.fill(0.0);
            add_columns(packed, P::of(&b.w), packed.len(), own);
            self.base.scatter_subtract(&b.path, packed, y);
        }
    }

    /// The forward half of a solve: `swept` becomes L^-1 b.
    pub fn sweep_up(&self, b: &[f64], swept: &mut Swept, scratch: &mut SolveScratch) {
        swept.set(b);
        let (y, a) = swept.values.split_at_mut(self.base.n());
        let SolveScratch {
            below,
            packed,
            whole,
            ..
        } = scratch;
        self.base.place_all(whole, &b[..y.len()], y);
        self.up::<Single>(whole, y, a, below, packed);
    }

    /// The backward half of a solve: x = L^-T `swept`, which is used up.
    pub fn sweep_down(&self, swept: &mut Swept, x: &mut [f64], scratch: &mut SolveScratch) {
        let (u, a) = x.split_at_mut(self.base.n());
        let (y, border) = swept.values.split_at_mut(u.len());
        let SolveScratch {
            below,
            packed,
            whole,
            ..
        } = scratch;
        self.down::<Single>(whole, y, border, below, packed);
        self.base.take_all(whole, y, u);
        a.copy_from_slice(border);
    }

    /// As [`sweep_down`](Self::sweep_down), but only in a region: what lies outside it in `x` keeps its value. `swept` is kept.
    pub fn sweep_down_region(
        &self,
        region: &Region,
        swept: &Swept,
        x: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        let (u, a) = x.split_at_mut(self.base.n());
        let SolveScratch {
            y, below, packed, ..
        } = scratch;
        let path = &region.path;
        let (kept, border) = swept.values.split_at(u.len());
        a.copy_from_slice(border);
        self.base.copy(path, kept, y);
        let packed = &mut packed[..path.n_rows()];
        self.down_region::<Single>(path, y, a, below, packed);
        self.base.take_all(path, y, u);
    }

    /// Completes what [`sweep_down_region`](Self::sweep_down_region) left out, from what it wrote to `x`; `swept` must be the same,
    /// and is used up.
    pub fn sweep_down_rest(
        &self,
        region: &Region,
        swept: &mut Swept,
        x: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        let (u, a) = x.split_at_mut(self.base.n());
        let SolveScratch {
            below,
            packed,
            whole,
            ..
        } = scratch;
        let (y, _) = swept.values.split_at_mut(u.len());
        self.subtract_border::<Single>(y, a, packed);
        self.base.place_all(&region.path, u, y);
        self.base.backward::<Single>(&region.rest, y, below);
        self.base.take_all(whole, y, u);
    }

    /// swept += H q for half-solved columns H.
    pub fn add_half(&self, half: &HalfSolved, q: &[f64], swept: &mut Swept) {
        let n_rows = half.path.n_rows();
        let mut sum = vec![0.0; n_rows];
        add_columns(&mut sum, &half.base, n_rows, q);
        let (y, border) = swept.values.split_at_mut(self.base.n());
        self.base.scatter_add(&half.path, &sum, y);
        let rows = half.border.chunks_exact(half.m.max(1));
        for (a, row) in border.iter_mut().zip(rows) {
            *a += dot(row, q);
        }
    }

    /// swept += L^-1 b for a sparse right-hand side b (unknown, value), in single precision as all sweeps are: what
    /// [`half_solve`](Self::half_solve) and [`add_half`](Self::add_half) do in double precision and for several.
    pub fn add_load(&self, load: &[(u32, f64)], swept: &mut Swept, scratch: &mut SolveScratch) {
        let n = self.base.n();
        let SolveScratch {
            y,
            below,
            packed,
            border,
            ..
        } = scratch;
        let in_base = |e: &&(u32, f64)| (e.0 as usize) < n;
        let path = self.base.path(load.iter().filter(in_base).map(|e| e.0));
        self.base.clear(&path, y);
        border.clear();
        border.resize(self.n_border, 0.0);
        for &(i, v) in load {
            match (i as usize).checked_sub(n) {
                None => y[self.base.place(i)] += v,
                Some(j) => border[j] += v,
            }
        }
        self.base.forward::<Single>(&path, y, below);
        let packed = &mut packed[..path.n_rows()];
        self.base.gather(&path, y, packed);
        for b in &self.batches {
            let own = &mut border[b.before..b.before + b.m];
            for (i, j, n) in path.common(&b.path) {
                let w = &Single::of(&b.w)[j..];
                subtract_dots(own, w, b.path.n_rows(), &packed[i..i + n]);
            }
        }
        self.border_up(border);
        let (y, a) = swept.values.split_at_mut(n);
        self.base.scatter_add(&path, packed, y);
        a.iter_mut().zip(&*border).for_each(|(a, b)| *a += b);
    }

    /// H^T swept, which is B^T K^-1 b for the columns B of H and the right-hand side b of `swept`.
    pub fn project(&self, half: &HalfSolved, swept: &Swept) -> Vec<f64> {
        let n_rows = half.path.n_rows();
        let mut packed = vec![0.0; n_rows];
        let (y, border) = swept.values.split_at(self.base.n());
        self.base.gather(&half.path, y, &mut packed);
        let mut p = vec![0.0; half.m];
        subtract_dots(&mut p, &half.base, n_rows, &packed);
        p.iter_mut().for_each(|v| *v = -*v);
        add_columns(&mut p, &half.border, half.m, &border[..half.n_border]);
        p
    }

    /// a <- L_S^-1 a.
    fn border_up(&self, a: &mut [f64]) {
        let mut buffer = [0.0; MOST_COLUMNS];
        for b in &self.batches {
            let (known, rest) = a.split_at_mut(b.before);
            let own = &mut rest[..b.m];
            let sum = &mut buffer[..b.m];
            sum.fill(0.0);
            add_columns(sum, &b.rows, b.m, known);
            let triangle = &b.rows[b.m * b.before..];
            for c in 0..b.m {
                let column = &triangle[c * b.m..(c + 1) * b.m];
                own[c] = (own[c] - sum[c]) / column[c];
                for r in c + 1..b.m {
                    sum[r] += column[r] * own[c];
                }
            }
        }
    }

    /// a <- L_S^-T a.
    fn border_down(&self, a: &mut [f64]) {
        for b in self.batches.iter().rev() {
            let (known, rest) = a.split_at_mut(b.before);
            let own = &mut rest[..b.m];
            let triangle = &b.rows[b.m * b.before..];
            for c in (0..b.m).rev() {
                let column = &triangle[c * b.m..(c + 1) * b.m];
                own[c] = (own[c] - dot(&column[c + 1..], &own[c + 1..])) / column[c];
            }
            subtract_dots(known, &b.rows, b.m, own);
        }
    }

    /// The forward half of a solve for sparse columns (unknown, value).
    pub fn half_solve(&self, columns: &[Vec<(u32, f64)>]) -> HalfSolved {
        let (m, n) = (columns.len(), self.base.n() as u32);
        let in_base = |c: &Vec<(u32, f64)>| c.iter().filter(|e| e.0 < n).copied().collect();
        let base: Vec<Vec<_>> = columns.iter().map(in_base).collect();
        let base: Vec<_> = base.iter().map(Vec::as_slice).collect();
        let (path, base) = self.forward_base(&base);
        let mut border = vec![0.0; m * self.n_border];
        for (i, column) in columns.iter().enumerate() {
            for &(j, v) in column.iter().filter(|e| e.0 >= n) {
                border[i + m * (j - n) as usize] += v;
            }
        }
        for b in &self.batches {
            let own = &mut border[m * b.before..m * (b.before + b.m)];
            subtract_common(own, m, (&path, &base, m), (&b.path, b.w.double(), b.m));
        }
        self.forward_border(&mut border, m);
        HalfSolved {
            path,
            base,
            border,
            n_border: self.n_border,
            m,
        }
    }
}

impl HalfSolved {
    /// Number of columns.
    pub fn n_columns(&self) -> usize {
        self.m
    }

    /// B^T K^-1 C, column-major, where `self` is half of K^-1 B and `other` of K^-1 C.
    pub fn compliance(&self, other: &Self) -> Vec<f64> {
        let mut c = vec![0.0; self.m * other.m];
        let (m, n) = (self.m, other.m);
        subtract_common(
            &mut c,
            m,
            (&self.path, &self.base, m),
            (&other.path, &other.base, n),
        );
        let a = view(&self.border, m, 0, m, self.n_border);
        let b = view(&other.border, n, 0, n, other.n_border);
        subtract_product(view_mut(&mut c, m, 0, m, n), a, b.transpose());
        c.iter_mut().for_each(|v| *v = -*v);
        c
    }
}

type Packed<'a> = (&'a Path, &'a [f64], usize);

/// c -= a^T b over the rows that two packed panels have in common; c is column-major with `stride` rows.
fn subtract_common(c: &mut [f64], stride: usize, a: Packed, b: Packed) {
    let ((a_path, a, a_columns), (b_path, b, b_columns)) = (a, b);
    for (i, j, n) in a_path.common(b_path) {
        subtract_product(
            view_mut(c, stride, 0, a_columns, b_columns),
            view(a, a_path.n_rows(), i, n, a_columns).transpose(),
            view(b, b_path.n_rows(), j, n, b_columns),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::block_matrix::BlockMatrix;
    use super::*;
    use crate::geometry::Vec3;
    use nalgebra::{DMatrix, DVector, Matrix3};

    /// A chain of blocks with some far couplings, positive definite by its diagonal.
    fn matrix(n_blocks: usize) -> BlockMatrix {
        let pairs = |b: u32| [(b / 2, b), (b.saturating_sub(1), b), (b / 5, b)];
        let pairs: Vec<_> = (1..n_blocks as u32).flat_map(pairs).collect();
        let mut matrix = BlockMatrix::zeros(n_blocks, pairs.iter().copied());
        for (k, (col, row)) in pairs.into_iter().enumerate() {
            let v = |r: usize, c: usize| ((k * 7 + 3 * r + c) as f64).sin();
            matrix.add(row, col, &Matrix3::from_fn(v));
        }
        for b in 0..n_blocks as u32 {
            let spin = Matrix3::from_fn(|r, c| 0.1 * ((r + c) as f64).cos());
            matrix.add(b, b, &(Matrix3::identity() * 20.0 + spin));
        }
        matrix
    }

    fn factor(matrix: &BlockMatrix) -> Result<Factor, FactorError> {
        let at = |b: usize| Vec3::new(b as f64, 0.0, 0.0);
        let positions: Vec<_> = (0..matrix.n_blocks()).map(at).collect();
        Factor::new(matrix, &positions)
    }

    fn dense(matrix: &BlockMatrix) -> DMatrix<f64> {
        let n = 3 * matrix.n_blocks();
        let mut full = DMatrix::zeros(n, n);
        for j in 0..n {
            let mut x = vec![0.0; n];
            x[j] = 1.0;
            let mut y = vec![0.0; n];
            matrix.multiply_add(&x, &mut y);
            full.set_column(j, &DVector::from_vec(y));
        }
        full
    }

    /// The factor of the leading `n_base` blocks, bordered by the rest in two growths.
    fn bordered(full: &DMatrix<f64>, base: &BlockMatrix) -> Bordered {
        let n = 3 * base.n_blocks();
        let row = |i: usize| BorderRow {
            base: (0..n)
                .filter(|j| full[(i, *j)] != 0.0)
                .map(|j| (j as u32, full[(i, j)]))
                .collect(),
            border: (n..=i).map(|j| ((j - n) as u32, full[(i, j)])).collect(),
        };
        let rows: Vec<_> = (n..full.nrows()).map(row).collect();
        let bordered = Bordered::new(factor(base).unwrap());
        let once = bordered.grown(&rows[..5]).unwrap();
        once.grown(&rows[5..]).unwrap()
    }

    #[test]
    fn solves_and_half_solves_agree_with_a_dense_inverse() {
        let whole = matrix(70);
        let full = dense(&whole);
        let base = {
            let mut base =
                BlockMatrix::zeros(40, whole.iter().filter(|e| e.0 < 40).map(|e| (e.1, e.0)));
            for (row, col, k) in whole.iter().filter(|e| e.0 < 40) {
                base.add(row, col, k);
            }
            base
        };
        let inverse = full.clone().try_inverse().unwrap();
        let factor = bordered(&full, &base);
        assert_eq!((factor.n(), factor.n_border()), (210, 90));
        let b = DVector::from_fn(210, |i, _| (i as f64).cos());
        let mut x = b.as_slice().to_vec();
        factor.solve(&mut x, &mut factor.scratch());
        let exact = &inverse * &b;
        assert!((DVector::from_vec(x) - &exact).amax() < 1e-13);

        let columns = [
            vec![(3, 1.0), (50, -2.0)],
            vec![(7, 1.0)],
            vec![(100, 0.5), (180, 1.5)],
        ];
        let of = |column: &[(u32, f64)]| {
            let mut v = DVector::zeros(210);
            column.iter().for_each(|e| v[e.0 as usize] += e.1);
            v
        };
        let half = factor.half_solve(&columns);
        let other = factor.half_solve(&columns[1..]);
        let c = half.compliance(&other);
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns[1..].iter().enumerate() {
                let exact = of(a).dot(&(&inverse * of(b)));
                assert!((c[i + 3 * j] - exact).abs() < 1e-14);
            }
        }
        for n_last in [1, 40, 90] {
            let mut b = DVector::zeros(210);
            b.rows_mut(210 - n_last, n_last).fill(-0.7);
            let exact = b.dot(&(&inverse * &b));
            assert!((factor.work_of_last(&b.as_slice()[210 - n_last..]) - exact).abs() < 1e-12);
        }
        let region = factor.region([3, 50, 190]);
        let mut x = of(&columns[0]).as_slice().to_vec();
        let exact = &inverse * of(&columns[0]);
        factor.solve_region(&region, &mut x, &mut factor.scratch());
        for i in [3, 50, 125, 190] {
            assert!((x[i] - exact[i]).abs() < 1e-14);
        }
        let (mut swept, mut scratch) = (Swept::default(), factor.scratch());
        factor.sweep_up(b.as_slice(), &mut swept, &mut scratch);
        let mut near = vec![0.0; 210];
        factor.sweep_down_region(&region, &swept, &mut near, &mut scratch);
        let mut x = vec![0.0; 210];
        factor.sweep_down(&mut swept, &mut x, &mut scratch);
        let apart = |i: usize, near: &[f64]| (near[i] - x[i]).abs();
        let unknowns = region.unknowns().iter();
        assert!(unknowns.clone().all(|i| apart(*i as usize, &near) < 1e-15));
        factor.sweep_up(b.as_slice(), &mut swept, &mut scratch);
        factor.sweep_down_rest(&region, &mut swept, &mut near, &mut scratch);
        assert!((0..210).all(|i| apart(i, &near) < 1e-15));

        // In single precision what is added agrees to some 1e-7 of it.
        for column in &columns {
            factor.sweep_up(b.as_slice(), &mut swept, &mut scratch);
            let mut exact = swept.clone();
            let half = factor.half_solve(std::slice::from_ref(column));
            factor.add_half(&half, &[1.0], &mut exact);
            factor.add_load(column, &mut swept, &mut scratch);
            let pairs = swept.values().iter().zip(exact.values());
            let apart = pairs.fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(apart < 1e-6, "{apart}");
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut base = matrix(3);
        let row = BorderRow {
            base: vec![(0, 30.0)],
            border: vec![(0, 1.0)],
        };
        let grown = Bordered::new(factor(&base).unwrap()).grown(&[row]);
        assert_eq!(grown.unwrap_err(), FactorError::NotPositiveDefinite);
        base.add(2, 2, &(Matrix3::identity() * -30.0));
        let refused = factor(&base).unwrap_err();
        assert_eq!(refused, FactorError::NotPositiveDefinite);
    }
}
