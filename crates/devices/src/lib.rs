//! Haptic devices and their stand-ins.
//!
//! One trait, [`HapticDevice`]; a backend a module. Always there: [`SimulatedHand`] (a mass on a spring that follows a
//! target and feels the displayed wrench) and [`RecordedHand`] (poses from a recording, deaf to the wrench). Physical
//! devices are found at run time ([`open()`], [`Driver::connect`]): vendors' libraries are loaded, services connected to;
//! none is needed to build. Their drivers run on threads of their own and meet the 1 kHz thread in a [`LinkedDevice`].
//! [`OperatedDevice`] maps a device into the world and keeps hands safe when it fails.
//!
//! Units: mm, N, N mm, s, rad; what a driver speaks is converted inside its backend and nowhere else.
//! The device's frame, for every backend: x to the user's right, y away from the user, z up; the handle in its neutral
//! pose has no rotation.

mod binding;
mod exercise;
pub mod force_dimension;
pub mod gamepad;
pub mod haply;
mod library;
mod link;
mod models;
mod open_error;
pub mod openhaptics;
mod operated;
mod pace;
mod puck;
mod recorded_hand;
pub mod remote;
mod simulated_hand;
#[cfg(unix)]
pub mod spacenav;
mod workspace;

pub use binding::{BadBinding, Binding, Driver, open};
pub use exercise::{Exercise, exercise};
pub use link::{Latency, LinkedDevice};
pub use models::{
    DeviceModel, INVERSE_3, LAMBDA_7, MODELS, OMEGA_3, OMEGA_6, OMNI, PREMIUM_6DOF, SIGMA_7, TOUCH,
};
pub use open_error::OpenError;
pub use operated::{OperatedDevice, SafetyEvent};
pub use recorded_hand::{EmptyRecording, RecordedHand};
pub use simulated_hand::{BadHand, HandParameters, SimulatedHand};
pub use workspace::Workspace;

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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Specification {
    /// Kind of device, e.g. `simulated`.
    pub model: String,
    /// Serial number; empty where there is none.
    pub serial: String,
    /// Largest force it displays \[N\].
    pub max_force: f64,
    /// Largest torque it displays \[N mm\]; 0 for a device without torque output.
    pub max_torque: f64,
    /// Sensed degrees of freedom.
    pub dofs_in: u8,
    /// Driven degrees of freedom.
    pub dofs_out: u8,
    /// Size of the workspace along x, y, z \[mm\], where the device tells.
    pub workspace: Option<[f64; 3]>,
    /// Stiffest spring that its maker recommends \[N/mm\], where known.
    pub nominal_stiffness: Option<f64>,
}

impl Specification {
    /// Of a known model.
    pub fn of(model: &DeviceModel, serial: impl Into<String>) -> Self {
        Self {
            model: model.name.to_owned(),
            serial: serial.into(),
            max_force: model.max_force,
            max_torque: model.max_torque,
            dofs_in: model.dofs_in,
            dofs_out: model.dofs_out,
            workspace: None,
            nominal_stiffness: model.nominal_stiffness,
        }
    }
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

impl Default for Reading {
    fn default() -> Self {
        Self {
            pose: Pose::identity(),
            velocity: Vec3::zeros(),
            angular_velocity: Vec3::zeros(),
            buttons: 0,
            time: 0.0,
        }
    }
}

/// What is wrong with a device. Whatever it is, the device displays zero meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(u8)]
pub enum DeviceFault {
    /// The wrench held a NaN or an infinity.
    #[error("the wrench is not finite; zero was displayed")]
    NotFinite = 1,
    /// No new reading has come in time.
    #[error("no new reading in time")]
    Stale,
    /// What came could not be understood.
    #[error("a message could not be understood")]
    Malformed,
    /// It must be calibrated before it can be trusted.
    #[error("calibration wanted: put the handle into its rest position")]
    Uncalibrated,
    /// Motors are too warm.
    #[error("motors are too warm; let the device cool")]
    WarmMotors,
    /// The device has refused a force, impulse or velocity.
    #[error("force, impulse or velocity beyond what the device bears")]
    ForceExceeded,
    /// The connection was interrupted.
    #[error("the connection was interrupted")]
    Communication,
    /// It is not there any more.
    #[error("unplugged, switched off, or its client went away")]
    Unplugged,
    /// The vendor's library has no valid licence.
    #[error("the vendor's library has no valid licence")]
    License,
    /// The device reports a defect.
    #[error("the device reports a defect")]
    Defect,
}

/// What the caller may do about a [`DeviceFault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remedy {
    /// It may pass by itself: read on.
    Retry,
    /// The user must calibrate; read on until it is done.
    Recalibrate,
    /// The device is gone; its driver goes on looking for it.
    Gone,
}

impl DeviceFault {
    const ALL: [Self; 10] = [
        Self::NotFinite,
        Self::Stale,
        Self::Malformed,
        Self::Uncalibrated,
        Self::WarmMotors,
        Self::ForceExceeded,
        Self::Communication,
        Self::Unplugged,
        Self::License,
        Self::Defect,
    ];

    /// What may be done about it.
    pub fn remedy(self) -> Remedy {
        match self {
            Self::Uncalibrated => Remedy::Recalibrate,
            Self::Unplugged | Self::License | Self::Defect => Remedy::Gone,
            _ => Remedy::Retry,
        }
    }

    fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|f| *f as u8 == code)
    }
}

/// How a device is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// What is wrong, if anything.
    pub fault: Option<DeviceFault>,
    /// Temperature of the warmest motor as a share of what it bears, where the device tells.
    pub motor_temperature: Option<f32>,
}

/// A haptic device, driven from the 1 kHz thread.
///
/// Nothing here allocates, waits or logs. One `write` a `read`.
pub trait HapticDevice: Send {
    /// What it is.
    fn specification(&self) -> &Specification;
    /// The newest reading; the last good one while [`health`](Self::health) reports a fault.
    fn read(&mut self) -> Reading;
    /// Displays a wrench until the next call. Beyond the device's limits it is scaled back to them; a wrench that is
    /// not finite displays zero.
    ///
    /// # Errors
    /// [`DeviceFault`]: what went wrong; the device is in a safe state (zero wrench).
    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault>;
    /// How it is at this moment.
    fn health(&self) -> Health {
        Health::default()
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_survives_as_a_code() {
        for fault in DeviceFault::ALL {
            assert_eq!(DeviceFault::from_code(fault as u8), Some(fault));
        }
        assert_eq!(DeviceFault::from_code(0), None);
    }
}
