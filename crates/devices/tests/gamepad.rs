//! The gamepad's driver against stand-ins for the kernel's joystick files: a named pipe for `js0`, and what sysfs says of it.
#![cfg(target_os = "linux")]
use osteotome_devices::gamepad::{Places, connect_in};
use osteotome_devices::{DeviceFault, HapticDevice, LinkedDevice, Vec3};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "still not: {what}"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A bitmap as sysfs shows it on this machine.
fn bitmap(codes: &[usize]) -> String {
    let bits = usize::BITS as usize;
    let n = codes.iter().max().unwrap() / bits + 1;
    let mut words = vec![0_usize; n];
    codes
        .iter()
        .for_each(|c| words[c / bits] |= 1 << (c % bits));
    let words: Vec<_> = words.iter().rev().map(|w| format!("{w:x}")).collect();
    words.join(" ")
}

struct Kernel(tempfile::TempDir);

impl Kernel {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("dev")).unwrap();
        Self(folder)
    }

    fn places(&self) -> Places {
        let [devices, descriptions] = ["dev", "sys"].map(|f| self.0.path().join(f));
        Places {
            devices,
            descriptions,
        }
    }

    fn file(&self, number: usize) -> std::path::PathBuf {
        self.places().devices.join(format!("js{number}"))
    }

    fn describe(&self, number: usize, name: &str, axes: &[usize], keys: &[usize]) {
        let device = self.places().descriptions;
        let device = device.join(format!("js{number}/device"));
        std::fs::create_dir_all(device.join("capabilities")).unwrap();
        let write = |file: &str, text: &str| {
            std::fs::write(device.join(file), format!("{text}\n")).unwrap();
        };
        write("name", name);
        write("capabilities/abs", &bitmap(axes));
        write("capabilities/key", &bitmap(keys));
    }

    fn make_file(&self, number: usize) {
        let made = Command::new("mkfifo").arg(self.file(number)).status();
        assert!(made.unwrap().success());
    }

    fn plug(&self, number: usize) -> Pad {
        // For reading too, so that opening does not wait for the driver.
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).open(self.file(number));
        Pad(file.unwrap())
    }
}

/// The kernel's end of a pad's file.
struct Pad(File);

impl Pad {
    /// `struct js_event`: time, value, kind, number.
    fn tell(&mut self, kind: u8, number: u8, value: i16) {
        let mut event = vec![1, 2, 3, 4];
        event.extend(value.to_ne_bytes());
        event.extend([kind, number]);
        // In two halves, as no kernel does.
        self.0.write_all(&event[..3]).unwrap();
        self.0.write_all(&event[3..]).unwrap();
    }
}

const INITIAL: u8 = 0x80;
const BUTTON: u8 = 1;
const AXIS: u8 = 2;

/// X, Y, Z, RX, RY, RZ and the cross: as the kernel's driver for Xbox pads has them.
const XBOX_AXES: [usize; 8] = [0, 1, 2, 3, 4, 5, 0x10, 0x11];
/// South, east, north, west, shoulders, select, start, mode, thumbs.
const XBOX_KEYS: [usize; 11] = [
    0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x13a, 0x13b, 0x13c, 0x13d, 0x13e,
];

fn only(found: Vec<LinkedDevice>) -> LinkedDevice {
    let [device]: [_; 1] = found.try_into().ok().expect("one gamepad");
    device
}

fn fault(device: &mut LinkedDevice) -> Option<DeviceFault> {
    device.read();
    device.health().fault
}

#[test]
fn sticks_and_buttons_are_what_the_kernel_says_they_are() {
    let kernel = Kernel::new();
    kernel.describe(0, "A pad", &XBOX_AXES, &XBOX_KEYS);
    kernel.make_file(0);
    let mut pad = kernel.plug(0);
    let mut device = only(connect_in(kernel.places()).unwrap());
    let s = device.specification();
    assert_eq!(
        (s.model.as_str(), s.serial.as_str(), s.dofs_in, s.dofs_out),
        ("A pad", "0", 5, 0)
    );
    // As it stands when opened: a trigger (axis 2) at its rest, -1, which moves nothing.
    pad.tell(INITIAL | AXIS, 2, -32767);
    until("it reads", || fault(&mut device).is_none());
    assert_eq!(device.read().velocity, Vec3::zeros());
    // Left stick half to the right and fully away, right stick fully down; the kernel counts y towards the user.
    pad.tell(AXIS, 0, 16384);
    pad.tell(AXIS, 1, -32767);
    pad.tell(AXIS, 4, 32767);
    let wanted = Vec3::new(50.0 * 16384.0 / 32767.0, 50.0, -50.0);
    until("it moves", || {
        (device.read().velocity - wanted).norm() < 1e-9
    });
    // Right stick to the right turns clockwise seen from above, the right shoulder (button 5) pitches.
    pad.tell(AXIS, 3, 32767);
    pad.tell(BUTTON, 5, 1);
    until("it turns", || {
        device.read().angular_velocity == Vec3::new(1.0, 0.0, -1.0)
    });
    // South and west (button 3, after north): bits 0 and 2; start (7), an unknown button and an unknown kind are nothing.
    for (kind, number) in [(BUTTON, 0), (BUTTON, 3), (BUTTON, 7), (BUTTON, 90), (7, 0)] {
        pad.tell(kind, number, 1);
    }
    until("two buttons are down", || device.read().buttons == 0b101);
    pad.tell(BUTTON, 0, 0);
    until("one is let go", || device.read().buttons == 0b100);
}

#[test]
fn a_pad_without_a_right_stick_of_that_name_uses_z_and_rz() {
    let kernel = Kernel::new();
    // X, Y, Z, RZ: the last is axis 3. Keys below BTN_JOYSTICK are counted after those above.
    kernel.describe(2, "Plain", &[0, 1, 2, 5], &[0x110, 0x130, 0x131]);
    kernel.make_file(2);
    let mut pad = kernel.plug(2);
    let mut device = only(connect_in(kernel.places()).unwrap());
    assert_eq!(device.specification().serial, "2");
    pad.tell(AXIS, 3, -32767);
    pad.tell(BUTTON, 1, 1);
    until("it goes up, and east is down", || {
        let reading = device.read();
        reading.velocity == Vec3::new(0.0, 0.0, 50.0) && reading.buttons == 0b10
    });
}

#[test]
fn unplugged_it_is_gone_and_plugged_in_again_it_is_back() {
    let kernel = Kernel::new();
    kernel.describe(0, "A pad", &XBOX_AXES, &XBOX_KEYS);
    kernel.make_file(0);
    let mut pad = kernel.plug(0);
    let mut device = only(connect_in(kernel.places()).unwrap());
    pad.tell(AXIS, 0, 32767);
    until("it moves", || device.read().velocity.x == 50.0);
    let unplug = |pad: Pad| {
        drop(pad);
        std::fs::remove_file(kernel.file(0)).unwrap();
    };
    unplug(pad);
    let is_gone = |d: &mut LinkedDevice| fault(d) == Some(DeviceFault::Unplugged);
    until("it is gone", || is_gone(&mut device));

    // Another that got its number is not followed.
    kernel.describe(0, "Another", &XBOX_AXES, &XBOX_KEYS);
    kernel.make_file(0);
    let another = kernel.plug(0);
    std::thread::sleep(Duration::from_millis(500));
    assert!(is_gone(&mut device));
    unplug(another);

    kernel.describe(0, "A pad", &XBOX_AXES, &XBOX_KEYS);
    kernel.make_file(0);
    let _pad = kernel.plug(0);
    until("it is back, at rest", || {
        fault(&mut device).is_none() && device.read().velocity == Vec3::zeros()
    });
}

fn refusal(places: Places) -> String {
    connect_in(places).err().expect("none").to_string()
}

#[test]
fn what_is_no_gamepad_is_passed_over_and_none_is_named_with_its_place() {
    let kernel = Kernel::new();
    // A flight stick (trigger, thumb), and a motion sensor.
    kernel.describe(0, "Stick", &[0, 1, 2], &[0x120, 0x121]);
    kernel.describe(1, "Sensor", &[0, 1, 2], &[0x1]);
    (0..2).for_each(|number| kernel.make_file(number));
    let text = refusal(kernel.places());
    assert!(
        text.contains("dev/js*") && text.contains("joydev"),
        "{text}"
    );
    let nowhere = Places {
        devices: Path::new("/nowhere").into(),
        ..kernel.places()
    };
    assert!(refusal(nowhere).contains("/nowhere/js*"));
    // One that may not be opened says why.
    kernel.describe(3, "A pad", &XBOX_AXES, &XBOX_KEYS);
    std::os::unix::fs::symlink("js3", kernel.file(3)).unwrap();
    let text = refusal(kernel.places());
    assert!(text.contains("js3: "), "{text}");
}
