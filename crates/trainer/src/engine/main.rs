use super::HandsView;
use super::haptic::BoneView;
use super::propagation::Loaded;
use crate::loops::{MainPart, Published, Subscribed};
use crate::session::MainSample;
use osteotome_mechanics::bone::SolveScratch;
use osteotome_mechanics::contact::Anchors;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::step::{Bone, BoneState, FaceContact};
use osteotome_mechanics::tool::{
    ScratchLimits, SolveSettings, ToolInput, ToolModel, ToolScratch, solve_tools,
};
use std::sync::Arc;

/// The main loop's ends of the exchange.
pub struct Ends {
    pub(super) hands: Subscribed<HandsView>,
    pub(super) grown: Subscribed<Arc<Bone>>,
    pub(super) to_haptic: Published<BoneView>,
    pub(super) to_propagation: Published<Loaded>,
}

/// The main loop's part. PROVISIONAL relaxation until `mechanics::step::main` lands.
pub struct Main {
    tools: ToolModel,
    bone: Arc<Bone>,
    state: BoneState,
    view: BoneView,
    ends: Ends,
    anchors: [Anchors; 2],
    scratch: ToolScratch,
    solve: SolveScratch,
    faces: FaceContact,
    serial: u64,
}

impl Main {
    pub(super) fn new(
        tools: ToolModel,
        bone: Arc<Bone>,
        state: BoneState,
        _start: HandsView,
        ends: Ends,
    ) -> Self {
        let n = bone.points.len() * 3;
        Self {
            view: BoneView::new(&bone, &state),
            solve: bone.system.scratch(1),
            tools,
            bone,
            state,
            ends,
            anchors: [Anchors::with_capacity(n), Anchors::with_capacity(n)],
            scratch: ToolScratch::new(ScratchLimits::default()),
            faces: FaceContact::default(),
            serial: 0,
        }
    }

    /// The newest bone.
    pub fn bone(&self) -> &Bone {
        &self.bone
    }

    /// Its newest state.
    pub fn state(&self) -> &BoneState {
        &self.state
    }
}

impl MainPart for Main {
    fn step(&mut self) -> MainSample {
        let grown = self.ends.grown.read();
        if grown.generation != self.bone.generation {
            let old = self.bone.clone();
            self.bone = grown.clone();
            let mut x = vec![0.0; self.bone.system.n()];
            for (load, _) in self.state.loads.iter().zip(0..) {
                let cell = &old.topology.cells()[load.cell as usize];
                let same =
                    self.bone.topology.cells_of(cell.tet).max_by_key(|&c| {
                        (self.bone.topology.cells()[c].mask & cell.mask).count_ones()
                    });
                let cell = &self.bone.topology.cells()[same.unwrap_or(0)];
                self.bone.system.add_force(
                    &self.bone.body.mesh,
                    cell,
                    &load.weights,
                    &load.force,
                    &mut x,
                );
            }
            self.solve = self.bone.system.scratch(1);
            self.bone.system.solve(&mut x, &mut self.solve);
            self.state.x = x;
            self.state.generation = self.bone.generation;
            let bone = self.bone.clone();
            bone.deform(&mut self.state);
            self.view.update(&bone, &self.state);
        }
        let hands = *self.ends.hands.read();
        let mut tools = hands.tools;
        let mesh = &self.bone.body.mesh;
        let (mut iterations, mut converged, mut residual) = (0, false, 0.0);
        let mut omega = 0.5;
        let mut last_r: Option<Vec<f64>> = None;
        let mut contacts = 0;
        while iterations < 20 && !converged {
            iterations += 1;
            let result = {
                let scene = self.view.scene();
                let input = ToolInput {
                    scene,
                    devices: &hands.devices,
                    anchors: &self.anchors,
                };
                solve_tools(
                    &self.tools,
                    &SolveSettings::MAIN,
                    &input,
                    &mut tools,
                    &mut self.scratch,
                )
            };
            contacts = result.n_contacts.iter().sum::<usize>();
            let mut x = vec![0.0; self.bone.system.n()];
            let mut loads = vec![];
            for f in self.scratch.point_forces(&self.tools, &self.view.scene()) {
                let weights = f.weights.map(f64::from);
                let cell = &self.bone.topology.cells()[f.cell as usize];
                self.bone
                    .system
                    .add_force(mesh, cell, &weights, &f.force, &mut x);
                loads.push(CellForce {
                    cell: f.cell,
                    weights,
                    force: f.force,
                });
            }
            self.bone.system.solve(&mut x, &mut self.solve);
            let b = &self.bone;
            loads.extend(self.faces.press(
                b.generation,
                &b.faces,
                mesh,
                &b.topology,
                &b.system,
                &mut self.solve,
                &mut x,
            ));
            let r: Vec<f64> = x.iter().zip(&self.state.x).map(|(a, b)| a - b).collect();
            residual = r.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            if let Some(last) = &last_r {
                let (mut num, mut den) = (0.0, 0.0);
                for (l, r) in last.iter().zip(&r) {
                    num += l * (r - l);
                    den += (r - l) * (r - l);
                }
                if den > 0.0 {
                    omega = (-omega * num / den).clamp(0.02, 1.0);
                }
            }
            self.state
                .x
                .iter_mut()
                .zip(&r)
                .for_each(|(x, r)| *x += omega * r);
            last_r = Some(r);
            self.state.loads = loads;
            let bone = self.bone.clone();
            bone.deform(&mut self.state);
            self.view.update(&bone, &self.state);
            converged = residual < 1e-3;
        }
        self.scratch.commit(&mut self.anchors);
        self.state.converged = converged;
        self.state.strain_energy = self.bone.system.energy(&self.state.x);
        self.ends
            .to_haptic
            .input_buffer_mut()
            .update(&self.bone, &self.state);
        self.ends.to_haptic.publish();
        self.serial += 1;
        self.ends.to_propagation.write(Loaded {
            serial: self.serial,
            bone: self.bone.clone(),
            state: self.state.clone(),
        });
        let max = (0..mesh.nodes().len())
            .map(|i| self.bone.system.displacement(i, &self.state.x).norm())
            .fold(0.0, f64::max);
        MainSample {
            time: 0.0,
            iterations,
            residual,
            converged,
            contacts: contacts as u32,
            max_displacement: max,
            strain_energy: self.state.strain_energy,
        }
    }
}
