//! What is left between two fronts, or between a front and the body's face, and too narrow for either to see.
//!
//! A ligament of an element's width is smaller than the domain of any integral, and no front can move in it: only the balance of
//! the whole body can tell whether it tears.
use super::balance::{Balance, Trial};
use super::bone::Bone;
use super::propagation::PropagationSettings;
use crate::crack::BodyError;
use crate::geometry::{TetMesh, Vec3};

/// Largest area that tears as a whole, in squared element sizes: about that of the integrals' domain. Whatever is larger is a crack
/// front's business.
const LARGEST: f64 = 4.0;
/// A larger ligament tears bite by bite, of this radius in element sizes.
const BITE: f64 = 1.2;

/// Of the ligaments between the two ends, few edges in all, the one that releases most over what it costs: how many edges it has, and
/// what comes of tearing it as a whole.
pub(super) fn weakest(
    bone: &Bone,
    balance: &Balance,
    settings: &PropagationSettings,
) -> Result<Option<(usize, Trial)>, BodyError> {
    let mesh = &bone.body.mesh;
    let share = settings.ligament_share * mesh.edges().len() as f64;
    let limit = settings.ligament_edges.max(share as usize);
    let Some(edges) = bone.bridge(limit) else {
        return Ok(None);
    };
    let mut weakest: Option<(usize, Trial)> = None;
    // Away from the line the elements of a graded mesh are larger.
    let size = |edges: &[u32]| mesh.mean_length(edges).max(bone.body.lengths.h);
    let ligaments = connected(mesh, edges);
    let pieces = ligaments
        .iter()
        .flat_map(|l| bites(mesh, l, BITE * size(l)));
    let pieces = pieces.filter(|p| p.len() < edges.len());
    for torn in std::iter::once(edges.to_vec()).chain(pieces) {
        let mut growth = bone.advanced(&[]);
        growth.tear(mesh, &torn);
        let trial = balance.weigh(growth)?;
        if let Some(trial) = trial.filter(|t| t.area <= LARGEST * size(&torn).powi(2))
            && weakest.as_ref().is_none_or(|w| trial.ratio > w.1.ratio)
        {
            weakest = Some((torn.len(), trial));
        }
    }
    Ok(weakest)
}

/// Edges in groups that hang together through common tetrahedra.
fn connected(mesh: &TetMesh, edges: &[u32]) -> Vec<Vec<u32>> {
    let mut left: Vec<u32> = edges.to_vec();
    let mut groups = Vec::new();
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while let Some(&edge) = group.get(next) {
            next += 1;
            let tets: Vec<u32> = mesh.tets_of_edge(edge).collect();
            let beside = |e: &u32| mesh.tets_of_edge(*e).any(|t| tets.contains(&t));
            let (met, rest) = left.into_iter().partition(beside);
            left = rest;
            group.extend::<Vec<u32>>(met);
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

/// Pieces of a ligament that together cover it; a small one is one piece.
fn bites(mesh: &TetMesh, ligament: &[u32], radius: f64) -> Vec<Vec<u32>> {
    let middle = |e: u32| -> Vec3 {
        let [a, b] = mesh.edges()[e as usize].map(|n| mesh.nodes()[n as usize]);
        0.5 * (a + b)
    };
    let mut covered = vec![false; ligament.len()];
    let mut bites = Vec::new();
    while let Some(seed) = covered.iter().position(|c| !c) {
        let centre = middle(ligament[seed]);
        let mut bite = Vec::new();
        for (e, covered) in ligament.iter().zip(&mut covered) {
            if (middle(*e) - centre).norm() <= radius {
                *covered = true;
                bite.push(*e);
            }
        }
        bites.push(bite);
    }
    bites
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::block_mesh;

    /// All edges of a bar that cross a plane between two of its layers, but for those near its middle line.
    #[test]
    fn two_ligaments_are_told_apart_and_bitten_off() {
        let mesh = block_mesh(Vec3::zeros(), Vec3::new(4.0, 12.0, 4.0), [4, 12, 4]);
        let crosses = |e: &u32| {
            let [a, b] = mesh.edges()[*e as usize].map(|n| mesh.nodes()[n as usize]);
            let y = 0.5 * (a.y + b.y);
            (a.x - 1.4) * (b.x - 1.4) < 0.0 && (y - 6.0).abs() > 2.0
        };
        let edges: Vec<u32> = (0..mesh.edges().len() as u32).filter(crosses).collect();
        let ligaments = connected(&mesh, &edges);
        assert_eq!(ligaments.len(), 2);
        assert_eq!(ligaments.concat().len(), edges.len());
        for ligament in &ligaments {
            assert_eq!(bites(&mesh, ligament, 10.0), std::slice::from_ref(ligament));
            let bites = bites(&mesh, ligament, 1.2);
            let mut all = bites.concat();
            all.sort_unstable();
            all.dedup();
            assert_eq!((&all, bites.len() > 3), (ligament, true));
        }
    }
}
