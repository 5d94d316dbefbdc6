//! Force Dimension's omega, delta, sigma and lambda, through libdhd.
//!
//! A thread a device reads and writes at 1 kHz (the calls wait for USB). The vendor's frame is x to the user, y right,
//! z up, in m, N and N m.
mod ffi;

use crate::link::{DriverEnd, DriverThread, link};
use crate::pace::{Pace, raise_priority};
use crate::{
    DeviceFault, DeviceModel, LinkedDevice, OpenError, Pose, Reading, SIGMA_7, Specification, Vec3,
};
use ffi::{Dhd, Failed, Id};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::sync::Arc;
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(1);
/// A reading older than this is stale.
const STALE: Duration = Duration::from_millis(20);
/// Between attempts to open a lost device.
const RETRY: Duration = Duration::from_millis(300);
/// Calibration is looked at every so many ticks.
const CHECK_EVERY: u64 = 64;
const MAX_DEVICES: i32 = 16;
const MM: f64 = 1e-3; // m
const N_MM: f64 = 1e-3; // N m

/// Opens all devices that are there.
///
/// # Errors
/// The library is missing or unusable; there is no device; none can be opened.
pub fn connect() -> Result<Vec<LinkedDevice>, OpenError> {
    let dhd = Arc::new(Dhd::load()?);
    let refused = |message: String| OpenError::Refused {
        driver: "forcedimension",
        message,
    };
    let count = dhd.device_count().clamp(0, MAX_DEVICES);
    if count == 0 {
        return Err(refused("no device is connected".to_owned()));
    }
    let mut devices = Vec::new();
    let mut refusal = String::new();
    for id in 0..count {
        let id = id as Id;
        match set_up(&dhd, id) {
            Ok(()) => devices.push(run(&dhd, id)?),
            Err(Failed) => refusal = dhd.error_text(),
        }
    }
    if devices.is_empty() {
        return Err(refused(format!("no device could be opened: {refusal}")));
    }
    Ok(devices)
}

fn set_up(dhd: &Dhd, id: Id) -> Result<(), Failed> {
    dhd.open(id)?;
    // The pace is kept here; the library's own guard would only repeat old readings.
    let ready = dhd
        .set_time_guard(0, id)
        .and_then(|()| dhd.enable_force(true, id));
    if ready.is_err() {
        dhd.close(id);
    }
    ready
}

fn run(dhd: &Arc<Dhd>, id: Id) -> Result<LinkedDevice, OpenError> {
    let specification = specification(dhd, id);
    let has_torque = specification.max_torque > 0.0;
    let thread = Arc::new(DriverThread::default());
    let (device, end) = link(specification, STALE, thread.clone());
    let mut arm = Arm {
        dhd: dhd.clone(),
        id,
        serial: dhd.serial_number(id),
        has_torque,
        end,
    };
    thread.start("forcedimension", move || arm.serve())?;
    Ok(device)
}

/// One device, as its thread sees it.
struct Arm {
    dhd: Arc<Dhd>,
    id: Id,
    serial: Option<u16>,
    has_torque: bool,
    end: DriverEnd,
}

impl Arm {
    fn serve(&mut self) {
        raise_priority();
        let mut tick = 0;
        let mut pace = Pace::new(PERIOD);
        while !self.end.is_abandoned() {
            if self.tick(tick).is_err() {
                self.end.set_fault(Some(DeviceFault::Unplugged));
                self.reopen();
            }
            tick += 1;
            pace.wait();
        }
        let _ = self.dhd.set_force(&[0.0; 3], &[0.0; 3], self.id);
        self.dhd.close(self.id);
    }

    /// Reading in, wrench out.
    fn tick(&mut self, tick: u64) -> Result<(), Failed> {
        let reading = self.reading()?;
        let published = self.end.publish(reading);
        if tick.is_multiple_of(CHECK_EVERY) || published.is_err() {
            let (is_calibrated, is_defect) = self.dhd.status(self.id)?;
            let uncalibrated = (!is_calibrated).then_some(DeviceFault::Uncalibrated);
            let defect = is_defect.then_some(DeviceFault::Defect);
            self.end
                .set_fault(published.err().or(defect).or(uncalibrated));
        }
        let wrench = self.end.wrench();
        let force = to_vendor(&wrench.force);
        let torque = if self.has_torque {
            to_vendor(&(wrench.torque * N_MM))
        } else {
            [0.0; 3]
        };
        self.dhd.set_force(&force, &torque, self.id)
    }

    /// Without velocities while the library's estimator is not ready.
    fn reading(&self) -> Result<Reading, Failed> {
        let linear = self.dhd.linear_velocity(self.id).unwrap_or_default();
        let angular = self.dhd.angular_velocity(self.id).unwrap_or_default();
        let (place, [x, y, z]) = self.dhd.frame(self.id)?;
        let rows = Matrix3::new(x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]);
        let turn = from_vendor() * rows * from_vendor().transpose();
        Ok(Reading {
            pose: Pose::from_parts(
                (from_vendor() * Vec3::from(place) / MM).into(),
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn)),
            ),
            velocity: from_vendor() * Vec3::from(linear) / MM,
            angular_velocity: from_vendor() * Vec3::from(angular),
            buttons: self.dhd.buttons(self.id),
            time: 0.0,
        })
    }

    /// Waits until the same device is back.
    fn reopen(&mut self) {
        self.dhd.close(self.id);
        while !self.end.is_abandoned() {
            std::thread::sleep(RETRY);
            if set_up(&self.dhd, self.id).is_err() {
                continue;
            }
            if self.dhd.serial_number(self.id) == self.serial {
                // Whatever was wrong is looked for anew at the first tick.
                return;
            }
            self.dhd.close(self.id);
        }
    }
}

/// By its name where the model is known; else an omega's force, and a sigma's torque if it has an active wrist.
fn specification(dhd: &Dhd, id: Id) -> Specification {
    let name = dhd.system_name(id);
    let serial = dhd
        .serial_number(id)
        .map_or_else(String::new, |s| s.to_string());
    if let Some(model) = DeviceModel::by_name(&name) {
        return Specification::of(model, serial);
    }
    let has_torque = dhd.has_active_wrist(id);
    Specification {
        model: name,
        serial,
        max_force: SIGMA_7.max_force,
        max_torque: if has_torque { SIGMA_7.max_torque } else { 0.0 },
        dofs_in: if dhd.has_wrist(id) { 6 } else { 3 },
        dofs_out: if has_torque { 6 } else { 3 },
        workspace: None,
        nominal_stiffness: None,
    }
}

/// Ours (right, away, up) from theirs (to the user, right, up).
fn from_vendor() -> Matrix3<f64> {
    Matrix3::new(0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
}

fn to_vendor(v: &Vec3) -> [f64; 3] {
    (from_vendor().transpose() * v).into()
}
