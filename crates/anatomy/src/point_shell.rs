//! Points spread evenly over a surface: what a chisel feels.
use crate::error::{AnatomyError, in_range};
use crate::teeth::ToothBody;
use osteotome_mechanics::geometry::{Aabb, MeshDistance, TriMesh, Vec3};

/// A point that stands for a piece of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// On the surface \[mm\].
    pub position: Vec3,
    /// Outward unit normal of its triangle.
    pub normal: Vec3,
    /// The area it stands for \[mm2\]; all together make the surface's area.
    pub area: f64,
    /// In the bone that carries the point: the point itself, on a crown a place under its neck, the same for all its points, so
    /// that a crown moves as one piece \[mm\].
    pub anchor: Vec3,
}

/// Smallest and largest number of points that may be asked for.
pub const POINT_RANGE: [usize; 2] = [100, 10_000_000];

/// Spreads `n` points over a surface, each with the same area: one in each of `n` equal strips of the area, the triangles taken
/// along a space-filling curve, and spread inside triangles by a low-discrepancy sequence. Deterministic.
///
/// # Errors
/// [`AnatomyError::OutOfRange`] for a number outside [`POINT_RANGE`], [`AnatomyError::EmptySurface`] for a surface without area.
pub fn point_shell(surface: &TriMesh, n: usize) -> Result<Vec<SurfacePoint>, AnatomyError> {
    check_count(n)?;
    spread_over(surface, n)
}

fn check_count(n: usize) -> Result<(), AnatomyError> {
    let [low, high] = POINT_RANGE;
    in_range("patient.shell_points", n as f64, low as f64, high as f64)
}

/// As [`point_shell`], for a bone with crowns: about `n` points (within 1 % from 20,000 on), equally dense on bone and crowns, and
/// none where one covers the other or neighbouring crowns meet. `teeth`: the crowns, each with its closed surface.
///
/// # Errors
/// As [`point_shell`].
pub fn toothed_point_shell(
    bone: &MeshDistance,
    teeth: &[(&dyn ToothBody, &TriMesh)],
    n: usize,
) -> Result<Vec<SurfacePoint>, AnatomyError> {
    check_count(n)?;
    // Once to see how much is hidden, once to have as many as were asked for.
    let tried = uncovered(bone, teeth, n)?.len().max(1);
    uncovered(
        bone,
        teeth,
        (n as f64 * n as f64 / tried as f64).round() as usize,
    )
}

/// `n` points over all surfaces, less those that are covered.
fn uncovered(
    bone: &MeshDistance,
    teeth: &[(&dyn ToothBody, &TriMesh)],
    n: usize,
) -> Result<Vec<SurfacePoint>, AnatomyError> {
    let area = bone.mesh().area() + teeth.iter().map(|(_, mesh)| mesh.area()).sum::<f64>();
    let share = |mesh: &TriMesh| ((n as f64 * mesh.area() / area).round() as usize).max(1);
    let covered = |p: &Vec3, but: Option<usize>| {
        let crowns = teeth.iter().enumerate().filter(|(i, _)| Some(*i) != but);
        crowns
            .into_iter()
            .any(|(_, (crown, _))| crown.signed(p) < 0.0)
    };
    let mut points = spread_over(bone.mesh(), share(bone.mesh()))?;
    points.retain(|p| !covered(&p.position, None));
    for (i, (crown, mesh)) in teeth.iter().enumerate() {
        let mut of_crown = spread_over(mesh, share(mesh))?;
        of_crown.retain(|p| bone.signed(&p.position) > 0.0 && !covered(&p.position, Some(i)));
        of_crown.iter_mut().for_each(|p| p.anchor = crown.anchor());
        points.extend(of_crown);
    }
    Ok(points)
}

fn spread_over(surface: &TriMesh, n: usize) -> Result<Vec<SurfacePoint>, AnatomyError> {
    let order = along_curve(surface);
    let mut ends = Vec::with_capacity(order.len());
    let mut total = 0.0;
    for &t in &order {
        total += 0.5 * surface.area_normal(t as usize).norm();
        ends.push(total);
    }
    if total.is_nan() || total <= 0.0 {
        return Err(AnatomyError::EmptySurface {
            name: "the surface to sample".to_owned(),
        });
    }
    let area = total / n as f64;
    let mut points = Vec::with_capacity(n);
    let mut i = 0;
    for k in 0..n {
        let at = (k as f64 + 0.5) * area;
        while i + 1 < ends.len() && ends[i] < at {
            i += 1;
        }
        let t = order[i] as usize;
        let position = inside(&surface.corners(t), k);
        points.push(SurfacePoint {
            position,
            anchor: position,
            normal: surface.area_normal(t).normalize(),
            area,
        });
    }
    Ok(points)
}

/// The k-th point of the R2 sequence (Roberts 2018), folded into a triangle.
fn inside(corners: &[Vec3; 3], k: usize) -> Vec3 {
    let u = (0.5 + k as f64 * 0.754_877_666_246_692_8).fract();
    let v = (0.5 + k as f64 * 0.569_840_290_998_053_3).fract();
    let (u, v) = if u + v > 1.0 {
        (1.0 - u, 1.0 - v)
    } else {
        (u, v)
    };
    corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v
}

/// Triangles with an area, sorted by their centres along a Morton curve.
fn along_curve(surface: &TriMesh) -> Vec<u32> {
    let bounds: Aabb = surface.bounds();
    let cell = bounds.extent().max().max(f64::MIN_POSITIVE) / 1023.0;
    let code = |t: u32| {
        let [a, b, c] = surface.corners(t as usize);
        let q = ((a + b + c) / 3.0 - bounds.min) / cell;
        (0..3).fold(0u64, |m, k| m | spread(q[k] as u64) << k)
    };
    let mut order: Vec<(u64, u32)> = (0..surface.triangles.len() as u32)
        .filter(|&t| surface.area_normal(t as usize).norm() > 0.0)
        .map(|t| (code(t), t))
        .collect();
    order.sort_unstable();
    order.into_iter().map(|(_, t)| t).collect()
}

/// Ten bits with two zeros between each.
fn spread(v: u64) -> u64 {
    (0..10).fold(0, |m, bit| m | (v >> bit & 1) << (3 * bit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::tests::tetrahedron;

    #[test]
    fn points_lie_on_the_surface_and_their_areas_add_up() {
        let mesh = tetrahedron();
        let points = point_shell(&mesh, 5_000).unwrap();
        assert_eq!(points.len(), 5_000);
        let sum: f64 = points.iter().map(|p| p.area).sum();
        assert!((sum - mesh.area()).abs() < 1e-9 * sum);
        let distance = osteotome_mechanics::geometry::MeshDistance::new(mesh);
        for p in &points {
            assert!(distance.unsigned(&p.position) < 1e-12);
            assert!(distance.signed(&(p.position + p.normal * 1e-3)) > 0.0);
        }
    }

    #[test]
    fn every_part_of_the_surface_gets_its_share() {
        let mesh = tetrahedron();
        let points = point_shell(&mesh, 20_000).unwrap();
        // A square of 2 x 2 mm on the face z = 0, whose fair share is 4 mm2.
        let share: f64 = points
            .iter()
            .filter(|p| p.position.z.abs() < 1e-9)
            .filter(|p| (1.0..3.0).contains(&p.position.x) && (2.0..4.0).contains(&p.position.y))
            .map(|p| p.area)
            .sum();
        assert!((share - 4.0).abs() < 0.1, "{share}");
    }

    #[test]
    fn silly_counts_are_refused() {
        let text = point_shell(&tetrahedron(), 3).unwrap_err().to_string();
        assert!(text.contains("patient.shell_points = 3"), "{text}");
    }
}
