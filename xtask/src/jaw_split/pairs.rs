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

/// One of the two walls: how deep each face lies, and the force that pushes on it, as large as its area.
type Side = Vec<(f64, CellForce)>;

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
        let sides = stations.map(|s| self.sides(self.line.on_ridge(s), Hold::Front));
        let held = sides.iter().filter(|[a, b]| !a.is_empty() && !b.is_empty());
        held.flatten().flat_map(|side| at_the_tip(side)).collect()
    }

    /// Pairs at the bottom of the slit, together 1 N a pair to either side. A blade stays where it is put while both walls are there,
    /// then goes to the nearest place along the ridge where they are. Both are twisted alike: they open the slit by the same width, and
    /// the one that meets more carries more.
    pub(super) fn kept(&self, stations: [f64; 2]) -> Vec<CellForce> {
        let wanted = stations.map(|s| self.line.on_ridge(s));
        let mut placed: Vec<(f64, Vec<CellForce>)> = Vec::new();
        let in_slit = |s: f64| self.blade(&self.sides(s, Hold::Slit));
        placed.extend(wanted.iter().filter_map(|s| Some((*s, in_slit(*s)?))));
        for s in wanted {
            if placed.iter().any(|p| p.0 == s) {
                continue;
            }
            let beside = |to: &f64| placed.iter().all(|p| (p.0 - to).abs() >= WIDTH);
            let mut ways = self.along_ridge(s).filter(beside);
            let moved = ways.find_map(|to| Some((to, in_slit(to)?)));
            placed.extend(moved);
        }
        if placed.is_empty() {
            let beyond = |s: &f64| self.blade(&self.sides(*s, Hold::Beyond));
            placed.extend(wanted.iter().filter_map(|s| Some((*s, beyond(s)?))));
        }
        let pairs: Vec<_> = placed.into_iter().map(|p| p.1).collect();
        let shares = shares(&self.compliance(&pairs));
        let scaled = |(pair, share): (&Vec<CellForce>, f64)| scaled(pair, share);
        pairs.iter().zip(shares).flat_map(scaled).collect()
    }

    /// Places along the ridge, the nearest to `s` first.
    fn along_ridge(&self, s: f64) -> impl Iterator<Item = f64> + use<> {
        let [first, last] = self.line.ridge();
        let n = ((last - first) / STRIDE) as i32;
        let offsets = (1..=n).flat_map(|k| [f64::from(k), -f64::from(k)]);
        let places = offsets.map(move |k| s + k * STRIDE);
        places.filter(move |p| (first..=last).contains(p))
    }

    /// The two walls at arc length `s`: what a chisel would push on there, past chips that have come loose.
    fn sides(&self, s: f64, hold: Hold) -> [Side; 2] {
        let bone = self.bone;
        let behind = BEHIND.max(CLEAR * bone.body.lengths.h);
        let is_behind = |p: &FacePlace| {
            let far = |f: &Vec3| (f - p.position).norm() >= behind;
            self.fronts.iter().all(far)
        };
        let (frame, slit) = (self.line.frame(s, WIDTH), self.line.mark(s).depth);
        let across = frame.rotation * Vec3::y();
        let mut sides: [Side; 2] = Default::default();
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
                sides[usize::from(push > 0.0)].push((depth, face));
            }
        }
        sides
    }

    /// A blade as deep as it lies against both walls, 1 N to either side; none where it would stand on an edge.
    fn blade(&self, sides: &[Side; 2]) -> Option<Vec<CellForce>> {
        let tip = sides.iter().map(|side| deepest(side)).reduce(f64::min)?;
        let mut pair = Vec::new();
        for side in sides {
            let below = side.iter().filter(|f| f.0 <= tip && f.0 >= tip - HEIGHT);
            let below: Vec<CellForce> = below.map(|f| f.1).collect();
            let area: f64 = below.iter().map(|f| f.force.norm()).sum();
            if area < LEAST_CONTACT * WIDTH * HEIGHT {
                return None;
            }
            pair.extend(scaled(&below, 1.0 / area));
        }
        Some(pair)
    }

    /// By how much 1 N at each pair opens each \[mm/N\].
    fn compliance(&self, pairs: &[Vec<CellForce>]) -> Vec<f64> {
        let columns = pairs.iter().map(|p| self.bone.sparse_loads(p));
        let half = self.bone.system.half_solve(&columns.collect::<Vec<_>>());
        half.compliance(&half)
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

/// Forces under which all pairs open alike, one on average. A pair that another opens farther than it would itself is left out.
fn shares(compliance: &[f64]) -> Vec<f64> {
    match compliance {
        [a, b, _, c] => {
            let forces = [(c - b).max(0.0), (a - b).max(0.0)];
            let all = forces[0] + forces[1];
            forces.map(|f| 2.0 * f / all).to_vec()
        }
        one => vec![1.0; one.len()],
    }
}

fn deepest(side: &Side) -> f64 {
    side.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max)
}

fn scaled(forces: &[CellForce], by: f64) -> Vec<CellForce> {
    let scaled = |f: &CellForce| CellForce {
        force: f.force * by,
        ..*f
    };
    forces.iter().map(scaled).collect()
}

/// The forces that lie deepest, together 1 N.
fn at_the_tip(side: &Side) -> Vec<CellForce> {
    let deepest = deepest(side);
    let tip = side.iter().filter(|s| s.0 >= deepest - HEIGHT);
    let tip: Vec<CellForce> = tip.map(|s| s.1).collect();
    let area: f64 = tip.iter().map(|f| f.force.norm()).sum();
    tip.iter()
        .map(|face| CellForce {
            force: face.force / area,
            ..*face
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_blades_open_the_slit_alike() {
        let opening = |c: &[f64; 4], f: &[f64]| [0, 1].map(|i| c[i] * f[0] + c[2 + i] * f[1]);
        let stiff_and_soft = [2.0, 0.5, 0.5, 8.0];
        let forces = shares(&stiff_and_soft);
        let [a, b] = opening(&stiff_and_soft, &forces);
        assert!((a - b).abs() < 1e-12 && (forces[0] + forces[1] - 2.0).abs() < 1e-12);
        assert!((forces[0] / forces[1] - 5.0).abs() < 1e-12);
        // The second alone opens the first, which hangs on it, farther than itself.
        assert_eq!(shares(&[4.0, 3.0, 3.0, 2.5]), [0.0, 2.0]);
        assert_eq!(shares(&[3.0]), [1.0]);
    }
}
