//! `report`: the debrief page of recorded sessions.
use crate::cli::{Failure, ReportArgs};
use crate::commands::prepare_recorded;
use crate::debrief::{Figures, Findings, Score, Subject, page};
use crate::engine::Prepared;
use crate::render_command::check_place;
use crate::session::Recording;
use crate::talk;
use anyhow::{Context, Result};
use std::path::Path;
use std::rc::Rc;

/// A session looked at.
struct Looked {
    prepared: Rc<Prepared>,
    recording: Recording,
    findings: Findings,
    score: Score,
    figures: Figures,
}

/// Writes the page about the last session.
pub fn report(args: &ReportArgs) -> Result<(), Failure> {
    check_place(&args.output).map_err(Failure::Input)?;
    let mut bone: Option<Rc<Prepared>> = None;
    let mut look = |path: &Path| -> Result<Looked, Failure> {
        let looked = look(path, bone.take())?;
        bone = Some(Rc::clone(&looked.prepared));
        Ok(looked)
    };
    let reference = args.reference.as_deref().map(&mut look).transpose()?;
    let mut curve = vec![];
    let mut last = None;
    for path in &args.sessions {
        let looked = look(path)?;
        curve.push(looked.figures.clone());
        last = Some(looked);
    }
    let Some(last) = last else { return Ok(()) };
    let subject = Subject {
        prepared: &last.prepared,
        recording: &last.recording,
        findings: &last.findings,
        score: &last.score,
        figures: &last.figures,
    };
    let html = page(&subject, reference.as_ref().map(|r| &r.figures), &curve);
    let work = html.and_then(|html| write_whole(&args.output, &html));
    work.map_err(Failure::Work)?;
    talk::say(&talk::score(&last.score));
    talk::say(&format!("Page: {}", args.output.display()));
    Ok(())
}

/// `bone`: of the session before, which often is this one's too.
fn look(path: &Path, bone: Option<Rc<Prepared>>) -> Result<Looked, Failure> {
    let recording = Recording::read(path).map_err(Failure::Input)?;
    let is_same = |b: &Rc<Prepared>| b.digest == recording.scenario.patient_digest;
    let prepared = match bone.filter(is_same) {
        Some(bone) => bone,
        None => Rc::new(prepare_recorded(&recording, path)?),
    };
    let named = || path.display().to_string();
    let findings = Findings::of(&prepared, &recording);
    let findings = findings.with_context(named).map_err(Failure::Input)?;
    let score = findings.score(&recording);
    Ok(Looked {
        figures: Figures::of(&named(), &findings, &score),
        prepared,
        recording,
        findings,
        score,
    })
}

/// The file appears whole or not at all.
pub fn write_whole(path: &Path, text: &str) -> Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let write = || {
        std::fs::write(&partial, text)?;
        std::fs::rename(&partial, path)
    };
    let result = write().with_context(|| path.display().to_string());
    if result.is_err() {
        // The name says what it is if even this fails.
        let _ = std::fs::remove_file(&partial);
    }
    result
}
