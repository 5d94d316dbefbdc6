//! The bone's tetrahedra.
use crate::error::AnatomyError;
use crate::fit::fit;
use crate::landmarks::JawFrame;
use crate::mesher::{self, Body};
use osteotome_mechanics::geometry::{MeshDistance, MeshError, TetMesh, Vec3};

/// Tetrahedra of the bone, pulled onto its surface, nodes in the order of first use.
pub(super) fn make_mesh(
    surface: &MeshDistance,
    frame: &JawFrame,
    target: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<TetMesh, AnatomyError> {
    let body = Body::mandible(surface, frame);
    let meshed = mesher::mesh_to_nodes(&body, target, &mut |f| progress(0.8 * f))?;
    let fitted = fit(&meshed.mesh, surface)?;
    progress(1.0);
    let made = in_order_of_use(fitted.nodes(), fitted.tets());
    made.map_err(|source| AnatomyError::Mesh {
        name: "the mesher's own mesh".to_owned(),
        source,
    })
}

/// The mesh with nodes numbered in the order in which tetrahedra name them: as a reader numbers them.
pub(super) fn in_order_of_use(nodes: &[Vec3], tets: &[[u32; 4]]) -> Result<TetMesh, MeshError> {
    let mut number = vec![u32::MAX; nodes.len()];
    let mut ordered = Vec::with_capacity(nodes.len());
    let mut place = |n: u32| {
        let slot = &mut number[n as usize];
        if *slot == u32::MAX {
            *slot = ordered.len() as u32;
            ordered.push(nodes[n as usize]);
        }
        *slot
    };
    let tets = tets.iter().map(|t| t.map(&mut place)).collect();
    TetMesh::new(ordered, tets)
}
