//! `fracture`: a body with a crack under load, its stress intensities, and how the crack grows.
mod case;
mod fields;
mod result;
mod setup;
mod study;

use crate::cli::{Failure, FractureArgs};
use crate::session::{CrackMesh, Mark, SessionFolder, write_crack};
use crate::talk::{self, Progress};
use anyhow::{Context, Result};
use case::Case;
use osteotome_mechanics::crack::CrackSurface;
use result::Outcome;
use setup::Problem;
use std::time::Instant;
use study::{Study, Verdict};

/// By this file a folder is known as an earlier result, which may be replaced.
const MARK: Mark = Mark {
    file: "result.json",
    what: "a fracture result",
};

/// `fracture`: solves a case, grows its crack, leaves a folder of results.
pub fn fracture(args: &FractureArgs) -> Result<(), Failure> {
    let begin = Instant::now();
    let case = Case::load(&args.case).map_err(Failure::Input)?;
    SessionFolder::check(&args.out, &MARK).map_err(Failure::Input)?;
    let shown = args.case.display().to_string();
    let wrong = |e: anyhow::Error| Failure::Input(e.context(shown.clone()));
    let problem = Problem::read(&case).map_err(wrong)?;
    let mut outcome = Outcome::new(&problem.body);
    outcome.timing.add("setup", begin);
    let study = Study::new(problem, &case).map_err(wrong)?;
    let folder = SessionFolder::create(&args.out, &MARK).map_err(Failure::Input)?;
    let grow = || -> Result<()> {
        run(study, &folder, &mut outcome)?;
        outcome.timing.add("total", begin);
        folder.write("result.json", &(outcome.json()? + "\n"))
    };
    grow().context("the study failed").map_err(Failure::Work)?;
    let out = folder.finish().map_err(Failure::Work)?;
    if args.json {
        talk::say(&outcome.json().map_err(Failure::Work)?);
    } else {
        talk::say(&outcome.summary());
        talk::say(&format!("Result: {}", out.display()));
    }
    Ok(())
}

/// Step by step until the last one, or until the crack rests.
fn run(mut study: Study, folder: &SessionFolder, outcome: &mut Outcome) -> Result<()> {
    let mut bar = Progress::new("Growing", study.steps() as u64 + 1);
    for step in 0.. {
        bar.set(step as u64, format!("step {step} of {}", study.steps()));
        let since = Instant::now();
        let (state, verdict) = study.evaluate(step);
        outcome.timing.add("evaluate", since);
        let since = Instant::now();
        let fields = fields::write(study.body(), &state);
        folder.write(&format!("fields_{step:03}.vtu"), &fields)?;
        folder.write(&format!("crack_{step:03}.ply"), &ply(&study.body().crack))?;
        outcome.push(study.body(), &state);
        outcome.timing.add("write", since);
        match verdict {
            Verdict::Grows(moves) => {
                let since = Instant::now();
                study.grow(&state, &moves)?;
                outcome.timing.add("grow", since);
            }
            Verdict::Stops(reason) => {
                outcome.stopped = reason;
                break;
            }
        }
    }
    bar.done();
    Ok(())
}

/// All sheets in one file.
fn ply(crack: &CrackSurface) -> String {
    let (mut vertices, mut triangles, mut kerf) = (vec![], vec![], vec![]);
    for sheet in &crack.sheets {
        let first = vertices.len() as u32;
        vertices.extend(sheet.mesh.vertices.iter().map(|v| <[f64; 3]>::from(*v)));
        triangles.extend(sheet.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
        kerf.extend_from_slice(&sheet.kerf);
    }
    write_crack(&CrackMesh {
        vertices: &vertices,
        triangles: &triangles,
        kerf: &kerf,
    })
}
