//! Builds a patient and prints what it holds; with no argument, the parametric mandible.
//!
//! `cargo run --release -p osteotome-anatomy --example patient_report [FILE.stl OSTEOTOMY.json [FILE.msh]]`
#![allow(clippy::print_stdout)]
use osteotome_anatomy::{MeshSource, OsteotomySource, Patient, PatientSpec, Side, SurfaceSource};
use osteotome_mechanics::geometry::{Aabb, TetLocator, Vec3};
use std::time::Instant;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mut spec = PatientSpec {
        mesh: MeshSource::Nodes(600),
        ..PatientSpec::default()
    };
    match arguments.next() {
        Some(side) if side == "left" => spec.side = Some(Side::Left),
        Some(stl) => spec.surface = SurfaceSource::File(stl.into()),
        None => {}
    }
    if let Some(file) = arguments.next() {
        spec.osteotomy = OsteotomySource::File(file.into());
    }
    if let Some(msh) = arguments.next() {
        spec.mesh = MeshSource::File(msh.into());
    }
    let start = Instant::now();
    let patient = match Patient::build(&spec, &mut |_, _| {}) {
        Ok(patient) => patient,
        Err(error) => {
            println!("{error}");
            std::process::exit(2);
        }
    };
    println!(
        "# {} in {:.2} s, digest {:016x}",
        patient.name,
        start.elapsed().as_secs_f64(),
        patient.digest()
    );
    println!(
        "# constructed: {:?}, notes: {:?}",
        patient.constructed, patient.notes
    );
    println!(
        "# {} nodes, {} tets, {} shell points",
        patient.mesh.nodes().len(),
        patient.mesh.tets().len(),
        patient.shell.len()
    );
    let mean = patient
        .materials
        .iter()
        .map(|m| m.young_modulus)
        .sum::<f64>();
    println!("# mean E {:.0} MPa", mean / patient.materials.len() as f64);
    let locator = TetLocator::new(&patient.mesh);
    let lost = |p: &Vec3, margin: f64| locator.find_near(&patient.mesh, p, margin).is_none();
    let lost_shell: Vec<_> = patient
        .shell
        .iter()
        .filter(|p| lost(&p.anchor, 2.0))
        .collect();
    let line = || patient.osteotomy.parts.iter().flat_map(|p| &p.points);
    let supports = patient.condyles.map(|c| {
        let near = patient
            .mesh
            .nodes()
            .iter()
            .filter(|n| (*n - c).norm() < 9.0);
        near.count()
    });
    println!(
        "# more than about 2 mm from the mesh: {} shell points within {:?}; {} of {} osteotomy points; nodes within 9 mm of the condyles: {supports:?}",
        lost_shell.len(),
        Aabb::around(lost_shell.iter().map(|p| &p.position)),
        line().filter(|p| lost(&p.at, 2.0)).count(),
        line().count()
    );
    let show = |p: &Vec3, what: &str| {
        println!("{:.3} {:.3} {:.3} {what}", p.x, p.y, p.z);
    };
    for part in &patient.osteotomy.parts {
        for p in &part.points {
            let t = p.toward;
            let what = format!(
                "{} [{:.2} {:.2} {:.2}] {:.2}",
                part.kind.name(),
                t.x,
                t.y,
                t.z,
                p.depth
            );
            show(&p.at, &what);
        }
    }
    for (p, what) in patient
        .condyles
        .iter()
        .zip(["l_condyle_right", "l_condyle_left"])
    {
        show(p, what);
    }
    for (p, what) in patient
        .frame
        .gonions
        .iter()
        .zip(["l_gonion_right", "l_gonion_left"])
    {
        show(p, what);
    }
    for p in &patient.frame.path {
        show(p, "l_path");
    }
    if let Some(marks) = &patient.landmarks {
        show(&marks.menton, "l_menton");
        for side in [&marks.right, &marks.left] {
            show(&side.lingula, "l_lingula");
            show(&side.coronoid_tip, "l_coronoid_tip");
            show(&side.sigmoid_notch, "l_sigmoid_notch");
            show(&side.lower_border, "l_lower_border");
            show(&side.second_molar_buccal, "l_second_molar");
        }
    }
}
