//! The part of libdhd that is used, as safe functions. Everything unsafe about Force Dimension is in this file.
#![allow(unsafe_code)]
use crate::OpenError;
use crate::library::{Sought, functions};
use std::ffi::{CStr, c_char, c_int};

/// A device's number. C's `char`, signed or not, is passed as it is.
pub(super) type Id = c_char;

/// The call was refused.
#[derive(Clone, Copy, Debug)]
pub(super) struct Failed;

functions!(Functions {
    device_count = "dhdGetDeviceCount": fn() -> c_int;
    open = "dhdOpenID": fn(Id) -> c_int;
    close = "dhdClose": fn(Id) -> c_int;
    serial_number = "dhdGetSerialNumber": fn(*mut u16, Id) -> c_int;
    system_name = "dhdGetSystemName": fn(Id) -> *const c_char;
    has_wrist = "dhdHasWrist": fn(Id) -> bool;
    has_active_wrist = "dhdHasActiveWrist": fn(Id) -> bool;
    enable_force = "dhdEnableForce": fn(u8, Id) -> c_int;
    set_time_guard = "dhdSetTimeGuard": fn(c_int, Id) -> c_int;
    frame = "dhdGetPositionAndOrientationFrame": fn(*mut f64, *mut f64, *mut f64, *mut [f64; 3], Id) -> c_int;
    linear_velocity = "dhdGetLinearVelocity": fn(*mut f64, *mut f64, *mut f64, Id) -> c_int;
    angular_velocity = "dhdGetAngularVelocityRad": fn(*mut f64, *mut f64, *mut f64, Id) -> c_int;
    set_force = "dhdSetForceAndTorqueAndGripperForce": fn(f64, f64, f64, f64, f64, f64, f64, Id) -> c_int;
    button_mask = "dhdGetButtonMask": fn(Id) -> u32;
    status = "dhdGetStatus": fn(*mut c_int, Id) -> c_int;
    error_text = "dhdErrorGetLastStr": fn() -> *const c_char;
});

/// libdhd.
pub(super) struct Dhd(Functions);

const SOUGHT: Sought = Sought {
    what: "Force Dimension's libdhd",
    variable: "OSTEOTOME_LIBDHD",
    names: if cfg!(windows) {
        &["dhd64.dll", "dhd.dll"]
    } else {
        &[
            "libdhd.so",
            "libdhd.so.3",
            "/usr/local/lib/libdhd.so",
            "/usr/lib/libdhd.so",
        ]
    },
    mend: "install Force Dimension's SDK 3",
};

/// Whether a result says that the call was done; time guard (1) and saturated motors (2) are not failures.
fn done(result: c_int) -> Result<(), Failed> {
    if result >= 0 { Ok(()) } else { Err(Failed) }
}

impl Dhd {
    pub(super) fn load() -> Result<Self, OpenError> {
        Ok(Self(Functions::load(SOUGHT.load()?)?))
    }

    pub(super) fn device_count(&self) -> c_int {
        // SAFETY: no arguments.
        unsafe { (self.0.device_count)() }
    }

    pub(super) fn open(&self, id: Id) -> Result<(), Failed> {
        // SAFETY: takes any number; likewise wherever only an id is passed.
        done(unsafe { (self.0.open)(id) })
    }

    pub(super) fn close(&self, id: Id) {
        // SAFETY: as above. A device that cannot be closed is gone already.
        let _ = unsafe { (self.0.close)(id) };
    }

    pub(super) fn serial_number(&self, id: Id) -> Option<u16> {
        let mut serial = 0;
        // SAFETY: one u16 to write to.
        done(unsafe { (self.0.serial_number)(&raw mut serial, id) }).ok()?;
        Some(serial)
    }

    pub(super) fn system_name(&self, id: Id) -> String {
        // SAFETY: as above.
        text(unsafe { (self.0.system_name)(id) })
    }

    pub(super) fn has_wrist(&self, id: Id) -> bool {
        // SAFETY: as above.
        unsafe { (self.0.has_wrist)(id) }
    }

    pub(super) fn has_active_wrist(&self, id: Id) -> bool {
        // SAFETY: as above.
        unsafe { (self.0.has_active_wrist)(id) }
    }

    pub(super) fn enable_force(&self, is_on: bool, id: Id) -> Result<(), Failed> {
        // SAFETY: takes any numbers.
        done(unsafe { (self.0.enable_force)(u8::from(is_on), id) })
    }

    /// Shortest time between two readings \[us\].
    pub(super) fn set_time_guard(&self, us: c_int, id: Id) -> Result<(), Failed> {
        // SAFETY: takes any numbers.
        done(unsafe { (self.0.set_time_guard)(us, id) })
    }

    /// Position \[m\] and orientation (rows of the matrix).
    pub(super) fn frame(&self, id: Id) -> Result<([f64; 3], [[f64; 3]; 3]), Failed> {
        let ([mut x, mut y, mut z], mut rows) = ([0.0; 3], [[0.0; 3]; 3]);
        // SAFETY: three doubles and a matrix of 3 x 3 to write to.
        let result =
            unsafe { (self.0.frame)(&raw mut x, &raw mut y, &raw mut z, rows.as_mut_ptr(), id) };
        done(result)?;
        Ok(([x, y, z], rows))
    }

    /// \[m/s\]
    pub(super) fn linear_velocity(&self, id: Id) -> Result<[f64; 3], Failed> {
        let [mut x, mut y, mut z] = [0.0; 3];
        // SAFETY: three doubles to write to.
        done(unsafe { (self.0.linear_velocity)(&raw mut x, &raw mut y, &raw mut z, id) })?;
        Ok([x, y, z])
    }

    /// \[rad/s\]
    pub(super) fn angular_velocity(&self, id: Id) -> Result<[f64; 3], Failed> {
        let [mut x, mut y, mut z] = [0.0; 3];
        // SAFETY: three doubles to write to.
        done(unsafe { (self.0.angular_velocity)(&raw mut x, &raw mut y, &raw mut z, id) })?;
        Ok([x, y, z])
    }

    /// \[N\], \[N m\]; no grip force.
    pub(super) fn set_force(&self, f: &[f64; 3], t: &[f64; 3], id: Id) -> Result<(), Failed> {
        // SAFETY: takes any numbers.
        done(unsafe { (self.0.set_force)(f[0], f[1], f[2], t[0], t[1], t[2], 0.0, id) })
    }

    pub(super) fn buttons(&self, id: Id) -> u32 {
        // SAFETY: as above.
        unsafe { (self.0.button_mask)(id) }
    }

    /// Whether it is calibrated (`reset`) and whether it reports an error.
    pub(super) fn status(&self, id: Id) -> Result<(bool, bool), Failed> {
        const RESET: usize = 3;
        const ERROR: usize = 9;
        let mut status = [0; 64];
        // SAFETY: no version of the library fills more than 17 values.
        done(unsafe { (self.0.status)(status.as_mut_ptr(), id) })?;
        Ok((status[RESET] != 0, status[ERROR] != 0))
    }

    /// Of this thread's last error.
    pub(super) fn error_text(&self) -> String {
        // SAFETY: no arguments.
        text(unsafe { (self.0.error_text)() })
    }
}

fn text(string: *const c_char) -> String {
    if string.is_null() {
        return String::new();
    }
    // SAFETY: the library's strings are constants ended by zero.
    let string = unsafe { CStr::from_ptr(string) };
    string.to_string_lossy().into_owned()
}
