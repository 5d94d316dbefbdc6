//! The body-centred cubic lattice: the points of a cubic grid and the centres of its cells.
//!
//! Its Delaunay tetrahedra are all alike: two opposite *long* edges (length `spacing`, between points of one kind) and four
//! *short* ones (length sqrt(3)/2 `spacing`, between a corner and a centre).
use osteotome_mechanics::geometry::{Aabb, Vec3};

/// A finite piece of the lattice. Point ids count corners (even) and centres (odd) in turn.
#[derive(Clone, Debug)]
pub struct Lattice {
    origin: Vec3,
    spacing: f64,
    cells: [usize; 3],
}

impl Lattice {
    /// A lattice that reaches two cells beyond `bounds` on each side; `offset` in units of the spacing shifts it.
    pub fn around(bounds: &Aabb, spacing: f64, offset: &Vec3) -> Self {
        let extent = bounds.extent();
        let cells = [0, 1, 2].map(|k| (extent[k] / spacing).ceil() as usize + 5);
        let origin = Vec3::from_fn(|k, _| {
            let middle = 0.5 * (bounds.min[k] + bounds.max[k]);
            middle + (offset[k].fract() - 0.5 * cells[k] as f64) * spacing
        });
        Self {
            origin,
            spacing,
            cells,
        }
    }

    /// How many points a lattice around `bounds` would have.
    pub fn size_around(bounds: &Aabb, spacing: f64) -> f64 {
        (0..3)
            .map(|k| bounds.extent()[k] / spacing + 5.0)
            .product::<f64>()
            * 2.0
    }

    /// Number of points.
    pub fn n_points(&self) -> usize {
        2 * self.cells.iter().product::<usize>()
    }

    /// Long edge length \[mm\].
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Position of a point.
    pub fn position(&self, id: u32) -> Vec3 {
        let (cell, centre) = self.split(id);
        let half = if centre { 0.5 } else { 0.0 };
        self.origin + Vec3::from_fn(|k, _| (cell[k] as f64 + half) * self.spacing)
    }

    /// Whether the edge between two neighbouring points is a long one.
    pub fn is_long(a: u32, b: u32) -> bool {
        (a ^ b) & 1 == 0
    }

    /// Calls `visit` with the 14 neighbours of a point; nothing for points of the outermost layer.
    pub fn neighbours(&self, id: u32, mut visit: impl FnMut(u32)) {
        let (cell, centre) = self.split(id);
        if (0..3).any(|k| cell[k] == 0 || cell[k] + 1 == self.cells[k]) {
            return;
        }
        let stride = self.strides();
        for s in stride {
            visit(id - s);
            visit(id + s);
        }
        for corner in 0..8 {
            let shift: u32 = (0..3)
                .filter(|k| corner >> k & 1 == 1)
                .map(|k| stride[k])
                .sum();
            // A centre's corners lie at its own cell and up; a corner's centres lie down.
            visit(if centre {
                id - 1 + shift
            } else {
                id + 1 - shift
            });
        }
    }

    /// Calls `visit` with every tetrahedron, positively oriented; the first two and the last two corners make its long edges.
    pub fn tets(&self, mut visit: impl FnMut([u32; 4])) {
        let stride = self.strides();
        for k in 0..self.cells[2] - 1 {
            for j in 0..self.cells[1] - 1 {
                for i in 0..self.cells[0] - 1 {
                    let corner = i as u32 * stride[0] + j as u32 * stride[1] + k as u32 * stride[2];
                    let cell = [i, j, k];
                    for axis in 0..3 {
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        if cell[u] + 2 > self.cells[u] || cell[v] + 2 > self.cells[v] {
                            continue;
                        }
                        let face = corner + stride[axis];
                        let ring = [
                            face,
                            face + stride[u],
                            face + stride[u] + stride[v],
                            face + stride[v],
                        ];
                        for m in 0..4 {
                            visit([
                                corner + 1,
                                corner + 1 + stride[axis],
                                ring[m],
                                ring[(m + 1) % 4],
                            ]);
                        }
                    }
                }
            }
        }
    }

    fn strides(&self) -> [u32; 3] {
        let x = 2;
        let y = x * self.cells[0] as u32;
        [x, y, y * self.cells[1] as u32]
    }

    fn split(&self, id: u32) -> ([usize; 3], bool) {
        let n = id as usize / 2;
        let [nx, ny, _] = self.cells;
        ([n % nx, n / nx % ny, n / (nx * ny)], id & 1 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice() -> Lattice {
        let bounds = Aabb {
            min: Vec3::zeros(),
            max: Vec3::new(3.0, 2.0, 4.0),
        };
        Lattice::around(&bounds, 1.0, &Vec3::new(0.2, 0.7, 0.4))
    }

    #[test]
    fn tetrahedra_are_alike_and_fill_space() {
        let lattice = lattice();
        let mut volume = 0.0;
        lattice.tets(|t| {
            let x = t.map(|p| lattice.position(p));
            let v = (x[1] - x[0]).dot(&(x[2] - x[0]).cross(&(x[3] - x[0]))) / 6.0;
            assert!((v - 1.0 / 12.0).abs() < 1e-12, "{v}");
            assert!(Lattice::is_long(t[0], t[1]) && Lattice::is_long(t[2], t[3]));
            assert!(!Lattice::is_long(t[0], t[2]));
            volume += v;
        });
        // All faces between cell centres, four tetrahedra each.
        let [a, b, c] = lattice.cells.map(|n| n as f64);
        assert!(volume > 0.9 * (a - 2.0) * (b - 2.0) * (c - 2.0));
    }

    #[test]
    fn neighbours_are_at_lattice_distances_and_mutual() {
        let lattice = lattice();
        let middle = lattice.n_points() as u32 / 2;
        for id in [middle, middle + 1] {
            let mut count = 0;
            lattice.neighbours(id, |n| {
                count += 1;
                let d = (lattice.position(n) - lattice.position(id)).norm();
                let want = if Lattice::is_long(n, id) {
                    1.0
                } else {
                    0.75f64.sqrt()
                };
                assert!((d - want).abs() < 1e-12);
                let mut back = false;
                lattice.neighbours(n, |m| back |= m == id);
                assert!(back);
            });
            assert_eq!(count, 14);
        }
    }
}
