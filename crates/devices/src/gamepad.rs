//! Gamepads, through gilrs. Left stick: right and away; right stick: up and about the upright axis; shoulder buttons: pitch.
//! Six degrees of freedom less roll in, none out.
use crate::link::{DriverEnd, DriverThread, link};
use crate::puck::Puck;
use crate::{DeviceFault, LinkedDevice, OpenError, Specification, Vec3};
use gilrs::{Axis, Button, Gamepad, GamepadId, Gilrs};
use std::sync::Arc;
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(2);
const STALE: Duration = Duration::from_millis(50);
/// \[mm/s\], \[rad/s\] at full deflection.
const SPEED: f64 = 50.0;
const SPIN: f64 = 1.0;
const BUTTONS: [Button; 4] = [Button::South, Button::East, Button::West, Button::North];

/// Opens all gamepads that are there. Serial numbers: gilrs's numbers.
///
/// # Errors
/// The system's input cannot be read, or there is no gamepad.
pub fn connect() -> Result<Vec<LinkedDevice>, OpenError> {
    let refused = |message: String| OpenError::Refused {
        driver: "gamepad",
        message,
    };
    let gilrs = Gilrs::new().map_err(|e| refused(e.to_string()))?;
    let thread = Arc::new(DriverThread::default());
    let pads = gilrs.gamepads();
    let (devices, arms): (Vec<_>, Vec<_>) =
        pads.map(|(id, pad)| open(id, &pad, thread.clone())).unzip();
    if devices.is_empty() {
        return Err(refused("no gamepad is connected".to_owned()));
    }
    // gilrs cannot be sent to a thread on every system: each thread makes its own.
    drop(gilrs);
    thread.start("gamepad", move || serve(arms))?;
    Ok(devices)
}

struct Arm {
    id: GamepadId,
    end: DriverEnd,
    puck: Puck,
}

fn open(id: GamepadId, pad: &Gamepad<'_>, thread: Arc<DriverThread>) -> (LinkedDevice, Arm) {
    let specification = Specification {
        model: pad.name().to_owned(),
        serial: id.to_string(),
        dofs_in: 5,
        ..Specification::default()
    };
    let (device, end) = link(specification, STALE, thread);
    (
        device,
        Arm {
            id,
            end,
            puck: Puck::default(),
        },
    )
}

fn serve(mut arms: Vec<Arm>) {
    let Ok(mut gilrs) = Gilrs::new() else {
        return arms
            .iter()
            .for_each(|a| a.end.set_fault(Some(DeviceFault::Unplugged)));
    };
    let mut before = Instant::now();
    while !arms.iter().all(|a| a.end.is_abandoned()) {
        while gilrs.next_event().is_some() {}
        let dt = before.elapsed().as_secs_f64().min(0.02);
        before = Instant::now();
        for arm in &mut arms {
            let pad = gilrs.connected_gamepad(arm.id);
            arm.end
                .set_fault(pad.is_none().then_some(DeviceFault::Unplugged));
            if let Some(pad) = pad {
                let (velocity, spin, buttons) = deflection(&pad);
                // Always finite: axes are within -1 to 1.
                let _ = arm
                    .end
                    .publish(arm.puck.advance(velocity, spin, buttons, dt));
            }
            arm.end.wrench();
        }
        std::thread::sleep(PERIOD);
    }
}

fn deflection(pad: &Gamepad<'_>) -> (Vec3, Vec3, u32) {
    let axis = |a| f64::from(pad.value(a));
    let held = |b| f64::from(u8::from(pad.is_pressed(b)));
    let pitch = held(Button::RightTrigger) - held(Button::LeftTrigger);
    let velocity = Vec3::new(
        axis(Axis::LeftStickX),
        axis(Axis::LeftStickY),
        axis(Axis::RightStickY),
    );
    let spin = Vec3::new(pitch, 0.0, -axis(Axis::RightStickX));
    let pressed = (0..BUTTONS.len()).filter(|i| pad.is_pressed(BUTTONS[*i]));
    (SPEED * velocity, SPIN * spin, pressed.map(|i| 1 << i).sum())
}
