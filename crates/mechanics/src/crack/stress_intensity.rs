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
//! - Material: the auxiliary fields are those of the material at the front (mean within .6 h). Where an element is of another one, their
//!   strain goes by its law, and what their stress and strain then lack in compatibility is added (the interaction integral of Yu et
//!   al. 2009, which no interface disturbs); G goes by K there, since J counts the pull of every interface within its domain as the
//!   crack's: with a tenfold stiffer material 0 to 1 h ahead it was 2.3 to 3.4 times what is released, with a softer one half
//!   (`tests/inhomogeneous_cracks.rs`). In an orthotropic body the auxiliary field is that of the isotropic mean, and the integrals are
//!   turned into K by the body's own near field (the law of the largest part of the domain; `anisotropic.rs`). The kink stays Amestoy
//!   and Leblond's.
use super::anisotropic::NearField;
use super::criterion::StressIntensity;
use super::cut_edges::CutEdges;
use super::domain::{Domain, NearCell};
use super::enrichment::Topology;
use super::front::FrontLine;
use super::surface::{CrackSurface, Front, Sheet};
use super::system::System;
use super::toughness_ahead::ToughnessAhead;
use crate::bone::{TetMaterial, stiffness};
use crate::geometry::{TetLocator, TetMesh, Vec3};
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

impl Fields<'_> {
    /// Displacement gradient in a cell: constant in a linear tetrahedron.
    fn gradient(&self, cell: u32) -> Matrix3<f64> {
        let cell = &self.topology.cells()[cell as usize];
        let u = self.system.cell_displacements(self.mesh, cell, self.x);
        stiffness::displacement_gradient(&self.mesh.gradients()[cell.tet as usize], &u)
    }
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
    /// What a growth would have to tear, where that is not one and the same.
    pub ahead: Option<ToughnessAhead>,
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
impl Station {
    /// At the origin, under opening alone, advancing along x in the plane z = 0.
    #[cfg(test)]
    pub(crate) fn of_mode_one() -> Self {
        Self {
            position: Vec3::zeros(),
            advance: Vec3::x(),
            normal: Vec3::z(),
            k: StressIntensity {
                k1: 1.0,
                k2: 0.0,
                k3: 0.0,
            },
            g: 1.0,
            material: TetMaterial::isotropic(1.0, 0.3, 1.0),
            ahead: None,
            inside: 1.0,
            clear: 1.0,
            offset: 0.0,
        }
    }

    /// Right-handed frame (q, n, t = q x n) as columns.
    pub fn frame(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&[self.advance, self.normal, self.advance.cross(&self.normal)])
    }

    /// Whether its values are its own.
    pub fn is_trusted(&self) -> bool {
        self.inside >= LEAST_INSIDE && self.clear >= LEAST_CLEAR
    }
}

/// What surrounds the fronts of a body: everything in the integrals that does not depend on the load. It stays until the crack grows.
#[derive(Debug)]
pub struct FrontDomains(Vec<Domain>);

impl FrontDomains {
    /// Costs in proportion to the elements within 2 h of the fronts. Of the fields only the geometry is read.
    ///
    /// `h`: element size near the fronts \[mm\].
    pub fn new(fields: &Fields, crack: &CrackSurface, fronts: &[Front], h: f64) -> Self {
        let lines = fronts.iter().map(|f| {
            let line = FrontLine::new(&crack.sheets[f.sheet], f, h);
            let offsets = line.effective_offsets(fields, h);
            (line.moved(&offsets), offsets)
        });
        Self(Domain::all(fields, lines.collect(), h))
    }

    /// G and K at each vertex of each front. K is computed where G exceeds `k_from` times the least toughness, and zero elsewhere.
    ///
    /// `fields`: of the body that the domains were made of. Accuracy: `tests/penny_crack.rs`.
    pub fn evaluate(&self, fields: &Fields, k_from: f64) -> Vec<Vec<Station>> {
        let stations = |d: &Domain| Driven::new(d, fields).stations(k_from);
        self.0.iter().map(stations).collect()
    }
}

/// Evaluates G and K at each vertex of each front; see [`FrontDomains`].
pub fn evaluate(
    fields: &Fields,
    crack: &CrackSurface,
    fronts: &[Front],
    h: f64,
    k_from: f64,
) -> Vec<Vec<Station>> {
    FrontDomains::new(fields, crack, fronts, h).evaluate(fields, k_from)
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

/// A front under load.
struct Driven<'a> {
    domain: &'a Domain,
    fields: &'a Fields<'a>,
    /// Displacement gradient and stress in each near cell: constant in a linear tetrahedron.
    gradients: Vec<Matrix3<f64>>,
    stresses: Vec<Matrix3<f64>>,
}

impl<'a> Driven<'a> {
    fn new(domain: &'a Domain, fields: &'a Fields) -> Self {
        let gradients = domain.cells.iter().map(|c| fields.gradient(c.cell));
        let gradients: Vec<Matrix3<f64>> = gradients.collect();
        let stress = |(c, grad_u): (&NearCell, &Matrix3<f64>)| {
            let law = fields.materials[c.tet as usize].elasticity();
            law.stress(grad_u)
        };
        Self {
            stresses: domain.cells.iter().zip(&gradients).map(stress).collect(),
            gradients,
            domain,
            fields,
        }
    }

    fn stations(&self, k_from: f64) -> Vec<Station> {
        let Domain { line, .. } = self.domain;
        let forces = self.configurational_forces();
        let loaded = self.loaded_nodes();
        let mut driven = Vec::new();
        let mut stations: Vec<Station> = (0..line.points.len())
            .map(|k| Station {
                position: line.points[k] - line.advance[k] * self.domain.offsets[k],
                advance: line.advance[k],
                normal: line.normal[k],
                k: StressIntensity::default(),
                g: self.domain.sum(k, |n| forces[n]),
                material: self.domain.materials[k],
                ahead: self.domain.ahead[k],
                inside: self.domain.inside[k].0,
                clear: self.domain.clear[k],
                offset: self.domain.offsets[k],
            })
            .collect();
        for (k, s) in stations.iter().enumerate() {
            let is_loaded = self.domain.sum(k, |n| loaded[n]) > 0.0;
            let own = s.material.toughness_along.min(s.material.toughness_across);
            let least = s.ahead.map_or(own, |ahead| ahead.least().min(own));
            if is_loaded || s.g > k_from * least {
                driven.push((k, is_loaded || !self.domain.is_uniform[k]));
            }
        }
        if driven.is_empty() {
            return stations;
        }
        let vertices: Vec<usize> = driven.iter().map(|d| d.0).collect();
        let wanted = self.domain.wanted(&vertices);
        let interaction = (self.domain).interaction(self.fields, &self.gradients, &wanted);
        for (k, j_fails) in driven {
            let s = &mut stations[k];
            let modes = [0, 1, 2].map(|m| self.domain.sum(k, |n| interaction[n][m]));
            let (e, lame) = (s.material.plane_strain_modulus(), s.material.lame());
            s.k = StressIntensity {
                k1: 0.5 * e * modes[0],
                k2: 0.5 * e * modes[1],
                k3: lame.mu * modes[2],
            };
            let near = s
                .material
                .orthotropic
                .and_then(|law| NearField::new(&law, &s.frame()));
            if let Some(near) = &near {
                s.k = near.intensities(&lame, modes).unwrap_or(s.k);
            }
            if j_fails {
                let isotropic = s.k.straight_release(s.material.poisson_ratio) / e;
                s.g = near.map_or(isotropic, |near| near.release(&s.k));
            }
        }
        stations
    }

    /// The extension of each nearby node that carries a load, zero for the others \[1\].
    fn loaded_nodes(&self) -> Vec<f64> {
        let mut loaded = vec![0.0; self.domain.near.len()];
        self.for_loads(|p, _, load| {
            if load.force != Vec3::zeros() {
                loaded[p] = self.domain.extension[p].norm();
            }
        });
        loaded
    }

    /// The part of each nearby node in J.
    fn configurational_forces(&self) -> Vec<f64> {
        let Domain {
            cells,
            faces,
            extension,
            ..
        } = self.domain;
        let mut c = vec![Vec3::zeros(); extension.len()];
        let density = |i: usize| stiffness::energy_density(&self.stresses[i], &self.gradients[i]);
        for (i, cell) in cells.iter().enumerate() {
            let flux = self.gradients[i].transpose() * self.stresses[i];
            let m = (flux - Matrix3::from_diagonal_element(density(i))) * cell.volume;
            let gradients = &self.fields.mesh.gradients()[cell.tet as usize];
            for (place, gradient) in cell.places.iter().zip(gradients) {
                if let Some(p) = place {
                    c[*p as usize] += m * gradient;
                }
            }
        }
        for f in faces {
            for (place, w) in cells[f.cell].places.iter().zip(f.weights) {
                if let Some(p) = place {
                    c[*p as usize] += f.outward * (w * density(f.cell));
                }
            }
        }
        self.for_loads(|p, weight, load| {
            let grad_u = self.fields.gradient(load.cell);
            c[p] -= grad_u.transpose() * load.force * weight;
        });
        c.iter().zip(extension).map(|(c, q)| c.dot(q)).collect()
    }

    /// Calls `f(position in near, shape function, load)` for each load and node near the front.
    fn for_loads(&self, mut f: impl FnMut(usize, f64, &CellForce)) {
        for load in self.fields.loads {
            let cell = &self.fields.topology.cells()[load.cell as usize];
            let nodes = &self.fields.mesh.tets()[cell.tet as usize];
            for (n, w) in nodes.iter().zip(&load.weights) {
                if let Some(p) = self.domain.place_of(*n) {
                    f(p as usize, *w, load);
                }
            }
        }
    }
}
