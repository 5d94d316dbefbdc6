//! The bone's equations factored anew beside the loops, once the border that growth has appended makes solves dear.
use osteotome_mechanics::bone::FactorError;
use osteotome_mechanics::crack::System;
use osteotome_mechanics::step::Bone;
use std::thread::JoinHandle;
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// The new factor is taken so many generations after it was asked for, early or late: so lockstep runs repeat to the last bit.
const DELAY: u32 = 2;

/// At most one factorisation at a time, on a thread of its own that gives way to all others.
#[derive(Debug, Default)]
pub(super) struct Rebase {
    running: Option<Running>,
    has_failed: bool,
}

#[derive(Debug)]
struct Running {
    thread: JoinHandle<Result<System, FactorError>>,
    /// The generation that takes its result.
    due: u32,
}

impl Rebase {
    /// To be called with each generation before anyone else sees it: takes a factor that is due, waiting for it if it must, and asks
    /// for one where the border is heavy. A factor that fails leaves the bone on its old one for good.
    pub(super) fn follow(&mut self, bone: &mut Bone) {
        if let Some(running) = self.running.take_if(|r| bone.generation >= r.due) {
            let base = running.thread.join().ok().and_then(Result::ok);
            self.has_failed = base.is_none_or(|base| bone.rebase(&base).is_err());
        }
        if self.running.is_none() && !self.has_failed && bone.is_border_heavy() {
            let body = (**bone).clone();
            let factor = move || {
                // Best effort: without the right to it, it runs as all others do.
                let _ = set_current_thread_priority(ThreadPriority::Min);
                body.refactored()
            };
            let thread = std::thread::Builder::new().name("rebase".into());
            self.running = thread.spawn(factor).ok().map(|thread| Running {
                thread,
                due: bone.generation + DELAY,
            });
        }
    }
}
