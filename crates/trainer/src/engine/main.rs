use super::HandsView;
use super::haptic::BoneView;
use super::propagation::Loaded;
use crate::loops::{MainPart, Published, Subscribed};
use crate::session::MainSample;
use osteotome_mechanics::step::main::{MainInput, MainSettings, MainState, main_step};
use osteotome_mechanics::step::{Bone, BoneState};
use osteotome_mechanics::tool::{ScratchLimits, ToolModel};
use std::sync::Arc;

/// The main loop's ends of the exchange.
pub struct Ends {
    pub(super) hands: Subscribed<HandsView>,
    pub(super) grown: Subscribed<Arc<Bone>>,
    pub(super) to_haptic: Published<BoneView>,
    pub(super) to_propagation: Published<Loaded>,
}

/// The main loop's part.
pub struct Main {
    tools: ToolModel,
    settings: MainSettings,
    bone: Arc<Bone>,
    state: MainState,
    ends: Ends,
    serial: u64,
}

impl Main {
    pub(super) fn new(tools: ToolModel, bone: Arc<Bone>, n_ids: usize, ends: Ends) -> Self {
        Self {
            state: MainState::new(&bone, n_ids, ScratchLimits::default()),
            settings: MainSettings::default(),
            tools,
            bone,
            ends,
            serial: 0,
        }
    }

    /// The newest bone.
    pub fn bone(&self) -> &Bone {
        &self.bone
    }

    /// Its newest state.
    pub fn state(&self) -> &BoneState {
        &self.state.bone
    }

    /// Takes over the bone that the propagation loop has grown, if there is a new one.
    fn adopt(&mut self) {
        let grown = self.ends.grown.read();
        if grown.generation != self.bone.generation {
            self.state.adopt(&self.bone, grown);
            self.bone = Arc::clone(grown);
        }
    }

    /// Hands the new state to the other loops.
    fn publish(&mut self) {
        let view = self.ends.to_haptic.input_buffer_mut();
        view.update(&self.bone, &self.state.bone, &self.state.volumes);
        self.ends.to_haptic.publish();
        self.serial += 1;
        let loaded = self.ends.to_propagation.input_buffer_mut();
        loaded.serial = self.serial;
        loaded.state.clone_from(&self.state.bone);
        self.ends.to_propagation.publish();
    }
}

impl MainPart for Main {
    fn step(&mut self) -> MainSample {
        self.adopt();
        let hands = *self.ends.hands.read();
        let input = MainInput {
            devices: hands.devices,
            tools: hands.tools,
        };
        let report = main_step(
            &self.bone,
            &self.tools,
            &self.settings,
            &mut self.state,
            &input,
        );
        self.publish();
        MainSample {
            time: 0.0,
            iterations: report.iterations as u32,
            residual: report.residual,
            converged: report.converged,
            contacts: report.n_contacts as u32,
            max_displacement: report.max_displacement,
            strain_energy: report.strain_energy,
        }
    }
}
