use super::cut_edges::CutEdges;
use super::cut_polygon::face_pieces;
use super::enrichment::Topology;
use super::fragments::Fragments;
use super::growth::{GrowthLengths, Surroundings, grow};
use super::stress_intensity::{CellForce, Fields, FrontDomains, Station};
use super::surface::{CrackSurface, Front};
use super::system::System;
use crate::bone::{FactorError, MaterialError, Supports, TetMaterial, free_motion};
use crate::geometry::{TetLocator, TetMesh, Vec3};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

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

    /// Pieces of fewer nodes do not come off: cuts that would only part one from the rest are not made. Where springs hold whatever
    /// comes off that is a single node, else a chip would have to get springs of its own.
    pub fn chip_nodes(&self) -> usize {
        if self.supports.ground_spring > 0.0 {
            LEAST_CHIP
        } else {
            (self.mesh.nodes().len() / 300).max(LEAST_CHIP)
        }
    }

    /// Pieces that neither support nor spring holds.
    fn loose_pieces(&self, fragments: &Fragments) -> Vec<u32> {
        if self.supports.ground_spring > 0.0 {
            return Vec::new();
        }
        let mut nodes_of = vec![Vec::new(); fragments.volume_share.len()];
        for (i, &f) in (0u32..).zip(&fragments.of_node) {
            nodes_of[f as usize].push(i);
        }
        let is_loose = |nodes: &Vec<u32>| free_motion(&self.mesh, &self.supports, nodes).is_some();
        let pieces = (0u32..).zip(&nodes_of);
        pieces.filter(|(_, n)| is_loose(n)).map(|p| p.0).collect()
    }

    /// The supports, with a soft spring at each node of the loose pieces.
    fn supports_with(&self, fragments: &Fragments, loose: &[u32]) -> Cow<'_, Supports> {
        if loose.is_empty() {
            return Cow::Borrowed(&self.supports);
        }
        let stiffest = self.materials.iter().map(|m| m.young_modulus);
        let spring = LOOSE_SPRING * stiffest.fold(0.0, f64::max) * self.lengths.h;
        let mut supports = self.supports.clone();
        let nodes = (0u32..).zip(&fragments.of_node);
        let hanging = nodes.filter(|(_, f)| loose.contains(f));
        supports.springs.extend(hanging.map(|(i, _)| (i, spring)));
        Cow::Owned(supports)
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
    /// Numbers of the pieces that no support holds; weak springs keep their equations regular.
    pub loose: Vec<u32>,
    /// The fronts and what surrounds them, found when they are first asked for.
    surrounded: OnceLock<Arc<(Vec<Front>, FrontDomains)>>,
}

/// Spring to the ground at the nodes of a piece that nothing holds, relative to E h.
const LOOSE_SPRING: f64 = 1e-7;

/// A border of more values than this share of the base's is heavy.
const HEAVY: f64 = 0.5;

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
        let cuts = solid
            .surroundings()
            .first_cuts(&mut crack, solid.chip_nodes());
        let topology = Topology::new(&solid.mesh, &cuts);
        let fragments = Fragments::find(&solid.mesh, &cuts);
        let loose = solid.loose_pieces(&fragments);
        let supports = solid.supports_with(&fragments, &loose);
        let system = System::new(&solid.mesh, &solid.materials, &topology, &supports)?;
        Ok(Self {
            fragments,
            loose,
            system: Arc::new(system),
            solid,
            crack,
            cuts,
            topology,
            surrounded: OnceLock::new(),
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

    /// Loads as a sparse right-hand side: (unknown, force \[N\]), each unknown once.
    pub fn sparse_loads<'a>(
        &self,
        loads: impl IntoIterator<Item = &'a CellForce>,
    ) -> Vec<(u32, f64)> {
        // Loads are many, cells few: summed by cell and corner before the unknowns are looked up.
        let mut corners: BTreeMap<u32, [Vec3; 4]> = BTreeMap::new();
        for l in loads {
            let cell = corners.entry(l.cell).or_default();
            let sums = cell.iter_mut().zip(l.weights);
            sums.for_each(|(sum, w)| *sum += l.force * w);
        }
        let mut pushed = Vec::new();
        for (cell, forces) in &corners {
            let cell = &self.topology.cells()[*cell as usize];
            self.system
                .push_corner_forces(&self.solid.mesh, cell, forces, &mut pushed);
        }
        pushed.sort_by_key(|p| p.0);
        pushed.dedup_by(|later, kept| {
            let same = later.0 == kept.0;
            kept.1 += if same { later.1 } else { 0.0 };
            same
        });
        pushed
    }

    /// The same loads on this body, where `old` is an earlier state of it: same place, same side.
    pub fn carry_loads(&self, old: &Self, loads: &[CellForce]) -> Vec<CellForce> {
        let carry = |l: &CellForce| {
            let was = &old.topology.cells()[l.cell as usize];
            let common = |c: &usize| (self.topology.cells()[*c].mask & was.mask).count_ones();
            let same = self.topology.cells_of(was.tet).rev().max_by_key(common);
            CellForce {
                cell: same.map_or(0, |c| c as u32),
                ..*l
            }
        };
        loads.iter().map(carry).collect()
    }

    /// Whether a cell has crumbled off with its piece; nothing presses on it any more.
    pub fn is_debris(&self, cell: u32) -> bool {
        let cell = &self.topology.cells()[cell as usize];
        let own = self.solid.mesh.tets()[cell.tet as usize];
        let node = own[cell.mask.trailing_zeros() as usize % 4];
        self.fragments.is_debris(node)
    }

    /// Whether some of tetrahedron `t` has crumbled off since `before`.
    pub fn has_crumbled(&self, before: &Self, t: u32) -> bool {
        let nodes = self.solid.mesh.tets()[t as usize];
        let crumbled = |n| self.fragments.is_debris(n) && !before.fragments.is_debris(n);
        nodes.into_iter().any(crumbled)
    }

    /// The work f . u of loads with the displacements that they cause: twice the elastic energy \[N mm\].
    pub fn work(&self, loads: &[CellForce]) -> f64 {
        let half = self.system.half_solve(&[self.sparse_loads(loads)]);
        half.compliance(&half)[0]
    }

    /// What growing from `before` to this body costs: effective area \[mm2\] and energy \[N mm\] of the new faces.
    ///
    /// Effective: each face counts as far as it is free to open (the sum of the enriched nodes' shape functions), as the energy
    /// that the growth releases does. The energy is that area in each tetrahedron times its toughness across the cut.
    pub fn cost(&self, before: &Self, newly_cut: &[u32]) -> (f64, f64) {
        let mesh = &self.solid.mesh;
        let mut nodes: Vec<u32> = newly_cut
            .iter()
            .flat_map(|&e| mesh.tets_of_edge(e))
            .flat_map(|t| mesh.tets()[t as usize])
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        let around = nodes.iter().flat_map(|&n| mesh.tets_of_node(n as usize));
        let mut tets: Vec<u32> = around.copied().collect();
        tets.sort_unstable();
        tets.dedup();
        let [now, then] = [self, before].map(|b| {
            let faces = tets.iter().map(|&t| b.faces_in(t));
            faces.fold((0.0, 0.0), |sum, f| (sum.0 + f.0, sum.1 + f.1))
        });
        (now.0 - then.0, now.1 - then.1)
    }

    /// Effective area of the crack in one tetrahedron, and that area times the toughness across it.
    pub(super) fn faces_in(&self, t: u32) -> (f64, f64) {
        let material = &self.solid.materials[t as usize];
        let (mut area, mut energy) = (0.0, 0.0);
        face_pieces(&self.solid.mesh, &self.cuts, &self.topology, t, |f| {
            let free = f.freedom * f.area_normal.norm();
            let normal = f.area_normal.try_normalize(1e-12);
            area += free;
            energy += free * normal.map_or(0.0, |n| material.toughness(&n));
        });
        (area, energy)
    }

    /// G and K at every vertex of every front under `loads`, whose solution is `x`.
    ///
    /// `k_from`: see [`FrontDomains::evaluate`].
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
            cuts: &self.cuts,
            topology: &self.topology,
            system: &self.system,
            x,
            loads,
        };
        let surrounded = self.surrounded.get_or_init(|| {
            let fronts = self.fronts();
            let domains = FrontDomains::new(&fields, &self.crack, &fronts, s.lengths.h);
            Arc::new((fronts, domains))
        });
        let (fronts, domains) = &**surrounded;
        let all = domains.evaluate(&fields, k_from).into_iter();
        let pair = |(front, stations): (&Front, _)| EvaluatedFront {
            front: front.clone(),
            stations,
        };
        fronts.iter().zip(all).map(pair).collect()
    }

    /// The crack after its fronts have moved, one vector \[mm\] for each vertex of each front.
    pub fn advanced(&self, fronts: &[(&Front, &[Vec3])]) -> Growth {
        let s = &self.solid;
        let mut growth = Growth {
            crack: self.crack.clone(),
            cuts: self.cuts.clone(),
            newly_cut: Vec::new(),
        };
        for (front, moves) in fronts {
            let strip = grow(&mut growth.crack, front, moves, &s.surroundings());
            let cut = strip.cut(&mut growth.cuts, &s.mesh, &s.locator, s.chip_nodes());
            growth.newly_cut.extend(cut);
        }
        growth
    }

    /// Whether solves with the border cost so much that [`refactored`](Self::refactored) is worth its while.
    pub fn is_border_heavy(&self) -> bool {
        let (base, border) = self.system.factor().n_values();
        border as f64 > HEAVY * base as f64 && self.loose.is_empty()
    }

    /// The equations of this body assembled and factored afresh: the same unknowns, nothing in the border.
    ///
    /// # Errors
    /// [`FactorError`] as [`System::new`].
    pub fn refactored(&self) -> Result<System, FactorError> {
        let s = &self.solid;
        let supports = s.supports_with(&self.fragments, &self.loose);
        System::new(&s.mesh, &s.materials, &self.topology, &supports)
    }

    /// Goes on from `base`, the [`refactored`](Self::refactored) equations of an earlier state of this body. The unknowns stay what
    /// they are. Nothing happens if a piece hangs in springs that `base` does not know.
    ///
    /// # Errors
    /// [`FactorError`] as [`System::grown`]; `self` stays as it was.
    pub fn rebase(&mut self, base: &System) -> Result<(), FactorError> {
        let s = &self.solid;
        if self.loose.is_empty() {
            let system = base.grown(&s.mesh, &s.materials, &self.topology, &s.supports)?;
            self.system = Arc::new(system);
        }
        Ok(())
    }

    /// The body after a growth of its crack: old unknowns stay, the factor is only appended to.
    ///
    /// # Errors
    /// [`BodyError::Factor`] if the grown crack leaves a part that nothing holds; `self` stays valid.
    pub fn grown(&self, growth: Growth) -> Result<Self, BodyError> {
        let s = &self.solid;
        let Growth {
            crack,
            cuts,
            newly_cut,
        } = growth;
        let topology = self.topology.grown(&s.mesh, &cuts, &newly_cut);
        let fragments = Fragments::find(&s.mesh, &cuts);
        let loose = s.loose_pieces(&fragments);
        let supports = s.supports_with(&fragments, &loose);
        let system = if supports == s.supports_with(&self.fragments, &self.loose) {
            (self.system).grown(&s.mesh, &s.materials, &topology, &supports)?
        } else {
            // A piece has come off that now hangs in springs of its own.
            System::new(&s.mesh, &s.materials, &topology, &supports)?
        };
        Ok(Self {
            solid: self.solid.clone(),
            fragments,
            loose,
            system: Arc::new(system),
            crack,
            cuts,
            topology,
            surrounded: OnceLock::new(),
        })
    }
}

/// A piece of one node has no stiffness of its own.
const LEAST_CHIP: usize = 2;

/// A crack that has grown, not yet part of its body's equations.
#[derive(Clone, Debug)]
pub struct Growth {
    /// The grown surface.
    pub crack: CrackSurface,
    /// What it has cut.
    pub cuts: CutEdges,
    /// The edges cut beyond those of the body it grew in.
    pub newly_cut: Vec<u32>,
}

impl Growth {
    /// Cuts further edges at their middle.
    pub fn tear(&mut self, mesh: &TetMesh, edges: &[u32]) {
        self.newly_cut
            .extend(self.cuts.cut_at_middle(mesh, edges, 1));
    }
}
