//! Whose hands hold the devices: the built-in surgeon's, a user's, or recorded ones.
use crate::loops::Subscribed;
use crate::scenario::{Scenario, Tool, Workspace};
use crate::session::{HandSample, on_grid};
use crate::surgeon::{BuiltInSurgeon, CrackView, Sight, SplitLine};
use anyhow::{Result, bail};
use nalgebra::UnitQuaternion;
use osteotome_devices::{
    Binding, DeviceFault, HapticDevice, LinkedDevice, OperatedDevice, Reading, RecordedHand,
    SimulatedHand, Wrench,
};
use osteotome_mechanics::geometry::{Pose, Vec3};

/// Two hands. Everything here runs in the haptic loop: no allocation, no wait, no log.
pub enum Input {
    /// Each hand the surgeon's, on a simulated device, or the user's.
    Live(Box<Live>),
    /// Two recorded hands.
    Recorded(Box<[RecordedHand; 2]>),
    /// Two recorded hands up to a moment, others from then on.
    Resumed(Box<Resumed>),
}

/// Recorded hands that others take over from.
///
/// The surgeon is led along: where the recording is its own, it is at the moment in the very state that it was in, and goes on to
/// the last bit. A hand whose leader is elsewhere than the recording begins at rest where the recorded one is, with what it
/// feels ramped in.
pub struct Resumed {
    recorded: [RecordedHand; 2],
    live: Live,
    /// Recorded steps left.
    left: u64,
    /// Whether the surgeon's own hand has been where the recorded one was, all along.
    is_own: [bool; 2],
    /// At rest where the recording ends, for hands that are elsewhere by then: made before the first step, as none may be in one.
    stand_ins: [Hand; 2],
}

/// The surgeon, both hands, and what they felt last.
pub struct Live {
    surgeon: BuiltInSurgeon,
    hands: [Hand; 2],
    felt: [Wrench; 2],
    seen: [Pose; 2],
    /// A device of the user's has failed, and all stands still until it is back.
    is_paused: bool,
}

enum Hand {
    Simulated(SimulatedHand),
    Operated(OperatedDevice),
    Guided(Guided),
}

/// Who leads a hand.
pub enum Leader {
    /// The built-in surgeon.
    Surgeon,
    /// A user who holds a device.
    Device(Box<LinkedDevice>),
    /// A user who says where a simulated hand shall go: mouse and keyboard.
    Guide(Subscribed<Pose>),
}

/// A simulated hand that goes where it is told, no faster than a hand does: a mouse moves by leaps.
struct Guided {
    hand: SimulatedHand,
    told: Told,
    target: Pose,
    dt: f64,
    /// Share of the wrench that the hand feels.
    ramp: f64,
}

/// Where a guided hand is to go.
enum Told {
    /// Says a user.
    Heard(Subscribed<Pose>),
    /// Says the surgeon.
    Surgeon(Pose),
}

impl Told {
    fn read(&mut self) -> Pose {
        match self {
            Self::Heard(told) => *told.read(),
            Self::Surgeon(pose) => *pose,
        }
    }
}

impl Guided {
    /// From no wrench to all of it after another has led the hand \[s\].
    const RAMP: f64 = 0.5;

    /// \[mm/s\]
    const SPEED: f64 = 80.0;
    /// \[rad/s\]
    const SPIN: f64 = 2.0;
    /// Of the lag behind what is told \[s\].
    const LAG: f64 = 0.03;

    fn step(&mut self) {
        let told = self.told.read();
        let share = self.dt / Self::LAG;
        let way = (told.translation.vector - self.target.translation.vector) * share;
        self.target.translation.vector += way.cap_magnitude(Self::SPEED * self.dt);
        let turn = (told.rotation * self.target.rotation.inverse()).scaled_axis() * share;
        let turn = UnitQuaternion::from_scaled_axis(turn.cap_magnitude(Self::SPIN * self.dt));
        self.target.rotation = turn * self.target.rotation;
        self.target.rotation.renormalize();
        self.hand.follow(self.target);
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault> {
        let felt = Wrench {
            force: wrench.force * self.ramp,
            torque: wrench.torque * self.ramp,
        };
        self.ramp = (self.ramp + self.dt / Self::RAMP).min(1.0);
        self.hand.write(&felt)
    }
}

/// The device of each hand, where it is not simulated.
pub type Devices = [Option<LinkedDevice>; 2];

/// Opens the physical devices that a scenario names. Says what each is and what it cannot show.
///
/// # Errors
/// A device that is not there, by the key that names it.
pub fn open_devices(scenario: &Scenario) -> Result<(Devices, Vec<String>)> {
    let bindings = [0, 1].map(|i| scenario.tool[i].device.clone());
    let allow_network = scenario
        .tool
        .iter()
        .all(|t| t.allow_network || !matches!(t.device, Binding::Remote(_)));
    let devices = osteotome_devices::open(&bindings, allow_network);
    let mut devices = match devices {
        Ok(devices) => devices.into_iter(),
        Err(error) => bail!("tool.device: {error}"),
    };
    let devices = [0, 1].map(|_| devices.next().flatten());
    let mut notes = Vec::new();
    for (device, tool) in devices.iter().zip(&scenario.tool) {
        let Some(device) = device else { continue };
        let model = &device.specification().model;
        notes.push(format!("{}: {} ({model})", tool.name, tool.device));
        notes.extend(cannot_show(device, tool));
    }
    Ok((devices, notes))
}

/// Narrows tools' limits and couplings to what their devices bear.
pub fn narrow(scenario: &mut Scenario, devices: &Devices) {
    for (device, tool) in devices.iter().zip(&mut scenario.tool) {
        let Some(device) = device else { continue };
        let s = device.specification();
        let narrow = |own: &mut f64, most: f64| {
            if most > 0.0 {
                *own = own.min(most);
            }
        };
        narrow(&mut tool.limits.force, s.max_force);
        narrow(&mut tool.limits.torque, s.max_torque);
        tool.coupling.linear_stiffness *= share(tool, device);
    }
}

/// At which share of its wrench a tool's coupling is felt no stiffer than the device bears.
fn share(tool: &Tool, device: &LinkedDevice) -> f64 {
    let felt = tool.coupling.linear_stiffness * tool.workspace.scale;
    let bears = device.specification().nominal_stiffness;
    let bears = bears.filter(|b| *b > 0.0);
    bears.map_or(1.0, |bears| (bears / felt).min(1.0))
}

/// What devices show less of than a scenario asks for whose limits and couplings must stay: those that a recorded session was made
/// with. Loads beyond a device's are cut by its driver; what a stiffer coupling gives is shown at a share.
pub fn shown_less(scenario: &Scenario, devices: &Devices) -> Vec<String> {
    let less = |(device, tool): (&Option<LinkedDevice>, &Tool)| {
        let device = device.as_ref()?;
        let s = device.specification();
        let mut what = Vec::new();
        for (name, most, asked, unit) in [
            ("forces", s.max_force, tool.limits.force, "N"),
            ("torques", s.max_torque, tool.limits.torque, "N mm"),
        ] {
            if most > 0.0 && most < asked {
                what.push(format!("{name} above {most} {unit} are cut"));
            }
        }
        let share = share(tool, device);
        if share < 1.0 {
            what.push(format!("all is shown at {:.0} %", 100.0 * share));
        }
        let what = (!what.is_empty()).then(|| what.join(", "))?;
        Some(format!(
            "{}: the recording was made for a stronger device; {what}.",
            tool.name
        ))
    };
    devices
        .iter()
        .zip(&scenario.tool)
        .filter_map(less)
        .collect()
}

fn cannot_show(device: &LinkedDevice, tool: &Tool) -> Option<String> {
    let s = device.specification();
    let what = if s.max_force == 0.0 {
        "shows neither force nor torque"
    } else if s.max_torque > 0.0 {
        return None;
    } else if tool.workspace.torque_lever.is_some() {
        "shows torque across the shaft as a force; twist about the shaft cannot be felt"
    } else {
        "shows no torque; workspace.torque_lever = 50.0 would show that across the shaft as a force"
    };
    Some(format!("{}: this device {what}.", tool.name))
}

fn workspace(w: &Workspace, start: Pose) -> osteotome_devices::Workspace {
    let turn = |deg: [f64; 3]| {
        let [x, y, z] = deg.map(f64::to_radians);
        UnitQuaternion::from_euler_angles(x, y, z)
    };
    osteotome_devices::Workspace {
        start,
        scale: w.scale,
        rotation: turn(w.rotation_deg),
        handle: turn(w.handle_deg),
        is_mirrored: w.mirrored,
        clutch: w.clutch_button,
        torque_lever: w.torque_lever,
    }
}

impl Input {
    /// The built-in surgeon's hands, but for those whose device is the user's; at rest where the surgeon starts.
    ///
    /// # Errors
    /// A hand with parameters out of range (checked with the scenario already).
    pub fn live(scenario: &Scenario, line: SplitLine, devices: Devices) -> Result<Self> {
        let leader =
            |d: Option<LinkedDevice>| d.map_or(Leader::Surgeon, |d| Leader::Device(Box::new(d)));
        Self::led(scenario, line, devices.map(leader))
    }

    /// Each hand led by whom it is given; at rest where the surgeon starts.
    ///
    /// # Errors
    /// As [`live`](Self::live).
    pub fn led(scenario: &Scenario, line: SplitLine, leaders: [Leader; 2]) -> Result<Self> {
        let live = Live::new(scenario, line, leaders, None)?;
        Ok(Self::Live(Box::new(live)))
    }

    /// The recorded hands for so many steps, then each hand led by whom it is given, from where it is.
    ///
    /// # Errors
    /// As [`live`](Self::live), and [`recorded`](Self::recorded).
    pub fn resumed(
        scenario: &Scenario,
        line: SplitLine,
        leaders: [Leader; 2],
        hands: &[Vec<HandSample>; 2],
        steps: u64,
    ) -> Result<Self> {
        let n = (steps as usize).clamp(1, hands[0].len().max(1));
        let until = [0, 1].map(|i| hands[i].get(..n).unwrap_or_default());
        let recorded = recorded_hands(scenario, until)?;
        let at = [0, 1].map(|i| until[i][n - 1].device_pose);
        let live = Live::new(scenario, line, leaders, Some(at))?;
        let dt = scenario.loops.dt();
        let stand_in = |i: usize| -> Result<Hand> {
            let parameters = scenario.tool[i].hand_parameters();
            Ok(Hand::Guided(Guided {
                hand: SimulatedHand::new(parameters, at[i], dt)?,
                told: Told::Surgeon(at[i]),
                target: at[i],
                dt,
                ramp: 0.0,
            }))
        };
        Ok(Self::Resumed(Box::new(Resumed {
            recorded,
            live,
            left: n as u64,
            is_own: [true; 2],
            stand_ins: [stand_in(0)?, stand_in(1)?],
        })))
    }

    /// Both hands the surgeon's.
    ///
    /// # Errors
    /// As [`live`](Self::live).
    pub fn built_in(scenario: &Scenario, line: SplitLine) -> Result<Self> {
        Self::live(scenario, line, [None, None])
    }

    /// Hands that repeat a recording.
    ///
    /// # Errors
    /// An empty recording.
    pub fn recorded(scenario: &Scenario, hands: &[Vec<HandSample>; 2]) -> Result<Self> {
        let hands = recorded_hands(scenario, hands.each_ref().map(Vec::as_slice))?;
        Ok(Self::Recorded(Box::new(hands)))
    }

    /// Goes back to the first recorded pose, after a look at it. The surgeon's hands do not move by being read.
    pub fn rewind(&mut self) {
        match self {
            Self::Recorded(hands) => hands.iter_mut().for_each(RecordedHand::rewind),
            Self::Resumed(r) => r.recorded.iter_mut().for_each(RecordedHand::rewind),
            Self::Live(_) => {}
        }
    }

    /// Lets the hands' owner look at the crack and the moving line, and decide.
    pub fn plan(&mut self, crack: &CrackView, line: &[Vec3]) {
        let live = match self {
            Self::Recorded(_) => return,
            Self::Resumed(r) if r.left > 0 => return r.live.decide(crack, line),
            Self::Resumed(r) => &mut r.live,
            Self::Live(live) => live,
        };
        if live.is_paused {
            return;
        }
        for hand in &mut live.hands {
            if let Hand::Guided(guided) = hand {
                guided.step();
            }
        }
        live.decide(crack, line);
    }

    /// Reads both devices, left first.
    pub fn read(&mut self) -> [Reading; 2] {
        match self {
            Self::Live(live) => live.read(),
            Self::Recorded(hands) => hands.each_mut().map(HapticDevice::read),
            Self::Resumed(r) if r.left > 0 => r.recorded.each_mut().map(HapticDevice::read),
            Self::Resumed(r) => r.live.read(),
        }
    }

    /// Displays both wrenches and shows the chisels; says how many wrenches were refused for not being finite.
    pub fn write(&mut self, wrenches: &[Wrench; 2], tools: &[Pose; 2]) -> u32 {
        match self {
            Self::Live(live) => live.write(wrenches, tools),
            Self::Resumed(r) if r.left > 0 => r.write(wrenches, tools),
            Self::Resumed(r) => r.live.write(wrenches, tools),
            Self::Recorded(hands) => {
                let refused = hands
                    .iter_mut()
                    .zip(wrenches)
                    .map(|(h, w)| h.write(w).is_err());
                refused.map(u32::from).sum()
            }
        }
    }

    /// A tick while time stands still: devices display zero, and their hands are let go.
    pub fn rest(&mut self) {
        let Some(live) = self.people() else { return };
        for hand in &mut live.hands {
            if let Hand::Operated(device) = hand {
                device.poll();
                device.follow(true);
                // A fault is polled with the next reading; the device displays zero meanwhile.
                let _ = device.write(&Wrench::default());
            }
        }
    }

    fn people(&mut self) -> Option<&mut Live> {
        match self {
            Self::Live(live) => Some(live),
            Self::Resumed(r) => Some(&mut r.live),
            Self::Recorded(_) => None,
        }
    }

    /// Whether nothing more will come. A user goes on to the end of the scenario's time.
    pub fn is_finished(&self) -> bool {
        match self {
            Self::Live(live) => live.is_done(),
            Self::Resumed(r) => r.left == 0 && r.live.is_done(),
            Self::Recorded(hands) => hands.iter().all(|h| h.n_left() == 0),
        }
    }

    /// Pauses and resumptions so far.
    pub fn events(&self) -> Vec<String> {
        let live = match self {
            Self::Live(live) => live,
            Self::Resumed(r) => &r.live,
            Self::Recorded(_) => return Vec::new(),
        };
        let of = |(name, hand): (&str, &Hand)| {
            let events = match hand {
                Hand::Operated(device) => device.events(),
                Hand::Simulated(_) | Hand::Guided(_) => &[],
            };
            let told = events.iter().map(|e| match e.fault {
                Some(fault) => format!("paused at {:.3} s: the {name} device: {fault}", e.time),
                None => format!("the {name} device is back at {:.3} s", e.time),
            });
            told.collect::<Vec<_>>()
        };
        ["left", "right"]
            .into_iter()
            .zip(&live.hands)
            .flat_map(of)
            .collect()
    }
}

fn recorded_hands(scenario: &Scenario, hands: [&[HandSample]; 2]) -> Result<[RecordedHand; 2]> {
    let hand = |i: usize| {
        let poses = hands[i].iter();
        let poses = poses.map(|h| (h.device_pose, h.device_buttons)).collect();
        let device = scenario.tool[i].hand_parameters().specification();
        RecordedHand::new(poses, scenario.loops.dt(), device)
    };
    Ok([hand(0)?, hand(1)?])
}

impl Resumed {
    /// What a recorded step has shown; after the last of them, the others take over.
    fn write(&mut self, wrenches: &[Wrench; 2], tools: &[Pose; 2]) -> u32 {
        let live = &mut self.live;
        (live.felt, live.seen) = (*wrenches, *tools);
        let mut refused = 0;
        for (i, hand) in live.hands.iter_mut().enumerate() {
            refused += u32::from(self.recorded[i].write(&wrenches[i]).is_err());
            if let Hand::Simulated(hand) = hand {
                let (pose, recorded) = (hand.read().pose, self.recorded[i].pose());
                // Recordings made before there was a grid are off it.
                self.is_own[i] &= [pose, on_grid(&pose)].contains(&recorded);
                // What it refuses has been counted.
                let _ = hand.write(&wrenches[i]);
            }
        }
        self.left -= 1;
        if self.left == 0 {
            self.take_over();
        }
        refused
    }

    fn take_over(&mut self) {
        let hands = self.live.hands.iter_mut().zip(&mut self.stand_ins);
        for ((hand, stand_in), is_own) in hands.zip(self.is_own) {
            if matches!(hand, Hand::Simulated(_)) && !is_own {
                std::mem::swap(hand, stand_in);
            }
        }
    }
}

impl Live {
    /// `at`: where the user's hands begin, if others have led them there.
    fn new(
        scenario: &Scenario,
        line: SplitLine,
        leaders: [Leader; 2],
        at: Option<[Pose; 2]>,
    ) -> Result<Self> {
        let surgeon = BuiltInSurgeon::new(scenario, line);
        let start = surgeon.targets();
        let places = at.unwrap_or(start);
        let ramp = if at.is_some() { 0.0 } else { 1.0 };
        let dt = scenario.loops.dt();
        let hand = |i: usize, leader: Leader| -> Result<Hand> {
            let tool = &scenario.tool[i];
            let simulated = |at: Pose| SimulatedHand::new(tool.hand_parameters(), at, dt);
            Ok(match leader {
                Leader::Surgeon => Hand::Simulated(simulated(start[i])?),
                Leader::Device(device) => {
                    let workspace = workspace(&tool.workspace, places[i]);
                    let share = share(tool, &device);
                    let operated = OperatedDevice::new(device, workspace, dt);
                    Hand::Operated(operated.at_share(share))
                }
                Leader::Guide(told) => Hand::Guided(Guided {
                    hand: simulated(places[i])?,
                    told: Told::Heard(told),
                    target: places[i],
                    dt,
                    ramp,
                }),
            })
        };
        let [left, right] = leaders;
        Ok(Self {
            hands: [hand(0, left)?, hand(1, right)?],
            surgeon,
            felt: [Wrench::default(); 2],
            seen: start,
            is_paused: false,
        })
    }

    /// The surgeon looks and decides, and its hands follow.
    fn decide(&mut self, crack: &CrackView, line: &[Vec3]) {
        if self.is_users() {
            return;
        }
        let tools = &self.seen;
        self.surgeon.step(&Sight { crack, tools, line }, &self.felt);
        for (hand, target) in self.hands.iter_mut().zip(self.surgeon.targets()) {
            match hand {
                Hand::Simulated(hand) => hand.follow(target),
                Hand::Guided(Guided {
                    told: Told::Surgeon(told),
                    ..
                }) => *told = target,
                Hand::Guided(_) | Hand::Operated(_) => {}
            }
        }
    }

    fn is_users(&self) -> bool {
        let is_surgeons = |h: &Hand| match h {
            Hand::Simulated(_) => true,
            Hand::Guided(guided) => matches!(guided.told, Told::Surgeon(_)),
            Hand::Operated(_) => false,
        };
        !self.hands.iter().any(is_surgeons)
    }

    fn is_done(&self) -> bool {
        !self.is_users() && self.surgeon.is_done()
    }

    fn read(&mut self) -> [Reading; 2] {
        self.is_paused = false;
        for hand in &mut self.hands {
            if let Hand::Operated(device) = hand {
                device.poll();
                self.is_paused |= device.fault().is_some();
            }
        }
        let is_paused = self.is_paused;
        self.hands.each_mut().map(|hand| {
            let reading = match hand {
                Hand::Simulated(hand) | Hand::Guided(Guided { hand, .. }) => hand.read(),
                Hand::Operated(device) => device.follow(is_paused),
            };
            let pose = on_grid(&reading.pose);
            Reading { pose, ..reading }
        })
    }

    fn write(&mut self, wrenches: &[Wrench; 2], tools: &[Pose; 2]) -> u32 {
        self.felt = *wrenches;
        self.seen = *tools;
        let mut refused = 0;
        for (hand, wrench) in self.hands.iter_mut().zip(wrenches) {
            refused += u32::from(!wrench.is_finite());
            // Other faults are polled with the next reading; the device displays zero meanwhile.
            let _ = match hand {
                Hand::Operated(device) => device.write(wrench),
                Hand::Simulated(hand) if !self.is_paused => hand.write(wrench),
                Hand::Guided(guided) if !self.is_paused => guided.write(wrench),
                Hand::Simulated(_) | Hand::Guided(_) => Ok(()),
            };
        }
        refused
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::surgeon::Mark;
    use osteotome_devices::remote;
    use std::net::UdpSocket;
    use std::time::{Duration, Instant};

    fn scenario(set: &str) -> Scenario {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        load(&source, &[set.parse().unwrap()], std::path::Path::new("/")).unwrap()
    }

    fn line() -> SplitLine {
        let mark = |i| Mark {
            at: Vec3::new(f64::from(i), 0.0, 0.0),
            toward: -Vec3::z(),
            depth: 4.0,
            is_ridge: i <= 30,
        };
        SplitLine::new((0..=40).map(mark).collect()).unwrap()
    }

    fn crack() -> CrackView {
        CrackView {
            generation: 0,
            severed: false,
            front: vec![],
        }
    }

    /// As docs/remote-hand.md has it: at `x`, upright.
    fn packet(sequence: u32, x: f64) -> Vec<u8> {
        let mut bytes = b"OSTH\x01\0\x01\0\x07\0\0\0".to_vec();
        bytes.extend(sequence.to_le_bytes());
        bytes.extend([0; 8]);
        for number in [
            x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ] {
            bytes.extend(f64::to_le_bytes(number));
        }
        bytes.extend([0; 8]);
        bytes
    }

    struct Stage {
        input: Input,
        client: UdpSocket,
        sequence: u32,
    }

    impl Stage {
        /// The left hand is a client's, the right the surgeon's.
        fn new() -> Self {
            let hand = remote::listen("127.0.0.1:0".parse().unwrap(), false).unwrap();
            let client = UdpSocket::bind("127.0.0.1:0").unwrap();
            client.connect(hand.address).unwrap();
            let devices = [Some(hand.device), None];
            let input = Input::live(&scenario("seed=1"), line(), devices).unwrap();
            Self {
                input,
                client,
                sequence: 0,
            }
        }

        /// One tick with the client at `x`, or silent.
        fn tick(&mut self, x: Option<f64>) -> [Pose; 2] {
            if let Some(x) = x {
                self.sequence += 1;
                self.client.send(&packet(self.sequence, x)).unwrap();
            }
            std::thread::sleep(Duration::from_millis(1));
            self.input.plan(&crack(), &[]);
            let poses = self.input.read().map(|r| r.pose);
            self.input.write(&[Wrench::default(); 2], &poses);
            poses
        }

        fn until(
            &mut self,
            what: &str,
            x: Option<f64>,
            mut is_so: impl FnMut(&[Pose; 2], &[Pose; 2]) -> bool,
        ) {
            let start = Instant::now();
            let mut before = self.tick(x);
            loop {
                let poses = self.tick(x);
                if is_so(&before, &poses) {
                    return;
                }
                assert!(
                    start.elapsed() < Duration::from_secs(60),
                    "still not: {what}"
                );
                before = poses;
            }
        }
    }

    #[test]
    fn a_hand_that_fails_stops_both_and_both_go_on_from_there() {
        let mut stage = Stage::new();
        let start = stage.tick(None);
        for _ in 0..20 {
            assert_eq!(stage.tick(None), start, "nobody is there: all stands");
        }
        stage.until("the surgeon's hand moves", Some(0.0), |a, b| a[1] != b[1]);
        stage.until("the user's hand moves", Some(3.0), |_, b| {
            (b[0].translation.x - start[0].translation.x - 3.0).abs() < 1e-9
        });
        stage.until("silence stops both", None, |a, b| a == b);
        let stood = stage.tick(None);
        assert_eq!(stage.tick(None), stood);
        stage.until("both go on", Some(50.0), |a, b| a[1] != b[1]);
        let x = stage.tick(Some(50.0))[0].translation.x;
        assert!((x - stood[0].translation.x).abs() < 1e-9, "no jump");
        let events = stage.input.events();
        assert!(
            events
                .first()
                .unwrap()
                .contains("the left device: no new reading"),
            "{events:?}"
        );
        assert!(events.iter().any(|e| e.contains("is back")), "{events:?}");
        assert!(!stage.input.is_finished());
    }

    #[test]
    fn a_guided_hand_goes_where_it_is_told_at_a_hands_pace() {
        let (mut told, hears) = crate::loops::latest(&Pose::identity());
        let leaders = [Leader::Guide(hears), Leader::Surgeon];
        let mut input = Input::led(&scenario("seed=1"), line(), leaders).unwrap();
        let start = input.read()[0].pose;
        let goal = Pose::translation(4.0, -3.0, 12.0) * start;
        told.write(goal);
        let mut before = start;
        for _ in 0..1500 {
            input.plan(&crack(), &[]);
            let poses = input.read().map(|r| r.pose);
            let step = (poses[0].translation.vector - before.translation.vector).norm();
            assert!(step < 0.12, "{step} mm in a millisecond");
            before = poses[0];
            input.write(&[Wrench::default(); 2], &poses);
        }
        let miss = (before.translation.vector - goal.translation.vector).norm();
        assert!(miss < 0.01, "{miss} mm off");
        assert!(!input.is_finished());
    }

    /// A recording of `n` steps along x at 10 mm/s, away from where the surgeon's hands are.
    fn recorded(n: u32) -> [Vec<HandSample>; 2] {
        let sample = |k: u32| HandSample {
            device_pose: Pose::translation(f64::from(k) * 0.01, 5.0, 40.0),
            device_buttons: 0,
            tool_pose: Pose::translation(f64::from(k) * 0.01, 5.0, 40.0),
            wrench: Wrench::default(),
            saturated: false,
            contacts: 0,
        };
        [0, 1].map(|_| (0..n).map(sample).collect())
    }

    #[test]
    fn a_hand_taken_over_begins_where_it_is_and_feels_its_load_by_and_by() {
        let scenario = scenario("seed=1");
        let hands = recorded(100);
        let end = hands[0][99].device_pose;
        let (_told, hears) = crate::loops::latest(&end);
        let leaders = [Leader::Guide(hears), Leader::Surgeon];
        let mut input = Input::resumed(&scenario, line(), leaders, &hands, 100).unwrap();
        let load = Wrench {
            force: Vec3::new(2.0, 0.0, 0.0),
            torque: Vec3::zeros(),
        };
        let mut step = || {
            input.plan(&crack(), &[]);
            let poses = input.read().map(|r| r.pose);
            input.write(&[load; 2], &poses);
            poses
        };
        for (k, sample) in hands[0].iter().enumerate() {
            assert_eq!(step()[0], sample.device_pose, "step {k}");
        }
        let way = |p: &Pose| (p.translation.vector - end.translation.vector).norm();
        let mut before = [end; 2];
        let mut after_30_ms = 0.0;
        for k in 0..2000 {
            let poses = step();
            for i in 0..2 {
                let moved = poses[i].translation.vector - before[i].translation.vector;
                assert!(moved.norm() < 0.12, "hand {i} leaps by {} mm", moved.norm());
            }
            if k == 30 {
                after_30_ms = way(&poses[0]);
            }
            before = poses;
        }
        // 2 N on 500 N/m; a thirtieth of a second is a fifteenth of the ramp.
        assert!((way(&before[0]) - 4.0).abs() < 1e-6, "{}", way(&before[0]));
        assert!(after_30_ms < 0.2, "{after_30_ms} mm at once");
        // The surgeon's hand has gone to where the surgeon is.
        assert!(way(&before[1]) > 10.0);
    }

    #[test]
    fn only_what_is_not_simulated_is_opened_and_limits_are_narrowed() {
        let plain = scenario("seed=1");
        let (devices, notes) = open_devices(&plain).unwrap();
        assert!(devices.iter().all(Option::is_none) && notes.is_empty());
        let mut remote = scenario("tool.0.device=\"remote:0\"");
        remote.tool[0].limits.force = 100.0;
        let (devices, notes) = open_devices(&remote).unwrap();
        assert!(devices[0].is_some() && devices[1].is_none());
        let less = shown_less(&remote, &devices);
        assert!(
            less.len() == 1 && less[0].contains("forces above 8.5 N are cut."),
            "{less:?}"
        );
        narrow(&mut remote, &devices);
        assert_eq!(remote.tool[0].limits.force, 8.5);
        assert!(shown_less(&remote, &devices).is_empty());
        assert!(notes[0].contains("left: remote:127.0.0.1:0"), "{notes:?}");
        let open = scenario("tool.0.device=\"remote:0.0.0.0:0\"");
        let refusal = open_devices(&open).err().unwrap().to_string();
        assert!(refusal.contains("allow_network"), "{refusal}");
    }
}
