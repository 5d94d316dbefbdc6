//! Haply's driver against a stand-in for its service: a WebSocket server that answers each message with the devices' state.
use osteotome_devices::{
    DeviceFault, HapticDevice, LinkedDevice, OpenError, OperatedDevice, Pose, Vec3, Workspace,
    Wrench, haply,
};
use serde_json::{Value, json};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::Builder;
use std::time::{Duration, Instant};

#[derive(Clone, Copy, PartialEq)]
enum Mood {
    Well,
    Malformed,
    Binary,
    WrongTypes,
    NotFinite,
    WithoutDevice,
    Stalled,
    Closing,
}

struct Service {
    is_new: bool,
    mood: Mood,
    /// Forces displayed, by device.
    shown: [[f64; 3]; 2],
    n_messages: u64,
    n_connections: u64,
}

type Shared = Arc<Mutex<Service>>;

fn vector(v: [f64; 3]) -> Value {
    json!({"x": v[0], "y": v[1], "z": v[2]})
}

/// As version 3.5 or 3.1 tells it; both devices give way by 1 mm a newton.
fn state(service: &Service, is_first: bool) -> String {
    let device = |i: usize| {
        let f = service.shown[i];
        let mut state = json!({
            "cursor_position": vector([f[0] * 1e-3, 0.1 + f[1] * 1e-3, f[2] * 1e-3]),
            "cursor_velocity": vector([0.0; 3]),
        });
        let mut device =
            json!({"device_id": (["049D", "05DA"][i]), "status": {"calibrated": true}});
        if service.is_new {
            state["control_mode"] = json!("idle");
            state["body_orientation"] = json!({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0});
        }
        if is_first {
            device["config"] = json!({"handedness": "right"});
        }
        if is_first && service.is_new {
            device["config"]["basis"] = json!({"permutation": "XYZ"});
        }
        device["state"] = state;
        device
    };
    let turn = json!({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0});
    let grip = if service.is_new {
        json!({"device_id": "g", "state": {"orientation": turn, "buttons": {"a": false, "b": true, "c": false}}})
    } else {
        json!({"device_id": "g", "state": {"orientation": turn, "button": true}})
    };
    json!({"session_id": 7, "inverse3": [device(0), device(1)], "verse_grip": [grip], "wireless_verse_grip": []}).to_string()
}

/// Takes the forces; a message of the other version is not understood.
fn take(service: &mut Service, text: &str) {
    let message: Value = serde_json::from_str(text).expect("a client's message is JSON");
    let key = if service.is_new { "vector" } else { "values" };
    for device in message["inverse3"].as_array().expect("a list") {
        let i = usize::from(device["device_id"] == "05DA");
        let f = &device["commands"]["set_cursor_force"][key];
        service.shown[i] =
            ["x", "y", "z"].map(|c| f[c].as_f64().expect("a force in this version's words"));
    }
    service.n_messages += 1;
}

fn serve(stream: TcpStream, shared: &Shared) -> Option<()> {
    let mut socket = tungstenite::accept(stream).ok()?;
    shared.lock().unwrap().n_connections += 1;
    let first = state(&shared.lock().unwrap(), true);
    socket.send(first.into()).ok()?;
    let result = (|| loop {
        let message = socket.read().ok()?;
        if !message.is_text() {
            continue;
        }
        let (mood, answer) = {
            let mut service = shared.lock().unwrap();
            take(&mut service, message.to_text().ok()?);
            (service.mood, state(&service, false))
        };
        let answer = match mood {
            Mood::Well => answer.into(),
            Mood::Malformed => "{\"inverse3\": [".into(),
            Mood::Binary => tungstenite::Message::binary(vec![0xff; 64]),
            Mood::WrongTypes => json!({"inverse3": {"device_id": 3}}).to_string().into(),
            Mood::NotFinite => answer.replace("0.1", "1e999").into(),
            Mood::WithoutDevice => json!({"inverse3": []}).to_string().into(),
            Mood::Stalled => continue,
            Mood::Closing => return Some(()),
        };
        socket.send(answer).ok()?;
    })();
    // A service stops pushing when its client has gone.
    shared.lock().unwrap().shown = [[0.0; 3]; 2];
    result
}

fn start(is_new: bool) -> (Shared, String) {
    let shared = Arc::new(Mutex::new(Service {
        is_new,
        mood: Mood::Well,
        shown: [[0.0; 3]; 2],
        n_messages: 0,
        n_connections: 0,
    }));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let service = shared.clone();
    let run = move || {
        for stream in listener.incoming() {
            let service = service.clone();
            let client = move || serve(stream.unwrap(), &service);
            Builder::new().name("client".into()).spawn(client).unwrap();
        }
    };
    Builder::new().name("service".into()).spawn(run).unwrap();
    (shared, address)
}

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
