//! What the commands do.
use crate::cli::{CheckArgs, DemoArgs, Failure, Mode, ReplayArgs, RunArgs};
use crate::debrief::{Figures, Findings, Score, Subject, page};
use crate::engine::{self, Prepared};
use crate::input::{Input, open_devices};
use crate::loops::{Control, Sink, lockstep, realtime_under};
use crate::picture::{self, write_pictures};
use crate::planning::Planning;
use crate::prepare_command::check_patient;
use crate::scenario::{self, Override, Scenario, Source};
use crate::session::{
    BoneSample, CrackMesh, GrowthSample, HapticSample, Loop, MainSample, Metrics, MetricsDocument,
    Outcome, Pace, Recorder, Recording, SESSION, ScenarioMessage, SessionFolder, StepTime,
    write_crack, write_final_bone,
};
use crate::talk::{self, Progress};
use crate::verify::Comparison;
use anyhow::{Context, Result, anyhow};
use osteotome_devices::{Binding, LinkedDevice};
use osteotome_render::Renderer;
use std::path::{Path, PathBuf};

/// `demo`: the shipped scenario in real time; a split that does not complete is a failure.
pub fn demo(args: &DemoArgs) -> Result<(), Failure> {
    let source = Source::Text {
        name: "built-in scenario".to_owned(),
        text: scenario::BSSO_RIGHT.to_owned(),
    };
    let mut scenario = load(&source, &args.set)?;
    SessionFolder::check(&args.out, &SESSION).map_err(Failure::Input)?;
    let (devices, notes) = open_devices(&mut scenario).map_err(Failure::Input)?;
    notes.iter().for_each(|note| talk::say(note));
    let prepared = prepare(&scenario)?;
    let input = live(&scenario, &prepared, devices)?;
    let ended = session(&scenario, &prepared, input, Mode::Realtime, &args.out)?;
    tell(&ended, &args.out);
    if ended.outcome.time.is_some() {
        Ok(())
    } else {
        Err(Failure::Work(anyhow!(
            "the bone did not come apart; see {}",
            args.out.display()
        )))
    }
}

/// `run`: any scenario, any input, either mode.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let mut overrides = args.set.clone();
    let extra = [
        args.seed.map(|seed| format!("seed={seed}")),
        args.max_time.map(|time| format!("max_time={time:?}")),
    ];
    for text in extra.into_iter().flatten() {
        overrides.push(text.parse().map_err(Failure::Input)?);
    }
    let mut scenario = load(&Source::File(args.scenario.clone()), &overrides)?;
    SessionFolder::check(&args.out, &SESSION).map_err(Failure::Input)?;
    let recording = if args.input == Path::new("builtin") {
        None
    } else {
        Some(Recording::read(&args.input).map_err(Failure::Input)?)
    };
    let devices = if recording.is_none() {
        users_devices(&mut scenario, args)?
    } else {
        [None, None]
    };
    let prepared = prepare(&scenario)?;
    let input = match &recording {
        Some(recording) => Input::recorded(&scenario, &recording.hands).map_err(Failure::Input)?,
        None => live(&scenario, &prepared, devices)?,
    };
    let ended = session(&scenario, &prepared, input, args.mode, &args.out)?;
    if args.json {
        talk::say(&json(&ended.document).map_err(Failure::Work)?);
    } else {
        tell(&ended, &args.out);
    }
    Ok(())
}

/// Physical devices live by the clock.
fn users_devices(
    scenario: &mut Scenario,
    args: &RunArgs,
) -> Result<[Option<LinkedDevice>; 2], Failure> {
    let physical = scenario
        .tool
        .iter()
        .find(|t| t.device != Binding::Simulated);
    if let Some(tool) = physical
        && args.mode == Mode::Lockstep
    {
        return Err(Failure::Input(anyhow!(
            "the {} tool's device is {}, which cannot be stepped; give --mode realtime",
            tool.name,
            tool.device
        )));
    }
    let (devices, notes) = open_devices(scenario).map_err(Failure::Input)?;
    if !args.json {
        notes.iter().for_each(|note| talk::say(note));
    }
    Ok(devices)
}

/// `check`: everything up to the first step of a session.
pub fn check(args: &CheckArgs) -> Result<(), Failure> {
    if args.scenario.is_dir() {
        return check_patient(&args.scenario);
    }
    let scenario = load(&Source::File(args.scenario.clone()), &args.set)?;
    let prepared = prepare(&scenario)?;
    let start = built_in(&scenario, &prepared)?.read().map(|r| r.pose);
    engine::connect(&prepared, &scenario, start).map_err(Failure::Input)?;
    let p = &prepared.patient;
    let body = &prepared.bone.body;
    talk::say(&format!(
        "{}: usable.\n{}: {} nodes, {} tetrahedra, {:.1} cm3, {} surface points, {} saw cuts, {} fragment(s).",
        scenario.name,
        p.name,
        body.mesh.nodes().len(),
        body.mesh.tets().len(),
        body.mesh.volume() * 1e-3,
        p.shell.len(),
        p.osteotomy.parts.len(),
        prepared.bone.fragments.count(),
    ));
    for note in &p.notes {
        talk::say(&format!("Mended: {note}."));
    }
    for note in &p.constructed {
        talk::say(&format!("Constructed, not measured: {note}."));
    }
    let review = Planning::new(&prepared, &scenario).review().clone();
    for finding in review.faults.iter().chain(&review.remarks) {
        talk::say(&format!("Osteotomy: {finding}."));
    }
    Ok(())
}

/// `replay`: the figures of a recording, recomputed on demand.
pub fn replay(args: &ReplayArgs) -> Result<(), Failure> {
    let recording = Recording::read(&args.session).map_err(Failure::Input)?;
    if !args.verify && args.out.is_none() {
        talk::say(&talk::summary(&recorded_figures(&recording).outcome()));
        return Ok(());
    }
    let scenario = recording.scenario.scenario.clone();
    let prepared = prepare_recorded(&recording, &args.session)?;
    let input = || Input::recorded(&scenario, &recording.hands).map_err(Failure::Input);
    if let Some(out) = &args.out {
        SessionFolder::check(out, &SESSION).map_err(Failure::Input)?;
        let ended = session(&scenario, &prepared, input()?, Mode::Lockstep, out)?;
        tell(&ended, out);
    }
    if args.verify {
        verify(&recording, &prepared, input()?)?;
    }
    Ok(())
}

/// Recomputes a recording in lockstep and says how far it is off. One made in lockstep must agree to the last bit.
fn verify(recording: &Recording, prepared: &Prepared, mut input: Input) -> Result<(), Failure> {
    let scenario = &recording.scenario.scenario;
    let start = recording.start();
    let engine = engine::connect(prepared, scenario, start).map_err(Failure::Input)?;
    let mut comparison = Comparison::new(recording);
    let mut bar = Progress::new("Replaying", millis(recording.seconds(scenario)));
    let mut progress = |time: f64, _: bool| bar.set(millis(time), format!("{time:.1} s"));
    input.rewind();
    lockstep(engine, input, scenario, &mut comparison, &mut progress).map_err(Failure::Work)?;
    bar.done();
    talk::say(&comparison.report());
    if recording.scenario.mode == Mode::Lockstep.name() && !comparison.is_exact() {
        return Err(Failure::Work(anyhow!(
            "the recording was made in lockstep, but recomputing it gives something else"
        )));
    }
    Ok(())
}

fn load(source: &Source, overrides: &[Override]) -> Result<Scenario, Failure> {
    let here = std::env::current_dir().map_err(|e| Failure::Work(e.into()))?;
    scenario::load(source, overrides, &here).map_err(Failure::Input)
}

pub fn prepare(scenario: &Scenario) -> Result<Prepared, Failure> {
    let mut bar = Progress::new("Preparing", 1000);
    let mut progress = |stage: &str, share: f64| bar.set((1000.0 * share) as u64, stage);
    let prepared = engine::prepare(scenario, &mut progress).map_err(Failure::Input);
    bar.done();
    prepared
}

/// The bone of a recording, which must still be the one that its scenario gives.
pub fn prepare_recorded(recording: &Recording, path: &Path) -> Result<Prepared, Failure> {
    let prepared = prepare(&recording.scenario.scenario)?;
    if prepared.digest != recording.scenario.patient_digest {
        return Err(Failure::Input(anyhow!(
            "{}: the bone built from its scenario is not the one recorded (digest {}, recorded {}); its files have changed",
            path.display(),
            prepared.digest,
            recording.scenario.patient_digest
        )));
    }
    Ok(prepared)
}

fn built_in(scenario: &Scenario, prepared: &Prepared) -> Result<Input, Failure> {
    Input::built_in(scenario, prepared.line.clone()).map_err(Failure::Input)
}

fn live(
    scenario: &Scenario,
    prepared: &Prepared,
    devices: [Option<LinkedDevice>; 2],
) -> Result<Input, Failure> {
    Input::live(scenario, prepared.line.clone(), devices).map_err(Failure::Input)
}

/// How a session ended.
pub struct Ended {
    /// Its figures.
    pub metrics: Metrics,
    outcome: Outcome,
    document: MetricsDocument,
    score: Option<Score>,
    /// Where its pictures were drawn.
    drawn_on: Option<String>,
}

fn tell(ended: &Ended, out: &Path) {
    talk::say(&talk::summary(&ended.outcome));
    if let Some(score) = &ended.score {
        talk::say(&talk::score(score));
    }
    if let Some(place) = &ended.drawn_on {
        talk::say(&format!("Pictures drawn on {place}"));
    }
    talk::say(&format!("Session: {}", out.display()));
}

/// Runs a session before a terminal and leaves its folder.
fn session(
    scenario: &Scenario,
    prepared: &Prepared,
    input: Input,
    mode: Mode,
    out: &Path,
) -> Result<Ended, Failure> {
    let mut bar = Progress::new(&scenario.name, millis(scenario.max_time));
    let mut drawing = Progress::new("Drawing", 1000);
    let mut progress = |advance: Advance| match advance {
        Advance::Running { time, is_severed } => {
            let word = if is_severed { ", split" } else { "" };
            bar.set(millis(time), format!("{time:.1} s{word}"));
        }
        Advance::Drawing { done, of } => {
            bar.clear();
            let share = (1000 * done / of) as u64;
            drawing.set(share, format!("picture {done} of {of}"));
        }
    };
    let mut watch = Watch {
        control: Control::default(),
        sink: &mut Unseen,
        progress: &mut progress,
        draws: true,
    };
    let ended = keep_session(scenario, prepared, input, mode, out, &mut watch);
    bar.done();
    drawing.done();
    ended
}

/// How far a session has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Advance {
    /// It runs.
    Running {
        /// Simulated time \[s\].
        time: f64,
        /// Whether the bone is apart.
        is_severed: bool,
    },
    /// Its pictures are drawn.
    Drawing {
        /// How many are.
        done: usize,
        /// Of how many.
        of: usize,
    },
}

/// Who looks on while a session is run and kept.
pub struct Watch<'a> {
    /// By which it is paused and ended; in lockstep without effect.
    pub control: Control,
    /// Sees every sample that is recorded.
    pub sink: &'a mut dyn Sink,
    /// Told how far all is.
    pub progress: &'a mut dyn FnMut(Advance),
    /// Whether pictures belong into the folder.
    pub draws: bool,
}

/// Nobody looks.
struct Unseen;

impl Sink for Unseen {
    fn haptic(&mut self, _: &HapticSample) -> Result<()> {
        Ok(())
    }
    fn main(&mut self, _: &MainSample) -> Result<()> {
        Ok(())
    }
    fn growth(&mut self, _: GrowthSample) -> Result<()> {
        Ok(())
    }
    fn timing(&mut self, _: &StepTime, _: bool) -> Result<()> {
        Ok(())
    }
    fn event(&mut self, _: f64, _: &str) -> Result<()> {
        Ok(())
    }
    fn pace(&mut self, _: Loop, _: Pace) {}
}

/// The recorder, and who looks on beside it.
struct Both<'a>(&'a mut Recorder, &'a mut dyn Sink);

impl Sink for Both<'_> {
    fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        self.1.haptic(sample)?;
        self.0.haptic(sample)
    }
    fn main(&mut self, sample: &MainSample) -> Result<()> {
        self.1.main(sample)?;
        self.0.main(sample)
    }
    fn bone(&mut self, sample: &BoneSample) -> Result<()> {
        self.1.bone(sample)?;
        self.0.bone(sample)
    }
    fn growth(&mut self, sample: GrowthSample) -> Result<()> {
        self.1.growth(sample.clone())?;
        self.0.growth(sample)
    }
    fn timing(&mut self, sample: &StepTime, grew: bool) -> Result<()> {
        self.1.timing(sample, grew)?;
        self.0.timing(sample, grew)
    }
    fn event(&mut self, time: f64, event: &str) -> Result<()> {
        self.1.event(time, event)?;
        self.0.event(time, event)
    }
    fn pace(&mut self, of: Loop, pace: Pace) {
        self.1.pace(of, pace);
        self.0.pace(of, pace);
    }
}

/// Runs a session and leaves its folder.
pub fn keep_session(
    scenario: &Scenario,
    prepared: &Prepared,
    mut input: Input,
    mode: Mode,
    out: &Path,
    watch: &mut Watch,
) -> Result<Ended, Failure> {
    let start = input.read().map(|r| r.pose);
    input.rewind();
    let engine = engine::connect(prepared, scenario, start).map_err(Failure::Input)?;
    let folder = SessionFolder::create(out, &SESSION).map_err(Failure::Input)?;
    let first = ScenarioMessage {
        scenario: scenario.clone(),
        patient_digest: prepared.digest.clone(),
        mode: mode.name().to_owned(),
    };
    let work = || -> Result<Ended> {
        let mut recorder = Recorder::create(folder.path(), &first)?;
        let mut sink = Both(&mut recorder, watch.sink);
        let mut progress =
            |time: f64, is_severed: bool| (watch.progress)(Advance::Running { time, is_severed });
        let engine = match mode {
            Mode::Lockstep => lockstep(engine, input, scenario, &mut sink, &mut progress)?,
            Mode::Realtime => {
                let control = &watch.control;
                realtime_under(control, engine, input, scenario, &mut sink, &mut progress)?
            }
        };
        if let Some(crack) = recorder.last_growth() {
            let crack = CrackMesh {
                vertices: &crack.vertices,
                triangles: &crack.triangles,
                kerf: &crack.kerf,
            };
            folder.write("crack.ply", &write_crack(&crack))?;
        }
        folder.write(
            "bone_final.vtu",
            &write_final_bone(&engine::final_bone(&engine)),
        )?;
        let metrics = recorder.finish()?;
        let mut ended = Ended {
            outcome: metrics.outcome(),
            document: metrics.document(),
            score: None,
            drawn_on: None,
            metrics,
        };
        // A session is worth keeping without its debrief.
        if watch.draws
            && let Err(error) = look_back(prepared, &folder, &mut ended, watch.progress)
        {
            talk::complain(&error);
        }
        folder.write("metrics.json", &json(&ended.document)?)?;
        Ok(ended)
    };
    let ended = match work().context("the session failed") {
        Ok(ended) => ended,
        Err(error) => return Err(Failure::Work(keep(folder, error))),
    };
    let _: PathBuf = folder.finish().map_err(Failure::Work)?;
    Ok(ended)
}

/// What was recorded before a failure is not thrown away.
fn keep(folder: SessionFolder, error: anyhow::Error) -> anyhow::Error {
    match folder.keep() {
        Some(kept) => {
            let shown = kept.display();
            error.context(format!("what was recorded until then is in {shown}"))
        }
        None => error,
    }
}

/// What the recording that `folder` holds says: figures, page, pictures.
fn look_back(
    prepared: &Prepared,
    folder: &SessionFolder,
    ended: &mut Ended,
    watch: &mut dyn FnMut(Advance),
) -> Result<()> {
    let recording = Recording::read(&folder.path().join("session.mcap"))?;
    let findings = Findings::of(prepared, &recording).context("the debrief")?;
    let score = findings.score(&recording);
    ended.document.complete(&findings, score.clone());
    let figures = Figures::of(&recording.scenario.scenario.name, &findings, &score);
    let subject = Subject {
        prepared,
        recording: &recording,
        findings: &findings,
        score: &score,
        figures: &figures,
    };
    let html = page(&subject, None, &[]).context("the debrief page")?;
    folder.write("report.html", &html)?;
    ended.score = Some(score);
    ended.drawn_on = Some(pictures(prepared, folder.path(), &recording, watch)?);
    Ok(())
}

/// Draws the session that `folder` holds; says where they were drawn.
fn pictures(
    prepared: &Prepared,
    folder: &Path,
    recording: &Recording,
    watch: &mut dyn FnMut(Advance),
) -> Result<String> {
    let mut progress = |done: usize, of: usize| watch(Advance::Drawing { done, of });
    let mut stage = picture::Stage::new(prepared, recording)?;
    let mut renderer = Renderer::fastest();
    let pictures = folder.join("pictures");
    write_pictures(&mut stage, &mut renderer, &pictures, &mut progress)
        .context("the pictures of the session")?;
    Ok(renderer.place())
}

fn json(document: &MetricsDocument) -> Result<String> {
    Ok(serde_json::to_string_pretty(document)?)
}

fn recorded_figures(recording: &Recording) -> Metrics {
    let scenario = &recording.scenario.scenario;
    let mut metrics = Metrics::new(scenario);
    let mut growth = recording.growth.iter().peekable();
    for sample in recording.haptic(scenario.loops.dt()) {
        while let Some(g) = growth.next_if(|g| g.time < sample.time) {
            metrics.growth(g);
        }
        metrics.haptic(&sample);
    }
    growth.for_each(|g| metrics.growth(g));
    recording.main.iter().for_each(|m| metrics.main(m));
    recording
        .timing
        .iter()
        .for_each(|t| metrics.timing(t, false));
    metrics
}

fn millis(seconds: f64) -> u64 {
    (seconds * 1e3) as u64
}
