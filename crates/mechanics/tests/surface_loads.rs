//! Loads on boundary faces: totals are exact, and where a crack divides faces each side takes its own part.
//!
//! A block is cut through by the plane x = .37, so that the cut divides faces of its top. Tolerances are round-off.
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::crack::{CrackSurface, CrackedBody, LoadKind, Sheet, Solid, SurfaceLoad};
use osteotome_mechanics::geometry::{TetLocator, TriMesh, Vec3, block_mesh};
use std::sync::Arc;

const CUT: f64 = 1.37;

fn cut_block() -> CrackedBody {
    let mesh = block_mesh(Vec3::zeros(), Vec3::new(3.0, 2.0, 2.0), [3, 2, 2]);
    let sheet = TriMesh {
        vertices: vec![
            Vec3::new(CUT, -1.0, -1.0),
            Vec3::new(CUT, 3.0, -1.0),
            Vec3::new(CUT, 3.0, 3.0),
            Vec3::new(CUT, -1.0, 3.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(100.0, 0.2, 1.0); mesh.tets().len()],
        supports: Supports {
            ground_spring: 1e-3,
            ..Default::default()
        },
        lengths: GrowthLengths::for_element_size(1.2),
        mesh,
    };
    let crack = CrackSurface {
        sheets: vec![Sheet {
            kerf: vec![0.0; 4],
            mesh: sheet,
            ..Default::default()
        }],
    };
    CrackedBody::new(Arc::new(solid), crack).expect("held by ground springs")
}

/// The faces of the top, z = 2.
fn top(body: &CrackedBody) -> Vec<u32> {
    let mesh = &body.solid.mesh;
    let is_top = |f: &[u32; 3]| f.iter().all(|n| mesh.nodes()[*n as usize].z == 2.0);
    let faces = (0u32..).zip(mesh.boundary_faces());
    faces.filter(|(_, f)| is_top(f)).map(|f| f.0).collect()
}

fn place(body: &CrackedBody, f: &CellForce) -> Vec3 {
    let tet = body.topology.cells()[f.cell as usize].tet;
    let x = body.solid.mesh.corners(tet as usize);
    (0..4).map(|k| x[k] * f.weights[k]).sum()
}

fn forces(body: &CrackedBody, kind: LoadKind) -> Vec<CellForce> {
    let faces = top(body);
    body.surface_forces(&SurfaceLoad { faces, kind })
}

#[test]
fn a_traction_is_shared_by_the_sides_of_the_cut() {
    let body = cut_block();
    assert_eq!(body.fragments.count(), 2);
    let traction = Vec3::new(0.0, 0.5, 2.0);
    let all = forces(&body, LoadKind::Traction(traction));
    let mut left = Vec3::zeros();
    for f in &all {
        let cell = &body.topology.cells()[f.cell as usize];
        let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap();
        let node = body.solid.mesh.tets()[cell.tet as usize][own];
        if body.solid.mesh.nodes()[node as usize].x < CUT {
            left += f.force;
            assert!(place(&body, f).x < CUT + 1e-9);
        } else {
            assert!(place(&body, f).x > CUT - 1e-9);
        }
    }
    let total: Vec3 = all.iter().map(|f| f.force).sum();
    assert!((total - traction * 6.0).norm() < 1e-12);
    assert!((left - traction * (2.0 * CUT)).norm() < 1e-9, "{left:?}");
}

#[test]
fn a_force_and_a_torque_have_their_totals() {
    let body = cut_block();
    let given = Vec3::new(3.0, -1.0, 7.0);
    let total: Vec3 = forces(&body, LoadKind::Force(given))
        .iter()
        .map(|f| f.force)
        .sum();
    assert!((total - given).norm() < 1e-12);
    let axis = Vec3::new(0.3, -0.2, 1.0).normalize();
    let origin = Vec3::new(1.0, 1.5, 0.0);
    let torque = LoadKind::Torque {
        axis,
        origin,
        moment: -42.0,
    };
    let moment: f64 = forces(&body, torque)
        .iter()
        .map(|f| axis.dot(&(place(&body, f) - origin).cross(&f.force)))
        .sum();
    assert!((moment + 42.0).abs() < 1e-11, "{moment}");
}

/// Clipped by the elements, and by the polygons that it has cut.
#[test]
fn areas_of_the_crack_are_those_of_its_part_inside() {
    let body = cut_block();
    assert!(
        (body.explicit_area() - 4.0).abs() < 1e-6,
        "{}",
        body.explicit_area()
    );
    // Cut through, every node beside the crack is free to move apart.
    assert!(
        (body.effective_area() - 4.0).abs() < 1e-9,
        "{}",
        body.effective_area()
    );
}
