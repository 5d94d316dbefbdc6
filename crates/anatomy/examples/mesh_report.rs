//! Meshes the parametric mandible, or a given STL, at several sizes and prints quality and time.
//!
//! `cargo run --release -p osteotome-anatomy --example mesh_report [FILE.stl] [nodes...]`
#![allow(clippy::print_stdout)]
use osteotome_anatomy::{ClosedSurface, JawFrame, mesher, parametric, stl};
use osteotome_mechanics::geometry::MeshDistance;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), osteotome_anatomy::AnatomyError> {
    let mut targets = Vec::new();
    let mut file = None;
    for argument in std::env::args().skip(1) {
        match argument.parse::<usize>() {
            Ok(n) => targets.push(n),
            Err(_) => file = Some(argument),
        }
    }
    if targets.is_empty() {
        targets = vec![600, 5_000];
    }
    let start = Instant::now();
    let mesh = match &file {
        Some(path) => stl::read_stl(Path::new(path))?,
        None => {
            let mandible = parametric::ParametricMandible::new(parametric::Parameters::default())?;
            mesher::contour(&mandible, 2.0)?
        }
    };
    let name = file.as_deref().unwrap_or("parametric mandible");
    let surface = ClosedSurface::new(mesh, name)?;
    let bounds = surface.mesh.bounds();
    println!(
        "{name}: {} vertices, {} faces, {:.2} cm3, {:.1} cm2, {:.1} x {:.1} x {:.1} mm, {} notes, {:.0} ms",
        surface.mesh.vertices.len(),
        surface.mesh.triangles.len(),
        surface.mesh.volume() * 1e-3,
        surface.mesh.area() * 1e-2,
        bounds.extent().x,
        bounds.extent().y,
        bounds.extent().z,
        surface.notes.len(),
        start.elapsed().as_secs_f64() * 1e3
    );
    if let Ok(out) = std::env::var("OUT") {
        let bytes = stl::to_binary_stl(&surface.mesh);
        std::fs::write(&out, bytes).expect("OUT can be written");
    }
    let frame = JawFrame::find(&surface.mesh, name)?;
    let distance = MeshDistance::new(surface.mesh);
    let body = mesher::Body::mandible(&distance, &frame);
    for target in targets {
        let start = Instant::now();
        let meshed = mesher::mesh_to_nodes(&body, target, &mut |_| {})?;
        let seconds = start.elapsed().as_secs_f64();
        let [low, high] = mesher::dihedral_range(&meshed.mesh);
        println!(
            "target {target}: {} nodes, {} tets, dihedral {low:.1} to {high:.1} deg, volume {:+.3} %, genus {}, spacing {:.2} mm, shift {:.2} mm, swollen {:.2} mm, farthest {:.2} mm, {seconds:.2} s",
            meshed.mesh.nodes().len(),
            meshed.mesh.tets().len(),
            meshed.volume_error * 100.0,
            mesher::mesh_genus(&meshed.mesh),
            meshed.stuffing.spacing,
            meshed.stuffing.shift,
            meshed.swollen,
            meshed.farthest,
        );
    }
    Ok(())
}
