//! Prescribed displacements: a bar pulled along x between symmetry planes, whole and cut.
//!
//! Uniform tension is in the space of linear tetrahedra, so stress E u / L, strains and reactions are exact: tolerance is
//! round-off (1e-9 of the largest value). A cut along the load changes nothing; one across it leaves no stress.
use osteotome_mechanics::bone::{Prescribed, Supports, TetMaterial, stiffness};
use osteotome_mechanics::crack::{CutEdges, Fragments, System, Topology};
use osteotome_mechanics::geometry::{TetLocator, TetMesh, TriMesh, Vec3, block_mesh};

const SIZE: [f64; 3] = [6.0, 4.0, 3.0];
const YOUNG: f64 = 1000.0;
const PULL: f64 = 0.03;

struct Bar {
    mesh: TetMesh,
    materials: Vec<TetMaterial>,
    topology: Topology,
    fragments: Fragments,
}

fn bar(sheet: Option<[[f64; 3]; 3]>) -> Bar {
    let mesh = block_mesh(Vec3::zeros(), Vec3::from(SIZE), [6, 4, 3]);
    let mut cuts = CutEdges::new(&mesh);
    if let Some(sheet) = sheet {
        let [o, a, b] = sheet.map(Vec3::from);
        let sheet = TriMesh {
            vertices: vec![o, o + a, o + a + b, o + b],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        cuts.cut(&mesh, &TetLocator::new(&mesh), &sheet, 1);
    }
    Bar {
        materials: vec![TetMaterial::isotropic(YOUNG, 0.3, 1.0); mesh.tets().len()],
        topology: Topology::new(&mesh, &cuts),
        fragments: Fragments::find(&mesh, &cuts),
        mesh,
    }
}

/// Symmetry planes x = 0, y = 0, z = 0; the end x = L pulled by `PULL`.
fn pulled(mesh: &TetMesh, ground_spring: f64) -> Supports {
    let mut prescribed = Vec::new();
    for (node, p) in (0u32..).zip(mesh.nodes()) {
        for axis in 0..3u8 {
            let at = p[usize::from(axis)];
            let mut hold = |value| prescribed.push(Prescribed { node, axis, value });
            if at < 1e-9 {
                hold(0.0);
            } else if axis == 0 && at > SIZE[0] - 1e-9 {
                hold(PULL);
            }
        }
    }
    Supports {
        prescribed,
        ground_spring,
        ..Default::default()
    }
}

fn solved(bar: &Bar, ground_spring: f64) -> (System, Vec<f64>) {
    let supports = pulled(&bar.mesh, ground_spring);
    let system = System::new(&bar.mesh, &bar.materials, &bar.topology, &supports).unwrap();
    let mut x = vec![0.0; system.n()];
    system.add_prescribed(&mut x);
    system.solve(&mut x, &mut system.scratch());
    (system, x)
}

/// Largest deviation of any cell's stress from `sigma` along x, relative to E u / L.
fn stress_error(bar: &Bar, system: &System, x: &[f64], sigma: f64) -> f64 {
    let mut expected = nalgebra::Matrix3::zeros();
    expected[(0, 0)] = sigma;
    let error = |cell| {
        let cell: &osteotome_mechanics::crack::Cell = cell;
        let u = system.cell_displacements(&bar.mesh, cell, x);
        let grad = stiffness::displacement_gradient(&bar.mesh.gradients()[cell.tet as usize], &u);
        let s = stiffness::stress(&bar.materials[cell.tet as usize].lame(), &grad);
        (s - expected).amax()
    };
    bar.topology.cells().iter().map(error).fold(0.0, f64::max) / (YOUNG * PULL / SIZE[0])
}

fn reaction(bar: &Bar, system: &System, x: &[f64]) -> f64 {
    let forces = system.multiply(x);
    (0..bar.mesh.nodes().len())
        .filter(|&i| bar.mesh.nodes()[i].x > SIZE[0] - 1e-9)
        .map(|i| system.displacement(i, &forces).x)
        .sum()
}

#[test]
fn a_bar_between_symmetry_planes_is_in_uniform_tension() {
    let bar = bar(None);
    let (system, x) = solved(&bar, 0.0);
    let sigma = YOUNG * PULL / SIZE[0];
    for (i, p) in bar.mesh.nodes().iter().enumerate() {
        let strain = PULL / SIZE[0];
        let expected = Vec3::new(p.x, -0.3 * p.y, -0.3 * p.z) * strain;
        assert!((system.displacement(i, &x) - expected).norm() < 1e-9 * PULL);
    }
    assert!(stress_error(&bar, &system, &x, sigma) < 1e-9);
    let area = SIZE[1] * SIZE[2];
    let energy = 0.5 * sigma * sigma / YOUNG * area * SIZE[0];
    assert!((reaction(&bar, &system, &x) / (sigma * area) - 1.0).abs() < 1e-9);
    assert!((system.energy(&x) / energy - 1.0).abs() < 1e-9);
}

/// The upper part is free to slide along y; a ground spring of 1e-10 E h stops it. A sheet that leans does change the stress.
#[test]
fn a_cut_along_the_load_changes_nothing() {
    let sigma = YOUNG * PULL / SIZE[0];
    let error = |rise: f64| {
        let bar = bar(Some([[-1.0, 1.3, -1.0], [9.0, rise, 0.0], [0.0, 0.3, 6.0]]));
        assert_eq!(bar.fragments.count(), 2);
        let (system, x) = solved(&bar, 1e-7);
        stress_error(&bar, &system, &x, sigma)
    };
    let (along, leaning) = (error(0.0), error(0.4));
    assert!(along < 1e-8, "stress off by {along:e}");
    assert!(leaning > 0.01, "stress off by {leaning:e} only");
}

#[test]
fn a_cut_across_the_load_leaves_no_stress() {
    let bar = bar(Some([[3.3, -1.0, -1.0], [0.2, 8.0, 0.0], [0.3, 0.0, 7.0]]));
    assert_eq!(bar.fragments.count(), 2);
    let (system, x) = solved(&bar, 1e-7);
    let error = stress_error(&bar, &system, &x, 0.0);
    assert!(error < 1e-7, "stress off by {error:e}");
    for (i, p) in bar.mesh.nodes().iter().enumerate() {
        let moved = if bar.fragments.of_node[i] == bar.fragments.of_node[bar.mesh.nodes().len() - 1]
        {
            PULL
        } else {
            0.0
        };
        let u = system.displacement(i, &x).x;
        assert!(
            (u - moved).abs() < 1e-7 * PULL,
            "node at {p:?} moves by {u:e}"
        );
    }
}
