//! Meshes the parametric mandible, or a given STL, at several sizes and prints quality and time. With a grading above 1 the mesh
//! is finer about the osteotomy line: that of the file, or on the parametric mandible after Dal Pont.
//!
//! `cargo run --release -p osteotome-anatomy --example mesh_report [FILE.stl] [LINE.json] [grading=R] [nodes...]`
#![allow(clippy::print_stdout)]
use osteotome_anatomy::{
    ClosedSurface, JawFrame, Osteotomy, Side, Technique, mesher, osteotomy, stl,
};
use osteotome_anatomy::{Parameters, ParametricMandible};
use osteotome_mechanics::geometry::{MeshDistance, TET_FACES, TetMesh, TriMesh, Vec3};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut targets, mut gradings) = (Vec::new(), Vec::new());
    let (mut file, mut line_file) = (None, None);
    for argument in std::env::args().skip(1) {
        if let Ok(n) = argument.parse::<usize>() {
            targets.push(n);
        } else if let Some(ratio) = argument.strip_prefix("grading=") {
            gradings.push(ratio.parse::<f64>()?);
        } else if Path::new(&argument).extension() == Some("json".as_ref()) {
            line_file = Some(argument);
        } else {
            file = Some(argument);
        }
    }
    if targets.is_empty() {
        targets = vec![600, 5_000];
    }
    if gradings.is_empty() {
        gradings = vec![1.0];
    }
    let parametric = ParametricMandible::new(Parameters::default())?;
    let mesh = match &file {
        Some(path) => stl::read_stl(Path::new(path))?,
        None => mesher::contour(&parametric, 2.0)?,
    };
    let name = file.as_deref().unwrap_or("parametric mandible");
    let surface = ClosedSurface::new(mesh, name)?;
    let e = surface.mesh.bounds().extent();
    println!(
        "{name}: {} vertices, {} faces, {:.2} cm3, {:.1} cm2, {:.1} x {:.1} x {:.1} mm, {} notes",
        surface.mesh.vertices.len(),
        surface.mesh.triangles.len(),
        surface.mesh.volume() * 1e-3,
        surface.mesh.area() * 1e-2,
        e.x,
        e.y,
        e.z,
        surface.notes.len(),
    );
    let frame = JawFrame::find(&surface.mesh, name)?;
    let distance = MeshDistance::new(surface.mesh);
    let line = match (&line_file, &file) {
        (Some(path), _) => {
            let file = osteotomy::read_osteotomy(Path::new(path))?;
            Some(Osteotomy::from_points(
                file.side,
                0.8,
                &file.points,
                &distance,
            )?)
        }
        (None, None) => {
            let marks = parametric.landmarks(&distance)?;
            Some(Osteotomy::by_technique(
                Technique::Hunsuck,
                &marks,
                Side::Right,
                0.8,
                &distance,
            )?)
        }
        (None, Some(_)) => None,
    };
    let place = line.map(|line| line.place()).unwrap_or_default();
    for ratio in gradings {
        for &target in &targets {
            let mandible = mesher::Body::mandible(&distance, &frame);
            let body = mandible.graded(distance.mesh(), &place, ratio, target)?;
            let scales = body
                .grading
                .focus
                .as_ref()
                .map_or([1.0; 2], osteotome_anatomy::Focus::scales);
            let start = Instant::now();
            let meshed = mesher::mesh_to_nodes(&body, target, &mut |_| {})?;
            let seconds = start.elapsed().as_secs_f64();
            println!(
                "target {target}, grading {ratio}: scales {:.2} to {:.2}, {seconds:.2} s",
                scales[0], scales[1]
            );
            report(&meshed, &distance, &place);
        }
    }
    Ok(())
}

fn report(meshed: &mesher::Meshed, surface: &MeshDistance, place: &[Vec3]) {
    let mesh = &meshed.mesh;
    let [low, high] = mesher::dihedral_range(mesh);
    println!(
        "  {} nodes, {} tets, dihedral {low:.1} to {high:.1} deg, volume {:+.3} %, genus {}, spacing {:.2} mm, shift {:.2} mm, swollen {:.2} mm",
        mesh.nodes().len(),
        mesh.tets().len(),
        meshed.volume_error * 100.0,
        mesher::mesh_genus(mesh),
        meshed.stuffing.spacing,
        meshed.stuffing.shift,
        meshed.swollen,
    );
    let smallest = |t: usize| mesher::dihedrals(&mesh.corners(t))[0];
    let mut histogram = [0usize; 7];
    (0..mesh.tets().len()).for_each(|t| histogram[((smallest(t) / 10.0) as usize).min(6)] += 1);
    let ratios: Vec<f64> = (0..mesh.tets().len())
        .map(|t| radius_ratio(&mesh.corners(t)))
        .collect();
    println!(
        "  smallest angle of each tet by tens of degrees {histogram:?}; radius ratio mean {:.3}, min {:.3}",
        mean(&ratios),
        ratios.iter().copied().fold(1.0, f64::min)
    );
    let skin = TriMesh {
        vertices: mesh.nodes().to_vec(),
        triangles: mesh.boundary_faces().to_vec(),
    };
    let skin = MeshDistance::new(skin);
    let (off, near): (Vec<f64>, Vec<bool>) = surface
        .mesh()
        .vertices
        .iter()
        .step_by(3)
        .map(|p| (skin.unsigned(p), is_near(p, place, 10.0)))
        .unzip();
    let near_off: Vec<f64> = off
        .iter()
        .zip(&near)
        .filter(|(_, n)| **n)
        .map(|(d, _)| *d)
        .collect();
    println!(
        "  surface off the mesh: mean {:.2}, max {:.2} mm; within 10 mm of the line mean {:.2}, max {:.2} mm",
        mean(&off),
        most(&off),
        mean(&near_off),
        most(&near_off)
    );
    for reach in [5.0, 15.0] {
        let lengths = edges(mesh, |p| is_near(p, place, reach));
        println!(
            "  edges within {reach} mm of the line: mean {:.2}, max {:.2} mm",
            mean(&lengths),
            most(&lengths)
        );
    }
    let all = edges(mesh, |_| true);
    println!(
        "  edges of all: mean {:.2}, max {:.2} mm",
        mean(&all),
        most(&all)
    );
}

fn edges(mesh: &TetMesh, keep: impl Fn(&Vec3) -> bool) -> Vec<f64> {
    let kept: Vec<bool> = mesh.nodes().iter().map(keep).collect();
    mesh.edges()
        .iter()
        .filter(|e| e.iter().all(|n| kept[*n as usize]))
        .map(|e| mesh.edge_vector(e).norm())
        .collect()
}

fn is_near(p: &Vec3, place: &[Vec3], reach: f64) -> bool {
    place.iter().any(|q| (p - q).norm() < reach)
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

fn most(x: &[f64]) -> f64 {
    x.iter().copied().fold(0.0, f64::max)
}

/// Three times the inscribed over the circumscribed sphere's radius; 1 for a regular tetrahedron.
fn radius_ratio(x: &[Vec3; 4]) -> f64 {
    let [a, b, c] = [x[1] - x[0], x[2] - x[0], x[3] - x[0]];
    let volume6 = a.dot(&b.cross(&c)).abs();
    let area2: f64 = TET_FACES
        .iter()
        .map(|f| (x[f[1]] - x[f[0]]).cross(&(x[f[2]] - x[f[0]])).norm())
        .sum();
    let round = b.cross(&c) * a.norm_squared()
        + c.cross(&a) * b.norm_squared()
        + a.cross(&b) * c.norm_squared();
    let circumradius = round.norm() / (2.0 * volume6);
    3.0 * (volume6 / area2) / circumradius
}
