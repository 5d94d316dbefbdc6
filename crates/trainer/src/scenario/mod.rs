//! The scenario: one TOML file that says everything about a session.
//!
//! [`load`] reads the file, applies `--set`, names unknown keys, resolves paths and checks every number; what it
//! returns needs no second look.
mod overrides;
mod read;
mod targets;

pub use overrides::Override;
pub use read::{Source, explain, load, parse_toml, plain};
pub use targets::{Target, Targets};

pub use osteotome_anatomy::Technique;
use osteotome_anatomy::density::DensitySpec;
use osteotome_anatomy::{CorticalRegions, Parameters};
use osteotome_devices::Binding;
use osteotome_mechanics::bone::EngineeringConstants;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A session's whole description.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Always `mm-N-MPa`.
    pub units: Units,
    /// Title shown to the user.
    pub name: String,
    /// Start of the surgeon's random variations.
    #[serde(default)]
    pub seed: u64,
    /// Longest simulated time \[s\].
    #[serde(default = "default_max_time")]
    pub max_time: f64,
    /// Whose bone.
    pub patient: Patient,
    /// How finely it is meshed and sampled.
    #[serde(default)]
    pub mesh: Mesh,
    /// Elasticity and toughness by region.
    #[serde(default)]
    pub material: Materials,
    /// The pre-sawn line.
    pub osteotomy: Osteotomy,
    /// What holds the bone.
    #[serde(default)]
    pub supports: Supports,
    /// Penalty contact and friction.
    #[serde(default)]
    pub contact: Contact,
    /// The two chisels, the left hand's first.
    #[serde(default = "default_tools")]
    pub tool: Vec<Tool>,
    /// The built-in surgeon.
    #[serde(default)]
    pub surgeon: Surgeon,
    /// Rates of the loops.
    #[serde(default)]
    pub loops: Loops,
    /// How two eyes look at it.
    #[serde(default)]
    pub view: Eyes,
    /// Whether the window gives no hints.
    #[serde(default)]
    pub exam: bool,
    /// What a debrief scores, with thresholds and weights.
    #[serde(default)]
    pub targets: Targets,
}

fn default_max_time() -> f64 {
    30.0
}

fn default_tools() -> Vec<Tool> {
    ["left", "right"].map(Tool::named).into()
}

/// Units of every number in the file.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub enum Units {
    /// mm, N, MPa (and N mm, s, rad unless a key's name says otherwise).
    #[serde(rename = "mm-N-MPa")]
    MmNMpa,
}

/// Exactly one of `parametric`, `directory`, `surface` is given.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Patient {
    /// The built-in mandible by its sizes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parametric: Option<Parameters>,
    /// A patient's folder that `prepare` made; without `mesh.nodes` its own mesh is used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directory: Option<PathBuf>,
    /// A closed surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<PathBuf>,
    /// The nerve's canal on the operated side (JSON), for the debrief; goes before the built-in mandible's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub canal: Option<PathBuf>,
    /// What stands still around the jaw.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub context: Vec<Context>,
}

/// A surface around the jaw: seen, and touched by the tools if it is closed.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Context {
    /// An STL, PLY or OBJ file.
    pub surface: PathBuf,
    /// What it is: maxilla, teeth, skull, soft tissue, retractor.
    #[serde(default = "anything")]
    pub role: String,
}

fn anything() -> String {
    "context".to_owned()
}

/// Mesh and point shell.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mesh {
    /// Nodes aimed at.
    pub nodes: usize,
    /// How much finer the mesh is about the osteotomy line than where it is coarsest; 1: the same everywhere.
    pub grading: f64,
    /// A tetrahedral mesh to use instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Points on the bone's surface for contact.
    pub shell_points: usize,
}

impl Default for Mesh {
    fn default() -> Self {
        Self {
            nodes: 5000,
            grading: 1.0,
            file: None,
            shell_points: 100_000,
        }
    }
}

/// Materials by region.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Materials {
    /// The dense outer layer.
    pub cortical: Material,
    /// Nine constants of the dense layer in place of its modulus and ratio: axis 1 along the jaw, axis 2 up, axis 3 across.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cortical_orthotropic: Option<EngineeringConstants>,
    /// The spongy inside.
    pub trabecular: Material,
    /// Thickness of the cortical layer \[mm\].
    pub cortical_thickness: f64,
    /// The same by region, in place of that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cortical_regions: Option<CorticalRegions>,
    /// Young's modulus of bone by a scan's density, in place of the two above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<DensitySpec>,
}

impl Default for Materials {
    fn default() -> Self {
        Self {
            cortical: Material {
                young_modulus: 15_000.0,
                poisson_ratio: 0.3,
                toughness: [0.5, 2.0],
            },
            cortical_orthotropic: None,
            trabecular: Material {
                young_modulus: 1500.0,
                poisson_ratio: 0.3,
                toughness: [0.2, 0.2],
            },
            cortical_thickness: 2.2,
            cortical_regions: None,
            density: None,
        }
    }
}

/// One region's material.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Young's modulus \[MPa\].
    pub young_modulus: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Critical energy release rate along and across the osteons \[N/mm\].
    pub toughness: [f64; 2],
}

/// The pre-sawn line: by exactly one of `points`, `file`, `technique`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Osteotomy {
    /// Which half of the jaw.
    pub side: Side,
    /// Width of the saw's slit \[mm\].
    #[serde(default = "default_kerf")]
    pub kerf: f64,
    /// The line itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<LinePoint>>,
    /// A file with the line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// A named technique, placed on the patient's landmarks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub technique: Option<Technique>,
}

fn default_kerf() -> f64 {
    0.8
}

/// Side of the patient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The patient's right.
    Right,
    /// The patient's left.
    Left,
}

/// One point of the line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinePoint {
    /// On the bone's surface \[mm\].
    pub at: [f64; 3],
    /// Depth of the slit there \[mm\].
    pub depth: f64,
    /// Direction into the bone.
    pub toward: [f64; 3],
    /// Which cut it belongs to: `medial`, `ridge`, `buccal` or another name.
    pub part: String,
}

/// Supports.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Supports {
    /// How the condyles are held.
    pub condyles: Condyles,
    /// Ground spring of the soft tissue, relative to E h.
    pub soft_tissue: f64,
    /// The assistant's hand that steadies the chin against the chisels \[N/mm\]; 0 for none.
    pub chin: f64,
}

impl Default for Supports {
    fn default() -> Self {
        Self {
            condyles: Condyles::Joint,
            soft_tissue: 1e-7,
            chin: 200.0,
        }
    }
}

/// How the condyles are held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Condyles {
    /// All displacements zero there.
    Fixed,
    /// By the capsule of the joint: springs that keep the condyle in place and let it turn.
    Joint,
}

/// Penalty contact between tools and bone.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Contact {
    /// Pressure for a penetration \[MPa/mm\].
    pub stiffness: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
}

impl Default for Contact {
    fn default() -> Self {
        Self {
            stiffness: 4000.0,
            friction: 0.3,
        }
    }
}

/// A chisel, the device that leads it and how its forces are shown there.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// `left` or `right`.
    pub name: String,
    /// Its shape.
    #[serde(default)]
    pub chisel: Chisel,
    /// Which device.
    #[serde(default)]
    pub device: Binding,
    /// Lets a `remote` device be led from other machines.
    #[serde(default)]
    pub allow_network: bool,
    /// How the device's workspace lies in the world; no meaning for a simulated hand.
    #[serde(default)]
    pub workspace: Workspace,
    /// Displayed force = bone force x scale.
    #[serde(default = "default_force_scale")]
    pub force_scale: f64,
    /// Displayed torque = bone torque x scale.
    #[serde(default = "default_torque_scale")]
    pub torque_scale: f64,
    /// Most the device displays.
    #[serde(default)]
    pub limits: Limits,
    /// Virtual coupling between handle and chisel, as felt at the device.
    #[serde(default)]
    pub coupling: Coupling,
    /// The simulated hand.
    #[serde(default)]
    pub hand: Hand,
}

fn default_force_scale() -> f64 {
    0.005
}

fn default_torque_scale() -> f64 {
    0.04
}

impl Tool {
    /// A tool of this name, all else default.
    fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            chisel: Chisel::default(),
            device: Binding::default(),
            allow_network: false,
            workspace: Workspace::default(),
            force_scale: default_force_scale(),
            torque_scale: default_torque_scale(),
            limits: Limits::default(),
            coupling: Coupling::default(),
            hand: Hand::default(),
        }
    }
}

/// A chisel's sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Chisel {
    /// Width of the cutting edge \[mm\].
    pub width: f64,
    /// Thickness of the blade \[mm\].
    pub thickness: f64,
    /// Angle at the cutting edge \[deg\].
    pub bevel_deg: f64,
    /// Length of the blade \[mm\].
    pub length: f64,
}

impl Default for Chisel {
    fn default() -> Self {
        Self {
            width: 10.0,
            thickness: 3.0,
            bevel_deg: 20.0,
            length: 60.0,
        }
    }
}

/// How a device's workspace lies in the world. Its frame is x to the user's right, y away, z up; untouched, that is the
/// world's as seen by somebody who faces the patient. The tool starts where the built-in surgeon's does.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Workspace {
    /// World mm a device mm.
    pub scale: f64,
    /// Turns the device's frame: about x, then y, then z \[deg\].
    pub rotation_deg: [f64; 3],
    /// Turns the chisel within the handle, likewise; untouched, it lies as the built-in surgeon's does \[deg\].
    pub handle_deg: [f64; 3],
    /// Swaps left and right.
    pub mirrored: bool,
    /// The button (0 the first) that lets the chisel stand while it is held down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clutch_button: Option<u8>,
    /// A device without torque shows the torque across the chisel's shaft as a force at this lever \[mm\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_lever: Option<f64>,
}

impl Default for Workspace {
    fn default() -> Self {
        Self {
            scale: 1.0,
            rotation_deg: [0.0; 3],
            handle_deg: [0.0; 3],
            mirrored: false,
            clutch_button: None,
            torque_lever: None,
        }
    }
}

/// The most a device displays; defaults: Phantom Premium 1.5/6DOF.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// \[N\]
    pub force: f64,
    /// \[N mm\]
    pub torque: f64,
    /// Fastest change of the force \[N/s\].
    pub force_rate: f64,
    /// Fastest change of the torque \[N mm/s\].
    pub torque_rate: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            force: 8.5,
            torque: 188.0,
            force_rate: 500.0,
            torque_rate: 10_000.0,
        }
    }
}

/// Virtual coupling at the device.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Coupling {
    /// \[N/mm\]; 1 kHz keeps about .3-.5 clean.
    pub linear_stiffness: f64,
    /// \[N mm/rad\]
    pub angular_stiffness: f64,
}

impl Default for Coupling {
    fn default() -> Self {
        Self {
            linear_stiffness: 0.4,
            angular_stiffness: 500.0,
        }
    }
}

/// The simulated hand; see `osteotome_devices::HandParameters`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Hand {
    /// \[kg\]
    pub mass: f64,
    /// \[N s/m\]
    pub damping: f64,
    /// \[N/m\]
    pub stiffness: f64,
    /// \[kg m2\]
    pub inertia: f64,
    /// \[N m s/rad\]
    pub angular_damping: f64,
    /// \[N m/rad\]
    pub angular_stiffness: f64,
}

impl Default for Hand {
    fn default() -> Self {
        let p = osteotome_devices::HandParameters::default();
        Self {
            mass: p.mass,
            damping: p.damping,
            stiffness: p.stiffness,
            inertia: p.inertia,
            angular_damping: p.angular_damping,
            angular_stiffness: p.angular_stiffness,
        }
    }
}

/// The built-in surgeon's habits. Lengths along the blade's driving direction are counted from the bone's surface.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Surgeon {
    /// Where along the ridge each hand's chisel goes in, as a share of its length (left, right).
    pub stations: [f64; 2],
    /// Height above the bone at the start \[mm\].
    pub approach_distance: f64,
    /// Speed outside the bone \[mm/s\].
    pub approach_speed: f64,
    /// Speed into the slit and deeper \[mm/s\].
    pub drive_speed: f64,
    /// How far into the slit first, as a share of its depth.
    pub insert_depth: f64,
    /// Twisting speed \[deg/s\].
    pub twist_rate_deg: f64,
    /// Twist at most \[deg\].
    pub twist_max_deg: f64,
    /// The tips stay this far behind the crack front \[mm\].
    pub behind_front: f64,
    /// Beyond that, driven in by up to this as a wedge where the crack stands still \[mm\].
    pub wedge: f64,
    /// Deepest tip \[mm\].
    pub max_depth: f64,
    /// The crack has stood still for so long: try something else \[s\].
    pub stall_time: f64,
    /// Inserts and follows the crack with no more than this displayed force, as a share of the device's limit.
    pub push_share: f64,
    /// Likewise where the crack stands still and the chisels are driven on as wedges.
    pub force_share: f64,
    /// From the break to the first reaction, at mean \[s\].
    pub reaction_time: f64,
    /// Time to untwist after that, before withdrawing \[s\].
    pub relax_time: f64,
    /// Relative spread of speeds and reaction time between seeds.
    pub variation: f64,
}

impl Default for Surgeon {
    fn default() -> Self {
        Self {
            stations: [0.2, 0.8],
            approach_distance: 10.0,
            approach_speed: 8.0,
            drive_speed: 4.0,
            insert_depth: 0.9,
            twist_rate_deg: 15.0,
            twist_max_deg: 45.0,
            behind_front: 2.0,
            wedge: 15.0,
            max_depth: 25.0,
            stall_time: 0.2,
            push_share: 0.3,
            force_share: 0.45,
            reaction_time: 0.06,
            relax_time: 0.15,
            variation: 0.05,
        }
    }
}

/// Two eyes or more, for pictures and windows in stereo; lengths in the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Eyes {
    /// From eye to eye \[mm\]; without it a thirtieth of the distance at which they converge, the usual bound of comfort.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eye_separation: Option<f64>,
    /// Distance \[mm\] at which both eyes' pictures meet: what is nearer stands out of the screen. Without it where the camera
    /// looks at.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub convergence: Option<f64>,
    /// From so many places side by side, `eye_separation` from each to the next: for screens that show more than two pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<usize>,
}

/// Rates of the loops.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Loops {
    /// Haptic steps a second.
    pub haptic_hz: f64,
    /// Main steps a second; divides `haptic_hz`.
    pub main_hz: f64,
}

impl Default for Loops {
    fn default() -> Self {
        Self {
            haptic_hz: 1000.0,
            main_hz: 50.0,
        }
    }
}

impl Loops {
    /// Step of the haptic loop \[s\].
    pub fn dt(&self) -> f64 {
        1.0 / self.haptic_hz
    }

    /// Haptic steps to a main step.
    pub fn haptic_per_main(&self) -> u32 {
        (self.haptic_hz / self.main_hz).round() as u32
    }
}

/// The shipped scenario, right side.
pub const BSSO_RIGHT: &str = include_str!("../../../../scenarios/bsso_right.toml");
/// The shipped scenario, left side.
pub const BSSO_LEFT: &str = include_str!("../../../../scenarios/bsso_left.toml");
/// The right side through the open mouth.
pub const BSSO_RIGHT_MOUTH: &str = include_str!("../../../../scenarios/bsso_right_mouth.toml");
/// The left side through the open mouth.
pub const BSSO_LEFT_MOUTH: &str = include_str!("../../../../scenarios/bsso_left_mouth.toml");

impl Tool {
    /// The simulated hand that holds this tool's device.
    pub fn hand_parameters(&self) -> osteotome_devices::HandParameters {
        osteotome_devices::HandParameters {
            mass: self.hand.mass,
            damping: self.hand.damping,
            stiffness: self.hand.stiffness,
            inertia: self.hand.inertia,
            angular_damping: self.hand.angular_damping,
            angular_stiffness: self.hand.angular_stiffness,
            max_force: self.limits.force,
            max_torque: self.limits.torque,
        }
    }
}
