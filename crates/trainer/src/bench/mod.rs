//! `osteotome bench`: the paper's evaluation (section 6) on this machine, from one recorded split.
//!
//! The recorded hands are played twice: in lockstep on this thread, where every part of Table 1 is timed beside the method it
//! replaces, and against the clock on three threads for the rates of Figure 6.
mod document;
mod export;
mod figures;
mod hands;
mod probe;
mod rates;
mod recording_cost;
mod replay;
mod rows;
mod soak;
mod table;
mod times;

use crate::cli::{BenchArgs, Failure};
use crate::commands::prepare;
use crate::engine::{self, Prepared};
use crate::input::Input;
use crate::scenario::Scenario;
use crate::session::Recording;
use crate::talk::{self, Progress};
use anyhow::{Result, anyhow};
use rates::Paced;
use replay::Replayed;

/// How large a case is.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct Sizes {
    nodes: usize,
    tets: usize,
    points: usize,
    faces: usize,
}

/// All that a bench finds.
struct Evaluation {
    sizes: Sizes,
    replayed: Replayed,
    paced: Paced,
}

/// `bench`.
pub fn bench(args: &BenchArgs) -> Result<(), Failure> {
    let recording = match &args.recording {
        Some(path) => Recording::read(path),
        None => hands::shipped(),
    }
    .map_err(Failure::Input)?;
    if let Some(path) = &args.trim {
        return hands::trim(&recording, path).map_err(Failure::Work);
    }
    let scenario = scenario(&recording, args).map_err(Failure::Input)?;
    let prepared = prepare(&scenario)?;
    if let Some(seconds) = args.soak {
        return soaked(&recording, &scenario, &prepared, seconds);
    }
    let evaluation = evaluate(&recording, &scenario, &prepared)?;
    if let Some(folder) = &args.figures {
        let paced = live(&scenario, &prepared)?;
        figures::write(&paced, &scenario, folder).map_err(Failure::Work)?;
    }
    if let Some(folder) = &args.export {
        let replayed = &evaluation.replayed;
        let (bone, touches) = (&replayed.bone, &replayed.touches);
        export::write(&prepared, &scenario, bone, touches, folder).map_err(Failure::Work)?;
    }
    if args.json {
        talk::say(&document::json(&evaluation).map_err(Failure::Work)?);
    } else {
        talk::say(&table::text(&evaluation));
    }
    Ok(())
}

/// `bench --soak`.
fn soaked(
    recording: &Recording,
    scenario: &Scenario,
    prepared: &Prepared,
    seconds: f64,
) -> Result<(), Failure> {
    let whole = Scenario {
        max_time: seconds,
        ..scenario.clone()
    };
    let soak = shown("In real time", &whole, |progress| {
        soak::soak(recording, scenario, prepared, seconds, progress)
    })?;
    talk::say(&soak.text().unwrap_or_default());
    Ok(())
}

/// The recording's scenario in the size asked for.
fn scenario(recording: &Recording, args: &BenchArgs) -> Result<Scenario> {
    let mut scenario = recording.scenario.scenario.clone();
    if args.nodes.is_some() && scenario.mesh.file.is_some() {
        return Err(anyhow!(
            "--nodes: the recording's mesh comes from a file; leave --nodes out, or record a session on a mesh of its own"
        ));
    }
    if let Some(nodes) = args.nodes {
        scenario.mesh.nodes = nodes as usize;
    }
    if let Some(points) = args.points {
        scenario.mesh.shell_points = points as usize;
    }
    let recorded = recording.seconds(&scenario);
    scenario.max_time = args.max_time.unwrap_or(recorded).min(recorded);
    Ok(scenario)
}

fn evaluate(
    recording: &Recording,
    scenario: &Scenario,
    prepared: &Prepared,
) -> Result<Evaluation, Failure> {
    let input = || Input::recorded(scenario, &recording.hands).map_err(Failure::Input);
    let replayed = shown("Timing each part", scenario, |progress| {
        replay::replay(prepared, scenario, input()?, progress).map_err(Failure::Work)
    })?;
    let paced = in_real_time(scenario, prepared, input()?)?;
    let body = &prepared.bone.body;
    Ok(Evaluation {
        sizes: Sizes {
            nodes: body.mesh.nodes().len(),
            tets: body.mesh.tets().len(),
            points: prepared.bone.shell.len(),
            faces: prepared.patient.surface.triangles.len(),
        },
        replayed,
        paced,
    })
}

/// A session of the built-in surgeon in real time: recorded hands do not answer to a break that comes a little earlier or later.
fn live(scenario: &Scenario, prepared: &Prepared) -> Result<Paced, Failure> {
    let scenario = Scenario {
        max_time: LONGEST,
        ..scenario.clone()
    };
    let input = Input::built_in(&scenario, prepared.line.clone()).map_err(Failure::Input)?;
    in_real_time(&scenario, prepared, input)
}

/// A live split takes a few seconds \[s\].
const LONGEST: f64 = 20.0;

fn in_real_time(
    scenario: &Scenario,
    prepared: &Prepared,
    mut input: Input,
) -> Result<Paced, Failure> {
    let start = input.read().map(|r| r.pose);
    input.rewind();
    let engine = engine::connect(prepared, scenario, start).map_err(Failure::Input)?;
    shown("In real time", scenario, |progress| {
        rates::run(engine, input, scenario, progress).map_err(Failure::Work)
    })
}

/// Does something that lasts a session's time, with a progress bar.
fn shown<T>(
    what: &str,
    scenario: &Scenario,
    work: impl FnOnce(&mut dyn FnMut(f64)) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let millis = |s: f64| (s * 1e3) as u64;
    let mut bar = Progress::new(what, millis(scenario.max_time));
    let result = work(&mut |t| bar.set(millis(t), format!("{t:.1} s")));
    bar.done();
    result
}
