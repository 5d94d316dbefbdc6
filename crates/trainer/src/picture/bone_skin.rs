//! The bone's surface, slit where the crack crosses it.
//!
//! A triangle whose corners lie on both sides of the crack belongs to both: its part on each side moves with that side's cells,
//! continued to the line of the crack. The parts are cut off here, along lines that only depend on the mesh edge, so that
//! neighbours fit; seams between the two lips keep the surface closed for the winding counts. Only triangles at the crack are
//! touched, only when it grows, and neither simulation mesh nor shell knows of it.
use super::anchored::{Anchor, Skin, are_joined, piece_of, tet_at};
use super::closing::{self, edges, fill, join, open_edges};
use super::crack_skin::GapSkin;
use osteotome_mechanics::crack::{Cell, CrackedBody};
use osteotome_mechanics::geometry::{Aabb, TriMesh, Vec3, segment_crosses};
use osteotome_render::skin::{Part, Skin as Drawn, Wear};
use std::collections::HashMap;

/// The surface with its slits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoneSkin {
    /// What is shown.
    pub skin: Skin,
    /// Triangles that close it: they count but are not shown. Between the lips of slits, and where fragments have parted, for each of
    /// them within its share of the gap.
    pub seams: Vec<[u32; 3]>,
    /// Of the seams' vertices in a gap the one opposite, and the way they go when they part.
    away: HashMap<u32, (u32, Vec3)>,
}

impl BoneSkin {
    /// For the renderer.
    pub fn drawn(&self, parts: Vec<Part>) -> Drawn {
        self.skin.drawn_with(parts, |v| {
            let (opposite, into) = *self.away.get(&(v as u32))?;
            let into = into.cast::<f32>().into();
            Some(Wear { opposite, into })
        })
    }

    /// The middle of each fragment's share of the gap.
    fn lids(&mut self, gap: &GapSkin) -> Vec<[u32; 3]> {
        let mut copies = HashMap::new();
        let mut copy = |v: u32| {
            *copies.entry(v).or_insert_with(|| {
                self.skin.anchors.push(gap.skin.anchors[v as usize]);
                self.skin.rest.push(gap.skin.rest[v as usize]);
                self.skin.anchors.len() as u32 - 1
            })
        };
        for v in gap.lids.iter().flatten() {
            let (opposite, far) = gap.opposite[*v as usize];
            let of = (copy(opposite), far * 0.5);
            self.away.insert(copy(*v), of);
        }
        gap.lids.iter().map(|t| t.map(&mut copy)).collect()
    }

    fn edges(&self) -> impl Iterator<Item = [u32; 2]> {
        self.skin
            .triangles
            .iter()
            .chain(&self.seams)
            .flat_map(edges)
    }
}

/// Where the corners of a surface lie in the simulation mesh, and its edges; stays while the crack grows.
#[derive(Clone, Debug)]
pub struct Places {
    tets: Vec<(u32, [f64; 4])>,
    /// Lower vertex first.
    edges: Vec<[u32; 2]>,
    /// Of each triangle, that from each corner to the next.
    edges_of: Vec<[u32; 3]>,
}

impl Places {
    /// Finds them.
    pub fn new(body: &CrackedBody, surface: &TriMesh) -> Self {
        let tets = surface.vertices.iter().map(|p| tet_at(body, p));
        let (mut edges, mut number) = (Vec::new(), HashMap::new());
        let mut edge = |a: u32, b: u32| {
            *number.entry([a.min(b), a.max(b)]).or_insert_with_key(|e| {
                edges.push(*e);
                edges.len() as u32 - 1
            })
        };
        let mut of = |t: &[u32; 3]| [0, 1, 2].map(|k| edge(t[k], t[(k + 1) % 3]));
        let edges_of = surface.triangles.iter().map(&mut of).collect();
        Self {
            tets: tets.collect(),
            edges,
            edges_of,
        }
    }
}

/// Looks for the crack along an edge at so many places, and then between two of them in so many halvings.
const LOOKS: usize = 8;
const HALVINGS: usize = 14;

/// A cell by its tetrahedron and its number among the cells there: keeps its name while others are divided.
type Name = (u32, u32);

/// What was found at an edge near the crack.
#[derive(Clone, Debug)]
struct Look {
    /// The tetrahedra that were looked at.
    tets: Vec<u32>,
    /// Where it is slit, and the cells of both lips, the lower vertex's first.
    slit: Option<(Vec3, [Name; 2])>,
}

/// What was found when the surface was last slit. Only what a growth has touched is looked for again.
#[derive(Debug, Default)]
pub struct Slits {
    /// The cells, and for each the fragment, that it was found with.
    cells: Vec<(Cell, u32)>,
    parting: HashMap<u32, Vec<[Vec3; 3]>>,
    corners: Vec<Name>,
    looks: HashMap<u32, Look>,
}

impl Slits {
    /// The surface of a cracked body, slit along the parting surface of `gap`.
    ///
    /// Equal to what a new [`Slits`] would give, whatever was slit before, as long as body and surface are the same.
    pub fn skin(
        &mut self,
        body: &CrackedBody,
        surface: &TriMesh,
        places: &Places,
        gap: &GapSkin,
    ) -> BoneSkin {
        let cells = body.topology.cells();
        let cells: Vec<_> = (0u32..)
            .zip(cells)
            .map(|(c, cell)| (*cell, piece_of(body, c)))
            .collect();
        let touched = self.touched(body, &cells, gap);
        let mut slitter = Slitter {
            body,
            sides: Sides::new(body, gap),
            surface,
            out: BoneSkin::default(),
            lips: vec![None; places.edges.len()],
            looked: Vec::new(),
        };
        let is_new = self.corners.is_empty();
        let corner = |(v, (tet, weights)): (usize, &(u32, [f64; 4]))| {
            if is_new || touched[*tet as usize] {
                let cell = slitter.sides.cell_at(&surface.vertices[v], *tet, weights);
                name_of(body, cell)
            } else {
                self.corners[v]
            }
        };
        self.corners = places.tets.iter().enumerate().map(corner).collect();
        for ((p, (tet, weights)), name) in
            surface.vertices.iter().zip(&places.tets).zip(&self.corners)
        {
            let anchor = match name.0 == *tet {
                true => Anchor {
                    cell: cell_of(body, *name),
                    weights: *weights,
                },
                false => slitter.anchor_in(cell_of(body, *name), p),
            };
            slitter.out.skin.push(anchor, p);
        }
        self.looks
            .retain(|_, look| !look.tets.iter().any(|t| touched[*t as usize]));
        let near = near_crack(body);
        let is_near = |v: &u32| near[self.corners[*v as usize].0 as usize];
        for (e, edge) in (0u32..).zip(&places.edges) {
            if edge.iter().any(is_near) {
                let look = self.looks.entry(e).or_insert_with(|| slitter.look(*edge));
                slitter.lips[e as usize] = look.slit.map(|slit| slitter.slit(slit));
            }
        }
        for (t, edges) in surface.triangles.iter().zip(&places.edges_of) {
            slitter.triangle(*t, *edges);
        }
        slitter.close_fragments(gap);
        (self.cells, self.parting) = (cells, gap.parting.clone());
        slitter.out
    }

    /// For each tetrahedron, whether its cells, their fragments, or the parting surface around it are others than last time.
    fn touched(&self, body: &CrackedBody, cells: &[(Cell, u32)], gap: &GapSkin) -> Vec<bool> {
        let parting = self.parting.keys().chain(gap.parting.keys());
        let others = parting.filter(|t| self.parting.get(t) != gap.parting.get(t));
        let mut touched = around(body, others.copied());
        let is_one = |a: &(Cell, u32), b: &(Cell, u32)| a.0.tet == b.0.tet;
        let both = self.cells.chunk_by(is_one).zip(cells.chunk_by(is_one));
        for (old, new) in both {
            touched[new[0].0.tet as usize] |= old != new;
        }
        touched
    }
}

/// For each tetrahedron, whether the parting surface may pass by it: an edge that stays away from it is whole.
fn near_crack(body: &CrackedBody) -> Vec<bool> {
    let n = body.solid.mesh.tets().len() as u32;
    around(body, (0..n).filter(|t| body.topology.is_divided(*t)))
}

/// How far beyond the tetrahedra that it divides the parting surface is asked, in rings of those that touch: led out of the bone, it
/// passes over their neighbours.
const RINGS: usize = 2;

/// For each tetrahedron, whether it is one of these or in the rings about them.
fn around(body: &CrackedBody, these: impl Iterator<Item = u32>) -> Vec<bool> {
    let mesh = &body.solid.mesh;
    let mut is_in = vec![false; mesh.tets().len()];
    these.for_each(|t| is_in[t as usize] = true);
    for _ in 0..RINGS {
        let mut near = vec![false; mesh.nodes().len()];
        let inside = mesh.tets().iter().zip(&is_in).filter(|(_, is_in)| **is_in);
        inside.for_each(|(nodes, _)| nodes.iter().for_each(|n| near[*n as usize] = true));
        let touches = |nodes: &[u32; 4]| nodes.iter().any(|n| near[*n as usize]);
        is_in = mesh.tets().iter().map(touches).collect();
    }
    is_in
}

fn name_of(body: &CrackedBody, cell: u32) -> Name {
    let tet = body.topology.cells()[cell as usize].tet;
    (tet, cell - body.topology.cells_of(tet).start as u32)
}

fn cell_of(body: &CrackedBody, (tet, number): Name) -> u32 {
    body.topology.cells_of(tet).start as u32 + number
}

struct Slitter<'a> {
    body: &'a CrackedBody,
    sides: Sides<'a>,
    surface: &'a TriMesh,
    out: BoneSkin,
    /// For each edge the two lips, the lower vertex's first; none where the edge is whole.
    lips: Vec<Option<[u32; 2]>>,
    /// The tetrahedra looked at on an edge.
    looked: Vec<u32>,
}

impl Slitter<'_> {
    fn triangle(&mut self, t: [u32; 3], edges: [u32; 3]) {
        let lips = [0, 1, 2].map(|k| {
            let lips = self.lips[edges[k] as usize];
            lips.map(|[low, high]| {
                if t[k] < t[(k + 1) % 3] {
                    [low, high]
                } else {
                    [high, low]
                }
            })
        });
        let skin = &mut self.out.skin;
        match lips.iter().filter(|l| l.is_some()).count() {
            0 => skin.triangles.push(t),
            3 => self.three_ways(t, lips.map(Option::unwrap_or_default)),
            _ => {
                // Turned so that the first edge is slit, and the third too if two are.
                let is_first = |k: &usize| {
                    lips[*k].is_some()
                        && (lips[(k + 2) % 3].is_some() || lips[(k + 1) % 3].is_none())
                };
                let k = (0..3).find(is_first).unwrap_or(0);
                let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                let [ma, mb] = lips[k].unwrap_or_default();
                match lips[(k + 2) % 3] {
                    None => {
                        // The crack ends in this triangle.
                        skin.triangles.extend([[a, ma, c], [mb, b, c]]);
                        self.out.seams.push([ma, mb, c]);
                    }
                    Some([nc, na]) => {
                        skin.triangles
                            .extend([[a, ma, na], [mb, b, c], [mb, c, nc]]);
                        self.out.seams.extend([[ma, mb, nc], [ma, nc, na]]);
                    }
                }
            }
        }
    }

    /// Each corner keeps a quarter or so; the three meet in the middle.
    fn three_ways(&mut self, t: [u32; 3], lips: [[u32; 2]; 3]) {
        let middle: Vec3 = t
            .iter()
            .map(|v| self.surface.vertices[*v as usize])
            .sum::<Vec3>()
            / 3.0;
        let centre = t.map(|v| {
            let cell = self.out.skin.anchors[v as usize].cell;
            let anchor = self.anchor_in(cell, &middle);
            self.out.skin.push(anchor, &middle)
        });
        for k in 0..3 {
            let ([from, to], [_, back]) = (lips[k], lips[(k + 2) % 3]);
            let (c, next) = (centre[k], centre[(k + 1) % 3]);
            self.out
                .skin
                .triangles
                .extend([[t[k], from, c], [t[k], c, back]]);
            self.out.seams.extend([[from, to, next], [from, next, c]]);
        }
        self.out.seams.push(centre);
    }

    /// Closes each fragment for itself, by a surface in the middle of its share of the gap, joined to its lips.
    fn close_fragments(&mut self, gap: &GapSkin) {
        /// Lips lie on a straight line where the gap's faces may bend. The surface that joins them to the middle must not come out on
        /// this side of those, where no bone would be left of them: it begins so far beyond \[mm\].
        const BEYOND: f64 = 0.2;
        let n_given = self.surface.vertices.len() as u32;
        let place = |skin: &Skin, v: u32| {
            let at = Vec3::from(skin.rest[v as usize].map(f64::from));
            (at, piece_of(self.body, skin.anchors[v as usize].cell))
        };
        let BoneSkin { skin, seams, .. } = &mut self.out;
        seams.retain(|t| t.map(|v| place(skin, v).1) == [place(skin, t[0]).1; 3]);
        if gap.lids.is_empty() {
            return;
        }
        let lids = self.out.lids(gap);
        // Whole edges of the surface are none of these.
        let is_new = |e: &[u32; 2]| e.iter().all(|v| *v >= n_given);
        let lips = open_edges(self.out.edges().filter(is_new));
        let rim = open_edges(lids.iter().flat_map(edges));
        let mut between = Vec::new();
        let (mut beyond, mut nearest) = (HashMap::new(), HashMap::new());
        for (v, end) in closing::nearest(&lips, &rim, |v| place(&self.out.skin, v)) {
            let way = self.out.away[&end].1.try_normalize(1e-12);
            let p = place(&self.out.skin, v).0 + way.unwrap_or_default() * BEYOND;
            let anchor = self.anchor_in(self.out.skin.anchors[v as usize].cell, &p);
            let tip = self.out.skin.push(anchor, &p);
            beyond.insert(v, tip);
            nearest.insert(tip, end);
        }
        let mut tips = Vec::new();
        for [u, v] in lips {
            if let (Some(&p), Some(&q)) = (beyond.get(&u), beyond.get(&v)) {
                between.extend([[v, u, p], [v, p, q]]);
                tips.push([p, q]);
            }
        }
        between.extend(join(&tips, &rim, &nearest));
        self.out.seams.extend(lids.into_iter().chain(between));
        let filled = fill(self.out.edges().filter(is_new));
        self.out.seams.extend(filled);
    }

    /// Looks for the crack along an edge.
    fn look(&mut self, [a, b]: [u32; 2]) -> Look {
        self.looked.clear();
        let slit = self.parts([a, b]);
        let mut tets = std::mem::take(&mut self.looked);
        tets.sort_unstable();
        tets.dedup();
        Look { tets, slit }
    }

    /// Where an edge is parted, and the cells of both lips.
    fn parts(&mut self, [a, b]: [u32; 2]) -> Option<(Vec3, [Name; 2])> {
        let body = self.body;
        let ends = [a, b].map(|v| self.out.skin.anchors[v as usize].cell);
        let looked = ends.map(|c| name_of(body, c).0);
        self.looked.extend(looked);
        let [pa, pb] = [a, b].map(|v| self.surface.vertices[v as usize]);
        let at = |s: f64| pa + (pb - pa) * s;
        let share = |k: usize| k as f64 / LOOKS as f64;
        let mut cells = vec![ends[0]];
        cells.extend((1..LOOKS).map(|k| self.cell_at(&at(share(k)))));
        cells.push(ends[1]);
        let parts = |k: &usize| !are_joined(body, cells[*k], cells[k + 1]);
        let first = (0..LOOKS).find(parts)?;
        let last = (0..LOOKS).rfind(parts)?;
        // Of a third piece in between nothing is shown.
        let (mut low, mut high) = ((share(first), cells[first]), share(first + 1));
        for _ in 0..HALVINGS {
            let s = 0.5 * (low.0 + high);
            let cell = self.cell_at(&at(s));
            if are_joined(body, low.1, cell) {
                low = (s, cell);
            } else {
                high = s;
            }
        }
        let lips = [low.1, cells[last + 1]].map(|c| name_of(body, c));
        Some((at(0.5 * (low.0 + high)), lips))
    }

    /// The lips' vertices.
    fn slit(&mut self, (p, cells): (Vec3, [Name; 2])) -> [u32; 2] {
        cells.map(|name| {
            let anchor = self.anchor_in(cell_of(self.body, name), &p);
            self.out.skin.push(anchor, &p)
        })
    }

    fn cell_at(&mut self, p: &Vec3) -> u32 {
        let (tet, weights) = tet_at(self.body, p);
        self.looked.push(tet);
        self.sides.cell_at(p, tet, &weights)
    }

    fn anchor_in(&self, cell: u32, p: &Vec3) -> Anchor {
        let tet = self.body.topology.cells()[cell as usize].tet;
        Anchor {
            cell,
            weights: self.body.solid.mesh.barycentric(tet as usize, p),
        }
    }
}

/// Which side of the parting surface a point is on.
///
/// Within a tetrahedron mechanics goes by a plane, or by the nearest corner; what is drawn goes by the parting surface itself, so
/// that lips and walls fit also where three pieces meet.
struct Sides<'a> {
    body: &'a CrackedBody,
    gap: &'a GapSkin,
    /// For each tetrahedron that was asked for, the parting surface around it, for points within it and for those out of the mesh.
    around: HashMap<(u32, bool), Around>,
}

/// The parting surface near a tetrahedron: it is led on out of the bone, so that it passes by others than those that it divides.
struct Around {
    /// In it and in those that touch it; for points out of the mesh a ring more.
    facets: Vec<Facet>,
    /// Those of them that it divides.
    divided: Vec<u32>,
}

/// A triangle of the parting surface in its box.
struct Facet {
    corners: [Vec3; 3],
    bounds: Aabb,
}

impl Facet {
    fn new(corners: &[Vec3; 3]) -> Self {
        // Crossings are found a little beyond the border.
        const ROOM: f64 = 1e-6;
        Self {
            corners: *corners,
            bounds: Aabb::around(corners).grown(ROOM),
        }
    }

    fn parts(&self, p: &Vec3, q: &Vec3, way: &Aabb) -> bool {
        self.bounds.overlaps(way) && segment_crosses(p, q, &self.corners).is_some()
    }
}

impl<'a> Sides<'a> {
    fn new(body: &'a CrackedBody, gap: &'a GapSkin) -> Self {
        Self {
            body,
            gap,
            around: HashMap::new(),
        }
    }

    /// The cell of a point of a tetrahedron: that of a node that can be reached from it without crossing the surface, or where there
    /// is none, of the nearest such node of those around.
    fn cell_at(&mut self, p: &Vec3, tet: u32, weights: &[f64; 4]) -> u32 {
        let (body, gap) = (self.body, self.gap);
        let (topology, mesh) = (&body.topology, &body.solid.mesh);
        /// Beyond it by less, a point is still looked at as within.
        const OUT: f64 = -0.02;
        let is_out = weights.iter().any(|w| *w < OUT);
        let rings = if is_out { RINGS } else { 1 };
        let key = (tet, is_out);
        let near = (self.around.entry(key)).or_insert_with(|| Around::of(body, gap, tet, rings));
        if near.facets.is_empty() {
            return topology.cell_at(tet, weights);
        }
        let is_free = |q: &Vec3| {
            let way = Aabb::around(&[*p, *q]);
            !near.facets.iter().any(|f| f.parts(p, q, &way))
        };
        let holds = |t: u32, k: usize| {
            let cell = topology
                .cells_of(t)
                .find(|c| topology.cells()[*c].mask >> k & 1 == 1);
            cell.map(|c| c as u32)
        };
        let corners = mesh.corners(tet as usize);
        if let Some(k) = (0..4).find(|k| is_free(&corners[*k])) {
            return holds(tet, k).unwrap_or_else(|| topology.cell_at(tet, weights));
        }
        let of_tet = |t: &u32| [0, 1, 2, 3].map(|k| (*t, k, mesh.corners(*t as usize)[k]));
        let mut nodes: Vec<_> = near.divided.iter().flat_map(of_tet).collect();
        nodes.sort_by(|a, b| (a.2 - p).norm().total_cmp(&(b.2 - p).norm()));
        let free = nodes.iter().find(|(_, _, q)| is_free(q));
        let reached = free.and_then(|(t, k, _)| holds(*t, *k));
        reached.unwrap_or_else(|| topology.cell_at(tet, weights))
    }
}

impl Around {
    fn of(body: &CrackedBody, gap: &GapSkin, tet: u32, rings: usize) -> Self {
        let mesh = &body.solid.mesh;
        let mut divided = vec![tet];
        for _ in 0..rings {
            let nodes = divided.iter().flat_map(|t| mesh.tets()[*t as usize]);
            let mut nodes: Vec<u32> = nodes.collect();
            nodes.sort_unstable();
            nodes.dedup();
            let stars = nodes.iter().flat_map(|n| mesh.tets_of_node(*n as usize));
            divided = stars.copied().collect();
            divided.sort_unstable();
            divided.dedup();
        }
        divided.retain(|t| gap.parting.contains_key(t));
        let parting = divided.iter().filter_map(|t| gap.parting.get(t));
        Self {
            facets: parting.flatten().map(Facet::new).collect(),
            divided,
        }
    }
}
