//! What `bench` says to people.
use super::Evaluation;
use super::probe::SIZE;
use super::rows::{Part, Row};

/// Table 1, baselines, rates.
pub fn text(e: &Evaluation) -> String {
    let s = &e.sizes;
    let [w, h] = SIZE;
    let split = match e.replayed.crack.as_ref().filter(|c| c.severed) {
        Some(c) => format!("split with {:.0} mm2 of new crack", c.area),
        None => "no split".to_owned(),
    };
    let mut lines = vec![
        format!(
            "{} nodes, {} tetrahedra, {} points, {} faces; {:.2} s of recorded hands, {split}.",
            s.nodes, s.tets, s.points, s.faces, e.replayed.seconds
        ),
        format!(
            "Times in ms, in lockstep on one thread; pictures of {w} x {h} drawn on {}. Paper: Knott and Kuhlen 2015, Table 1.",
            e.replayed.drawn_on
        ),
        String::new(),
        format!(
            "{:<18}{:>34}   {:>54}{:>11}",
            "", "paper: mean SD min max", "here: mean SD min median p99 max", "ratio"
        ),
    ];
    lines.extend(e.replayed.rows.iter().map(row));
    lines.push(String::new());
    lines.push(
        "Beside other methods in the same situations, results checked to be equal:".to_owned(),
    );
    lines.extend(e.replayed.rows.iter().flat_map(baselines));
    lines.extend(equations(&e.replayed.rows));
    lines.extend(recording(e));
    lines.push(String::new());
    let [haptic, main, propagation] = e.paced.hz();
    let missed = e.paced.pace.map(|p| p.missed);
    lines.push(format!(
        "In real time on three threads: haptic loop {haptic:.0} Hz ({} deadlines missed), main loop {main:.1} Hz ({} missed), propagation {propagation:.0} looks a second.",
        missed[0], missed[1]
    ));
    lines.extend(live_step(e));
    lines.push("The paper's Figure 6: haptic loop 1000 Hz, main loop 30 to 50 Hz.".to_owned());
    lines.join("\n")
}

/// The haptic step as it runs beside the other two loops.
fn live_step(e: &Evaluation) -> Option<String> {
    let t = e.paced.haptic_times.in_short()?;
    Some(format!(
        "There the haptic step takes {:.3} ms on average, {:.3} at the median, {:.3} at the 99th percentile, {:.3} at most.",
        t.mean, t.median, t.p99, t.max
    ))
}

/// What the recorder costs the haptic loop.
fn recording(e: &Evaluation) -> Option<String> {
    let ms = super::recording_cost::per_sample_ms(&e.paced.haptic)?;
    let steps = e
        .replayed
        .rows
        .iter()
        .find(|r| r.part == Part::HapticStep)?;
    let share = 100.0 * ms / steps.times.in_short()?.mean;
    Some(format!(
        "Recording a haptic step: {:.3} us more, {share:.2} % of it.",
        1e3 * ms
    ))
}

/// What the paper does after each growth, over what is done here.
fn equations(rows: &[Row]) -> Option<String> {
    let of = |part: Part| {
        let pairs = rows.iter().find(|r| r.part == part)?.baselines.first()?;
        let full = pairs.baseline_ms()?;
        Some([full, full / pairs.ratio()?])
    };
    let [a, b] = [of(Part::Linearisation)?, of(Part::Factorisation)?];
    let [full, ours] = [a[0] + b[0], a[1] + b[1]];
    let ratio = full / ours;
    Some(format!(
        "Linearisation and factorisation of a growth together: {ours:.3} ms, in full {full:.3} ms: {ratio:.1} times as long."
    ))
}

fn row(row: &Row) -> String {
    let name = row.part.name();
    let paper = row.part.paper();
    let Some(t) = row.times.in_short() else {
        return format!("{name:<18}  the recording never came to it");
    };
    let [m, sd, lo, hi] = paper;
    format!(
        "{name:<18}{m:>10.2}{sd:>8.2}{lo:>8.2}{hi:>8.2}   {:>9.3}{:>9.3}{:>9.4}{:>9.3}{:>9.3}{:>9.3}{:>10.1}x",
        t.mean,
        t.sd,
        t.min,
        t.median,
        t.p99,
        t.max,
        m / t.mean
    )
}

fn baselines(row: &Row) -> Vec<String> {
    let line = |b: &super::times::Pairs| {
        let (name, n) = (row.part.name(), b.len());
        let left_out = match b.n_left_out() {
            0 => String::new(),
            k => format!(", {k} left out: no common rest"),
        };
        match (b.baseline_ms(), b.ratio()) {
            (Some(ms), Some(ratio)) => Some(format!(
                "{name:<18}{ms:>10.3} ms, {ratio:>7.2} times ours: {} (n = {n}{left_out})",
                b.what,
            )),
            _ if b.n_left_out() > 0 => Some(format!("{name:<18}: {} (n = 0{left_out})", b.what)),
            _ => None,
        }
    };
    row.baselines.iter().filter_map(line).collect()
}
