//! The two faces of the crack must not pass through each other.
//!
//! One contact point a divided tetrahedron, with the opening g = gap + n . (u_+ - u_-). Pressures p >= 0 where g < 0 by a
//! penalty that is stiff against the bone; because the bone's compliance at these points is known from half solves with the
//! kept factor, the penalty is solved implicitly (projected Gauss-Seidel) and never limits the relaxation.
use super::bone::Bone;
use crate::bone::{HalfSolved, Region, SolveScratch, Swept};
use crate::crack::stress_intensity::CellForce;
use crate::crack::{Cell, CrackedBody, CutEdges, cut_area};
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

/// Where the two faces of the crack lie opposite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FacePlace {
    /// In the undeformed body \[mm\].
    pub position: Vec3,
    /// Unit vector to the side that a positive force pushes along it.
    pub normal: Vec3,
    /// Width of the kerf \[mm\]; zero where the bone broke.
    pub gap: f64,
    /// \[mm2\]
    pub area: f64,
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
    /// Places a pair in each tetrahedron that the crack divides in two, unless one of them has crumbled off.
    pub fn new(body: &CrackedBody) -> Self {
        Self::of(divided_tets(body).map(|t| Divided::new(body, t)))
    }

    /// The faces of a body that has grown from `before`, whose faces these are. Where the crack grew they are made anew: what
    /// was cut ahead of a saw's front has now its own sheet, which has no kerf.
    pub fn grown(&self, before: &CrackedBody, body: &CrackedBody) -> Self {
        let beside = tets_beside_growth(before, body);
        let mut known = self.divided.iter().peekable();
        Self::of(divided_tets(body).map(|t| {
            let old = known.next_if(|d| d.tet == t);
            let cells = body.topology.cells_of(t);
            match old {
                Some(old)
                    if before.topology.cells_of(t).len() == cells.len()
                        && !(beside[t as usize] && old.is_in_kerf())
                        && !body.has_crumbled(before, t) =>
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

    /// The cells on both sides of each pair.
    pub fn cells(&self) -> impl Iterator<Item = u32> {
        self.pairs.iter().flat_map(|p| p.cells)
    }

    /// Where each pair is.
    pub fn places(&self, body: &CrackedBody) -> impl Iterator<Item = FacePlace> {
        let mesh = &body.solid.mesh;
        self.pairs.iter().map(|p| {
            let tet = body.topology.cells()[p.cells[0] as usize].tet;
            let corners = mesh.corners(tet as usize);
            FacePlace {
                position: (0..4).map(|k| corners[k] * p.weights[k]).sum(),
                normal: p.normal,
                gap: p.gap,
                area: p.area,
            }
        })
    }

    /// Forces that push the two faces of a pair apart with `force` \[N\] each.
    pub fn push_apart(&self, pair: usize, force: f64) -> [CellForce; 2] {
        self.pairs[pair].forces(force)
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
    pub fn openings(&self, body: &CrackedBody, x: &[f64]) -> Vec<f64> {
        self.pairs.iter().map(|p| p.gap + p.jump(body, x)).collect()
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
        let both = cells.len() == 2 && !cells.clone().any(|c| body.is_debris(c as u32));
        Self {
            tet,
            area: divided_area(&body.solid.mesh, &body.cuts, &body.topology.cells()[cells]),
            pair: both.then(|| pair(body, tet)).flatten(),
        }
    }

    /// Whether its faces are a saw cut's walls, as far as is known.
    fn is_in_kerf(&self) -> bool {
        self.pair.is_none_or(|p| p.gap > 0.0)
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
    fn jump(&self, body: &CrackedBody, x: &[f64]) -> f64 {
        let at = |cell: u32| -> Vec3 {
            let cell = &body.topology.cells()[cell as usize];
            let u = body.system.cell_displacements(&body.solid.mesh, cell, x);
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

/// Keeps the faces apart; remembers pressures (for the warm start) and, within a bone generation, compliances.
#[derive(Debug, Default)]
pub struct FaceContact {
    generation: Option<u32>,
    /// Force of each active pair \[N\].
    force: Vec<f64>,
    /// Pairs whose compliance is known, in the order they were met.
    active: Vec<usize>,
    /// The tetrahedron of each active pair.
    tets: Vec<u32>,
    /// The active pairs' unit forces, half solved.
    half: Vec<HalfSolved>,
    /// b_i . K^-1 b_j of the active pairs.
    compliance: Vec<Vec<f64>>,
    /// Opening of each pair at the start of the step \[mm\].
    opening: Vec<f64>,
}

/// Most pairs that can press at once; beyond it the deepest come first.
const MOST_ACTIVE: usize = 256;
/// Most pairs taken in at once: where the deepest are pressed apart, most others no longer overlap.
const MOST_NEW: usize = 24;
/// Stiffness of the penalty \[N/mm3\]: a pressure of 10 MPa overlaps the faces by a micrometre.
const STIFFNESS: f64 = 1e4;

impl FaceContact {
    /// Begins a step from the displacements `before`.
    pub fn start(&mut self, bone: &Bone, before: &[f64]) {
        self.follow(bone);
        self.opening = bone.faces.openings(bone, before);
    }

    /// Solves for the way `moved` from the start of the step in a region that has all cells of the faces, under the loads that are half
    /// solved in `swept` and the faces' pressures, which are added to it. Returns these forces, and whether no further faces overlap
    /// then; those that do are pressed apart from the next call on.
    pub fn press(
        &mut self,
        bone: &Bone,
        region: &Region,
        swept: &mut Swept,
        moved: &mut [f64],
        scratch: &mut SolveScratch,
    ) -> (Vec<CellForce>, bool) {
        self.relax(bone, swept);
        let mut forces = &self.force[..];
        for half in &self.half {
            let (own, rest) = forces.split_at(half.n_columns());
            bone.system.add_half(half, own, swept);
            forces = rest;
        }
        (bone.system).sweep_down_region(region, swept, moved, scratch);
        let pressing = self.active.iter().zip(&self.force).filter(|p| *p.1 > 0.0);
        let pressures = pressing
            .flat_map(|(&i, &f)| bone.faces.pairs[i].forces(f))
            .collect();
        let overlapping = self.overlapping(bone, moved);
        self.take_in(bone, &overlapping);
        (pressures, overlapping.is_empty())
    }

    /// On a new generation the pairs that press stay active where they still are, with the force they had.
    fn follow(&mut self, bone: &Bone) {
        if self.generation == Some(bone.generation) {
            return;
        }
        let tet_of = |p: &FacePair| bone.topology.cells()[p.cells[0] as usize].tet;
        let pairs = &bone.faces.pairs;
        let old = std::mem::take(self);
        self.generation = Some(bone.generation);
        let pressing = old.tets.iter().zip(old.force).filter(|p| p.1 > 0.0);
        let kept =
            pressing.filter_map(|(t, f)| Some((pairs.binary_search_by_key(t, tet_of).ok()?, f)));
        let (kept, force): (Vec<usize>, Vec<f64>) = kept.unzip();
        self.take_in(bone, &kept);
        self.force = force;
    }

    /// The pairs that overlap after the way `moved` and are not active, the deepest first, as many as may become so.
    fn overlapping(&self, bone: &Bone, moved: &[f64]) -> Vec<usize> {
        let pairs = bone.faces.pairs.iter().zip(&self.opening);
        let opening: Vec<f64> = pairs.map(|(p, o)| o + p.jump(bone, moved)).collect();
        let mut new: Vec<usize> = (0..opening.len())
            .filter(|i| opening[*i] < 0.0 && !self.active.contains(i))
            .collect();
        new.sort_by(|a, b| opening[*a].total_cmp(&opening[*b]).then(a.cmp(b)));
        new.truncate(MOST_NEW.min(MOST_ACTIVE - self.active.len().min(MOST_ACTIVE)));
        new
    }

    /// Makes pairs active, without force yet.
    fn take_in(&mut self, bone: &Bone, new: &[usize]) {
        if new.is_empty() {
            return;
        }
        let pairs = &bone.faces.pairs;
        let unit = |i: &usize| bone.sparse_loads(&pairs[*i].forces(1.0));
        let columns: Vec<_> = new.iter().map(unit).collect();
        self.half.push(bone.system.half_solve(&columns));
        let newest = &self.half[self.half.len() - 1];
        let first = self.active.len();
        self.compliance.resize(first + new.len(), Vec::new());
        let mut column = 0;
        for half in &self.half {
            // One row a known pair, one column a new one.
            let block = half.compliance(newest);
            for (k, c) in block.iter().enumerate() {
                let (i, j) = (column + k % half.n_columns(), first + k / half.n_columns());
                self.compliance[j].push(*c);
                if i < first {
                    self.compliance[i].push(*c);
                }
            }
            column += half.n_columns();
        }
        let tet_of = |i: &usize| bone.topology.cells()[pairs[*i].cells[0] as usize].tet;
        self.tets.extend(new.iter().map(tet_of));
        self.active.extend(new);
        self.force.resize(self.active.len(), 0.0);
    }

    /// Projected Gauss-Seidel on the active pairs: opening + compliance of the penalty = 0 or force = 0.
    fn relax(&mut self, bone: &Bone, swept: &Swept) {
        const SWEEPS: usize = 200;
        let faces = &bone.faces;
        let moved = self.half.iter().flat_map(|h| bone.system.project(h, swept));
        let free: Vec<f64> = (self.active.iter().zip(moved))
            .map(|(&i, u)| self.opening[i] + u)
            .collect();
        // Most pairs that once pressed no longer do: only changes are told to the others.
        let mut pressed = vec![0.0; self.active.len()];
        let tell = |row: &[f64], by: f64, pressed: &mut [f64]| {
            let pairs = pressed.iter_mut().zip(row);
            pairs.for_each(|(p, c)| *p += c * by);
        };
        let pressing = self.compliance.iter().zip(&self.force);
        (pressing.filter(|p| *p.1 > 0.0)).for_each(|(row, f)| tell(row, *f, &mut pressed));
        for _ in 0..SWEEPS {
            let mut change = 0.0_f64;
            for (a, &i) in self.active.iter().enumerate() {
                let row = &self.compliance[a];
                let soft = 1.0 / (STIFFNESS * faces.pairs[i].area.max(1e-6));
                let old = self.force[a];
                let new = (old - (free[a] + pressed[a] + soft * old) / (row[a] + soft)).max(0.0);
                if new != old {
                    self.force[a] = new;
                    tell(row, new - old, &mut pressed);
                    change = change.max((new - old).abs() * row[a]);
                }
            }
            if change < 1e-9 {
                break;
            }
        }
    }
}
