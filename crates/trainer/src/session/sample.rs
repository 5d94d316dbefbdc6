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

impl HandSample {
    /// As it is recorded: tool and wrench to digits that are far below what anybody or anything feels or measures (1e-6 mm, 1e-8,
    /// 1e-5 N, 1e-4 N mm). The device's pose, from which a session is recomputed, is kept to the last bit.
    #[must_use]
    pub fn rounded(&self) -> Self {
        Self {
            tool_pose: rounded(&self.tool_pose, [1e6, 1e8]),
            wrench: Wrench {
                force: self.wrench.force.map(|v| nearest(v, 1e5)),
                torque: self.wrench.torque.map(|v| nearest(v, 1e4)),
            },
            ..*self
        }
    }

    fn bits(&self) -> impl Iterator<Item = u64> {
        let (tool, wrench) = (self.tool_pose, self.wrench);
        let numbers = [tool.translation.vector, wrench.force, wrench.torque];
        let numbers = numbers.map(<[f64; 3]>::from).into_iter().flatten();
        let turn: [f64; 4] = tool.rotation.coords.into();
        numbers.chain(turn).map(f64::to_bits)
    }
}

/// To the nearest multiple of 1 / `steps`, which has few digits in decimals.
fn nearest(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

/// A pose with so many steps a mm and in one. Its quaternion is off the unit length by some 1e-9, which no step of the mechanics
/// notices.
fn rounded(pose: &Pose, [mm, one]: [f64; 2]) -> Pose {
    let turn = pose.rotation.coords.map(|v| nearest(v, one));
    let turn = nalgebra::UnitQuaternion::new_unchecked(turn.into());
    let place = pose.translation.vector.map(|v| nearest(v, mm));
    Pose::from_parts(place.into(), turn)
}

/// A live hand's pose as the session takes it in: to 1e-6 mm and 1e-9, some ten thousand times finer than any device resolves. So
/// that a recording keeps it to the last bit in few digits.
pub fn on_grid(pose: &Pose) -> Pose {
    rounded(pose, [1e6, 1e9])
}

/// A number that follows from every bit of tools and wrenches of all haptic steps so far: sessions that agree in it agree in those,
/// but for a chance of 1 in 1e19. So a recording of rounded numbers still tells whether a replay is exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest {
    /// Haptic steps so far.
    pub steps: u64,
    bits: u64,
}

impl Default for Digest {
    fn default() -> Self {
        Self {
            steps: 0,
            bits: 0xcbf2_9ce4_8422_2325,
        }
    }
}

impl Digest {
    /// One step more.
    pub fn take(&mut self, sample: &HapticSample) {
        self.steps += 1;
        for word in sample.hands.iter().flat_map(HandSample::bits) {
            self.bits = (self.bits ^ word).wrapping_mul(0x0000_0100_0000_01b3);
            // A multiplication alone carries nothing downwards: two changed signs would cancel each other.
            self.bits ^= self.bits >> 32;
        }
    }
}

/// A digest as it is written.
#[derive(Serialize, Deserialize)]
pub struct DigestForm {
    steps: u64,
    /// Hexadecimal: JSON's numbers are 53 bits in many programs.
    bits: String,
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

impl Wire for Digest {
    type Form = DigestForm;
    fn to_wire(&self) -> DigestForm {
        DigestForm {
            steps: self.steps,
            bits: format!("{:016x}", self.bits),
        }
    }
    fn from_wire(form: &DigestForm) -> Self {
        Self {
            steps: form.steps,
            // What is no number agrees with nothing.
            bits: u64::from_str_radix(&form.bits, 16).unwrap_or(0),
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

    /// Rounded values come back as they were written, in short; rounding twice changes nothing.
    #[test]
    fn a_rounded_hand_is_near_and_short() {
        let exact = HandSample {
            tool_pose: Pose::new(
                Vec3::new(-37.123_456_789_1, 0.1, 1e-9),
                Vec3::new(0.3, 1.1, 0.7),
            ),
            ..hand(std::f64::consts::PI)
        };
        let once = exact.rounded();
        let json = serde_json::to_string(&once.to_wire()).unwrap();
        assert!(
            json.contains("-37.123457,") && json.contains("3.14159,"),
            "{json}"
        );
        assert_eq!(format!("{once:?}"), format!("{:?}", once.rounded()));
        let off = once.tool_pose.translation.vector - exact.tool_pose.translation.vector;
        assert!(
            off.norm() < 1e-6 && once.tool_pose.rotation.angle_to(&exact.tool_pose.rotation) < 3e-8
        );
        assert!((once.wrench.force - exact.wrench.force).norm() < 1e-5);
        assert_eq!(
            once.device_pose, exact.device_pose,
            "what is recomputed from is not touched"
        );
        assert_eq!(
            on_grid(&on_grid(&exact.device_pose)),
            on_grid(&exact.device_pose)
        );
    }

    #[test]
    fn a_digest_knows_the_last_bit_and_the_order() {
        let sample = |x: f64| HapticSample {
            step: 0,
            time: 0.0,
            hands: [hand(x), hand(2.0)],
        };
        let of = |xs: &[f64]| {
            let mut digest = Digest::default();
            xs.iter().for_each(|x| digest.take(&sample(*x)));
            digest
        };
        let (one, next) = (1.0_f64, 1.0_f64.next_up());
        assert_ne!(of(&[one, 3.0]), of(&[next, 3.0]));
        assert_ne!(of(&[one, 3.0]), of(&[3.0, one]));
        let mut turned = sample(one);
        turned.hands[0].wrench.force *= -1.0;
        let mut digest = Digest::default();
        digest.take(&turned);
        assert_ne!(digest, of(&[one]), "several changed signs do not cancel");
        assert_eq!(Digest::from_wire(&of(&[one]).to_wire()), of(&[one]));
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
