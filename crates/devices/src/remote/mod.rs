//! A hand led by another program over UDP: docs/remote-hand.md.
mod packet;

use crate::link::{DriverEnd, DriverThread, link};
use crate::pace::raise_priority;
use crate::{DeviceFault, LinkedDevice, OpenError, PREMIUM_6DOF, Specification};
use packet::{POSE_LEN, PosePacket, WrenchPacket};
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A reading older than this is stale.
const STALE: Duration = Duration::from_millis(50);
/// A client silent for so long has gone; another may take its place.
const GONE: Duration = Duration::from_secs(1);
/// Packets looked at before the wrench is seen to again.
const MAX_BURST: usize = 256;
/// Between two looks at the socket, with and without a client.
const NAPS: [Duration; 2] = [Duration::from_micros(200), Duration::from_millis(2)];

/// Packets by what became of them.
#[derive(Debug, Default)]
pub struct RemoteCounts {
    accepted: AtomicU64,
    malformed: AtomicU64,
    old: AtomicU64,
    foreign: AtomicU64,
}

impl RemoteCounts {
    /// Led the hand.
    pub fn accepted(&self) -> u64 {
        self.accepted.load(Ordering::Relaxed)
    }
    /// Of wrong size or content.
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }
    /// Repeated, or overtaken by a newer one.
    pub fn old(&self) -> u64 {
        self.old.load(Ordering::Relaxed)
    }
    /// From others than the client that leads.
    pub fn foreign(&self) -> u64 {
        self.foreign.load(Ordering::Relaxed)
    }
}

/// A hand that listens for its client.
pub struct RemoteHand {
    /// The device.
    pub device: LinkedDevice,
    /// What became of packets.
    pub counts: Arc<RemoteCounts>,
    /// Where it listens.
    pub address: SocketAddr,
}

/// Listens on `address`. The limits are those of the largest device with torque; a scenario narrows them.
///
/// # Errors
/// An address that is reached from other machines without `allow_network`; a socket that cannot be had.
pub fn listen(address: SocketAddr, allow_network: bool) -> Result<RemoteHand, OpenError> {
    if !address.ip().is_loopback() && !allow_network {
        return Err(OpenError::Refused {
            driver: "remote",
            message: format!(
                "{address} can be reached from other machines, and packets are not authenticated; give a loopback address, or allow_network = true"
            ),
        });
    }
    let io = |error| OpenError::Io {
        what: format!("remote: listening on {address}"),
        error,
    };
    let socket = UdpSocket::bind(address).map_err(io)?;
    socket.set_nonblocking(true).map_err(io)?;
    let address = socket.local_addr().map_err(io)?;
    let mut specification = Specification::of(&PREMIUM_6DOF, address.to_string());
    "remote".clone_into(&mut specification.model);
    specification.nominal_stiffness = None;
    let thread = Arc::new(DriverThread::default());
    let (device, end) = link(specification, STALE, thread.clone());
    let counts = Arc::new(RemoteCounts::default());
    let mut server = Server {
        socket,
        end,
        counts: counts.clone(),
        start: Instant::now(),
        client: None,
        newest: None,
    };
    thread.start("remote", move || server.serve())?;
    Ok(RemoteHand {
        device,
        counts,
        address,
    })
}

/// Who leads the hand.
struct Client {
    address: SocketAddr,
    session: u32,
    sequence: u32,
    heard: Instant,
}

struct Server {
    socket: UdpSocket,
    end: DriverEnd,
    counts: Arc<RemoteCounts>,
    start: Instant,
    client: Option<Client>,
    newest: Option<PosePacket>,
}

impl Server {
    fn serve(&mut self) {
        raise_priority();
        // One byte more than a packet, so that a longer one is seen to be longer.
        let mut buffer = [0; POSE_LEN + 1];
        while !self.end.is_abandoned() {
            for _ in 0..MAX_BURST {
                match self.socket.recv_from(&mut buffer) {
                    Ok((n, from)) => self.take(&buffer[..n], from),
                    Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => break,
                    // What an earlier answer met (nobody there any more); the next packet may be good. On Windows a
                    // packet longer than the buffer ends here too.
                    Err(_) => {}
                }
            }
            self.publish();
            self.answer();
            std::thread::sleep(NAPS[usize::from(self.client.is_none())]);
        }
    }

    fn take(&mut self, bytes: &[u8], from: SocketAddr) {
        let counts = &self.counts;
        let Some(packet) = PosePacket::parse(bytes) else {
            counts.malformed.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let heard = Instant::now();
        let Some(client) = &mut self.client else {
            let PosePacket {
                session, sequence, ..
            } = packet;
            self.client = Some(Client {
                address: from,
                session,
                sequence,
                heard,
            });
            return self.accept(packet);
        };
        if client.address != from || client.session != packet.session {
            counts.foreign.fetch_add(1, Ordering::Relaxed);
        } else if packet.sequence.wrapping_sub(client.sequence).cast_signed() <= 0 {
            counts.old.fetch_add(1, Ordering::Relaxed);
        } else {
            client.sequence = packet.sequence;
            client.heard = heard;
            self.accept(packet);
        }
    }

    fn accept(&mut self, packet: PosePacket) {
        self.counts.accepted.fetch_add(1, Ordering::Relaxed);
        self.newest = Some(packet);
    }

    /// Hands on the newest pose; lets go of a client that has gone.
    fn publish(&mut self) {
        if let Some(packet) = self.newest.take() {
            let tag = (packet.sequence, packet.time_us);
            let fault = self.end.publish_tagged(packet.reading, tag).err();
            self.end.set_fault(fault);
        }
        if self
            .client
            .as_ref()
            .is_some_and(|c| c.heard.elapsed() > GONE)
        {
            self.client = None;
            self.end.set_fault(Some(DeviceFault::Unplugged));
        }
    }

    /// One answer a wrench.
    fn answer(&mut self) {
        if !self.end.has_news() {
            return;
        }
        let wrench = self.end.wrench();
        let (sequence, time_us) = self.end.answered();
        let Some(client) = &self.client else { return };
        let packet = WrenchPacket {
            session: client.session,
            sequence,
            time_us,
            our_time_us: self.start.elapsed().as_micros() as u64,
            wrench,
            fault: self.end.fault(),
        };
        // A full or refused send is the client's loss of one answer, which it must bear like any lost packet.
        let _ = self.socket.send_to(&packet.bytes(), client.address);
    }
}

#[cfg(test)]
mod tests {
    use super::packet::WRENCH_LEN;
    use super::packet::tests::pose_packet;
    use super::*;
    use crate::{HapticDevice, Vec3, Wrench};

    fn hand() -> RemoteHand {
        listen("127.0.0.1:0".parse().unwrap(), false).unwrap()
    }

    fn client(hand: &RemoteHand) -> UdpSocket {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(hand.address).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        socket
    }

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

    fn arrives(hand: &mut RemoteHand, x: f64) {
        until("it arrives", || hand.device.read().pose.translation.x == x);
    }

    #[test]
    fn a_pose_goes_in_and_its_wrench_comes_out() {
        let mut hand = hand();
        let client = client(&hand);
        let wrench = Wrench {
            force: Vec3::new(1.0, -2.0, 3.0),
            torque: Vec3::new(9.0, 8.0, 7.0),
        };
        let mut bytes = [0; 200];
        // A machine that sleeps between pose and wrench makes the pose stale: then again.
        let answer = (0..1000).find_map(|i| {
            client.send(&pose_packet(7, i, f64::from(i))).unwrap();
            arrives(&mut hand, f64::from(i));
            let written = hand.device.write(&wrench);
            let n = client.recv(&mut bytes).unwrap();
            written.is_ok().then(|| (i, bytes[..n].to_vec()))
        });
        let (i, answer) = answer.unwrap();
        assert_eq!(answer.len(), WRENCH_LEN);
        assert_eq!(&answer[..8], b"OSTH\x01\0\x02\0");
        let number = |at: usize| u32::from_le_bytes(answer[at..at + 4].try_into().unwrap());
        assert_eq!(
            [number(8), number(12), number(16), number(80)],
            [7, i, 77, 0]
        );
        let shown: Vec<_> = (0..6)
            .map(|k| f64::from_le_bytes(answer[32 + 8 * k..40 + 8 * k].try_into().unwrap()))
            .collect();
        assert_eq!(shown, [1.0, -2.0, 3.0, 9.0, 8.0, 7.0]);
    }

    #[test]
    fn lost_repeated_and_reordered_packets_are_survived() {
        let mut hand = hand();
        let client = client(&hand);
        let start = u32::MAX - 1; // and the count wraps
        for (offset, x) in [(0, 1.0), (5, 2.0), (5, 90.0), (3, 91.0), (6, 3.0)] {
            let accepted = hand.counts.accepted() + hand.counts.old();
            client
                .send(&pose_packet(7, start.wrapping_add(offset), x))
                .unwrap();
            until("it is seen to", || {
                hand.counts.accepted() + hand.counts.old() > accepted
            });
        }
        arrives(&mut hand, 3.0);
        assert_eq!([hand.counts.accepted(), hand.counts.old()], [3, 2]);
    }

    #[test]
    fn malformed_and_oversized_packets_and_a_second_client_change_nothing() {
        let mut hand = hand();
        let [first, second] = [client(&hand), client(&hand)];
        first.send(&pose_packet(7, 1, 1.0)).unwrap();
        arrives(&mut hand, 1.0);
        first.send(&[0; 60_000]).unwrap();
        first.send(&[]).unwrap();
        first.send(&pose_packet(7, 2, f64::NAN)).unwrap();
        second.send(&pose_packet(7, 3, 50.0)).unwrap();
        first.send(&pose_packet(8, 3, 60.0)).unwrap();
        until("all are refused", || {
            hand.counts.malformed() == 3 && hand.counts.foreign() == 2
        });
        assert_eq!(hand.device.read().pose.translation.x, 1.0);
    }

    #[test]
    fn a_flood_of_others_does_not_keep_the_client_out() {
        let mut hand = hand();
        let [first, second] = [client(&hand), client(&hand)];
        first.send(&pose_packet(7, 1, 1.0)).unwrap();
        arrives(&mut hand, 1.0);
        let mut sequence = 1;
        until("ten thousand are refused and the client leads", || {
            for _ in 0..200 {
                // The kernel may refuse a packet for want of room; that is the flood's loss.
                let _ = second.send(&pose_packet(9, 1, 50.0));
            }
            sequence += 1;
            let _ = first.send(&pose_packet(7, sequence, 2.0));
            hand.counts.foreign() > 10_000 && hand.device.read().pose.translation.x == 2.0
        });
    }

    #[test]
    fn a_client_that_goes_is_a_fault_and_another_may_follow() {
        let mut hand = hand();
        client(&hand).send(&pose_packet(7, 1, 1.0)).unwrap();
        arrives(&mut hand, 1.0);
        until("it is stale", || {
            hand.device.health().fault == Some(DeviceFault::Stale)
        });
        assert!(hand.device.write(&Wrench::default()).is_err());
        until("it is gone", || {
            hand.device.health().fault == Some(DeviceFault::Unplugged)
        });
        let next = client(&hand);
        let mut sequence = 0;
        until("the next leads", || {
            sequence += 1;
            next.send(&pose_packet(8, sequence, 2.0)).unwrap();
            hand.device.read().pose.translation.x == 2.0 && hand.device.health().fault.is_none()
        });
    }

    #[test]
    fn an_address_for_everybody_is_refused_unless_told() {
        let address = "0.0.0.0:0".parse().unwrap();
        let text = listen(address, false).err().unwrap().to_string();
        assert!(
            text.contains("0.0.0.0:0") && text.contains("allow_network"),
            "{text}"
        );
        assert!(listen(address, true).is_ok());
    }
}
