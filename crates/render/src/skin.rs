//! Triangles that move with the bone: the paper's geometric mapping (section 4.1) for what is drawn.
//!
//! A skin is made when the crack grows. From frame to frame only the cells' moved nodes change, D_T of equation 7, for each side
//! of the crack its own; a graphics device computes vertices and normals from them.
use crate::scene::{Kind, Material, Mesh, vertex_normals};
use crate::vector::{V3, add, length, scale, sub};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// A cell's four moved nodes \[mm\].
pub type MovedCell = [[f32; 3]; 4];

/// A vertex' place in the bone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Its cell: a tetrahedron, on one side of the crack.
    pub cell: u32,
    /// The shape functions there; they add up to one.
    pub weights: [f32; 4],
    /// For a face of the crack.
    pub wear: Option<Wear>,
}

/// What a crack's face loses where both faces have moved against each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wear {
    /// The vertex opposite.
    pub opposite: u32,
    /// The way back into the bone: 1 long, or shorter where less is lost.
    pub into: [f32; 3],
}

/// Faces that have moved far against each other have lost this much bone each \[mm\]: crumbs, and the misfit of lips and walls
/// that would else hang as threads between them. Reached where they have moved by [`WORN`] \[mm\].
pub const CRUMBS: f32 = 0.4;
/// See [`CRUMBS`].
pub const WORN: f32 = 2.0;

/// Triangles of a skin with one meaning and one look.
#[derive(Clone, Debug)]
pub struct Part {
    /// Meaning.
    pub kind: Kind,
    /// Look.
    pub material: Material,
    /// Whether normals are those of the vertices, over all smooth parts of the skin; else triangles are flat.
    pub is_smooth: bool,
    /// Counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh whose vertices move with cells.
#[derive(Debug)]
pub struct Skin {
    /// Its own: a device that has it need not be given it again.
    number: u64,
    anchors: Vec<Anchor>,
    rest: Vec<[f32; 3]>,
    parts: Vec<Part>,
    is_closed: bool,
    beyond: f32,
}

/// A skin's vertices at one moment.
pub struct Moved {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
}

impl Skin {
    /// With a place and an undeformed position \[mm\] for each vertex.
    pub fn new(anchors: Vec<Anchor>, rest: Vec<[f32; 3]>, parts: Vec<Part>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        assert_eq!(anchors.len(), rest.len(), "a place for each vertex");
        Self {
            number: NEXT.fetch_add(1, Ordering::Relaxed),
            is_closed: is_bone_closed(&parts),
            beyond: anchors.iter().map(beyond).fold(0.0, f32::max),
            anchors,
            rest,
            parts,
        }
    }

    #[cfg(feature = "gpu")]
    /// Whether its bone, with its seams, is a closed surface; a skin without bone is.
    pub(crate) fn is_closed(&self) -> bool {
        self.is_closed
    }

    #[cfg(feature = "gpu")]
    /// By how much of a cell's extent vertices may lie outside of their cells.
    pub(crate) fn beyond(&self) -> f32 {
        self.beyond
    }

    pub(crate) fn number(&self) -> u64 {
        self.number
    }

    pub(crate) fn anchors(&self) -> &[Anchor] {
        &self.anchors
    }

    pub(crate) fn rest(&self) -> &[[f32; 3]] {
        &self.rest
    }

    /// Its meshes, in this order before the scene's own.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The triangles whose normals its vertices have.
    pub(crate) fn smooth(&self) -> impl Iterator<Item = &[u32; 3]> {
        let smooth = self.parts.iter().filter(|p| p.is_smooth);
        smooth.flat_map(|p| &p.triangles)
    }

    /// Where the vertices are \[mm\].
    pub fn positions(&self, cells: &[MovedCell]) -> Vec<[f32; 3]> {
        let carried = |a: &Anchor| {
            let nodes = cells[a.cell as usize];
            (0..4).fold([0.0; 3], |sum, k| add(sum, scale(nodes[k], a.weights[k])))
        };
        let at = |a: &Anchor| -> V3 {
            let p = carried(a);
            let Some(wear) = a.wear else { return p };
            let way = length(sub(p, carried(&self.anchors[wear.opposite as usize])));
            add(p, scale(wear.into, CRUMBS * (way / WORN).min(1.0)))
        };
        self.anchors.par_iter().map(at).collect()
    }

    pub(crate) fn moved(&self, cells: &[MovedCell]) -> Moved {
        let positions = self.positions(cells);
        let smooth: Vec<[u32; 3]> = self.smooth().copied().collect();
        Moved {
            normals: if smooth.is_empty() {
                Vec::new()
            } else {
                vertex_normals(&positions, &smooth)
            },
            positions,
        }
    }

    pub(crate) fn meshes<'a>(&'a self, moved: &'a Moved) -> impl Iterator<Item = Mesh<'a>> {
        self.parts.iter().map(|p| Mesh {
            kind: p.kind,
            material: p.material,
            positions: &moved.positions,
            rest: &self.rest,
            normals: if p.is_smooth { &moved.normals } else { &[] },
            triangles: &p.triangles,
        })
    }
}

/// A vertex is the mean of nodes by its weights above zero, and as far from there as those below zero carry it.
fn beyond(anchor: &Anchor) -> f32 {
    -anchor.weights.iter().map(|w| w.min(0.0)).sum::<f32>()
}

/// Whether each edge of bone and seams is run through as often one way as the other.
fn is_bone_closed(parts: &[Part]) -> bool {
    let bone = parts
        .iter()
        .filter(|p| matches!(p.kind, Kind::Bone | Kind::Seam));
    let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let mut edges: Vec<[u32; 2]> = bone.flat_map(|p| &p.triangles).flat_map(edges).collect();
    edges.sort_unstable_by_key(|[a, b]| [*a.min(b), *a.max(b)]);
    let way = |[a, b]: &[u32; 2]| if a < b { 1 } else { -1 };
    let same = |a: &[u32; 2], b: &[u32; 2]| a.iter().all(|v| b.contains(v));
    edges
        .chunk_by(same)
        .all(|e| e.iter().map(way).sum::<i32>() == 0)
}

#[cfg(feature = "gpu")]
/// A box that holds a body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub low: V3,
    pub high: V3,
}

#[cfg(feature = "gpu")]
impl Bounds {
    /// Of vertices that lie outside of these cells by at most so much of a cell's extent.
    pub fn of(cells: &[MovedCell], beyond: f32) -> Self {
        let [mut low, mut high, mut extent] =
            [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3], [0.0f32; 3]];
        for [a, b, c, d] in cells {
            for k in 0..3 {
                let least = a[k].min(b[k]).min(c[k].min(d[k]));
                let most = a[k].max(b[k]).max(c[k].max(d[k]));
                low[k] = low[k].min(least);
                high[k] = high[k].max(most);
                extent[k] = extent[k].max(most - least);
            }
        }
        let room = extent.map(|e| beyond * e + CRUMBS);
        Self {
            low: sub(low, room),
            high: add(high, room),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_that_have_parted_lose_as_much_as_they_may() {
        let at = |cell, opposite, into| Anchor {
            cell,
            weights: [1.0, 0.0, 0.0, 0.0],
            wear: Some(Wear { opposite, into }),
        };
        // Of the second there is little.
        let anchors = vec![at(0, 1, [0.0, 0.0, -1.0]), at(1, 0, [0.0, 0.0, 0.25])];
        let skin = Skin::new(anchors, vec![[0.0; 3]; 2], vec![]);
        let heights = |apart: f32| {
            let at = skin.positions(&[[[0.0; 3]; 4], [[0.0, 0.0, apart]; 4]]);
            at.iter().map(|p| p[2]).collect::<Vec<_>>()
        };
        assert_eq!(heights(0.0), [0.0, 0.0]);
        assert_eq!(heights(WORN), [-CRUMBS, WORN + 0.25 * CRUMBS]);
        assert_eq!(heights(2.0 * WORN), [-CRUMBS, 2.0 * WORN + 0.25 * CRUMBS]);
        assert_eq!(heights(0.5 * WORN)[0], -0.5 * CRUMBS);
    }
}
