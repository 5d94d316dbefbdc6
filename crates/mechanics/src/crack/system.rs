use super::enrichment::{Cell, STANDARD, Topology};
use crate::bone::{Factor, FactorError, SolveScratch, Supports, TetMaterial, stiffness};
use crate::geometry::{TetMesh, Vec3};
use nalgebra::Matrix3;

/// "No unknown": a held node or its enrichment.
const HELD: u32 = u32::MAX;

/// The linear equations of the cracked bone (paper, equation 3) with their factor.
///
/// Unknowns `x`: three for each block, blocks = nodes that are not fixed, then their enrichments. On linear tetrahedra no
/// quadrature is needed: the blocks of K_ua and K_aa are those of the element times volume shares of its cells.
///
/// Coordinates whose displacement is prescribed keep their place in `x`: a right-hand side starts from
/// [`add_prescribed`](Self::add_prescribed), and what [`solve`](Self::solve) makes of it holds the prescribed values.
#[derive(Clone, Debug)]
pub struct System {
    block_of_node: Vec<u32>,
    block_of_enrichment: Vec<u32>,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    /// Unknowns that are prescribed, ascending: nodes' and those of their enrichments.
    held: Vec<u32>,
    /// Right-hand side that stands for the prescribed displacements; empty if there are none.
    lift: Vec<f64>,
    factor: Factor,
}

impl System {
    /// Assembles and factors.
    ///
    /// # Errors
    /// [`FactorError`] if some part of the body is held by nothing, neither support nor ground spring.
    pub fn new(
        mesh: &TetMesh,
        materials: &[TetMaterial],
        topology: &Topology,
        supports: &Supports,
    ) -> Result<Self, FactorError> {
        let (block_of_node, block_of_enrichment) = number_blocks(mesh, topology, supports);
        let free = |b: &&u32| **b != HELD;
        let n_blocks = block_of_node
            .iter()
            .chain(&block_of_enrichment)
            .filter(free)
            .count();
        let mut blocks = BlockMatrix::new(n_blocks);
        let mut around = vec![0.0; mesh.nodes().len()];
        for (tet, v) in mesh.tets().iter().zip(mesh.volumes()) {
            tet.iter().for_each(|&n| around[n as usize] += v);
        }
        let mut spring = vec![supports.ground_spring; mesh.nodes().len()];
        for &(n, k) in &supports.springs {
            spring[n as usize] += k;
        }
        // First pass: where entries are; second: what they are.
        for _ in 0..2 {
            for cell in topology.cells() {
                let t = cell.tet as usize;
                let (lame, g) = (materials[t].lame(), &mesh.gradients()[t]);
                let unknowns = unknowns(mesh, cell, &block_of_node, &block_of_enrichment);
                let weight = mesh.volumes()[t] * cell.fraction;
                // Soft tissue holds the material, so each cell takes its share, also of what only its enrichments move.
                let ground: [f64; 4] =
                    mesh.tets()[t].map(|n| spring[n as usize] * weight / around[n as usize]);
                for a in 0..4 {
                    for b in 0..4 {
                        let mut k = stiffness::block(&lame, &g[a], &g[b]) * weight;
                        if a == b {
                            k += Matrix3::from_diagonal_element(ground[a]);
                        }
                        for &row in unknowns[a].iter().filter(free) {
                            for &col in unknowns[b].iter().filter(free) {
                                if row >= col {
                                    blocks.add(row, col, &k);
                                }
                            }
                        }
                    }
                }
            }
            blocks.freeze();
        }
        let (column_starts, rows, values) = blocks.into_lower_columns();
        let (held, moved) = held_unknowns(topology, supports, &block_of_node, &block_of_enrichment);
        let free_values = decoupled(&column_starts, &rows, &values, &held);
        let factor = Factor::new(&column_starts, &rows, &free_values)?;
        let mut system = Self {
            block_of_node,
            block_of_enrichment,
            column_starts,
            rows,
            values,
            held,
            lift: Vec::new(),
            factor,
        };
        system.lift = system.lift_of(&moved);
        Ok(system)
    }

    /// -K_fp u_p on free unknowns; on prescribed ones their value times their diagonal, which is all that the factor holds
    /// of them.
    fn lift_of(&self, moved: &[(u32, f64)]) -> Vec<f64> {
        if self.held.is_empty() {
            return Vec::new();
        }
        let mut x = vec![0.0; self.n()];
        moved.iter().for_each(|&(i, v)| x[i as usize] = v);
        let mut lift = self.multiply(&x);
        lift.iter_mut().for_each(|f| *f = -*f);
        for &i in &self.held {
            lift[i as usize] = self.values[self.column_starts[i as usize]] * x[i as usize];
        }
        lift
    }

    /// Adds what prescribed displacements do to the right-hand side. Nothing if there are none.
    pub fn add_prescribed(&self, rhs: &mut [f64]) {
        rhs.iter_mut().zip(&self.lift).for_each(|(f, l)| *f += l);
    }

    /// Number of unknowns.
    pub fn n(&self) -> usize {
        self.factor.n()
    }

    /// Memory for [`solve`](Self::solve) with up to `columns` right-hand sides.
    pub fn scratch(&self, columns: usize) -> SolveScratch {
        self.factor.scratch(columns)
    }

    /// Solves K x = f in place; `f` and `x` \[N, mm\], n values a right-hand side.
    pub fn solve(&self, x: &mut [f64], scratch: &mut SolveScratch) {
        self.factor.solve(x, scratch);
    }

    /// Adds a force \[N\] that acts at the point of `cell` with shape functions `weights` to the right-hand side. What acts on
    /// held coordinates goes into their supports.
    pub fn add_force(
        &self,
        mesh: &TetMesh,
        cell: &Cell,
        weights: &[f64; 4],
        force: &Vec3,
        rhs: &mut [f64],
    ) {
        let unknowns = unknowns(mesh, cell, &self.block_of_node, &self.block_of_enrichment);
        for (blocks, w) in unknowns.iter().zip(weights) {
            for &b in blocks.iter().filter(|b| **b != HELD) {
                for k in 0..3 {
                    let i = 3 * b + k;
                    if self.held.is_empty() || self.held.binary_search(&i).is_err() {
                        rhs[i as usize] += w * force[k as usize];
                    }
                }
            }
        }
    }

    /// Displacement of node `i` \[mm\]; of [`multiply`](Self::multiply)'s result, the force that holds it there \[N\].
    pub fn displacement(&self, i: usize, x: &[f64]) -> Vec3 {
        read(self.block_of_node[i], x)
    }

    /// Adds to the displacement of node `i`, unless it is fixed.
    pub fn add_displacement(&self, i: usize, by: &Vec3, x: &mut [f64]) {
        let b = self.block_of_node[i];
        if b != HELD {
            (0..3).for_each(|k| x[3 * b as usize + k] += by[k]);
        }
    }

    /// Displacements of a cell's four virtual nodes \[mm\].
    pub fn cell_displacements(&self, mesh: &TetMesh, cell: &Cell, x: &[f64]) -> [Vec3; 4] {
        let unknowns = unknowns(mesh, cell, &self.block_of_node, &self.block_of_enrichment);
        unknowns.map(|[node, enrichment]| read(node, x) + read(enrichment, x))
    }

    /// The unknowns of a displacement field that is `of_fragment(k, p)` at the points of fragment `k` and may jump between
    /// fragments; exact where the field is affine. For tests: rigid motions, for instance.
    pub fn interpolate(
        &self,
        mesh: &TetMesh,
        topology: &Topology,
        of_cell: impl Fn(&Cell, &Vec3) -> Vec3,
    ) -> Vec<f64> {
        let mut x = vec![0.0; self.n()];
        let mut write = |b: u32, v: &Vec3| (0..3).for_each(|k| x[3 * b as usize + k] = v[k]);
        let mut standard = vec![Vec3::zeros(); mesh.nodes().len()];
        for cell in topology.cells() {
            for (k, &n) in mesh.tets()[cell.tet as usize].iter().enumerate() {
                if cell.mask >> k & 1 == 1 {
                    standard[n as usize] = of_cell(cell, &mesh.nodes()[n as usize]);
                }
            }
        }
        for (i, v) in standard
            .iter()
            .enumerate()
            .filter(|(i, _)| self.block_of_node[*i] != HELD)
        {
            write(self.block_of_node[i], v);
        }
        for cell in topology.cells() {
            for (k, &n) in mesh.tets()[cell.tet as usize].iter().enumerate() {
                let e = cell.enrichment[k];
                if e != STANDARD && self.block_of_enrichment[e as usize] != HELD {
                    let jump = of_cell(cell, &mesh.nodes()[n as usize]) - standard[n as usize];
                    write(self.block_of_enrichment[e as usize], &jump);
                }
            }
        }
        x
    }

    /// K x, prescribed displacements included: the forces that hold the field `x`, reactions of prescribed coordinates among
    /// them \[N\].
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        for j in 0..x.len() {
            for p in self.column_starts[j]..self.column_starts[j + 1] {
                let i = self.rows[p];
                y[i] += self.values[p] * x[j];
                if i != j {
                    y[j] += self.values[p] * x[i];
                }
            }
        }
        y
    }

    /// Elastic energy 1/2 x . K x \[N mm\].
    pub fn energy(&self, x: &[f64]) -> f64 {
        0.5 * self
            .multiply(x)
            .iter()
            .zip(x)
            .map(|(a, b)| a * b)
            .sum::<f64>()
    }
}

fn read(block: u32, x: &[f64]) -> Vec3 {
    if block == HELD {
        Vec3::zeros()
    } else {
        Vec3::from_column_slice(&x[3 * block as usize..3 * block as usize + 3])
    }
}

fn number_blocks(mesh: &TetMesh, topology: &Topology, supports: &Supports) -> (Vec<u32>, Vec<u32>) {
    let mut next = 0;
    let mut number = |held: bool| {
        if held {
            return HELD;
        }
        next += 1;
        next - 1
    };
    let nodes = (0..mesh.nodes().len() as u32)
        .map(|i| number(supports.is_fixed(i)))
        .collect();
    let enrichments = topology
        .enriched_nodes()
        .iter()
        .map(|&i| number(supports.is_fixed(i)))
        .collect();
    (nodes, enrichments)
}

/// Unknowns that supports prescribe, ascending, and the displacements of those that move.
fn held_unknowns(
    topology: &Topology,
    supports: &Supports,
    of_node: &[u32],
    of_enrichment: &[u32],
) -> (Vec<u32>, Vec<(u32, f64)>) {
    let (mut held, mut moved) = (Vec::new(), Vec::new());
    for p in &supports.prescribed {
        let block = of_node[p.node as usize];
        if block != HELD {
            held.push(3 * block + u32::from(p.axis));
            moved.push((3 * block + u32::from(p.axis), p.value));
        }
    }
    for (&node, &block) in topology.enriched_nodes().iter().zip(of_enrichment) {
        let axes = supports.prescribed_at(node);
        held.extend(
            (0..3)
                .filter(|&k| block != HELD && axes[k as usize].is_some())
                .map(|k| 3 * block + k),
        );
    }
    held.sort_unstable();
    held.dedup();
    (held, moved)
}

/// The matrix with the couplings of held unknowns left out; their diagonal stays, so that its scale stays the body's.
fn decoupled(starts: &[usize], rows: &[usize], values: &[f64], held: &[u32]) -> Vec<f64> {
    let mut free = values.to_vec();
    if held.is_empty() {
        return free;
    }
    let mut is_held = vec![false; starts.len() - 1];
    held.iter().for_each(|&i| is_held[i as usize] = true);
    for j in 0..is_held.len() {
        for p in starts[j]..starts[j + 1] {
            if rows[p] != j && (is_held[j] || is_held[rows[p]]) {
                free[p] = 0.0;
            }
        }
    }
    free
}

/// The blocks whose sum is the displacement of each virtual node of a cell.
fn unknowns(mesh: &TetMesh, cell: &Cell, of_node: &[u32], of_enrichment: &[u32]) -> [[u32; 2]; 4] {
    let nodes = &mesh.tets()[cell.tet as usize];
    [0, 1, 2, 3].map(|k| {
        let e = cell.enrichment[k];
        [
            of_node[nodes[k] as usize],
            if e == STANDARD {
                HELD
            } else {
                of_enrichment[e as usize]
            },
        ]
    })
}

/// Lower triangle of a symmetric matrix of 3 x 3 blocks: first its pattern is collected, then values are added.
struct BlockMatrix {
    keys: Vec<u64>,
    first: Vec<usize>,
    values: Vec<Matrix3<f64>>,
}

impl BlockMatrix {
    fn new(n_blocks: usize) -> Self {
        Self {
            keys: (0..n_blocks as u64).map(|b| b << 32 | b).collect(),
            first: vec![0; n_blocks + 1],
            values: Vec::new(),
        }
    }

    fn freeze(&mut self) {
        if !self.values.is_empty() {
            return;
        }
        self.keys.sort_unstable();
        self.keys.dedup();
        self.values = vec![Default::default(); self.keys.len()];
        for k in &self.keys {
            self.first[(k >> 32) as usize + 1] += 1;
        }
        for j in 1..self.first.len() {
            self.first[j] += self.first[j - 1];
        }
    }

    fn add(&mut self, row: u32, col: u32, block: &Matrix3<f64>) {
        let key = u64::from(col) << 32 | u64::from(row);
        if self.values.is_empty() {
            self.keys.push(key);
            return;
        }
        let range = self.first[col as usize]..self.first[col as usize + 1];
        if let Ok(p) = self.keys[range.clone()].binary_search(&key) {
            self.values[range.start + p] += block;
        }
    }

    fn into_lower_columns(self) -> (Vec<usize>, Vec<usize>, Vec<f64>) {
        let mut starts = vec![0];
        let (mut rows, mut values) = (Vec::new(), Vec::new());
        for j in 0..self.first.len() - 1 {
            for c in 0..3 {
                for p in self.first[j]..self.first[j + 1] {
                    let i = (self.keys[p] & 0xffff_ffff) as usize;
                    for r in if i == j { c } else { 0 }..3 {
                        rows.push(3 * i + r);
                        values.push(self.values[p][(r, c)]);
                    }
                }
                starts.push(rows.len());
            }
        }
        (starts, rows, values)
    }
}
