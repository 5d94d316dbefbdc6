//! The life of sessions behind the window, without a window: prepare, start, pause, end, again.
//!
//! Work is done on threads of its own, one at a time; [`Conductor::poll`] looks how far it is. Whatever ends a session (reset,
//! another scenario, closing the window), the session's folder is finished first.
use super::catalogue::{self, Leading};
use super::live::{Feed, SharedLive, look};
use super::look_back::LookBack;
use crate::cli::{Failure, Mode};
use crate::commands::{Advance, History, Plan, Watch, keep_session};
use crate::debrief::Figures;
use crate::engine::{self, Prepared};
use crate::input::{Input, Leader, narrow, open_devices, shown_less};
use crate::loops::{Control, Published, Sink, Subscribed, latest};
use crate::retry::Moment;
use crate::scenario::{Override, Scenario};
use crate::session::{Metrics, ScenarioMessage};
use anyhow::{Context, Result, anyhow, ensure};
use osteotome_devices::Binding;
use osteotome_mechanics::geometry::Pose;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

/// A user's session may last at least so long \[s\]: the scenario's limit is meant for the built-in surgeon.
const USERS_TIME: f64 = 600.0;

/// A patient on whom a session can begin.
pub struct Ready {
    /// The scenario.
    pub scenario: Scenario,
    /// Its patient.
    pub prepared: Prepared,
    /// Where hands begin.
    pub start: [Pose; 2],
}

/// How a session is to be run.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Who leads.
    pub hands: [Leading; 2],
    /// Under which its folder goes.
    pub sessions: PathBuf,
    /// Whether pictures belong into it.
    pub draws: bool,
    /// Whose history it goes into.
    pub profile: Option<String>,
}

/// A session that has ended and is kept.
pub struct Kept {
    /// Its figures.
    pub metrics: Metrics,
    /// Its folder.
    pub folder: PathBuf,
    /// Its score \[%\].
    pub score: Option<f64>,
    /// Why it is not in the history that it should be in.
    pub fault: Option<String>,
    /// Whether nothing else was asked for meanwhile, so that its figures are of interest.
    pub is_last_word: bool,
}

/// What goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// No scenario that could be used.
    Empty,
    /// A patient is meshed.
    Preparing,
    /// A session can begin.
    Ready,
    /// What came before the moment that it goes on from is computed anew.
    Recomputing,
    /// It runs.
    Running,
    /// Its time stands still.
    Paused,
    /// It has ended and its folder is being finished.
    Keeping,
}

enum Work {
    None,
    Preparing(Job<Ready>),
    Opening(Job<Opened>),
    Session(Job<Kept>),
}

/// A recording that is to be looked at, and its patient if it is another one.
struct Opened {
    back: LookBack,
    ready: Option<Ready>,
}

/// What comes after the work at hand.
enum Next {
    Clear,
    Select(String),
    Start(Setup, Option<Moment>),
    Open(PathBuf),
}

/// Words and share of what a thread does.
type Stand = Arc<Mutex<(String, f32)>>;

struct Job<T> {
    thread: JoinHandle<Result<T>>,
    stand: Stand,
}

impl<T: Send + 'static> Job<T> {
    fn start(name: &str, work: impl FnOnce(&Stand) -> Result<T> + Send + 'static) -> Result<Self> {
        let stand = Stand::default();
        let told = stand.clone();
        let thread = Builder::new()
            .name(name.to_owned())
            .spawn(move || work(&told))?;
        Ok(Self { thread, stand })
    }

    fn finish(self) -> Result<T> {
        let panicked = |_| anyhow!("the work stopped unexpectedly; its message is on the terminal");
        self.thread.join().map_err(panicked)?
    }
}

fn tell(stand: &Stand, words: impl Into<String>, share: f32) {
    *stand.lock().unwrap_or_else(PoisonError::into_inner) = (words.into(), share);
}

/// See the module.
pub struct Conductor {
    live: SharedLive,
    overrides: Vec<Override>,
    work: Work,
    next: Option<Next>,
    ready: Option<Arc<Ready>>,
    control: Control,
    is_ending: bool,
    guides: [Option<Published<Pose>>; 2],
    kept: Option<Kept>,
    opened: Option<LookBack>,
    start_of_hands: Option<[Pose; 2]>,
    /// Whether the session that has begun is still on its way to its moment.
    is_recomputing: Arc<AtomicBool>,
    notice: Option<String>,
}

impl Conductor {
    /// With no patient yet. `overrides` go over every scenario.
    pub fn new(live: SharedLive, overrides: Vec<Override>) -> Self {
        Self {
            live,
            overrides,
            work: Work::None,
            next: None,
            ready: None,
            control: Control::default(),
            is_ending: false,
            guides: [None, None],
            kept: None,
            opened: None,
            start_of_hands: None,
            is_recomputing: Arc::default(),
            notice: None,
        }
    }

    /// What goes on.
    pub fn phase(&self) -> Phase {
        match &self.work {
            Work::Preparing(_) | Work::Opening(_) => Phase::Preparing,
            Work::Session(_) if self.is_ending || look(&self.live).has_ended => Phase::Keeping,
            Work::Session(_) if self.is_recomputing.load(Ordering::Acquire) => Phase::Recomputing,
            Work::Session(_) if self.control.is_paused() => Phase::Paused,
            Work::Session(_) => Phase::Running,
            Work::None if self.ready.is_some() => Phase::Ready,
            Work::None => Phase::Empty,
        }
    }

    /// What the thread at work says, and how far it is, 0 to 1.
    pub fn stand(&self) -> (String, f32) {
        let stand = match &self.work {
            Work::None => return Default::default(),
            Work::Preparing(job) => &job.stand,
            Work::Opening(job) => &job.stand,
            Work::Session(job) => &job.stand,
        };
        stand.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The patient, once there is one.
    pub fn ready(&self) -> Option<&Arc<Ready>> {
        self.ready.as_ref()
    }

    /// The last session that has ended, once.
    pub fn take_kept(&mut self) -> Option<Kept> {
        self.kept.take()
    }

    /// The recording that has been opened, once.
    pub fn take_opened(&mut self) -> Option<LookBack> {
        self.opened.take()
    }

    /// Where the hands of the session begin that has begun, or would.
    pub fn start_of_hands(&self) -> Option<[Pose; 2]> {
        self.start_of_hands.or(self.ready.as_ref().map(|r| r.start))
    }

    /// What went wrong, once.
    pub fn take_notice(&mut self) -> Option<String> {
        self.notice.take()
    }

    /// The ends by which a user leads the hands of the session that has begun, once.
    pub fn take_guides(&mut self) -> [Option<Published<Pose>>; 2] {
        std::mem::take(&mut self.guides)
    }

    /// Goes over to a scenario; a session that runs is ended and kept first.
    pub fn select(&mut self, name: &str) {
        self.next = Some(Next::Select(name.to_owned()));
        self.finish();
        self.go_on();
    }

    /// Begins a session, or begins again: one that runs is ended and kept first.
    pub fn start(&mut self, setup: Setup) {
        self.next = Some(Next::Start(setup, None));
        self.finish();
        self.go_on();
    }

    /// Goes on live from a moment of a recording; it waits there, paused.
    pub fn go_on_from(&mut self, setup: Setup, moment: Moment) {
        self.next = Some(Next::Start(setup, Some(moment)));
        self.finish();
        self.go_on();
    }

    /// Reads a recording to be looked at; a session that runs is ended and kept first.
    pub fn open(&mut self, path: &Path) {
        self.next = Some(Next::Open(path.to_owned()));
        self.finish();
        self.go_on();
    }

    /// Lets the session's time stand still, or go on.
    pub fn pause(&mut self, is_paused: bool) {
        self.control.pause(is_paused);
    }

    /// Ends the session; its folder stays.
    pub fn finish(&mut self) {
        if matches!(self.work, Work::Session(_)) {
            self.is_ending = true;
            self.control.stop();
        }
    }

    /// Ends the session and shows the patient as at the beginning.
    pub fn reset(&mut self) {
        self.next = Some(Next::Clear);
        self.finish();
        self.go_on();
    }

    fn clear(&self) {
        let mut live = look(&self.live);
        let revision = live.revision + 1;
        *live = super::live::Live {
            revision,
            ..Default::default()
        };
    }

    /// Looks whether work is done, and goes on with what is to come. Never waits.
    pub fn poll(&mut self) {
        let is_done = match &self.work {
            Work::None => false,
            Work::Preparing(job) => job.thread.is_finished(),
            Work::Opening(job) => job.thread.is_finished(),
            Work::Session(job) => job.thread.is_finished(),
        };
        if is_done {
            match std::mem::replace(&mut self.work, Work::None) {
                Work::None => {}
                Work::Preparing(job) => self.prepared(job.finish()),
                Work::Opening(job) => self.has_opened(job.finish()),
                Work::Session(job) => self.session_ended(job.finish()),
            }
        }
        self.go_on();
    }

    fn prepared(&mut self, result: Result<Ready>) {
        match result {
            Ok(ready) => self.ready = Some(Arc::new(ready)),
            Err(error) => self.complain(&error),
        }
    }

    fn session_ended(&mut self, result: Result<Kept>) {
        self.is_ending = false;
        match result {
            Ok(kept) => {
                let is_last_word = self.next.is_none();
                self.kept = Some(Kept {
                    is_last_word,
                    ..kept
                });
            }
            Err(error) => {
                self.next = None;
                self.complain(&error);
            }
        }
    }

    fn complain(&mut self, error: &anyhow::Error) {
        self.notice = Some(format!("{error:#}"));
    }

    fn go_on(&mut self) {
        if !matches!(self.work, Work::None) {
            return;
        }
        let begun = match self.next.take() {
            Some(Next::Clear) => {
                self.clear();
                Ok(())
            }
            Some(Next::Select(name)) => self.prepare(name),
            Some(Next::Start(setup, from)) => self.begin(setup, from),
            Some(Next::Open(path)) => self.read(path),
            None => Ok(()),
        };
        if let Err(error) = begun {
            self.complain(&error);
        }
    }

    fn prepare(&mut self, name: String) -> Result<()> {
        self.clear();
        self.ready = None;
        let overrides = self.overrides.clone();
        self.work = Work::Preparing(Job::start("prepare", move |stand| {
            ready(&name, &overrides, stand)
        })?);
        Ok(())
    }

    fn read(&mut self, path: PathBuf) -> Result<()> {
        let now = self.ready.clone();
        self.work = Work::Opening(Job::start("open", move |stand| {
            tell(stand, "Reading the recording", 0.0);
            let back = LookBack::read(&path)?;
            let message = &back.recording().scenario;
            let is_same = now.is_some_and(|r| r.prepared.digest == message.patient_digest);
            let ready = match is_same {
                true => None,
                false => Some(recorded(message, stand)?),
            };
            Ok(Opened { back, ready })
        })?);
        Ok(())
    }

    fn has_opened(&mut self, result: Result<Opened>) {
        match result {
            Ok(Opened { back, ready }) => {
                if let Some(ready) = ready {
                    self.ready = Some(Arc::new(ready));
                }
                self.opened = Some(back);
            }
            Err(error) => self.complain(&error),
        }
    }

    fn begin(&mut self, setup: Setup, from: Option<Moment>) -> Result<()> {
        let Some(ready) = self.ready.clone() else {
            return Ok(());
        };
        let start = from.as_ref().map_or(ready.start, Moment::devices);
        self.start_of_hands = Some(start);
        let told = [0, 1].map(|i| {
            let is_mouse = setup.hands[i] == Leading::Mouse;
            let (guide, hears) = is_mouse.then(|| latest(&start[i])).unzip();
            self.guides[i] = guide;
            hears
        });
        self.control = Control::default();
        self.is_ending = false;
        self.clear();
        // Whoever is to go on takes the handles first.
        self.control.pause(from.is_some());
        self.is_recomputing = Arc::new(AtomicBool::new(from.is_some()));
        let (control, live) = (self.control.clone(), self.live.clone());
        let is_recomputing = self.is_recomputing.clone();
        self.work = Work::Session(Job::start("session", move |stand| {
            let begun = Begun {
                setup: &setup,
                told,
                control,
                from: from.as_ref(),
                is_recomputing: &is_recomputing,
            };
            session(&ready, begun, &live, stand)
        })?);
        Ok(())
    }
}

impl Drop for Conductor {
    /// However the window goes away, a session that runs is kept.
    fn drop(&mut self) {
        self.finish();
        if let Work::Session(job) = std::mem::replace(&mut self.work, Work::None) {
            // Nobody is left to be told.
            let _ = job.finish();
        }
    }
}

fn ready(name: &str, overrides: &[Override], stand: &Stand) -> Result<Ready> {
    made_ready(catalogue::load(name, overrides)?, stand)
}

fn made_ready(scenario: Scenario, stand: &Stand) -> Result<Ready> {
    let mut progress = |stage: &str, share: f64| tell(stand, stage, share as f32);
    let prepared = engine::prepare(&scenario, &mut progress)?;
    let start = Input::built_in(&scenario, prepared.line.clone())?.read();
    let start = start.map(|r| r.pose);
    // What the loops would refuse is refused before the user presses start.
    engine::connect(&prepared, &scenario, start)?;
    Ok(Ready {
        scenario,
        prepared,
        start,
    })
}

/// The patient of a recording, which must still be the one that its scenario gives.
fn recorded(message: &ScenarioMessage, stand: &Stand) -> Result<Ready> {
    let ready = made_ready(message.scenario.clone(), stand)?;
    ensure!(
        ready.prepared.digest == message.patient_digest,
        "the bone built from the recording's scenario is not the one recorded; its files have changed"
    );
    Ok(ready)
}

/// What a session begins with.
struct Begun<'a> {
    setup: &'a Setup,
    told: [Option<Subscribed<Pose>>; 2],
    control: Control,
    from: Option<&'a Moment>,
    is_recomputing: &'a AtomicBool,
}

/// The scenario with the hands that were chosen.
fn chosen(scenario: &Scenario, setup: &Setup, from: Option<&Moment>) -> Scenario {
    let mut scenario = scenario.clone();
    for (tool, hand) in scenario.tool.iter_mut().zip(&setup.hands) {
        tool.device = match hand {
            Leading::Device(binding) => binding.clone(),
            _ => Binding::Simulated,
        };
    }
    let before = from.map_or(0.0, Moment::time);
    if setup.hands.iter().any(|h| *h != Leading::Surgeon) || before >= scenario.max_time {
        scenario.max_time = scenario.max_time.max(before + USERS_TIME);
    }
    scenario
}

fn session(ready: &Ready, begun: Begun, live: &SharedLive, stand: &Stand) -> Result<Kept> {
    let Begun { setup, from, .. } = begun;
    let mut scenario = chosen(from.map_or(&ready.scenario, Moment::scenario), setup, from);
    let (devices, mut notes) = open_devices(&scenario)?;
    if from.is_some() {
        notes.extend(shown_less(&scenario, &devices));
    } else {
        narrow(&mut scenario, &devices);
    }
    let mut devices = devices.into_iter();
    let leaders = begun.told.map(|t| match (t, devices.next().flatten()) {
        (Some(told), _) => Leader::Guide(told),
        (None, Some(device)) => Leader::Device(Box::new(device)),
        (None, None) => Leader::Surgeon,
    });
    let line = ready.prepared.line.clone();
    let input = match from {
        None => Input::led(&scenario, line, leaders)?,
        Some(m) => Input::resumed(&scenario, line, leaders, &m.recording.hands, m.steps)?,
    };
    let folder = free_folder(&setup.sessions, &scenario.name)?;
    let mut feed = Feed::new(live.clone(), &scenario);
    for note in notes {
        feed.event(0.0, &note)?;
    }
    let is_recomputing = begun.is_recomputing;
    let mut progress = |advance: Advance| match advance {
        Advance::Running { .. } => is_recomputing.store(false, Ordering::Release),
        Advance::Recomputing { time, of } => {
            let words = format!("Recomputing {time:.1} of {of:.1} s");
            tell(stand, words, (time / of) as f32);
        }
        Advance::Drawing { done, of } => {
            let share = (done as f32 + 0.5) / of as f32;
            tell(
                stand,
                format!("Drawing picture {done} of {of}"),
                share.min(1.0),
            );
        }
    };
    let mut watch = Watch {
        control: begun.control,
        sink: &mut feed,
        progress: &mut progress,
        draws: setup.draws,
    };
    let mut history = setup.profile.as_deref().map(History::open);
    let known = history.as_ref().and_then(|h| h.as_ref().ok());
    let plan = Plan {
        scenario: &scenario,
        prepared: &ready.prepared,
        mode: Mode::Realtime,
        out: &folder,
        from,
        earlier: known.map_or(&[], |h| &h.earlier),
    };
    let ended = keep_session(&plan, input, &mut watch).map_err(plain)?;
    is_recomputing.store(false, Ordering::Release);
    let taken = history.as_mut().map(|h| match h {
        Ok(history) => history.take_in(&scenario.name, &folder, &ended),
        Err(error) => Err(anyhow!("the session is kept, but in no history: {error:#}")),
    });
    Ok(Kept {
        score: ended.figures.as_ref().and_then(Figures::score),
        metrics: ended.metrics,
        folder,
        fault: taken.and_then(Result::err).map(|e| format!("{e:#}")),
        is_last_word: true,
    })
}

fn plain(failure: Failure) -> anyhow::Error {
    match failure {
        Failure::Input(error) | Failure::Work(error) => error,
    }
}

/// The next number under `sessions`, with the scenario's name.
fn free_folder(sessions: &Path, name: &str) -> Result<PathBuf> {
    std::fs::create_dir_all(sessions)
        .with_context(|| format!("sessions cannot be kept in {}", sessions.display()))?;
    let mut highest = 0;
    for entry in std::fs::read_dir(sessions)? {
        let name = entry?.file_name();
        let name = name.to_string_lossy();
        let digits = name.split('-').next().unwrap_or_default();
        highest = highest.max(digits.parse::<u32>().unwrap_or(0));
    }
    let words: Vec<String> = name
        .split(|c: char| !c.is_alphanumeric())
        .filter(|w| !w.is_empty())
        .map(str::to_lowercase)
        .collect();
    let slug: String = words.join("-").chars().take(40).collect();
    Ok(sessions.join(format!("{:04}-{slug}", highest.saturating_add(1))))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::live::SharedLive;
    use super::*;
    use std::time::{Duration, Instant};

    pub fn until(conductor: &mut Conductor, what: &str, mut is_so: impl FnMut(&Conductor) -> bool) {
        let start = Instant::now();
        loop {
            conductor.poll();
            if is_so(conductor) {
                return;
            }
            assert!(
                start.elapsed() < Duration::from_secs(300),
                "still not: {what}; {:?} {:?}",
                conductor.phase(),
                conductor.notice
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub fn conductor() -> (Conductor, SharedLive) {
        let live = SharedLive::default();
        let overrides = ["mesh.nodes=200", "mesh.shell_points=4000"];
        let overrides = overrides.map(|o| o.parse().unwrap()).to_vec();
        let mut conductor = Conductor::new(live.clone(), overrides);
        conductor.select("bsso-right");
        until(&mut conductor, "ready", |c| c.phase() == Phase::Ready);
        (conductor, live)
    }

    pub fn setup(folder: &Path) -> Setup {
        Setup {
            hands: [Leading::Surgeon, Leading::Mouse],
            sessions: folder.to_owned(),
            draws: false,
            profile: None,
        }
    }

    pub fn has_begun(live: &SharedLive) -> bool {
        look(live).time > 0.02
    }

    #[test]
    fn a_session_runs_stands_still_ends_and_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (mut c, live) = conductor();
        c.start(setup(folder.path()));
        assert!(c.take_guides()[1].is_some() && c.take_guides()[1].is_none());
        until(&mut c, "begun", |_| has_begun(&live));
        c.pause(true);
        assert_eq!(c.phase(), Phase::Paused);
        until(&mut c, "told", |_| {
            look(&live).events.iter().any(|e| e.1 == "paused")
        });
        c.pause(false);
        assert_eq!(c.phase(), Phase::Running);
        c.reset();
        assert_eq!(c.phase(), Phase::Keeping);
        until(&mut c, "kept", |c| c.phase() == Phase::Ready);
        let kept = c.take_kept().unwrap();
        assert!(!kept.is_last_word && look(&live).time == 0.0);
        assert!(kept.folder.ends_with("0001-bsso-right-side"));
        for file in [
            "session.mcap",
            "metrics.json",
            "crack.ply",
            "bone_final.vtu",
        ] {
            assert!(kept.folder.join(file).is_file(), "{file}");
        }
        c.select("no/such.toml");
        until(&mut c, "refused", |c| c.phase() == Phase::Empty);
        assert!(c.take_notice().unwrap().contains("no/such.toml"));
    }

    #[test]
    fn trying_again_keeps_the_session_before() {
        let folder = tempfile::tempdir().unwrap();
        let (mut c, live) = conductor();
        for n in 1..=3 {
            c.start(setup(folder.path()));
            until(&mut c, "begun", |c| {
                c.phase() == Phase::Running && has_begun(&live)
            });
            let kept = std::fs::read_dir(folder.path()).unwrap().count();
            assert_eq!(kept, n, "those before, and the one under way");
        }
        c.finish();
        until(&mut c, "kept", |c| c.phase() == Phase::Ready);
        assert!(
            folder
                .path()
                .join("0003-bsso-right-side/session.mcap")
                .is_file()
        );
    }
}
