//! Generalised winding numbers: how often a surface, however torn, goes round a point.
//!
//! Jacobson et al. 2013 (ACM TOG 32, 33); far triangles through their dipole in a tree, Barill et al. 2018 (ACM TOG 37, 43).
use osteotome_mechanics::geometry::{Aabb, TriMesh, Vec3, segment_crosses};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Triangles in a tree of boxes, each with its dipole.
pub struct TriangleTree {
    nodes: Vec<Node>,
    /// Triangle numbers and corners in the order of the leaves.
    order: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    triangles: Vec<[u32; 3]>,
}

struct Node {
    bounds: Aabb,
    /// Area-weighted middle, and how far the box reaches from it.
    centre: Vec3,
    radius: f64,
    /// Sum of the area normals.
    dipole: Vec3,
    /// Leaf: first item; inner node: number of the right child (the left one follows the node itself).
    start: u32,
    /// Items of a leaf; 0 for an inner node.
    count: u32,
}

const LEAF_SIZE: usize = 8;
/// A node further away than so many of its radii counts as a dipole: winding numbers are then right within 0.01.
const FAR: f64 = 3.0;
/// Deeper than any tree of median splits over `u32` items.
const STACK_SIZE: usize = 64;

impl TriangleTree {
    /// Indexes a mesh.
    pub fn new(mesh: &TriMesh) -> Self {
        let mut order: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        let centres: Vec<Vec3> = (0..mesh.triangles.len())
            .map(|t| mesh.corners(t).iter().sum::<Vec3>() / 3.0)
            .collect();
        let mut tree = Self {
            nodes: Vec::new(),
            order: Vec::new(),
            corners: Vec::new(),
            triangles: mesh.triangles.clone(),
        };
        if !order.is_empty() {
            tree.split(mesh, &centres, &mut order, 0);
        }
        tree.corners = order.iter().map(|t| mesh.corners(*t as usize)).collect();
        tree.order = order;
        tree
    }

    fn split(&mut self, mesh: &TriMesh, centres: &[Vec3], order: &mut [u32], start: u32) {
        let index = self.nodes.len();
        self.nodes.push(node(mesh, centres, order, start));
        if order.len() <= LEAF_SIZE {
            return;
        }
        let spread = Aabb::around(order.iter().map(|t| &centres[*t as usize])).extent();
        let axis = spread.imax();
        let middle = order.len() / 2;
        let place = |t: &u32| centres[*t as usize][axis];
        order.select_nth_unstable_by(middle, |a, b| place(a).total_cmp(&place(b)).then(a.cmp(b)));
        let (left, right) = order.split_at_mut(middle);
        self.split(mesh, centres, left, start);
        self.nodes[index].start = self.nodes.len() as u32;
        self.nodes[index].count = 0;
        self.split(mesh, centres, right, start + middle as u32);
    }

    /// 1 inside a closed surface with outward normals, 0 outside, in between near holes. Accuracy: 0.01.
    pub fn winding(&self, p: &Vec3) -> f64 {
        let mut sum = 0.0;
        let mut stack = [0u32; STACK_SIZE];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let node = &self.nodes[index as usize];
            let d = node.centre - p;
            let r2 = d.norm_squared();
            if r2 > (FAR * node.radius).powi(2) {
                sum += d.dot(&node.dipole) / (r2 * r2.sqrt());
            } else if node.count > 0 {
                let items = node.start as usize..(node.start + node.count) as usize;
                sum += self.corners[items]
                    .iter()
                    .map(|c| solid_angle(c, p))
                    .sum::<f64>();
            } else {
                stack[top] = index + 1;
                stack[top + 1] = node.start;
                top += 2;
            }
        }
        sum / (4.0 * PI)
    }

    /// How many triangles are cut by an edge of another that shares no corner with them, and the place of the first. A triangle
    /// that more than `PATIENCE` others come near is not looked at further: such surfaces are broken anyway.
    pub fn self_intersections(&self) -> (usize, Option<Vec3>) {
        let found: Vec<Option<Vec3>> = (0..self.order.len())
            .into_par_iter()
            .map(|i| self.intersection(i))
            .collect();
        let n = found.iter().flatten().count();
        // By the mesh's own numbers, not the tree's.
        let first = (0..found.len())
            .filter(|i| found[*i].is_some())
            .min_by_key(|i| self.order[*i])
            .and_then(|i| found[i]);
        (n, first)
    }

    fn intersection(&self, i: usize) -> Option<Vec3> {
        const PATIENCE: usize = 2_000;
        let own = &self.corners[i];
        let names = self.triangles[self.order[i] as usize];
        let around = Aabb::around(own);
        let mut stack = [0u32; STACK_SIZE];
        let (mut top, mut seen) = (1, 0);
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let node = &self.nodes[index as usize];
            if !node.bounds.overlaps(&around) {
                continue;
            }
            if node.count == 0 {
                stack[top] = index + 1;
                stack[top + 1] = node.start;
                top += 2;
                continue;
            }
            for k in node.start as usize..(node.start + node.count) as usize {
                let others = self.triangles[self.order[k] as usize];
                let is_neighbour = others.iter().any(|v| names.contains(v));
                if is_neighbour || !Aabb::around(&self.corners[k]).overlaps(&around) {
                    continue;
                }
                for e in 0..3 {
                    let (a, b) = (self.corners[k][e], self.corners[k][(e + 1) % 3]);
                    if let Some(share) = segment_crosses(&a, &b, own) {
                        return Some(a + (b - a) * share);
                    }
                }
                seen += 1;
                if seen > PATIENCE {
                    return None;
                }
            }
        }
        None
    }
}

fn node(mesh: &TriMesh, centres: &[Vec3], order: &[u32], start: u32) -> Node {
    let (mut bounds, mut dipole) = (Aabb::EMPTY, Vec3::zeros());
    let (mut centre, mut area) = (Vec3::zeros(), 0.0);
    for &t in order {
        let normal = mesh.area_normal(t as usize) * 0.5;
        let size = normal.norm();
        dipole += normal;
        centre += centres[t as usize] * size;
        area += size;
        mesh.corners(t as usize).iter().for_each(|c| bounds.add(c));
    }
    let centre = if area > 0.0 {
        centre / area
    } else {
        bounds.centre()
    };
    let reach = (centre - bounds.min)
        .abs()
        .sup(&(bounds.max - centre).abs());
    Node {
        bounds,
        centre,
        radius: reach.norm(),
        dipole,
        start,
        count: order.len() as u32,
    }
}

/// Signed solid angle of a triangle (van Oosterom & Strackee 1983).
fn solid_angle(corners: &[Vec3; 3], p: &Vec3) -> f64 {
    let [a, b, c] = corners.map(|x| x - p);
    let [la, lb, lc] = [a.norm(), b.norm(), c.norm()];
    let numerator = a.dot(&b.cross(&c));
    let denominator = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    2.0 * numerator.atan2(denominator)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesher::contour;
    use osteotome_mechanics::geometry::SignedDistance;

    struct Ball(f64);
    impl SignedDistance for Ball {
        fn signed(&self, p: &Vec3) -> f64 {
            p.norm() - self.0
        }
        fn bounds(&self) -> Aabb {
            let r = Vec3::repeat(self.0);
            Aabb { min: -r, max: r }
        }
    }

    fn places() -> impl Iterator<Item = Vec3> {
        (0..400).map(|i| {
            let f = f64::from(i);
            Vec3::new((f * 0.7).sin(), (f * 1.3).cos(), (f * 0.37).sin()) * (3.0 + 0.035 * f)
        })
    }

    #[test]
    fn one_inside_zero_outside_a_ball() {
        let tree = TriangleTree::new(&contour(&Ball(10.0), 1.0).unwrap());
        for p in places().filter(|p| (p.norm() - 10.0).abs() > 0.2) {
            let want = f64::from(u8::from(p.norm() < 10.0));
            assert!((tree.winding(&p) - want).abs() < 0.01, "{p}");
        }
    }

    /// Against the plain sum over all triangles, of a torn surface.
    #[test]
    fn the_tree_equals_the_sum() {
        let mut mesh = contour(&Ball(10.0), 1.0).unwrap();
        let n = mesh.triangles.len();
        mesh.triangles.drain(n / 3..n / 2);
        let tree = TriangleTree::new(&mesh);
        for p in places() {
            let sum: f64 = (0..mesh.triangles.len())
                .map(|t| solid_angle(&mesh.corners(t), &p))
                .sum();
            assert!((tree.winding(&p) - sum / (4.0 * PI)).abs() < 0.01);
        }
    }

    /// An open hemisphere: on its axis the rim is seen under a known solid angle.
    #[test]
    fn half_a_ball_is_the_closed_form() {
        let mut mesh = contour(&Ball(10.0), 0.5).unwrap();
        let vertices = mesh.vertices.clone();
        mesh.triangles
            .retain(|t| t.iter().all(|v| vertices[*v as usize].z < 0.0));
        let tree = TriangleTree::new(&mesh);
        for z in [-6.0f64, -3.0, 3.0, 8.0] {
            // All but the cone through the rim, seen from below it; only that cone from above.
            let want = 0.5 * (1.0 - z / z.hypot(10.0));
            let got = tree.winding(&(Vec3::z() * z));
            assert!((got - want).abs() < 0.03, "{z}: {got} instead of {want}");
        }
    }

    #[test]
    fn intersections_are_found_and_closed_surfaces_have_none() {
        let ball = contour(&Ball(10.0), 2.0).unwrap();
        assert_eq!(TriangleTree::new(&ball).self_intersections().0, 0);
        let mut two = ball.clone();
        let mut moved = ball;
        moved.vertices.iter_mut().for_each(|p| p.x += 13.1);
        two.append(&moved);
        let (n, first) = TriangleTree::new(&two).self_intersections();
        assert!(n > 10);
        // On the circle in which both balls meet.
        let first = first.unwrap();
        assert!((first.x - 6.55).abs() < 0.5 && (first.norm() - 10.0).abs() < 0.5);
    }
}
