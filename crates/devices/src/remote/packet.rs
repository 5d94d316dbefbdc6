//! The packets of docs/remote-hand.md. Little-endian, of fixed size.
use crate::{DeviceFault, Pose, Reading, Vec3, Wrench};
use nalgebra::{Quaternion, UnitQuaternion};

const MAGIC: [u8; 4] = *b"OSTH";
const VERSION: u16 = 1;
const POSE: u16 = 1;
const WRENCH: u16 = 2;
/// Length of a pose packet.
pub(super) const POSE_LEN: usize = 136;
/// Length of a wrench packet; shorter than what asks for it, so that nobody can be flooded through us.
pub(super) const WRENCH_LEN: usize = 88;
/// Farther from the middle of its workspace no hand is \[mm\].
const FAR: f64 = 1e4;

/// A pose packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PosePacket {
    pub session: u32,
    pub sequence: u32,
    /// The client's clock \[us\].
    pub time_us: u64,
    pub reading: Reading,
}

impl PosePacket {
    /// `None` for anything that is not exactly a pose packet with sensible numbers.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; POSE_LEN] = bytes.try_into().ok()?;
        let mut rest = &bytes[..];
        let is_ours = take(&mut rest) == MAGIC
            && u16::from_le_bytes(take(&mut rest)) == VERSION
            && u16::from_le_bytes(take(&mut rest)) == POSE;
        if !is_ours {
            return None;
        }
        let session = u32::from_le_bytes(take(&mut rest));
        let sequence = u32::from_le_bytes(take(&mut rest));
        let time_us = u64::from_le_bytes(take(&mut rest));
        let numbers: [f64; 13] = std::array::from_fn(|_| f64::from_le_bytes(take(&mut rest)));
        let buttons = u32::from_le_bytes(take(&mut rest));
        Some(Self {
            session,
            sequence,
            time_us,
            reading: reading(&numbers, buttons)?,
        })
    }
}

fn reading(n: &[f64; 13], buttons: u32) -> Option<Reading> {
    let vector = |i: usize| Vec3::new(n[i], n[i + 1], n[i + 2]);
    let turn = Quaternion::new(n[6], n[3], n[4], n[5]);
    let is_sensible = n.iter().all(|c| c.is_finite())
        && vector(0).norm() <= FAR
        && (turn.norm() - 1.0).abs() < 1e-3;
    is_sensible.then(|| Reading {
        pose: Pose::from_parts(vector(0).into(), UnitQuaternion::from_quaternion(turn)),
        velocity: vector(7),
        angular_velocity: vector(10),
        buttons,
        time: 0.0,
    })
}

/// A wrench packet.
pub(super) struct WrenchPacket {
    pub session: u32,
    /// Of the pose packet that it answers, like the next.
    pub sequence: u32,
    pub time_us: u64,
    /// Our clock \[us\].
    pub our_time_us: u64,
    pub wrench: Wrench,
    pub fault: Option<DeviceFault>,
}

impl WrenchPacket {
    pub(super) fn bytes(&self) -> [u8; WRENCH_LEN] {
        let mut bytes = [0; WRENCH_LEN];
        let mut rest = &mut bytes[..];
        put(&mut rest, MAGIC);
        put(&mut rest, VERSION.to_le_bytes());
        put(&mut rest, WRENCH.to_le_bytes());
        put(&mut rest, self.session.to_le_bytes());
        put(&mut rest, self.sequence.to_le_bytes());
        put(&mut rest, self.time_us.to_le_bytes());
        put(&mut rest, self.our_time_us.to_le_bytes());
        for component in self.wrench.force.iter().chain(&self.wrench.torque) {
            put(&mut rest, component.to_le_bytes());
        }
        put(&mut rest, self.fault.map_or(0, |f| f as u32).to_le_bytes());
        bytes
    }
}

/// The caller has checked the whole length.
fn take<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    let (first, after) = rest.split_first_chunk().expect("length checked");
    *rest = after;
    *first
}

fn put<const N: usize>(rest: &mut &mut [u8], bytes: [u8; N]) {
    let (first, after) = std::mem::take(rest).split_at_mut(N);
    first.copy_from_slice(&bytes);
    *rest = after;
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A client's packet: at `x`, upright.
    pub(in crate::remote) fn pose_packet(session: u32, sequence: u32, x: f64) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(POSE.to_le_bytes());
        bytes.extend(session.to_le_bytes());
        bytes.extend(sequence.to_le_bytes());
        bytes.extend(77_u64.to_le_bytes());
        let mut numbers = [0.0; 13];
        (numbers[0], numbers[6]) = (x, 1.0);
        numbers
            .iter()
            .for_each(|n: &f64| bytes.extend(n.to_le_bytes()));
        bytes.extend([5, 0, 0, 0, 0, 0, 0, 0]);
        bytes
    }

    #[test]
    fn a_pose_packet_is_read() {
        let packet = PosePacket::parse(&pose_packet(9, 3, 1.5)).unwrap();
        assert_eq!(
            (packet.session, packet.sequence, packet.time_us),
            (9, 3, 77)
        );
        assert_eq!(packet.reading.pose, Pose::translation(1.5, 0.0, 0.0));
        assert_eq!(packet.reading.buttons, 5);
    }

    #[test]
    fn anything_else_is_not() {
        let good = pose_packet(9, 3, 1.5);
        for n in 0..good.len() {
            assert_eq!(PosePacket::parse(&good[..n]), None, "{n} bytes");
        }
        let mut long = good.clone();
        long.push(0);
        assert_eq!(PosePacket::parse(&long), None);
        for byte in 0..8 {
            let mut bad = good.clone();
            bad[byte] ^= 0x40;
            assert_eq!(PosePacket::parse(&bad), None, "byte {byte}");
        }
        let with = |i: usize, value: f64| {
            let mut bad = good.clone();
            bad[24 + 8 * i..32 + 8 * i].copy_from_slice(&value.to_le_bytes());
            PosePacket::parse(&bad)
        };
        assert_eq!(with(0, f64::NAN), None);
        assert_eq!(with(1, 1e9), None, "too far");
        assert_eq!(with(6, 0.5), None, "no rotation");
        assert_eq!(with(12, f64::INFINITY), None);
    }
}
