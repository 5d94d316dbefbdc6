use super::bone::{Bone, BoneState};
use crate::crack::growth::advances;
use crate::crack::{BodyError, EvaluatedFront, Front, bridging_edges};
use crate::geometry::Vec3;

/// How the propagation step behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PropagationSettings {
    /// The last ligament is tried as a whole once at most this many mesh edges still hold the two ends together.
    pub ligament_edges: usize,
}

impl Default for PropagationSettings {
    fn default() -> Self {
        Self { ligament_edges: 12 }
    }
}

/// One point of a crack front, for recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontPoint {
    /// Position \[mm\].
    pub position: Vec3,
    /// K_I, K_II, K_III \[MPa sqrt(mm)\].
    pub k: [f64; 3],
    /// Energy release rate \[N/mm\].
    pub g: f64,
    /// Largest G(theta) / G_c(theta) after smoothing along the front.
    pub drive: f64,
    /// Preferred kink \[rad\].
    pub angle: f64,
    /// Advance in this step \[mm\].
    pub advance: f64,
    /// Whether it lies inside the body.
    pub inside: bool,
}

/// What a propagation step found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GrowthReport {
    /// The fronts before growth.
    pub fronts: Vec<Vec<FrontPoint>>,
    /// Largest drive of all.
    pub strongest: f64,
    /// Whether any front advanced.
    pub advanced: bool,
    /// Whether the last ligament was torn as a whole: its edges, and its energy release rate over its toughness.
    pub ligament: Option<(usize, f64)>,
}

/// Share of the least toughness from which a station's K are looked at: no kink raises G by more than half (pure sliding,
/// 1.52 times), so no other station can grow, not even after smoothing with its neighbours.
const K_FROM: f64 = 0.3;

/// Checks MSERRC on a state of the bone and grows the crack by one increment where it is met (paper, section 3.1 step 3).
///
/// Returns the next generation, or none if the crack rests. `state` must belong to `bone`.
///
/// # Errors
/// [`BodyError::Factor`] if the grown bone cannot be factored; the old one stays valid.
pub fn propagation_step(
    bone: &Bone,
    state: &BoneState,
    settings: &PropagationSettings,
) -> Result<(Option<Bone>, GrowthReport), BodyError> {
    let body = &bone.body;
    let mut report = GrowthReport::default();
    let evaluated = bone.evaluate_fronts(&state.x, &state.loads, K_FROM);
    let mut moving: Vec<(&Front, Vec<Vec3>)> = Vec::new();
    for EvaluatedFront { front, stations } in &evaluated {
        let (drives, moves) = advances(stations, front.closed, &body.lengths);
        report.fronts.push(
            stations
                .iter()
                .zip(drives.iter().zip(&moves))
                .map(|(s, (d, m))| FrontPoint {
                    position: s.position,
                    k: [s.k.k1, s.k.k2, s.k.k3],
                    g: s.g,
                    drive: d.ratio,
                    angle: d.kink,
                    advance: m.norm(),
                    inside: s.inside > 0.5,
                })
                .collect(),
        );
        report.strongest = drives
            .iter()
            .map(|d| d.ratio)
            .fold(report.strongest, f64::max);
        if moves.iter().any(|m| *m != Vec3::zeros()) {
            moving.push((front, moves));
        }
    }
    report.advanced = !moving.is_empty();
    let moving: Vec<_> = moving.iter().map(|(f, m)| (*f, m.as_slice())).collect();
    let mut growth = bone.advanced(&moving);
    if !report.advanced
        && let Some((edges, ratio)) = ligament(bone, state, settings)?
    {
        report.ligament = Some((edges.len(), ratio));
        if ratio >= 1.0 {
            growth.tear(&body.mesh, &edges);
            report.advanced = true;
        }
    }
    if !report.advanced {
        return Ok((None, report));
    }
    let next = Bone::assemble(
        bone.generation + 1,
        body.clone(),
        bone.cracked.grown(growth)?,
        bone.points.clone(),
        bone.walled.clone(),
    );
    Ok((Some(next), report))
}

/// Largest area that tears as a whole, in squared element sizes: about that of the integrals' domain.
const LARGEST_LIGAMENT: f64 = 4.0;

/// The last ligament between the ends, and its energy release rate over its toughness if it tears as a whole.
///
/// A ligament of a few edges is smaller than the domain of any integral. Its release is computed by finite fracture: cut it,
/// solve again, and take the elastic energy that a held load gives up, U (1 - C / C') for compliances C and C' before and
/// after: the least that any way of loading can release. Divided by its area it is compared with the mean toughness.
fn ligament(
    bone: &Bone,
    state: &BoneState,
    settings: &PropagationSettings,
) -> Result<Option<(Vec<u32>, f64)>, BodyError> {
    let body = &bone.body;
    let [source, sink] = &body.ends;
    let Some(edges) = bridging_edges(
        &body.mesh,
        &bone.cuts,
        source,
        sink,
        settings.ligament_edges,
    ) else {
        return Ok(None);
    };
    if edges.is_empty() || state.loads.is_empty() {
        return Ok(None);
    }
    let mut growth = bone.advanced(&[]);
    growth.tear(&body.mesh, &edges);
    let torn = Bone::assemble(
        bone.generation,
        body.clone(),
        bone.cracked.grown(growth)?,
        Vec::new(),
        bone.walled.clone(),
    );
    let work = |b: &Bone| {
        let mut x = vec![0.0; b.system.n()];
        b.add_loads(&b.carry_loads(bone, &state.loads), &mut x);
        let f = x.clone();
        b.system.solve(&mut x, &mut b.system.scratch());
        f.iter().zip(&x).map(|(f, x)| f * x).sum::<f64>()
    };
    let area = torn.crack_area() - bone.crack_area();
    // Whatever is larger than the domain of the integrals is a crack front's business, not a ligament's.
    let h = body.lengths.h;
    if !(0.0..LARGEST_LIGAMENT * h * h).contains(&area) {
        return Ok(None);
    }
    let (before, after) = (work(bone), work(&torn));
    let area = area.max(1e-3 * h * h);
    let toughness =
        edges.iter().map(|&e| edge_toughness(bone, e)).sum::<f64>() / edges.len() as f64;
    let released = if after > before {
        0.5 * before * (1.0 - before / after)
    } else {
        0.0
    };
    Ok(Some((edges, released / area / toughness)))
}

fn edge_toughness(bone: &Bone, e: u32) -> f64 {
    let mesh = &bone.body.mesh;
    let [a, _] = mesh.edges()[e as usize];
    let along = mesh.edge_vector(&mesh.edges()[e as usize]).normalize();
    let holders = mesh
        .tets_of_node(a as usize)
        .iter()
        .filter(|&&t| mesh.tet_edges()[t as usize].contains(&e));
    let values: Vec<f64> = holders
        .map(|&t| bone.body.materials[t as usize].toughness(&along))
        .collect();
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
