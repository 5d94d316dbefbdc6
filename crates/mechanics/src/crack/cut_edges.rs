use super::fragments::UnionFind;
use crate::geometry::{
    Aabb, TetLocator, TetMesh, TriMesh, Vec3, closest_on_triangle, segment_crosses,
};
use rustc_hash::FxHashSet;

/// The state of the crack as mechanics knows it: which mesh edges it has crossed, and where.
///
/// It only ever grows, so that sides can never flip.
#[derive(Clone, Debug)]
pub struct CutEdges {
    /// Share of the edge, from its lower node, at which it is crossed; NaN where it is not.
    crossing: Vec<f64>,
    /// Node positions for the crossing test: off the mesh only where the crack ran through a node.
    seat: Vec<Vec3>,
    seated: Vec<bool>,
    /// [`SNAP`] times the mean edge length around each node.
    snap: Vec<f64>,
    n_cut: usize,
}

/// Nodes closer to the crack than this, relative to h, are taken to lie that far on their own side of it.
///
/// A crack through a node would leave slivers of volume, which sew it shut: with drop tolerances of 1e-4 a double cantilever
/// beam keeps only .55 to .91 of its compliance.
const SNAP: f64 = 0.05;

impl CutEdges {
    /// Nothing is cut yet.
    pub fn new(mesh: &TetMesh) -> Self {
        Self {
            crossing: vec![f64::NAN; mesh.edges().len()],
            seat: mesh.nodes().to_vec(),
            seated: vec![false; mesh.nodes().len()],
            snap: snaps(mesh),
            n_cut: 0,
        }
    }

    /// Whether edge `e` is cut.
    pub fn is_cut(&self, e: u32) -> bool {
        !self.crossing[e as usize].is_nan()
    }

    /// Where edge `e` is crossed, as a share of its length from its lower node; NaN if it is not.
    pub fn crossing(&self, e: u32) -> f64 {
        self.crossing[e as usize]
    }

    /// Nodes that were moved off the crack for the crossing test, and where to.
    pub fn seats(&self) -> impl Iterator<Item = (u32, Vec3)> + '_ {
        let seats = (0u32..).zip(&self.seat).zip(&self.seated);
        seats
            .filter(|(_, seated)| **seated)
            .map(|((n, p), _)| (n, *p))
    }

    /// Repeats recorded cuts (edge, share of it) and seats as they were; returns the edges newly cut, ascending.
    ///
    /// # Panics
    /// For an edge or a node that the mesh does not have.
    pub fn restore(&mut self, cuts: &[(u32, f64)], seats: &[(u32, Vec3)]) -> Vec<u32> {
        for (n, p) in seats {
            self.seat[*n as usize] = *p;
            self.seated[*n as usize] = true;
        }
        let mut fresh: Vec<u32> = Vec::with_capacity(cuts.len());
        for &(e, share) in cuts {
            if !self.is_cut(e) {
                fresh.push(e);
            }
            self.crossing[e as usize] = share;
        }
        fresh.sort_unstable();
        fresh.dedup();
        self.n_cut += fresh.len();
        fresh
    }

    /// How many edges are cut.
    pub fn len(&self) -> usize {
        self.n_cut
    }

    /// Whether no edge is cut.
    pub fn is_empty(&self) -> bool {
        self.n_cut == 0
    }

    /// Position of the crossing on edge `e`.
    pub fn crossing_point(&self, mesh: &TetMesh, e: u32) -> Vec3 {
        let [a, b] = mesh.edges()[e as usize].map(|n| mesh.nodes()[n as usize]);
        a + (b - a) * self.crossing[e as usize]
    }

    /// Cuts every edge that a triangle of `sheet` crosses; returns those newly cut, ascending.
    ///
    /// Cuts that would only crumble a chip smaller than `chip_nodes` nodes off the body are not made.
    pub fn cut(
        &mut self,
        mesh: &TetMesh,
        locator: &TetLocator,
        sheet: &TriMesh,
        chip_nodes: usize,
    ) -> Vec<u32> {
        self.seat_nodes(mesh, locator, sheet);
        let fresh = self.crossings(mesh, locator, sheet);
        self.commit(mesh, fresh, chip_nodes)
    }

    /// Cuts what lies ahead of a front, after [`seat_nodes`](Self::seat_nodes) for the same sheet: of the tetrahedra that `sheet`
    /// would divide, those for whose polygon's centre `is_reached` holds are cut as a whole; returns the edges newly cut, ascending.
    ///
    /// Cutting by the centre of the polygon instead of edge by edge keeps the effective front level however large the polygons
    /// are that a plane happens to cut out of its mesh.
    pub fn cut_ahead(
        &mut self,
        mesh: &TetMesh,
        locator: &TetLocator,
        sheet: &TriMesh,
        is_reached: impl Fn(&Vec3) -> bool,
        chip_nodes: usize,
    ) -> Vec<u32> {
        let candidates = self.crossings(mesh, locator, sheet);
        let crossing = |e: u32| {
            let found = candidates.binary_search_by_key(&e, |c| c.0);
            found.map_or(self.crossing[e as usize], |k| candidates[k].1)
        };
        let mut tets: Vec<u32> = candidates
            .iter()
            .flat_map(|&(e, _)| {
                let [a, b] = mesh.edges()[e as usize];
                let holds = move |t: &&u32| mesh.tets()[**t as usize].contains(&b);
                mesh.tets_of_node(a as usize).iter().filter(holds)
            })
            .copied()
            .collect();
        tets.sort_unstable();
        tets.dedup();
        let mut taken = Vec::new();
        for t in tets {
            let edges = mesh.tet_edges()[t as usize];
            let crossed: Vec<u32> = edges
                .into_iter()
                .filter(|e| !crossing(*e).is_nan())
                .collect();
            // Fewer than three crossed edges never part a tetrahedron.
            if crossed.len() < 3 {
                continue;
            }
            let at = |e: &u32| {
                let [a, b] = mesh.edges()[*e as usize].map(|n| mesh.nodes()[n as usize]);
                a + (b - a) * crossing(*e)
            };
            let centre = crossed.iter().map(at).sum::<Vec3>() / crossed.len() as f64;
            if is_reached(&centre) {
                taken.extend(crossed);
            }
        }
        taken.sort_unstable();
        let fresh = candidates
            .iter()
            .filter(|c| taken.binary_search(&c.0).is_ok())
            .copied()
            .collect();
        self.commit(mesh, fresh, chip_nodes)
    }

    /// Uncut edges that a triangle of `sheet` crosses, and where; ascending.
    fn crossings(&self, mesh: &TetMesh, locator: &TetLocator, sheet: &TriMesh) -> Vec<(u32, f64)> {
        let largest = self.snap.iter().copied().fold(0.0, f64::max);
        let mut fresh: Vec<(u32, f64)> = Vec::new();
        for t in 0..sheet.triangles.len() {
            let triangle = sheet.corners(t);
            let normal = sheet.area_normal(t);
            let side = |p: &Vec3| normal.dot(&(p - triangle[0]));
            let query = Aabb::around(&triangle).grown(2.0 * largest);
            locator.tets_near(&query, |tet| {
                let nodes = &mesh.tets()[tet as usize];
                if are_beside(nodes.map(|n| side(&self.seat[n as usize]))) {
                    return;
                }
                for &e in &mesh.tet_edges()[tet as usize] {
                    if !self.is_cut(e) {
                        let [a, b] = mesh.edges()[e as usize].map(|n| &self.seat[n as usize]);
                        fresh.extend(
                            segment_crosses(a, b, &triangle)
                                .map(|s| (e, s.clamp(SNAP, 1.0 - SNAP))),
                        );
                    }
                }
            });
        }
        fresh.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        fresh.dedup_by_key(|f| f.0);
        fresh
    }

    /// Cuts the given edges at their middle; returns those newly cut.
    pub fn cut_at_middle(&mut self, mesh: &TetMesh, edges: &[u32], chip_nodes: usize) -> Vec<u32> {
        let mut fresh: Vec<_> = edges
            .iter()
            .filter(|&&e| !self.is_cut(e))
            .map(|&e| (e, 0.5))
            .collect();
        fresh.sort_by_key(|f| f.0);
        fresh.dedup_by_key(|f| f.0);
        self.commit(mesh, fresh, chip_nodes)
    }

    /// Moves nodes that lie almost on `sheet` off it, each to its own side, for all later tests of what crosses what.
    ///
    /// Sheets that adjoin are seated together before either cuts: a node that moves between two cuts would leave an edge uncut
    /// that passes their seam.
    pub fn seat_nodes(&mut self, mesh: &TetMesh, locator: &TetLocator, sheet: &TriMesh) {
        let largest = self.snap.iter().copied().fold(0.0, f64::max);
        let mut nearest: Vec<(u32, f64, Vec3)> = Vec::new();
        for t in 0..sheet.triangles.len() {
            let triangle = sheet.corners(t);
            let Some(normal) = sheet.area_normal(t).try_normalize(1e-12) else {
                continue;
            };
            let around = Aabb::around(&triangle).grown(largest);
            locator.tets_near(&around, |tet| {
                for &n in &mesh.tets()[tet as usize] {
                    let (p, snap) = (&mesh.nodes()[n as usize], self.snap[n as usize]);
                    if self.seated[n as usize] || !around.contains(p) {
                        continue;
                    }
                    let w = closest_on_triangle(p, &triangle);
                    let offset = p - (0..3).map(|k| triangle[k] * w[k]).sum::<Vec3>();
                    if offset.norm() < snap {
                        let side = if offset.dot(&normal) < 0.0 { -1.0 } else { 1.0 };
                        let seat = p + normal * (side * snap - offset.dot(&normal));
                        nearest.push((n, offset.norm(), seat));
                    }
                }
            });
        }
        nearest.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for (n, _, seat) in nearest {
            if !std::mem::replace(&mut self.seated[n as usize], true) {
                self.seat[n as usize] = seat;
            }
        }
    }

    /// Makes the cuts, except those round a chip.
    fn commit(
        &mut self,
        mesh: &TetMesh,
        mut fresh: Vec<(u32, f64)>,
        chip_nodes: usize,
    ) -> Vec<u32> {
        for &(e, s) in &fresh {
            self.crossing[e as usize] = s.clamp(SNAP, 1.0 - SNAP);
        }
        loop {
            let mut pieces = Pieces::new(self, mesh, chip_nodes);
            let crumbles: Vec<bool> = fresh.iter().map(|f| pieces.crumble(f.0)).collect();
            if !crumbles.contains(&true) {
                break;
            }
            let mut keep = crumbles.iter().map(|c| !c);
            fresh.retain(|&(e, _)| {
                let kept = keep.next().unwrap_or(true);
                if !kept {
                    self.crossing[e as usize] = f64::NAN;
                }
                kept
            });
        }
        self.n_cut += fresh.len();
        fresh.into_iter().map(|(e, _)| e).collect()
    }

    /// Nodes joined by uncut edges.
    pub fn components(&self, mesh: &TetMesh) -> UnionFind {
        let mut parts = UnionFind::new(mesh.nodes().len());
        for (e, [a, b]) in mesh.edges().iter().enumerate() {
            if self.crossing[e].is_nan() {
                parts.join(*a as usize, *b as usize);
            }
        }
        parts
    }
}

/// Whether all corners lie on one side of a plane, clearly enough for [`segment_crosses`] to see no crossing: most tetrahedra near a
/// triangle do.
fn are_beside(sides: [f64; 4]) -> bool {
    const CLEARLY: f64 = 1e-8;
    let (least, most) = sides
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), s| {
            (l.min(*s), m.max(*s))
        });
    least > CLEARLY * most.abs() && least > 0.0 || most < -CLEARLY * least.abs() && most < 0.0
}

/// Tells chips from larger pieces by walking over uncut edges, never farther than the size of a chip.
struct Pieces<'a> {
    cuts: &'a CutEdges,
    mesh: &'a TetMesh,
    chip_nodes: usize,
    /// Nodes known to lie in a large piece.
    large: FxHashSet<u32>,
}

impl<'a> Pieces<'a> {
    fn new(cuts: &'a CutEdges, mesh: &'a TetMesh, chip_nodes: usize) -> Self {
        Self {
            cuts,
            mesh,
            chip_nodes,
            large: FxHashSet::default(),
        }
    }

    /// Whether a cut edge parts a chip from the rest.
    fn crumble(&mut self, e: u32) -> bool {
        let [a, b] = self.mesh.edges()[e as usize];
        let parted = |chip: Option<Vec<u32>>, other: u32| chip.is_some_and(|c| !c.contains(&other));
        parted(self.chip(a), b) || parted(self.chip(b), a)
    }

    /// The nodes of the piece that holds `start`, if there are fewer than those of a chip.
    fn chip(&mut self, start: u32) -> Option<Vec<u32>> {
        let mut found = vec![start];
        let mut next = 0;
        while let Some(&n) = found.get(next) {
            next += 1;
            if self.large.contains(&n) || found.len() >= self.chip_nodes {
                self.large.extend(found);
                return None;
            }
            for &t in self.mesh.tets_of_node(n as usize) {
                for e in self.mesh.tet_edges()[t as usize] {
                    let [a, b] = self.mesh.edges()[e as usize];
                    if (a == n || b == n) && !self.cuts.is_cut(e) {
                        let other = if a == n { b } else { a };
                        if !found.contains(&other) {
                            found.push(other);
                        }
                    }
                }
            }
        }
        (found.len() < self.chip_nodes).then_some(found)
    }
}

fn snaps(mesh: &TetMesh) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); mesh.nodes().len()];
    for e in mesh.edges() {
        let length = mesh.edge_vector(e).norm();
        for n in e {
            sums[*n as usize].0 += length;
            sums[*n as usize].1 += 1.0;
        }
    }
    sums.into_iter().map(|(sum, n)| SNAP * sum / n).collect()
}
