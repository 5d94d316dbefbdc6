//! Griffith's balance of the whole body: a growth happens if the elastic energy that it releases pays for its faces.
//!
//! The integrals that drive the fronts are good to some per cent on a smooth front far from others, but not where chisels
//! press beside it or fronts close in on each other; the balance is the guard against both.
use super::bone::BoneState;
use crate::crack::stress_intensity::CellForce;
use crate::crack::{BodyError, CrackedBody, Front, Growth};
use crate::geometry::Vec3;
use std::cell::Cell;

/// A cut of next to no area still has to be torn by something \[N mm\].
const LEAST_COST: f64 = 1e-3;

/// A body at rest under loads, about to grow.
pub(super) struct Balance<'a> {
    body: &'a CrackedBody,
    state: &'a BoneState,
    /// Largest ratio of energy released to energy needed.
    best: Cell<f64>,
    /// Largest energy needed \[N mm\].
    dearest: Cell<f64>,
}

/// A growth that was tried.
pub(super) struct Trial {
    /// The grown body.
    pub body: CrackedBody,
    /// Energy released over energy needed; growth from 1 on.
    pub ratio: f64,
    /// Effective area of the new faces \[mm2\].
    pub area: f64,
    /// Energy released over what is needed \[N mm\].
    pub gain: f64,
    /// Whether something that is pressed on crumbles off.
    pub crumbles: bool,
}

impl<'a> Balance<'a> {
    pub fn new(body: &'a CrackedBody, state: &'a BoneState) -> Self {
        Self {
            body,
            state,
            best: Cell::new(0.0),
            dearest: Cell::new(LEAST_COST),
        }
    }

    /// Of all growths weighed under which nothing crumbles off, the largest ratio of energy released to energy needed.
    pub fn best(&self) -> f64 {
        self.best.get()
    }

    /// For how many of the growths weighed, the dearest of them, the elastic energy of the body would pay.
    pub fn reserve(&self) -> f64 {
        self.state.strain_energy / self.dearest.get()
    }

    /// Tries a growth; none if it cuts nothing.
    pub fn weigh(&self, growth: Growth) -> Result<Option<Trial>, BodyError> {
        let newly_cut = growth.newly_cut.clone();
        if newly_cut.is_empty() {
            return Ok(None);
        }
        let body = self.body.grown(growth)?;
        let (area, cost) = body.cost(self.body, &newly_cut);
        let (released, crumbles) = self.released(&body);
        let (ratio, gain) = (released / cost.max(LEAST_COST), released - cost);
        self.dearest.set(self.dearest.get().max(cost));
        if !crumbles {
            self.best.set(self.best.get().max(ratio));
        }
        Ok(Some(Trial {
            body,
            ratio,
            area,
            gain,
            crumbles,
        }))
    }

    /// What a held load gives up, U (1 - C / C') for compliances C and C' before and after: less than what is set free if the forces
    /// stay, and all of U at most. Loads on what crumbles off give up all that they had stored; says whether there are any.
    fn released(&self, grown: &CrackedBody) -> (f64, bool) {
        let (body, loads) = (self.body, &self.state.loads);
        let carried = grown.carry_loads(body, loads);
        let stays = |l: &&CellForce| !grown.is_debris(l.cell);
        let staying: Vec<CellForce> = carried.iter().filter(stays).copied().collect();
        let part = |whole: f64, more: f64| {
            if more > 0.0 {
                more * whole / (whole + more)
            } else {
                0.0
            }
        };
        let crumbles = staying.len() < carried.len();
        if !crumbles {
            let (mesh, topology) = (&body.solid.mesh, &grown.topology);
            let (x, forces) = (&self.state.x, grown.sparse_loads(&staying));
            let more = (grown.system).released(&body.system, mesh, topology, x, &forces);
            if let Some(more) = more {
                return (part(self.state.strain_energy, more), false);
            }
        }
        let kept = loads.iter().zip(&carried).filter(|(_, c)| stays(c));
        let kept: Vec<CellForce> = kept.map(|(l, _)| *l).collect();
        let [all, before, after] =
            [body.work(loads), body.work(&kept), grown.work(&staying)].map(|work| 0.5 * work);
        let released = all - before + part(before, after - before);
        (released.min(self.state.strain_energy), crumbles)
    }

    /// The affordable growth of a stretch of front: as a whole or, if the energy does not suffice, only where it is driven
    /// hardest.
    pub fn advance(&self, front: &Front, moves: &[Vec3]) -> Result<Option<Trial>, BodyError> {
        self.first_paid(front, parts(moves))
    }

    /// What of a stretch that cannot pay as it would move can pay by itself: the stretch moved as far as if no other front were
    /// driven harder, or as if no vertex of it were driven harder than half of its vertices are, or a short piece of it in which some
    /// vertex moves by `least` or more.
    pub fn advance_some(
        &self,
        front: &Front,
        moves: &[Vec3],
        least: f64,
    ) -> Result<Option<Trial>, BodyError> {
        let increment = self.body.solid.lengths.increment;
        let farthest = longest(moves);
        let alone = (farthest < 0.9 * increment).then(|| scaled(moves, increment / farthest));
        let alone = alone.map(|moves| parts(&moves)).unwrap_or_default();
        let pieces = alone.into_iter().chain(levelled(moves, increment));
        self.first_paid(front, pieces.chain(self.windows(moves, least)))
    }

    /// A stretch of front that is about to meet another sheet, moved there as a whole or, if that does not pay, in pieces.
    pub fn join(&self, front: &Front, ways: &[Vec3]) -> Result<Option<Trial>, BodyError> {
        let places: Vec<usize> = (0..ways.len())
            .filter(|&k| ways[k] != Vec3::zeros())
            .collect();
        let piece = |part: &[usize]| {
            let mut moves = vec![Vec3::zeros(); ways.len()];
            part.iter().for_each(|&k| moves[k] = ways[k]);
            moves
        };
        let pieces = places.chunks(PIECE).filter(|p| p.len() < places.len());
        self.first_paid(
            front,
            std::iter::once(ways.to_vec()).chain(pieces.map(piece)),
        )
    }

    /// Of several ways for a front, the one that gains most, unless something under a tool crumbles off; none if none pays.
    pub fn best_way(
        &self,
        front: &Front,
        ways: impl IntoIterator<Item = Vec<Vec3>>,
    ) -> Result<Option<Trial>, BodyError> {
        let mut best: Option<Trial> = None;
        for moves in ways {
            let trial = self.weigh(self.body.advanced(&[(front, &moves)]))?;
            let paid = trial.filter(|t| t.ratio >= 1.0 && !t.crumbles);
            best = most_gaining(best, paid);
        }
        Ok(best)
    }

    fn first_paid(
        &self,
        front: &Front,
        growths: impl IntoIterator<Item = Vec<Vec3>>,
    ) -> Result<Option<Trial>, BodyError> {
        for moves in growths {
            let mut trial = self.weigh(self.body.advanced(&[(front, &moves)]))?;
            if trial.is_none()
                && let Some(moves) = self.through_an_element(front, &moves)
            {
                trial = self.weigh(self.body.advanced(&[(front, &moves)]))?;
            }
            if let Some(paid) = trial.filter(|t| t.ratio >= 1.0) {
                return Ok(Some(paid));
            }
        }
        Ok(None)
    }

    /// Moves that are short against the element in which the front moves farthest, made as long as it is: away from the line a graded
    /// mesh has elements that no increment would ever cut.
    fn through_an_element(&self, front: &Front, moves: &[Vec3]) -> Option<Vec<Vec3>> {
        const SHORT: f64 = 0.5;
        let solid = &self.body.solid;
        let farthest = longest(moves);
        let place = moves.iter().position(|m| m.norm() == farthest)?;
        let vertices = &self.body.crack.sheets[front.sheet].mesh.vertices;
        let position = vertices[front.vertices[place] as usize];
        let (tet, _) = solid
            .locator
            .find_near(&solid.mesh, &position, solid.lengths.h)?;
        let size = solid
            .mesh
            .mean_length(&solid.mesh.tet_edges()[tet as usize]);
        (farthest < SHORT * size).then(|| scaled(moves, size / farthest))
    }

    /// Short pieces of a stretch, each moved as far as if it were alone, hardest driven first.
    fn windows(&self, moves: &[Vec3], least: f64) -> Vec<Vec<Vec3>> {
        let Some(last) = moves.len().checked_sub(WINDOW) else {
            return Vec::new();
        };
        let starts = (0..last).step_by(WINDOW - 1).chain([last]);
        let mut windows: Vec<(f64, usize)> = starts
            .map(|first| (first, &moves[first..first + WINDOW]))
            .filter(|(_, window)| longest(window) >= least)
            .map(|(first, window)| (window.iter().map(Vec3::norm).sum(), first))
            .collect();
        windows.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let alone = |(_, first): (f64, usize)| {
            let places = first..first + WINDOW;
            let farthest = longest(&moves[places.clone()]);
            let scale = self.body.solid.lengths.increment / farthest;
            let mut part = vec![Vec3::zeros(); moves.len()];
            part[places.clone()].copy_from_slice(&scaled(&moves[places], scale));
            part
        };
        windows.into_iter().take(MOST_WINDOWS).map(alone).collect()
    }
}

/// The one of two trials that gains more.
pub(super) fn most_gaining(one: Option<Trial>, other: Option<Trial>) -> Option<Trial> {
    let gain = |t: &Option<Trial>| t.as_ref().map_or(f64::NEG_INFINITY, |t| t.gain);
    if gain(&other) > gain(&one) {
        other
    } else {
        one
    }
}

/// Vertices of a front that meet another sheet together.
const PIECE: usize = 4;
/// Vertices of a front that are tried by themselves: some four element sizes.
const WINDOW: usize = 9;
/// So many windows of a stretch are tried.
const MOST_WINDOWS: usize = 8;

/// A stretch as a whole, and what of it moves at least so far relative to the farthest.
fn parts(moves: &[Vec3]) -> Vec<Vec<Vec3>> {
    const LEAST: [f64; 3] = [0.0, 0.5, 0.8];
    let farthest = longest(moves);
    let mut parts = Vec::new();
    let mut tried = usize::MAX;
    for least in LEAST {
        let is_part = |m: &Vec3| m.norm() > 0.0 && m.norm() >= least * farthest;
        let n = moves.iter().filter(|m| is_part(m)).count();
        if n != std::mem::replace(&mut tried, n) {
            let kept = |m: &Vec3| if is_part(m) { *m } else { Vec3::zeros() };
            parts.push(moves.iter().map(kept).collect());
        }
    }
    parts
}

/// Half of the moving vertices move by the increment, the others in proportion to how hard they are driven. Beside a chisel one vertex
/// may be driven ten times as hard as all others, which then hardly move. None where that changes little.
fn levelled(moves: &[Vec3], increment: f64) -> Option<Vec<Vec3>> {
    const UNLIKE: f64 = 0.7;
    let mut lengths: Vec<f64> = moves.iter().map(Vec3::norm).filter(|l| *l > 0.0).collect();
    lengths.sort_by(f64::total_cmp);
    let median = *lengths.get(lengths.len() / 2)?;
    let level = |m: &Vec3| m.cap_magnitude(median) * (increment / median);
    (median < UNLIKE * longest(moves)).then(|| moves.iter().map(level).collect())
}

fn scaled(moves: &[Vec3], by: f64) -> Vec<Vec3> {
    moves.iter().map(|m| m * by).collect()
}

pub(super) fn longest(moves: &[Vec3]) -> f64 {
    moves.iter().map(Vec3::norm).fold(0.0, f64::max)
}
