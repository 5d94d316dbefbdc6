//! A stand-in for Haply's service: a WebSocket server that answers each message with the devices' state.
use serde_json::{Value, json};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::Builder;

#[derive(Clone, Copy, PartialEq)]
/// What the service does wrong.
pub enum Mood {
    Well,
    Malformed,
    Binary,
    WrongTypes,
    NotFinite,
    WithoutDevice,
    Stalled,
    Closing,
}

pub struct Service {
    is_new: bool,
    pub mood: Mood,
    /// Forces displayed, by device.
    pub shown: [[f64; 3]; 2],
    pub n_messages: u64,
    pub n_connections: u64,
}

pub type Shared = Arc<Mutex<Service>>;

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

/// A service with two devices, of version 3.5 or 3.1, on a port of its own.
pub fn start(is_new: bool) -> (Shared, String) {
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
