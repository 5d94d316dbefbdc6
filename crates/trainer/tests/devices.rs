//! Devices as the program's users meet them, against stand-ins for the vendors' libraries.
#[path = "../../devices/tests/standin/building.rs"]
mod building;

use building::build;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// The program where no vendor's library or service is, but for what `found` names.
fn osteotome(folder: &Path, found: &[(&str, &Path)], args: &[&str]) -> Output {
    let nowhere = folder.join("nowhere");
    let mut command = Command::new(env!("CARGO_BIN_EXE_osteotome"));
    command.current_dir(folder).args(args);
    for variable in ["OSTEOTOME_LIBHD", "OSTEOTOME_LIBDHD", "SPNAV_SOCKET"] {
        command.env(variable, &nowhere);
    }
    // Port 1 of the loopback: nobody is there.
    command
        .env("OSTEOTOME_HAPLY", "127.0.0.1:1")
        .envs(found.iter().copied());
    command.output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn names(list: &Value, key: &str) -> Vec<String> {
    let name = |v: &Value| v[key].as_str().expect("a name").to_owned();
    list.as_array().expect("a list").iter().map(name).collect()
}

#[test]
fn what_is_missing_is_said_with_where_it_was_sought() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = osteotome(folder.path(), &[], &["devices"]);
    assert!(output.status.success());
    let told = text(&output.stdout);
    for part in [
        "simulated",
        "OSTEOTOME_LIBHD",
        "OSTEOTOME_LIBDHD",
        "ws://127.0.0.1:1",
        "SPNAV_SOCKET",
        "nowhere",
    ] {
        assert!(told.contains(part), "'{part}' is not in:\n{told}");
    }
    let report = json(&osteotome(folder.path(), &[], &["devices", "--json"]));
    assert_eq!(names(&report["devices"], "device"), ["simulated"]);
    let missing = names(&report["missing"], "driver");
    assert_eq!(
        missing[..4],
        ["openhaptics", "forcedimension", "haply", "spacenav"]
    );
}

#[test]
fn devices_are_listed_by_serial_number_and_tested() {
    let folder = tempfile::tempdir().expect("a folder");
    let [hd, dhd] = ["libHD", "libdhd"].map(|n| build(n, folder.path()));
    let found = [
        ("OSTEOTOME_LIBHD", hd.as_path()),
        ("OSTEOTOME_LIBDHD", dhd.as_path()),
    ];
    let args = ["devices", "--test", "--seconds", "0.3", "--json"];
    let report = json(&osteotome(folder.path(), &found, &args));
    assert_eq!(
        names(&report["devices"], "device"),
        [
            "simulated",
            "openhaptics:SN-1001",
            "openhaptics:SN-2002",
            "forcedimension:7001",
            "forcedimension:3002"
        ]
    );
    assert_eq!(report["devices"][1]["max_force"], 3.3);
    assert_eq!(report["devices"][2]["max_torque"], 188.0);
    for device in report["devices"].as_array().expect("a list") {
        assert!(
            device["test"]["rate_hz"].as_f64().expect("a rate") > 0.0,
            "{device}"
        );
    }
    for device in &report["devices"].as_array().expect("a list")[1..] {
        assert!(
            device["test"]["device_to_device_us"][1].is_u64(),
            "{device}"
        );
    }
}

fn refused(found: &[(&str, &Path)], folder: &Path, args: &[&str], parts: &[&str]) {
    let output = osteotome(folder, found, args);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
    assert_eq!(error.lines().count(), 1, "{args:?}: {error}");
    for part in parts {
        assert!(error.contains(part), "'{part}' is not in: {error}");
    }
}

#[test]
fn devices_that_cannot_be_had_are_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let hd = build("libHD", folder.path());
    let found = [("OSTEOTOME_LIBHD", hd.as_path())];
    let scenario = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scenarios/bsso_right.toml"
    );
    let run = |device: &str, mode: &str, parts: &[&str]| {
        let set = format!("tool.1.device={device:?}");
        let args = [
            "run", scenario, "--out", "out", "--mode", mode, "--set", &set,
        ];
        refused(&found, folder.path(), &args, parts);
    };
    run(
        "openhaptics:SN-1001",
        "lockstep",
        &["right", "openhaptics:SN-1001", "--mode realtime"],
    );
    run(
        "openhaptics",
        "realtime",
        &["several", "openhaptics:SN-1001", "openhaptics:SN-2002"],
    );
    run(
        "openhaptics:SN-3",
        "realtime",
        &["SN-3", "openhaptics:SN-2002 (Phantom Premium"],
    );
    run("forcedimension", "realtime", &["libdhd", "nowhere"]);
    run(
        "remote:0.0.0.0:0",
        "realtime",
        &["0.0.0.0:0", "allow_network"],
    );
    run("mouse", "realtime", &["\"mouse\"", "openhaptics[:SERIAL]"]);
    let device = ["devices", "--device", "mouse"];
    refused(&[], folder.path(), &device, &["\"mouse\""]);
    refused(
        &[],
        folder.path(),
        &["devices", "--seconds", "0"],
        &["--seconds 0"],
    );
}
