use super::HandsView;
use super::haptic::BoneView;
use super::propagation::Loaded;
use crate::loops::{MainPart, Published, Seen, Subscribed};
use crate::session::{BoneSample, MainSample};
use crate::surgeon::{Mark, SplitLine};
use osteotome_mechanics::geometry::Vec3;
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
    pub(super) ends: Ends,
    serial: u64,
    /// Haptic steps made when the hands were read last.
    hands_seen: u64,
    /// A tetrahedron at each mark of the osteotomy line.
    line: Vec<u32>,
}

impl Main {
    pub(super) fn new(
        tools: ToolModel,
        bone: Arc<Bone>,
        n_ids: usize,
        line: &SplitLine,
        ends: Ends,
    ) -> Self {
        Self {
            state: MainState::new(&bone, n_ids, ScratchLimits::default()),
            settings: MainSettings::default(),
            tools,
            line: tets_at(&bone, line),
            bone,
            ends,
            serial: 0,
            hands_seen: 0,
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

    /// All that the main loop keeps of the bone: what tools see of it, and how it gives way.
    pub fn whole_state(&self) -> &MainState {
        &self.state
    }

    /// Hands the new state to the other loops.
    fn publish(&mut self) {
        self.serial += 1;
        let view = self.ends.to_haptic.input_buffer_mut();
        // The view at rest that the haptic loop began with is number 1.
        view.update(&self.bone, &self.state, self.serial + 1);
        let moved = self
            .line
            .iter()
            .map(|t| moved(&self.bone, &self.state.bone, *t));
        view.line.clear();
        view.line.extend(moved);
        self.ends.to_haptic.publish();
        let loaded = self.ends.to_propagation.input_buffer_mut();
        loaded.serial = self.serial;
        loaded.state.clone_from(&self.state.bone);
        self.ends.to_propagation.publish();
    }
}

/// The tetrahedron at each mark, or the one nearest by.
fn tets_at(bone: &Bone, line: &SplitLine) -> Vec<u32> {
    let body = &bone.body;
    let reach = 2.0 * body.lengths.h;
    let at = |mark: &Mark| {
        let middle = mark.at + mark.toward * (0.5 * mark.depth);
        body.locator.find_near(&body.mesh, &middle, reach)
    };
    line.marks()
        .iter()
        .map(|m| at(m).map_or(0, |(tet, _)| tet))
        .collect()
}

/// Mean displacement of a tetrahedron's nodes: between the two walls of the slit \[mm\].
fn moved(bone: &Bone, state: &BoneState, tet: u32) -> Vec3 {
    let nodes = bone.body.mesh.tets()[tet as usize];
    let sum: Vec3 = nodes
        .iter()
        .map(|n| bone.system.displacement(*n as usize, &state.x))
        .sum();
    sum / 4.0
}

impl MainPart for Main {
    fn seen(&self) -> Seen {
        Seen {
            state: self.hands_seen,
            generation: Some(self.bone.generation.into()),
        }
    }

    fn generation(&self) -> u64 {
        self.state().generation.into()
    }

    fn bone(&self) -> Option<BoneSample> {
        let state = self.state();
        Some(BoneSample {
            time: 0.0,
            generation: state.generation.into(),
            x_um: state.x.iter().map(|v| (v * 1e3).round() as i32).collect(),
        })
    }

    fn step(&mut self) -> MainSample {
        self.adopt();
        let hands = *self.ends.hands.read();
        self.hands_seen = hands.steps;
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
