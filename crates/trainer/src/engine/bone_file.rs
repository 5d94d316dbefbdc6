use crate::session::FinalBone;
use osteotome_mechanics::crack::level_set::level_sets;
use osteotome_mechanics::step::{Bone, BoneState};
use std::collections::HashMap;

/// One cell of the file for each cell of the topology; corners that move alike are shared.
pub fn final_bone(bone: &Bone, state: &BoneState) -> FinalBone {
    let mesh = &bone.body.mesh;
    let mut known: HashMap<(u32, [u64; 3]), u32> = HashMap::new();
    let mut node_of_point = Vec::new();
    let mut file = FinalBone {
        points: vec![],
        displacement: vec![],
        level_sets: Default::default(),
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
                    node_of_point.push(nodes[k]);
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
    file.level_sets = level_sets_at(bone, &node_of_point);
    file
}

/// phi1, phi2, phi3 at the given nodes; phi2 is -1 where the nearest sheet has no front left.
fn level_sets_at(bone: &Bone, nodes: &[u32]) -> [Vec<f64>; 3] {
    let body = &bone.body;
    let bounds = body.mesh.bounds();
    let everywhere = (bounds.max - bounds.min).norm();
    let fronts = bone.fronts();
    let sets = level_sets(&body.mesh, &body.locator, &bone.crack, &fronts, everywhere);
    let at = |n: &u32| {
        let known = sets.binary_search_by_key(n, |l| l.node);
        known.map_or([-1.0; 3], |k| {
            let l = &sets[k];
            let front = if l.front.is_finite() { l.front } else { -1.0 };
            [l.surface, front, l.offset]
        })
    };
    let values: Vec<[f64; 3]> = nodes.iter().map(at).collect();
    [0, 1, 2].map(|k| values.iter().map(|v| v[k]).collect())
}
