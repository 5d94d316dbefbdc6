//! Linux: the kernel's joydev. A gamepad is a file js0, js1, ...; reading it gives 8 bytes an event, and first of all an
//! event for each axis and button as it stands. Axes come calibrated, +-32767. Which of the pad's axes and buttons an
//! event's number means follows from the lists of what it has, in sysfs: joydev counts them up in the order of their codes,
//! buttons from `BTN_JOYSTICK` on first (Linux, drivers/input/joydev.c).
use super::{Controls, Present};
use crate::OpenError;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Of the kernel's input-event-codes.h.
mod code {
    pub const ABS_X: u16 = 0x00;
    pub const ABS_Y: u16 = 0x01;
    pub const ABS_Z: u16 = 0x02;
    pub const ABS_RX: u16 = 0x03;
    pub const ABS_RY: u16 = 0x04;
    pub const ABS_RZ: u16 = 0x05;
    pub const BTN_MISC: u16 = 0x100;
    pub const BTN_JOYSTICK: u16 = 0x120;
    /// `BTN_SOUTH`, `BTN_EAST`, `BTN_WEST`, `BTN_NORTH`, as the pad's driver calls them.
    pub const BUTTONS: [u16; 4] = [0x130, 0x131, 0x134, 0x133];
    pub const SHOULDERS: [u16; 2] = [0x136, 0x137];
    pub const KEY_MAX: u16 = 0x2ff;
}

const EVENT_LEN: usize = 8;
const MAX_EVENTS_A_TICK: usize = 64;
const BUTTON: u8 = 1;
const AXIS: u8 = 2;
/// Set in events that tell how things stand.
const INITIAL: u8 = 0x80;
/// Between attempts to reach a pad that is gone.
const RETRY: Duration = Duration::from_millis(200);

/// Where the system keeps its input devices; files also where `OSTEOTOME_INPUT` says.
#[derive(Clone, Debug)]
pub struct Places {
    /// Files to read.
    pub devices: PathBuf,
    /// What they are.
    pub descriptions: PathBuf,
}

impl Default for Places {
    fn default() -> Self {
        let given = std::env::var_os("OSTEOTOME_INPUT").map(PathBuf::from);
        Self {
            devices: given.unwrap_or_else(|| "/dev/input".into()),
            descriptions: "/sys/class/input".into(),
        }
    }
}

/// All gamepads of a system.
#[derive(Default)]
pub(super) struct Pads {
    places: Places,
    /// `Err`: when it was last looked for.
    open: BTreeMap<usize, Result<Pad, Instant>>,
}

impl Pads {
    pub(super) fn within(places: Places) -> Self {
        Self {
            places,
            ..Self::default()
        }
    }

    /// Those that are there.
    pub(super) fn present(&mut self) -> Result<Vec<Present>, OpenError> {
        let missing = |why: &str| OpenError::Missing {
            what: "a gamepad",
            sought: format!("{}/js*{why}", self.places.devices.display()),
            mend: "connect one that the kernel's joydev serves (modprobe joydev)".to_owned(),
        };
        let files = std::fs::read_dir(&self.places.devices);
        let files = files.map_err(|e| missing(&format!(" ({e})")))?;
        let number = |f: std::io::Result<std::fs::DirEntry>| {
            let name = f.ok()?.file_name();
            name.to_str()?.strip_prefix("js")?.parse().ok()
        };
        let mut numbers: Vec<usize> = files.filter_map(number).collect();
        numbers.sort_unstable();
        let (mut present, mut refused) = (Vec::new(), String::new());
        for number in numbers {
            let Some(layout) = self.places.layout(number) else {
                continue;
            };
            match self.places.open(number) {
                Ok(_) => present.push(Present {
                    number,
                    name: layout.name,
                }),
                Err(error) => refused += &format!(" (js{number}: {error})"),
            }
        }
        if present.is_empty() {
            return Err(missing(&refused));
        }
        Ok(present)
    }

    /// What is held on one of them; `None` while it is unplugged, or another has its number.
    pub(super) fn held(&mut self, wanted: &Present) -> Option<Controls> {
        let number = wanted.number;
        let slot = self.open.entry(number).or_insert_with(|| {
            let now = Instant::now();
            Err(now.checked_sub(RETRY).unwrap_or(now))
        });
        if slot.as_ref().is_err_and(|sought| sought.elapsed() >= RETRY) {
            let pad = self.places.pad(wanted);
            *slot = pad.ok_or_else(Instant::now);
        }
        let pad = slot.as_mut().ok()?;
        if pad.take_events() {
            return Some(pad.controls());
        }
        *slot = Err(Instant::now());
        None
    }
}

impl Places {
    fn open(&self, number: usize) -> std::io::Result<File> {
        let path = self.devices.join(format!("js{number}"));
        let mut options = OpenOptions::new();
        options.read(true).custom_flags(libc::O_NONBLOCK).open(path)
    }

    fn layout(&self, number: usize) -> Option<Layout> {
        Layout::of(&self.descriptions.join(format!("js{number}/device")))
    }

    fn pad(&self, wanted: &Present) -> Option<Pad> {
        let layout = self.layout(wanted.number)?;
        let is_it = layout.name == wanted.name;
        let file = is_it.then(|| self.open(wanted.number).ok())??;
        Some(Pad {
            file,
            axes: vec![0.0; layout.axes.len()],
            buttons: vec![false; layout.buttons.len()],
            layout,
            partial: Vec::with_capacity(EVENT_LEN * (MAX_EVENTS_A_TICK + 1)),
        })
    }
}

/// What a pad has, in joydev's order.
struct Layout {
    name: String,
    axes: Vec<u16>,
    buttons: Vec<u16>,
}

impl Layout {
    /// `None` for what is no gamepad: flight sticks, and motion sensors, which joydev serves too.
    fn of(device: &Path) -> Option<Self> {
        let read = |name: &str| std::fs::read_to_string(device.join(name)).ok();
        let axes = codes(&read("capabilities/abs")?);
        let keys = codes(&read("capabilities/key")?);
        let is_gamepad = axes.contains(&code::ABS_X) && keys.contains(&code::BUTTONS[0]);
        let within = |from, to| {
            keys.iter()
                .copied()
                .filter(move |k| (from..=to).contains(k))
        };
        let buttons = within(code::BTN_JOYSTICK, code::KEY_MAX);
        let buttons = buttons.chain(within(code::BTN_MISC, code::BTN_JOYSTICK - 1));
        is_gamepad.then(|| Self {
            name: read("name").unwrap_or_default().trim().to_owned(),
            buttons: buttons.collect(),
            axes,
        })
    }

    /// The right stick; pads without one of its own name use Z and RZ.
    fn right_stick(&self) -> [u16; 2] {
        if self.axes.contains(&code::ABS_RX) && self.axes.contains(&code::ABS_RY) {
            [code::ABS_RX, code::ABS_RY]
        } else {
            [code::ABS_Z, code::ABS_RZ]
        }
    }
}

/// The bits that are set in a bitmap of sysfs: hexadecimal machine words, the highest first.
fn codes(bitmap: &str) -> Vec<u16> {
    let words = bitmap.split_whitespace().rev();
    let words = words.map(|w| usize::from_str_radix(w, 16).unwrap_or(0));
    let bits = words.zip(0u16..).flat_map(|(word, at)| {
        let set = (0..usize::BITS as u16).filter(move |bit| word >> bit & 1 == 1);
        set.map(move |bit| at * usize::BITS as u16 + bit)
    });
    bits.collect()
}

struct Pad {
    file: File,
    layout: Layout,
    axes: Vec<f64>,
    buttons: Vec<bool>,
    /// An event that has not come whole.
    partial: Vec<u8>,
}

impl Pad {
    /// Takes the events that are there; false where the pad is gone.
    fn take_events(&mut self) -> bool {
        let mut bytes = [0; EVENT_LEN * MAX_EVENTS_A_TICK];
        match self.file.read(&mut bytes) {
            Ok(0) => return false,
            Ok(n) => self.partial.extend(&bytes[..n]),
            Err(error) => {
                return matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted);
            }
        }
        let events = self.partial.as_chunks::<EVENT_LEN>().0;
        // Time stamps (4 bytes) are not used: what is held now counts.
        for &[_, _, _, _, low, high, kind, number] in events {
            let value = i16::from_ne_bytes([low, high]);
            let number = usize::from(number);
            match kind & !INITIAL {
                AXIS => {
                    if let Some(axis) = self.axes.get_mut(number) {
                        *axis = f64::from(value.max(-i16::MAX)) / f64::from(i16::MAX);
                    }
                }
                BUTTON => {
                    if let Some(button) = self.buttons.get_mut(number) {
                        *button = value != 0;
                    }
                }
                _ => {}
            }
        }
        let taken = events.len() * EVENT_LEN;
        self.partial.drain(..taken);
        true
    }

    fn controls(&self) -> Controls {
        let axis = |code: u16| {
            let at = self.layout.axes.iter().position(|a| *a == code);
            at.map_or(0.0, |at| self.axes[at])
        };
        let is_held = |code: u16| {
            let at = self.layout.buttons.iter().position(|b| *b == code);
            at.is_some_and(|at| self.buttons[at])
        };
        // The kernel's y axes point to the user.
        let stick = |[x, y]: [u16; 2]| [axis(x), -axis(y)];
        let pressed = (0..4).filter(|i| is_held(code::BUTTONS[*i]));
        Controls {
            sticks: [
                stick([code::ABS_X, code::ABS_Y]),
                stick(self.layout.right_stick()),
            ],
            shoulders: code::SHOULDERS.map(is_held),
            buttons: pressed.map(|i| 1 << i).sum(),
        }
    }
}
