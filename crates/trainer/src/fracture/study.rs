use super::case::{Case, LoadControl};
use super::setup::Problem;
use anyhow::{Result, ensure};
use osteotome_mechanics::crack::load_control::FrontDrives;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::crack::{CrackedBody, EvaluatedFront, Front, SurfaceLoad};
use osteotome_mechanics::geometry::Vec3;

/// A crack under load, step by step.
pub struct Study {
    body: CrackedBody,
    loads: Vec<SurfaceLoad>,
    steps: usize,
    control: LoadControl,
    /// Strain energy of the first step under the load as given \[N mm\].
    first_energy: f64,
}

/// Below this share of the first step's strain energy the loads meet no resistance any more.
const NOTHING: f64 = 1e-9;

/// What is found at one step. Unknowns, stations and drives are those of the loads as given: `load_factor` is not in them.
#[derive(Debug, Default)]
pub struct State {
    /// Solution of the equations.
    pub x: Vec<f64>,
    /// Fronts with their stations.
    pub fronts: Vec<EvaluatedFront>,
    /// What drives them.
    pub drives: FrontDrives,
    /// How far each vertex moves from here \[mm\].
    pub moves: Vec<Vec<Vec3>>,
    /// By what loads and prescribed displacements are multiplied in this step.
    pub load_factor: f64,
}

/// What comes after a step.
pub enum Verdict {
    /// The next one, after these moves of the fronts' vertices.
    Grows(Vec<Vec<Vec3>>),
    /// Nothing: why, or that all steps are done.
    Stops(Option<String>),
}

/// Displacements beyond this many sizes of the body mean that a part of it hangs by a hinge.
const FARTHEST: f64 = 1e6;

impl Study {
    /// Makes a study of a problem; solves it once, so that what cannot be solved is known before anything is written.
    ///
    /// # Errors
    /// If a part of the body hangs by a hinge.
    pub fn new(problem: Problem, case: &Case) -> Result<Self> {
        let growth = case.growth.as_ref();
        let mut study = Self {
            first_energy: 0.0,
            body: problem.body,
            loads: problem.loads,
            steps: case.steps(),
            control: growth.map_or(LoadControl::Fixed, |g| g.load),
        };
        let (x, _) = study.solve();
        study.first_energy = study.body.system.energy(&x);
        let bounds = study.body.solid.mesh.bounds();
        let size = (bounds.max - bounds.min).norm();
        let largest = x.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let given = study.body.solid.supports.prescribed.iter();
        let given = given.map(|p| p.value.abs()).fold(0.0, f64::max);
        ensure!(
            x.iter().all(|v| v.is_finite()) && largest <= FARTHEST * size + 1e3 * given,
            "the body moves by {largest:e} mm: some part of it hangs by a hinge or the load is beyond all measure; hold it better or check units (mm, N, MPa)"
        );
        Ok(study)
    }

    /// Growth steps asked for.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The body as it is now.
    pub fn body(&self) -> &CrackedBody {
        &self.body
    }

    /// Solution under the loads as given, and these loads.
    fn solve(&self) -> (Vec<f64>, Vec<CellForce>) {
        let system = &self.body.system;
        let forces = |l: &SurfaceLoad| self.body.surface_forces(l);
        let loads: Vec<CellForce> = self.loads.iter().flat_map(forces).collect();
        let mut x = vec![0.0; system.n()];
        self.body.add_loads(&loads, &mut x);
        system.add_prescribed(&mut x);
        system.solve(&mut x, &mut system.scratch());
        (x, loads)
    }

    /// Solves, evaluates the fronts, finds the load factor and says what comes next.
    pub fn evaluate(&self, step: usize) -> (State, Verdict) {
        let (x, loads) = self.solve();
        if self.carries_nothing(&loads) {
            let state = State {
                x: vec![0.0; x.len()],
                ..State::default()
            };
            let reason = "the body has come apart: a loaded piece is held by nothing, so no load is left to carry";
            return (state, Verdict::Stops(Some(reason.to_owned())));
        }
        let lengths = &self.body.solid.lengths;
        let fronts = self.body.evaluate_fronts(&x, &loads, 0.0);
        let drives = FrontDrives::new(&fronts, lengths);
        let resists = self.body.system.energy(&x) > NOTHING * self.first_energy;
        let mut state = State {
            x,
            load_factor: 1.0,
            ..State::default()
        };
        let scaled = self.control == LoadControl::Scaled && self.steps > 0;
        let is_driven = drives.strongest > 0.0 && resists;
        if scaled && is_driven {
            state.load_factor = 1.0 / drives.strongest.sqrt();
        }
        let least = if scaled { 0.0 } else { 1.0 };
        let moves = drives.moves(&fronts, lengths, least);
        let rests = moves.iter().flatten().all(|m| *m == Vec3::zeros());
        let verdict = if step >= self.steps {
            Verdict::Stops(None)
        } else if fronts.is_empty() {
            Verdict::Stops(Some("no front is left inside the body".to_owned()))
        } else if !is_driven {
            Verdict::Stops(Some(
                "nothing drives the crack: G is nowhere positive along its fronts".to_owned(),
            ))
        } else if rests {
            Verdict::Stops(Some(format!(
                "the crack rests: the largest G / G_c is {:.4}",
                drives.strongest
            )))
        } else {
            state.moves.clone_from(&moves);
            Verdict::Grows(moves)
        };
        (state.fronts, state.drives) = (fronts, drives);
        (state, verdict)
    }

    /// Whether a load acts on a piece that no support holds.
    fn carries_nothing(&self, loads: &[CellForce]) -> bool {
        let body = &self.body;
        let is_loose = |l: &&CellForce| {
            let cell = &body.topology.cells()[l.cell as usize];
            let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap_or(0);
            let node = body.solid.mesh.tets()[cell.tet as usize][own];
            let piece = body.fragments.of_node[node as usize];
            l.force != Vec3::zeros() && body.loose.contains(&piece)
        };
        !body.loose.is_empty() && loads.iter().any(|l| is_loose(&l))
    }

    /// Moves the fronts of `state`.
    ///
    /// # Errors
    /// If the grown body cannot be factored.
    pub fn grow(&mut self, state: &State, moves: &[Vec<Vec3>]) -> Result<()> {
        let moving: Vec<(&Front, &[Vec3])> = state
            .fronts
            .iter()
            .zip(moves)
            .filter(|(_, m)| m.iter().any(|v| *v != Vec3::zeros()))
            .map(|(f, m)| (&f.front, m.as_slice()))
            .collect();
        self.body = self.body.grown(self.body.advanced(&moving))?;
        Ok(())
    }
}
