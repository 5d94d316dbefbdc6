use nalgebra::Matrix3;

/// Symmetric sparse matrix of 3 x 3 blocks: its lower triangle by block columns, rows ascending in each.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    starts: Vec<usize>,
    rows: Vec<u32>,
    blocks: Vec<Matrix3<f64>>,
}

impl BlockMatrix {
    /// Zero in the pattern of the given (column, row) pairs of the lower triangle, in any order, repeated or not. Every
    /// diagonal block is part of the pattern.
    pub fn zeros(n_blocks: usize, pairs: impl IntoIterator<Item = (u32, u32)>) -> Self {
        let key = |(col, row)| u64::from(col) << 32 | u64::from(row);
        let mut keys: Vec<u64> = (0..n_blocks as u32).map(|b| key((b, b))).collect();
        keys.extend(pairs.into_iter().map(key));
        keys.sort_unstable();
        keys.dedup();
        let mut starts = vec![0; n_blocks + 1];
        for k in &keys {
            starts[(k >> 32) as usize + 1] += 1;
        }
        for j in 0..n_blocks {
            starts[j + 1] += starts[j];
        }
        Self {
            starts,
            rows: keys.iter().map(|k| *k as u32).collect(),
            blocks: vec![Matrix3::zeros(); keys.len()],
        }
    }

    /// Adds to block (row, col) of the lower triangle.
    ///
    /// # Panics
    /// If the block is not part of the pattern.
    pub fn add(&mut self, row: u32, col: u32, block: &Matrix3<f64>) {
        let first = self.starts[col as usize];
        let column = &self.rows[first..self.starts[col as usize + 1]];
        let p = column.binary_search(&row).expect("a block of the pattern");
        self.blocks[first + p] += block;
    }

    /// Number of block rows.
    pub fn n_blocks(&self) -> usize {
        self.starts.len() - 1
    }

    /// The blocks of the lower triangle as (row, column, block).
    pub fn iter(&self) -> impl Iterator<Item = (u32, u32, &Matrix3<f64>)> {
        (0..self.n_blocks()).flat_map(move |j| {
            let range = self.starts[j]..self.starts[j + 1];
            range.map(move |p| (self.rows[p], j as u32, &self.blocks[p]))
        })
    }

    /// The pattern: starts of the block columns and the rows in them.
    pub fn pattern(&self) -> (&[usize], &[u32]) {
        (&self.starts, &self.rows)
    }

    /// Adds K x to `y`.
    pub fn multiply_add(&self, x: &[f64], y: &mut [f64]) {
        for (row, col, k) in self.iter() {
            add_product(row, col, k, x, y);
        }
    }

    /// Leaves out the couplings of the scalar unknowns for which `is_held`; their diagonal stays, so that its scale stays
    /// the body's.
    pub fn decouple(&mut self, is_held: impl Fn(u32) -> bool) {
        for j in 0..self.n_blocks() {
            for p in self.starts[j]..self.starts[j + 1] {
                decouple(self.rows[p], j as u32, &mut self.blocks[p], &is_held);
            }
        }
    }
}

/// y += K x for one block of the lower triangle and its mirror image.
pub fn add_product(row: u32, col: u32, k: &Matrix3<f64>, x: &[f64], y: &mut [f64]) {
    let (i, j) = (3 * row as usize, 3 * col as usize);
    for r in 0..3 {
        y[i + r] += (0..3).map(|c| k[(r, c)] * x[j + c]).sum::<f64>();
    }
    if i != j {
        for c in 0..3 {
            y[j + c] += (0..3).map(|r| k[(r, c)] * x[i + r]).sum::<f64>();
        }
    }
}

/// Clears the entries of one block that couple held unknowns.
pub fn decouple(row: u32, col: u32, k: &mut Matrix3<f64>, is_held: impl Fn(u32) -> bool) {
    for r in 0..3 {
        for c in 0..3 {
            let (i, j) = (3 * row + r, 3 * col + c);
            if i != j && (is_held(i) || is_held(j)) {
                k[(r as usize, c as usize)] = 0.0;
            }
        }
    }
}
