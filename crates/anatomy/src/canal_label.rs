//! The canal's centre line from its voxels.
use crate::canal::Canal;
use crate::labels::LabelVolume;
use crate::osteotomy::Side;
use osteotome_mechanics::geometry::Vec3;
use rustc_hash::FxHashMap;
use std::collections::VecDeque;
use std::f64::consts::PI;

/// Pieces of a line between whose middles points are placed \[mm\].
const STEP: f64 = 1.5;
/// A piece of label shorter than this is a crumb \[mm\].
const LEAST_LENGTH: f64 = 10.0;
/// Gaps between pieces of one canal that are bridged \[mm\].
const GAP: f64 = 6.0;

/// One canal a side, of those voxels that have the label; `middle`: x of the midline \[mm\]. What is left out is told in `notes`.
///
/// Each side's longest piece is walked from end to end; points are the means of its voxels at equal steps of the way, the radius
/// that of a cylinder of as much volume and length.
pub fn canals(volume: &LabelVolume, label: u8, middle: f64, notes: &mut Vec<String>) -> Vec<Canal> {
    let voxels: Vec<usize> = (0..volume.voxels.len())
        .filter(|i| volume.voxels[*i] == label)
        .collect();
    let mut found = Vec::new();
    for side in [Side::Right, Side::Left] {
        let own: Vec<usize> = voxels
            .iter()
            .copied()
            .filter(|i| (volume.place(*i).x - middle) * side.sign() > 0.0)
            .collect();
        match canal(volume, &own, side) {
            Some(canal) => found.push(canal),
            None if own.is_empty() => notes.push(format!("no canal is labelled on the {side:?} side")),
            None => notes.push(format!(
                "the canal's label on the {side:?} side is in pieces shorter than {LEAST_LENGTH} mm and was left out"
            )),
        }
    }
    found
}

fn canal(volume: &LabelVolume, voxels: &[usize], side: Side) -> Option<Canal> {
    let cloud = Cloud::new(volume, voxels);
    let start = *cloud.walk(0).last()?;
    // From one end to the other; the second walk gives the way to each voxel.
    let (way, order) = cloud.ways(start);
    let length = way[*order.last()?];
    if length < LEAST_LENGTH {
        return None;
    }
    let n = (length / STEP).round().max(2.0) as usize;
    let mut sums = vec![(Vec3::zeros(), 0.0); n];
    for i in &order {
        let bin = ((way[*i] / length * n as f64) as usize).min(n - 1);
        sums[bin].0 += cloud.places[*i];
        sums[bin].1 += 1.0;
    }
    let mut line: Vec<Vec3> = sums
        .iter()
        .filter(|s| s.1 > 0.0)
        .map(|s| s.0 / s.1)
        .collect();
    // The mandibular foramen lies behind and above.
    let behind = |p: &Vec3| p.y + p.z;
    if behind(line.first()?) < behind(line.last()?) {
        line.reverse();
    }
    let run: f64 = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    // The bins' middles leave half a bin out at either end.
    let run = run * n as f64 / (n as f64 - 1.0);
    let held = order.len() as f64 * volume.affine.voxel();
    Some(Canal {
        side,
        line,
        radius: (held / (PI * run)).sqrt().clamp(0.25, 5.0),
        is_constructed: false,
    })
}

/// Voxels with their neighbours, those across small gaps among them.
struct Cloud {
    places: Vec<Vec3>,
    neighbours: Vec<Vec<u32>>,
}

impl Cloud {
    fn new(volume: &LabelVolume, voxels: &[usize]) -> Self {
        let places: Vec<Vec3> = voxels.iter().map(|i| volume.place(*i)).collect();
        let number: FxHashMap<[usize; 3], u32> = voxels
            .iter()
            .zip(0u32..)
            .map(|(i, k)| (volume.index(*i), k))
            .collect();
        let near = |i: usize| {
            let at = volume.index(i);
            (0..27)
                .filter_map(|c| {
                    let to = [at[0] + c % 3, at[1] + c / 3 % 3, at[2] + c / 9];
                    let to = [
                        to[0].checked_sub(1)?,
                        to[1].checked_sub(1)?,
                        to[2].checked_sub(1)?,
                    ];
                    number.get(&to).copied().filter(|_| to != at)
                })
                .collect::<Vec<u32>>()
        };
        let neighbours = voxels.iter().map(|i| near(*i)).collect();
        let mut cloud = Self { places, neighbours };
        cloud.bridge();
        cloud
    }

    /// Joins pieces that lie near each other, nearest first, at their nearest voxels.
    fn bridge(&mut self) {
        /// More pieces than this are noise, and only the first are looked at.
        const MAX_PIECES: usize = 40;
        let mut pieces = self.pieces();
        pieces.sort_by_key(|p| std::cmp::Reverse(p.len()));
        pieces.truncate(MAX_PIECES);
        while pieces.len() > 1 {
            // The largest piece and the one nearest to it.
            let main = pieces.swap_remove(0);
            let best = (0..pieces.len())
                .map(|k| (self.gap(&main, &pieces[k]), k))
                .min_by(|a, b| a.0.0.total_cmp(&b.0.0));
            let Some(((distance, from, to), k)) = best.filter(|b| b.0.0 <= GAP) else {
                break;
            };
            debug_assert!(distance <= GAP);
            self.neighbours[from as usize].push(to);
            self.neighbours[to as usize].push(from);
            let joined = pieces.swap_remove(k);
            pieces.insert(0, [main, joined].concat());
        }
    }

    fn gap(&self, a: &[u32], b: &[u32]) -> (f64, u32, u32) {
        let mut best = (f64::INFINITY, 0, 0);
        // Every few voxels are enough to find where pieces come near.
        let step = (a.len() / 500).max(1);
        for i in a.iter().step_by(step) {
            for k in b.iter().step_by((b.len() / 500).max(1)) {
                let d = (self.places[*i as usize] - self.places[*k as usize]).norm();
                if d < best.0 {
                    best = (d, *i, *k);
                }
            }
        }
        best
    }

    fn pieces(&self) -> Vec<Vec<u32>> {
        let mut is_seen = vec![false; self.places.len()];
        let mut pieces = Vec::new();
        for i in 0..self.places.len() as u32 {
            if is_seen[i as usize] {
                continue;
            }
            let mut piece = vec![i];
            is_seen[i as usize] = true;
            let mut next = 0;
            while next < piece.len() {
                for k in &self.neighbours[piece[next] as usize] {
                    if !is_seen[*k as usize] {
                        is_seen[*k as usize] = true;
                        piece.push(*k);
                    }
                }
                next += 1;
            }
            pieces.push(piece);
        }
        pieces
    }

    /// Voxels of the largest piece, the one that lies furthest from its `first` along the piece at the end.
    fn walk(&self, first: usize) -> Vec<usize> {
        let pieces = self.pieces();
        let Some(largest) = pieces.iter().max_by_key(|p| p.len()) else {
            return Vec::new();
        };
        self.ways(largest[first] as usize).1
    }

    /// The way along the label from one voxel to each other \[mm\], and those reached, nearest first.
    fn ways(&self, start: usize) -> (Vec<f64>, Vec<usize>) {
        let mut way = vec![f64::INFINITY; self.places.len()];
        way[start] = 0.0;
        // Label-correcting: the label is thin and its graph small.
        let mut queue = VecDeque::from([start]);
        let mut waits = vec![false; self.places.len()];
        while let Some(i) = queue.pop_front() {
            waits[i] = false;
            for k in self.neighbours[i].iter().map(|k| *k as usize) {
                let further = way[i] + (self.places[k] - self.places[i]).norm();
                if further < way[k] - 1e-9 {
                    way[k] = further;
                    if !std::mem::replace(&mut waits[k], true) {
                        queue.push_back(k);
                    }
                }
            }
        }
        let mut reached: Vec<usize> = (0..way.len()).filter(|i| way[*i].is_finite()).collect();
        reached.sort_by(|a, b| way[*a].total_cmp(&way[*b]).then(a.cmp(b)));
        (way, reached)
    }
}
