use super::exchange::{Control, Looked, RingIn, RingsOut, Shared, Timed, latest, rings};
use super::lockstep::timed;
use super::{
    BoneClock, HapticLoop, HapticPart, MainPart, Parts, Progress, Propagated, PropagationPart,
    Published, Sink, Subscribed, Underway, view,
};
use crate::input::Input;
use crate::scenario::Scenario;
use crate::session::{BoneSample, HapticSample, Loop, MainSample, Pace, StepTime};
use crate::surgeon::CrackView;
use anyhow::{Result, anyhow};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread::{Builder, ScopedJoinHandle};
use std::time::{Duration, Instant};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// Runs a session from three threads against the clock; this thread records. Gives the parts back.
///
/// # Errors
/// What the sink reports, or that a loop panicked.
pub fn realtime<H: HapticPart, M: MainPart, P: PropagationPart>(
    parts: Parts<H, M, P>,
    input: Input,
    scenario: &Scenario,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<Parts<H, M, P>> {
    realtime_under(&Control::default(), parts, input, scenario, sink, progress)
}

/// Likewise, paused and stopped from outside.
///
/// # Errors
/// As [`realtime`].
pub fn realtime_under<H: HapticPart, M: MainPart, P: PropagationPart>(
    control: &Control,
    parts: Parts<H, M, P>,
    input: Input,
    scenario: &Scenario,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<Parts<H, M, P>> {
    let underway = Underway::begin(parts, input, scenario, sink)?;
    realtime_on(control, underway, scenario, sink, progress)
}

/// Likewise from the middle of a session on.
///
/// # Errors
/// As [`realtime`].
pub(crate) fn realtime_on<H: HapticPart, M: MainPart, P: PropagationPart>(
    control: &Control,
    underway: Underway<H, M, P>,
    scenario: &Scenario,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<Parts<H, M, P>> {
    let shared = Shared::under(control);
    let (rings_in, mut rings_out) = rings();
    let Underway {
        haptic,
        main,
        propagation,
        bone_clock,
    } = underway;
    shared.count(haptic.next_step);
    let (crack_tx, crack_rx) = latest(&view(&propagation.crack()));
    let period = Duration::from_secs_f64(1.0 / scenario.loops.main_hz);
    let dt = scenario.loops.dt();
    std::thread::scope(|scope| {
        let shared = &shared;
        let haptic = Builder::new()
            .name("haptic".into())
            .spawn_scoped(scope, move || {
                haptic_loop(haptic, crack_rx, rings_in.haptic, shared)
            })?;
        let main = Builder::new()
            .name("main".into())
            .spawn_scoped(scope, move || {
                let rings = (rings_in.main, rings_in.bone);
                main_loop(main, bone_clock, rings, shared, period, dt)
            });
        let propagation = Builder::new()
            .name("propagation".into())
            .spawn_scoped(scope, move || {
                propagation_loop(propagation, crack_tx, rings_in.propagation, shared, dt)
            });
        // From here on every way out stops the loops first: the scope waits for them.
        let stop = StopOnDrop(shared);
        let recorded = record(&mut rings_out, sink, progress, shared, dt);
        drop(stop);
        let (haptic, haptic_pace) = join(haptic, "haptic")?;
        let (main, main_pace) = join(main?, "main")?;
        let (propagation, propagation_pace) = join(propagation?, "propagation")?;
        recorded?;
        drain(&mut rings_out, sink, &mut false)?;
        report(sink, Loop::Haptic, &haptic_pace, shared, dt)?;
        report(sink, Loop::Main, &main_pace, shared, dt)?;
        report(sink, Loop::Propagation, &propagation_pace, shared, dt)?;
        let accounts = [haptic_pace, main_pace, propagation_pace];
        if let Some(panic) = accounts.into_iter().find_map(|a| a.panic) {
            return Err(anyhow!("{panic}"));
        }
        Ok(Parts {
            haptic,
            main,
            propagation,
        })
    })
}

/// A loop's pace, the samples its full ring dropped, and what went wrong.
#[derive(Default)]
struct Account {
    pace: Pace,
    dropped: u64,
    events: Vec<String>,
    /// Which loop has panicked, and with what words.
    panic: Option<String>,
}

/// A step of the loop called `name`; its panic in words. All loops end then, the hands feel nothing, and what was recorded stays.
fn guarded<T>(name: &str, step: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(step)).map_err(|what| {
        let words = what.downcast_ref::<String>().map(String::as_str);
        let words = words.or_else(|| what.downcast_ref::<&str>().copied());
        let words = words.unwrap_or("no words");
        format!(
            "the {name} loop panicked ({words}); the devices were told zero and the session ended"
        )
    })
}

fn report(sink: &mut impl Sink, of: Loop, a: &Account, shared: &Shared, dt: f64) -> Result<()> {
    sink.pace(of, a.pace);
    let time = shared.steps() as f64 * dt;
    if a.dropped > 0 {
        sink.event(
            time,
            &format!("{of:?} loop: {} samples were not recorded", a.dropped),
        )?;
    }
    for event in a.events.iter().chain(&a.panic) {
        sink.event(time, event)?;
    }
    Ok(())
}

fn join<T>(handle: ScopedJoinHandle<T>, name: &str) -> Result<T> {
    handle
        .join()
        .map_err(|_| anyhow!("the {name} loop panicked; its message is above"))
}

/// Whichever loop ends, by whatever way, the others end too.
struct StopOnDrop<'a>(&'a Shared);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// Paces a loop against absolute deadlines. A step that ends late is counted, and the next ones follow at once until the
/// schedule is met again; a loop that has fallen behind by more than [`CATCH_UP`] starts a new schedule.
struct Pacer {
    start: Instant,
    next: Instant,
    period: Duration,
    /// When the step under way began.
    woke: Instant,
    sleeper: spin_sleep::SpinSleeper,
    pace: Pace,
}

/// A hand would feel a longer burst of hurried steps.
const CATCH_UP: Duration = Duration::from_millis(20);

impl Pacer {
    fn new(period: Duration) -> Self {
        let start = Instant::now();
        Self {
            start,
            next: start + period,
            period,
            woke: start,
            sleeper: spin_sleep::SpinSleeper::default(),
            pace: Pace::default(),
        }
    }

    /// Ends a step and waits for its deadline. By how much the step was late, if a new schedule had to be started.
    fn wait(&mut self) -> Option<Duration> {
        self.pace.steps += 1;
        let now = Instant::now();
        let late = now.saturating_duration_since(self.next);
        let is_behind = late > CATCH_UP.max(self.period);
        if late.is_zero() {
            self.sleeper.sleep_until(self.next);
        } else {
            self.pace.missed += 1;
            self.pace.overran += u64::from(now - self.woke > self.period);
            self.pace.latest_us = self.pace.latest_us.max(late.as_secs_f64() * 1e6);
            if is_behind {
                self.next = now;
            }
        }
        self.next += self.period;
        self.woke = Instant::now();
        self.pace.seconds = (self.woke - self.start).as_secs_f64();
        is_behind.then_some(late)
    }

    /// Waits a period that counts for nothing.
    fn rest(&mut self) {
        let before = Instant::now();
        self.sleeper.sleep(self.period);
        let now = Instant::now();
        self.start += now - before;
        self.next = now + self.period;
        self.woke = now;
    }
}

/// Of the haptic thread among those with real-time priority: above usual ones, below the kernel's own.
#[cfg(unix)]
const REAL_TIME_PRIORITY: u8 = 60;

/// First come, first served, where the system lets us; else as high as it goes. Best effort: without the right to either the loop
/// runs at normal priority.
fn raise_priority() {
    #[cfg(unix)]
    {
        use thread_priority::unix::{
            RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
            thread_native_id,
        };
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority = ThreadPriority::try_from(REAL_TIME_PRIORITY);
        let set = priority.map(|p| set_thread_priority_and_policy(thread_native_id(), p, policy));
        if matches!(set, Ok(Ok(()))) {
            return;
        }
    }
    let _ = set_current_thread_priority(ThreadPriority::Max);
}

fn haptic_loop<H: HapticPart>(
    mut haptic: HapticLoop<H>,
    mut crack: Subscribed<CrackView>,
    mut ring: RingIn<Timed<HapticSample>>,
    shared: &Shared,
) -> (H, Account) {
    let _stop = StopOnDrop(shared);
    raise_priority();
    let mut pacer = Pacer::new(Duration::from_secs_f64(haptic.dt));
    let mut panic = None;
    while !shared.is_stopping() && !haptic.is_finished() {
        if shared.is_paused() {
            haptic.rest();
            pacer.rest();
            continue;
        }
        let (sample, step_us) = match guarded("haptic", || timed(|| haptic.tick(crack.read()))) {
            Ok(ticked) => ticked,
            Err(words) => {
                panic = guarded("haptic", || haptic.silence()).err().or(Some(words));
                break;
            }
        };
        shared.count(haptic.next_step);
        let seen = haptic.part.seen();
        ring.put(Timed {
            sample,
            seen,
            step_us,
        });
        if let Some(late) = pacer.wait() {
            haptic.overrun(late.as_secs_f64());
        }
    }
    let account = Account {
        pace: pacer.pace,
        dropped: ring.n_dropped(),
        events: haptic.events(),
        panic,
    };
    (haptic.part, account)
}

fn main_loop<M: MainPart>(
    mut part: M,
    mut bone_clock: BoneClock,
    (mut ring, mut bones): (RingIn<Timed<MainSample>>, RingIn<BoneSample>),
    shared: &Shared,
    period: Duration,
    dt: f64,
) -> (M, Account) {
    let _stop = StopOnDrop(shared);
    let mut pacer = Pacer::new(period);
    let mut panic = None;
    while !shared.is_stopping() {
        if shared.is_paused() {
            pacer.rest();
            continue;
        }
        let (mut sample, step_us) = match guarded("main", || timed(|| part.step())) {
            Ok(stepped) => stepped,
            Err(words) => {
                panic = Some(words);
                break;
            }
        };
        let time = shared.steps() as f64 * dt;
        sample.time = time;
        let seen = part.seen();
        ring.put(Timed {
            sample,
            seen,
            step_us,
        });
        if bone_clock.is_due(part.generation())
            && let Some(bone) = part.bone()
        {
            bones.put(BoneSample { time, ..bone });
        }
        pacer.wait();
    }
    let account = Account {
        pace: pacer.pace,
        dropped: ring.n_dropped() + bones.n_dropped(),
        events: part.fault().into_iter().collect(),
        panic,
    };
    (part, account)
}

/// How long the propagation loop rests when the main loop has nothing new.
const REST: Duration = Duration::from_millis(1);

fn propagation_loop<P: PropagationPart>(
    mut part: P,
    mut crack: Published<CrackView>,
    mut ring: RingIn<Timed<Looked>>,
    shared: &Shared,
    dt: f64,
) -> (P, Account) {
    let _stop = StopOnDrop(shared);
    let mut start = Instant::now();
    let mut pace = Pace::default();
    let mut panic = None;
    while !shared.is_stopping() {
        if shared.is_paused() {
            let before = Instant::now();
            std::thread::sleep(REST);
            start += before.elapsed();
            continue;
        }
        let (propagated, step_us) = match guarded("propagation", || timed(|| part.step())) {
            Ok(stepped) => stepped,
            Err(words) => {
                panic = Some(words);
                break;
            }
        };
        let growth = match propagated {
            Propagated::Idle => {
                std::thread::sleep(REST);
                continue;
            }
            Propagated::Checked => None,
            Propagated::Grown(growth) => Some(growth),
        };
        pace.steps += 1;
        if let Some(growth) = &growth {
            crack.write(view(growth));
        }
        let time = shared.steps() as f64 * dt;
        ring.put(Timed {
            sample: Looked { time, growth },
            seen: part.seen(),
            step_us,
        });
    }
    pace.seconds = start.elapsed().as_secs_f64();
    let account = Account {
        pace,
        dropped: ring.n_dropped(),
        events: part.fault().into_iter().collect(),
        panic,
    };
    (part, account)
}

/// Drains the rings until the loops stop.
fn record(
    rings: &mut RingsOut,
    sink: &mut impl Sink,
    progress: Progress,
    shared: &Shared,
    dt: f64,
) -> Result<()> {
    let (mut severed, mut was_paused) = (false, false);
    while !shared.is_stopping() {
        drain(rings, sink, &mut severed)?;
        let time = shared.steps() as f64 * dt;
        let is_paused = shared.is_paused();
        if is_paused != was_paused {
            sink.event(time, if is_paused { "paused" } else { "resumed" })?;
            was_paused = is_paused;
        }
        progress(time, severed);
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// Takes out what is in the rings.
fn drain(rings: &mut RingsOut, sink: &mut impl Sink, severed: &mut bool) -> Result<()> {
    while let Ok(timed) = rings.propagation.pop() {
        let Timed {
            sample: Looked { time, growth },
            seen,
            step_us,
        } = timed;
        sink.seen(time, Loop::Propagation, seen)?;
        let grew = growth.is_some();
        if let Some(mut growth) = growth {
            growth.time = time;
            *severed = growth.severed;
            sink.growth(*growth)?;
        }
        sink.timing(
            &StepTime {
                time,
                of: Loop::Propagation,
                step_us,
            },
            grew,
        )?;
    }
    while let Ok(timed) = rings.haptic.pop() {
        let Timed {
            sample,
            seen,
            step_us,
        } = timed;
        sink.haptic(&sample)?;
        sink.seen(sample.time, Loop::Haptic, seen)?;
        let time = sample.time;
        sink.timing(
            &StepTime {
                time,
                of: Loop::Haptic,
                step_us,
            },
            false,
        )?;
    }
    while let Ok(bone) = rings.bone.pop() {
        sink.bone(&bone)?;
    }
    while let Ok(timed) = rings.main.pop() {
        let Timed {
            sample,
            seen,
            step_us,
        } = timed;
        sink.main(&sample)?;
        sink.seen(sample.time, Loop::Main, seen)?;
        let time = sample.time;
        sink.timing(
            &StepTime {
                time,
                of: Loop::Main,
                step_us,
            },
            false,
        )?;
    }
    Ok(())
}
