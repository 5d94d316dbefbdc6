//! Haply's Inverse3, through its service's WebSocket.
//!
//! One thread sends a message a millisecond (all devices' forces, zero ones too: they keep the service alive) and takes
//! the answer. The service is told nothing but forces.
mod message;

use crate::link::{DriverEnd, DriverThread, link};
use crate::pace::{Pace, raise_priority};
use crate::{DeviceFault, INVERSE_3, LinkedDevice, OpenError, Specification, Vec3};
use message::{Dialect, Message, forces};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::Duration;
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Error, WebSocket};

/// Where the service is, unless [`VARIABLE`] says otherwise.
const ADDRESS: &str = "127.0.0.1:10001";
const VARIABLE: &str = "OSTEOTOME_HAPLY";
const PERIOD: Duration = Duration::from_millis(1);
/// A reading older than this is stale.
const STALE: Duration = Duration::from_millis(30);
/// An answer that takes longer than this is not waited for any more: the connection is made anew.
const STALL: Duration = Duration::from_millis(100);
const CONNECT: Duration = Duration::from_secs(1);
/// Between attempts to reach a lost service.
const RETRY: Duration = Duration::from_millis(300);
/// The service's largest message, its inventory, takes a few kilobytes.
const MAX_MESSAGE: usize = 1 << 20;

/// Opens all devices of the service.
///
/// # Errors
/// The service is not there or does not speak its protocol; it has no device.
pub fn connect() -> Result<Vec<LinkedDevice>, OpenError> {
    let address = std::env::var(VARIABLE).unwrap_or_else(|_| ADDRESS.to_owned());
    connect_to(&address)
}

/// Likewise at an address `HOST:PORT`.
///
/// # Errors
/// As [`connect`].
pub fn connect_to(address: &str) -> Result<Vec<LinkedDevice>, OpenError> {
    let missing = |sought: String| OpenError::Missing {
        what: "Haply's Inverse service",
        sought: format!("ws://{sought}"),
        mend: format!("install and start Haply Hub, or set {VARIABLE} to HOST:PORT"),
    };
    let resolved = address.to_socket_addrs().ok().and_then(|mut a| a.next());
    let resolved = resolved.ok_or_else(|| missing(address.to_owned()))?;
    let (socket, inventory) =
        greet(resolved).map_err(|e| missing(format!("{address} ({})", one_line(&e))))?;
    let refused = |message: &str| OpenError::Refused {
        driver: "haply",
        message: message.to_owned(),
    };
    let inventory = Message::parse(&inventory).ok_or_else(|| {
        refused("the service's inventory cannot be read; is it version 3.1 or later?")
    })?;
    let ids = inventory.device_ids();
    if ids.is_empty() {
        return Err(refused(
            "the service is there, but no Inverse3 is connected to it",
        ));
    }
    let thread = Arc::new(DriverThread::default());
    let (devices, arms) = ids
        .into_iter()
        .map(|id| {
            let specification = Specification::of(&INVERSE_3, id.clone());
            let (device, end) = link(specification, STALE, thread.clone());
            (device, Arm { id, end })
        })
        .unzip();
    let mut client = Client {
        address: resolved,
        arms,
        dialect: inventory.dialect(),
    };
    thread.start("haply", move || client.serve(socket))?;
    Ok(devices)
}

fn one_line(error: &Error) -> String {
    error.to_string().replace('\n', " ")
}

/// Connects and takes the inventory.
fn greet(address: SocketAddr) -> Result<(WebSocket<TcpStream>, String), Error> {
    let stream = TcpStream::connect_timeout(&address, CONNECT)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(CONNECT))?;
    stream.set_write_timeout(Some(STALL))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE))
        .max_frame_size(Some(MAX_MESSAGE));
    let url = format!("ws://{address}/");
    let (mut socket, _) = tungstenite::client::client_with_config(url, stream, Some(config))
        .map_err(|e| match e {
            tungstenite::HandshakeError::Failure(error) => error,
            tungstenite::HandshakeError::Interrupted(_) => {
                Error::Io(std::io::ErrorKind::TimedOut.into())
            }
        })?;
    let inventory = text(&mut socket)?;
    socket.get_ref().set_read_timeout(Some(STALL))?;
    Ok((socket, inventory))
}

/// The next text message. The read timeout bounds the wait for each frame.
fn text(socket: &mut WebSocket<TcpStream>) -> Result<String, Error> {
    const MOST: usize = 16;
    for _ in 0..MOST {
        let message = socket.read()?;
        if message.is_text() {
            return Ok(message.into_text()?.to_string());
        }
    }
    Err(Error::Io(std::io::ErrorKind::InvalidData.into()))
}

struct Arm {
    id: String,
    end: DriverEnd,
}

/// The service's devices, as the thread sees them.
struct Client {
    address: SocketAddr,
    arms: Vec<Arm>,
    dialect: Dialect,
}

impl Client {
    fn is_abandoned(&self) -> bool {
        self.arms.iter().all(|a| a.end.is_abandoned())
    }

    fn serve(&mut self, socket: WebSocket<TcpStream>) {
        raise_priority();
        let mut connected = Some(socket);
        while !self.is_abandoned() {
            if let Some(mut socket) = connected.take() {
                self.drive(&mut socket);
                // Whatever the service still displays ends with its client.
                let _ = socket.close(None).and_then(|()| socket.flush());
                self.report(Some(DeviceFault::Communication));
                continue;
            }
            std::thread::sleep(RETRY);
            if let Ok((socket, inventory)) = greet(self.address)
                && let Some(inventory) = Message::parse(&inventory)
            {
                self.dialect = inventory.dialect();
                connected = Some(socket);
            }
        }
    }

    fn report(&self, fault: Option<DeviceFault>) {
        self.arms.iter().for_each(|a| a.end.set_fault(fault));
    }

    /// Until the connection fails, stalls, or nobody wants it any more.
    fn drive(&mut self, socket: &mut WebSocket<TcpStream>) {
        let mut pace = Pace::new(PERIOD);
        while !self.is_abandoned() {
            if self.tick(socket).is_err() {
                return;
            }
            pace.wait();
        }
        let zero: Vec<_> = self
            .arms
            .iter()
            .map(|a| (a.id.as_str(), Vec3::zeros()))
            .collect();
        let _ = socket.send(forces(self.dialect, &zero).into());
    }

    fn tick(&mut self, socket: &mut WebSocket<TcpStream>) -> Result<(), Error> {
        let told: Vec<_> = self
            .arms
            .iter_mut()
            .map(|a| (a.id.as_str(), a.end.wrench().force))
            .collect();
        socket.send(forces(self.dialect, &told).into())?;
        let answer = text(socket)?;
        self.take(&answer);
        Ok(())
    }

    fn take(&mut self, answer: &str) {
        let Some(message) = Message::parse(answer) else {
            return self.report(Some(DeviceFault::Malformed));
        };
        for (index, arm) in self.arms.iter_mut().enumerate() {
            let fault = match message.reading(index, &arm.id) {
                Some(reading) => arm.end.publish(reading).err(),
                None => Some(DeviceFault::Unplugged),
            };
            arm.end.set_fault(fault);
        }
    }
}
