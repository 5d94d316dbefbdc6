use super::{
    BoneClock, HapticLoop, HapticPart, MainPart, Parts, Progress, Propagated, PropagationPart,
    Sink, view,
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
    let Parts {
        haptic,
        mut main,
        mut propagation,
    } = parts;
    let start = propagation.crack();
    let mut crack = view(&start);
    sink.growth(start)?;
    let mut haptic = HapticLoop::new(haptic, input, scenario);
    let mut time = 0.0;
    let mut bone_clock = BoneClock::default();
    while !haptic.is_finished() {
        for _ in 0..scenario.loops.haptic_per_main() {
            if haptic.is_finished() {
                break;
            }
            let (sample, step_us) = timed(|| haptic.tick(&crack));
            time = sample.time;
            sink.haptic(&sample)?;
            sink.timing(
                &StepTime {
                    time,
                    of: Loop::Haptic,
                    step_us,
                },
                false,
            )?;
        }
        let (mut sample, step_us) = timed(|| main.step());
        sample.time = time;
        sink.main(&sample)?;
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
