//! The hands that are replayed.
use crate::session::{HandSample, HapticSample, Recording, RecordingWriter};
use anyhow::{Context, Result};
use osteotome_devices::Wrench;
use osteotome_mechanics::geometry::Pose;
use std::path::Path;

/// A split by the built-in surgeon at the paper's size (`scenarios/bsso_right.toml` with 104,567 points): the hands alone. Made
/// by `osteotome bench --recording SESSION.mcap --trim FILE`.
const SHIPPED: &[u8] = include_bytes!("split.mcap");

/// The shipped split.
///
/// # Errors
/// A file that cannot be read: one that does not belong to this program.
pub fn shipped() -> Result<Recording> {
    Recording::parse("the shipped split", SHIPPED)
}

/// Writes scenario and devices' poses alone, the poses rounded to 1e-5 mm and 1e-9.
///
/// # Errors
/// Whatever the file system says.
pub fn trim(recording: &Recording, path: &Path) -> Result<()> {
    let partial = path.with_extension("partial");
    let work = || -> Result<()> {
        let mut writer = RecordingWriter::create(&partial, &recording.scenario)?;
        let dt = recording.scenario.scenario.loops.dt();
        for sample in recording.haptic(dt) {
            let hands = sample.hands.each_ref().map(alone);
            writer.haptic(&HapticSample { hands, ..sample })?;
        }
        writer.finish()?;
        std::fs::rename(&partial, path)?;
        Ok(())
    };
    let result = work().with_context(|| path.display().to_string());
    if result.is_err() {
        // The name says what it is if even this fails.
        let _ = std::fs::remove_file(&partial);
    }
    result
}

/// Where the device was, and nothing of what came of it.
fn alone(hand: &HandSample) -> HandSample {
    let round = |v: f64, digits: f64| (v * digits).round() / digits;
    let mut pose = hand.device_pose;
    pose.translation.vector.apply(|v| *v = round(*v, 1e5));
    let turned = pose.rotation.coords.map(|v| round(v, 1e9));
    // Off the unit length by 1e-9 at most: not worth digits.
    let rotation = nalgebra::UnitQuaternion::new_unchecked(turned.into());
    HandSample {
        device_pose: Pose::from_parts(pose.translation, rotation),
        device_buttons: hand.device_buttons,
        tool_pose: Pose::identity(),
        wrench: Wrench::default(),
        saturated: false,
        contacts: 0,
    }
}
