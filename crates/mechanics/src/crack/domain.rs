//! What surrounds one crack front: the cells whose fields enter its integrals, and how much. Constant until the crack grows.
use super::cut_polygon::cut_polygon;
use super::enrichment::Cell;
use super::front::{FrontLine, LocalFrame, NearNode, Place};
use super::interaction::{BoundaryPart, CellInteraction};
use super::mean_material::MaterialSum;
use super::stress_intensity::Fields;
use super::surface_load::face_pieces;
use super::toughness_ahead::ToughnessAhead;
use super::williams::Side;
use crate::bone::{Lame, TetMaterial};
use crate::geometry::{NO_TET, TET_FACES, Vec3};
use std::sync::OnceLock;

/// Inner and outer radius of the plateau, in element sizes.
pub(super) const PLATEAU: [f64; 2] = [1.0, 2.0];
/// Half width of the hat along the front, in element sizes: a wider one smooths, a narrower one scatters by 20 % and more.
const HAT: f64 = 2.0;
/// Faces closer to the front than this, in element sizes, are taken to lie in its plane: there the field is singular and coarse.
const FACES_FROM: f64 = 0.75;
/// Another front's q is 0 closer than the first and unhindered beyond the second distance, in element sizes.
const OTHER_FRONT: [f64; 2] = [0.5, 1.5];

/// What surrounds one front.
#[derive(Debug)]
pub(super) struct Domain {
    /// The effective front.
    pub line: FrontLine,
    /// How far it lies ahead of the geometric one at each vertex \[mm\].
    pub offsets: Vec<f64>,
    pub h: f64,
    pub near: Vec<NearNode>,
    /// q of each nearby node but for the hat.
    pub extension: Vec<Vec3>,
    pub cells: Vec<NearCell>,
    pub faces: Vec<FacePart>,
    /// Pieces of the body's boundary, by ascending cell.
    pub boundary: Vec<BoundaryPart>,
    /// What each cell's field contributes to the interaction, made when it is first asked for.
    pub interactions: Vec<OnceLock<Box<CellInteraction>>>,
    /// For each vertex, how clear of other fronts it is.
    pub clear: Vec<f64>,
    /// For each vertex, share of its hat inside the body and the integral of the hat there \[mm\].
    pub inside: Vec<(f64, f64)>,
    /// For each vertex, the mean material at the front there.
    pub materials: Vec<TetMaterial>,
    /// For each vertex, whether all of its domain is of one elastic law, or of laws that depend on direction.
    pub is_uniform: Vec<bool>,
    /// For each vertex, what a growth would have to tear, where that is not one and the same.
    pub ahead: Vec<Option<ToughnessAhead>>,
    /// For each vertex, the nodes within its hat and the hat there.
    hats: Vec<Vec<(u32, f64)>>,
}

/// A cell beside the front.
#[derive(Debug)]
pub(super) struct NearCell {
    /// Which cell of the topology.
    pub cell: u32,
    pub tet: u32,
    /// Where the four nodes are in the list of nearby nodes.
    pub places: [Option<u32>; 4],
    pub volume: f64,
    /// Where its centre is, and on which side of the crack.
    pub at: Option<(Place, LocalFrame, Side)>,
}

/// A piece of the crack's face that does not lie in the plane of the front, seen from one cell.
#[derive(Debug)]
pub(super) struct FacePart {
    /// Its cell in the list of near cells.
    pub cell: usize,
    pub weights: [f64; 4],
    /// Out of the cell, as long as the piece's area.
    pub outward: Vec3,
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

impl Domain {
    /// The domains of some effective fronts and of how far each lies ahead of the geometric one. Of the fields only the geometry
    /// is read.
    pub fn all(fields: &Fields, fronts: Vec<(FrontLine, Vec<f64>)>, h: f64) -> Vec<Self> {
        let (lines, offsets): (Vec<_>, Vec<_>) = fronts.into_iter().unzip();
        let clear_of = |own: usize, p: &Vec3| clearance(&lines, own, p, h);
        let near_nodes = |own: usize| {
            let near = lines[own].nodes_near(fields.mesh, PLATEAU[1] * h);
            let weight = |n: &NearNode| {
                plateau(n.r, h) * clear_of(own, &fields.mesh.nodes()[n.node as usize])
            };
            let extension = |n: &NearNode| lines[own].frame_at(n.s).advance * weight(n);
            let extension: Vec<Vec3> = near.iter().map(extension).collect();
            let clear: Vec<f64> = lines[own].points.iter().map(|p| clear_of(own, p)).collect();
            (near, extension, clear)
        };
        let parts: Vec<_> = (0..lines.len()).map(near_nodes).collect();
        let fronts = lines.into_iter().zip(offsets).zip(parts);
        fronts
            .map(|((line, offsets), (near, extension, clear))| {
                let mut domain = Self {
                    inside: line.inside_share(fields, HAT * h),
                    line,
                    offsets,
                    h,
                    near,
                    extension,
                    clear,
                    cells: Vec::new(),
                    faces: Vec::new(),
                    boundary: Vec::new(),
                    interactions: Vec::new(),
                    materials: Vec::new(),
                    is_uniform: Vec::new(),
                    ahead: Vec::new(),
                    hats: Vec::new(),
                };
                domain.gather(fields);
                domain
            })
            .collect()
    }

    fn gather(&mut self, fields: &Fields) {
        let mut tets: Vec<u32> = (self.near.iter())
            .flat_map(|n| fields.mesh.tets_of_node(n.node as usize))
            .copied()
            .collect();
        tets.sort_unstable();
        tets.dedup();
        for t in tets {
            self.push_boundary(fields, t);
            self.push_cells(fields, t);
        }
        self.interactions
            .resize_with(self.cells.len(), OnceLock::new);
        let sums = self.material_sums(fields);
        let fallback = &fields.materials[0];
        self.materials = sums.iter().map(|s| s.mean(fallback)).collect();
        self.is_uniform = sums.iter().map(MaterialSum::is_uniform).collect();
        let vertices = 0..self.line.points.len();
        self.ahead = vertices
            .map(|k| ToughnessAhead::new(self, fields, k))
            .collect();
        self.hats = self.hats();
    }

    fn push_cells(&mut self, fields: &Fields, t: u32) {
        let places = fields.mesh.tets()[t as usize].map(|n| self.place_of(n));
        let corners = fields.mesh.corners(t as usize);
        let middle: Vec3 = corners.iter().sum::<Vec3>() / 4.0;
        let divided = fields.topology.is_divided(t);
        for c in fields.topology.cells_of(t) {
            let cell = &fields.topology.cells()[c];
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
                self.push_faces(fields, cell, &own);
            }
            self.cells.push(NearCell {
                cell: c as u32,
                tet: t,
                places,
                volume: fields.mesh.volumes()[t as usize] * cell.fraction,
                at,
            });
        }
    }

    /// Where a node is in the list of nearby nodes.
    pub fn place_of(&self, node: u32) -> Option<u32> {
        let place = self.near.binary_search_by_key(&node, |n| n.node);
        place.ok().map(|p| p as u32)
    }

    /// The faces of a cell that q crosses; those in the front's plane count nothing.
    fn push_faces(&mut self, fields: &Fields, cell: &Cell, own: &Vec3) {
        let corners = cut_polygon(fields.mesh, fields.cuts, cell);
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
                self.faces.push(FacePart {
                    cell: self.cells.len(),
                    weights: fields.mesh.barycentric(cell.tet as usize, &at),
                    outward,
                });
            }
        }
    }

    /// The pieces of a tetrahedron's faces that bound the body; its cells are the next to be pushed.
    fn push_boundary(&mut self, fields: &Fields, tet: u32) {
        let mesh = fields.mesh;
        let t = tet as usize;
        let first = self.boundary.len();
        for k in (0..4).filter(|&k| mesh.neighbours()[t][k] == NO_TET) {
            let held = TET_FACES[k].map(|n| fields.system.held_axes(mesh.tets()[t][n]));
            let pieces = face_pieces(mesh, fields.cuts, fields.topology, tet, k);
            let part = |(cell, piece): (u32, _)| BoundaryPart {
                cell: self.cells.len() + cell as usize - fields.topology.cells_of(tet).start,
                outward: -mesh.gradients()[t][k].normalize(),
                held: [0, 1, 2].map(|a| held.iter().all(|h| h[a])),
                piece,
            };
            self.boundary.extend(pieces.into_iter().map(part));
        }
        self.boundary[first..].sort_by_key(|b| b.cell);
    }

    /// The materials about each vertex, weighted by volume, hat and nearness to the front.
    fn material_sums(&self, fields: &Fields) -> Vec<MaterialSum> {
        /// Reach of what counts as at the front, in element sizes; what lies farther off only stands in where nothing is so near.
        const TIP: f64 = 0.6;
        const FARTHER: f64 = 1e-9;
        let mut sums = vec![MaterialSum::default(); self.line.points.len()];
        for c in &self.cells {
            let Some((place, _, _)) = &c.at else { continue };
            let weight = (1.0 - place.r / (TIP * self.h)).max(FARTHER);
            for k in self.line.vertices_within(place.s, HAT * self.h) {
                let hat = self.line.hat(place.s, self.line.arc[k], HAT * self.h);
                let weight = weight * hat * c.volume;
                sums[k].add(&fields.materials[c.tet as usize], weight);
            }
        }
        sums
    }

    fn hats(&self) -> Vec<Vec<(u32, f64)>> {
        let mut hats = vec![Vec::new(); self.line.points.len()];
        for (i, n) in (0u32..).zip(&self.near) {
            for k in self.line.vertices_within(n.s, HAT * self.h) {
                let hat = self.line.hat(n.s, self.line.arc[k], HAT * self.h);
                hats[k].push((i, hat));
            }
        }
        hats
    }

    /// Sum over the nodes within the hat of vertex `k`, a unit of front length inside the body.
    pub fn sum(&self, k: usize, value: impl Fn(usize) -> f64) -> f64 {
        let length = self.inside[k].1;
        if length <= 0.0 {
            return 0.0;
        }
        let nodes = self.hats[k].iter();
        nodes.map(|(n, hat)| value(*n as usize) * hat).sum::<f64>() / length
    }

    /// Which cells enter the sums of the given vertices.
    pub fn wanted(&self, vertices: &[usize]) -> Vec<bool> {
        let mut nodes = vec![false; self.near.len()];
        for (n, _) in vertices.iter().flat_map(|&k| &self.hats[k]) {
            nodes[*n as usize] = true;
        }
        let of = |c: &NearCell| c.places.iter().flatten().any(|p| nodes[*p as usize]);
        self.cells.iter().map(of).collect()
    }

    /// The mean material's constants at some arc length.
    pub fn lame_at(&self, s: f64) -> Lame {
        let (a, b, w) = self.line.between(s);
        let (a, b) = (self.materials[a].lame(), self.materials[b].lame());
        Lame {
            lambda: a.lambda * (1.0 - w) + b.lambda * w,
            mu: a.mu * (1.0 - w) + b.mu * w,
        }
    }
}

pub(super) fn mean_of(corners: &[Vec3; 4], mask: u8) -> Vec3 {
    let inside = (0..4).filter(|k| mask >> k & 1 == 1);
    inside.map(|k| corners[k]).sum::<Vec3>() / f64::from(mask.count_ones().max(1))
}
