//! What the commands do.
use crate::cli::{CheckArgs, DemoArgs, Failure, Mode, ReplayArgs, RunArgs};
use crate::debrief::{Figures, Findings, Score, Subject, page};
use crate::engine::{self, Engine, EngineUnderway, Prepared};
use crate::input::{Devices, Input, Leader, narrow, open_devices, shown_less};
use crate::loops::{self, Control, Sink, lockstep_on, realtime_on};
use crate::picture::{self, write_pictures};
use crate::planning::Planning;
use crate::prepare_command::check_patient;
use crate::profiles::{self, Store};
use crate::retry::{Moment, Recomputing, Schedule, recompute};
use crate::scenario::{self, Override, Scenario, Source};
use crate::session::{
    BoneSample, CrackMesh, GrowthSample, HandSample, HapticSample, Loop, MainSample, Metrics,
    MetricsDocument, Outcome, Pace, Recorder, Recording, SESSION, ScenarioMessage, Seen,
    SessionFolder, StepTime, Wire, write_crack, write_final_bone,
};
use crate::step_times::StepTimes;
use crate::talk::{self, Progress};
use crate::verify::Comparison;
use anyhow::{Context, Result, anyhow, bail};
use osteotome_devices::Binding;
use osteotome_mechanics::geometry::Pose;
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
    let (devices, notes) = open_devices(&scenario).map_err(Failure::Input)?;
    narrow(&mut scenario, &devices);
    notes.iter().for_each(|note| talk::say(note));
    let prepared = prepare(&scenario)?;
    let input = live(&scenario, &prepared, devices)?;
    let plan = Plan {
        scenario: &scenario,
        prepared: &prepared,
        mode: Mode::Realtime,
        out: &args.out,
        from: None,
        earlier: &[],
    };
    let ended = session(&plan, input)?;
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

/// `run`: any scenario, any input, either mode; or on from a moment of a recording.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let given = given(args)?;
    let profile = args.profile.as_deref().map(History::open);
    let mut profile = profile.transpose().map_err(Failure::Input)?;
    SessionFolder::check(&args.out, &SESSION).map_err(Failure::Input)?;
    let hands = match args.input.as_deref() {
        Some(path) if path != Path::new("builtin") => Some(recorded(path)?),
        _ => None,
    };
    let (mut scenario, from) = given;
    let devices = if hands.is_none() {
        users_devices(&mut scenario, args)?
    } else {
        [None, None]
    };
    let prepared = match (&from, &args.from) {
        (Some(moment), Some(path)) => prepare_recorded(&moment.recording, path)?,
        _ => prepare(&scenario)?,
    };
    if !args.json {
        say_remarks(&prepared);
    }
    let input = match (&from, &hands) {
        (None, None) => live(&scenario, &prepared, devices)?,
        (None, Some(hands)) => Input::recorded(&scenario, hands).map_err(Failure::Input)?,
        (Some(moment), hands) => resumed(moment, &scenario, &prepared, devices, hands.as_ref())?,
    };
    let plan = Plan {
        scenario: &scenario,
        prepared: &prepared,
        mode: args.mode,
        out: &args.out,
        from: from.as_ref(),
        earlier: profile.as_ref().map_or(&[], |p| &p.earlier),
    };
    let ended = session(&plan, input)?;
    // A session is worth keeping without its history.
    if let Some(profile) = &mut profile
        && let Err(error) = profile.take_in(&scenario.name, &args.out, &ended)
    {
        talk::complain(&error);
    }
    if args.json {
        talk::say(&json(&ended.document).map_err(Failure::Work)?);
    } else {
        tell(&ended, &args.out);
    }
    Ok(())
}

/// The profile that a session goes into.
pub struct History {
    store: Store,
    name: String,
    /// What is known of its sessions.
    pub earlier: Vec<Figures>,
}

impl History {
    /// A profile's.
    pub fn open(name: &str) -> Result<Self> {
        let mut store = profiles::store()?;
        Ok(Self {
            earlier: profiles::figures(&mut store, name)?,
            name: name.to_owned(),
            store,
        })
    }

    /// Takes in a session that has ended.
    pub fn take_in(&mut self, scenario: &str, folder: &Path, ended: &Ended) -> Result<()> {
        let Some(figures) = &ended.figures else {
            return Ok(());
        };
        profiles::add_to(&mut self.store, &self.name, scenario, folder, figures)
    }
}

/// Scenario, and the moment to go on from.
fn given(args: &RunArgs) -> Result<(Scenario, Option<Moment>), Failure> {
    if let (Some(path), Some(at)) = (&args.from, args.at) {
        let moment = Moment::read(path, at).map_err(Failure::Input)?;
        let mut scenario = moment.scenario_with(&args.set).map_err(Failure::Input)?;
        scenario.max_time = args.max_time.unwrap_or(scenario.max_time);
        if scenario.max_time <= moment.time() {
            return Err(Failure::Input(anyhow!(
                "the session would end at {} s, before it goes on at {at} s; give a larger --max-time",
                scenario.max_time
            )));
        }
        return Ok((scenario, Some(moment)));
    }
    let mut overrides = args.set.clone();
    let extra = [
        args.seed.map(|seed| format!("seed={seed}")),
        args.max_time.map(|time| format!("max_time={time:?}")),
    ];
    for text in extra.into_iter().flatten() {
        overrides.push(text.parse().map_err(Failure::Input)?);
    }
    // The command line sees to it that there is one.
    let file = args.scenario.clone().unwrap_or_default();
    Ok((load(&Source::File(file), &overrides)?, None))
}

/// Both hands of a recording.
fn recorded(path: &Path) -> Result<[Vec<HandSample>; 2], Failure> {
    let recording = Recording::read(path).map_err(Failure::Input)?;
    Ok(recording.hands)
}

/// The recorded hands up to the moment, then those of another recording, or the surgeon's and the user's.
fn resumed(
    moment: &Moment,
    scenario: &Scenario,
    prepared: &Prepared,
    devices: Devices,
    hands: Option<&[Vec<HandSample>; 2]>,
) -> Result<Input, Failure> {
    let before = &moment.recording.hands;
    let n = moment.steps as usize;
    let input = if let Some(after) = hands {
        let join = |i: usize| {
            let rest = after[i].get(n..).unwrap_or_default();
            [&before[i][..n], rest].concat()
        };
        Input::recorded(scenario, &[join(0), join(1)])
    } else {
        let leaders = devices.map(|d| d.map_or(Leader::Surgeon, |d| Leader::Device(Box::new(d))));
        Input::resumed(
            scenario,
            prepared.line.clone(),
            leaders,
            before,
            moment.steps,
        )
    };
    input.map_err(Failure::Input)
}

/// Physical devices live by the clock.
fn users_devices(scenario: &mut Scenario, args: &RunArgs) -> Result<Devices, Failure> {
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
    let (devices, mut notes) = open_devices(scenario).map_err(Failure::Input)?;
    if args.from.is_some() {
        notes.extend(shown_less(scenario, &devices));
    } else {
        narrow(scenario, &devices);
    }
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
    say_remarks(&prepared);
    let review = Planning::new(&prepared, &scenario).review().clone();
    for finding in review.faults.iter().chain(&review.remarks) {
        talk::say(&format!("Osteotomy: {finding}."));
    }
    Ok(())
}

fn say_remarks(prepared: &Prepared) {
    for remark in &prepared.remarks {
        talk::say(&format!("Note: {remark}."));
    }
}

/// `replay`: the figures of a recording, recomputed on demand.
pub fn replay(args: &ReplayArgs) -> Result<(), Failure> {
    let whole = Moment::end(&args.session).map_err(Failure::Input)?;
    let recording = &whole.recording;
    if !args.verify && args.out.is_none() {
        talk::say(&talk::summary(&recorded_figures(recording).outcome()));
        return Ok(());
    }
    let scenario = whole.scenario();
    let prepared = prepare_recorded(recording, &args.session)?;
    let input = || Input::recorded(scenario, &recording.hands).map_err(Failure::Input);
    if let Some(out) = &args.out {
        SessionFolder::check(out, &SESSION).map_err(Failure::Input)?;
        let plan = Plan {
            scenario,
            prepared: &prepared,
            mode: Mode::Lockstep,
            out,
            from: Some(&whole),
            earlier: &[],
        };
        let ended = session(&plan, input()?)?;
        tell(&ended, out);
    }
    if args.verify {
        verify(recording, &prepared, input()?)?;
    }
    Ok(())
}

fn verify(recording: &Recording, prepared: &Prepared, input: Input) -> Result<(), Failure> {
    let seconds = recording.seconds(&recording.scenario.scenario);
    let mut bar = Progress::new("Replaying", millis(seconds));
    let mut progress = |time: f64, _: bool| bar.set(millis(time), format!("{time:.1} s"));
    let report = verified(recording, prepared, input, &mut progress);
    bar.done();
    talk::say(&report?);
    Ok(())
}

/// Recomputes a recording and says how far it is off. Where it is known what its steps read of each other, it must agree to the last
/// bit.
pub fn verified(
    recording: &Recording,
    prepared: &Prepared,
    input: Input,
    progress: loops::Progress,
) -> Result<String, Failure> {
    let schedule = Schedule::of(recording);
    let mut comparison = Comparison::new(recording, &schedule);
    let what = Recomputing {
        recording,
        schedule: &schedule,
        steps: recording.hands[0].len() as u64,
        control: Control::default(),
    };
    let scenario = &recording.scenario.scenario;
    recompute(&what, prepared, scenario, input, &mut comparison, progress)
        .map_err(Failure::Work)?;
    let report = comparison.report();
    if schedule.is_known() && !comparison.is_exact() {
        return Err(Failure::Work(anyhow!(
            "{report} That is beyond the bound of 0: this build computes something else than the one that recorded it"
        )));
    }
    Ok(report)
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

fn live(scenario: &Scenario, prepared: &Prepared, devices: Devices) -> Result<Input, Failure> {
    Input::live(scenario, prepared.line.clone(), devices).map_err(Failure::Input)
}

/// How a session ended.
pub struct Ended {
    /// Its figures.
    pub metrics: Metrics,
    outcome: Outcome,
    document: MetricsDocument,
    score: Option<Score>,
    /// What a history keeps of it.
    pub figures: Option<Figures>,
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
fn session(plan: &Plan, input: Input) -> Result<Ended, Failure> {
    let scenario = plan.scenario;
    let mut bar = Progress::new(&scenario.name, millis(scenario.max_time));
    let mut drawing = Progress::new("Drawing", 1000);
    let mut progress = |advance: Advance| match advance {
        Advance::Recomputing { time, of } => {
            bar.set(millis(time), format!("recomputing {time:.1} of {of:.1} s"));
        }
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
    let ended = keep_session(plan, input, &mut watch);
    bar.done();
    drawing.done();
    ended
}

/// How far a session has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Advance {
    /// What was recorded before the moment that it goes on from is computed anew.
    Recomputing {
        /// Simulated time \[s\].
        time: f64,
        /// The moment \[s\].
        of: f64,
    },
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
pub struct Unseen;

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

/// The recorder, and who looks on beside it and before it.
struct Both<'a>(&'a mut dyn Sink, &'a mut dyn Sink);

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
    fn seen(&mut self, time: f64, of: Loop, seen: Seen) -> Result<()> {
        self.1.seen(time, of, seen)?;
        self.0.seen(time, of, seen)
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

/// A session to be run.
pub struct Plan<'a> {
    /// What.
    pub scenario: &'a Scenario,
    /// On whose bone.
    pub prepared: &'a Prepared,
    /// How it is driven.
    pub mode: Mode,
    /// Its folder.
    pub out: &'a Path,
    /// The moment that it goes on from.
    pub from: Option<&'a Moment>,
    /// Earlier sessions of whoever trains, for the learning curve.
    pub earlier: &'a [Figures],
}

impl Plan<'_> {
    fn first_message(&self, start: [Pose; 2]) -> ScenarioMessage {
        ScenarioMessage {
            scenario: self.scenario.clone(),
            patient_digest: self.prepared.digest.clone(),
            mode: self.mode.name().to_owned(),
            start: Some(start.map(|p| p.to_wire())),
            retried: self.from.map(Moment::origin),
        }
    }

    /// The session between two steps: before its first one, or at the moment that it goes on from.
    fn begin(
        &self,
        start: [Pose; 2],
        input: Input,
        sink: &mut Both,
        control: &Control,
        watch: &mut dyn FnMut(Advance),
    ) -> Result<EngineUnderway> {
        let Some(moment) = self.from else {
            let parts = engine::connect(self.prepared, self.scenario, start)?;
            return EngineUnderway::begin(parts, input, self.scenario, sink);
        };
        let schedule = Schedule::of(&moment.recording);
        let mut comparison = Comparison::new(&moment.recording, &schedule);
        let what = Recomputing {
            recording: &moment.recording,
            schedule: &schedule,
            steps: moment.steps,
            control: control.clone(),
        };
        let of = moment.time();
        let mut progress = |time: f64, _: bool| watch(Advance::Recomputing { time, of });
        let (underway, made) = recompute(
            &what,
            self.prepared,
            self.scenario,
            input,
            &mut Both(sink, &mut comparison),
            &mut progress,
        )?;
        let deviation = comparison.deviation();
        if control.is_stopped() {
            bail!("it was ended before the moment that it should go on from");
        }
        if made < moment.steps {
            bail!(
                "the recording breaks off; it can be gone on from up to {:.3} s",
                made as f64 * self.scenario.loops.dt()
            );
        }
        let from = &moment.origin().session_sha256[..12];
        sink.event(
            of,
            &format!("on from {of:.3} s of session {from}, recomputed {deviation}"),
        )?;
        Ok(underway)
    }
}

/// Runs a session and leaves its folder.
pub fn keep_session(plan: &Plan, mut input: Input, watch: &mut Watch) -> Result<Ended, Failure> {
    let Plan {
        scenario,
        prepared,
        mode,
        out,
        from,
        ..
    } = *plan;
    let start = match from {
        Some(moment) => moment.recording.start(),
        None => input.read().map(|r| r.pose),
    };
    input.rewind();
    // Numbers that the mechanics refuses are wrong input.
    engine::connect(prepared, scenario, start).map_err(Failure::Input)?;
    let folder = SessionFolder::create(out, &SESSION).map_err(Failure::Input)?;
    let first = plan.first_message(start);
    let work = || -> Result<Ended> {
        let mut recorder = Recorder::create(folder.path(), &first)?;
        let mut sink = Both(&mut recorder, watch.sink);
        let underway = plan.begin(start, input, &mut sink, &watch.control, watch.progress)?;
        let mut progress =
            |time: f64, is_severed: bool| (watch.progress)(Advance::Running { time, is_severed });
        let engine = match mode {
            Mode::Lockstep => lockstep_on(underway, scenario, &mut sink, &mut progress)?,
            Mode::Realtime => {
                let control = &watch.control;
                realtime_on(control, underway, scenario, &mut sink, &mut progress)?
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
        let bone = engine::final_bone(engine.main.bone(), engine.main.state());
        folder.write("bone_final.vtu", &write_final_bone(&bone))?;
        let metrics = recorder.finish()?;
        let mut ended = Ended {
            outcome: metrics.outcome(),
            document: metrics.document(),
            score: None,
            figures: None,
            drawn_on: None,
            metrics,
        };
        // A session is worth keeping without its debrief.
        if let Err(error) = look_back(plan, &engine, &folder, &mut ended, watch) {
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

/// What the recording that `folder` holds says: figures, and where pictures are wanted page and pictures.
fn look_back(
    plan: &Plan,
    engine: &Engine,
    folder: &SessionFolder,
    ended: &mut Ended,
    watch: &mut Watch,
) -> Result<()> {
    let prepared = plan.prepared;
    let recording = Recording::read(&folder.path().join("session.mcap"))?;
    let findings = Findings::of(prepared, &recording).context("the debrief")?;
    let score = findings.score(&recording);
    ended.document.complete(&findings, score.clone());
    let figures = Figures::of(&recording.scenario.scenario.name, &findings, &score);
    let mut times = StepTimes::default();
    let tools = engine::tools_among(prepared, plan.scenario)?;
    times.contact(engine, &tools, &recording.hands);
    times.growths(prepared, &recording)?;
    if watch.draws {
        let subject = Subject {
            prepared,
            recording: &recording,
            findings: &findings,
            score: &score,
            figures: &figures,
        };
        let mut curve = plan.earlier.to_vec();
        if !curve.is_empty() {
            curve.push(figures.clone());
        }
        let html = page(&subject, None, &curve).context("the debrief page")?;
        folder.write("report.html", &html)?;
        let drawn = pictures(prepared, folder.path(), &recording, &mut times, watch)?;
        ended.drawn_on = Some(drawn);
    }
    ended.document.time_steps(&times);
    ended.score = Some(score);
    ended.figures = Some(figures);
    Ok(())
}

/// Draws the session that `folder` holds; says where they were drawn.
fn pictures(
    prepared: &Prepared,
    folder: &Path,
    recording: &Recording,
    times: &mut StepTimes,
    watch: &mut Watch,
) -> Result<String> {
    let mut progress = |done: usize, of: usize| (watch.progress)(Advance::Drawing { done, of });
    let mut stage = picture::Stage::new(prepared, recording)?;
    let mut renderer = Renderer::fastest();
    let pictures = folder.join("pictures");
    write_pictures(&mut stage, &mut renderer, &pictures, &mut progress)
        .context("the pictures of the session")?;
    times.views(&mut stage, &mut renderer)?;
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
