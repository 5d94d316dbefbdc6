//! Stand-ins for the vendors' libraries, built from their C sources, and the hands that make them fail.
#![allow(dead_code, unsafe_code)]
mod building;
pub mod haply_service;

#[allow(unused_imports)]
pub use building::build;

use libloading::Library;
use std::path::Path;
use std::time::{Duration, Instant};

/// The strings that move the puppet: the same library, loaded again.
pub struct Strings(Library);

impl Strings {
    pub fn of(path: &Path) -> Self {
        // SAFETY: the stand-in has no initialisers.
        Self(unsafe { Library::new(path) }.expect("the stand-in loads"))
    }

    /// `standin_NAME(device, value)`.
    pub fn set(&self, name: &str, device: i32, value: i32) {
        // SAFETY: the stand-ins' functions have this signature.
        unsafe {
            let f = self
                .0
                .get::<unsafe extern "C" fn(i32, i32)>(format!("standin_{name}"));
            f.expect("a known string")(device, value);
        }
    }

    /// Where the simulated hand goes, in mm of the vendor's frame.
    pub fn lead(&self, device: i32, [x, y, z]: [f64; 3]) {
        // SAFETY: the stand-ins' function has this signature.
        unsafe {
            let f = self
                .0
                .get::<unsafe extern "C" fn(i32, f64, f64, f64)>("standin_move");
            f.expect("a known string")(device, x, y, z);
        }
    }

    /// Force and torque that the device displays, in the vendor's units.
    pub fn shown(&self, device: i32) -> [f64; 6] {
        let mut values = [0.0; 6];
        // SAFETY: the stand-ins' function writes six doubles.
        unsafe {
            let f = self
                .0
                .get::<unsafe extern "C" fn(i32, *mut f64)>("standin_shown");
            f.expect("a known string")(device, values.as_mut_ptr());
        }
        values
    }
}

/// Waits for what must come about; however slow the machine, it fails only after a minute.
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "still not: {what}"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}
