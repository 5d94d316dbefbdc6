//! Patients from good and bad input: what is refused, in which words; that a patient fits together and repeats bit by bit.
use osteotome_anatomy::density::{DensitySpec, Relation};
use osteotome_anatomy::{
    MeshSource, OsteotomySource, Parameters, Patient, PatientSpec, Side, SurfaceSource, mesher,
    osteotomy, stl,
};
use osteotome_mechanics::bone::{EngineeringConstants, TetMaterial};
use osteotome_mechanics::geometry::{MeshDistance, TetLocator, TriMesh};
use std::path::PathBuf;

fn small() -> PatientSpec {
    PatientSpec {
        mesh: MeshSource::Nodes(600),
        shell_points: 20_000,
        ..PatientSpec::default()
    }
}

fn build(spec: &PatientSpec) -> Patient {
    Patient::build(spec, &mut |_, _| {}).unwrap()
}

fn refusal(spec: &PatientSpec) -> String {
    let text = Patient::build(spec, &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(!text.contains('\n'), "{text}");
    text
}

/// A file of this test's own; removed when dropped.
struct TestFile(PathBuf);

impl TestFile {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path = std::env::temp_dir().join(format!("osteotome-{}-{name}", std::process::id()));
        std::fs::write(&path, bytes).unwrap();
        Self(path)
    }
}

impl Drop for TestFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn parametric_patient_fits_together() {
    let mut stages = Vec::new();
    let patient = Patient::build(&small(), &mut |stage, done| {
        stages.push((stage.to_owned(), done));
    })
    .unwrap();
    assert!(stages.windows(2).all(|w| w[0].1 <= w[1].1), "{stages:?}");
    assert_eq!(stages.last().unwrap().1, 1.0);
    assert_eq!(patient.materials.len(), patient.mesh.tets().len());
    assert!(patient.materials.iter().all(|m| m.check().is_ok()));
    assert!(
        patient
            .materials
            .iter()
            .all(|m| (m.osteon.norm() - 1.0).abs() < 1e-12)
    );
    assert!((patient.shell.len() as f64 / 20_000.0 - 1.0).abs() < 0.01);
    assert_eq!(patient.osteotomy.side, Side::Right);
    assert!(!patient.constructed.is_empty());
    // The supports need nodes near the condyles, the line and the shell a tetrahedron near by.
    for c in &patient.condyles {
        let near = patient
            .mesh
            .nodes()
            .iter()
            .filter(|n| (*n - c).norm() < 9.0);
        assert!(near.count() >= 3);
    }
    let locator = TetLocator::new(&patient.mesh);
    let lost = patient
        .shell
        .iter()
        .filter(|p| locator.find_near(&patient.mesh, &p.anchor, 1.5).is_none())
        .count();
    // The tips of the coronoids, which a mesh of 600 nodes may blunt by up to 4.5 mm (tests/mandible_mesh.rs): measured 59.
    assert!(
        lost < 70,
        "{lost} of 20000 shell points have no tetrahedron near"
    );
}

#[test]
fn crowns_are_felt_and_stiffen_what_they_reach() {
    let patient = build(&small());
    let names: Vec<u32> = patient.teeth.iter().map(|t| t.fdi).collect();
    let want: Vec<u32> = (41..=47).chain(31..=37).collect();
    assert_eq!(names, want);
    let bone = MeshDistance::new(patient.surface.clone());
    let crowns: Vec<MeshDistance> = patient
        .teeth
        .iter()
        .map(|t| MeshDistance::new(t.surface.clone()))
        .collect();
    let mut felt = vec![0.0; crowns.len()];
    for p in &patient.shell {
        // Neither under a crown nor, on a crown, in the bone; chords cut a tenth of a millimetre off.
        let depth = crowns.iter().map(|c| c.signed(&p.position));
        assert!(depth.fold(f64::INFINITY, f64::min) > -0.15);
        if p.anchor != p.position {
            assert!(bone.signed(&p.position) > 0.0);
            assert!(bone.signed(&p.anchor) < -1.0);
            let of = (0..crowns.len()).find(|i| crowns[*i].unsigned(&p.position) < 1e-9);
            felt[of.unwrap()] += p.area;
        }
    }
    // Most of each crown is free.
    for (area, tooth) in felt.iter().zip(&patient.teeth) {
        let share = area / tooth.surface.area();
        assert!((0.4..0.9).contains(&share), "{share} of {}", tooth.fdi);
    }
    let cortical = small().material.cortical.young_modulus;
    let stiffer = patient
        .materials
        .iter()
        .filter(|m| m.young_modulus > cortical);
    assert!(stiffer.count() > 0);
}

/// Nine constants of the isotropic layer change nothing but the form; a layer stiffer along the jaw is stiffer along the osteons.
#[test]
fn an_orthotropic_layer_follows_the_osteons() {
    let plain = build(&small());
    let tissue = small().material.cortical;
    let with = |nine: EngineeringConstants| {
        let mut spec = small();
        spec.material.cortical_orthotropic = Some(nine);
        build(&spec)
    };
    let mut nine = EngineeringConstants::isotropic(tissue.young_modulus, tissue.poisson_ratio);
    let alike = with(nine);
    nine.e1 *= 1.5;
    let stiffer = with(nine);
    let mut n_stiffer = 0;
    for ((p, a), s) in plain
        .materials
        .iter()
        .zip(&alike.materials)
        .zip(&stiffer.materials)
    {
        let stretch = p.osteon * p.osteon.transpose();
        let along = |m: &TetMaterial| p.osteon.dot(&(m.elasticity().stress(&stretch) * p.osteon));
        assert!((along(a) / along(p) - 1.0).abs() < 1e-9);
        assert!((a.young_modulus / p.young_modulus - 1.0).abs() < 1e-9);
        n_stiffer += usize::from(along(s) > 1.2 * along(p));
    }
    assert!(
        n_stiffer > plain.materials.len() / 4,
        "{n_stiffer} tetrahedra"
    );
    assert_ne!(alike.digest(), stiffer.digest());
}

#[test]
fn same_input_gives_the_same_bits() {
    let (a, b) = (build(&small()), build(&small()));
    assert_eq!(a.digest(), b.digest());
    let mut other = small();
    other.material.cortical.toughness[1] = 2.5;
    assert_ne!(build(&other).digest(), a.digest());
}

#[test]
fn a_jaw_from_files_equals_the_jaw_it_was_written_from() {
    let made = build(&small());
    let surface = TestFile::new("jaw.stl", &stl::to_binary_stl(&made.surface));
    let line = serde_json::to_vec(&made.osteotomy.to_file()).unwrap();
    let line = TestFile::new("line.json", &line);
    let mut msh = format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n",
        made.mesh.nodes().len()
    );
    for (i, p) in made.mesh.nodes().iter().enumerate() {
        msh += &format!("{} {} {} {}\n", i + 1, p.x, p.y, p.z);
    }
    msh += &format!("$EndNodes\n$Elements\n{}\n", made.mesh.tets().len());
    for (i, t) in made.mesh.tets().iter().enumerate() {
        let [a, b, c, d] = t.map(|n| n + 1);
        msh += &format!("{} 4 2 1 1 {a} {b} {c} {d}\n", i + 1);
    }
    msh += "$EndElements\n";
    let mesh = TestFile::new("jaw.msh", msh.as_bytes());
    let read = build(&PatientSpec {
        surface: SurfaceSource::File(surface.0.clone()),
        mesh: MeshSource::File(mesh.0.clone()),
        osteotomy: OsteotomySource::File(line.0.clone()),
        ..small()
    });
    assert_eq!(read.mesh.tets().len(), made.mesh.tets().len());
    assert!((read.surface.volume() / made.surface.volume() - 1.0).abs() < 1e-5);
    for (a, b) in read.condyles.iter().zip(&made.condyles) {
        assert!((a - b).norm() < 1e-3);
    }
    assert_eq!(read.osteotomy.parts.len(), 3);
    let wrong_side = PatientSpec {
        surface: SurfaceSource::File(surface.0.clone()),
        osteotomy: OsteotomySource::File(line.0.clone()),
        side: Some(Side::Left),
        ..small()
    };
    assert!(refusal(&wrong_side).contains("is for the Right side"));
    let no_landmarks = PatientSpec {
        surface: SurfaceSource::File(surface.0.clone()),
        ..small()
    };
    assert!(refusal(&no_landmarks).contains("needs landmarks"));
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let missing = PatientSpec {
        surface: SurfaceSource::File("no/such/jaw.stl".into()),
        ..small()
    };
    assert!(refusal(&missing).starts_with("cannot read no/such/jaw.stl: "));

    let jaw = |change: &dyn Fn(&mut TriMesh)| {
        let mandible = osteotome_anatomy::ParametricMandible::new(Parameters::default()).unwrap();
        let mut mesh = mesher::contour(&mandible, 4.0).unwrap();
        change(&mut mesh);
        stl::to_binary_stl(&mesh)
    };
    let from = |file: &TestFile| PatientSpec {
        surface: SurfaceSource::File(file.0.clone()),
        ..small()
    };
    let open = TestFile::new("open.stl", &jaw(&|m| drop(m.triangles.drain(..2))));
    assert!(refusal(&from(&open)).contains("is an open surface: "));
    let nan = TestFile::new("nan.stl", &jaw(&|m| m.vertices[7].y = f64::NAN));
    assert!(refusal(&from(&nan)).contains("not a finite number"));
    let whole = jaw(&|_| {});
    let cut = TestFile::new("cut.stl", &whole[..whole.len() / 2]);
    assert!(refusal(&from(&cut)).contains("truncated"));
    let upside_down = TestFile::new(
        "down.stl",
        &jaw(&|m| {
            m.vertices.iter_mut().for_each(|v| *v = -*v);
            m.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }),
    );
    assert!(refusal(&from(&upside_down)).contains("does not look like a mandible"));

    let mut material = small();
    material.material.cortical.young_modulus = -15_000.0;
    assert!(refusal(&material).starts_with("material.cortical.young_modulus = -15000 is outside"));
    let mut material = small();
    let mut nine = EngineeringConstants::isotropic(15_000.0, 0.3);
    nine.g23 = 0.0;
    material.material.cortical_orthotropic = Some(nine);
    assert!(refusal(&material).starts_with("material.cortical_orthotropic: g23 is 0; it must be"));
    let mut material = small();
    material.material.cortical.poisson_ratio = 0.5;
    assert!(refusal(&material).starts_with("material.cortical.poisson_ratio = 0.5 is outside"));
    for nodes in [3, 1_000_000] {
        let spec = PatientSpec {
            mesh: MeshSource::Nodes(nodes),
            ..small()
        };
        assert!(refusal(&spec).starts_with(&format!("mesh.nodes = {nodes} is outside")));
    }
    let astray = PatientSpec {
        side: Some(Side::Right),
        osteotomy: OsteotomySource::Points(vec![
            osteotomy::PointSpec {
                at: [0.0, 0.0, 0.0],
                toward: [0.0, 1.0, 0.0],
                depth: 4.0,
                part: "ridge".to_owned(),
            };
            2
        ]),
        ..small()
    };
    let text = refusal(&astray);
    assert!(
        text.starts_with("osteotomy point 0 (ridge) is ") && text.contains("mm outside the bone")
    );
}

#[test]
fn cortex_is_stiff_and_the_core_is_soft() {
    let mut spec = small();
    spec.mesh = MeshSource::Nodes(5_000);
    let patient = build(&spec);
    let surface = MeshDistance::new(patient.surface.clone());
    let tissue = &spec.material;
    // The share of cortical bone by volume, against a fine grid of points.
    let bounds = patient.surface.bounds();
    let (mut inside, mut cortical) = (0.0, 0.0);
    for i in 0..70 {
        for j in 0..45 {
            for k in 0..45 {
                let f = osteotome_mechanics::geometry::Vec3::new(
                    f64::from(i) / 70.0,
                    f64::from(j) / 45.0,
                    f64::from(k) / 45.0,
                );
                let d = surface.signed(&(bounds.min + f.component_mul(&bounds.extent())));
                inside += f64::from(u8::from(d < 0.0));
                cortical += f64::from(u8::from(d < 0.0 && d > -tissue.cortical_thickness));
            }
        }
    }
    let e = |m: &osteotome_anatomy::Tissue| m.young_modulus;
    let weighted: f64 = patient
        .materials
        .iter()
        .zip(patient.mesh.volumes())
        .map(|(m, v)| m.young_modulus * v)
        .sum();
    let mean = weighted / patient.mesh.volume();
    let share = (mean - e(&tissue.trabecular)) / (e(&tissue.cortical) - e(&tissue.trabecular));
    let want = cortical / inside;
    assert!((share - want).abs() < 0.02, "{share} instead of {want}");
}

/// A scan of one grey value gives all bone the relation's modulus at that density; tetrahedra with a tooth in them stay stiffer.
#[test]
fn stiffness_follows_a_scan_where_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.nrrd");
    let header = "NRRD0004\ntype: short\ndimension: 3\nsizes: 60 60 60\nspace: left-posterior-superior\n\
        space directions: (4,0,0) (0,4,0) (0,0,4)\nspace origin: (-118,-118,-118)\nendian: little\nencoding: raw\n\n";
    let mut bytes = header.as_bytes().to_vec();
    bytes.extend(std::iter::repeat_n(300i16.to_le_bytes(), 60 * 60 * 60).flatten());
    std::fs::write(&path, &bytes).unwrap();
    let density = DensitySpec {
        scan: path.clone(),
        relation: Relation::MorganFemoralNeck,
        calibration: [1e-3, 0.0],
    };
    let spec = PatientSpec {
        mesh: MeshSource::Nodes(300),
        shell_points: 2000,
        density: Some(density.clone()),
        ..PatientSpec::default()
    };
    let patient = Patient::build(&spec, &mut |_, _| {}).unwrap();
    let wanted = 6850.0 * 0.3f64.powf(1.49);
    let is_wanted = |e: f64| (e / wanted - 1.0).abs() < 1e-9;
    let n = patient
        .materials
        .iter()
        .filter(|m| is_wanted(m.young_modulus))
        .count();
    assert!(
        10 * n > 9 * patient.materials.len(),
        "{n} of {}",
        patient.materials.len()
    );
    assert!(
        patient
            .materials
            .iter()
            .all(|m| m.young_modulus > 0.999 * wanted)
    );
    assert!(
        patient
            .constructed
            .iter()
            .any(|c| c.contains("morgan-femoral-neck"))
    );

    let refusal = |change: &dyn Fn(&mut DensitySpec)| {
        let mut density = density.clone();
        change(&mut density);
        let spec = PatientSpec {
            density: Some(density),
            ..spec.clone()
        };
        Patient::build(&spec, &mut |_, _| {})
            .unwrap_err()
            .to_string()
    };
    let text = refusal(&|d| d.calibration[0] = 0.0);
    assert!(
        text.starts_with("material.density.calibration.0 = 0 is outside"),
        "{text}"
    );
    let text = refusal(&|d| d.scan = "scan.png".into());
    assert!(text.contains("NIfTI") && text.contains("NRRD"), "{text}");
    let elsewhere = header.replace("(-118,", "(20,");
    let mut moved = elsewhere.into_bytes();
    moved.extend_from_slice(&bytes[header.len()..]);
    std::fs::write(&path, &moved).unwrap();
    let text = refusal(&|_| {});
    assert!(
        text.contains("does not reach") && text.contains("in one frame"),
        "{text}"
    );
}
