//! A bone under given forces instead of tools: for studies of the bone alone.
use super::bone::{Bone, BoneState};
use super::crack_faces::FaceContact;
use crate::bone::Swept;
use crate::crack::stress_intensity::CellForce;

/// Rounds in which faces that overlap are taken in, at most.
const MOST_ROUNDS: usize = 40;

impl Bone {
    /// The bone at rest under `loads`, its crack's faces kept apart. Soft tissue's drag takes part as a spring: leave it out of the
    /// supports where the final rest is asked for.
    pub fn under_loads(&self, loads: &[CellForce], faces: &mut FaceContact) -> BoneState {
        let (system, mesh) = (&self.system, &self.body.mesh);
        let mut scratch = system.scratch();
        let everywhere = system.region(mesh, self.topology.cells());
        let mut state = self.at_rest();
        let mut load = state.x.clone();
        self.add_loads(loads, &mut load);
        let (mut loaded, mut swept) = (Swept::default(), Swept::default());
        system.sweep_up(&load, &mut loaded, &mut scratch);
        faces.start(self, &state.x);
        state.loads = loads.to_vec();
        state.converged = false;
        for _ in 0..MOST_ROUNDS {
            swept.clone_from(&loaded);
            let (pressures, are_apart) =
                faces.press(self, &everywhere, &mut swept, &mut state.x, &mut scratch);
            state.loads.truncate(loads.len());
            state.loads.extend(pressures);
            if are_apart {
                state.converged = true;
                break;
            }
        }
        // Sweeps are in single precision; the forces that came of them are not approximate, so this solves for the displacements.
        state.x.fill(0.0);
        self.add_loads(&state.loads, &mut state.x);
        system.solve(&mut state.x, &mut scratch);
        state.strain_energy = 0.5 * self.work(&state.loads);
        self.deform(&mut state);
        state
    }
}
