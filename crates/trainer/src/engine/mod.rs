//! A scenario made into the three parts that the loops drive, around the steps of `osteotome_mechanics`.
mod bone_file;
mod fineness;
mod haptic;
mod held;
mod main;
mod prepare;
mod propagation;
mod rebase;
mod surroundings;

pub use bone_file::final_bone;
pub use haptic::haptic_model;
pub(crate) use held::Held;
pub use prepare::{Prepared, material_spec, prepare};
pub use propagation::cut_since;
pub use surroundings::Surrounding;

use crate::loops::{Parts, Underway, latest};
use crate::scenario::{Scenario, Tool};
use anyhow::{Context, Result};
use haptic::BoneView;
use osteotome_mechanics::contact::ContactLaw;
use osteotome_mechanics::geometry::Pose;
use osteotome_mechanics::step::Bone;
use osteotome_mechanics::tool::{self, Chisel, ChiselParameters, Coupling, ToolModel, ToolsState};
use std::sync::Arc;

/// The parts of a session.
pub type Engine = Parts<haptic::Haptic, main::Main, propagation::Propagation>;

/// Likewise between two steps.
pub(crate) type EngineUnderway = Underway<haptic::Haptic, main::Main, propagation::Propagation>;
pub(crate) use main::Main as MainOfEngine;
pub(crate) use propagation::Propagation as PropagationOfEngine;

/// What the haptic loop tells the main loop.
#[derive(Clone, Copy, Debug)]
struct HandsView {
    /// Haptic steps made.
    steps: u64,
    devices: [Pose; 2],
    tools: ToolsState,
}

/// Connects the three parts. `start`: where the hands are at the beginning.
///
/// # Errors
/// A number of the scenario that the mechanics refuses.
pub fn connect(prepared: &Prepared, scenario: &Scenario, start: [Pose; 2]) -> Result<Engine> {
    let tools = tools_among(prepared, scenario)?;
    let bone = &prepared.bone;
    let state = bone.at_rest();
    let (bone_view_tx, bone_view_rx) = latest(&BoneView::new(bone, &state));
    let at_start = HandsView {
        steps: 0,
        devices: start,
        tools: ToolsState { poses: start },
    };
    let (hands_tx, hands_rx) = latest(&at_start);
    let (state_tx, state_rx) = latest(&propagation::Loaded { serial: 0, state });
    let (bone_tx, bone_rx) = latest(&Arc::clone(bone));
    let n_ids = n_ids(bone);
    let ends = main::Ends {
        hands: hands_rx,
        grown: bone_rx,
        to_haptic: bone_view_tx,
        to_propagation: state_tx,
    };
    Ok(Parts {
        haptic: haptic::Haptic::new(
            scenario,
            tools.clone(),
            n_ids,
            start,
            bone_view_rx,
            hands_tx,
        )?,
        main: main::Main::new(tools, bone.clone(), n_ids, &prepared.line, ends),
        propagation: propagation::Propagation::new(bone.clone(), state_rx, bone_tx),
    })
}

/// Room for point ids on a bone and on the crack that will grow in it.
pub fn n_ids(bone: &Bone) -> usize {
    bone.points.len() + (2.0 * CRACK_ROOM * bone.body.wall_density) as usize
}

/// Room for points on both faces of the crack that will grow \[mm2 of crack\].
const CRACK_ROOM: f64 = 6000.0;

/// The tools with what stands still around the bone.
///
/// # Errors
/// A number of the scenario that the mechanics refuses.
pub fn tools_among(prepared: &Prepared, scenario: &Scenario) -> Result<ToolModel> {
    let mut tools = tool_model(scenario)?;
    let fields = prepared.surroundings.iter().filter_map(|s| s.field.clone());
    tools.surroundings = fields.collect();
    Ok(tools)
}

/// The chisels with their couplings, and the contact law.
///
/// # Errors
/// A number of the scenario that the mechanics refuses.
pub fn tool_model(scenario: &Scenario) -> Result<ToolModel> {
    let tool = |i: usize| one_tool(&scenario.tool[i]).with_context(|| format!("tool.{i}"));
    let mut tools = [tool(0)?, tool(1)?];
    if scenario.tool[0].chisel == scenario.tool[1].chisel {
        // One distance field in the cache instead of two.
        tools[1].shape = tools[0].shape.clone();
    }
    Ok(ToolModel {
        tools,
        law: ContactLaw::new(scenario.contact.stiffness, scenario.contact.friction)?,
        surroundings: Vec::new(),
    })
}

/// A tool's blade.
///
/// # Errors
/// A size that the mechanics refuses.
pub fn chisel(t: &Tool) -> Result<Chisel> {
    Ok(Chisel::new(ChiselParameters {
        width: t.chisel.width,
        thickness: t.chisel.thickness,
        bevel_deg: t.chisel.bevel_deg,
        length: t.chisel.length,
    })?)
}

/// Coupling stiffnesses and limits are the device's; seen from the bone they are larger by the scales.
fn one_tool(t: &Tool) -> Result<tool::Tool> {
    let chisel = chisel(t)?;
    let coupling = Coupling::new(
        t.coupling.linear_stiffness / t.force_scale,
        t.coupling.angular_stiffness / t.torque_scale,
        t.limits.force / t.force_scale,
        t.limits.torque / t.torque_scale,
    )?;
    Ok(tool::Tool {
        shape: chisel.shape(),
        coupling,
    })
}
