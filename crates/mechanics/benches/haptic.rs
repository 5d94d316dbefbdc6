//! The haptic step and its contact query on a block of bone: `cargo bench -p osteotome-mechanics --bench haptic`.
#![allow(clippy::print_stdout)]
#[path = "../tests/support/mod.rs"]
mod support;

use osteotome_mechanics::contact::Wrench;
use osteotome_mechanics::geometry::{Pose, Vec3};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticInput, HapticModel, HapticState, haptic_step,
};
use osteotome_mechanics::tool::{BoneCompliance, Matrix12, ScratchLimits, SolveSettings, Vector12};
use std::time::Instant;
use support::{Block, downward, model};

/// In, twist against each other, out.
fn hands(step: u32, depth: f64) -> [Pose; 2] {
    let t = f64::from(step % 400) / 400.0;
    let depth = depth * (std::f64::consts::TAU * t).sin();
    let at = |x: f64, twist: f64| downward(Vec3::new(x, 0.4, -depth), Vec3::new(0.02, 0.01, twist));
    [at(-7.0, 0.1 * depth), at(7.0, -0.1 * depth)]
}

fn yielding() -> BoneCompliance {
    let matrix = Vector12::from_fn(|i, _| if i % 6 < 3 { 1e-3 } else { 1e-5 });
    BoneCompliance {
        matrix: Matrix12::from_diagonal(&matrix),
        origins: [Vec3::new(-7.0, 0.0, 0.0), Vec3::new(7.0, 0.0, 0.0)],
        load: [Wrench::ZERO; 2],
    }
}

fn main() {
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
        limits: [limits, limits],
    };
    for (n, depth) in [(8, 1.0), (8, 3.0), (24, 1.0), (24, 3.0), (24, 8.0)] {
        let block = Block::still(n);
        let bone = yielding();
        let mut state = HapticState::new(
            hands(0, depth),
            block.points.len(),
            ScratchLimits::default(),
        );
        let mut rows: Vec<(usize, f64, usize)> = Vec::new();
        let mut sum = 0.0;
        for step in 0..1200 {
            let mut scene = block.scene();
            scene.state = 1 + u64::from(step / 20);
            let input = HapticInput {
                scene,
                compliance: Some(&bone),
                devices: hands(step, depth),
                dt: 1e-3,
            };
            let start = Instant::now();
            let out = haptic_step(&model, &mut state, &input);
            let us = start.elapsed().as_secs_f64() * 1e6;
            sum += out.device[0].force.norm() + out.device[1].torque.norm();
            rows.push((
                out.result.n_contacts.iter().sum(),
                us,
                out.result.iterations,
            ));
        }
        println!(
            "{} points, {depth} mm deep, checksum {sum:.3}",
            block.points.len()
        );
        for (a, b) in [
            (0, 1),
            (1, 30),
            (30, 100),
            (100, 300),
            (300, 1000),
            (1000, 100_000),
        ] {
            let mut t: Vec<_> = rows
                .iter()
                .filter(|r| (a..b).contains(&r.0))
                .map(|r| r.1)
                .collect();
            let it: usize = rows
                .iter()
                .filter(|r| (a..b).contains(&r.0))
                .map(|r| r.2)
                .sum();
            if t.is_empty() {
                continue;
            }
            t.sort_by(f64::total_cmp);
            let at = |s: f64| t[((t.len() - 1) as f64 * s) as usize];
            println!(
                "  {a:>5} contacts and more: n {:>5} iterations {:.2} p50 {:>8.1} p90 {:>8.1} p99 {:>8.1} us",
                t.len(),
                it as f64 / t.len() as f64,
                at(0.5),
                at(0.9),
                at(0.99)
            );
        }
    }
}
