//! The cracked body's equations: what must cost no energy, and what must be held.
//!
//! Invariants, no golden numbers: exact patch test, rigid motions free, severed parts independent, junctions open.
mod support;
use osteotome_mechanics::bone::{Supports, TetMaterial, stiffness};
use osteotome_mechanics::crack::{Cell, CutEdges, Fragments, System, Topology, bridging_edges};
use osteotome_mechanics::geometry::{TetLocator, TetMesh, TriMesh, Vec3, block_mesh};

struct Body {
    mesh: TetMesh,
    topology: Topology,
    cuts: CutEdges,
}

fn rectangle(corner: [f64; 3], along: [f64; 3], across: [f64; 3]) -> TriMesh {
    let [o, a, b] = [corner, along, across].map(Vec3::from);
    TriMesh {
        vertices: vec![o, o + a, o + a + b, o + b],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn body(sheets: &[TriMesh]) -> Body {
    cut(
        block_mesh(Vec3::zeros(), Vec3::new(6.0, 5.0, 4.0), [6, 5, 4]),
        sheets,
    )
}

/// As [`body`], inner nodes moved at random by up to .1: nothing cancels by symmetry.
fn uneven_body(sheets: &[TriMesh]) -> Body {
    let even = block_mesh(Vec3::zeros(), Vec3::new(6.0, 5.0, 4.0), [6, 5, 4]);
    let mut random = support::noise(5);
    let size = even.bounds().max;
    let moved = |p: &Vec3| {
        Vec3::from_fn(|k, _| {
            let shift = 0.1 * random();
            let inner = p[k] > 1e-9 && p[k] < size[k] - 1e-9;
            p[k] + if inner { shift } else { 0.0 }
        })
    };
    let nodes = even.nodes().iter().map(moved).collect();
    cut(TetMesh::new(nodes, even.tets().to_vec()).unwrap(), sheets)
}

fn cut(mesh: TetMesh, sheets: &[TriMesh]) -> Body {
    let locator = TetLocator::new(&mesh);
    let mut cuts = CutEdges::new(&mesh);
    for s in sheets {
        cuts.cut(&mesh, &locator, s, 1);
    }
    let topology = Topology::new(&mesh, &cuts);
    Body {
        mesh,
        topology,
        cuts,
    }
}

fn system(body: &Body, supports: &Supports) -> System {
    let materials = vec![TetMaterial::isotropic(1000.0, 0.3, 1.0); body.mesh.tets().len()];
    System::new(&body.mesh, &materials, &body.topology, supports).unwrap()
}

fn ground(spring: f64) -> Supports {
    Supports {
        fixed: vec![],
        ground_spring: spring,
        ..Default::default()
    }
}

fn full_cut() -> TriMesh {
    rectangle([3.3, -1.0, -1.0], [0.2, 8.0, 0.0], [0.3, 0.0, 7.0])
}

/// Two sheets that meet in a T: across the block, and one that ends on the first (a little beyond, as fronts do).
fn tee() -> [TriMesh; 2] {
    [
        full_cut(),
        rectangle([3.2, -1.0, 2.2], [8.0, 0.0, 0.1], [0.0, 8.0, 0.2]),
    ]
}

#[test]
fn uncut_patch_test_is_exact() {
    let body = body(&[]);
    let (min, max) = (Vec3::zeros(), Vec3::new(6.0, 5.0, 4.0));
    let on_border = |p: &Vec3| (0..3).any(|k| p[k] <= min[k] || p[k] >= max[k]);
    let field = |p: &Vec3| {
        Vec3::new(
            1e-3 * p.x + 2e-3 * p.y,
            -1e-3 * p.z,
            5e-4 * (p.x + p.y + p.z),
        )
    };
    let system = system(&body, &ground(0.0001));
    let x = system.interpolate(&body.mesh, &body.topology, |_, p| field(p));
    let residual = system.multiply(&x);
    for (i, p) in body
        .mesh
        .nodes()
        .iter()
        .enumerate()
        .filter(|(_, p)| !on_border(p))
    {
        for k in 0..3 {
            // What the ground spring takes is known and subtracted.
            let force = residual[3 * i + k] - 0.0001 * field(p)[k];
            assert!(
                force.abs() < 1e-9,
                "node {i} is out of balance by {force:e} N"
            );
        }
    }
}

#[test]
fn rigid_motion_costs_no_energy() {
    for sheets in [
        vec![],
        vec![full_cut()],
        tee().to_vec(),
        vec![rectangle(
            [3.3, -1.0, -1.0],
            [0.0, 3.6, 0.0],
            [0.0, 0.0, 7.0],
        )],
    ] {
        let body = body(&sheets);
        let system = system(&body, &ground(1e-12));
        let spin = Vec3::new(0.3, -0.2, 0.5);
        let x = system.interpolate(&body.mesh, &body.topology, |_, p| {
            Vec3::new(1.0, 2.0, 3.0) + spin.cross(p)
        });
        assert!(system.energy(&x) < 1e-8, "energy {:e}", system.energy(&x));
    }
}

#[test]
fn severed_fragments_move_apart_freely() {
    for (sheets, expected) in [(vec![full_cut()], 2), (tee().to_vec(), 3)] {
        let body = body(&sheets);
        let fragments = Fragments::find(&body.mesh, &body.cuts);
        assert_eq!(fragments.count(), expected);
        assert!((fragments.volume_share.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let system = system(&body, &ground(1e-12));
        let motion = |f: u32, p: &Vec3| {
            let s = f64::from(f);
            Vec3::new(s, -2.0 * s, 0.5 * s) + Vec3::new(0.1 * s, 0.3, -0.2 * s).cross(p)
        };
        let x = system.interpolate(&body.mesh, &body.topology, |cell, p| {
            let node = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap();
            motion(
                fragments.of_node[body.mesh.tets()[cell.tet as usize][node] as usize],
                p,
            )
        });
        assert!(system.energy(&x) < 1e-8, "energy {:e}", system.energy(&x));
    }
}

/// Two sheets that meet at a corner inside the body and lead on a little beyond each other: a bar along y comes off.
fn corner() -> [TriMesh; 2] {
    [
        rectangle([3.3, -1.0, -1.0], [0.0, 8.0, 0.0], [0.2, 0.0, 3.45]),
        rectangle([7.0, -1.0, 2.3], [-3.8, 0.0, -0.1], [0.0, 8.0, 0.0]),
    ]
}

/// Forces that soft tissue alone carries: `pull(f)` times the ground spring that each cell's virtual nodes hang on.
fn pulled(body: &Body, system: &System, spring: f64, pull: impl Fn(u32) -> Vec3) -> Vec<f64> {
    let fragments = Fragments::find(&body.mesh, &body.cuts);
    let mut around = vec![0.0; body.mesh.nodes().len()];
    for (tet, v) in body.mesh.tets().iter().zip(body.mesh.volumes()) {
        tet.iter().for_each(|&n| around[n as usize] += v);
    }
    let mut load = vec![0.0; system.n()];
    for cell in body.topology.cells() {
        let tet = body.mesh.tets()[cell.tet as usize];
        let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap();
        let weight = spring * cell.fraction * body.mesh.volumes()[cell.tet as usize];
        let shares = tet.map(|n| weight / around[n as usize]);
        let force = pull(fragments.of_node[tet[own] as usize]);
        system.add_force(&body.mesh, cell, &shares, &force, &mut load);
    }
    load
}

/// Largest stress component in any cell.
fn largest_stress(body: &Body, system: &System, x: &[f64]) -> f64 {
    let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
    let of_cell = |cell: &Cell| {
        let u = system.cell_displacements(&body.mesh, cell, x);
        let gradients = &body.mesh.gradients()[cell.tet as usize];
        stiffness::stress(&lame, &stiffness::displacement_gradient(gradients, &u)).amax()
    };
    body.topology
        .cells()
        .iter()
        .map(of_cell)
        .fold(0.0, f64::max)
}

/// Pieces that only soft tissue holds, pulled apart in different directions, move as rigid bodies and carry no stress: across a
/// flat cut, at the T where three pieces meet, and at a corner.
///
/// Relative to what the same displacement would make in a bridging tetrahedron (E u / h = 1000 MPa): 1e-9.
#[test]
fn pieces_pulled_apart_carry_no_stress() {
    const SPRING: f64 = 1e-3;
    for (name, sheets, expected) in [
        ("flat", vec![full_cut()], 2),
        ("tee", tee().to_vec(), 3),
        ("corner", corner().to_vec(), 2),
    ] {
        let body = body(&sheets);
        let fragments = Fragments::find(&body.mesh, &body.cuts);
        assert_eq!(fragments.count(), expected, "{name}");
        let system = system(&body, &ground(SPRING));
        let way = |f: u32| match f {
            0 => Vec3::new(0.2, -0.3, -0.9),
            1 => Vec3::new(-1.0, 0.5, 0.1),
            _ => Vec3::new(0.7, 0.6, 0.3),
        };
        let mut x = pulled(&body, &system, SPRING, way);
        system.solve(&mut x, &mut system.scratch());
        let stress = largest_stress(&body, &system, &x);
        assert!(stress < 1e-6, "{name}: a stress of {stress:e} MPa");
        for (i, f) in fragments.of_node.iter().enumerate() {
            let off = (system.displacement(i, &x) - way(*f)).norm();
            assert!(
                off < 1e-9,
                "{name}: node {i} is {off:e} mm off its piece's motion"
            );
        }
    }
}

/// The T with one piece held and the others drawn away by tractions of the same resultant: what is held carries no stress, as
/// nothing leads to it, and what is drawn is as stressed as if it were alone.
#[test]
fn a_tee_under_load_passes_nothing_on() {
    let body = body(&tee());
    let held: Vec<u32> = (0..body.mesh.nodes().len() as u32)
        .filter(|&i| body.mesh.nodes()[i as usize].x < 1e-9)
        .collect();
    let fragments = Fragments::find(&body.mesh, &body.cuts);
    let still = fragments.of_node[held[0] as usize];
    let supports = Supports {
        fixed: held,
        ..ground(1e-3)
    };
    let system = system(&body, &supports);
    let mut load = vec![0.0; system.n()];
    for face in body.mesh.boundary_faces() {
        let [a, b, c] = face.map(|n| body.mesh.nodes()[n as usize]);
        let area_normal = (b - a).cross(&(c - a)) * 0.5;
        // Only the two pieces beyond the stem of the T have faces that look along +-y beyond x = 4.
        if area_normal.y.abs() < 1e-9 || (a + b + c).x / 3.0 < 4.0 {
            continue;
        }
        let (tet, weights) = TetLocator::new(&body.mesh)
            .find_near(&body.mesh, &((a + b + c) / 3.0), 1e-6)
            .unwrap();
        let cell = body.topology.cell_at(tet, &weights);
        system.add_force(
            &body.mesh,
            &body.topology.cells()[cell as usize],
            &weights,
            &area_normal,
            &mut load,
        );
    }
    let mut x = load.clone();
    system.solve(&mut x, &mut system.scratch());
    let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
    let (mut in_held, mut in_drawn) = (0.0f64, 0.0f64);
    for cell in body.topology.cells() {
        let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap();
        let u = system.cell_displacements(&body.mesh, cell, &x);
        let gradients = &body.mesh.gradients()[cell.tet as usize];
        let stress =
            stiffness::stress(&lame, &stiffness::displacement_gradient(gradients, &u)).amax();
        let node = body.mesh.tets()[cell.tet as usize][own];
        if fragments.of_node[node as usize] == still {
            in_held = in_held.max(stress);
        } else {
            in_drawn = in_drawn.max(stress);
        }
    }
    assert!(in_held < 1e-9, "the held piece carries {in_held:e} MPa");
    assert!(in_drawn > 0.5, "the drawn pieces carry only {in_drawn} MPa");
}

/// Constant stress along a fully cut body whose cut contains the axis of pull: the cut is not noticed.
///
/// Flat cut: the cells' volumes are exact, 1e-9 everywhere. T and corner: 1e-9 everywhere in an even mesh, where the errors of
/// neighbours cancel; in an uneven one from .9 h off the line where the sheets meet. Nearer, a tetrahedron knows the sheets by the
/// crossing points on its edges alone, and the line between them is rounded off: measured up to .034 N out of balance, 2 % of
/// s h^2 (limit .05). Exact volumes would need the sheets' planes in each such tetrahedron, and would change cells that a later
/// sheet divides again, which must not be.
#[test]
fn a_cut_along_the_pull_passes_the_patch_test() {
    let field = |p: &Vec3| Vec3::new(-0.3 * p.x, p.y, -0.3 * p.z) * 1e-3;
    let on_end = |p: &Vec3| p.y <= 1e-9 || p.y >= 5.0 - 1e-9;
    let flat = rectangle([3.3, -1.0, -1.0], [0.0, 8.0, 0.0], [0.3, 0.0, 7.0]);
    for (name, sheets, meeting) in [
        ("flat", vec![flat.clone()], None),
        (
            "tee",
            vec![
                flat,
                rectangle([3.2, -1.0, 2.2], [8.0, 0.0, 0.1], [0.0, 8.0, 0.0]),
            ],
            Some([3.45, 2.2]),
        ),
        ("corner", corner().to_vec(), Some([3.4, 2.25])),
    ] {
        for (body, radius) in [(body(&sheets), 0.0), (uneven_body(&sheets), 1.15)] {
            let system = system(&body, &ground(1e-11));
            let x = system.interpolate(&body.mesh, &body.topology, |_, p| field(p));
            let residual = system.multiply(&x);
            let near = |p: &Vec3| {
                meeting.is_some_and(|[x, z]: [f64; 2]| (p.x - x).hypot(p.z - z) < radius)
            };
            // Unknowns are the nodes, then the enrichments, as nothing is held.
            let nodes = (0..body.mesh.nodes().len() as u32)
                .chain(body.topology.enriched_nodes().iter().copied());
            let mut checked = 0;
            for (i, node) in nodes.enumerate() {
                let p = &body.mesh.nodes()[node as usize];
                if on_end(p) {
                    continue;
                }
                let limit = if near(p) { 0.05 } else { 1e-9 };
                checked += 1;
                for k in 0..3 {
                    let force = residual[3 * i + k];
                    assert!(
                        force.abs() < limit,
                        "{name}: unknown {i} at {p} is out of balance by {force:e} N"
                    );
                }
            }
            assert!(checked > 60, "{name}: only {checked} nodes checked");
        }
    }
}

/// A bridge left on purpose: the sheet stops short, the fragments hang together, and the same motion costs energy.
#[test]
fn a_sheet_that_stops_short_still_holds() {
    let body = body(&[rectangle(
        [3.3, -1.0, -1.0],
        [0.0, 4.6, 0.0],
        [0.0, 0.0, 7.0],
    )]);
    assert_eq!(Fragments::find(&body.mesh, &body.cuts).count(), 1);
    let end = |x: f64| -> Vec<u32> {
        (0..body.mesh.nodes().len() as u32)
            .filter(|&i| (body.mesh.nodes()[i as usize].x - x).abs() < 1e-9)
            .collect()
    };
    let bridge = bridging_edges(&body.mesh, &body.cuts, &end(0.0), &end(6.0), 1000).unwrap();
    assert!(!bridge.is_empty());
    assert_eq!(
        bridging_edges(&body.mesh, &body.cuts, &end(0.0), &end(6.0), 2),
        None
    );
    let mut cuts = body.cuts.clone();
    cuts.cut_at_middle(&body.mesh, &bridge, 1);
    assert_eq!(Fragments::find(&body.mesh, &cuts).count(), 2);
}

#[test]
fn stiffness_is_positive_definite_and_the_crack_only_softens() {
    let held = |mesh: &TetMesh| Supports {
        fixed: (0..mesh.nodes().len() as u32)
            .filter(|&i| mesh.nodes()[i as usize].x < 1e-9)
            .collect(),
        ground_spring: 1e-9,
        ..Default::default()
    };
    let mut softest = 0.0;
    for length in [0.0, 1.4, 2.6, 3.4, 4.6] {
        let body = body(&[rectangle(
            [3.3, -1.0, -1.0],
            [0.0, 1.0 + length, 0.0],
            [0.0, 0.0, 7.0],
        )]);
        let system = system(&body, &held(&body.mesh));
        let mut load = vec![0.0; system.n()];
        for (c, cell) in body.topology.cells().iter().enumerate() {
            let centre = body.mesh.corners(cell.tet as usize).iter().sum::<Vec3>() / 4.0;
            if centre.x > 5.0 {
                system.add_force(
                    &body.mesh,
                    &body.topology.cells()[c],
                    &[0.25; 4],
                    &Vec3::y(),
                    &mut load,
                );
            }
        }
        let mut x = load.clone();
        system.solve(&mut x, &mut system.scratch());
        let residual = system
            .multiply(&x)
            .iter()
            .zip(&load)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(residual < 1e-7, "residual {residual:e}");
        let compliance: f64 = x.iter().zip(&load).map(|(a, b)| a * b).sum();
        assert!(
            compliance >= softest * (1.0 - 1e-12),
            "compliance fell from {softest} to {compliance}"
        );
        softest = compliance;
    }
}
