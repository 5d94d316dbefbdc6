//! From the case to the body: mesh, materials, supports, crack, loads.
use super::case::{Case, Load, Place};
use anyhow::{Context, Result, anyhow, bail, ensure};
use osteotome_anatomy::msh::{MeshFile, PhysicalGroup, read_msh};
use osteotome_anatomy::sheets::read_sheets;
use osteotome_anatomy::vtu::read_vtu;
use osteotome_mechanics::bone::{Prescribed, Supports, TetMaterial, free_motion};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{
    CrackSurface, CrackedBody, CutEdges, LoadKind, SMALLEST_FRAGMENT, Sheet, Solid, SurfaceLoad,
};
use osteotome_mechanics::geometry::{Aabb, MeshDistance, TetLocator, TetMesh, TriMesh, Vec3};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A problem ready to be solved.
pub struct Problem {
    /// The body with the crack it starts from.
    pub body: CrackedBody,
    /// What acts on it.
    pub loads: Vec<SurfaceLoad>,
}

/// Most nodes of a mesh: beyond it the factor of one step would take tens of gigabytes.
const MAX_NODES: usize = 200_000;
/// Largest kink in one step \[rad\]: about where the series of the kinked release ends.
const MAX_KINK: f64 = 1.4;

impl Problem {
    /// Reads the files of a case.
    ///
    /// # Errors
    /// One line: where, what, and what would be right.
    pub fn read(case: &Case) -> Result<Self> {
        let file = read_mesh(case)?;
        let mesh = &file.mesh;
        let materials = materials(case, &file)?;
        let supports = supports(case, &file)?;
        let loads = loads(case, &file)?;
        let locator = TetLocator::new(mesh);
        let (crack, h) = crack(case, mesh, &locator)?;
        let usual = GrowthLengths::for_element_size(h);
        let growth = case.growth.as_ref();
        let lengths = GrowthLengths {
            max_kink: MAX_KINK,
            increment: growth.and_then(|g| g.increment).unwrap_or(usual.increment),
            twist: growth.map_or(0.0, |g| g.twist),
            criterion: growth.map_or(usual.criterion, |g| g.criterion.criterion()),
            ..usual
        };
        let solid = Arc::new(Solid {
            locator,
            materials,
            supports,
            lengths,
            mesh: file.mesh,
        });
        check_held(&solid)?;
        let body = CrackedBody::new(solid, crack)?;
        check_pieces(&body)?;
        Ok(Self { body, loads })
    }
}

fn read_mesh(case: &Case) -> Result<MeshFile> {
    let path = &case.mesh.file;
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    let file = match extension.to_ascii_lowercase().as_str() {
        "msh" => read_msh(path),
        "vtu" => read_vtu(path),
        _ => bail!(
            "mesh.file: {}: \".{extension}\" is not known; give a Gmsh .msh or a VTK .vtu file",
            path.display()
        ),
    };
    let file = file.context("mesh.file")?;
    let n = file.mesh.nodes().len();
    ensure!(
        n <= MAX_NODES,
        "mesh.file: {}: {n} nodes are too many; at most {MAX_NODES} can be used",
        path.display()
    );
    Ok(file)
}

fn is_named(group: &PhysicalGroup, name: &str) -> bool {
    group.name == name || group.id.to_string() == name
}

fn known<'a>(groups: impl Iterator<Item = &'a PhysicalGroup>) -> String {
    const MANY: usize = 12;
    let names: Vec<String> = groups
        .map(|g| {
            if g.name.is_empty() {
                format!("\"{}\"", g.id)
            } else {
                format!("\"{}\"", g.name)
            }
        })
        .collect();
    if names.is_empty() {
        "it has none".to_owned()
    } else {
        let dots = if names.len() > MANY { ", ..." } else { "" };
        format!("it has {}{dots}", names[..names.len().min(MANY)].join(", "))
    }
}

fn materials(case: &Case, file: &MeshFile) -> Result<Vec<TetMaterial>> {
    let mut of_tet = vec![None; file.mesh.tets().len()];
    for (i, m) in case.material.iter().enumerate() {
        let is_here = |volume: Option<u32>| {
            m.region == "*"
                || volume.is_some_and(|v| is_named(&file.volumes[v as usize], &m.region))
        };
        let mut found = false;
        for (t, &volume) in file.tet_volume.iter().enumerate() {
            if is_here(volume) {
                let centre = file.mesh.corners(t).iter().sum::<Vec3>() / 4.0;
                let material = m.at(&centre);
                of_tet[t] = Some(material.with_context(|| format!("material.{i}.axes"))?);
                found = true;
            }
        }
        ensure!(
            found,
            "material.{i}.region: the mesh has no volume \"{}\"; {} (\"*\" for all)",
            m.region,
            known(file.volumes.iter())
        );
    }
    if let Some(t) = of_tet.iter().position(Option::is_none) {
        let region = file.tet_volume[t].map_or("outside every physical volume".to_owned(), |v| {
            let g = &file.volumes[v as usize];
            format!("in volume \"{}\" ({})", g.name, g.id)
        });
        bail!(
            "material: tetrahedron {t}, {region}, has none; give a [[material]] for it, or one with region = \"*\" before the others"
        );
    }
    Ok(of_tet.into_iter().flatten().collect())
}

/// A box that takes in what lies on its faces but for round-off.
fn region(bounds: &[[f64; 3]; 2], mesh: &TetMesh) -> Aabb {
    let [a, b] = bounds.map(Vec3::from);
    let body = mesh.bounds();
    Aabb {
        min: a.inf(&b),
        max: a.sup(&b),
    }
    .grown(1e-9 * (body.max - body.min).norm())
}

fn surface<'a>(file: &'a MeshFile, key: &str, name: &str) -> Result<&'a [[u32; 3]]> {
    let found = file.surfaces.iter().find(|s| is_named(&s.0, name));
    found.map(|s| s.1.as_slice()).ok_or_else(|| {
        anyhow!(
            "{key}.surface: the mesh has no surface \"{name}\"; {}, or give a box",
            known(file.surfaces.iter().map(|s| &s.0))
        )
    })
}

fn show(b: &Aabb) -> String {
    let point = |p: &Vec3| format!("({:.6}, {:.6}, {:.6})", p.x, p.y, p.z);
    format!("{} to {}", point(&b.min), point(&b.max))
}

fn nodes_of(file: &MeshFile, key: &str, place: &Place) -> Result<Vec<u32>> {
    let mesh = &file.mesh;
    if let Some(name) = &place.surface {
        return Ok(surface(file, key, name)?
            .iter()
            .flatten()
            .copied()
            .collect());
    }
    let bounds = region(&place.bounds.unwrap_or_default(), mesh);
    let inside = (0u32..)
        .zip(mesh.nodes())
        .filter(|(_, p)| bounds.contains(p));
    let nodes: Vec<u32> = inside.map(|(i, _)| i).collect();
    ensure!(
        !nodes.is_empty(),
        "{key}.box: no node lies in it; the body spans {}",
        show(&mesh.bounds())
    );
    Ok(nodes)
}

fn supports(case: &Case, file: &MeshFile) -> Result<Supports> {
    let mut held: BTreeMap<(u32, u8), f64> = BTreeMap::new();
    for (i, s) in case.support.iter().enumerate() {
        for node in nodes_of(file, &format!("support.{i}.where"), &s.place)? {
            for (axis, value) in (0u8..).zip(s.fix.axes()) {
                held.extend(value.map(|v| ((node, axis), v)));
            }
        }
    }
    let prescribed = held
        .into_iter()
        .map(|((node, axis), value)| Prescribed { node, axis, value })
        .collect();
    Ok(Supports {
        prescribed,
        ..Default::default()
    })
}

fn loads(case: &Case, file: &MeshFile) -> Result<Vec<SurfaceLoad>> {
    let mesh = &file.mesh;
    let sorted = |f: &[u32; 3]| {
        let mut key = *f;
        key.sort_unstable();
        key
    };
    let faces_of = |key: &str, place: &Place| -> Result<Vec<u32>> {
        let faces = (0u32..).zip(mesh.boundary_faces());
        if let Some(name) = &place.surface {
            let mut wanted: Vec<_> = surface(file, key, name)?.iter().map(sorted).collect();
            wanted.sort_unstable();
            let is_wanted = |f: &[u32; 3]| wanted.binary_search(&sorted(f)).is_ok();
            let found: Vec<u32> = faces.filter(|(_, f)| is_wanted(f)).map(|f| f.0).collect();
            ensure!(
                !found.is_empty(),
                "{key}.surface: \"{name}\" lies inside the body; a load needs faces on its boundary"
            );
            return Ok(found);
        }
        let bounds = region(&place.bounds.unwrap_or_default(), mesh);
        let centroid =
            |f: &[u32; 3]| f.iter().map(|n| mesh.nodes()[*n as usize]).sum::<Vec3>() / 3.0;
        let found: Vec<u32> = faces
            .filter(|(_, f)| bounds.contains(&centroid(f)))
            .map(|f| f.0)
            .collect();
        ensure!(
            !found.is_empty(),
            "{key}.box: no boundary face has its centroid in it; the body spans {}",
            show(&mesh.bounds())
        );
        Ok(found)
    };
    let one = |(i, l): (usize, &Load)| -> Result<SurfaceLoad> {
        let faces = faces_of(&format!("load.{i}.where"), &l.place)?;
        let kind = match (l.traction, l.force, &l.torque) {
            (Some(t), _, _) => LoadKind::Traction(t.into()),
            (_, Some(f), _) => LoadKind::Force(f.into()),
            (_, _, Some(t)) => {
                let kind = LoadKind::Torque {
                    axis: Vec3::from(t.axis).normalize(),
                    origin: t.origin.into(),
                    moment: t.moment,
                };
                check_arm(mesh, &faces, &kind).with_context(|| format!("load.{i}.torque"))?;
                kind
            }
            _ => bail!("load.{i}: no kind is given"),
        };
        Ok(SurfaceLoad { faces, kind })
    };
    case.load.iter().enumerate().map(one).collect()
}

/// A torque needs faces beside its axis.
fn check_arm(mesh: &TetMesh, faces: &[u32], kind: &LoadKind) -> Result<()> {
    let LoadKind::Torque { axis, origin, .. } = kind else {
        return Ok(());
    };
    let arm = |n: &u32| axis.cross(&(mesh.nodes()[*n as usize] - origin)).norm();
    let nodes = faces
        .iter()
        .flat_map(|&f| &mesh.boundary_faces()[f as usize]);
    let longest = nodes.map(arm).fold(0.0, f64::max);
    let size = mesh.bounds();
    ensure!(
        longest > 1e-9 * (size.max - size.min).norm(),
        "all its faces lie on the axis; move origin or choose other faces"
    );
    Ok(())
}

/// The crack as sheets ready for mechanics, and the element size near its fronts.
fn crack(case: &Case, mesh: &TetMesh, locator: &TetLocator) -> Result<(CrackSurface, f64)> {
    let Some(section) = &case.crack else {
        return Ok((CrackSurface::default(), mesh.mean_edge_length()));
    };
    let parts = read_sheets(&section.surface).context("crack.surface")?;
    let Some(h) = size_near_cuts(mesh, locator, &parts) else {
        let mut all = TriMesh::default();
        parts.iter().for_each(|p| all.append(p));
        bail!(
            "crack.surface: {}: it crosses no edge of the mesh; it spans {}, the body {}",
            section.surface.display(),
            show(&all.bounds()),
            show(&mesh.bounds())
        );
    };
    let boundary = MeshDistance::new(TriMesh {
        vertices: mesh.nodes().to_vec(),
        triangles: mesh.boundary_faces().to_vec(),
    });
    let sheet = |(i, part): (usize, TriMesh)| {
        let mut part = with_fine_border(part, 0.5 * h);
        lead_out(&mut part, &boundary, h);
        Sheet {
            name: format!("sheet {i}"),
            kerf: vec![0.0; part.vertices.len()],
            mesh: part,
            lead: TriMesh::default(),
        }
    };
    let crack = CrackSurface {
        sheets: parts.into_iter().enumerate().map(sheet).collect(),
    };
    let h = size_near_fronts(mesh, locator, &crack, h).unwrap_or(h);
    Ok((crack, h))
}

fn mean_edge(mesh: &TetMesh, edges: impl Iterator<Item = u32>) -> Option<f64> {
    let (mut n, mut sum) = (0.0, 0.0);
    for e in edges {
        n += 1.0;
        sum += mesh.edge_vector(&mesh.edges()[e as usize]).norm();
    }
    (n > 0.0).then(|| sum / n)
}

/// Mean edge length of the tetrahedra that the sheets cut; `None` if they cut nothing.
fn size_near_cuts(mesh: &TetMesh, locator: &TetLocator, parts: &[TriMesh]) -> Option<f64> {
    let mut cuts = CutEdges::new(mesh);
    for p in parts {
        cuts.cut(mesh, locator, p, 1);
    }
    let near = mesh.tet_edges().iter();
    let mut edges: Vec<u32> = near
        .filter(|edges| edges.iter().any(|e| cuts.is_cut(*e)))
        .flatten()
        .copied()
        .collect();
    edges.sort_unstable();
    edges.dedup();
    mean_edge(mesh, edges.into_iter())
}

/// Mean length of the edges within two element sizes of a front.
fn size_near_fronts(
    mesh: &TetMesh,
    locator: &TetLocator,
    crack: &CrackSurface,
    h: f64,
) -> Option<f64> {
    let lengths = GrowthLengths::for_element_size(h);
    let mut near = vec![false; mesh.nodes().len()];
    for front in crack.fronts(mesh, locator, lengths.stick()) {
        for v in front.vertices {
            let p = crack.sheets[front.sheet].mesh.vertices[v as usize];
            let reach = Aabb { min: p, max: p }.grown(2.0 * h);
            locator.tets_near(&reach, |t| {
                for &n in &mesh.tets()[t as usize] {
                    near[n as usize] |= (mesh.nodes()[n as usize] - p).norm() <= 2.0 * h;
                }
            });
        }
    }
    let edges = (0u32..).zip(mesh.edges());
    let inside = edges.filter(|(_, e)| e.iter().all(|n| near[*n as usize]));
    mean_edge(mesh, inside.map(|e| e.0))
}

/// Splits border edges into parts no longer than `spacing`, so that a front has stations enough.
fn with_fine_border(mut sheet: TriMesh, spacing: f64) -> TriMesh {
    /// A front of more vertices says no more.
    const MOST_PARTS: f64 = 2000.0;
    for [a, b] in sheet.border_edges() {
        let [p, q] = [a, b].map(|v| sheet.vertices[v as usize]);
        let n = ((q - p).norm() / spacing).ceil().clamp(1.0, MOST_PARTS) as u32;
        let holds = |t: &[u32; 3]| (0..3).find(|&k| t[k] == a && t[(k + 1) % 3] == b);
        let Some((t, k)) = (0..sheet.triangles.len())
            .find_map(|t| holds(&sheet.triangles[t]).map(|k| (t, k)))
            .filter(|_| n > 1)
        else {
            continue;
        };
        let apex = sheet.triangles[t][(k + 2) % 3];
        let mut last = a;
        for i in 1..=n {
            let next = if i == n {
                b
            } else {
                let w = f64::from(i) / f64::from(n);
                sheet.vertices.push(p * (1.0 - w) + q * w);
                sheet.vertices.len() as u32 - 1
            };
            if i == 1 {
                sheet.triangles[t] = [last, next, apex];
            } else {
                sheet.triangles.push([last, next, apex]);
            }
            last = next;
        }
    }
    sheet
}

/// Leads a border that runs along the body's faces half an element size out of it: it is no front, and nothing must stay
/// uncut beside it.
fn lead_out(sheet: &mut TriMesh, boundary: &MeshDistance, h: f64) {
    let at = |v: u32| sheet.vertices[v as usize];
    let is_near = |p: &Vec3| boundary.closest_within(p, 0.1 * h).is_some();
    let mut edges = Vec::new();
    let mut outward: BTreeMap<u32, Vec3> = BTreeMap::new();
    for [a, b] in sheet.border_edges() {
        let middle = (at(a) + at(b)) * 0.5;
        if !(is_near(&at(a)) && is_near(&at(b)) && is_near(&middle)) {
            continue;
        }
        let holds = |t: &&[u32; 3]| (0..3).any(|k| t[k] == a && t[(k + 1) % 3] == b);
        let Some(&[i, j, k]) = sheet.triangles.iter().find(holds) else {
            continue;
        };
        let normal = (at(j) - at(i)).cross(&(at(k) - at(i)));
        let Some(out) = (at(b) - at(a)).cross(&normal).try_normalize(1e-300) else {
            continue;
        };
        edges.push([a, b]);
        for v in [a, b] {
            *outward.entry(v).or_default() += out;
        }
    }
    let mut beyond: BTreeMap<u32, u32> = BTreeMap::new();
    for (v, out) in outward {
        let out = out.try_normalize(1e-9).unwrap_or_default();
        beyond.insert(v, sheet.vertices.len() as u32);
        sheet.vertices.push(at_vertex(sheet, v) + out * (0.5 * h));
    }
    for [a, b] in edges {
        let (c, d) = (beyond[&a], beyond[&b]);
        sheet.triangles.push([b, a, c]);
        sheet.triangles.push([b, c, d]);
    }
}

fn at_vertex(sheet: &TriMesh, v: u32) -> Vec3 {
    sheet.vertices[v as usize]
}

/// The uncut body, or each part of it if it has several, must be held.
fn check_held(solid: &Solid) -> Result<()> {
    let mut parts = CutEdges::new(&solid.mesh).components(&solid.mesh);
    let mut nodes: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
    for i in 0..solid.mesh.nodes().len() {
        nodes.entry(parts.find(i)).or_default().push(i as u32);
    }
    let n = nodes.len();
    for part in nodes.values() {
        if let Some(motion) = free_motion(&solid.mesh, &solid.supports, part) {
            let which = if n == 1 {
                "the body".to_owned()
            } else {
                let at = solid.mesh.nodes()[part[0] as usize];
                format!(
                    "the part of the mesh near ({:.3}, {:.3}, {:.3})",
                    at.x, at.y, at.z
                )
            };
            bail!(
                "support: {which} is not held: nothing stops it from {motion}; fix more nodes or axes"
            );
        }
    }
    Ok(())
}

/// The crack must not cut off a piece that nothing holds.
fn check_pieces(body: &CrackedBody) -> Result<()> {
    for &f in &body.loose {
        let share = body.fragments.volume_share[f as usize];
        ensure!(
            share < SMALLEST_FRAGMENT,
            "crack.surface: it cuts off a piece of {:.1} % of the volume that no [[support]] holds; hold it or shorten the crack",
            100.0 * share
        );
    }
    Ok(())
}
