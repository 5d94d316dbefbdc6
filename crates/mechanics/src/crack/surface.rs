use crate::geometry::{
    Aabb, TetLocator, TetMesh, TriMesh, Vec3, closest_on_triangle, segment_crosses,
};
use rustc_hash::FxHashMap;

/// One sheet of the explicit crack representation (ECR): a saw cut, or a saw cut with the fracture that grew from it.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// What it is, in the surgeon's words.
    pub name: String,
    /// Its triangles; their normals look to the sheet's positive side. May reach out of the body.
    pub mesh: TriMesh,
    /// Half the width of the kerf at each vertex \[mm\]: positive where the saw passed, zero where the bone broke.
    pub kerf: Vec<f64>,
    /// What mechanics has cut ahead of its saw fronts: other sheets end on it as on the sheet itself.
    pub lead: TriMesh,
}

/// A point of a sawn line: where the saw enters, which way it goes, and how deep \[mm\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    /// On the bone's surface.
    pub at: Vec3,
    /// Unit direction into the bone.
    pub toward: Vec3,
    /// Depth of the cut.
    pub depth: f64,
}

impl Sheet {
    /// The ribbon that a saw leaves along a line of at least two points, from `outside` \[mm\] above the surface to its depth.
    ///
    /// Both ends are led on by `overlap` \[mm\], so that neighbouring cuts cross instead of leaving a pin-hole.
    pub fn ribbon(name: &str, line: &[LinePoint], kerf: f64, outside: f64, overlap: f64) -> Self {
        let n = line.len();
        let led_on = |end: &LinePoint, before: &LinePoint| LinePoint {
            at: end.at + (end.at - before.at).try_normalize(1e-9).unwrap_or_default() * overlap,
            ..*end
        };
        let mut points = vec![led_on(&line[0], &line[1])];
        points.extend_from_slice(line);
        points.push(led_on(&line[n - 1], &line[n - 2]));
        let mut mesh = TriMesh::default();
        for p in &points {
            mesh.vertices.push(p.at - p.toward * outside);
            mesh.vertices.push(p.at + p.toward * p.depth);
        }
        for k in 0..points.len() as u32 - 1 {
            let [a, b, c, d] = [2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3];
            mesh.triangles.push([a, b, c]);
            mesh.triangles.push([c, b, d]);
        }
        let kerf = vec![0.5 * kerf; mesh.vertices.len()];
        Self {
            name: name.to_owned(),
            mesh,
            kerf,
            lead: TriMesh::default(),
        }
    }

    /// The point of the sheet closest to `p`: distance, triangle, barycentric coordinates.
    pub fn closest(&self, p: &Vec3) -> Option<(f64, usize, [f64; 3])> {
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        for t in 0..self.mesh.triangles.len() {
            let corners = self.mesh.corners(t);
            let reach = best.map_or(f64::INFINITY, |b| b.0);
            if Aabb::around(&corners).distance_squared(p) >= reach * reach {
                continue;
            }
            let w = closest_on_triangle(p, &corners);
            let foot: Vec3 = (0..3).map(|k| corners[k] * w[k]).sum();
            let distance = (p - foot).norm();
            if distance < reach {
                best = Some((distance, t, w));
            }
        }
        best
    }

    /// The point of the sheet closest to `p`, if it is closer than `reach`.
    pub fn closest_within(&self, p: &Vec3, reach: f64) -> Option<Vec3> {
        let triangles = (0..self.mesh.triangles.len()).map(|t| self.mesh.corners(t));
        triangles
            .filter_map(|corners| foot_within(p, &corners, reach))
            .min_by(|a, b| (a - p).norm().total_cmp(&(b - p).norm()))
    }

    /// The sheet's triangles and those of its lead.
    fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> {
        let corners = |m: &'_ TriMesh, t: usize| m.corners(t);
        let own = (0..self.mesh.triangles.len()).map(move |t| corners(&self.mesh, t));
        own.chain((0..self.lead.triangles.len()).map(move |t| corners(&self.lead, t)))
    }

    /// Whether some point of the sheet or of its lead is closer to `p` than `reach`.
    pub fn is_near(&self, p: &Vec3, reach: f64) -> bool {
        self.triangles()
            .any(|corners| foot_within(p, &corners, reach).is_some())
    }

    /// Share of the way from `p` to `q` at which the sheet or its lead is first crossed.
    pub fn first_crossing(&self, p: &Vec3, q: &Vec3) -> Option<f64> {
        let path = Aabb::around(&[*p, *q]);
        self.triangles()
            .filter(|corners| Aabb::around(corners).overlaps(&path))
            .filter_map(|corners| segment_crosses(p, q, &corners))
            .min_by(f64::total_cmp)
    }
}

/// The point of a triangle closest to `p`, if it is closer than `reach`.
fn foot_within(p: &Vec3, corners: &[Vec3; 3], reach: f64) -> Option<Vec3> {
    let foot = || {
        let w = closest_on_triangle(p, corners);
        (0..3).map(|k| corners[k] * w[k]).sum::<Vec3>()
    };
    let near = Aabb::around(corners).grown(reach).contains(p);
    near.then(foot).filter(|foot| (foot - p).norm() < reach)
}

/// A piece of crack front: consecutive border vertices of a sheet, in the sense of the sheet's own border.
#[derive(Clone, Debug, PartialEq)]
pub struct Front {
    /// Which sheet.
    pub sheet: usize,
    /// At least two vertices; a closed front repeats none.
    pub vertices: Vec<u32>,
    /// Whether the last vertex joins the first.
    pub closed: bool,
}

/// All sheets of the crack.
#[derive(Clone, Debug, Default)]
pub struct CrackSurface {
    /// Sheets; they may cross each other and reach out of the body.
    pub sheets: Vec<Sheet>,
}

impl CrackSurface {
    /// Whether `p` lies closer than `reach` to any sheet but `sheet`.
    pub fn touches_other(&self, sheet: usize, p: &Vec3, reach: f64) -> bool {
        self.others(sheet).any(|s| s.is_near(p, reach))
    }

    /// Share of the way from `p` to `q` at which a sheet other than `sheet` is first crossed.
    pub fn first_crossing_of_other(&self, sheet: usize, p: &Vec3, q: &Vec3) -> Option<f64> {
        self.others(sheet)
            .filter_map(|s| s.first_crossing(p, q))
            .min_by(f64::total_cmp)
    }

    fn others(&self, sheet: usize) -> impl Iterator<Item = &Sheet> {
        self.sheets
            .iter()
            .enumerate()
            .filter(move |(k, _)| *k != sheet)
            .map(|(_, s)| s)
    }

    /// The crack fronts: chains of border edges that run inside the body and not along another sheet.
    ///
    /// Nothing is remembered from growth to growth, so fronts may split, meet, leave the body or end on other sheets.
    /// `stick`: a border closer than this to another sheet has arrived there \[mm\].
    pub fn fronts(&self, mesh: &TetMesh, locator: &TetLocator, stick: f64) -> Vec<Front> {
        let mut fronts = Vec::new();
        for (sheet, s) in self.sheets.iter().enumerate() {
            let next: FxHashMap<u32, u32> =
                s.mesh.border_edges().iter().map(|e| (e[0], e[1])).collect();
            let at = |v: u32| s.mesh.vertices[v as usize];
            let arrived = |v: u32| self.touches_other(sheet, &at(v), stick);
            let is_active = |e: &[u32; 2]| {
                let middle = (at(e[0]) + at(e[1])) * 0.5;
                locator.find(mesh, &middle).is_some() && !self.touches_other(sheet, &middle, stick)
            };
            let mut active: Vec<[u32; 2]> = s
                .mesh
                .border_edges()
                .into_iter()
                .filter(is_active)
                .collect();
            active.retain(|e| next.get(&e[0]) == Some(&e[1]));
            let previous: FxHashMap<u32, u32> = next.iter().map(|(a, b)| (*b, *a)).collect();
            // An open chain must not end inside the body: its ends have to run along the face or the other sheet.
            let is_loose =
                |v: u32| locator.find_near(mesh, &at(v), 0.2 * stick).is_some() && !arrived(v);
            for (mut vertices, closed) in chains(&active) {
                if !closed {
                    let [first, last] = [vertices[0], vertices[vertices.len() - 1]];
                    let onward = |v: u32, map: &FxHashMap<u32, u32>| {
                        map.get(&v).copied().filter(|_| is_loose(v))
                    };
                    vertices.extend(onward(last, &next).filter(|v| *v != first));
                    if let Some(v) = onward(first, &previous).filter(|v| !vertices.contains(v)) {
                        vertices.insert(0, v);
                    }
                }
                fronts.push(Front {
                    sheet,
                    vertices,
                    closed,
                });
            }
        }
        fronts
    }
}

/// Joins directed edges into chains, each started at its smallest free beginning.
fn chains(edges: &[[u32; 2]]) -> Vec<(Vec<u32>, bool)> {
    let next: FxHashMap<u32, u32> = edges.iter().map(|e| (e[0], e[1])).collect();
    let ends: FxHashMap<u32, u32> = edges.iter().map(|e| (e[1], e[0])).collect();
    let mut used: FxHashMap<u32, bool> = FxHashMap::default();
    let open = edges
        .iter()
        .filter(|e| !ends.contains_key(&e[0]))
        .map(|e| (e[0], false));
    let closed = edges.iter().map(|e| (e[0], true));
    let mut found = Vec::new();
    for (start, is_loop) in open.chain(closed) {
        if used.contains_key(&start) {
            continue;
        }
        let mut chain = vec![start];
        used.insert(start, true);
        let mut v = start;
        while let Some(&w) = next.get(&v) {
            if w == start || used.contains_key(&w) {
                break;
            }
            used.insert(w, true);
            chain.push(w);
            v = w;
        }
        if chain.len() > 1 {
            found.push((chain, is_loop));
        }
    }
    found
}
