//! What the haptic loop calls does not allocate: reading, mapping and writing, well or failing.
use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use osteotome_devices::{
    HandParameters, HapticDevice, OperatedDevice, Pose, RecordedHand, SimulatedHand, Vec3,
    Workspace, Wrench, remote,
};
use std::net::UdpSocket;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

/// Violations are counted for each thread, so tests that run side by side do not disturb each other.
fn check_no_allocation(work: impl FnOnce()) {
    let before = violation_count();
    assert_no_alloc(work);
    assert_eq!(violation_count() - before, 0);
}

fn push() -> Wrench {
    Wrench {
        force: Vec3::x(),
        torque: Vec3::y(),
    }
}

fn simulated() -> SimulatedHand {
    SimulatedHand::new(HandParameters::default(), Pose::identity(), 1e-3)
        .expect("default parameters")
}

#[test]
fn an_allocation_would_be_seen() {
    let before = violation_count();
    assert_no_alloc(|| drop(std::hint::black_box(vec![1; 10])));
    assert!(violation_count() > before);
}

#[test]
fn hands_do_not_allocate() {
    let mut hand = simulated();
    let specification = hand.specification().clone();
    let poses = vec![(Pose::identity(), 0); 3];
    let mut recorded = RecordedHand::new(poses, 1e-3, specification).expect("poses");
    check_no_allocation(|| {
        for device in [&mut hand as &mut dyn HapticDevice, &mut recorded] {
            for _ in 0..5 {
                device.read();
                let _ = device.write(&push());
                device.health();
            }
        }
    });
}

#[test]
fn a_device_in_a_hand_does_not_allocate_when_well() {
    let workspace = Workspace {
        clutch: Some(0),
        ..Workspace::at(Pose::identity())
    };
    let mut hand = OperatedDevice::new(Box::new(simulated()), workspace, 1e-3);
    check_no_allocation(|| {
        for tick in 0..1000 {
            hand.poll();
            hand.follow(tick % 100 < 5);
            let _ = hand.write(&push());
        }
    });
}

/// A client that comes and goes: every pause and resumption is noted without allocating, and so is the one too many.
#[test]
fn nor_does_it_when_its_link_fails_and_returns() {
    let remote = remote::listen("127.0.0.1:0".parse().expect("an address"), false).expect("a port");
    let client = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    client.connect(remote.address).expect("loopback");
    let mut hand = OperatedDevice::new(
        Box::new(remote.device),
        Workspace::at(Pose::identity()),
        1e-3,
    );
    let mut sequence = 0_u32;
    while hand.events().len() < 6 {
        // Some poses, then a silence longer than what counts as stale.
        for step in 0..30 {
            if step < 10 {
                sequence += 1;
                client.send(&packet(sequence)).expect("sent");
            }
            check_no_allocation(|| {
                hand.poll();
                hand.follow(hand.fault().is_some());
                let _ = hand.write(&push());
            });
            std::thread::sleep(std::time::Duration::from_millis(4));
        }
    }
}

fn packet(sequence: u32) -> Vec<u8> {
    let mut packet = b"OSTH\x01\0\x01\0\x07\0\0\0".to_vec();
    packet.extend(sequence.to_le_bytes());
    packet.extend([0; 8]);
    for i in 0..13 {
        packet.extend(f64::from(u8::from(i == 6)).to_le_bytes());
    }
    packet.extend([0; 8]);
    packet
}
