//! What each stage of a growth step costs, against the full method in the same run: criterion, growth of the surface, signs of
//! the cut elements, level sets, cells, equations with factor, fragments.
//!
//! A bar of unit bricks split lengthwise from one end: the front spans the bar's width and runs through its middle third in
//! steps of .8 h. Each figure is the median over the steps of the least of three calls. Full method: everything of the stage
//! made anew from the whole crack. Run with `cargo bench -p osteotome-mechanics --bench propagation`.
#![allow(clippy::print_stdout)]
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::growth::{GrowthLengths, Strip, grow};
use osteotome_mechanics::crack::level_set::level_sets;
use osteotome_mechanics::crack::load_control::FrontDrives;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::crack::{
    CrackSurface, CrackedBody, Fragments, Growth, LinePoint, Sheet, Solid, System, Topology,
};
use osteotome_mechanics::geometry::{TetLocator, Vec3, block_mesh};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

const YOUNG: f64 = 13_000.0;
/// Mean edge of a unit brick in six tetrahedra.
const H: f64 = 1.28;

const STAGES: [&str; 7] = [
    "criterion: G, K, kinks along the front",
    "growth of the explicit crack",
    "signs: newly cut edges",
    "level sets",
    "cells and enrichments",
    "border: equations and factor",
    "fragments",
];

/// The bar with a crack of a third of its length from x = 0, held at its other end.
fn bar(cells: [usize; 3]) -> CrackedBody {
    let [l, b, h] = cells.map(|n| n as f64);
    let mesh = block_mesh(Vec3::zeros(), Vec3::new(l, b, h), cells);
    let end = Vec3::new(l, 0.5 * b, 0.5 * h);
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(YOUNG, 0.3, 0.5); mesh.tets().len()],
        supports: Supports::near(&mesh, &[end], 0.5 * b, 1e-7, YOUNG),
        lengths: GrowthLengths::for_element_size(H),
        mesh,
    };
    let line: Vec<LinePoint> = (0..=2 * cells[1])
        .map(|k| LinePoint {
            at: Vec3::new(0.0, 0.5 * k as f64, (0.5 * h).floor() + 0.4),
            toward: Vec3::x(),
            depth: (l / 3.0).floor() + 0.4,
        })
        .collect();
    let sheets = vec![Sheet::ribbon("split", &line, 0.5, 1.0, 1.0)];
    CrackedBody::new(Arc::new(solid), CrackSurface { sheets }).expect("the bar is held")
}

/// A force pair that opens the crack at its mouth.
fn pull(body: &CrackedBody) -> Vec<CellForce> {
    let (mesh, size) = (&body.solid.mesh, body.solid.mesh.bounds().max);
    let at = |z: f64, up: f64| {
        let p = Vec3::new(0.01, 0.5 * size.y, z);
        let (tet, weights) = body.solid.locator.find(mesh, &p).expect("inside the bar");
        CellForce {
            cell: body.topology.cell_at(tet, &weights),
            weights,
            force: up * Vec3::z(),
        }
    };
    vec![at(size.z - 0.01, 100.0), at(0.01, -100.0)]
}

/// Milliseconds: the least of three calls.
fn least<T>(mut f: impl FnMut() -> T) -> (f64, T) {
    let mut timed = || {
        let start = Instant::now();
        let result = black_box(f());
        (1e3 * start.elapsed().as_secs_f64(), result)
    };
    let first = timed();
    (1..3)
        .map(|_| timed())
        .fold(first, |a, b| if b.0 < a.0 { b } else { a })
}

/// One step: milliseconds of each stage as it is done, and as the full method does it.
struct Step {
    ours: [f64; 7],
    full: [f64; 7],
    next: CrackedBody,
}

fn step(body: &CrackedBody) -> Step {
    let solid = &*body.solid;
    let (mesh, locator, around) = (&solid.mesh, &solid.locator, solid.surroundings());
    let loads = pull(body);
    let mut x = vec![0.0; body.system.n()];
    body.add_loads(&loads, &mut x);
    body.system.solve(&mut x, &mut body.system.scratch());
    let (criterion, evaluated) = least(|| {
        let evaluated = body.evaluate_fronts(&x, &loads, 0.0);
        black_box(FrontDrives::new(&evaluated, &solid.lengths));
        evaluated
    });
    let stations = &evaluated[0].stations;
    let ahead: Vec<Vec3> = stations
        .iter()
        .map(|_| Vec3::x() * solid.lengths.increment)
        .collect();
    let (surface, (crack, strip)) = least(|| -> (CrackSurface, Strip) {
        let mut crack = body.crack.clone();
        let strip = grow(&mut crack, &evaluated[0].front, &ahead, &around);
        (crack, strip)
    });
    let (signs, (cuts, newly_cut)) = least(|| {
        let mut cuts = body.cuts.clone();
        let new = strip.cut(&mut cuts, mesh, locator, solid.chip_nodes());
        (cuts, new)
    });
    let fronts = crack.fronts(mesh, locator, solid.lengths.stick());
    let (sets, _) = least(|| level_sets(mesh, locator, &crack, &fronts, 2.0 * H));
    let (cells, topology) = least(|| body.topology.grown(mesh, &cuts, &newly_cut));
    let (materials, supports) = (&solid.materials, &solid.supports);
    let (border, _) = least(|| body.system.grown(mesh, materials, &topology, supports));
    let (pieces, _) = least(|| Fragments::find(mesh, &cuts));
    let (all_signs, _) = least(|| around.first_cuts(&mut crack.clone(), solid.chip_nodes()));
    let (all_cells, anew) = least(|| Topology::new(mesh, &cuts));
    let (factor, _) = least(|| System::new(mesh, materials, &anew, supports));
    let next = body
        .grown(Growth {
            crack,
            cuts,
            newly_cut,
        })
        .expect("the bar is held");
    Step {
        ours: [criterion, surface, signs, sets, cells, border, pieces],
        full: [
            criterion, surface, all_signs, sets, all_cells, factor, pieces,
        ],
        next,
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let mut columns = Vec::new();
    for cells in [[24, 4, 4], [50, 9, 9], [100, 16, 14]] {
        let mut body = bar(cells);
        let n_steps = (cells[0] as f64 / (3.0 * 0.8 * H)) as usize;
        let n_steps = n_steps.min(10);
        let mut steps = Vec::new();
        for _ in 0..n_steps {
            let step = step(&body);
            // By stage, then the whole step: as it is done, and by the full method.
            let mut times: Vec<[f64; 2]> = step
                .ours
                .into_iter()
                .zip(step.full)
                .map(|(o, f)| [o, f])
                .collect();
            times.push([step.ours.iter().sum(), step.full.iter().sum()]);
            steps.push(times);
            body = step.next;
        }
        let of = |i: usize, k: usize| median(steps.iter().map(|s| s[i][k]).collect());
        let column: Vec<[f64; 2]> = (0..=STAGES.len()).map(|i| [of(i, 0), of(i, 1)]).collect();
        columns.push((body.solid.mesh.nodes().len(), n_steps, column));
    }
    print!("| stage, ms (full method) |");
    columns
        .iter()
        .for_each(|(n, steps, _)| print!(" {n} nodes, {steps} steps |"));
    println!("\n|---|---|---|---|");
    for (i, stage) in STAGES.iter().chain(&["whole step"]).enumerate() {
        print!("| {stage} |");
        for (_, _, column) in &columns {
            let [ours, full] = column[i];
            if ours == full {
                print!(" {ours:.3} |");
            } else {
                print!(" {ours:.3} ({full:.2}: {:.1} times) |", full / ours);
            }
        }
        println!();
    }
}
