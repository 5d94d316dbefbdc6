//! Phantom Omni, Touch, Premium and their kin, through OpenHaptics' libHD.
//!
//! One scheduler callback serves all devices. A thread of ours looks after them: it opens a device that was lost again
//! (with the scheduler stopped meanwhile, so that all devices pause) and ends them.
//! The vendor's frame is x right, y up, z to the user, in mm, N and mN m.
mod ffi;

use crate::link::{DriverEnd, DriverThread, link};
use crate::{
    DeviceFault, DeviceModel, LinkedDevice, OpenError, Pose, Reading, Specification, Vec3, Wrench,
};
use ffi::{Handle, Hd, INVALID, Servo};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::ffi::{CString, c_ulong};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

/// A reading older than this is stale.
const STALE: Duration = Duration::from_millis(20);
/// A fault that passes by itself is reported for so many ticks after it was last seen.
const LINGER: u64 = 500;
/// Calibration and temperature are looked at every so many ticks.
const CHECK_EVERY: u64 = 64;
/// Between attempts to open a lost device.
const RETRY: Duration = Duration::from_millis(500);
/// Names that the vendor's setup gives to devices. The first is the default device's (null).
const NAMES: [&str; 4] = ["", "Phantom2", "Left Device", "Right Device"];
const MAX_ERRORS_A_TICK: usize = 32;

/// Opens all devices that are there. Their calibration may still be wanted: that is a fault of the device, not an error.
///
/// # Errors
/// The library is missing or unusable; its licence is not valid; there is no device.
pub fn connect() -> Result<Vec<LinkedDevice>, OpenError> {
    let hd = Hd::load()?;
    let (opened, refusal) = open_all(&hd);
    if opened.is_empty() {
        return Err(OpenError::Refused {
            driver: "openhaptics",
            message: refusal,
        });
    }
    let keeper = Arc::new(Keeper::default());
    let (devices, arms): (Vec<_>, Vec<_>) = opened
        .into_iter()
        .map(|(name, handle)| Arm::new(&hd, name, handle, keeper.clone()))
        .unzip();
    let stand: &'static Stand = Box::leak(Box::new(Stand {
        hd,
        arms: Mutex::new(arms),
        ticks: AtomicU64::new(0),
    }));
    let scheduled = stand.hd.schedule(stand);
    stand.hd.start_scheduler();
    let is_over = keeper.is_over.clone();
    let look_after = move || look_after(stand, scheduled, &is_over);
    keeper.thread.start("openhaptics", look_after)?;
    Ok(devices)
}

type Named = (Option<CString>, Handle);

/// All that open, and why the first did not.
fn open_all(hd: &Hd) -> (Vec<Named>, String) {
    let mut opened = Vec::new();
    let mut refusal = String::new();
    for name in NAMES {
        let name = CString::new(name).ok().filter(|n| !n.is_empty());
        match hd.init(name.as_ref()) {
            Ok(handle) => opened.push((name, handle)),
            Err(error) if refusal.is_empty() => refusal = told(hd, error.code),
            Err(_) => {}
        }
    }
    (opened, refusal)
}

fn told(hd: &Hd, code: u32) -> String {
    match fault_of(code) {
        Some(fault @ DeviceFault::License) => fault.to_string(),
        _ => format!(
            "no device could be opened: {} (error {code:#x})",
            hd.error_text(code)
        ),
    }
}

/// What an error code means for its device; `None`: nothing that a hand would feel.
fn fault_of(code: u32) -> Option<DeviceFault> {
    match code {
        0x104 | 0x302 => Some(DeviceFault::Unplugged),
        0x200 => Some(DeviceFault::WarmMotors),
        0x201..=0x204 => Some(DeviceFault::ForceExceeded),
        0x300 => Some(DeviceFault::Defect),
        0x600 => Some(DeviceFault::License),
        _ => None,
    }
}

/// One device, as the callback sees it.
struct Arm {
    name: Option<CString>,
    /// [`INVALID`] while it is lost.
    handle: Handle,
    /// The one it had before it was lost.
    former: Handle,
    serial: String,
    end: DriverEnd,
    has_torque: bool,
    is_calibrated: bool,
    /// The last fault of the error queue and when it ends; one whose remedy is `Gone` does not end.
    fault: Option<(DeviceFault, u64)>,
}

impl Arm {
    fn new(
        hd: &Hd,
        name: Option<CString>,
        handle: Handle,
        keeper: Arc<Keeper>,
    ) -> (LinkedDevice, Self) {
        hd.make_current(handle);
        let specification = specification(hd);
        let serial = specification.serial.clone();
        let has_torque = specification.max_torque > 0.0;
        let (device, end) = link(specification, STALE, keeper);
        let mut arm = Self {
            name,
            handle,
            former: INVALID,
            serial,
            end,
            has_torque,
            is_calibrated: false,
            fault: None,
        };
        arm.set_up(hd);
        (device, arm)
    }

    /// Forces on, clamped and ramped by the vendor as well. What a device does not know only sets an error.
    fn set_up(&mut self, hd: &Hd) {
        for capability in [
            ffi::FORCE_OUTPUT,
            ffi::MAX_FORCE_CLAMPING,
            ffi::FORCE_RAMPING,
        ] {
            hd.enable(capability);
        }
        self.calibrate(hd);
        while hd.pop_error().is_some() {}
    }

    fn calibrate(&mut self, hd: &Hd) {
        let state = hd.check_calibration();
        if state == ffi::CALIBRATION_NEEDS_UPDATE {
            hd.update_calibration(hd.integer(ffi::CALIBRATION_STYLE) as u32);
        }
        self.is_calibrated = state == ffi::CALIBRATION_OK;
    }

    fn is_lost(&self) -> bool {
        self.handle == INVALID
    }

    /// Wrench out, reading in, within one frame.
    fn tick(&mut self, hd: &Hd, tick: u64) {
        if self.is_lost() {
            return;
        }
        hd.make_current(self.handle);
        if tick.is_multiple_of(CHECK_EVERY) {
            self.calibrate(hd);
            let warmest = hd
                .doubles(ffi::MOTOR_TEMPERATURE)
                .into_iter()
                .fold(0.0, f64::max);
            self.end.set_motor_temperature(warmest as f32);
        }
        hd.begin_frame(self.handle);
        let reading = reading(hd);
        let published = self.end.publish(reading);
        let wrench = self.end.wrench();
        self.show(hd, &wrench);
        hd.end_frame(self.handle);
        if let Err(fault) = published {
            self.fault = Some((fault, tick + LINGER));
        }
    }

    fn show(&self, hd: &Hd, wrench: &Wrench) {
        hd.set(ffi::CURRENT_FORCE, &to_vendor(&wrench.force));
        if self.has_torque {
            hd.set(ffi::CURRENT_TORQUE, &to_vendor(&wrench.torque));
        }
    }

    fn note(&mut self, fault: DeviceFault, tick: u64) {
        self.fault = Some((fault, tick + LINGER));
        if fault.remedy() == crate::Remedy::Gone {
            self.former = std::mem::replace(&mut self.handle, INVALID);
        }
    }

    fn report(&mut self, tick: u64) {
        if !self.is_lost() && self.fault.is_some_and(|(_, until)| tick > until) {
            self.fault = None;
        }
        let uncalibrated = (!self.is_calibrated).then_some(DeviceFault::Uncalibrated);
        self.end
            .set_fault(self.fault.map(|(f, _)| f).or(uncalibrated));
    }

    /// Tries to open it again. The scheduler stands meanwhile.
    fn reopen(&mut self, hd: &Hd) {
        if self.former != INVALID {
            hd.disable(std::mem::replace(&mut self.former, INVALID));
        }
        let Ok(handle) = hd.init(self.name.as_ref()) else {
            return;
        };
        hd.make_current(handle);
        if hd.string(ffi::SERIAL_NUMBER) != self.serial {
            hd.disable(handle);
            return;
        }
        self.handle = handle;
        self.fault = None;
        self.set_up(hd);
    }
}

/// What the scheduler calls: all devices in turn.
struct Stand {
    hd: Hd,
    arms: Mutex<Vec<Arm>>,
    ticks: AtomicU64,
}

impl Servo for Stand {
    fn tick(&self) {
        let tick = self.ticks.fetch_add(1, Ordering::Relaxed);
        let mut arms = match self.arms.try_lock() {
            Ok(arms) => arms,
            // A tick that panicked must not be the last: the next one may have to display zero.
            Err(TryLockError::Poisoned(arms)) => arms.into_inner(),
            // Held elsewhere only while the scheduler is stopped or about to be: never wait here.
            Err(TryLockError::WouldBlock) => return,
        };
        arms.iter_mut().for_each(|arm| arm.tick(&self.hd, tick));
        for _ in 0..MAX_ERRORS_A_TICK {
            let Some(error) = self.hd.pop_error() else {
                break;
            };
            let Some(fault) = fault_of(error.code) else {
                continue;
            };
            let is_theirs =
                |a: &Arm| error.device != INVALID && [a.handle, a.former].contains(&error.device);
            // An error of no known device is everybody's: better two silent devices than one that pushes wrongly.
            let is_known = arms.iter().any(is_theirs);
            let concerned = |a: &&mut Arm| !a.is_lost() && (!is_known || is_theirs(a));
            let arms = arms.iter_mut().filter(concerned);
            arms.for_each(|arm| arm.note(fault, tick));
        }
        arms.iter_mut().for_each(|arm| arm.report(tick));
    }
}

/// Ends the thread that looks after the devices, once all of them are dropped.
#[derive(Default)]
struct Keeper {
    is_over: Arc<AtomicBool>,
    thread: DriverThread,
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
    }
}

fn look_after(stand: &'static Stand, scheduled: c_ulong, is_over: &AtomicBool) {
    let arms = || stand.arms.lock().unwrap_or_else(PoisonError::into_inner);
    let mut next = Instant::now();
    while !is_over.load(Ordering::Acquire) {
        std::thread::sleep(Duration::from_millis(20));
        if Instant::now() < next || !arms().iter().any(Arm::is_lost) {
            continue;
        }
        stand.hd.stop_scheduler();
        arms()
            .iter_mut()
            .filter(|a| a.is_lost())
            .for_each(|a| a.reopen(&stand.hd));
        stand.hd.start_scheduler();
        next = Instant::now() + RETRY;
    }
    stand.hd.stop_scheduler();
    stand.hd.unschedule(scheduled);
    let mut arms = arms();
    let opened = arms.iter().filter(|a| !a.is_lost());
    opened.for_each(|a| stand.hd.disable(a.handle));
    // What is left of the stand stays for good: the vendor's thread may hold its address.
    arms.clear();
}

/// Of the current device. Its own limits, but never more than its model is known to bear.
fn specification(hd: &Hd) -> Specification {
    let model = hd.string(ffi::MODEL_TYPE);
    let known = DeviceModel::by_name(&model);
    let number = |parameter| hd.doubles(parameter)[0];
    let capped = |own: f64, known: Option<f64>| {
        known.map_or(own, |k| if own > 0.0 { own.min(k) } else { k })
    };
    let dofs_out = hd.integer(ffi::OUTPUT_DOF).clamp(0, 6) as u8;
    let max_torque = if dofs_out >= 6 {
        capped(number(ffi::NOMINAL_MAX_TORQUE), known.map(|k| k.max_torque))
    } else {
        0.0
    };
    let w = hd.doubles(ffi::USABLE_WORKSPACE);
    let stiffness = number(ffi::NOMINAL_MAX_STIFFNESS);
    Specification {
        serial: hd.string(ffi::SERIAL_NUMBER),
        max_force: capped(number(ffi::NOMINAL_MAX_FORCE), known.map(|k| k.max_force)).max(0.0),
        max_torque: max_torque.max(0.0),
        dofs_in: hd.integer(ffi::INPUT_DOF).clamp(0, 7) as u8,
        dofs_out,
        // x right, y up, z to the user: our y is their z.
        workspace: Some([w[3] - w[0], w[5] - w[2], w[4] - w[1]]),
        nominal_stiffness: (stiffness > 0.0)
            .then_some(stiffness)
            .or(known.and_then(|k| k.nominal_stiffness)),
        model,
    }
}

/// Within a frame of the current device.
fn reading(hd: &Hd) -> Reading {
    let t = hd.doubles(ffi::TRANSFORM);
    let columns = Matrix3::new(t[0], t[4], t[8], t[1], t[5], t[9], t[2], t[6], t[10]);
    let turn = from_vendor() * columns * from_vendor().transpose();
    let vector = |v: [f64; 16]| from_vendor() * Vec3::new(v[0], v[1], v[2]);
    Reading {
        pose: Pose::from_parts(
            (from_vendor() * Vec3::new(t[12], t[13], t[14])).into(),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn)),
        ),
        velocity: vector(hd.doubles(ffi::VELOCITY)),
        angular_velocity: vector(hd.doubles(ffi::ANGULAR_VELOCITY)),
        buttons: hd.integer(ffi::BUTTONS) as u32,
        time: 0.0,
    }
}

/// Ours (right, away, up) from theirs (right, up, to the user).
fn from_vendor() -> Matrix3<f64> {
    Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0)
}

fn to_vendor(v: &Vec3) -> [f64; 3] {
    (from_vendor().transpose() * v).into()
}
