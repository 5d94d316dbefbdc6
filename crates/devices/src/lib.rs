//! Haptic devices and their stand-ins.
//!
//! One trait, [`HapticDevice`]; a backend a module. Always built: [`SimulatedHand`] (a mass on a spring that follows a
//! target and feels the displayed wrench) and [`RecordedHand`] (poses from a recording, deaf to the wrench).
//! Units: mm, N, N mm, s, rad; what a driver speaks is converted inside its backend and nowhere else.
#![forbid(unsafe_code)]

mod models;
mod recorded_hand;
mod simulated_hand;

pub use models::{
    DeviceModel, INVERSE_3, LAMBDA_7, MODELS, OMEGA_3, OMEGA_6, OMNI, PREMIUM_6DOF, SIGMA_7, TOUCH,
};
pub use recorded_hand::{EmptyRecording, RecordedHand};
pub use simulated_hand::{BadHand, HandParameters, SimulatedHand};

/// A rigid motion from the tool handle's frame to the device's frame.
pub type Pose = nalgebra::Isometry3<f64>;
/// A vector in the device's frame.
pub type Vec3 = nalgebra::Vector3<f64>;

/// A force and a torque about the handle's origin, in the device's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force \[N\].
    pub force: Vec3,
    /// Torque \[N mm\].
    pub torque: Vec3,
}

impl Wrench {
    /// Whether all six components are finite numbers.
    pub fn is_finite(&self) -> bool {
        self.force.iter().chain(&self.torque).all(|c| c.is_finite())
    }
}

/// What a device is and the most it can display.
#[derive(Clone, Debug, PartialEq)]
pub struct Specification {
    /// Kind of device, e.g. `simulated`.
    pub model: String,
    /// Serial number; empty where there is none.
    pub serial: String,
    /// Largest force it displays \[N\].
    pub max_force: f64,
    /// Largest torque it displays \[N mm\]; 0 for a device without torque output.
    pub max_torque: f64,
}

/// One reading of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Pose of the handle.
    pub pose: Pose,
    /// Velocity of the handle's origin \[mm/s\].
    pub velocity: Vec3,
    /// Angular velocity \[rad/s\].
    pub angular_velocity: Vec3,
    /// One bit a button, the first the lowest.
    pub buttons: u32,
    /// When the reading was taken, since the device was started \[s\].
    pub time: f64,
}

/// What a device can report when it is written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceFault {
    /// The wrench held a NaN or an infinity; zero was displayed instead.
    #[error("the wrench is not finite; zero was displayed")]
    NotFinite,
}

/// A haptic device, driven from the 1 kHz thread.
///
/// Neither [`read`](Self::read) nor [`write`](Self::write) allocates, waits or logs. One `write` a `read`.
pub trait HapticDevice: Send {
    /// What it is.
    fn specification(&self) -> &Specification;
    /// The newest reading.
    fn read(&mut self) -> Reading;
    /// Displays a wrench until the next call. Beyond the device's limits it is scaled back to them; a wrench that is
    /// not finite displays zero.
    ///
    /// # Errors
    /// [`DeviceFault`]: what went wrong; the device is in a safe state (zero wrench).
    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault>;
}

/// The wrench scaled back to the limits, force and torque each on its own; their directions stay.
fn limited(wrench: &Wrench, specification: &Specification) -> Result<Wrench, DeviceFault> {
    if !wrench.is_finite() {
        return Err(DeviceFault::NotFinite);
    }
    let cap = |v: Vec3, most: f64| {
        if v.norm() > most {
            v * (most / v.norm())
        } else {
            v
        }
    };
    Ok(Wrench {
        force: cap(wrench.force, specification.max_force),
        torque: cap(wrench.torque, specification.max_torque),
    })
}
