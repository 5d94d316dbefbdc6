//! Surfaces from files, and what makes a surface usable.
use crate::error::AnatomyError;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use rustc_hash::FxHashMap;

/// No surface may have more triangles than this.
pub const MAX_TRIANGLES: usize = 10_000_000;

/// A surface that may bound a solid: closed, manifold, outward, one piece; what was mended is in `notes`.
#[derive(Clone, Debug)]
pub struct ClosedSurface {
    /// The surface.
    pub mesh: TriMesh,
    /// What was mended, in words.
    pub notes: Vec<String>,
}

impl ClosedSurface {
    /// Checks a surface. A surface turned inside out is turned back and crumbs beside the largest piece are dropped, both with a note.
    ///
    /// # Errors
    /// [`AnatomyError`] for a surface that is empty, not finite, open, not manifold, not consistently oriented, or flat.
    pub fn new(mesh: TriMesh, name: &str) -> Result<Self, AnatomyError> {
        let mut notes = Vec::new();
        check_numbers(&mesh, name)?;
        check_edges(&mesh, name)?;
        let (mut mesh, dropped) = largest_piece(mesh);
        if dropped > 0 {
            notes.push(format!(
                "{name}: kept the largest of {} pieces",
                dropped + 1
            ));
        }
        let volume = mesh.volume();
        if volume < 0.0 {
            for t in &mut mesh.triangles {
                t.swap(1, 2);
            }
            notes.push(format!("{name}: the surface was inside out and was turned"));
        }
        // A cubic millimetre: less is a flat surface, or one in metres.
        if volume.abs() < 1.0 {
            let name = name.to_owned();
            return Err(AnatomyError::NoVolume { name, volume });
        }
        Ok(Self { mesh, notes })
    }

    /// Likewise of a surface that may have several pieces, such as a row of teeth: up to 64 all stay but those that enclose nothing, of
    /// more the largest.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_pieces(mesh: TriMesh, name: &str) -> Result<Self, AnatomyError> {
        const MOST: usize = 64;
        check_numbers(&mesh, name)?;
        check_edges(&mesh, name)?;
        if n_pieces(&mesh) > MOST {
            return Self::new(mesh, name);
        }
        let mut all = Self {
            mesh: TriMesh::default(),
            notes: Vec::new(),
        };
        let mut flat = None;
        for piece in split_pieces(&mesh) {
            match Self::new(piece, name) {
                Ok(one) => {
                    all.mesh.append(&one.mesh);
                    all.notes.extend(one.notes);
                }
                Err(error @ AnatomyError::NoVolume { .. }) => flat = Some(error),
                Err(error) => return Err(error),
            }
        }
        match flat {
            Some(error) if all.mesh.triangles.is_empty() => return Err(error),
            Some(_) => all
                .notes
                .push(format!("{name}: pieces without volume were left out")),
            None => {}
        }
        Ok(all)
    }
}

fn check_numbers(mesh: &TriMesh, name: &str) -> Result<(), AnatomyError> {
    if mesh.triangles.is_empty() {
        return Err(AnatomyError::EmptySurface {
            name: name.to_owned(),
        });
    }
    let finite = |p: &Vec3| p.iter().all(|c| c.is_finite());
    if let Some(vertex) = mesh.vertices.iter().position(|p| !finite(p)) {
        let name = name.to_owned();
        return Err(AnatomyError::NotFinite { name, vertex });
    }
    Ok(())
}

/// Edges by what is wrong with them, each list sorted.
pub(crate) struct EdgeFaults {
    /// With a triangle on one side only.
    pub open: Vec<[u32; 2]>,
    /// With more than two triangles.
    pub non_manifold: Vec<[u32; 2]>,
    /// Whose two triangles face opposite ways.
    pub misoriented: Vec<[u32; 2]>,
}

impl EdgeFaults {
    pub(crate) fn of(mesh: &TriMesh) -> Self {
        // Sorted, not hashed: half the memory for surfaces of millions of triangles, and the order is given.
        let mut edges: Vec<([u32; 2], bool)> = Vec::with_capacity(3 * mesh.triangles.len());
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                edges.push(([a.min(b), a.max(b)], a > b));
            }
        }
        edges.sort_unstable();
        let mut faults = Self {
            open: Vec::new(),
            non_manifold: Vec::new(),
            misoriented: Vec::new(),
        };
        for uses in edges.chunk_by(|a, b| a.0 == b.0) {
            let edge = uses[0].0;
            match uses {
                [_] => faults.open.push(edge),
                [a, b] if a.1 == b.1 => faults.misoriented.push(edge),
                [_, _] => {}
                _ => faults.non_manifold.push(edge),
            }
        }
        faults
    }
}

fn check_edges(mesh: &TriMesh, name: &str) -> Result<(), AnatomyError> {
    let faults = EdgeFaults::of(mesh);
    let name = name.to_owned();
    let middle = |e: &[u32; 2]| (mesh.vertices[e[0] as usize] + mesh.vertices[e[1] as usize]) * 0.5;
    let first = |edges: &[[u32; 2]]| edges.first().map(|e| (edges.len(), middle(e)));
    if let Some((n_edges, near)) = first(&faults.non_manifold) {
        return Err(AnatomyError::NonManifold {
            name,
            n_edges,
            near,
        });
    }
    if let Some((n_edges, near)) = first(&faults.open) {
        return Err(AnatomyError::OpenSurface {
            name,
            n_edges,
            near,
        });
    }
    if let Some((n_edges, near)) = first(&faults.misoriented) {
        return Err(AnatomyError::Orientation {
            name,
            n_edges,
            near,
        });
    }
    Ok(())
}

/// The connected piece that encloses most, without loose vertices, and how many others there were.
fn largest_piece(mesh: TriMesh) -> (TriMesh, usize) {
    let pieces = pieces(&mesh);
    let n = pieces.iter().max().map_or(0, |n| *n as usize + 1);
    let mut volumes = vec![0.0; n];
    for (t, piece) in pieces.iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        volumes[*piece as usize] += a.dot(&b.cross(&c));
    }
    let larger = |a: &usize, b: &usize| {
        volumes[*a]
            .abs()
            .total_cmp(&volumes[*b].abs())
            .then(b.cmp(a))
    };
    let Some(keep) = (0..n).max_by(larger) else {
        return (mesh, 0);
    };
    if n == 1 {
        return (compact(&mesh.vertices, &mesh.triangles), 0);
    }
    (piece(&mesh, &pieces, keep as u32), n - 1)
}

/// All connected pieces, in the order of their first vertices.
pub(crate) fn split_pieces(mesh: &TriMesh) -> Vec<TriMesh> {
    let pieces = pieces(mesh);
    let n = pieces.iter().max().map_or(0, |n| *n + 1);
    (0..n).map(|k| piece(mesh, &pieces, k)).collect()
}

/// How many pieces share no vertex.
pub(crate) fn n_pieces(mesh: &TriMesh) -> usize {
    pieces(mesh).iter().max().map_or(0, |n| *n as usize + 1)
}

fn piece(mesh: &TriMesh, pieces: &[u32], keep: u32) -> TriMesh {
    let kept: Vec<_> = mesh
        .triangles
        .iter()
        .zip(pieces)
        .filter(|(_, p)| **p == keep)
        .map(|(t, _)| *t)
        .collect();
    compact(&mesh.vertices, &kept)
}

/// The number of each triangle's piece, counted in the order of their first vertices.
fn pieces(mesh: &TriMesh) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for t in &mesh.triangles {
        for k in 1..3 {
            let (a, b) = (root(&mut parent, t[0]), root(&mut parent, t[k]));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let roots: Vec<u32> = mesh
        .triangles
        .iter()
        .map(|t| root(&mut parent, t[0]))
        .collect();
    let mut names = roots.clone();
    names.sort_unstable();
    names.dedup();
    let name = |r: &u32| names.binary_search(r).map_or(0, |i| i as u32);
    roots.iter().map(name).collect()
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

/// The mesh of the given triangles with unused vertices left out, order kept.
pub(crate) fn compact(vertices: &[Vec3], triangles: &[[u32; 3]]) -> TriMesh {
    let mut index = vec![u32::MAX; vertices.len()];
    for v in triangles.iter().flatten() {
        index[*v as usize] = 0;
    }
    let mut out = Vec::new();
    for (v, i) in index.iter_mut().enumerate() {
        if *i == 0 {
            *i = out.len() as u32;
            out.push(vertices[v]);
        }
    }
    TriMesh {
        vertices: out,
        triangles: triangles
            .iter()
            .map(|t| t.map(|v| index[v as usize]))
            .collect(),
    }
}

/// What a reader found, checked: every triangle names vertices that are there and are finite; triangles with two equal corners
/// and loose vertices are left out.
pub(crate) fn checked_surface(
    mut mesh: TriMesh,
    name: &str,
    format: &'static str,
) -> Result<TriMesh, AnatomyError> {
    let n = mesh.vertices.len();
    let is_missing = |v: &&u32| **v as usize >= n;
    if let Some(v) = mesh.triangles.iter().flatten().find(is_missing) {
        return Err(AnatomyError::Format {
            path: name.to_owned(),
            format,
            reason: format!("a face names vertex {v}, counted from 0, but there are only {n}"),
        });
    }
    mesh.triangles
        .retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    check_numbers(&mesh, name)?;
    Ok(compact(&mesh.vertices, &mesh.triangles))
}

/// Joins equal corners of loose triangles into shared vertices; triangles with two equal corners are dropped.
pub(crate) fn weld(corners: &[[Vec3; 3]]) -> TriMesh {
    let mut index: FxHashMap<[u64; 3], u32> = FxHashMap::default();
    let mut mesh = TriMesh::default();
    for triangle in corners {
        let t = triangle.map(|p| {
            // Adding zero makes -0 and +0 the same key.
            let key = [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits());
            *index.entry(key).or_insert_with(|| {
                mesh.vertices.push(p);
                mesh.vertices.len() as u32 - 1
            })
        });
        if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            mesh.triangles.push(t);
        }
    }
    mesh
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn tetrahedron() -> TriMesh {
        TriMesh {
            vertices: vec![
                Vec3::zeros(),
                Vec3::x() * 10.0,
                Vec3::y() * 10.0,
                Vec3::z() * 10.0,
            ],
            triangles: vec![[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]],
        }
    }

    fn refusal(mesh: TriMesh) -> String {
        ClosedSurface::new(mesh, "jaw.stl").unwrap_err().to_string()
    }

    #[test]
    fn closed_surface_passes_and_inside_out_is_turned() {
        let good = ClosedSurface::new(tetrahedron(), "jaw").unwrap();
        assert!(good.notes.is_empty());
        let mut flipped = tetrahedron();
        flipped.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let mended = ClosedSurface::new(flipped, "jaw").unwrap();
        assert!(mended.mesh.volume() > 0.0 && mended.notes.len() == 1);
    }

    #[test]
    fn all_pieces_stay_each_turned_outward() {
        let (mut two, mut second) = (tetrahedron(), tetrahedron());
        second.vertices.iter_mut().for_each(|p| p.x += 20.0);
        second.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let mut crumb = tetrahedron();
        crumb
            .vertices
            .iter_mut()
            .for_each(|p| *p = *p * 0.1 - Vec3::x() * 9.0);
        two.append(&second);
        two.append(&crumb);
        let closed = ClosedSurface::of_pieces(two, "teeth").unwrap();
        let volume = 2.0 * tetrahedron().volume();
        assert!((closed.mesh.volume() - volume).abs() < 1e-9);
        assert_eq!(closed.notes.len(), 2, "{:?}", closed.notes);
        assert!(ClosedSurface::of_pieces(crumb, "teeth").is_err());
    }

    #[test]
    fn each_fault_is_named_with_its_place() {
        let mut open = tetrahedron();
        open.triangles.pop();
        assert_eq!(
            refusal(open),
            "jaw.stl is an open surface: 3 border edges, the first near (5.0, 0.0, 0.0); close the holes"
        );
        let mut crooked = tetrahedron();
        crooked.triangles[0].swap(0, 1);
        assert!(refusal(crooked).contains("3 edges whose two triangles face opposite ways"));
        let mut doubled = tetrahedron();
        doubled.triangles.push([0, 2, 1]);
        assert!(refusal(doubled).contains("not manifold: 3 edges"));
        let mut holed = tetrahedron();
        holed.vertices[2].y = f64::NAN;
        assert!(refusal(holed).contains("vertex 2 has a coordinate that is not a finite number"));
        assert!(refusal(TriMesh::default()).contains("no triangles"));
        let mut tiny = tetrahedron();
        tiny.vertices.iter_mut().for_each(|v| *v *= 1e-3);
        assert!(refusal(tiny).contains("encloses no volume"));
    }

    #[test]
    fn crumbs_are_dropped_with_a_note() {
        let mut mesh = tetrahedron();
        let crumb = tetrahedron();
        let n = mesh.vertices.len() as u32;
        mesh.vertices
            .extend(crumb.vertices.iter().map(|v| (v * 0.2).add_scalar(50.0)));
        mesh.triangles
            .extend(crumb.triangles.iter().map(|t| t.map(|v| v + n)));
        let kept = ClosedSurface::new(mesh, "jaw").unwrap();
        assert_eq!(kept.mesh, tetrahedron());
        assert_eq!(kept.notes, ["jaw: kept the largest of 2 pieces"]);
    }
}
