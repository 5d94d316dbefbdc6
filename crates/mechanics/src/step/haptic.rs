//! The haptic loop's step: paper 3.4, steps 4 to 6 for both tools at 1 kHz.
use crate::contact::{Anchors, ContactScene, Wrench};
use crate::geometry::{Pose, Vec3};
use crate::tool::{
    BoneCompliance, ScratchLimits, SolveSettings, ToolInput, ToolModel, ToolScratch, ToolsResult,
    ToolsState, solve_tools,
};

/// How bone units become those of one device, and what the device can bear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceLimits {
    /// Newtons at the device a newton at the bone.
    pub force_scale: f64,
    /// Alike for torque.
    pub torque_scale: f64,
    /// At the device \[N\].
    pub max_force: f64,
    /// At the device \[N mm\]; 0 for a device without torque.
    pub max_torque: f64,
    /// Fastest change at the device \[N/s\].
    pub max_force_rate: f64,
    /// Fastest change at the device \[N mm/s\].
    pub max_torque_rate: f64,
}

/// Why device limits were refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("device limit {name} is {value}; it must be a number of at least 0")]
pub struct DeviceLimitsError {
    name: &'static str,
    value: f64,
}

impl DeviceLimits {
    /// Checks that all are finite and none is negative.
    ///
    /// # Errors
    /// [`DeviceLimitsError`] names the first that is not.
    pub fn checked(self) -> Result<Self, DeviceLimitsError> {
        let named = [
            ("force_scale", self.force_scale),
            ("torque_scale", self.torque_scale),
            ("max_force", self.max_force),
            ("max_torque", self.max_torque),
            ("max_force_rate", self.max_force_rate),
            ("max_torque_rate", self.max_torque_rate),
        ];
        for (name, value) in named {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(DeviceLimitsError { name, value });
            }
        }
        Ok(self)
    }

    /// What the device is told, having been told `last` `dt` \[s\] ago, when `pull` acts on the hand in bone units.
    fn output(&self, pull: &Wrench, last: &Wrench, dt: f64) -> Wrench {
        let force = clamped(pull.force * self.force_scale, self.max_force);
        let torque = clamped(pull.torque * self.torque_scale, self.max_torque);
        let dt = if dt > 0.0 { dt } else { 0.0 };
        Wrench {
            force: last.force + clamped(force - last.force, self.max_force_rate * dt),
            torque: last.torque + clamped(torque - last.torque, self.max_torque_rate * dt),
        }
    }
}

fn clamped(v: Vec3, max: f64) -> Vec3 {
    let length = v.norm();
    if length > max { v * (max / length) } else { v }
}

/// A wrench reaches the hand a step after the pose it answers was read, and stands for a step: one and a half in the middle. By
/// then a moving hand is elsewhere, and a spring that answers late gives back more than was put in. So the wrench is led by its own slope.
const LEAD: f64 = 2e-3; // s
/// The slope is smoothed over this time, else the steps of the encoders would be felt \[s\].
const SMOOTHING: f64 = 2e-3;

/// A pull and how fast it changes, for one hand.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pull {
    now: Wrench,
    /// \[N/s, N mm/s\]
    slope: Wrench,
}

impl Pull {
    const NONE: Self = Self {
        now: Wrench::ZERO,
        slope: Wrench::ZERO,
    };

    /// Takes in the next pull; where it will be by the time it is felt.
    fn led(&mut self, pull: &Wrench, dt: f64) -> Wrench {
        if dt > 0.0 {
            let share = dt / (dt + SMOOTHING);
            let steepness = (*pull + -self.now) * (1.0 / dt);
            self.slope = self.slope * (1.0 - share) + steepness * share;
        }
        self.now = *pull;
        *pull + self.slope * LEAD
    }
}

/// What is constant over all haptic steps.
#[derive(Clone, Debug)]
pub struct HapticModel {
    /// Tools and how they touch.
    pub tools: ToolModel,
    /// Bounds of the solve.
    pub settings: SolveSettings,
    /// One a hand.
    pub limits: [DeviceLimits; 2],
}

/// What a haptic step is given.
#[derive(Clone, Copy, Debug)]
pub struct HapticInput<'a> {
    /// The bone in its latest state.
    pub scene: ContactScene<'a>,
    /// How the bone gives way about that state; none: it stands still until the next one, as in the paper.
    pub compliance: Option<&'a BoneCompliance>,
    /// World from device, already in the bone's space.
    pub devices: [Pose; 2],
    /// Since the last step \[s\].
    pub dt: f64,
}

/// Why the output is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HapticFault {
    /// A device's pose was not finite.
    DevicePose {
        /// 0 or 1.
        hand: usize,
    },
    /// The solve gave something that is not finite.
    Solve,
}

/// What a haptic step gives.
#[derive(Clone, Copy, Debug)]
pub struct HapticOutput {
    /// For each device, in its own units: scaled, clamped, limited in rate; zero from a fault on.
    pub device: [Wrench; 2],
    /// What pulls at each hand in bone units, unlimited.
    pub bone: [Wrench; 2],
    /// World from tool.
    pub tools: ToolsState,
    /// Contacts and balance.
    pub result: ToolsResult,
    /// Latched until [`HapticState::reset`].
    pub fault: Option<HapticFault>,
}

/// What is computed from haptic step to haptic step.
#[derive(Clone, Debug)]
pub struct HapticState {
    tools: ToolsState,
    anchors: [Anchors; 2],
    scratch: ToolScratch,
    pull: [Pull; 2],
    last: [Wrench; 2],
    fault: Option<HapticFault>,
}

impl HapticState {
    /// At rest at `poses`, with room for point ids below `n_ids`: allow for the points that the crack will add.
    pub fn new(poses: [Pose; 2], n_ids: usize, limits: ScratchLimits) -> Self {
        Self {
            tools: ToolsState { poses },
            anchors: [Anchors::with_capacity(n_ids), Anchors::with_capacity(n_ids)],
            scratch: ToolScratch::new(limits),
            pull: [Pull::NONE; 2],
            last: [Wrench::ZERO; 2],
            fault: None,
        }
    }

    /// Clears a fault, lets go of all contacts and starts again from `poses` with no force.
    pub fn reset(&mut self, poses: [Pose; 2]) {
        self.tools = ToolsState { poses };
        self.anchors.iter_mut().for_each(Anchors::let_go);
        self.pull = [Pull::NONE; 2];
        self.last = [Wrench::ZERO; 2];
        self.fault = None;
    }

    /// Where the tools are.
    pub fn tools(&self) -> &ToolsState {
        &self.tools
    }

    /// Latched fault, if any.
    pub fn fault(&self) -> Option<HapticFault> {
        self.fault
    }
}

/// One step of the haptic loop: both tools to rest between hand and bone, and what their devices are told.
///
/// Real-time: allocates nothing, waits for nothing, cannot panic; bounded by `settings.max_iterations` contact queries.
/// A pose or a result that is not finite makes the output zero, for both hands and until reset.
pub fn haptic_step(
    model: &HapticModel,
    state: &mut HapticState,
    input: &HapticInput,
) -> HapticOutput {
    let bad_hand = input.devices.iter().position(|p| !is_finite(p));
    if let Some(hand) = bad_hand {
        state.fault.get_or_insert(HapticFault::DevicePose { hand });
    }
    if state.fault.is_some() {
        return stopped(state);
    }
    let before = state.tools;
    let result = solve_tools(
        &model.tools,
        &model.settings,
        &ToolInput {
            scene: input.scene,
            devices: &input.devices,
            anchors: &state.anchors,
            compliance: input.compliance.filter(|c| c.is_finite()),
        },
        &mut state.tools,
        &mut state.scratch,
    );
    if !result.coupling.iter().all(Wrench::is_finite) || !state.tools.poses.iter().all(is_finite) {
        state.tools = before;
        state.fault = Some(HapticFault::Solve);
        return stopped(state);
    }
    state.scratch.commit(&mut state.anchors);
    let bone = result.coupling.map(|w| -w);
    let told = state.last.iter_mut().zip(&model.limits);
    for ((pull, bone), (told, limits)) in state.pull.iter_mut().zip(&bone).zip(told) {
        *told = limits.output(&pull.led(bone, input.dt), told, input.dt);
    }
    HapticOutput {
        device: state.last,
        bone,
        tools: state.tools,
        result,
        fault: None,
    }
}

fn stopped(state: &mut HapticState) -> HapticOutput {
    state.last = [Wrench::ZERO; 2];
    HapticOutput {
        device: state.last,
        bone: [Wrench::ZERO; 2],
        tools: state.tools,
        result: ToolsResult::NONE,
        fault: state.fault,
    }
}

fn is_finite(pose: &Pose) -> bool {
    let numbers = pose.translation.vector.iter();
    numbers
        .chain(pose.rotation.coords.iter())
        .all(|c| c.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> DeviceLimits {
        DeviceLimits {
            force_scale: 0.01,
            torque_scale: 0.04,
            max_force: 3.3,
            max_torque: 188.0,
            max_force_rate: 500.0,
            max_torque_rate: 1e4,
        }
    }

    #[test]
    fn output_is_clamped_and_limited_in_rate() {
        let pull = Wrench {
            force: Vec3::new(0.0, -1000.0, 0.0),
            torque: Vec3::new(1e6, 0.0, 0.0),
        };
        let mut told = Wrench::ZERO;
        for step in 1..100 {
            let next = limits().output(&pull, &told, 1e-3);
            assert!((next.force - told.force).norm() <= 0.5 + 1e-12);
            assert!((next.torque - told.torque).norm() <= 10.0 + 1e-12);
            assert!(next.force.norm() <= 3.3 + 1e-12 && next.torque.norm() <= 188.0 + 1e-12);
            let expected = (0.5 * f64::from(step)).min(3.3);
            assert!((next.force.norm() - expected).abs() < 1e-9);
            told = next;
        }
        assert_eq!(limits().output(&pull, &told, f64::NAN), told);
    }

    #[test]
    fn bad_limits_are_named() {
        let mut bad = limits();
        bad.max_torque = -1.0;
        let text = bad.checked().unwrap_err().to_string();
        assert_eq!(
            text,
            "device limit max_torque is -1; it must be a number of at least 0"
        );
    }
}
