use crate::geometry::{TetMesh, Vec3};

/// One coordinate of one node that moves by a given amount.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prescribed {
    /// The node.
    pub node: u32,
    /// 0, 1, 2 for x, y, z.
    pub axis: u8,
    /// Its displacement along that axis \[mm\].
    pub value: f64,
}

/// How the body is held.
///
/// A support on a face that the crack crosses holds the enrichment there too: both sides move as the support does.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Supports {
    /// Nodes that do not move, ascending. Their enrichments are held with them.
    pub fixed: Vec<u32>,
    /// Prescribed displacements, ascending by node, then axis; those of a fixed node are ignored.
    pub prescribed: Vec<Prescribed>,
    /// Ground spring on every node \[N/mm\]: the soft tissue, and what keeps a loose fragment's equations regular.
    pub ground_spring: f64,
    /// Further springs to the ground: node and stiffness \[N/mm\] (a hand that steadies the body).
    pub springs: Vec<(u32, f64)>,
    /// Spring on every node \[N/mm\] towards where it was at the end of the last step: the drag of soft tissue over the length
    /// of a step. It slows what would leap, a fragment just broken off above all, and is gone where nothing moves.
    pub drag: f64,
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
            ..Default::default()
        }
    }

    /// Whether node `i` is fixed.
    pub fn is_fixed(&self, i: u32) -> bool {
        self.fixed.binary_search(&i).is_ok()
    }

    /// The prescribed displacements of node `i`, a value or none for each axis.
    pub fn prescribed_at(&self, i: u32) -> [Option<f64>; 3] {
        let first = self.prescribed.partition_point(|p| p.node < i);
        let mut values = [None; 3];
        for p in self.prescribed[first..].iter().take_while(|p| p.node == i) {
            values[usize::from(p.axis)] = Some(p.value);
        }
        values
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
