use super::{
    HapticPart, MainPart, Parts, Progress, Propagated, PropagationPart, Sink, Underway, view,
};
use crate::input::Input;
use crate::scenario::Scenario;
use crate::session::{BoneSample, Loop, StepTime};
use anyhow::Result;
use std::time::Instant;

/// Runs a session from this thread: a main step after every so many haptic steps, propagation after each main step.
///
/// The same parts and input give the same samples, bit for bit, whatever the machine is doing meanwhile; only
/// [`Sink::timing`] sees the clock. Gives the parts back.
///
/// # Errors
/// What the sink reports.
pub fn lockstep<H: HapticPart, M: MainPart, P: PropagationPart>(
    parts: Parts<H, M, P>,
    input: Input,
    scenario: &Scenario,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<Parts<H, M, P>> {
    let underway = Underway::begin(parts, input, scenario, sink)?;
    lockstep_on(underway, scenario, sink, progress)
}

/// Likewise from the middle of a session on.
///
/// # Errors
/// As [`lockstep`].
pub(crate) fn lockstep_on<H: HapticPart, M: MainPart, P: PropagationPart>(
    underway: Underway<H, M, P>,
    scenario: &Scenario,
    sink: &mut impl Sink,
    progress: Progress,
) -> Result<Parts<H, M, P>> {
    let Underway {
        mut haptic,
        mut main,
        mut propagation,
        mut bone_clock,
    } = underway;
    let mut crack = view(&propagation.crack());
    let every = u64::from(scenario.loops.haptic_per_main());
    let mut time = haptic.next_step.saturating_sub(1) as f64 * haptic.dt;
    while !haptic.is_finished() {
        while !haptic.is_finished() {
            let (sample, step_us) = timed(|| haptic.tick(&crack));
            time = sample.time;
            sink.haptic(&sample)?;
            sink.seen(time, Loop::Haptic, haptic.part.seen())?;
            sink.timing(
                &StepTime {
                    time,
                    of: Loop::Haptic,
                    step_us,
                },
                false,
            )?;
            if haptic.next_step.is_multiple_of(every) {
                break;
            }
        }
        let (mut sample, step_us) = timed(|| main.step());
        sample.time = time;
        sink.main(&sample)?;
        sink.seen(time, Loop::Main, main.seen())?;
        if bone_clock.is_due(main.generation())
            && let Some(bone) = main.bone()
        {
            sink.bone(&BoneSample { time, ..bone })?;
        }
        sink.timing(
            &StepTime {
                time,
                of: Loop::Main,
                step_us,
            },
            false,
        )?;

        let (propagated, step_us) = timed(|| propagation.step());
        let step = StepTime {
            time,
            of: Loop::Propagation,
            step_us,
        };
        if !matches!(propagated, Propagated::Idle) {
            sink.seen(time, Loop::Propagation, propagation.seen())?;
        }
        match propagated {
            Propagated::Idle => {}
            Propagated::Checked => sink.timing(&step, false)?,
            Propagated::Grown(mut growth) => {
                growth.time = time;
                crack = view(&growth);
                sink.growth(*growth)?;
                sink.timing(&step, true)?;
            }
        }
        progress(time, crack.severed);
    }
    let faults = main.fault().into_iter().chain(propagation.fault());
    for event in haptic.events().into_iter().chain(faults) {
        sink.event(time, &event)?;
    }
    let haptic = haptic.part;
    Ok(Parts {
        haptic,
        main,
        propagation,
    })
}

/// A result and how long it took \[us\].
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64() * 1e6)
}
