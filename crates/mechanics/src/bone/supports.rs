use crate::geometry::TetMesh;

/// How the body is held.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Supports {
    /// Nodes that do not move, ascending. Their enrichments are held with them.
    pub fixed: Vec<u32>,
    /// Ground spring on every node \[N/mm\]: the soft tissue, and what keeps a loose fragment's equations regular.
    pub ground_spring: f64,
    /// Further springs to the ground: node and stiffness \[N/mm\] (a hand that steadies the body).
    pub springs: Vec<(u32, f64)>,
}

impl Supports {
    /// Holds the nodes within `radius` of any of `centres` (at least the three nearest of each, so that no hinge is left), with
    /// ground springs of
    /// `alpha` E h, where h is the mean edge length.
    ///
    /// `alpha` 1e-7 to 1e-6 changes the energy of a held body by 1e-6 to 1e-5.
    pub fn near(
        mesh: &TetMesh,
        centres: &[crate::geometry::Vec3],
        radius: f64,
        alpha: f64,
        young_modulus: f64,
    ) -> Self {
        let mut fixed = Vec::new();
        for c in centres {
            let distance = |i: &u32| (mesh.nodes()[*i as usize] - c).norm();
            let mut nearest: Vec<u32> = (0..mesh.nodes().len() as u32).collect();
            nearest.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            let within = nearest.partition_point(|i| distance(i) <= radius);
            fixed.extend(&nearest[..within.max(3).min(nearest.len())]);
        }
        fixed.sort_unstable();
        fixed.dedup();
        Self {
            fixed,
            ground_spring: alpha * young_modulus * mesh.mean_edge_length(),
            springs: Vec::new(),
        }
    }

    /// Steadies the body by springs of `stiffness` \[N/mm\] in all, spread over the nodes within `radius` of `centre`.
    pub fn steady(
        &mut self,
        mesh: &TetMesh,
        centre: &crate::geometry::Vec3,
        radius: f64,
        stiffness: f64,
    ) {
        let is_near = |i: &u32| (mesh.nodes()[*i as usize] - centre).norm() <= radius;
        let near: Vec<u32> = (0..mesh.nodes().len() as u32).filter(is_near).collect();
        let each = stiffness / near.len().max(1) as f64;
        self.springs.extend(near.into_iter().map(|i| (i, each)));
    }
}
