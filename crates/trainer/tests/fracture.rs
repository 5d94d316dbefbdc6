//! `osteotome fracture` as its users meet it: the contract's keys and files, exact solutions, closed forms, growth, bad input.
use osteotome_mechanics::geometry::{TetMesh, Vec3, block_mesh};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn osteotome(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_osteotome"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn shipped(case: &str) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../validation");
    format!("{folder}/{case}/case.toml")
}

/// Runs a case into `out` and gives what it prints.
fn solve(folder: &Path, case: &str) -> Value {
    let output = osteotome(folder, &["fracture", case, "--out", "out", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON and nothing else")
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("{v} is not a number"))
}

/// Stations inside the body at a step.
fn inside(result: &Value, step: usize) -> Vec<&Value> {
    let fronts = result["steps"][step]["fronts"].as_array().expect("fronts");
    let stations = fronts.iter().flat_map(|f| f.as_array().expect("a front"));
    stations.filter(|s| s["inside"] == true).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let v: Vec<f64> = values.collect();
    v.iter().sum::<f64>() / v.len() as f64
}

/// A block with its six sides as physical surfaces, as Gmsh 2.2 text.
fn msh(mesh: &TetMesh) -> String {
    let bounds = mesh.bounds();
    let mut elements = Vec::new();
    for f in mesh.boundary_faces() {
        let side = (0..6).find(|s| {
            let at = if s % 2 == 0 { bounds.min } else { bounds.max };
            f.iter()
                .all(|n| mesh.nodes()[*n as usize][s / 2] == at[s / 2])
        });
        let [a, b, c] = f.map(|n| n + 1);
        let side = side.expect("on a side") + 1;
        elements.push(format!("2 2 {side} {side} {a} {b} {c}"));
    }
    for [a, b, c, d] in mesh.tets().iter().map(|t| t.map(|n| n + 1)) {
        elements.push(format!("4 2 7 1 {a} {b} {c} {d}"));
    }
    let mut s = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n7\n".to_owned();
    for (i, name) in ["x-", "x+", "y-", "y+", "z-", "z+"].iter().enumerate() {
        writeln!(s, "2 {} \"{name}\"", i + 1).unwrap();
    }
    write!(
        s,
        "3 7 \"body\"\n$EndPhysicalNames\n$Nodes\n{}\n",
        mesh.nodes().len()
    )
    .unwrap();
    for (i, p) in mesh.nodes().iter().enumerate() {
        writeln!(s, "{} {} {} {}", i + 1, p.x, p.y, p.z).unwrap();
    }
    write!(s, "$EndNodes\n$Elements\n{}\n", elements.len()).unwrap();
    for (i, e) in elements.iter().enumerate() {
        writeln!(s, "{} {e}", i + 1).unwrap();
    }
    s + "$EndElements\n"
}

/// The same block as VTU text.
fn vtu(mesh: &TetMesh) -> String {
    let points: Vec<String> = mesh
        .nodes()
        .iter()
        .map(|p| format!("{} {} {}", p.x, p.y, p.z))
        .collect();
    let tets: Vec<String> = mesh
        .tets()
        .iter()
        .map(|[a, b, c, d]| format!("{a} {b} {c} {d}"))
        .collect();
    let ends: Vec<String> = (1..=tets.len()).map(|i| (4 * i).to_string()).collect();
    let types = vec!["10"; tets.len()];
    format!(
        "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\
         <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{}</DataArray></Points>\
         <Cells><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">{}</DataArray>\
         <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">{}</DataArray>\
         <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">{}</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>",
        points.len(),
        tets.len(),
        points.join(" "),
        tets.join(" "),
        ends.join(" "),
        types.join(" ")
    )
}

/// A parallelogram as OBJ.
fn obj(o: [f64; 3], a: [f64; 3], b: [f64; 3]) -> String {
    let [o, a, b] = [o, a, b].map(Vec3::from);
    let mut s = String::new();
    for p in [o, o + a, o + a + b, o + b] {
        writeln!(s, "v {} {} {}", p.x, p.y, p.z).unwrap();
    }
    s + "f 1 2 3 4\n"
}

/// A column of 4 x 2 x 6 mm that stands on its foot, pulled by 2 MPa.
const COLUMN: &str = r#"units = "mm-N-MPa"
[mesh]
file = "block.msh"
[[material]]
region = "*"
young_modulus = 500.0
poisson_ratio = 0.0
toughness = 0.5
[crack]
surface = "crack.obj"
[[support]]
where = { surface = "z-" }
fix = { x = 0.0, y = 0.0, z = 0.0 }
[[load]]
where = { surface = "z+" }
traction = [0.0, 0.0, 2.0]
"#;

fn column() -> TetMesh {
    block_mesh(Vec3::zeros(), Vec3::new(4.0, 2.0, 6.0), [4, 2, 6])
}

/// A folder with the column, a crack and a case.
fn folder(case: &str, crack: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("block.msh"), msh(&column())).expect("writable");
    std::fs::write(folder.path().join("crack.obj"), crack).expect("writable");
    std::fs::write(folder.path().join("case.toml"), case).expect("writable");
    let path = folder.path().to_owned();
    (folder, path)
}

/// From one side half way through, at z = 3.1.
fn side_crack() -> String {
    obj([-1.0, -1.0, 3.1], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0])
}

/// From foot to head, along the load.
fn long_crack() -> String {
    obj([1.37, -1.0, -1.0], [0.0, 4.0, 0.0], [0.0, 0.0, 8.0])
}

/// Numbers of an array of a VTU file.
fn array(vtu: &str, name: &str) -> Vec<f64> {
    let tag = format!("Name=\"{name}\"");
    let rest = &vtu[vtu.find(&tag).unwrap_or_else(|| panic!("no {name}"))..];
    let body = &rest[rest.find('>').expect("a tag") + 1..];
    let body = &body[..body.find('<').expect("an end")];
    body.split_whitespace()
        .map(|w| w.parse().expect("a number"))
        .collect()
}

/// Whole, or cut from foot to head along the load: stress, strain energy and displacement are those of the uncut column.
#[test]
fn patch_tests_are_exact() {
    let no_crack = COLUMN.replace("[crack]\nsurface = \"crack.obj\"\n", "");
    for (case, pieces) in [(no_crack.as_str(), 1), (COLUMN, 2)] {
        let (_keep, folder) = folder(case, &long_crack());
        let result = solve(&folder, "case.toml");
        let energy = 0.5 * 2.0 * 2.0 / 500.0 * 48.0;
        assert!(
            (number(&result["strain_energy"]) / energy - 1.0).abs() < 1e-9,
            "{result}"
        );
        assert_eq!(result["steps"][0]["fragments"], pieces);
        let vtu = std::fs::read_to_string(folder.join("out/fields_000.vtu")).expect("readable");
        for stress in array(&vtu, "von_mises_stress") {
            assert!((stress - 2.0).abs() < 1e-8, "{stress}");
        }
        let (points, moved) = (array(&vtu, "Points"), array(&vtu, "displacement"));
        for (p, u) in points.chunks(3).zip(moved.chunks(3)) {
            assert!((u[2] - p[2] * 2.0 / 500.0).abs() < 1e-10 && u[0].abs() < 1e-10);
        }
        assert!((volume(&vtu) - 48.0).abs() < 1e-9);
        let areas = ["crack_area", "effective_area"].map(|k| number(&result["steps"][0][k]));
        let area = if pieces == 2 { 12.0 } else { 0.0 };
        assert!(areas.iter().all(|a| (a - area).abs() < 1e-5), "{areas:?}");
    }
}

/// The column stretches by the modulus along the load, whichever axis lies there, given as a frame or by a curve.
#[test]
fn an_orthotropic_column_stretches_by_the_modulus_along_it() {
    for (axes, modulus) in [
        ("first = [0, 0, 2], second = [1, 0, 0]", 500.0),
        ("first = [1, 0, 0], second = [0.3, 0, 1]", 300.0),
        ("first = [1, 0, 0], second = [0, 1, 0]", 200.0),
        (
            "along = [[9, 0, 0], [9, 0, 3], [9, 0, 7]], second = [1, 0, 0]",
            500.0,
        ),
    ] {
        let nine = "{ e1 = 500, e2 = 300, e3 = 200, nu12 = 0, nu23 = 0, nu13 = 0, g12 = 90, g23 = 70, g13 = 80 }";
        let case = COLUMN.replace(
            "young_modulus = 500.0\npoisson_ratio = 0.0\n",
            &format!("orthotropic = {nine}\naxes = {{ {axes} }}\n"),
        );
        let (_keep, folder) = folder(&case, &long_crack());
        let result = solve(&folder, "case.toml");
        let energy = 0.5 * 2.0 * 2.0 / modulus * 48.0;
        let found = number(&result["strain_energy"]);
        assert!((found / energy - 1.0).abs() < 1e-9, "{axes}: {found}");
        let vtu = std::fs::read_to_string(folder.join("out/fields_000.vtu")).expect("readable");
        let stresses = array(&vtu, "von_mises_stress");
        assert!(stresses.iter().all(|s| (s - 2.0).abs() < 1e-8), "{axes}");
    }
}

/// Sum of the volumes of a file's tetrahedra; each must be positive.
fn volume(vtu: &str) -> f64 {
    let points = array(vtu, "Points");
    let at = |n: f64| Vec3::from_column_slice(&points[3 * n as usize..3 * n as usize + 3]);
    array(vtu, "connectivity")
        .chunks(4)
        .map(|t| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| at(t[k]));
            let v = (b - a).dot(&(c - a).cross(&(d - a))) / 6.0;
            assert!(v > 0.0, "a tetrahedron of volume {v}");
            v
        })
        .sum()
}

/// Meshes from .msh and .vtu are the same body.
#[test]
fn a_vtu_mesh_gives_the_same_figures() {
    let (_keep, folder) = folder(COLUMN, &side_crack());
    let first = solve(&folder, "case.toml");
    std::fs::write(folder.join("block.vtu"), vtu(&column())).expect("writable");
    let case = COLUMN
        .replace("block.msh", "block.vtu")
        .replace("surface = \"z-\"", "box = [[0, 0, 0], [4, 2, 0]]")
        .replace("surface = \"z+\"", "box = [[0, 0, 6], [4, 2, 6]]");
    std::fs::write(folder.join("case.toml"), case).expect("writable");
    let second = solve(&folder, "case.toml");
    assert_eq!(first["steps"], second["steps"]);
    assert!(!inside(&first, 0).is_empty());
}

/// Everything that the contract names is there, in files as on standard output, and a second run gives the same.
#[test]
fn the_contract_is_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut result = solve(folder.path(), &shipped("inclined"));
    let out = folder.path().join("out");
    let written = std::fs::read_to_string(out.join("result.json")).expect("readable");
    assert_eq!(
        serde_json::from_str::<Value>(&written).expect("JSON"),
        result
    );
    assert_eq!(result["schema"], "osteotome.fracture/1");
    for key in ["nodes", "tets", "enriched_nodes", "strain_energy"] {
        assert!(number(&result[key]) > 0.0, "{key}");
    }
    assert!(number(&result["timing_ms"]["total"]) > 0.0);
    let steps = result["steps"].as_array().expect("steps");
    assert_eq!(steps.len(), 6);
    for (i, step) in steps.iter().enumerate() {
        assert_eq!(step["step"], i);
        for key in [
            "load_factor",
            "strain_energy",
            "crack_area",
            "effective_area",
            "fragments",
        ] {
            assert!(number(&step[key]) > 0.0, "{key}");
        }
        let mut largest = 0.0_f64;
        for s in step["fronts"]
            .as_array()
            .expect("fronts")
            .iter()
            .flat_map(|f| f.as_array().unwrap())
        {
            for key in ["position", "normal", "advance"] {
                assert_eq!(s[key].as_array().expect(key).len(), 3);
            }
            for key in ["G", "kink_deg", "twist_deg", "advanced_mm"] {
                number(&s[key]);
            }
            if s["inside"] == true {
                assert_eq!(s["K"].as_array().expect("K").len(), 3);
                largest = largest.max(number(&s["G"]));
            } else {
                assert!(s.get("K").is_none());
            }
            assert!(number(&s["advanced_mm"]) <= 0.8 + 1e-9);
        }
        // At the load factor found the largest release of any kink is the toughness, and no kink raises G by half.
        assert!(
            largest <= 0.05 + 1e-9 && largest > 0.05 / 1.6,
            "step {i}: G = {largest}"
        );
        let vtu =
            std::fs::read_to_string(out.join(format!("fields_{i:03}.vtu"))).expect("readable");
        for name in [
            "displacement",
            "strain_energy_density",
            "von_mises_stress",
            "level_set",
            "fragment",
        ] {
            assert!(array(&vtu, name).iter().all(|v| v.is_finite()), "{name}");
        }
        assert!(
            (volume(&vtu) / 480.0 - 1.0).abs() < 1e-2,
            "{}",
            volume(&vtu)
        );
        let ply = std::fs::read_to_string(out.join(format!("crack_{i:03}.ply"))).expect("readable");
        assert!(ply.starts_with("ply\n"));
    }
    assert_eq!(std::fs::read_dir(&out).expect("readable").count(), 13);
    let mut second = solve(folder.path(), &shipped("inclined"));
    for r in [&mut result, &mut second] {
        r.as_object_mut().expect("an object").remove("timing_ms");
    }
    assert_eq!(result, second);
}

/// The crack at 45 degrees kinks by about -40 degrees and then runs across the load.
#[test]
fn an_inclined_crack_turns_across_the_load() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = solve(folder.path(), &shipped("inclined"));
    let kink = mean(inside(&result, 0).iter().map(|s| number(&s["kink_deg"])));
    assert!((kink + 41.0).abs() < 4.0, "first kink {kink} degrees");
    let across = mean(inside(&result, 4).iter().map(|s| number(&s["normal"][2])));
    assert!(across > 0.98, "normal . load = {across}");
    let load = |k: usize| number(&result["steps"][k]["load_factor"]);
    assert!(
        (1..6).all(|k| load(k) < load(k - 1)),
        "the load must fall as the crack grows"
    );
    let area = |k: usize| number(&result["steps"][k]["crack_area"]);
    assert!((1..6).all(|k| area(k) > area(k - 1) + 1.0));
}

/// Closed forms: SENT, penny (numerics.md: -8 +- 6 % at a/h 2 to 3), DCB. Meshes are coarse: 10 %.
#[test]
fn energy_release_rates_agree_with_closed_forms() {
    for (case, g) in [("sent", 0.05060), ("penny", 0.003476), ("dcb", 0.01003)] {
        let folder = tempfile::tempdir().expect("a folder");
        let result = solve(folder.path(), &shipped(case));
        let found = mean(inside(&result, 0).iter().map(|s| number(&s["G"])));
        assert!(
            (found / g - 1.0).abs() < 0.10,
            "{case}: G is {} of the closed form",
            found / g
        );
        assert_eq!(result["steps"][0]["load_factor"], 1.0);
    }
    let folder = tempfile::tempdir().expect("a folder");
    let result = solve(folder.path(), &shipped("sent"));
    let k1 = mean(inside(&result, 0).iter().map(|s| number(&s["K"][0])));
    assert!(
        (k1 / 7.457 - 1.0).abs() < 0.05,
        "K_I is {} of the closed form",
        k1 / 7.457
    );
}

#[test]
fn every_shipped_case_runs() {
    for case in ["skew_notch", "two_sheets"] {
        let folder = tempfile::tempdir().expect("a folder");
        let result = solve(folder.path(), &shipped(case));
        assert!(!inside(&result, 0).is_empty(), "{case}");
    }
}

/// A fixed load: below the toughness the crack rests and says so, far above it runs through and the body comes apart.
#[test]
fn a_fixed_load_grows_only_above_the_toughness() {
    let growth = "[growth]\nsteps = 8\nincrement = 0.8\nload = \"fixed\"\ncriterion = \"mts\"\n";
    let tough = COLUMN.replace("toughness = 0.5", "toughness = 50.0") + growth;
    let (_keep, folder) = folder(&tough, &side_crack());
    let result = solve(&folder, "case.toml");
    assert_eq!(result["steps"].as_array().map(Vec::len), Some(1));
    let stopped = result["stopped"].as_str().expect("a word");
    assert!(stopped.contains("the crack rests"), "{stopped}");
    let weak = COLUMN.replace("toughness = 0.5", "toughness = 0.01") + growth;
    std::fs::write(folder.join("case.toml"), weak).expect("writable");
    let deep = obj([-1.0, -1.0, 3.1], [3.8, 0.0, 0.0], [0.0, 4.0, 0.0]);
    std::fs::write(folder.join("crack.obj"), deep).expect("writable");
    let result = solve(&folder, "case.toml");
    let last = result["steps"]
        .as_array()
        .and_then(|s| s.last())
        .expect("a step");
    assert_eq!(last["fragments"], 2, "{last}");
    assert_eq!(last["strain_energy"], 0.0);
    let stopped = result["stopped"].as_str().expect("a word");
    assert!(stopped.contains("come apart"), "{stopped}");
}

/// The input is refused with exit code 2 and one line that holds all `parts`; nothing is written.
fn check_refused(folder: &Path, args: &[&str], parts: &[&str]) {
    let names = |folder: &Path| {
        let mut found: Vec<_> = std::fs::read_dir(folder)
            .expect("readable")
            .map(|e| e.expect("an entry").file_name())
            .collect();
        found.sort();
        found
    };
    let before = names(folder);
    let output = osteotome(folder, args);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    assert!(output.stdout.is_empty());
    for part in parts {
        assert!(error.contains(part), "'{part}' is not in: {error}");
    }
    assert_eq!(names(folder), before, "{args:?} wrote something");
}

#[test]
fn bad_cases_are_named() {
    let growth = "[growth]\nsteps = 2\n";
    for (from, to, parts) in [
        (
            "young_modulus = 500.0",
            "young_modulus = -1",
            ["material.0.young_modulus", "above 0"],
        ),
        (
            "poisson_ratio = 0.0",
            "poisson_ratio = 0.5",
            ["poisson_ratio", "0.5"],
        ),
        (
            "young_modulus = 500.0\npoisson_ratio = 0.0",
            "orthotropic = { e1 = 5, e2 = 5, e3 = 5, nu12 = 0, nu23 = 0, nu13 = 0, g12 = 2, g23 = 2, g13 = 2 }\naxes = { along = [[0, 0, 0], [1, 0, 0]], second = [2, 0, 0] }",
            ["material.0.axes", "parallel"],
        ),
        (
            "young_modulus = 500.0\npoisson_ratio = 0.0",
            "orthotropic = { e1 = 5, e2 = 5, e3 = 5, nu12 = 1, nu23 = 0, nu13 = 0, g12 = 2, g23 = 2, g13 = 2 }\naxes = { first = [1, 0, 0], second = [0, 1, 0] }",
            ["material.0.orthotropic: nu12 is 1", "positive definite"],
        ),
        (
            "region = \"*\"",
            "region = \"bone\"",
            ["no volume \"bone\"", "\"body\""],
        ),
        (
            "surface = \"z-\"",
            "surface = \"foot\"",
            ["support.0.where.surface", "\"z-\""],
        ),
        (
            "surface = \"z-\"",
            "box = [[9, 9, 9], [10, 10, 10]]",
            ["support.0.where.box", "no node"],
        ),
        (
            "surface = \"z+\"",
            "box = [[1, 1, 1], [2, 1, 2]]",
            ["load.0.where.box", "no boundary face"],
        ),
        (
            "traction = [0.0, 0.0, 2.0]",
            "traction = [0.0, nan, 2.0]",
            ["load.0.traction", "NaN"],
        ),
        (
            "traction = [0.0, 0.0, 2.0]",
            "torque = { axis = [0, 0, 1], origin = [0, 0, 0], moment = inf }",
            ["torque", "inf"],
        ),
        (
            "fix = { x = 0.0, y = 0.0, z = 0.0 }",
            "fix = { z = 0.0 }",
            ["not held", "moving along"],
        ),
        ("block.msh", "none.msh", ["mesh.file", "none.msh"]),
        ("block.msh", ".", ["mesh.file", "not known"]),
        ("block.msh", "block.stp", ["mesh.file", "stp"]),
        ("crack.obj", "none.obj", ["crack.surface", "none.obj"]),
        ("crack.obj", "crack.step", ["crack.surface", ".step"]),
        ("toughness = 0.5", "", ["material.0.toughness", "growth"]),
        ("units", "unitz", ["unitz", "units"]),
        ("[crack]", "[[crack]]", ["crack", "invalid type"]),
        ("[mesh]", "[mesh]\n[mesh]", ["line 3", "duplicate"]),
    ] {
        assert!(COLUMN.contains(from), "{from}");
        let case = COLUMN.replacen(from, to, 1) + growth;
        let (_keep, folder) = folder(&case, &side_crack());
        check_refused(&folder, &["fracture", "case.toml", "--out", "out"], &parts);
    }
    let no_supports = COLUMN.replace(
        "[[support]]\nwhere = { surface = \"z-\" }\nfix = { x = 0.0, y = 0.0, z = 0.0 }\n",
        "",
    );
    let (_keep, folder) = folder(&no_supports, &side_crack());
    check_refused(
        &folder,
        &["fracture", "case.toml", "--out", "out"],
        &["case.toml", "the body is not held"],
    );
    check_refused(
        &folder,
        &["fracture", ".", "--out", "out"],
        &["not a regular file"],
    );
    check_refused(
        &folder,
        &["fracture", "none.toml", "--out", "out"],
        &["none.toml", "no such file"],
    );
    check_refused(&folder, &["fracture", "case.toml"], &["--out"]);
    std::fs::create_dir(folder.join("folder.msh")).expect("writable");
    std::fs::write(
        folder.join("case.toml"),
        COLUMN.replace("block.msh", "folder.msh"),
    )
    .expect("writable");
    check_refused(
        &folder,
        &["fracture", "case.toml", "--out", "out"],
        &["folder.msh", "not a regular file"],
    );
}

#[test]
fn bad_cracks_are_named() {
    let outside = obj([-1.0, -1.0, 9.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let through = obj([-1.0, -1.0, 3.1], [9.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let fin = side_crack() + "v 0 0 5\nf 1 3 5\n";
    for (crack, parts) in [
        (outside, ["crack.surface", "crosses no edge"]),
        (through, ["cuts off a piece", "no [[support]] holds"]),
        (fin, ["crack.surface", "not manifold"]),
        (
            side_crack().replace("v -1", "v nan"),
            ["crack.obj", "not a finite number"],
        ),
        (
            side_crack().replace("f 1 2 3 4", "f 1 2 3 99"),
            ["crack.obj", "names vertex 98"],
        ),
        (String::new(), ["crack.obj", "no triangles"]),
    ] {
        let (_keep, folder) = folder(COLUMN, &crack);
        check_refused(&folder, &["fracture", "case.toml", "--out", "out"], &parts);
    }
}

#[test]
fn bad_meshes_are_named() {
    let whole = msh(&column());
    let first = whole
        .lines()
        .find(|l| l.contains(" 4 2 7 1 "))
        .expect("a tetrahedron");
    let mut words: Vec<&str> = first.split(' ').collect();
    let n = words.len();
    words.swap(n - 1, n - 2);
    let flipped = words.join(" ");
    for (text, part) in [
        (whole[..whole.len() / 2].to_owned(), "truncated"),
        (whole.replace(first, &flipped), "must be positive"),
        (
            whole.replacen("$Nodes\n105", "$Nodes\n99999999999", 1),
            "beyond the limit",
        ),
        (
            whole.replacen("1 0 0 0\n", "1 0 nan 0\n", 1),
            "not a finite number",
        ),
        (String::new(), "$MeshFormat"),
    ] {
        assert!(text != whole, "{part}: nothing is broken");
        let (_keep, folder) = folder(COLUMN, &side_crack());
        std::fs::write(folder.join("block.msh"), text).expect("writable");
        check_refused(
            &folder,
            &["fracture", "case.toml", "--out", "out"],
            &["block.msh", part],
        );
    }
}

#[test]
fn what_is_in_the_way_is_left_alone() {
    let (_keep, folder) = folder(COLUMN, &side_crack());
    check_refused(
        &folder,
        &["fracture", "case.toml", "--out", "crack.obj"],
        &["crack.obj", "give a folder"],
    );
    check_refused(
        &folder,
        &["fracture", "case.toml", "--out", "."],
        &["something else than a fracture result"],
    );
    solve(&folder, "case.toml");
    solve(&folder, "case.toml");
    assert!(folder.join("out/result.json").is_file());
}
