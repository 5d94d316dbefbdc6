//! A device in a hand: mapped into the world, silenced when it fails, eased back in when it returns.
use crate::{DeviceFault, HapticDevice, Pose, Reading, Specification, Vec3, Workspace, Wrench};
use nalgebra::UnitQuaternion;

/// From zero to the full wrench after every pause \[s\].
const RAMP: f64 = 0.5;
/// A handle that came back turned is followed at this rate \[rad/s\].
const REALIGN: f64 = 0.8;
/// Events kept for the record.
const MAX_EVENTS: usize = 256;

/// A pause or its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyEvent {
    /// Since the session's start \[s\].
    pub time: f64,
    /// Why it paused; `None`: it went on.
    pub fault: Option<DeviceFault>,
}

/// A [`HapticDevice`] as a session uses it.
///
/// [`poll`](Self::poll) looks at the device; [`follow`](Self::follow) gives the tool's handle in the world. Whenever the
/// session is paused (by a fault of this or the other device) or the clutch is held, the handle stands where it was and
/// zero is displayed; afterwards motion goes on from there without a jump, and the wrench is ramped in within .5 s.
/// Nothing here allocates or waits.
pub struct OperatedDevice {
    device: Box<dyn HapticDevice>,
    workspace: Workspace,
    dt: f64,
    time: f64,
    raw: Reading,
    fault: Option<DeviceFault>,
    /// What the hand leads, last followed.
    held: Pose,
    is_following: bool,
    ramp: f64,
    /// Of the wrench that is displayed.
    share: f64,
    /// The device's and the world's position of the same point.
    anchor: [Vec3; 2],
    /// Turn of the tool against where the handle wants it.
    askew: UnitQuaternion<f64>,
    events: Vec<SafetyEvent>,
}

impl OperatedDevice {
    /// At the workspace's start, paused until the device gives a reading; one tick every `dt` \[s\].
    pub fn new(device: Box<dyn HapticDevice>, mut workspace: Workspace, dt: f64) -> Self {
        if device.specification().max_torque > 0.0 {
            workspace.torque_lever = None;
        }
        let start = workspace.start;
        Self {
            device,
            workspace,
            dt,
            time: 0.0,
            raw: Reading::default(),
            fault: None,
            held: start,
            is_following: false,
            ramp: 0.0,
            share: 1.0,
            anchor: [Vec3::zeros(), start.translation.vector],
            askew: UnitQuaternion::identity(),
            events: Vec::with_capacity(MAX_EVENTS),
        }
    }

    /// Displays no more than this share of each wrench: for a coupling that is stiffer than the device bears.
    #[must_use]
    pub fn at_share(mut self, share: f64) -> Self {
        self.share = share;
        self
    }

    /// What the device is.
    pub fn specification(&self) -> &Specification {
        self.device.specification()
    }

    /// Takes the newest reading; once a tick, first of all.
    pub fn poll(&mut self) {
        self.raw = self.device.read();
        let fault = self.device.health().fault;
        if fault != self.fault && self.events.len() < MAX_EVENTS {
            let time = self.time;
            self.events.push(SafetyEvent { time, fault });
        }
        self.fault = fault;
        self.time += self.dt;
    }

    /// What is wrong with it, as last polled.
    pub fn fault(&self) -> Option<DeviceFault> {
        self.fault
    }

    /// Pauses and their ends so far, at most 256.
    pub fn events(&self) -> &[SafetyEvent] {
        &self.events
    }

    /// The handle in the world, or where it stands while the session `is_paused`.
    pub fn follow(&mut self, is_paused: bool) -> Reading {
        let clutch = self.workspace.clutch;
        let is_clutched = clutch.is_some_and(|b| self.raw.buttons >> b & 1 == 1);
        if is_paused || is_clutched || self.fault.is_some() {
            self.is_following = false;
            self.ramp = 0.0;
            return Reading {
                pose: self.held,
                buttons: self.raw.buttons,
                time: self.raw.time,
                ..Reading::default()
            };
        }
        if !self.is_following {
            self.is_following = true;
            self.anchor_here();
        }
        self.realign();
        self.held = self.mapped();
        Reading {
            pose: self.held,
            velocity: self.workspace.vector(&self.raw.velocity),
            angular_velocity: self.workspace.turn(&self.raw.angular_velocity),
            ..self.raw
        }
    }

    /// Displays a wrench of the world; zero while the tool does not follow.
    ///
    /// # Errors
    /// What the device reports.
    pub fn write(&mut self, world: &Wrench) -> Result<(), DeviceFault> {
        if !self.is_following {
            return self.device.write(&Wrench::default());
        }
        let share = self.ramp * self.share;
        self.ramp = (self.ramp + self.dt / RAMP).min(1.0);
        let eased = Wrench {
            force: world.force * share,
            torque: world.torque * share,
        };
        let wrench = self.workspace.wrench(&eased, &self.held.rotation);
        self.device.write(&wrench)
    }

    /// From here on the device's present place means the tool's present place.
    fn anchor_here(&mut self) {
        self.anchor = [
            self.raw.pose.translation.vector,
            self.held.translation.vector,
        ];
        let wanted = self.workspace.orientation(&self.raw.pose.rotation);
        self.askew = self.held.rotation * wanted.inverse();
    }

    fn realign(&mut self) {
        let angle = self.askew.angle();
        let left = (angle - REALIGN * self.dt).max(0.0);
        self.askew = self
            .askew
            .axis()
            .map_or_else(UnitQuaternion::identity, |axis| {
                UnitQuaternion::from_axis_angle(&axis, left)
            });
    }

    fn mapped(&self) -> Pose {
        let [device, world] = self.anchor;
        let moved = self.raw.pose.translation.vector - device;
        let place = world + self.workspace.vector(&moved);
        let turned = self.askew * self.workspace.orientation(&self.raw.pose.rotation);
        Pose::from_parts(place.into(), turned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DeviceModel, Health, OMNI, PREMIUM_6DOF};
    use std::sync::{Arc, Mutex};

    #[derive(Default)]
    struct Scene {
        reading: Reading,
        fault: Option<DeviceFault>,
        shown: Wrench,
    }

    struct Puppet(Specification, Arc<Mutex<Scene>>);

    impl HapticDevice for Puppet {
        fn specification(&self) -> &Specification {
            &self.0
        }
        fn read(&mut self) -> Reading {
            self.1.lock().unwrap().reading
        }
        fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault> {
            self.1.lock().unwrap().shown = *wrench;
            Ok(())
        }
        fn health(&self) -> Health {
            let fault = self.1.lock().unwrap().fault;
            Health {
                fault,
                motor_temperature: None,
            }
        }
    }

    struct Stage {
        scene: Arc<Mutex<Scene>>,
        hand: OperatedDevice,
    }

    impl Stage {
        fn new(workspace: Workspace) -> Self {
            Self::of(&OMNI, workspace)
        }
        fn of(model: &DeviceModel, workspace: Workspace) -> Self {
            let scene = Arc::new(Mutex::new(Scene::default()));
            let puppet = Puppet(Specification::of(model, ""), scene.clone());
            let hand = OperatedDevice::new(Box::new(puppet), workspace, 1e-3);
            Self { scene, hand }
        }
        fn place(&self, x: f64, angle: f64) {
            let turn = UnitQuaternion::from_scaled_axis(Vec3::new(0.0, 0.0, angle));
            self.scene.lock().unwrap().reading.pose =
                Pose::from_parts(Vec3::new(x, 0.0, 0.0).into(), turn);
        }
        fn tick(&mut self, is_paused: bool) -> (Pose, f64) {
            self.hand.poll();
            let pose = self.hand.follow(is_paused).pose;
            let push = Wrench {
                force: Vec3::y(),
                torque: Vec3::zeros(),
            };
            self.hand.write(&push).unwrap();
            (pose, self.scene.lock().unwrap().shown.force.norm())
        }
        fn settle(&mut self) -> (Pose, f64) {
            (0..3000).map(|_| self.tick(false)).last().unwrap()
        }
    }

    #[test]
    fn a_fault_stops_and_its_end_resumes_without_a_jump() {
        let mut stage = Stage::new(Workspace::at(Pose::translation(5.0, 0.0, 0.0)));
        stage.place(20.0, 0.0);
        let (first, force) = stage.tick(false);
        assert_eq!(
            (first.translation.x, force),
            (5.0, 0.0),
            "at its start, ramping"
        );
        let (_, force) = stage.settle();
        assert_eq!(force, 1.0);

        stage.scene.lock().unwrap().fault = Some(DeviceFault::Unplugged);
        let (pose, force) = stage.tick(false);
        assert_eq!((pose.translation.x, force), (5.0, 0.0), "at once");
        stage.place(-80.0, 1.0);
        stage.tick(false);
        stage.scene.lock().unwrap().fault = None;
        let mut last = stage.tick(false);
        assert!((last.0.translation.x - 5.0).abs() < 1e-9 && last.1 == 0.0);
        for _ in 0..3000 {
            let next = stage.tick(false);
            assert!(next.1 - last.1 <= 0.0021, "ramped");
            assert!(
                next.0.rotation.angle_to(&last.0.rotation) < 1e-3,
                "turned slowly"
            );
            last = next;
        }
        assert!(
            (last.0.rotation.angle() - 1.0).abs() < 1e-9,
            "the handle is followed again"
        );
        let faults: Vec<_> = stage.hand.events().iter().map(|e| e.fault).collect();
        assert_eq!(faults, [Some(DeviceFault::Unplugged), None]);
    }

    /// 100 N mm about x at a lever of 50 mm are 2 N in the hand, on a device that has no torque of its own.
    #[test]
    fn torque_is_shown_as_a_force_only_where_there_is_no_torque() {
        let workspace = Workspace {
            torque_lever: Some(50.0),
            ..Workspace::at(Pose::identity())
        };
        let shown = |model| {
            let mut stage = Stage::of(model, workspace.clone());
            stage.settle();
            let turn = Wrench {
                force: Vec3::zeros(),
                torque: Vec3::new(100.0, 0.0, 0.0),
            };
            stage.hand.write(&turn).unwrap();
            stage.scene.lock().unwrap().shown
        };
        assert!((shown(&OMNI).force.norm() - 2.0).abs() < 1e-12);
        assert_eq!(shown(&PREMIUM_6DOF).force, Vec3::zeros());
        assert_eq!(shown(&PREMIUM_6DOF).torque.x, 100.0);
    }

    #[test]
    fn a_share_of_the_wrench_is_displayed() {
        let mut stage = Stage::new(Workspace::at(Pose::identity()));
        stage.hand = stage.hand.at_share(0.25);
        assert_eq!(stage.settle().1, 0.25);
    }

    #[test]
    fn the_other_hands_pause_holds_this_one() {
        let mut stage = Stage::new(Workspace::at(Pose::identity()));
        stage.settle();
        stage.place(50.0, 0.0);
        assert_eq!(stage.tick(true), (Pose::identity(), 0.0));
        assert!(stage.tick(false).0.translation.x.abs() < 1e-12);
        stage.place(53.0, 0.0);
        assert!((stage.tick(false).0.translation.x - 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_clutch_lets_the_tool_stand() {
        let workspace = Workspace {
            clutch: Some(1),
            scale: 2.0,
            ..Workspace::at(Pose::identity())
        };
        let mut stage = Stage::new(workspace);
        stage.settle();
        stage.place(10.0, 0.0);
        assert!((stage.tick(false).0.translation.x - 20.0).abs() < 1e-12);
        stage.scene.lock().unwrap().reading.buttons = 0b10;
        stage.place(0.0, 0.0);
        assert!((stage.tick(false).0.translation.x - 20.0).abs() < 1e-12);
        stage.scene.lock().unwrap().reading.buttons = 0b01;
        stage.tick(false);
        stage.place(1.0, 0.0);
        assert!((stage.tick(false).0.translation.x - 22.0).abs() < 1e-12);
    }
}
