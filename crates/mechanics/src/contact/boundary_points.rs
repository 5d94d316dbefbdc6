use super::{PointOrigin, ShellPoint};
use crate::geometry::{NO_TET, TET_FACES, TetMesh, Vec3};

/// Points on the boundary of a mesh itself, `n * n` a boundary triangle, each for the same share of it: a shell for
/// examples and verification, where the mesh is the body.
pub fn boundary_points(mesh: &TetMesh, n: usize) -> Vec<ShellPoint> {
    let mut points = Vec::new();
    for (t, neighbours) in mesh.neighbours().iter().enumerate() {
        let corners = mesh.corners(t);
        for (face, neighbour) in TET_FACES.iter().zip(neighbours) {
            if *neighbour != NO_TET {
                continue;
            }
            let [a, b, c] = face.map(|i| corners[i]);
            let area = (0.5 * (b - a).cross(&(c - a)).norm() / (n * n) as f64) as f32;
            for [u, v] in centroids(n) {
                let position = a + u * (b - a) + v * (c - a);
                points.push(shell_point(mesh, t, position, area));
            }
        }
    }
    points
}

fn shell_point(mesh: &TetMesh, t: usize, position: Vec3, area: f32) -> ShellPoint {
    ShellPoint {
        position,
        tet: t as u32,
        weights: mesh.barycentric(t, &position).map(|w| w as f32),
        area,
        origin: PointOrigin::Surface,
    }
}

/// Centroids of the `n * n` triangles that a triangle is cut into, along its two edges from the first corner.
fn centroids(n: usize) -> impl Iterator<Item = [f64; 2]> {
    let at = move |i: usize, j: usize, third: f64| {
        [(i as f64 + third) / n as f64, (j as f64 + third) / n as f64]
    };
    (0..n).flat_map(move |i| {
        let upright = (0..n - i).map(move |j| at(i, j, 1.0 / 3.0));
        let inverted = (0..(n - i).saturating_sub(1)).map(move |j| at(i, j, 2.0 / 3.0));
        upright.chain(inverted)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::block_mesh;

    #[test]
    fn the_points_stand_for_the_whole_boundary() {
        let mesh = block_mesh(Vec3::zeros(), Vec3::new(2.0, 3.0, 4.0), [2, 2, 3]);
        let points = boundary_points(&mesh, 3);
        assert_eq!(points.len(), 9 * mesh.boundary_faces().len());
        let area: f64 = points.iter().map(|p| f64::from(p.area)).sum();
        assert!((area - 52.0).abs() < 1e-4);
        for p in &points {
            assert!(p.weights.iter().all(|w| (-1e-6..=1.0).contains(w)));
        }
    }
}
