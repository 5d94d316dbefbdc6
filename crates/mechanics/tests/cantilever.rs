//! Tip deflection of a cantilever against beam theory (Timoshenko): w = P L^3 / (3 E I) + P L / (k G A), k = 5/6.
//!
//! Linear tetrahedra are too stiff in bending, from below; second order shows once bending is resolved: measured errors are
//! .655, .328 and .110 with two, four and eight elements (twice as long as high) through the height.
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::{CutEdges, System, Topology};
use osteotome_mechanics::geometry::{Vec3, block_mesh};

const YOUNG: f64 = 1000.0;
const LENGTH: f64 = 8.0;

/// Deflection over beam theory with `n` elements through the height.
fn ratio(n: usize) -> f64 {
    let mesh = block_mesh(Vec3::zeros(), Vec3::new(LENGTH, 1.0, 1.0), [4 * n, n, n]);
    let at = |x: f64| -> Vec<u32> {
        (0..mesh.nodes().len() as u32)
            .filter(|&i| (mesh.nodes()[i as usize].x - x).abs() < 1e-9)
            .collect()
    };
    let topology = Topology::new(&mesh, &CutEdges::new(&mesh));
    let materials = vec![TetMaterial::isotropic(YOUNG, 0.0, 1.0); mesh.tets().len()];
    let supports = Supports {
        fixed: at(0.0),
        ..Default::default()
    };
    let system = System::new(&mesh, &materials, &topology, &supports).unwrap();
    let mut x = vec![0.0; system.n()];
    let tip = at(LENGTH);
    for &i in &tip {
        let t = mesh.tets_of_node(i as usize)[0];
        let weights = mesh.tets()[t as usize].map(|n| f64::from(u8::from(n == i)));
        let cell = &topology.cells()[topology.cells_of(t).start];
        system.add_force(
            &mesh,
            cell,
            &weights,
            &(Vec3::z() / tip.len() as f64),
            &mut x,
        );
    }
    system.solve(&mut x, &mut system.scratch());
    let w: f64 = tip
        .iter()
        .map(|&i| system.displacement(i as usize, &x).z)
        .sum();
    let bending = LENGTH.powi(3) / (3.0 * YOUNG / 12.0);
    let shear = LENGTH / (5.0 / 6.0 * 0.5 * YOUNG);
    w / tip.len() as f64 / (bending + shear)
}

#[test]
fn deflection_converges_to_beam_theory_from_below() {
    let errors = [2, 4, 8].map(|n| 1.0 - ratio(n));
    assert!(errors.iter().all(|e| *e > 0.0), "{errors:?}");
    assert!(
        errors[1] < 0.55 * errors[0] && errors[2] < 0.4 * errors[1],
        "{errors:?}"
    );
    assert!(errors[2] < 0.12, "{errors:?}");
}
