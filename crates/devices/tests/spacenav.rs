//! The SpaceMouse's driver against a stand-in for spacenavd, and against the real one where it is installed.
#![cfg(unix)]
use osteotome_devices::{DeviceFault, HapticDevice, LinkedDevice, Vec3, Wrench, spacenav};
use std::io::Write;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "still not: {what}"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn is_well(device: &mut LinkedDevice) -> bool {
    device.read();
    device.health().fault.is_none()
}

fn event(words: [i32; 8]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_ne_bytes()).collect()
}

#[test]
fn deflection_moves_and_buttons_are_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("spnav.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let mut device = spacenav::connect_to(&path).unwrap();
    let mut daemon = listener.accept().unwrap().0;
    until("at rest, it reads", || is_well(&mut device));
    assert_eq!(device.read().pose.translation.vector, Vec3::zeros());

    // Away (z) and up (y), in two halves; then a button, and an event of a kind that is not known.
    let motion = event([0, 0, 100, 200, 0, 0, 0, 8]);
    daemon.write_all(&motion[..13]).unwrap();
    daemon.write_all(&motion[13..]).unwrap();
    daemon.write_all(&event([9, 1, 2, 3, 4, 5, 6, 7])).unwrap();
    daemon.write_all(&event([1, 3, 0, 0, 0, 0, 0, 0])).unwrap();
    daemon.write_all(&event([1, -7, 0, 0, 0, 0, 0, 0])).unwrap();
    until("it moves and the button is down", || {
        let reading = device.read();
        let place = reading.pose.translation.vector;
        place.y > 0.5 && (place.y - 2.0 * place.z).abs() < 1e-9 && reading.buttons == 8
    });
    daemon.write_all(&event([2, 3, 0, 0, 0, 0, 0, 0])).unwrap();
    until("silent, it comes to rest", || {
        let reading = device.read();
        reading.velocity == Vec3::zeros() && reading.buttons == 0
    });
    let push = Wrench {
        force: Vec3::x(),
        torque: Vec3::zeros(),
    };
    until("it takes a wrench and shows none", || {
        device.read();
        device.write(&push).is_ok()
    });
    drop((daemon, listener));
    until("its end is seen", || {
        device.read();
        device.health().fault == Some(DeviceFault::Unplugged)
    });
}

#[test]
fn a_daemon_that_is_not_there_is_named() {
    let text = spacenav::connect_to(Path::new("/nowhere/spnav.sock"))
        .err()
        .unwrap()
        .to_string();
    for part in ["spacenavd", "/nowhere/spnav.sock", "SPNAV_SOCKET"] {
        assert!(text.contains(part), "{text}");
    }
}

/// Debian's spacenavd 1.1 makes its socket at `run/spnav.sock` of its working directory. `None`: it is not installed.
fn spacenavd(folder: &Path) -> Option<Child> {
    let quiet = Stdio::null;
    let child = Command::new("spacenavd")
        .args(["-d", "-c", "none", "-l", "log"])
        .current_dir(folder)
        .env_remove("DISPLAY")
        .stdout(quiet())
        .stderr(quiet())
        .spawn();
    match child {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        child => Some(child.expect("spacenavd starts")),
    }
}

#[test]
fn the_real_daemon_is_connected_to_and_may_restart() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    let socket = run.join("spnav.sock");
    let Some(mut daemon) = spacenavd(folder.path()) else {
        return;
    };
    let mut found = None;
    until("it listens", || {
        found = spacenav::connect_to(&socket).ok();
        found.is_some()
    });
    let mut device = found.unwrap();
    until("it reads", || is_well(&mut device));
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    until("its end is seen", || !is_well(&mut device));
    let _ = std::fs::remove_file(run.join("spnavd.pid"));
    let mut daemon = spacenavd(folder.path()).expect("as before");
    until("it reads again", || is_well(&mut device));
    daemon.kill().unwrap();
    daemon.wait().unwrap();
}
