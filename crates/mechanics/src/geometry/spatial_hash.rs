use super::{Aabb, Vec3};

/// Boxes sorted into a hash table of cubic cells, after Teschner et al. 2003.
///
/// Real-time use: [`rebuild`](Self::rebuild) allocates only while it grows past its largest size so far;
/// [`query`](Self::query) neither allocates nor waits and visits each box at most once a cell it shares with the query.
#[derive(Debug, Default)]
pub struct SpatialHash {
    cell_size: f64,
    mask: usize,
    first: Vec<u32>,
    items: Vec<u32>,
}

/// Copies into the memory that is there.
impl Clone for SpatialHash {
    fn clone(&self) -> Self {
        let mut copy = Self::default();
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        (self.cell_size, self.mask) = (other.cell_size, other.mask);
        self.first.clone_from(&other.first);
        self.items.clone_from(&other.items);
    }
}

/// A box is entered into at most this many cells along each axis; larger boxes must be met by a larger cell size.
const MAX_CELLS_PER_AXIS: i64 = 64;

impl SpatialHash {
    /// Builds the table from `(id, box)` pairs.
    pub fn build(cell_size: f64, boxes: &[(u32, Aabb)]) -> Self {
        let mut table = Self::default();
        table.rebuild(cell_size, boxes.iter().copied());
        table
    }

    /// Builds the table again in place. `cell_size` \[mm\] is positive and about the size of the boxes.
    pub fn rebuild(
        &mut self,
        cell_size: f64,
        boxes: impl ExactSizeIterator<Item = (u32, Aabb)> + Clone,
    ) {
        self.cell_size = cell_size;
        let n_buckets = (2 * boxes.len()).next_power_of_two().max(16);
        self.mask = n_buckets - 1;
        self.first.clear();
        self.first.resize(n_buckets + 1, 0);
        for (_, b) in boxes.clone() {
            self.for_each_bucket(&b, |k, first, _| first[k + 1] += 1);
        }
        for k in 0..n_buckets {
            self.first[k + 1] += self.first[k];
        }
        self.items.clear();
        self.items.resize(self.first[n_buckets] as usize, 0);
        for (id, b) in boxes {
            self.for_each_bucket(&b, |k, first, items| {
                items[first[k] as usize] = id;
                first[k] += 1;
            });
        }
        for k in (1..=n_buckets).rev() {
            self.first[k] = self.first[k - 1];
        }
        self.first[0] = 0;
    }

    /// Calls `visit` with the id of every box whose cells meet those of `query`; an id may come more than once.
    pub fn query(&self, query: &Aabb, mut visit: impl FnMut(u32)) {
        if self.first.is_empty() {
            return;
        }
        let (lo, hi) = self.cell_range(query);
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let k = bucket([x, y, z], self.mask);
                    let range = self.first[k] as usize..self.first[k + 1] as usize;
                    self.items[range].iter().for_each(|&id| visit(id));
                }
            }
        }
    }

    fn cell_range(&self, b: &Aabb) -> ([i64; 3], [i64; 3]) {
        let cell = |v: &Vec3, k: usize| (v[k] / self.cell_size).floor() as i64;
        let lo = [0, 1, 2].map(|k| cell(&b.min, k));
        let hi = [0, 1, 2].map(|k| cell(&b.max, k).min(lo[k] + MAX_CELLS_PER_AXIS));
        (lo, hi)
    }

    fn for_each_bucket(&mut self, b: &Aabb, mut f: impl FnMut(usize, &mut [u32], &mut [u32])) {
        let (lo, hi) = self.cell_range(b);
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    f(
                        bucket([x, y, z], self.mask),
                        &mut self.first,
                        &mut self.items,
                    );
                }
            }
        }
    }
}

fn bucket(cell: [i64; 3], mask: usize) -> usize {
    // The primes of Teschner et al. 2003.
    const PRIMES: [i64; 3] = [73_856_093, 19_349_663, 83_492_791];
    let h = (0..3).fold(0, |h, k| h ^ cell[k].wrapping_mul(PRIMES[k]));
    (h as usize) & mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn query_finds_every_overlapping_box() {
        let boxes: Vec<_> = (0..300u32)
            .map(|i| {
                let c = Vec3::new(
                    f64::from(i * 37 % 101),
                    f64::from(i * 53 % 97),
                    f64::from(i * 71 % 89),
                ) * 0.3;
                (
                    i,
                    Aabb {
                        min: c,
                        max: c.add_scalar(0.4 + f64::from(i % 7)),
                    },
                )
            })
            .collect();
        let table = SpatialHash::build(2.0, &boxes);
        for (_, q) in boxes.iter().step_by(11) {
            let mut found = Vec::new();
            table.query(q, |id| found.push(id));
            for (id, b) in &boxes {
                assert!(!b.overlaps(q) || found.contains(id), "box {id} was missed");
            }
        }
    }
}
