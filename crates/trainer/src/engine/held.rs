//! What the parts tell each other, held back until it is asked for, so that a recorded session repeats itself.
use super::haptic::BoneView;
use super::{Engine, EngineUnderway, Prepared, connect};
use super::{main::Main, propagation::Propagation};
use crate::loops::{MainPart, Propagated, PropagationPart, Published, Subscribed, latest};
use crate::scenario::Scenario;
use crate::session::MainSample;
use anyhow::Result;
use osteotome_mechanics::geometry::Pose;
use osteotome_mechanics::step::Bone;
use std::collections::VecDeque;
use std::sync::Arc;

/// Between the writing and the reading end of a latest value: what has been written waits in a queue.
struct Relay<T: Send> {
    from: Subscribed<T>,
    to: Published<T>,
    held: VecDeque<T>,
    /// What was let through last.
    passed: T,
}

impl<T: Clone + Send> Relay<T> {
    /// The relay, the writing end before it and the reading end behind it.
    fn new(initial: &T) -> (Self, Published<T>, Subscribed<T>) {
        let (writer, from) = latest(initial);
        let (to, reader) = latest(initial);
        let relay = Self {
            from,
            to,
            held: VecDeque::new(),
            passed: initial.clone(),
        };
        (relay, writer, reader)
    }

    fn hold(&mut self) {
        let value = self.from.read().clone();
        self.held.push_back(value);
    }

    /// Lets through what comes first, as long as it is wanted.
    fn pass(&mut self, is_wanted: impl Fn(&T) -> bool) {
        let n = self.held.iter().take_while(|v| is_wanted(v)).count();
        if let Some(last) = self.held.drain(..n).next_back() {
            self.passed = last.clone();
            self.to.write(last);
        }
    }
}

/// See the module. Hands go straight from the haptic to the main step, and the loaded bone from there to the propagation
/// step: whoever drives the parts steps the reader at the right moment.
pub struct Held {
    views: Relay<BoneView>,
    grown: Relay<Arc<Bone>>,
}

impl Held {
    /// The parts as [`connect`] makes them, but for what stands between them.
    ///
    /// # Errors
    /// As there.
    pub fn connect(
        prepared: &Prepared,
        scenario: &Scenario,
        start: [Pose; 2],
    ) -> Result<(Self, Engine)> {
        let mut parts = connect(prepared, scenario, start)?;
        let at_rest = parts.haptic.bone.read().clone();
        let (views, writer, reader) = Relay::new(&at_rest);
        parts.main.ends.to_haptic = writer;
        parts.haptic.bone = reader;
        let (grown, writer, reader) = Relay::new(&prepared.bone);
        parts.propagation.grown = writer;
        parts.main.ends.grown = reader;
        Ok((Self { views, grown }, parts))
    }

    /// A main step on the bone of this generation, or the newest before it.
    pub fn main_step(&mut self, main: &mut Main, generation: u64) -> MainSample {
        self.grown
            .pass(|bone| u64::from(bone.generation) <= generation);
        let sample = main.step();
        self.views.hold();
        sample
    }

    /// A propagation step on what the main step before has left.
    pub fn propagation_step(&mut self, propagation: &mut Propagation) -> Propagated {
        let propagated = propagation.step();
        if matches!(propagated, Propagated::Grown(_)) {
            self.grown.hold();
        }
        propagated
    }

    /// Shows the haptic step the bone's state of this number; false if there is no such state.
    pub fn show(&mut self, number: u64) -> bool {
        self.views.pass(|view| view.number <= number);
        self.views.passed.number == number
    }

    /// Shows it the newest.
    pub fn show_newest(&mut self) {
        self.views.pass(|_| true);
    }

    /// The parts as they are, connected as usual: each sees the newest of the others.
    pub fn release(mut self, parts: &mut EngineUnderway) {
        self.views.pass(|_| true);
        self.grown.pass(|_| true);
        let (writer, reader) = latest(&self.views.passed);
        parts.main.ends.to_haptic = writer;
        parts.haptic.part.bone = reader;
        let (writer, reader) = latest(&self.grown.passed);
        parts.propagation.grown = writer;
        parts.main.ends.grown = reader;
    }
}
