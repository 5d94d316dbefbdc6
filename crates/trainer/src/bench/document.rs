//! `bench --json`.
use super::rows::Row;
use super::{Evaluation, Sizes};
use anyhow::Result;
use serde::Serialize;

#[derive(Serialize)]
struct Document {
    schema: &'static str,
    sizes: Sizes,
    rows: Vec<RowForm>,
    rates_hz: Rates,
}

#[derive(Serialize)]
struct RowForm {
    name: &'static str,
    paper_mean_ms: f64,
    mean_ms: f64,
    sd_ms: f64,
    min_ms: f64,
    p99_ms: f64,
    max_ms: f64,
    #[serde(flatten)]
    baseline: Option<BaselineForm>,
}

#[derive(Serialize)]
struct BaselineForm {
    baseline: &'static str,
    baseline_ms: f64,
    ratio: f64,
}

#[derive(Serialize)]
struct Rates {
    haptic: f64,
    main: f64,
    propagation: f64,
}

/// The document. A part that the recording never came to has no row.
///
/// # Errors
/// None that can be named: a document that serde refuses.
pub fn json(e: &Evaluation) -> Result<String> {
    let [haptic, main, propagation] = e.paced.hz();
    let document = Document {
        schema: "osteotome.bench/1",
        sizes: e.sizes,
        rows: e.replayed.rows.iter().filter_map(row).collect(),
        rates_hz: Rates {
            haptic,
            main,
            propagation,
        },
    };
    Ok(serde_json::to_string_pretty(&document)?)
}

fn row(row: &Row) -> Option<RowForm> {
    let times = row.times.in_short()?;
    let baseline = row.baselines.first().and_then(|b| {
        Some(BaselineForm {
            baseline: b.what,
            baseline_ms: b.baseline_ms()?,
            ratio: b.ratio()?,
        })
    });
    Some(RowForm {
        name: row.part.name(),
        paper_mean_ms: row.part.paper()[0],
        mean_ms: times.mean,
        sd_ms: times.sd,
        min_ms: times.min,
        p99_ms: times.p99,
        max_ms: times.max,
        baseline,
    })
}
