//! The three loops, driven from one thread ([`lockstep()`]) or from three ([`realtime()`]) through the same steps.
mod exchange;
mod lockstep;
mod realtime;

pub use crate::session::Seen;
pub use exchange::{Control, Published, Subscribed, latest};
pub(crate) use exchange::{Timed, rings};
pub use lockstep::lockstep;
pub(crate) use lockstep::lockstep_on;
pub(crate) use lockstep::timed;
pub(crate) use realtime::realtime_on;
pub use realtime::{realtime, realtime_under};

use crate::input::Input;
use crate::scenario::Scenario;
use crate::session::{
    BoneSample, GrowthSample, HandSample, HapticSample, Loop, MainSample, Pace, StepTime,
};
use crate::surgeon::CrackView;
use anyhow::Result;
use osteotome_devices::Wrench;
use osteotome_mechanics::geometry::{Pose, Vec3};

/// What the haptic step answers for one hand.
#[derive(Clone, Copy, Debug)]
pub struct HandOutput {
    /// The virtual chisel.
    pub tool_pose: Pose,
    /// To be displayed \[N, N mm\].
    pub wrench: Wrench,
    /// Whether it is at the device's limit.
    pub saturated: bool,
    /// Points in contact.
    pub contacts: u32,
}

/// The haptic loop's share of the simulation: steps 4 to 6 of the relaxation, against the latest bone.
pub trait HapticPart: Send {
    /// One step of `dt` \[s\]. Does not allocate, wait or log.
    fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2];
    /// What the last step read.
    fn seen(&self) -> Seen {
        Seen::default()
    }
    /// How far the bone has moved at each mark of the osteotomy line, as last seen \[mm\].
    fn line(&mut self) -> &[Vec3];
    /// Why the output has been zero since, if it has.
    fn fault(&self) -> Option<String>;
}

/// The main loop's share: steps 1 to 7 to convergence.
pub trait MainPart: Send {
    /// One step.
    fn step(&mut self) -> MainSample;
    /// What the last step read.
    fn seen(&self) -> Seen {
        Seen::default()
    }
    /// The generation of the bone that the last step worked on.
    fn generation(&self) -> u64 {
        0
    }
    /// The bone as the last step left it.
    fn bone(&self) -> Option<BoneSample> {
        None
    }
    /// Why it has stopped, if it has.
    fn fault(&self) -> Option<String> {
        None
    }
}

/// What a call of the propagation step did.
pub enum Propagated {
    /// The main loop had nothing new.
    Idle,
    /// Looked; the crack stays.
    Checked,
    /// The crack has grown.
    Grown(Box<GrowthSample>),
}

/// The propagation loop's share.
pub trait PropagationPart: Send {
    /// What the last step read.
    fn seen(&self) -> Seen {
        Seen::default()
    }
    /// The crack as it stands.
    fn crack(&self) -> GrowthSample;
    /// One step.
    fn step(&mut self) -> Propagated;
    /// Why it has stopped, if it has.
    fn fault(&self) -> Option<String>;
}

/// The simulation, one part a loop.
pub struct Parts<H, M, P> {
    /// 1 kHz.
    pub haptic: H,
    /// 50 Hz.
    pub main: M,
    /// As it can.
    pub propagation: P,
}

/// Where samples go.
pub trait Sink {
    /// A haptic step.
    ///
    /// # Errors
    /// Whatever keeps the sink from taking it; ends the session. Likewise below.
    fn haptic(&mut self, sample: &HapticSample) -> Result<()>;
    /// A main step.
    fn main(&mut self, sample: &MainSample) -> Result<()>;
    /// How the bone is deformed; whoever does not keep it need not take it.
    fn bone(&mut self, _: &BoneSample) -> Result<()> {
        Ok(())
    }
    /// A growth step.
    fn growth(&mut self, sample: GrowthSample) -> Result<()>;
    /// How long a step took.
    fn timing(&mut self, sample: &StepTime, grew: bool) -> Result<()>;
    /// What a step read of the other loops; told after the step's sample.
    fn seen(&mut self, _time: f64, _of: Loop, _seen: Seen) -> Result<()> {
        Ok(())
    }
    /// Something worth knowing.
    fn event(&mut self, time: f64, event: &str) -> Result<()>;
    /// A loop's pace, at the end.
    fn pace(&mut self, of: Loop, pace: Pace);
}

/// Says when the bone is to be recorded: after every fourth main step (at 50 Hz, 12.5 times a second), and whenever it has grown
/// a new crack.
#[derive(Default)]
pub(crate) struct BoneClock {
    since: u32,
    generation: Option<u64>,
}

impl BoneClock {
    pub(crate) fn is_due(&mut self, generation: u64) -> bool {
        const EVERY: u32 = 4;
        self.since += 1;
        let is_due = self.since >= EVERY || self.generation != Some(generation);
        if is_due {
            self.since = 0;
            self.generation = Some(generation);
        }
        is_due
    }
}

/// Told how far the simulated time has come \[s\], and whether the bone is apart.
pub type Progress<'a> = &'a mut dyn FnMut(f64, bool);

/// A session between two steps: at its beginning, or somewhere in its middle.
pub(crate) struct Underway<H, M, P> {
    pub(crate) haptic: HapticLoop<H>,
    pub(crate) main: M,
    pub(crate) propagation: P,
    pub(crate) bone_clock: BoneClock,
}

impl<H: HapticPart, M: MainPart, P: PropagationPart> Underway<H, M, P> {
    /// At the beginning; tells the sink of the crack.
    pub(crate) fn begin(
        parts: Parts<H, M, P>,
        input: Input,
        scenario: &Scenario,
        sink: &mut impl Sink,
    ) -> Result<Self> {
        sink.growth(parts.propagation.crack())?;
        Ok(Self {
            haptic: HapticLoop::new(parts.haptic, input, scenario),
            main: parts.main,
            propagation: parts.propagation,
            bone_clock: BoneClock::default(),
        })
    }
}

/// The haptic loop: hands, devices, step.
pub(crate) struct HapticLoop<H> {
    pub(crate) part: H,
    input: Input,
    dt: f64,
    max_steps: u64,
    next_step: u64,
    faults: u32,
    overruns: Overruns,
}

/// Steps that came so late that their forces were let go.
#[derive(Default)]
struct Overruns {
    count: u32,
    /// When the first was, and by how much it was late \[s\].
    first: [f64; 2],
    /// Share of the wrenches that is held back, falling from 1 to 0 after each.
    held_back: f64,
}

/// From nothing to the whole wrench after an overrun \[s\].
const EASE: f64 = 0.5;

impl Overruns {
    fn happened(&mut self, time: f64, late: f64) {
        if self.count == 0 {
            self.first = [time, late];
        }
        self.count += 1;
        self.held_back = 1.0;
    }

    /// Share of the wrench to display in this step.
    fn share(&mut self, dt: f64) -> f64 {
        let share = 1.0 - self.held_back;
        self.held_back = (self.held_back - dt / EASE).max(0.0);
        share
    }

    fn event(&self) -> Option<String> {
        let [time, late] = self.first;
        (self.count > 0).then(|| {
            format!(
                "{} haptic steps overran, the first at {time:.3} s by {:.0} ms; zero was displayed and eased in again after each",
                self.count,
                1e3 * late
            )
        })
    }
}

impl<H: HapticPart> HapticLoop<H> {
    /// Before the first step.
    pub(crate) fn new(part: H, input: Input, scenario: &Scenario) -> Self {
        Self::after(0, part, input, scenario)
    }

    /// After so many steps.
    pub(crate) fn after(steps: u64, part: H, input: Input, scenario: &Scenario) -> Self {
        Self {
            part,
            input,
            dt: scenario.loops.dt(),
            max_steps: (scenario.max_time * scenario.loops.haptic_hz).ceil() as u64,
            next_step: steps,
            faults: 0,
            overruns: Overruns::default(),
        }
    }

    /// One tick: plan, read, step, write. A function of its own in the machine code, which `tests/no_locks.rs` reads.
    #[inline(never)]
    pub(crate) fn tick(&mut self, crack: &CrackView) -> HapticSample {
        self.input.plan(crack, self.part.line());
        let readings = self.input.read();
        let output = self.part.step(&readings.map(|r| r.pose), self.dt);
        // Recorded is what the simulation asked for, so that a recording can be computed anew.
        let share = self.overruns.share(self.dt);
        let shown = output.map(|o| Wrench {
            force: o.wrench.force * share,
            torque: o.wrench.torque * share,
        });
        self.faults += (self.input).write(&shown, &output.map(|o| o.tool_pose));
        let step = self.next_step;
        self.next_step += 1;
        HapticSample {
            step,
            time: step as f64 * self.dt,
            hands: [0, 1].map(|i| HandSample {
                device_pose: readings[i].pose,
                device_buttons: readings[i].buttons,
                tool_pose: output[i].tool_pose,
                wrench: output[i].wrench,
                saturated: output[i].saturated,
                contacts: output[i].contacts,
            }),
        }
    }

    /// Tells both devices zero.
    fn silence(&mut self) {
        let tools = self.input.read().map(|r| r.pose);
        self.input.write(&[Wrench::default(); 2], &tools);
    }

    /// The last step ended so much too late \[s\]: what the hands have felt meanwhile answered to where they were long ago.
    fn overrun(&mut self, late: f64) {
        let time = self.next_step as f64 * self.dt;
        self.overruns.happened(time, late);
    }

    /// A tick while time stands still.
    fn rest(&mut self) {
        self.input.rest();
    }

    /// What went wrong on the way.
    fn events(&self) -> Vec<String> {
        let refused = (self.faults > 0).then(|| {
            format!(
                "{} wrenches were not finite; zero was displayed",
                self.faults
            )
        });
        let paused = self.input.events();
        self.part
            .fault()
            .into_iter()
            .chain(refused)
            .chain(self.overruns.event())
            .chain(paused)
            .collect()
    }

    fn is_finished(&self) -> bool {
        self.next_step >= self.max_steps || self.input.is_finished()
    }
}

/// What the surgeon sees of a growth.
pub(crate) fn view(sample: &GrowthSample) -> CrackView {
    CrackView {
        generation: sample.generation,
        severed: sample.severed,
        front: sample.tips.clone(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    //! A spring in place of the mechanics: the tool is the device, the wrench a spring to the start, and the crack grows
    //! a little with every tenth main step until the bone is in two.
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::surgeon::{Mark, SplitLine};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    #[derive(Clone, Default)]
    pub struct Spring {
        main_steps: Arc<AtomicU64>,
        seen: u64,
        generation: u64,
    }

    impl HapticPart for Spring {
        fn step(&mut self, devices: &[Pose; 2], _: f64) -> [HandOutput; 2] {
            devices.map(|tool_pose| HandOutput {
                tool_pose,
                wrench: Wrench {
                    force: -0.1 * tool_pose.translation.vector,
                    torque: -10.0 * tool_pose.rotation.scaled_axis(),
                },
                saturated: false,
                contacts: 3,
            })
        }
        fn line(&mut self) -> &[Vec3] {
            &[]
        }
        fn fault(&self) -> Option<String> {
            None
        }
    }

    impl MainPart for Spring {
        fn step(&mut self) -> MainSample {
            self.main_steps.fetch_add(1, Ordering::Relaxed);
            MainSample {
                time: 0.0,
                iterations: 2,
                residual: 1e-7,
                converged: true,
                contacts: 3,
                max_displacement: 0.1,
                strain_energy: 1.0,
            }
        }
    }

    impl PropagationPart for Spring {
        fn crack(&self) -> GrowthSample {
            let depth = 4.0 + 0.2 * self.generation as f64;
            let tips = (0..=30).map(|i| Vec3::new(f64::from(i), 0.0, -depth));
            GrowthSample {
                time: 0.0,
                vertices: vec![],
                triangles: vec![],
                kerf: vec![],
                generation: self.generation,
                front: vec![],
                area: 6.0 * self.generation as f64,
                fragments: 1 + usize::from(self.generation >= 40),
                severed: self.generation >= 40,
                sheets: vec![],
                cut: vec![],
                seats: vec![],
                tips: tips.collect(),
            }
        }

        fn step(&mut self) -> Propagated {
            let now = self.main_steps.load(Ordering::Relaxed);
            if now == self.seen {
                return Propagated::Idle;
            }
            self.seen = now;
            if !now.is_multiple_of(10) || self.generation >= 40 {
                return Propagated::Checked;
            }
            self.generation += 1;
            Propagated::Grown(Box::new(self.crack()))
        }

        fn fault(&self) -> Option<String> {
            None
        }
    }

    pub fn parts() -> Parts<Spring, Spring, Spring> {
        let spring = Spring::default();
        Parts {
            haptic: spring.clone(),
            main: spring.clone(),
            propagation: spring,
        }
    }

    pub fn scenario(sets: &[&str]) -> Scenario {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let sets: Vec<_> = sets.iter().map(|s| s.parse().unwrap()).collect();
        load(&source, &sets, std::path::Path::new("/")).unwrap()
    }

    pub fn surgeon(scenario: &Scenario) -> Input {
        let marks = (0..=40).map(|i| Mark {
            at: Vec3::new(f64::from(i), 0.0, 0.0),
            toward: -Vec3::z(),
            depth: 4.0,
            is_ridge: i <= 30,
        });
        Input::built_in(scenario, SplitLine::new(marks.collect()).unwrap()).unwrap()
    }

    /// Keeps everything.
    #[derive(Default)]
    pub struct Kept {
        pub haptic: Vec<HapticSample>,
        pub main: Vec<MainSample>,
        pub growth: Vec<GrowthSample>,
        pub times: Vec<StepTime>,
        pub pace: Vec<(Loop, Pace)>,
        pub events: Vec<String>,
    }

    impl Sink for Kept {
        fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
            self.haptic.push(*sample);
            Ok(())
        }
        fn main(&mut self, sample: &MainSample) -> Result<()> {
            self.main.push(*sample);
            Ok(())
        }
        fn growth(&mut self, sample: GrowthSample) -> Result<()> {
            self.growth.push(sample);
            Ok(())
        }
        fn timing(&mut self, sample: &StepTime, _: bool) -> Result<()> {
            self.times.push(*sample);
            Ok(())
        }
        fn event(&mut self, _: f64, event: &str) -> Result<()> {
            self.events.push(event.to_owned());
            Ok(())
        }
        fn pace(&mut self, of: Loop, pace: Pace) {
            self.pace.push((of, pace));
        }
    }

    fn in_lockstep(input: Input, scenario: &Scenario) -> Kept {
        let mut kept = Kept::default();
        lockstep(parts(), input, scenario, &mut kept, &mut |_, _| {}).unwrap();
        kept
    }

    fn bits(kept: &Kept) -> String {
        format!("{:?} {:?}", kept.haptic, kept.growth)
    }

    #[test]
    fn lockstep_interleaves_and_ends_after_the_break() {
        let scenario = scenario(&[]);
        let kept = in_lockstep(surgeon(&scenario), &scenario);
        assert_eq!(kept.growth.last().unwrap().fragments, 2);
        assert!(kept.haptic.len() < 30_000, "it did not wait for max_time");
        let expected = kept.haptic.len().div_ceil(20);
        assert_eq!(kept.main.len(), expected);
        assert!(
            (kept.growth[1].time - 0.199).abs() < 1e-12,
            "the tenth main step"
        );
    }

    #[test]
    fn lockstep_twice_and_replayed_is_the_same_to_the_last_bit() {
        let scenario = scenario(&["seed=5"]);
        let [a, b] = [0, 1].map(|_| in_lockstep(surgeon(&scenario), &scenario));
        assert_eq!(bits(&a), bits(&b));
        let hands = [0, 1].map(|i| a.haptic.iter().map(|s| s.hands[i]).collect());
        let replayed = in_lockstep(Input::recorded(&scenario, &hands).unwrap(), &scenario);
        assert_eq!(bits(&a), bits(&replayed));
    }

    #[test]
    fn three_threads_record_every_step_and_keep_the_pace() {
        let scenario = scenario(&["max_time=0.5"]);
        let mut kept = Kept::default();
        realtime(
            parts(),
            surgeon(&scenario),
            &scenario,
            &mut kept,
            &mut |_, _| {},
        )
        .unwrap();
        assert_eq!(kept.haptic.len(), 500);
        assert!(kept.haptic.windows(2).all(|w| w[1].step == w[0].step + 1));
        assert!(
            (15..=26).contains(&kept.main.len()),
            "{} main steps in .5 s",
            kept.main.len()
        );
        let (_, pace) = kept.pace.iter().find(|(l, _)| *l == Loop::Haptic).unwrap();
        assert_eq!(pace.steps, 500);
        assert!(
            pace.seconds > 0.49,
            "faster than the clock: {}",
            pace.seconds
        );
    }

    #[test]
    fn a_paused_session_stands_still_and_goes_on_where_it_was() {
        let scenario = scenario(&["max_time=0.3"]);
        let mut kept = Kept::default();
        let control = Control::default();
        let mut paused_at = None;
        let mut rests = 0;
        let mut progress = |time: f64, _: bool| {
            if paused_at.is_none() && time > 0.1 {
                control.pause(true);
                paused_at = Some(time);
            } else if control.is_paused() {
                rests += 1;
                let since = time - paused_at.unwrap();
                // A step that was under way when it was asked for, on a machine that may stall.
                assert!(rests < 3 || since < 0.1, "{since} s on while paused");
                control.pause(rests < 20);
            }
        };
        let input = surgeon(&scenario);
        realtime_under(
            &control,
            parts(),
            input,
            &scenario,
            &mut kept,
            &mut progress,
        )
        .unwrap();
        assert_eq!(kept.haptic.len(), 300);
        assert!(kept.haptic.windows(2).all(|w| w[1].step == w[0].step + 1));
        assert_eq!(kept.events, ["paused", "resumed"]);
    }

    #[test]
    fn a_session_ends_when_it_is_told_to() {
        let scenario = scenario(&["max_time=600.0"]);
        let mut kept = Kept::default();
        let control = Control::default();
        let mut progress = |time: f64, _: bool| {
            if time > 0.05 {
                control.stop();
            }
        };
        let input = surgeon(&scenario);
        realtime_under(
            &control,
            parts(),
            input,
            &scenario,
            &mut kept,
            &mut progress,
        )
        .unwrap();
        assert!(
            (50..60_000).contains(&kept.haptic.len()),
            "{}",
            kept.haptic.len()
        );
    }

    /// Steps as a spring, and panics in the tenth step.
    struct Bad(u32);

    impl Bad {
        fn count(&mut self) {
            self.0 += 1;
            assert!(self.0 < 10, "on purpose");
        }
    }

    impl MainPart for Bad {
        fn step(&mut self) -> MainSample {
            self.count();
            MainPart::step(&mut Spring::default())
        }
    }

    impl HapticPart for Bad {
        fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2] {
            self.count();
            HapticPart::step(&mut Spring::default(), devices, dt)
        }
        fn line(&mut self) -> &[Vec3] {
            &[]
        }
        fn fault(&self) -> Option<String> {
            None
        }
    }

    impl PropagationPart for Bad {
        fn crack(&self) -> GrowthSample {
            Spring::default().crack()
        }
        fn step(&mut self) -> Propagated {
            self.count();
            Propagated::Checked
        }
        fn fault(&self) -> Option<String> {
            None
        }
    }

    /// Steps as a spring; the hundredth step takes 40 ms.
    struct Slow(u32);

    impl HapticPart for Slow {
        fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2] {
            self.0 += 1;
            if self.0 == 100 {
                std::thread::sleep(std::time::Duration::from_millis(40));
            }
            HapticPart::step(&mut Spring::default(), devices, dt)
        }
        fn line(&mut self) -> &[Vec3] {
            &[]
        }
        fn fault(&self) -> Option<String> {
            None
        }
    }

    #[test]
    fn an_overrun_holds_everything_back_and_then_less_and_less() {
        let mut overruns = Overruns::default();
        assert_eq!(overruns.share(1e-3), 1.0);
        overruns.happened(0.1, 0.04);
        for k in 0..500 {
            assert!((overruns.share(1e-3) - 2e-3 * f64::from(k)).abs() < 1e-9);
        }
        assert!((overruns.share(1e-3) - 1.0).abs() < 1e-9);
        overruns.happened(0.9, 0.03);
        assert_eq!((overruns.share(1e-3), overruns.count), (0.0, 2));
    }

    /// After a step that took far too long nothing is displayed, then more by and by, and the record says so.
    #[test]
    fn an_overrun_lets_the_hands_go_and_eases_back_in() {
        let scenario = scenario(&["max_time=0.8"]);
        let mut kept = Kept::default();
        let Parts {
            main, propagation, ..
        } = parts();
        let parts = Parts {
            haptic: Slow(0),
            main,
            propagation,
        };
        let none = &mut |_: f64, _: bool| {};
        let input = surgeon(&scenario);
        realtime(parts, input, &scenario, &mut kept, none).unwrap();
        let event = kept.events.iter().find(|e| e.contains("overran"));
        assert!(event.is_some(), "{:?}", kept.events);
        let hand = |k: usize| &kept.haptic[k].hands[0];
        // The hand that was let go is elsewhere than it is without overruns, and what was asked for is recorded all the same.
        let calm = in_lockstep(surgeon(&scenario), &scenario);
        assert_ne!(hand(300).device_pose, calm.haptic[300].hands[0].device_pose);
        for k in [99, 100, 300] {
            let asked = 0.1 * hand(k).tool_pose.translation.vector.norm();
            assert!((hand(k).wrench.force.norm() - asked).abs() < 1e-9 && asked > 0.0);
        }
        let (_, pace) = kept.pace.iter().find(|p| p.0 == Loop::Haptic).unwrap();
        assert!(pace.latest_us > 30_000.0 && pace.missed > 0);
        assert!((1..=pace.missed).contains(&pace.overran), "{pace:?}");
    }

    /// Ends it in a way that says why, in the recording too, and keeps what was recorded.
    #[test]
    fn a_panic_in_a_loop_ends_the_session_with_its_words() {
        let scenario = scenario(&[]);
        let [mut first, mut second, mut third] = [0; 3].map(|_| Kept::default());
        let Parts {
            haptic,
            main,
            propagation,
        } = parts();
        let none = &mut |_: f64, _: bool| {};
        let main_panics = Parts {
            haptic,
            main: Bad(0),
            propagation,
        };
        let error = realtime(main_panics, surgeon(&scenario), &scenario, &mut first, none);
        assert!(
            error
                .err()
                .unwrap()
                .to_string()
                .contains("the main loop panicked (on purpose)")
        );
        assert!(
            first
                .events
                .iter()
                .any(|e| e.contains("main loop panicked"))
        );
        assert_eq!(first.main.len(), 9);
        let Parts { propagation, .. } = parts();
        let haptic_panics = Parts {
            haptic: Bad(0),
            main,
            propagation,
        };
        let error = realtime(
            haptic_panics,
            surgeon(&scenario),
            &scenario,
            &mut second,
            none,
        );
        assert!(
            error
                .err()
                .unwrap()
                .to_string()
                .contains("the haptic loop panicked")
        );
        assert_eq!(second.haptic.len(), 9);
        let Parts { haptic, main, .. } = parts();
        let propagation_panics = Parts {
            haptic,
            main,
            propagation: Bad(0),
        };
        let input = surgeon(&scenario);
        let error = realtime(propagation_panics, input, &scenario, &mut third, none);
        let words = error.err().unwrap().to_string();
        assert!(words.contains("the propagation loop panicked (on purpose)"));
        assert!(third.events.contains(&words));
    }
}
