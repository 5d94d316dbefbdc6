use super::{TetMesh, Vec3};

/// A structured block of tetrahedra for examples and verification: each of the `cells` bricks is cut into six along its
/// diagonal (Kuhn's subdivision), so that the mesh conforms everywhere.
///
/// Nodes are numbered with x fastest, then y, then z: node `(i, j, k)` is `i + (cells[0] + 1) (j + (cells[1] + 1) k)`.
///
/// # Panics
/// If `min` is not below `max` on every axis, if a coordinate is not finite or a count is zero.
pub fn block_mesh(min: Vec3, max: Vec3, cells: [usize; 3]) -> TetMesh {
    let nodes = grid_nodes(&min, &max, cells);
    let mut tets = Vec::with_capacity(6 * cells.iter().product::<usize>());
    for k in 0..cells[2] {
        for j in 0..cells[1] {
            for i in 0..cells[0] {
                tets.extend(brick_tets([i, j, k], cells));
            }
        }
    }
    TetMesh::new(nodes, tets).expect("a block needs min < max and at least one brick an axis")
}

fn grid_nodes(min: &Vec3, max: &Vec3, cells: [usize; 3]) -> Vec<Vec3> {
    let along = |axis: usize, i: usize| {
        let t = i as f64 / cells[axis] as f64;
        min[axis] * (1.0 - t) + max[axis] * t
    };
    let mut nodes = Vec::with_capacity(cells.iter().map(|n| n + 1).product());
    for k in 0..=cells[2] {
        for j in 0..=cells[1] {
            for i in 0..=cells[0] {
                nodes.push(Vec3::new(along(0, i), along(1, j), along(2, k)));
            }
        }
    }
    nodes
}

/// The six tetrahedra of one brick: a path along the axes in each of the six orders, from its low to its high corner.
fn brick_tets(brick: [usize; 3], cells: [usize; 3]) -> [[u32; 4]; 6] {
    const EVEN: [[usize; 3]; 3] = [[0, 1, 2], [1, 2, 0], [2, 0, 1]];
    const ODD: [[usize; 3]; 3] = [[0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let index = |c: [usize; 3]| (c[0] + (cells[0] + 1) * (c[1] + (cells[1] + 1) * c[2])) as u32;
    let path = |axes: [usize; 3]| {
        let mut corner = brick;
        let mut tet = [index(corner); 4];
        for (node, axis) in tet[1..].iter_mut().zip(axes) {
            corner[axis] += 1;
            *node = index(corner);
        }
        tet
    };
    let mirrored = |[a, b, c, d]: [u32; 4]| [a, c, b, d];
    let [e, o] = [EVEN.map(path), ODD.map(path).map(mirrored)];
    [e[0], e[1], e[2], o[0], o[1], o[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_filled_and_closed() {
        let (min, max) = (Vec3::new(-1.0, 0.0, 2.0), Vec3::new(3.0, 1.5, 5.0));
        let mesh = block_mesh(min, max, [4, 2, 3]);
        assert_eq!(mesh.nodes().len(), 5 * 3 * 4);
        assert_eq!(mesh.tets().len(), 6 * 24);
        assert!((mesh.volume() - 18.0).abs() < 1e-12);
        assert_eq!(mesh.boundary_faces().len(), 2 * 2 * (8 + 6 + 12));
        assert_eq!(mesh.bounds().max, max);
    }
}
