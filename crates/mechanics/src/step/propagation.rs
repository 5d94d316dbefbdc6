use super::bone::{Bone, BoneState};
use crate::crack::growth::{Drive, advances, drives};
use crate::crack::stress_intensity::{CellForce, Station};
use crate::crack::{BodyError, CrackedBody, EvaluatedFront, Front, Growth, bridging_edges};
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

impl FrontPoint {
    fn new(station: &Station, drive: &Drive, advance: &Vec3) -> Self {
        Self {
            position: station.position,
            k: [station.k.k1, station.k.k2, station.k.k3],
            g: station.g,
            drive: drive.ratio,
            angle: drive.kink,
            advance: advance.norm(),
            inside: station.inside > 0.5,
        }
    }
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
    let lengths = &body.lengths;
    let driven: Vec<(&EvaluatedFront, Vec<Drive>)> = evaluated
        .iter()
        .map(|e| (e, drives(&e.stations, e.front.closed, lengths)))
        .collect();
    report.strongest =
        (driven.iter().flat_map(|(_, drives)| drives)).fold(0.0, |most, d| d.ratio.max(most));
    let mut moving: Vec<(&Front, Vec<Vec3>)> = Vec::new();
    for (EvaluatedFront { front, stations }, drives) in &driven {
        let moves = advances(stations, drives, report.strongest, lengths);
        let points = stations.iter().zip(drives).zip(&moves);
        let points = points.map(|((s, d), m)| FrontPoint::new(s, d, m));
        report.fronts.push(points.collect());
        if moves.iter().any(|m| *m != Vec3::zeros()) {
            moving.push((front, moves));
        }
    }
    let mut grown: Option<(f64, CrackedBody)> = None;
    for (front, moves) in stretches(&moving) {
        if let Some((ratio, next)) = advance_affordably(&bone.cracked, front, &moves, &state.loads)?
            && grown.as_ref().is_none_or(|(best, _)| ratio > *best)
        {
            grown = Some((ratio, next));
        }
    }
    report.advanced = grown.is_some();
    if !report.advanced
        && let Some((torn, n_edges, ratio)) = ligament(bone, state, settings)?
    {
        report.ligament = Some((n_edges, ratio));
        if ratio >= 1.0 {
            grown = Some((ratio, torn));
            report.advanced = true;
        }
    }
    let Some((_, grown)) = grown else {
        return Ok((None, report));
    };
    let next = Bone::assemble(
        bone.generation + 1,
        body.clone(),
        grown,
        bone.points.clone(),
        bone.walled.clone(),
    );
    Ok((Some(next), report))
}

/// The moving stretches of all fronts, each by itself, the farthest advance first. The one that pays best advances; then the
/// tools and the bone come to rest anew before the next one does, as that load may be gone.
fn stretches<'a>(moving: &[(&'a Front, Vec<Vec3>)]) -> Vec<(&'a Front, Vec<Vec3>)> {
    let mut found = Vec::new();
    for (front, moves) in moving {
        let mut start = 0;
        for stretch in moves.chunk_by(|a, b| (*a == Vec3::zeros()) == (*b == Vec3::zeros())) {
            let places = start..start + stretch.len();
            start = places.end;
            let farthest = stretch.iter().map(Vec3::norm).fold(0.0, f64::max);
            if farthest > 0.0 {
                let mut alone = vec![Vec3::zeros(); moves.len()];
                alone[places].copy_from_slice(stretch);
                found.push((farthest, *front, alone));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, f, m)| (f, m)).collect()
}

/// The body after a stretch has advanced, as a whole or, if the energy does not suffice, only where it is driven hardest.
fn advance_affordably(
    body: &CrackedBody,
    front: &Front,
    moves: &[Vec3],
    loads: &[CellForce],
) -> Result<Option<(f64, CrackedBody)>, BodyError> {
    /// Parts of a stretch that are tried, by their least advance relative to the largest.
    const PARTS: [f64; 3] = [0.0, 0.5, 0.8];
    let farthest = moves.iter().map(Vec3::norm).fold(0.0, f64::max);
    for least in PARTS {
        let hardest = |m: &Vec3| {
            if m.norm() < least * farthest {
                Vec3::zeros()
            } else {
                *m
            }
        };
        let part: Vec<Vec3> = moves.iter().map(hardest).collect();
        let paid = pay(body, body.advanced(&[(front, &part)]), loads)?;
        if paid.is_some() {
            return Ok(paid);
        }
    }
    Ok(None)
}

/// The grown body, if the elastic energy that the growth releases pays for its faces (Griffith's balance over a finite step),
/// and how many times over.
///
/// The integrals that drive the fronts are good to some per cent on a smooth front far from others, but not where chisels
/// press beside it or fronts close in on each other; the balance of the whole body is the guard against both. A growth that
/// cuts nothing is none.
fn pay(
    before: &CrackedBody,
    growth: Growth,
    loads: &[CellForce],
) -> Result<Option<(f64, CrackedBody)>, BodyError> {
    let newly_cut = growth.newly_cut.clone();
    if newly_cut.is_empty() {
        return Ok(None);
    }
    let after = before.grown(growth)?;
    let (_, cost) = after.cost(before, &newly_cut);
    let ratio = released(before, &after, loads) / cost.max(LEAST_COST);
    Ok((ratio >= 1.0).then_some((ratio, after)))
}

/// A cut of next to no area still has to be torn by something \[N mm\].
const LEAST_COST: f64 = 1e-3;

/// Elastic energy \[N mm\] that growth releases while what loads the body is held: U (1 - C / C') for its compliances C and
/// C' before and after, the least that any way of loading can release. `loads` act on `before`.
fn released(before: &CrackedBody, after: &CrackedBody, loads: &[CellForce]) -> f64 {
    let was = before.work(loads);
    let is = after.work(&after.carry_loads(before, loads));
    if is > was {
        0.5 * was * (1.0 - was / is)
    } else {
        0.0
    }
}

/// Largest area that tears as a whole, in squared element sizes: about that of the integrals' domain.
const LARGEST_LIGAMENT: f64 = 4.0;

/// The body without its last ligament, that ligament's edges, and its energy release rate over its toughness if it tears as a
/// whole.
///
/// A ligament of a few edges is smaller than the domain of any integral: its release is computed by finite fracture.
fn ligament(
    bone: &Bone,
    state: &BoneState,
    settings: &PropagationSettings,
) -> Result<Option<(CrackedBody, usize, f64)>, BodyError> {
    let body = &bone.body;
    let [source, sink] = &body.ends;
    let limit = settings.ligament_edges;
    let bridging = bridging_edges(&body.mesh, &bone.cuts, source, sink, limit);
    let Some(edges) = bridging.filter(|e| !e.is_empty() && !state.loads.is_empty()) else {
        return Ok(None);
    };
    let mut growth = bone.advanced(&[]);
    growth.tear(&body.mesh, &edges);
    let newly_cut = growth.newly_cut.clone();
    let torn = bone.cracked.grown(growth)?;
    let (area, cost) = torn.cost(&bone.cracked, &newly_cut);
    // Whatever is larger than the domain of the integrals is a crack front's business, not a ligament's.
    let h = body.lengths.h;
    if area > LARGEST_LIGAMENT * h * h {
        return Ok(None);
    }
    let ratio = released(&bone.cracked, &torn, &state.loads) / cost.max(LEAST_COST);
    Ok(Some((torn, edges.len(), ratio)))
}
