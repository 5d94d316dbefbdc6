//! In which order the steps of a recorded session have read each other.
use crate::session::{Loop, Recording};

/// A main step: after how many haptic steps, and on which generation of the bone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MainTurn {
    /// Haptic steps made before it.
    pub after: u64,
    /// Generation of the bone; the largest number for the newest.
    pub generation: u64,
}

/// Which state of the bone a haptic step read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// The newest.
    Newest,
    /// The one that the step before read.
    AsBefore,
    /// The one of this number.
    State(u64),
}

/// See the module.
#[derive(Debug)]
pub struct Schedule {
    /// From which haptic step on which state of the bone was read; `None`: always the newest.
    views: Option<Vec<(u64, u64)>>,
    main: Vec<MainTurn>,
    /// After which main steps (from 1) the crack was looked at; `None`: after each.
    looks: Option<Vec<u64>>,
    why_unknown: Option<String>,
}

impl Schedule {
    /// As recorded. A recording in lockstep has a known one without saying so.
    pub fn of(recording: &Recording) -> Self {
        let mut events = recording.events.iter().map(|e| &e.1);
        let lost = events.rfind(|e| e.contains("not recorded"));
        let is_lockstep = recording.scenario.mode == "lockstep";
        if recording.exchange.is_empty() || lost.is_some() {
            let why = match lost {
                Some(event) => Some(event.clone()),
                None if is_lockstep => None,
                None => Some("it was made by an earlier version, against the clock".to_owned()),
            };
            return Self {
                why_unknown: why,
                ..Self::lockstep(recording)
            };
        }
        let of = |which: Loop| recording.exchange.iter().filter(move |e| e.of == which);
        let turn = |e: &crate::session::Exchange| MainTurn {
            after: e.state,
            generation: e.generation.unwrap_or(u64::MAX),
        };
        Self {
            views: Some(of(Loop::Haptic).map(|e| (e.step, e.state)).collect()),
            main: of(Loop::Main).map(turn).collect(),
            looks: Some(of(Loop::Propagation).map(|e| e.state).collect()),
            why_unknown: None,
        }
    }

    /// A main step after every so many haptic ones, and a look at the crack after each.
    fn lockstep(recording: &Recording) -> Self {
        let every = u64::from(recording.scenario.scenario.loops.haptic_per_main().max(1));
        let n = recording.hands[0].len() as u64;
        let turn = |k: u64| MainTurn {
            after: (k * every).min(n),
            generation: u64::MAX,
        };
        Self {
            views: None,
            main: (1..=n.div_ceil(every)).map(turn).collect(),
            looks: None,
            why_unknown: None,
        }
    }

    /// Whether steps in this order give what was recorded, to the last bit.
    pub fn is_known(&self) -> bool {
        self.why_unknown.is_none()
    }

    /// Why they may not.
    pub fn why_unknown(&self) -> Option<&str> {
        self.why_unknown.as_deref()
    }

    /// The main steps.
    pub fn main(&self) -> &[MainTurn] {
        &self.main
    }

    /// Which state of the bone this haptic step read.
    pub fn view(&self, step: u64) -> View {
        let Some(views) = &self.views else {
            return View::Newest;
        };
        let at = views.binary_search_by_key(&step, |v| v.0);
        at.map_or(View::AsBefore, |k| View::State(views[k].1))
    }

    /// Whether the crack was looked at after this many main steps.
    pub fn is_looked_at(&self, main_steps: u64) -> bool {
        let looks = self.looks.as_ref();
        looks.is_none_or(|l| l.binary_search(&main_steps).is_ok())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::session::{Exchange, ScenarioMessage, tests::hand};

    fn recording(mode: &str) -> Recording {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let mut recording = Recording::empty(ScenarioMessage {
            scenario: load(&source, &[], std::path::Path::new("/")).unwrap(),
            patient_digest: String::new(),
            mode: mode.into(),
            start: None,
            retried: None,
        });
        recording.hands = [vec![hand(0.0); 50], vec![hand(0.0); 50]];
        recording
    }

    #[test]
    fn lockstep_needs_no_record_of_what_was_read() {
        let schedule = Schedule::of(&recording("lockstep"));
        assert!(schedule.is_known() && schedule.is_looked_at(2));
        let after: Vec<u64> = schedule.main().iter().map(|m| m.after).collect();
        assert_eq!(after, [20, 40, 50]);
        assert_eq!(schedule.view(7), View::Newest);
    }

    #[test]
    fn against_the_clock_what_was_read_is_known_or_nothing_is_promised() {
        let mut recording = recording("realtime");
        let why = |r: &Recording| Schedule::of(r).why_unknown().map(str::to_owned);
        assert!(why(&recording).unwrap().contains("earlier version"));
        let read = |of, step, state| Exchange {
            of,
            step,
            state,
            generation: (of == Loop::Main).then_some(0),
        };
        recording.exchange = vec![
            read(Loop::Haptic, 0, 1),
            read(Loop::Main, 0, 3),
            read(Loop::Haptic, 9, 2),
            read(Loop::Propagation, 0, 1),
        ];
        let schedule = Schedule::of(&recording);
        assert!(schedule.is_known());
        assert_eq!(
            [8, 9].map(|k| schedule.view(k)),
            [View::AsBefore, View::State(2)]
        );
        assert_eq!(
            (schedule.main()[0].after, schedule.is_looked_at(2)),
            (3, false)
        );
        let lost = "Haptic loop: 4 samples were not recorded".to_owned();
        recording.events.push((1.0, lost.clone()));
        assert_eq!(why(&recording), Some(lost));
    }
}
