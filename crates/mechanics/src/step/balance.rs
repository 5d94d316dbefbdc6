//! Griffith's balance of the whole body: a growth happens if the elastic energy that it releases pays for its faces.
//!
//! The integrals that drive the fronts are good to some per cent on a smooth front far from others, but not where chisels
//! press beside it or fronts close in on each other; the balance is the guard against both.
use crate::crack::stress_intensity::CellForce;
use crate::crack::{BodyError, CrackedBody, Front, Growth};
use crate::geometry::Vec3;

/// A cut of next to no area still has to be torn by something \[N mm\].
const LEAST_COST: f64 = 1e-3;

/// A body under loads, about to grow.
pub(super) struct Balance<'a> {
    body: &'a CrackedBody,
    loads: &'a [CellForce],
    /// f . u, twice the elastic energy \[N mm\].
    work: f64,
}

/// A growth that was tried.
pub(super) struct Trial {
    /// The grown body.
    pub body: CrackedBody,
    /// Energy released over energy needed; growth from 1 on.
    pub ratio: f64,
    /// Effective area of the new faces \[mm2\].
    pub area: f64,
}

impl<'a> Balance<'a> {
    pub fn new(body: &'a CrackedBody, loads: &'a [CellForce]) -> Self {
        Self {
            work: body.work(loads),
            body,
            loads,
        }
    }

    /// Tries a growth; none if it cuts nothing.
    ///
    /// Released is what a held load gives up, U (1 - C / C') for compliances C and C' before and after: the least that any way of
    /// loading can release.
    pub fn weigh(&self, growth: Growth) -> Result<Option<Trial>, BodyError> {
        let newly_cut = growth.newly_cut.clone();
        if newly_cut.is_empty() {
            return Ok(None);
        }
        let body = self.body.grown(growth)?;
        let (area, cost) = body.cost(self.body, &newly_cut);
        let work = body.work(&body.carry_loads(self.body, self.loads));
        let released = if work > self.work {
            0.5 * self.work * (1.0 - self.work / work)
        } else {
            0.0
        };
        let ratio = released / cost.max(LEAST_COST);
        Ok(Some(Trial { body, ratio, area }))
    }

    /// The affordable growth of a stretch of front: as a whole or, if the energy does not suffice, only where it is driven
    /// hardest.
    pub fn advance(&self, front: &Front, moves: &[Vec3]) -> Result<Option<Trial>, BodyError> {
        /// Parts of a stretch that are tried, by their least advance relative to the largest.
        const PARTS: [f64; 3] = [0.0, 0.5, 0.8];
        let farthest = moves.iter().map(Vec3::norm).fold(0.0, f64::max);
        let mut tried = usize::MAX;
        for least in PARTS {
            let is_part = |m: &Vec3| m.norm() > 0.0 && m.norm() >= least * farthest;
            let n = moves.iter().filter(|m| is_part(m)).count();
            if n == std::mem::replace(&mut tried, n) {
                continue;
            }
            let part = moves
                .iter()
                .map(|m| if is_part(m) { *m } else { Vec3::zeros() });
            let part: Vec<Vec3> = part.collect();
            let trial = self.weigh(self.body.advanced(&[(front, &part)]))?;
            if let Some(paid) = trial.filter(|t| t.ratio >= 1.0) {
                return Ok(Some(paid));
            }
        }
        Ok(None)
    }
}
