//! Validation: the mesher on the parametric mandible.
//!
//! Asked for: node count within 5 %, volume within 5 % at 600 nodes and 1 % at 5,000, no dihedral angle below 8 degrees, no
//! inverted tetrahedron (`TetMesh` refuses those), one piece without handles, nodes near the surface (at 600 nodes within
//! 2.2 mm: thin parts are swollen so that the lattice does not lose them), condyles meshed.
use osteotome_anatomy::{
    JawFrame, Osteotomy, Parameters, ParametricMandible, Side, Technique, mesher,
};
use osteotome_mechanics::geometry::{MeshDistance, TetMesh, Vec3};

fn check(parameters: Parameters, target: usize, volume_tolerance: f64, surface_tolerance: f64) {
    let mandible = ParametricMandible::new(parameters).unwrap();
    let surface = MeshDistance::new(mesher::contour(&mandible, 2.0).unwrap());
    let frame = JawFrame::find(surface.mesh(), "jaw").unwrap();
    let body = mesher::Body::mandible(&surface, &frame);
    let meshed = mesher::mesh_to_nodes(&body, target, &mut |_| {}).unwrap();
    let mesh = &meshed.mesh;
    let nodes = mesh.nodes().len() as f64 / target as f64;
    assert!((nodes - 1.0).abs() < 0.05, "{nodes}");
    assert!((mesh.volume() / body.volume - 1.0).abs() < volume_tolerance);
    let [low, high] = mesher::dihedral_range(mesh);
    assert!(low > 8.0 && high < 165.0, "{low} {high}");
    assert_eq!(mesher::mesh_genus(mesh), 0);
    let farthest = mesh
        .boundary_faces()
        .iter()
        .flatten()
        .map(|n| surface.unsigned(&mesh.nodes()[*n as usize]))
        .fold(0.0, f64::max);
    assert!(farthest < surface_tolerance, "{farthest}");
    // Nothing of the bone is left without mesh; both condyles have nodes to be held by.
    assert!(meshed.farthest < 4.5, "{}", meshed.farthest);
    for condyle in &frame.condyles {
        let near = mesh.nodes().iter().filter(|n| (*n - condyle).norm() < 9.0);
        assert!(near.count() >= 4);
    }
}

#[test]
fn at_the_paper_size() {
    for scale in [0.9, 1.0] {
        let parameters = Parameters {
            scale,
            ..Parameters::default()
        };
        check(parameters, 600, 0.05, 2.2);
    }
}

#[test]
fn at_five_thousand_nodes() {
    check(Parameters::default(), 5_000, 0.01, 0.3);
}

#[test]
fn with_a_thin_ramus() {
    let thin = Parameters {
        ramus_thickness: 6.0,
        ..Parameters::default()
    };
    check(thin, 600, 0.05, 2.2);
}

/// Mean length of edges within 10 mm of a place.
fn edge_near(mesh: &TetMesh, place: &[Vec3]) -> f64 {
    let is_near = |p: &Vec3| place.iter().any(|q| (p - q).norm() < 10.0);
    let near: Vec<bool> = mesh.nodes().iter().map(is_near).collect();
    let edges = mesh.edges().iter();
    let lengths: Vec<f64> = edges
        .filter(|e| e.iter().all(|n| near[*n as usize]))
        .map(|e| mesh.edge_vector(e).norm())
        .collect();
    lengths.iter().sum::<f64>() / lengths.len() as f64
}

/// Graded about the Dal Pont line: the bounds of even meshes hold, and edges there are shorter than in an even mesh of as many
/// nodes.
#[test]
fn graded_about_the_line() {
    let mandible = ParametricMandible::new(Parameters::default()).unwrap();
    let surface = MeshDistance::new(mesher::contour(&mandible, 2.0).unwrap());
    let frame = JawFrame::find(surface.mesh(), "jaw").unwrap();
    let landmarks = mandible.landmarks(&surface).unwrap();
    let cases = [
        (Side::Right, 2.0, 2_500, 0.9),
        (Side::Left, 3.0, 5_000, 0.8),
        (Side::Right, 6.0, 5_000, 0.8),
    ];
    for (side, ratio, target, finer) in cases {
        let line =
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, side, 0.8, &surface).unwrap();
        let place = line.place();
        let even = mesher::Body::mandible(&surface, &frame);
        let body = even.clone().graded(surface.mesh(), &place, ratio, target);
        let meshed = mesher::mesh_to_nodes(&body.unwrap(), target, &mut |_| {}).unwrap();
        let mesh = &meshed.mesh;
        let nodes = mesh.nodes().len() as f64 / target as f64;
        assert!((nodes - 1.0).abs() < 0.05, "{nodes}");
        assert!((mesh.volume() / even.volume - 1.0).abs() < 0.01);
        let [low, high] = mesher::dihedral_range(mesh);
        assert!(low > 8.0 && high < 165.0, "{low} {high}");
        assert_eq!(mesher::mesh_genus(mesh), 0);
        assert!(meshed.farthest < 5.5, "{}", meshed.farthest);
        for condyle in &frame.condyles {
            let near = mesh.nodes().iter().filter(|n| (*n - condyle).norm() < 9.0);
            assert!(near.count() >= 4);
        }
        let plain = mesher::mesh_to_nodes(&even, target, &mut |_| {}).unwrap();
        let [graded, plain] = [mesh, &plain.mesh].map(|m| edge_near(m, &place));
        assert!(graded < finer * plain, "{graded} {plain}");
    }
    let place = [frame.gonions[0]];
    let body = mesher::Body::mandible(&surface, &frame);
    let wrong = body.graded(surface.mesh(), &place, 9.0, 600).err().unwrap();
    assert_eq!(
        wrong.to_string(),
        "mesh.grading = 9 is outside its range; it must lie between 1 and 6"
    );
}
