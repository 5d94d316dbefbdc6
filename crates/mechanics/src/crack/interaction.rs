//! The interaction of the body's field with those of unit stress intensities: linear in the body's field, and so, for each cell, a
//! few matrices that stay what they are until the crack grows.
use super::domain::{Domain, PLATEAU, mean_of};
use super::front::{LocalFrame, Place};
use super::stress_intensity::Fields;
use super::williams::{Auxiliary, Side, auxiliary, stress_slopes};
use crate::bone::{Elasticity, stiffness};
use crate::geometry::Vec3;
use nalgebra::Matrix3;

/// A load on a face meets the mean of the auxiliary field over this stretch, in element sizes: single points would sample the
/// field's singularity by chance.
const LOAD_CORE: f64 = 0.5;
/// Parts of an edge that boundary faces are cut into for integration: the auxiliary field is singular.
const PARTS: usize = 3;
/// Closer to the front than this, in element sizes, boundary faces are left out.
const BOUNDARY_FROM: f64 = 0.02;
/// Closer to the front than this, in element sizes, the body counts as of the material at the front.
const TIP: f64 = 0.3;

/// What a cell's field contributes to the interaction with unit K_I, K_II and K_III at each of its four nodes: the double dot
/// product of these matrices with its displacement gradient.
pub(super) type CellInteraction = [[Matrix3<f64>; 3]; 4];

/// A piece of the body's boundary beside the front.
#[derive(Debug)]
pub(super) struct BoundaryPart {
    /// Its cell in the list of near cells.
    pub cell: usize,
    pub outward: Vec3,
    /// Axes along which a support holds it.
    pub held: [bool; 3],
    /// Its corners in the shape functions of the tetrahedron.
    pub piece: [[f64; 4]; 3],
}

/// Matrices of stress and of displacement gradient, by node and mode.
#[derive(Default)]
struct Parts {
    of_stress: CellInteraction,
    of_gradient: CellInteraction,
}

impl Domain {
    /// For each nearby node what it contributes to the interaction with unit K_I, K_II and K_III, from the wanted cells.
    ///
    /// `gradients`: the displacement gradient in each near cell.
    pub fn interaction(
        &self,
        fields: &Fields,
        gradients: &[Matrix3<f64>],
        wanted: &[bool],
    ) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; self.near.len()];
        for (i, grad_u) in gradients.iter().enumerate().filter(|(i, _)| wanted[*i]) {
            let of_cell = self.interactions[i].get_or_init(|| Box::new(self.of_cell(fields, i)));
            for (place, of_node) in self.cells[i].places.iter().zip(of_cell.iter()) {
                let Some(p) = place else { continue };
                let sums = sums[*p as usize].iter_mut().zip(of_node);
                sums.for_each(|(sum, m)| *sum += m.dot(grad_u));
            }
        }
        self.add_loads(fields, &mut sums);
        sums
    }

    fn of_cell(&self, fields: &Fields, i: usize) -> CellInteraction {
        let mut parts = Parts::default();
        self.add_volume(fields, i, &mut parts);
        let first = self.boundary.partition_point(|b| b.cell < i);
        let own = self.boundary[first..].iter();
        for part in own.take_while(|b| b.cell == i) {
            self.add_boundary(fields, part, &mut parts);
        }
        let law = fields.materials[self.cells[i].tet as usize].elasticity();
        let Parts {
            of_stress,
            of_gradient,
        } = parts;
        std::array::from_fn(|k| {
            std::array::from_fn(|m| law.stress(&of_stress[k][m]) + of_gradient[k][m])
        })
    }

    /// int (aux.grad_u^T stress + grad_u^T aux.stress - (stress : aux.strain) I) grad N . q, with what a curved front's auxiliary
    /// field lacks in balance and compatibility.
    fn add_volume(&self, fields: &Fields, i: usize, parts: &mut Parts) {
        let cell = &self.cells[i];
        let Some((place, frame, side)) = &cell.at else {
            return;
        };
        let gradients = &fields.mesh.gradients()[cell.tet as usize];
        let aux = self.auxiliary_in(fields, cell.tet, place, frame, *side);
        for (k, p) in cell.places.iter().enumerate() {
            let Some(p) = p else { continue };
            let q = self.extension[*p as usize] * cell.volume;
            let g = &gradients[k];
            for (mode, aux) in aux.iter().enumerate() {
                parts.of_stress[k][mode] += (aux.grad_u * q) * g.transpose()
                    - aux.strain * q.dot(g)
                    + aux.misfit_slope * (0.25 * q.dot(&frame.advance));
                parts.of_gradient[k][mode] +=
                    (aux.stress * g + aux.body_force * 0.25) * q.transpose();
            }
        }
    }

    /// Where q reaches the body's boundary the auxiliary field pulls at it: - int (grad u^T sigma_aux n - w n) . q, and where a
    /// support holds it, its reaction works on the auxiliary field. Without these, faces across the front turn K_I into K_III of
    /// either sign (18 % of K_I at the ends of an edge crack in plane strain).
    fn add_boundary(&self, fields: &Fields, part: &BoundaryPart, parts: &mut Parts) {
        let cell = &self.cells[part.cell];
        let Some((_, _, side)) = cell.at else {
            return;
        };
        let x = fields.mesh.corners(cell.tet as usize);
        let at = |n: &[f64; 4]| (0..4).map(|i| x[i] * n[i]).sum::<Vec3>();
        let [a, b, c] = [0, 1, 2].map(|i| at(&part.piece[i]));
        let share = 0.5 * (b - a).cross(&(c - a)).norm() / (PARTS * PARTS) as f64;
        let n = &part.outward;
        for [u, v, w] in parts_of_a_triangle() {
            let [p0, p1, p2] = &part.piece;
            let weights: [f64; 4] = std::array::from_fn(|i| u * p0[i] + v * p1[i] + w * p2[i]);
            let Some((place, frame)) = self.line.place(&at(&weights), PLATEAU[1] * self.h) else {
                continue;
            };
            if place.r < BOUNDARY_FROM * self.h {
                continue;
            }
            let aux = self.auxiliary_in(fields, cell.tet, &place, &frame, side);
            for (k, p) in cell.places.iter().enumerate() {
                let Some(p) = p else { continue };
                let q = self.extension[*p as usize] * (share * weights[k]);
                for (mode, aux) in aux.iter().enumerate() {
                    let held = (aux.grad_u * q)
                        .zip_map(&part.held.into(), |v, held| if held { v } else { 0.0 });
                    parts.of_stress[k][mode] += aux.strain * q.dot(n) - held * n.transpose();
                    parts.of_gradient[k][mode] -= (aux.stress * n) * q.transpose();
                }
            }
        }
    }

    /// The auxiliary fields of the material at the front; where tetrahedron `tet` is of another one, their strain by its law.
    ///
    /// Then int stress : (grad u_aux - S sigma_aux),q stays of what vanishes in a uniform body, and the integral is the same for any
    /// domain: only tractions and displacements, which no interface parts, are moved from its border to the front.
    fn auxiliary_in(
        &self,
        fields: &Fields,
        tet: u32,
        place: &Place,
        frame: &LocalFrame,
        side: Side,
    ) -> [Auxiliary; 3] {
        let tip = self.lame_at(place.s);
        let aux = auxiliary(place, frame, side, &tip);
        match fields.materials[tet as usize].elasticity() {
            Elasticity::Isotropic(own) if place.r > TIP * self.h && own != tip => {
                let slopes = stress_slopes(place, frame, side, &tip);
                let mut slopes = slopes.into_iter();
                aux.map(|aux| {
                    let slope = slopes.next().unwrap_or_default();
                    Auxiliary {
                        strain: stiffness::strain(&own, &aux.stress),
                        misfit_slope: aux.misfit_slope + stiffness::strain(&tip, &slope)
                            - stiffness::strain(&own, &slope),
                        ..aux
                    }
                })
            }
            _ => aux,
        }
    }

    fn add_loads(&self, fields: &Fields, sums: &mut [[f64; 3]]) {
        for load in fields.loads {
            let cell = &fields.topology.cells()[load.cell as usize];
            let places = fields.mesh.tets()[cell.tet as usize].map(|n| self.place_of(n));
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
            let aux = auxiliary(&place, &frame, side, &self.lame_at(place.s));
            let pulls: [Vec3; 3] = aux.map(|aux: Auxiliary| aux.grad_u.transpose() * load.force);
            for (p, w) in places.iter().zip(&load.weights) {
                let Some(p) = p.map(|p| p as usize) else {
                    continue;
                };
                let sums = sums[p].iter_mut().zip(&pulls);
                sums.for_each(|(sum, v)| *sum -= self.extension[p].dot(v) * w);
            }
        }
    }
}

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
