use super::cut_edges::CutEdges;
use crate::geometry::TetMesh;

/// Disjoint sets with path halving; the root of a set is its smallest member, so that results do not depend on order.
#[derive(Clone, Debug)]
pub struct UnionFind(Vec<u32>);

impl UnionFind {
    /// `n` singletons.
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    /// Number of members of all sets.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The smallest member of the set of `i`.
    pub fn find(&mut self, mut i: usize) -> usize {
        while self.0[i] as usize != i {
            self.0[i] = self.0[self.0[i] as usize];
            i = self.0[i] as usize;
        }
        i
    }

    /// Unites two sets.
    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b)] = a.min(b) as u32;
    }
}

/// The pieces of the body: components of its nodes over uncut edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Fragments {
    /// Fragment of each node; fragments are numbered from the largest volume down.
    pub of_node: Vec<u32>,
    /// Share of the body's volume of each fragment.
    pub volume_share: Vec<f64>,
}

/// Smaller pieces are debris, not fragments: the share that `split.complete` counts from.
pub const SMALLEST_FRAGMENT: f64 = 0.01;

impl Fragments {
    /// Finds the pieces. A node stands for a quarter of each tetrahedron around it.
    pub fn find(mesh: &TetMesh, cuts: &CutEdges) -> Self {
        let mut parts = cuts.components(mesh);
        let n_nodes = mesh.nodes().len();
        let root_of: Vec<usize> = (0..n_nodes).map(|i| parts.find(i)).collect();
        let mut share = vec![0.0; n_nodes];
        let total = mesh.volume();
        for (tet, volume) in mesh.tets().iter().zip(mesh.volumes()) {
            tet.iter()
                .for_each(|&n| share[root_of[n as usize]] += 0.25 * volume / total);
        }
        let mut roots: Vec<usize> = (0..n_nodes).filter(|&i| root_of[i] == i).collect();
        roots.sort_by(|&a, &b| share[b].total_cmp(&share[a]).then(a.cmp(&b)));
        let mut number = vec![0u32; n_nodes];
        for (k, &r) in roots.iter().enumerate() {
            number[r] = k as u32;
        }
        Self {
            of_node: root_of.iter().map(|&r| number[r]).collect(),
            volume_share: roots.iter().map(|&r| share[r]).collect(),
        }
    }

    /// Whether node `n` has crumbled off: its piece is smaller than [`SMALLEST_FRAGMENT`].
    pub fn is_debris(&self, n: u32) -> bool {
        self.volume_share[self.of_node[n as usize] as usize] < SMALLEST_FRAGMENT
    }

    /// How many pieces hold at least [`SMALLEST_FRAGMENT`] of the volume.
    pub fn count(&self) -> usize {
        self.volume_share
            .iter()
            .filter(|s| **s >= SMALLEST_FRAGMENT)
            .count()
    }
}

/// Marks the edges that lie within two elements of a cut one.
pub(crate) fn edges_near_cuts(mesh: &TetMesh, cuts: &CutEdges) -> Vec<bool> {
    let mut near = vec![false; mesh.nodes().len()];
    for (e, edge) in mesh.edges().iter().enumerate() {
        if cuts.is_cut(e as u32) {
            edge.iter().for_each(|n| near[*n as usize] = true);
        }
    }
    let ends_near = |edge: &[u32; 2], near: &[bool]| edge.map(|n| near[n as usize]);
    let inner = near.clone();
    for edge in mesh.edges() {
        if ends_near(edge, &inner).contains(&true) {
            edge.iter().for_each(|n| near[*n as usize] = true);
        }
    }
    let both = |edge: &[u32; 2]| ends_near(edge, &near) == [true; 2];
    mesh.edges().iter().map(both).collect()
}

/// The fewest uncut edges that still hold `source` and `sink` together, if there are at most `limit` of them.
///
/// Maximum flow by augmenting paths over unit edges (Ford & Fulkerson 1956); the cut nearest to the source. Empty if the
/// two are already apart, `None` if more than `limit` edges hold them.
pub fn bridging_edges(
    mesh: &TetMesh,
    cuts: &CutEdges,
    source: &[u32],
    sink: &[u32],
    limit: usize,
) -> Option<Vec<u32>> {
    let all = vec![true; mesh.edges().len()];
    bridging_edges_among(&all, mesh, cuts, source, sink, limit)
}

/// Likewise where only the edges marked in `may_part` can part.
pub(crate) fn bridging_edges_among(
    may_part: &[bool],
    mesh: &TetMesh,
    cuts: &CutEdges,
    source: &[u32],
    sink: &[u32],
    limit: usize,
) -> Option<Vec<u32>> {
    let n = mesh.nodes().len();
    let mut around: Vec<Vec<(u32, u32)>> = vec![Vec::new(); n];
    for (e, &[a, b]) in mesh.edges().iter().enumerate() {
        if !cuts.is_cut(e as u32) {
            around[a as usize].push((b, e as u32));
            around[b as usize].push((a, e as u32));
        }
    }
    let mut is_sink = vec![false; n];
    sink.iter().for_each(|&i| is_sink[i as usize] = true);
    // Flow on an edge, +1 from its lower to its higher node.
    let mut flow = vec![0i32; mesh.edges().len()];
    for found in 0.. {
        let mut came: Vec<Option<(u32, u32)>> = vec![None; n];
        let mut seen = vec![false; n];
        let mut queue: Vec<u32> = source.to_vec();
        queue.iter().for_each(|&i| seen[i as usize] = true);
        let mut head = 0;
        let mut end = None;
        while let Some(&i) = queue.get(head) {
            head += 1;
            if is_sink[i as usize] {
                end = Some(i);
                break;
            }
            for &(j, e) in &around[i as usize] {
                let used = flow[e as usize] * if i < j { 1 } else { -1 };
                if !seen[j as usize] && (used < 1 || !may_part[e as usize]) {
                    seen[j as usize] = true;
                    came[j as usize] = Some((i, e));
                    queue.push(j);
                }
            }
        }
        let Some(mut j) = end else {
            let across = |e: &u32| {
                let [a, b] = mesh.edges()[*e as usize];
                !cuts.is_cut(*e) && seen[a as usize] != seen[b as usize]
            };
            return Some((0..mesh.edges().len() as u32).filter(across).collect());
        };
        if found == limit {
            return None;
        }
        while let Some((i, e)) = came[j as usize] {
            flow[e as usize] += if i < j { 1 } else { -1 };
            j = i;
        }
    }
    None
}
