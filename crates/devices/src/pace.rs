use std::time::{Duration, Instant};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// Late by more than this, a loop starts a new schedule instead of hurrying after the old one.
const CATCH_UP: Duration = Duration::from_millis(5);

/// Keeps a loop's rate against absolute deadlines.
pub(crate) struct Pace {
    period: Duration,
    next: Instant,
}

impl Pace {
    pub(crate) fn new(period: Duration) -> Self {
        let next = Instant::now() + period;
        Self { period, next }
    }

    /// Sleeps to the end of this step.
    pub(crate) fn wait(&mut self) {
        let now = Instant::now();
        std::thread::sleep(self.next.saturating_duration_since(now));
        if now > self.next + CATCH_UP {
            self.next = now;
        }
        self.next += self.period;
    }
}

/// For threads that a hand waits for. Best effort: without the right to it they run at normal priority.
pub(crate) fn raise_priority() {
    let _ = set_current_thread_priority(ThreadPriority::Max);
}
