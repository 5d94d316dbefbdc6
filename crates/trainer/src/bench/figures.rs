//! The paper's Figures 5 and 6, drawn from a session in real time.
use super::rates::Paced;
use crate::picture::write_png;
use crate::scenario::Scenario;
use anyhow::{Context, Result};
use osteotome_render::chart::{Chart, Series};
use std::path::Path;

/// What Figure 5 shows before and after the break \[s\].
const AROUND: [f64; 2] = [1.2, 0.4];
/// Rates are those over so long \[s\].
const WINDOW: f64 = 0.2;

/// Writes `force`, `torque` and `rates`, each as SVG and PNG, into `folder`.
///
/// # Errors
/// Whatever the file system says.
pub fn write(paced: &Paced, scenario: &Scenario, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let charts = [
        ("force", loads(paced, scenario, 0)),
        ("torque", loads(paced, scenario, 1)),
        ("rates", rates(paced)),
    ];
    for (name, chart) in charts {
        let path = |ending: &str| folder.join(format!("{name}.{ending}"));
        std::fs::write(path("svg"), chart.svg())
            .with_context(|| path("svg").display().to_string())?;
        write_png(&path("png"), &chart.image())?;
    }
    Ok(())
}

/// Magnitudes of the displayed force (0) or torque (1) of both hands around the break; of all the session if nothing broke.
fn loads(paced: &Paced, scenario: &Scenario, of: usize) -> Chart {
    let broken = paced.broken();
    let shown = |t: f64| broken.is_none_or(|b| t > b - AROUND[0] && t < b + AROUND[1]);
    let line = |hand: usize| {
        let tool = &scenario.tool[hand];
        let scale = [tool.force_scale, tool.torque_scale][of];
        let samples = paced.haptic.iter().filter(|s| shown(s.time));
        let points = samples.map(|s| {
            let w = &s.hands[hand].wrench;
            let displayed = [w.force.norm(), w.torque.norm()][of];
            // Torques come in thousands.
            (s.time, displayed / scale / [1.0, 1000.0][of])
        });
        Series::new(&format!("{} hand", tool.name), points.collect())
    };
    Chart {
        title: ["Force on the hands", "Torque on the hands"][of].to_owned(),
        axes: [
            "time (s)".to_owned(),
            ["force, bone units (N)", "torque, bone units (N m)"][of].to_owned(),
        ],
        series: vec![line(0), line(1)],
        floor: Some(0.0),
        marks: broken
            .map(|t| (t, "break".to_owned()))
            .into_iter()
            .collect(),
        ..Chart::default()
    }
}

/// Rates of haptic and main loop over the session.
fn rates(paced: &Paced) -> Chart {
    let haptic = haptic_rate(&paced.clock);
    let main = main_rate(&paced.main, &haptic);
    Chart {
        title: "Rates of the loops".to_owned(),
        axes: ["time (s)".to_owned(), "rate (Hz)".to_owned()],
        series: vec![
            Series::new("haptic loop", haptic),
            Series::new("main loop", main),
        ],
        is_log: [false, true],
        floor: Some(10.0),
        is_named_low: true,
        marks: (paced.broken().map(|t| (t, "break".to_owned())))
            .into_iter()
            .collect(),
        ..Chart::default()
    }
}

/// Steps a second \[Hz\] by the loop's own time \[s\], over windows of wall time.
fn haptic_rate(clock: &[[f64; 2]]) -> Vec<(f64, f64)> {
    let mut rates = Vec::new();
    let mut first = clock.first().copied().unwrap_or_default();
    for sample in clock {
        if sample[0] - first[0] >= WINDOW {
            rates.push((
                sample[1],
                1000.0 * (sample[1] - first[1]) / (sample[0] - first[0]),
            ));
            first = *sample;
        }
    }
    rates
}

/// Steps a second over the last [`WINDOW`] or more, at each step that ended at `times` of the haptic loop's clock \[s\].
fn main_rate(times: &[f64], haptic: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut rates = Vec::new();
    let mut first = 0;
    for (k, now) in times.iter().enumerate() {
        while times[first + 1..=k]
            .first()
            .is_some_and(|t| now - t >= WINDOW)
        {
            first += 1;
        }
        if now - times[first] >= WINDOW {
            let of_clock = (k - first) as f64 / (now - times[first]);
            rates.push((*now, of_clock * rate_at(haptic, *now) / 1000.0));
        }
    }
    rates
}

fn rate_at(rates: &[(f64, f64)], time: f64) -> f64 {
    let k = rates.partition_point(|r| r.0 < time);
    rates.get(k).or(rates.last()).map_or(1000.0, |r| r.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_RIGHT, Source, load};
    use crate::session::{GrowthSample, HandSample, HapticSample};
    use osteotome_mechanics::geometry::{Pose, Vec3};

    #[test]
    fn the_haptic_rate_is_steps_over_wall_time() {
        // Half speed for a second, then full speed.
        let clock = (0..=100).map(|k| {
            let wall = 0.02 * f64::from(k);
            [wall, if wall < 1.0 { 0.5 * wall } else { wall - 0.5 }]
        });
        let rates = haptic_rate(&clock.collect::<Vec<_>>());
        assert!((rate_at(&rates, 0.3) - 500.0).abs() < 1e-6);
        assert!((rate_at(&rates, 1.2) - 1000.0).abs() < 1e-6);
        // A main step each 20 ms of a clock that runs at half speed for its first half second.
        let ends: Vec<f64> = (0..75).map(|k| 0.02 * f64::from(k)).collect();
        let main = main_rate(&ends, &rates);
        assert!((rate_at(&main, 0.3) - 25.0).abs() < 1e-6);
        assert!((rate_at(&main, 1.2) - 50.0).abs() < 1e-6);
    }

    /// Both hands press with 1 and 2 N at the device, twist with 3 and 4 N mm, and the bone breaks at 1 s.
    fn paced(scenario: &Scenario) -> Paced {
        let wrench = |k: f64| osteotome_devices::Wrench {
            force: Vec3::x() * k,
            torque: Vec3::y() * (k + 2.0),
        };
        let hand = |k: f64| HandSample {
            device_pose: Pose::identity(),
            device_buttons: 0,
            tool_pose: Pose::identity(),
            wrench: wrench(k),
            saturated: false,
            contacts: 0,
        };
        let haptic = (0..2000u64).map(|step| HapticSample {
            step,
            time: step as f64 * scenario.loops.dt(),
            hands: [hand(1.0), hand(2.0)],
        });
        let growth = serde_json::json!({
            "vertices": [], "triangles": [], "kerf": [], "generation": 1, "front": [], "area": 1.0, "fragments": 2, "severed": true
        });
        let growth: GrowthSample = serde_json::from_value(growth).unwrap();
        Paced {
            haptic: haptic.collect(),
            main: (0..100).map(|k| 0.02 * f64::from(k)).collect(),
            growth: vec![GrowthSample {
                time: 1.0,
                ..growth
            }],
            clock: (0..100).map(|k| [0.02 * f64::from(k); 2]).collect(),
            ..Paced::default()
        }
    }

    #[test]
    fn figures_are_written_in_both_forms_and_in_bone_units() {
        let source = Source::Text {
            name: "test".into(),
            text: BSSO_RIGHT.into(),
        };
        let scenario = load(&source, &[], Path::new("/")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        write(&paced(&scenario), &scenario, folder.path()).unwrap();
        for name in ["force", "torque", "rates"] {
            let file = |ending: &str| std::fs::read(folder.path().join(format!("{name}.{ending}")));
            assert!(file("png").unwrap().starts_with(b"\x89PNG"));
            let svg = String::from_utf8(file("svg").unwrap()).unwrap();
            assert!(svg.starts_with("<svg") && svg.contains("break"));
        }
        // 2 N at the device are 400 N at the bone, so that the axis goes to 400 and not far beyond.
        let force = loads(&paced(&scenario), &scenario, 0).svg();
        assert!(force.contains(">400</text>") && !force.contains(">500</text>"));
    }
}
