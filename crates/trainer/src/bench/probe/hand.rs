//! The haptic step, against one for which the bone stands still between two states.
use super::in_ms;
use crate::bench::rows::{Part, Row};
use crate::bench::times::{Pairs, Times};
use crate::loops::HandOutput;
use anyhow::{Result, ensure};
use osteotome_mechanics::contact::ContactScene;
use osteotome_mechanics::geometry::Pose;
use osteotome_mechanics::step::haptic::{HapticInput, HapticModel, HapticState, haptic_step};
use osteotome_mechanics::tool::{BoneCompliance, ScratchLimits};

/// The program's haptic steps, and the paper's haptic loop on the same hands and bone.
pub struct Hands {
    model: HapticModel,
    still: HapticState,
    /// Whether a compliance has told the two apart.
    has_parted: bool,
    times: Times,
    pairs: Pairs,
}

impl Hands {
    /// At rest at `start`, with room for point ids below `n_ids`.
    pub fn new(model: HapticModel, start: [Pose; 2], n_ids: usize) -> Self {
        Self {
            model,
            still: HapticState::new(start, n_ids, ScratchLimits::default()),
            has_parted: false,
            times: Times::default(),
            pairs: Pairs::new("a bone that stands still between two main steps: 30 % too stiff"),
        }
    }

    /// The same step with a bone that stands still, where the program's took `ms` and gave `ours`.
    ///
    /// # Errors
    /// If they differ although the bone has not yielded yet.
    pub fn step(
        &mut self,
        (ours, ms): (&[HandOutput; 2], f64),
        scene: ContactScene,
        compliance: Option<&BoneCompliance>,
        devices: &[Pose; 2],
        dt: f64,
    ) -> Result<()> {
        let input = HapticInput {
            scene,
            compliance: None,
            devices: *devices,
            dt,
        };
        let (theirs, baseline) = in_ms(|| haptic_step(&self.model, &mut self.still, &input));
        self.times.push(ms);
        self.pairs.push(ms, baseline, 0.0);
        self.has_parted |= compliance.is_some();
        let poses = ours.each_ref().map(|o| o.tool_pose);
        ensure!(
            self.has_parted || poses == theirs.tools.poses,
            "both haptic loops must give the same as long as the bone does not yield"
        );
        Ok(())
    }

    /// The row.
    pub fn row(self) -> Row {
        Row::new(Part::HapticStep, self.times).against(self.pairs)
    }
}
