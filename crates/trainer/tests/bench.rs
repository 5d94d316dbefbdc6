//! `bench --json` as the contract has it, at a size that takes seconds.
use serde_json::Value;
use std::process::Command;

/// Names in the order of the contract, with the paper's means.
const ROWS: [(&str, f64); 10] = [
    ("haptic step", 0.45),
    ("main step", 4.33),
    ("collision query", 0.43),
    ("collision update", 2.20),
    ("visual update", 0.24),
    ("csg render", 1.81),
    ("propagation step", 9.45),
    ("crack propagation", 7.85),
    ("linearisation", 65.92),
    ("factorisation", 8.41),
];

fn number(value: &Value, key: &str) -> f64 {
    let number = value[key].as_f64();
    number.unwrap_or_else(|| panic!("no number {key} in {value}"))
}

/// A row has exactly the fields of the contract, and figures that belong to one distribution.
fn check_row(row: &Value, (name, paper): (&str, f64)) {
    assert_eq!(row["name"], name);
    assert_eq!(number(row, "paper_mean_ms"), paper);
    let [mean, sd, min, p99, max] =
        ["mean_ms", "sd_ms", "min_ms", "p99_ms", "max_ms"].map(|k| number(row, k));
    assert!(0.0 <= min && min <= mean && mean <= max && min <= p99 && p99 <= max && sd >= 0.0);
    let fields = row.as_object().expect("an object").len();
    let has_baseline = row.get("baseline").is_some();
    assert_eq!(fields, if has_baseline { 10 } else { 7 }, "{row}");
    if has_baseline {
        assert!(row["baseline"].as_str().is_some_and(|w| !w.is_empty()));
        assert!(number(row, "baseline_ms") > 0.0 && number(row, "ratio") > 0.0);
    }
}

/// A whole split, so that every baseline is tried, and its result found equal to ours: else the exit code is 1.
#[test]
fn the_shipped_split_gives_the_document_of_the_contract() {
    let output = Command::new(env!("CARGO_BIN_EXE_osteotome"))
        .args("bench --json --nodes 600 --points 5000".split(' '))
        .output()
        .expect("the program starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{error}");
    let document: Value = serde_json::from_slice(&output.stdout).expect("JSON alone");
    assert_eq!(document["schema"], "osteotome.bench/1");
    assert_eq!(document.as_object().expect("an object").len(), 4);
    let sizes = &document["sizes"];
    let [nodes, tets, points, faces] =
        ["nodes", "tets", "points", "faces"].map(|k| number(sizes, k));
    assert!((400.0..900.0).contains(&nodes) && tets > nodes, "{sizes}");
    assert!((4000.0..12_000.0).contains(&points), "{sizes}");
    assert!((10_000.0..40_000.0).contains(&faces), "{sizes}");
    let rows = document["rows"].as_array().expect("a list");
    assert_eq!(rows.len(), ROWS.len());
    rows.iter().zip(ROWS).for_each(|(r, e)| check_row(r, e));
    let with_baseline = rows.iter().filter(|r| r.get("baseline").is_some());
    let with_baseline: Vec<&str> = with_baseline.filter_map(|r| r["name"].as_str()).collect();
    assert_eq!(
        with_baseline,
        [
            "haptic step",
            "main step",
            "collision query",
            "collision update",
            "visual update",
            "linearisation",
            "factorisation"
        ]
    );
    let rates = &document["rates_hz"];
    assert_eq!(rates.as_object().expect("an object").len(), 3);
    for of in ["haptic", "main", "propagation"] {
        assert!(number(rates, of) > 0.0, "{rates}");
    }
}

#[test]
fn wrong_input_is_named() {
    let refused = |args: &str, part: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_osteotome"))
            .args(args.split(' '))
            .output()
            .expect("the program starts");
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args}: {error}");
        assert_eq!(error.lines().count(), 1, "{args}: {error}");
        assert!(error.contains(part), "'{part}' is not in: {error}");
    };
    refused("bench --recording none.mcap", "none.mcap: No such file");
    refused("bench --nodes 5", "100..=200000");
    refused("bench --points many", "--points");
    refused("bench --max-time 0", "above 0");
}
