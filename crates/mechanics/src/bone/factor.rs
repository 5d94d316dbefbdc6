use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{
    LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side, Spec};
use std::sync::Arc;

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

/// Sparse Cholesky factor of a symmetric positive definite matrix of 3 x 3 blocks (faer, AMD ordering).
#[derive(Clone)]
pub struct Factor {
    symbolic: Arc<SymbolicCholesky<usize>>,
    values: Vec<f64>,
}

/// Memory of a solve, kept so that solving allocates nothing.
pub struct SolveScratch {
    buffer: MemBuffer,
    columns: usize,
}

impl std::fmt::Debug for Factor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "Factor({} unknowns, {} values)",
            self.symbolic.nrows(),
            self.values.len()
        )
    }
}

impl std::fmt::Debug for SolveScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SolveScratch({} columns)", self.columns)
    }
}

impl Factor {
    /// Factors the matrix given by its lower triangle in compressed columns, rows ascending in each.
    ///
    /// # Errors
    /// [`FactorError`] if the matrix is not positive definite or does not fit.
    pub fn new(
        column_starts: &[usize],
        rows: &[usize],
        values: &[f64],
    ) -> Result<Self, FactorError> {
        let n = column_starts.len() - 1;
        let memory = |_| FactorError::OutOfMemory(n);
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, column_starts, None, rows);
        let symbolic = factorize_symbolic_cholesky(
            pattern,
            Side::Lower,
            SymmetricOrdering::Amd,
            Default::default(),
        )
        .map_err(memory)?;
        let mut factor = vec![0.0; symbolic.len_val()];
        let need = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let mut buffer = MemBuffer::try_new(need).map_err(|_| FactorError::OutOfMemory(n))?;
        symbolic
            .factorize_numeric_llt(
                &mut factor,
                SparseColMatRef::new(pattern, values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut buffer),
                Spec::default(),
            )
            .map_err(|_| FactorError::NotPositiveDefinite)?;
        Ok(Self {
            symbolic: Arc::new(symbolic),
            values: factor,
        })
    }

    /// Number of unknowns.
    pub fn n(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Memory for solves with up to `columns` right-hand sides.
    pub fn scratch(&self, columns: usize) -> SolveScratch {
        let need = self
            .symbolic
            .solve_in_place_scratch::<f64>(columns, Par::Seq);
        SolveScratch {
            buffer: MemBuffer::new(need),
            columns,
        }
    }

    /// Solves K x = b in place for right-hand sides stored one after the other. Allocates nothing.
    ///
    /// `x`: n values a right-hand side, at most as many as `scratch` was made for.
    pub fn solve(&self, x: &mut [f64], scratch: &mut SolveScratch) {
        let columns = x.len() / self.n().max(1);
        assert!(
            columns <= scratch.columns,
            "scratch is for {} right-hand sides, not {columns}",
            scratch.columns
        );
        let rhs = MatMut::from_column_major_slice_mut(x, self.n(), columns);
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            rhs,
            Par::Seq,
            MemStack::new(&mut scratch.buffer),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_a_tridiagonal_system() {
        let n = 40;
        let mut starts = vec![0];
        let (mut rows, mut values) = (Vec::new(), Vec::new());
        for j in 0..n {
            rows.push(j);
            values.push(2.5);
            if j + 1 < n {
                rows.push(j + 1);
                values.push(-1.0);
            }
            starts.push(rows.len());
        }
        let factor = Factor::new(&starts, &rows, &values).unwrap();
        let expected: Vec<f64> = (0..2 * n).map(|i| (i as f64).sin()).collect();
        let mut x = expected.clone();
        for c in 0..2 {
            let e = &expected[c * n..(c + 1) * n];
            for i in 0..n {
                let side = |k: Option<usize>| k.and_then(|k| e.get(k)).copied().unwrap_or(0.0);
                x[c * n + i] = 2.5 * e[i] - side(i.checked_sub(1)) - side(Some(i + 1));
            }
        }
        factor.solve(&mut x, &mut factor.scratch(2));
        for (a, b) in x.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let refused = Factor::new(&[0, 1, 2], &[0, 1], &[1.0, -1.0]);
        assert_eq!(refused.unwrap_err(), FactorError::NotPositiveDefinite);
    }
}
