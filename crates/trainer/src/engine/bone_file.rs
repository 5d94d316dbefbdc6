use crate::session::FinalBone;
use osteotome_mechanics::step::{Bone, BoneState};
use std::collections::HashMap;

/// One cell of the file for each cell of the topology; corners that move alike are shared.
pub fn final_bone(bone: &Bone, state: &BoneState) -> FinalBone {
    let mesh = &bone.body.mesh;
    let mut known: HashMap<(u32, [u64; 3]), u32> = HashMap::new();
    let mut file = FinalBone {
        points: vec![],
        displacement: vec![],
        cells: vec![],
        fragment: vec![],
        volume_fraction: vec![],
    };
    for cell in bone.topology.cells() {
        let nodes = mesh.tets()[cell.tet as usize];
        let u = bone.system.cell_displacements(mesh, cell, &state.x);
        let corner = |k: usize| {
            let displacement: [f64; 3] = u[k].into();
            let next = file.points.len() as u32;
            *known
                .entry((nodes[k], displacement.map(f64::to_bits)))
                .or_insert_with(|| {
                    file.points.push(mesh.nodes()[nodes[k] as usize].into());
                    file.displacement.push(displacement);
                    next
                })
        };
        let corners = [0, 1, 2, 3].map(corner);
        file.cells.push(corners);
        let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap_or(0);
        file.fragment
            .push(bone.fragments.of_node[nodes[own] as usize]);
        file.volume_fraction.push(cell.fraction);
    }
    file
}
