//! What the window must never do to a session, and what sessions must leave behind.
use super::conductor::tests::{conductor, has_begun, setup, until};
use super::conductor::{Conductor, Phase};
use super::eye::{Eye, Look, Seen};
use super::live::{Feed, SharedLive, look};
use crate::loops::tests::{parts, scenario, surgeon};
use crate::loops::{Control, HandOutput, HapticPart, Parts, realtime_under};
use crate::picture::View;
use osteotome_mechanics::geometry::{Pose, Vec3};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A haptic part whose steps are counted.
struct Counted<H>(H, Arc<AtomicU64>);

impl<H: HapticPart> HapticPart for Counted<H> {
    fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2] {
        self.1.fetch_add(1, Ordering::Relaxed);
        self.0.step(devices, dt)
    }
    fn line(&mut self) -> &[Vec3] {
        self.0.line()
    }
    fn fault(&self) -> Option<String> {
        self.0.fault()
    }
}

/// Waits for something that only a loop that goes on can bring about.
fn wait(what: &str, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(
            start.elapsed() < Duration::from_secs(300),
            "still not: {what}"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The window and the loops share nothing but what the recording thread writes for it. A window that holds all of that for a
/// thousand haptic steps holds no loop up: they are made while it does, and none of their samples is lost.
#[test]
fn a_window_that_holds_on_to_all_it_shares_holds_up_no_loop() {
    let scenario = scenario(&["max_time=600.0"]);
    let live = SharedLive::default();
    let (control, steps) = (Control::default(), Arc::new(AtomicU64::new(0)));
    let Parts {
        haptic,
        main,
        propagation,
    } = parts();
    let parts = Parts {
        haptic: Counted(haptic, steps.clone()),
        main,
        propagation,
    };
    std::thread::scope(|scope| {
        scope.spawn(|| {
            wait("a first sample", || look(&live).time > 0.0);
            let held = look(&live);
            let from = steps.load(Ordering::Relaxed);
            wait("1000 steps", || steps.load(Ordering::Relaxed) > from + 1000);
            assert!(
                held.time < 1e-3 * (from + 1000) as f64,
                "the recording thread got past the window"
            );
            drop(held);
            control.stop();
        });
        let mut feed = Feed::new(live.clone(), &scenario);
        let input = surgeon(&scenario);
        realtime_under(&control, parts, input, &scenario, &mut feed, &mut |_, _| {}).unwrap();
    });
    let live = look(&live);
    assert!(
        !live.events.iter().any(|e| e.1.contains("not recorded")),
        "{:?}",
        live.events
    );
    let told = live.traces.back().unwrap().0;
    let made = 1e-3 * steps.load(Ordering::Relaxed) as f64;
    assert!(told > made - 0.05, "told until {told} s of {made} s");
}

fn eye(conductor: &Conductor, live: &SharedLive, size: [usize; 2]) -> Eye {
    let eye = Eye::open(live.clone(), || {}).unwrap();
    let ready = conductor.ready().unwrap();
    let aspect = size[0] as f64 / size[1] as f64;
    let look = Look {
        camera: View::Close.camera(&ready.prepared, aspect),
        size,
        is_transparent: false,
        shows_loads: true,
        shows_head: false,
        apart: 0.0,
        stereo: None,
    };
    eye.wish(look, ready);
    eye
}

fn next_picture(eye: &Eye) -> Seen {
    let seen = std::cell::RefCell::new(None);
    wait("a picture", || {
        *seen.borrow_mut() = eye.take();
        seen.borrow().is_some()
    });
    let seen = seen.into_inner().unwrap();
    assert_eq!(seen.fault, None);
    seen
}

/// Pictures of a quarter of a million pixels while a session runs: it goes on between two of them, and what comes meanwhile is dropped.
#[test]
fn a_slow_drawer_drops_frames_and_the_session_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (mut c, live) = conductor();
    c.start(setup(folder.path()));
    until(&mut c, "begun", |_| has_begun(&live));
    let eye = eye(&c, &live, [2048, 2048]);
    let mut most = 0;
    for _ in 0..2 {
        next_picture(&eye);
        let from = look(&live).revision;
        next_picture(&eye);
        most = most.max(look(&live).revision - from);
    }
    // A revision is twenty haptic steps, or a state of the bone.
    assert!(most > 3, "{most} revisions between two pictures");
    drop(eye);
    c.reset();
    until(&mut c, "kept", |c| c.phase() == Phase::Ready);
    let kept = c.take_kept().unwrap();
    let text = std::fs::read_to_string(kept.folder.join("metrics.json")).unwrap();
    assert!(!text.contains("were not recorded"), "{text}");
}

/// Figures of this process.
#[cfg(target_os = "linux")]
#[derive(Debug)]
struct Held {
    /// Resident memory \[pages\].
    pages: f64,
    threads: usize,
    files: usize,
}

#[cfg(target_os = "linux")]
impl Held {
    fn now() -> Self {
        let entries = |path| std::fs::read_dir(path).unwrap().count();
        let text = std::fs::read_to_string("/proc/self/statm").unwrap();
        Self {
            pages: text.split(' ').nth(1).unwrap().parse().unwrap(),
            threads: entries("/proc/self/task"),
            files: entries("/proc/self/fd"),
        }
    }

    /// Once threads that are about to end have ended.
    fn at_rest() -> Self {
        let mut held = Self::now();
        for _ in 0..20 {
            std::thread::sleep(Duration::from_millis(50));
            let now = Self::now();
            held.threads = held.threads.min(now.threads);
            held.files = held.files.min(now.files);
            held.pages = now.pages;
        }
        held
    }
}

/// Whether this process runs the test alone; else it has had another do so.
#[cfg(target_os = "linux")]
fn is_alone(test: &str) -> bool {
    const ALONE: &str = "OSTEOTOME_TEST_ALONE";
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let mut command = std::process::Command::new(std::env::current_exe().unwrap());
    command
        .args([test, "--exact", "--nocapture"])
        .env(ALONE, "1");
    assert!(command.status().unwrap().success(), "{test}");
    false
}

/// 1,000 resets with OSTEOTOME_LONG=1, 20 without, with the eye open. The first are for pools and allocators to settle.
#[cfg(target_os = "linux")]
#[test]
fn resets_leave_memory_threads_and_files_as_they_were() {
    if !is_alone("window::soak::resets_leave_memory_threads_and_files_as_they_were") {
        return;
    }
    let is_long = std::env::var_os("OSTEOTOME_LONG").is_some();
    let (n, settling) = if is_long { (1000, 50) } else { (20, 8) };
    let (mut c, live) = conductor();
    let eye = eye(&c, &live, [64, 64]);
    let mut settled = None;
    for k in 0..n {
        let folder = tempfile::tempdir().unwrap();
        c.start(setup(folder.path()));
        until(&mut c, "begun", |_| has_begun(&live));
        c.reset();
        until(&mut c, "kept", |c| c.phase() == Phase::Ready);
        assert!(c.take_kept().is_some(), "{:?}", c.take_notice());
        if k + 1 == settling {
            next_picture(&eye);
            settled = Some(Held::at_rest());
        }
    }
    let (before, after) = (settled.unwrap(), Held::at_rest());
    assert_eq!([before.threads, before.files], [after.threads, after.files]);
    let grown = after.pages / before.pages - 1.0;
    let words = format!(
        "memory grew by {:.1} % from {settling} to {n} resets: {before:?}, {after:?}",
        100.0 * grown
    );
    crate::talk::say(&words);
    assert!(grown < 0.08, "{words}");
}
