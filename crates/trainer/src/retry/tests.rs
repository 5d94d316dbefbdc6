//! Invariant: whatever threads made a session, its recording repeats to the last bit; and a session gone on from a moment with the hands
//! that it had is the session that it was.
use super::*;
use crate::cli::{Failure, Mode};
use crate::commands::{Plan, Unseen, Watch, keep_session, verified};
use crate::engine::{Prepared, prepare};
use crate::input::{Input, Leader};
use crate::loops::Control;
use crate::scenario::{BSSO_RIGHT, Source, load};

struct Stage {
    folder: tempfile::TempDir,
    scenario: Scenario,
    prepared: Prepared,
}

impl Stage {
    fn new(max_time: &str) -> Self {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let time = format!("max_time={max_time}");
        // Brittle bone and a quick surgeon: apart after 1.4 s.
        let sets = [
            "mesh.shell_points=6000",
            "material.cortical={young_modulus=15000,poisson_ratio=0.3,toughness=[0.1,0.4]}",
            "surgeon.approach_speed=80",
            "surgeon.approach_distance=3",
            "surgeon.twist_rate_deg=60",
            &time,
        ];
        let sets = sets.map(|s| s.parse().unwrap());
        let scenario = load(&source, &sets, Path::new("/")).unwrap();
        Self {
            folder: tempfile::tempdir().unwrap(),
            prepared: prepare(&scenario, &mut |_, _| {}).unwrap(),
            scenario,
        }
    }

    fn file(&self, out: &str) -> std::path::PathBuf {
        self.folder.path().join(out).join("session.mcap")
    }

    fn keep(&self, out: &str, mode: Mode, from: Option<&Moment>, input: Input) -> Recording {
        let plan = Plan {
            scenario: &self.scenario,
            prepared: &self.prepared,
            mode,
            out: &self.folder.path().join(out),
            from,
            earlier: &[],
        };
        let mut watch = Watch {
            control: Control::default(),
            sink: &mut Unseen,
            progress: &mut |_| {},
            draws: false,
        };
        keep_session(&plan, input, &mut watch).unwrap();
        Recording::read(&self.file(out)).unwrap()
    }

    fn original(&self, mode: Mode) -> Recording {
        let input = Input::built_in(&self.scenario, self.prepared.line.clone()).unwrap();
        self.keep("original", mode, None, input)
    }

    fn moment(&self, at: f64) -> Result<Moment> {
        Moment::read(&self.file("original"), at)
    }

    fn surgeon_from(&self, moment: &Moment) -> Input {
        let hands = &moment.recording.hands;
        let leaders = [Leader::Surgeon, Leader::Surgeon];
        let line = self.prepared.line.clone();
        Input::resumed(&self.scenario, line, leaders, hands, moment.steps).unwrap()
    }

    /// What `replay --verify` says.
    fn verify(&self, recording: &Recording) -> Result<String, Failure> {
        let input = Input::recorded(&self.scenario, &recording.hands).unwrap();
        verified(recording, &self.prepared, input, &mut |_, _| {})
    }
}

/// All but times of the clock, of the first so many haptic steps.
fn bits(recording: &Recording, steps: usize) -> String {
    let hands = recording.hands.each_ref().map(|h| &h[..steps]);
    let until = steps as f64 * 1e-3;
    let main = recording.main.iter().filter(|m| m.time < until);
    let growth = recording.growth.iter().filter(|g| g.time < until);
    format!(
        "{hands:?} {:?} {:?}",
        main.collect::<Vec<_>>(),
        growth.collect::<Vec<_>>()
    )
}

#[test]
fn a_session_gone_on_from_with_its_own_hands_is_the_session_that_it_was() {
    let stage = Stage::new("1.6");
    let original = stage.original(Mode::Lockstep);
    assert!(original.growth.len() > 2, "the crack grew");
    let grown = original.growth[2].time;
    let n = original.hands[0].len();
    for (out, at) in [("early", 0.507), ("late", grown)] {
        let moment = stage.moment(at).unwrap();
        let recorded = Input::recorded(&stage.scenario, &original.hands).unwrap();
        for input in [recorded, stage.surgeon_from(&moment)] {
            let again = stage.keep(out, Mode::Lockstep, Some(&moment), input);
            assert_eq!(again.hands[0].len(), n, "{out}");
            assert!(
                bits(&again, n) == bits(&original, n),
                "{out} is another session"
            );
            let origin = again.scenario.retried.unwrap();
            assert_eq!(
                (origin.at_s, origin.session_sha256.len()),
                (moment.time(), 64)
            );
            let told = &again.events[0].1;
            assert!(told.ends_with("recomputed to the last bit"), "{told}");
        }
    }
    let lasts = format!("lasts {:.3}", n as f64 * 1e-3);
    for (at, word) in [
        (0.0, "no moment at 0"),
        (9.5, lasts.as_str()),
        (f64::NAN, "no moment"),
    ] {
        let told = stage.moment(at).err().map(|e| format!("{e:#}")).unwrap();
        assert!(told.contains(word), "{told}");
    }
}

#[test]
fn a_session_on_three_threads_repeats_and_is_gone_on_from_to_the_last_bit() {
    let stage = Stage::new("1.6");
    let mut original = stage.original(Mode::Realtime);
    let told = stage.verify(&original).unwrap();
    assert!(told.contains("Identical to the last bit") && told.contains("Bound: 0"));
    let moment = stage.moment(1.25).unwrap();
    let input = stage.surgeon_from(&moment);
    let again = stage.keep("again", Mode::Realtime, Some(&moment), input);
    assert!(
        bits(&again, 1250) == bits(&original, 1250),
        "it begins otherwise"
    );
    // Both parts of it, recomputed and live, repeat.
    assert!(
        stage
            .verify(&again)
            .unwrap()
            .contains("Identical to the last bit")
    );
    // A step that read something else than it says is found.
    for e in &mut original.exchange {
        let is_late = e.of == crate::session::Loop::Haptic && e.step > 700;
        e.state -= u64::from(is_late);
    }
    assert!(
        matches!(stage.verify(&original), Err(Failure::Work(e)) if e.to_string().contains("bound"))
    );
}
