//! The program as its users meet it: exit codes, one line of error, nothing half written, and sessions that repeat.
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
        "/../../scenarios/bsso_right.toml"
    )
    .to_owned()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The input is refused with exit code 2 and one line that holds all `parts`; the folder stays as it was.
fn check_refused(args: &[&str], parts: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let output = osteotome(folder.path(), args);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
    assert_eq!(error.lines().count(), 1, "{args:?}: {error}");
    assert!(output.stdout.is_empty(), "{args:?}");
    for part in parts {
        assert!(error.contains(part), "'{part}' is not in: {error}");
    }
    let left = std::fs::read_dir(folder.path()).expect("readable").count();
    assert_eq!(left, 0, "{args:?} wrote something");
}

fn run_args<'a>(scenario: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let mut args = vec!["run", scenario, "--out", "out"];
    args.extend(more);
    args
}

#[test]
fn wrong_command_lines_are_named() {
    check_refused(&["rum"], &["rum", "run"]);
    check_refused(&["run", "a.toml"], &["--out"]);
    check_refused(
        &["run", "none.toml", "--out", "out"],
        &["none.toml", "no such file"],
    );
}

#[test]
fn wrong_scenarios_are_named() {
    let s = scenario();
    let refused = |set: &str, parts: &[&str]| check_refused(&run_args(&s, &["--set", set]), parts);
    refused(
        "mesh.nodez=600",
        &["--set mesh.nodez", "did you mean 'nodes'"],
    );
    refused(
        "material.cortical.young_modulus=-1",
        &["young_modulus", "-1", "above 0"],
    );
    refused("contact.stiffness=nan", &["contact.stiffness", "NaN"]);
    refused("units=\"cm-N-MPa\"", &["units", "cm-N-MPa", "mm-N-MPa"]);
    refused("patient.surface=none.stl", &["patient.surface", "quotes"]);
    refused(
        "patient.surface=\"none.stl\"",
        &["none.stl", "no such file"],
    );
    refused(
        "patient={}",
        &["exactly one of parametric, directory, surface"],
    );
    refused("tool.2.name=\"third\"", &["tool.2.name", "list of 2"]);
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("bad.toml"), "units = \n").expect("writable");
    let output = osteotome(folder.path(), &["check", "bad.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("bad.toml, line 1"));
}

#[test]
fn wrong_surfaces_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let surface = folder.path().join("bone.stl");
    let refused = |content: &[u8], part: &str| {
        std::fs::write(&surface, content).expect("writable");
        let set = format!("patient.surface='{}'", surface.display());
        let osteotomy = "osteotomy.points=[{at=[0,0,0],depth=4,toward=[0,1,0],part=\"ridge\"},{at=[9,0,0],depth=4,toward=[0,1,0],part=\"ridge\"}]";
        check_refused(
            &run_args(&scenario(), &["--set", &set, "--set", osteotomy]),
            &["bone.stl", part],
        );
    };
    refused(b"not a mesh at all", "");
    refused(b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n", "");
    refused(b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 nan\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n", "");
}

#[test]
fn a_folder_with_something_else_is_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("out")).expect("writable");
    std::fs::write(folder.path().join("out/thesis.txt"), "1").expect("writable");
    let output = osteotome(
        folder.path(),
        &run_args(&scenario(), &["--max-time", "0.1"]),
    );
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("something else than a session"));
    assert!(folder.path().join("out/thesis.txt").is_file());
}

#[test]
fn wrong_recordings_are_named() {
    check_refused(
        &["replay", "none.mcap", "--verify"],
        &["none.mcap", "session.mcap"],
    );
}

#[test]
fn the_shipped_scenarios_are_usable() {
    for side in ["right", "left"] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = scenario().replace("right", side);
        let output = osteotome(folder.path(), &["check", &path]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert!(
            text(&output.stdout).contains("3 saw cuts, 1 fragment"),
            "{}",
            text(&output.stdout)
        );
    }
}

/// Figures without what the clock decides.
fn figures(json: &str) -> serde_json::Value {
    let mut value: serde_json::Value = serde_json::from_str(json).expect("JSON and nothing else");
    let object = value.as_object_mut().expect("an object");
    assert!(object.remove("loops").is_some() && object.remove("steps_us").is_some());
    value
}

/// Width and height as a PNG file says.
fn png_size(path: &Path) -> [u32; 2] {
    let bytes = std::fs::read(path).expect("a picture");
    assert!(
        bytes.starts_with(b"\x89PNG\r\n\x1a\n"),
        "{}",
        path.display()
    );
    [16, 20].map(|k| u32::from_be_bytes(bytes[k..k + 4].try_into().expect("four bytes")))
}

/// `render` on the session in `out`: pictures that repeat, and one line for whatever is wrong.
fn check_render(folder: &Path) {
    let render = |more: &[&str]| {
        let mut args = vec!["render", "out/session.mcap", "--size", "321x180"];
        args.extend(more);
        osteotome(folder, &args)
    };
    let modes: [&[&str]; 3] = [
        &["--at", "2.0", "-o", "a.png", "--view", "procedure"],
        &["--at", "2.0", "-o", "b.png", "--view", "procedure"],
        &[
            "--at",
            "0",
            "-o",
            "c.png",
            "--transparent",
            "--stereo",
            "anaglyph",
            "--cpu",
        ],
    ];
    for args in modes {
        let output = render(args);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(png_size(&folder.join(args[3])), [321, 180]);
    }
    let read = |name: &str| std::fs::read(folder.join(name)).expect("readable");
    assert!(read("a.png") == read("b.png") && read("a.png") != read("c.png"));
    let refused = |args: &[&str], code: i32, part: &str| {
        let output = render(args);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {error}");
        assert!(
            error.lines().count() == 1 && error.contains(part),
            "{error}"
        );
        assert!(!folder.join("d.png").exists(), "{args:?}");
    };
    refused(
        &["--at", "99", "-o", "d.png"],
        2,
        "the session lasts 2.50 s",
    );
    refused(&["--at", "1", "-o", "none/d.png"], 2, "none/d.png");
    refused(&["--at", "1"], 2, "-o");
    refused(
        &["--at", "1", "-o", "d.png", "--view", "below"],
        2,
        "procedure",
    );
    refused(
        &["--at", "1", "-o", "d.png", "--apart", "300"],
        2,
        "0 to 100",
    );
    refused(&["--video", "d.mp4"], 2, "even");
    refused(&["--at", "1", "-o", "d.png", "--cpu", "--gpu"], 2, "--gpu");
    let forced = render(&["--at", "1", "-o", "e.png", "--gpu"]);
    let (said, error) = (text(&forced.stdout), text(&forced.stderr));
    match forced.status.code() {
        Some(0) => assert!(!said.contains("drawn on the processor"), "{said}"),
        code => {
            assert_eq!(code, Some(1), "{error}");
            assert!(error.contains("--gpu: no graphics device"), "{error}");
            assert!(!folder.join("e.png").exists());
        }
    }
    if !has_ffmpeg() {
        let film = osteotome(folder, &["render", "out/session.mcap", "--video", "d.mp4"]);
        assert_eq!(film.status.code(), Some(1));
        let error = text(&film.stderr);
        assert!(
            error.lines().count() == 1 && error.contains("ffmpeg is not installed"),
            "{error}"
        );
    }
    let size = osteotome(
        folder,
        &[
            "render",
            "out/session.mcap",
            "--at",
            "1",
            "-o",
            "d.png",
            "--size",
            "9x9",
        ],
    );
    assert!(text(&size.stderr).contains("16 to 4096"));
}

fn has_ffmpeg() -> bool {
    Command::new("ffmpeg").arg("-version").output().is_ok()
}

/// Lockstep: the same scenario gives the same figures and the recording recomputes to the last bit.
#[test]
fn lockstep_sessions_repeat_and_replay() {
    let folder = tempfile::tempdir().expect("a folder");
    let s = scenario();
    let more = [
        "--max-time",
        "2.5",
        "--seed",
        "4",
        "--json",
        "--set",
        "mesh.shell_points=20000",
    ];
    let run = || {
        let output = osteotome(folder.path(), &run_args(&s, &more));
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
        figures(&text(&output.stdout))
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    assert!(
        first["hands"]["left"]["peak_force"]
            .as_f64()
            .expect("a number")
            > 0.0,
        "it touched"
    );
    let out = folder.path().join("out");
    for file in [
        "session.mcap",
        "metrics.json",
        "crack.ply",
        "bone_final.vtu",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let written = std::fs::read_to_string(out.join("metrics.json")).expect("readable");
    assert_eq!(figures(&written), second);
    let replay = osteotome(folder.path(), &["replay", "out/session.mcap", "--verify"]);
    assert_eq!(replay.status.code(), Some(0), "{}", text(&replay.stderr));
    assert!(
        text(&replay.stdout).contains("Identical to the last bit"),
        "{}",
        text(&replay.stdout)
    );
    for name in ["1_before", "1_before_transparent", "4_after"] {
        let picture = out.join(format!("pictures/{name}.png"));
        assert_eq!(png_size(&picture), [1280, 720], "{name}");
    }
    check_render(folder.path());
}
