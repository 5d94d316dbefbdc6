//! Where a sweep of the relaxation looks at the bone.
use super::bone::{Bone, BoneState};
use crate::bone::Region;
use crate::contact::{BoundingVolumes, cells_about};
use crate::tool::{ToolModel, ToolsState};

/// The cells that the tools may touch and those on both faces of the crack: only there does one sweep depend on the last one. A solve
/// that is held to them passes through a part of the factor only; the rest of the bone follows when the sweeps are over.
#[derive(Debug, Default)]
pub struct SweepRegion {
    generation: Option<u32>,
    /// Ascending.
    cells: Vec<u32>,
    /// Their unknowns.
    pub region: Region,
}

/// Cells are taken in that a tool may touch once it has moved so far \[mm\] ...
const TAKEN: f32 = 1.0;
/// ... as soon as one is missing that it may touch on this way; in a step tools and bone move less but when a piece breaks off.
const MISSED: f32 = 0.5;

impl SweepRegion {
    /// Makes sure that the region belongs to this bone and has all that its tools may touch.
    pub fn follow(
        &mut self,
        bone: &Bone,
        volumes: &BoundingVolumes,
        model: &ToolModel,
        tools: &ToolsState,
    ) {
        let cells = bone.shell.occupied();
        let near = |way: f32, visit: &mut dyn FnMut(u32)| {
            for (tool, pose) in model.tools.iter().zip(&tools.poses) {
                cells_about(&tool.shape, pose, volumes, cells, way, &mut *visit);
            }
        };
        let mut has_all = self.generation == Some(bone.generation);
        near(MISSED, &mut |c| {
            has_all = has_all && self.cells.binary_search(&c).is_ok();
        });
        if has_all {
            return;
        }
        self.generation = Some(bone.generation);
        self.cells.clear();
        self.cells.extend(bone.faces.cells());
        near(TAKEN, &mut |c| self.cells.push(c));
        self.cells.sort_unstable();
        self.cells.dedup();
        let cells = self.cells.iter();
        let cells = cells.map(|c| &bone.topology.cells()[*c as usize]);
        self.region = bone.system.region(&bone.body.mesh, cells);
    }

    /// Moves the region's unknowns to `values`, its cells and their volumes with them.
    pub fn deform(
        &self,
        bone: &Bone,
        values: &[f64],
        state: &mut BoneState,
        volumes: &mut BoundingVolumes,
    ) {
        let unknowns = self.region.unknowns().iter();
        (unknowns.zip(values)).for_each(|(i, v)| state.x[*i as usize] = *v);
        bone.deform_cells(state, &self.cells);
        volumes.update_cells(&bone.shell, &state.deformation, &self.cells);
    }
}
