use crate::geometry::Vec3;

/// Where on the bone a point lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointOrigin {
    /// On the bone's surface before any cut.
    Surface,
    /// On a wall of the crack.
    Wall {
        /// Unit normal that points out of the bone of its own side, into the crack; undeformed.
        normal: Vec3,
    },
}

/// A point of the bone's surface or of a crack wall that stands for a patch of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShellPoint {
    /// Undeformed \[mm\].
    pub position: Vec3,
    /// The tetrahedron that holds it.
    pub tet: u32,
    /// The tetrahedron's shape functions there.
    pub weights: [f32; 4],
    /// The area it stands for \[mm2\].
    pub area: f32,
    /// Surface or crack wall.
    pub origin: PointOrigin,
}

/// The points of the bone sorted by cell, as the contact query reads them.
///
/// A point's id is its index in the list it was grouped from; points are only ever appended to that list, so ids are stable.
#[derive(Clone, Debug, Default)]
pub struct PointShell {
    /// Range of each cell's points: `first[c]..first[c + 1]`.
    first: Vec<u32>,
    ids: Vec<u32>,
    weights: [Vec<f32>; 4],
    areas: Vec<f32>,
    /// Wall normals; zero for surface points.
    normals: Vec<[f32; 3]>,
    /// One past the highest id.
    n_ids: usize,
}

/// The points of one cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellPoints<'a> {
    /// Place of the first in the shell's arrays.
    pub first: usize,
    pub weights: [&'a [f32]; 4],
    pub areas: &'a [f32],
    pub ids: &'a [u32],
    pub normals: &'a [[f32; 3]],
}

impl PointShell {
    /// The cell number of a point that is dropped (it lies in the kerf).
    pub const DROPPED: u32 = u32::MAX;

    /// Sorts the points by cell; `cell_of[i]` is the cell of point `i`, [`DROPPED`](Self::DROPPED) or beyond `n_cells` to leave it out.
    pub fn group(points: &[ShellPoint], cell_of: &[u32], n_cells: usize) -> Self {
        let mut first = vec![0u32; n_cells + 1];
        let mut ids: Vec<u32> = (0u32..)
            .zip(points.iter().zip(cell_of))
            .filter(|(_, (_, cell))| (**cell as usize) < n_cells)
            .map(|(id, _)| id)
            .collect();
        ids.sort_by_key(|&id| cell_of[id as usize]);
        for &id in &ids {
            first[cell_of[id as usize] as usize + 1] += 1;
        }
        for c in 0..n_cells {
            first[c + 1] += first[c];
        }
        let point = |id: &u32| &points[*id as usize];
        let weights = [0, 1, 2, 3].map(|k| ids.iter().map(|id| point(id).weights[k]).collect());
        Self {
            first,
            weights,
            areas: ids.iter().map(|id| point(id).area).collect(),
            normals: ids.iter().map(|id| normal(point(id))).collect(),
            n_ids: points.len(),
            ids,
        }
    }

    /// How many points take part.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether no point takes part.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// How many cells there are, empty ones included.
    pub fn n_cells(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// One past the highest id: the length of the list that was grouped.
    pub fn n_ids(&self) -> usize {
        self.n_ids
    }

    /// Whether cell `c` holds any point.
    pub fn cell_is_empty(&self, c: usize) -> bool {
        self.first[c] == self.first[c + 1]
    }

    /// The shape functions of the point at place `k` of the sorted list; `None` beyond its end.
    pub fn weights(&self, k: usize) -> Option<[f32; 4]> {
        let [a, b, c, d] = &self.weights;
        Some([*a.get(k)?, *b.get(k)?, *c.get(k)?, *d.get(k)?])
    }

    /// The points of cell `c`; `None` if there is no such cell.
    pub(super) fn cell(&self, c: usize) -> Option<CellPoints<'_>> {
        let first = *self.first.get(c)? as usize;
        let range = first..*self.first.get(c + 1)? as usize;
        let [a, b, c, d] = &self.weights;
        Some(CellPoints {
            first,
            weights: [
                a.get(range.clone())?,
                b.get(range.clone())?,
                c.get(range.clone())?,
                d.get(range.clone())?,
            ],
            areas: self.areas.get(range.clone())?,
            ids: self.ids.get(range.clone())?,
            normals: self.normals.get(range)?,
        })
    }
}

fn normal(point: &ShellPoint) -> [f32; 3] {
    match point.origin {
        PointOrigin::Surface => [0.0; 3],
        PointOrigin::Wall { normal } => [0, 1, 2].map(|k| normal[k] as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_grouped_in_order_and_dropped_ones_left_out() {
        let point = |i: u32| ShellPoint {
            position: Vec3::zeros(),
            tet: 0,
            weights: [i as f32, 0.0, 0.0, 0.0],
            area: 1.0,
            origin: PointOrigin::Surface,
        };
        let points: Vec<_> = (0..6).map(point).collect();
        let shell = PointShell::group(&points, &[2, 0, u32::MAX, 2, 9, 0], 3);
        assert_eq!((shell.len(), shell.n_cells(), shell.n_ids()), (4, 3, 6));
        assert_eq!(shell.cell(0).unwrap().ids, [1, 5]);
        assert!(shell.cell_is_empty(1));
        let last = shell.cell(2).unwrap();
        assert_eq!(last.ids, [0, 3]);
        assert_eq!(last.weights[0], [0.0, 3.0]);
        assert!(shell.cell(3).is_none());
    }
}
