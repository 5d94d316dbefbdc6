use super::enrichment::{Cell, STANDARD, Topology, lineage};
use crate::bone::{
    BlockMatrix, BorderRow, Bordered, Elasticity, Factor, FactorError, HalfSolved, Region,
    SolveScratch, Supports, Swept, TetMaterial, add_product, decouple,
};
use crate::geometry::{TetMesh, Vec3};
use nalgebra::Matrix3;
use std::sync::Arc;

/// "No unknown": a fixed node or its enrichment.
const FIXED: u32 = u32::MAX;

/// The linear equations of the cracked bone (paper, equation 3) with their factor.
///
/// Unknowns `x`: three for each block, blocks = nodes that are not fixed, then their enrichments. On linear tetrahedra no
/// quadrature is needed: the blocks of K_ua and K_aa are those of the element times volume shares of its cells.
///
/// Coordinates whose displacement is prescribed keep their place in `x`: a right-hand side starts from
/// [`add_prescribed`](Self::add_prescribed), and what [`solve`](Self::solve) makes of it holds the prescribed values.
///
/// When the crack grows, old unknowns and their stiffness stay what they are ([`Topology::grown`]): [`grown`](Self::grown)
/// appends rows to the factor and shares the rest with the system it came from.
#[derive(Clone, Debug)]
pub struct System {
    base: Arc<Base>,
    block_of_enrichment: Vec<u32>,
    parents: Vec<u32>,
    /// What came with each growth since the base was factored.
    border: Vec<Arc<Vec<BlockRow>>>,
    /// Unknowns that are prescribed, ascending: nodes' and those of their enrichments.
    held: Vec<u32>,
    /// Right-hand side that stands for the prescribed displacements; empty if there are none.
    lift: Vec<f64>,
    factor: Bordered,
}

/// What stays when the crack grows.
#[derive(Debug)]
struct Base {
    block_of_node: Vec<u32>,
    matrix: BlockMatrix,
    /// Ground spring of each node over the volume around it \[N/mm4\].
    ground: Vec<f64>,
    /// The part of it that drags \[N/mm4\], and of each node \[N/mm\].
    drag: Vec<f64>,
    node_drag: Vec<f64>,
    /// Unknowns that supports move, ascending, and how far \[mm\].
    moved: Vec<(u32, f64)>,
}

/// One block row of the border: blocks up to the diagonal.
#[derive(Clone, Debug)]
struct BlockRow {
    row: u32,
    blocks: Vec<(u32, Matrix3<f64>)>,
}

impl System {
    /// Assembles and factors all of it.
    ///
    /// # Errors
    /// [`FactorError`] if some part of the body is held by nothing, neither support nor ground spring.
    pub fn new(
        mesh: &TetMesh,
        materials: &[TetMaterial],
        topology: &Topology,
        supports: &Supports,
    ) -> Result<Self, FactorError> {
        let numbering = Numbering::new(mesh, topology, supports);
        let [ground, drag] = ground_springs(mesh, supports);
        let matrix = assemble(mesh, materials, topology, &numbering, &ground);
        let (held, moved) = held_unknowns(topology, supports, &numbering);
        let positions = numbering.positions(mesh, topology);
        let factor = if held.is_empty() {
            Factor::new(&matrix, &positions)?
        } else {
            let mut free = matrix.clone();
            free.decouple(|i| held.binary_search(&i).is_ok());
            Factor::new(&free, &positions)?
        };
        let mut system = Self {
            block_of_enrichment: numbering.of_enrichment,
            parents: topology.parents().to_vec(),
            base: Arc::new(Base {
                block_of_node: numbering.of_node,
                matrix,
                ground,
                node_drag: node_drag(mesh, &drag),
                drag,
                moved,
            }),
            border: Vec::new(),
            held,
            lift: Vec::new(),
            factor: Bordered::new(factor),
        };
        system.lift = system.base_lift();
        Ok(system)
    }

    /// The equations of the same body after its crack grew: `topology` must come from this system's by [`Topology::grown`],
    /// mesh, materials and supports must be the same. Old unknowns keep their places in `x`.
    ///
    /// Agrees with [`new`](Self::new) on the same topology to 4e-13 of the largest displacement as long as supports hold every
    /// piece; the rigid motion of a piece that only ground springs of 1e-7 E h hold is known to 3e-9, as with `new`
    /// (`tests/grown_systems.rs`). Costs a 25th to a 40th of `new` (`benches/growth.rs`). Solves get dearer as the border grows,
    /// by half over a whole split; `new` on the same topology starts afresh with the same `x`.
    ///
    /// # Errors
    /// [`FactorError`] if the grown body is held by nothing somewhere.
    ///
    /// # Panics
    /// If `topology` has fewer enrichments than this system knows.
    pub fn grown(
        &self,
        mesh: &TetMesh,
        materials: &[TetMaterial],
        topology: &Topology,
        supports: &Supports,
    ) -> Result<Self, FactorError> {
        let n_old = self.block_of_enrichment.len();
        let new = &topology.enriched_nodes()[n_old..];
        let mut grown = self.clone();
        let mut next = (self.n() / 3) as u32;
        for &node in new {
            let block = if supports.is_fixed(node) { FIXED } else { next };
            next += u32::from(block != FIXED);
            grown.block_of_enrichment.push(block);
            let axes = supports.prescribed_at(node);
            let held = (0..3).filter(|&k| block != FIXED && axes[k as usize].is_some());
            grown.held.extend(held.map(|k| 3 * block + k));
        }
        grown.parents.extend(&topology.parents()[n_old..]);
        let rows: Vec<BlockRow> = (n_old..topology.enriched_nodes().len())
            .filter(|e| grown.block_of_enrichment[*e] != FIXED)
            .map(|e| grown.block_row(mesh, materials, topology, e as u32))
            .collect();
        grown.extend_lift(&rows);
        let scalar: Vec<BorderRow> = rows.iter().flat_map(|r| grown.scalar_rows(r)).collect();
        grown.factor = self.factor.grown(&scalar)?;
        grown.border.push(Arc::new(rows));
        Ok(grown)
    }

    /// The stiffness of enrichment `e` against all unknowns up to itself, from the cells around its node.
    fn block_row(
        &self,
        mesh: &TetMesh,
        materials: &[TetMaterial],
        topology: &Topology,
        e: u32,
    ) -> BlockRow {
        let row = self.block_of_enrichment[e as usize];
        let node = topology.enriched_nodes()[e as usize];
        let mut blocks: Vec<(u32, Matrix3<f64>)> = Vec::with_capacity(256);
        for &t in mesh.tets_of_node(node as usize) {
            let nodes = &mesh.tets()[t as usize];
            let a = nodes.iter().position(|n| *n == node).unwrap_or(0);
            for cell in &topology.cells()[topology.cells_of(t)] {
                if !topology.lineage(cell.enrichment[a]).any(|l| l == e) {
                    continue;
                }
                let element = Element::new(mesh, materials, &self.base.ground, cell);
                for (b, n) in nodes.iter().enumerate() {
                    let k = element.block(a, b);
                    let columns = self.blocks(*n, cell.enrichment[b]);
                    blocks.extend(columns.filter(|c| *c <= row).map(|c| (c, k)));
                }
            }
        }
        blocks.sort_by_key(|b| b.0);
        blocks.dedup_by(|later, kept| {
            let same = later.0 == kept.0;
            if same {
                kept.1 += later.1;
            }
            same
        });
        BlockRow { row, blocks }
    }

    /// What the factor was given at the last growth: `factor().grown(&rows)` of the system before gives this one's. Nothing if
    /// there was no growth since the base was factored.
    pub fn last_rows(&self) -> Vec<BorderRow> {
        let rows = self.border.last().into_iter().flat_map(|b| b.iter());
        rows.flat_map(|r| self.scalar_rows(r)).collect()
    }

    /// What the base was factored from, as [`Factor::new`] wants it: the stiffness with held unknowns decoupled, and where each
    /// block acts. `topology` must be that of the base.
    pub fn base(&self, mesh: &TetMesh, topology: &Topology) -> (BlockMatrix, Vec<Vec3>) {
        let mut matrix = self.base.matrix.clone();
        if !self.held.is_empty() {
            matrix.decouple(|i| self.is_held(i));
        }
        let n_blocks = matrix.n_blocks();
        let mut positions = vec![Vec3::zeros(); n_blocks];
        let nodes = (0u32..).zip(&self.base.block_of_node);
        let enriched = topology.enriched_nodes().iter().copied();
        let blocks = nodes.chain(enriched.zip(&self.block_of_enrichment));
        for (node, block) in blocks.filter(|(_, b)| (**b as usize) < n_blocks) {
            positions[*block as usize] = mesh.nodes()[node as usize];
        }
        (matrix, positions)
    }

    /// What the factor is given of a block row: held unknowns decoupled.
    fn scalar_rows(&self, row: &BlockRow) -> [BorderRow; 3] {
        let n_base = 3 * self.base.matrix.n_blocks() as u32;
        let mut rows: [BorderRow; 3] = Default::default();
        for (col, k) in &row.blocks {
            let mut k = *k;
            if !self.held.is_empty() {
                decouple(row.row, *col, &mut k, |i| self.is_held(i));
            }
            for (r, out) in rows.iter_mut().enumerate() {
                let last = if *col == row.row { r } else { 2 };
                for c in 0..=last {
                    let j = 3 * col + c as u32;
                    let v = k[(r, c)];
                    if j < n_base {
                        out.base.push((j, v));
                    } else {
                        out.border.push((j - n_base, v));
                    }
                }
            }
        }
        rows
    }

    fn is_held(&self, i: u32) -> bool {
        self.held.binary_search(&i).is_ok()
    }

    /// -K_fp u_p on free unknowns; on prescribed ones their value times their diagonal, which is all that the factor holds
    /// of them.
    fn base_lift(&self) -> Vec<f64> {
        if self.held.is_empty() {
            return Vec::new();
        }
        let mut x = vec![0.0; self.n()];
        let moved = &self.base.moved;
        moved.iter().for_each(|&(i, v)| x[i as usize] = v);
        let mut lift = self.multiply(&x);
        lift.iter_mut().for_each(|f| *f = -*f);
        self.held.iter().for_each(|i| lift[*i as usize] = 0.0);
        for (row, col, k) in self.base.matrix.iter().filter(|(row, col, _)| row == col) {
            for c in 0..3 {
                let i = 3 * col + c;
                if self.is_held(i) {
                    lift[3 * row as usize + c as usize] =
                        k[(c as usize, c as usize)] * x[i as usize];
                }
            }
        }
        lift
    }

    fn extend_lift(&mut self, rows: &[BlockRow]) {
        if self.held.is_empty() {
            return;
        }
        let moved = &self.base.moved;
        let value = |i: u32| {
            moved
                .binary_search_by_key(&i, |m| m.0)
                .map_or(0.0, |p| moved[p].1)
        };
        for BlockRow { row, blocks } in rows {
            for r in 0..3 {
                let along = |(col, k): &(u32, Matrix3<f64>)| -> f64 {
                    (0..3).map(|c| k[(r, c)] * value(3 * col + c as u32)).sum()
                };
                let force: f64 = blocks.iter().map(along).sum();
                let held = self.held.binary_search(&(3 * row + r as u32)).is_ok();
                self.lift.push(if held { 0.0 } else { -force });
            }
        }
    }

    /// Adds what prescribed displacements do to the right-hand side. Nothing if there are none.
    pub fn add_prescribed(&self, rhs: &mut [f64]) {
        rhs.iter_mut().zip(&self.lift).for_each(|(f, l)| *f += l);
    }

    /// Number of unknowns.
    pub fn n(&self) -> usize {
        self.factor.n()
    }

    /// The factor, for its sizes.
    pub fn factor(&self) -> &Bordered {
        &self.factor
    }

    /// Memory for [`solve`](Self::solve) and [`solve_region`](Self::solve_region).
    pub fn scratch(&self) -> SolveScratch {
        self.factor.scratch()
    }

    /// Solves K x = f in place; `f` and `x` \[N, mm\], n values a right-hand side. Allocates nothing.
    pub fn solve(&self, x: &mut [f64], scratch: &mut SolveScratch) {
        self.factor.solve(x, scratch);
    }

    /// The region of the unknowns that move some cells: where forces will act, and where displacements will be read. All
    /// enrichments since the base was factored are part of it.
    pub fn region<'a>(&self, mesh: &TetMesh, cells: impl IntoIterator<Item = &'a Cell>) -> Region {
        let mut unknowns = Vec::new();
        for cell in cells {
            for (n, e) in mesh.tets()[cell.tet as usize].iter().zip(cell.enrichment) {
                let blocks = self.blocks(*n, e);
                unknowns.extend(blocks.flat_map(|b| (0..3).map(move |k| 3 * b + k)));
            }
        }
        self.factor.region(unknowns)
    }

    /// As [`solve`](Self::solve) for one right-hand side that is zero outside the region; what lies outside it in `x` is not
    /// computed and keeps its value.
    pub fn solve_region(&self, region: &Region, x: &mut [f64], scratch: &mut SolveScratch) {
        self.factor.solve_region(region, x, scratch);
    }

    /// Forces \[N\] at the four virtual nodes of `cell` as a sparse right-hand side for [`half_solve`](Self::half_solve):
    /// (unknown, value), appended.
    pub fn push_corner_forces(
        &self,
        mesh: &TetMesh,
        cell: &Cell,
        forces: &[Vec3; 4],
        column: &mut Vec<(u32, f64)>,
    ) {
        let nodes = &mesh.tets()[cell.tet as usize];
        for k in 0..4 {
            for b in self.blocks(nodes[k], cell.enrichment[k]) {
                for axis in 0..3 {
                    let i = 3 * b + axis;
                    if self.held.is_empty() || !self.is_held(i) {
                        column.push((i, forces[k][axis as usize]));
                    }
                }
            }
        }
    }

    /// Adds the pull of [`Supports::drag`] towards the displacements `before` to a right-hand side. `before` may be shorter than
    /// the unknowns: new enrichments had not moved.
    pub fn add_drag(&self, mesh: &TetMesh, topology: &Topology, before: &[f64], rhs: &mut [f64]) {
        if self.base.drag.iter().all(|d| *d == 0.0) {
            return;
        }
        let mut x = before.to_vec();
        x.resize(self.n(), 0.0);
        // Without jumps a node's cells drag as one.
        for (n, drag) in self.base.node_drag.iter().enumerate() {
            self.add_node_force(n, &(self.displacement(n, &x) * *drag), rhs);
        }
        for cell in topology.cells() {
            let jumps = cell.enrichment.iter().any(|e| *e != STANDARD);
            if jumps {
                self.add_jump_drag(mesh, cell, &x, rhs);
            }
        }
    }

    /// What the body pulls with at its loads where it stands at `x`: -K x without [`Supports::drag`], nothing on held coordinates.
    pub fn pull(&self, mesh: &TetMesh, topology: &Topology, x: &[f64]) -> Vec<f64> {
        let mut pull = self.multiply(x);
        pull.iter_mut().for_each(|f| *f = -*f);
        self.add_drag(mesh, topology, x, &mut pull);
        self.held.iter().for_each(|i| pull[*i as usize] = 0.0);
        pull
    }

    /// The elastic energy that the last growth sets free under forces that stay what they are \[N mm\], where the body was at rest at
    /// `x` before: half of what the forces do that the new unknowns then lack for balance. Drag holds on to `x`.
    ///
    /// `loads`: those forces on this body (unknown, force \[N\]). None if `before` is not what this system has grown from.
    pub fn released(
        &self,
        before: &Self,
        mesh: &TetMesh,
        topology: &Topology,
        x: &[f64],
        loads: &[(u32, f64)],
    ) -> Option<f64> {
        let grown = self.border.len() == before.border.len() + 1;
        let rows = self.border.last().filter(|_| grown)?;
        if !Arc::ptr_eq(&self.base, &before.base) {
            return None;
        }
        let n_old = before.n();
        let mut at = x.to_vec();
        at.resize(self.n(), 0.0);
        let mut lacking = vec![0.0; self.n()];
        let first = before.block_of_enrichment.len();
        self.add_new_drag(mesh, topology, first, &at, &mut lacking);
        loads.iter().for_each(|(i, f)| lacking[*i as usize] += f);
        for BlockRow { row, blocks } in rows.iter() {
            let held = blocks.iter().map(|(col, k)| k * read(*col, &at));
            let held: Vec3 = held.sum();
            for k in 0..3 {
                let i = 3 * *row as usize + k;
                let is_free = !self.is_held(i as u32);
                lacking[i] = if is_free { lacking[i] - held[k] } else { 0.0 };
            }
        }
        Some(0.5 * self.factor.work_of_last(&lacking[n_old..]))
    }

    /// As [`add_drag`](Self::add_drag), but right only on the enrichments from `first` on: those of the cells around their nodes.
    fn add_new_drag(
        &self,
        mesh: &TetMesh,
        topology: &Topology,
        first: usize,
        x: &[f64],
        rhs: &mut [f64],
    ) {
        if self.base.drag.iter().all(|d| *d == 0.0) {
            return;
        }
        let nodes = topology.enriched_nodes()[first..].iter();
        let mut tets: Vec<u32> = nodes
            .flat_map(|n| mesh.tets_of_node(*n as usize))
            .copied()
            .collect();
        tets.sort_unstable();
        tets.dedup();
        for cell in tets
            .iter()
            .flat_map(|t| &topology.cells()[topology.cells_of(*t)])
        {
            if cell.enrichment.iter().any(|e| *e != STANDARD) {
                self.add_jump_drag(mesh, cell, x, rhs);
            }
        }
    }

    /// The part of a cell's drag that its enrichments take part in.
    fn add_jump_drag(&self, mesh: &TetMesh, cell: &Cell, x: &[f64], rhs: &mut [f64]) {
        let t = cell.tet as usize;
        let u = self.cell_displacements(mesh, cell, x);
        let mut forces = Vec::new();
        for (a, n) in mesh.tets()[t].into_iter().enumerate() {
            if cell.enrichment[a] == STANDARD {
                continue;
            }
            let stiffness = self.base.drag[n as usize] * mesh.volumes()[t] * cell.fraction;
            let mut at_node = [Vec3::zeros(); 4];
            at_node[a] = u[a] * stiffness;
            self.push_corner_forces(mesh, cell, &at_node, &mut forces);
            let counted = self.displacement(n as usize, x) * stiffness;
            self.add_node_force(n as usize, &-counted, rhs);
        }
        forces.iter().for_each(|(i, f)| rhs[*i as usize] += f);
    }

    /// The forward half of a solve for sparse right-hand sides B: [`HalfSolved::compliance`] of two of them is B^T K^-1 C.
    pub fn half_solve(&self, columns: &[Vec<(u32, f64)>]) -> HalfSolved {
        self.factor.half_solve(columns)
    }

    /// The forward half of a solve for any right-hand side; see [`Bordered::sweep_up`].
    pub fn sweep_up(&self, rhs: &[f64], swept: &mut Swept, scratch: &mut SolveScratch) {
        self.factor.sweep_up(rhs, swept, scratch);
    }

    /// The forward half of a solve for a sparse right-hand side, added to another; see [`Bordered::add_load`].
    pub fn add_load(&self, load: &[(u32, f64)], swept: &mut Swept, scratch: &mut SolveScratch) {
        self.factor.add_load(load, swept, scratch);
    }

    /// The backward half of a solve; see [`Bordered::sweep_down`].
    pub fn sweep_down(&self, swept: &mut Swept, x: &mut [f64], scratch: &mut SolveScratch) {
        self.factor.sweep_down(swept, x, scratch);
    }

    /// The backward half of a solve in a region only; see [`Bordered::sweep_down_region`].
    pub fn sweep_down_region(
        &self,
        region: &Region,
        swept: &Swept,
        x: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        self.factor.sweep_down_region(region, swept, x, scratch);
    }

    /// What a sweep down a region left out; see [`Bordered::sweep_down_rest`].
    pub fn sweep_down_rest(
        &self,
        region: &Region,
        swept: &mut Swept,
        x: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        self.factor.sweep_down_rest(region, swept, x, scratch);
    }

    /// Adds half-solved right-hand sides, `q` times each; see [`Bordered::add_half`].
    pub fn add_half(&self, half: &HalfSolved, q: &[f64], swept: &mut Swept) {
        self.factor.add_half(half, q, swept);
    }

    /// How far half-solved forces would move along themselves; see [`Bordered::project`].
    pub fn project(&self, half: &HalfSolved, swept: &Swept) -> Vec<f64> {
        self.factor.project(half, swept)
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
        let nodes = &mesh.tets()[cell.tet as usize];
        for k in 0..4 {
            for b in self.blocks(nodes[k], cell.enrichment[k]) {
                for axis in 0..3 {
                    let i = 3 * b + axis;
                    if self.held.is_empty() || !self.is_held(i) {
                        rhs[i as usize] += weights[k] * force[axis as usize];
                    }
                }
            }
        }
    }

    /// Adds a force \[N\] on the unknowns of node `i` alone.
    fn add_node_force(&self, i: usize, force: &Vec3, rhs: &mut [f64]) {
        let block = self.base.block_of_node[i];
        if block != FIXED {
            let axes = (3 * block..).zip(force.iter());
            for (k, f) in axes.filter(|(k, _)| !self.is_held(*k)) {
                rhs[k as usize] += f;
            }
        }
    }

    /// In which directions the support holds node `i`.
    pub fn held_axes(&self, i: u32) -> [bool; 3] {
        let block = self.base.block_of_node[i as usize];
        [0, 1, 2].map(|k| block == FIXED || self.is_held(3 * block + k))
    }

    /// Displacement of node `i` \[mm\]; of [`multiply`](Self::multiply)'s result, the force that holds it there \[N\].
    pub fn displacement(&self, i: usize, x: &[f64]) -> Vec3 {
        read(self.base.block_of_node[i], x)
    }

    /// Adds to the displacement of node `i`, unless it is fixed.
    pub fn add_displacement(&self, i: usize, by: &Vec3, x: &mut [f64]) {
        let b = self.base.block_of_node[i];
        if b != FIXED {
            (0..3).for_each(|k| x[3 * b as usize + k] += by[k]);
        }
    }

    /// Displacements of a cell's four virtual nodes \[mm\].
    pub fn cell_displacements(&self, mesh: &TetMesh, cell: &Cell, x: &[f64]) -> [Vec3; 4] {
        let nodes = &mesh.tets()[cell.tet as usize];
        [0, 1, 2, 3].map(|k| {
            let mut u = self.displacement(nodes[k] as usize, x);
            for e in lineage(&self.parents, cell.enrichment[k]) {
                u += read(self.block_of_enrichment[e as usize], x);
            }
            u
        })
    }

    /// The blocks whose sum is the displacement of a cell's virtual node at node `n` with enrichment `e`.
    fn blocks(&self, n: u32, e: u32) -> impl Iterator<Item = u32> {
        let node = std::iter::once(self.base.block_of_node[n as usize]);
        let jumps = lineage(&self.parents, e).map(|e| self.block_of_enrichment[e as usize]);
        node.chain(jumps).filter(|b| *b != FIXED)
    }

    /// The unknowns of a displacement field that is `of_cell(cell, p)` at the points of a cell and may jump between cells;
    /// exact where the field is affine. For tests: rigid motions, for instance.
    pub fn interpolate(
        &self,
        mesh: &TetMesh,
        topology: &Topology,
        of_cell: impl Fn(&Cell, &Vec3) -> Vec3,
    ) -> Vec<f64> {
        let mut standard = vec![Vec3::zeros(); mesh.nodes().len()];
        let mut total = vec![Vec3::zeros(); topology.parents().len()];
        for cell in topology.cells() {
            for (k, &n) in mesh.tets()[cell.tet as usize].iter().enumerate() {
                if cell.mask >> k & 1 == 1 {
                    standard[n as usize] = of_cell(cell, &mesh.nodes()[n as usize]);
                }
                if cell.enrichment[k] != STANDARD {
                    total[cell.enrichment[k] as usize] = of_cell(cell, &mesh.nodes()[n as usize]);
                }
            }
        }
        let mut x = vec![0.0; self.n()];
        let mut write = |b: u32, v: Vec3| {
            if b != FIXED {
                (0..3).for_each(|k| x[3 * b as usize + k] = v[k]);
            }
        };
        for (v, b) in standard.iter().zip(&self.base.block_of_node) {
            write(*b, *v);
        }
        for (e, node) in topology.enriched_nodes().iter().enumerate() {
            let above = match topology.parents()[e] {
                STANDARD => standard[*node as usize],
                parent => total[parent as usize],
            };
            write(self.block_of_enrichment[e], total[e] - above);
        }
        x
    }

    /// K x, prescribed displacements included: the forces that hold the field `x`, reactions of prescribed coordinates among
    /// them \[N\].
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        self.base.matrix.multiply_add(x, &mut y);
        for BlockRow { row, blocks } in self.border.iter().flat_map(|b| b.iter()) {
            for (col, k) in blocks {
                add_product(*row, *col, k, x, &mut y);
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
    if block == FIXED {
        Vec3::zeros()
    } else {
        Vec3::from_column_slice(&x[3 * block as usize..3 * block as usize + 3])
    }
}

/// Block of each node and of each enrichment.
struct Numbering {
    of_node: Vec<u32>,
    of_enrichment: Vec<u32>,
    n_blocks: usize,
}

impl Numbering {
    fn new(mesh: &TetMesh, topology: &Topology, supports: &Supports) -> Self {
        let mut n_blocks = 0;
        let mut number = |i: u32| {
            let block = if supports.is_fixed(i) {
                FIXED
            } else {
                n_blocks
            };
            n_blocks += u32::from(block != FIXED);
            block
        };
        Self {
            of_node: (0..mesh.nodes().len() as u32).map(&mut number).collect(),
            of_enrichment: topology
                .enriched_nodes()
                .iter()
                .map(|i| number(*i))
                .collect(),
            n_blocks: n_blocks as usize,
        }
    }

    /// Where each block acts.
    fn positions(&self, mesh: &TetMesh, topology: &Topology) -> Vec<Vec3> {
        let nodes = (0u32..).zip(&self.of_node);
        let enrichments = topology.enriched_nodes().iter().copied();
        nodes
            .chain(enrichments.zip(&self.of_enrichment))
            .filter(|(_, b)| **b != FIXED)
            .map(|(i, _)| mesh.nodes()[i as usize])
            .collect()
    }

    fn blocks<'a>(
        &'a self,
        topology: &'a Topology,
        n: u32,
        e: u32,
    ) -> impl Iterator<Item = u32> + 'a {
        let jumps = topology.lineage(e).map(|e| self.of_enrichment[e as usize]);
        std::iter::once(self.of_node[n as usize])
            .chain(jumps)
            .filter(|b| *b != FIXED)
    }
}

/// One cell's stiffness.
struct Element<'a> {
    law: Elasticity,
    gradients: &'a [Vec3; 4],
    weight: f64,
    ground: [f64; 4],
}

impl<'a> Element<'a> {
    fn new(mesh: &'a TetMesh, materials: &[TetMaterial], ground: &[f64], cell: &Cell) -> Self {
        let t = cell.tet as usize;
        let weight = mesh.volumes()[t] * cell.fraction;
        Self {
            law: materials[t].elasticity(),
            gradients: &mesh.gradients()[t],
            weight,
            // Soft tissue holds the material, so each cell takes its share, also of what only its enrichments move.
            ground: mesh.tets()[t].map(|n| ground[n as usize] * weight),
        }
    }

    /// Block of local nodes `a` and `b` \[N/mm\].
    fn block(&self, a: usize, b: usize) -> Matrix3<f64> {
        let g = self.gradients;
        let k = self.law.block(&g[a], &g[b]) * self.weight;
        if a == b {
            k + Matrix3::from_diagonal_element(self.ground[a])
        } else {
            k
        }
    }
}

/// Springs to the ground over the volume around each node, and the part of them that drags.
fn ground_springs(mesh: &TetMesh, supports: &Supports) -> [Vec<f64>; 2] {
    let mut around = vec![0.0; mesh.nodes().len()];
    for (tet, v) in mesh.tets().iter().zip(mesh.volumes()) {
        tet.iter().for_each(|&n| around[n as usize] += v);
    }
    let mut spring = vec![supports.ground_spring + supports.drag; mesh.nodes().len()];
    for &(n, k) in &supports.springs {
        spring[n as usize] += k;
    }
    let drag = around.iter().map(|v| supports.drag / v).collect();
    [
        spring.iter().zip(&around).map(|(k, v)| k / v).collect(),
        drag,
    ]
}

/// The drag of each node's whole volume \[N/mm\].
fn node_drag(mesh: &TetMesh, drag: &[f64]) -> Vec<f64> {
    let volume = |n: usize| -> f64 {
        let around = mesh.tets_of_node(n).iter();
        around.map(|t| mesh.volumes()[*t as usize]).sum()
    };
    let nodes = drag.iter().enumerate();
    nodes.map(|(n, drag)| drag * volume(n)).collect()
}

fn assemble(
    mesh: &TetMesh,
    materials: &[TetMaterial],
    topology: &Topology,
    numbering: &Numbering,
    ground: &[f64],
) -> BlockMatrix {
    let each = |cell: &Cell, visit: &mut dyn FnMut(usize, usize, u32, u32)| {
        let nodes = &mesh.tets()[cell.tet as usize];
        for a in 0..4 {
            for row in numbering.blocks(topology, nodes[a], cell.enrichment[a]) {
                for (b, n) in nodes.iter().enumerate() {
                    for col in numbering.blocks(topology, *n, cell.enrichment[b]) {
                        if row >= col {
                            visit(a, b, row, col);
                        }
                    }
                }
            }
        }
    };
    // Nodes couple along edges; only cells with enrichments add to that.
    let of_edge = |[a, b]: &[u32; 2]| [*a, *b].map(|n| numbering.of_node[n as usize]);
    let mut pairs: Vec<(u32, u32)> = mesh
        .edges()
        .iter()
        .map(of_edge)
        .filter(|[a, b]| *a != FIXED && *b != FIXED)
        .map(|[a, b]| (a, b))
        .collect();
    let is_enriched = |c: &&Cell| c.enrichment.iter().any(|e| *e != STANDARD);
    for cell in topology.cells().iter().filter(is_enriched) {
        each(cell, &mut |_, _, row, col| pairs.push((col, row)));
    }
    let mut matrix = BlockMatrix::zeros(numbering.n_blocks, pairs);
    for cell in topology.cells() {
        let element = Element::new(mesh, materials, ground, cell);
        each(cell, &mut |a, b, row, col| {
            matrix.add(row, col, &element.block(a, b));
        });
    }
    matrix
}

/// Unknowns that supports prescribe, ascending, and the displacements of those that move.
fn held_unknowns(
    topology: &Topology,
    supports: &Supports,
    numbering: &Numbering,
) -> (Vec<u32>, Vec<(u32, f64)>) {
    let (mut held, mut moved) = (Vec::new(), Vec::new());
    for p in &supports.prescribed {
        let block = numbering.of_node[p.node as usize];
        if block != FIXED {
            held.push(3 * block + u32::from(p.axis));
            moved.push((3 * block + u32::from(p.axis), p.value));
        }
    }
    for (&node, &block) in topology
        .enriched_nodes()
        .iter()
        .zip(&numbering.of_enrichment)
    {
        let axes = supports.prescribed_at(node);
        let held_axes = (0..3).filter(|&k| block != FIXED && axes[k as usize].is_some());
        held.extend(held_axes.map(|k| 3 * block + k));
    }
    (held, moved)
}
