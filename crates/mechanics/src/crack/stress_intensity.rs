//! Energy release rate and stress intensity factors along a crack front, by domain integrals.
//!
//! Both integrals are sums of nodal values times nodal vectors of the virtual extension q, because q is interpolated
//! linearly: J = sum_a q_a . C_a with the configurational force C_a = sum_tets V f ((grad u)^T sigma - W I) grad N_a.
//! q is the front's advance direction times a plateau weight of the distance to the front (1 closer than 1 h, 0 beyond
//! 2 h: inside the plateau the coarse field near the front does not enter) times a hat along the front.
use super::criterion::StressIntensity;
use super::enrichment::Topology;
use super::surface::{Front, Sheet};
use super::system::System;
use crate::bone::{Lame, TetMaterial, stiffness};
use crate::geometry::{Aabb, TetLocator, TetMesh, Vec3};
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
}

/// Stations with a smaller share of their hat inside the body carry no values of their own.
pub const LEAST_INSIDE: f64 = 0.3;
/// Inner and outer radius of the plateau, in element sizes.
const PLATEAU: [f64; 2] = [1.0, 2.0];
/// Half width of the hat along the front, in element sizes: a wider one smooths, a narrower one scatters by 20 % and more.
const HAT: f64 = 2.0;

impl Station {
    /// Right-handed frame (q, n, t = q x n) as columns.
    pub fn frame(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&[self.advance, self.normal, self.advance.cross(&self.normal)])
    }
}

/// Evaluates G and K at each vertex of a front.
///
/// `h`: element size near the front \[mm\]. K is computed where G exceeds `k_from` times the least toughness, and zero
/// elsewhere. Accuracy: `tests/penny_crack.rs`.
pub fn evaluate(
    fields: &Fields,
    sheet: &Sheet,
    front: &Front,
    h: f64,
    k_from: f64,
) -> Vec<Station> {
    let line = FrontLine::new(sheet, front, h);
    let near = line.nearby_nodes(fields, PLATEAU[1] * h);
    let inside = line.inside_share(fields, HAT * h);
    let tets = tets_of(fields.mesh, &near);
    let states: Vec<CellState> = tets
        .iter()
        .flat_map(|&t| cell_states(fields, &near, t))
        .collect();
    let forces = configurational_forces(fields, &states, &near);
    line.points
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let hat = |s: f64| line.hat(s, line.arc[k], HAT * h);
            let extension: Vec<Vec3> = near
                .iter()
                .map(|n| line.advance_at(n.s) * (plateau(n.r, h) * hat(n.s)))
                .collect();
            let material = mean_material(fields, &states, &extension);
            let mut station = Station {
                position: *p,
                advance: line.advance[k],
                normal: line.normal[k],
                k: StressIntensity::default(),
                g: 0.0,
                material,
                inside: inside[k].0,
            };
            let length = inside[k].1;
            if length > 0.0 {
                station.g = extension
                    .iter()
                    .zip(&forces)
                    .map(|(q, c)| q.dot(c))
                    .sum::<f64>()
                    / length;
            }
            if length > 0.0
                && station.g > k_from * material.toughness_along.min(material.toughness_across)
            {
                station.k = interaction(
                    fields,
                    &states,
                    &near,
                    &extension,
                    &station,
                    &material.lame(),
                    length,
                );
            }
            station
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

fn plateau(r: f64, h: f64) -> f64 {
    ((PLATEAU[1] - r / h) / (PLATEAU[1] - PLATEAU[0])).clamp(0.0, 1.0)
}

/// A front as a smooth curve with frames.
struct FrontLine {
    points: Vec<Vec3>,
    arc: Vec<f64>,
    advance: Vec<Vec3>,
    normal: Vec<Vec3>,
    closed_length: Option<f64>,
}

/// A node near the front: distance and place along it.
struct NearNode {
    node: u32,
    r: f64,
    s: f64,
}

impl FrontLine {
    fn new(sheet: &Sheet, front: &Front, h: f64) -> Self {
        let points: Vec<Vec3> = front
            .vertices
            .iter()
            .map(|&v| sheet.mesh.vertices[v as usize])
            .collect();
        let n = points.len();
        let mut arc = vec![0.0];
        for k in 1..n {
            arc.push(arc[k - 1] + (points[k] - points[k - 1]).norm());
        }
        let closed_length = front
            .closed
            .then(|| arc[n - 1] + (points[0] - points[n - 1]).norm());
        let mut line = Self {
            points,
            arc,
            advance: Vec::new(),
            normal: Vec::new(),
            closed_length,
        };
        line.set_frames(sheet, front, h);
        line
    }

    /// Normals from the triangles at the front, averaged over about one element size; q from the chord.
    fn set_frames(&mut self, sheet: &Sheet, front: &Front, h: f64) {
        let n = self.points.len();
        let mut raw = vec![Vec3::zeros(); n];
        let place: rustc_hash::FxHashMap<u32, usize> = front
            .vertices
            .iter()
            .enumerate()
            .map(|(k, v)| (*v, k))
            .collect();
        for (t, triangle) in sheet.mesh.triangles.iter().enumerate() {
            // Only triangles with an edge on the front say which way the crack is heading.
            let on_front: Vec<usize> = triangle
                .iter()
                .filter_map(|v| place.get(v).copied())
                .collect();
            let neighbours =
                |a: usize, b: usize| a.abs_diff(b) == 1 || (front.closed && a.abs_diff(b) == n - 1);
            if on_front.len() >= 2 && neighbours(on_front[0], on_front[1]) {
                on_front
                    .iter()
                    .for_each(|&k| raw[k] += sheet.mesh.area_normal(t));
            }
        }
        let unit = |v: Vec3| v.try_normalize(1e-12).unwrap_or_else(Vec3::zeros);
        let raw: Vec<Vec3> = raw.into_iter().map(unit).collect();
        for k in 0..n {
            let weight = |j: usize| self.hat(self.arc[j], self.arc[k], 1.5 * h).max(1e-6);
            let normal = unit((0..n).map(|j| raw[j] * weight(j)).sum());
            let chord: Vec3 = (0..n).map(|j| self.direction(j) * weight(j)).sum();
            self.advance.push(unit(chord.cross(&normal)));
            self.normal.push(normal);
        }
    }

    fn direction(&self, k: usize) -> Vec3 {
        let n = self.points.len();
        let closed = self.closed_length.is_some();
        let before = if k > 0 {
            k - 1
        } else if closed {
            n - 1
        } else {
            0
        };
        let after = if k + 1 < n {
            k + 1
        } else if closed {
            0
        } else {
            n - 1
        };
        (self.points[after] - self.points[before])
            .try_normalize(1e-12)
            .unwrap_or_else(Vec3::zeros)
    }

    fn hat(&self, s: f64, at: f64, half_width: f64) -> f64 {
        let mut d = (s - at).abs();
        if let Some(length) = self.closed_length {
            d = d.min(length - d);
        }
        (1.0 - d / half_width).max(0.0)
    }

    fn advance_at(&self, s: f64) -> Vec3 {
        let n = self.points.len();
        let k = self.arc.partition_point(|a| *a <= s).clamp(1, n) - 1;
        let (after, end) = if k + 1 < n {
            (k + 1, self.arc[k + 1])
        } else {
            (0, self.closed_length.unwrap_or(self.arc[k]))
        };
        let w = if end > self.arc[k] {
            ((s - self.arc[k]) / (end - self.arc[k])).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (self.advance[k] * (1.0 - w) + self.advance[after] * w)
            .try_normalize(1e-12)
            .unwrap_or(self.advance[k])
    }

    fn segments(&self) -> impl Iterator<Item = (Vec3, Vec3, f64)> {
        let n = self.points.len();
        let last = if self.closed_length.is_some() {
            n
        } else {
            n - 1
        };
        (0..last).map(move |k| (self.points[k], self.points[(k + 1) % n], self.arc[k]))
    }

    /// Distance to the front and arc length of the nearest point.
    fn project(&self, p: &Vec3) -> (f64, f64) {
        let mut best = (f64::INFINITY, 0.0);
        for (a, b, s) in self.segments() {
            let d = b - a;
            let w = ((p - a).dot(&d) / d.norm_squared().max(1e-18)).clamp(0.0, 1.0);
            let r = (a + d * w - p).norm();
            if r < best.0 {
                best = (r, s + w * d.norm());
            }
        }
        best
    }

    fn nearby_nodes(&self, fields: &Fields, reach: f64) -> Vec<NearNode> {
        let region = Aabb::around(&self.points).grown(reach);
        let nodes = fields
            .mesh
            .nodes()
            .iter()
            .enumerate()
            .filter(|(_, p)| region.contains(p));
        nodes
            .map(|(i, p)| {
                let (r, s) = self.project(p);
                NearNode {
                    node: i as u32,
                    r,
                    s,
                }
            })
            .filter(|n| n.r < reach)
            .collect()
    }

    /// For each vertex: share of its hat inside the body, and the integral of the hat there \[mm\].
    fn inside_share(&self, fields: &Fields, half_width: f64) -> Vec<(f64, f64)> {
        const SAMPLES: usize = 4;
        let mut samples = Vec::new();
        for (a, b, s) in self.segments() {
            let d = b - a;
            for k in 0..SAMPLES {
                let w = (k as f64 + 0.5) / SAMPLES as f64;
                let is_in = fields.locator.find(fields.mesh, &(a + d * w)).is_some();
                samples.push((s + w * d.norm(), d.norm() / SAMPLES as f64, is_in));
            }
        }
        self.arc
            .iter()
            .map(|&at| {
                let part = |only_in: bool| -> f64 {
                    let counted = samples.iter().filter(|x| x.2 || !only_in);
                    counted.map(|x| x.1 * self.hat(x.0, at, half_width)).sum()
                };
                let (all, inside) = (part(false), part(true));
                (if all > 0.0 { inside / all } else { 0.0 }, inside)
            })
            .collect()
    }
}

fn tets_of(mesh: &TetMesh, near: &[NearNode]) -> Vec<u32> {
    let mut tets: Vec<u32> = near
        .iter()
        .flat_map(|n| mesh.tets_of_node(n.node as usize))
        .copied()
        .collect();
    tets.sort_unstable();
    tets.dedup();
    tets
}

/// The fields of one cell: constant in a linear tetrahedron.
struct CellState {
    tet: u32,
    /// Where the four nodes are in the list of nearby nodes.
    places: [Option<u32>; 4],
    volume: f64,
    centre: Vec3,
    /// Mean of the nodes on the cell's own side minus the tetrahedron's centre: which side of the crack this is.
    side: Option<Vec3>,
    grad_u: Matrix3<f64>,
    stress: Matrix3<f64>,
}

fn cell_states<'a>(
    fields: &'a Fields,
    near: &[NearNode],
    t: u32,
) -> impl Iterator<Item = CellState> + use<'a> {
    let place = |n: u32| {
        near.binary_search_by_key(&n, |x| x.node)
            .ok()
            .map(|p| p as u32)
    };
    let places = fields.mesh.tets()[t as usize].map(place);
    let corners = fields.mesh.corners(t as usize);
    let middle: Vec3 = corners.iter().sum::<Vec3>() / 4.0;
    let divided = fields.topology.is_divided(t);
    fields.topology.cells_of(t).map(move |c| {
        let cell = &fields.topology.cells()[c];
        let u = fields
            .system
            .cell_displacements(fields.mesh, cell, fields.x);
        let grad_u = stiffness::displacement_gradient(&fields.mesh.gradients()[t as usize], &u);
        let own = (0..4)
            .filter(|k| cell.mask >> k & 1 == 1)
            .map(|k| corners[k])
            .sum::<Vec3>()
            / f64::from(cell.mask.count_ones());
        CellState {
            tet: t,
            places,
            volume: fields.mesh.volumes()[t as usize] * cell.fraction,
            centre: if divided {
                (middle + own) * 0.5
            } else {
                middle
            },
            side: divided.then(|| own - middle),
            grad_u,
            stress: stiffness::stress(&fields.materials[t as usize].lame(), &grad_u),
        }
    })
}

/// Adds V M grad N_a to the list of nearby nodes.
fn add_on_nodes(fields: &Fields, state: &CellState, m: &Matrix3<f64>, sum: &mut [Vec3]) {
    let gradients = &fields.mesh.gradients()[state.tet as usize];
    for (place, gradient) in state.places.iter().zip(gradients) {
        if let Some(p) = place {
            sum[*p as usize] += m * gradient * state.volume;
        }
    }
}

fn configurational_forces(fields: &Fields, states: &[CellState], near: &[NearNode]) -> Vec<Vec3> {
    let mut c = vec![Vec3::zeros(); near.len()];
    for s in states {
        let w = stiffness::energy_density(&s.stress, &s.grad_u);
        let m = s.grad_u.transpose() * s.stress - Matrix3::from_diagonal_element(w);
        add_on_nodes(fields, s, &m, &mut c);
    }
    // Loads inside the domain: - int t . (grad u q).
    for_loads(fields, near, |p, weight, grad_u, force| {
        c[p] -= grad_u.transpose() * force * weight;
    });
    c
}

/// Calls `f(position in near, shape function, displacement gradient, force)` for each load and node near the front.
fn for_loads(
    fields: &Fields,
    near: &[NearNode],
    mut f: impl FnMut(usize, f64, &Matrix3<f64>, &Vec3),
) {
    for load in fields.loads {
        let cell = &fields.topology.cells()[load.cell as usize];
        let nodes = &fields.mesh.tets()[cell.tet as usize];
        let places = nodes.map(|n| near.binary_search_by_key(&n, |x| x.node).ok());
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
                f(*p, *w, &grad_u, &load.force);
            }
        }
    }
}

/// Material near a station: mean over its domain, weighted by volume and extension. Osteons have no sense, so their
/// directions are summed towards the first one met.
fn mean_material(fields: &Fields, states: &[CellState], extension: &[Vec3]) -> TetMaterial {
    let (mut total, mut sum) = (0.0, [0.0; 4]);
    let mut osteon = Vec3::zeros();
    for s in states {
        let reach: f64 = s
            .places
            .iter()
            .flatten()
            .map(|p| extension[*p as usize].norm())
            .sum();
        if reach == 0.0 {
            continue;
        }
        let m = &fields.materials[s.tet as usize];
        let weight = s.volume * reach;
        total += weight;
        let values = [
            m.young_modulus,
            m.poisson_ratio,
            m.toughness_along,
            m.toughness_across,
        ];
        (0..4).for_each(|k| sum[k] += weight * values[k]);
        osteon += m.osteon
            * if m.osteon.dot(&osteon) < 0.0 {
                -weight
            } else {
                weight
            };
    }
    if total <= 0.0 {
        return fields.materials[0];
    }
    let [
        young_modulus,
        poisson_ratio,
        toughness_along,
        toughness_across,
    ] = sum.map(|v| v / total);
    let osteon = osteon
        .try_normalize(1e-12)
        .unwrap_or(fields.materials[0].osteon);
    TetMaterial {
        young_modulus,
        poisson_ratio,
        toughness_along,
        toughness_across,
        osteon,
    }
}

/// Stress intensity factors by the interaction integral with straight auxiliary fields in the station's frame.
fn interaction(
    fields: &Fields,
    states: &[CellState],
    near: &[NearNode],
    extension: &[Vec3],
    station: &Station,
    lame: &Lame,
    length: f64,
) -> StressIntensity {
    let frame = station.frame();
    let auxiliary = |centre: &Vec3, side: Option<Vec3>| {
        let mut p = frame.transpose() * (centre - station.position);
        if let Some(side) = side {
            // On a curved crack the side comes from the topology, not from the straight frame.
            p.y = p.y.abs().max(1e-6)
                * if side.dot(&station.normal) < 0.0 {
                    -1.0
                } else {
                    1.0
                };
        }
        auxiliary_gradients(p.x, p.y, lame).map(|g| frame * g * frame.transpose())
    };
    let mut sums = [0.0; 3];
    for s in states {
        let moved = |k: usize| s.places[k].map_or_else(Vec3::zeros, |p| extension[p as usize]);
        let grad_q = stiffness::displacement_gradient(
            &fields.mesh.gradients()[s.tet as usize],
            &[0, 1, 2, 3].map(moved),
        );
        if grad_q == Matrix3::zeros() {
            continue;
        }
        for (sum, aux) in sums.iter_mut().zip(auxiliary(&s.centre, s.side)) {
            let aux_stress = stiffness::stress(lame, &aux);
            let m = aux.transpose() * s.stress + s.grad_u.transpose() * aux_stress;
            *sum += s.volume * (m.dot(&grad_q) - s.stress.dot(&aux) * grad_q.trace());
        }
    }
    for load in fields.loads {
        let cell = &fields.topology.cells()[load.cell as usize];
        let corners = fields.mesh.corners(cell.tet as usize);
        let q: Vec3 = (0..4)
            .filter_map(|k| {
                let place = near
                    .binary_search_by_key(&fields.mesh.tets()[cell.tet as usize][k], |x| x.node)
                    .ok()?;
                Some(extension[place] * load.weights[k])
            })
            .sum();
        if q == Vec3::zeros() {
            continue;
        }
        let point: Vec3 = (0..4).map(|k| corners[k] * load.weights[k]).sum();
        let own = (0..4)
            .filter(|k| cell.mask >> k & 1 == 1)
            .map(|k| corners[k])
            .sum::<Vec3>()
            / f64::from(cell.mask.count_ones());
        let side = (cell.mask != 0b1111).then(|| own - corners.iter().sum::<Vec3>() / 4.0);
        for (sum, aux) in sums.iter_mut().zip(auxiliary(&point, side)) {
            *sum -= load.force.dot(&(aux * q));
        }
    }
    let (e, mu) = (station.material.plane_strain_modulus(), lame.mu);
    let [i1, i2, i3] = sums.map(|v| v / length);
    StressIntensity {
        k1: 0.5 * e * i1,
        k2: 0.5 * e * i2,
        k3: mu * i3,
    }
}

/// Displacement gradients of the Williams fields of unit K_I, K_II, K_III at (x, y) in the frame of a straight front, plane
/// strain.
fn auxiliary_gradients(x: f64, y: f64, lame: &Lame) -> [Matrix3<f64>; 3] {
    let r = x.hypot(y).max(1e-9);
    let theta = y.atan2(x);
    let nu = lame.lambda / (2.0 * (lame.lambda + lame.mu));
    let kappa = 3.0 - 4.0 * nu;
    let (s, c) = (0.5 * theta).sin_cos();
    let (sin, cos) = theta.sin_cos();
    let scale = 1.0 / (2.0 * std::f64::consts::PI * r).sqrt();
    // A displacement sqrt(r / 2 pi) factor f(theta), given f and df/dtheta, has this gradient:
    let gradient = |factor: f64, f: f64, df: f64| {
        let v = factor * scale;
        [
            v * (0.5 * cos * f - sin * df),
            v * (0.5 * sin * f + cos * df),
        ]
    };
    let plane = 0.5 / lame.mu;
    let rows = |rows: [[f64; 2]; 3]| Matrix3::from_fn(|i, j| if j < 2 { rows[i][j] } else { 0.0 });
    let none = [0.0; 2];
    [
        rows([
            gradient(plane, c * (kappa - cos), -0.5 * s * (kappa - cos) + c * sin),
            gradient(plane, s * (kappa - cos), 0.5 * c * (kappa - cos) + s * sin),
            none,
        ]),
        rows([
            gradient(
                plane,
                s * (kappa + 2.0 + cos),
                0.5 * c * (kappa + 2.0 + cos) - s * sin,
            ),
            gradient(
                plane,
                -c * (kappa - 2.0 + cos),
                0.5 * s * (kappa - 2.0 + cos) + c * sin,
            ),
            none,
        ]),
        rows([none, none, gradient(2.0 / lame.mu, s, 0.5 * c)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The auxiliary fields are in equilibrium and leave the faces free: checked by finite differences.
    #[test]
    fn auxiliary_fields_are_in_equilibrium() {
        let lame = TetMaterial::isotropic(1000.0, 0.3, 1.0).lame();
        let stress = |mode, x: f64, y: f64| {
            stiffness::stress(&lame, &auxiliary_gradients(x, y, &lame)[mode])
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
            let s = stiffness::stress(&lame, &auxiliary_gradients(2.0, 0.0, &lame)[mode]);
            let expected = 1.0 / (2.0 * std::f64::consts::PI * 2.0).sqrt();
            assert!(
                (s[component] - expected).abs() < 1e-12,
                "mode {mode}: {}",
                s[component]
            );
        }
    }
}
