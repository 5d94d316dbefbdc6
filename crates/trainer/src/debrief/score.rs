//! The score: the scenario's rubric, line by line, each lost point with its reason and time.
use super::findings::Findings;
use crate::scenario::{Target, Targets};
use serde::Serialize;

/// The score of a session.
#[derive(Clone, Debug, Serialize)]
pub struct Score {
    /// Points had.
    pub points: f64,
    /// Points that could be had of what could be measured.
    pub of: f64,
    /// The rubric.
    pub lines: Vec<Line>,
}

/// A line of the rubric.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Its key in `[targets]`.
    pub key: &'static str,
    /// What is asked.
    pub what: String,
    /// What was found, in words.
    pub found: String,
    /// Points had; `null` where it could not be measured, and then it does not count.
    pub points: Option<f64>,
    /// Points to be had.
    pub of: f64,
    /// When points were lost \[s\].
    pub lost_at_s: Option<f64>,
}

/// What one line is scored on.
struct Found {
    what: &'static str,
    unit: &'static str,
    decimals: usize,
    /// Value and time, or why there is none.
    value: Result<(f64, Option<f64>), String>,
}

impl Score {
    /// Out of 100; `None` where nothing can be had.
    pub fn percent(&self) -> Option<f64> {
        (self.of > 0.0).then(|| 100.0 * self.points / self.of)
    }

    /// Scores a session.
    pub fn of(findings: &Findings, targets: &Targets) -> Self {
        let mut lines = yes_or_no(findings, targets);
        for (key, target) in targets.scaled() {
            if target.weight > 0.0 {
                lines.push(line(key, &target, found(findings, key)));
            }
        }
        let counted = || lines.iter().filter_map(|l| Some((l.points?, l.of)));
        Self {
            points: counted().map(|l| l.0).sum(),
            of: counted().map(|l| l.1).sum(),
            lines,
        }
    }
}

fn yes_or_no(f: &Findings, targets: &Targets) -> Vec<Line> {
    let complete = Line {
        key: "complete",
        what: "The split is complete".to_owned(),
        found: match f.broken_s {
            Some(t) => format!("complete after {t:.1} s"),
            None => "the bone did not come apart".to_owned(),
        },
        points: Some(if f.broken_s.is_some() {
            targets.complete
        } else {
            0.0
        }),
        of: targets.complete,
        lost_at_s: f.broken_s.is_none().then_some(f.phases.after),
    };
    let (points, found, lost_at_s) = match &f.bad_split {
        Ok(b) => match &b.kind {
            None => (Some(targets.no_bad_split), "none".to_owned(), None),
            Some(kind) => (Some(0.0), format!("type {kind}: {}", b.reason), f.broken_s),
        },
        Err(why) => (None, why.clone(), None),
    };
    let bad = Line {
        key: "no_bad_split",
        what: "No bad split of the published types".to_owned(),
        found,
        points,
        of: targets.no_bad_split,
        lost_at_s,
    };
    [complete, bad].into_iter().filter(|l| l.of > 0.0).collect()
}

fn line(key: &'static str, target: &Target, found: Found) -> Line {
    let n = found.decimals;
    let unit = |v: f64| format!("{v:.n$} {}", found.unit).trim_end().to_owned();
    let side = if target.good < target.bad {
        "at most"
    } else {
        "at least"
    };
    let what = format!(
        "{}: {side} {} (no points at {})",
        found.what,
        unit(target.good),
        unit(target.bad)
    );
    let (points, lost_at_s) = match &found.value {
        Ok((value, time)) => {
            let share = target.share(*value);
            (Some(target.weight * share), time.filter(|_| share < 1.0))
        }
        Err(_) => (None, None),
    };
    Line {
        key,
        what,
        found: match found.value {
            Ok((value, _)) => unit(value),
            Err(why) => why,
        },
        points,
        of: target.weight,
        lost_at_s,
    }
}

/// The larger of both hands' peaks, and when it was.
fn worst(
    f: &Findings,
    of: fn(&super::hands::HandFindings) -> super::hands::At,
) -> Result<(f64, Option<f64>), String> {
    let [a, b] = f.hands.each_ref().map(of);
    let at = if a.value > b.value { a } else { b };
    Ok((at.value, Some(at.time_s)))
}

/// The value that a key is scored on.
fn found(f: &Findings, key: &str) -> Found {
    let make = |what, unit, decimals, value| Found {
        what,
        unit,
        decimals,
        value,
    };
    let plain = |value: f64| Ok((value, None));
    let both = |g: fn(&super::hands::HandFindings) -> f64| g(&f.hands[0]) + g(&f.hands[1]);
    let unbroken = || "the bone did not come apart".to_owned();
    let nerve = f.nerve.as_ref().map_err(Clone::clone);
    match key {
        "path_deviation" => make(
            "Broken face beside the planned plane, mean",
            "mm",
            1,
            match &f.path {
                Some(p) => Ok((p.mean_mm, Some(p.max_mm.time_s))),
                None => Err("nothing broke".to_owned()),
            },
        ),
        "nerve_distance" => make(
            "Tools and crack to the canal's wall (negative within it)",
            "mm",
            1,
            nerve.map(|n| {
                let at = n.nearest();
                (at.value, Some(at.time_s))
            }),
        ),
        "nerve_stretch" => make(
            "Stretch of the nerve's line over 10 mm",
            "",
            3,
            nerve.map(|n| (n.max_stretch.value, Some(n.max_stretch.time_s))),
        ),
        "nerve_kept" => make(
            "Share of the canal on the tooth-bearing fragment",
            "",
            2,
            nerve.and_then(|n| {
                n.kept_by_distal
                    .map(|k| (k, f.broken_s))
                    .ok_or_else(unbroken)
            }),
        ),
        "overshoot" => {
            let worst = f
                .hands
                .iter()
                .filter_map(|h| h.overshoot_mm)
                .max_by(|a, b| a.value.total_cmp(&b.value));
            make(
                "Overshoot after the break",
                "mm",
                1,
                worst
                    .map(|o| (o.value, Some(o.time_s)))
                    .ok_or_else(unbroken),
            )
        }
        "slips" => {
            let first = f
                .hands
                .iter()
                .flat_map(|h| &h.slips_s)
                .copied()
                .reduce(f64::min);
            make(
                "Tool slips",
                "",
                0,
                Ok((both(|h| h.slips_s.len() as f64), first)),
            )
        }
        "teeth" => make(
            "Tools touching teeth",
            "s",
            2,
            match &f.teeth {
                Ok(t) => Ok((t.seconds, t.first_s)),
                Err(why) => Err(why.clone()),
            },
        ),
        "balance" => make(
            "Smaller over larger impulse of the hands",
            "",
            2,
            f.balance
                .map(|b| (b, None))
                .ok_or_else(|| "no force was applied".to_owned()),
        ),
        "time" => make(
            "Time until the split",
            "s",
            1,
            f.broken_s.map(|t| (t, Some(t))).ok_or_else(unbroken),
        ),
        "peak_force" => {
            let worst = worst(f, |h| h.peak_force);
            make("Largest force on the bone", "N", 0, worst)
        }
        "peak_torque" => {
            let worst = worst(f, |h| h.peak_torque);
            make("Largest torque on the bone", "N mm", 0, worst)
        }
        "path_length" => make(
            "Path of both edges",
            "mm",
            0,
            plain(both(|h| h.path_length_mm)),
        ),
        _ => make(
            "Smoothness of the less smooth hand (spectral arc length)",
            "",
            2,
            f.hands
                .iter()
                .filter_map(|h| h.smoothness)
                .reduce(f64::min)
                .map(|s| (s, None))
                .ok_or_else(|| "the hands did not move".to_owned()),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::findings::tests::findings;
    use super::*;

    fn line<'a>(score: &'a Score, key: &str) -> &'a Line {
        score.lines.iter().find(|l| l.key == key).unwrap()
    }

    #[test]
    fn a_split_as_planned_has_all_points() {
        let score = Score::of(&findings(), &Targets::default());
        assert_eq!(score.percent(), Some(100.0), "{:?}", score.lines);
        assert!(score.lines.iter().all(|l| l.lost_at_s.is_none()));
    }

    #[test]
    fn each_point_lost_has_its_time_and_what_is_unknown_does_not_count() {
        let mut f = findings();
        f.hands[1].overshoot_mm = Some(super::super::hands::At {
            value: 6.0,
            time_s: 4.2,
        });
        f.hands[0].slips_s = vec![1.5, 3.0];
        f.nerve = Err("no canal is known".to_owned());
        let targets = Targets::default();
        let score = Score::of(&f, &targets);
        let overshoot = line(&score, "overshoot");
        assert_eq!(
            (overshoot.points, overshoot.lost_at_s),
            (Some(5.0), Some(4.2))
        );
        let slips = line(&score, "slips");
        assert!((slips.points.unwrap() - 5.0 / 3.0).abs() < 1e-12 && slips.lost_at_s == Some(1.5));
        let nerve = line(&score, "nerve_distance");
        assert_eq!(
            (nerve.points, nerve.found.as_str()),
            (None, "no canal is known")
        );
        assert!((score.of - (100.0 - 20.0)).abs() < 1e-9, "{}", score.of);
        let lost = score.of - score.points;
        assert!((lost - 5.0 - 10.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn an_unbroken_bone_loses_what_hangs_on_the_break() {
        let mut f = findings();
        f.broken_s = None;
        f.bad_split = Err("the bone did not come apart".to_owned());
        let score = Score::of(&f, &Targets::default());
        assert_eq!(line(&score, "complete").points, Some(0.0));
        assert_eq!(line(&score, "no_bad_split").points, None);
        assert_eq!(line(&score, "time").points, None);
    }
}
