//! Two chisels between hands and bone: forces balance, nothing diverges, the hands are independent, equal input gives equal bits.
mod support;

use osteotome_mechanics::contact::Anchors;
use osteotome_mechanics::geometry::{Aabb, DistanceGrid, Pose, Vec3};
use osteotome_mechanics::tool::{
    ScratchLimits, SolveSettings, ToolInput, ToolModel, ToolScratch, ToolsResult, ToolsState,
    evaluate_contacts, solve_tools, solve_tools_on_threads,
};
use std::sync::Arc;
use support::{Block, aside, downward, model, moved, noise};

struct Rig {
    model: ToolModel,
    block: Block,
    anchors: [Anchors; 2],
    state: ToolsState,
    scratch: ToolScratch,
}

impl Rig {
    fn new(friction: f64, poses: [Pose; 2]) -> Self {
        let block = Block::still(8);
        let anchors = || Anchors::with_capacity(block.points.len());
        Self {
            model: model(friction),
            anchors: [anchors(), anchors()],
            state: ToolsState { poses },
            scratch: ToolScratch::new(ScratchLimits::default()),
            block,
        }
    }

    fn solve(&mut self, devices: [Pose; 2], settings: &SolveSettings) -> ToolsResult {
        let input = ToolInput {
            scene: self.block.scene(),
            devices: &devices,
            anchors: &self.anchors,
            compliance: None,
        };
        let solve = match settings.points_for_two_threads {
            0 => solve_tools_on_threads,
            _ => solve_tools,
        };
        solve(
            &self.model,
            settings,
            &input,
            &mut self.state,
            &mut self.scratch,
        )
    }

    fn step(&mut self, devices: [Pose; 2]) -> ToolsResult {
        let result = self.solve(devices, &SolveSettings::HAPTIC);
        self.scratch.commit(&mut self.anchors);
        result
    }
}

fn at(x: f64, z: f64) -> Pose {
    downward(Vec3::new(x, 0.4, z), Vec3::new(0.02, 0.01, 0.1))
}

#[test]
fn a_chisel_pushed_into_the_block_settles_with_its_forces_in_balance() {
    for friction in [0.0, 0.3] {
        let mut rig = Rig::new(friction, [at(1.0, 0.1), aside()]);
        for depth in [0.2, 0.5, 1.0, 2.0, 4.0, 8.0] {
            let result = rig.solve([at(1.0, -depth), aside()], &SolveSettings::MAIN);
            rig.scratch.commit(&mut rig.anchors);
            let [pull, push] = [result.coupling[0], result.contact[0]];
            assert!(result.converged, "depth {depth}: {result:?}");
            assert!(result.iterations <= 20, "depth {depth}: {result:?}");
            let left = (pull.force + push.force).norm();
            assert!(
                left < 1e-3 * pull.force.norm(),
                "depth {depth}: {left} left over"
            );
            let left = (pull.torque + push.torque).norm();
            assert!(
                left < 1e-3 * 10.0 * pull.force.norm(),
                "depth {depth}: {left} left over"
            );
            assert!(result.n_contacts[0] > 0 && result.n_dropped == 0);
        }
    }
}

/// Whether another thread takes a tool or not, to the last bit.
#[test]
fn both_tools_at_a_time_come_to_the_same_rest() {
    let [alone, beside] = [usize::MAX, 0].map(|points_for_two_threads| {
        let settings = SolveSettings {
            points_for_two_threads,
            ..SolveSettings::MAIN
        };
        let mut rig = Rig::new(0.3, [at(-7.0, 0.1), at(7.0, 0.1)]);
        let solve = |depth: f64| {
            let result = rig.solve([at(-7.0, -depth), at(7.0, -1.2 * depth)], &settings);
            rig.scratch.commit(&mut rig.anchors);
            assert!(result.n_contacts.iter().all(|n| *n > 10), "{result:?}");
            (result.coupling, rig.state)
        };
        [0.5, 2.0, 1.0].map(solve)
    });
    assert_eq!(alone, beside);
}

/// In free space the tool simply goes where the hand is, however saturated the spring.
#[test]
fn a_free_tool_follows_its_hand() {
    let mut rig = Rig::new(
        0.3,
        [aside(), moved(&aside(), &[30.0, 0.0, 0.0, 0.0, 0.0, 0.0])],
    );
    let there = moved(&aside(), &[-20.0, 8.0, 5.0, 0.0, 0.3, 2.9]);
    let devices = [there, rig.state.poses[1]];
    for _ in 0..100 {
        rig.step(devices);
    }
    let result = rig.step(devices);
    assert!(result.converged, "{result:?}");
    let way = rig.state.poses[0].translation.vector - there.translation.vector;
    assert!(way.norm() < 1e-3 && rig.state.poses[0].rotation.angle_to(&there.rotation) < 1e-3);
}

/// A wild hand: jumps, turns, contacts that come and go, both tools against each other. The penalty and coupling energy
/// of a solve never ends above where it began, and the tools stay near the hands.
#[test]
fn wild_hands_never_make_it_diverge() {
    for seed in 0..6 {
        let mut next = noise(seed);
        let mut rig = Rig::new(0.0, [at(-8.0, 1.0), at(8.0, 1.0)]);
        for step in 0..150 {
            let mut pose = |x: f64| {
                let reach = if step % 10 == 0 { 4.0 } else { 0.5 };
                let shift = Vec3::new(x + reach * next(), reach * next(), -1.0 + reach * next());
                downward(shift, Vec3::new(next(), next(), next()) * 0.3)
            };
            let devices = [pose(-3.0), pose(3.0)];
            let energy = |rig: &mut Rig| {
                let input = ToolInput {
                    scene: rig.block.scene(),
                    devices: &devices,
                    anchors: &rig.anchors,
                    compliance: None,
                };
                let settings = SolveSettings::HAPTIC;
                let r =
                    evaluate_contacts(&rig.model, &settings, &input, &rig.state, &mut rig.scratch);
                let coupling = (0..2).map(|t| {
                    let c = &rig.model.tools[t].coupling;
                    c.respond(&devices[t], &rig.state.poses[t]).energy
                });
                r.contact_energy + coupling.sum::<f64>()
            };
            let before = energy(&mut rig);
            let result = rig.solve(devices, &SolveSettings::HAPTIC);
            let after = energy(&mut rig);
            assert!(
                after <= before * (1.0 + 1e-4) + 1e-3,
                "step {step}: {before} to {after}"
            );
            assert!(result.residual.iter().all(|r| r.is_finite()));
            for (t, (tool, device)) in rig.state.poses.iter().zip(&devices).enumerate() {
                let way = tool.translation.vector - device.translation.vector;
                assert!(
                    way.norm() < 40.0,
                    "step {step}: tool {t} is {} mm off",
                    way.norm()
                );
            }
        }
    }
}

/// Whatever the second hand does, as long as the tools do not touch, the first hand's numbers have the same bits.
#[test]
fn the_hands_are_independent() {
    let run = |second: &dyn Fn(i32) -> Pose| {
        let mut rig = Rig::new(0.3, [at(-8.0, 0.2), second(0)]);
        (0..60)
            .map(|i| rig.step([at(-8.0, 0.2 - 0.03 * f64::from(i)), second(i)]))
            .map(|r| (r.coupling[0].to_vector(), r.n_contacts[0]))
            .collect::<Vec<_>>()
    };
    let far = run(&|_| aside());
    let digging = run(&|i| at(9.0, -0.05 * f64::from(i)));
    assert_eq!(far, digging);
    assert!(far.last().unwrap().0.norm() > 100.0);
}

#[test]
fn equal_input_gives_equal_bits() {
    let run = || {
        let mut rig = Rig::new(0.3, [at(-3.0, 0.2), at(4.0, 0.2)]);
        let mut trace = Vec::new();
        for i in 0..80 {
            let z = 0.2 - 0.03 * f64::from(i);
            let twist = [0.0, 0.0, 0.0, 0.0, 0.0, 0.004 * f64::from(i)];
            let result = rig.step([moved(&at(-3.0, z), &twist), at(4.0, z)]);
            trace.push((result.coupling.map(|w| w.to_vector()), rig.state));
            let shift = 1e-3 * f64::from(i);
            rig.block
                .deform(|p| p + Vec3::new(0.0, 0.0, shift * p.x / 20.0));
        }
        trace
    };
    assert_eq!(run(), run());
}

/// Two chisels driven at each other stop, and both hands feel it.
#[test]
fn chisels_meet() {
    let up = Vec3::new(0.0, 0.0, 200.0);
    let pose = |y: f64| downward(up + Vec3::new(0.0, y, 0.0), Vec3::zeros());
    let mut rig = Rig::new(0.3, [pose(-2.0), pose(2.0)]);
    let result = rig.solve([pose(-1.0), pose(1.0)], &SolveSettings::MAIN);
    assert!(result.converged && result.n_pair_contacts > 0, "{result:?}");
    let [a, b] = result.coupling.map(|w| w.force);
    assert!(a.y > 30.0 && (a + b).norm() < 1e-2 * a.y, "{a} {b}");
}

#[test]
fn a_pose_that_is_not_finite_moves_nothing() {
    let mut rig = Rig::new(0.3, [at(1.0, -0.1), aside()]);
    let before = rig.state;
    let mut bad = aside();
    bad.translation.vector.x = f64::NAN;
    rig.step([at(1.0, -0.5), bad]);
    assert_eq!(rig.state.poses[1], before.poses[1]);
}

/// A ball that stands still holds a chisel as a spring k A d would, and only the chisel that touches it.
#[test]
fn what_stands_still_pushes_back() {
    let here = aside();
    let other = moved(&here, &[80.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut rig = Rig::new(0.0, [here, other]);
    // The blade's side looks along -y; the ball's top comes .5 mm into it.
    let centre = here.translation.vector + Vec3::new(0.0, -11.0, 30.0);
    let bounds = Aabb::around(&[centre.add_scalar(-13.0), centre.add_scalar(13.0)]);
    let ball = DistanceGrid::sample(bounds, [0.5; 3], |p| (p - centre).norm() - 10.0).unwrap();
    rig.model.surroundings = vec![Arc::new(ball)];
    let result = rig.solve([here, other], &SolveSettings::MAIN);
    assert!(result.converged && result.n_static_contacts[0] > 0);
    assert_eq!(result.n_static_contacts[1], 0);
    let [pushed, free] = result.contact;
    assert!(pushed.force.y > 1.0, "{pushed:?}");
    assert!(free.force.norm() == 0.0, "{free:?}");
    let left = pushed.force + result.coupling[0].force;
    assert!(left.norm() < 1e-3 * pushed.force.norm(), "{left} left over");
    // Deeper, it pushes harder.
    let deeper = moved(&here, &[0.0, -1e-3, 0.0, 0.0, 0.0, 0.0]);
    let forced = rig.solve([deeper, other], &SolveSettings::MAIN);
    assert!(forced.contact[0].force.y > pushed.force.y);
}
