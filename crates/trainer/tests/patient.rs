//! `prepare`, `check` and a session on a prepared patient, as their users meet them.
use osteotome_anatomy::{Parameters, ParametricMandible, landmarks::Landmarks, mesher, stl};
use osteotome_mechanics::geometry::MeshDistance;
use std::path::Path;
use std::process::{Command, Output};

fn osteotome(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_osteotome"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program starts")
}

fn scenario() -> String {
    concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scenarios/bsso_left.toml"
    )
    .to_owned()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn json<T: serde::Serialize>(value: &T) -> Vec<u8> {
    serde_json::to_vec(value).expect("JSON")
}

/// `jaw.stl`, `marks.json` and both canals in a folder.
fn write_jaw(folder: &Path) {
    let mandible = ParametricMandible::new(Parameters::default()).expect("sizes in range");
    let surface = mesher::contour(&mandible, 2.5).expect("a surface");
    let put = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.join(name), bytes).expect("writable");
    };
    put("jaw.stl", &stl::to_binary_stl(&surface));
    let marks: Landmarks = mandible
        .landmarks(&MeshDistance::new(surface))
        .expect("landmarks");
    put("marks.json", &json(&marks.to_file()));
    for (canal, name) in mandible.canals().iter().zip(["right.json", "left.json"]) {
        put(name, &json(&canal.to_file()));
    }
}

/// Exit code 2 and one line on standard error that holds all `parts`.
fn refused(output: &Output, parts: &[&str]) {
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    for part in parts {
        assert!(error.contains(part), "'{part}' is not in: {error}");
    }
}

fn fine(output: &Output) -> String {
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{error}");
    text(&output.stdout)
}

#[test]
fn a_surface_becomes_a_patient_who_is_operated_on() {
    let base = tempfile::tempdir().expect("a folder");
    let at = base.path();
    write_jaw(at);
    let args = [
        "prepare",
        "jaw.stl",
        "--landmarks",
        "marks.json",
        "--canal",
        "left.json",
        "--canal",
        "right.json",
        "--nodes",
        "600",
        "--name",
        "test jaw",
        "-o",
        "p",
        "--json",
    ];
    let report: serde_json::Value =
        serde_json::from_str(&fine(&osteotome(at, &args))).expect("one JSON object");
    assert_eq!(report["schema"], "osteotome.prepare/1");
    assert_eq!(report["canals"], 2);
    for file in [
        "patient.toml",
        "report.txt",
        "report.json",
        "pictures/front.png",
    ] {
        assert!(at.join("p").join(file).is_file(), "{file}");
    }
    let first = std::fs::read(at.join("p/patient.toml")).expect("a manifest");
    fine(&osteotome(at, &args));
    let second = std::fs::read(at.join("p/patient.toml")).expect("a manifest");
    assert_eq!(first, second, "the same input gives the same digests");

    let said = fine(&osteotome(at, &["check", "p"]));
    assert!(
        said.contains("test jaw: ") && said.contains("2 canals"),
        "{said}"
    );
    let s = scenario();
    let directory = "patient.directory=\"p\"";
    let own_mesh = fine(&osteotome(at, &["check", &s, "--set", directory]));
    assert!(own_mesh.contains("test jaw: "), "{own_mesh}");
    let run = [
        "run",
        &s,
        "--set",
        directory,
        "--max-time",
        "0.06",
        "--out",
        "out",
        "--json",
    ];
    let metrics = fine(&osteotome(at, &run));
    assert!(metrics.contains("osteotome.metrics/1"), "{metrics}");

    // One fault is one line, several are listed.
    let surface = at.join("p/surface.ply");
    let mut bytes = std::fs::read(&surface).expect("a surface");
    bytes[1000] ^= 4;
    std::fs::write(&surface, bytes).expect("writable");
    refused(
        &osteotome(at, &["check", "p"]),
        &["surface.ply", "not the file that was written"],
    );
    refused(
        &osteotome(at, &run),
        &["surface.ply", "not the file that was written"],
    );
    std::fs::remove_file(at.join("p/mesh.vtu")).expect("there");
    let both = osteotome(at, &["check", "p"]);
    refused(&both, &["2 things are wrong"]);
    let list = text(&both.stdout);
    assert!(
        list.contains("1. ") && list.contains("surface.ply"),
        "{list}"
    );
    assert!(list.contains("2. ") && list.contains("mesh.vtu"), "{list}");
    let technique = osteotome(at, &["check", &s, "--set", "patient.directory=\"none\""]);
    refused(&technique, &["patient.directory", "none"]);
}

#[test]
fn what_cannot_be_a_patient_is_refused_and_leaves_nothing() {
    let base = tempfile::tempdir().expect("a folder");
    let at = base.path();
    write_jaw(at);
    std::fs::write(at.join("picture.stl"), b"\x89PNG\r\n\x1a\n").expect("writable");
    let before = std::fs::read_dir(at).expect("readable").count();
    let refusal = |args: &[&str], parts: &[&str]| {
        let mut all = vec!["prepare"];
        all.extend(args);
        refused(&osteotome(at, &all), parts);
        let left = std::fs::read_dir(at).expect("readable").count();
        assert_eq!(left, before, "{args:?} wrote something");
    };
    refusal(&["none.stl", "-o", "p"], &["cannot read none.stl"]);
    refusal(&["picture.stl", "-o", "p"], &["PNG picture", "STL"]);
    refusal(&["jaw.stl"], &["--output"]);
    refusal(
        &["jaw.stl", "-o", "p", "--nodes", "5"],
        &["--nodes = 5", "100"],
    );
    refusal(
        &["jaw.stl", "-o", "p", "--axes", "RAS"],
        &["but would in RAS; say --axes RAS"],
    );
    refusal(
        &["jaw.stl", "-o", "p", "--axes", "XYZ"],
        &["like LPS or RAS"],
    );
    refusal(&["jaw.stl", "-o", "p", "--unit", "m"], &["no mandible"]);
    refusal(
        &["jaw.stl", "-o", "p", "--label", "jaw=3"],
        &["like mandible=2"],
    );
    refusal(
        &["jaw.stl", "-o", "p", "--context", "x.stl"],
        &["maxilla=maxilla.stl"],
    );
    refusal(
        &["jaw.stl", "-o", "p", "--canal", "marks.json"],
        &["marks.json", "canal"],
    );
    refusal(
        &["jaw.stl", "-o", "jaw.stl"],
        &["there is a file of this name"],
    );
    std::fs::create_dir(at.join("thesis")).expect("writable");
    std::fs::write(at.join("thesis/thesis.txt"), "").expect("writable");
    let foreign = osteotome(at, &["prepare", "jaw.stl", "-o", "thesis"]);
    refused(&foreign, &["something else than a patient"]);
    refused(
        &osteotome(at, &["check", "thesis"]),
        &["holds no patient.toml"],
    );
}

/// The built-in surgeon splits a jaw that is not its own mirror image, on both sides.
#[test]
fn an_asymmetric_jaw_is_split_on_both_sides() {
    if std::env::var_os("OSTEOTOME_LONG").is_none() {
        return;
    }
    let base = tempfile::tempdir().expect("a folder");
    for side in ["right", "left"] {
        let s = scenario().replace("bsso_left", &format!("bsso_{side}"));
        let chin = "patient.parametric.chin_deviation=6.0";
        let args = [
            "run",
            &s,
            "--set",
            chin,
            "--max-time",
            "20",
            "--out",
            side,
            "--json",
        ];
        let metrics: serde_json::Value =
            serde_json::from_str(&fine(&osteotome(base.path(), &args))).expect("one JSON object");
        assert_eq!(
            metrics["split"]["complete"], true,
            "{side}: {}",
            metrics["split"]
        );
    }
}
