//! Recordings computed anew: to be held against themselves, and to go on live from any of their moments.
//!
//! A recording says what each step had read of the other loops ([`Schedule`]); steps made one after another in that order give the
//! same states to the last bit, whichever threads had made them.
mod recompute;
mod schedule;
#[cfg(test)]
mod tests;

pub use recompute::{Recomputing, recompute};
pub use schedule::Schedule;

use crate::scenario::{Override, Scenario, Source, load};
use crate::session::{Origin, Recording};
use anyhow::{Context, Result, bail, ensure};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;

/// A moment of a recording from which a session goes on.
#[derive(Clone)]
pub struct Moment {
    /// The recording.
    pub recording: Arc<Recording>,
    /// Haptic steps up to the moment.
    pub steps: u64,
    /// SHA-256 of its file.
    sha256: String,
}

impl Moment {
    /// The end of a recording.
    ///
    /// # Errors
    /// A file that is no recording.
    pub fn end(path: &Path) -> Result<Self> {
        let name = path.display();
        let bytes = std::fs::read(path)
            .with_context(|| format!("{name}: give the path of a session.mcap"))?;
        let recording = Recording::parse(&name.to_string(), &bytes)?;
        let hash = Sha256::digest(&bytes);
        Ok(Self {
            steps: recording.hands[0].len() as u64,
            sha256: hash.iter().map(|b| format!("{b:02x}")).collect(),
            recording: Arc::new(recording),
        })
    }

    /// `at` \[s\] from the beginning, to the nearest haptic step.
    ///
    /// # Errors
    /// As [`end`](Self::end) and [`at`](Self::at).
    pub fn read(path: &Path, at: f64) -> Result<Self> {
        let moment = Self::end(path)?.at(at);
        moment.with_context(|| path.display().to_string())
    }

    /// Another moment of the same recording, `at` \[s\] from its beginning.
    ///
    /// # Errors
    /// A moment that the recording does not have, or from which it cannot be computed anew.
    pub fn at(&self, at: f64) -> Result<Self> {
        let steps = (at * self.scenario().loops.haptic_hz).round();
        let n = self.recording.hands[0].len();
        if !(steps >= 1.0 && steps <= n as f64) {
            let lasts = n as f64 * self.scenario().loops.dt();
            bail!(
                "there is no moment at {at} s; the recording lasts {lasts:.3} s, give a time above 0 and up to that"
            );
        }
        if let Some(why) = Schedule::of(&self.recording).why_unknown() {
            bail!("the recording cannot be gone on from: {why}; record a session anew");
        }
        Ok(Self {
            steps: steps as u64,
            ..self.clone()
        })
    }

    /// When it is \[s\].
    pub fn time(&self) -> f64 {
        self.steps as f64 * self.scenario().loops.dt()
    }

    /// The recording's scenario.
    pub fn scenario(&self) -> &Scenario {
        &self.recording.scenario.scenario
    }

    /// Where both devices are then.
    pub fn devices(&self) -> [osteotome_mechanics::geometry::Pose; 2] {
        let last = self.steps as usize - 1;
        [0, 1].map(|i| self.recording.hands[i][last].device_pose)
    }

    /// The scenario to go on in: the recorded one, each hand on the device that `overrides` name, if they do.
    ///
    /// # Errors
    /// An override of anything else, which would have to hold from the beginning on; or one that is wrong in itself.
    pub fn scenario_with(&self, overrides: &[Override]) -> Result<Scenario> {
        const OF_HANDS: [&str; 3] = ["device", "workspace", "allow_network"];
        for o in overrides {
            let of_hands = match o.path.as_slice() {
                [section, _, key, ..] => section == "tool" && OF_HANDS.contains(&key.as_str()),
                _ => false,
            };
            ensure!(
                of_hands,
                "--set {}: the recorded scenario holds; only device, workspace and allow_network of a tool can be set, e.g. --set tool.0.device='\"haply\"'",
                o.key()
            );
        }
        let mut scenario = self.scenario().clone();
        let source = Source::Text {
            name: "the recorded scenario".to_owned(),
            text: toml::to_string(&scenario)?,
        };
        let wanted = load(&source, overrides, Path::new("/"))?;
        for (tool, wanted) in scenario.tool.iter_mut().zip(wanted.tool) {
            tool.device = wanted.device;
            tool.workspace = wanted.workspace;
            tool.allow_network = wanted.allow_network;
        }
        Ok(scenario)
    }

    /// As the new recording names it.
    pub fn origin(&self) -> Origin {
        Origin {
            session_sha256: self.sha256.clone(),
            at_s: self.time(),
            steps: self.steps,
        }
    }
}
