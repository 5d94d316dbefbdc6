use super::crack_faces::CrackFaces;
use super::walls::{in_kerf, push_walls, side_cells};
use crate::contact::{PointShell, ShellPoint};
use crate::crack::stress_intensity::CellForce;
use crate::crack::{BodyError, CrackSurface, CrackedBody, Solid};
use crate::geometry::{SignedDistance, Vec3};
use nalgebra::Matrix3x4;
use std::ops::Deref;
use std::sync::Arc;

/// The space that the bone fills.
#[derive(Clone)]
pub struct Region(pub Arc<dyn SignedDistance + Send + Sync>);

impl std::fmt::Debug for Region {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Region({:?})", self.0.bounds())
    }
}

/// What never changes: the body without its crack, and what contact needs to know of it.
#[derive(Debug)]
pub struct Body {
    /// Mesh, materials, supports.
    pub solid: Arc<Solid>,
    /// Nodes of the two parts that the split is to separate (the two condyles): between them the last ligaments are sought.
    pub ends: [Vec<u32>; 2],
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
    /// Crack, cuts, cells, equations, pieces.
    pub cracked: CrackedBody,
    /// Surface and wall points; only ever appended.
    pub points: Vec<ShellPoint>,
    /// The same, sorted by cell.
    pub shell: Arc<PointShell>,
    /// Where the two faces of the crack may press on each other.
    pub faces: Arc<CrackFaces>,
    /// For each sheet, how many of its triangles already carry wall points.
    pub(super) walled: Vec<usize>,
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
    /// [`BodyError`] for a material out of range or a body that nothing holds.
    pub fn new(body: Arc<Body>, crack: CrackSurface) -> Result<Self, BodyError> {
        let cracked = CrackedBody::new(body.solid.clone(), crack)?;
        let kept = |p: &&ShellPoint| !in_kerf(&cracked.crack, &p.position);
        let points = body.surface.iter().filter(kept).copied().collect();
        let walled = vec![0; cracked.crack.sheets.len()];
        Ok(Self::assemble(0, body, cracked, points, walled))
    }

    /// The next generation: shell and crack faces for a grown crack.
    pub(super) fn assemble(
        generation: u32,
        body: Arc<Body>,
        cracked: CrackedBody,
        mut points: Vec<ShellPoint>,
        mut walled: Vec<usize>,
    ) -> Self {
        for (sheet, done) in cracked.crack.sheets.iter().zip(&mut walled) {
            push_walls(&body, sheet, *done, &mut points);
            *done = sheet.mesh.triangles.len();
        }
        let cell_of = side_cells(&body, &cracked.topology, &points);
        let shell = PointShell::group(&points, &cell_of, cracked.topology.cells().len());
        let (cuts, topology) = (&cracked.cuts, &cracked.topology);
        let faces = CrackFaces::new(&body.mesh, cuts, topology, &cracked.crack);
        Self {
            generation,
            faces: Arc::new(faces),
            shell: Arc::new(shell),
            body,
            cracked,
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

/// A bone is a cracked body that tools touch.
impl Deref for Bone {
    type Target = CrackedBody;

    fn deref(&self) -> &CrackedBody {
        &self.cracked
    }
}

/// A body for contact is a solid first.
impl Deref for Body {
    type Target = Solid;

    fn deref(&self) -> &Solid {
        &self.solid
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
}
