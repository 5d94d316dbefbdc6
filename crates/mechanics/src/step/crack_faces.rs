//! The two faces of the crack must not pass through each other.
//!
//! One contact point a divided tetrahedron, with the opening g = gap + n . (u_+ - u_-). Pressures p >= 0 where g < 0 by a
//! penalty that is stiff against the bone; because the bone's compliance at these points is known from solves with the
//! kept factor, the penalty is solved implicitly (projected Gauss-Seidel) and never limits the relaxation.
use crate::bone::SolveScratch;
use crate::crack::stress_intensity::CellForce;
use crate::crack::{Cell, CrackedBody, CutEdges, System, Topology, cut_area};
use crate::geometry::{Aabb, TetMesh, Vec3};

/// One pair of opposite points.
#[derive(Clone, Copy, Debug)]
struct FacePair {
    /// Cells on the side that `normal` points to, and on the other.
    cells: [u32; 2],
    weights: [f64; 4],
    normal: Vec3,
    /// Width of the kerf there \[mm\].
    gap: f64,
    area: f64,
}

/// The crack in one divided tetrahedron.
#[derive(Clone, Copy, Debug)]
struct Divided {
    tet: u32,
    area: f64,
    /// If it is divided in two.
    pair: Option<FacePair>,
}

/// The face pairs of a bone generation.
#[derive(Clone, Debug, Default)]
pub struct CrackFaces {
    divided: Vec<Divided>,
    pairs: Vec<FacePair>,
}

impl CrackFaces {
    /// Places a pair in each tetrahedron that the crack divides in two.
    pub fn new(body: &CrackedBody) -> Self {
        Self::of(divided_tets(body).map(|t| Divided::new(body, t)))
    }

    /// The faces of a body that has grown from `before`, whose faces these are. Where the crack grew they are made anew: what
    /// was cut ahead of the front has now its own sheet.
    pub fn grown(&self, before: &CrackedBody, body: &CrackedBody) -> Self {
        let beside = tets_beside_growth(before, body);
        let mut known = self.divided.iter().peekable();
        Self::of(divided_tets(body).map(|t| {
            let old = known.next_if(|d| d.tet == t);
            let cells = body.topology.cells_of(t);
            match old {
                Some(old)
                    if before.topology.cells_of(t).len() == cells.len() && !beside[t as usize] =>
                {
                    old.renumbered(cells.start as u32)
                }
                _ => Divided::new(body, t),
            }
        }))
    }

    fn of(divided: impl Iterator<Item = Divided>) -> Self {
        let divided: Vec<Divided> = divided.collect();
        Self {
            pairs: divided.iter().filter_map(|d| d.pair).collect(),
            divided,
        }
    }

    /// Area of the crack inside the body: the cut polygons of all divided tetrahedra \[mm2\].
    pub fn area(&self) -> f64 {
        self.divided.iter().map(|d| d.area).sum()
    }

    /// How many pairs there are.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Opening of each pair \[mm\], negative where the faces overlap.
    pub fn openings(
        &self,
        mesh: &TetMesh,
        topology: &Topology,
        system: &System,
        x: &[f64],
    ) -> Vec<f64> {
        self.pairs
            .iter()
            .map(|p| p.gap + p.jump(mesh, topology, system, x))
            .collect()
    }
}

fn divided_tets(body: &CrackedBody) -> impl Iterator<Item = u32> {
    let tets = 0..body.solid.mesh.tets().len() as u32;
    tets.filter(|t| body.topology.cells_of(*t).len() > 1)
}

/// Which tetrahedra lie beside triangles that `before` did not have: their nearest sheet may be another.
fn tets_beside_growth(before: &CrackedBody, body: &CrackedBody) -> Vec<bool> {
    let solid = &body.solid;
    let mut beside = vec![false; solid.mesh.tets().len()];
    for (new, old) in body.crack.sheets.iter().zip(&before.crack.sheets) {
        for t in old.mesh.triangles.len()..new.mesh.triangles.len() {
            let around = Aabb::around(&new.mesh.corners(t)).grown(2.0 * solid.lengths.h);
            (solid.locator).tets_near(&around, |t| beside[t as usize] = true);
        }
    }
    beside
}

impl Divided {
    fn new(body: &CrackedBody, tet: u32) -> Self {
        let cells = body.topology.cells_of(tet);
        let both = cells.len() == 2;
        Self {
            tet,
            area: divided_area(&body.solid.mesh, &body.cuts, &body.topology.cells()[cells]),
            pair: both.then(|| pair(body, tet)).flatten(),
        }
    }

    /// The same in a topology where its cells begin at `first`.
    fn renumbered(&self, first: u32) -> Self {
        let cells = [first, first + 1];
        Self {
            pair: self.pair.map(|p| FacePair { cells, ..p }),
            ..*self
        }
    }
}

impl FacePair {
    fn jump(&self, mesh: &TetMesh, topology: &Topology, system: &System, x: &[f64]) -> f64 {
        let at = |cell: u32| -> Vec3 {
            let u = system.cell_displacements(mesh, &topology.cells()[cell as usize], x);
            (0..4).map(|k| u[k] * self.weights[k]).sum()
        };
        self.normal.dot(&(at(self.cells[0]) - at(self.cells[1])))
    }

    fn forces(&self, pressure_force: f64) -> [CellForce; 2] {
        [0, 1].map(|side| CellForce {
            cell: self.cells[side],
            weights: self.weights,
            force: self.normal
                * if side == 0 {
                    pressure_force
                } else {
                    -pressure_force
                },
        })
    }
}

/// Cut area of a tetrahedron: half the sum over its cells of the polygon that bounds each.
fn divided_area(mesh: &TetMesh, cuts: &CutEdges, cells: &[Cell]) -> f64 {
    0.5 * cells
        .iter()
        .map(|c| cut_area(mesh, cuts, c).1.norm())
        .sum::<f64>()
}

fn pair(body: &CrackedBody, t: u32) -> Option<FacePair> {
    let (mesh, topology, crack) = (&body.solid.mesh, &body.topology, &body.crack);
    let cells = topology.cells_of(t);
    let mask = topology.cells()[cells.start].mask;
    let inside = |k: usize| mask >> k & 1 == 1;
    let (centre, area_normal) = cut_area(mesh, &body.cuts, &topology.cells()[cells.start]);
    let mut normal = area_normal.try_normalize(1e-12)?;
    let x = mesh.corners(t as usize);
    let own: Vec3 = (0..4)
        .filter(|k| inside(*k))
        .map(|k| x[k] - centre)
        .sum::<Vec3>()
        / f64::from(mask.count_ones());
    if own.dot(&normal) < 0.0 {
        normal = -normal;
    }
    let gap = crack
        .sheets
        .iter()
        .filter_map(|s| {
            s.closest(&centre).map(|(d, t, w)| {
                (
                    d,
                    2.0 * (0..3)
                        .map(|c| s.kerf[s.mesh.triangles[t][c] as usize] * w[c])
                        .sum::<f64>(),
                )
            })
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(0.0, |f| f.1);
    Some(FacePair {
        cells: [cells.start as u32, cells.start as u32 + 1],
        weights: mesh.barycentric(t as usize, &centre),
        normal,
        gap,
        area: area_normal.norm(),
    })
}

/// Keeps the faces apart; remembers pressures (for the warm start) and compliance columns of one bone generation.
#[derive(Debug, Default)]
pub struct FaceContact {
    generation: Option<u32>,
    /// Force of each pair \[N\].
    force: Vec<f64>,
    /// Pairs with a compliance column, ascending in the order they were met.
    active: Vec<usize>,
    /// K^-1 b of each active pair, one after the other.
    columns: Vec<f64>,
    /// b_i . K^-1 b_j of the active pairs.
    compliance: Vec<Vec<f64>>,
}

/// Most pairs that can press at once; beyond it the deepest come first.
const MOST_ACTIVE: usize = 256;
/// Stiffness of the penalty \[N/mm3\]: a pressure of 10 MPa overlaps the faces by a micrometre.
const STIFFNESS: f64 = 1e4;

impl FaceContact {
    /// Adds the face pressures' share to the displacement `x` that the other loads cause. Returns the forces they mean.
    #[allow(clippy::too_many_arguments)] // the parts of a bone, which this module sits below
    pub fn press(
        &mut self,
        generation: u32,
        faces: &CrackFaces,
        mesh: &TetMesh,
        topology: &Topology,
        system: &System,
        scratch: &mut SolveScratch,
        x: &mut [f64],
    ) -> Vec<CellForce> {
        if self.generation != Some(generation) {
            *self = Self {
                generation: Some(generation),
                force: vec![0.0; faces.len()],
                ..Default::default()
            };
        }
        // Twice: pressing some faces may close others.
        for _ in 0..3 {
            let free = faces.openings(mesh, topology, system, x);
            let mut opening = free.clone();
            for (a, &i) in self.active.iter().enumerate() {
                let f = self.force[i];
                if f != 0.0 {
                    let column = &self.columns[a * x.len()..(a + 1) * x.len()];
                    faces
                        .pairs
                        .iter()
                        .zip(&mut opening)
                        .for_each(|(p, o)| *o += f * p.jump(mesh, topology, system, column));
                }
            }
            let mut new: Vec<usize> = (0..opening.len())
                .filter(|i| opening[*i] < 0.0 && !self.active.contains(i))
                .collect();
            new.sort_by(|a, b| opening[*a].total_cmp(&opening[*b]).then(a.cmp(b)));
            new.truncate(MOST_ACTIVE - self.active.len().min(MOST_ACTIVE));
            let none_new = new.is_empty();
            for i in new {
                self.activate(i, faces, mesh, topology, system, scratch);
            }
            self.relax(faces, &free);
            if none_new {
                break;
            }
        }
        let mut loads = Vec::new();
        for (a, &i) in self.active.iter().enumerate() {
            let f = self.force[i];
            if f > 0.0 {
                let column = &self.columns[a * x.len()..(a + 1) * x.len()];
                x.iter_mut().zip(column).for_each(|(x, c)| *x += f * c);
                loads.extend(faces.pairs[i].forces(f));
            }
        }
        loads
    }

    fn activate(
        &mut self,
        i: usize,
        faces: &CrackFaces,
        mesh: &TetMesh,
        topology: &Topology,
        system: &System,
        scratch: &mut SolveScratch,
    ) {
        let mut column = vec![0.0; system.n()];
        for f in faces.pairs[i].forces(1.0) {
            system.add_force(
                mesh,
                &topology.cells()[f.cell as usize],
                &f.weights,
                &f.force,
                &mut column,
            );
        }
        system.solve(&mut column, scratch);
        self.active.push(i);
        let row: Vec<f64> = self
            .active
            .iter()
            .map(|&j| faces.pairs[j].jump(mesh, topology, system, &column))
            .collect();
        for (other, c) in self.compliance.iter_mut().zip(&row) {
            other.push(*c);
        }
        self.compliance.push(row);
        self.columns.extend(column);
    }

    /// Projected Gauss-Seidel on the active pairs: opening + compliance of the penalty = 0 or force = 0.
    fn relax(&mut self, faces: &CrackFaces, free: &[f64]) {
        const SWEEPS: usize = 200;
        for _ in 0..SWEEPS {
            let mut change = 0.0_f64;
            for (a, &i) in self.active.iter().enumerate() {
                let row = &self.compliance[a];
                let soft = 1.0 / (STIFFNESS * faces.pairs[i].area.max(1e-6));
                let others: f64 = self
                    .active
                    .iter()
                    .zip(row)
                    .map(|(&j, c)| c * self.force[j])
                    .sum();
                let old = self.force[i];
                let new = (old - (free[i] + others + soft * old) / (row[a] + soft)).max(0.0);
                self.force[i] = new;
                change = change.max((new - old).abs() * row[a]);
            }
            if change < 1e-9 {
                break;
            }
        }
    }
}
