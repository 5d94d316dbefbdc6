//! `prepare`: files of a jaw made into a patient's folder.
use crate::cli::{Failure, PrepareArgs};
use crate::picture::patient_pictures;
use crate::session::{Mark, SessionFolder};
use crate::talk::{self, Progress};
use anyhow::{Context, Result, anyhow};
use osteotome_anatomy::folder::{Content, MANIFEST, Role};
use osteotome_anatomy::prepare::{PrepareSpec, Report, prepare};
use std::time::Instant;

/// By this file a folder is known as an earlier patient, which may be replaced.
const MARK: Mark = Mark {
    file: MANIFEST,
    what: "a patient",
};

/// Makes the folder, whole or not at all.
pub fn prepare_patient(args: &PrepareArgs) -> Result<(), Failure> {
    let begin = Instant::now();
    let out = &args.output;
    SessionFolder::check(out, &MARK).map_err(Failure::Input)?;
    let mut bar = Progress::new("Preparing", 1000);
    let mut progress = |stage: &str, share: f64| bar.set((900.0 * share) as u64, stage);
    let made = prepare(&spec(args), &mut progress);
    let made = made.map_err(|e| Failure::Input(e.into()))?;
    bar.set(900, "pictures");
    let text = words(&made.report);
    let write = || -> Result<()> {
        let folder = SessionFolder::create(out, &MARK)?;
        let mut files: Vec<Content> = patient_pictures(&made.patient)?
            .into_iter()
            .map(|(name, png)| extra(Role::Picture, format!("pictures/{name}.png"), png))
            .collect();
        files.push(extra(
            Role::Report,
            "report.txt".to_owned(),
            (text.clone() + "\n").into_bytes(),
        ));
        let json = serde_json::to_string_pretty(&made.report)? + "\n";
        files.push(extra(
            Role::Report,
            "report.json".to_owned(),
            json.into_bytes(),
        ));
        made.patient.write(folder.path(), files)?;
        folder.finish()?;
        Ok(())
    };
    write()
        .with_context(|| format!("{} could not be written", out.display()))
        .map_err(Failure::Work)?;
    bar.done();
    if args.json {
        let json = serde_json::to_string(&made.report);
        talk::say(&json.map_err(|e| Failure::Work(e.into()))?);
    } else {
        talk::say(&text);
        talk::say(&format!(
            "Patient: {} ({:.1} s)",
            out.display(),
            begin.elapsed().as_secs_f64()
        ));
    }
    Ok(())
}

fn extra(role: Role, path: String, bytes: Vec<u8>) -> Content {
    Content {
        role,
        of: None,
        path,
        bytes,
    }
}

fn spec(args: &PrepareArgs) -> PrepareSpec {
    let mut spec = PrepareSpec::of(&args.input);
    spec.name.clone_from(&args.name);
    spec.teeth.clone_from(&args.teeth);
    spec.canals.clone_from(&args.canal);
    spec.landmarks.clone_from(&args.landmarks);
    spec.context = args
        .context
        .iter()
        .map(|c| (c.role.clone(), c.file.clone()))
        .collect();
    spec.nodes = args.nodes;
    spec.unit = args.unit;
    spec.axes = args.axes;
    for label in &args.label {
        let place = match label.name {
            "maxilla" => &mut spec.labels.maxilla,
            "mandible" => &mut spec.labels.mandible,
            "upper-teeth" => &mut spec.labels.upper_teeth,
            "lower-teeth" => &mut spec.labels.lower_teeth,
            _ => &mut spec.labels.canal,
        };
        *place = label.number;
    }
    spec
}

/// The report for people; without times, so that the same input gives the same file.
fn words(report: &Report) -> String {
    let [x, y, z] = report.extent;
    let mut lines = vec![format!(
        "{}: {x:.1} x {y:.1} x {z:.1} mm, {:.1} cm3.",
        report.name,
        1e-3 * report.mesh.surface_volume
    )];
    if let Some(d) = &report.diagnosis {
        let faults = d.faults();
        let found = if faults.is_empty() {
            "closed, manifold, not self-intersecting".to_owned()
        } else {
            faults.join(", ")
        };
        lines.push(format!("Surface: {} triangles; {found}.", d.n_triangles));
    }
    let m = &report.mesh;
    lines.push(format!(
        "Mesh: {} nodes, {} tetrahedra, dihedral angles {:.1} to {:.1} degrees, volume {:+.2} %.",
        m.nodes,
        m.tets,
        m.dihedral[0],
        m.dihedral[1],
        100.0 * (m.volume / m.surface_volume - 1.0)
    ));
    for (what, s) in [
        ("the mesh lies off the surface", m.deviation.of_mesh),
        ("the surface lies off the mesh", m.deviation.of_surface),
    ] {
        lines.push(format!(
            "  {what} by {:.2} mm on average, {:.2} mm at the 95th percentile, {:.2} mm at most.",
            s.mean, s.p95, s.max
        ));
    }
    lines.push(format!(
        "With it: {} teeth, {} canals, {} surfaces around.",
        report.teeth, report.canals, report.context
    ));
    lines.extend(report.notes.iter().map(|n| format!("Note: {n}.")));
    let constructed = report.constructed.iter();
    lines.extend(constructed.map(|c| format!("Constructed, not measured: {c}.")));
    lines.join("\n")
}

/// `check` of a patient's folder: all that is wrong, in order.
pub fn check_patient(folder: &std::path::Path) -> Result<(), Failure> {
    let checked = osteotome_anatomy::folder::check(folder);
    let shown = folder.display();
    if let [only] = &checked.faults[..] {
        return Err(Failure::Input(anyhow!("{only}")));
    }
    if !checked.faults.is_empty() {
        for (i, fault) in checked.faults.iter().enumerate() {
            talk::say(&format!("{}. {fault}.", i + 1));
        }
        return Err(Failure::Input(anyhow!(
            "{shown}: unusable, {} things are wrong, listed above; mend them in this order",
            checked.faults.len()
        )));
    }
    if let Some(p) = &checked.patient {
        talk::say(&format!(
            "{}: usable.\n{}: {} nodes, {} tetrahedra, {:.1} cm3, {} teeth, {} canals, {} surfaces around{}.",
            shown,
            p.name,
            p.mesh.nodes().len(),
            p.mesh.tets().len(),
            p.mesh.volume() * 1e-3,
            p.teeth.len(),
            p.canals.len(),
            p.context.len(),
            if p.landmarks.is_some() {
                ", landmarks"
            } else {
                ""
            },
        ));
    }
    for remark in &checked.remarks {
        talk::say(&format!("Note: {remark}."));
    }
    Ok(())
}
