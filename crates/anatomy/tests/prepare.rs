//! From files to a patient's folder and back: nothing is lost, nothing is taken that was changed, what is torn is mended within
//! bounds, and the same files give the same bytes.
use osteotome_anatomy::folder::{self, PatientFolder};
use osteotome_anatomy::prepare::{Preparation, PrepareSpec, prepare};
use osteotome_anatomy::{
    MeshSource, OsteotomySource, Parameters, ParametricMandible, Patient, PatientSpec, Side,
    SurfaceSource, mesher, ply, stl,
};
use osteotome_mechanics::geometry::{MeshDistance, TriMesh, Vec3};
use std::path::{Path, PathBuf};

fn mandible() -> ParametricMandible {
    ParametricMandible::new(Parameters::default()).unwrap()
}

fn jaw() -> TriMesh {
    mesher::contour(&mandible(), 2.5).unwrap()
}

fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn spec(input: &Path, nodes: usize) -> PrepareSpec {
    PrepareSpec {
        nodes: Some(nodes),
        ..PrepareSpec::of(input)
    }
}

fn made(spec: &PrepareSpec) -> Preparation {
    prepare(spec, &mut |_, _| {}).unwrap()
}

fn refusal(spec: &PrepareSpec) -> String {
    let text = prepare(spec, &mut |_, _| {}).unwrap_err().to_string();
    assert!(!text.contains('\n'), "{text}");
    text
}

/// Teeth, canals, landmarks and a maxilla of sorts beside the bone.
fn whole(folder: &Path) -> PrepareSpec {
    let mandible = mandible();
    let surface = MeshDistance::new(jaw());
    let mut teeth = TriMesh::default();
    for crown in mandible.teeth() {
        teeth.append(&crown.surface().unwrap());
    }
    let canals = mandible.canals().into_iter().enumerate();
    let canal = |(i, c): (usize, osteotome_anatomy::Canal)| {
        let json = serde_json::to_vec(&c.to_file()).unwrap();
        put(folder, &format!("canal{i}.json"), &json)
    };
    let marks = mandible.landmarks(&surface).unwrap().to_file();
    let mut above = teeth.clone();
    above.vertices.iter_mut().for_each(|p| p.z += 30.0);
    above.triangles.pop();
    PrepareSpec {
        teeth: Some(put(folder, "teeth.ply", &ply::to_binary_ply(&teeth))),
        canals: canals.map(canal).collect(),
        landmarks: Some(put(
            folder,
            "marks.json",
            &serde_json::to_vec(&marks).unwrap(),
        )),
        context: vec![(
            "maxilla".to_owned(),
            put(folder, "maxilla.stl", &stl::to_binary_stl(&above)),
        )],
        ..spec(
            &put(folder, "jaw.stl", &stl::to_binary_stl(surface.mesh())),
            600,
        )
    }
}

fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let short = path.strip_prefix(folder).unwrap().to_owned();
                all.push((short, std::fs::read(&path).unwrap()));
            }
        }
    }
    all.sort();
    all
}

#[test]
fn a_folder_read_again_is_the_same_and_a_changed_one_is_refused() {
    let base = tempfile::tempdir().unwrap();
    let spec = whole(base.path());
    let first = made(&spec);
    let [a, b] = ["a", "b"].map(|n| base.path().join(n));
    first.patient.write(&a, vec![]).unwrap();
    made(&spec).patient.write(&b, vec![]).unwrap();
    assert_eq!(files(&a), files(&b), "the same input gives the same bytes");

    let read = PatientFolder::read(&a).unwrap();
    assert_eq!(read.surface, first.patient.surface);
    assert_eq!(read.mesh.nodes(), first.patient.mesh.nodes());
    assert_eq!(read.mesh.tets(), first.patient.mesh.tets());
    assert_eq!(read.canals, first.patient.canals);
    assert_eq!(read.landmarks, first.patient.landmarks);
    assert_eq!(read.context, first.patient.context);
    assert_eq!(read.inputs, first.patient.inputs);
    assert_eq!(read.figures, first.patient.figures);
    let surfaces = |p: &PatientFolder| {
        p.teeth
            .iter()
            .map(|t| t.surface.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(surfaces(&read), surfaces(&first.patient));
    assert_eq!(read.teeth.len(), 14);
    let again = base.path().join("c");
    read.write(&again, vec![]).unwrap();
    assert_eq!(files(&a), files(&again));
    let checked = folder::check(&a);
    assert_eq!(checked.faults, Vec::<String>::new());
    let remarks = checked.remarks.join("; ");
    assert!(
        remarks.contains("maxilla it is shown, but tools do not touch it"),
        "{remarks}"
    );
    assert!(remarks.contains("constructed, not seen"), "{remarks}");

    simulates(&a, &read);
    changed(&b);
}

/// The folder as a patient: its own mesh where as many nodes are asked for, another where not; technique by its landmarks.
fn simulates(folder: &Path, read: &PatientFolder) {
    let with = |nodes: usize| PatientSpec {
        surface: SurfaceSource::Folder(folder.to_owned()),
        mesh: MeshSource::Nodes(nodes),
        osteotomy: OsteotomySource::Technique(osteotome_anatomy::Technique::Hunsuck),
        side: Some(Side::Left),
        shell_points: 5_000,
        ..PatientSpec::default()
    };
    let own = Patient::build(&with(600), &mut |_, _| {}).unwrap();
    assert_eq!(own.mesh.nodes(), read.mesh.nodes());
    assert_eq!(
        (own.teeth.len(), own.canals.len(), own.context.len()),
        (14, 2, 1)
    );
    assert_eq!(own.osteotomy.parts.len(), 3);
    assert!(
        own.shell.iter().any(|p| p.anchor != p.position),
        "crowns are felt"
    );
    let other = Patient::build(&with(400), &mut |_, _| {}).unwrap();
    assert!(other.mesh.nodes().len() < 450);
}

fn changed(folder: &Path) {
    let faults = |path: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let file = folder.join(path);
        let good = std::fs::read(&file).unwrap();
        let mut bad = good.clone();
        change(&mut bad);
        std::fs::write(&file, bad).unwrap();
        let first = PatientFolder::read(folder).unwrap_err().to_string();
        let checked = folder::check(folder);
        assert_eq!(checked.faults[0], first);
        std::fs::write(&file, good).unwrap();
        checked.faults.join("; ")
    };
    let flip = |at: usize| move |b: &mut Vec<u8>| b[at] ^= 1;
    let text = faults("surface.ply", &flip(900));
    assert!(
        text.contains("surface.ply: it is not the file that was written"),
        "{text}"
    );
    let text = faults("canal_2.json", &flip(30));
    assert!(text.contains("canal_2.json: it is not"), "{text}");
    let manifest = |from: &'static str, to: &'static str| {
        move |b: &mut Vec<u8>| *b = String::from_utf8_lossy(b).replace(from, to).into_bytes()
    };
    let text = faults(
        "patient.toml",
        &manifest("osteotome.patient/1", "osteotome.patient/9"),
    );
    assert!(text.contains("schema is \"osteotome.patient/9\""), "{text}");
    let text = faults(
        "patient.toml",
        &manifest("frame = \"LPS\"", "frame = \"RAS\""),
    );
    assert!(text.contains("frame is \"RAS\""), "{text}");
    let text = faults(
        "patient.toml",
        &manifest("path = \"mesh.vtu\"", "path = \"../mesh.vtu\""),
    );
    assert!(
        text.contains("\"../mesh.vtu\" leads out of the folder"),
        "{text}"
    );
    let text = faults(
        "patient.toml",
        &manifest("units = \"mm\"", "unitz = \"mm\""),
    );
    assert!(text.contains("line 2: unknown field `unitz`"), "{text}");
    // All at once, in order.
    std::fs::write(folder.join("landmarks.json"), "{}").unwrap();
    std::fs::remove_file(folder.join("teeth/03.ply")).unwrap();
    let faults = folder::check(folder).faults;
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(
        faults[0].contains("03.ply") && faults[1].contains("landmarks.json"),
        "{faults:?}"
    );
    std::fs::remove_file(folder.join("patient.toml")).unwrap();
    let text = PatientFolder::read(folder).unwrap_err().to_string();
    assert!(text.contains("it holds no patient.toml"), "{text}");
}

/// A hole, a flipped patch, doubled triangles and a tooth pushed through the surface.
#[test]
fn a_torn_surface_is_mended_within_bounds() {
    let base = tempfile::tempdir().unwrap();
    let good = jaw();
    let mut torn = good.clone();
    let hole = torn.vertices[900];
    let is_near = |m: &TriMesh, t: &[u32; 3], r: f64| {
        t.iter()
            .any(|v| (m.vertices[*v as usize] - hole).norm() < r)
    };
    let copy = torn.clone();
    torn.triangles.retain(|t| !is_near(&copy, t, 3.0));
    let n = torn.triangles.len();
    for t in &mut torn.triangles[n - 8..] {
        t.swap(0, 1);
    }
    let doubled = torn.triangles[..4].to_vec();
    torn.triangles.extend(doubled);
    let crown = mandible().teeth()[5].surface().unwrap();
    torn.append(&crown);
    // Far from the origin, as scans are, and inside out.
    let shift = Vec3::new(20.0, -140.0, 1480.0);
    torn.vertices.iter_mut().for_each(|p| *p += shift);
    torn.triangles.iter_mut().for_each(|t| t.swap(0, 2));
    let input = put(base.path(), "torn.ply", &ply::to_binary_ply(&torn));
    let made = made(&spec(&input, 1_500));
    let found = made.report.diagnosis.unwrap();
    assert!(
        found.inside_out
            && found.open_edges > 0
            && found.non_manifold_edges > 0
            && found.self_intersections > 0
    );
    assert_eq!(found.n_pieces, 2);
    let mending = made.report.mending.unwrap();
    assert!(mending.of_mesh.p95 < 0.15, "{mending:?}");
    let mut mended = made.patient.surface;
    mended.vertices.iter_mut().for_each(|p| *p -= shift);
    // Crown and bone are one body now.
    let more = mended.volume() - good.volume();
    assert!((0.3..1.0).contains(&(more / crown.volume())), "{more} mm3");
    let bone = MeshDistance::new(good);
    let closed = MeshDistance::new(mended);
    let over_hole = closed.unsigned(&hole);
    assert!(
        over_hole < 1.0 && bone.unsigned(&hole) < 1e-9,
        "{over_hole}"
    );
}

/// What no exporter writes: each time another damage, by a fixed seed. A patient that passes `check`, or a line; never a panic.
/// `OSTEOTOME_LONG=1`: many more.
#[test]
fn a_jaw_of_any_damage_is_a_patient_or_a_refusal() {
    let base = tempfile::tempdir().unwrap();
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut below = |n: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as usize % n.max(1)
    };
    let good = mesher::contour(&mandible(), 4.0).unwrap();
    // Mending takes seconds each: one of those that need it, and all that do not.
    let rounds: Vec<usize> = if std::env::var_os("OSTEOTOME_LONG").is_some() {
        (0..120).collect()
    } else {
        vec![0, 2, 3, 4, 5, 6]
    };
    let mut patients = 0;
    for round in &rounds {
        let mut bad = good.clone();
        let n = bad.triangles.len();
        let (first, some) = (below(n), 1 + below(n / 3));
        match round % 12 {
            0 => drop(bad.triangles.drain(first..(first + some).min(n))),
            1 => bad.triangles[first..(first + some).min(n)]
                .iter_mut()
                .for_each(|t| t.swap(0, 1)),
            2 => bad.vertices[below(n / 2)] = Vec3::new(1e30, -1e30, 1e30),
            3 => bad
                .vertices
                .iter_mut()
                .skip(below(n / 2))
                .take(some)
                .for_each(|p| p.z = 0.0),
            4 => bad.vertices.iter_mut().for_each(|p| *p *= 1e-300),
            5 => bad.vertices.iter_mut().for_each(|p| *p *= 1e150),
            6 => bad.vertices.iter_mut().for_each(|p| p.y = 0.0),
            7 => bad.append(&good.clone()),
            8 => {
                // Another one within, inside out.
                let mut inner = good.clone();
                inner.vertices.iter_mut().for_each(|p| *p *= 0.999);
                inner.triangles.iter_mut().for_each(|t| t.swap(0, 1));
                bad.append(&inner);
            }
            9 => {
                for _ in 0..some {
                    let (a, b) = (below(n), below(n));
                    bad.triangles[a][below(3)] = bad.triangles[b][below(3)];
                }
            }
            10 => {
                for p in &mut bad.vertices {
                    *p += Vec3::from([0; 3].map(|_| below(8_001) as f64 * 1e-3 - 4.0));
                }
            }
            _ => bad
                .triangles
                .iter_mut()
                .take(some)
                .for_each(|t| t[2] = t[1]),
        }
        let input = put(base.path(), "bad.ply", &ply::to_binary_ply(&bad));
        match prepare(&spec(&input, 400), &mut |_, _| {}) {
            Ok(made) => {
                let folder = base.path().join(format!("p{round}"));
                made.patient.write(&folder, Vec::new()).unwrap();
                assert_eq!(
                    folder::check(&folder).faults,
                    Vec::<String>::new(),
                    "{round}"
                );
                patients += 1;
            }
            Err(error) => assert!(!error.to_string().contains('\n'), "{round}: {error}"),
        }
    }
    assert!((1..rounds.len()).contains(&patients), "{patients}");
}

#[test]
fn the_mesh_is_pulled_onto_the_surface() {
    let base = tempfile::tempdir().unwrap();
    let input = put(base.path(), "jaw.stl", &stl::to_binary_stl(&jaw()));
    let figures = made(&spec(&input, 5_000)).report.mesh;
    assert!(figures.deviation.p95() < 0.2, "{figures:?}");
    assert!((figures.volume / figures.surface_volume - 1.0).abs() < 0.01);
    assert!(figures.dihedral[0] > 10.0, "{figures:?}");
}

#[test]
fn wrong_units_axes_and_bodies_are_named() {
    let base = tempfile::tempdir().unwrap();
    let mut ras = jaw();
    ras.vertices
        .iter_mut()
        .for_each(|p| *p = Vec3::new(-p.x, -p.y, p.z) * 1e-3);
    let input = put(base.path(), "jaw.stl", &stl::to_binary_stl(&ras));
    let mut spec = spec(&input, 400);
    assert!(refusal(&spec).contains("which is no mandible; it would be one in m; say --unit m"));
    spec.unit = "m".parse().unwrap();
    assert!(refusal(&spec).contains("but would in RAS; say --axes RAS"));
    spec.axes = "RAS".parse().unwrap();
    let made = made(&spec);
    let chin = made.patient.surface.bounds().min.y;
    assert!(chin < -40.0, "the chin is in front");
    // Every second triangle goes the other way: nothing is enclosed.
    let mut muddled = jaw();
    for t in muddled.triangles.iter_mut().step_by(2) {
        t.swap(0, 1);
    }
    let muddled = put(base.path(), "muddled.stl", &stl::to_binary_stl(&muddled));
    let text = refusal(&PrepareSpec::of(&muddled));
    assert!(
        text.contains("edges whose triangles face opposite ways")
            && text.contains("go round no volume"),
        "{text}"
    );
    let missing = PrepareSpec::of(&base.path().join("none.stl"));
    assert!(refusal(&missing).contains("cannot read"));
    spec.nodes = Some(7);
    assert!(refusal(&spec).contains("--nodes = 7"));
}
