//! What is wrong with a surface, and mending it.
use crate::error::AnatomyError;
use crate::mesher::{self, Sketched};
use crate::surface::{ClosedSurface, EdgeFaults, n_pieces};
use crate::winding::TriangleTree;
use osteotome_mechanics::geometry::{Aabb, MeshDistance, SignedDistance, TriMesh, Vec3};
use serde::Serialize;

/// What was found about a surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Triangles.
    pub n_triangles: usize,
    /// Pieces that share no vertex.
    pub n_pieces: usize,
    /// Edges with a triangle on one side only.
    pub open_edges: usize,
    /// Edges with more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges whose two triangles face opposite ways.
    pub misoriented_edges: usize,
    /// Triangles that another one cuts.
    pub self_intersections: usize,
    /// Whether its normals point inward.
    pub inside_out: bool,
    /// Length, breadth and height \[mm\].
    pub extent: [f64; 3],
    /// Enclosed \[mm3\]; of no meaning for an open surface.
    pub volume: f64,
}

impl Diagnosis {
    /// Looks at a surface and all its triangles.
    pub fn of(mesh: &TriMesh, tree: &TriangleTree) -> Self {
        let edges = EdgeFaults::of(mesh);
        let volume = volume_about_middle(mesh);
        Self {
            n_triangles: mesh.triangles.len(),
            n_pieces: n_pieces(mesh),
            open_edges: edges.open.len(),
            non_manifold_edges: edges.non_manifold.len(),
            misoriented_edges: edges.misoriented.len(),
            self_intersections: tree.self_intersections().0,
            inside_out: volume < 0.0,
            extent: mesh.bounds().extent().into(),
            volume,
        }
    }

    /// Whether the surface cannot bound a solid as it is. Pieces beside the largest one do no harm if they are whole.
    pub fn needs_repair(&self) -> bool {
        let faults = self.open_edges + self.non_manifold_edges + self.misoriented_edges;
        faults + self.self_intersections > 0
    }

    /// In words, faults only.
    pub fn faults(&self) -> Vec<String> {
        let count = |n: usize, what: &str| (n > 0).then(|| format!("{n} {what}"));
        let faults = [
            count(self.open_edges, "open edges"),
            count(
                self.non_manifold_edges,
                "edges with more than two triangles",
            ),
            count(
                self.misoriented_edges,
                "edges whose triangles face opposite ways",
            ),
            count(self.self_intersections, "triangles cut by others"),
            count(usize::from(self.n_pieces > 1) * self.n_pieces, "pieces"),
            self.inside_out
                .then(|| "normals that point inward".to_owned()),
        ];
        faults.into_iter().flatten().collect()
    }
}

/// Where a torn surface encloses something: beyond half a turn of the winding number.
struct Enclosed<'a> {
    distance: MeshDistance,
    tree: &'a TriangleTree,
    /// -1 for a surface whose normals point inward, which goes round everything the other way.
    sense: f64,
}

impl Enclosed<'_> {
    /// Winding numbers so far from one half are taken as certain; nearer to it, as across a hole, the distance fades to zero.
    const CERTAIN: f64 = 0.25;
}

impl SignedDistance for Enclosed<'_> {
    fn signed(&self, p: &Vec3) -> f64 {
        let outward = 0.5 - self.sense * self.tree.winding(p);
        let share = (outward.abs() / Self::CERTAIN).min(1.0);
        (self.distance.unsigned(p) * share).copysign(outward)
    }

    fn bounds(&self) -> Aabb {
        self.distance.bounds()
    }
}

/// Enclosed volume \[mm3\]. About the surface's own middle holes count for little; about a scanner's far origin they would count
/// for more than the bone.
fn volume_about_middle(mesh: &TriMesh) -> f64 {
    let middle = mesh.bounds().centre();
    let six = |t: usize| {
        let [a, b, c] = mesh.corners(t).map(|p| p - middle);
        a.dot(&b.cross(&c))
    };
    (0..mesh.triangles.len()).map(six).sum::<f64>() / 6.0
}

/// Fineness of a mended surface \[mm\].
pub const MENDED_SPACING: f64 = 0.8;
/// Positions of the lattice that are tried until the contour is manifold.
const OFFSETS: u32 = 6;

/// The boundary of what a torn, folded or doubled surface encloses, closed and manifold. Edges are blunted by about a quarter of
/// [`MENDED_SPACING`]; holes are closed by the surface on which the winding number is one half.
///
/// # Errors
/// [`AnatomyError`] if it encloses nothing, or is too large.
pub fn solidify(
    mesh: &TriMesh,
    tree: &TriangleTree,
    name: &str,
) -> Result<ClosedSurface, AnatomyError> {
    let enclosed = Enclosed {
        distance: MeshDistance::new(mesh.clone()),
        tree,
        sense: volume_about_middle(mesh).signum(),
    };
    closed_contour(&enclosed, MENDED_SPACING, name)
}

/// A closed, manifold surface mesh of a region's boundary; of several pieces the largest, with a note.
///
/// # Errors
/// As [`mesher::contour`], and if no position of the lattice gives a manifold.
pub fn closed_contour(
    region: &dyn SignedDistance,
    spacing: f64,
    name: &str,
) -> Result<ClosedSurface, AnatomyError> {
    // The band in which values must be right: longer than any edge across the surface.
    let sketched = Sketched::with(region, 2.5 * spacing, 2.0 * spacing);
    let mut last = None;
    for trial in 0..OFFSETS {
        let offset = Vec3::new(0.0, 0.25, 0.25) + Vec3::new(0.819, 0.671, 0.550) * f64::from(trial);
        let found = mesher::contour_at(&sketched, spacing, &offset.map(f64::fract))
            .and_then(|mesh| ClosedSurface::new(mesh, name));
        match found {
            Ok(closed) => return Ok(closed),
            Err(error @ (AnatomyError::NonManifold { .. } | AnatomyError::Orientation { .. })) => {
                last = Some(error);
            }
            Err(error) => return Err(error),
        }
    }
    Err(last.unwrap_or_else(|| AnatomyError::EmptySurface {
        name: name.to_owned(),
    }))
}
