//! `result.json`.
use super::study::State;
use anyhow::Result;
use osteotome_mechanics::crack::stress_intensity::Station;
use osteotome_mechanics::crack::{CrackedBody, load_control};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// The whole document, step by step. All of a step is at its load factor.
#[derive(Debug, Serialize)]
pub struct Outcome {
    schema: &'static str,
    nodes: usize,
    tets: usize,
    enriched_nodes: usize,
    /// That of step 0 \[N mm\].
    strain_energy: f64,
    steps: Vec<Step>,
    /// Why the crack stopped before the last step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped: Option<String>,
    /// Where the time went.
    #[serde(rename = "timing_ms")]
    pub timing: Timing,
}

#[derive(Debug, Serialize)]
struct Step {
    step: usize,
    load_factor: f64,
    strain_energy: f64,
    crack_area: f64,
    effective_area: f64,
    fronts: Vec<Vec<FrontVertex>>,
    fragments: usize,
}

#[derive(Debug, Serialize)]
struct FrontVertex {
    position: [f64; 3],
    normal: [f64; 3],
    advance: [f64; 3],
    /// Only inside the body.
    #[serde(rename = "K", skip_serializing_if = "Option::is_none")]
    k: Option<[f64; 3]>,
    #[serde(rename = "G")]
    g: f64,
    kink_deg: f64,
    twist_deg: f64,
    advanced_mm: f64,
    inside: bool,
}

/// Milliseconds by what they went into.
#[derive(Debug, Default, Serialize)]
pub struct Timing(BTreeMap<&'static str, f64>);

impl Timing {
    /// Adds the time since `begin`.
    pub fn add(&mut self, what: &'static str, begin: Instant) {
        *self.0.entry(what).or_default() += begin.elapsed().as_secs_f64() * 1e3;
    }
}

impl Outcome {
    /// A study that begins.
    pub fn new(body: &CrackedBody) -> Self {
        let mut enriched = body.topology.enriched_nodes().to_vec();
        enriched.sort_unstable();
        enriched.dedup();
        Self {
            schema: "osteotome.fracture/1",
            nodes: body.solid.mesh.nodes().len(),
            tets: body.solid.mesh.tets().len(),
            enriched_nodes: enriched.len(),
            strain_energy: 0.0,
            steps: Vec::new(),
            stopped: None,
            timing: Timing::default(),
        }
    }

    /// Adds a step.
    pub fn push(&mut self, body: &CrackedBody, state: &State) {
        let factor = state.load_factor;
        let strain_energy = body.system.energy(&state.x) * factor * factor;
        if self.steps.is_empty() {
            self.strain_energy = strain_energy;
        }
        let vertex = |f: usize, v: usize, s: &Station| {
            let drive = state.drives.raw[f][v];
            let advanced = state.moves.get(f).map_or(0.0, |m| m[v].norm());
            front_vertex(body, s, drive.kink, advanced, factor)
        };
        let fronts = state.fronts.iter().enumerate().map(|(f, front)| {
            let stations = front.stations.iter().enumerate();
            stations.map(|(v, s)| vertex(f, v, s)).collect()
        });
        self.steps.push(Step {
            step: self.steps.len(),
            load_factor: factor,
            strain_energy,
            crack_area: body.explicit_area(),
            effective_area: body.effective_area(),
            fronts: fronts.collect(),
            fragments: body.fragments.count(),
        });
    }

    /// As text.
    ///
    /// # Errors
    /// If a number cannot be written.
    pub fn json(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    /// For people.
    pub fn summary(&self) -> String {
        let mut lines = vec![format!(
            "{} nodes, {} tetrahedra, {} enriched nodes.",
            self.nodes, self.tets, self.enriched_nodes
        )];
        for s in &self.steps {
            let inside = || s.fronts.iter().flatten().filter(|v| v.inside);
            let largest = inside().map(|v| v.g).fold(0.0, f64::max);
            let k1 = inside().filter_map(|v| v.k).map(|k| k[0]);
            let front = if inside().count() == 0 {
                "no front inside".to_owned()
            } else {
                format!(
                    "largest G {largest:.4} N/mm, largest K_I {:.4} MPa sqrt(mm)",
                    k1.fold(f64::NEG_INFINITY, f64::max)
                )
            };
            lines.push(format!(
                "Step {}: load factor {:.4}, strain energy {:.6} N mm, crack {:.3} mm2, {front}, {} fragment(s).",
                s.step, s.load_factor, s.strain_energy, s.crack_area, s.fragments
            ));
        }
        lines.extend(self.stopped.iter().map(|s| format!("Stopped: {s}.")));
        lines.join("\n")
    }
}

fn front_vertex(
    body: &CrackedBody,
    s: &Station,
    kink: f64,
    advanced: f64,
    factor: f64,
) -> FrontVertex {
    let solid = &body.solid;
    // A vertex on a face of the body is inside.
    let margin = 1e-6 * solid.lengths.h;
    let at = solid.locator.find_near(&solid.mesh, &s.position, margin);
    let inside = at.is_some() && s.is_trusted();
    FrontVertex {
        position: s.position.into(),
        normal: s.normal.into(),
        advance: s.advance.into(),
        k: inside.then(|| [s.k.k1, s.k.k2, s.k.k3].map(|k| k * factor)),
        g: s.g * factor * factor,
        kink_deg: if inside { kink.to_degrees() } else { 0.0 },
        twist_deg: if inside {
            load_control::twist(&s.k, kink).to_degrees()
        } else {
            0.0
        },
        advanced_mm: advanced,
        inside,
    }
}
