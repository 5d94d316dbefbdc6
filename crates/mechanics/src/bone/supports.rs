use crate::geometry::{TetMesh, Vec3};

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
        centres: &[Vec3],
        radius: f64,
        alpha: f64,
        young_modulus: f64,
    ) -> Self {
        let mut fixed: Vec<u32> = centres
            .iter()
            .flat_map(|c| nearest(mesh, c, radius))
            .collect();
        fixed.sort_unstable();
        fixed.dedup();
        Self {
            fixed,
            ground_spring: alpha * young_modulus * mesh.mean_edge_length(),
            springs: Vec::new(),
        }
    }

    /// Steadies the body by springs of `stiffness` \[N/mm\] in all, spread over the nodes within `radius` of `centre`, or
    /// over the three nearest.
    pub fn steady(&mut self, mesh: &TetMesh, centre: &Vec3, radius: f64, stiffness: f64) {
        let near = nearest(mesh, centre, radius);
        let each = stiffness / near.len().max(1) as f64;
        self.springs.extend(near.into_iter().map(|i| (i, each)));
    }
}

/// The nodes within `radius` of `centre`, at least the three nearest.
fn nearest(mesh: &TetMesh, centre: &Vec3, radius: f64) -> Vec<u32> {
    let distance = |i: &u32| (mesh.nodes()[*i as usize] - centre).norm();
    let mut nodes: Vec<u32> = (0..mesh.nodes().len() as u32).collect();
    nodes.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    let within = nodes.partition_point(|i| distance(i) <= radius);
    nodes.truncate(within.max(3));
    nodes
}
