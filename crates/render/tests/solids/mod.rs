//! Solids with known equations, as meshes and as an oracle.
//!
//! The oracle follows each ray through all surfaces that it meets, in closed form, and asks of every stretch between two of
//! them whether it lies in the solid: the first change is what must be seen.
#![allow(dead_code)] // not every test that shares this looks at all of it
use osteotome_render::{Camera, Frame, Kind, Material, Mesh, Options, Scene, Texture};
use std::collections::HashMap;

type P = [f64; 3];

#[derive(Clone, Default)]
pub struct Shape {
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    fn reversed(mut self) -> Self {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self
    }

    fn mesh(&self, kind: Kind) -> Mesh<'_> {
        Mesh {
            kind,
            material: Material {
                color: [0.7; 3],
                opacity: 0.3,
                gloss: 0.2,
                texture: Texture::Plain,
            },
            positions: &self.positions,
            rest: &[],
            normals: &[],
            triangles: &self.triangles,
        }
    }
}

/// 20 x 4^n triangles, corners on the sphere.
pub fn sphere(radius: f64, n: u32) -> Shape {
    let t = (1.0 + 5.0f64.sqrt()) / 2.0;
    let mut points: Vec<P> = Vec::new();
    for s in [-1.0, 1.0] {
        for r in [-t, t] {
            points.extend([[0.0, s, r], [s, r, 0.0], [r, 0.0, s]]);
        }
    }
    let mut faces = Vec::new();
    let near = |a: P, b: P| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>() < 4.1;
    for a in 0..12usize {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, r] = [points[a], points[b], points[c]];
                if near(p, q) && near(q, r) && near(p, r) {
                    let outward = det(p, q, r) > 0.0;
                    faces.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..n {
        let mut middle: HashMap<(usize, usize), usize> = HashMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in faces {
            let mut mid = |p: usize, q: usize| {
                *middle.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    points.push([0, 1, 2].map(|k| points[p][k] + points[q][k]));
                    points.len() - 1
                })
            };
            let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        faces = finer;
        for p in &mut points {
            let l = p.iter().map(|c| c * c).sum::<f64>().sqrt();
            *p = p.map(|c| c / l);
        }
    }
    Shape {
        positions: points
            .iter()
            .map(|p| p.map(|c| (c * radius) as f32))
            .collect(),
        triangles: faces.iter().map(|f| f.map(|i| i as u32)).collect(),
    }
}

fn det(a: P, b: P, c: P) -> f64 {
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// A closed grid of n x 4 quads: `section(k)` gives the four corners of a cross-section, counter-clockwise seen from its end.
fn swept(n: u32, section: impl Fn(u32) -> [[f64; 3]; 4]) -> Shape {
    let mut shape = Shape::default();
    for k in 0..=n {
        shape
            .positions
            .extend(section(k).map(|p| p.map(|c| c as f32)));
    }
    for k in 0..n {
        for c in 0..4u32 {
            let (a, b) = (4 * k + c, 4 * k + (c + 1) % 4);
            shape.triangles.extend([[a, b, b + 4], [a, b + 4, a + 4]]);
        }
    }
    let e = 4 * n;
    shape
        .triangles
        .extend([[0, 2, 1], [0, 3, 2], [e, e + 1, e + 2], [e, e + 2, e + 3]]);
    shape
}

fn slab(low: P, high: P) -> Shape {
    swept(1, |k| {
        let z = [low[2], high[2]][k as usize];
        [
            [low[0], low[1], z],
            [high[0], low[1], z],
            [high[0], high[1], z],
            [low[0], high[1], z],
        ]
    })
}

/// Between two radii about the z axis, over a range of angles and heights.
fn arc(radii: [f64; 2], angles: [f64; 2], heights: [f64; 2], n: u32) -> Shape {
    swept(n, |k| {
        let a = angles[0] + (angles[1] - angles[0]) * f64::from(k) / f64::from(n);
        let at = |r: f64, z: f64| [r * a.cos(), r * a.sin(), z];
        [
            at(radii[0], heights[0]),
            at(radii[0], heights[1]),
            at(radii[1], heights[1]),
            at(radii[1], heights[0]),
        ]
    })
}

/// A surface in closed form.
enum Surface {
    Sphere(f64),
    Cylinder(f64),
    Plane {
        axis: usize,
        at: f64,
    },
    /// Holds the z axis.
    Radial(f64),
}

impl Surface {
    fn meets(&self, o: P, d: P, t: &mut Vec<f64>) {
        let roots = |a: f64, b: f64, c: f64, t: &mut Vec<f64>| {
            let q = b * b - a * c;
            if q > 0.0 {
                t.extend([(-b - q.sqrt()) / a, (-b + q.sqrt()) / a]);
            }
        };
        let dot = |n: usize, a: P, b: P| (0..n).map(|k| a[k] * b[k]).sum::<f64>();
        match *self {
            Self::Sphere(r) => roots(dot(3, d, d), dot(3, o, d), dot(3, o, o) - r * r, t),
            Self::Cylinder(r) => roots(dot(2, d, d), dot(2, o, d), dot(2, o, o) - r * r, t),
            Self::Plane { axis, at } => t.push((at - o[axis]) / d[axis]),
            Self::Radial(angle) => {
                let n = [-angle.sin(), angle.cos(), 0.0];
                t.push(-dot(2, o, n) / dot(2, d, n));
            }
        }
    }
}

/// Ids as in a frame where mesh 0 is what bounds the uncut bone, and mesh 1 what is cut out.
pub struct Oracle {
    surfaces: Vec<Surface>,
    is_bone: fn(P) -> bool,
    is_cut: fn(P) -> bool,
}

const NEAR: f64 = 0.5;

impl Oracle {
    fn id(&self, o: P, d: P) -> u32 {
        let mut t = vec![NEAR];
        self.surfaces.iter().for_each(|s| s.meets(o, d, &mut t));
        t.retain(|t| *t >= NEAR);
        t.sort_by(f64::total_cmp);
        t.push(t[t.len() - 1] + 1.0);
        let state = |k: usize| {
            let m = 0.5 * (t[k] + t[k + 1]);
            let p = [0, 1, 2].map(|i| o[i] + m * d[i]);
            ((self.is_bone)(p), (self.is_cut)(p))
        };
        let solid = |(bone, cut): (bool, bool)| bone && !cut;
        for k in 1..t.len() - 1 {
            let (before, after) = (state(k - 1), state(k));
            if solid(before) != solid(after) {
                return if before.1 == after.1 { 1 } else { 2 };
            }
        }
        0
    }
}

/// Pixels across and down.
pub const SIZE: [usize; 2] = [960, 540];

/// A solid, and from where it is looked at.
pub struct Case {
    /// For messages.
    pub name: &'static str,
    meshes: Vec<(Kind, Shape)>,
    /// The last mesh (id) that bounds the uncut bone.
    cut_from: u32,
    oracle: Oracle,
    /// From where.
    pub camera: Camera,
}

impl Case {
    /// For the renderer.
    pub fn scene(&self) -> Scene<'_> {
        let meshes = self.meshes.iter().map(|(kind, s)| s.mesh(*kind));
        Scene {
            meshes: meshes.collect(),
            background: [[0.1; 3]; 2],
            ..Scene::default()
        }
    }

    /// One sample a pixel.
    pub fn options(&self, is_transparent: bool) -> Options {
        Options {
            width: SIZE[0],
            height: SIZE[1],
            samples: 1,
            is_transparent,
        }
    }

    /// Gives the meshes other looks.
    pub fn scene_with(&self, texture: Texture, gloss: f32) -> Scene<'_> {
        let mut scene = self.scene();
        for mesh in &mut scene.meshes {
            mesh.material.texture = texture;
            mesh.material.gloss = gloss;
        }
        scene
    }

    /// What each pixel must show: 0 for nothing, 1 for the bone's surface, 2 for a cut's.
    fn expected(&self) -> Vec<u32> {
        let [w, h] = SIZE;
        let camera = &self.camera;
        let id = |i: usize| {
            let x = 2.0 * (((i % w) as f64 + 0.5) - 0.5 * w as f64) / h as f64;
            let y = 1.0 - 2.0 * ((i / w) as f64 + 0.5) / h as f64;
            let s = f64::from(camera.tangent);
            let d = [0, 1, 2].map(|k| {
                let [r, u, f] = camera.axes.map(|a| f64::from(a[k]));
                f + s * (x * r + y * u)
            });
            self.oracle.id(camera.eye.map(f64::from), d)
        };
        (0..w * h).map(id).collect()
    }

    /// Fewer than .05 % of the pixels may differ (the meshes are polyhedra), and only where the oracle's picture has an edge.
    pub fn check(&self, frame: &Frame) {
        let [w, h] = SIZE;
        let meaning = |id: &u32| match *id {
            0 => 0,
            id if id <= self.cut_from => 1,
            _ => 2,
        };
        let got: Vec<u32> = frame.ids.iter().map(meaning).collect();
        let expected = self.expected();
        let name = self.name;
        let mut seen = expected.clone();
        seen.sort_unstable();
        seen.dedup();
        assert!(seen.len() > 1, "{name}: the oracle sees only {seen:?}");
        let mut different = 0;
        for i in (0..w * h).filter(|i| got[*i] != expected[*i]) {
            different += 1;
            let (x, y) = (i % w, i / w);
            let around = (y.saturating_sub(1)..(y + 2).min(h))
                .flat_map(|y| (x.saturating_sub(1)..(x + 2).min(w)).map(move |x| y * w + x));
            let is_edge = around.into_iter().any(|k| expected[k] != expected[i]);
            assert!(
                is_edge,
                "{name}: pixel {x}, {y} shows {} instead of {}, off any edge",
                got[i], expected[i]
            );
        }
        let share = f64::from(different) / (w * h) as f64;
        assert!(
            share < 0.0005,
            "{name}: {:.4} % of the pixels differ",
            100.0 * share
        );
    }
}

fn look_at(eye: [f32; 3], target: [f32; 3]) -> Camera {
    Camera::look_at(eye, target, [0.0, 0.0, 1.0], 40.0)
}

fn norm(p: P) -> f64 {
    p.iter().map(|c| c * c).sum::<f64>().sqrt()
}

fn in_slab(p: P) -> bool {
    p[0].abs() < 3.0 && p[1].abs() < 40.0 && p[2] > 2.0 && p[2] < 40.0
}

fn slab_planes() -> Vec<Surface> {
    [
        (0, -3.0),
        (0, 3.0),
        (1, -40.0),
        (1, 40.0),
        (2, 2.0),
        (2, 40.0),
    ]
    .map(|(axis, at)| Surface::Plane { axis, at })
    .into()
}

fn slit() -> Shape {
    slab([-3.0, -40.0, 2.0], [3.0, 40.0, 40.0])
}

/// A sphere with a slit.
pub fn sphere_minus_prism() -> Case {
    let mut surfaces = slab_planes();
    surfaces.push(Surface::Sphere(20.0));
    let oracle = Oracle {
        surfaces,
        is_bone: |p| norm(p) < 20.0,
        is_cut: in_slab,
    };
    let meshes = vec![(Kind::Bone, sphere(20.0, 5)), (Kind::Kerf, slit())];
    Case {
        name: "sphere minus prism",
        meshes,
        cut_from: 1,
        oracle,
        camera: look_at([17.0, -52.0, 41.0], [0.0; 3]),
    }
}

/// Several shells of bone in each other.
pub fn nested_shells() -> Case {
    // A hollow sphere with a solid core that overlaps nothing, and a second core that is part of the first: counts, not parity.
    let mut surfaces = slab_planes();
    surfaces.extend([18.0, 20.0, 12.0, 9.0].map(Surface::Sphere));
    let oracle = Oracle {
        surfaces,
        is_bone: |p| (18.0..20.0).contains(&norm(p)) || norm(p) < 12.0,
        is_cut: in_slab,
    };
    let meshes = vec![
        (Kind::Bone, sphere(20.0, 5)),
        (Kind::Bone, sphere(18.0, 5).reversed()),
        (Kind::Bone, sphere(12.0, 5)),
        (Kind::Bone, sphere(9.0, 4)),
        (Kind::Kerf, slit()),
    ];
    Case {
        name: "nested shells",
        meshes,
        cut_from: 4,
        oracle,
        camera: look_at([6.0, -30.0, 62.0], [0.0; 3]),
    }
}

/// A sphere with part of a cylinder's wall taken out.
pub fn bent_crack() -> Case {
    let oracle = Oracle {
        surfaces: vec![
            Surface::Sphere(20.0),
            Surface::Cylinder(10.0),
            Surface::Cylinder(11.5),
            Surface::Plane { axis: 2, at: 0.0 },
            Surface::Plane { axis: 2, at: 30.0 },
            Surface::Radial(-2.6),
            Surface::Radial(0.9),
        ],
        is_bone: |p| norm(p) < 20.0,
        is_cut: |p| {
            let angle = p[1].atan2(p[0]);
            (10.0..11.5).contains(&p[0].hypot(p[1]))
                && (0.0..30.0).contains(&p[2])
                && (-2.6..0.9).contains(&angle)
        },
    };
    let crack = arc([10.0, 11.5], [-2.6, 0.9], [0.0, 30.0], 160);
    let meshes = vec![(Kind::Bone, sphere(20.0, 5)), (Kind::Gap, crack)];
    Case {
        name: "bent crack",
        meshes,
        cut_from: 1,
        oracle,
        camera: look_at([12.0, -38.0, 58.0], [0.0, 0.0, 5.0]),
    }
}

/// So many spheres in each other, each bone of its own, with a slit: rays meet more than a short list holds.
pub fn many_shells() -> Case {
    let mut case = sphere_minus_prism();
    let shells = (0..24).map(|k| (Kind::Bone, sphere(20.0 - 0.7 * f64::from(k), 3)));
    case.name = "many shells";
    case.meshes.splice(0..1, shells);
    case
}

/// The slit sphere from within: in the bone, and in the slit.
pub fn from_inside() -> [Case; 2] {
    [
        ("inside the bone", [-9.0, -2.0, 4.0], [3.0, 3.0, 5.0]),
        ("inside the slit", [0.5, -6.0, 9.0], [0.0, 9.0, 6.0]),
    ]
    .map(|(name, eye, target)| Case {
        name,
        camera: look_at(eye, target),
        ..sphere_minus_prism()
    })
}
