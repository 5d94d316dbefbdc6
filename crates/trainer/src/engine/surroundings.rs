//! What stands still around the jaw: surfaces of a scenario as distance fields for contact.
use crate::scenario::Context as Surface;
use anyhow::Result;
use osteotome_anatomy::ClosedSurface;
use osteotome_anatomy::input::read_surface;
use osteotome_mechanics::geometry::{Aabb, DistanceGrid, MeshDistance, TriMesh, Vec3};
use std::sync::Arc;

/// Of the samples of a field \[mm\]: blades are broad.
const SPACING: f64 = 1.0;
/// Farther from the osteotomy line than this \[mm\] no blade touches anything.
const REACH: f64 = 60.0;

/// One surface around the jaw.
#[derive(Clone, Debug)]
pub struct Surrounding {
    /// What it is.
    pub role: String,
    /// Its surface, to be seen.
    pub mesh: TriMesh,
    /// To be touched; none if the surface is open or out of the blades' reach.
    pub field: Option<Arc<DistanceGrid>>,
}

/// Reads the surfaces; `came_with`: those of the patient's folder. An open one is left out of contact, and `notes` says so.
///
/// # Errors
/// One line for a file that cannot be read.
pub fn surroundings(
    given: &[Surface],
    came_with: Vec<(String, TriMesh)>,
    line: impl Iterator<Item = Vec3>,
    notes: &mut Vec<String>,
) -> Result<Vec<Surrounding>> {
    let line: Vec<Vec3> = line.collect();
    let near = Aabb::around(&line).grown(REACH);
    let mut make = |role: String, mesh: TriMesh, name: String| -> Result<Surrounding> {
        let field = match ClosedSurface::of_pieces(mesh.clone(), &name) {
            Ok(closed) => {
                notes.extend(closed.notes);
                field(closed.mesh, &near)?
            }
            Err(why) => {
                notes.push(format!("{why}; it is shown, but tools do not touch it"));
                None
            }
        };
        Ok(Surrounding { role, mesh, field })
    };
    let mut all = Vec::new();
    for (role, mesh) in came_with {
        let name = format!("the patient's {role}");
        all.push(make(role, mesh, name)?);
    }
    for s in given {
        let mesh = read_surface(&s.surface)?;
        all.push(make(s.role.clone(), mesh, s.surface.display().to_string())?);
    }
    Ok(all)
}

fn field(mesh: TriMesh, near: &Aabb) -> Result<Option<Arc<DistanceGrid>>> {
    let own = Aabb::around(&mesh.vertices).grown(2.0 * SPACING);
    let bounds = Aabb {
        min: own.min.sup(&near.min),
        max: own.max.inf(&near.max),
    };
    if bounds.extent().min() <= SPACING {
        return Ok(None);
    }
    let distance = MeshDistance::new(mesh);
    let grid = DistanceGrid::sample(bounds, [SPACING; 3], |p| distance.signed(p))?;
    Ok(Some(Arc::new(grid)))
}
