//! The bone's surface, slit where the crack crosses it.
//!
//! A triangle whose corners lie on both sides of the crack belongs to both: its part on each side moves with that side's cells,
//! continued to the line of the crack. The parts are cut off here, along lines that only depend on the mesh edge, so that
//! neighbours fit; seams between the two lips keep the surface closed for the winding counts. Only triangles at the crack are
//! touched, only when it grows, and neither simulation mesh nor shell knows of it.
use super::anchored::{Anchor, Skin, are_joined, tet_at};
use super::crack_skin::GapSkin;
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::geometry::{TriMesh, Vec3, segment_crosses};
use std::collections::HashMap;

/// The surface with its slits.
#[derive(Clone, Debug, Default)]
pub struct BoneSkin {
    /// What is shown.
    pub skin: Skin,
    /// Triangles over the same vertices between the lips of slits: they count but are not shown.
    pub seams: Vec<[u32; 3]>,
}

/// Where the corners of a surface lie in the simulation mesh; stays while the crack grows.
#[derive(Clone, Debug)]
pub struct Places {
    tets: Vec<(u32, [f64; 4])>,
}

impl Places {
    /// Finds them.
    pub fn new(body: &CrackedBody, surface: &TriMesh) -> Self {
        let tets = surface.vertices.iter().map(|p| tet_at(body, p));
        Self {
            tets: tets.collect(),
        }
    }
}

/// Looks for the crack along an edge at so many places, and then between two of them in so many halvings.
const LOOKS: usize = 8;
const HALVINGS: usize = 14;

struct Slitter<'a> {
    body: &'a CrackedBody,
    sides: Sides<'a>,
    surface: &'a TriMesh,
    out: BoneSkin,
    /// For each edge, lower vertex first: the two lips, the lower vertex's first; none where the edge is whole.
    lips: HashMap<[u32; 2], Option<[u32; 2]>>,
    /// Nodes of divided tetrahedra: an edge that stays away from them is whole.
    near_crack: Vec<bool>,
}

/// The surface of a cracked body, slit along the parting surface of `gap`.
pub fn bone_skin(
    body: &CrackedBody,
    surface: &TriMesh,
    places: &Places,
    gap: &GapSkin,
) -> BoneSkin {
    let mesh = &body.solid.mesh;
    let mut near_crack = vec![false; mesh.nodes().len()];
    for cell in body.topology.cells() {
        if body.topology.is_divided(cell.tet) {
            let nodes = mesh.tets()[cell.tet as usize];
            nodes.iter().for_each(|n| near_crack[*n as usize] = true);
        }
    }
    let mut slitter = Slitter {
        body,
        sides: Sides::new(body, gap),
        surface,
        out: BoneSkin::default(),
        lips: HashMap::new(),
        near_crack,
    };
    for (p, (tet, weights)) in surface.vertices.iter().zip(&places.tets) {
        let anchor = Anchor {
            cell: slitter.sides.cell_at(p, *tet, weights),
            weights: *weights,
        };
        slitter.out.skin.push(anchor, p);
    }
    for t in &surface.triangles {
        slitter.triangle(*t);
    }
    slitter.out
}

impl Slitter<'_> {
    fn triangle(&mut self, t: [u32; 3]) {
        let lips = [0, 1, 2].map(|k| self.lips(t[k], t[(k + 1) % 3]));
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

    /// The lips of a slit edge, that of `a` first.
    fn lips(&mut self, a: u32, b: u32) -> Option<[u32; 2]> {
        let key = [a.min(b), a.max(b)];
        let lips = match self.lips.get(&key) {
            Some(known) => *known,
            None => {
                let found = self.slit(key);
                self.lips.insert(key, found);
                found
            }
        };
        lips.map(|[low, high]| if a < b { [low, high] } else { [high, low] })
    }

    fn slit(&mut self, [a, b]: [u32; 2]) -> Option<[u32; 2]> {
        let [ca, cb] = [a, b].map(|v| self.out.skin.anchors[v as usize].cell);
        if ![ca, cb].iter().any(|c| self.is_near_crack(*c)) {
            return None;
        }
        let [pa, pb] = [a, b].map(|v| self.surface.vertices[v as usize]);
        let at = |s: f64| pa + (pb - pa) * s;
        let share = |k: usize| k as f64 / LOOKS as f64;
        let mut cells = vec![ca];
        cells.extend((1..LOOKS).map(|k| self.cell_at(&at(share(k)))));
        cells.push(cb);
        let parts = |k: &usize| !are_joined(self.body, cells[*k], cells[k + 1]);
        let first = (0..LOOKS).find(parts)?;
        let last = (0..LOOKS).rfind(parts)?;
        // Of a third piece in between nothing is shown.
        let (mut low, mut high) = ((share(first), cells[first]), share(first + 1));
        for _ in 0..HALVINGS {
            let s = 0.5 * (low.0 + high);
            let cell = self.cell_at(&at(s));
            if are_joined(self.body, low.1, cell) {
                low = (s, cell);
            } else {
                high = s;
            }
        }
        let p = at(0.5 * (low.0 + high));
        Some([low.1, cells[last + 1]].map(|cell| {
            let anchor = self.anchor_in(cell, &p);
            self.out.skin.push(anchor, &p)
        }))
    }

    fn is_near_crack(&self, cell: u32) -> bool {
        let tet = self.body.topology.cells()[cell as usize].tet;
        let nodes = self.body.solid.mesh.tets()[tet as usize];
        nodes.iter().any(|n| self.near_crack[*n as usize])
    }

    fn cell_at(&self, p: &Vec3) -> u32 {
        let (tet, weights) = tet_at(self.body, p);
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
    /// For each divided tetrahedron the parting surface in it and around it.
    around: HashMap<u32, Vec<[Vec3; 3]>>,
}

impl<'a> Sides<'a> {
    fn new(body: &'a CrackedBody, gap: &GapSkin) -> Self {
        let mesh = &body.solid.mesh;
        let around = gap.parting.keys().map(|&t| {
            let nodes = mesh.tets()[t as usize];
            let mut near: Vec<u32> = nodes
                .iter()
                .flat_map(|n| mesh.tets_of_node(*n as usize))
                .copied()
                .collect();
            near.sort_unstable();
            near.dedup();
            let triangles = near
                .iter()
                .filter_map(|t| gap.parting.get(t))
                .flatten()
                .copied();
            (t, triangles.collect())
        });
        Self {
            around: around.collect(),
            body,
        }
    }

    /// The cell of a point of a tetrahedron: that of a node that can be reached from it without crossing the surface.
    fn cell_at(&self, p: &Vec3, tet: u32, weights: &[f64; 4]) -> u32 {
        let topology = &self.body.topology;
        let Some(surface) = self.around.get(&tet) else {
            return topology.cell_at(tet, weights);
        };
        let corners = self.body.solid.mesh.corners(tet as usize);
        let is_free = |k: &usize| {
            !surface
                .iter()
                .any(|t| segment_crosses(p, &corners[*k], t).is_some())
        };
        let holds = |k: usize| {
            topology
                .cells_of(tet)
                .find(|c| topology.cells()[*c].mask >> k & 1 == 1)
        };
        let reached = (0..4).find(is_free).and_then(holds);
        reached.map_or_else(|| topology.cell_at(tet, weights), |c| c as u32)
    }
}
