//! Both vendors' drivers against stand-ins for their libraries. Each test is a process's worth of one library: they run in
//! turn, each on a copy of its own.
#![allow(unsafe_code)]
mod standin;

use osteotome_devices::{
    DeviceFault, HapticDevice, LinkedDevice, OpenError, OperatedDevice, Pose, Remedy, Vec3,
    Workspace, Wrench, force_dimension, openhaptics,
};
use standin::{Strings, build, until};
use std::sync::Mutex;

/// One driver, what its library is called, and which variable points to it.
struct Vendor {
    name: &'static str,
    variable: &'static str,
    connect: fn() -> Result<Vec<LinkedDevice>, OpenError>,
    serials: [&'static str; 2],
    /// Vendor's x, y, z in our frame.
    axes: [Vec3; 3],
}

const OPENHAPTICS: Vendor = Vendor {
    name: "libHD",
    variable: "OSTEOTOME_LIBHD",
    connect: openhaptics::connect,
    serials: ["SN-1001", "SN-2002"],
    axes: [
        Vec3::new(1.0, 0.0, 0.0),
        Vec3::new(0.0, 0.0, 1.0),
        Vec3::new(0.0, -1.0, 0.0),
    ],
};

const FORCE_DIMENSION: Vendor = Vendor {
    name: "libdhd",
    variable: "OSTEOTOME_LIBDHD",
    connect: force_dimension::connect,
    serials: ["7001", "3002"],
    axes: [
        Vec3::new(0.0, -1.0, 0.0),
        Vec3::new(1.0, 0.0, 0.0),
        Vec3::new(0.0, 0.0, 1.0),
    ],
};

/// The environment is the whole process's.
static IN_TURN: Mutex<()> = Mutex::new(());

/// Runs a test on a fresh copy of the stand-in.
fn with(
    vendor: &Vendor,
    prepare: impl Fn(&Strings),
    test: impl Fn(&Strings, Result<Vec<LinkedDevice>, OpenError>),
) {
    let _turn = IN_TURN
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    let folder = tempfile::tempdir().expect("a folder");
    let library = build(vendor.name, folder.path());
    let strings = Strings::of(&library);
    prepare(&strings);
    // SAFETY: tests of this file run in turn, and no other thread reads the environment meanwhile.
    unsafe { std::env::set_var(vendor.variable, &library) };
    test(&strings, (vendor.connect)());
}

fn push(x: f64, y: f64, z: f64) -> Wrench {
    Wrench {
        force: Vec3::new(x, y, z),
        torque: Vec3::new(10.0 * x, 10.0 * y, 10.0 * z),
    }
}

/// Reads and writes until the device displays it.
fn show(device: &mut LinkedDevice, wrench: &Wrench, strings: &Strings, at: i32) -> Vec3 {
    until("a force is displayed", || {
        device.read();
        device.write(wrench).is_ok() && strings.shown(at)[..3].iter().any(|f| *f != 0.0)
    });
    Vec3::from_column_slice(&strings.shown(at)[..3])
}

fn drives_two_devices_independently(vendor: &Vendor) {
    with(
        vendor,
        |_| {},
        |strings, devices| {
            let mut devices = devices.expect("both open");
            let serials: Vec<_> = devices
                .iter()
                .map(|d| d.specification().serial.clone())
                .collect();
            assert_eq!(serials, vendor.serials);
            let wrenches = [push(0.5, -1.0, 2.0), push(-2.0, 0.25, 0.5)];
            for (i, (device, wrench)) in devices.iter_mut().zip(&wrenches).enumerate() {
                let shown = show(device, wrench, strings, i as i32);
                let ours: Vec3 = (0..3).map(|k| vendor.axes[k] * shown[k]).sum();
                assert!((ours - wrench.force).norm() < 1e-12, "{ours}");
            }
            for (i, device) in devices.iter_mut().enumerate() {
                let goal = [3.0 + i as f64, -2.0, 5.0];
                strings.lead(i as i32, goal);
                let expected: Vec3 = (0..3).map(|k| vendor.axes[k] * goal[k]).sum();
                until("the hand has arrived", || {
                    let pose = device.read().pose;
                    let _ = device.write(&Wrench::default());
                    (pose.translation.vector - expected).norm() < 1e-3
                        && pose.rotation.angle() < 1e-6
                });
                strings.set("buttons", i as i32, 2);
                until("a button is seen", || device.read().buttons == 2);
                assert_eq!(device.health().fault, None);
                assert!(device.latency().n() > 0);
            }
        },
    );
}

#[test]
fn openhaptics_drives_two_devices_independently() {
    drives_two_devices_independently(&OPENHAPTICS);
}

#[test]
fn force_dimension_drives_two_devices_independently() {
    drives_two_devices_independently(&FORCE_DIMENSION);
}

/// A session's tick with both hands: as the haptic loop does it.
fn tick(hands: &mut [OperatedDevice]) -> Vec<Pose> {
    hands.iter_mut().for_each(OperatedDevice::poll);
    let is_paused = hands.iter().any(|h| h.fault().is_some());
    let poses = hands.iter_mut().map(|h| h.follow(is_paused).pose).collect();
    for hand in hands {
        let _ = hand.write(&push(0.0, 1.0, 0.0));
    }
    poses
}

fn survives_unplugging(vendor: &Vendor) {
    with(
        vendor,
        |_| {},
        |strings, devices| {
            let workspace = Workspace::at(Pose::identity());
            let operated = |d| OperatedDevice::new(Box::new(d), workspace.clone(), 1e-3);
            let mut hands: Vec<_> = devices
                .expect("both open")
                .into_iter()
                .map(operated)
                .collect();
            let shows = |i| strings.shown(i)[..3].iter().any(|f| *f != 0.0);
            until("both display", || {
                tick(&mut hands);
                shows(0) && shows(1)
            });
            strings.set("plug", 1, 0);
            until("both are silent", || {
                tick(&mut hands);
                hands[1].fault() == Some(DeviceFault::Unplugged) && !shows(0) && !shows(1)
            });
            let stood = tick(&mut hands);
            strings.lead(0, [30.0, 0.0, 0.0]);
            strings.lead(1, [-20.0, 0.0, 0.0]);
            for _ in 0..300 {
                std::thread::sleep(std::time::Duration::from_millis(1));
                assert_eq!(tick(&mut hands), stood, "the tools stand");
                assert!(!shows(0) && !shows(1));
            }
            strings.set("plug", 1, 1);
            let mut before = stood;
            until("both display again", || {
                let poses = tick(&mut hands);
                for (a, b) in poses.iter().zip(&before) {
                    let jump = (a.translation.vector - b.translation.vector).norm();
                    assert!(jump < 15.0, "{jump} mm: not eased in");
                }
                before = poses;
                shows(0) && shows(1)
            });
            let faults: Vec<_> = hands[1].events().iter().map(|e| e.fault).collect();
            assert!(faults.contains(&Some(DeviceFault::Unplugged)), "{faults:?}");
            assert_eq!(faults.last(), Some(&None), "went on");
        },
    );
}

#[test]
fn openhaptics_survives_unplugging() {
    survives_unplugging(&OPENHAPTICS);
}

#[test]
fn force_dimension_survives_unplugging() {
    survives_unplugging(&FORCE_DIMENSION);
}

/// A fault on command shows as itself and displays zero; without it the device works again.
fn reports(vendor: &Vendor, string: &str, value: i32, ok: i32, fault: DeviceFault, remedy: Remedy) {
    with(
        vendor,
        |_| {},
        |strings, devices| {
            let mut devices = devices.expect("both open");
            show(&mut devices[0], &push(0.0, 1.0, 0.0), strings, 0);
            strings.set(string, 0, value);
            until("the fault is reported", || {
                devices[0].read();
                devices[0].write(&push(0.0, 1.0, 0.0)) == Err(fault)
            });
            until("and displays zero", || strings.shown(0)[..3] == [0.0; 3]);
            assert_eq!(fault.remedy(), remedy);
            strings.set(string, 0, ok);
            show(&mut devices[0], &push(0.0, 1.0, 0.0), strings, 0);
        },
    );
}

#[test]
fn openhaptics_reports_what_is_wrong() {
    let v = &OPENHAPTICS;
    reports(v, "overheat", 1, 0, DeviceFault::WarmMotors, Remedy::Retry);
    reports(v, "exceed", 1, 0, DeviceFault::ForceExceeded, Remedy::Retry);
    reports(v, "defect", 1, 0, DeviceFault::Defect, Remedy::Gone);
    reports(
        v,
        "calibration",
        2,
        0,
        DeviceFault::Uncalibrated,
        Remedy::Recalibrate,
    );
}

#[test]
fn force_dimension_reports_what_is_wrong() {
    let v = &FORCE_DIMENSION;
    reports(v, "defect", 1, 0, DeviceFault::Defect, Remedy::Gone);
    reports(
        v,
        "calibration",
        2,
        0,
        DeviceFault::Uncalibrated,
        Remedy::Recalibrate,
    );
}

#[test]
fn a_calibration_that_only_needs_an_update_is_updated() {
    with(
        &OPENHAPTICS,
        |s| s.set("calibration", 0, 1),
        |strings, devices| {
            let mut devices = devices.expect("both open");
            show(&mut devices[0], &push(0.0, 1.0, 0.0), strings, 0);
        },
    );
}

#[test]
fn motor_temperature_is_told() {
    with(
        &OPENHAPTICS,
        |_| {},
        |_, devices| {
            let devices = devices.expect("both open");
            until("it is told", || {
                devices[0].health().motor_temperature == Some(0.25)
            });
        },
    );
}

#[test]
fn a_wrong_licence_or_no_device_is_said() {
    with(
        &OPENHAPTICS,
        |s| s.set("licence", 0, 0),
        |_, devices| {
            let text = devices.err().expect("refused").to_string();
            assert!(text.contains("licence"), "{text}");
        },
    );
    let unplug = |s: &Strings| (0..2).for_each(|i| s.set("plug", i, 0));
    with(&OPENHAPTICS, unplug, |_, devices| {
        let text = devices.err().expect("refused").to_string();
        assert!(
            text.contains("HD_COMM_ERROR") && text.contains("0x302"),
            "{text}"
        );
    });
    with(&FORCE_DIMENSION, unplug, |_, devices| {
        let text = devices.err().expect("refused").to_string();
        assert!(text.contains("device not available"), "{text}");
    });
}

#[test]
fn devices_open_again_after_they_were_dropped() {
    with(
        &OPENHAPTICS,
        |_| {},
        |strings, devices| {
            drop(devices.expect("both open"));
            let mut devices = openhaptics::connect().expect("both open again");
            show(&mut devices[1], &push(0.0, 1.0, 0.0), strings, 1);
        },
    );
}

#[test]
fn a_missing_library_is_named_with_where_it_was_sought() {
    let _turn = IN_TURN
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    for vendor in [OPENHAPTICS, FORCE_DIMENSION] {
        // SAFETY: as in `with`.
        unsafe { std::env::set_var(vendor.variable, "/nowhere/lib.so") };
        let text = (vendor.connect)().err().expect("refused").to_string();
        for part in [vendor.name, "/nowhere/lib.so", vendor.variable] {
            assert!(text.contains(part), "{text}");
        }
    }
}
