//! The two faces of the crack must not pass through each other.
//!
//! One contact point a divided tetrahedron, with the opening g = gap + n . (u_+ - u_-). Pressures p >= 0 where g < 0 by a
//! penalty that is stiff against the bone; because the bone's compliance at these points is known from half solves with the
//! kept factor, the penalty is solved implicitly (projected Gauss-Seidel) and never limits the relaxation.
use super::bone::Bone;
use super::yielding::Yielding;
use crate::bone::{HalfSolved, Region, SolveScratch, Swept};
use crate::crack::stress_intensity::CellForce;
use crate::crack::{Cell, CrackedBody, CutEdges, System, cut_area};
use crate::geometry::{Aabb, TetMesh, Vec3};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

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

/// Keeps the faces apart; remembers pressures (for the warm start) and compliances.
#[derive(Debug, Default)]
pub struct FaceContact {
    generation: Option<u32>,
    /// The equations of that generation.
    system: Option<Arc<System>>,
    /// Pairs whose unit forces are half solved, in the order in which they were met.
    known: Vec<Known>,
    /// These unit forces, some together, and b_i . K^-1 b_j of each two of these batches, the later by the earlier.
    half: Vec<HalfSolved>,
    compliance: Vec<Vec<Vec<f64>>>,
    /// The known pairs that may press in this step.
    active: Vec<usize>,
    /// How the patches under the tools move by each batch in this step: B^T K^-1 b.
    at_patches: Vec<Option<DMatrix<f64>>>,
    /// Opening of each pair at the start of the step \[mm\].
    opening: Vec<f64>,
}

/// A pair whose unit force is half solved.
#[derive(Debug)]
struct Known {
    /// Which pair, and its tetrahedron.
    pair: usize,
    tet: u32,
    /// Its unit force: (unknown, value).
    load: Vec<(u32, f64)>,
    /// Where its half-solved force is: batch and column.
    at: (usize, usize),
    /// \[N\]
    force: f64,
}

/// Most pairs that are known at once; beyond it the deepest come first.
const MOST_KNOWN: usize = 256;
/// Most pairs taken in at once: where the deepest are pressed apart, most others no longer overlap.
const MOST_NEW: usize = 24;
/// Known pairs that do not press and are farther apart than this \[mm\] take no part until they overlap.
const NEAR: f64 = 0.02;
/// Stiffness of the penalty \[N/mm3\]: a pressure of 10 MPa overlaps the faces by a micrometre.
const STIFFNESS: f64 = 1e4;

impl FaceContact {
    /// Begins a step from the displacements `before`.
    pub fn start(&mut self, bone: &Bone, before: &[f64]) {
        self.follow(bone);
        self.opening = bone.faces.openings(bone, before);
        let may_press = |k: &usize| {
            let known = &self.known[*k];
            known.force > 0.0 || self.opening[known.pair] < NEAR
        };
        self.active = (0..self.known.len()).filter(may_press).collect();
        self.at_patches = vec![None; self.half.len()];
    }

    /// Solves for the way `moved` from the start of the step in a region that has all cells of the faces, under the loads that are half
    /// solved in `swept` and the faces' pressures, which are added to it, with what the tools give way under them. Returns these forces,
    /// and whether no further faces overlap then; those that do are pressed apart from the next call on.
    pub fn press(
        &mut self,
        bone: &Bone,
        region: &Region,
        yielding: Option<&Yielding>,
        swept: &mut Swept,
        moved: &mut [f64],
        scratch: &mut SolveScratch,
    ) -> (Vec<CellForce>, bool) {
        self.relax(bone, yielding, swept);
        let mut forces: Vec<_> = (self.half.iter())
            .map(|half| vec![0.0; half.n_columns()])
            .collect();
        for k in &self.active {
            let known = &self.known[*k];
            forces[known.at.0][known.at.1] = known.force;
        }
        for (half, own) in self.half.iter().zip(&forces) {
            bone.system.add_half(half, own, swept);
        }
        (bone.system).sweep_down_region(region, swept, moved, scratch);
        let pressing = self.active.iter().map(|k| &self.known[*k]);
        let pressures = pressing
            .filter(|k| k.force > 0.0)
            .flat_map(|k| bone.faces.pairs[k.pair].forces(k.force))
            .collect();
        let overlapping = self.overlapping(bone, moved);
        self.take_in(bone, &overlapping);
        (pressures, overlapping.is_empty())
    }

    /// On a new generation the pairs that press stay known where they still are, with the force they had.
    fn follow(&mut self, bone: &Bone) {
        if self.generation == Some(bone.generation) {
            return;
        }
        let old = std::mem::take(self);
        self.generation = Some(bone.generation);
        self.system = Some(Arc::clone(&bone.system));
        let tet_of = |p: &FacePair| bone.topology.cells()[p.cells[0] as usize].tet;
        let pairs = &bone.faces.pairs;
        let has_room = old.known.len() <= MOST_KNOWN / 2;
        let is_appended = |s: &Arc<System>| has_room && bone.system.has_grown_from(s);
        let before = old.system.filter(is_appended).map(|s| s.n() as u32);
        let mut again = Vec::new();
        let mut kept = Vec::new();
        for known in old.known {
            let Ok(pair) = pairs.binary_search_by_key(&known.tet, tet_of) else {
                continue;
            };
            let load = bone.sparse_loads(&pairs[pair].forces(1.0));
            let is_same = before.is_some_and(|n| {
                let older = load.partition_point(|l| l.0 < n);
                load[..older] == known.load
            });
            if is_same {
                kept.push(Known {
                    pair,
                    load,
                    ..known
                });
            } else if known.force > 0.0 {
                again.push((pair, known.force));
            }
        }
        if let Some(n_before) = before {
            self.keep(bone, n_before, kept, old.half, &old.compliance);
        }
        let (pairs, forces): (Vec<usize>, Vec<f64>) = again.into_iter().unzip();
        let first = self.known.len();
        self.half_solve(bone, &pairs);
        (self.known[first..].iter_mut().zip(forces)).for_each(|(known, force)| known.force = force);
    }

    /// Takes over what is half solved of an earlier generation with `n_before` unknowns: batches of which some pair presses.
    fn keep(
        &mut self,
        bone: &Bone,
        n_before: u32,
        mut kept: Vec<Known>,
        half: Vec<HalfSolved>,
        compliance: &[Vec<Vec<f64>>],
    ) {
        let mut is_kept = vec![false; half.len()];
        let pressing = kept.iter().filter(|k| k.force > 0.0);
        pressing.for_each(|k| is_kept[k.at.0] = true);
        kept.retain(|k| is_kept[k.at.0]);
        let mut batches = Vec::new();
        for (b, mut half) in half.into_iter().enumerate().filter(|b| is_kept[b.0]) {
            let mut columns = vec![Vec::new(); half.n_columns()];
            for known in kept.iter_mut().filter(|k| k.at.0 == b) {
                let newer = known.load.partition_point(|l| l.0 < n_before);
                columns[known.at.1] = known.load[newer..].to_vec();
            }
            let n_border = half.n_border();
            bone.system.extend(&mut half, &columns);
            self.half.push(half);
            batches.push((b, n_border));
        }
        for (i, (a, n_border)) in batches.iter().enumerate() {
            let block = |(j, (b, _)): (usize, &(usize, usize))| {
                let more = self.half[i].compliance_from(*n_border, &self.half[j]);
                let all = compliance[*a][*b].iter().zip(more).map(|(c, m)| c + m);
                all.collect()
            };
            let row = batches[..=i].iter().enumerate().map(block).collect();
            self.compliance.push(row);
        }
        let place = |b: usize| batches.partition_point(|(a, _)| *a < b);
        kept.iter_mut().for_each(|k| k.at.0 = place(k.at.0));
        self.known = kept;
    }

    /// The pairs that overlap after the way `moved` and are not active, the deepest first, as many as may become so.
    fn overlapping(&self, bone: &Bone, moved: &[f64]) -> Vec<usize> {
        let pairs = bone.faces.pairs.iter().zip(&self.opening);
        let opening: Vec<f64> = pairs.map(|(p, o)| o + p.jump(bone, moved)).collect();
        let mut is_active = vec![false; opening.len()];
        let active = self.active.iter().map(|k| self.known[*k].pair);
        active.for_each(|pair| is_active[pair] = true);
        let mut new: Vec<usize> = (0..opening.len())
            .filter(|i| opening[*i] < 0.0 && !is_active[*i])
            .collect();
        new.sort_by(|a, b| opening[*a].total_cmp(&opening[*b]).then(a.cmp(b)));
        new.truncate(MOST_NEW);
        new
    }

    /// Lets pairs press, without force yet.
    fn take_in(&mut self, bone: &Bone, new: &[usize]) {
        let known = |pair: &usize| self.known.iter().position(|k| k.pair == *pair);
        let (found, unknown): (Vec<_>, Vec<_>) =
            (new.iter().map(|pair| (known(pair), *pair))).partition(|(known, _)| known.is_some());
        self.active
            .extend(found.iter().filter_map(|(known, _)| *known));
        let room = MOST_KNOWN - self.known.len().min(MOST_KNOWN);
        let unknown: Vec<usize> = unknown.into_iter().map(|u| u.1).take(room).collect();
        let first = self.known.len();
        self.half_solve(bone, &unknown);
        self.active.extend(first..self.known.len());
        self.at_patches.resize(self.half.len(), None);
    }

    /// Makes pairs known, without force yet.
    fn half_solve(&mut self, bone: &Bone, new: &[usize]) {
        if new.is_empty() {
            return;
        }
        let pairs = &bone.faces.pairs;
        let unit = |i: &usize| bone.sparse_loads(&pairs[*i].forces(1.0));
        let columns: Vec<_> = new.iter().map(unit).collect();
        let batch = self.half.len();
        self.half.push(bone.system.half_solve(&columns));
        let newest = &self.half[batch];
        let row = self.half.iter().map(|half| newest.compliance(half));
        self.compliance.push(row.collect());
        let known = new.iter().zip(columns).enumerate();
        self.known
            .extend(known.map(|(column, (&pair, load))| Known {
                pair,
                tet: bone.topology.cells()[pairs[pair].cells[0] as usize].tet,
                load,
                at: (batch, column),
                force: 0.0,
            }));
    }

    /// b_i . K^-1 b_j of two known pairs.
    fn compliance(&self, i: usize, j: usize) -> f64 {
        let (a, b) = (self.known[i].at, self.known[j].at);
        let (late, early) = if a.0 >= b.0 { (a, b) } else { (b, a) };
        self.compliance[late.0][early.0][late.1 + self.half[late.0].n_columns() * early.1]
    }

    /// Projected Gauss-Seidel on the active pairs: opening + compliance of the penalty = 0 or force = 0. The tools' yielding is part of
    /// the compliance: what lies loose between a tool and a face is moved by both.
    fn relax(&mut self, bone: &Bone, yielding: Option<&Yielding>, swept: &mut Swept) {
        const SWEEPS: usize = 200;
        let faces = &bone.faces;
        let n = self.active.len();
        if n == 0 {
            return;
        }
        let mut columns = vec![Vec::new(); self.half.len()];
        let mut places = vec![Vec::new(); self.half.len()];
        for (a, k) in self.active.iter().enumerate() {
            let (batch, column) = self.known[*k].at;
            columns[batch].push(column);
            places[batch].push(a);
        }
        let mut free: Vec<f64> = (self.active.iter())
            .map(|k| self.opening[self.known[*k].pair])
            .collect();
        for (half, (columns, places)) in self.half.iter().zip(columns.iter().zip(&places)) {
            if !columns.is_empty() {
                let moved = bone.system.project_some(half, columns, swept);
                places.iter().zip(moved).for_each(|(a, u)| free[*a] += u);
            }
        }
        let mut compliance =
            DMatrix::from_fn(n, n, |a, b| self.compliance(self.active[a], self.active[b]));
        let at_patches = yielding.map(|yielding| {
            let mut all = DMatrix::zeros(yielding.n_columns(), n);
            for (batch, (columns, places)) in columns.iter().zip(&places).enumerate() {
                if columns.is_empty() {
                    continue;
                }
                let half = &self.half[batch];
                let of = self.at_patches[batch].get_or_insert_with(|| yielding.moved_by(half));
                for (column, a) in columns.iter().zip(places) {
                    all.set_column(*a, &of.column(*column));
                }
            }
            compliance -= all.transpose() * yielding.given_way(&all);
            all
        });
        // Most pairs that once pressed no longer do: only changes are told to the others.
        let mut force: Vec<f64> = self.active.iter().map(|k| self.known[*k].force).collect();
        let mut pressed = vec![0.0; n];
        let tell = |a: usize, by: f64, pressed: &mut [f64]| {
            let column = compliance.column(a);
            let pairs = pressed.iter_mut().zip(column.iter());
            pairs.for_each(|(p, c)| *p += c * by);
        };
        let pressing = force.iter().enumerate().filter(|f| *f.1 > 0.0);
        pressing.for_each(|(a, f)| tell(a, *f, &mut pressed));
        for _ in 0..SWEEPS {
            let mut change = 0.0_f64;
            for a in 0..n {
                let area = faces.pairs[self.known[self.active[a]].pair].area;
                let (own, soft) = (compliance[(a, a)], 1.0 / (STIFFNESS * area.max(1e-6)));
                let old = force[a];
                let new = (old - (free[a] + pressed[a] + soft * old) / (own + soft)).max(0.0);
                if new != old {
                    force[a] = new;
                    tell(a, new - old, &mut pressed);
                    change = change.max((new - old).abs() * own);
                }
            }
            if change < 1e-9 {
                break;
            }
        }
        for (k, f) in self.active.iter().zip(&force) {
            self.known[*k].force = *f;
        }
        if let (Some(yielding), Some(at_patches)) = (yielding, at_patches) {
            yielding.follow(bone, &(at_patches * DVector::from_vec(force)), swept);
        }
    }
}
