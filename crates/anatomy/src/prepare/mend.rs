//! Surfaces closed, teeth told apart.
use super::bone::Raw;
use crate::deviation::Deviation;
use crate::diagnosis::{Diagnosis, solidify};
use crate::error::AnatomyError;
use crate::mesher;
use crate::surface::{ClosedSurface, compact, split_pieces, weld};
use crate::teeth::Tooth;
use crate::winding::TriangleTree;
use osteotome_mechanics::geometry::{MeshDistance, SignedDistance, TriMesh, Vec3};

/// A tooth smaller than this is a crumb \[mm3\].
const LEAST_TOOTH: f64 = 20.0;
/// No jaw has more teeth.
const MAX_TEETH: usize = 20;

/// The surface, closed; mended only where that is needed.
pub(super) fn mended(
    mut mesh: TriMesh,
    name: &str,
    progress: &mut dyn FnMut(f64),
) -> Result<(ClosedSurface, Diagnosis, Option<Deviation>), AnatomyError> {
    let mut tree = TriangleTree::new(&mesh);
    let mut diagnosis = Diagnosis::of(&mesh, &tree);
    if diagnosis.open_edges > 0 {
        // Exporters leave triangles loose, or doubled vertices along seams.
        let corners: Vec<[Vec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
        let welded = weld(&corners);
        tree = TriangleTree::new(&welded);
        diagnosis = Diagnosis::of(&welded, &tree);
        mesh = welded;
    }
    if !diagnosis.needs_repair() {
        return Ok((ClosedSurface::new(mesh, name)?, diagnosis, None));
    }
    progress(0.3);
    let closed = solidify(&mesh, &tree, name).map_err(|error| match error {
        AnatomyError::Mesher { .. } => AnatomyError::Format {
            path: name.to_owned(),
            format: "surface",
            reason: format!(
                "its triangles ({}) go round no volume; give the bone's whole surface",
                diagnosis.faults().join(", ")
            ),
        },
        other => other,
    })?;
    progress(0.8);
    let mending = Deviation::between(
        &MeshDistance::new(closed.mesh.clone()),
        &MeshDistance::new(mesh),
    )?;
    Ok((closed, diagnosis, Some(mending)))
}

/// All of a region's boundary, of whatever many pieces.
pub(super) fn all_pieces(
    region: &dyn SignedDistance,
    spacing: f64,
) -> Result<TriMesh, AnatomyError> {
    let how = mesher::Stuffing {
        spacing,
        shift: 0.0,
        offset: Vec3::new(0.0, 0.25, 0.25),
    };
    let tets = mesher::stuff_all(region, &how)?;
    Ok(compact(&tets.nodes, &tets.boundary()))
}

/// Each piece is a tooth.
pub(super) fn add_teeth(raw: &mut Raw, mesh: &TriMesh, name: &str) -> Result<(), AnatomyError> {
    let pieces = split_pieces(mesh);
    if pieces.len() > 50 * MAX_TEETH {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (pieces)"),
            size: pieces.len() as u64,
            limit: 50 * MAX_TEETH as u64,
        });
    }
    let mut crumbs = 0;
    for piece in pieces {
        if piece.volume().abs() < LEAST_TOOTH {
            crumbs += 1;
            continue;
        }
        let (surface, _, mending) = mended(piece, name, &mut |_| {})?;
        if mending.is_some() {
            raw.notes
                .push(format!("{name}: a tooth's surface was mended"));
        }
        raw.teeth.push(Tooth {
            fdi: 0,
            surface: surface.mesh,
        });
    }
    if raw.teeth.len() > MAX_TEETH {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (teeth)"),
            size: raw.teeth.len() as u64,
            limit: MAX_TEETH as u64,
        });
    }
    if crumbs > 0 {
        raw.notes.push(format!(
            "{name}: {crumbs} pieces smaller than {LEAST_TOOTH} mm3 were left out of the teeth"
        ));
    }
    // From the patient's right to the left.
    let place = |t: &Tooth| t.surface.bounds().centre().x;
    raw.teeth.sort_by(|a, b| place(a).total_cmp(&place(b)));
    Ok(())
}
