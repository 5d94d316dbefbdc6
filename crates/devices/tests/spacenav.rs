//! The SpaceMouse's driver against a stand-in for spacenavd, and against the real one where it is installed.
#![cfg(unix)]
use osteotome_devices::{DeviceFault, HapticDevice, LinkedDevice, Vec3, Wrench, spacenav};
use std::io::Write;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
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

/// The installed daemon, else Debian's, fetched into `folder`. `None`: neither is to be had.
fn daemon(folder: &Path) -> Option<PathBuf> {
    let installed = std::env::var_os("PATH").unwrap_or_default();
    let mut places = std::env::split_paths(&installed).map(|p| p.join("spacenavd"));
    places.find(|p| p.exists()).or_else(|| fetched(folder))
}

/// Taken out of Debian's package where `apt-get` can fetch it; nothing is installed.
fn fetched(folder: &Path) -> Option<PathBuf> {
    let does = |command: &mut Command| {
        let command = command.current_dir(folder).stdin(Stdio::null());
        command.output().is_ok_and(|o| o.status.success())
    };
    let is_fetched = does(Command::new("apt-get").args(["download", "spacenavd"]));
    let mut files = std::fs::read_dir(folder).ok()?.flatten().map(|f| f.path());
    let package = files.find(|p| p.extension().is_some_and(|e| e == "deb"))?;
    let is_out = is_fetched && does(Command::new("dpkg").arg("-x").arg(&package).arg("package"));
    let daemon = folder.join("package/usr/bin/spacenavd");
    (is_out && daemon.exists()).then_some(daemon)
}

/// Debian's spacenavd 1.1 makes its socket at `run/spnav.sock` of its working directory.
fn spacenavd(daemon: &Path, folder: &Path) -> Child {
    let quiet = Stdio::null;
    let child = Command::new(daemon)
        .args(["-d", "-c", "none", "-l", "log"])
        .current_dir(folder)
        .env_remove("DISPLAY")
        .stdout(quiet())
        .stderr(quiet())
        .spawn();
    child.expect("spacenavd starts")
}

#[test]
#[allow(clippy::print_stderr)]
fn the_real_daemon_is_connected_to_and_may_restart() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    let socket = run.join("spnav.sock");
    let Some(program) = daemon(folder.path()) else {
        eprintln!("skipped: spacenavd is neither installed nor to be fetched by apt-get");
        return;
    };
    let mut daemon = spacenavd(&program, folder.path());
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
    let mut daemon = spacenavd(&program, folder.path());
    until("it reads again", || is_well(&mut device));
    daemon.kill().unwrap();
    daemon.wait().unwrap();
}
