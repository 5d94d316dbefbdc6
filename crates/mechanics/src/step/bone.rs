use super::crack_faces::CrackFaces;
use super::walls::{in_kerf, push_walls, side_cells};
use crate::bone::{FactorError, MaterialError, Supports, TetMaterial};
use crate::contact::{PointShell, ShellPoint};
use crate::crack::growth::{GrowthLengths, Surroundings};
use crate::crack::stress_intensity::CellForce;
use crate::crack::{CrackSurface, CutEdges, Fragments, System, Topology};
use crate::geometry::{SignedDistance, TetLocator, TetMesh, Vec3};
use nalgebra::Matrix3x4;
use std::sync::Arc;

/// Why a bone could not be made.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum BoneError {
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

/// The space that the bone fills.
#[derive(Clone)]
pub struct Region(pub Arc<dyn SignedDistance + Send + Sync>);

impl std::fmt::Debug for Region {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Region({:?})", self.0.bounds())
    }
}

/// What never changes: the body without its crack.
#[derive(Debug)]
pub struct Body {
    /// The simulation mesh.
    pub mesh: TetMesh,
    /// Finds its tetrahedra.
    pub locator: TetLocator,
    /// One material for each tetrahedron.
    pub materials: Vec<TetMaterial>,
    /// How it is held.
    pub supports: Supports,
    /// Nodes of the two parts that the split is to separate (the two condyles): between them the last ligaments are sought.
    pub ends: [Vec<u32>; 2],
    /// Lengths of a growth step.
    pub lengths: GrowthLengths,
    /// The bone's true shape: a coarse mesh cuts its corners.
    pub region: Region,
    /// The uncut surface as points.
    pub surface: Vec<ShellPoint>,
    /// Points a mm2 on crack walls.
    pub wall_density: f64,
}

/// Everything that is constant between two growth steps. The propagation loop makes a new one; nobody edits a shared one.
#[derive(Clone, Debug)]
pub struct Bone {
    /// Counts the growths.
    pub generation: u32,
    /// What never changes.
    pub body: Arc<Body>,
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
    /// Surface and wall points; only ever appended.
    pub points: Vec<ShellPoint>,
    /// The same, sorted by cell.
    pub shell: Arc<PointShell>,
    /// Where the two faces of the crack may press on each other.
    pub faces: Arc<CrackFaces>,
    /// For each sheet, how many of its triangles already carry wall points.
    pub(super) walled: Vec<usize>,
}

/// A crack with its equations: what makes one generation of a bone differ from the one before.
#[derive(Debug)]
pub(super) struct Grown {
    pub crack: CrackSurface,
    pub cuts: CutEdges,
    pub topology: Topology,
    pub system: System,
}

/// What is computed on a bone: the deformation under the present load.
#[derive(Clone, Debug, Default)]
pub struct BoneState {
    /// The bone this belongs to.
    pub generation: u32,
    /// The unknowns x_XF \[mm\].
    pub x: Vec<f64>,
    /// Deformed positions of each cell's virtual nodes: D_T of the paper's equation 7.
    pub deformation: Vec<Matrix3x4<f32>>,
    /// The forces under which it was computed, from tools and from face on face.
    pub loads: Vec<CellForce>,
    /// Elastic energy \[N mm\].
    pub strain_energy: f64,
    /// Whether the relaxation had converged.
    pub converged: bool,
}

impl Bone {
    /// A bone with its saw cuts.
    ///
    /// # Errors
    /// [`BoneError`] for a material out of range or a body that nothing holds.
    pub fn new(body: Arc<Body>, mut crack: CrackSurface) -> Result<Self, BoneError> {
        let needed = body.mesh.tets().len();
        if body.materials.len() != needed {
            return Err(BoneError::MaterialCount {
                given: body.materials.len(),
                needed,
            });
        }
        for (tet, m) in body.materials.iter().enumerate() {
            m.check()
                .map_err(|source| BoneError::Material { tet, source })?;
        }
        let mut cuts = CutEdges::new(&body.mesh);
        for sheet in &crack.sheets {
            cuts.cut(&body.mesh, &body.locator, &sheet.mesh, body.chip_nodes());
        }
        let around = body.surroundings();
        let mut leads = Vec::new();
        for front in crack.fronts(&body.mesh, &body.locator, body.lengths.stick()) {
            let sheet = &crack.sheets[front.sheet];
            let (points, advances) =
                crate::crack::stress_intensity::front_frames(sheet, &front, body.lengths.h);
            let lead = around.lead_strip(&crack, front.sheet, &points, &advances);
            cuts.cut(&body.mesh, &body.locator, &lead, body.chip_nodes());
            leads.push((front.sheet, lead));
        }
        for (sheet, lead) in leads {
            crack.sheets[sheet].lead.append(&lead);
        }
        let kept = |p: &&ShellPoint| !in_kerf(&crack, &p.position);
        let points = body.surface.iter().filter(kept).copied().collect();
        let walled = vec![0; crack.sheets.len()];
        let topology = Topology::new(&body.mesh, &cuts);
        let system = System::new(&body.mesh, &body.materials, &topology, &body.supports)?;
        Ok(Self::assemble(
            0,
            body,
            Grown {
                crack,
                cuts,
                topology,
                system,
            },
            points,
            walled,
        ))
    }

    /// The crack after growth, with its equations: old unknowns stay, the factor is only appended to. `newly_cut` are the
    /// edges that `cuts` has beyond this bone's.
    ///
    /// # Errors
    /// [`BoneError::Factor`] if the grown bone cannot be factored.
    pub(super) fn grown(
        &self,
        crack: CrackSurface,
        cuts: CutEdges,
        newly_cut: &[u32],
    ) -> Result<Grown, BoneError> {
        let body = &self.body;
        let topology = self.topology.grown(&body.mesh, &cuts, newly_cut);
        let (materials, supports) = (&body.materials, &body.supports);
        let system = self
            .system
            .grown(&body.mesh, materials, &topology, supports)?;
        Ok(Grown {
            crack,
            cuts,
            topology,
            system,
        })
    }

    /// The next generation: shell, faces and fragments for a grown crack.
    pub(super) fn assemble(
        generation: u32,
        body: Arc<Body>,
        grown: Grown,
        mut points: Vec<ShellPoint>,
        mut walled: Vec<usize>,
    ) -> Self {
        let Grown {
            crack,
            cuts,
            topology,
            system,
        } = grown;
        for (sheet, done) in crack.sheets.iter().zip(&mut walled) {
            push_walls(&body, sheet, *done, &mut points);
            *done = sheet.mesh.triangles.len();
        }
        let cell_of = side_cells(&body, &topology, &points);
        let shell = PointShell::group(&points, &cell_of, topology.cells().len());
        Self {
            generation,
            fragments: Fragments::find(&body.mesh, &cuts),
            faces: Arc::new(CrackFaces::new(&body.mesh, &cuts, &topology, &crack)),
            system: Arc::new(system),
            shell: Arc::new(shell),
            body,
            crack,
            cuts,
            topology,
            points,
            walled,
        }
    }

    /// The bone at rest.
    pub fn at_rest(&self) -> BoneState {
        let mut state = BoneState {
            generation: self.generation,
            x: vec![0.0; self.system.n()],
            ..Default::default()
        };
        self.deform(&mut state);
        state.converged = true;
        state
    }

    /// Recomputes the cells' matrices from the unknowns.
    pub fn deform(&self, state: &mut BoneState) {
        let mesh = &self.body.mesh;
        state
            .deformation
            .resize(self.topology.cells().len(), Matrix3x4::zeros());
        for (d, cell) in state.deformation.iter_mut().zip(self.topology.cells()) {
            let u = self.system.cell_displacements(mesh, cell, &state.x);
            let x = mesh.corners(cell.tet as usize);
            for k in 0..4 {
                d.set_column(k, &(x[k] + u[k]).cast());
            }
        }
    }

    /// Adds loads to a right-hand side.
    pub fn add_loads<'a>(&self, loads: impl IntoIterator<Item = &'a CellForce>, rhs: &mut [f64]) {
        for l in loads {
            let cell = &self.topology.cells()[l.cell as usize];
            self.system
                .add_force(&self.body.mesh, cell, &l.weights, &l.force, rhs);
        }
    }

    /// The same loads on this bone, where `old` is an earlier generation: same place, same side.
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

    /// Scales the way from the displacements of `before` (on `old`) to those of `state` so that no node moves farther than a
    /// fraction of a millimetre.
    pub(super) fn limit_change(&self, old: &Self, before: &BoneState, state: &mut BoneState) {
        const FARTHEST: f64 = 0.3;
        let n = 0..self.body.mesh.nodes().len();
        let was = |i: usize| old.system.displacement(i, &before.x);
        let farthest = n
            .clone()
            .map(|i| (self.system.displacement(i, &state.x) - was(i)).norm())
            .fold(0.0, f64::max);
        if farthest > FARTHEST {
            let share = FARTHEST / farthest;
            state.x.iter_mut().for_each(|v| *v *= share);
            n.for_each(|i| {
                self.system
                    .add_displacement(i, &(was(i) * (1.0 - share)), &mut state.x);
            });
        }
    }

    /// Whether the two ends are apart: the split is complete.
    pub fn is_severed(&self) -> bool {
        let fragment = |end: &Vec<u32>| end.first().map(|&i| self.fragments.of_node[i as usize]);
        fragment(&self.body.ends[0]) != fragment(&self.body.ends[1]) && self.fragments.count() >= 2
    }

    /// Area of the crack inside the body as mechanics knows it: the cut polygons of divided tetrahedra \[mm2\].
    pub fn crack_area(&self) -> f64 {
        self.faces.area()
    }
}

impl Body {
    /// The tetrahedron that carries a point of the bone, with the shape functions there: below zero where the mesh cuts a
    /// corner. `None` where the mesh is farther than two element sizes.
    pub fn embed(&self, p: &Vec3) -> Option<(u32, [f64; 4])> {
        let near = |reach: f64| {
            self.locator
                .find_near(&self.mesh, p, reach * self.lengths.h)
        };
        [0.25, 0.5, 1.0, 2.0].into_iter().find_map(near)
    }

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
}
