//! The life of sessions behind the window, without a window: prepare, start, pause, end, again.
//!
//! Work is done on threads of its own, one at a time; [`Conductor::poll`] looks how far it is. Whatever ends a session (reset,
//! another scenario, closing the window), the session's folder is finished first.
use super::catalogue::{self, Leading};
use super::live::{Feed, SharedLive, look};
use crate::cli::{Failure, Mode};
use crate::commands::{Advance, Watch, keep_session};
use crate::engine::{self, Prepared};
use crate::input::{Input, Leader, open_devices};
use crate::loops::{Control, Published, Sink, Subscribed, latest};
use crate::scenario::{Override, Scenario};
use crate::session::Metrics;
use anyhow::{Context, Result, anyhow};
use osteotome_devices::Binding;
use osteotome_mechanics::geometry::Pose;
use std::path::{Path, PathBuf};
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
}

/// A session that has ended and is kept.
pub struct Kept {
    /// Its figures.
    pub metrics: Metrics,
    /// Its folder.
    pub folder: PathBuf,
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
    Session(Job<Kept>),
}

/// What comes after the work at hand.
enum Next {
    Clear,
    Select(String),
    Start(Setup),
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
            notice: None,
        }
    }

    /// What goes on.
    pub fn phase(&self) -> Phase {
        match &self.work {
            Work::Preparing(_) => Phase::Preparing,
            Work::Session(_) if self.is_ending || look(&self.live).has_ended => Phase::Keeping,
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
        self.next = Some(Next::Start(setup));
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
            Work::Session(job) => job.thread.is_finished(),
        };
        if is_done {
            match std::mem::replace(&mut self.work, Work::None) {
                Work::None => {}
                Work::Preparing(job) => self.prepared(job.finish()),
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
            Some(Next::Start(setup)) => self.begin(setup),
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

    fn begin(&mut self, setup: Setup) -> Result<()> {
        let Some(ready) = self.ready.clone() else {
            return Ok(());
        };
        let told = [0, 1].map(|i| {
            let is_mouse = setup.hands[i] == Leading::Mouse;
            let (guide, hears) = is_mouse.then(|| latest(&ready.start[i])).unzip();
            self.guides[i] = guide;
            hears
        });
        self.control = Control::default();
        self.is_ending = false;
        self.clear();
        let (control, live) = (self.control.clone(), self.live.clone());
        self.work = Work::Session(Job::start("session", move |stand| {
            session(&ready, &setup, told, control, &live, stand)
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
    let scenario = catalogue::load(name, overrides)?;
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

fn session(
    ready: &Ready,
    setup: &Setup,
    told: [Option<Subscribed<Pose>>; 2],
    control: Control,
    live: &SharedLive,
    stand: &Stand,
) -> Result<Kept> {
    let mut scenario = ready.scenario.clone();
    for (tool, hand) in scenario.tool.iter_mut().zip(&setup.hands) {
        tool.device = match hand {
            Leading::Device(binding) => binding.clone(),
            _ => Binding::Simulated,
        };
    }
    if setup.hands.iter().any(|h| *h != Leading::Surgeon) {
        scenario.max_time = scenario.max_time.max(USERS_TIME);
    }
    let (devices, notes) = open_devices(&mut scenario)?;
    let mut devices = devices.into_iter();
    let leaders = told.map(|t| match (t, devices.next().flatten()) {
        (Some(told), _) => Leader::Guide(told),
        (None, Some(device)) => Leader::Device(Box::new(device)),
        (None, None) => Leader::Surgeon,
    });
    let input = Input::led(&scenario, ready.prepared.line.clone(), leaders)?;
    let folder = free_folder(&setup.sessions, &scenario.name)?;
    let mut feed = Feed::new(live.clone(), &scenario);
    for note in notes {
        feed.event(0.0, &note)?;
    }
    let mut progress = |advance: Advance| match advance {
        Advance::Running { .. } => {}
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
        control,
        sink: &mut feed,
        progress: &mut progress,
        draws: setup.draws,
    };
    let ended = keep_session(
        &scenario,
        &ready.prepared,
        input,
        Mode::Realtime,
        &folder,
        &mut watch,
    );
    let ended = ended.map_err(|failure| match failure {
        Failure::Input(error) | Failure::Work(error) => error,
    })?;
    Ok(Kept {
        metrics: ended.metrics,
        folder,
        is_last_word: true,
    })
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
