//! Whose hands hold the devices: the built-in surgeon's or recorded ones.
use crate::scenario::Scenario;
use crate::session::HandSample;
use crate::surgeon::{BuiltInSurgeon, CrackView, Sight, SplitLine};
use anyhow::Result;
use osteotome_devices::{HapticDevice, Reading, RecordedHand, SimulatedHand, Wrench};
use osteotome_mechanics::geometry::{Pose, Vec3};

/// Two hands. Everything here runs in the haptic loop: no allocation, no wait, no log.
pub enum Input {
    /// The surgeon leads two simulated hands.
    BuiltIn(Box<BuiltIn>),
    /// Two recorded hands.
    Recorded(Box<[RecordedHand; 2]>),
}

/// The surgeon, the hands it leads, and what they felt last.
pub struct BuiltIn {
    surgeon: BuiltInSurgeon,
    hands: [SimulatedHand; 2],
    felt: [Wrench; 2],
    seen: [Pose; 2],
}

impl Input {
    /// The built-in surgeon, hands at rest where it starts.
    ///
    /// # Errors
    /// A hand with parameters out of range (checked with the scenario already).
    pub fn built_in(scenario: &Scenario, line: SplitLine) -> Result<Self> {
        let surgeon = BuiltInSurgeon::new(scenario, line);
        let start = surgeon.targets();
        let dt = scenario.loops.dt();
        let hand = |i: usize| SimulatedHand::new(scenario.tool[i].hand_parameters(), start[i], dt);
        Ok(Self::BuiltIn(Box::new(BuiltIn {
            hands: [hand(0)?, hand(1)?],
            surgeon,
            felt: [Wrench::default(); 2],
            seen: start,
        })))
    }

    /// Hands that repeat a recording.
    ///
    /// # Errors
    /// An empty recording.
    pub fn recorded(scenario: &Scenario, hands: &[Vec<HandSample>; 2]) -> Result<Self> {
        let hand = |i: usize| {
            let poses = hands[i]
                .iter()
                .map(|h| (h.device_pose, h.device_buttons))
                .collect();
            let device = scenario.tool[i].hand_parameters().specification();
            RecordedHand::new(poses, scenario.loops.dt(), device)
        };
        Ok(Self::Recorded(Box::new([hand(0)?, hand(1)?])))
    }

    /// Goes back to the first recorded pose, after a look at it. The surgeon's hands do not move by being read.
    pub fn rewind(&mut self) {
        if let Self::Recorded(hands) = self {
            hands.iter_mut().for_each(RecordedHand::rewind);
        }
    }

    /// Lets the hands' owner look at the crack and the moving line, and decide.
    pub fn plan(&mut self, crack: &CrackView, line: &[Vec3]) {
        if let Self::BuiltIn(b) = self {
            let tools = &b.seen;
            b.surgeon.step(&Sight { crack, tools, line }, &b.felt);
            for (hand, target) in b.hands.iter_mut().zip(b.surgeon.targets()) {
                hand.follow(target);
            }
        }
    }

    /// Reads both devices, left first.
    pub fn read(&mut self) -> [Reading; 2] {
        match self {
            Self::BuiltIn(b) => b.hands.each_mut().map(HapticDevice::read),
            Self::Recorded(hands) => hands.each_mut().map(HapticDevice::read),
        }
    }

    /// Displays both wrenches and shows the chisels; says how many devices reported a fault (and displayed zero).
    pub fn write(&mut self, wrenches: &[Wrench; 2], tools: &[Pose; 2]) -> u32 {
        match self {
            Self::BuiltIn(b) => {
                b.felt = *wrenches;
                b.seen = *tools;
                write_all(&mut b.hands, wrenches)
            }
            Self::Recorded(hands) => write_all(hands.as_mut(), wrenches),
        }
    }

    /// Whether nothing more will come.
    pub fn is_finished(&self) -> bool {
        match self {
            Self::BuiltIn(b) => b.surgeon.is_done(),
            Self::Recorded(hands) => hands.iter().all(|h| h.n_left() == 0),
        }
    }
}

fn write_all<D: HapticDevice>(devices: &mut [D; 2], wrenches: &[Wrench; 2]) -> u32 {
    let faults = devices
        .iter_mut()
        .zip(wrenches)
        .map(|(d, w)| u32::from(d.write(w).is_err()));
    faults.sum()
}
