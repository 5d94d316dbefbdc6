//! From the reading of a device to the wrench that answers it, for each transport: `cargo bench -p osteotome-devices`.
//!
//! The devices are stand-ins on this machine, so that what is measured is the driver and its transport, not a vendor's
//! hardware. The haptic thread is `exercise`: 1 kHz, free of the vendors' clocks, and next to no work a step.
#![allow(clippy::print_stdout, unsafe_code)]
#[path = "../tests/standin/mod.rs"]
mod standin;

use osteotome_devices::{
    HandParameters, HapticDevice, LinkedDevice, Pose, SimulatedHand, exercise, force_dimension,
    haply, openhaptics, remote,
};
use standin::{build, haply_service};
use std::net::UdpSocket;
use std::thread::Builder;
use std::time::{Duration, Instant};

const DURATION: Duration = Duration::from_secs(5);

fn row(name: &str, device: &mut dyn HapticDevice) {
    let e = exercise(device, DURATION);
    let [p50, p99] = e.read_to_write_us;
    println!(
        "{name:<16} {:5.0} readings/s, jitter {:4.0} us; on the haptic thread {p50} / {p99} us; fault {:?}",
        e.rate_hz, e.jitter_us, e.fault
    );
}

fn linked(name: &str, mut device: LinkedDevice) {
    standin::until("it reads", || {
        device.read();
        device.health().fault.is_none()
    });
    row(name, &mut device);
    let l = device.latency();
    let quantile = |share| l.quantile_us(share).unwrap_or(0);
    println!(
        "{:<16} device to device {} / {} us (median / 99 %), {} wrenches",
        "",
        quantile(0.5),
        quantile(0.99),
        l.n()
    );
}

/// Sends poses at 1 kHz and takes the answers' round trips.
fn remote_client(address: std::net::SocketAddr) -> Vec<u64> {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    socket.connect(address).expect("loopback");
    socket.set_nonblocking(true).expect("a socket");
    let start = Instant::now();
    let clock = || start.elapsed().as_micros() as u64;
    let mut trips = Vec::new();
    let mut sequence = 0_u32;
    while start.elapsed() < DURATION {
        sequence += 1;
        let mut packet = b"OSTH\x01\0\x01\0\x07\0\0\0".to_vec();
        packet.extend(sequence.to_le_bytes());
        packet.extend(clock().to_le_bytes());
        for i in 0..13 {
            packet.extend(f64::from(u8::from(i == 6)).to_le_bytes());
        }
        packet.extend([0; 8]);
        let _ = socket.send(&packet);
        let mut answer = [0; 200];
        let next = start + Duration::from_millis(u64::from(sequence));
        while Instant::now() < next {
            if let Ok(88) = socket.recv(&mut answer) {
                let sent = u64::from_le_bytes(answer[16..24].try_into().expect("8 bytes"));
                trips.push(clock().saturating_sub(sent));
            } else {
                std::thread::sleep(Duration::from_micros(50));
            }
        }
    }
    trips
}

fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = SimulatedHand::new(HandParameters::default(), Pose::identity(), 1e-3)
        .expect("default parameters");
    row("simulated", &mut hand);

    // SAFETY: no other thread has been started yet that could read the environment meanwhile.
    unsafe {
        std::env::set_var("OSTEOTOME_LIBHD", build("libHD", folder.path()));
        std::env::set_var("OSTEOTOME_LIBDHD", build("libdhd", folder.path()));
    }
    let first = |devices: Vec<LinkedDevice>| devices.into_iter().next().expect("a device");
    linked(
        "openhaptics",
        first(openhaptics::connect().expect("the stand-in")),
    );
    linked(
        "forcedimension",
        first(force_dimension::connect().expect("the stand-in")),
    );
    let (_, address) = haply_service::start(true);
    linked(
        "haply",
        first(haply::connect_to(&address).expect("the stand-in")),
    );

    let hand = remote::listen("127.0.0.1:0".parse().expect("an address"), false).expect("a port");
    let address = hand.address;
    let client = Builder::new()
        .name("client".into())
        .spawn(move || remote_client(address));
    linked("remote", hand.device);
    let mut trips = client.expect("a thread").join().expect("the client ends");
    trips.sort_unstable();
    let quantile = |share: f64| trips[(share * (trips.len() - 1) as f64) as usize];
    println!(
        "{:<16} client's pose to its wrench {} / {} us",
        "",
        quantile(0.5),
        quantile(0.99)
    );
}
