//! Tetrahedra from a signed distance: isosurface stuffing (Labelle & Shewchuk 2007, SIGGRAPH) on a body-centred cubic lattice.
//!
//! Lattice points that the surface nearly touches are warped onto it, the lattice tetrahedra inside are kept, those across the
//! surface are cut. All dihedral angles are bounded by construction, whatever the surface. A mesh that is finer about a place
//! comes from a lattice that a conformal map has drawn together there ([`Focus`]).
use crate::error::AnatomyError;
use crate::focus::Focus;
use crate::landmarks::JawFrame;
use crate::lattice::Lattice;
use crate::point_shell::point_shell;
use osteotome_mechanics::geometry::{
    Aabb, MeshDistance, SignedDistance, TET_FACES, TetMesh, TriMesh, Vec3,
};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Fraction of a long edge within which a surface crossing pulls the lattice point onto the surface (the paper's values).
/// Dihedral angles over 300 sponge-like bodies, whose holes are as small as the lattice: 10.4 to 158.6 degrees.
const WARP_LONG: f64 = 0.24999;
/// The same for short edges.
const WARP_SHORT: f64 = 0.41189;
/// A lattice may have at most this many points; it keeps point ids and memory small.
const MAX_LATTICE: f64 = 40e6;

/// Smallest and largest node count that may be asked for.
pub const NODE_RANGE: [usize; 2] = [100, 200_000];

/// Smallest and largest ratio of coarsest to finest spacing that may be asked for.
pub const RATIO_RANGE: [f64; 2] = [1.0, 6.0];
/// Points of the surface by which a focus is chosen.
const FOCUS_POINTS: usize = 2_000;
/// Even meshes of so many nodes keep all parts of a mandible; a graded mesh is nowhere coarser.
const SAFE_NODES: f64 = 400.0;
/// Steps in which a ratio that asks too much is lowered.
const RATIO_STEP: f64 = 0.25;
/// Between those points the surface may reach this much further out \[mm\].
const POINT_GAP: f64 = 5.0;

/// How a mesh is to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stuffing {
    /// Long edge of the lattice \[mm\].
    pub spacing: f64,
    /// The surface meshed is this far outside the given one \[mm\]; chords of a coarse mesh cut corners, which this makes up.
    pub shift: f64,
    /// Where the lattice lies, in units of the spacing.
    pub offset: Vec3,
}

/// A mesh and how it was made.
#[derive(Clone, Debug)]
pub struct Meshed {
    /// The mesh.
    pub mesh: TetMesh,
    /// The lattice that it came from.
    pub stuffing: Stuffing,
    /// Relative error of the volume.
    pub volume_error: f64,
    /// Largest distance of a surface point from the mesh \[mm\].
    pub farthest: f64,
    /// Largest extra outward shift, where the body was too thin for the lattice \[mm\].
    pub swollen: f64,
}

/// Nodes and tetrahedra before they are checked.
#[derive(Clone, Debug, Default)]
pub struct Tets {
    /// Positions \[mm\].
    pub nodes: Vec<Vec3>,
    /// Positively oriented.
    pub tets: Vec<[u32; 4]>,
}

impl Tets {
    /// Enclosed volume \[mm3\].
    pub fn volume(&self) -> f64 {
        let six = |t: &[u32; 4]| {
            let [a, b, c, d] = t.map(|n| self.nodes[n as usize]);
            (b - a).dot(&(c - a).cross(&(d - a)))
        };
        self.tets.iter().map(six).sum::<f64>() / 6.0
    }

    /// Faces that belong to one tetrahedron only, outward, in an order that depends on the mesh alone.
    pub fn boundary(&self) -> Vec<[u32; 3]> {
        let mut faces: Vec<([u32; 3], [u32; 3])> = self
            .tets
            .iter()
            .flat_map(|t| TET_FACES.map(|f| f.map(|k| t[k])))
            .map(|f| (sorted(f), f))
            .collect();
        faces.sort_unstable();
        let mut open = Vec::new();
        let mut i = 0;
        while i < faces.len() {
            let n = faces[i..].iter().take_while(|f| f.0 == faces[i].0).count();
            if n == 1 {
                open.push(faces[i].1);
            }
            i += n;
        }
        open
    }
}

fn sorted(mut f: [u32; 3]) -> [u32; 3] {
    f.sort_unstable();
    f
}

/// Meshes a region with one given lattice; the largest piece connected by faces is kept.
///
/// # Errors
/// [`AnatomyError::Mesher`] if the lattice would be too large or the region slips through it.
pub fn stuff(region: &dyn SignedDistance, how: &Stuffing) -> Result<Tets, AnatomyError> {
    stuff_graded(region, how, &Swelling::none(), &Grading::EVEN)
}

/// As [`stuff`], with all pieces.
pub(crate) fn stuff_all(region: &dyn SignedDistance, how: &Stuffing) -> Result<Tets, AnatomyError> {
    stuffed(region, how, &Swelling::none(), &Grading::EVEN)
}

fn stuff_graded(
    region: &dyn SignedDistance,
    how: &Stuffing,
    swelling: &Swelling,
    grading: &Grading,
) -> Result<Tets, AnatomyError> {
    let kept = largest_piece(&stuffed(region, how, swelling, grading)?);
    if kept.tets.is_empty() {
        let reason = format!(
            "nothing of it is as thick as the lattice of {:.2} mm; ask for more nodes",
            how.spacing
        );
        return Err(AnatomyError::Mesher { reason });
    }
    Ok(kept)
}

fn stuffed(
    region: &dyn SignedDistance,
    how: &Stuffing,
    swelling: &Swelling,
    grading: &Grading,
) -> Result<Tets, AnatomyError> {
    let lenses = &grading.lenses;
    let focus = grading.focus.as_ref();
    let scale = |p: &Vec3| focus.map_or(1.0, |f| f.scale(p));
    let grown = lenses.iter().map(Lens::growth).fold(0.0, f64::max);
    let coarsest = focus.map_or(1.0, |f| f.scales()[1]);
    let margin = how.shift.max(0.0) * coarsest.powi(2) + swelling.most() + grown;
    let bounds = match focus {
        Some(focus) => focus.bounds(margin + POINT_GAP),
        None => region.bounds().grown(margin),
    };
    let middle = bounds.centre();
    let half = (bounds.extent() * 0.5).component_div(&grading.grain);
    let bounds = Aabb {
        min: middle - half,
        max: middle + half,
    };
    let size = Lattice::size_around(&bounds, how.spacing);
    if size.is_nan() || size >= MAX_LATTICE {
        let reason = format!(
            "a spacing of {:.3} mm needs {size:.2e} lattice points; ask for fewer nodes",
            how.spacing
        );
        return Err(AnatomyError::Mesher { reason });
    }
    let lattice = Lattice::around(&bounds, how.spacing, &how.offset);
    // The lattice is regular in its own space; grain, focus and lenses map that into the body's.
    let place = |u: &Vec3| {
        let stretched = middle + (u - middle).component_mul(&grading.grain);
        let graded = focus.map_or(stretched, |f| f.to_body(&stretched));
        lenses.iter().fold(graded, |p, lens| lens.look(&p))
    };
    let value = |u: &Vec3| {
        let p = place(u);
        // What chords cut off grows with the square of their length.
        region.signed(&p) - how.shift * scale(&p).powi(2) - swelling.at(&p)
    };
    let mut stuffed = Stuffer::new(&lattice, &value).tets();
    stuffed.nodes.iter_mut().for_each(|p| *p = place(p));
    Ok(stuffed)
}

/// A place where the mesh is finer: the lattice is drawn together about it, radially, and unchanged further out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Middle of the place \[mm\].
    pub centre: Vec3,
    /// Within this radius the mesh is finest \[mm\].
    pub radius: f64,
    /// Spacing there over the spacing elsewhere: between .5 and 1, lest the angles suffer.
    pub finer: f64,
}

impl Lens {
    /// Where the lattice is as before, over the radius of the lattice that is drawn together.
    const OUTER: f64 = 2.6;

    fn growth(&self) -> f64 {
        self.radius * (1.0 / self.finer - 1.0)
    }

    /// From the lattice's regular space to the body's.
    fn look(&self, u: &Vec3) -> Vec3 {
        let inner = self.radius / self.finer;
        let outer = Self::OUTER * inner;
        let d = u - self.centre;
        let r = d.norm();
        if r >= outer {
            return *u;
        }
        if r <= inner {
            return self.centre + d * self.finer;
        }
        // Hermite cubic between both, with their slopes.
        let (w, t) = (outer - inner, (r - inner) / (outer - inner));
        let (t2, t3) = (t * t, t * t * t);
        let to = (2.0 * t3 - 3.0 * t2 + 1.0) * self.radius
            + (t3 - 2.0 * t2 + t) * w * self.finer
            + (3.0 * t2 - 2.0 * t3) * outer
            + (t3 - t2) * w;
        self.centre + d * (to / r)
    }
}

/// How a mesh differs from a regular one.
#[derive(Clone, Debug, PartialEq)]
pub struct Grading {
    /// Spacing along each axis, relative to that asked for; finer across a plate keeps the plate whole.
    pub grain: Vec3,
    /// Where the mesh is finer; apart from each other.
    pub lenses: Vec<Lens>,
    /// A place about which all of it is graded.
    pub focus: Option<Focus>,
}

impl Grading {
    /// The same everywhere.
    pub const EVEN: Self = Self {
        grain: Vec3::new(1.0, 1.0, 1.0),
        lenses: Vec::new(),
        focus: None,
    };

    /// Spacing at a place, relative to that asked for; lenses left out.
    fn scale(&self, p: &Vec3) -> f64 {
        self.focus.as_ref().map_or(1.0, |f| f.scale(p))
    }

    /// What of it is needed with a spacing: grain and lenses only where the mesh is coarse.
    fn with_spacing(&self, spacing: f64) -> Self {
        let is_coarse = |lens: &&Lens| spacing * self.scale(&lens.centre) > COARSE;
        let lenses: Vec<Lens> = self.lenses.iter().filter(is_coarse).copied().collect();
        let coarse = match &self.focus {
            Some(_) => !lenses.is_empty(),
            None => spacing > COARSE,
        };
        Self {
            grain: if coarse { self.grain } else { Self::EVEN.grain },
            lenses,
            focus: self.focus.clone(),
        }
    }
}

/// A body to be meshed, with what its mesh is held against.
#[derive(Clone)]
pub struct Body<'a> {
    /// Where it is; the true distance, or a smaller one.
    pub distance: &'a dyn SignedDistance,
    /// Its volume \[mm3\].
    pub volume: f64,
    /// Handles of its surface less its inner cavities; 0 for a ball.
    pub genus: i64,
    /// Points all over its surface, that the mesh should come near; may be empty.
    pub outposts: Vec<Vec3>,
    /// Grain and lenses are applied where the mesh is coarse, with spacings above 4.5 mm.
    pub grading: Grading,
}

impl<'a> Body<'a> {
    /// The body inside a closed surface.
    pub fn of(surface: &'a MeshDistance) -> Self {
        Self {
            distance: surface,
            volume: surface.mesh().volume(),
            genus: genus(&surface.mesh().triangles),
            outposts: surface
                .mesh()
                .vertices
                .iter()
                .step_by(surface.mesh().vertices.len().div_ceil(MAX_OUTPOSTS))
                .copied()
                .collect(),
            grading: Grading::EVEN,
        }
    }

    /// A mandible: a coarse lattice is finer across the rami and about condyles and necks, which it would lose otherwise.
    pub fn mandible(surface: &'a MeshDistance, frame: &JawFrame) -> Self {
        let lens = |condyle: &Vec3, gonion: &Vec3| {
            let down = gonion - condyle;
            Lens {
                // The upper end of the neck.
                centre: condyle + down * 0.15,
                radius: 0.32 * down.norm(),
                finer: 0.8,
            }
        };
        let sides = frame.condyles.iter().zip(&frame.gonions);
        Self {
            grading: Grading {
                grain: Vec3::new(0.75, 1.15, 1.15),
                lenses: sides.map(|(c, g)| lens(c, g)).collect(),
                focus: None,
            },
            ..Self::of(surface)
        }
    }

    /// The same body, to be meshed with `target` nodes and finer about `place`: coarsest spacing over that at the place is `ratio`,
    /// 1 to 6, or less where a part far from it would be meshed coarser than an even mesh of 600 nodes is.
    ///
    /// # Errors
    /// [`AnatomyError::OutOfRange`] for another ratio.
    pub fn graded(
        mut self,
        surface: &TriMesh,
        place: &[Vec3],
        ratio: f64,
        target: usize,
    ) -> Result<Self, AnatomyError> {
        let [least, most] = RATIO_RANGE;
        crate::error::in_range("mesh.grading", ratio, least, most)?;
        let shell = point_shell(surface, FOCUS_POINTS)?;
        let points: Vec<Vec3> = shell.iter().map(|p| p.position).collect();
        // How much coarser than an even mesh of as many nodes the coarsest part may be.
        let room = (target as f64 / SAFE_NODES).cbrt();
        let mut ratio = ratio;
        while ratio > 1.0 + RATIO_STEP {
            let focus = Focus::on(place, &points, ratio);
            if let Some(focus) = focus.filter(|f| f.coarsest(&points) <= room) {
                self.grading.focus = Some(focus);
                break;
            }
            ratio -= RATIO_STEP;
        }
        Ok(self)
    }
}

/// Meshes a body with about `target` nodes.
///
/// The spacing is found by iteration on the node count. Chords of a coarse mesh only ever take volume away, so the surface is
/// shifted outward by what makes the volumes equal. Parts thinner than the lattice (condyle necks, at the paper's size) would
/// break off: where surface points are left without mesh, the body is swollen a little, as much as it takes and not elsewhere.
/// Positions of the lattice are tried until one keeps the number of handles, meets the count within 3 %, the volume within .2 %
/// and leaves no surface point further than 3 mm or half a spacing from the mesh; else the best of all is taken.
/// Accuracy: `tests/mandible_mesh.rs`.
///
/// # Errors
/// [`AnatomyError::OutOfRange`] for a target outside [`NODE_RANGE`], [`AnatomyError::Mesher`] if no mesh was found.
pub fn mesh_to_nodes(
    body: &Body,
    target: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<Meshed, AnatomyError> {
    let [least, most] = NODE_RANGE;
    crate::error::in_range("mesh.nodes", target as f64, least as f64, most as f64)?;
    let sketched = Sketched::new(body.distance);
    let body = &Body {
        distance: &sketched,
        ..body.clone()
    };
    let mut best: Option<Trial> = None;
    let mut how = Stuffing {
        // Two nodes a cell inside, and about as many again on the surface of thin bodies.
        spacing: (4.5 * body.volume / target as f64).cbrt(),
        shift: 0.0,
        offset: Vec3::zeros(),
    };
    for trial in 0..MAX_OFFSETS {
        progress(f64::from(trial) / f64::from(MAX_OFFSETS));
        // Quasi-random offsets (R3 sequence); the first puts the lattice symmetric about the middle.
        how.offset = Vec3::new(0.819_172_513, 0.671_043_607, 0.549_700_478) * f64::from(trial);
        let Ok(found) = fit(body, target, how) else {
            continue;
        };
        how = found.how;
        if best.as_ref().is_none_or(|b| found.cost < b.cost) {
            best = Some(found);
        }
        if best.as_ref().is_some_and(|b| b.cost < 1.0) {
            break;
        }
    }
    let Some(best) = best else {
        let reason = format!("no lattice gives {target} nodes; ask for more nodes");
        return Err(AnatomyError::Mesher { reason });
    };
    progress(1.0);
    let mesh =
        TetMesh::new(best.tets.nodes, best.tets.tets).map_err(|source| AnatomyError::Mesh {
            name: "the mesher's own mesh".to_owned(),
            source,
        })?;
    Ok(Meshed {
        volume_error: mesh.volume() / body.volume - 1.0,
        mesh,
        stuffing: best.how,
        farthest: best.farthest,
        swollen: best.swollen,
    })
}

/// A signed distance that is exact within a reach of the surface; further out it may be too small, but is quick: most of a
/// lattice about a mandible lies there.
pub(crate) struct Sketched<'a> {
    exact: &'a dyn SignedDistance,
    bounds: Aabb,
    size: [usize; 3],
    values: Vec<f64>,
    reach: f64,
    cell: f64,
}

impl<'a> Sketched<'a> {
    /// More than any edge of a tetrahedral mesh that the surface crosses is long \[mm\].
    const REACH: f64 = 10.0;
    /// Of the grid of distances \[mm\].
    const CELL: f64 = 4.0;
    /// A body that takes more cells is not sketched.
    const MAX_CELLS: usize = 4_000_000;

    fn new(exact: &'a dyn SignedDistance) -> Self {
        Self::with(exact, Self::REACH, Self::CELL)
    }

    /// Exact within `reach` \[mm\]; `cell`: of the grid of distances.
    pub(crate) fn with(exact: &'a dyn SignedDistance, reach: f64, cell: f64) -> Self {
        let bounds = exact.bounds().grown(cell);
        let size = [0, 1, 2].map(|k| (bounds.extent()[k] / cell) as usize + 1);
        let at = |i: usize| {
            let index = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
            bounds.min + Vec3::from(index.map(|c| c as f64 * cell))
        };
        let n = size.iter().fold(1, |n: usize, s| n.saturating_mul(*s));
        let n = if n < Self::MAX_CELLS { n } else { 0 };
        Self {
            exact,
            bounds,
            size,
            values: (0..n)
                .into_par_iter()
                .map(|i| exact.signed(&at(i)))
                .collect(),
            reach,
            cell,
        }
    }

    /// What the distance is at least, in magnitude, with its sign.
    fn estimate(&self, p: &Vec3) -> Option<f64> {
        let outside = (self.bounds.min - p)
            .sup(&(p - self.bounds.max))
            .sup(&Vec3::zeros());
        if outside != Vec3::zeros() {
            return Some(outside.norm());
        }
        let q = (p - self.bounds.min) / self.cell;
        let cell = [0, 1, 2].map(|k| (q[k].round() as usize).min(self.size[k] - 1));
        let index = (cell[2] * self.size[1] + cell[1]) * self.size[0] + cell[0];
        let value = self.values.get(index)?;
        let off = (q - Vec3::from(cell.map(|c| c as f64))).norm() * self.cell;
        Some(value.signum() * (value.abs() - off).max(0.0))
    }
}

impl SignedDistance for Sketched<'_> {
    fn signed(&self, p: &Vec3) -> f64 {
        match self.estimate(p) {
            Some(distance) if distance.abs() > self.reach => distance,
            _ => self.exact.signed(p),
        }
    }

    fn bounds(&self) -> Aabb {
        self.exact.bounds()
    }
}

/// A mesh, how it was made, and its faults in units of what is good enough.
struct Trial {
    cost: f64,
    tets: Tets,
    how: Stuffing,
    farthest: f64,
    swollen: f64,
}

/// Extra outward shift where the body is too thin for the lattice: a coarse grid of values, linear between them.
struct Swelling {
    low: Vec3,
    cell: f64,
    size: [usize; 3],
    values: Vec<f64>,
}

impl Swelling {
    fn none() -> Self {
        Self {
            low: Vec3::zeros(),
            cell: 1.0,
            size: [0; 3],
            values: Vec::new(),
        }
    }

    fn new(bounds: &Aabb, cell: f64) -> Self {
        let bounds = bounds.grown(2.0 * cell);
        let size = [0, 1, 2].map(|k| (bounds.extent()[k] / cell).ceil() as usize + 2);
        Self {
            low: bounds.min,
            cell,
            size,
            values: vec![0.0; size.iter().product()],
        }
    }

    fn most(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    fn index(&self, cell: [usize; 3]) -> usize {
        (cell[2] * self.size[1] + cell[1]) * self.size[0] + cell[0]
    }

    fn at(&self, p: &Vec3) -> f64 {
        let q = (p - self.low) / self.cell;
        let base = q.map(f64::floor);
        if (0..3).any(|k| base[k] < 0.0 || base[k] + 1.0 >= self.size[k] as f64) {
            return 0.0;
        }
        let (f, cell) = (q - base, [0, 1, 2].map(|k| base[k] as usize));
        (0..8)
            .map(|corner| {
                let up = [0, 1, 2].map(|k| corner >> k & 1);
                let weight: f64 = (0..3)
                    .map(|k| if up[k] == 1 { f[k] } else { 1.0 - f[k] })
                    .product();
                weight * self.values[self.index([0, 1, 2].map(|k| cell[k] + up[k]))]
            })
            .sum()
    }

    /// Raises the field about some places, each with the spacing of the lattice there; see [`SWELLING`].
    fn raise(&mut self, places: &[(Vec3, f64)]) {
        // By how much, and up to where.
        let mut raise = vec![[0.0f64; 2]; self.values.len()];
        for (p, spacing) in places {
            let [step, limit, reach] = SWELLING.map(|x| x * spacing);
            let n = (reach / self.cell).ceil() as i64;
            let q = (p - self.low) / self.cell;
            let nearest = q.map(|c| c.round() as i64);
            for (dx, dy, dz) in cube(n) {
                let cell = [nearest.x + dx, nearest.y + dy, nearest.z + dz];
                if (0..3).any(|k| cell[k] < 0 || cell[k] >= self.size[k] as i64) {
                    continue;
                }
                let at = Vec3::from(cell.map(|c| c as f64));
                let fall = 1.0 - (at - q).norm() * self.cell / reach;
                let slot = &mut raise[self.index(cell.map(|c| c as usize))];
                let more = step * (1.5 * fall).clamp(0.0, 1.0);
                *slot = [slot[0].max(more), slot[1].max(limit)];
            }
        }
        for (value, [more, limit]) in self.values.iter_mut().zip(raise) {
            *value = (*value + more).min(limit.max(*value));
        }
    }
}

fn cube(n: i64) -> impl Iterator<Item = (i64, i64, i64)> {
    (-n..=n).flat_map(move |x| (-n..=n).flat_map(move |y| (-n..=n).map(move |z| (x, y, z))))
}

/// Surface points against which a mesh is held, at most.
const MAX_OUTPOSTS: usize = 4_000;
/// A lattice is good if no surface point is further from the mesh than this, in spacings and in mm: sharp edges may be blunted.
const GOOD_REACH: [f64; 2] = [0.5, 3.0];
/// Spacings above this make a mesh coarse \[mm\]: the rami are 7 to 9 mm thick.
const COARSE: f64 = 4.5;
/// The first of these for a graded mesh, whose coarse parts are far from what matters: tips of coronoids may be blunted more.
const GRADED_REACH: f64 = 0.75;
/// What counts as a gain when a graded mesh is fitted: less than this part of the least cost so far.
const GAIN: f64 = 0.95;
/// A lattice position is given up after so many iterations without gain.
const PATIENCE: u32 = 5;
/// Smallest dihedral angle of a good mesh \[degrees\]; below 8 is refused by those who use it.
const GOOD_DIHEDRAL: f64 = 9.5;
/// Lattice positions tried at most.
const MAX_OFFSETS: i32 = 8;
/// Iterations of spacing, shift and swelling for each of them.
const MAX_FITS: u32 = 16;
/// Swelling in one iteration and at most, and how far it reaches, in spacings.
const SWELLING: [f64; 3] = [0.08, 0.2, 0.9];

/// Distances of `points` from the boundary.
fn distances(tets: &Tets, boundary: Vec<[u32; 3]>, points: &[Vec3]) -> Vec<f64> {
    let distance = MeshDistance::new(TriMesh {
        vertices: tets.nodes.clone(),
        triangles: boundary,
    });
    points.par_iter().map(|p| distance.unsigned(p)).collect()
}

/// Errors of node count and volume in units of what is good enough.
fn misfit(tets: &Tets, body: &Body, target: usize) -> f64 {
    let nodes = (tets.nodes.len() as f64 / target as f64 - 1.0).abs();
    let volume = (tets.volume() / body.volume - 1.0).abs();
    (nodes / 0.03).max(volume / 0.002)
}

/// Iterates spacing, shift and swelling together for one lattice offset.
fn fit(body: &Body, target: usize, mut how: Stuffing) -> Result<Trial, AnatomyError> {
    let mut best: Option<Trial> = None;
    let mut swelling = Swelling::new(&body.distance.bounds(), 0.4 * how.spacing);
    let grading = body.grading.with_spacing(how.spacing);
    let is_graded = grading.focus.is_some();
    let blunt = if is_graded {
        GRADED_REACH
    } else {
        GOOD_REACH[0]
    };
    let mut since_best = 0;
    for round in 0..MAX_FITS {
        let tets = stuff_graded(body.distance, &how, &swelling, &grading)?;
        let used = how;
        let nodes = tets.nodes.len() as f64 / target as f64;
        let missing = body.volume - tets.volume();
        let area = shifted_area(&tets, &grading);
        let boundary = tets.boundary();
        let handles = handles_amiss(genus(&boundary), body.genus) as f64;
        // Grain and lenses take some of the lattice's own angles.
        let flat = f64::from(u8::from(smallest_dihedral(&tets) < GOOD_DIHEDRAL));
        let left_out = distances(&tets, boundary, &body.outposts);
        let farthest = left_out.iter().copied().fold(0.0, f64::max);
        let spacing = |p: &Vec3| how.spacing * grading.scale(p);
        let good = |p: &Vec3| (blunt * spacing(p)).max(GOOD_REACH[1]);
        let outposts = || body.outposts.iter().zip(&left_out);
        let reach = outposts().map(|(p, d)| d / good(p)).fold(0.0, f64::max);
        let trial = Trial {
            cost: 3.0 * handles + flat + reach.max(misfit(&tets, body, target)),
            tets,
            how: used,
            farthest,
            swollen: swelling.most(),
        };
        since_best += 1;
        let least = best.as_ref().map_or(f64::INFINITY, |b| b.cost);
        if trial.cost < GAIN * least || (trial.cost < least && !is_graded) {
            since_best = 0;
        }
        if trial.cost < least {
            best = Some(trial);
        }
        if since_best > PATIENCE || best.as_ref().is_some_and(|b| b.cost < 1.0) {
            break;
        }
        // Only next to what is meshed, so that a lost part grows back from its stump instead of swelling as a whole.
        let is_front = |p: &Vec3, d: f64| (0.9 * good(p)..good(p) + 0.7 * spacing(p)).contains(&d);
        let front: Vec<(Vec3, f64)> = outposts()
            .filter(|(p, d)| is_front(p, **d))
            .map(|(p, _)| (*p, spacing(p)))
            .collect();
        swelling.raise(&front);
        // Thin bodies gain nodes with about the power 2.6 of the resolution; less and less is made of it, lest it go to and fro.
        let power = 1.0 / (2.6 + 0.3 * f64::from(round));
        how.spacing *= nodes.powf(power).clamp(0.8, 1.25);
        how.shift = (how.shift + missing / area).clamp(-0.05 * how.spacing, 0.3 * how.spacing);
    }
    best.ok_or_else(|| AnatomyError::Mesher {
        reason: "no iteration was made".to_owned(),
    })
}

/// Handles and cavities of a mesh that its body has not, or the other way round. A body with handles, as one with teeth that touch,
/// may lose those that are smaller than the lattice.
fn handles_amiss(mesh: i64, body: i64) -> i64 {
    if body > 0 {
        (mesh - body).max(-mesh).max(0)
    } else {
        (mesh - body).abs()
    }
}

/// Volume that a shift of 1 mm adds \[mm2\]: the surface's area, counted more where the mesh is coarse and the shift larger.
fn shifted_area(tets: &Tets, grading: &Grading) -> f64 {
    tets.boundary()
        .iter()
        .map(|f| {
            let [a, b, c] = f.map(|n| tets.nodes[n as usize]);
            0.5 * (b - a).cross(&(c - a)).norm() * grading.scale(&a).powi(2)
        })
        .sum()
}

/// A closed, outward surface mesh of a region's boundary: the boundary of its tetrahedra, with angles bounded as theirs.
///
/// # Errors
/// As [`stuff`].
pub fn contour(region: &dyn SignedDistance, spacing: f64) -> Result<TriMesh, AnatomyError> {
    contour_at(region, spacing, &Vec3::new(0.0, 0.25, 0.25))
}

/// As [`contour`], with the lattice at a given place.
pub(crate) fn contour_at(
    region: &dyn SignedDistance,
    spacing: f64,
    offset: &Vec3,
) -> Result<TriMesh, AnatomyError> {
    let how = Stuffing {
        spacing,
        shift: 0.0,
        offset: *offset,
    };
    let tets = stuff(region, &how)?;
    Ok(crate::surface::compact(&tets.nodes, &tets.boundary()))
}

/// Point of the mesh to be: a lattice point, or the surface crossing of a lattice edge (inner point first).
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Point {
    Lattice(u32),
    Cut(u32, u32),
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Side {
    In,
    On,
    Out,
}

struct Stuffer<'a> {
    lattice: &'a Lattice,
    side: Vec<Side>,
    /// Positions of warped points.
    warped: FxHashMap<u32, Vec3>,
    /// Crossings of edges, inner point first.
    cuts: FxHashMap<[u32; 2], Vec3>,
}

impl<'a> Stuffer<'a> {
    fn new(lattice: &'a Lattice, value: &(dyn Fn(&Vec3) -> f64 + Sync)) -> Self {
        let values: Vec<f64> = (0..lattice.n_points() as u32)
            .into_par_iter()
            .map(|id| value(&lattice.position(id)))
            .collect();
        let side = values
            .iter()
            .map(|v| if *v < 0.0 { Side::In } else { Side::Out })
            .collect();
        let crossings = crossings(lattice, &values, value);
        let mut stuffer = Self {
            lattice,
            side,
            warped: FxHashMap::default(),
            cuts: crossings.iter().copied().collect(),
        };
        stuffer.warp(&crossings);
        stuffer
    }

    /// Moves each point with a crossing too near onto the nearest of its crossings, which frees its other edges.
    fn warp(&mut self, crossings: &[([u32; 2], Vec3)]) {
        let mut touched: Vec<u32> = crossings.iter().flat_map(|(e, _)| *e).collect();
        touched.sort_unstable();
        touched.dedup();
        for id in touched {
            let here = self.lattice.position(id);
            let mut best: Option<(f64, Vec3)> = None;
            self.lattice.neighbours(id, |n| {
                if self.side[n as usize] == Side::On
                    || self.side[n as usize] == self.side[id as usize]
                {
                    return;
                }
                let Some(p) = self.cuts.get(&self.inner_first(id, n)) else {
                    return;
                };
                let length = (self.lattice.position(n) - here).norm();
                let reach = if Lattice::is_long(id, n) {
                    WARP_LONG
                } else {
                    WARP_SHORT
                };
                let distance = (p - here).norm();
                if distance < reach * length && best.is_none_or(|(d, _)| distance < d) {
                    best = Some((distance, *p));
                }
            });
            if let Some((_, p)) = best {
                self.side[id as usize] = Side::On;
                self.warped.insert(id, p);
            }
        }
    }

    fn inner_first(&self, a: u32, b: u32) -> [u32; 2] {
        if self.side[a as usize] == Side::In {
            [a, b]
        } else {
            [b, a]
        }
    }

    fn position(&self, p: Point) -> Vec3 {
        match p {
            Point::Lattice(id) => self
                .warped
                .get(&id)
                .copied()
                .unwrap_or_else(|| self.lattice.position(id)),
            Point::Cut(a, b) => self.cuts.get(&[a, b]).copied().unwrap_or_else(|| {
                // Every edge between an inner and an outer point has a crossing.
                debug_assert!(false, "no crossing on a cut edge");
                (self.lattice.position(a) + self.lattice.position(b)) * 0.5
            }),
        }
    }

    fn tets(&self) -> Tets {
        let mut index: FxHashMap<Point, u32> = FxHashMap::default();
        let mut out = Tets::default();
        self.lattice.tets(|t| {
            if !t.iter().any(|&n| self.side[n as usize] == Side::In) {
                return;
            }
            self.cut(t, &mut |points| {
                let tet = points.map(|p| {
                    *index.entry(p).or_insert_with(|| {
                        out.nodes.push(self.position(p));
                        out.nodes.len() as u32 - 1
                    })
                });
                out.tets.push(tet);
            });
        });
        out
    }

    /// The pieces of one lattice tetrahedron that lie inside.
    fn cut(&self, t: [u32; 4], emit: &mut dyn FnMut([Point; 4])) {
        use Point::{Cut, Lattice as At};
        let (v, [n_in, n_on, n_out]) = self.inner_points_first(t);
        match (n_in, n_on, n_out) {
            (0, _, _) => {}
            (_, _, 0) => emit(v.map(At)),
            (1, _, _) => emit(v.map(|id| match self.side[id as usize] {
                Side::Out => Cut(v[0], id),
                _ => At(id),
            })),
            // Two in, one on, one out: a pyramid over the quadrilateral between the two cut edges.
            (2, 1, _) => {
                let [p, q, on, out] = v;
                let (cp, cq) = (Cut(p, out), Cut(q, out));
                // Positive as [p, q, on, out], hence [q, p, out, on] too, and [p, q, out, on] is negative.
                let (p, q, cp, cq) = (At(q), At(p), cq, cp);
                if self.diagonal_from_first(v[1], v[0], out) {
                    emit([p, q, cq, At(on)]);
                    emit([p, cq, cp, At(on)]);
                } else {
                    emit([p, q, cp, At(on)]);
                    emit([cp, q, cq, At(on)]);
                }
            }
            (2, _, _) => {
                let [p, q, m, n] = v;
                let near = [At(p), Cut(p, m), Cut(p, n)];
                let far = [At(q), Cut(q, m), Cut(q, n)];
                let over_m = self.diagonal_from_first(p, q, m);
                let over_n = self.diagonal_from_first(p, q, n);
                // The outer quadrilateral belongs to no other tetrahedron: any diagonal that closes no cycle; the shorter if both.
                let length = |a, b| (self.position(a) - self.position(b)).norm_squared();
                let outer = if over_m == over_n {
                    length(near[1], far[2]) < length(near[2], far[1])
                } else {
                    over_n
                };
                prism(near, far, [over_m, outer, !over_n], emit);
            }
            _ => {
                let out = v[3];
                let inner = [v[0], v[1], v[2]];
                let diagonals =
                    [0, 1, 2].map(|k| self.diagonal_from_first(inner[k], inner[(k + 1) % 3], out));
                prism(inner.map(At), inner.map(|id| Cut(id, out)), diagonals, emit);
            }
        }
    }

    /// The corners sorted in, on, out, kept positive, and how many there are of each.
    fn inner_points_first(&self, mut t: [u32; 4]) -> ([u32; 4], [usize; 3]) {
        let rank = |id: u32| self.side[id as usize] as usize;
        let mut odd = false;
        for i in 1..4 {
            for k in (1..=i).rev() {
                if rank(t[k]) < rank(t[k - 1]) {
                    t.swap(k, k - 1);
                    odd = !odd;
                }
            }
        }
        if odd {
            // Two of a kind always stand side by side.
            if let Some(k) = (0..3).find(|&k| rank(t[k]) == rank(t[k + 1])) {
                t.swap(k, k + 1);
            }
        }
        let mut count = [0; 3];
        for id in t {
            count[rank(id)] += 1;
        }
        (t, count)
    }

    /// Whether the quadrilateral `p`, `q`, cut(q, out), cut(p, out) is split from `p` (to the cut on the edge of `q`).
    ///
    /// A function of the lattice face alone, so that the two tetrahedra that share it agree, and never cyclic in a prism.
    fn diagonal_from_first(&self, p: u32, q: u32, out: u32) -> bool {
        match (Lattice::is_long(p, out), Lattice::is_long(q, out)) {
            (true, false) => false,
            (false, true) => true,
            // Both cut edges are short, p q is a long edge: by the quarter around it in which `out` lies.
            _ => {
                let (a, b, o) = (
                    self.lattice.position(p),
                    self.lattice.position(q),
                    self.lattice.position(out),
                );
                let (edge, side) = (b - a, o - a);
                let axis = edge.iamax();
                let quarter = (side[(axis + 1) % 3] > 0.0) ^ (side[(axis + 2) % 3] > 0.0);
                quarter ^ (edge[axis] > 0.0)
            }
        }
    }
}

/// Splits the prism between triangles `a` and `b` (`a[k]` under `b[k]`, positive if `b` lies where `a` is seen
/// counter-clockwise from below). `diagonals[k]`: whether the side between edges k and k + 1 is split from `a[k]` to `b[k + 1]`.
fn prism(a: [Point; 3], b: [Point; 3], diagonals: [bool; 3], emit: &mut dyn FnMut([Point; 4])) {
    debug_assert!(
        diagonals.iter().any(|d| *d != diagonals[0]),
        "cyclic diagonals"
    );
    // Raise the corners of `a` to `b` one by one; a diagonal a[k] b[k+1] means that k + 1 rises first.
    let mut rank = [0; 3];
    for k in 0..3 {
        rank[if diagonals[k] { k } else { (k + 1) % 3 }] += 1;
    }
    let mut current = a;
    for turn in 0..3 {
        for k in 0..3 {
            if rank[k] == turn {
                emit([current[0], current[1], current[2], b[k]]);
                current[k] = b[k];
            }
        }
    }
}

/// Crossings of all lattice edges, inner point first, ordered by the inner point's id.
fn crossings(
    lattice: &Lattice,
    values: &[f64],
    value: &(dyn Fn(&Vec3) -> f64 + Sync),
) -> Vec<([u32; 2], Vec3)> {
    let inner: Vec<u32> = (0..values.len() as u32)
        .filter(|id| values[*id as usize] < 0.0)
        .collect();
    inner
        .par_iter()
        .flat_map_iter(|&a| {
            let mut found = Vec::new();
            lattice.neighbours(a, |b| {
                let (va, vb) = (values[a as usize], values[b as usize]);
                if vb >= 0.0 {
                    let ends = (lattice.position(a), lattice.position(b));
                    found.push(([a, b], root(ends, (va, vb), value)));
                }
            });
            found
        })
        .collect()
}

/// Zero on a segment from negative to positive, by the Illinois form of regula falsi, to about 1e-4 of its length.
fn root((mut a, mut b): (Vec3, Vec3), (va, vb): (f64, f64), value: &dyn Fn(&Vec3) -> f64) -> Vec3 {
    let tolerance = 1e-4 * (b - a).norm();
    let (mut fa, mut fb) = (va, vb);
    let mut last = 0;
    let mut p = a;
    for _ in 0..12 {
        p = a + (b - a) * (fa / (fa - fb)).clamp(0.0, 1.0);
        let f = value(&p);
        if f.abs() < tolerance {
            break;
        }
        if f < 0.0 {
            (a, fa) = (p, f);
            if last == -1 {
                fb *= 0.5;
            }
            last = -1;
        } else {
            (b, fb) = (p, f);
            if last == 1 {
                fa *= 0.5;
            }
            last = 1;
        }
    }
    p
}

/// The piece connected through faces that has most tetrahedra, without loose nodes.
fn largest_piece(all: &Tets) -> Tets {
    let mut faces: Vec<([u32; 3], u32)> = all
        .tets
        .iter()
        .zip(0u32..)
        .flat_map(|(t, i)| TET_FACES.map(|f| (sorted(f.map(|k| t[k])), i)))
        .collect();
    faces.sort_unstable();
    let mut parent: Vec<u32> = (0..all.tets.len() as u32).collect();
    let find = |parent: &mut [u32], mut v: u32| {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    };
    for pair in faces.windows(2) {
        if pair[0].0 == pair[1].0 {
            let (a, b) = (find(&mut parent, pair[0].1), find(&mut parent, pair[1].1));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut sizes = vec![0u32; all.tets.len()];
    for t in 0..all.tets.len() as u32 {
        sizes[find(&mut parent, t) as usize] += 1;
    }
    let Some(keep) = (0..sizes.len()).max_by_key(|&r| (sizes[r], std::cmp::Reverse(r))) else {
        return Tets::default();
    };
    let mut index = vec![u32::MAX; all.nodes.len()];
    let mut out = Tets::default();
    for (i, t) in all.tets.iter().enumerate() {
        if find(&mut parent, i as u32) as usize != keep {
            continue;
        }
        out.tets.push(t.map(|n| {
            let slot = &mut index[n as usize];
            if *slot == u32::MAX {
                *slot = out.nodes.len() as u32;
                out.nodes.push(all.nodes[n as usize]);
            }
            *slot
        }));
    }
    out
}

/// Smallest and largest dihedral angle of a mesh \[degrees\].
pub fn dihedral_range(mesh: &TetMesh) -> [f64; 2] {
    let tets = 0..mesh.tets().len();
    tets.map(|t| dihedrals(&mesh.corners(t)))
        .fold([180.0, 0.0], |range, [low, high]| {
            [range[0].min(low), range[1].max(high)]
        })
}

fn smallest_dihedral(tets: &Tets) -> f64 {
    tets.tets
        .iter()
        .map(|t| dihedrals(&t.map(|n| tets.nodes[n as usize]))[0])
        .fold(180.0, f64::min)
}

/// Smallest and largest dihedral angle of a tetrahedron \[degrees\].
pub fn dihedrals(x: &[Vec3; 4]) -> [f64; 2] {
    let normals = TET_FACES.map(|f| (x[f[1]] - x[f[0]]).cross(&(x[f[2]] - x[f[0]])));
    let mut range = [180.0f64, 0.0];
    for i in 0..4 {
        for k in 0..i {
            // The supplement of the angle between the two outward normals.
            let (a, b) = (&normals[i], &normals[k]);
            let angle = a.cross(b).norm().atan2(-a.dot(b)).to_degrees();
            range = [range[0].min(angle), range[1].max(angle)];
        }
    }
    range
}

/// Handles of the mesh's boundary less its inner cavities; 0 for a ball.
pub fn mesh_genus(mesh: &TetMesh) -> i64 {
    genus(mesh.boundary_faces())
}

fn genus(faces: &[[u32; 3]]) -> i64 {
    let mut nodes: Vec<u32> = faces.iter().flatten().copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    let euler = nodes.len() as i64 - faces.len() as i64 / 2;
    1 - euler / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A torus whose axis is oblique: every slope of surface, saddle points, a handle.
    struct Torus {
        radius: f64,
        tube: f64,
    }

    impl SignedDistance for Torus {
        fn signed(&self, p: &Vec3) -> f64 {
            let axis = Vec3::new(0.3, 0.5, 0.8).normalize();
            let height = p.dot(&axis);
            let out = (p - axis * height).norm() - self.radius;
            out.hypot(height) - self.tube
        }
        fn bounds(&self) -> Aabb {
            let r = self.radius + self.tube;
            Aabb {
                min: Vec3::repeat(-r),
                max: Vec3::repeat(r),
            }
        }
    }

    /// Waves as short as the lattice itself: every pattern of signs and crossings.
    struct Sponge {
        wave: Vec3,
    }

    impl SignedDistance for Sponge {
        fn signed(&self, p: &Vec3) -> f64 {
            let q = p.component_mul(&self.wave);
            let waves = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
            (waves - 0.2).max(p.norm() - 8.0)
        }
        fn bounds(&self) -> Aabb {
            Aabb {
                min: Vec3::repeat(-8.0),
                max: Vec3::repeat(8.0),
            }
        }
    }

    #[test]
    fn angles_are_bounded_on_a_sponge() {
        let mut range = [180.0f64, 0.0];
        for trial in 0..30 {
            let wave = Vec3::new(1.1, 1.3, 0.9) * (1.0 + 0.1 * f64::from(trial));
            let how = Stuffing {
                spacing: 1.0,
                shift: 0.0,
                offset: Vec3::new(0.37, 0.71, 0.13) * f64::from(trial),
            };
            let tets = stuff(&Sponge { wave }, &how).unwrap();
            let [low, high] = dihedral_range(&TetMesh::new(tets.nodes, tets.tets).unwrap());
            range = [range[0].min(low), range[1].max(high)];
        }
        // 10.39 and 158.6 were the extremes over 300 such sponges.
        assert!(range[0] > 10.0 && range[1] < 164.8, "{range:?}");
    }

    #[test]
    fn angles_are_bounded_whatever_the_surface() {
        let mut range = [180.0f64, 0.0];
        for trial in 0..40 {
            let torus = Torus {
                radius: 10.0,
                tube: 1.5 + 0.12 * f64::from(trial),
            };
            let how = Stuffing {
                spacing: 0.9 + 0.037 * f64::from(trial),
                shift: 0.0,
                offset: Vec3::new(0.37, 0.71, 0.13) * f64::from(trial),
            };
            let tets = stuff(&torus, &how).unwrap();
            let [low, high] = dihedral_range(&TetMesh::new(tets.nodes, tets.tets).unwrap());
            range = [range[0].min(low), range[1].max(high)];
        }
        assert!(range[0] > 15.0 && range[1] < 164.8, "{range:?}");
    }

    #[test]
    fn angles_are_bounded_in_graded_meshes() {
        let mut range = [180.0f64, 0.0];
        let torus = Torus {
            radius: 10.0,
            tube: 3.0,
        };
        let surface = MeshDistance::new(contour(&torus, 0.8).unwrap());
        let points = &surface.mesh().vertices;
        let place: Vec<Vec3> = points.iter().filter(|p| p.x > 9.0).copied().collect();
        for trial in 0..40 {
            let ratio = 1.5 + 0.5 * f64::from(trial % 10);
            let focus = Focus::on(&place, points, ratio).unwrap();
            let [low, high] = focus.scales();
            let spacing = (0.8 + 0.02 * f64::from(trial)) / (low * high).sqrt();
            let how = Stuffing {
                spacing,
                shift: 0.0,
                offset: Vec3::new(0.37, 0.71, 0.13) * f64::from(trial),
            };
            let grading = Grading {
                focus: Some(focus),
                ..Grading::EVEN
            };
            let tets = stuff_graded(&torus, &how, &Swelling::none(), &grading).unwrap();
            let [low, high] = dihedral_range(&TetMesh::new(tets.nodes, tets.tets).unwrap());
            range = [range[0].min(low), range[1].max(high)];
        }
        assert!(range[0] > 10.0 && range[1] < 164.8, "{range:?}");
    }

    #[test]
    fn a_sketched_distance_is_exact_near_and_never_too_large() {
        let torus = Torus {
            radius: 30.0,
            tube: 6.0,
        };
        let sketched = Sketched::new(&torus);
        let (mut quick, mut n) = (0, 0);
        for i in 0..20_000 {
            let u = Vec3::new(0.754_877_7, 0.569_840_3, 0.430_159_7) * f64::from(i);
            let p = (u.map(f64::fract) - Vec3::repeat(0.5)) * 160.0;
            let (d, s) = (torus.signed(&p), sketched.signed(&p));
            assert!(d == s || (d.signum() == s.signum() && s.abs() > 10.0 && s.abs() <= d.abs()));
            quick += usize::from(d != s);
            n += 1;
        }
        assert!(quick > n / 2, "{quick} of {n}");
    }

    #[test]
    fn volume_converges_and_topology_is_kept() {
        let torus = Torus {
            radius: 10.0,
            tube: 4.0,
        };
        let exact = 2.0 * std::f64::consts::PI.powi(2) * torus.radius * torus.tube.powi(2);
        let error = |spacing| {
            let how = Stuffing {
                spacing,
                shift: 0.0,
                offset: Vec3::new(0.1, 0.2, 0.3),
            };
            let tets = stuff(&torus, &how).unwrap();
            assert_eq!(genus(&tets.boundary()), 1);
            (tets.volume() / exact - 1.0).abs()
        };
        let (coarse, fine) = (error(2.0), error(0.5));
        // Second order: a quarter of the spacing, a sixteenth of the error; half of that is asked for.
        assert!(fine < coarse / 8.0, "{coarse} {fine}");
    }

    #[test]
    fn asked_for_node_count_and_volume_are_met() {
        let torus = Torus {
            radius: 30.0,
            tube: 6.0,
        };
        let exact = 2.0 * std::f64::consts::PI.powi(2) * torus.radius * torus.tube.powi(2);
        let body = Body {
            distance: &torus,
            volume: exact,
            genus: 1,
            outposts: Vec::new(),
            grading: Grading::EVEN,
        };
        for target in [300, 1_500, 6_000] {
            let meshed = mesh_to_nodes(&body, target, &mut |_| {}).unwrap();
            let n = meshed.mesh.nodes().len() as f64 / target as f64;
            assert!((n - 1.0).abs() < 0.05, "{n}");
            assert!(meshed.volume_error.abs() < 0.002, "{}", meshed.volume_error);
        }
        let error = mesh_to_nodes(&body, 7, &mut |_| {}).unwrap_err();
        assert_eq!(
            error.to_string(),
            "mesh.nodes = 7 is outside its range; it must lie between 100 and 200000"
        );
    }

    #[test]
    fn result_does_not_depend_on_threads() {
        let torus = Torus {
            radius: 10.0,
            tube: 4.0,
        };
        let how = Stuffing {
            spacing: 1.0,
            shift: 0.1,
            offset: Vec3::zeros(),
        };
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let four = rayon::ThreadPoolBuilder::new()
            .num_threads(4)
            .build()
            .unwrap();
        let (a, b) = (
            one.install(|| stuff(&torus, &how)).unwrap(),
            four.install(|| stuff(&torus, &how)).unwrap(),
        );
        assert_eq!(a.nodes, b.nodes);
        assert_eq!(a.tets, b.tets);
    }

    #[test]
    fn contour_is_closed_and_outward() {
        let torus = Torus {
            radius: 10.0,
            tube: 4.0,
        };
        let mesh = contour(&torus, 1.2).unwrap();
        let closed = crate::surface::ClosedSurface::new(mesh.clone(), "torus").unwrap();
        assert!(closed.notes.is_empty());
        assert_eq!(closed.mesh, mesh);
    }
}
