use super::cut_edges::CutEdges;
use super::fragments::UnionFind;
use crate::geometry::{NO_TET, TET_EDGES, TET_FACES, TetMesh, Vec3};

/// "No enrichment": the virtual node is the standard node itself.
pub const STANDARD: u32 = u32::MAX;

/// One side of one tetrahedron: what moves as one piece of the continuum.
///
/// A tetrahedron that the crack does not divide is one cell. A divided one has a cell for each group of its nodes that uncut
/// edges join. The field in a cell interpolates four virtual nodes: at a node on the cell's own side (or one that the cell
/// still hangs together with round the crack front) the standard displacement u_i, at any other u_i plus jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// The tetrahedron.
    pub tet: u32,
    /// Bit k: local node k lies in this cell.
    pub mask: u8,
    /// Share of the tetrahedron's volume; the shares of its cells add to one.
    pub fraction: f64,
    /// Enrichment added at each local node with all above it (see [`Topology::parents`]), or [`STANDARD`].
    pub enrichment: [u32; 4],
    /// Of a tetrahedron's cells, a point with shape functions N lies in the one whose `score . N` is largest.
    pub score: [f64; 4],
}

/// Cells and enrichments of a cut mesh: the shifted enrichment of the paper's equation 1, for any number of sheets.
///
/// For node i take the pieces of its support (the tetrahedra around it, as the cut edges divide them) that hang together
/// through shared face nodes. Each component c beyond the node's own carries one jump function N_i chi_c. It vanishes at
/// every node, so nodal values stay displacements and K_uu never changes; with one flat crack it is equation 1 up to the
/// factor of the sign function; a front needs no rule of its own, because round it the support is one component.
///
/// Cuts are only ever added, so components only ever split. When one does, its function stays as it is, over all its parts,
/// and each part but the first gets a further function of its own, whose parent it is. The space is the same as if each part
/// had one function, but no function ever changes: a grown topology appends unknowns and leaves all others alone.
#[derive(Clone, Debug)]
pub struct Topology {
    cells: Vec<Cell>,
    first: Vec<u32>,
    enriched_nodes: Vec<u32>,
    parents: Vec<u32>,
}

impl Topology {
    /// Builds cells and enrichments from the cut edges.
    pub fn new(mesh: &TetMesh, cuts: &CutEdges) -> Self {
        let mut cells = Vec::with_capacity(mesh.tets().len());
        let mut first = vec![0u32];
        for t in 0..mesh.tets().len() {
            push_cells(mesh, cuts, t, &mut cells);
            first.push(cells.len() as u32);
        }
        let mut topology = Self {
            cells,
            first,
            enriched_nodes: Vec::new(),
            parents: Vec::new(),
        };
        for i in 0..mesh.nodes().len() {
            topology.enrich(mesh, i);
        }
        topology
    }

    /// The topology after further cuts, where `newly_cut` are the edges that `cuts` has beyond those this one was made from.
    ///
    /// Only tetrahedra around these edges are looked at. All enrichments keep their numbers and functions; new ones follow.
    /// A piece that is divided again shares its own volume among its parts, so that the volumes of all others stay; where
    /// three or more pieces meet in a tetrahedron they may so differ a little from those of [`new`](Self::new).
    pub fn grown(&self, mesh: &TetMesh, cuts: &CutEdges, newly_cut: &[u32]) -> Self {
        let divided = self.newly_divided(mesh, cuts, newly_cut);
        let mut grown = self.with_cells(&divided);
        let mut nodes: Vec<u32> = divided
            .iter()
            .flat_map(|c| mesh.tets()[c[0].tet as usize])
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        for i in nodes {
            grown.enrich(mesh, i as usize);
        }
        grown
    }

    /// The new cells of each tetrahedron that further cuts divide further, by ascending tetrahedron.
    fn newly_divided(&self, mesh: &TetMesh, cuts: &CutEdges, newly_cut: &[u32]) -> Vec<Vec<Cell>> {
        let mut touched = Vec::new();
        for &e in newly_cut {
            let star = mesh.tets_of_node(mesh.edges()[e as usize][0] as usize);
            let holds = |t: &&u32| mesh.tet_edges()[**t as usize].contains(&e);
            touched.extend(star.iter().filter(holds));
        }
        touched.sort_unstable();
        touched.dedup();
        let mut divided = Vec::new();
        for t in touched {
            let mut cells = Vec::new();
            push_cells(mesh, cuts, t as usize, &mut cells);
            let old = &self.cells[self.cells_of(t)];
            if cells.len() > old.len() {
                inherit(old, &mut cells);
                divided.push(cells);
            }
        }
        divided
    }

    /// A copy with other cells for some tetrahedra, given in ascending order.
    fn with_cells(&self, divided: &[Vec<Cell>]) -> Self {
        let n_more: usize = divided.iter().map(Vec::len).sum();
        let mut cells = Vec::with_capacity(self.cells.len() + n_more);
        let mut first = Vec::with_capacity(self.first.len());
        let mut from = 0;
        for new in divided {
            let t = new[0].tet;
            let kept = self.first[from as usize] as usize..self.first[t as usize] as usize;
            let shift = (cells.len() - kept.start) as u32;
            let starts = &self.first[from as usize..=t as usize];
            first.extend(starts.iter().map(|f| f + shift));
            cells.extend_from_slice(&self.cells[kept]);
            cells.extend_from_slice(new);
            from = t + 1;
        }
        let rest = self.first[from as usize] as usize;
        let shift = (cells.len() - rest) as u32;
        first.extend(self.first[from as usize..].iter().map(|f| f + shift));
        cells.extend_from_slice(&self.cells[rest..]);
        Self {
            cells,
            first,
            enriched_nodes: self.enriched_nodes.clone(),
            parents: self.parents.clone(),
        }
    }

    /// All cells, grouped by tetrahedron.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Indices of the cells of tetrahedron `t`.
    pub fn cells_of(&self, t: u32) -> std::ops::Range<usize> {
        self.first[t as usize] as usize..self.first[t as usize + 1] as usize
    }

    /// Whether the crack divides tetrahedron `t`.
    pub fn is_divided(&self, t: u32) -> bool {
        self.cells_of(t).len() > 1
    }

    /// The node of each enrichment.
    pub fn enriched_nodes(&self) -> &[u32] {
        &self.enriched_nodes
    }

    /// For each enrichment the one whose component it is a part of, or [`STANDARD`]: a virtual node moves by u_i plus its
    /// enrichment's jump and those of all above it. Parents have lower numbers.
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// Enrichment `e` and all above it; none for [`STANDARD`].
    pub fn lineage(&self, e: u32) -> impl Iterator<Item = u32> {
        lineage(&self.parents, e)
    }

    /// The cell of a point of tetrahedron `t` with shape functions `n` there (paper, equation 8).
    pub fn cell_at(&self, t: u32, n: &[f64; 4]) -> u32 {
        self.best(t, |c| (0..4).map(|k| c.score[k] * n[k]).sum())
    }

    /// The cell of tetrahedron `t` that lies on the side of `point` to which `direction` looks: for points on a crack face.
    pub fn cell_towards(&self, mesh: &TetMesh, t: u32, point: &Vec3, direction: &Vec3) -> u32 {
        let x = mesh.corners(t as usize);
        self.best(t, |c| {
            let inside = (0..4).filter(|k| c.mask >> k & 1 == 1);
            let count = c.mask.count_ones();
            inside.map(|k| (x[k] - point).dot(direction)).sum::<f64>() / f64::from(count.max(1))
        })
    }

    fn best(&self, t: u32, score: impl Fn(&Cell) -> f64) -> u32 {
        let range = self.cells_of(t);
        let mut best = (range.start, f64::NEG_INFINITY);
        if range.len() > 1 {
            for c in range {
                let s = score(&self.cells[c]);
                if s > best.1 {
                    best = (c, s);
                }
            }
        }
        best.0 as u32
    }

    /// Gives node `i` a jump function for each component of its support that has none yet and does not hold it.
    fn enrich(&mut self, mesh: &TetMesh, i: usize) {
        let star = mesh.tets_of_node(i);
        if !star.iter().any(|&t| self.is_divided(t)) {
            return;
        }
        let (offset, mut parts) = self.components_of_support(mesh, i);
        let home = parts.find(parts.len() - 1);
        let mut numbered: Vec<(usize, u32)> = Vec::new();
        for (s, &t) in star.iter().enumerate() {
            let k = node_position(mesh, t, i);
            for (c, cell) in self.cells_of(t).enumerate() {
                let root = parts.find(offset[s] + c);
                if root == home {
                    continue;
                }
                let known = numbered.iter().find(|n| n.0 == root).map(|n| n.1);
                let e = known.unwrap_or_else(|| {
                    let above = self.cells[cell].enrichment[k];
                    let is_taken = above == STANDARD || numbered.iter().any(|n| n.1 == above);
                    let e = if is_taken {
                        self.enriched_nodes.push(i as u32);
                        self.parents.push(above);
                        self.enriched_nodes.len() as u32 - 1
                    } else {
                        above
                    };
                    numbered.push((root, e));
                    e
                });
                self.cells[cell].enrichment[k] = e;
            }
        }
    }

    /// Which cells around node `i` hang together. Cells count from the first of each tetrahedron of the star, whose offsets
    /// come with them; the last member stands for the node itself.
    fn components_of_support(&self, mesh: &TetMesh, i: usize) -> (Vec<usize>, UnionFind) {
        let star = mesh.tets_of_node(i);
        let mut offset = Vec::with_capacity(star.len() + 1);
        let mut total = 0;
        for &t in star {
            offset.push(total);
            total += self.cells_of(t).len();
        }
        let mut parts = UnionFind::new(total + 1);
        for (s, &t) in star.iter().enumerate() {
            let k = node_position(mesh, t, i);
            parts.join(total, offset[s] + self.position_of_node_cell(t, k));
            for (face, &other) in mesh.neighbours()[t as usize].iter().enumerate() {
                // Faces that hold the node, each once.
                if face == k || other == NO_TET || other < t {
                    continue;
                }
                let Ok(so) = star.binary_search(&other) else {
                    continue;
                };
                if !self.is_divided(t) && !self.is_divided(other) {
                    parts.join(offset[s], offset[so]);
                    continue;
                }
                for l in TET_FACES[face] {
                    let n = mesh.tets()[t as usize][l] as usize;
                    let a = self.position_of_node_cell(t, l);
                    let b = self.position_of_node_cell(other, node_position(mesh, other, n));
                    parts.join(offset[s] + a, offset[so] + b);
                }
            }
        }
        (offset, parts)
    }

    /// Which of the cells of `t` holds local node `k`, counted from its first.
    fn position_of_node_cell(&self, t: u32, k: usize) -> usize {
        self.cells_of(t)
            .position(|c| self.cells[c].mask >> k & 1 == 1)
            .unwrap_or(0)
    }
}

/// Enrichment `e` and all above it.
pub(super) fn lineage(parents: &[u32], e: u32) -> impl Iterator<Item = u32> {
    let some = |e: u32| (e != STANDARD).then_some(e);
    std::iter::successors(some(e), move |e| some(parents[*e as usize]))
}

/// Hands the enrichments and volumes of a tetrahedron's old cells on to its new ones.
fn inherit(old: &[Cell], new: &mut [Cell]) {
    for cell in old {
        let is_part = |c: &Cell| c.mask & cell.mask == c.mask;
        let sum: f64 = new.iter().filter(|c| is_part(c)).map(|c| c.fraction).sum();
        for part in new.iter_mut().filter(|c| is_part(c)) {
            part.fraction *= cell.fraction / sum;
            part.enrichment = cell.enrichment;
        }
    }
}

fn node_position(mesh: &TetMesh, t: u32, node: usize) -> usize {
    mesh.tets()[t as usize]
        .iter()
        .position(|&n| n as usize == node)
        .unwrap_or(0)
}

/// Divides one tetrahedron by its cut edges.
fn push_cells(mesh: &TetMesh, cuts: &CutEdges, t: usize, cells: &mut Vec<Cell>) {
    let edges = &mesh.tet_edges()[t];
    let whole = Cell {
        tet: t as u32,
        mask: 0b1111,
        fraction: 1.0,
        enrichment: [STANDARD; 4],
        score: [0.0; 4],
    };
    if edges.iter().filter(|&&e| cuts.is_cut(e)).count() < 3 {
        cells.push(whole);
        return;
    }
    let mut group = [0u8, 1, 2, 3];
    for (l, [a, b]) in TET_EDGES.iter().enumerate() {
        if !cuts.is_cut(edges[l]) {
            let (keep, gone) = (group[*a].min(group[*b]), group[*a].max(group[*b]));
            group
                .iter_mut()
                .filter(|g| **g == gone)
                .for_each(|g| *g = keep);
        }
    }
    let mut masks: Vec<u8> = Vec::new();
    for g in 0..4u8 {
        let mask = (0..4)
            .filter(|&k| group[k] == g)
            .fold(0u8, |m, k| m | 1 << k);
        if mask != 0 {
            masks.push(mask);
        }
    }
    if masks.len() == 1 {
        cells.push(whole);
        return;
    }
    let reach = reaches(mesh, cuts, t);
    let fractions = fractions(&masks, &reach);
    for (c, &mask) in masks.iter().enumerate() {
        let score = if masks.len() == 2 {
            two_sided_score(mask, &reach)
        } else {
            corner_score(mask)
        };
        cells.push(Cell {
            mask,
            fraction: fractions[c],
            score,
            ..whole
        });
    }
}

/// `reach[a][b]`: share of edge a-b, from a, up to where it is cut; 1 if it is not.
fn reaches(mesh: &TetMesh, cuts: &CutEdges, t: usize) -> [[f64; 4]; 4] {
    let mut reach = [[1.0; 4]; 4];
    for (l, [a, b]) in TET_EDGES.iter().enumerate() {
        let e = mesh.tet_edges()[t][l];
        if cuts.is_cut(e) {
            let from_low = cuts.crossing(e);
            let a_is_low = mesh.tets()[t][*a] < mesh.tets()[t][*b];
            let s = if a_is_low { from_low } else { 1.0 - from_low };
            reach[*a][*b] = s;
            reach[*b][*a] = 1.0 - s;
        }
    }
    reach
}

/// Volume shares of the pieces; exact where the crossing points of a piece's border lie in one plane.
fn fractions(masks: &[u8], reach: &[[f64; 4]; 4]) -> Vec<f64> {
    /// Keeps every piece's stiffness positive; far below what would sew a crack shut.
    const LEAST: f64 = 1e-9;
    let corner = |k: usize| {
        (0..4)
            .filter(|&l| l != k)
            .map(|l| reach[k][l])
            .product::<f64>()
    };
    let nodes = |mask: u8| (0..4).filter(move |k| mask >> k & 1 == 1);
    let mut f: Vec<f64> = masks
        .iter()
        .map(|&m| match m.count_ones() {
            1 => corner(nodes(m).next().unwrap_or(0)),
            2 if masks.len() == 2 => wedge(m, reach),
            _ => f64::NAN,
        })
        .collect();
    // Whatever is not a corner or one of two wedges is the rest.
    let known: f64 = f.iter().filter(|v| !v.is_nan()).sum();
    f.iter_mut()
        .filter(|v| v.is_nan())
        .for_each(|v| *v = 1.0 - known);
    f.iter_mut().for_each(|v| *v = v.max(LEAST));
    let sum: f64 = f.iter().sum();
    f.iter_mut().for_each(|v| *v /= sum);
    f
}

/// Share of the wedge that holds two of the four nodes, cut off by a plane through its four crossed edges.
fn wedge(mask: u8, reach: &[[f64; 4]; 4]) -> f64 {
    let [i, j] = pick(mask);
    let [k, l] = pick(!mask & 0b1111);
    // Split into the tetrahedra (i j j_k j_l), (i i_k j_k j_l) and (i i_k i_l j_l) of the corners and crossing points.
    reach[j][k] * reach[j][l]
        + reach[i][k] * (1.0 - reach[j][k]) * reach[j][l]
        + reach[i][k] * reach[i][l] * (1.0 - reach[j][l])
}

fn pick(mask: u8) -> [usize; 2] {
    let mut nodes = (0..4).filter(|k| mask >> k & 1 == 1);
    [nodes.next().unwrap_or(0), nodes.next().unwrap_or(0)]
}

/// A linear function that is zero on the plane through the crossing points (least squares for two against two).
fn two_sided_score(mask: u8, reach: &[[f64; 4]; 4]) -> [f64; 4] {
    let inside = |k: usize| mask >> k & 1 == 1;
    // On each crossed edge: s_a (1 - r) + s_b r = 0. Start from any inner node and take the mean over the edges.
    let mut score = [0.0; 4];
    let anchor = (0..4).find(|&k| inside(k)).unwrap_or(0);
    score[anchor] = 1.0;
    let across = |from: f64, r: f64| -from * (1.0 - r) / r;
    for k in 0..4 {
        if !inside(k) {
            score[k] = across(1.0, reach[anchor][k]);
        }
    }
    for k in 0..4 {
        if inside(k) && k != anchor {
            let outer: Vec<usize> = (0..4).filter(|&l| !inside(l)).collect();
            score[k] = outer
                .iter()
                .map(|&l| across(score[l], reach[l][k]))
                .sum::<f64>()
                / outer.len() as f64;
        }
    }
    score
}

/// For three or four pieces: a point goes with the piece of its nearest corner.
fn corner_score(mask: u8) -> [f64; 4] {
    [0, 1, 2, 3].map(|k| f64::from(mask >> k & 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares by the closed form against counting sample points on either side of a plane.
    #[test]
    fn fractions_of_a_plane_cut_are_exact() {
        for phi in [
            [0.3, -0.5, -0.2, -0.9],
            [0.3, 0.5, -0.2, -0.9],
            [0.7, 0.1, 0.4, -0.6],
            [-0.2, 0.6, -0.4, 0.3],
        ] {
            let mut reach = [[1.0; 4]; 4];
            for a in 0..4 {
                for b in 0..4 {
                    if phi[a] * phi[b] < 0.0 {
                        reach[a][b] = phi[a] / (phi[a] - phi[b]);
                    }
                }
            }
            let mask = (0..4)
                .filter(|&k| phi[k] > 0.0)
                .fold(0u8, |m, k| m | 1 << k);
            let f = fractions(&[mask, !mask & 15], &reach);
            let score = two_sided_score(mask, &reach);
            let (mut inside, mut total, mut wrong) = (0, 0, 0);
            let n = 60;
            for i in 0..n {
                for j in 0..n - i {
                    for k in 0..n - i - j {
                        let w = [i, j, k, n - 1 - i - j - k]
                            .map(|v| (f64::from(v) + 0.25) / f64::from(n));
                        let value: f64 = (0..4).map(|l| w[l] * phi[l]).sum();
                        let scored: f64 = (0..4).map(|l| w[l] * score[l]).sum();
                        total += 1;
                        inside += i32::from(value > 0.0);
                        wrong += i32::from((value > 0.0) != (scored > 0.0));
                    }
                }
            }
            let share = f64::from(inside) / f64::from(total);
            assert!(
                (f[0] - share).abs() < 0.01,
                "{phi:?}: {} against {share}",
                f[0]
            );
            assert_eq!(wrong, 0, "{phi:?}: sides by score");
        }
    }
}
