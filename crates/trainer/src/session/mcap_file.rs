//! `session.mcap`: JSON channels with schemas, chunked, zstd.
use super::sample::{
    BoneSample, Digest, DigestForm, Exchange, GrowthSample, HandSample, HapticSample, MainSample,
    PoseForm, StepTime, Wire,
};
use anyhow::{Context, Result, bail};
use mcap::records::MessageHeader;
use osteotome_mechanics::geometry::Pose;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Channel, schema name, JSON schema's properties.
const CHANNELS: [(&str, &str, &str); 10] = [
    ("/haptic/left", "osteotome.hand/1", HAND),
    ("/haptic/right", "osteotome.hand/1", HAND),
    (
        "/main",
        "osteotome.main/1",
        include_str!("schemas/main.json"),
    ),
    (
        "/crack",
        "osteotome.crack/1",
        include_str!("schemas/crack.json"),
    ),
    (
        "/timing",
        "osteotome.timing/1",
        include_str!("schemas/timing.json"),
    ),
    (
        "/event",
        "osteotome.event/1",
        include_str!("schemas/event.json"),
    ),
    (
        "/scenario",
        "osteotome.scenario/1",
        include_str!("schemas/scenario.json"),
    ),
    (
        "/bone",
        "osteotome.bone/1",
        include_str!("schemas/bone.json"),
    ),
    (
        "/exchange",
        "osteotome.exchange/1",
        include_str!("schemas/exchange.json"),
    ),
    (
        "/digest",
        "osteotome.digest/1",
        include_str!("schemas/digest.json"),
    ),
];

const HAND: &str = include_str!("schemas/hand.json");

/// What `/scenario` holds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ScenarioMessage {
    /// The whole scenario, overrides applied, paths absolute.
    pub scenario: crate::scenario::Scenario,
    /// Digest of the bone built from it.
    pub patient_digest: String,
    /// `realtime` or `lockstep`.
    pub mode: String,
    /// Where the devices were before the first step; absent in older recordings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<[PoseForm; 2]>,
    /// Which recording this session goes on from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retried: Option<Origin>,
}

/// The recording that a session goes on from; up to the moment it is recomputed, from then on live.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// SHA-256 of its `session.mcap`.
    pub session_sha256: String,
    /// The moment \[s\].
    pub at_s: f64,
    /// Haptic steps recomputed.
    pub steps: u64,
}

#[derive(Serialize, Deserialize)]
struct Event {
    event: String,
}

/// Writes the recording; one message a call.
pub struct RecordingWriter {
    writer: mcap::Writer<BufWriter<File>>,
    channels: [u16; CHANNELS.len()],
    sequence: [u32; CHANNELS.len()],
    json: Vec<u8>,
    digest: Digest,
    /// Time of the last haptic step \[s\].
    written: f64,
    /// Time of the last flush \[s\].
    flushed: f64,
}

/// What a killed program loses at most \[s of the session\].
const FLUSH_EVERY: f64 = 0.5;
/// Of zstd. A sixth smaller than by default, for 2 % of a core on the recording thread; above it hardly anything is gained.
const COMPRESSION: u32 = 8;

impl RecordingWriter {
    /// Starts a file with the scenario as its first message.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn create(path: &Path, first: &ScenarioMessage) -> Result<Self> {
        let file = File::create(path).with_context(|| path.display().to_string())?;
        let mut writer = mcap::WriteOptions::new()
            .compression(Some(mcap::Compression::Zstd))
            .compression_level(COMPRESSION)
            .compression_threads(0)
            .library(concat!("osteotome ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(file))?;
        let mut channels = [0; CHANNELS.len()];
        for (id, (topic, name, schema)) in channels.iter_mut().zip(CHANNELS) {
            let schema = writer.add_schema(name, "jsonschema", schema.as_bytes())?;
            *id = writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
        }
        let mut this = Self {
            writer,
            channels,
            sequence: [0; CHANNELS.len()],
            json: Vec::new(),
            digest: Digest::default(),
            written: 0.0,
            flushed: 0.0,
        };
        this.put(6, 0.0, first)?;
        this.writer.flush()?;
        Ok(this)
    }

    fn put(&mut self, channel: usize, time: f64, message: &impl Serialize) -> Result<()> {
        self.json.clear();
        serde_json::to_writer(&mut self.json, message)?;
        let log_time = (time * 1e9).round() as u64;
        let header = MessageHeader {
            channel_id: self.channels[channel],
            sequence: self.sequence[channel],
            log_time,
            publish_time: log_time,
        };
        self.sequence[channel] += 1;
        self.writer.write_to_known_channel(&header, &self.json)?;
        Ok(())
    }

    /// Both hands, [rounded](HandSample::rounded); before each flush the digest of what they were.
    ///
    /// # Errors
    /// Whatever the file system says; likewise below.
    pub fn haptic(&mut self, sample: &HapticSample) -> Result<()> {
        self.digest.take(sample);
        for (i, hand) in sample.hands.iter().enumerate() {
            self.put(i, sample.time, &hand.rounded().to_wire())?;
        }
        self.written = sample.time;
        if sample.time - self.flushed >= FLUSH_EVERY {
            self.flushed = sample.time;
            self.put_digest()?;
            self.writer.flush()?;
        }
        Ok(())
    }

    fn put_digest(&mut self) -> Result<()> {
        self.put(9, self.written, &self.digest.to_wire())
    }

    /// A main step.
    pub fn main(&mut self, sample: &MainSample) -> Result<()> {
        self.put(2, sample.time, sample)
    }

    /// A growth step.
    pub fn growth(&mut self, sample: &GrowthSample) -> Result<()> {
        self.put(3, sample.time, sample)
    }

    /// How the bone is deformed.
    pub fn bone(&mut self, sample: &BoneSample) -> Result<()> {
        self.put(7, sample.time, sample)
    }

    /// How long a step took.
    pub fn timing(&mut self, sample: &StepTime) -> Result<()> {
        self.put(4, sample.time, sample)
    }

    /// What a step read of the other loops.
    pub fn exchange(&mut self, time: f64, sample: &Exchange) -> Result<()> {
        self.put(8, time, sample)
    }

    /// Something worth knowing.
    pub fn event(&mut self, time: f64, event: &str) -> Result<()> {
        let event = event.to_owned();
        self.put(5, time, &Event { event })
    }

    /// Writes the summary section and closes the file.
    pub fn finish(mut self) -> Result<()> {
        self.put_digest()?;
        self.writer.finish()?;
        Ok(())
    }
}

/// A recording read back.
pub struct Recording {
    /// Its first message.
    pub scenario: ScenarioMessage,
    /// Left and right hand, step by step.
    pub hands: [Vec<HandSample>; 2],
    /// Main steps.
    pub main: Vec<MainSample>,
    /// Growth steps.
    pub growth: Vec<GrowthSample>,
    /// The deformed bone, in the order of time; none in recordings made before there was such a channel.
    pub bone: Vec<BoneSample>,
    /// How long steps took.
    pub timing: Vec<StepTime>,
    /// What steps read of the other loops; none in older recordings.
    pub exchange: Vec<Exchange>,
    /// Digests of tools and wrenches at some steps, in their order; none in older recordings, which have those to the last bit.
    pub digests: Vec<Digest>,
    /// What was worth knowing, and when \[s\].
    pub events: Vec<(f64, String)>,
    /// Whether the recording breaks off: the program was killed, or the disk was full.
    pub is_cut_short: bool,
}

impl Recording {
    /// Reads a whole file.
    ///
    /// # Errors
    /// One line: what is wrong with the file.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let bytes = std::fs::read(path)
            .map_err(|e| anyhow::anyhow!("{name}: {e}; give the path of a session.mcap"))?;
        Self::parse(&name.to_string(), &bytes)
    }

    /// Reads what a file called `name` holds.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(name: &str, bytes: &[u8]) -> Result<Self> {
        if !bytes.starts_with(mcap::MAGIC) {
            bail!("{name}: not an MCAP file; give the path of a session.mcap");
        }
        let damaged = || format!("{name}: the file is damaged; record the session again");
        let whole = bytes.len() > 2 * mcap::MAGIC.len() && bytes.ends_with(mcap::MAGIC);
        // Without its end a recording is read up to the last chunk that got to the disk.
        let options = if whole {
            Default::default()
        } else {
            mcap::read::Options::IgnoreEndMagic.into()
        };
        let stream = mcap::MessageStream::new_with_options(bytes, options).with_context(damaged)?;
        let mut scenario = None;
        let mut hands = [vec![], vec![]];
        let (mut main, mut growth, mut bone) = (vec![], vec![], vec![]);
        let (mut timing, mut events) = (vec![], vec![]);
        let (mut exchange, mut digests) = (vec![], vec![]);
        for message in stream {
            let message = match message {
                Ok(message) => message,
                Err(_) if !whole => break,
                Err(error) => return Err(error).with_context(damaged),
            };
            let topic = message.channel.topic.as_str();
            let bad =
                || format!("{name}: a message on {topic} is not as in an osteotome recording");
            let time = message.log_time as f64 * 1e-9;
            let data = &message.data;
            match topic {
                "/haptic/left" | "/haptic/right" => {
                    let form = serde_json::from_slice(data).with_context(bad)?;
                    hands[usize::from(topic == "/haptic/right")].push(HandSample::from_wire(&form));
                }
                "/main" => main.push(MainSample {
                    time,
                    ..serde_json::from_slice(data).with_context(bad)?
                }),
                "/crack" => growth.push(GrowthSample {
                    time,
                    ..serde_json::from_slice(data).with_context(bad)?
                }),
                "/bone" => bone.push(BoneSample {
                    time,
                    ..serde_json::from_slice(data).with_context(bad)?
                }),
                "/timing" => timing.push(StepTime {
                    time,
                    ..serde_json::from_slice(data).with_context(bad)?
                }),
                "/exchange" => exchange.push(serde_json::from_slice(data).with_context(bad)?),
                "/digest" => {
                    let form: DigestForm = serde_json::from_slice(data).with_context(bad)?;
                    digests.push(Digest::from_wire(&form));
                }
                "/event" => {
                    let event: Event = serde_json::from_slice(data).with_context(bad)?;
                    events.push((time, event.event));
                }
                "/scenario" => {
                    scenario = Some(serde_json::from_slice(data).with_context(bad)?);
                }
                _ => {}
            }
        }
        let Some(scenario) = scenario else {
            bail!("{name}: there is no /scenario message; give a recording made by osteotome");
        };
        let counts = hands.each_ref().map(Vec::len);
        if !whole {
            let both = counts[0].min(counts[1]);
            hands.iter_mut().for_each(|h| h.truncate(both));
        }
        if hands[0].is_empty() || hands[0].len() != hands[1].len() {
            bail!(
                "{name}: {} left and {} right hand samples; both hands must be recorded alike",
                counts[0],
                counts[1]
            );
        }
        Ok(Self {
            scenario,
            hands,
            main,
            growth,
            bone,
            timing,
            exchange,
            digests,
            events,
            is_cut_short: !whole,
        })
    }
}

impl Recording {
    /// Nothing recorded yet.
    #[cfg(test)]
    pub fn empty(scenario: ScenarioMessage) -> Self {
        Self {
            scenario,
            hands: [vec![], vec![]],
            main: vec![],
            growth: vec![],
            bone: vec![],
            timing: vec![],
            exchange: vec![],
            digests: vec![],
            events: vec![],
            is_cut_short: false,
        }
    }

    /// Both hands, step by step of `dt` \[s\].
    pub fn haptic(&self, dt: f64) -> impl Iterator<Item = HapticSample> {
        let [left, right] = &self.hands;
        left.iter()
            .zip(right)
            .zip(0u64..)
            .map(move |((l, r), step)| HapticSample {
                step,
                time: step as f64 * dt,
                hands: [*l, *r],
            })
    }

    /// Where the devices were at the beginning.
    pub fn start(&self) -> [Pose; 2] {
        let first = [0, 1].map(|i| self.hands[i][0].device_pose);
        let told = self.scenario.start.as_ref();
        told.map_or(first, |s| s.each_ref().map(Pose::from_wire))
    }

    /// How long it lasts \[s\].
    pub fn seconds(&self, scenario: &crate::scenario::Scenario) -> f64 {
        self.hands[0].len() as f64 * scenario.loops.dt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Loop, tests::hand};
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};

    fn first() -> ScenarioMessage {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        ScenarioMessage {
            scenario: load(&source, &[], Path::new("/")).unwrap(),
            patient_digest: "abc".into(),
            mode: "lockstep".into(),
            start: None,
            retried: None,
        }
    }

    #[test]
    fn a_recording_reads_back_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        let mut writer = RecordingWriter::create(&path, &first()).unwrap();
        for step in 0..100u32 {
            let time = f64::from(step) * 1e-3;
            let hands = [hand(f64::from(step) / 7.0), hand(-0.3)];
            writer
                .haptic(&HapticSample {
                    step: step.into(),
                    time,
                    hands,
                })
                .unwrap();
            writer
                .timing(&StepTime {
                    time,
                    of: Loop::Haptic,
                    step_us: 12.5,
                })
                .unwrap();
        }
        writer.event(0.1, "done").unwrap();
        writer.finish().unwrap();
        let back = Recording::read(&path).unwrap();
        assert_eq!(back.scenario.patient_digest, "abc");
        assert_eq!(back.hands[0].len(), 100);
        assert_eq!(
            format!("{:?}", back.hands[0][99]),
            format!("{:?}", hand(99.0 / 7.0).rounded())
        );
        assert_eq!(back.digests.len(), 1);
        assert_eq!(back.digests[0].steps, 100);
    }

    /// A copy of the file is what a kill at that moment leaves.
    #[test]
    fn a_killed_recording_lacks_less_than_a_second_and_no_byte_cut_makes_it_unreadable() {
        let folder = tempfile::tempdir().unwrap();
        let (path, copy) = (
            folder.path().join("session.mcap"),
            folder.path().join("copy.mcap"),
        );
        let mut writer = RecordingWriter::create(&path, &first()).unwrap();
        let n = 3777;
        for step in 0..n {
            let hands = [hand(step as f64 / 7.0), hand(-0.3)];
            let time = step as f64 * 1e-3;
            writer.haptic(&HapticSample { step, time, hands }).unwrap();
        }
        std::fs::copy(&path, &copy).unwrap();
        let back = Recording::read(&copy).unwrap();
        assert!(back.is_cut_short);
        assert!(
            back.hands[0].len() as u64 > n - 1000,
            "{}",
            back.hands[0].len()
        );
        let bytes = std::fs::read(&copy).unwrap();
        let mut before = 0;
        for share in [0.3, 0.5, 0.77, 0.999] {
            std::fs::write(&copy, &bytes[..(share * bytes.len() as f64) as usize]).unwrap();
            let there = Recording::read(&copy).unwrap().hands[0].len();
            assert!(there >= before && there > 0, "{share}: {there}");
            before = there;
        }
        writer.finish().unwrap();
        assert!(!Recording::read(&path).unwrap().is_cut_short);
    }

    #[test]
    fn what_is_no_recording_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mcap");
        let error = |path: &Path| format!("{:#}", Recording::read(path).err().unwrap());
        assert!(error(&path).contains("x.mcap: No such file"));
        std::fs::write(&path, "hello").unwrap();
        assert!(error(&path).contains("not an MCAP file"));
    }
}
