//! What the pairs of forces hold on to.
use osteotome::surgeon::SplitLine;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::step::{Bone, FacePlace};

/// Width of what a pair of forces acts on, along the line \[mm\]: a chisel's.
const WIDTH: f64 = 6.0;
/// Its height, along the way in \[mm\].
const HEIGHT: f64 = 3.0;
/// Driven pairs stay this far behind the front \[mm\], or `CLEAR` element sizes: elements at the front do not open. They go no deeper
/// into the bone than `DEEPEST` \[mm\].
const BEHIND: f64 = 3.0;
const CLEAR: f64 = 1.2;
const DEEPEST: f64 = 25.0;
/// The crack may lie this far off the blade's plane \[mm\].
const ASIDE: f64 = 8.0;
/// A kept blade lies against either wall with this share of its face at least, or is moved along the slit, this far at a time \[mm\].
const LEAST_CONTACT: f64 = 0.25;
const STRIDE: f64 = 1.0;

/// What a pair of forces holds on to.
#[derive(Clone, Copy, PartialEq)]
enum Hold {
    /// The bottom of the slit.
    Slit,
    /// What is deepest, behind the crack's front.
    Front,
    /// What of the crack lies highest: where all that the slit's walls were has come off.
    Beyond,
}

/// How deep each face of a wall lies, and the force that pushes on it, as large as its area.
type Wall = Vec<(f64, CellForce)>;

/// A bone and the line along which it was sawn.
pub(super) struct Holds<'a> {
    bone: &'a Bone,
    line: &'a SplitLine,
    fronts: Vec<Vec3>,
}

impl<'a> Holds<'a> {
    pub(super) fn new(bone: &'a Bone, line: &'a SplitLine) -> Self {
        let front = |f: osteotome_mechanics::crack::Front| {
            let vertices = &bone.crack.sheets[f.sheet].mesh.vertices;
            let at = |v: &u32| vertices[*v as usize];
            f.vertices.iter().map(at).collect::<Vec<_>>()
        };
        Self {
            bone,
            line,
            fronts: bone.fronts().into_iter().flat_map(front).collect(),
        }
    }

    /// A pair that follows the crack's front at each station, 1 N to either side.
    pub(super) fn driven(&self, stations: [f64; 2]) -> Vec<CellForce> {
        let walls = stations.map(|s| self.walls(self.line.on_ridge(s), Hold::Front));
        let held = walls.iter().filter(|w| w.iter().all(|w| !w.is_empty()));
        held.flatten().flat_map(at_the_tip).collect()
    }

    /// Pairs at the bottom of the slit, 1 N to either side. A blade stays where it is put while both walls are there, then goes to the
    /// nearest place along the ridge where they are.
    pub(super) fn kept(&self, stations: [f64; 2]) -> Vec<CellForce> {
        let wanted = stations.map(|s| self.line.on_ridge(s));
        let in_slit = |s: f64| blade(&self.walls(s, Hold::Slit));
        let stays = wanted.iter().filter_map(|s| Some((*s, in_slit(*s)?)));
        let mut pairs: Vec<(f64, Vec<CellForce>)> = stays.collect();
        for s in wanted {
            if pairs.iter().any(|p| p.0 == s) {
                continue;
            }
            let is_free = |to: &f64| pairs.iter().all(|p| (p.0 - to).abs() >= WIDTH);
            let mut places = along(self.line.ridge(), s).filter(is_free);
            let moved = places.find_map(|to| Some((to, in_slit(to)?)));
            pairs.extend(moved);
        }
        if pairs.is_empty() {
            let beyond = |s: &f64| Some((*s, blade(&self.walls(*s, Hold::Beyond))?));
            pairs.extend(wanted.iter().filter_map(beyond));
        }
        pairs.into_iter().flat_map(|p| p.1).collect()
    }

    /// The two walls at arc length `s`: what a chisel would push on there, past chips that have come loose.
    fn walls(&self, s: f64, hold: Hold) -> [Wall; 2] {
        let bone = self.bone;
        let behind = BEHIND.max(CLEAR * bone.body.lengths.h);
        let is_behind = |p: &FacePlace| {
            let far = |f: &Vec3| (f - p.position).norm() >= behind;
            self.fronts.iter().all(far)
        };
        let (frame, slit) = (self.line.frame(s, WIDTH), self.line.mark(s).depth);
        let across = frame.rotation * Vec3::y();
        let mut walls: [Wall; 2] = Default::default();
        for (i, p) in bone.faces.places(bone).enumerate() {
            let place = frame.inverse_transform_point(&p.position.into());
            let faces = bone.faces.push_apart(i, p.area);
            let held = faces.map(|f| self.is_held(&f));
            // A loose chip's bed is the slit's new wall.
            let in_slit = place.z <= slit && (p.gap > 0.0 || held.contains(&false));
            let in_crack = place.z <= DEEPEST && is_behind(&p);
            let (is_hold, depth) = match hold {
                Hold::Slit => (in_slit, place.z),
                Hold::Front => (in_slit || in_crack, place.z),
                Hold::Beyond => (in_crack, -place.z),
            };
            let may = is_hold
                && place.x.abs() <= 0.5 * WIDTH
                && place.y.abs() <= ASIDE
                && across.dot(&p.normal).abs() > 0.5;
            for (mut face, _) in faces.into_iter().zip(held).filter(|(_, held)| may && *held) {
                let push = face.force.dot(&across);
                if hold != Hold::Front {
                    // A blade's face is flat.
                    face.force = across * push;
                }
                walls[usize::from(push > 0.0)].push((depth, face));
            }
        }
        walls
    }

    /// Whether a face hangs on one of the two ends: to push on what has come loose moves it, no more.
    fn is_held(&self, face: &CellForce) -> bool {
        let bone = self.bone;
        let pieces = &bone.fragments.of_node;
        let cell = &bone.topology.cells()[face.cell as usize];
        let own = (0..4).find(|k| cell.mask >> k & 1 == 1).unwrap_or(0);
        let piece = pieces[bone.body.mesh.tets()[cell.tet as usize][own] as usize];
        let mut ends = bone.body.ends.iter().filter_map(|e| e.first());
        ends.any(|&n| pieces[n as usize] == piece)
    }
}

/// Places on a ridge, the nearest to `s` first.
fn along([first, last]: [f64; 2], s: f64) -> impl Iterator<Item = f64> {
    let n = ((last - first) / STRIDE) as i32;
    let offsets = (1..=n).flat_map(|k| [f64::from(k), -f64::from(k)]);
    let places = offsets.map(move |k| s + k * STRIDE);
    places.filter(move |p| (first..=last).contains(p))
}

/// A blade as deep as it lies against both walls, 1 N to either side; none where it would stand on an edge.
fn blade(walls: &[Wall; 2]) -> Option<Vec<CellForce>> {
    let tip = deepest(&walls[0]).min(deepest(&walls[1]));
    let mut pair = Vec::new();
    for wall in walls {
        let below = wall.iter().filter(|f| f.0 <= tip && f.0 >= tip - HEIGHT);
        let below: Vec<CellForce> = below.map(|f| f.1).collect();
        let area: f64 = below.iter().map(|f| f.force.norm()).sum();
        if area < LEAST_CONTACT * WIDTH * HEIGHT {
            return None;
        }
        pair.extend(scaled(below, 1.0 / area));
    }
    Some(pair)
}

/// The forces that lie deepest, together 1 N.
fn at_the_tip(wall: &Wall) -> impl Iterator<Item = CellForce> {
    let deepest = deepest(wall);
    let tip = wall.iter().filter(|f| f.0 >= deepest - HEIGHT);
    let tip: Vec<CellForce> = tip.map(|f| f.1).collect();
    let area: f64 = tip.iter().map(|f| f.force.norm()).sum();
    scaled(tip, 1.0 / area)
}

fn deepest(wall: &Wall) -> f64 {
    wall.iter().map(|f| f.0).fold(f64::NEG_INFINITY, f64::max)
}

fn scaled(forces: Vec<CellForce>, by: f64) -> impl Iterator<Item = CellForce> {
    forces.into_iter().map(move |f| CellForce {
        force: f.force * by,
        ..f
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(depths: &[f64], push: f64) -> Wall {
        let face = |depth: &f64| {
            let face = CellForce {
                cell: 0,
                weights: [0.25; 4],
                force: Vec3::y() * push,
            };
            (*depth, face)
        };
        depths.iter().map(face).collect()
    }

    /// One wall has lost what lay deepest, and most of the rest: the blade lies higher on the other, pushes both ways alike, and is gone
    /// where next to nothing is left for it.
    #[test]
    fn a_blade_lies_against_both_walls_or_is_moved() {
        let whole = wall(&[0.5, 1.5, 2.5, 3.5], -4.0);
        let pair = blade(&[whole.clone(), wall(&[0.5, 1.5], 3.0)]).unwrap();
        let sum: Vec3 = pair.iter().map(|f| f.force).sum();
        let pushed: f64 = pair.iter().map(|f| f.force.norm()).sum();
        assert!(sum.norm() < 1e-12 && (pushed - 2.0).abs() < 1e-12 && pair.len() == 4);
        assert_eq!(blade(&[whole.clone(), wall(&[0.5], 3.0)]), None);
        assert_eq!(blade(&[whole, Wall::new()]), None);
    }

    #[test]
    fn a_blade_is_moved_no_farther_than_it_has_to_be() {
        let places: Vec<f64> = along([10.0, 14.0], 11.5).collect();
        assert_eq!(places, [12.5, 10.5, 13.5]);
    }
}
