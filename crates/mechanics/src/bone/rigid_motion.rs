use super::Supports;
use crate::geometry::{TetMesh, Vec3};
use nalgebra::{Matrix6, SymmetricEigen, Vector6};

/// A rigid motion that no support resists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FreeMotion {
    /// Along this unit vector.
    Along(Vec3),
    /// Round an axis along this unit vector.
    Round(Vec3),
}

impl std::fmt::Display for FreeMotion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (word, v) = match self {
            Self::Along(v) => ("moving along", v),
            Self::Round(v) => ("turning round", v),
        };
        // Adding zero turns -0.00 into 0.00.
        let [x, y, z] = [v.x, v.y, v.z].map(|c| (c * 100.0).round() / 100.0 + 0.0);
        write!(f, "{word} ({x}, {y}, {z})")
    }
}

/// Whether supports and springs hold the given nodes as one rigid piece; if not, a motion that they allow.
///
/// Each held coordinate is a row of constraints on the six rigid motions about the piece's centre, lengths relative to its
/// size; free are the motions whose sum of squared constraints is below 1e-9. Hinges between parts of the piece are not seen.
pub fn free_motion(mesh: &TetMesh, supports: &Supports, nodes: &[u32]) -> Option<FreeMotion> {
    let at = |i: u32| mesh.nodes()[i as usize];
    let centre = nodes.iter().map(|&i| at(i)).sum::<Vec3>() / nodes.len().max(1) as f64;
    let size = nodes
        .iter()
        .map(|&i| (at(i) - centre).norm())
        .fold(1e-300, f64::max);
    let mut sum = Matrix6::zeros();
    let mut hold = |i: u32, axis: usize| {
        let arm = (at(i) - centre) / size;
        let turn = arm.cross(&Vec3::ith(axis, 1.0));
        let mut row = Vector6::zeros();
        row[axis] = 1.0;
        (0..3).for_each(|k| row[3 + k] = turn[k]);
        sum += row * row.transpose();
    };
    if supports.ground_spring > 0.0 {
        return None;
    }
    let sprung: Vec<u32> = supports.springs.iter().map(|s| s.0).collect();
    for &i in nodes {
        if supports.is_fixed(i) || sprung.contains(&i) {
            (0..3).for_each(|k| hold(i, k));
            continue;
        }
        let axes = supports.prescribed_at(i);
        (0..3)
            .filter(|&k| axes[k].is_some())
            .for_each(|k| hold(i, k));
    }
    /// Far above round-off, far below the constraint of one node one thousandth of the size off an axis.
    const FREE: f64 = 1e-9;
    let eigen = SymmetricEigen::new(sum);
    let (k, least) = (0..6)
        .map(|k| (k, eigen.eigenvalues[k]))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    if least > FREE {
        return None;
    }
    let mode = eigen.eigenvectors.column(k);
    let part = |from: usize| Vec3::new(mode[from], mode[from + 1], mode[from + 2]);
    // Either sense is as good: the largest component is positive.
    let unit = |v: Vec3| {
        let v = v.normalize();
        if v[v.iamax()] < 0.0 { -v } else { v }
    };
    let (along, round) = (part(0), part(3));
    Some(if round.norm() < 1e-3 {
        FreeMotion::Along(unit(along))
    } else {
        FreeMotion::Round(unit(round))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::Prescribed;
    use crate::geometry::block_mesh;

    #[test]
    fn what_is_free_is_named() {
        let mesh = block_mesh(Vec3::zeros(), Vec3::new(4.0, 2.0, 2.0), [4, 2, 2]);
        let nodes: Vec<u32> = (0..mesh.nodes().len() as u32).collect();
        let held = |axes: &[u8]| Supports {
            prescribed: (0u32..)
                .zip(mesh.nodes())
                .filter(|(_, p)| p.x == 0.0)
                .flat_map(|(node, _)| {
                    axes.iter().map(move |&axis| Prescribed {
                        node,
                        axis,
                        value: 0.0,
                    })
                })
                .collect(),
            ..Default::default()
        };
        assert_eq!(free_motion(&mesh, &held(&[0, 1, 2]), &nodes), None);
        assert_eq!(
            free_motion(&mesh, &held(&[0, 1]), &nodes)
                .unwrap()
                .to_string(),
            "moving along (0, 0, 1)".to_owned()
        );
        let one = Supports {
            fixed: vec![0],
            ..Default::default()
        };
        assert!(matches!(
            free_motion(&mesh, &one, &nodes),
            Some(FreeMotion::Round(_))
        ));
        assert!(free_motion(&mesh, &Supports::default(), &nodes).is_some());
        let grounded = Supports {
            ground_spring: 1.0,
            ..Default::default()
        };
        assert_eq!(free_motion(&mesh, &grounded, &nodes), None);
    }
}
