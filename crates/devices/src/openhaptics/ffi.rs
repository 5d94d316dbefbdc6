//! The part of libHD that is used, as safe functions. Everything unsafe about OpenHaptics is in this file.
//!
//! Types and constants follow the public headers of OpenHaptics 3.
#![allow(unsafe_code)]
use crate::OpenError;
use crate::library::{Sought, functions};
use std::ffi::{CStr, CString, c_char, c_ulong, c_void};

/// A device's handle.
pub(super) type Handle = u32;
/// No device.
pub(super) const INVALID: Handle = u32::MAX;

pub(super) const BUTTONS: u32 = 0x2000;
pub(super) const VELOCITY: u32 = 0x2051;
pub(super) const TRANSFORM: u32 = 0x2052;
pub(super) const ANGULAR_VELOCITY: u32 = 0x2053;
pub(super) const MODEL_TYPE: u32 = 0x2501;
pub(super) const SERIAL_NUMBER: u32 = 0x2504;
pub(super) const USABLE_WORKSPACE: u32 = 0x2551;
pub(super) const INPUT_DOF: u32 = 0x2553;
pub(super) const OUTPUT_DOF: u32 = 0x2554;
pub(super) const CALIBRATION_STYLE: u32 = 0x2555;
pub(super) const NOMINAL_MAX_STIFFNESS: u32 = 0x2602;
pub(super) const NOMINAL_MAX_FORCE: u32 = 0x2603;
pub(super) const MOTOR_TEMPERATURE: u32 = 0x2605;
pub(super) const NOMINAL_MAX_TORQUE: u32 = 0x2622;
pub(super) const CURRENT_FORCE: u32 = 0x2700;
pub(super) const CURRENT_TORQUE: u32 = 0x2701;
pub(super) const FORCE_OUTPUT: u32 = 0x4000;
pub(super) const MAX_FORCE_CLAMPING: u32 = 0x4001;
pub(super) const FORCE_RAMPING: u32 = 0x4002;
pub(super) const CALIBRATION_OK: u32 = 0x5000;
pub(super) const CALIBRATION_NEEDS_UPDATE: u32 = 0x5001;

const DEFAULT_PRIORITY: u16 = 32767;
const CALLBACK_CONTINUE: u32 = 1;

/// An entry of the error queue.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorInfo {
    pub code: u32,
    pub internal: i32,
    pub device: Handle,
}

type Callback = extern "system" fn(*mut c_void) -> u32;

functions!(Functions {
    init_device = "hdInitDevice": fn(*const c_char) -> Handle;
    disable_device = "hdDisableDevice": fn(Handle);
    make_current_device = "hdMakeCurrentDevice": fn(Handle);
    begin_frame = "hdBeginFrame": fn(Handle);
    end_frame = "hdEndFrame": fn(Handle);
    enable = "hdEnable": fn(u32);
    get_doubles = "hdGetDoublev": fn(u32, *mut f64);
    get_integers = "hdGetIntegerv": fn(u32, *mut i32);
    get_string = "hdGetString": fn(u32) -> *const c_char;
    set_doubles = "hdSetDoublev": fn(u32, *const f64);
    get_error = "hdGetError": fn() -> ErrorInfo;
    get_error_string = "hdGetErrorString": fn(u32) -> *const c_char;
    check_calibration = "hdCheckCalibration": fn() -> u32;
    update_calibration = "hdUpdateCalibration": fn(u32);
    start_scheduler = "hdStartScheduler": fn();
    stop_scheduler = "hdStopScheduler": fn();
    schedule = "hdScheduleAsynchronous": fn(Callback, *mut c_void, u16) -> c_ulong;
    unschedule = "hdUnschedule": fn(c_ulong);
});

/// What the scheduler calls at every tick.
pub(super) trait Servo: Send + Sync + 'static {
    fn tick(&self);
}

/// libHD.
pub(super) struct Hd(Functions);

const SOUGHT: Sought = Sought {
    what: "OpenHaptics' libHD",
    variable: "OSTEOTOME_LIBHD",
    names: if cfg!(windows) {
        &["HD.dll"]
    } else {
        &[
            "libHD.so",
            "libHD.so.3.4",
            "libHD.so.3",
            "/usr/lib/libHD.so",
            "/usr/local/lib/libHD.so",
        ]
    },
    mend: "install OpenHaptics and the device's driver from 3D Systems",
};

impl Hd {
    pub(super) fn load() -> Result<Self, OpenError> {
        Ok(Self(Functions::load(SOUGHT.load()?)?))
    }

    /// Opens a device and makes it current.
    pub(super) fn init(&self, name: Option<&CString>) -> Result<Handle, ErrorInfo> {
        while self.pop_error().is_some() {}
        let name = name.map_or(std::ptr::null(), |n| n.as_ptr());
        // SAFETY: null (the default device) or a string that outlives the call, ended by zero.
        let handle = unsafe { (self.0.init_device)(name) };
        match self.pop_error() {
            Some(error) => Err(error),
            None if handle == INVALID => Err(ErrorInfo {
                code: 0,
                internal: 0,
                device: INVALID,
            }),
            None => Ok(handle),
        }
    }

    pub(super) fn disable(&self, device: Handle) {
        // SAFETY: takes any number; an unknown handle only sets an error.
        unsafe { (self.0.disable_device)(device) }
    }

    pub(super) fn make_current(&self, device: Handle) {
        // SAFETY: as above.
        unsafe { (self.0.make_current_device)(device) }
    }

    pub(super) fn begin_frame(&self, device: Handle) {
        // SAFETY: as above.
        unsafe { (self.0.begin_frame)(device) }
    }

    pub(super) fn end_frame(&self, device: Handle) {
        // SAFETY: as above.
        unsafe { (self.0.end_frame)(device) }
    }

    pub(super) fn enable(&self, capability: u32) {
        // SAFETY: takes any number; an unknown capability only sets an error.
        unsafe { (self.0.enable)(capability) }
    }

    /// A parameter of the current device; what it does not fill stays 0.
    pub(super) fn doubles(&self, parameter: u32) -> [f64; 16] {
        let mut values = [0.0; 16];
        // SAFETY: 16 doubles are the most that any parameter has (the transform).
        unsafe { (self.0.get_doubles)(parameter, values.as_mut_ptr()) }
        values
    }

    /// As [`doubles`](Self::doubles), the first value.
    pub(super) fn integer(&self, parameter: u32) -> i32 {
        let mut values = [0; 16];
        // SAFETY: no integer parameter has more than 16 values.
        unsafe { (self.0.get_integers)(parameter, values.as_mut_ptr()) }
        values[0]
    }

    pub(super) fn string(&self, parameter: u32) -> String {
        // SAFETY: takes any number.
        text(unsafe { (self.0.get_string)(parameter) })
    }

    pub(super) fn set(&self, parameter: u32, values: &[f64; 3]) {
        // SAFETY: the parameters set here, force and torque, are read as three doubles.
        unsafe { (self.0.set_doubles)(parameter, values.as_ptr()) }
    }

    /// The oldest entry of the error queue.
    pub(super) fn pop_error(&self) -> Option<ErrorInfo> {
        // SAFETY: no arguments; the result is plain numbers.
        let error = unsafe { (self.0.get_error)() };
        (error.code != 0).then_some(error)
    }

    pub(super) fn error_text(&self, code: u32) -> String {
        // SAFETY: takes any number.
        text(unsafe { (self.0.get_error_string)(code) })
    }

    pub(super) fn check_calibration(&self) -> u32 {
        // SAFETY: no arguments.
        unsafe { (self.0.check_calibration)() }
    }

    pub(super) fn update_calibration(&self, style: u32) {
        // SAFETY: takes any number.
        unsafe { (self.0.update_calibration)(style) }
    }

    pub(super) fn start_scheduler(&self) {
        // SAFETY: no arguments.
        unsafe { (self.0.start_scheduler)() }
    }

    pub(super) fn stop_scheduler(&self) {
        // SAFETY: no arguments.
        unsafe { (self.0.stop_scheduler)() }
    }

    /// Has `servo` called at every tick, on the scheduler's thread.
    pub(super) fn schedule<S: Servo>(&self, servo: &'static S) -> c_ulong {
        let data = std::ptr::from_ref(servo).cast_mut().cast::<c_void>();
        // SAFETY: the data outlive every call ('static) and may be used from any thread (Sync); `call` has the callback's
        // signature and takes the data for what they are.
        unsafe { (self.0.schedule)(call::<S>, data, DEFAULT_PRIORITY) }
    }

    pub(super) fn unschedule(&self, scheduled: c_ulong) {
        // SAFETY: takes any number.
        unsafe { (self.0.unschedule)(scheduled) }
    }
}

extern "system" fn call<S: Servo>(data: *mut c_void) -> u32 {
    // SAFETY: `schedule` has passed a &'static S, and S is Sync.
    let servo = unsafe { &*data.cast_const().cast::<S>() };
    // A panic must not unwind into the vendor's code; its tick is lost, and the message is on standard error.
    let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| servo.tick()));
    CALLBACK_CONTINUE
}

fn text(string: *const c_char) -> String {
    if string.is_null() {
        return String::new();
    }
    // SAFETY: the library's strings are constants ended by zero.
    let string = unsafe { CStr::from_ptr(string) };
    string.to_string_lossy().into_owned()
}
