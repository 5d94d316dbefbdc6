//! Time of a haptic step: two chisels driven into a block of about 100,000 shell points in about 2,000 tetrahedra.
//!
//! `cargo run --release -p osteotome-mechanics --example haptic_timing`
#![allow(clippy::print_stdout)]
#[path = "../tests/support/mod.rs"]
mod support;

use osteotome_mechanics::contact::BoundingVolumes;
use osteotome_mechanics::geometry::{Pose, Vec3};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticInput, HapticModel, HapticState, haptic_step,
};
use osteotome_mechanics::tool::{ScratchLimits, SolveSettings};
use std::time::{Duration, Instant};
use support::{Block, downward, model};

fn main() {
    // 472 boundary triangles of 15 x 15 points; 1,440 tetrahedra.
    let block = Block::still(15);
    let limits = DeviceLimits {
        force_scale: 0.005,
        torque_scale: 0.04,
        max_force: 3.3,
        max_torque: 188.0,
        max_force_rate: 500.0,
        max_torque_rate: 20_000.0,
    };
    let model = HapticModel {
        tools: model(0.3),
        settings: SolveSettings::HAPTIC,
        limits: [limits; 2],
    };
    let (n_points, n_tets) = (block.points.len(), block.mesh.tets().len());
    println!("{n_points} points in {n_tets} tetrahedra");
    time_update(&block);
    for (name, depth, lying) in [("tips", 2.0, 0.0), ("sides", 1.0, 1.4)] {
        time_steps(name, &model, &block, |i| hands(i, depth, lying));
    }
}

/// Presses in over 500 steps with a tremor of 0.05 mm at 9 Hz, twisting.
fn hands(step: u32, depth: f64, lying: f64) -> [Pose; 2] {
    let t = f64::from(step) * 1e-3;
    let z =
        1.5 - (1.5 + depth) * (t / 0.5).min(1.0) + 0.05 * (std::f64::consts::TAU * 9.0 * t).sin();
    [(-8.0, 1.0), (8.0, -1.0)].map(|(x, way): (f64, f64)| {
        downward(Vec3::new(x, 6.0, z), Vec3::new(lying, 0.03, 0.3 * way * t))
    })
}

fn time_update(block: &Block) {
    let mut volumes = BoundingVolumes::default();
    let start = Instant::now();
    for _ in 0..100 {
        volumes.update(&block.shell, &block.deformation);
    }
    println!(
        "bounding volumes: {:.1} us an update",
        1e4 * start.elapsed().as_secs_f64()
    );
}

/// The least of several runs of each step, so that what else the machine does is left out.
fn time_steps(name: &str, model: &HapticModel, block: &Block, hands: impl Fn(u32) -> [Pose; 2]) {
    const STEPS: u32 = 3000;
    let mut least = vec![Duration::MAX; STEPS as usize];
    let (mut iterations, mut contacts, mut converged) = (0, 0, 0);
    for _ in 0..RUNS {
        let mut state = HapticState::new(hands(0), block.points.len(), ScratchLimits::default());
        (iterations, contacts, converged) = (0, 0, 0);
        for step in 0..STEPS {
            let input = HapticInput {
                scene: block.scene(),
                devices: hands(step),
                dt: 1e-3,
            };
            let start = Instant::now();
            let output = haptic_step(model, &mut state, &input);
            let time = &mut least[step as usize];
            *time = (*time).min(start.elapsed());
            iterations += output.result.iterations;
            contacts = contacts.max(output.result.n_contacts[0]);
            converged += usize::from(output.result.converged);
        }
    }
    least.sort_unstable();
    let us = |d: Duration| 1e6 * d.as_secs_f64();
    let n = least.len();
    println!(
        "{name}: mean {:.0} us, median {:.0}, 99 % {:.0}, worst {:.0}; {:.2} iterations a step, up to {contacts} contacts a tool, {:.1} % at rest",
        us(least.iter().sum::<Duration>()) / n as f64,
        us(least[n / 2]),
        us(least[n * 99 / 100]),
        us(least[n - 1]),
        iterations as f64 / n as f64,
        100.0 * converged as f64 / n as f64,
    );
}

const RUNS: usize = 7;
