//! The haptic step allocates nothing, latches faults and keeps within the devices' limits, over a chisel's whole way in and out.
mod support;

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use osteotome_mechanics::contact::Wrench;
use osteotome_mechanics::geometry::{Pose, Vec3};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticFault, HapticInput, HapticModel, HapticOutput, HapticState, haptic_step,
};
use osteotome_mechanics::tool::{BoneCompliance, Matrix12, ScratchLimits, SolveSettings, Vector12};
use support::{Block, aside, downward, model};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

fn haptic_model() -> HapticModel {
    let limits = DeviceLimits {
        force_scale: 0.005,
        torque_scale: 0.04,
        max_force: 3.3,
        max_torque: 188.0,
        max_force_rate: 500.0,
        max_torque_rate: 20_000.0,
    };
    HapticModel {
        tools: model(0.3),
        settings: SolveSettings::HAPTIC,
        limits: [limits.checked().unwrap(), limits.checked().unwrap()],
    }
}

fn at(x: f64, z: f64, twist: f64) -> Pose {
    downward(Vec3::new(x, 0.4, z), Vec3::new(0.02, 0.01, twist))
}

/// In, twist against each other, out; one full turn of it takes 300 steps.
fn hands(step: i32) -> [Pose; 2] {
    let t = f64::from(step % 300) / 300.0;
    let depth = 3.0 * (std::f64::consts::TAU * t).sin();
    [at(-7.0, -depth, 0.3 * depth), at(7.0, -depth, -0.3 * depth)]
}

fn run(
    state: &mut HapticState,
    model: &HapticModel,
    block: &Block,
    devices: [Pose; 2],
) -> HapticOutput {
    let bone = yielding();
    let input = HapticInput {
        scene: block.scene(),
        compliance: Some(&bone),
        devices,
        dt: 1e-3,
    };
    haptic_step(model, state, &input)
}

/// A micrometre a newton under each tool.
fn yielding() -> BoneCompliance {
    let matrix = Vector12::from_fn(|i, _| if i % 6 < 3 { 1e-3 } else { 1e-5 });
    BoneCompliance {
        matrix: Matrix12::from_diagonal(&matrix),
        origins: [Vec3::new(-7.0, 0.0, 0.0), Vec3::new(7.0, 0.0, 0.0)],
        load: [Wrench::ZERO; 2],
    }
}

#[test]
fn no_allocation_and_no_output_beyond_the_limits() {
    let (model, block) = (haptic_model(), Block::still(12));
    let poses = hands(0);
    let mut state = HapticState::new(poses, block.points.len(), ScratchLimits::default());
    let mut last = [Wrench::ZERO; 2];
    let (mut peak, mut contacts) = (0.0f64, 0);
    for step in 0..600 {
        let devices = hands(step);
        let output = assert_no_alloc(|| run(&mut state, &model, &block, devices));
        assert_eq!(violation_count(), 0, "allocated in step {step}");
        assert_eq!(output.fault, None);
        for (t, (told, before)) in output.device.iter().zip(&last).enumerate() {
            assert!(told.force.norm() <= 3.3 + 1e-9 && told.torque.norm() <= 188.0 + 1e-9);
            assert!((told.force - before.force).norm() <= 0.5 + 1e-9);
            assert!((told.torque - before.torque).norm() <= 20.0 + 1e-9);
            assert!(output.bone[t].force.norm() <= model.tools.tools[t].coupling.max_force());
            peak = peak.max(told.force.norm());
        }
        contacts = contacts.max(output.result.n_contacts[0]);
        last = output.device;
    }
    assert!(
        peak > 0.5 && contacts > 50,
        "{peak} N, {contacts} contacts: hardly touched"
    );
}

/// A step with an allocation inside is noticed: the test above can fail.
#[test]
fn the_guard_notices_an_allocation() {
    let worker = std::thread::Builder::new().name("allocates".into());
    let seen = worker
        .spawn(|| {
            assert_no_alloc(|| drop(std::hint::black_box(vec![0u8; 100])));
            violation_count()
        })
        .unwrap();
    assert!(seen.join().unwrap() > 0);
}

#[test]
fn a_fault_latches_zero_for_both_hands_until_reset() {
    let (model, block) = (haptic_model(), Block::still(6));
    let pressed = [at(-7.0, -1.0, 0.1), at(7.0, -1.0, 0.0)];
    let start = [at(-7.0, 0.0, 0.0), at(7.0, 0.0, 0.0)];
    let mut state = HapticState::new(start, block.points.len(), ScratchLimits::default());
    for _ in 0..20 {
        run(&mut state, &model, &block, pressed);
    }
    let fine = run(&mut state, &model, &block, pressed);
    assert!(fine.device.iter().all(|w| w.force.norm() > 0.1));
    let mut bad = pressed;
    bad[1].translation.vector.y = f64::INFINITY;
    let tools = *state.tools();
    for devices in [bad, pressed, pressed] {
        let output = run(&mut state, &model, &block, devices);
        assert_eq!(output.fault, Some(HapticFault::DevicePose { hand: 1 }));
        assert_eq!(output.device, [Wrench::ZERO; 2]);
        assert_eq!(output.tools, tools);
    }
    state.reset(start);
    let again = run(&mut state, &model, &block, pressed);
    assert!(again.fault.is_none() && again.device[0].force.norm() > 0.0);
}

/// A bone that has blown up gives no fault by itself: its cells are left out, and the tool meets nothing there.
#[test]
fn a_bone_that_is_not_finite_gives_no_force() {
    let (model, mut block) = (haptic_model(), Block::still(6));
    block.deform(|p| p * f64::NAN);
    let pressed = [at(-7.0, -1.0, 0.1), aside()];
    let mut state = HapticState::new(pressed, block.points.len(), ScratchLimits::default());
    let output = run(&mut state, &model, &block, pressed);
    assert!(output.device.iter().all(Wrench::is_finite));
    assert_eq!(output.result.n_contacts, [0, 0]);
}
