use super::{Aabb, TriMesh, Vec3};
use rustc_hash::FxHashMap;

/// A region of space given by the signed distance to its surface.
pub trait SignedDistance: Sync {
    /// Distance from `p` to the surface \[mm\]: negative inside, positive outside.
    fn signed(&self, p: &Vec3) -> f64;
    /// A box that holds the whole region.
    fn bounds(&self) -> Aabb;
}

/// A box with its faces.
impl SignedDistance for Aabb {
    fn signed(&self, p: &Vec3) -> f64 {
        let outside = (self.min - p).sup(&(p - self.max));
        outside.sup(&Vec3::zeros()).norm() + outside.max().min(0.0)
    }

    fn bounds(&self) -> Aabb {
        *self
    }
}

/// Where on a triangle mesh the point nearest to a query lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// The nearest point.
    pub point: Vec3,
    /// A triangle that holds it.
    pub triangle: u32,
    /// Unit normal of the feature it lies on: face, edge (mean of its faces) or vertex (angle-weighted mean).
    pub normal: Vec3,
}

/// Exact distance to a triangle mesh through a tree of boxes.
///
/// The sign comes from the angle-weighted pseudonormal of the nearest face, edge or vertex (Bærentzen & Aanæs 2005,
/// IEEE TVCG), which is right everywhere for a closed, consistently oriented mesh without self-intersections. For an
/// open sheet the sign says on which side of its nearest feature a point lies. Queries neither allocate nor wait.
#[derive(Clone, Debug)]
pub struct MeshDistance {
    mesh: TriMesh,
    nodes: Vec<Node>,
    /// Triangle indices and corners, in the order of the leaves.
    order: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    face_normals: Vec<Vec3>,
    /// By triangle, for the edges `[0,1]`, `[1,2]`, `[2,0]`.
    edge_normals: Vec<[Vec3; 3]>,
    vertex_normals: Vec<Vec3>,
    bounds: Aabb,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Aabb,
    /// Leaf: first item; inner node: index of the right child (the left one follows the node itself).
    start: u32,
    /// Items of a leaf; 0 for an inner node.
    count: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Feature {
    Vertex(usize),
    Edge(usize),
    Face,
}

const LEAF_SIZE: usize = 4;
/// Deeper than any tree of median splits over `u32` items.
const STACK_SIZE: usize = 64;

impl MeshDistance {
    /// Indexes a mesh, whose triangles must name existing vertices. Triangles without area count for distance only.
    pub fn new(mesh: TriMesh) -> Self {
        let mut order: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        let boxes: Vec<_> = (0..mesh.triangles.len())
            .map(|t| Aabb::around(&mesh.corners(t)))
            .collect();
        let mut nodes = Vec::with_capacity(mesh.triangles.len());
        if !order.is_empty() {
            build(&mut nodes, &boxes, &mut order, 0);
        }
        let corners = order.iter().map(|&t| mesh.corners(t as usize)).collect();
        let face_normals: Vec<_> = (0..mesh.triangles.len())
            .map(|t| unit(mesh.area_normal(t)))
            .collect();
        Self {
            edge_normals: edge_normals(&mesh, &face_normals),
            vertex_normals: vertex_normals(&mesh, &face_normals),
            bounds: Aabb::around(
                mesh.triangles
                    .iter()
                    .flatten()
                    .map(|&v| &mesh.vertices[v as usize]),
            ),
            nodes,
            order,
            corners,
            face_normals,
            mesh,
        }
    }

    /// The mesh that was indexed.
    pub fn mesh(&self) -> &TriMesh {
        &self.mesh
    }

    /// Angle-weighted unit normal at each vertex; zero at vertices that no triangle uses.
    pub fn vertex_normals(&self) -> &[Vec3] {
        &self.vertex_normals
    }

    /// The point of the mesh nearest to `p`; `None` for a mesh without triangles.
    pub fn closest(&self, p: &Vec3) -> Option<Closest> {
        self.nearest(p, f64::INFINITY).map(|(_, closest)| closest)
    }

    /// Like [`closest`](Self::closest), but only within `reach` \[mm\]: cheaper where most queries are far away.
    pub fn closest_within(&self, p: &Vec3, reach: f64) -> Option<Closest> {
        self.nearest(p, reach * reach).map(|(_, closest)| closest)
    }

    /// Distance to the mesh without sign \[mm\]; infinite for a mesh without triangles.
    pub fn unsigned(&self, p: &Vec3) -> f64 {
        self.nearest(p, f64::INFINITY)
            .map_or(f64::INFINITY, |(d2, _)| d2.sqrt())
    }

    /// Signed distance \[mm\], negative inside; positive and infinite for a mesh without triangles.
    pub fn signed(&self, p: &Vec3) -> f64 {
        self.nearest(p, f64::INFINITY)
            .map_or(f64::INFINITY, |(d2, c)| {
                d2.sqrt().copysign((p - c.point).dot(&c.normal))
            })
    }

    fn nearest(&self, p: &Vec3, limit_squared: f64) -> Option<(f64, Closest)> {
        let mut best = limit_squared;
        let mut found = None;
        let mut stack = [(0.0, 0u32); STACK_SIZE];
        let mut top = 0;
        if let Some(root) = self.nodes.first() {
            stack[0] = (box_distance_squared(&root.bounds, p), 0);
            top = 1;
        }
        while top > 0 {
            top -= 1;
            let (d2, index) = stack[top];
            if d2 >= best {
                continue;
            }
            let node = self.nodes[index as usize];
            if node.count > 0 {
                for i in node.start as usize..(node.start + node.count) as usize {
                    let (point, feature) = closest_on_triangle(&self.corners[i], p);
                    let d2 = (p - point).norm_squared();
                    if d2 < best {
                        best = d2;
                        found = Some((point, self.order[i], feature));
                    }
                }
                continue;
            }
            let mut children = [index + 1, node.start]
                .map(|c| (box_distance_squared(&self.nodes[c as usize].bounds, p), c));
            if children[0].0 < children[1].0 {
                children.swap(0, 1);
            }
            for child in children {
                if child.0 < best {
                    stack[top] = child;
                    top += 1;
                }
            }
        }
        found.map(|(point, triangle, feature)| {
            let normal = self.feature_normal(triangle as usize, feature);
            let closest = Closest {
                point,
                triangle,
                normal,
            };
            (best, closest)
        })
    }

    fn feature_normal(&self, triangle: usize, feature: Feature) -> Vec3 {
        match feature {
            Feature::Face => self.face_normals[triangle],
            Feature::Edge(k) => self.edge_normals[triangle][k],
            Feature::Vertex(k) => self.vertex_normals[self.mesh.triangles[triangle][k] as usize],
        }
    }
}

impl SignedDistance for MeshDistance {
    fn signed(&self, p: &Vec3) -> f64 {
        self.signed(p)
    }
    fn bounds(&self) -> Aabb {
        self.bounds
    }
}

fn unit(v: Vec3) -> Vec3 {
    let n = v.norm();
    if n > 0.0 { v / n } else { Vec3::zeros() }
}

fn edge_normals(mesh: &TriMesh, faces: &[Vec3]) -> Vec<[Vec3; 3]> {
    let key = |a: u32, b: u32| [a.min(b), a.max(b)];
    let mut sums: FxHashMap<[u32; 2], Vec3> = FxHashMap::default();
    for (t, n) in mesh.triangles.iter().zip(faces) {
        for k in 0..3 {
            *sums.entry(key(t[k], t[(k + 1) % 3])).or_default() += n;
        }
    }
    let normal = |t: &[u32; 3], k: usize| unit(sums[&key(t[k], t[(k + 1) % 3])]);
    mesh.triangles
        .iter()
        .map(|t| [0, 1, 2].map(|k| normal(t, k)))
        .collect()
}

fn vertex_normals(mesh: &TriMesh, faces: &[Vec3]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::zeros(); mesh.vertices.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let x = mesh.corners(t);
        for k in 0..3 {
            let a = x[(k + 1) % 3] - x[k];
            let b = x[(k + 2) % 3] - x[k];
            let angle = a.cross(&b).norm().atan2(a.dot(&b));
            sums[triangle[k] as usize] += angle * faces[t];
        }
    }
    sums.into_iter().map(unit).collect()
}

/// Splits `order` at the median centre along the longest side, and so on down to leaves.
fn build(nodes: &mut Vec<Node>, boxes: &[Aabb], order: &mut [u32], start: u32) {
    let mut bounds = Aabb::EMPTY;
    let mut centres = Aabb::EMPTY;
    for &t in order.iter() {
        let b = &boxes[t as usize];
        bounds.add(&b.min);
        bounds.add(&b.max);
        centres.add(&b.centre());
    }
    let index = nodes.len();
    nodes.push(Node {
        bounds,
        start,
        count: order.len() as u32,
    });
    if order.len() <= LEAF_SIZE {
        return;
    }
    let axis = centres.extent().imax();
    let centre = |t: &u32| boxes[*t as usize].centre()[axis];
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |a, b| {
        centre(a).total_cmp(&centre(b)).then(a.cmp(b))
    });
    let (left, right) = order.split_at_mut(middle);
    build(nodes, boxes, left, start);
    nodes[index].start = nodes.len() as u32;
    nodes[index].count = 0;
    build(nodes, boxes, right, start + middle as u32);
}

fn box_distance_squared(b: &Aabb, p: &Vec3) -> f64 {
    (0..3)
        .map(|k| (b.min[k] - p[k]).max(p[k] - b.max[k]).max(0.0))
        .map(|d| d * d)
        .sum()
}

/// Nearest point of a triangle and the feature that it lies on, by Voronoi regions.
fn closest_on_triangle(x: &[Vec3; 3], p: &Vec3) -> (Vec3, Feature) {
    let [a, b, c] = *x;
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Feature::Vertex(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Feature::Vertex(1));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Feature::Vertex(2));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        return (a + ab * (d1 / (d1 - d3)), Feature::Edge(0));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        return (a + ac * (d2 / (d2 - d6)), Feature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    let (e, f) = (d4 - d3, d5 - d6);
    if va <= 0.0 && e >= 0.0 && f >= 0.0 && e + f > 0.0 {
        return (b + (c - b) * (e / (e + f)), Feature::Edge(1));
    }
    let sum = va + vb + vc;
    let (v, w) = (vb / sum, vc / sum);
    let inside = a + ab * v + ac * w;
    if sum > 0.0 && inside.iter().all(|c| c.is_finite()) {
        return (inside, Feature::Face);
    }
    closest_on_edges(x, p)
}

/// For triangles so thin that rounding leaves no region to choose.
fn closest_on_edges(x: &[Vec3; 3], p: &Vec3) -> (Vec3, Feature) {
    let candidate = |k: usize| {
        let (a, edge) = (x[k], x[(k + 1) % 3] - x[k]);
        let length2 = edge.norm_squared();
        let s = if length2 > 0.0 {
            ((p - a).dot(&edge) / length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (a + edge * s, Feature::Edge(k))
    };
    let distance = |q: &(Vec3, Feature)| (p - q.0).norm_squared();
    let [q0, q1, q2] = [0, 1, 2].map(candidate);
    let best = if distance(&q1) < distance(&q0) {
        q1
    } else {
        q0
    };
    if distance(&q2) < distance(&best) {
        q2
    } else {
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points that fill a box evenly but irregularly (Halton sequence).
    fn scattered(n: u32, bounds: &Aabb) -> Vec<Vec3> {
        let halton = |mut i: u32, base: u32| {
            let (mut f, mut r) = (1.0, 0.0);
            while i > 0 {
                f /= f64::from(base);
                r += f * f64::from(i % base);
                i /= base;
            }
            r
        };
        (1..=n)
            .map(|i| {
                let u = Vec3::new(halton(i, 2), halton(i, 3), halton(i, 5));
                bounds.min + u.component_mul(&bounds.extent())
            })
            .collect()
    }

    #[test]
    fn a_box_is_as_far_as_its_faces() {
        let (unit, faces) = (Aabb::around(&cube().vertices), MeshDistance::new(cube()));
        assert_eq!(unit.bounds(), unit);
        for p in scattered(500, &unit.grown(0.7)) {
            assert!((unit.signed(&p) - faces.signed(&p)).abs() < 1e-12, "at {p}");
        }
    }

    fn cube() -> TriMesh {
        let vertices = (0..8)
            .map(|i| Vec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64))
            .collect();
        let quads = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let triangles = quads
            .iter()
            .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .collect();
        TriMesh {
            vertices,
            triangles,
        }
    }

    /// An octahedron refined onto the unit sphere.
    fn sphere(levels: usize) -> TriMesh {
        let (x, y, z) = (Vec3::x(), Vec3::y(), Vec3::z());
        let mut mesh = TriMesh {
            vertices: vec![x, y, -x, -y, z, -z],
            triangles: (0..4)
                .flat_map(|k| [[k, (k + 1) % 4, 4], [(k + 1) % 4, k, 5]])
                .collect(),
        };
        for _ in 0..levels {
            let mut middles: FxHashMap<[u32; 2], u32> = FxHashMap::default();
            let mut vertices = mesh.vertices.clone();
            let mut middle = |a: u32, b: u32| {
                *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    vertices.push((vertices[a as usize] + vertices[b as usize]).normalize());
                    vertices.len() as u32 - 1
                })
            };
            let triangles = mesh
                .triangles
                .iter()
                .flat_map(|&[a, b, c]| {
                    let [d, e, f] = [middle(a, b), middle(b, c), middle(c, a)];
                    [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
                })
                .collect();
            mesh = TriMesh {
                vertices,
                triangles,
            };
        }
        mesh
    }

    #[test]
    fn equals_brute_force() {
        let mesh = sphere(3);
        let distance = MeshDistance::new(mesh.clone());
        for p in scattered(500, &mesh.bounds().grown(0.5)) {
            let brute = (0..mesh.triangles.len())
                .map(|t| (p - closest_on_triangle(&mesh.corners(t), &p).0).norm())
                .fold(f64::INFINITY, f64::min);
            assert!((distance.unsigned(&p) - brute).abs() < 1e-15);
            let closest = distance.closest(&p).unwrap();
            assert!(((p - closest.point).norm() - brute).abs() < 1e-15);
            assert!(distance.closest_within(&p, 0.999 * brute).is_none());
            assert_eq!(distance.closest_within(&p, 1.001 * brute), Some(closest));
        }
    }

    #[test]
    fn distance_to_a_cube_is_the_closed_form() {
        let distance = MeshDistance::new(cube());
        let exact = |p: &Vec3| {
            let q = (p.add_scalar(-0.5)).abs().add_scalar(-0.5);
            q.sup(&Vec3::zeros()).norm() + q.max().min(0.0)
        };
        let mut points = scattered(2000, &cube().bounds().grown(1.0));
        // Straight out of, and just beside, every vertex and edge: where face normals alone give wrong signs.
        for i in 0..27 {
            let d = Vec3::new(
                f64::from(i % 3 - 1),
                f64::from(i / 3 % 3 - 1),
                f64::from(i / 9 - 1),
            );
            for s in [0.3, 0.499_999, 0.500_001, 0.7] {
                points.push((d * s).add_scalar(0.5));
                points.push((d * s).add_scalar(0.5) + Vec3::new(3e-7, -2e-7, 1e-7));
            }
        }
        for p in points {
            let (got, want) = (distance.signed(&p), exact(&p));
            assert!((got - want).abs() < 1e-12, "{p}: {got} instead of {want}");
        }
    }

    #[test]
    fn sign_is_right_all_around_a_faceted_sphere() {
        let mesh = sphere(2);
        let distance = MeshDistance::new(mesh.clone());
        let radius_in = (0..mesh.triangles.len())
            .map(|t| mesh.corners(t)[0].dot(&unit(mesh.area_normal(t))))
            .fold(f64::INFINITY, f64::min);
        for p in scattered(5000, &mesh.bounds().grown(0.3)) {
            if p.norm() > 1.0 {
                assert!(distance.signed(&p) > 0.0, "{p}");
            } else if p.norm() < radius_in {
                assert!(distance.signed(&p) < 0.0, "{p}");
            }
        }
        for v in &mesh.vertices {
            assert!(distance.signed(&(v * 1.001)) > 0.0);
            assert!(distance.signed(&(v * 0.999)) < 0.0);
        }
    }

    #[test]
    fn triangles_without_area_do_no_harm() {
        let mut mesh = cube();
        mesh.triangles.push([0, 0, 1]);
        mesh.triangles.push([0, 1, 1]);
        let distance = MeshDistance::new(mesh);
        let d = distance.signed(&Vec3::new(0.5, -0.25, -0.25));
        assert!((d - 0.125f64.sqrt()).abs() < 1e-12);
        assert!(
            MeshDistance::new(TriMesh::default())
                .closest(&Vec3::zeros())
                .is_none()
        );
    }
}
