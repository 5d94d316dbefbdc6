use super::HandsView;
use crate::loops::{HandOutput, HapticPart, Published, Seen, Subscribed};
use crate::scenario::Scenario;
use anyhow::{Context, Result};
use nalgebra::Matrix3x4;
use osteotome_devices::Wrench;
use osteotome_mechanics::contact::{BoundingVolumes, ContactScene, NearPoints, PointShell};
use osteotome_mechanics::geometry::{Pose, Vec3};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticInput, HapticModel, HapticState, haptic_step,
};
use osteotome_mechanics::step::main::MainState;
use osteotome_mechanics::step::{Bone, BoneState};
use osteotome_mechanics::tool::{BoneCompliance, ScratchLimits, SolveSettings, ToolModel};
use std::sync::Arc;

/// What the haptic loop sees of the bone: one state, complete in itself.
#[derive(Clone)]
pub struct BoneView {
    /// Points by cell; the same for all states of a generation.
    pub shell: Arc<PointShell>,
    /// Of this state.
    pub volumes: BoundingVolumes,
    /// Of this state.
    pub deformation: Vec<Matrix3x4<f32>>,
    /// Number of this state, from 1.
    pub number: u64,
    /// Of this state.
    pub compliance: Option<BoneCompliance>,
    /// Points near the tools as the main loop left them, so that the haptic loop need not look for them.
    pub near: [NearPoints; 2],
    /// How far the bone has moved at each mark of the line \[mm\].
    pub line: Vec<Vec3>,
}

impl BoneView {
    /// A view of a state.
    pub fn new(bone: &Bone, state: &BoneState) -> Self {
        Self {
            shell: bone.shell.clone(),
            volumes: BoundingVolumes::new(&bone.shell, &state.deformation),
            deformation: state.deformation.clone(),
            number: 1,
            compliance: None,
            near: std::array::from_fn(|_| NearPoints::with_capacity(0)),
            line: Vec::new(),
        }
    }

    /// Follows to another state, reusing the memory.
    pub fn update(&mut self, bone: &Bone, state: &MainState, number: u64) {
        self.number = number;
        self.shell.clone_from(&bone.shell);
        self.deformation.clone_from(&state.bone.deformation);
        self.volumes.clone_from(&state.volumes);
        self.compliance = state.compliance;
        for (own, near) in self.near.iter_mut().zip(state.near()) {
            own.clone_from(near);
        }
    }

    /// As contact wants it.
    pub fn scene(&self) -> ContactScene<'_> {
        ContactScene {
            shell: &self.shell,
            volumes: &self.volumes,
            deformation: &self.deformation,
            state: self.number,
            near: Some(&self.near),
        }
    }
}

/// The haptic loop's part.
pub struct Haptic {
    model: HapticModel,
    state: HapticState,
    pub(super) bone: Subscribed<BoneView>,
    hands: Published<HandsView>,
    steps: u64,
    seen: u64,
}

impl Haptic {
    pub(super) fn new(
        scenario: &Scenario,
        tools: ToolModel,
        n_ids: usize,
        start: [Pose; 2],
        view: Subscribed<BoneView>,
        hands: Published<HandsView>,
    ) -> Result<Self> {
        Ok(Self {
            model: haptic_model(scenario, tools)?,
            state: HapticState::new(start, n_ids, ScratchLimits::default()),
            bone: view,
            hands,
            steps: 0,
            seen: 0,
        })
    }

    fn is_saturated(&self, hand: usize, wrench: &Wrench) -> bool {
        const FULL: f64 = 0.999;
        let limits = &self.model.limits[hand];
        wrench.force.norm() >= FULL * limits.max_force
            || wrench.torque.norm() >= FULL * limits.max_torque
    }
}

/// What is constant over all haptic steps of a scenario.
///
/// # Errors
/// A limit of a device that the mechanics refuses.
pub fn haptic_model(scenario: &Scenario, tools: ToolModel) -> Result<HapticModel> {
    let limits = |i: usize| {
        let t = &scenario.tool[i];
        let limits = DeviceLimits {
            force_scale: t.force_scale,
            torque_scale: t.torque_scale,
            max_force: t.limits.force,
            max_torque: t.limits.torque,
            max_force_rate: t.limits.force_rate,
            max_torque_rate: t.limits.torque_rate,
        };
        limits.checked().with_context(|| format!("tool.{i}.limits"))
    };
    Ok(HapticModel {
        tools,
        settings: SolveSettings::HAPTIC,
        limits: [limits(0)?, limits(1)?],
    })
}

impl HapticPart for Haptic {
    fn step(&mut self, devices: &[Pose; 2], dt: f64) -> [HandOutput; 2] {
        let bone = self.bone.read();
        self.seen = bone.number;
        self.steps += 1;
        let input = HapticInput {
            scene: bone.scene(),
            compliance: bone.compliance.as_ref(),
            devices: *devices,
            dt,
        };
        let output = haptic_step(&self.model, &mut self.state, &input);
        self.hands.write(HandsView {
            steps: self.steps,
            devices: *devices,
            tools: output.tools,
        });
        [0, 1].map(|i| {
            let wrench = Wrench {
                force: output.device[i].force,
                torque: output.device[i].torque,
            };
            HandOutput {
                tool_pose: output.tools.poses[i],
                saturated: self.is_saturated(i, &wrench),
                wrench,
                contacts: output.result.n_contacts[i] as u32,
            }
        })
    }

    fn seen(&self) -> Seen {
        Seen {
            state: self.seen,
            generation: None,
        }
    }

    fn line(&mut self) -> &[Vec3] {
        &self.bone.read().line
    }

    fn fault(&self) -> Option<String> {
        let fault = self.state.fault()?;
        Some(format!("the haptic loop stopped its output: {fault:?}"))
    }
}
