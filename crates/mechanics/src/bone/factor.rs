use super::block_matrix::BlockMatrix;
use super::dense::{
    Double, Precision, Stored, TOGETHER, inlined, touch, vectorized, view, view_mut,
};
use super::ordering::nested_dissection;
use crate::geometry::Vec3;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::linalg::{
    SupernodalThreshold, SymbolicSupernodalParams, cholesky::supernodal::SymbolicSupernodalCholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Accum, Par, Side, Spec};

/// Why a matrix could not be factored.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum FactorError {
    /// Some part of the body is held by nothing.
    #[error(
        "the stiffness matrix is not positive definite: some part of the bone is held by nothing"
    )]
    NotPositiveDefinite,
    /// The factor does not fit into memory.
    #[error("not enough memory to factor the stiffness matrix of {0} unknowns")]
    OutOfMemory(usize),
}

/// Supernodes of fewer values are swept column by column: calls of the dense kernels cost more than they save.
const SMALL: usize = 1200;

/// Two supernodes of at most so many columns together are merged if at most this share of what they hold becomes zeros. Sweeps are as
/// fast as memory, so zeros cost what values do; without any merging the factorisation takes a tenth longer.
const MERGED: [(usize, f64); 3] = [(4, 1.0), (16, 0.3), (48, 0.05)];

/// So many values are read ahead at once.
const TOUCHED: usize = 1 << 14;

/// "No supernode above."
const ROOT: u32 = u32::MAX;

/// Sparse Cholesky factor K = L L^T of a symmetric positive definite matrix of 3 x 3 blocks.
///
/// The blocks are ordered by nested dissection; faer computes L once. It is kept by supernodes (runs of columns with
/// one pattern, dense and column-major), so that a triangular solve can be held to those supernodes that a right-hand side
/// reaches: its path up the elimination tree.
#[derive(Clone, Debug)]
pub struct Factor {
    /// Place in L of each unknown, and back.
    place: Vec<u32>,
    unknown_at: Vec<u32>,
    /// First column of each supernode, and one past the last.
    first: Vec<u32>,
    supernode_of: Vec<u32>,
    parent: Vec<u32>,
    /// Rows of L below the columns of each supernode.
    pattern_first: Vec<usize>,
    pattern: Vec<u32>,
    value_first: Vec<usize>,
    values: Stored,
}

/// Supernodes that a set of right-hand sides reaches, from leaves to roots, with all above them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    pub(super) supernodes: Vec<u32>,
    /// First row of each in a packed column, and the number of rows.
    pub(super) offset: Vec<usize>,
}

impl Path {
    /// Number of rows in a packed column.
    pub fn n_rows(&self) -> usize {
        self.offset.last().copied().unwrap_or(0)
    }

    /// Runs of rows that two packed columns have in common: (first row in `self`, in `other`, how many).
    pub(super) fn common<'a>(
        &'a self,
        other: &'a Self,
    ) -> impl Iterator<Item = (usize, usize, usize)> + 'a {
        let (mut i, mut j) = (0, 0);
        let (a, b) = (&self.supernodes, &other.supernodes);
        std::iter::from_fn(move || {
            while i < a.len() && j < b.len() && a[i] != b[j] {
                if a[i] < b[j] {
                    i += 1;
                } else {
                    j += 1;
                }
            }
            let (i0, j0) = (i, j);
            while i < a.len() && j < b.len() && a[i] == b[j] {
                i += 1;
                j += 1;
            }
            (i > i0).then(|| {
                let rows = self.offset[i] - self.offset[i0];
                (self.offset[i0], other.offset[j0], rows)
            })
        })
    }
}

impl Factor {
    /// Orders, analyses and factors. `positions`: where each block acts, for the ordering.
    ///
    /// # Errors
    /// [`FactorError`] if the matrix is not positive definite or does not fit.
    pub fn new(matrix: &BlockMatrix, positions: &[Vec3]) -> Result<Self, FactorError> {
        let n = 3 * matrix.n_blocks();
        let memory = |_| FactorError::OutOfMemory(n);
        let (starts, rows) = matrix.pattern();
        let blocks = nested_dissection(starts, rows, positions);
        let unknown_at: Vec<usize> = blocks
            .iter()
            .flat_map(|b| (0..3).map(move |k| 3 * *b as usize + k))
            .collect();
        let mut place = vec![0; n];
        unknown_at
            .iter()
            .enumerate()
            .for_each(|(p, u)| place[*u] = p);
        let (starts, rows, values) = scalar_columns(matrix);
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            supernodal_params: SymbolicSupernodalParams {
                relax: Some(&MERGED),
            },
            ..Default::default()
        };
        let permutation = PermRef::new_checked(&unknown_at, &place, n);
        let ordering = SymmetricOrdering::Custom(permutation);
        let symbolic = factorize_symbolic_cholesky(pattern, Side::Lower, ordering, params)
            .map_err(|_| FactorError::OutOfMemory(n))?;
        let mut factor = vec![0.0; symbolic.len_val()];
        let need = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let mut buffer = MemBuffer::try_new(need).map_err(memory)?;
        symbolic
            .factorize_numeric_llt(
                &mut factor,
                SparseColMatRef::new(pattern, &values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut buffer),
                Spec::default(),
            )
            .map_err(|_| FactorError::NotPositiveDefinite)?;
        let SymbolicCholeskyRaw::Supernodal(supernodes) = symbolic.raw() else {
            return Err(FactorError::OutOfMemory(n));
        };
        let narrow = |v: Vec<usize>| v.into_iter().map(|i| i as u32).collect();
        Ok(Self::from_supernodes(
            supernodes,
            factor,
            narrow(place),
            narrow(unknown_at),
        ))
    }

    fn from_supernodes(
        symbolic: &SymbolicSupernodalCholesky<usize>,
        values: Vec<f64>,
        place: Vec<u32>,
        unknown_at: Vec<u32>,
    ) -> Self {
        let mut first: Vec<u32> = symbolic
            .supernode_begin()
            .iter()
            .map(|s| *s as u32)
            .collect();
        first.push(symbolic.nrows() as u32);
        let mut supernode_of = vec![0; symbolic.nrows()];
        let (mut pattern_first, mut pattern) = (vec![0], Vec::new());
        for s in 0..symbolic.n_supernodes() {
            supernode_of[first[s] as usize..first[s + 1] as usize].fill(s as u32);
            pattern.extend(symbolic.supernode(s).pattern().iter().map(|r| *r as u32));
            pattern_first.push(pattern.len());
        }
        let above = |s: usize| pattern[pattern_first[s]..pattern_first[s + 1]].first();
        let parent = (0..symbolic.n_supernodes())
            .map(|s| above(s).map_or(ROOT, |r| supernode_of[*r as usize]))
            .collect();
        Self {
            place,
            unknown_at,
            first,
            parent,
            supernode_of,
            pattern_first,
            pattern,
            value_first: symbolic.col_ptr_for_val().to_vec(),
            values: Stored::new(values),
        }
    }

    /// Number of unknowns.
    pub fn n(&self) -> usize {
        self.place.len()
    }

    /// The unknowns in the order in which they were eliminated.
    pub fn ordering(&self) -> &[u32] {
        &self.unknown_at
    }

    /// Number of values kept.
    pub fn n_values(&self) -> usize {
        self.values.len()
    }

    /// The path of right-hand sides that are zero but at the given unknowns.
    pub fn path(&self, unknowns: impl IntoIterator<Item = u32>) -> Path {
        let mut seen = vec![false; self.parent.len()];
        let mut supernodes = Vec::new();
        for u in unknowns {
            let mut s = self.supernode_of[self.place[u as usize] as usize];
            while s != ROOT && !std::mem::replace(&mut seen[s as usize], true) {
                supernodes.push(s);
                s = self.parent[s as usize];
            }
        }
        supernodes.sort_unstable();
        self.path_of(supernodes)
    }

    /// All supernodes.
    pub fn whole(&self) -> Path {
        self.path_of((0..self.parent.len() as u32).collect())
    }

    /// All supernodes but those of `path`.
    pub(super) fn rest(&self, path: &Path) -> Path {
        let is_off = |s: &u32| path.supernodes.binary_search(s).is_err();
        self.path_of((0..self.parent.len() as u32).filter(is_off).collect())
    }

    /// Packs the rows of `path` out of places of L.
    pub(super) fn gather(&self, path: &Path, y: &[f64], packed: &mut [f64]) {
        for (&s, &offset) in path.supernodes.iter().zip(&path.offset) {
            let columns = self.columns(s as usize);
            packed[offset..offset + columns.len()].copy_from_slice(&y[columns]);
        }
    }

    /// Subtracts packed rows from their places in L.
    pub(super) fn scatter_subtract(&self, path: &Path, packed: &[f64], y: &mut [f64]) {
        for (&s, &offset) in path.supernodes.iter().zip(&path.offset) {
            let from = y[self.columns(s as usize)]
                .iter_mut()
                .zip(&packed[offset..]);
            from.for_each(|(y, p)| *y -= p);
        }
    }

    /// Adds packed rows to their places in L.
    pub(super) fn scatter_add(&self, path: &Path, packed: &[f64], y: &mut [f64]) {
        for (&s, &offset) in path.supernodes.iter().zip(&path.offset) {
            let to = y[self.columns(s as usize)].iter_mut();
            to.zip(&packed[offset..]).for_each(|(y, p)| *y += p);
        }
    }

    fn path_of(&self, supernodes: Vec<u32>) -> Path {
        let mut offset = vec![0];
        for &s in &supernodes {
            offset.push(offset[offset.len() - 1] + self.columns(s as usize).len());
        }
        Path { supernodes, offset }
    }

    /// Columns of supernode `s`.
    pub(super) fn columns(&self, s: usize) -> std::ops::Range<usize> {
        self.first[s] as usize..self.first[s + 1] as usize
    }

    /// Row of unknown `i` in columns packed along `path`.
    pub(super) fn packed_row(&self, path: &Path, i: usize) -> usize {
        let place = self.place[i];
        let s = self.supernode_of[place as usize];
        let at = path.supernodes.partition_point(|t| *t < s);
        path.offset[at] + (place - self.first[s as usize]) as usize
    }

    /// Copies the unknowns on `path` to their places in L.
    pub(super) fn place_all(&self, path: &Path, x: &[f64], y: &mut [f64]) {
        for &s in &path.supernodes {
            self.columns(s as usize)
                .for_each(|i| y[i] = x[self.unknown_at[i] as usize]);
        }
    }

    /// Makes what lies on `path` zero, in places of L.
    pub(super) fn clear(&self, path: &Path, y: &mut [f64]) {
        for &s in &path.supernodes {
            y[self.columns(s as usize)].fill(0.0);
        }
    }

    /// Place in L of an unknown.
    pub(super) fn place(&self, unknown: u32) -> usize {
        self.place[unknown as usize] as usize
    }

    /// Copies what lies on `path`, both in places of L.
    pub(super) fn copy(&self, path: &Path, from: &[f64], to: &mut [f64]) {
        for &s in &path.supernodes {
            let columns = self.columns(s as usize);
            to[columns.clone()].copy_from_slice(&from[columns]);
        }
    }

    /// Copies back what [`place_all`](Self::place_all) placed.
    pub(super) fn take_all(&self, path: &Path, y: &[f64], x: &mut [f64]) {
        for &s in &path.supernodes {
            self.columns(s as usize)
                .for_each(|i| x[self.unknown_at[i] as usize] = y[i]);
        }
    }

    fn pattern(&self, s: usize) -> &[u32] {
        &self.pattern[self.pattern_first[s]..self.pattern_first[s + 1]]
    }

    fn values<P: Precision>(&self, s: usize) -> &[P::Value] {
        &P::of(&self.values)[self.value_first[s]..self.value_first[s + 1]]
    }

    /// Length of the longest column: what the sweeps need for `below`.
    pub(super) fn longest_column(&self) -> usize {
        (0..self.parent.len())
            .map(|s| self.columns(s).len() + self.pattern(s).len())
            .max()
            .unwrap_or(0)
    }

    /// y <- L^-1 y for a y that is zero off `path`, in places of L. Supernodes where y is zero cost nothing.
    pub(super) fn forward<P: Precision>(&self, path: &Path, y: &mut [f64], below: &mut [f64]) {
        vectorized(
            #[inline(always)]
            || {
                for &s in &path.supernodes {
                    self.forward_one::<P>(s as usize, y, below);
                }
            },
        );
    }

    #[inline(always)]
    fn forward_one<P: Precision>(&self, s: usize, y: &mut [f64], below: &mut [f64]) {
        let (columns, pattern) = (self.columns(s), self.pattern(s));
        let (n, stride) = (columns.len(), columns.len() + pattern.len());
        if is_zero(&y[columns.clone()]) {
            return;
        }
        let l = self.values::<P>(s);
        if l.len() <= TOUCHED {
            touch(l);
        }
        // The rows that the columns meet, one after the other: their own, then what they give to those below.
        let met = &mut below[..stride];
        met[..n].copy_from_slice(&y[columns.clone()]);
        met[n..].fill(0.0);
        for c in (0..n).step_by(TOGETHER) {
            let past = n.min(c + TOGETHER);
            let own = &l[c * stride..past * stride];
            if l.len() > TOUCHED {
                touch(own);
            }
            let (top, rest) = met.split_at_mut(past);
            let mut x = [0.0; TOGETHER];
            for i in c..past {
                let mut given = 0.0;
                for j in c..i {
                    given += own[(j - c) * stride + i].into() * top[j];
                }
                top[i] = (top[i] - given) / own[(i - c) * stride + i].into();
                x[i - c] = -top[i];
            }
            inlined::add_columns(rest, &own[past..], stride, &x[..past - c]);
        }
        y[columns].copy_from_slice(&met[..n]);
        for (row, m) in pattern.iter().zip(&met[n..]) {
            y[*row as usize] += m;
        }
    }

    /// y <- L^-T y on `path`, in places of L. Supernodes that stay zero cost next to nothing.
    pub(super) fn backward<P: Precision>(&self, path: &Path, y: &mut [f64], below: &mut [f64]) {
        vectorized(
            #[inline(always)]
            || {
                for &s in path.supernodes.iter().rev() {
                    self.backward_one::<P>(s as usize, y, below);
                }
            },
        );
    }

    #[inline(always)]
    fn backward_one<P: Precision>(&self, s: usize, y: &mut [f64], below: &mut [f64]) {
        let (columns, pattern) = (self.columns(s), self.pattern(s));
        let (n, stride) = (columns.len(), columns.len() + pattern.len());
        let l = self.values::<P>(s);
        // All that the columns meet, one after the other.
        let met = &mut below[..stride];
        met[..n].copy_from_slice(&y[columns.clone()]);
        for (b, row) in met[n..].iter_mut().zip(pattern) {
            *b = y[*row as usize];
        }
        if is_zero(met) {
            return;
        }
        let first_of_last = n.saturating_sub(1) / TOGETHER * TOGETHER;
        for c in (0..=first_of_last).rev().step_by(TOGETHER) {
            let past = n.min(c + TOGETHER);
            let (top, known) = met.split_at_mut(past);
            let own = &l[c * stride..past * stride];
            inlined::subtract_dots(&mut top[c..], &own[past..], stride, known);
            for i in (c..past).rev() {
                let column = &own[(i - c) * stride..];
                let rest: f64 = (i + 1..past).map(|j| column[j].into() * top[j]).sum();
                top[i] = (top[i] - rest) / column[i].into();
            }
        }
        y[columns].copy_from_slice(&met[..n]);
    }

    /// L^-1 of `m` columns packed along their common path, in place.
    pub(super) fn forward_packed(&self, path: &Path, panel: &mut [f64], m: usize) {
        let n_rows = path.n_rows();
        let mut shift = vec![0usize; self.parent.len()];
        for (s, offset) in path.supernodes.iter().zip(&path.offset) {
            // Rows of the path never lie before their packed place.
            shift[*s as usize] = self.first[*s as usize] as usize - offset;
        }
        let mut below = vec![0.0; self.longest_column() * m];
        let mut rows = Vec::with_capacity(self.longest_column());
        for (&s, &offset) in path.supernodes.iter().zip(&path.offset) {
            let (n, pattern) = (self.columns(s as usize).len(), self.pattern(s as usize));
            let (l, stride) = (self.values::<Double>(s as usize), n + pattern.len());
            let is_small = n * stride < SMALL;
            let below = &mut below[..pattern.len() * m];
            if is_small {
                below.fill(0.0);
            } else {
                let top = view_mut(panel, n_rows, offset, n, m);
                solve_lower_triangular_in_place(view(l, stride, 0, n, n), top, Par::Seq);
                let top = view(panel, n_rows, offset, n, m);
                let product = view_mut(below, pattern.len(), 0, pattern.len(), m);
                let lower = view(l, stride, n, pattern.len(), n);
                matmul(product, Accum::Replace, lower, top, 1.0, Par::Seq);
            }
            rows.clear();
            rows.extend((pattern.iter()).map(|row| {
                let row = *row as usize;
                row - shift[self.supernode_of[row] as usize]
            }));
            for (c, column) in panel.chunks_exact_mut(n_rows).enumerate() {
                let top = &mut column[offset..offset + n];
                // Each column has entries on its own path only.
                if top.iter().all(|v| *v == 0.0) {
                    continue;
                }
                let below = &mut below[c * rows.len()..(c + 1) * rows.len()];
                if is_small {
                    vectorized(
                        #[inline(always)]
                        || eliminate(l, stride, top, below),
                    );
                }
                rows.iter()
                    .zip(below)
                    .for_each(|(row, b)| column[*row] -= *b);
            }
        }
    }
}

/// One supernode's part of a forward sweep: its own rows become x, and what they take from those below is added to `below`.
#[inline(always)]
fn eliminate<T: Copy + Into<f64>>(l: &[T], stride: usize, top: &mut [f64], below: &mut [f64]) {
    let n = top.len();
    for c in 0..n {
        let column = &l[c * stride..c * stride + n];
        top[c] /= column[c].into();
        let x = top[c];
        for (t, l) in top[c + 1..].iter_mut().zip(&column[c + 1..]) {
            *t -= (*l).into() * x;
        }
    }
    if !below.is_empty() {
        inlined::add_columns(below, &l[n..], stride, top);
    }
}

#[inline(always)]
fn is_zero(y: &[f64]) -> bool {
    y.iter().all(|v| *v == 0.0)
}

fn scalar_columns(matrix: &BlockMatrix) -> (Vec<usize>, Vec<usize>, Vec<f64>) {
    let mut columns: Vec<usize> = vec![0; 3 * matrix.n_blocks() + 1];
    for (row, col, _) in matrix.iter() {
        for c in 0..3 {
            columns[3 * col as usize + c + 1] += if row == col { 3 - c } else { 3 };
        }
    }
    for j in 1..columns.len() {
        columns[j] += columns[j - 1];
    }
    let mut next = columns.clone();
    let n_values = columns[columns.len() - 1];
    let (mut rows, mut values) = (vec![0; n_values], vec![0.0; n_values]);
    for (row, col, k) in matrix.iter() {
        for c in 0..3 {
            for r in if row == col { c } else { 0 }..3 {
                let at = &mut next[3 * col as usize + c];
                rows[*at] = 3 * row as usize + r;
                values[*at] = k[(r, c)];
                *at += 1;
            }
        }
    }
    (columns, rows, values)
}
