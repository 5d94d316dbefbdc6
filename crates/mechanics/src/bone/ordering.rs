//! The order of elimination: nested dissection by planes.
//!
//! Bodies are cut in two across their longest axis where the fewest nodes hold the halves together (a least vertex cover of the edges
//! between them, Koenig 1931), those nodes come last, and so on with each half (George 1973); small parts are put in order by minimum
//! degree. On slender bodies that leaves little more fill than minimum degree for all, and what matters as much
//! here: short paths up the elimination tree, which is all that an appended column or a local solve passes through.
use crate::geometry::Vec3;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use nalgebra::Matrix3;
use rustc_hash::{FxHashMap, FxHashSet};

/// A part of this many blocks or fewer is not cut further.
const LEAF: usize = 100;
/// How many places of a cut are tried, between a third and two thirds of a part.
const TRIES: usize = 9;

/// An order of the blocks of a symmetric matrix: the block at each place. `starts` and `rows` are its lower triangle by
/// columns, `positions` where each block acts.
pub fn nested_dissection(starts: &[usize], rows: &[u32], positions: &[Vec3]) -> Vec<u32> {
    let graph = Graph::new(starts, rows);
    let mut dissection = Dissection {
        graph: &graph,
        positions,
        part_of: vec![0; positions.len()],
        rank: vec![0; positions.len()],
        n_parts: 1,
        order: Vec::with_capacity(positions.len()),
    };
    dissection.cut((0..positions.len() as u32).collect(), 0);
    graph.postordered(&dissection.order)
}

/// Neighbours of each block.
struct Graph {
    first: Vec<usize>,
    neighbours: Vec<u32>,
}

impl Graph {
    fn new(starts: &[usize], rows: &[u32]) -> Self {
        let n = starts.len() - 1;
        let pairs = || {
            let column = |j: usize| {
                rows[starts[j]..starts[j + 1]]
                    .iter()
                    .map(move |i| (*i as usize, j))
            };
            (0..n).flat_map(column).filter(|(i, j)| i != j)
        };
        let mut first = vec![0; n + 1];
        for (i, j) in pairs() {
            first[i + 1] += 1;
            first[j + 1] += 1;
        }
        for i in 0..n {
            first[i + 1] += first[i];
        }
        let mut next = first.clone();
        let mut neighbours = vec![0; first[n]];
        for (i, j) in pairs() {
            for (a, b) in [(i, j), (j, i)] {
                neighbours[next[a]] = b as u32;
                next[a] += 1;
            }
        }
        Self { first, neighbours }
    }

    fn around(&self, i: u32) -> &[u32] {
        &self.neighbours[self.first[i as usize]..self.first[i as usize + 1]]
    }

    /// Some blocks in the order of approximate minimum degree among themselves (Amestoy, Davis, Duff 1996).
    fn by_minimum_degree(&self, blocks: &[u32]) -> Vec<u32> {
        let n = blocks.len();
        let place: FxHashMap<u32, usize> = blocks.iter().copied().zip(0..).collect();
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for (k, b) in blocks.iter().enumerate() {
            let own = self.around(*b).iter().filter_map(|c| place.get(c));
            rows.extend(own.filter(|j| **j < k));
            let first = starts[k];
            rows[first..].sort_unstable();
            rows.push(k);
            starts.push(rows.len());
        }
        let upper = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let need = amd::order_scratch::<usize>(n, rows.len());
        let (mut order, mut inverse) = (vec![0; n], vec![0; n]);
        let mut memory = MemBuffer::new(need);
        let stack = MemStack::new(&mut memory);
        match amd::order(
            &mut order,
            &mut inverse,
            upper,
            amd::Control::default(),
            stack,
        ) {
            Ok(_) => order.into_iter().map(|k| blocks[k]).collect(),
            // Any order is valid.
            Err(_) => blocks.to_vec(),
        }
    }

    /// The order with each subtree of its elimination tree (Liu 1986) in one run: the same fill, larger supernodes.
    fn postordered(&self, order: &[u32]) -> Vec<u32> {
        const NONE: u32 = u32::MAX;
        let n = order.len();
        let mut place = vec![0u32; n];
        (0u32..)
            .zip(order)
            .for_each(|(p, b)| place[*b as usize] = p);
        let (mut parent, mut ancestor) = (vec![NONE; n], vec![NONE; n]);
        for p in 0..n as u32 {
            for b in self.around(order[p as usize]) {
                let mut q = place[*b as usize];
                while q < p {
                    let above = std::mem::replace(&mut ancestor[q as usize], p);
                    if above == NONE {
                        parent[q as usize] = p;
                        break;
                    }
                    q = above;
                }
            }
        }
        // Children as linked lists, first child first.
        let (mut child, mut sibling) = (vec![NONE; n + 1], vec![NONE; n]);
        for p in (0..n).rev() {
            let above = if parent[p] == NONE {
                n
            } else {
                parent[p] as usize
            };
            sibling[p] = std::mem::replace(&mut child[above], p as u32);
        }
        let mut result = Vec::with_capacity(n);
        let mut stack = vec![n];
        while let Some(&top) = stack.last() {
            let next = child[top];
            if next == NONE {
                stack.pop();
                if top < n {
                    result.push(order[top]);
                }
            } else {
                child[top] = sibling[next as usize];
                stack.push(next as usize);
            }
        }
        result
    }
}

struct Dissection<'a> {
    graph: &'a Graph,
    positions: &'a [Vec3],
    part_of: Vec<u32>,
    /// Place of each block in the part that is being cut.
    rank: Vec<usize>,
    n_parts: u32,
    order: Vec<u32>,
}

impl Dissection<'_> {
    /// Appends the blocks of one part to the order: its halves, then what lies between them.
    fn cut(&mut self, mut blocks: Vec<u32>, part: u32) {
        if blocks.len() <= LEAF {
            self.order.extend(self.graph.by_minimum_degree(&blocks));
            return;
        }
        let axis = longest_axis(&blocks, self.positions);
        let along = |b: &u32| axis.dot(&self.positions[*b as usize]);
        blocks.sort_by(|a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
        let (at, between) = self.thinnest(&blocks, part);
        let [low, high] = [self.n_parts, self.n_parts + 1];
        self.n_parts += 2;
        for (k, b) in blocks.iter().enumerate() {
            self.part_of[*b as usize] = if k < at { low } else { high };
        }
        between
            .iter()
            .for_each(|b| self.part_of[*b as usize] = u32::MAX);
        for half in [low, high] {
            let blocks: Vec<u32> = blocks
                .iter()
                .copied()
                .filter(|b| self.part_of[*b as usize] == half)
                .collect();
            self.cut(blocks, half);
        }
        self.order.extend(between);
    }

    /// Where to cut a sorted part, and the blocks that hold its halves together there.
    fn thinnest(&mut self, blocks: &[u32], part: u32) -> (usize, Vec<u32>) {
        let n = blocks.len();
        for (k, b) in blocks.iter().enumerate() {
            self.rank[*b as usize] = k;
        }
        // Few blocks between, and halves not too unlike.
        let mut best: Option<(f64, usize, Vec<u32>)> = None;
        for k in 0..TRIES {
            let at = n / 3 + n * k / (3 * (TRIES - 1));
            let between = self.least_cover(blocks, at, part);
            let low = at
                - between
                    .iter()
                    .filter(|b| self.rank[**b as usize] < at)
                    .count();
            let high = n - low - between.len();
            let cost = between.len() as f64 / (low * high).max(1) as f64;
            if best.as_ref().is_none_or(|b| cost < b.0) {
                best = Some((cost, at, between));
            }
        }
        best.map(|b| (b.1, b.2)).unwrap_or_default()
    }

    /// The fewest blocks without which no edge joins the first `at` blocks of a part to the others: as many as disjoint edges can join
    /// them (Koenig), which are found by augmenting paths.
    fn least_cover(&self, blocks: &[u32], at: usize, part: u32) -> Vec<u32> {
        let across = |low: u32| {
            let around = self.graph.around(low).iter().copied();
            around.filter(|c| self.part_of[*c as usize] == part && self.rank[*c as usize] >= at)
        };
        let touches = |b: &&u32| across(**b).next().is_some();
        let edge: Vec<u32> = blocks[..at].iter().filter(touches).copied().collect();
        let mut matching = Matching::default();
        for &low in &edge {
            matching.augment(low, &across);
        }
        // From unmatched low blocks by alternating edges: what is reached above, and what is not below, covers every edge.
        let mut reached_low: FxHashSet<u32> = FxHashSet::default();
        let mut above = Vec::new();
        let is_free = |b: &&u32| !matching.of_low.contains_key(*b);
        let mut open: Vec<u32> = edge.iter().filter(is_free).copied().collect();
        let mut seen: FxHashSet<u32> = FxHashSet::default();
        while let Some(low) = open.pop() {
            if reached_low.insert(low) {
                for high in across(low).filter(|h| seen.insert(*h)) {
                    above.push(high);
                    open.extend(matching.of_high.get(&high));
                }
            }
        }
        let below = edge.into_iter().filter(|b| !reached_low.contains(b));
        below.chain(above).collect()
    }
}

/// Disjoint edges between low and high blocks.
#[derive(Default)]
struct Matching {
    of_low: FxHashMap<u32, u32>,
    of_high: FxHashMap<u32, u32>,
}

impl Matching {
    /// Matches a free low block, by moving others if need be and possible.
    fn augment<I: Iterator<Item = u32>>(&mut self, free: u32, across: &impl Fn(u32) -> I) {
        let mut came_from: FxHashMap<u32, u32> = FxHashMap::default();
        let mut open = vec![free];
        let mut next = 0;
        while let Some(&low) = open.get(next) {
            next += 1;
            for high in across(low) {
                if came_from.contains_key(&high) {
                    continue;
                }
                came_from.insert(high, low);
                match self.of_high.get(&high) {
                    Some(other) => open.push(*other),
                    None => return self.turn_over(high, &came_from),
                }
            }
        }
    }

    /// Matches along the path that led to the free block `high`.
    fn turn_over(&mut self, mut high: u32, came_from: &FxHashMap<u32, u32>) {
        loop {
            let low = came_from[&high];
            self.of_high.insert(high, low);
            match self.of_low.insert(low, high) {
                Some(before) => high = before,
                None => return,
            }
        }
    }
}

/// Unit direction in which the blocks spread most.
fn longest_axis(blocks: &[u32], positions: &[Vec3]) -> Vec3 {
    let n = blocks.len() as f64;
    let centre: Vec3 = blocks.iter().map(|b| positions[*b as usize]).sum::<Vec3>() / n;
    let spread: Matrix3<f64> = blocks
        .iter()
        .map(|b| positions[*b as usize] - centre)
        .map(|d| d * d.transpose())
        .sum();
    let eigen = spread.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_block_comes_once_and_a_chain_is_cut_in_its_middle() {
        let n = 400;
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for j in 0..n {
            rows.push(j);
            if j + 1 < n {
                rows.push(j + 1);
            }
            starts.push(rows.len());
        }
        let positions: Vec<Vec3> = (0..n).map(|i| Vec3::new(f64::from(i), 0.0, 0.0)).collect();
        let order = nested_dissection(&starts, &rows, &positions);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..n).collect::<Vec<_>>());
        let last = order[order.len() - 1];
        assert!(
            (n / 3..=2 * n / 3).contains(&last),
            "the last block is {last}"
        );
    }
}
