use super::balance::{Balance, Trial, longest};
use super::bone::{Bone, BoneState};
use super::{ligament, meeting, search};
use crate::crack::growth::Drive;
use crate::crack::load_control::FrontDrives;
use crate::crack::stress_intensity::Station;
use crate::crack::{BodyError, EvaluatedFront, Front};
use crate::geometry::Vec3;

/// How the propagation step behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PropagationSettings {
    /// Ligaments are sought once at most so many mesh edges still hold the two ends together,
    pub ligament_edges: usize,
    /// or this share of all the mesh's edges, whichever is more.
    pub ligament_share: f64,
}

impl Default for PropagationSettings {
    fn default() -> Self {
        Self {
            ligament_edges: 12,
            ligament_share: 0.0025,
        }
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
    /// Under what the crack rests, if growths were tried and none paid.
    pub rest: Option<Rest>,
    /// The ligament that came nearest to tearing as a whole: its edges, and its energy release rate over its toughness.
    pub ligament: Option<(usize, f64)>,
}

/// A load under which growths were tried and none paid.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// Largest drive of each front.
    drives: Vec<f64>,
    /// Elastic energy \[N mm\].
    energy: f64,
    /// Largest ratio of energy released to energy needed.
    ratio: f64,
}

impl Rest {
    fn new(drives: &FrontDrives, state: &BoneState) -> Self {
        let largest = |f: &Vec<Drive>| f.iter().fold(0.0, |most: f64, d| d.ratio.max(most));
        Self {
            drives: drives.smooth.iter().map(largest).collect(),
            energy: state.strain_energy,
            ratio: 0.0,
        }
    }

    /// Whether nothing pays under `now` either: what a growth releases goes with the square of the load, as drives and energy do, so
    /// neither may have risen by what the best growth lacked, and no front may have come to be driven.
    fn holds(&self, now: &Self) -> bool {
        /// Less than one, and never many times the load: its pattern may have changed as well.
        const MARGIN: f64 = 0.8;
        const LEAST: f64 = 0.5;
        let is_driven = |drive: &f64| *drive >= 1.0;
        let rise = |(then, now): (&f64, &f64)| match (is_driven(then), is_driven(now)) {
            (_, false) => 0.0,
            (false, true) => f64::INFINITY,
            (true, true) => now / then,
        };
        let fronts = self.drives.iter().zip(&now.drives).map(rise);
        let most = fronts.fold(now.energy / self.energy.max(1e-9), f64::max);
        self.drives.len() == now.drives.len() && self.ratio.max(LEAST) * most < MARGIN
    }
}

/// Share of the least toughness from which a station's K are looked at: no kink raises G by more than half (pure sliding,
/// 1.52 times), so no other station can grow, not even after smoothing with its neighbours.
const K_FROM: f64 = 0.3;

/// Checks MSERRC on a state of the bone and grows the crack by one increment where it is met (paper, section 3.1 step 3) and
/// pays for itself.
///
/// Returns the next generation, or none if the crack rests. `state` must belong to `bone`, and `rested`, where it was last found to rest,
/// to the same generation: then nothing is tried until the load has risen.
///
/// # Errors
/// [`BodyError::Factor`] if the grown bone cannot be factored; the old one stays valid.
pub fn propagation_step(
    bone: &Bone,
    state: &BoneState,
    settings: &PropagationSettings,
    rested: Option<&Rest>,
) -> Result<(Option<Bone>, GrowthReport), BodyError> {
    let body = &bone.body;
    let mut report = GrowthReport::default();
    let evaluated = bone.evaluate_fronts(&state.x, &state.loads, K_FROM);
    let lengths = &body.lengths;
    let drives = FrontDrives::new(&evaluated, lengths);
    report.strongest = drives.largest();
    // What moves is the whole front, in proportion to its drive, as soon as the balance pays for it: where only the hardest driven places
    // move, the front turns ragged, and the integrals along it go wrong.
    let is_driven = report.strongest >= 1.0;
    let moves = drives.moves(&evaluated, lengths, if is_driven { 0.0 } else { 1.0 });
    for ((e, drives), moves) in evaluated.iter().zip(&drives.smooth).zip(&moves) {
        let points = e.stations.iter().zip(drives).zip(moves);
        let points = points.map(|((s, d), m)| FrontPoint::new(s, d, m));
        report.fronts.push(points.collect());
    }
    let rest = Rest::new(&drives, state);
    if let Some(rested) = rested.filter(|r| r.holds(&rest)) {
        report.rest = Some(rested.clone());
        return Ok((None, report));
    }
    let balance = Balance::new(&bone.cracked, state);
    let driven = lengths.increment / drives.pace(&evaluated).max(1.0);
    let mut stretches = stretches(&evaluated, &moves);
    stretches.retain(|(_, moves)| longest(moves) >= driven);
    let mut best = best_of(&stretches, |front, moves| balance.advance(front, moves))?;
    if is_driven {
        let ways = meeting::ways(&evaluated, &bone.crack, lengths);
        let met = best_of(&self::stretches(&evaluated, &ways), |front, ways| {
            balance.join(front, ways)
        })?;
        let ratio = best.as_ref().map_or(0.0, |b| b.ratio);
        best = met.filter(|m| m.ratio > ratio).or(best);
    }
    // A ligament that would tear goes before a crack starts anew elsewhere.
    if best.is_none()
        && let Some((n_edges, torn)) = ligament::weakest(bone, &balance, settings)?
    {
        report.ligament = Some((n_edges, torn.ratio));
        best = Some(torn).filter(|t| t.ratio >= 1.0);
    }
    if best.is_none() {
        best = best_of(&stretches, |front, moves| {
            balance.advance_some(front, moves, driven)
        })?;
    }
    if best.is_none() && is_driven && search::is_due(&balance) {
        best = search::best(&balance, &evaluated, &drives, lengths)?;
    }
    let Some(Trial { body: grown, .. }) = best else {
        let ratio = balance.best();
        report.rest = Some(Rest { ratio, ..rest });
        return Ok((None, report));
    };
    report.advanced = true;
    let next = bone.grown(grown);
    Ok((Some(next), report))
}

/// Of what comes of the stretches, the growth that pays best. It alone is made; then tools and bone come to rest anew before the next
/// one is, as that load may be gone.
fn best_of(
    stretches: &[(&Front, Vec<Vec3>)],
    grow: impl Fn(&Front, &[Vec3]) -> Result<Option<Trial>, BodyError>,
) -> Result<Option<Trial>, BodyError> {
    let mut best: Option<Trial> = None;
    for (front, moves) in stretches {
        let ratio = best.as_ref().map_or(0.0, |b| b.ratio);
        best = grow(front, moves)?.filter(|t| t.ratio > ratio).or(best);
    }
    Ok(best)
}

/// The moving stretches of all fronts, each by itself.
fn stretches<'a>(fronts: &'a [EvaluatedFront], moves: &[Vec<Vec3>]) -> Vec<(&'a Front, Vec<Vec3>)> {
    let rests = |m: &Vec3| *m == Vec3::zeros();
    let mut found = Vec::new();
    for (e, moves) in fronts.iter().zip(moves) {
        let mut start = 0;
        for stretch in moves.chunk_by(|a, b| rests(a) == rests(b)) {
            let places = start..start + stretch.len();
            start = places.end;
            if !rests(&stretch[0]) {
                let mut alone = vec![Vec3::zeros(); moves.len()];
                alone[places].copy_from_slice(stretch);
                found.push((&e.front, alone));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crack_rests_until_the_load_has_risen_by_what_was_lacking() {
        let rest = |drives: &[f64], energy: f64, ratio: f64| Rest {
            drives: drives.to_vec(),
            energy,
            ratio,
        };
        let then = rest(&[2.0, 0.5], 10.0, 0.6);
        assert!(then.holds(&rest(&[2.4, 0.9], 12.0, 0.0)));
        for later in [
            rest(&[2.8, 0.5], 10.0, 0.0),
            rest(&[2.0, 1.1], 10.0, 0.0),
            rest(&[2.0, 0.5], 14.0, 0.0),
            rest(&[2.0], 10.0, 0.0),
        ] {
            assert!(!then.holds(&later), "{later:?}");
        }
        // Nothing was tried, as nothing was driven.
        assert!(!rest(&[0.9], 10.0, 0.0).holds(&rest(&[1.0], 12.0, 0.0)));
    }
}
