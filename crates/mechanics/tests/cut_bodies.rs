//! The cracked body's equations: what must cost no energy, and what must be held.
//!
//! Invariants, no golden numbers: exact patch test, rigid motions free, severed parts independent, junctions open.
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::{CutEdges, Fragments, System, Topology, bridging_edges};
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
    let mesh = block_mesh(Vec3::zeros(), Vec3::new(6.0, 5.0, 4.0), [6, 5, 4]);
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
