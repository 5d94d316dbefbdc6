//! Gamepads of other systems than Linux, through gilrs.
use super::{Controls, Present};
use crate::OpenError;
use gilrs::{Axis, Button, Gamepad, GamepadId, Gilrs};

const BUTTONS: [Button; 4] = [Button::South, Button::East, Button::West, Button::North];

/// All of them.
pub(super) struct Pads(Result<Gilrs, String>);

impl Default for Pads {
    fn default() -> Self {
        Self(Gilrs::new().map_err(|e| e.to_string()))
    }
}

impl Pads {
    /// Those that are there.
    pub(super) fn present(&mut self) -> Result<Vec<Present>, OpenError> {
        let refused = |message: String| OpenError::Refused {
            driver: "gamepad",
            message,
        };
        let gilrs = self.0.as_ref().map_err(|e| refused(e.clone()))?;
        let present = |(id, pad): (GamepadId, Gamepad<'_>)| Present {
            number: id.into(),
            name: pad.name().to_owned(),
        };
        let present: Vec<_> = gilrs.gamepads().map(present).collect();
        if present.is_empty() {
            return Err(refused("no gamepad is connected".to_owned()));
        }
        Ok(present)
    }

    /// What is held on one of them; `None` while it is unplugged.
    pub(super) fn held(&mut self, wanted: &Present) -> Option<Controls> {
        let gilrs = self.0.as_mut().ok()?;
        while gilrs.next_event().is_some() {}
        let is_it = |(id, _): &(GamepadId, Gamepad<'_>)| usize::from(*id) == wanted.number;
        gilrs.gamepads().find(is_it).map(|(_, pad)| controls(&pad))
    }
}

fn controls(pad: &Gamepad<'_>) -> Controls {
    let axis = |a| f64::from(pad.value(a));
    let pressed = (0..BUTTONS.len()).filter(|i| pad.is_pressed(BUTTONS[*i]));
    Controls {
        sticks: [
            [axis(Axis::LeftStickX), axis(Axis::LeftStickY)],
            [axis(Axis::RightStickX), axis(Axis::RightStickY)],
        ],
        shoulders: [Button::LeftTrigger, Button::RightTrigger].map(|b| pad.is_pressed(b)),
        buttons: pressed.map(|i| 1 << i).sum(),
    }
}
