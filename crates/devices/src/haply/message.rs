//! The messages of Haply's service that are used, versions 3.1 to 3.5.
use crate::{Pose, Reading, Vec3};
use nalgebra::{Quaternion, UnitQuaternion};
use serde::Deserialize;
use serde_json::{Value, json};

const MM: f64 = 1e-3; // m

/// What the service tells: at first of everything, later of what has changed.
#[derive(Debug, Deserialize)]
pub(super) struct Message {
    #[serde(default)]
    inverse3: Vec<Device>,
    #[serde(default)]
    verse_grip: Vec<Grip>,
    #[serde(default)]
    wireless_verse_grip: Vec<Grip>,
}

#[derive(Debug, Deserialize)]
struct Device {
    device_id: String,
    state: Option<State>,
    #[serde(default)]
    config: Value,
}

#[derive(Debug, Deserialize)]
struct State {
    cursor_position: Vector,
    cursor_velocity: Option<Vector>,
    control_mode: Option<Value>,
}

#[derive(Debug, Deserialize)]
struct Grip {
    state: Option<GripState>,
}

#[derive(Debug, Deserialize)]
struct GripState {
    orientation: Turn,
    /// Of a grip with one button.
    #[serde(default)]
    button: bool,
    /// Of one with several, by name.
    #[serde(default)]
    buttons: serde_json::Map<String, Value>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

impl From<Vector> for Vec3 {
    fn from(v: Vector) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
struct Turn {
    w: f64,
    x: f64,
    y: f64,
    z: f64,
}

/// How a force is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dialect {
    /// `"values"`.
    V31,
    /// `"vector"`.
    V35,
}

impl Message {
    pub(super) fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    pub(super) fn device_ids(&self) -> Vec<String> {
        self.inverse3.iter().map(|d| d.device_id.clone()).collect()
    }

    /// By what only version 3.5 tells in its first message.
    pub(super) fn dialect(&self) -> Dialect {
        let is_new = |d: &Device| {
            d.config.get("basis").is_some()
                || d.state.as_ref().is_some_and(|s| s.control_mode.is_some())
        };
        if self.inverse3.iter().any(is_new) {
            Dialect::V35
        } else {
            Dialect::V31
        }
    }

    /// Of the `index`-th device; the grips belong to the devices in their order. Our frame is the service's: x right, y
    /// away, z up, and a grip's shaft points along its y. `None`: the message does not speak of the device.
    pub(super) fn reading(&self, index: usize, id: &str) -> Option<Reading> {
        let device = self.inverse3.iter().find(|d| d.device_id == id)?;
        let state = device.state.as_ref()?;
        let grips = self.wireless_verse_grip.iter().chain(&self.verse_grip);
        let grip = grips.filter_map(|g| g.state.as_ref()).nth(index);
        let (turn, buttons) = grip.map_or((UnitQuaternion::identity(), 0), grip_reading);
        Some(Reading {
            pose: Pose::from_parts((Vec3::from(state.cursor_position) / MM).into(), turn),
            velocity: state
                .cursor_velocity
                .map_or_else(Vec3::zeros, |v| Vec3::from(v) / MM),
            angular_velocity: Vec3::zeros(),
            buttons,
            time: 0.0,
        })
    }
}

fn grip_reading(grip: &GripState) -> (UnitQuaternion<f64>, u32) {
    let o = grip.orientation;
    let turn = Quaternion::new(o.w, o.x, o.y, o.z);
    // A grip that has not been calibrated tells zeros.
    let turn = UnitQuaternion::try_new(turn, 1e-3).unwrap_or_default();
    let named = ["a", "b", "c"].map(|n| grip.buttons.get(n).and_then(Value::as_bool));
    let mask = (0..3).filter(|i| named[*i] == Some(true)).map(|i| 1 << i);
    (turn, u32::from(grip.button) | mask.sum::<u32>())
}

/// One tick's message: a force \[N\] for each device.
pub(super) fn forces(dialect: Dialect, forces: &[(&str, Vec3)]) -> String {
    let key = match dialect {
        Dialect::V31 => "values",
        Dialect::V35 => "vector",
    };
    let devices: Vec<_> = forces
        .iter()
        .map(|(id, f)| {
            let vector = json!({"x": f.x, "y": f.y, "z": f.z});
            json!({"device_id": id, "commands": {"set_cursor_force": {key: vector}}})
        })
        .collect();
    json!({ "inverse3": devices }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_are_written_as_each_version_wants_them() {
        let write = |dialect| forces(dialect, &[("049D", Vec3::new(1.0, -0.5, 0.0))]);
        let with = |key: &str| {
            let text = format!(
                r#"{{"inverse3":[{{"commands":{{"set_cursor_force":{{"{key}":{{"x":1.0,"y":-0.5,"z":0.0}}}}}},"device_id":"049D"}}]}}"#
            );
            serde_json::from_str::<Value>(&text).unwrap()
        };
        for (dialect, key) in [(Dialect::V31, "values"), (Dialect::V35, "vector")] {
            let written: Value = serde_json::from_str(&write(dialect)).unwrap();
            assert_eq!(written, with(key));
        }
    }

    #[test]
    fn metres_become_millimetres_and_grips_go_with_their_device() {
        let text = r#"{"inverse3": [{"device_id": "A", "state": {"cursor_position": {"x": 0.01, "y": -0.12, "z": 0.15}}}],
            "verse_grip": [{"state": {"orientation": {"w": 0.0, "x": 0.0, "y": 0.0, "z": 1.0}, "button": true, "hall": 1}}]}"#;
        let message = Message::parse(text).unwrap();
        let reading = message.reading(0, "A").unwrap();
        let place = reading.pose.translation.vector;
        assert!((place - Vec3::new(10.0, -120.0, 150.0)).norm() < 1e-9);
        assert!((reading.pose.rotation.angle() - std::f64::consts::PI).abs() < 1e-9);
        assert_eq!(reading.buttons, 1);
        assert_eq!(message.reading(0, "B"), None);
        assert_eq!(message.dialect(), Dialect::V31);
    }
}
