//! `docs/performance/*.svg`: what each part costs against the size of the problem, from several runs of `osteotome bench --json`.
use anyhow::{Context, Result, ensure};
use osteotome_render::chart::{Chart, Series};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Cost against one size.
struct Sweep {
    name: &'static str,
    axis: &'static str,
    /// As in the documents' `sizes`.
    size: &'static str,
    parts: &'static [&'static str],
}

const SWEEPS: [Sweep; 2] = [
    Sweep {
        name: "nodes",
        axis: "nodes of the simulation mesh",
        size: "nodes",
        parts: &[
            "haptic step",
            "main step",
            "collision update",
            "propagation step",
            "linearisation",
            "factorisation",
        ],
    },
    Sweep {
        name: "points",
        axis: "points of the shell",
        size: "points",
        parts: &[
            "haptic step",
            "collision query",
            "collision update",
            "main step",
            "propagation step",
        ],
    },
];

/// Draws `nodes` or `points` from documents of `osteotome bench --json`.
pub fn write(what: &str, documents: &[String]) -> Result<()> {
    let sweep = SWEEPS.iter().find(|s| s.name == what);
    let sweep = sweep.with_context(|| format!("{what}: give nodes or points"))?;
    ensure!(
        documents.len() >= 2,
        "give at least two documents of osteotome bench --json"
    );
    let runs: Vec<Value> = documents.iter().map(|d| read(d)).collect::<Result<_>>()?;
    let series = sweep.parts.iter().map(|part| line(sweep, part, &runs));
    let chart = Chart {
        title: format!("Cost against {}", sweep.axis),
        axes: [sweep.axis.to_owned(), "mean (ms)".to_owned()],
        series: series.collect::<Result<_>>()?,
        is_log: [true, true],
        is_named_low: what == "points",
        ..Chart::default()
    };
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/performance");
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join(format!("{}.svg", sweep.name)), chart.svg())?;
    Ok(())
}

fn read(path: &str) -> Result<Value> {
    let text = std::fs::read_to_string(Path::new(path)).with_context(|| path.to_owned())?;
    let document: Value = serde_json::from_str(&text).with_context(|| path.to_owned())?;
    ensure!(
        document["schema"] == "osteotome.bench/1",
        "{path}: not a document of osteotome bench --json"
    );
    Ok(document)
}

/// Mean times of one part, its slope in the name.
fn line(sweep: &Sweep, part: &str, runs: &[Value]) -> Result<Series> {
    let point = |run: &Value| {
        let rows = run["rows"].as_array()?;
        let row = rows.iter().find(|r| r["name"] == part)?;
        Some((
            run["sizes"][sweep.size].as_f64()?,
            row["mean_ms"].as_f64().filter(|ms| *ms > 0.0)?,
        ))
    };
    let points: Vec<(f64, f64)> = runs.iter().filter_map(point).collect();
    ensure!(points.len() >= 2, "{part}: timed in fewer than two runs");
    let name = format!("{part}: slope {:.2}", slope(&points));
    Ok(Series::new(&name, points).dotted())
}

/// Least squares in logarithms: the power of the size with which the cost grows.
fn slope(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<[f64; 2]> = points.iter().map(|p| [p.0.ln(), p.1.ln()]).collect();
    let mean = |k: usize| logs.iter().map(|l| l[k]).sum::<f64>() / logs.len() as f64;
    let [x, y] = [mean(0), mean(1)];
    let covariance: f64 = logs.iter().map(|l| (l[0] - x) * (l[1] - y)).sum();
    covariance / logs.iter().map(|l| (l[0] - x) * (l[0] - x)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_power_is_its_slope() {
        let points = [600.0, 5000.0, 25_000.0].map(|n: f64| (n, 0.3 * n.powf(1.5)));
        assert!((super::slope(&points) - 1.5).abs() < 1e-12);
    }
}
