//! Gamepads. Left stick: right and away; right stick: up and about the upright axis; shoulder buttons: pitch. The four
//! buttons on the right are 0 (lowest), 1 (right), 2 (left), 3 (uppermost). Six degrees of freedom less roll in, none out.
//!
//! On Linux through the kernel's joystick files, which needs no library, to build or to run; elsewhere
//! through gilrs.
#[cfg(not(target_os = "linux"))]
mod elsewhere;
#[cfg(target_os = "linux")]
mod joydev;

use crate::link::{DriverEnd, DriverThread, link};
use crate::puck::Puck;
use crate::{DeviceFault, LinkedDevice, OpenError, Specification, Vec3};
#[cfg(not(target_os = "linux"))]
use elsewhere::Pads;
#[cfg(target_os = "linux")]
use joydev::Pads;
#[cfg(target_os = "linux")]
pub use joydev::Places;
use std::sync::Arc;
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(2);
const STALE: Duration = Duration::from_millis(50);
/// \[mm/s\], \[rad/s\] at full deflection.
const SPEED: f64 = 50.0;
const SPIN: f64 = 1.0;

/// What is held at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Controls {
    /// Left and right stick: to the right and up, 1 at full deflection.
    sticks: [[f64; 2]; 2],
    /// Left and right shoulder button.
    shoulders: [bool; 2],
    /// One bit each of the four buttons.
    buttons: u32,
}

impl Controls {
    fn velocity(&self) -> Vec3 {
        let [[right, away], [_, up]] = self.sticks;
        SPEED * Vec3::new(right, away, up)
    }

    fn spin(&self) -> Vec3 {
        let [left, right] = self.shoulders.map(|held| f64::from(u8::from(held)));
        SPIN * Vec3::new(right - left, 0.0, -self.sticks[1][0])
    }
}

/// A gamepad that is there.
struct Present {
    /// The system's number of it; it keeps it over a replug where nothing else has taken it.
    number: usize,
    name: String,
}

/// Opens all gamepads that are there. Serial numbers: the system's numbers.
///
/// # Errors
/// There is no gamepad, or none that may be read.
pub fn connect() -> Result<Vec<LinkedDevice>, OpenError> {
    connect_through(Pads::default)
}

/// Likewise those under other folders than the system's.
///
/// # Errors
/// As [`connect`].
#[cfg(target_os = "linux")]
pub fn connect_in(places: Places) -> Result<Vec<LinkedDevice>, OpenError> {
    connect_through(move || Pads::within(places.clone()))
}

/// What reads gamepads cannot be sent to a thread on every system: each thread makes its own.
fn connect_through(
    pads: impl Fn() -> Pads + Send + 'static,
) -> Result<Vec<LinkedDevice>, OpenError> {
    let present = pads().present()?;
    let thread = Arc::new(DriverThread::default());
    let open = |found: Present| open(found, thread.clone());
    let (devices, arms): (Vec<_>, Vec<_>) = present.into_iter().map(open).unzip();
    thread.start("gamepad", move || serve(&mut pads(), arms))?;
    Ok(devices)
}

struct Arm {
    pad: Present,
    end: DriverEnd,
    puck: Puck,
}

fn open(pad: Present, thread: Arc<DriverThread>) -> (LinkedDevice, Arm) {
    let specification = Specification {
        model: pad.name.clone(),
        serial: pad.number.to_string(),
        dofs_in: 5,
        ..Specification::default()
    };
    let (device, end) = link(specification, STALE, thread);
    let puck = Puck::default();
    (device, Arm { pad, end, puck })
}

fn serve(pads: &mut Pads, mut arms: Vec<Arm>) {
    let mut before = Instant::now();
    while !arms.iter().all(|a| a.end.is_abandoned()) {
        let dt = before.elapsed().as_secs_f64().min(0.02);
        before = Instant::now();
        for Arm { pad, end, puck } in &mut arms {
            let held = pads.held(pad);
            end.set_fault(held.is_none().then_some(DeviceFault::Unplugged));
            if let Some(held) = held {
                let reading = puck.advance(held.velocity(), held.spin(), held.buttons, dt);
                // Always finite: sticks are within -1 to 1.
                let _ = end.publish(reading);
            }
            end.wrench();
        }
        std::thread::sleep(PERIOD);
    }
}
