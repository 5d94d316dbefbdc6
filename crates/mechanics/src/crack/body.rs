use super::cut_edges::CutEdges;
use super::enrichment::Topology;
use super::fragments::Fragments;
use super::growth::{GrowthLengths, Surroundings, grow};
use super::stress_intensity::{CellForce, Fields, Station, evaluate, front_frames};
use super::surface::{CrackSurface, Front};
use super::system::System;
use crate::bone::{FactorError, MaterialError, Supports, TetMaterial, free_motion};
use crate::geometry::{TetLocator, TetMesh, Vec3};
use std::sync::Arc;

/// Why a cracked body could not be made.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum BodyError {
    /// A material is out of its range.
    #[error("material of tetrahedron {tet}: {source}")]
    Material {
        /// Which tetrahedron.
        tet: usize,
        /// What is wrong with it.
        source: MaterialError,
    },
    /// There must be one material for each tetrahedron.
    #[error("{given} materials for {needed} tetrahedra; there must be one for each")]
    MaterialCount {
        /// How many there are.
        given: usize,
        /// How many there must be.
        needed: usize,
    },
    /// The equations have no solution.
    #[error(transparent)]
    Factor(#[from] FactorError),
}

/// The body without its crack: what never changes as the crack grows.
#[derive(Debug)]
pub struct Solid {
    /// The simulation mesh.
    pub mesh: TetMesh,
    /// Finds its tetrahedra.
    pub locator: TetLocator,
    /// One material for each tetrahedron.
    pub materials: Vec<TetMaterial>,
    /// How it is held.
    pub supports: Supports,
    /// Lengths of a growth step.
    pub lengths: GrowthLengths,
}

impl Solid {
    /// What a growth step needs to know.
    pub fn surroundings(&self) -> Surroundings<'_> {
        Surroundings {
            mesh: &self.mesh,
            locator: &self.locator,
            lengths: self.lengths,
        }
    }

    /// Pieces of fewer nodes are chips, not fragments: cuts that would only crumble one off are not made.
    pub fn chip_nodes(&self) -> usize {
        (self.mesh.nodes().len() / 300).max(2)
    }

    fn check(&self) -> Result<(), BodyError> {
        let needed = self.mesh.tets().len();
        if self.materials.len() != needed {
            return Err(BodyError::MaterialCount {
                given: self.materials.len(),
                needed,
            });
        }
        for (tet, m) in self.materials.iter().enumerate() {
            m.check()
                .map_err(|source| BodyError::Material { tet, source })?;
        }
        Ok(())
    }
}

/// A body with its crack, as mechanics sees it: constant between two growths. Growth makes a new one.
#[derive(Clone, Debug)]
pub struct CrackedBody {
    /// The body without its crack.
    pub solid: Arc<Solid>,
    /// The explicit crack.
    pub crack: CrackSurface,
    /// What it has cut.
    pub cuts: CutEdges,
    /// Cells and enrichments.
    pub topology: Topology,
    /// The equations with their factor.
    pub system: Arc<System>,
    /// The pieces.
    pub fragments: Fragments,
    /// Numbers of the pieces that no support holds; springs of [`LOOSE_SPRING`] keep their equations regular.
    pub loose: Vec<u32>,
}

/// Spring to the ground at the nodes of a piece that nothing holds, relative to E h.
pub const LOOSE_SPRING: f64 = 1e-7;

/// A front with the stations at its vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluatedFront {
    /// The front.
    pub front: Front,
    /// One for each of its vertices.
    pub stations: Vec<Station>,
}

impl CrackedBody {
    /// Cuts the body along the sheets and, by the lead, a little ahead of their fronts.
    ///
    /// # Errors
    /// [`BodyError`] for a material out of range or a body that nothing holds.
    pub fn new(solid: Arc<Solid>, mut crack: CrackSurface) -> Result<Self, BodyError> {
        solid.check()?;
        let mut cuts = CutEdges::new(&solid.mesh);
        for sheet in &crack.sheets {
            cuts.cut(&solid.mesh, &solid.locator, &sheet.mesh, solid.chip_nodes());
        }
        let around = solid.surroundings();
        let mut leads = Vec::new();
        for front in crack.fronts(&solid.mesh, &solid.locator, solid.lengths.stick()) {
            let sheet = &crack.sheets[front.sheet];
            let (points, advances) = front_frames(sheet, &front, solid.lengths.h);
            let lead = around.lead_strip(&crack, front.sheet, &points, &advances);
            cuts.cut(&solid.mesh, &solid.locator, &lead, solid.chip_nodes());
            leads.push((front.sheet, lead));
        }
        for (sheet, lead) in leads {
            crack.sheets[sheet].lead.append(&lead);
        }
        Self::from_cuts(solid, crack, cuts)
    }

    /// The body with exactly these cuts.
    ///
    /// # Errors
    /// [`BodyError::Factor`] if nothing holds some part of it.
    pub fn from_cuts(
        solid: Arc<Solid>,
        crack: CrackSurface,
        cuts: CutEdges,
    ) -> Result<Self, BodyError> {
        let topology = Topology::new(&solid.mesh, &cuts);
        let fragments = Fragments::find(&solid.mesh, &cuts);
        let (loose, springs) = loose_pieces(&solid, &fragments);
        let sprung;
        let supports = if springs.is_empty() {
            &solid.supports
        } else {
            sprung = Supports {
                springs: [solid.supports.springs.clone(), springs].concat(),
                ..solid.supports.clone()
            };
            &sprung
        };
        let system = System::new(&solid.mesh, &solid.materials, &topology, supports)?;
        Ok(Self {
            fragments,
            loose,
            system: Arc::new(system),
            solid,
            crack,
            cuts,
            topology,
        })
    }

    /// The crack fronts inside the body.
    pub fn fronts(&self) -> Vec<Front> {
        let s = &self.solid;
        self.crack.fronts(&s.mesh, &s.locator, s.lengths.stick())
    }

    /// Adds loads to a right-hand side.
    pub fn add_loads<'a>(&self, loads: impl IntoIterator<Item = &'a CellForce>, rhs: &mut [f64]) {
        for l in loads {
            let cell = &self.topology.cells()[l.cell as usize];
            self.system
                .add_force(&self.solid.mesh, cell, &l.weights, &l.force, rhs);
        }
    }

    /// G and K at every vertex of every front under `loads`, whose solution is `x`.
    ///
    /// `k_from`: see [`evaluate`].
    pub fn evaluate_fronts(
        &self,
        x: &[f64],
        loads: &[CellForce],
        k_from: f64,
    ) -> Vec<EvaluatedFront> {
        let s = &self.solid;
        let fields = Fields {
            mesh: &s.mesh,
            locator: &s.locator,
            materials: &s.materials,
            topology: &self.topology,
            system: &self.system,
            x,
            loads,
        };
        let stations = |front: Front| {
            let sheet = &self.crack.sheets[front.sheet];
            let stations = evaluate(&fields, sheet, &front, s.lengths.h, k_from);
            EvaluatedFront { front, stations }
        };
        self.fronts().into_iter().map(stations).collect()
    }

    /// The crack after its fronts have moved, one vector \[mm\] for each vertex of each front, and what it has cut by then.
    pub fn grown(&self, fronts: &[(&Front, &[Vec3])]) -> (CrackSurface, CutEdges) {
        let (mut crack, mut cuts) = (self.crack.clone(), self.cuts.clone());
        let s = &self.solid;
        for (front, moves) in fronts {
            let strip = grow(&mut crack, front, moves, &s.surroundings());
            cuts.cut(&s.mesh, &s.locator, &strip.cut, s.chip_nodes());
        }
        (crack, cuts)
    }

    /// The body after its fronts have moved, one vector \[mm\] for each vertex of each front.
    ///
    /// # Errors
    /// [`BodyError::Factor`] if the grown crack leaves a part that nothing holds; `self` stays valid.
    pub fn grow(&self, fronts: &[(&Front, &[Vec3])]) -> Result<Self, BodyError> {
        let (crack, cuts) = self.grown(fronts);
        Self::from_cuts(self.solid.clone(), crack, cuts)
    }
}

/// Pieces that nothing holds, and a soft spring for each of their nodes.
fn loose_pieces(solid: &Solid, fragments: &Fragments) -> (Vec<u32>, Vec<(u32, f64)>) {
    let (mut loose, mut springs) = (Vec::new(), Vec::new());
    if solid.supports.ground_spring > 0.0 {
        return (loose, springs);
    }
    let stiffest = solid.materials.iter().map(|m| m.young_modulus);
    let spring = LOOSE_SPRING * stiffest.fold(0.0, f64::max) * solid.mesh.mean_edge_length();
    let mut nodes_of = vec![Vec::new(); fragments.volume_share.len()];
    for (i, &f) in (0u32..).zip(&fragments.of_node) {
        nodes_of[f as usize].push(i);
    }
    for (f, nodes) in (0u32..).zip(&nodes_of) {
        if free_motion(&solid.mesh, &solid.supports, nodes).is_some() {
            loose.push(f);
            springs.extend(nodes.iter().map(|&i| (i, spring)));
        }
    }
    (loose, springs)
}
