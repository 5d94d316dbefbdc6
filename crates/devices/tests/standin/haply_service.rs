//! A stand-in for Haply's service: a WebSocket server that answers each message with the devices' state.
use serde_json::{Value, json};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread::Builder;
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// What the service does wrong.
#[derive(Clone, Copy, PartialEq)]
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

/// Hands that the service's devices and grips follow, a pose a message. While something is wrong they wait.
pub struct Script {
    /// Position \[mm\] and quaternion x, y, z, w.
    pub hands: [Vec<([f64; 3], [f64; 4])>; 2],
    /// Begins once there is this file.
    pub go: PathBuf,
    /// What goes wrong at which pose, for how many messages; the latest first.
    pub troubles: Vec<(usize, Mood, u32)>,
    pub has_begun: bool,
    pub played: usize,
}

impl Script {
    fn pose(&self, i: usize) -> ([f64; 3], [f64; 4]) {
        let hand = &self.hands[i];
        hand[self.played.min(hand.len() - 1)]
    }

    fn play(&mut self) -> Mood {
        self.has_begun = self.has_begun || self.go.exists();
        if let Some((at, mood, left)) = self.troubles.last_mut()
            && self.played >= *at
        {
            let mood = *mood;
            *left -= 1;
            if *left == 0 {
                self.troubles.pop();
            }
            return mood;
        }
        self.played += usize::from(self.has_begun);
        Mood::Well
    }
}

pub struct Service {
    pub script: Option<Script>,
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
        let place = match &service.script {
            Some(script) => script.pose(i).0.map(|c| c * 1e-3),
            None => [f[0] * 1e-3, 0.1 + f[1] * 1e-3, f[2] * 1e-3],
        };
        let mut state = json!({
            "cursor_position": vector(place),
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
    let grip = |i: usize| {
        let turn = service.script.as_ref().map(|s| s.pose(i).1);
        let [x, y, z, w] = turn.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let turn = json!({"w": w, "x": x, "y": y, "z": z});
        if service.is_new {
            json!({"device_id": "g", "state": {"orientation": turn, "buttons": {"a": false, "b": true, "c": false}}})
        } else {
            json!({"device_id": "g", "state": {"orientation": turn, "button": true}})
        }
    };
    let grips = if service.script.is_some() { 2 } else { 1 };
    let grips: Vec<_> = (0..grips).map(grip).collect();
    json!({"session_id": 7, "inverse3": [device(0), device(1)], "verse_grip": grips, "wireless_verse_grip": []}).to_string()
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
    // As the vendor's service; without the right to it, as it is.
    let _ = set_current_thread_priority(ThreadPriority::Max);
    let mut socket = tungstenite::accept(stream).ok()?;
    socket.get_ref().set_nodelay(true).ok()?;
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
            if let Some(script) = &mut service.script {
                service.mood = script.play();
            }
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
        script: None,
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
