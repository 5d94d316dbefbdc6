//! `report.html`: one file that works offline.
use super::bad_split::BadSplit;
use super::course::Course;
use super::findings::Findings;
use super::hands::load;
use super::packed::{base64, floats};
use super::score::Score;
use super::shapes::Shapes;
use crate::engine::Prepared;
use crate::picture::{Stage, shots};
use crate::retry::Schedule;
use crate::session::{Loop, Recording};
use anyhow::Result;
use osteotome_render::Renderer;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A session in figures, for comparison and learning curve.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Figures {
    /// What the session is called.
    pub name: String,
    rows: Vec<Figure>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Figure {
    what: Cow<'static, str>,
    unit: Cow<'static, str>,
    decimals: usize,
    value: Option<f64>,
    /// Where there is no value.
    why_not: String,
}

impl Figures {
    /// Each figure: what it is, its unit, its value.
    pub fn rows(&self) -> impl Iterator<Item = (&str, &str, Option<f64>)> {
        (self.rows.iter()).map(|r| (r.what.as_ref(), r.unit.as_ref(), r.value))
    }

    /// The value of one.
    pub fn value(&self, what: &str) -> Option<f64> {
        self.rows().find(|r| r.0 == what)?.2
    }

    /// The score \[%\].
    pub fn score(&self) -> Option<f64> {
        self.value("Score")
    }

    /// From what was found.
    pub fn of(name: &str, f: &Findings, score: &Score) -> Self {
        let mut rows = vec![];
        let mut row =
            |what: &'static str, unit: &'static str, decimals, value: Result<f64, &str>| {
                rows.push(Figure {
                    what: what.into(),
                    unit: unit.into(),
                    decimals,
                    value: value.ok(),
                    why_not: value.err().unwrap_or_default().to_owned(),
                });
            };
        let unbroken = "the bone did not come apart";
        row("Score", "%", 0, score.percent().ok_or("nothing is scored"));
        row("Time until the split", "s", 1, f.broken_s.ok_or(unbroken));
        for (name, seconds) in f.phases.lengths() {
            let what = match name {
                "approach" => "Phase: approach",
                "insertion" => "Phase: insertion",
                "twisting" => "Phase: twisting",
                "break" => "Phase: break",
                _ => "Phase: after",
            };
            row(what, "s", 2, Ok(seconds));
        }
        let names = [
            [
                "Left: peak force on the bone",
                "Right: peak force on the bone",
            ],
            [
                "Left: peak torque on the bone",
                "Right: peak torque on the bone",
            ],
            ["Left: impulse", "Right: impulse"],
            ["Left: path of the edge", "Right: path of the edge"],
            ["Left: movements", "Right: movements"],
            [
                "Left: smoothness (spectral arc length)",
                "Right: smoothness (spectral arc length)",
            ],
            [
                "Left: overshoot after the break",
                "Right: overshoot after the break",
            ],
            ["Left: slips", "Right: slips"],
        ];
        for (i, h) in f.hands.iter().enumerate() {
            row(names[0][i], "N", 0, Ok(h.peak_force.value));
            row(names[1][i], "N mm", 0, Ok(h.peak_torque.value));
            row(names[2][i], "N s", 0, Ok(h.impulse));
            row(names[3][i], "mm", 0, Ok(h.path_length_mm));
            row(names[4][i], "", 0, Ok(h.movements as f64));
            row(
                names[5][i],
                "",
                2,
                h.smoothness.ok_or("the hand did not move"),
            );
            row(
                names[6][i],
                "mm",
                1,
                h.overshoot_mm.map(|o| o.value).ok_or(unbroken),
            );
            row(names[7][i], "", 0, Ok(h.slips_s.len() as f64));
        }
        row(
            "Smaller over larger impulse",
            "",
            2,
            f.balance.ok_or("no force was applied"),
        );
        let path = |g: fn(&super::path::PathFindings) -> f64| {
            f.path.as_ref().map(g).ok_or("nothing broke")
        };
        row(
            "Broken face beside the plan, mean",
            "mm",
            1,
            path(|p| p.mean_mm),
        );
        row(
            "Broken face beside the plan, most",
            "mm",
            1,
            path(|p| p.max_mm.value),
        );
        row("Broken area", "mm\u{b2}", 0, path(|p| p.area_mm2));
        let nerve = f.nerve.as_ref().map_err(String::as_str);
        row(
            "Tools to the canal's wall",
            "mm",
            1,
            nerve.map(|n| n.tool_mm.value),
        );
        row(
            "Crack to the canal's wall",
            "mm",
            1,
            nerve.and_then(|n| n.crack_mm.map(|c| c.value).ok_or("nothing broke")),
        );
        row(
            "Stretch of the nerve's line over 10 mm",
            "",
            3,
            nerve.map(|n| n.max_stretch.value),
        );
        row(
            "Canal kept by the tooth-bearing fragment",
            "%",
            0,
            nerve.and_then(|n| n.kept_by_distal.map(|k| 100.0 * k).ok_or(unbroken)),
        );
        row(
            "Tools touching teeth",
            "s",
            2,
            f.teeth.as_ref().map(|t| t.seconds).map_err(String::as_str),
        );
        let touched: Vec<f64> = f.context.iter().filter_map(|c| c.seconds).collect();
        row(
            "Tools touching what is around the jaw, surface by surface",
            "s",
            2,
            match touched.is_empty() {
                true => Err("nothing closed is around the jaw"),
                false => Ok(touched.iter().sum()),
            },
        );
        Self {
            name: name.to_owned(),
            rows,
        }
    }
}

#[derive(Serialize)]
struct Page<'a> {
    title: &'a str,
    version: &'static str,
    seconds: f64,
    broken_s: Option<f64>,
    score: &'a Score,
    bad_split: Option<&'a BadSplit>,
    no_verdict: Option<&'a str>,
    phases: Vec<(&'static str, f64)>,
    events: Vec<(f64, String)>,
    loads: Loads,
    rates: Rates,
    shots: Vec<ShotOnPage>,
    shapes: Option<Shapes>,
    figures: &'a Figures,
    reference: Option<&'a Figures>,
    curve: &'a [Figures],
    notes: Vec<String>,
}

/// Largest displayed loads in each bin.
#[derive(Serialize)]
struct Loads {
    step: f64,
    force: [String; 2],
    torque: [String; 2],
    /// On the bone over displayed.
    factors: [[f64; 2]; 2],
}

#[derive(Serialize)]
struct Rates {
    times: String,
    hz: String,
    wanted: f64,
}

#[derive(Serialize)]
struct ShotOnPage {
    title: String,
    time: f64,
    png: String,
}

/// The session a page is about.
pub struct Subject<'a> {
    /// Its bone.
    pub prepared: &'a Prepared,
    /// Its recording.
    pub recording: &'a Recording,
    /// What was found.
    pub findings: &'a Findings,
    /// Its score.
    pub score: &'a Score,
    /// In short.
    pub figures: &'a Figures,
}

/// The page. `reference`: a session to compare with; `curve`: all sessions in their order, this one included.
///
/// # Errors
/// A recording that does not fit the bone.
pub fn page(s: &Subject, reference: Option<&Figures>, curve: &[Figures]) -> Result<String> {
    let (recording, findings) = (s.recording, s.findings);
    let scenario = &recording.scenario.scenario;
    let course = Course::new(s.prepared, recording)?;
    let patient = &s.prepared.patient;
    let canal = patient
        .canals
        .iter()
        .find(|c| c.side == patient.osteotomy.side);
    let chisels = Findings::chisels(scenario)?;
    let shapes = Shapes::of(
        &course,
        s.prepared,
        recording,
        &chisels,
        canal.map(|c| &c.line[..]),
    )?;
    let mut stage = Stage::new(s.prepared, recording)?;
    let shots = shots(&mut stage, &mut Renderer::fastest())?
        .into_iter()
        .map(|shot| ShotOnPage {
            title: shot.title.to_owned(),
            time: shot.time,
            png: base64(&shot.png),
        });
    let data = Page {
        title: &scenario.name,
        version: env!("CARGO_PKG_VERSION"),
        seconds: recording.seconds(scenario),
        broken_s: findings.broken_s,
        score: s.score,
        bad_split: findings.bad_split.as_ref().ok(),
        no_verdict: findings.bad_split.as_ref().err().map(String::as_str),
        phases: findings.phases.lengths().into(),
        events: events(recording, findings),
        loads: loads(recording),
        rates: rates(recording),
        shots: shots.collect(),
        shapes: Some(shapes),
        figures: s.figures,
        reference,
        curve,
        notes: notes(s),
    };
    // A "<" in a text must not end the script element.
    let json = serde_json::to_string(&data)?.replace('<', "\\u003c");
    let title = scenario.name.replace('&', "&amp;").replace('<', "&lt;");
    Ok(include_str!("page.html")
        .replace("{{title}}", &title)
        .replace("{{style}}", include_str!("page.css"))
        .replace(
            "{{script}}",
            concat!(include_str!("page.js"), include_str!("viewer.js")),
        )
        .replace("{{data}}", &json))
}

/// Growths are many: the first, and the break, are told.
fn events(recording: &Recording, findings: &Findings) -> Vec<(f64, String)> {
    let mut events = recording.events.clone();
    let grown: Vec<_> = recording
        .growth
        .iter()
        .filter(|g| g.generation > 0)
        .collect();
    if let (Some(first), Some(last)) = (grown.first(), grown.last()) {
        events.push((first.time, "first crack".to_owned()));
        events.push((
            last.time,
            format!(
                "last of {} growths: {:.0} mm\u{b2} broken",
                grown.len(),
                last.area
            ),
        ));
    }
    for (name, hand) in ["left", "right"].into_iter().zip(&findings.hands) {
        events.push((
            hand.peak_force.time_s,
            format!(
                "peak force of the {name} hand: {:.0} N",
                hand.peak_force.value
            ),
        ));
        events.push((
            hand.peak_torque.time_s,
            format!(
                "peak torque of the {name} hand: {:.0} N mm",
                hand.peak_torque.value
            ),
        ));
        events.extend(
            hand.slips_s
                .iter()
                .map(|t| (*t, format!("the {name} tool slipped"))),
        );
    }
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    events
}

fn loads(recording: &Recording) -> Loads {
    const MOST: usize = 3000;
    let scenario = &recording.scenario.scenario;
    let every = recording.hands[0].len().div_ceil(MOST).max(1);
    let bins = |i: usize, k: usize| {
        let scale = [scenario.tool[i].force_scale, scenario.tool[i].torque_scale][k];
        let largest = move |bin: &[_]| {
            bin.iter()
                .map(|s| load(s, scenario, i)[k] * scale)
                .fold(0.0, f64::max)
        };
        floats(recording.hands[i].chunks(every).map(largest))
    };
    Loads {
        step: every as f64 * scenario.loops.dt(),
        force: [bins(0, 0), bins(1, 0)],
        torque: [bins(0, 1), bins(1, 1)],
        factors: [0, 1].map(|i| {
            [
                1.0 / scenario.tool[i].force_scale,
                1.0 / scenario.tool[i].torque_scale,
            ]
        }),
    }
}

/// How often a second the main step could be made: one over its duration; the slowest of each bin.
fn rates(recording: &Recording) -> Rates {
    const MOST: usize = 1500;
    let main: Vec<_> = recording
        .timing
        .iter()
        .filter(|t| t.of == Loop::Main && t.step_us > 0.0)
        .collect();
    let every = main.len().div_ceil(MOST).max(1);
    let slowest =
        |bin: &[&crate::session::StepTime]| 1e6 / bin.iter().map(|t| t.step_us).fold(0.0, f64::max);
    Rates {
        times: floats(main.chunks(every).map(|bin| bin[0].time)),
        hz: floats(main.chunks(every).map(slowest)),
        wanted: recording.scenario.scenario.loops.main_hz,
    }
}

/// Limits and constructed data, openly.
fn notes(s: &Subject) -> Vec<String> {
    let scenario = &s.recording.scenario.scenario;
    let mut notes: Vec<String> = vec![];
    if s.recording.is_cut_short {
        notes.push("This recording breaks off: the program ended before the session did. What follows is what had been written.".to_owned());
    }
    notes.extend(
        s.prepared
            .patient
            .constructed
            .iter()
            .map(|c| format!("Constructed, not measured: {c}.")),
    );
    if s.findings.nerve.as_ref().is_ok_and(|n| !n.is_constructed) {
        notes.push("The canal comes from a file of this patient.".to_owned());
    }
    if s.findings.nerve.as_ref().is_ok_and(|n| n.is_constructed) {
        notes.push("The constructed canal begins just behind where a split as planned leaves the bone, so that such a split crosses it there: figures of the nerve tell more in comparison than by themselves.".to_owned());
    }
    for (tool, hand) in scenario.tool.iter().zip(&s.findings.hands) {
        notes.push(format!(
            "{} hand: device {}, at most {} N and {} N mm; it showed 1/{:.0} of the force and 1/{:.0} of the torque on the bone, and was at its limit for {:.2} s.",
            if tool.name == "left" { "Left" } else { "Right" },
            tool.device,
            tool.limits.force,
            tool.limits.torque,
            1.0 / tool.force_scale,
            1.0 / tool.torque_scale,
            hand.saturated_s
        ));
    }
    notes.push(match s.recording.scenario.mode.as_str() {
        "lockstep" => "Recorded in lockstep: no clock; it can be recomputed to the last bit.".to_owned(),
        _ => match Schedule::of(s.recording).why_unknown() {
            None => "Recorded against the clock; what its steps read of each other is recorded too, so that it can be recomputed to the last bit.".to_owned(),
            Some(why) => format!("Recorded against the clock; it cannot be recomputed to the last bit: {why}."),
        },
    });
    notes.push("No human splitting load has been published: forces and torques on the bone are the model's.".to_owned());
    notes.push("The thresholds of the rubric are assumptions of the scenario. They have not been validated against surgeons' outcomes.".to_owned());
    notes.push(
        "Single sessions tell little about skill: novices peak early. Look at several together."
            .to_owned(),
    );
    notes
}
