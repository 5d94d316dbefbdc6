//! Triangles that move with the bone: the paper's geometric mapping (section 4.1) for what is drawn.
//!
//! A skin is made when the crack grows. From frame to frame only the cells' moved nodes change, D_T of equation 7, for each side
//! of the crack its own; a graphics device computes vertices and normals from them.
use crate::scene::{Kind, Material, Mesh, vertex_normals};
use crate::vector::{V3, add, length, scale, sub, unit};
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
    /// The way back into the bone: a unit vector, or zero.
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
            anchors,
            rest,
            parts,
        }
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

impl Wear {
    /// Towards `into`, of any length.
    pub fn new(opposite: u32, into: [f32; 3]) -> Self {
        Self {
            opposite,
            into: unit(into),
        }
    }
}
