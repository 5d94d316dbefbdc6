//! What a growth step costs: everything assembled and factored anew, against the bordered factor; and what solves cost.
//!
//! A slender bar is split as in the operation: two kerfs half way through it, and a sheet along the bar that grows from one
//! to the other until the bar is in two. Each call's least time of several,
//! medians over the steps of one split; ratios are of the same run.
//! Run with `cargo bench -p osteotome-mechanics --bench growth`; an argument of digits picks one size.
#![allow(clippy::print_stdout)]
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::{CutEdges, Fragments, System, Topology};
use osteotome_mechanics::geometry::{TetLocator, TetMesh, TriMesh, Vec3, block_mesh};
use std::hint::black_box;
use std::time::Instant;

const REPEATS: usize = 7;

fn rectangle(corner: [f64; 3], along: [f64; 3], across: [f64; 3]) -> TriMesh {
    let [o, a, b] = [corner, along, across].map(Vec3::from);
    TriMesh {
        vertices: vec![o, o + a, o + a + b, o + b],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// A bar of unit bricks, its kerfs, and the strips of its growing sheet.
struct Split {
    mesh: TetMesh,
    kerfs: [TriMesh; 2],
    strips: Vec<TriMesh>,
}

fn split(cells: [usize; 3]) -> Split {
    let [l, b, h] = cells.map(|n| n as f64);
    let mesh = block_mesh(Vec3::zeros(), Vec3::new(l, b, h), cells);
    let middle = (0.5 * h).floor() + 0.4;
    let (start, end) = ((l / 3.0).floor() + 0.45, (2.0 * l / 3.0).floor() + 0.55);
    let across = [0.0, b + 2.0, 0.3];
    let kerfs = [
        rectangle([start, -1.0, middle - 0.3], [0.2, 0.0, h], across),
        rectangle([end, -1.0, middle + 0.5], [0.2, 0.0, -h], across),
    ];
    let n = ((end - start) / 0.8).ceil() as usize;
    let step = (end - start + 0.5) / n as f64;
    let strip = |k: usize| {
        let x = start - 0.3 + step * k as f64;
        rectangle([x - 0.4, -1.0, middle], [step + 0.4, 0.0, 0.0], across)
    };
    Split {
        mesh,
        kerfs,
        strips: (0..n).map(strip).collect(),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Milliseconds of one call: the least of several, as other programs take the processor away at times.
fn least<T>(n: usize, mut f: impl FnMut() -> T) -> (f64, T) {
    let first = timed(&mut f);
    (1..n)
        .map(|_| timed(&mut f))
        .fold(first, |a, b| if b.0 < a.0 { b } else { a })
}

/// Milliseconds of one call.
fn timed<T>(f: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = black_box(f());
    (1e3 * start.elapsed().as_secs_f64(), result)
}

/// Least milliseconds of `n` calls.
fn repeated(n: usize, mut f: impl FnMut()) -> f64 {
    (0..n)
        .map(|_| timed(&mut f).0)
        .fold(f64::INFINITY, f64::min)
}

/// The split of one body, as far as it has come.
struct Run {
    split: Split,
    locator: TetLocator,
    materials: Vec<TetMaterial>,
    supports: Supports,
    cuts: CutEdges,
    topology: Topology,
    system: System,
}

/// Milliseconds of each step.
#[derive(Default)]
struct Times {
    cut: Vec<f64>,
    topology: Vec<f64>,
    system: Vec<f64>,
    full_topology: Vec<f64>,
    full_system: Vec<f64>,
    full_solve: Vec<f64>,
}

impl Run {
    /// The body with its kerfs, held at one end.
    fn new(cells: [usize; 3]) -> Self {
        const YOUNG: f64 = 13_000.0;
        let split = split(cells);
        let mesh = &split.mesh;
        let [_, b, h] = cells.map(|n| n as f64);
        let end = Vec3::new(0.0, 0.5 * b, 0.5 * h);
        let locator = TetLocator::new(mesh);
        let materials = vec![TetMaterial::isotropic(YOUNG, 0.3, 1.0); mesh.tets().len()];
        let supports = Supports::near(mesh, &[end], 0.5 * b, 1e-7, YOUNG);
        let mut cuts = CutEdges::new(mesh);
        for kerf in &split.kerfs {
            cuts.cut(mesh, &locator, kerf, 4);
        }
        let topology = Topology::new(mesh, &cuts);
        let system = System::new(mesh, &materials, &topology, &supports).unwrap();
        Self {
            split,
            locator,
            materials,
            supports,
            cuts,
            topology,
            system,
        }
    }

    /// Grows by strip `k`.
    fn grow(&mut self, k: usize, times: &mut Times) {
        let mesh = &self.split.mesh;
        let strip = &self.split.strips[k];
        let (ms, new) = timed(|| self.cuts.cut(mesh, &self.locator, strip, 4));
        times.cut.push(ms);
        let (ms, next) = least(REPEATS, || self.topology.grown(mesh, &self.cuts, &new));
        times.topology.push(ms);
        self.topology = next;
        let (ms, next) = least(REPEATS, || {
            let (system, materials) = (&self.system, &self.materials);
            system.grown(mesh, materials, &self.topology, &self.supports)
        });
        times.system.push(ms);
        self.system = next.unwrap();
    }

    /// What the same takes anew.
    fn compare(&self, times: &mut Times) {
        let mesh = &self.split.mesh;
        let repeats = if self.is_large() { 2 } else { REPEATS };
        let topology = || Topology::new(mesh, &self.cuts);
        times.full_topology.push(least(REPEATS, topology).0);
        let (ms, full) = least(repeats, || {
            System::new(mesh, &self.materials, &self.topology, &self.supports)
        });
        times.full_system.push(ms);
        let full = full.unwrap();
        let (mut x, mut scratch) = (vec![1.0; full.n()], full.scratch());
        let solve = || full.solve(&mut x, &mut scratch);
        times.full_solve.push(repeated(5, solve));
    }

    fn is_large(&self) -> bool {
        self.split.mesh.nodes().len() > 10_000
    }
}

fn bench(cells: [usize; 3]) {
    let mut run = Run::new(cells);
    let mut times = Times::default();
    let n_steps = run.split.strips.len();
    let mesh = &run.split.mesh;
    println!(
        "\n{} nodes, {} tets, {} unknowns at the start, {n_steps} steps",
        mesh.nodes().len(),
        mesh.tets().len(),
        run.system.n(),
    );
    let compare_every = if run.is_large() { n_steps / 3 } else { 1 };
    for k in 0..n_steps {
        run.grow(k, &mut times);
        if k % compare_every == 0 || k + 1 == n_steps {
            run.compare(&mut times);
        }
    }
    report(&run, times);
}

fn report(run: &Run, times: Times) {
    let mesh = &run.split.mesh;
    let (find_ms, fragments) = timed(|| Fragments::find(mesh, &run.cuts));
    let worst = times.system.iter().copied().fold(0.0, f64::max);
    let sum: f64 = times.system.iter().sum();
    let (grown, full) = (median(times.system), median(times.full_system));
    let factor = run.system.factor();
    println!(
        "  {} fragments; border of {} unknowns; values kept {:?}",
        fragments.count(),
        factor.n_border(),
        factor.n_values()
    );
    println!(
        "  linearisation + factorisation, ms: full {full:.3}, bordered {grown:.3} (worst {worst:.3}, whole split {sum:.1}); ratio {:.1}",
        full / grown
    );
    let (t_grown, t_full) = (median(times.topology), median(times.full_topology));
    println!(
        "  topology, ms: full {t_full:.3}, grown {t_grown:.3}; with it, ratio {:.1}",
        (full + t_full) / (grown + t_grown)
    );
    println!(
        "  cutting {:.3} ms, finding fragments {find_ms:.3} ms",
        median(times.cut)
    );
    solves(mesh, &run.topology, &run.system, median(times.full_solve));
}

/// Solves at the end of the split: all of it, the region of contacts and crack, and half solves of contact forces.
fn solves(mesh: &TetMesh, topology: &Topology, system: &System, full_ms: f64) {
    let mut scratch = system.scratch();
    let mut x = vec![1.0; system.n()];
    let solve_ms = repeated(15, || system.solve(&mut x, &mut scratch));
    // Contacts: the divided cells nearest to the first kerf.
    let from = mesh.bounds().max.x / 3.0;
    let distance = |c: u32| {
        let tet = topology.cells()[c as usize].tet;
        (mesh.corners(tet as usize)[0].x - from).abs()
    };
    let mut contacts: Vec<u32> = (0..topology.cells().len() as u32)
        .filter(|c| topology.is_divided(topology.cells()[*c as usize].tet))
        .collect();
    contacts.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b)));
    contacts.truncate(24);
    let cells: Vec<_> = contacts
        .iter()
        .map(|c| &topology.cells()[*c as usize])
        .collect();
    let region = system.region(mesh, cells.iter().copied());
    let mut x = vec![0.0; system.n()];
    let region_ms = repeated(15, || {
        x.fill(0.0);
        system.add_force(mesh, cells[0], &[0.25; 4], &Vec3::x(), &mut x);
        system.solve_region(&region, &mut x, &mut scratch);
    });
    let columns: Vec<_> = cells
        .iter()
        .map(|cell| {
            let mut column = Vec::new();
            system.push_corner_forces(mesh, cell, &[Vec3::y() * 0.25; 4], &mut column);
            column
        })
        .collect();
    let half_ms = repeated(9, || {
        black_box(system.half_solve(&columns));
    });
    let half = system.half_solve(&columns);
    let compliance_ms = repeated(9, || {
        black_box(half.compliance(&half));
    });
    println!(
        "  solve, ms: full factor {full_ms:.3}, bordered {solve_ms:.3}; region of {} of {} unknowns {region_ms:.3}",
        region.n_rows() + system.factor().n_border(),
        system.n()
    );
    println!("  24 half solves {half_ms:.3} ms, their compliance {compliance_ms:.3} ms");
}

fn main() {
    let wanted = std::env::args()
        .skip(1)
        .find_map(|a| a.parse::<usize>().ok());
    for (size, cells) in [
        (600, [24, 4, 4]),
        (5000, [50, 9, 9]),
        (25_000, [100, 16, 14]),
    ] {
        if wanted.is_none_or(|w| w == size) {
            bench(cells);
        }
    }
}
