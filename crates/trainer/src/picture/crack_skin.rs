//! The volumes that the CSG takes out of the bone: the saw's slit, and the opened crack.
//!
//! The slit is the two sides of the explicit crack's sawn part, offset by the kerf; the opened crack lies between the two faces
//! along which mechanics has parted the bone (the cut polygons of its tetrahedra), each moved by its own side's cells. There the
//! displacement jumps, so both volumes fit the slit surface exactly, also where mechanics runs ahead of the explicit front and
//! where a last ligament tore. Borders are closed.
use super::anchored::{Anchor, Skin, piece_of, sawn_part, tet_at};
use super::closing::{edges, fill, open_edges};
use super::saw_cuts::SawCuts;
use osteotome_mechanics::crack::{Cell, CrackedBody, Sheet};
use osteotome_mechanics::geometry::{NO_TET, SignedDistance, TET_EDGES, TET_FACES, TriMesh, Vec3};
use osteotome_render::skin::{CRUMBS, Part, Skin as Drawn, Wear};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// The saw's slit.
#[derive(Clone, Debug, Default)]
pub struct KerfSkin {
    /// What is shown.
    pub skin: Skin,
    /// Triangles over the same vertices between the two sides, and where a side goes over from one fragment to another, which span the gap
    /// once fragments are apart; and what lies out of the bone. They count but are not shown.
    pub seams: Vec<[u32; 3]>,
}

/// Between a triangle of the saw's cut on one side of the slit, and one that closes it off.
struct Prism {
    near: [u32; 3],
    far: [u32; 3],
    /// Whether the far one is the slit's other side, and not only counts.
    is_whole: bool,
    /// Of the sheet's corners.
    sheet: [u32; 3],
}

/// The sawn part of all sheets as closed volumes.
///
/// Where both sides are of one fragment the slit lies between them. Where fragments have parted, each side has nearly all of it for itself,
/// closed off by triangles that move with it: a volume from one fragment to the other would sweep through bone beside the slit wherever they
/// slide along each other. What is between them is the gap's.
pub fn kerf_skin(body: &CrackedBody, region: &dyn SignedDistance) -> KerfSkin {
    let mut skin = Skin::default();
    let mut sheets = Vec::new();
    for sheet in &body.crack.sheets {
        let sawn = sawn_part(sheet);
        let normals = normals(&sawn);
        let first = skin.anchors.len() as u32;
        let n = sawn.vertices.len() as u32;
        for side in [1.0, -1.0] {
            for (v, p) in sawn.vertices.iter().enumerate() {
                let out = normals[v] * side;
                push_on_side(body, &mut skin, &(p + out * sheet.kerf[v]), &out);
            }
        }
        for [a, b, c] in sawn.triangles.iter().map(|t| t.map(|v| v + first)) {
            skin.triangles.extend([[a, b, c], [a + n, c + n, b + n]]);
            sheets.push([[a, a + n], [b, b + n], [c, c + n]]);
        }
    }
    part_fragments(body, &mut skin);
    let (prisms, middles) = prisms(body, &mut skin, &sheets);
    let (shown, mut seams) = close(body, &mut skin, &prisms, &middles);
    let is_out = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| Vec3::from(skin.rest[v as usize].map(f64::from)));
        let middles = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
        [a, b, c]
            .iter()
            .chain(&middles)
            .all(|p| region.signed(p) > 0.0)
    };
    let (out, within) = shown.iter().partition(|t| is_out(t));
    seams.extend::<Vec<_>>(out);
    skin.triangles = within;
    KerfSkin { skin, seams }
}

/// The prisms of all triangles, whose sides are the skin's in turn, and for each corner of the sheets, which `sheets` has on both sides,
/// where it is itself.
fn prisms(
    body: &CrackedBody,
    skin: &mut Skin,
    sheets: &[[[u32; 2]; 3]],
) -> (Vec<Prism>, HashMap<u32, Vec3>) {
    /// What each side has of a parted slit reaches so far beyond the middle \[of its width\]: the gap's faces are near the middle only, and
    /// the other side's wall must stay clear of it while it has hardly moved.
    const BEYOND: f64 = 0.4;
    let rest = |skin: &Skin, v: u32| Vec3::from(skin.rest[v as usize].map(f64::from));
    let sides = std::mem::take(&mut skin.triangles);
    let (mut middles, mut closing) = (HashMap::new(), HashMap::new());
    let mut all = Vec::new();
    for (corners, both) in sheets.iter().zip(sides.chunks(2)) {
        let sheet = corners.map(|[v, other]| {
            middles.insert(v, (rest(skin, v) + rest(skin, other)) / 2.0);
            v
        });
        let [one, [d, f, e]] = [both[0], both[1]];
        let other = [d, e, f];
        let piece = |v: u32| piece_of(body, skin.anchors[v as usize].cell);
        if piece(one[0]) == piece(d) {
            let (near, far, is_whole) = (one, other, true);
            all.push(Prism {
                near,
                far,
                is_whole,
                sheet,
            });
            continue;
        }
        let mut closed_off = |near: [u32; 3], sheet: [u32; 3]| {
            let far = [0, 1, 2].map(|k| {
                *closing.entry(near[k]).or_insert_with(|| {
                    let (p, middle) = (rest(skin, near[k]), middles[&sheet[k]]);
                    let cell = skin.anchors[near[k] as usize].cell;
                    push_with(body, skin, cell, &(middle + (middle - p) * (2.0 * BEYOND)))
                })
            });
            let is_whole = false;
            Prism {
                near,
                far,
                is_whole,
                sheet,
            }
        };
        let [a, b, c] = sheet;
        all.push(closed_off(one, sheet));
        all.push(closed_off([d, f, e], [a, c, b]));
    }
    (all, middles)
}

/// What is shown of prisms, and what only closes them.
fn close(
    body: &CrackedBody,
    skin: &mut Skin,
    prisms: &[Prism],
    middles: &HashMap<u32, Vec3>,
) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
    let (mut shown, mut seams) = (Vec::new(), Vec::new());
    // Of each edge of the sheets the prisms' ends there, near and far, as their near triangles run from one to the next.
    let mut walls: BTreeMap<[u32; 2], Vec<(usize, usize)>> = BTreeMap::new();
    let edge = |i: usize, k: usize| [k, (k + 1) % 3].map(|k| prisms[i].sheet[k]);
    for (i, prism) in prisms.iter().enumerate() {
        shown.push(prism.near);
        let [d, e, f] = prism.far;
        if prism.is_whole {
            &mut shown
        } else {
            &mut seams
        }
        .push([d, f, e]);
        for k in 0..3 {
            let [a, b] = edge(i, k);
            walls.entry([a.min(b), a.max(b)]).or_default().push((i, k));
        }
    }
    let mut halves = HashMap::new();
    for of_edge in walls.values() {
        let ends = |(i, k): (usize, usize)| {
            [k, (k + 1) % 3].map(|k| [prisms[i].near[k], prisms[i].far[k]])
        };
        // A parted triangle of a sheet has two prisms.
        let n_sides = of_edge
            .iter()
            .map(|(i, _)| 1 + usize::from(prisms[*i].is_whole));
        let is_border = n_sides.sum::<usize>() == 2;
        for &wall in of_edge {
            let [p, q] = ends(wall);
            if of_edge.iter().any(|other| ends(*other) == [q, p]) {
                continue;
            }
            let quad = |[p, q]: [[u32; 2]; 2]| [[q[0], p[0], p[1]], [q[0], p[1], q[1]]];
            let (i, k) = wall;
            if !is_border {
                seams.extend(quad([p, q]));
            } else if prisms[i].is_whole {
                // Each half of the slit's bottom stays with its own side.
                let [[pa, pb], [qa, qb]] = [(p, k), (q, (k + 1) % 3)].map(|(ends, k)| {
                    *halves.entry(ends).or_insert_with(|| {
                        let middle = &middles[&prisms[i].sheet[k]];
                        ends.map(|v| {
                            let cell = skin.anchors[v as usize].cell;
                            push_with(body, skin, cell, middle)
                        })
                    })
                });
                shown.extend(quad([[p[0], pa], [q[0], qa]]));
                shown.extend(quad([[pb, p[1]], [qb, q[1]]]));
                seams.extend(quad([[pa, pb], [qa, qb]]));
            } else {
                shown.extend(quad([p, q]));
            }
        }
    }
    let filled = fill(shown.iter().chain(&seams).flat_map(edges));
    seams.extend(filled);
    (shown, seams)
}

/// The explicit crack beyond the saw's slit: where the bone broke. A triangle that would span two fragments goes with one of them.
pub fn broken_sheets(body: &CrackedBody) -> Skin {
    let mut skin = Skin::default();
    for sheet in &body.crack.sheets {
        let normals = normals(&sheet.mesh);
        let first = skin.anchors.len() as u32;
        for (p, n) in sheet.mesh.vertices.iter().zip(&normals) {
            push_on_side(body, &mut skin, p, n);
        }
        let broken = sheet.mesh.triangles.iter().filter(|t| !is_sawn(sheet, t));
        skin.triangles.extend(broken.map(|t| t.map(|v| v + first)));
    }
    part_fragments(body, &mut skin);
    skin
}

/// Those triangles of the explicit crack that have not parted fragments.
///
/// Where fragments have parted, mechanics has given the crack's vertices to one or the other, and their triangles would be seen in patches
/// on both: there [`GapSkin::apart`] shows where the bone broke.
pub fn unparted(body: &CrackedBody, broken: &Skin, gap: &GapSkin) -> Vec<[u32; 3]> {
    let mesh = &body.solid.mesh;
    let mut is_at_parted = vec![false; mesh.nodes().len()];
    let of_fragments = gap.pieces.iter().map(|(cells, _)| *cells);
    for [cell, _] in of_fragments.filter(|cells| parts_fragments(body, *cells)) {
        let tet = body.topology.cells()[cell as usize].tet;
        let nodes = mesh.tets()[tet as usize];
        nodes.iter().for_each(|n| is_at_parted[*n as usize] = true);
    }
    let is_parted = |t: &[u32; 3]| {
        let at = t.map(|v| Vec3::from(broken.rest[v as usize].map(f64::from)));
        let (tet, _) = tet_at(body, &(at.iter().sum::<Vec3>() / 3.0));
        let nodes = mesh.tets()[tet as usize];
        nodes.iter().any(|n| is_at_parted[*n as usize])
    };
    let all = broken.triangles.iter();
    all.filter(|t| !is_parted(t)).copied().collect()
}

/// Has each triangle go with the fragment of most of its corners.
fn part_fragments(body: &CrackedBody, skin: &mut Skin) {
    let mut copies: HashMap<[u32; 2], u32> = HashMap::new();
    for i in 0..skin.triangles.len() {
        let t = skin.triangles[i];
        let cells = t.map(|v| skin.anchors[v as usize].cell);
        let of = cells.map(|c| piece_of(body, c));
        // Two of three different ones are as good as any.
        let k = usize::from(of[0] != of[1] && of[0] != of[2]);
        skin.triangles[i] = [0, 1, 2].map(|j| match of[j] == of[k] {
            true => t[j],
            false => *(copies.entry([t[j], of[k]])).or_insert_with(|| {
                let at = Vec3::from(skin.rest[t[j] as usize].map(f64::from));
                push_with(body, skin, cells[k], &at)
            }),
        });
    }
}

/// Whether two cells are of two fragments.
fn parts_fragments(body: &CrackedBody, [a, b]: [u32; 2]) -> bool {
    piece_of(body, a) != piece_of(body, b)
}

fn is_sawn(sheet: &Sheet, t: &[u32; 3]) -> bool {
    t.iter().all(|v| sheet.kerf[*v as usize] > 0.0)
}

fn normals(mesh: &TriMesh) -> Vec<Vec3> {
    let mut sums = vec![Vec3::zeros(); mesh.vertices.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let n = mesh.area_normal(t);
        corners.iter().for_each(|v| sums[*v as usize] += n);
    }
    let unit = |n: &Vec3| n.try_normalize(1e-12).unwrap_or_default();
    sums.iter().map(unit).collect()
}

/// A vertex at `p` that moves with the side of the crack to which `side` looks.
fn push_on_side(body: &CrackedBody, skin: &mut Skin, p: &Vec3, side: &Vec3) {
    let (tet, weights) = tet_at(body, p);
    let cell = body.topology.cell_towards(&body.solid.mesh, tet, p, side);
    skin.push(Anchor { cell, weights }, p);
}

/// A vertex at `p` that moves with a cell.
fn push_with(body: &CrackedBody, skin: &mut Skin, cell: u32, p: &Vec3) -> u32 {
    let tet = body.topology.cells()[cell as usize].tet;
    let weights = body.solid.mesh.barycentric(tet as usize, p);
    skin.push(Anchor { cell, weights }, p)
}

/// The opened crack.
#[derive(Clone, Debug, Default)]
pub struct GapSkin {
    /// Vertices, and faces where the bone broke.
    pub skin: Skin,
    /// Those of them that have parted fragments.
    pub apart: Vec<[u32; 3]>,
    /// Faces within the saw's slit.
    pub sawn: Vec<[u32; 3]>,
    /// Triangles that close it: they count but are not shown.
    pub walls: Vec<[u32; 3]>,
    /// Those of them that are the far side of a fragment's share of the gap, as far as it was not led out of the bone.
    pub lids: Vec<[u32; 3]>,
    /// For each vertex the one opposite, or itself, and the way it goes when they part: of a face into its own side, 1 long, shorter
    /// where there is little bone that way.
    pub opposite: Vec<(u32, Vec3)>,
    /// Of each piece, the two cells and its undeformed area vector \[mm2\], which looks from the first to the second.
    pub pieces: Vec<([u32; 2], Vec3)>,
    /// The undeformed triangles along which each tetrahedron is parted, led on out of the bone.
    pub parting: HashMap<u32, Vec<[Vec3; 3]>>,
}

impl GapSkin {
    /// For the renderer: where faces rub, crumbs come off.
    pub fn drawn(&self, parts: Vec<Part>) -> Drawn {
        self.skin.drawn_with(parts, |v| {
            let (opposite, into) = &self.opposite[v];
            let is_face = *opposite as usize != v;
            is_face.then(|| Wear {
                opposite: *opposite,
                into: into.cast::<f32>().into(),
            })
        })
    }
}

impl GapSkin {
    /// Closes off each fragment's share of the gap behind these faces by triangles that move with the fragment: what spanned the gap
    /// would sweep through bone beside it wherever fragments slide along each other.
    fn close_off(&mut self, [within, led_out]: &[Vec<[u32; 3]>; 2]) {
        /// The far side goes so far beyond where a face was, in shares of what the other fragment's face goes back there: it must not
        /// reach into the other's bone, nor lie on its face.
        const FAR: f64 = 0.7;
        let mut far = HashMap::new();
        let mut behind = |v: u32| {
            *far.entry(v).or_insert_with(|| {
                let (opposite, into) = self.opposite[v as usize];
                let (anchor, rest) = (self.skin.anchors[v as usize], self.skin.rest[v as usize]);
                self.skin.anchors.push(anchor);
                self.skin.rest.push(rest);
                self.opposite.push((opposite, into * -FAR));
                self.skin.anchors.len() as u32 - 1
            })
        };
        let mut turned = |t: &[u32; 3]| {
            let [a, b, c] = t.map(&mut behind);
            [a, c, b]
        };
        self.lids = within.iter().map(&mut turned).collect();
        self.walls.extend(&self.lids);
        self.walls.extend(led_out.iter().map(turned));
        for [a, b] in open_edges(within.iter().chain(led_out).flat_map(edges)) {
            let [c, d] = [a, b].map(&mut behind);
            self.walls.extend([[b, a, c], [b, c, d]]);
        }
    }
}

/// A point of the parting surface: on a cut edge, on a face between cut edges, in the middle of a tetrahedron; and the same led
/// out of the bone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Base {
    Edge(u32),
    /// By its nodes, ascending.
    Face([u32; 3]),
    Tet(u32),
}

/// A base point, and whether it is the one led out of the bone.
type Point = (Base, bool);

/// A piece of the parting surface between two cells of a tetrahedron; its normal looks from the first to the second.
struct Piece {
    cells: [u32; 2],
    points: [Point; 4],
}

/// Where a point of the parting surface is.
#[derive(Clone, Copy)]
struct Place {
    /// Undeformed.
    at: Vec3,
    /// The saw's cuts that it is on.
    cuts: u64,
    /// How far from where the saw came to a stop; below zero beyond it.
    depth: f64,
}

/// A corner of a face: one vertex on each side of the crack.
#[derive(Clone, Copy)]
struct Corner {
    vertices: [u32; 2],
    depth: f64,
}

struct Parting<'a> {
    body: &'a CrackedBody,
    saw: SawCuts,
    places: BTreeMap<Base, Place>,
    /// The saw's cuts through each cut edge.
    cuts_of: HashMap<u32, u64>,
    way_out: HashMap<Base, Vec3>,
    pieces: Vec<Piece>,
    out: GapSkin,
    vertices: HashMap<(Point, [u32; 4]), u32>,
    /// Vertices where the saw came to a stop between two others.
    stops: HashMap<[u32; 2], u32>,
    /// Faces between fragments: in the mesh, and led out of the bone.
    parted: [Vec<[u32; 3]>; 2],
}

/// The opened crack of a body whose true shape is `region`.
pub fn gap_skin(body: &CrackedBody, region: &dyn SignedDistance) -> GapSkin {
    let mut parting = Parting {
        body,
        saw: SawCuts::new(body, region),
        places: BTreeMap::new(),
        cuts_of: HashMap::new(),
        way_out: HashMap::new(),
        pieces: Vec::new(),
        out: GapSkin::default(),
        vertices: HashMap::new(),
        stops: HashMap::new(),
        parted: Default::default(),
    };
    for t in 0..body.solid.mesh.tets().len() as u32 {
        if body.topology.is_divided(t) {
            parting.divide(t);
        }
    }
    parting.lead_out(region);
    parting.emit();
    let (mut gap, parted) = (parting.out, parting.parted);
    for (_, into) in &mut gap.opposite {
        *into = into.try_normalize(1e-12).unwrap_or_default();
    }
    let n_faces = gap.opposite.len();
    gap.close_off(&parted);
    let faces = gap.opposite[..n_faces].iter_mut();
    for ((_, into), p) in faces.zip(&gap.skin.rest) {
        *into *= wearing(region, &Vec3::from(p.map(f64::from)), into);
    }
    gap
}

/// How much of its crumbs a face at `p` may lose `into` its side: all, or less where so little bone is left that a hole would show.
fn wearing(region: &dyn SignedDistance, p: &Vec3, into: &Vec3) -> f64 {
    /// Looks so far, in as many steps, in shares of what is lost at most.
    const REACH: usize = 5;
    let is_out = |k: &usize| region.signed(&(p + into * (*k as f64 * f64::from(CRUMBS)))) > 0.0;
    if is_out(&0) {
        return 1.0;
    }
    let thickness = (1..=REACH).find(is_out).map_or(REACH, |k| k - 1);
    thickness as f64 / REACH as f64
}

impl Parting<'_> {
    /// The pieces in one tetrahedron: for each edge that parts, the quad of its crossing point, its two faces' middles and the
    /// tetrahedron's.
    fn divide(&mut self, t: u32) {
        let (body, mesh) = (self.body, &self.body.solid.mesh);
        let nodes = mesh.tets()[t as usize];
        let range = body.topology.cells_of(t);
        let cell_of = |k: usize| {
            let holds = |c: &usize| body.topology.cells()[*c].mask >> k & 1 == 1;
            range.clone().find(holds).unwrap_or(range.start) as u32
        };
        let cells = [0, 1, 2, 3].map(cell_of);
        let edges = mesh.tet_edges()[t as usize];
        let parted: Vec<usize> = (0..6)
            .filter(|l| {
                let [a, b] = TET_EDGES[*l];
                cells[a] != cells[b] && body.cuts.is_cut(edges[*l])
            })
            .collect();
        let on = |list: &[usize]| list.iter().map(|l| edges[*l]).collect::<Vec<_>>();
        self.put(Base::Tet(t), &on(&parted));
        for &l in &parted {
            let [a, b] = TET_EDGES[l];
            let mut rest = (0..4).filter(|k| *k != a && *k != b);
            let (c, d) = (rest.next().unwrap_or(0), rest.next().unwrap_or(0));
            let (c, d) = if is_even([a, b, c, d]) {
                (c, d)
            } else {
                (d, c)
            };
            let mut face = |e: usize| {
                let mut ids = [a, b, e].map(|k| nodes[k]);
                ids.sort_unstable();
                // All cut edges of the face, so that the tetrahedron behind it finds the same middle.
                let on_face = |l: &usize| {
                    TET_EDGES[*l].iter().all(|k| [a, b, e].contains(k))
                        && body.cuts.is_cut(edges[*l])
                };
                let cut: Vec<usize> = (0..6).filter(on_face).collect();
                self.put(Base::Face(ids), &on(&cut));
                Base::Face(ids)
            };
            let (fc, fd) = (face(c), face(d));
            self.put(Base::Edge(edges[l]), &on(&[l]));
            let points = [Base::Edge(edges[l]), fc, Base::Tet(t), fd].map(|p| (p, false));
            self.pieces.push(Piece {
                cells: [cells[a], cells[b]],
                points,
            });
        }
    }

    /// Places a point amid cut edges, on the saw's cuts that made them.
    fn put(&mut self, base: Base, edges: &[u32]) {
        if self.places.contains_key(&base) {
            return;
        }
        let mesh = &self.body.solid.mesh;
        let crossing = |e: &u32| self.body.cuts.crossing_point(mesh, *e);
        let mut through = |e: &u32| {
            let ends = mesh.edges()[*e as usize].map(|n| mesh.nodes()[n as usize]);
            let found = || self.saw.through(ends, &crossing(e));
            *self.cuts_of.entry(*e).or_insert_with(found)
        };
        let of_edges: Vec<u64> = edges.iter().map(&mut through).collect();
        // Where several cuts meet on all of them; amid edges that broke apart, on none.
        let cuts = match of_edges.iter().fold(u64::MAX, |all, c| all & c) {
            0 if of_edges.contains(&0) => 0,
            0 => of_edges.iter().fold(0, |all, c| all | c),
            common => common,
        };
        let middle = edges.iter().map(crossing).sum::<Vec3>() / edges.len() as f64;
        let seat = self.saw.seat(&middle, cuts);
        let at = seat.unwrap_or(middle);
        let place = Place {
            at,
            cuts: if seat.is_some() { cuts } else { 0 },
            depth: self.saw.depth(&at),
        };
        self.places.insert(base, place);
    }

    /// Border edges of the parting surface, or of a part of it, as their piece runs through them.
    fn borders(&self, is_part: impl Fn(&Piece) -> bool) -> Vec<(usize, [Point; 2])> {
        let mut uses: HashMap<[Point; 2], u32> = HashMap::new();
        let edges = |p: &Piece| [0, 1, 2, 3].map(|k| [p.points[k], p.points[(k + 1) % 4]]);
        let key = |[a, b]: [Point; 2]| [a.min(b), a.max(b)];
        let pieces: Vec<_> = (self.pieces.iter().enumerate())
            .filter(|(_, p)| is_part(p))
            .collect();
        for e in pieces.iter().flat_map(|(_, p)| edges(p)) {
            *uses.entry(key(e)).or_default() += 1;
        }
        let of_piece = |(i, p): &(usize, &Piece)| edges(p).map(|e| (*i, e));
        let all = pieces.iter().flat_map(of_piece);
        all.filter(|(_, e)| uses[&key(*e)] == 1).collect()
    }

    /// Leads the surface on where it ends at the simulation mesh's boundary, out of the true bone.
    fn lead_out(&mut self, region: &dyn SignedDistance) {
        /// Directions are made alike in so many rounds.
        const ALIKE: usize = 6;
        let mut ends = Vec::new();
        let mut outward: HashMap<Base, Vec3> = HashMap::new();
        let mut across: HashMap<Base, (Vec3, f64)> = HashMap::new();
        for (i, edge) in self.borders(|_| true) {
            let piece = &self.pieces[i];
            let tet = self.body.topology.cells()[piece.cells[0] as usize].tet;
            let Some(out) = edge
                .iter()
                .find_map(|p| boundary_normal(self.body, tet, p.0))
            else {
                continue;
            };
            let [a, b, c, _] = piece.points.map(|p| self.places[&p.0].at);
            let normal = (b - a).cross(&(c - a)).try_normalize(1e-12);
            for p in edge {
                *outward.entry(p.0).or_default() += out;
                let (sum, n) = across.entry(p.0).or_default();
                *sum += normal.unwrap_or_default();
                *n += 1.0;
            }
            ends.push((i, edge));
        }
        let outward: BTreeMap<Base, Vec3> = (outward.into_iter())
            .map(|(base, out)| (base, out.try_normalize(1e-12).unwrap_or_default()))
            .collect();
        let h = self.body.solid.lengths.h;
        // In the saw's cut, else in the surface's own plane, unless several meet there.
        let within = |base: &Base, way: &Vec3| {
            let Place { at, cuts, .. } = self.places[base];
            let (sum, n) = across[base];
            let normal = sum.try_normalize(0.9 * n).unwrap_or_default();
            let own = || (way - normal * way.dot(&normal)).try_normalize(1e-6);
            let way = self.saw.way_out(&at, cuts, way).or_else(own);
            way.filter(|d| d.dot(&outward[base]) > 0.4)
        };
        let mut ways: BTreeMap<Base, Vec3> = (outward.iter())
            .map(|(base, out)| (*base, within(base, out).unwrap_or(*out)))
            .collect();
        // Alike from point to point: where two cuts meet, surfaces led out across their common line would twist into each other.
        for _ in 0..ALIKE {
            let mut sums = ways.clone();
            for [p, q] in ends.iter().map(|(_, edge)| edge.map(|p| p.0)) {
                let [of_p, of_q] = [ways[&p], ways[&q]];
                *sums.entry(p).or_default() += of_q;
                *sums.entry(q).or_default() += of_p;
            }
            for (base, way) in &mut ways {
                *way = within(base, &sums[base]).unwrap_or(*way);
            }
        }
        for (base, direction) in ways {
            let from = self.places[&base].at;
            // Beyond the true surface, and a little more.
            let reach = (0..=100).map(|k| 0.015 * h * f64::from(k));
            let mut clear = reach.filter(|s| region.signed(&(from + direction * *s)) > 0.05 * h);
            let length = (clear.next().unwrap_or(0.3 * h) + 0.1 * h).max(0.6 * h);
            self.way_out.insert(base, direction * length);
        }
        let edges = ends.iter().map(|(_, edge)| edge.map(|p| p.0));
        self.clear_chords(&edges.collect::<Vec<_>>(), region);
        for (i, [p, q]) in ends {
            let cells = self.pieces[i].cells;
            let points = [q, p, (p.0, true), (q.0, true)];
            self.pieces.push(Piece { cells, points });
        }
    }

    /// Leads both ends of an edge out farther where the bone bulges between them: what is left beyond the edge would hang across the
    /// gap.
    fn clear_chords(&mut self, edges: &[[Base; 2]], region: &dyn SignedDistance) {
        const ROUNDS: usize = 5;
        /// Farther by so much in each \[element sizes\].
        const FARTHER: f64 = 0.15;
        const BETWEEN: [f64; 5] = [0.15, 0.3, 0.5, 0.7, 0.85];
        let h = self.body.solid.lengths.h;
        let mut asked: Vec<[Base; 2]> = edges.to_vec();
        for _ in 0..ROUNDS {
            let tip = |base: Base| self.places[&base].at + self.way_out[&base];
            let is_within = |[p, q]: &[Base; 2]| {
                let [p, q] = [tip(*p), tip(*q)];
                let at = |s: f64| region.signed(&p.lerp(&q, s));
                BETWEEN.into_iter().any(|s| at(s) < 0.05 * h)
            };
            asked.retain(is_within);
            let short: BTreeSet<Base> = asked.iter().flatten().copied().collect();
            if short.is_empty() {
                break;
            }
            for base in &short {
                let (at, way) = (self.places[base].at, self.way_out[base]);
                let farther = way * (1.0 + FARTHER * h / way.norm());
                // Not across a hollow into the bone on its other side.
                if region.signed(&(at + farther)) > region.signed(&(at + way)) {
                    self.way_out.insert(*base, farther);
                }
            }
            let is_touched = |e: &&[Base; 2]| e.iter().any(|p| short.contains(p));
            asked = edges.iter().filter(is_touched).copied().collect();
        }
    }

    /// Both faces of each piece, and walls along the border of what has opened within a fragment.
    fn emit(&mut self) {
        let borders = self.borders(|p| !parts_fragments(self.body, p.cells));
        for i in 0..self.pieces.len() {
            let Piece { cells, points } = self.pieces[i];
            let corners = points.map(|p| Corner {
                vertices: cells.map(|cell| self.vertex(p, cell)),
                depth: self.places[&p.0].depth,
            });
            let [p, q, r, s] = corners.map(|c| self.rest(c.vertices[1]));
            let area = 0.5 * (r - p).cross(&(s - q));
            self.out.pieces.push((cells, area));
            let tet = self.body.topology.cells()[cells[0] as usize].tet;
            let parting = self.out.parting.entry(tet).or_default();
            parting.extend([[p, q, r], [p, r, s]]);
            let mut used: Vec<[u32; 2]> = corners.map(|c| c.vertices).to_vec();
            let n_before = [&self.out.skin.triangles, &self.out.sawn].map(Vec::len);
            for t in [[0, 1, 2], [0, 2, 3]] {
                self.face(t.map(|k| corners[k]), cells, &mut used);
            }
            if parts_fragments(self.body, cells) {
                let out = &mut self.out;
                let [broken, sawn] = n_before;
                out.apart.extend(&out.skin.triangles[broken..]);
                let is_led_out = points.iter().any(|p| p.1);
                let list = &mut self.parted[usize::from(is_led_out)];
                list.extend(&out.skin.triangles[broken..]);
                list.extend(&out.sawn[sawn..]);
            }
            used.sort_unstable();
            used.dedup();
            for [a, b] in used.into_iter().filter(|[a, b]| a != b) {
                for (v, other, into) in [(a, b, -area), (b, a, area)] {
                    let (opposite, sum) = &mut self.out.opposite[v as usize];
                    *opposite = other;
                    *sum += into;
                }
            }
        }
        for (i, [p, q]) in borders {
            let [a, b] = self.pieces[i].cells;
            let [pa, qa, pb, qb] = [(p, a), (q, a), (p, b), (q, b)].map(|(p, c)| self.vertex(p, c));
            for t in [[pa, qa, qb], [pa, qb, pb]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    self.out.walls.push(t);
                }
            }
        }
        self.close();
    }

    /// Both sides of a triangle, what the saw made and what broke apart.
    fn face(&mut self, corners: [Corner; 3], cells: [u32; 2], used: &mut Vec<[u32; 2]>) {
        let (mut sawn, mut broken) = (Vec::new(), Vec::new());
        for k in 0..3 {
            let (c, next) = (corners[k], corners[(k + 1) % 3]);
            if c.depth >= 0.0 {
                sawn.push(c.vertices);
            }
            if c.depth <= 0.0 {
                broken.push(c.vertices);
            }
            if c.depth * next.depth < 0.0 {
                let stop = self.stop(c, next, cells);
                used.push(stop);
                sawn.push(stop);
                broken.push(stop);
            }
        }
        // On the line where the saw stopped a face is of neither.
        if sawn.len() == 3 && broken.len() == 3 {
            sawn.clear();
        }
        let out = &mut self.out;
        for (corners, list) in [(sawn, &mut out.sawn), (broken, &mut out.skin.triangles)] {
            for k in 2..corners.len() {
                let [a, b] = [0, 1].map(|side| [0, k - 1, k].map(|c: usize| corners[c][side]));
                list.extend([b, [a[0], a[2], a[1]]]);
            }
        }
    }

    /// Between two corners, where the saw came to a stop.
    fn stop(&mut self, from: Corner, to: Corner, cells: [u32; 2]) -> [u32; 2] {
        [0, 1].map(|side| {
            let (u, v) = (from.vertices[side], to.vertices[side]);
            let key = [u.min(v), u.max(v)];
            if let Some(known) = self.stops.get(&key) {
                return *known;
            }
            let share = from.depth / (from.depth - to.depth);
            let p = self.rest(u).lerp(&self.rest(v), share);
            let p = self.saw.stop(&p).unwrap_or(p);
            let vertex = self.push(cells[side], &p);
            self.stops.insert(key, vertex);
            vertex
        })
    }

    fn rest(&self, vertex: u32) -> Vec3 {
        Vec3::from(self.out.skin.rest[vertex as usize].map(f64::from))
    }

    /// A vertex that a cell moves.
    fn push(&mut self, cell: u32, p: &Vec3) -> u32 {
        let vertex = push_with(self.body, &mut self.out.skin, cell, p);
        self.out.opposite.push((vertex, Vec3::zeros()));
        vertex
    }

    /// A point as one cell moves it. Cells that move it alike share the vertex.
    fn vertex(&mut self, point: Point, cell: u32) -> u32 {
        let mesh = &self.body.solid.mesh;
        let c: Cell = self.body.topology.cells()[cell as usize];
        let nodes = mesh.tets()[c.tet as usize];
        let jump = |n: u32| {
            nodes
                .iter()
                .position(|m| *m == n)
                .map_or(0, |k| c.enrichment[k])
        };
        let key = match point.0 {
            Base::Edge(e) => {
                let [a, b] = mesh.edges()[e as usize];
                [jump(a), jump(b), 0, 0]
            }
            Base::Face([a, b, c]) => [jump(a), jump(b), jump(c), 0],
            Base::Tet(_) => [cell, 0, 0, 1],
        };
        if let Some(known) = self.vertices.get(&(point, key)) {
            return *known;
        }
        let way = if point.1 {
            self.way_out.get(&point.0).copied()
        } else {
            None
        };
        let p = self.places[&point.0].at + way.unwrap_or_default();
        let vertex = self.push(cell, &p);
        self.vertices.insert((point, key), vertex);
        vertex
    }

    /// Fills what is still open: small holes where three or more pieces meet at the border, and where what parts fragments begins.
    fn close(&mut self) {
        let out = &mut self.out;
        // What parts fragments is closed off by itself.
        let parted: HashSet<&[u32; 3]> = self.parted.iter().flatten().collect();
        let faces = out.skin.triangles.iter().chain(&out.sawn);
        let within = faces.filter(|t| !parted.contains(t)).chain(&out.walls);
        let filled = fill(within.flat_map(edges));
        out.walls.extend(filled);
    }
}

/// Outward normal of the boundary face of `tet` that a face's middle lies on.
fn boundary_normal(body: &CrackedBody, tet: u32, base: Base) -> Option<Vec3> {
    let Base::Face(ids) = base else {
        return None;
    };
    let mesh = &body.solid.mesh;
    let nodes = mesh.tets()[tet as usize];
    let k = (0..4).find(|k| !ids.contains(&nodes[*k]))?;
    if mesh.neighbours()[tet as usize][k] != NO_TET {
        return None;
    }
    let [a, b, c] = TET_FACES[k].map(|l| mesh.nodes()[nodes[l] as usize]);
    (b - a).cross(&(c - a)).try_normalize(1e-12)
}

fn is_even(p: [usize; 4]) -> bool {
    let swaps = (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
    swaps.filter(|(i, j)| p[*i] > p[*j]).count() % 2 == 0
}
