use osteotome_devices::Wrench;
use osteotome_mechanics::geometry::{Pose, Vec3};
use serde::{Deserialize, Serialize};

/// One hand in one haptic step. Fixed size: it goes through a ring from the haptic loop.
#[derive(Clone, Copy, Debug)]
pub struct HandSample {
    /// The device's handle.
    pub device_pose: Pose,
    /// Its buttons.
    pub device_buttons: u32,
    /// The virtual chisel.
    pub tool_pose: Pose,
    /// As displayed at the device \[N, N mm\].
    pub wrench: Wrench,
    /// Whether force or torque was at the device's limit.
    pub saturated: bool,
    /// Points in contact.
    pub contacts: u32,
}

/// Both hands in one haptic step, left first.
#[derive(Clone, Copy, Debug)]
pub struct HapticSample {
    /// Number of the step, from 0.
    pub step: u64,
    /// Simulated time \[s\].
    pub time: f64,
    /// Left, right.
    pub hands: [HandSample; 2],
}

/// One main step.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct MainSample {
    /// Simulated time \[s\].
    #[serde(skip)]
    pub time: f64,
    /// Relaxation passes.
    pub iterations: u32,
    /// Change in the last pass, relative to the tolerance's norm.
    pub residual: f64,
    /// Whether the tolerance was met.
    pub converged: bool,
    /// Points in contact, both tools.
    pub contacts: u32,
    /// Largest nodal displacement \[mm\].
    pub max_displacement: f64,
    /// \[N mm\]
    pub strain_energy: f64,
}

/// How the bone is deformed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BoneSample {
    /// Simulated time \[s\].
    #[serde(skip)]
    pub time: f64,
    /// The generation of the bone that the unknowns belong to.
    pub generation: u64,
    /// Unknowns x_XF: displacements of nodes, then jumps of enrichments, in micrometres.
    pub x_um: Vec<i32>,
}

/// A vertex of the crack front.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct FrontPoint {
    /// \[mm\]
    pub position: [f64; 3],
    /// Stress intensity factors I, II, III \[MPa sqrt(mm)\].
    #[serde(rename = "K")]
    pub k: [f64; 3],
    /// Energy release rate \[N/mm\].
    #[serde(rename = "G")]
    pub g: f64,
    /// Direction of growth out of the crack's plane \[rad\].
    pub angle: f64,
}

/// The crack after a growth step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct GrowthSample {
    /// Simulated time \[s\].
    #[serde(skip)]
    pub time: f64,
    /// Vertices of the crack surface \[mm\].
    pub vertices: Vec<[f64; 3]>,
    /// Its triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Kerf half width at each vertex; 0 where the bone broke \[mm\].
    pub kerf: Vec<f64>,
    /// Which generation of the bone this is.
    pub generation: u64,
    /// The fronts as they were when they grew; empty for the saw cuts.
    pub front: Vec<FrontPoint>,
    /// Area of broken bone, the saw's excluded \[mm2\].
    pub area: f64,
    /// Pieces of 1 % of the volume or more.
    pub fragments: usize,
    /// Whether the operated side has come off: the split is complete.
    pub severed: bool,
    /// Of each sheet in turn, how many of the vertices and triangles are its own.
    #[serde(default)]
    pub sheets: Vec<[u32; 2]>,
    /// Mesh edges cut since the generation before, and the share at which each is crossed, from its lower node.
    #[serde(default)]
    pub cut: Vec<(u32, f64)>,
    /// Mesh nodes moved off the crack for the crossing test since the generation before, and where to \[mm\].
    #[serde(default)]
    pub seats: Vec<(u32, [f64; 3])>,
    /// Where the bone still holds: the new front inside the bone, or what bridges the gap \[mm\].
    #[serde(skip)]
    pub tips: Vec<Vec3>,
}

/// The three loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Loop {
    /// 1 kHz.
    Haptic,
    /// 50 Hz.
    Main,
    /// As it can.
    Propagation,
}

/// What a step read of what the other loops had told by then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// Haptic: number of the bone's state; main: haptic steps made; propagation: number of the main step.
    pub state: u64,
    /// Main: the generation of the bone.
    pub generation: Option<u64>,
}

/// What a step read, as recorded: of the haptic steps only those that read something new. With it a session on three threads
/// repeats to the last bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exchange {
    /// Whose step.
    #[serde(rename = "loop")]
    pub of: Loop,
    /// Which of its steps, from 0.
    pub step: u64,
    /// As [`Seen::state`].
    pub state: u64,
    /// As [`Seen::generation`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub generation: Option<u64>,
}

/// How long a step took.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct StepTime {
    /// Simulated time \[s\].
    #[serde(skip)]
    pub time: f64,
    /// Whose step.
    #[serde(rename = "loop")]
    pub of: Loop,
    /// \[us\]
    pub step_us: f64,
}

/// The form in which poses, wrenches and hands are written to JSON.
pub trait Wire: Sized {
    /// The serialisable form.
    type Form: Serialize + serde::de::DeserializeOwned;
    /// To it.
    fn to_wire(&self) -> Self::Form;
    /// Back; bit for bit what went in.
    fn from_wire(form: &Self::Form) -> Self;
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Xyzw {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// A pose as it is written.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseForm {
    position: Xyz,
    orientation: Xyzw,
}

#[derive(Serialize, Deserialize)]
pub struct WrenchForm {
    force: Xyz,
    torque: Xyz,
}

#[derive(Serialize, Deserialize)]
pub struct HandForm {
    device_pose: PoseForm,
    device_buttons: u32,
    tool_pose: PoseForm,
    wrench: WrenchForm,
    saturated: bool,
    contacts: u32,
}

impl Wire for Vec3 {
    type Form = Xyz;
    fn to_wire(&self) -> Xyz {
        let [x, y, z] = (*self).into();
        Xyz { x, y, z }
    }
    fn from_wire(form: &Xyz) -> Self {
        Self::new(form.x, form.y, form.z)
    }
}

impl Wire for Pose {
    type Form = PoseForm;
    fn to_wire(&self) -> PoseForm {
        let [x, y, z, w] = self.rotation.coords.into();
        PoseForm {
            position: self.translation.vector.to_wire(),
            orientation: Xyzw { x, y, z, w },
        }
    }
    fn from_wire(form: &PoseForm) -> Self {
        let o = &form.orientation;
        let quaternion = nalgebra::Quaternion::new(o.w, o.x, o.y, o.z);
        // Not normalised again: that would change the last bits, and a replay is held to all of them.
        let rotation = nalgebra::UnitQuaternion::new_unchecked(quaternion);
        Self::from_parts(Vec3::from_wire(&form.position).into(), rotation)
    }
}

impl Wire for Wrench {
    type Form = WrenchForm;
    fn to_wire(&self) -> WrenchForm {
        WrenchForm {
            force: self.force.to_wire(),
            torque: self.torque.to_wire(),
        }
    }
    fn from_wire(form: &WrenchForm) -> Self {
        Self {
            force: Vec3::from_wire(&form.force),
            torque: Vec3::from_wire(&form.torque),
        }
    }
}

impl Wire for HandSample {
    type Form = HandForm;
    fn to_wire(&self) -> HandForm {
        HandForm {
            device_pose: self.device_pose.to_wire(),
            device_buttons: self.device_buttons,
            tool_pose: self.tool_pose.to_wire(),
            wrench: self.wrench.to_wire(),
            saturated: self.saturated,
            contacts: self.contacts,
        }
    }
    fn from_wire(form: &HandForm) -> Self {
        Self {
            device_pose: Pose::from_wire(&form.device_pose),
            device_buttons: form.device_buttons,
            tool_pose: Pose::from_wire(&form.tool_pose),
            wrench: Wrench::from_wire(&form.wrench),
            saturated: form.saturated,
            contacts: form.contacts,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub fn hand(x: f64) -> HandSample {
        HandSample {
            device_pose: Pose::new(Vec3::new(x, 0.1, -1e-7), Vec3::new(0.3, x, 0.7)),
            device_buttons: 5,
            tool_pose: Pose::translation(x / 3.0, 0.0, 1487.5),
            wrench: Wrench {
                force: Vec3::new(0.1, x, 0.0),
                torque: Vec3::new(1.0 / 3.0, 2.0, x),
            },
            saturated: true,
            contacts: 17,
        }
    }

    #[test]
    fn a_hand_comes_back_from_json_bit_for_bit() {
        let before = hand(std::f64::consts::PI);
        let json = serde_json::to_string(&before.to_wire()).unwrap();
        let form = serde_json::from_str(&json).unwrap();
        let after = HandSample::from_wire(&form);
        assert_eq!(format!("{before:?}"), format!("{after:?}"));
    }
}
