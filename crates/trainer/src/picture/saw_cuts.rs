//! Where the saw has been, for what is drawn.
//!
//! Mechanics parts the bone along polygons between cut edges, which leave the saw's own surface wherever the saw ends within a
//! tetrahedron or several cuts meet in one. Flakes of bone would show there between the slit and the opened crack, so what lies
//! along the saw's cut is drawn on it.
use super::anchored::sawn_part;
use osteotome_mechanics::crack::{CrackedBody, Sheet};
use osteotome_mechanics::geometry::{Aabb, SignedDistance, Vec3};

/// An edge that the saw's cut crosses this near to where it is parted \[element sizes\] was parted by it.
const ON: f64 = 0.15;
/// Points are moved so far onto it \[element sizes\].
const REACH: f64 = 0.35;
/// Points are moved onto several cuts in so many rounds.
const ROUNDS: usize = 6;

/// All of the saw's cuts.
pub struct SawCuts {
    cuts: Vec<Cut>,
    h: f64,
}

struct Cut {
    sheet: Sheet,
    /// Out of it all is far.
    bounds: Aabb,
    /// Its border within the bone.
    bottom: Vec<[Vec3; 2]>,
}

impl SawCuts {
    /// Of a body whose true shape is `region`.
    pub fn new(body: &CrackedBody, region: &dyn SignedDistance) -> Self {
        let h = body.solid.lengths.h;
        let cut = |sheet: &Sheet| {
            let sheet = Sheet {
                mesh: sawn_part(sheet),
                ..Sheet::default()
            };
            let at = |e: [u32; 2]| e.map(|v| sheet.mesh.vertices[v as usize]);
            let border = sheet.mesh.border_edges().into_iter().map(at);
            let is_within = |e: &[Vec3; 2]| e.iter().any(|p| region.signed(p) <= 0.0);
            let bottom = border.filter(is_within).collect();
            Cut {
                bounds: Aabb::around(&sheet.mesh.vertices).grown(REACH * h),
                sheet,
                bottom,
            }
        };
        Self {
            cuts: body.crack.sheets.iter().map(cut).collect(),
            h,
        }
    }

    /// The cuts that have parted an edge from `a` to `b` at `p`, one bit each.
    pub fn through(&self, [a, b]: [Vec3; 2], p: &Vec3) -> u64 {
        let is_crossed = |c: &(usize, &Cut)| {
            let at = (c.1.bounds.contains(p)).then(|| c.1.sheet.first_crossing(&a, &b));
            at.flatten()
                .is_some_and(|s| (a + (b - a) * s - p).norm() < ON * self.h)
        };
        let cuts = self.cuts.iter().enumerate().take(64);
        cuts.filter(is_crossed).map(|c| 1 << c.0).sum()
    }

    /// The point nearest to `p`, or nearly so, that is on all the cuts in `on`; `None` if it is far.
    pub fn seat(&self, p: &Vec3, on: u64) -> Option<Vec3> {
        let mut at = *p;
        let rounds = if on.count_ones() > 1 { ROUNDS } else { 1 };
        for cut in (0..rounds).flat_map(|_| self.chosen(on)) {
            at = cut.foot(&at)?;
        }
        (on != 0 && (at - p).norm() < REACH * self.h).then_some(at)
    }

    /// The way out of the bone at a point of the cuts in `on`, within them; `out` is square to the bone's surface.
    pub fn way_out(&self, p: &Vec3, on: u64, out: &Vec3) -> Option<Vec3> {
        let mut normals = self.chosen(on).filter_map(|c| c.normal(p));
        let first = normals.next()?;
        let way = match normals.next() {
            Some(second) => {
                let line = first.cross(&second);
                line * line.dot(out)
            }
            None => out - first * first.dot(out),
        };
        way.try_normalize(1e-6)
    }

    /// How far a point is from where the saw has come to a stop \[mm\]; below zero beyond it.
    pub fn depth(&self, p: &Vec3) -> f64 {
        let of_cut = |c: &Cut| {
            let foot = c.foot(p)?;
            let off = (foot - p).norm();
            let behind = nearest(&foot, &c.bottom).map_or(self.h, |q| (q - foot).norm());
            let is_beyond = behind < 1e-9 || off > REACH * self.h;
            Some(if is_beyond { -off } else { behind })
        };
        let near = self.cuts.iter().filter(|c| c.bounds.contains(p));
        near.filter_map(of_cut).fold(-self.h, f64::max)
    }

    /// The point nearest to `p` at which the saw came to a stop; `None` if there is none near.
    pub fn stop(&self, p: &Vec3) -> Option<Vec3> {
        let near = self.cuts.iter().filter(|c| c.bounds.contains(p));
        let feet = near.filter_map(|c| nearest(p, &c.bottom));
        let foot = feet.min_by(|a, b| (a - p).norm().total_cmp(&(b - p).norm()));
        foot.filter(|q| (q - p).norm() < ON * self.h)
    }

    fn chosen(&self, on: u64) -> impl Iterator<Item = &Cut> {
        let cuts = self.cuts.iter().enumerate().take(64);
        cuts.filter(move |c| on >> c.0 & 1 == 1).map(|c| c.1)
    }
}

impl Cut {
    fn normal(&self, p: &Vec3) -> Option<Vec3> {
        let (_, t, _) = self.sheet.closest(p)?;
        self.sheet.mesh.area_normal(t).try_normalize(1e-12)
    }

    fn foot(&self, p: &Vec3) -> Option<Vec3> {
        let (_, t, w) = self.sheet.closest(p)?;
        let corners = self.sheet.mesh.corners(t);
        Some((0..3).map(|k| corners[k] * w[k]).sum())
    }
}

/// The nearest point of some edges.
fn nearest(p: &Vec3, edges: &[[Vec3; 2]]) -> Option<Vec3> {
    let foot = |[a, b]: &[Vec3; 2]| {
        let way = b - a;
        let share = (p - a).dot(&way) / way.norm_squared().max(1e-12);
        a + way * share.clamp(0.0, 1.0)
    };
    let feet = edges.iter().map(foot);
    feet.min_by(|a, b| (a - p).norm().total_cmp(&(b - p).norm()))
}
