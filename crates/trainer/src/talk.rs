//! All that is said to the user: the only module that prints.
use crate::debrief::Score;
use crate::session::{LoopFigures, Outcome};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::time::{Duration, Instant};

/// Text for people and programs, on standard output.
pub fn say(text: &str) {
    // Whoever reads may have gone away (a closed pipe): not a failure of ours.
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// One line on standard error.
pub fn complain(error: &anyhow::Error) {
    let text = format!("{error:#}");
    let _ = writeln!(
        std::io::stderr(),
        "osteotome: {}",
        text.split('\n')
            .map(str::trim)
            .collect::<Vec<_>>()
            .join(" ")
    );
}

/// A progress bar on standard error that appears once the work has taken a second. Silent where there is no terminal.
pub struct Progress {
    bar: ProgressBar,
    since: Instant,
    is_shown: bool,
}

/// Work shorter than this goes without a bar.
const PATIENCE: Duration = Duration::from_secs(1);

impl Progress {
    /// Up to `length` of whatever `what` counts.
    pub fn new(what: &str, length: u64) -> Self {
        let bar = ProgressBar::new(length);
        bar.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        let style = ProgressStyle::with_template("{prefix} [{bar:40}] {msg} ({elapsed})");
        bar.set_style(
            style
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .progress_chars("=> "),
        );
        bar.set_prefix(what.to_owned());
        Self {
            bar,
            since: Instant::now(),
            is_shown: false,
        }
    }

    /// How far it has come, in words as well.
    pub fn set(&mut self, position: u64, message: impl Into<String>) {
        if !self.is_shown && self.since.elapsed() > PATIENCE {
            self.is_shown = true;
            self.bar
                .set_draw_target(indicatif::ProgressDrawTarget::stderr_with_hz(10));
        }
        self.bar.set_position(position);
        if self.is_shown {
            self.bar.set_message(message.into());
        }
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Takes the bar away for good.
    pub fn done(self) {
        self.clear();
    }
}

/// The session in a few lines.
pub fn summary(outcome: &Outcome) -> String {
    let mut lines = vec![match outcome.time {
        Some(time) => format!(
            "Split complete after {time:.2} s: {} fragments, {:.0} mm2 of new crack.",
            outcome.fragments, outcome.area
        ),
        None => format!(
            "No split within {:.2} s: {:.0} mm2 of new crack.",
            outcome.ended, outcome.area
        ),
    }];
    for (i, hand) in ["Left", "Right"].into_iter().enumerate() {
        let [force, torque] = outcome.peaks[i];
        let fall = outcome.torque_fall[i].map_or_else(String::new, |share| {
            format!(
                "; torque fell by {:.0} % within 100 ms of the break",
                100.0 * share
            )
        });
        lines.push(format!(
            "{hand:<6} hand: at most {force:.0} N and {torque:.0} N mm on the bone{fall}."
        ));
    }
    for (name, figures) in ["Haptic", "Main", "Propagation"]
        .into_iter()
        .zip(&outcome.loops)
    {
        lines.extend(loop_line(name, figures));
    }
    if let Some(share) = outcome.within_five {
        lines.push(format!(
            "Relaxation converged within 5 iterations in {:.1} % of the main steps.",
            100.0 * share
        ));
    }
    lines.join("\n")
}

/// The score, with what was lost and when.
pub fn score(score: &Score) -> String {
    let mut lines = vec![format!(
        "Score: {:.0} of {:.0} points.",
        score.points, score.of
    )];
    for line in &score.lines {
        let Some(points) = line.points.filter(|p| line.of - p >= 0.05) else {
            continue;
        };
        let when = line
            .lost_at_s
            .map_or_else(String::new, |t| format!(", at {t:.2} s"));
        lines.push(format!(
            "  -{:.1}  {}: {}{when}.",
            line.of - points,
            line.what,
            line.found.trim_end_matches('.')
        ));
    }
    lines.join("\n")
}

fn loop_line(name: &str, figures: &LoopFigures) -> Option<String> {
    let times = figures.step_us?;
    let [mean, p99] = [times.mean, times.p99].map(|us| us * 1e-3);
    let pace = match (figures.hz, figures.missed) {
        (Some(hz), Some(missed)) => format!("{hz:.0} Hz, {missed} deadlines missed, "),
        _ => String::new(),
    };
    Some(format!(
        "{name:<11} loop: {pace}step {mean:.3} ms on average, {p99:.3} ms at the 99th percentile."
    ))
}
