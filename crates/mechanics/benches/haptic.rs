//! The haptic step and its contact query on a block of bone: `cargo bench -p osteotome-mechanics --bench haptic`.
//!
//! Judge by medians and by ratios within one run.
#![allow(clippy::print_stdout)]
#[path = "../tests/support/mod.rs"]
mod support;

use osteotome_mechanics::contact::{NearPoints, Wrench, penetrations, penetrations_in};
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

/// Median time of a repeated piece of work \[us\], called with the number of the repetition.
fn median(mut work: impl FnMut(usize)) -> f64 {
    let mut times: Vec<f64> = (0..101)
        .map(|k| {
            let start = Instant::now();
            work(k);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Finding the near points and the query of those, four at a time and one at a time.
fn query(n: usize) {
    let block = Block::still(n);
    let model = model(0.3);
    let shape = &model.tools[0].shape;
    let pose = downward(Vec3::new(-7.0, 0.4, -2.0), Vec3::new(0.02, 0.01, 0.2));
    let scene = block.scene();
    let room = block.points.len();
    let [mut near, mut plain_near] = [0; 2].map(|_| NearPoints::with_capacity(room));
    let [mut found, mut plain_found] = [0; 2].map(|_| Vec::with_capacity(room));
    let find = median(|_| near.find(shape, &pose, &scene));
    let plain_find = median(|_| plain_near.find_in::<f32>(shape, &pose, &scene));
    let ask = median(|_| penetrations(shape, &pose, &near, &mut found));
    let plain_ask = median(|_| penetrations_in::<f32>(shape, &pose, &plain_near, &mut plain_found));
    assert_eq!(found, plain_found);
    println!(
        "{room:>8} points, {} near, {} inside: finding {find:.1} us ({:.1} times slower without SIMD), query {ask:.2} us ({:.1} times; {:.0} points a us)",
        near.len(),
        found.len(),
        plain_find / find,
        plain_ask / ask,
        near.len() as f64 / ask
    );
}

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
        limits: [limits, limits],
    }
}

/// Haptic steps of hands that go in by `depth` \[mm\] and out again, a new state of the bone every twenty; by how many points touch.
fn steps(n: usize, depth: f64) {
    let (model, block, bone) = (haptic_model(), Block::still(n), yielding());
    let n_points = block.points.len();
    let mut state = HapticState::new(hands(0, depth), n_points, ScratchLimits::default());
    let mut rows = Vec::new();
    let mut felt = 0.0;
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
        let output = haptic_step(&model, &mut state, &input);
        let us = start.elapsed().as_secs_f64() * 1e6;
        felt += output.device[0].force.norm() + output.device[1].torque.norm();
        let result = &output.result;
        rows.push((result.n_contacts.iter().sum(), us, result.iterations));
    }
    println!("{n_points} points, {depth} mm deep; sum of all that was felt: {felt:.3}");
    for least in [0, 1, 30, 100, 300, 1000] {
        let next = [1, 30, 100, 300, 1000, usize::MAX]
            .into_iter()
            .find(|n| *n > least);
        let range = least..next.unwrap_or(usize::MAX);
        let own: Vec<&(usize, f64, usize)> = rows.iter().filter(|r| range.contains(&r.0)).collect();
        let mut times: Vec<f64> = own.iter().map(|r| r.1).collect();
        times.sort_by(f64::total_cmp);
        let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
        if !own.is_empty() {
            let iterations = own.iter().map(|r| r.2).sum::<usize>() as f64 / own.len() as f64;
            println!(
                "  from {least:>4} contacts: {:>4} steps, {iterations:.2} iterations, median {:>6.1} us, 90 % {:>6.1}, 99 % {:>6.1}",
                own.len(),
                at(0.5),
                at(0.9),
                at(0.99)
            );
        }
    }
}

fn main() {
    for n in [8, 15, 26, 46] {
        query(n);
    }
    for (n, depth) in [(8, 1.0), (8, 3.0), (24, 1.0), (24, 3.0), (24, 8.0)] {
        steps(n, depth);
    }
}
