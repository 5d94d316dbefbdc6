//! Over a whole split of the mandible, breaks and new bones included, the haptic step allocates and frees nothing.
//!
//! `assert_no_alloc` counts what the allocator is asked for inside the guarded step; that the count can rise is tested too.
use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use osteotome::engine::{connect, prepare};
use osteotome::input::Input;
use osteotome::loops::{HandOutput, HapticPart, Parts, Sink, lockstep};
use osteotome::scenario::{BSSO_RIGHT, Source, load};
use osteotome::session::{GrowthSample, HapticSample, Loop, MainSample, Pace, StepTime};
use osteotome_mechanics::geometry::{Pose, Vec3};
use std::path::Path;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

struct Guarded<H>(H);

impl<H: HapticPart> HapticPart for Guarded<H> {
    fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2] {
        assert_no_alloc(|| self.0.step(devices, dt))
    }

    fn line(&mut self) -> &[Vec3] {
        self.0.line()
    }

    fn fault(&self) -> Option<String> {
        self.0.fault()
    }
}

/// Keeps only whether the bone is apart, and how many contacts there were.
#[derive(Default)]
struct Outcome {
    severed: bool,
    contacts: u64,
}

impl Sink for Outcome {
    fn haptic(&mut self, sample: &HapticSample) -> anyhow::Result<()> {
        self.contacts += u64::from(sample.hands[0].contacts);
        Ok(())
    }
    fn main(&mut self, _: &MainSample) -> anyhow::Result<()> {
        Ok(())
    }
    fn growth(&mut self, sample: GrowthSample) -> anyhow::Result<()> {
        self.severed |= sample.severed;
        Ok(())
    }
    fn timing(&mut self, _: &StepTime, _: bool) -> anyhow::Result<()> {
        Ok(())
    }
    fn event(&mut self, _: f64, _: &str) -> anyhow::Result<()> {
        Ok(())
    }
    fn pace(&mut self, _: Loop, _: Pace) {}
}

#[test]
fn a_whole_split_allocates_nothing_in_the_haptic_step() {
    let source = Source::Text {
        name: "test".into(),
        text: BSSO_RIGHT.into(),
    };
    let scenario = load(&source, &[], Path::new("/")).unwrap();
    let prepared = prepare(&scenario, &mut |_, _| {}).unwrap();
    let mut input = Input::built_in(&scenario, prepared.line.clone()).unwrap();
    let start = input.read().map(|r| r.pose);
    input.rewind();
    let Parts {
        haptic,
        main,
        propagation,
    } = connect(&prepared, &scenario, start).unwrap();
    let parts = Parts {
        haptic: Guarded(haptic),
        main,
        propagation,
    };
    let mut outcome = Outcome::default();
    lockstep(parts, input, &scenario, &mut outcome, &mut |_, _| {}).unwrap();
    assert!(outcome.severed, "the split was not completed");
    assert!(outcome.contacts > 1000, "{} contacts", outcome.contacts);
    assert_eq!(violation_count(), 0);
    assert_no_alloc(|| drop(std::hint::black_box(vec![0u8; 100])));
    assert!(violation_count() > 0, "the guard is blind");
}
