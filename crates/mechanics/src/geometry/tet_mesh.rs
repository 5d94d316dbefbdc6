use super::{Aabb, SpatialHash, Vec3};
use rustc_hash::FxHashMap;

/// Local node pairs of a tetrahedron's six edges.
pub const TET_EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Local nodes of the face opposite each local node, counter-clockwise seen from outside a positive tetrahedron.
pub const TET_FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
/// "No tetrahedron" in [`TetMesh::neighbours`].
pub const NO_TET: u32 = u32::MAX;

/// Why a tetrahedral mesh was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum MeshError {
    /// No tetrahedra at all.
    #[error("the mesh holds no tetrahedra")]
    Empty,
    /// A coordinate is not a finite number.
    #[error("node {0} has a coordinate that is not a finite number")]
    NotFinite(usize),
    /// A tetrahedron names a node that is not there.
    #[error("tetrahedron {tet} names node {node}, but there are only {n_nodes} nodes")]
    NoSuchNode {
        /// Which tetrahedron.
        tet: usize,
        /// The node it names.
        node: u32,
        /// How many there are.
        n_nodes: usize,
    },
    /// A tetrahedron is inverted or flat.
    #[error(
        "tetrahedron {tet} has volume {volume:e} mm3; each must be positive (reorder its nodes or mend the mesh)"
    )]
    NotPositive {
        /// Which tetrahedron.
        tet: usize,
        /// Its signed volume.
        volume: f64,
    },
    /// More than two tetrahedra share a face.
    #[error("more than two tetrahedra share the face of nodes {0:?}")]
    FaceShared([u32; 3]),
    /// A node belongs to no tetrahedron.
    #[error("node {0} belongs to no tetrahedron")]
    LooseNode(usize),
}

/// A linear tetrahedral mesh with its connectivity; immutable once made.
#[derive(Clone, Debug)]
pub struct TetMesh {
    nodes: Vec<Vec3>,
    tets: Vec<[u32; 4]>,
    volumes: Vec<f64>,
    gradients: Vec<[Vec3; 4]>,
    edges: Vec<[u32; 2]>,
    tet_edges: Vec<[u32; 6]>,
    neighbours: Vec<[u32; 4]>,
    node_tets_first: Vec<u32>,
    node_tets: Vec<u32>,
    boundary_faces: Vec<[u32; 3]>,
}

impl TetMesh {
    /// Checks the mesh and builds its connectivity.
    ///
    /// # Errors
    /// [`MeshError`] for an empty mesh, a node that is missing, loose or not finite, a tetrahedron that is not positive.
    pub fn new(nodes: Vec<Vec3>, tets: Vec<[u32; 4]>) -> Result<Self, MeshError> {
        if tets.is_empty() {
            return Err(MeshError::Empty);
        }
        if let Some(i) = nodes.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(MeshError::NotFinite(i));
        }
        let n_nodes = nodes.len();
        let mut volumes = Vec::with_capacity(tets.len());
        let mut gradients = Vec::with_capacity(tets.len());
        for (tet, t) in tets.iter().enumerate() {
            if let Some(&node) = t.iter().find(|&&n| n as usize >= n_nodes) {
                return Err(MeshError::NoSuchNode { tet, node, n_nodes });
            }
            let (volume, gradient) = shape(&t.map(|n| nodes[n as usize]));
            if volume.is_nan() || volume <= 0.0 {
                return Err(MeshError::NotPositive { tet, volume });
            }
            volumes.push(volume);
            gradients.push(gradient);
        }
        let (node_tets_first, node_tets) = incidence(n_nodes, &tets);
        if let Some(i) = (0..n_nodes).find(|&i| node_tets_first[i] == node_tets_first[i + 1]) {
            return Err(MeshError::LooseNode(i));
        }
        let (edges, tet_edges) = number_edges(&tets);
        let (neighbours, boundary_faces) = number_faces(&tets)?;
        Ok(Self {
            nodes,
            tets,
            volumes,
            gradients,
            edges,
            tet_edges,
            neighbours,
            node_tets_first,
            node_tets,
            boundary_faces,
        })
    }

    /// Tetrahedra that hold edge `e`.
    pub fn tets_of_edge(&self, e: u32) -> impl Iterator<Item = u32> + '_ {
        let [a, b] = self.edges[e as usize];
        let around = self.tets_of_node(a as usize).iter().copied();
        around.filter(move |&t| self.tets[t as usize].contains(&b))
    }

    /// Node positions \[mm\].
    pub fn nodes(&self) -> &[Vec3] {
        &self.nodes
    }
    /// Node indices of each tetrahedron, positively oriented.
    pub fn tets(&self) -> &[[u32; 4]] {
        &self.tets
    }
    /// Volume of each tetrahedron \[mm3\].
    pub fn volumes(&self) -> &[f64] {
        &self.volumes
    }
    /// Gradients of the four shape functions in each tetrahedron \[1/mm\].
    pub fn gradients(&self) -> &[[Vec3; 4]] {
        &self.gradients
    }
    /// Node pairs of each edge, the smaller index first; sorted.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }
    /// Edge indices of each tetrahedron, in the order of [`TET_EDGES`].
    pub fn tet_edges(&self) -> &[[u32; 6]] {
        &self.tet_edges
    }
    /// The tetrahedron across the face opposite each local node, or [`NO_TET`].
    pub fn neighbours(&self) -> &[[u32; 4]] {
        &self.neighbours
    }
    /// Boundary triangles, counter-clockwise seen from outside.
    pub fn boundary_faces(&self) -> &[[u32; 3]] {
        &self.boundary_faces
    }
    /// The tetrahedra that hold node `i`.
    pub fn tets_of_node(&self, i: usize) -> &[u32] {
        &self.node_tets[self.node_tets_first[i] as usize..self.node_tets_first[i + 1] as usize]
    }
    /// Corner positions of tetrahedron `t`.
    pub fn corners(&self, t: usize) -> [Vec3; 4] {
        self.tets[t].map(|n| self.nodes[n as usize])
    }
    /// Total volume \[mm3\].
    pub fn volume(&self) -> f64 {
        self.volumes.iter().sum()
    }
    /// Box around all nodes.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(&self.nodes)
    }
    /// Mean edge length: the element size h of the numerics \[mm\].
    pub fn mean_edge_length(&self) -> f64 {
        let sum: f64 = self.edges.iter().map(|e| self.edge_vector(e).norm()).sum();
        sum / self.edges.len() as f64
    }
    /// Mean length of some edges \[mm\], given by their numbers; zero of none.
    pub fn mean_length(&self, edges: &[u32]) -> f64 {
        let lengths = edges
            .iter()
            .map(|&e| self.edge_vector(&self.edges[e as usize]).norm());
        lengths.sum::<f64>() / edges.len().max(1) as f64
    }

    /// Vector from the first to the second node of an edge.
    pub fn edge_vector(&self, e: &[u32; 2]) -> Vec3 {
        self.nodes[e[1] as usize] - self.nodes[e[0] as usize]
    }

    /// Barycentric coordinates of `p` in tetrahedron `t`: the shape functions there, also outside.
    pub fn barycentric(&self, t: usize, p: &Vec3) -> [f64; 4] {
        let x0 = self.nodes[self.tets[t][0] as usize];
        let g = &self.gradients[t];
        let d = p - x0;
        let [b, c, e] = [g[1].dot(&d), g[2].dot(&d), g[3].dot(&d)];
        [1.0 - b - c - e, b, c, e]
    }
}

/// Volume and shape function gradients.
fn shape(x: &[Vec3; 4]) -> (f64, [Vec3; 4]) {
    let [a, b, c] = [x[1] - x[0], x[2] - x[0], x[3] - x[0]];
    let six_v = a.dot(&b.cross(&c));
    let g = [
        b.cross(&c) / six_v,
        c.cross(&a) / six_v,
        a.cross(&b) / six_v,
    ];
    (six_v / 6.0, [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]])
}

fn incidence(n_nodes: usize, tets: &[[u32; 4]]) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; n_nodes + 1];
    for n in tets.iter().flatten() {
        first[*n as usize + 1] += 1;
    }
    for i in 0..n_nodes {
        first[i + 1] += first[i];
    }
    let mut next = first.clone();
    let mut list = vec![0u32; 4 * tets.len()];
    for (t, tet) in tets.iter().enumerate() {
        for n in tet {
            list[next[*n as usize] as usize] = t as u32;
            next[*n as usize] += 1;
        }
    }
    (first, list)
}

fn number_edges(tets: &[[u32; 4]]) -> (Vec<[u32; 2]>, Vec<[u32; 6]>) {
    let key = |t: &[u32; 4], [a, b]: [usize; 2]| [t[a].min(t[b]), t[a].max(t[b])];
    let mut edges: Vec<_> = tets
        .iter()
        .flat_map(|t| TET_EDGES.map(|e| key(t, e)))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    let index: FxHashMap<_, _> = edges.iter().zip(0u32..).map(|(e, i)| (*e, i)).collect();
    let tet_edges = tets
        .iter()
        .map(|t| TET_EDGES.map(|e| index[&key(t, e)]))
        .collect();
    (edges, tet_edges)
}

type Faces = (Vec<[u32; 4]>, Vec<[u32; 3]>);

fn number_faces(tets: &[[u32; 4]]) -> Result<Faces, MeshError> {
    let mut open: FxHashMap<[u32; 3], (u32, u8)> = FxHashMap::default();
    let mut neighbours = vec![[NO_TET; 4]; tets.len()];
    for (t, tet) in tets.iter().enumerate() {
        for (k, face) in TET_FACES.iter().enumerate() {
            let mut key = face.map(|n| tet[n]);
            key.sort_unstable();
            match open.insert(key, (t as u32, k as u8)) {
                None => {}
                Some((other, _)) if other == NO_TET => return Err(MeshError::FaceShared(key)),
                Some((other, local)) => {
                    neighbours[t][k] = other;
                    neighbours[other as usize][local as usize] = t as u32;
                    open.insert(key, (NO_TET, 0));
                }
            }
        }
    }
    let mut boundary = Vec::new();
    for (t, tet) in tets.iter().enumerate() {
        for k in 0..4 {
            if neighbours[t][k] == NO_TET {
                boundary.push(TET_FACES[k].map(|n| tet[n]));
            }
        }
    }
    Ok((neighbours, boundary))
}

/// Finds the tetrahedron that holds a point, through a spatial hash.
#[derive(Clone, Debug)]
pub struct TetLocator {
    hash: SpatialHash,
    reach: f64,
}

impl TetLocator {
    /// Indexes a mesh.
    pub fn new(mesh: &TetMesh) -> Self {
        let boxes: Vec<_> = (0..mesh.tets().len())
            .map(|t| (t as u32, Aabb::around(&mesh.corners(t))))
            .collect();
        let reach = mesh.mean_edge_length();
        Self {
            hash: SpatialHash::build(reach, &boxes),
            reach,
        }
    }

    /// The tetrahedron that holds `p`, with the shape functions there; `None` outside the body.
    pub fn find(&self, mesh: &TetMesh, p: &Vec3) -> Option<(u32, [f64; 4])> {
        self.best(mesh, p, 0.0).filter(|(_, n)| least(n) > -1e-9)
    }

    /// Like [`find`](Self::find), but a point outside by at most about `margin` \[mm\] gets the tetrahedron it sticks out of least.
    pub fn find_near(&self, mesh: &TetMesh, p: &Vec3, margin: f64) -> Option<(u32, [f64; 4])> {
        if let Some(found) = self.find(mesh, p) {
            return Some(found);
        }
        self.best(mesh, p, margin)
            .filter(|(_, n)| least(n) * self.reach > -2.0 * margin)
    }

    /// Calls `visit` with each tetrahedron whose box may meet `query`; one may come more than once.
    pub fn tets_near(&self, query: &Aabb, visit: impl FnMut(u32)) {
        self.hash.query(query, visit);
    }

    fn best(&self, mesh: &TetMesh, p: &Vec3, margin: f64) -> Option<(u32, [f64; 4])> {
        let mut best: Option<(u32, [f64; 4])> = None;
        self.hash
            .query(&Aabb { min: *p, max: *p }.grown(margin), |t| {
                let n = mesh.barycentric(t as usize, p);
                // Ties (a point on a shared face) go to the lowest index, whatever order the table has.
                let better = best.as_ref().is_none_or(|(bt, bn)| {
                    let (new, old) = (least(&n), least(bn));
                    new > old || (new == old && t < *bt)
                });
                if better {
                    best = Some((t, n));
                }
            });
        best
    }
}

fn least(n: &[f64; 4]) -> f64 {
    n.iter().copied().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit() -> (Vec<Vec3>, Vec<[u32; 4]>) {
        let nodes = vec![
            Vec3::zeros(),
            Vec3::x(),
            Vec3::y(),
            Vec3::z(),
            Vec3::new(1.0, 1.0, 1.0),
        ];
        (nodes, vec![[0, 1, 2, 3], [1, 2, 3, 4]])
    }

    #[test]
    fn connectivity_of_two_tets() {
        let (nodes, tets) = unit();
        let mesh = TetMesh::new(nodes, tets).unwrap();
        assert_eq!(mesh.edges().len(), 9);
        assert_eq!(mesh.boundary_faces().len(), 6);
        assert_eq!(mesh.neighbours()[0][0], 1);
        assert_eq!(mesh.neighbours()[1][3], 0);
        assert!((mesh.volume() - 0.5).abs() < 1e-15);
        let locator = TetLocator::new(&mesh);
        assert_eq!(locator.find(&mesh, &Vec3::new(0.1, 0.1, 0.1)).unwrap().0, 0);
        assert_eq!(locator.find(&mesh, &Vec3::new(0.8, 0.8, 0.8)).unwrap().0, 1);
        assert!(locator.find(&mesh, &Vec3::new(0.9, 0.05, 0.5)).is_none());
    }

    #[test]
    fn boundary_faces_look_outward() {
        let (nodes, tets) = unit();
        let mesh = TetMesh::new(nodes, tets).unwrap();
        let flux: f64 = mesh
            .boundary_faces()
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|n| mesh.nodes()[n as usize]);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum();
        assert!((flux - mesh.volume()).abs() < 1e-15);
    }

    #[test]
    fn bad_meshes_are_named() {
        let (nodes, tets) = unit();
        assert_eq!(
            TetMesh::new(nodes.clone(), vec![]).unwrap_err(),
            MeshError::Empty
        );
        let flipped = TetMesh::new(nodes.clone(), vec![tets[0], [2, 1, 3, 4]]).unwrap_err();
        assert!(matches!(flipped, MeshError::NotPositive { tet: 1, .. }));
        assert!(matches!(
            TetMesh::new(nodes, vec![[0, 1, 2, 9]]).unwrap_err(),
            MeshError::NoSuchNode { node: 9, .. }
        ));
    }
}
