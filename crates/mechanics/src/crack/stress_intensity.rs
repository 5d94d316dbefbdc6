//! Energy release rate and stress intensity factors along a crack front, by domain integrals.
//!
//! Both integrals are sums of nodal values times nodal vectors of the virtual extension q, because q is interpolated
//! linearly: J = sum_a q_a . C_a with the configurational force C_a = sum_tets V f ((grad u)^T sigma - W I) grad N_a, and
//! likewise for the interaction with the field of a unit stress intensity. q is the front's advance direction times a plateau
//! weight of the distance to the front (1 closer than 1 h, 0 beyond 2 h: inside the plateau the coarse field near the front
//! does not enter) times a hat along the front.
//!
//! - Centre: the effective front, where the crack's area counted as far as it is free to open ends.
//! - Auxiliary fields: Williams' in the frame of the nearest point of the front, with the terms of its in-plane curvature
//!   (Gosz & Moran 1998): stresses as at a straight front, strains by Hooke's law, displacements turned with the frame.
//! - The body's boundary inside the domain: what the auxiliary field pulls there, and supports' reactions on it.
//! - Loads inside the domain: - int t . (grad u q), and its twin for the auxiliary field. A load's own strain, of the order
//!   F / (E h2) in the element that carries it, enters J squared and would drown G; it enters the interaction only in
//!   proportion and cancels. So where a chisel presses within the domain, G comes from K.
//! - Faces of this or another sheet that q crosses (behind a kink, at a junction): J gets + int W q . n over both faces, n out
//!   of the body. Its twin for the auxiliary field is left out: tried on kinked cracks, the product of two singular fields on
//!   ragged faces threw kinks about by 10 degrees, while without it K and J agree within 2 % behind a kink of 40 degrees.
//! - Material: the interaction integral takes the mean over the station's domain for the auxiliary field and each element's
//!   own for the real one. In an inhomogeneous body K_I : K_II : K_III are therefore those of a homogeneous body of the mean
//!   material near the front; terms of the gradient of E are left out. In an orthotropic body the auxiliary field is that of the
//!   isotropic mean, and the integrals are turned into K by the body's own near field (the law of the largest part of the domain;
//!   `anisotropic.rs`). The kink stays Amestoy and Leblond's.
use super::anisotropic::NearField;
use super::criterion::StressIntensity;
use super::cut_edges::CutEdges;
use super::cut_polygon::cut_polygon;
use super::enrichment::Topology;
use super::front::{FrontLine, LocalFrame, NearNode, Place};
use super::surface::{CrackSurface, Front, Sheet};
use super::surface_load::face_pieces;
use super::system::System;
use crate::bone::{Lame, Orthotropic, TetMaterial, stiffness};
use crate::geometry::{NO_TET, TET_FACES, TetLocator, TetMesh, Vec3};
use nalgebra::Matrix3;

/// A force \[N\] on the bone at a point of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellForce {
    /// Which cell of the topology.
    pub cell: u32,
    /// Shape functions of its tetrahedron at the point.
    pub weights: [f64; 4],
    /// The force.
    pub force: Vec3,
}

/// The state that the integrals read.
#[derive(Clone, Copy, Debug)]
pub struct Fields<'a> {
    /// The body.
    pub mesh: &'a TetMesh,
    /// Finds its tetrahedra.
    pub locator: &'a TetLocator,
    /// Material of each tetrahedron.
    pub materials: &'a [TetMaterial],
    /// What the crack has cut.
    pub cuts: &'a CutEdges,
    /// Its cells.
    pub topology: &'a Topology,
    /// Its equations.
    pub system: &'a System,
    /// Their solution.
    pub x: &'a [f64],
    /// Loads that act on the crack's faces or near them; they enter the integrals where q is not zero.
    pub loads: &'a [CellForce],
}

/// One point of a front and what drives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Position \[mm\].
    pub position: Vec3,
    /// Outward, in the crack's plane: q.
    pub advance: Vec3,
    /// Normal of the crack: n.
    pub normal: Vec3,
    /// Stress intensity factors.
    pub k: StressIntensity,
    /// Energy release rate of straight growth by the domain integral \[N/mm\].
    pub g: f64,
    /// Material near the station: mean over its domain.
    pub material: TetMaterial,
    /// Share of the station's hat that lies inside the body; below [`LEAST_INSIDE`] the values are not to be trusted.
    pub inside: f64,
    /// 1 if no other front is near; below [`LEAST_CLEAR`] another front's field enters the domain.
    pub clear: f64,
    /// How far the effective front lies ahead of the geometric one \[mm\].
    pub offset: f64,
}

/// Stations with a smaller share of their hat inside the body carry no values of their own.
pub const LEAST_INSIDE: f64 = 0.3;
/// Stations whose own place is less clear of other fronts carry no values of their own.
pub const LEAST_CLEAR: f64 = 0.5;
/// Inner and outer radius of the plateau, in element sizes.
const PLATEAU: [f64; 2] = [1.0, 2.0];
/// Half width of the hat along the front, in element sizes: a wider one smooths, a narrower one scatters by 20 % and more.
const HAT: f64 = 2.0;
/// A load on a face meets the mean of the auxiliary field over this stretch, in element sizes: single points would sample the
/// field's singularity by chance.
const LOAD_CORE: f64 = 0.5;
/// Faces closer to the front than this, in element sizes, are taken to lie in its plane: there the field is singular and coarse.
const FACES_FROM: f64 = 0.75;
/// Another front's q is 0 closer than the first and unhindered beyond the second distance, in element sizes.
const OTHER_FRONT: [f64; 2] = [0.5, 1.5];

impl Station {
    /// Right-handed frame (q, n, t = q x n) as columns.
    pub fn frame(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&[self.advance, self.normal, self.advance.cross(&self.normal)])
    }

    /// Whether its values are its own.
    pub fn is_trusted(&self) -> bool {
        self.inside >= LEAST_INSIDE && self.clear >= LEAST_CLEAR
    }
}

/// Evaluates G and K at each vertex of each front.
///
/// `h`: element size near the fronts \[mm\]. K is computed where G exceeds `k_from` times the least toughness, and zero
/// elsewhere. Costs in proportion to the elements within 2 h of the fronts. Accuracy: `tests/penny_crack.rs`.
pub fn evaluate(
    fields: &Fields,
    crack: &CrackSurface,
    fronts: &[Front],
    h: f64,
    k_from: f64,
) -> Vec<Vec<Station>> {
    let geometric = fronts
        .iter()
        .map(|f| FrontLine::new(&crack.sheets[f.sheet], f, h));
    let mut offsets = Vec::new();
    let lines: Vec<FrontLine> = geometric
        .map(|line| {
            let tets = line.tets_near(fields, 1.5 * h);
            let ahead = line.effective_offsets(fields, &tets, h);
            offsets.push(ahead.clone());
            line.moved(&ahead)
        })
        .collect();
    (0..lines.len())
        .map(|k| {
            let mut stations = Domain::new(fields, &lines, k, h).stations(k_from);
            for (station, ahead) in stations.iter_mut().zip(&offsets[k]) {
                station.position -= station.advance * *ahead;
                station.offset = *ahead;
            }
            stations
        })
        .collect()
}

/// Positions of a front's vertices and their outward directions q, as [`evaluate`] uses them; a closed front ends where it began.
pub fn front_frames(sheet: &Sheet, front: &Front, h: f64) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut line = FrontLine::new(sheet, front, h);
    if front.closed {
        line.points.push(line.points[0]);
        line.advance.push(line.advance[0]);
    }
    (line.points, line.advance)
}

/// Normals of the crack at a front's vertices, as [`evaluate`] uses them.
pub fn front_normals(sheet: &Sheet, front: &Front, h: f64) -> Vec<Vec3> {
    FrontLine::new(sheet, front, h).normal
}

/// What surrounds one front.
struct Domain<'a> {
    fields: &'a Fields<'a>,
    line: &'a FrontLine,
    h: f64,
    near: Vec<NearNode>,
    /// q of each nearby node but for the hat.
    extension: Vec<Vec3>,
    states: Vec<CellState>,
    faces: Vec<FaceState>,
    clear: Vec<f64>,
}

/// The fields of one cell: constant in a linear tetrahedron.
struct CellState {
    tet: u32,
    /// Where the four nodes are in the list of nearby nodes.
    places: [Option<u32>; 4],
    volume: f64,
    grad_u: Matrix3<f64>,
    stress: Matrix3<f64>,
    /// Where its centre is, and on which side of the crack.
    at: Option<(Place, LocalFrame, Side)>,
}

/// Which face of the crack a point behind the front belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Side {
    Above,
    Below,
    /// As its position says.
    Plain,
}

/// A piece of the crack's face that does not lie in the plane of the front, seen from one cell.
struct FaceState {
    /// Its cell in the list of states.
    state: usize,
    weights: [f64; 4],
    /// Out of the cell, as long as the piece's area.
    outward: Vec3,
}

fn plateau(r: f64, h: f64) -> f64 {
    ((PLATEAU[1] - r / h) / (PLATEAU[1] - PLATEAU[0])).clamp(0.0, 1.0)
}

/// 0 at another front, 1 where it is far.
fn clearance(lines: &[FrontLine], own: usize, p: &Vec3, h: f64) -> f64 {
    let others = lines.iter().enumerate().filter(|(k, _)| *k != own);
    let nearest = others
        .filter_map(|(_, l)| l.project(p, OTHER_FRONT[1] * h))
        .map(|(r, _)| r / h)
        .fold(OTHER_FRONT[1], f64::min);
    ((nearest - OTHER_FRONT[0]) / (OTHER_FRONT[1] - OTHER_FRONT[0])).clamp(0.0, 1.0)
}

impl<'a> Domain<'a> {
    fn new(fields: &'a Fields, lines: &'a [FrontLine], own: usize, h: f64) -> Self {
        let line = &lines[own];
        let reach = PLATEAU[1] * h;
        let candidates = line.tets_near(fields, reach);
        let near = line.nodes_near(fields.mesh, &candidates, reach);
        let weight = |n: &NearNode| {
            plateau(n.r, h) * clearance(lines, own, &fields.mesh.nodes()[n.node as usize], h)
        };
        let extension: Vec<Vec3> = near
            .iter()
            .map(|n| line.frame_at(n.s).advance * weight(n))
            .collect();
        let is_near = |n: &u32| near.binary_search_by_key(n, |x| x.node).is_ok();
        let tets: Vec<u32> = candidates
            .into_iter()
            .filter(|&t| fields.mesh.tets()[t as usize].iter().any(is_near))
            .collect();
        let mut domain = Self {
            clear: line
                .points
                .iter()
                .map(|p| clearance(lines, own, p, h))
                .collect(),
            fields,
            line,
            h,
            near,
            extension,
            states: Vec::new(),
            faces: Vec::new(),
        };
        for t in tets {
            domain.push_states(t);
        }
        domain
    }

    fn push_states(&mut self, t: u32) {
        let fields = self.fields;
        let nodes = &fields.mesh.tets()[t as usize];
        let place = |n: u32| self.near.binary_search_by_key(&n, |x| x.node).ok();
        let places = nodes.map(|n| place(n).map(|p| p as u32));
        let corners = fields.mesh.corners(t as usize);
        let middle: Vec3 = corners.iter().sum::<Vec3>() / 4.0;
        let divided = fields.topology.is_divided(t);
        for c in fields.topology.cells_of(t) {
            let cell = &fields.topology.cells()[c];
            let u = fields
                .system
                .cell_displacements(fields.mesh, cell, fields.x);
            let grad_u = stiffness::displacement_gradient(&fields.mesh.gradients()[t as usize], &u);
            let own: Vec3 = mean_of(&corners, cell.mask);
            let centre = if divided {
                (middle + own) * 0.5
            } else {
                middle
            };
            let at = self
                .line
                .place(&centre, 2.0 * PLATEAU[1] * self.h)
                .map(|(p, f)| {
                    let side = match (own - middle).dot(&f.normal) {
                        _ if !divided => Side::Plain,
                        d if d < 0.0 => Side::Below,
                        _ => Side::Above,
                    };
                    (p, f, side)
                });
            if divided {
                self.push_faces(cell, &own);
            }
            self.states.push(CellState {
                tet: t,
                places,
                volume: fields.mesh.volumes()[t as usize] * cell.fraction,
                grad_u,
                stress: fields.materials[t as usize].elasticity().stress(&grad_u),
                at,
            });
        }
    }

    /// The faces of a cell that q crosses; those in the front's plane count nothing.
    fn push_faces(&mut self, cell: &super::enrichment::Cell, own: &Vec3) {
        let mesh = self.fields.mesh;
        let corners = cut_polygon(mesh, self.fields.cuts, cell);
        let centre = corners.iter().sum::<Vec3>() / corners.len() as f64;
        for k in 0..corners.len() {
            let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
            let at = (a + b + centre) / 3.0;
            let Some((place, frame)) = self.line.place(&at, PLATEAU[1] * self.h) else {
                continue;
            };
            if place.r < FACES_FROM * self.h {
                continue;
            }
            let mut outward = (a - centre).cross(&(b - centre)) * 0.5;
            if outward.dot(&(own - centre)) > 0.0 {
                outward = -outward;
            }
            let steep = outward.dot(&frame.advance).abs() > 0.15 * outward.norm();
            if steep || place.y.abs() > 0.15 * self.h {
                self.faces.push(FaceState {
                    state: self.states.len(),
                    weights: mesh.barycentric(cell.tet as usize, &at),
                    outward,
                });
            }
        }
    }

    fn stations(&self, k_from: f64) -> Vec<Station> {
        let line = self.line;
        let inside = line.inside_share(self.fields, HAT * self.h);
        let mut by_arc: Vec<usize> = (0..self.near.len()).collect();
        by_arc.sort_by(|a, b| self.near[*a].s.total_cmp(&self.near[*b].s).then(a.cmp(b)));
        let forces = self.configurational_forces();
        let materials = self.mean_materials();
        let mut stations: Vec<Station> = (0..line.points.len())
            .map(|k| Station {
                position: line.points[k],
                advance: line.advance[k],
                normal: line.normal[k],
                k: StressIntensity::default(),
                g: self.sum(
                    k,
                    inside[k].1,
                    |n| self.extension[n].dot(&forces[n]),
                    &by_arc,
                ),
                material: materials[k],
                inside: inside[k].0,
                clear: self.clear[k],
                offset: 0.0,
            })
            .collect();
        let loaded = self.loaded_nodes();
        let is_loaded: Vec<bool> = (0..stations.len())
            .map(|k| self.sum(k, inside[k].1, |n| loaded[n], &by_arc) > 0.0)
            .collect();
        let is_driven = |(k, s): &(usize, &mut Station)| {
            let least = s.material.toughness_along.min(s.material.toughness_across);
            is_loaded[*k] || s.g > k_from * least
        };
        if !stations.iter_mut().enumerate().any(|s| is_driven(&s)) {
            return stations;
        }
        let driven: Vec<usize> = (stations.iter_mut().enumerate())
            .filter(is_driven)
            .map(|(k, _)| k)
            .collect();
        let interaction = self.interaction_forces(&materials, &self.wanted(&driven));
        for (k, s) in stations.iter_mut().enumerate().filter(is_driven) {
            let mode = |m: usize| {
                self.sum(
                    k,
                    inside[k].1,
                    |n| self.extension[n].dot(&interaction[n][m]),
                    &by_arc,
                )
            };
            let (e, mu) = (s.material.plane_strain_modulus(), s.material.lame().mu);
            s.k = StressIntensity {
                k1: 0.5 * e * mode(0),
                k2: 0.5 * e * mode(1),
                k3: mu * mode(2),
            };
            let near = s
                .material
                .orthotropic
                .and_then(|law| NearField::new(&law, &s.frame()));
            if let Some(near) = &near {
                let own = near.intensities(&s.material.lame(), [0, 1, 2].map(mode));
                s.k = own.unwrap_or(s.k);
            }
            if is_loaded[k] {
                let isotropic = s.k.straight_release(s.material.poisson_ratio) / e;
                s.g = near.map_or(isotropic, |near| near.release(&s.k));
            }
        }
        stations
    }

    /// The extension of each nearby node that carries a load, zero for the others \[1\].
    fn loaded_nodes(&self) -> Vec<f64> {
        let mut loaded = vec![0.0; self.near.len()];
        self.for_loads(|p, _, _, load| {
            if load.force != Vec3::zeros() {
                loaded[p] = self.extension[p].norm();
            }
        });
        loaded
    }

    /// Sum over the nodes within the hat of vertex `k`, a unit of front length.
    fn sum(&self, k: usize, length: f64, value: impl Fn(usize) -> f64, by_arc: &[usize]) -> f64 {
        if length <= 0.0 {
            return 0.0;
        }
        let (at, half_width) = (self.line.arc[k], HAT * self.h);
        let s_of = |i: &usize| self.near[*i].s;
        let turn = self.line.closed_length;
        let shifts = [Some(0.0), turn, turn.map(|l| -l)];
        let mut sum = 0.0;
        for shift in shifts.into_iter().flatten() {
            let from = by_arc.partition_point(|i| s_of(i) <= at + shift - half_width);
            let to = by_arc.partition_point(|i| s_of(i) < at + shift + half_width);
            for &n in &by_arc[from..to] {
                sum += value(n) * (1.0 - (s_of(&n) - at - shift).abs() / half_width);
            }
        }
        sum / length
    }

    /// Adds V M grad N_a to the sums of nearby nodes.
    fn add_on_nodes(&self, state: &CellState, m: &Matrix3<f64>, mut add: impl FnMut(usize, Vec3)) {
        let gradients = &self.fields.mesh.gradients()[state.tet as usize];
        for (place, gradient) in state.places.iter().zip(gradients) {
            if let Some(p) = place {
                add(*p as usize, m * gradient * state.volume);
            }
        }
    }

    fn configurational_forces(&self) -> Vec<Vec3> {
        let mut c = vec![Vec3::zeros(); self.near.len()];
        let density = |s: &CellState| stiffness::energy_density(&s.stress, &s.grad_u);
        for s in &self.states {
            let m = s.grad_u.transpose() * s.stress - Matrix3::from_diagonal_element(density(s));
            self.add_on_nodes(s, &m, |p, v| c[p] += v);
        }
        for f in &self.faces {
            let s = &self.states[f.state];
            for (place, w) in s.places.iter().zip(f.weights) {
                if let Some(p) = place {
                    c[*p as usize] += f.outward * (w * density(s));
                }
            }
        }
        self.for_loads(|p, weight, grad_u, load| {
            c[p] -= grad_u.transpose() * load.force * weight;
        });
        c
    }

    /// Calls `f(position in near, shape function, displacement gradient, load)` for each load and node near the front.
    fn for_loads(&self, mut f: impl FnMut(usize, f64, &Matrix3<f64>, &CellForce)) {
        let fields = self.fields;
        for load in fields.loads {
            let cell = &fields.topology.cells()[load.cell as usize];
            let nodes = &fields.mesh.tets()[cell.tet as usize];
            let places = nodes.map(|n| self.near.binary_search_by_key(&n, |x| x.node).ok());
            if places.iter().all(Option::is_none) {
                continue;
            }
            let u = fields
                .system
                .cell_displacements(fields.mesh, cell, fields.x);
            let grad_u =
                stiffness::displacement_gradient(&fields.mesh.gradients()[cell.tet as usize], &u);
            for (place, w) in places.iter().zip(&load.weights) {
                if let Some(p) = place {
                    f(*p, *w, &grad_u, load);
                }
            }
        }
    }

    /// Material near each vertex: mean over its domain, weighted by volume and hat.
    fn mean_materials(&self) -> Vec<TetMaterial> {
        let mut sums = vec![MaterialSum::default(); self.line.points.len()];
        for s in &self.states {
            let weight: f64 = s
                .places
                .iter()
                .flatten()
                .map(|p| self.extension[*p as usize].norm())
                .sum();
            let Some((place, _, _)) = &s.at else { continue };
            for k in self.line.vertices_within(place.s, HAT * self.h) {
                let hat = self.line.hat(place.s, self.line.arc[k], HAT * self.h);
                sums[k].add(
                    &self.fields.materials[s.tet as usize],
                    weight * hat * s.volume,
                );
            }
        }
        sums.iter()
            .map(|s| s.mean(&self.fields.materials[0]))
            .collect()
    }

    /// Which states enter the sums of the given vertices.
    fn wanted(&self, vertices: &[usize]) -> Vec<bool> {
        let mut nodes = vec![false; self.near.len()];
        for (wanted, n) in nodes.iter_mut().zip(&self.near) {
            let reaches = |k: &usize| self.line.hat(n.s, self.line.arc[*k], HAT * self.h) > 0.0;
            *wanted = vertices.iter().any(reaches);
        }
        let of = |s: &CellState| s.places.iter().flatten().any(|p| nodes[*p as usize]);
        self.states.iter().map(of).collect()
    }

    /// The nodal vectors of the interaction with unit K_I, K_II and K_III, from the wanted states.
    fn interaction_forces(&self, materials: &[TetMaterial], wanted: &[bool]) -> Vec<[Vec3; 3]> {
        let mut c = vec![[Vec3::zeros(); 3]; self.near.len()];
        let lame_at = |s: f64| {
            let (a, b, w) = self.line.between(s);
            let (a, b) = (materials[a].lame(), materials[b].lame());
            Lame {
                lambda: a.lambda * (1.0 - w) + b.lambda * w,
                mu: a.mu * (1.0 - w) + b.mu * w,
            }
        };
        for (s, _) in self.states.iter().zip(wanted).filter(|s| *s.1) {
            let Some((place, frame, side)) = &s.at else {
                continue;
            };
            for (mode, aux) in auxiliary(place, frame, *side, &lame_at(place.s))
                .iter()
                .enumerate()
            {
                let density = s.stress.dot(&aux.strain);
                let m = aux.grad_u.transpose() * s.stress + s.grad_u.transpose() * aux.stress
                    - Matrix3::from_diagonal_element(density);
                self.add_on_nodes(s, &m, |p, v| c[p][mode] += v);
                // Out-of-balance and incompatibility of the auxiliary field at a curved front.
                let along = frame.advance * s.stress.dot(&aux.misfit_slope);
                let volume = (s.grad_u.transpose() * aux.body_force + along) * (0.25 * s.volume);
                for p in s.places.iter().flatten() {
                    c[*p as usize][mode] += volume;
                }
            }
        }
        self.add_load_interaction(&lame_at, &mut c);
        self.add_boundary_interaction(&lame_at, wanted, &mut c);
        c
    }

    /// Where q reaches the body's boundary the auxiliary field pulls at it: - int (grad u^T sigma_aux n - w n) . q, and where a
    /// support holds it, its reaction works on the auxiliary field. Without these, faces across the front turn K_I into K_III of
    /// either sign (18 % of K_I at the ends of an edge crack in plane strain).
    fn add_boundary_interaction(
        &self,
        lame_at: &impl Fn(f64) -> Lame,
        wanted: &[bool],
        c: &mut [[Vec3; 3]],
    ) {
        let fields = self.fields;
        let mesh = fields.mesh;
        for (i, first) in self.states.iter().enumerate() {
            // The first of a tetrahedron's states stands for all: they have the same nodes.
            if !wanted[i] || (i > 0 && self.states[i - 1].tet == first.tet) {
                continue;
            }
            let t = first.tet as usize;
            for k in (0..4).filter(|&k| mesh.neighbours()[t][k] == NO_TET) {
                let outward = -mesh.gradients()[t][k].normalize();
                let held = TET_FACES[k].map(|n| fields.system.held_axes(mesh.tets()[t][n]));
                let axes = [0, 1, 2].map(|a| held.iter().all(|h| h[a]));
                let pieces = face_pieces(mesh, fields.cuts, fields.topology, first.tet, k);
                for (cell, piece) in pieces {
                    let state =
                        &self.states[i + cell as usize - fields.topology.cells_of(first.tet).start];
                    let traction = state.stress * outward;
                    let reaction = Vec3::from_fn(|a, _| if axes[a] { traction[a] } else { 0.0 });
                    self.add_face(state, &outward, &reaction, &piece, lame_at, c);
                }
            }
        }
    }

    /// One piece of a boundary face.
    fn add_face(
        &self,
        state: &CellState,
        outward: &Vec3,
        reaction: &Vec3,
        piece: &[[f64; 4]; 3],
        lame_at: &impl Fn(f64) -> Lame,
        c: &mut [[Vec3; 3]],
    ) {
        let Some((_, _, side)) = state.at else {
            return;
        };
        let x = self.fields.mesh.corners(state.tet as usize);
        let at = |n: &[f64; 4]| (0..4).map(|i| x[i] * n[i]).sum::<Vec3>();
        let [a, b, d] = [0, 1, 2].map(|i| at(&piece[i]));
        let area = 0.5 * (b - a).cross(&(d - a)).norm();
        for [u, v, w] in parts_of_a_triangle() {
            let weights: [f64; 4] =
                std::array::from_fn(|i| u * piece[0][i] + v * piece[1][i] + w * piece[2][i]);
            let Some((place, frame)) = self.line.place(&at(&weights), PLATEAU[1] * self.h) else {
                continue;
            };
            if place.r < BOUNDARY_FROM * self.h {
                continue;
            }
            let share = area / (PARTS * PARTS) as f64;
            for (mode, aux) in auxiliary(&place, &frame, side, &lame_at(place.s))
                .iter()
                .enumerate()
            {
                let pull = state.grad_u.transpose() * (aux.stress * outward);
                let density = state.stress.dot(&aux.strain);
                let sum = pull + aux.grad_u.transpose() * reaction - outward * density;
                for (p, n) in state.places.iter().zip(weights) {
                    if let Some(p) = p {
                        c[*p as usize][mode] -= sum * (n * share);
                    }
                }
            }
        }
    }

    fn add_load_interaction(&self, lame_at: &impl Fn(f64) -> Lame, c: &mut [[Vec3; 3]]) {
        let fields = self.fields;
        for load in fields.loads {
            let cell = &fields.topology.cells()[load.cell as usize];
            let nodes = &fields.mesh.tets()[cell.tet as usize];
            let places = nodes.map(|n| self.near.binary_search_by_key(&n, |x| x.node).ok());
            if places.iter().all(Option::is_none) {
                continue;
            }
            let corners = fields.mesh.corners(cell.tet as usize);
            let point: Vec3 = (0..4).map(|k| corners[k] * load.weights[k]).sum();
            let Some((mut place, frame)) = self.line.place(&point, 2.0 * PLATEAU[1] * self.h)
            else {
                continue;
            };
            let up = (mean_of(&corners, cell.mask) - corners.iter().sum::<Vec3>() / 4.0)
                .dot(&frame.normal);
            let side = match cell.mask {
                0b1111 => Side::Plain,
                _ if up < 0.0 => Side::Below,
                _ => Side::Above,
            };
            if cell.mask != 0b1111 && place.x < 0.0 {
                if place.x > -LOAD_CORE * self.h {
                    place.y = 0.0;
                }
                place.x = smeared(place.x, 0.5 * LOAD_CORE * self.h);
            }
            for (mode, aux) in auxiliary(&place, &frame, side, &lame_at(place.s))
                .iter()
                .enumerate()
            {
                let v = aux.grad_u.transpose() * load.force;
                for (p, w) in places.iter().zip(&load.weights) {
                    if let Some(p) = p {
                        c[*p][mode] -= v * *w;
                    }
                }
            }
        }
    }
}

/// Parts of an edge that boundary faces are cut into for integration: the auxiliary field is singular.
const PARTS: usize = 3;
/// Closer to the front than this, in element sizes, boundary faces are left out.
const BOUNDARY_FROM: f64 = 0.02;

/// Centres of the parts of a triangle, as shares of its corners.
fn parts_of_a_triangle() -> impl Iterator<Item = [f64; 3]> {
    let third = 1.0 / (3 * PARTS) as f64;
    (0..PARTS).flat_map(move |i| {
        (0..PARTS - i).flat_map(move |j| {
            let centre = |i: usize, j: usize, shift: usize| {
                let (u, v) = (
                    (3 * i + shift) as f64 * third,
                    (3 * j + shift) as f64 * third,
                );
                [u, v, 1.0 - u - v]
            };
            let upright = Some(centre(i, j, 1));
            let inverted = (i + j + 1 < PARTS).then(|| centre(i, j, 2));
            upright.into_iter().chain(inverted)
        })
    })
}

/// Where behind the front 1 / sqrt(-x) has the value of its mean over `half` to either side, mirrored at the front so that no
/// share of a pressure up to the front is lost.
fn smeared(x: f64, half: f64) -> f64 {
    let (far, near) = (half - x, -half - x);
    let mean = (far.sqrt() - near.abs().sqrt().copysign(near)) / half;
    -1.0 / (mean * mean)
}

fn mean_of(corners: &[Vec3; 4], mask: u8) -> Vec3 {
    let inside = (0..4).filter(|k| mask >> k & 1 == 1);
    inside.map(|k| corners[k]).sum::<Vec3>() / f64::from(mask.count_ones().max(1))
}

/// Mean of materials by weight. Osteons have no sense, so their directions are summed towards the first one met.
#[derive(Clone, Debug, Default)]
struct MaterialSum {
    weight: f64,
    values: [f64; 4],
    osteon: Vec3,
    /// The orthotropic law of the largest part, and its weight.
    law: Option<(f64, Orthotropic)>,
}

impl MaterialSum {
    fn add(&mut self, m: &TetMaterial, weight: f64) {
        self.weight += weight;
        let values = [
            m.young_modulus,
            m.poisson_ratio,
            m.toughness_along,
            m.toughness_across,
        ];
        self.values
            .iter_mut()
            .zip(values)
            .for_each(|(s, v)| *s += weight * v);
        if let Some(law) = m.orthotropic
            && self.law.is_none_or(|(w, _)| weight > w)
        {
            self.law = Some((weight, law));
        }
        let sense = if m.osteon.dot(&self.osteon) < 0.0 {
            -weight
        } else {
            weight
        };
        self.osteon += m.osteon * sense;
    }

    fn mean(&self, fallback: &TetMaterial) -> TetMaterial {
        if self.weight <= 0.0 {
            return *fallback;
        }
        let [
            young_modulus,
            poisson_ratio,
            toughness_along,
            toughness_across,
        ] = self.values.map(|v| v / self.weight);
        TetMaterial {
            young_modulus,
            poisson_ratio,
            orthotropic: self.law.map(|l| l.1),
            toughness_along,
            toughness_across,
            osteon: self.osteon.try_normalize(1e-12).unwrap_or(fallback.osteon),
        }
    }
}

/// The field of a unit stress intensity at a point, in world axes.
struct Auxiliary {
    /// Displacement gradient, turned with the front's frame.
    grad_u: Matrix3<f64>,
    /// Strain by Hooke's law from `stress`: that of a straight front.
    strain: Matrix3<f64>,
    stress: Matrix3<f64>,
    /// div stress.
    body_force: Vec3,
    /// d/dq of sym grad_u - strain.
    misfit_slope: Matrix3<f64>,
}

/// The fields of unit K_I, K_II, K_III beside a front of constant in-plane curvature.
///
/// Along t the frame turns: dq/dt = t / rho, dt/dt = - q / rho with rho = 1 / curvature + x.
fn auxiliary(place: &Place, frame: &LocalFrame, side: Side, lame: &Lame) -> [Auxiliary; 3] {
    let axes = Matrix3::from_columns(&[
        frame.advance,
        frame.normal,
        frame.advance.cross(&frame.normal),
    ]);
    let turned = |m: Matrix3<f64>| axes * m * axes.transpose();
    let per_rho = frame.curvature / (1.0 + frame.curvature * place.x).max(0.15);
    williams(place.x, place.y, side, lame).map(|w| {
        let strain = (w.gradient + w.gradient.transpose()) * 0.5;
        let stress = stiffness::stress(lame, &w.gradient);
        let mut gradient = w.gradient;
        gradient[(2, 2)] += w.u.x * per_rho;
        gradient[(0, 2)] -= w.u.z * per_rho;
        let mut slope = Matrix3::zeros();
        let slide = |u: f64, du: f64| (du - u * per_rho) * per_rho;
        slope[(2, 2)] = slide(w.u.x, w.gradient[(0, 0)]);
        slope[(0, 2)] = -0.5 * slide(w.u.z, w.gradient[(2, 0)]);
        slope[(2, 0)] = slope[(0, 2)];
        let force = Vec3::new(
            stress[(0, 0)] - stress[(2, 2)],
            stress[(0, 1)],
            2.0 * stress[(0, 2)],
        ) * per_rho;
        Auxiliary {
            grad_u: turned(gradient),
            strain: turned(strain),
            stress: turned(stress),
            body_force: axes * force,
            misfit_slope: turned(slope),
        }
    })
}

/// Displacement and its gradient in the frame of a straight front.
pub(super) struct Williams {
    u: Vec3,
    pub(super) gradient: Matrix3<f64>,
}

/// Williams' fields of unit K_I, K_II, K_III at (x, y), plane strain. Behind the front the side decides on which sheet of the
/// square root a point lies; past the plane of the front the fields are continued.
pub(super) fn williams(x: f64, y: f64, side: Side, lame: &Lame) -> [Williams; 3] {
    use std::f64::consts::PI;
    let r = x.hypot(y).max(1e-9);
    let plain = y.atan2(x);
    let theta = match side {
        Side::Above if x < 0.0 && y < 0.0 => plain + 2.0 * PI,
        Side::Below if x < 0.0 && y >= 0.0 => plain - 2.0 * PI,
        _ => plain,
    };
    let nu = lame.lambda / (2.0 * (lame.lambda + lame.mu));
    let kappa = 3.0 - 4.0 * nu;
    let (s, c) = (0.5 * theta).sin_cos();
    let (sin, cos) = theta.sin_cos();
    let scale = 1.0 / (2.0 * PI * r).sqrt();
    // A displacement factor sqrt(r / 2 pi) f(theta), given f and df/dtheta: value and gradient.
    let row = |factor: f64, f: f64, df: f64| {
        let v = factor * scale;
        (
            v * r * f,
            [
                v * (0.5 * cos * f - sin * df),
                v * (0.5 * sin * f + cos * df),
            ],
        )
    };
    let field = |rows: [(f64, [f64; 2]); 3]| Williams {
        u: Vec3::new(rows[0].0, rows[1].0, rows[2].0),
        gradient: Matrix3::from_fn(|i, j| if j < 2 { rows[i].1[j] } else { 0.0 }),
    };
    let plane = 0.5 / lame.mu;
    let none = (0.0, [0.0; 2]);
    [
        field([
            row(plane, c * (kappa - cos), -0.5 * s * (kappa - cos) + c * sin),
            row(plane, s * (kappa - cos), 0.5 * c * (kappa - cos) + s * sin),
            none,
        ]),
        field([
            row(
                plane,
                s * (kappa + 2.0 + cos),
                0.5 * c * (kappa + 2.0 + cos) - s * sin,
            ),
            row(
                plane,
                -c * (kappa - 2.0 + cos),
                0.5 * s * (kappa - 2.0 + cos) + c * sin,
            ),
            none,
        ]),
        field([none, none, row(2.0 / lame.mu, s, 0.5 * c)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The auxiliary fields are in equilibrium and leave the faces free: checked by finite differences.
    #[test]
    fn auxiliary_fields_are_in_equilibrium() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        let stress = |mode: usize, x: f64, y: f64| {
            stiffness::stress(&lame, &williams(x, y, Side::Plain, &lame)[mode].gradient)
        };
        let d = 1e-5;
        for mode in 0..3 {
            for (x, y) in [(0.7, 0.4), (-0.3, 0.8), (-0.5, -0.2), (0.1, -0.9)] {
                let along = (stress(mode, x + d, y) - stress(mode, x - d, y)) / (2.0 * d);
                let across = (stress(mode, x, y + d) - stress(mode, x, y - d)) / (2.0 * d);
                let force = along.column(0) + across.column(1);
                assert!(
                    force.norm() < 1e-6 * stress(mode, x, y).norm(),
                    "mode {mode} at ({x}, {y}): {force}"
                );
            }
            for y in [1e-12, -1e-12] {
                let face = stress(mode, -1.0, y).column(1).norm();
                assert!(face < 1e-8, "mode {mode}: traction {face} on the face");
            }
        }
    }

    /// Unit K_I means sigma_yy = 1 / sqrt(2 pi r) ahead of the front; likewise the others.
    #[test]
    fn auxiliary_fields_have_unit_intensity() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        for (mode, component) in [(0, (1, 1)), (1, (0, 1)), (2, (2, 1))] {
            let s = stiffness::stress(
                &lame,
                &williams(2.0, 0.0, Side::Plain, &lame)[mode].gradient,
            );
            let expected = 1.0 / (2.0 * std::f64::consts::PI * 2.0).sqrt();
            assert!(
                (s[component] - expected).abs() < 1e-12,
                "mode {mode}: {}",
                s[component]
            );
        }
    }
}
