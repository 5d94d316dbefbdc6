//! What a session leaves behind: samples, the recording, the figures, the folder.
mod files;
mod folder;
mod mcap_file;
mod metrics;
mod recorder;
mod sample;

pub use files::{CrackMesh, FinalBone, VtuWriter, write_crack, write_final_bone};
pub use folder::{Mark, SESSION, SessionFolder};
pub use mcap_file::{Origin, Recording, RecordingWriter, ScenarioMessage};
pub use metrics::{LoopFigures, Metrics, MetricsDocument, Outcome, Pace};
pub use recorder::Recorder;
pub use sample::{
    BoneSample, Digest, Exchange, FrontPoint, GrowthSample, HandSample, HapticSample, Loop,
    MainSample, Seen, StepTime, Wire, on_grid,
};

#[cfg(test)]
pub(crate) use sample::tests;
