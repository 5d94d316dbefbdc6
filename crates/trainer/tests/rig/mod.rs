//! A hand on a device, closed around the real haptic step and the real bone.
//!
//! The device is a mass with viscous and Coulomb friction; it reads positions with the resolution of its encoders, and shows a
//! wrench that is held for a step and comes one step late. The hand is a mass on a spring and damper that leads to a target.
//! Both are integrated with twenty steps to a millisecond. Rotations are alike.
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use osteotome_devices::{DeviceModel, INVERSE_3, OMEGA_6, OMNI, PREMIUM_6DOF, SIGMA_7};
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::contact::{ContactLaw, Wrench, boundary_points};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{CrackSurface, LinePoint, Sheet, Solid};
use osteotome_mechanics::geometry::{Aabb, Pose, TetLocator, Vec3, block_mesh};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticInput, HapticModel, HapticState, haptic_step,
};
use osteotome_mechanics::step::main::{MainInput, MainSettings, MainState, main_step};
use osteotome_mechanics::step::{Body, Bone, PropagationSettings, Region, propagation_step};
use osteotome_mechanics::tool::{
    Chisel, ChiselParameters, Coupling, ScratchLimits, SolveSettings, Tool, ToolModel,
};
use std::sync::Arc;

/// What a device weighs, how it rubs and how finely it reads. Assumed: of the order that makers and studies name, not taken
/// from one source; the limits are the devices' own.
#[derive(Clone, Copy)]
pub struct Device {
    pub model: &'static DeviceModel,
    /// \[kg\]
    pub mass: f64,
    /// \[N s/m\]
    pub damping: f64,
    /// Coulomb \[N\].
    pub friction: f64,
    /// \[mm\]
    pub resolution: f64,
}

const fn device(model: &'static DeviceModel, mass: f64, friction: f64, resolution: f64) -> Device {
    Device {
        model,
        mass,
        damping: 0.005,
        friction,
        resolution,
    }
}

pub const DEVICES: [Device; 5] = [
    device(&OMNI, 0.045, 0.26, 0.055),
    device(&PREMIUM_6DOF, 0.136, 0.04, 0.03),
    device(&OMEGA_6, 0.25, 0.1, 0.01),
    device(&SIGMA_7, 0.25, 0.1, 0.0015),
    device(&INVERSE_3, 0.1, 0.1, 0.01),
];

/// A hand in translation: \[kg\], \[N s/m\], \[N/m\].
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    pub mass: f64,
    pub damping: f64,
    pub stiffness: f64,
}

/// The corners of the range that studies of the hand give.
pub fn hands() -> impl Iterator<Item = Hand> {
    (0..8).map(|k| Hand {
        mass: [0.05, 0.2][k & 1],
        damping: [2.0, 10.0][k >> 1 & 1],
        stiffness: [100.0, 1000.0][k >> 2 & 1],
    })
}

const SUBSTEPS: u32 = 20;
const DT: f64 = 1e-3;
/// Of the encoders of rotations \[rad\].
const ANGLE: f64 = 1e-3;
/// Coulomb friction is regularised below this speed \[mm/s\].
const CREEP: f64 = 0.5;

/// A hand's handle on its device.
#[derive(Clone)]
pub struct Handle {
    hand: Hand,
    device: Device,
    start: Vec3,
    pose: Pose,
    velocity: Vec3,
    spin: Vec3,
    target: Pose,
    /// Shown now: what was computed from the reading a step ago.
    shown: Wrench,
    /// Done by the loop on the hand, its largest value, and done by the hand's muscles forwards \[N mm\].
    pub work: f64,
    pub created: f64,
    pub put_in: f64,
}

impl Handle {
    pub fn new(hand: Hand, device: Device, pose: Pose) -> Self {
        Self {
            hand,
            device,
            start: pose.translation.vector,
            pose,
            velocity: Vec3::zeros(),
            spin: Vec3::zeros(),
            target: pose,
            shown: Wrench::ZERO,
            work: 0.0,
            created: 0.0,
            put_in: 0.0,
        }
    }

    /// What the encoders say.
    pub fn read(&self) -> Pose {
        let round = |v: f64, step: f64| (v / step).round() * step;
        let moved = self.pose.translation.vector - self.start;
        let at = self.start + moved.map(|v| round(v, self.device.resolution));
        let turn = self.pose.rotation.scaled_axis().map(|v| round(v, ANGLE));
        Pose::from_parts(at.into(), UnitQuaternion::from_scaled_axis(turn))
    }

    /// One step towards `target` under the last wrench; `wrench`, computed from the last reading, is shown from its end on.
    pub fn advance(&mut self, target: Pose, wrench: Wrench) {
        let before = self.target;
        let dt = DT / f64::from(SUBSTEPS);
        let aim = (target.translation.vector - before.translation.vector) / DT;
        let aim_spin = (target.rotation * before.rotation.inverse()).scaled_axis() / DT;
        for k in 0..SUBSTEPS {
            let share = f64::from(k) / f64::from(SUBSTEPS);
            let goal = before.translation.vector + aim * (share * DT);
            self.translate(goal, aim, dt);
            self.rotate(before.rotation, aim_spin, share, dt);
        }
        self.target = target;
        self.shown = wrench;
    }

    fn translate(&mut self, goal: Vec3, aim: Vec3, dt: f64) {
        let (hand, device) = (self.hand, self.device);
        let v = self.velocity;
        // N, from mm and mm/s.
        let muscles = (goal - self.pose.translation.vector) * (1e-3 * hand.stiffness)
            + (aim - v) * (1e-3 * hand.damping);
        let rub = v * (1e-3 * device.damping) + v * (device.friction / (v.norm() + CREEP));
        let shown = self.shown.force;
        self.velocity += (muscles + shown - rub) * (1e3 * dt / (hand.mass + device.mass));
        let way = self.velocity * dt;
        self.pose.translation.vector += way;
        self.work += shown.dot(&way);
        self.created = self.created.max(self.work);
        self.put_in += muscles.dot(&way).max(0.0);
    }

    /// As a hand of a natural frequency of some 20 Hz with seven tenths of critical damping.
    fn rotate(&mut self, before: UnitQuaternion<f64>, aim: Vec3, share: f64, dt: f64) {
        const INERTIA: f64 = 1e-4; // kg m2
        const DAMPING: f64 = 0.02; // N m s/rad
        const STIFFNESS: f64 = 2.0; // N m/rad
        let goal = UnitQuaternion::from_scaled_axis(aim * (share * DT)) * before;
        let turn = (goal * self.pose.rotation.inverse()).scaled_axis();
        let muscles = turn * STIFFNESS + (aim - self.spin) * DAMPING;
        let shown = self.shown.torque * 1e-3;
        self.spin += (muscles + shown) * (dt / INERTIA);
        let way = self.spin * dt;
        self.pose.rotation = UnitQuaternion::from_scaled_axis(way) * self.pose.rotation;
        self.pose.rotation.renormalize();
        self.work += 1e3 * shown.dot(&way);
        self.created = self.created.max(self.work);
        self.put_in += 1e3 * muscles.dot(&way).max(0.0);
    }
}

/// A block of cortical bone of 24 x 12 x 12 mm whose top is z = 0, held at -x, and if `sawn` with a kerf of .8 mm across its top
/// at x = 0, 5 mm deep. What comes off hangs in soft tissue.
pub fn block(sawn: bool) -> Bone {
    let (min, max) = (Vec3::new(-12.0, -6.0, -12.0), Vec3::new(12.0, 6.0, 0.0));
    let mesh = block_mesh(min, max, [12, 6, 6]);
    let held = |p: &Vec3| p.x < min.x + 1e-9 || (!sawn && p.z < min.z + 1e-9);
    let fixed = (0u32..).zip(mesh.nodes()).filter(|(_, p)| held(p));
    let supports = Supports {
        fixed: fixed.map(|f| f.0).collect(),
        ground_spring: 0.01,
        drag: 2.0,
        ..Default::default()
    };
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(15_000.0, 0.3, 0.5); mesh.tets().len()],
        lengths: GrowthLengths::for_element_size(mesh.mean_edge_length()),
        supports,
        mesh,
    };
    let end = |x: f64| {
        let nodes = (0u32..).zip(solid.mesh.nodes());
        nodes
            .filter(|(_, p)| (p.x - x).abs() < 1e-9)
            .map(|n| n.0)
            .collect()
    };
    let point = |y: f64| LinePoint {
        at: Vec3::new(0.1, y, 0.0),
        toward: -Vec3::z(),
        depth: 5.0,
    };
    let saw = Sheet::ribbon("saw", &[point(-6.0), point(0.0), point(6.0)], 0.8, 2.0, 2.0);
    let body = Body {
        surface: boundary_points(&solid.mesh, 8),
        ends: [end(min.x), end(max.x)],
        region: Region(Arc::new(Aabb { min, max })),
        wall_density: 25.0,
        solid: Arc::new(solid),
    };
    let sheets = if sawn { vec![saw] } else { Vec::new() };
    Bone::new(Arc::new(body), CrackSurface { sheets }).unwrap()
}

/// Both loops around both hands.
pub struct Rig {
    bone: Bone,
    model: HapticModel,
    main: MainState,
    state: HapticState,
    pub handles: [Handle; 2],
    step: u32,
    /// Whether the bone may break.
    pub breaks: bool,
    /// Shown to each hand, step by step \[N\], \[N mm\].
    pub forces: [Vec<f64>; 2],
    pub torques: [Vec<f64>; 2],
    /// What pulls at each hand at the bone, unlimited, step by step.
    pub pulls: [Vec<Wrench>; 2],
    /// Steps made when the crack first grew, and when the bone came apart.
    pub grown_at: Option<usize>,
    pub severed_at: Option<usize>,
}

/// Width of a chisel \[mm\].
pub const BLADE: f64 = 6.0;
/// Newtons and newton millimetres at the device for one at the bone.
pub const SCALES: [f64; 2] = [0.005, 0.01];

impl Rig {
    /// `stiffness`: of the coupling at the device \[N/mm\].
    pub fn new(
        device: Device,
        hands: [Hand; 2],
        sawn: bool,
        start: [Pose; 2],
        stiffness: f64,
    ) -> Self {
        let bone = block(sawn);
        let torque = if device.model.max_torque > 0.0 {
            device.model.max_torque
        } else {
            100.0
        };
        let limits = DeviceLimits {
            force_scale: SCALES[0],
            torque_scale: SCALES[1],
            max_force: device.model.max_force,
            max_torque: device.model.max_torque,
            max_force_rate: 500.0,
            max_torque_rate: 10_000.0,
        };
        let chisel = Chisel::new(ChiselParameters {
            width: BLADE,
            thickness: 2.0,
            bevel_deg: 8.0,
            length: 60.0,
        });
        let coupling = Coupling::new(
            stiffness / SCALES[0],
            1250.0 * stiffness / SCALES[1],
            device.model.max_force / SCALES[0],
            torque / SCALES[1],
        );
        let tool = Tool {
            shape: chisel.unwrap().shape(),
            coupling: coupling.unwrap(),
        };
        let n_ids = bone.points.len() + 20_000;
        Self {
            model: HapticModel {
                tools: ToolModel {
                    tools: [tool.clone(), tool],
                    law: ContactLaw::new(4000.0, 0.3).unwrap(),
                    surroundings: Vec::new(),
                },
                settings: SolveSettings::HAPTIC,
                limits: [limits.checked().unwrap(); 2],
            },
            main: MainState::new(&bone, n_ids, ScratchLimits::default()),
            state: HapticState::new(start, n_ids, ScratchLimits::default()),
            handles: [0, 1].map(|t| Handle::new(hands[t], device, start[t])),
            bone,
            step: 0,
            breaks: false,
            forces: Default::default(),
            torques: Default::default(),
            pulls: Default::default(),
            grown_at: None,
            severed_at: None,
        }
    }

    /// A millisecond; twenty of them to a main step.
    pub fn advance(&mut self, targets: [Pose; 2]) {
        let devices = [0, 1].map(|t| self.handles[t].read());
        let input = HapticInput {
            scene: self.main.scene(&self.bone),
            compliance: self.main.compliance.as_ref(),
            devices,
            dt: DT,
        };
        let output = haptic_step(&self.model, &mut self.state, &input);
        assert_eq!(output.fault, None, "step {}", self.step);
        for (t, handle) in self.handles.iter_mut().enumerate() {
            handle.advance(targets[t], output.device[t]);
            self.forces[t].push(output.device[t].force.norm());
            self.torques[t].push(output.device[t].torque.norm());
            self.pulls[t].push(output.bone[t]);
        }
        self.step += 1;
        if self.step.is_multiple_of(20) {
            self.main_loop(devices);
        }
    }

    fn main_loop(&mut self, devices: [Pose; 2]) {
        let tools = *self.state.tools();
        let input = MainInput { devices, tools };
        let settings = MainSettings::default();
        main_step(
            &self.bone,
            &self.model.tools,
            &settings,
            &mut self.main,
            &input,
        );
        if self.breaks {
            let settings = PropagationSettings::default();
            let grown = propagation_step(&self.bone, &self.main.bone, &settings, None).unwrap();
            if let (Some(grown), _) = grown {
                self.main.adopt(&self.bone, &grown);
                self.bone = grown;
                let now = self.step as usize;
                self.grown_at.get_or_insert(now);
                if self.bone.is_severed() {
                    self.severed_at.get_or_insert(now);
                }
            }
        }
    }

    /// Largest deviation from the mean over the last `n` steps, force and torque of the first hand.
    pub fn ripple(&self, n: usize) -> [f64; 2] {
        [&self.forces[0], &self.torques[0]].map(|shown| {
            let last = &shown[shown.len() - n..];
            let mean = last.iter().sum::<f64>() / n as f64;
            last.iter().fold(0.0, |m: f64, f| m.max((f - mean).abs()))
        })
    }
}

/// Driven along -z, its width along y, then turned by `turn`: an edge at `at`.
pub fn downward(at: Vec3, turn: Vec3) -> Pose {
    // x along world y, y along world x, z down.
    let axes = Matrix3::from_columns(&[Vec3::y(), Vec3::x(), -Vec3::z()]);
    let base = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Pose::from_parts(at.into(), UnitQuaternion::from_scaled_axis(turn) * base)
}
