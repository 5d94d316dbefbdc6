use super::mcap_file::{RecordingWriter, ScenarioMessage};
use super::metrics::{Metrics, Pace};
use super::sample::{
    BoneSample, Exchange, GrowthSample, HandSample, HapticSample, Loop, MainSample, Seen, StepTime,
};
use anyhow::Result;
use std::path::Path;

/// Takes every sample into the recording and the figures. In lockstep it is called directly, in real time from its own
/// thread behind rings.
pub struct Recorder {
    writer: RecordingWriter,
    metrics: Metrics,
    last_growth: Option<GrowthSample>,
    /// Steps of which it is known what they read, by loop, and what the last haptic one did.
    n_seen: [u64; 3],
    seen: u64,
}

impl Recorder {
    /// Starts `session.mcap` in `folder`.
    ///
    /// # Errors
    /// Whatever the file system says; likewise below.
    pub fn create(folder: &Path, first: &ScenarioMessage) -> Result<Self> {
        Ok(Self {
            writer: RecordingWriter::create(&folder.join("session.mcap"), first)?,
            metrics: Metrics::new(&first.scenario),
            last_growth: None,
            n_seen: [0; 3],
            seen: 0,
        })
    }

    /// The crack after its last growth.
    pub fn last_growth(&self) -> Option<&GrowthSample> {
        self.last_growth.as_ref()
    }

    /// Closes the recording; the figures remain.
    pub fn finish(self) -> Result<Metrics> {
        self.writer.finish()?;
        Ok(self.metrics)
    }
}

impl crate::loops::Sink for Recorder {
    fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        // Figures are those of the recording.
        let hands = sample.hands.each_ref().map(HandSample::rounded);
        self.metrics.haptic(&HapticSample { hands, ..*sample });
        self.writer.haptic(sample)
    }

    fn main(&mut self, sample: &MainSample) -> Result<()> {
        self.metrics.main(sample);
        self.writer.main(sample)
    }

    fn bone(&mut self, sample: &BoneSample) -> Result<()> {
        self.writer.bone(sample)
    }

    fn growth(&mut self, sample: GrowthSample) -> Result<()> {
        let was_complete = self.metrics.is_complete();
        self.metrics.growth(&sample);
        self.writer.growth(&sample)?;
        if self.metrics.is_complete() && !was_complete {
            let event = format!("the bone is in {} pieces", sample.fragments);
            self.writer.event(sample.time, &event)?;
        }
        self.last_growth = Some(sample);
        Ok(())
    }

    fn timing(&mut self, sample: &StepTime, grew: bool) -> Result<()> {
        self.metrics.timing(sample, grew);
        self.writer.timing(sample)
    }

    fn seen(&mut self, time: f64, of: Loop, seen: Seen) -> Result<()> {
        let step = self.n_seen[of as usize];
        self.n_seen[of as usize] += 1;
        let is_news = of != Loop::Haptic || seen.state != self.seen;
        if of == Loop::Haptic {
            self.seen = seen.state;
        }
        if !is_news {
            return Ok(());
        }
        let Seen { state, generation } = seen;
        let exchange = Exchange {
            of,
            step,
            state,
            generation,
        };
        self.writer.exchange(time, &exchange)
    }

    fn event(&mut self, time: f64, event: &str) -> Result<()> {
        self.writer.event(time, event)
    }

    fn pace(&mut self, of: Loop, pace: Pace) {
        self.metrics.pace(of, pace);
    }
}
