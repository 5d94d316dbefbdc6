//! What evaluating G and K along a front costs as the body around it grows: the same front in blocks of 600 to 25,000 nodes.
//!
//! Only elements within two element sizes of the front are looked at, so that the cost must stay level.
//! Run with `cargo bench -p osteotome-mechanics --bench front_evaluation`.
#![allow(clippy::print_stdout)]
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{CrackSurface, CrackedBody, LinePoint, Sheet, Solid};
use osteotome_mechanics::geometry::{TetLocator, Vec3, block_mesh};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

/// A bar of unit bricks with a saw cut across it, 6 deep and 4 wide.
fn bar(length: usize) -> CrackedBody {
    let size = [length, 4, 12];
    let mesh = block_mesh(Vec3::zeros(), Vec3::from(size.map(|n| n as f64)), size);
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(13_000.0, 0.3, 0.5); mesh.tets().len()],
        supports: Supports {
            ground_spring: 1e-3,
            ..Default::default()
        },
        lengths: GrowthLengths::for_element_size(1.28),
        mesh,
    };
    let middle = 0.5 * length as f64 + 0.3;
    let line: Vec<LinePoint> = (0..=8)
        .map(|k| LinePoint {
            at: Vec3::new(middle, 0.5 * f64::from(k), 0.0),
            toward: Vec3::z(),
            depth: 6.2,
        })
        .collect();
    let sheet = Sheet::ribbon("cut", &line, 0.5, 1.0, 1.0);
    CrackedBody::new(
        Arc::new(solid),
        CrackSurface {
            sheets: vec![sheet],
        },
    )
    .expect("soft tissue holds every part")
}

fn main() {
    let mut first = None;
    for length in [8, 76, 384] {
        let body = bar(length);
        let x: Vec<f64> = (0..body.system.n())
            .map(|i| 1e-3 * (0.37 * i as f64).sin())
            .collect();
        let mut times: Vec<f64> = (0..21)
            .map(|_| {
                let start = Instant::now();
                black_box(body.evaluate_fronts(&x, &[], 0.0));
                1e3 * start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let stations: usize = body
            .evaluate_fronts(&x, &[], 0.0)
            .iter()
            .map(|f| f.stations.len())
            .sum();
        let ratio = times[10] / *first.get_or_insert(times[10]);
        let nodes = body.solid.mesh.nodes().len();
        println!(
            "{nodes:6} nodes, {stations} stations: {:.2} ms, {ratio:.2} of the smallest",
            times[10]
        );
    }
}
