//! The implicit crack representation (ICR): level sets of the explicit surface at the nodes near it.
//!
//! After Fries & Baydoun (2012): phi1 the distance to the surface, phi2 the distance to its front, phi3 the signed distance
//! to the surface led on past its front along its tangent plane. They serve distances and front coordinates; which side of
//! the crack a point is on, once it is cut, comes from the cut edges ([`super::CutEdges`]), never from the sign of phi3.
use super::surface::{CrackSurface, Front, Sheet};
use crate::geometry::{MeshDistance, TetLocator, TetMesh, TriMesh, Vec3};

/// The crack as one node sees it, by the sheet that is nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelSet {
    /// Which node.
    pub node: u32,
    /// Which sheet is nearest.
    pub sheet: u32,
    /// phi1: distance to that sheet \[mm\].
    pub surface: f64,
    /// phi2: distance to its fronts inside the body \[mm\]; infinite if it has none.
    pub front: f64,
    /// phi3: distance to that sheet and its tangential extension, positive where its normals look to \[mm\].
    pub offset: f64,
    /// Whether the nearest point of the sheet lies on its border: the node is ahead of it, not beside it.
    pub is_ahead: bool,
}

/// How the level sets see a tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementClass {
    /// Away from the crack, or only touched by its extension.
    Uncut,
    /// phi3 changes sign behind the front.
    Cut,
    /// The front runs through it: phi3 changes sign, and some nodes are ahead of the front, others behind.
    Front,
}

impl LevelSet {
    /// Coordinates (a, b) \[mm\] in the plane across the front: a along the crack's extension, negative behind the front, b
    /// along its normal. Distance r = phi2 and angle theta = atan2(b, a).
    pub fn front_coordinates(&self) -> (f64, f64) {
        let along = (self.front * self.front - self.offset * self.offset)
            .max(0.0)
            .sqrt();
        (if self.is_ahead { along } else { -along }, self.offset)
    }
}

/// Level sets at the nodes closer than `reach` \[mm\] to the crack, ascending by node.
///
/// `fronts`: those of `crack`. Exact for the distance to the triangles; costs in proportion to the nodes in the sheets' boxes.
pub fn level_sets(
    mesh: &TetMesh,
    locator: &TetLocator,
    crack: &CrackSurface,
    fronts: &[Front],
    reach: f64,
) -> Vec<LevelSet> {
    let mut all = Vec::new();
    for (k, sheet) in crack.sheets.iter().enumerate() {
        let own: Vec<&Front> = fronts.iter().filter(|f| f.sheet == k).collect();
        let seen = SheetSeen::new(sheet, &own);
        let nodes = nodes_near(mesh, locator, &sheet.mesh, reach);
        all.extend(nodes.into_iter().filter_map(|node| {
            let p = &mesh.nodes()[node as usize];
            seen.level_set(p, reach).map(|l| LevelSet {
                node,
                sheet: k as u32,
                ..l
            })
        }));
    }
    all.sort_by(|a, b| (a.node.cmp(&b.node)).then(a.surface.total_cmp(&b.surface)));
    all.dedup_by_key(|l| l.node);
    all
}

/// Class of tetrahedron `t` by the level sets of its nodes, which [`level_sets`] gave.
pub fn element_class(mesh: &TetMesh, sets: &[LevelSet], t: u32) -> ElementClass {
    let mut nodes = [None; 4];
    for (of, n) in nodes.iter_mut().zip(mesh.tets()[t as usize]) {
        *of = sets.binary_search_by_key(&n, |l| l.node).ok();
    }
    let [Some(a), Some(b), Some(c), Some(d)] = nodes else {
        return ElementClass::Uncut;
    };
    let sets = [a, b, c, d].map(|k| &sets[k]);
    let changes = |f: &dyn Fn(&LevelSet) -> bool| sets.iter().any(|l| f(l) != f(sets[0]));
    let one_sheet = sets.iter().all(|l| l.sheet == sets[0].sheet);
    if !one_sheet || !changes(&|l| l.offset < 0.0) {
        ElementClass::Uncut
    } else if changes(&|l| l.is_ahead) {
        ElementClass::Front
    } else if sets[0].is_ahead {
        ElementClass::Uncut
    } else {
        ElementClass::Cut
    }
}

/// One sheet, made ready for many queries.
struct SheetSeen {
    distance: MeshDistance,
    border: Vec<[Vec3; 2]>,
    fronts: Vec<[Vec3; 2]>,
}

impl SheetSeen {
    fn new(sheet: &Sheet, fronts: &[&Front]) -> Self {
        let at = |v: u32| sheet.mesh.vertices[v as usize];
        let segments = |f: &&Front| {
            let n = f.vertices.len();
            let last = if f.closed { n } else { n - 1 };
            let segment = |k: usize| [at(f.vertices[k]), at(f.vertices[(k + 1) % n])];
            (0..last).map(segment).collect::<Vec<_>>()
        };
        Self {
            border: (sheet.mesh.border_edges().iter())
                .map(|e| e.map(at))
                .collect(),
            fronts: fronts.iter().flat_map(segments).collect(),
            distance: MeshDistance::new(sheet.mesh.clone()),
        }
    }

    fn level_set(&self, p: &Vec3, reach: f64) -> Option<LevelSet> {
        /// A foot this near to the border, relative to the reach, lies on it.
        const ON_BORDER: f64 = 1e-9;
        let foot = self.distance.closest_within(p, reach)?;
        let way = p - foot.point;
        let across = way.dot(&foot.normal);
        let is_ahead = nearest(&self.border, &foot.point) < ON_BORDER * reach;
        Some(LevelSet {
            node: 0,
            sheet: 0,
            surface: way.norm(),
            front: nearest(&self.fronts, p),
            // Beside the sheet a kink's pseudonormal leans off the way to it: there only its sign counts.
            offset: if is_ahead {
                across
            } else {
                way.norm().copysign(across)
            },
            is_ahead,
        })
    }
}

/// Distance from `p` to the nearest segment.
fn nearest(segments: &[[Vec3; 2]], p: &Vec3) -> f64 {
    let distance = |[a, b]: &[Vec3; 2]| {
        let d = b - a;
        let w = ((p - a).dot(&d) / d.norm_squared().max(1e-30)).clamp(0.0, 1.0);
        (a + d * w - p).norm()
    };
    segments.iter().map(distance).fold(f64::INFINITY, f64::min)
}

/// Nodes of the tetrahedra that may come within `reach` of a sheet, ascending.
fn nodes_near(mesh: &TetMesh, locator: &TetLocator, sheet: &TriMesh, reach: f64) -> Vec<u32> {
    let mut is_near = vec![false; mesh.nodes().len()];
    locator.tets_near(&sheet.bounds().grown(reach), |tet| {
        for &n in &mesh.tets()[tet as usize] {
            is_near[n as usize] = true;
        }
    });
    let all = 0..mesh.nodes().len() as u32;
    all.filter(|n| is_near[*n as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::block_mesh;
    use std::f64::consts::PI;

    const REACH: f64 = 2.5;

    /// A penny of radius 3 in the plane z = .2 about (.1, -.2), with its front.
    fn penny() -> (CrackSurface, Vec<Front>) {
        const N: u32 = 720;
        let centre = Vec3::new(0.1, -0.2, 0.2);
        let mut mesh = TriMesh {
            vertices: vec![centre],
            triangles: vec![],
        };
        for k in 0..N {
            let (sin, cos) = (2.0 * PI * f64::from(k) / f64::from(N)).sin_cos();
            mesh.vertices.push(centre + Vec3::new(cos, sin, 0.0) * 3.0);
            mesh.triangles.push([0, 1 + k, 1 + (k + 1) % N]);
        }
        let front = Front {
            sheet: 0,
            vertices: (1..=N).collect(),
            closed: true,
        };
        let sheet = Sheet {
            kerf: vec![0.0; mesh.vertices.len()],
            mesh,
            ..Default::default()
        };
        let crack = CrackSurface {
            sheets: vec![sheet],
        };
        (crack, vec![front])
    }

    fn block() -> (TetMesh, TetLocator) {
        let mesh = block_mesh(Vec3::repeat(-6.0), Vec3::repeat(6.0), [12, 12, 12]);
        let locator = TetLocator::new(&mesh);
        (mesh, locator)
    }

    /// Closed forms of a disc; the polygon with 720 corners is off by at most 3e-5.
    #[test]
    fn a_penny_by_its_closed_form() {
        let ((mesh, locator), (crack, fronts)) = (block(), penny());
        let sets = level_sets(&mesh, &locator, &crack, &fronts, REACH);
        let in_reach = |p: &Vec3| {
            let (rho, z) = ((p.x - 0.1).hypot(p.y + 0.2), p.z - 0.2);
            (rho - 3.0).max(0.0).hypot(z) < REACH - 1e-4
        };
        let expected = mesh.nodes().iter().filter(|p| in_reach(p)).count();
        assert!(sets.len() >= expected && expected > 200);
        for l in &sets {
            let p = &mesh.nodes()[l.node as usize];
            let (rho, z) = ((p.x - 0.1).hypot(p.y + 0.2), p.z - 0.2);
            let phi = [(rho - 3.0).max(0.0).hypot(z), (rho - 3.0).hypot(z), z];
            let found = [l.surface, l.front, l.offset];
            for (f, e) in found.iter().zip(&phi) {
                assert!((f - e).abs() < 1e-4, "{found:?} is not {phi:?} at {p}");
            }
            let (a, b) = l.front_coordinates();
            assert!((a - (rho - 3.0)).abs() < 2e-3 && (b - z).abs() < 1e-4);
        }
    }

    /// The classes agree with where the disc and its rim run.
    #[test]
    fn elements_are_cut_behind_the_front_only() {
        let ((mesh, locator), (crack, fronts)) = (block(), penny());
        let sets = level_sets(&mesh, &locator, &crack, &fronts, REACH);
        let mut counts = [0; 3];
        for t in 0..mesh.tets().len() as u32 {
            let x = mesh.corners(t as usize);
            let rho = x.map(|p| (p.x - 0.1).hypot(p.y + 0.2));
            let straddles = x.iter().any(|p| p.z > 0.2) && x.iter().any(|p| p.z < 0.2);
            let behind = rho.iter().filter(|r| **r < 3.0).count();
            let expected = match (straddles, behind) {
                (true, 4) => ElementClass::Cut,
                (true, 1..=3) => ElementClass::Front,
                _ => ElementClass::Uncut,
            };
            let found = element_class(&mesh, &sets, t);
            assert_eq!(found, expected, "tetrahedron {t}");
            counts[found as usize] += 1;
        }
        assert!(counts.iter().all(|c| *c > 20), "{counts:?}");
    }

    /// On a roof the distance is to the nearer slope on either side, and its sign is that of the side: the normals look up.
    #[test]
    fn a_kinked_sheet_keeps_its_sides() {
        let (mesh, locator) = block();
        let roof = TriMesh {
            vertices: vec![
                Vec3::new(-4.0, -9.0, -4.03),
                Vec3::new(0.03, -9.0, 0.0),
                Vec3::new(4.06, -9.0, -4.03),
                Vec3::new(-4.0, 9.0, -4.03),
                Vec3::new(0.03, 9.0, 0.0),
                Vec3::new(4.06, 9.0, -4.03),
            ],
            triangles: vec![[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
        };
        let crack = CrackSurface {
            sheets: vec![Sheet {
                kerf: vec![0.0; 6],
                mesh: roof,
                ..Default::default()
            }],
        };
        let sets = level_sets(&mesh, &locator, &crack, &[], REACH);
        let mut beside = 0;
        for l in sets.iter().filter(|l| !l.is_ahead) {
            let p = &mesh.nodes()[l.node as usize];
            // Below the ridge the slopes z = -|x - .03| are nearest square to them, above it the ridge itself may be.
            let (x, z) = ((p.x - 0.03).abs(), p.z);
            let below = (-z - x) / 2f64.sqrt();
            let above = if z > x { x.hypot(z) } else { -below };
            let expected = if z + x > 0.0 { above } else { -below };
            let found = l.offset;
            assert!(
                (found - expected).abs() < 1e-9,
                "{found} is not {expected} at {p}"
            );
            assert!(l.front.is_infinite());
            beside += 1;
        }
        assert!(beside > 300, "{beside}");
    }
}
