//! 3Dconnexion's SpaceMouse, through the socket of spacenavd. Six degrees of freedom in, none out.
//!
//! An event is eight 32-bit integers. The daemon's frame is x right, y up, z away.
use crate::link::{DriverEnd, DriverThread, link};
use crate::puck::Puck;
use crate::{DeviceFault, LinkedDevice, OpenError, Specification, Vec3};
use std::io::{ErrorKind, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(2);
/// A reading older than this is stale.
const STALE: Duration = Duration::from_millis(50);
/// Between attempts to reach a lost daemon.
const RETRY: Duration = Duration::from_millis(200);
/// A deflected puck tells so every few milliseconds; one that has been silent for so long is at rest.
const AT_REST: Duration = Duration::from_millis(200);
/// At full deflection (about 350 units): 50 mm/s, 1 rad/s.
const SPEED: f64 = 50.0 / 350.0;
const SPIN: f64 = 1.0 / 350.0;
const EVENT_LEN: usize = 32;
const MAX_EVENTS_A_TICK: usize = 64;

/// Where the daemon's socket is sought: `SPNAV_SOCKET`, else `socket` in /etc/spnavrc, else the default.
fn socket_path() -> PathBuf {
    let from_file = || {
        let text = std::fs::read_to_string("/etc/spnavrc").ok()?;
        let value = |line: &str| {
            let (key, value) = line.split_once('=')?;
            (key.trim() == "socket").then(|| value.trim().to_owned())
        };
        text.lines().find_map(value)
    };
    let given = std::env::var("SPNAV_SOCKET").ok().or_else(from_file);
    PathBuf::from(given.unwrap_or_else(|| "/var/run/spnav.sock".to_owned()))
}

/// Connects to the daemon; it speaks for all pucks as one.
///
/// # Errors
/// The daemon is not there.
pub fn connect() -> Result<LinkedDevice, OpenError> {
    connect_to(&socket_path())
}

/// Likewise at a socket's path.
///
/// # Errors
/// The daemon is not there.
pub fn connect_to(path: &Path) -> Result<LinkedDevice, OpenError> {
    let stream = open(path).map_err(|error| OpenError::Missing {
        what: "spacenavd",
        sought: format!("{} ({error})", path.display()),
        mend: "install and start spacenavd, or set SPNAV_SOCKET to its socket".to_owned(),
    })?;
    let specification = Specification {
        model: "SpaceMouse".to_owned(),
        dofs_in: 6,
        ..Specification::default()
    };
    let thread = Arc::new(DriverThread::default());
    let (device, end) = link(specification, STALE, thread.clone());
    let mut client = Client {
        path: path.to_owned(),
        end,
        puck: Puck::default(),
        state: State::default(),
    };
    thread.start("spacenav", move || client.serve(stream))?;
    Ok(device)
}

fn open(path: &Path) -> std::io::Result<UnixStream> {
    let stream = UnixStream::connect(path)?;
    stream.set_nonblocking(true)?;
    Ok(stream)
}

/// What events have said so far.
#[derive(Default)]
struct State {
    velocity: Vec3,
    spin: Vec3,
    buttons: u32,
    moved: Option<Instant>,
}

impl State {
    fn take(&mut self, event: &[u8; EVENT_LEN]) {
        let word = |i: usize| {
            let bytes = [0, 1, 2, 3].map(|k| event[4 * i + k]);
            i32::from_ne_bytes(bytes)
        };
        let number = |i| f64::from(word(i));
        let bit = u32::try_from(word(1))
            .ok()
            .filter(|b| *b < 32)
            .map_or(0, |b| 1 << b);
        match word(0) {
            0 => {
                self.velocity = SPEED * Vec3::new(number(1), number(3), number(2));
                self.spin = SPIN * Vec3::new(number(4), number(6), number(5));
                self.moved = Some(Instant::now());
            }
            1 => self.buttons |= bit,
            2 => self.buttons &= !bit,
            _ => {}
        }
    }

    fn settle(&mut self) {
        if self.moved.is_some_and(|m| m.elapsed() > AT_REST) {
            self.velocity = Vec3::zeros();
            self.spin = Vec3::zeros();
        }
    }
}

struct Client {
    path: PathBuf,
    end: DriverEnd,
    puck: Puck,
    state: State,
}

impl Client {
    fn serve(&mut self, stream: UnixStream) {
        let mut connected = Some(stream);
        while !self.end.is_abandoned() {
            if let Some(stream) = connected.take() {
                self.end.set_fault(None);
                self.follow(stream);
                self.state = State::default();
                self.end.set_fault(Some(DeviceFault::Unplugged));
            }
            std::thread::sleep(RETRY);
            connected = open(&self.path).ok();
        }
    }

    /// Until the daemon goes.
    fn follow(&mut self, mut stream: UnixStream) {
        let mut before = Instant::now();
        let mut partial = Vec::with_capacity(EVENT_LEN * MAX_EVENTS_A_TICK);
        while !self.end.is_abandoned() {
            if !self.read(&mut stream, &mut partial) {
                return;
            }
            self.state.settle();
            let dt = before.elapsed().as_secs_f64().min(0.02);
            before = Instant::now();
            let State {
                velocity,
                spin,
                buttons,
                ..
            } = self.state;
            let reading = self.puck.advance(velocity, spin, buttons, dt);
            if self.end.publish(reading).is_err() {
                return;
            }
            // Nothing is displayed; but this tells how long answers take.
            self.end.wrench();
            std::thread::sleep(PERIOD);
        }
    }

    /// Takes the events that are there; false where the daemon is gone.
    fn read(&mut self, stream: &mut UnixStream, partial: &mut Vec<u8>) -> bool {
        let mut bytes = [0; EVENT_LEN * MAX_EVENTS_A_TICK];
        match stream.read(&mut bytes) {
            Ok(0) => return false,
            Ok(n) => partial.extend(&bytes[..n]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return true,
            Err(error) => return error.kind() == ErrorKind::Interrupted,
        }
        let events = partial.as_chunks::<EVENT_LEN>().0;
        events.iter().for_each(|e| self.state.take(e));
        let taken = events.len() * EVENT_LEN;
        partial.drain(..taken);
        true
    }
}
