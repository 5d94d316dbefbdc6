//! Devices as the program's users meet them, against stand-ins for the vendors' libraries.
#[path = "../../devices/tests/standin/building.rs"]
mod building;

#[expect(dead_code, reason = "some moods are for the drivers' own tests")]
#[path = "../../devices/tests/standin/haply_service.rs"]
mod haply_service;

use building::build;
use haply_service::{Mood, Script};
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// The program where no vendor's library or service is, but for what `found` names.
fn osteotome(folder: &Path, found: &[(&str, &Path)], args: &[&str]) -> Output {
    let nowhere = folder.join("nowhere");
    let mut command = Command::new(env!("CARGO_BIN_EXE_osteotome"));
    command.current_dir(folder).args(args);
    for variable in [
        "OSTEOTOME_LIBHD",
        "OSTEOTOME_LIBDHD",
        "SPNAV_SOCKET",
        "OSTEOTOME_INPUT",
    ] {
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
        "nowhere/js*",
    ] {
        assert!(told.contains(part), "'{part}' is not in:\n{told}");
    }
    let report = json(&osteotome(folder.path(), &[], &["devices", "--json"]));
    assert_eq!(names(&report["devices"], "device"), ["simulated"]);
    let missing = names(&report["missing"], "driver");
    assert_eq!(
        missing,
        [
            "openhaptics",
            "forcedimension",
            "haply",
            "spacenav",
            "gamepad"
        ]
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

#[test]
fn what_a_device_cannot_show_is_said_before_the_session() {
    let folder = tempfile::tempdir().expect("a folder");
    let hd = build("libHD", folder.path());
    let found = [("OSTEOTOME_LIBHD", hd.as_path())];
    let told = |serial: &str, lever: &str| {
        let device = format!("tool.0.device=\"openhaptics:{serial}\"");
        let mut args = vec![
            "run",
            SCENARIO,
            "--out",
            "out",
            "--mode",
            "realtime",
            "--max-time",
            "0.2",
        ];
        for set in ["mesh.nodes=300", "mesh.shell_points=6000", &device, lever] {
            args.extend(["--set", set]);
        }
        let output = osteotome(folder.path(), &found, &args);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let [plain, levered] = [
        "tool.0.workspace.scale=1",
        "tool.0.workspace.torque_lever=50",
    ];
    assert!(told("SN-1001", plain).contains("left: this device shows no torque"));
    assert!(told("SN-1001", levered).contains("twist about the shaft cannot be felt"));
    assert!(!told("SN-2002", plain).contains("this device shows"));
}

/// There and back along the vendor's x at 10 mm/s, for a minute.
fn to_and_fro() -> Vec<u8> {
    let x = |tick: i32| {
        let phase = tick % 4000;
        f64::from(if phase < 2000 { phase } else { 4000 - phase }) * 0.01
    };
    let poses = (0..60_000).map(|tick| Isometry3::translation(x(tick), 0.0, 0.0));
    transforms(&poses.collect::<Vec<_>>(), &Matrix3::identity())
}

/// A session in lockstep, gone on from in its midst by two devices: up to there it is the session that it was, then the hands go
/// with the devices from where they were, and the whole repeats.
#[test]
fn a_recording_is_gone_on_from_with_devices() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let library = build("libHD", folder);
    let script = folder.join("hands.bin");
    std::fs::write(&script, to_and_fro()).expect("written");
    let found = [
        ("OSTEOTOME_LIBHD", library.as_path()),
        ("STANDIN_POSES_0", &script),
        ("STANDIN_POSES_1", &script),
        ("STANDIN_GO", Path::new("again.partial")),
    ];
    let run = |args: &[&str]| {
        let output = osteotome(folder, &found, args);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    run(&[
        "run",
        SCENARIO,
        "--out",
        "first",
        "--max-time",
        "0.8",
        "--set",
        "mesh.nodes=300",
        "--set",
        "mesh.shell_points=6000",
    ]);
    let [left, right] = [0, 1].map(|i| {
        let serial = ["SN-1001", "SN-2002"][i];
        format!("tool.{i}.device=\"openhaptics:{serial}\"")
    });
    let from = [
        "run",
        "--from",
        "first/session.mcap",
        "--at",
        "0.6",
        "--out",
        "again",
    ];
    let live = [
        "--mode",
        "realtime",
        "--max-time",
        "2.6",
        "--set",
        &left,
        "--set",
        &right,
    ];
    let told = run(&[&from[..], &live[..]].concat());
    assert!(told.contains("right: openhaptics:SN-2002"), "{told}");
    let read = |name: &str| {
        let path = folder.join(name).join("session.mcap");
        osteotome::session::Recording::read(&path).expect("a recording")
    };
    let [first, again] = ["first", "again"].map(read);
    for i in 0..2 {
        let before = format!("{:?}", &first.hands[i][..600]);
        assert_eq!(before, format!("{:?}", &again.hands[i][..600]));
        let live = again.hands[i][599..].windows(2);
        let steps = live.map(|h| {
            let places = [&h[0], &h[1]].map(|h| h.device_pose.translation.vector);
            (places[1] - places[0]).norm()
        });
        let steps: Vec<f64> = steps.collect();
        // A driver that comes late, by 20 ms at most, makes up for it at once.
        assert!(steps.iter().all(|s| *s < 0.5), "hand {i} leaps");
        assert!(steps.iter().sum::<f64>() > 1.0, "hand {i} does not move");
    }
    let told = run(&["replay", "again/session.mcap", "--verify"]);
    assert!(told.contains("Identical to the last bit"), "{told}");

    // What would have to hold from the beginning on cannot be set.
    let set = ["--set", "mesh.nodes=400"];
    let args = [&from[..], &set[..]].concat();
    refused(&[], folder, &args, &["mesh.nodes", "recorded scenario"]);
}

// Whole splits, in real time and on the shipped bone: the poses of a session that the built-in surgeon has led are led once
// more by devices, one split after the other. They need a machine that keeps the pace, and OSTEOTOME_LONG=1.

const SCENARIO: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../scenarios/bsso_right.toml"
);

fn is_long() -> bool {
    std::env::var_os("OSTEOTOME_LONG").is_some()
}

/// Played so many times slower than in lockstep, where the crack grows in no time.
const SLOWNESS: usize = 4;

type Hands = [Vec<Isometry3<f64>>; 2];

/// The surgeon's hands, for as long as no other split runs.
fn surgeons_hands() -> (&'static Hands, MutexGuard<'static, ()>) {
    static IN_TURN: Mutex<()> = Mutex::new(());
    static HANDS: OnceLock<Hands> = OnceLock::new();
    let turn = IN_TURN.lock().unwrap_or_else(PoisonError::into_inner);
    (HANDS.get_or_init(built_in_surgeons_hands), turn)
}

/// The surgeon's session in lockstep, and both hands' motion as their devices' poses up to the break and a little on. There they
/// stay: in real time the crack may need longer to get so far.
fn built_in_surgeons_hands() -> Hands {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let args = ["run", SCENARIO, "--out", "surgeon", "--json"];
    let metrics = json(&osteotome(folder, &[], &args));
    let time = metrics["split"]["time_s"]
        .as_f64()
        .expect("the surgeon splits it");
    let n_steps = (1e3 * time) as usize;
    let bytes = std::fs::read(folder.join("surgeon/session.mcap")).expect("a recording");
    let mut hands = [vec![], vec![]];
    for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
        let message = message.expect("a message");
        let topics = ["/haptic/left", "/haptic/right"];
        let Some(i) = topics.iter().position(|t| *t == message.channel.topic) else {
            continue;
        };
        let sample: Value = serde_json::from_slice(&message.data).expect("JSON");
        let n = |of: &str, key: &str| sample["device_pose"][of][key].as_f64().expect("a number");
        let place = Vector3::from(["x", "y", "z"].map(|k| n("position", k)));
        let [w, x, y, z] = ["w", "x", "y", "z"].map(|k| n("orientation", k));
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        hands[i].push(Isometry3::from_parts(place.into(), turn));
    }
    hands.map(|poses| {
        let start = poses[0];
        let relative = |p: &Isometry3<f64>| {
            let moved = p.translation.vector - start.translation.vector;
            Isometry3::from_parts(moved.into(), p.rotation * start.rotation.inverse())
        };
        let slowly = |p| std::iter::repeat_n(relative(p), SLOWNESS);
        going_on(&poses[..n_steps])
            .iter()
            .flat_map(slowly)
            .collect()
    })
}

/// The poses, and the last .3 s of motion three times more: in real time the crack may ask for more than in lockstep.
fn going_on(poses: &[Isometry3<f64>]) -> Vec<Isometry3<f64>> {
    const STEPS: usize = 300;
    let [before, last] = [poses[poses.len() - 1 - STEPS], poses[poses.len() - 1]];
    let moved = last.translation.vector - before.translation.vector;
    let turned = last.rotation * before.rotation.inverse();
    let further = (1..=3 * STEPS).map(|i| {
        let share = i as f64 / STEPS as f64;
        let place = last.translation.vector + moved * share;
        Isometry3::from_parts(place.into(), turned.powf(share) * last.rotation)
    });
    poses.iter().copied().chain(further).collect()
}

fn split_by(
    folder: &Path,
    found: &[(&str, &Path)],
    devices: [&str; 2],
    seconds: f64,
) -> (Value, Vec<String>) {
    let sets = [0, 1].map(|i| format!("tool.{i}.device={:?}", devices[i]));
    let time = format!("{seconds:.1}");
    let args = [
        "run",
        SCENARIO,
        "--mode",
        "realtime",
        "--json",
        "--out",
        "out",
        "--max-time",
        &time,
        "--set",
        &sets[0],
        "--set",
        &sets[1],
    ];
    let metrics = json(&osteotome(folder, found, &args));
    let bytes = std::fs::read(folder.join("out/session.mcap")).expect("a recording");
    let messages = mcap::MessageStream::new(&bytes).expect("an MCAP file");
    let messages = messages.map(|m| m.expect("a message"));
    let events = messages
        .filter(|m| m.channel.topic == "/event")
        .map(|m| text(&m.data))
        .collect();
    (metrics, events)
}

/// `to_vendor`: from our frame to the vendor's.
fn transforms(poses: &[Isometry3<f64>], to_vendor: &Matrix3<f64>) -> Vec<u8> {
    let bytes = |pose: &Isometry3<f64>| {
        let turn = to_vendor * pose.rotation.to_rotation_matrix() * to_vendor.transpose();
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        m.fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&(to_vendor * pose.translation.vector));
        m.as_slice()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    poses.iter().flat_map(bytes).collect()
}

/// For a crack that lags behind the hands, and for a pause \[s\].
const PATIENCE: f64 = 12.0;

fn length(hands: &Hands) -> f64 {
    hands[0].len() as f64 * 1e-3
}

/// A whole split, with the right device unplugged for a while in its midst.
fn splits(library: &str, variable: &str, devices: [&str; 2], to_vendor: &Matrix3<f64>) {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (hands, _turn) = surgeons_hands();
    let files = [0, 1].map(|i| {
        let file = folder.join(format!("hand{i}.bin"));
        std::fs::write(&file, transforms(&hands[i], to_vendor)).expect("written");
        file
    });
    let library = build(library, folder);
    let found = [
        (variable, library.as_path()),
        ("STANDIN_POSES_0", &files[0]),
        ("STANDIN_POSES_1", &files[1]),
        ("STANDIN_GO", Path::new("out.partial")),
        ("STANDIN_UNPLUG", Path::new("2000:700")),
    ];
    let (metrics, events) = split_by(folder, &found, devices, length(hands) + PATIENCE);
    let told = |part: &str| events.iter().any(|e| e.contains(part));
    assert!(
        told("the right device: unplugged") && told("the right device is back"),
        "{events:?}"
    );
    assert_eq!(metrics["split"]["complete"], true, "{events:?} {metrics}");
}

#[test]
fn openhaptics_drives_a_whole_split() {
    if is_long() {
        // x right, y up, z to the user
        let to_vendor = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0);
        let devices = ["openhaptics:SN-1001", "openhaptics:SN-2002"];
        splits("libHD", "OSTEOTOME_LIBHD", devices, &to_vendor);
    }
}

#[test]
fn force_dimension_drives_a_whole_split() {
    if is_long() {
        // x to the user, y right, z up
        let to_vendor = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let devices = ["forcedimension:7001", "forcedimension:3002"];
        splits("libdhd", "OSTEOTOME_LIBDHD", devices, &to_vendor);
    }
}

/// A whole split by two Inverse3s with grips, of either version; in its midst the service talks nonsense, has no devices, falls silent and
/// goes away.
fn haply_splits(is_new: bool) {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (hands, _turn) = surgeons_hands();
    let (service, address) = haply_service::start(is_new);
    let poses = |hand: &Vec<Isometry3<f64>>| {
        let pose = |p: &Isometry3<f64>| (p.translation.vector.into(), p.rotation.coords.into());
        hand.iter().map(pose).collect()
    };
    service.lock().expect("a service").script = Some(Script {
        hands: hands.each_ref().map(poses),
        go: folder.join("out.partial"),
        troubles: vec![
            (8000, Mood::Closing, 1),
            (6000, Mood::Stalled, 1),
            (4000, Mood::WithoutDevice, 700),
            (2000, Mood::Malformed, 100),
        ],
        has_begun: false,
        played: 0,
    });
    let found = [("OSTEOTOME_HAPLY", Path::new(&address))];
    let devices = ["haply:049D", "haply:05DA"];
    let (metrics, events) = split_by(folder, &found, devices, length(hands) + PATIENCE);
    for what in [
        "could not be understood",
        "unplugged",
        "no new reading",
        "connection was interrupted",
        "the right device is back",
    ] {
        assert!(
            events.iter().any(|e| e.contains(what)),
            "{what}: {events:?}"
        );
    }
    assert!(service.lock().expect("a service").n_connections >= 3);
    assert_eq!(metrics["split"]["complete"], true, "{events:?} {metrics}");
}

#[test]
fn haply_3_5_drives_a_whole_split() {
    if is_long() {
        haply_splits(true);
    }
}

#[test]
fn haply_3_1_drives_a_whole_split() {
    if is_long() {
        haply_splits(false);
    }
}

/// A process that is ended with the test.
struct Client(Child);

impl Drop for Client {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The example client; each hand is a port, and a file to follow.
fn python(folder: &Path, hands: &[(String, Option<PathBuf>)]) -> Client {
    let mut command = Command::new("python3");
    command.current_dir(folder).arg(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/remote_hand.py"
    ));
    command.args(["--seconds", "600"]);
    for (port, file) in hands {
        let file = file
            .as_ref()
            .map_or_else(String::new, |f| format!(":{}", f.display()));
        command.arg("--hand").arg(format!("{port}{file}"));
    }
    command.stdout(std::process::Stdio::null());
    Client(command.spawn().expect("python3 runs"))
}

/// Ports that were free a moment ago.
fn free_ports() -> [String; 2] {
    let socket = || std::net::UdpSocket::bind("127.0.0.1:0").expect("a port");
    let sockets = [socket(), socket()];
    sockets.map(|s| s.local_addr().expect("bound").port().to_string())
}

#[test]
fn the_python_client_is_understood() {
    let folder = tempfile::tempdir().expect("a folder");
    let [port, _] = free_ports();
    let _client = python(folder.path(), &[(port.clone(), None)]);
    let device = format!("remote:{port}");
    let args = [
        "devices",
        "--test",
        "--seconds",
        "0.5",
        "--json",
        "--device",
        &device,
    ];
    let report = json(&osteotome(folder.path(), &[], &args));
    let found = &report["devices"][0];
    assert_eq!(found["device"], format!("remote:127.0.0.1:{port}"));
    assert_eq!(found["fault"], Value::Null, "poses came");
    let test = &found["test"];
    assert!(test["rate_hz"].as_f64().expect("a rate") > 0.0, "{test}");
    assert!(
        test["device_to_device_us"][0].is_u64(),
        "wrenches went: {test}"
    );
}

#[test]
fn the_python_client_drives_a_whole_split() {
    if !is_long() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (hands, _turn) = surgeons_hands();
    let ports = free_ports();
    let led = [0, 1].map(|i| {
        let file = folder.join(format!("hand{i}.csv"));
        let line = |p: &Isometry3<f64>| {
            let (t, q) = (p.translation.vector, p.rotation.coords);
            format!("{} {} {} {} {} {} {}\n", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
        };
        std::fs::write(&file, hands[i].iter().map(line).collect::<String>()).expect("written");
        (ports[i].clone(), Some(file))
    });
    let _client = python(folder, &led);
    let devices = [0, 1].map(|i| format!("remote:{}", ports[i]));
    let (metrics, events) = split_by(
        folder,
        &[],
        devices.each_ref().map(String::as_str),
        length(hands) + PATIENCE,
    );
    assert_eq!(
        metrics["split"]["complete"],
        true,
        "{} events, {metrics}",
        events.len()
    );
}
