//! The order of elimination: nested dissection by planes.
//!
//! Bodies are cut in two across their longest axis where the fewest nodes lie between the halves, those nodes come last, and
//! so on with each half (George 1973). On slender bodies that leaves less fill than minimum degree, and what matters as much
//! here: short paths up the elimination tree, which is all that an appended column or a local solve passes through.
use crate::geometry::Vec3;
use nalgebra::Matrix3;

/// A part of this many blocks or fewer is not cut further.
const LEAF: usize = 24;
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
            self.order.extend(blocks);
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

    /// Where to cut a sorted part, and the blocks of one side that touch the other there.
    fn thinnest(&mut self, blocks: &[u32], part: u32) -> (usize, Vec<u32>) {
        let n = blocks.len();
        for (k, b) in blocks.iter().enumerate() {
            self.rank[*b as usize] = k;
        }
        let ranks = |b: &u32| {
            let inside = self.graph.around(*b).iter();
            inside
                .filter(|c| self.part_of[**c as usize] == part)
                .map(|c| self.rank[*c as usize])
        };
        let reach: Vec<(usize, usize)> = blocks
            .iter()
            .enumerate()
            .map(|(k, b)| ranks(b).fold((k, k), |(lo, hi), r| (lo.min(r), hi.max(r))))
            .collect();
        // Few blocks between, and halves not too unlike.
        let cost = |at: usize, side: &[u32]| side.len() as f64 / (at * (n - at)) as f64;
        let mut best: Option<(usize, Vec<u32>)> = None;
        for k in 0..TRIES {
            let at = n / 3 + n * k / (3 * (TRIES - 1));
            let below = (0..at).filter(|&r| reach[r].1 >= at).map(|r| blocks[r]);
            let above = (at..n).filter(|&r| reach[r].0 < at).map(|r| blocks[r]);
            for side in [below.collect::<Vec<_>>(), above.collect()] {
                if best
                    .as_ref()
                    .is_none_or(|b| cost(at, &side) < cost(b.0, &b.1))
                {
                    best = Some((at, side));
                }
            }
        }
        best.unwrap_or_default()
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
