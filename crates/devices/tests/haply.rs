//! Haply's driver against a stand-in for its service: a WebSocket server that answers each message with the devices' state.
mod standin;

use osteotome_devices::{
    DeviceFault, HapticDevice, LinkedDevice, OpenError, OperatedDevice, Pose, Vec3, Workspace,
    Wrench, haply,
};
use serde_json::json;
use standin::haply_service::{Mood, Shared, start};
use std::net::TcpListener;
use std::thread::Builder;
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

fn push(x: f64, y: f64, z: f64) -> Wrench {
    Wrench {
        force: Vec3::new(x, y, z),
        torque: Vec3::zeros(),
    }
}

fn shows(device: &mut LinkedDevice, wrench: &Wrench, service: &Shared, at: usize) {
    until("the force is displayed", || {
        device.read();
        let _ = device.write(wrench);
        service.lock().unwrap().shown[at] == <[f64; 3]>::from(wrench.force)
    });
}

fn drives_two(is_new: bool, buttons: u32) {
    let (service, address) = start(is_new);
    let mut devices = haply::connect_to(&address).unwrap();
    let serials: Vec<_> = devices
        .iter()
        .map(|d| d.specification().serial.clone())
        .collect();
    assert_eq!(serials, ["049D", "05DA"]);
    let wrenches = [push(1.0, 0.5, -2.0), push(-3.0, 0.25, 4.0)];
    for i in 0..2 {
        shows(&mut devices[i], &wrenches[i], &service, i);
        until("the place is read", || {
            let expected = wrenches[i].force + Vec3::new(0.0, 100.0, 0.0);
            let place = devices[i].read().pose.translation.vector;
            let _ = devices[i].write(&wrenches[i]);
            (place - expected).norm() < 1e-9
        });
    }
    assert_eq!(devices[0].read().buttons, buttons);
    assert!(devices[0].latency().n() > 0);
    drop(devices);
    until("it ends with zero", || {
        service.lock().unwrap().shown == [[0.0; 3]; 2]
    });
}

#[test]
fn version_3_5_drives_two_devices() {
    drives_two(true, 2);
}

#[test]
fn version_3_1_drives_two_devices() {
    drives_two(false, 1);
}

/// Whatever the service does, the hands feel nothing and the tools stand; when it is well again, they go on.
#[test]
fn nonsense_and_stalls_give_zero_and_a_clean_resume() {
    let (service, address) = start(true);
    let mut devices = haply::connect_to(&address).unwrap();
    let second = devices.pop();
    let workspace = Workspace::at(Pose::identity());
    let mut hand = OperatedDevice::new(Box::new(devices.pop().unwrap()), workspace, 1e-3);
    let mut tick = || {
        hand.poll();
        let pose = hand.follow(false).pose;
        let _ = hand.write(&push(0.0, 1.0, 0.0));
        (pose, hand.fault())
    };
    let shown = || service.lock().unwrap().shown[0] != [0.0; 3];
    for (mood, fault) in [
        (Mood::Malformed, DeviceFault::Malformed),
        (Mood::WrongTypes, DeviceFault::Malformed),
        (Mood::NotFinite, DeviceFault::Malformed),
        (Mood::WithoutDevice, DeviceFault::Unplugged),
        (Mood::Binary, DeviceFault::Communication),
        (Mood::Stalled, DeviceFault::Stale),
        (Mood::Closing, DeviceFault::Communication),
    ] {
        until("it displays", || {
            tick();
            shown()
        });
        service.lock().unwrap().mood = mood;
        let mut stood = None;
        until("it pauses for this reason", || {
            let (pose, found) = tick();
            if found.is_some() {
                let place = stood.get_or_insert(pose);
                assert_eq!(*place, pose, "the tool stands");
            }
            found == Some(fault)
        });
        until("it displays zero", || {
            tick();
            !shown()
        });
        service.lock().unwrap().mood = Mood::Well;
    }
    until("it displays again", || {
        tick();
        shown()
    });
    assert!(
        service.lock().unwrap().n_connections >= 3,
        "stall, closing, binary: anew"
    );
    drop(second);
}

#[test]
fn a_service_that_is_not_there_or_has_no_device_is_said() {
    let free = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let text = haply::connect_to(&free.to_string())
        .err()
        .unwrap()
        .to_string();
    assert!(
        text.contains("Inverse service") && text.contains(&free.to_string()),
        "{text}"
    );
    assert!(!text.contains('\n'));

    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let run = move || {
        let mut socket = tungstenite::accept(listener.accept().unwrap().0).unwrap();
        socket
            .send(json!({"session_id": 1, "inverse3": []}).to_string().into())
            .unwrap();
        let _ = socket.read();
    };
    Builder::new().name("service".into()).spawn(run).unwrap();
    let refusal = haply::connect_to(&address).err().unwrap();
    assert!(matches!(refusal, OpenError::Refused { .. }), "{refusal}");
}
