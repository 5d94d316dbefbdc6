//! How the explicit crack grows: stations advance, a strip of triangles joins the old front to the new one.
use super::criterion::Criterion;
use super::cut_edges::CutEdges;
use super::lead::Lead;
use super::stress_intensity::{Station, front_frames, front_normals};
use super::surface::{CrackSurface, Front, Sheet};
use crate::geometry::{TetLocator, TetMesh, TriMesh, Vec3};
use rustc_hash::FxHashMap;

/// Lengths of one growth step \[mm\] and its largest kink.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrowthLengths {
    /// Element size near the crack.
    pub h: f64,
    /// Largest advance of a front in one step.
    pub increment: f64,
    /// Spacing of front vertices after resampling.
    pub spacing: f64,
    /// Largest kink in one step \[rad\].
    pub max_kink: f64,
    /// What the direction maximises.
    pub criterion: Criterion,
    /// Share of the twist asked for by K_III that a front takes in one step; 0: none, as a front that nears the body's other
    /// face is not stable with it (`tests/skew_notch_growth.rs`).
    pub twist: f64,
}

impl GrowthLengths {
    /// Increment and spacing of one half to one element size, as measured to work on unstructured meshes.
    pub fn for_element_size(h: f64) -> Self {
        Self {
            h,
            increment: 0.8 * h,
            spacing: 0.5 * h,
            max_kink: 1.2,
            criterion: Criterion::EnergyRelease,
            twist: 0.0,
        }
    }

    /// How far cuts are led ahead of the front: the mechanical front lags the geometric one by this much.
    pub fn lead(&self) -> f64 {
        LEAD * self.h
    }

    /// A front that ends on another sheet ends this far beyond it, so that no pin-hole stays between them.
    pub fn overshoot(&self) -> f64 {
        0.25 * self.h
    }

    /// A front closer than this to another sheet has arrived there.
    pub fn stick(&self) -> f64 {
        0.4 * self.h
    }
}

/// The lead in element sizes.
///
/// Measured on penny cracks in body-centred meshes: with elements cut by the centre of their polygon, the effective front then
/// lies within .1 element sizes of the geometric one on average.
const LEAD: f64 = 0.52;

/// What drives a station, and where to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Largest G(theta) / G_c(theta); the crack grows where it exceeds 1.
    pub ratio: f64,
    /// The angle at which it is reached \[rad\], from q towards n.
    pub kink: f64,
}

/// The criterion at one station: magnitude from the domain integral, dependence on the angle from the stress intensity factors.
pub fn drive(station: &Station, lengths: &GrowthLengths) -> Drive {
    let straight = station.k.straight_release(station.material.poisson_ratio);
    if station.g <= 0.0 || straight <= 0.0 {
        return Drive {
            ratio: 0.0,
            kink: 0.0,
        };
    }
    let toughness = |a: f64| match &station.ahead {
        Some(ahead) => ahead.at(a),
        None => station
            .material
            .toughness(&(station.normal * a.cos() - station.advance * a.sin())),
    };
    let (kink, best) = station.k.preferred_kink(
        lengths.criterion,
        station.material.poisson_ratio,
        lengths.max_kink,
        toughness,
    );
    Drive {
        ratio: station.g * best / straight,
        kink,
    }
}

/// Averages over a hat along the front; stations that lie mostly outside the body only receive.
pub(super) fn smoothed(
    stations: &[Station],
    raw: &[Drive],
    closed: bool,
    half_width: f64,
) -> Vec<Drive> {
    let n = stations.len();
    let mut arc = vec![0.0];
    for k in 1..n {
        arc.push(arc[k - 1] + (stations[k].position - stations[k - 1].position).norm());
    }
    let round = arc[n - 1] + (stations[0].position - stations[n - 1].position).norm();
    let trusted: Vec<usize> = (0..n).filter(|&k| stations[k].is_trusted()).collect();
    let distance = |a: usize, b: usize| {
        let d = (arc[a] - arc[b]).abs();
        if closed { d.min(round - d) } else { d }
    };
    (0..n)
        .map(|k| {
            let nearest = trusted
                .iter()
                .map(|&j| distance(j, k))
                .fold(f64::INFINITY, f64::min);
            let reach = half_width.max(nearest + 0.5 * half_width);
            let (mut weight, mut ratio, mut kink, mut strength) = (0.0, 0.0, 0.0, 0.0);
            for &j in &trusted {
                let w = (1.0 - distance(j, k) / reach).max(0.0);
                weight += w;
                ratio += w * raw[j].ratio;
                // A station that is hardly driven has no say in the direction.
                kink += w * raw[j].ratio * raw[j].kink;
                strength += w * raw[j].ratio;
            }
            if weight > 0.0 && strength > 0.0 {
                Drive {
                    ratio: ratio / weight,
                    kink: kink / strength,
                }
            } else {
                Drive {
                    ratio: 0.0,
                    kink: 0.0,
                }
            }
        })
        .collect()
}

/// What a growth step needs to know of the body.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The body.
    pub mesh: &'a TetMesh,
    /// Finds its tetrahedra.
    pub locator: &'a TetLocator,
    /// Lengths of the step.
    pub lengths: GrowthLengths,
}

impl Surroundings<'_> {
    fn is_inside(&self, p: &Vec3) -> bool {
        self.locator.find(self.mesh, p).is_some()
    }

    /// How far the body's face lies ahead of a point inside, if within `reach` \[mm\].
    fn way_out(&self, p: &Vec3, direction: &Vec3, reach: f64) -> Option<f64> {
        const STEPS: u32 = 12;
        let at = |k: u32| reach * f64::from(k) / f64::from(STEPS);
        (1..=STEPS)
            .map(at)
            .find(|d| !self.is_inside(&(p + direction * *d)))
    }

    /// How far cuts run ahead of a front vertex: the lead, but never through more than half of what is left of the bone, and
    /// only just beyond another sheet.
    pub fn lead(&self, crack: &CrackSurface, sheet: usize, p: &Vec3, direction: &Vec3) -> f64 {
        const STEPS: usize = 16;
        let lead = self.lengths.lead();
        let mut lead_here = lead;
        if self.is_inside(p) {
            let left = (1..=STEPS)
                .map(|k| 2.0 * lead * k as f64 / STEPS as f64)
                .find(|d| !self.is_inside(&(p + direction * *d)));
            lead_here = left.map_or(lead, |d| lead.min(0.5 * d));
        }
        let met = crack.first_crossing_of_other(sheet, p, &(p + direction * lead));
        met.map_or(lead_here, |s| {
            lead_here.min(s * lead + self.lengths.overshoot())
        })
    }

    /// What is to be cut ahead of a front.
    pub fn lead_ahead(
        &self,
        crack: &CrackSurface,
        sheet: usize,
        front: &[Vec3],
        directions: &[Vec3],
    ) -> Lead {
        let along = front.iter().zip(directions);
        let lengths: Vec<f64> = along.map(|(p, d)| self.lead(crack, sheet, p, d)).collect();
        Lead::new(front, directions, &lengths, self.lengths.h)
    }
}

impl Surroundings<'_> {
    /// What the sheets cut, and what is cut ahead of their fronts; the sheets remember their leads.
    pub fn first_cuts(&self, crack: &mut CrackSurface, chip_nodes: usize) -> CutEdges {
        let (mesh, locator) = (self.mesh, self.locator);
        let fronts = crack.fronts(mesh, locator, self.lengths.stick());
        let lead = |front: &Front| {
            let (points, advances) =
                front_frames(&crack.sheets[front.sheet], front, self.lengths.h);
            (
                front.sheet,
                self.lead_ahead(crack, front.sheet, &points, &advances),
            )
        };
        let leads: Vec<_> = fronts.iter().map(lead).collect();
        let mut cuts = CutEdges::new(mesh);
        for sheet in &crack.sheets {
            cuts.seat_nodes(mesh, locator, &sheet.mesh);
        }
        for (_, lead) in &leads {
            lead.seat(&mut cuts, mesh, locator);
        }
        for sheet in &crack.sheets {
            cuts.cut(mesh, locator, &sheet.mesh, chip_nodes);
        }
        for (sheet, lead) in leads {
            lead.cut(&mut cuts, mesh, locator, chip_nodes);
            crack.sheets[sheet].lead.append(&lead.mesh);
        }
        cuts
    }
}

/// One strip that was grown.
#[derive(Clone, Debug, Default)]
pub struct Strip {
    /// The new triangles.
    pub grown: TriMesh,
    /// What is to be cut ahead of them.
    pub lead: Lead,
    /// Index of the first new triangle of the sheet.
    pub first_triangle: usize,
}

impl Strip {
    /// Cuts the body along the strip and ahead of it; returns the edges newly cut.
    pub fn cut(
        &self,
        cuts: &mut CutEdges,
        mesh: &TetMesh,
        locator: &TetLocator,
        chip_nodes: usize,
    ) -> Vec<u32> {
        self.lead.seat(cuts, mesh, locator);
        let mut fresh = cuts.cut(mesh, locator, &self.grown, chip_nodes);
        fresh.extend(self.lead.cut(cuts, mesh, locator, chip_nodes));
        fresh.sort_unstable();
        fresh
    }
}

/// Advances a front by `moves`, one a vertex; the sheet gains a strip for each run of moving vertices.
///
/// A strip with a folded or flat triangle is not taken: moves around it are evened out and shortened, in the end withheld, until
/// the strip is sound.
pub fn grow(
    crack: &mut CrackSurface,
    front: &Front,
    moves: &[Vec3],
    around: &Surroundings,
) -> Strip {
    const GENTLE: usize = 3;
    const ATTEMPTS: usize = 7;
    let sheet = &crack.sheets[front.sheet];
    let first_triangle = sheet.mesh.triangles.len();
    let normals = front_normals(sheet, front, around.lengths.h);
    let mut moves = moves.to_vec();
    for attempt in 0..ATTEMPTS {
        let trial = advanced(crack, front, &moves, around);
        let unsound = trial.unsound(front, &normals, around.lengths.h);
        if unsound.is_empty() {
            crack.sheets[front.sheet] = trial.sheet;
            return Strip {
                grown: trial.grown,
                lead: trial.lead,
                first_triangle,
            };
        }
        moves = eased(&moves, &unsound, front.closed, attempt >= GENTLE);
    }
    Strip {
        first_triangle,
        ..Default::default()
    }
}

/// A strip on trial.
struct Trial {
    sheet: Sheet,
    grown: TriMesh,
    lead: Lead,
    first_triangle: usize,
}

fn advanced(crack: &CrackSurface, front: &Front, moves: &[Vec3], around: &Surroundings) -> Trial {
    let sheet = crack.sheets[front.sheet].clone();
    let first_triangle = sheet.mesh.triangles.len();
    let mut trial = Trial {
        sheet,
        grown: TriMesh::default(),
        lead: Lead::default(),
        first_triangle,
    };
    for run in runs(front, moves, around.lengths.spacing * 0.05) {
        let target = new_front(crack, front, &run, moves, around);
        if target.points.len() < 2 {
            continue;
        }
        let new = append(&mut trial.sheet, &target);
        zip(&mut trial.sheet.mesh, &run.vertices, &new);
        trial.lead.append(&around.lead_ahead(
            crack,
            front.sheet,
            &target.points,
            &target.directions,
        ));
    }
    let mesh = &trial.sheet.mesh;
    for t in first_triangle..mesh.triangles.len() {
        push_triangle(&mut trial.grown, mesh.corners(t));
    }
    trial
}

impl Trial {
    /// Places in the old front near which a new triangle is flat, looks backwards, or folds onto its neighbour.
    fn unsound(&self, front: &Front, normals: &[Vec3], h: f64) -> Vec<usize> {
        /// Cosines of the sharpest angle with the front's normal, and between neighbours.
        const FORWARD: f64 = 0.1;
        const OPEN: f64 = 0.0;
        /// Least height of a triangle over its longest edge.
        const SLIMMEST: f64 = 0.02;
        let mesh = &self.sheet.mesh;
        let at = |v: u32| mesh.vertices[v as usize];
        let place = |t: usize| {
            let centre = mesh.corners(t).iter().sum::<Vec3>() / 3.0;
            let distance = |k: &usize| (at(front.vertices[*k]) - centre).norm();
            (0..front.vertices.len())
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap_or(0)
        };
        let mut beside: FxHashMap<[u32; 2], usize> = FxHashMap::default();
        let mut found = Vec::new();
        for (t, [a, b, c]) in mesh.triangles.iter().enumerate() {
            for edge in [[*a, *b], [*b, *c], [*c, *a]] {
                if beside.insert(edge, t).is_some() {
                    found.push(place(t));
                }
            }
        }
        for t in self.first_triangle..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let longest = (0..3)
                .map(|k| (corners[k] - corners[(k + 1) % 3]).norm())
                .fold(0.0, f64::max);
            let area = mesh.area_normal(t);
            let near = place(t);
            let flat = area.norm() < SLIMMEST * longest * longest || area.norm() < 1e-4 * h * h;
            let backwards = area.dot(&normals[near]) < FORWARD * area.norm();
            let tri = mesh.triangles[t];
            let folds = (0..3).any(|k| {
                let other = beside.get(&[tri[(k + 1) % 3], tri[k]]);
                other.is_some_and(|o| {
                    let n = mesh.area_normal(*o);
                    n.dot(&area) < OPEN * n.norm() * area.norm()
                })
            });
            if flat || backwards || folds {
                found.push(near);
            }
        }
        found
    }
}

/// Moves evened out and shortened around some places, or withheld there.
fn eased(moves: &[Vec3], places: &[usize], closed: bool, withheld: bool) -> Vec<Vec3> {
    const REACH: usize = 2;
    let n = moves.len();
    let near = |k: usize| {
        places.iter().any(|&p| {
            let d = p.abs_diff(k);
            d <= REACH || (closed && n - d <= REACH)
        })
    };
    let at = |k: usize, step: isize| {
        let j = k as isize + step;
        let j = if closed {
            j.rem_euclid(n as isize)
        } else {
            j.clamp(0, n as isize - 1)
        };
        moves[j as usize]
    };
    (0..n)
        .map(|k| match (near(k), withheld) {
            (false, _) => moves[k],
            (true, true) => Vec3::zeros(),
            (true, false) => (at(k, -1) + moves[k] * 2.0 + at(k, 1)) * (0.25 * 0.6),
        })
        .collect()
}

fn push_triangle(mesh: &mut TriMesh, corners: [Vec3; 3]) {
    let n = mesh.vertices.len() as u32;
    mesh.vertices.extend(corners);
    mesh.triangles.push([n, n + 1, n + 2]);
}

/// Consecutive vertices of which all but pinned ends move.
struct Run {
    /// Places in the front.
    places: Vec<usize>,
    vertices: Vec<u32>,
    pinned: [bool; 2],
}

fn runs(front: &Front, moves: &[Vec3], least: f64) -> Vec<Run> {
    let n = front.vertices.len();
    let is_moving = |k: usize| moves[k].norm() > least;
    let make = |places: Vec<usize>, pinned: [bool; 2]| Run {
        vertices: places.iter().map(|&k| front.vertices[k]).collect(),
        places,
        pinned,
    };
    if front.closed && (0..n).all(is_moving) {
        return vec![make((0..=n).map(|k| k % n).collect(), [false; 2])];
    }
    // A closed front that rests somewhere is walked from a resting vertex.
    let start = if front.closed {
        (0..n).find(|&k| !is_moving(k)).unwrap_or(0)
    } else {
        0
    };
    let walk: Vec<usize> = (0..if front.closed { n + 1 } else { n })
        .map(|k| (start + k) % n)
        .collect();
    let mut found = Vec::new();
    let mut k = 0;
    while k < walk.len() {
        if !is_moving(walk[k]) {
            k += 1;
            continue;
        }
        let from = k;
        while k < walk.len() && is_moving(walk[k]) {
            k += 1;
        }
        let (lo, hi) = (from.saturating_sub(1), k.min(walk.len() - 1));
        found.push(make(walk[lo..=hi].to_vec(), [from > 0, k < walk.len()]));
    }
    found
}

/// The new front line of a run: smoothed, its free ends brought to the body's face or to another sheet, resampled.
struct Target {
    points: Vec<Vec3>,
    directions: Vec<Vec3>,
    kept_ends: [Option<u32>; 2],
    closed: bool,
}

fn new_front(
    crack: &CrackSurface,
    front: &Front,
    run: &Run,
    moves: &[Vec3],
    around: &Surroundings,
) -> Target {
    let sheet = &crack.sheets[front.sheet];
    let mut line: Vec<(Vec3, Vec3)> = run
        .places
        .iter()
        .map(|&k| {
            let p = sheet.mesh.vertices[front.vertices[k] as usize];
            (p, moves[k])
        })
        .map(|(p, m)| {
            // A vertex that would run through another sheet stops just beyond it.
            let met = crack.first_crossing_of_other(front.sheet, &p, &(p + m));
            let step = met.map_or(1.0, |s| {
                (s + around.lengths.overshoot() / m.norm().max(1e-9)).min(1.0)
            });
            (p + m * step, m.try_normalize(1e-9).unwrap_or_default())
        })
        .collect();
    let closed = front.closed
        && run.pinned == [false; 2]
        && run.places.first() == run.places.last()
        && run.places.len() > 2;
    let pinned = if closed { [true; 2] } else { run.pinned };
    smooth(&mut line, 2);
    if !closed {
        if !pinned[1] {
            finish_end(crack, front.sheet, &mut line, around);
        }
        if !pinned[0] {
            line.reverse();
            finish_end(crack, front.sheet, &mut line, around);
            line.reverse();
        }
    }
    let fewest = if pinned == [true; 2] { 2 } else { 1 };
    let line = resample(&line, around.lengths.spacing, fewest);
    let end = |side: usize| {
        let v = if side == 0 {
            run.vertices.first()
        } else {
            run.vertices.last()
        };
        (pinned[side] && !closed).then_some(()).and(v.copied())
    };
    Target {
        kept_ends: [end(0), end(1)],
        directions: line.iter().map(|l| l.1).collect(),
        points: line.into_iter().map(|l| l.0).collect(),
        closed,
    }
}

/// Laplacian passes over the inner points; ends stay.
fn smooth(line: &mut [(Vec3, Vec3)], passes: usize) {
    for _ in 0..passes {
        let old = line.to_vec();
        for k in 1..line.len().saturating_sub(1) {
            line[k].0 = old[k].0 * 0.5 + (old[k - 1].0 + old[k + 1].0) * 0.25;
        }
    }
}

/// Leads a line that ended on another sheet on to the body's face if that is near: in the corner between the two no pin-hole
/// may stay.
fn leave_corner(line: &mut Vec<(Vec3, Vec3)>, around: &Surroundings) {
    let h = around.lengths.h;
    let (end, direction) = line[line.len() - 1];
    let before = line[line.len().saturating_sub(3)].0;
    let onward = (end - before).try_normalize(1e-9);
    let Some(onward) = onward.filter(|_| around.is_inside(&end)) else {
        return;
    };
    if let Some(length) = around.way_out(&end, &onward, 0.6 * h) {
        line.push((end + onward * (length + 0.4 * h), direction));
    }
}

/// Brings the last end of a line to the body's face or just beyond another sheet.
///
/// The line is cut where it first crosses another sheet or has been outside the body for some length. If it ends inside, it is
/// led on along its last direction where a face or a sheet is within reach; otherwise it stays a free end.
fn finish_end(
    crack: &CrackSurface,
    sheet: usize,
    line: &mut Vec<(Vec3, Vec3)>,
    around: &Surroundings,
) {
    let lengths = &around.lengths;
    let margin = 0.6 * lengths.h;
    let last_inside = (0..line.len())
        .rev()
        .find(|&k| around.is_inside(&line[k].0));
    let mut outside = 0.0;
    for k in (line.len() / 2).max(1)..line.len() {
        let (a, b) = (line[k - 1].0, line[k].0);
        let length = (b - a).norm();
        if let Some(s) = crack.first_crossing_of_other(sheet, &a, &b) {
            let end =
                a + (b - a) * (s + lengths.overshoot() / length.max(1e-9)).min(1.0_f64.max(s));
            line[k].0 = end;
            line.truncate(k + 1);
            leave_corner(line, around);
            return;
        }
        outside += if last_inside.is_some_and(|i| k > i) {
            length
        } else {
            0.0
        };
        if outside > margin {
            line.truncate(k + 1);
            return;
        }
    }
    let (end, direction) = line[line.len() - 1];
    let before = line[line.len().saturating_sub(3)].0;
    let Some(onward) = (end - before).try_normalize(1e-9) else {
        return;
    };
    if crack.touches_other(sheet, &end, lengths.overshoot()) {
        leave_corner(line, around);
        return;
    }
    if !around.is_inside(&end) {
        return;
    }
    let reach = 1.2 * lengths.h;
    let met = crack
        .first_crossing_of_other(sheet, &end, &(end + onward * reach))
        .map(|s| s * reach);
    let left = around.way_out(&end, &onward, reach);
    let length = match (met, left) {
        (Some(m), Some(l)) if m < l => m + lengths.overshoot(),
        (_, Some(l)) => l + 0.4 * lengths.h,
        (Some(m), None) => m + lengths.overshoot(),
        (None, None) => return,
    };
    line.push((end + onward * length, direction));
}

fn resample(line: &[(Vec3, Vec3)], spacing: f64, fewest: usize) -> Vec<(Vec3, Vec3)> {
    let mut arc = vec![0.0];
    for k in 1..line.len() {
        arc.push(arc[k - 1] + (line[k].0 - line[k - 1].0).norm());
    }
    let total = arc[arc.len() - 1];
    let n = ((total / spacing).round() as usize).max(fewest);
    (0..=n)
        .map(|i| {
            let s = total * i as f64 / n as f64;
            let k = arc.partition_point(|a| *a < s).clamp(1, line.len() - 1);
            let w = ((s - arc[k - 1]) / (arc[k] - arc[k - 1]).max(1e-12)).clamp(0.0, 1.0);
            let mix = |a: Vec3, b: Vec3| a * (1.0 - w) + b * w;
            let direction = mix(line[k - 1].1, line[k].1)
                .try_normalize(1e-9)
                .unwrap_or_default();
            (mix(line[k - 1].0, line[k].0), direction)
        })
        .collect()
}

/// Adds the new front's vertices to the sheet; pinned ends are those of the old front.
fn append(sheet: &mut Sheet, target: &Target) -> Vec<u32> {
    let n = target.points.len();
    let mut ids = Vec::with_capacity(n);
    for (k, p) in target.points.iter().enumerate() {
        let kept = if k == 0 {
            target.kept_ends[0]
        } else if k + 1 == n {
            target.kept_ends[1]
        } else {
            None
        };
        let id = if target.closed && k + 1 == n {
            ids[0]
        } else {
            kept.unwrap_or_else(|| {
                sheet.mesh.vertices.push(*p);
                sheet.kerf.push(0.0);
                sheet.mesh.vertices.len() as u32 - 1
            })
        };
        ids.push(id);
    }
    ids
}

/// Fills the strip between two lines with triangles, always taking the shorter of the two diagonals.
fn zip(mesh: &mut TriMesh, old: &[u32], new: &[u32]) {
    let (mut i, mut j) = (0, 0);
    while i + 1 < old.len() || j + 1 < new.len() {
        let at = |v: u32| mesh.vertices[v as usize];
        let take_new = if i + 1 == old.len() {
            true
        } else if j + 1 == new.len() {
            false
        } else {
            (at(old[i]) - at(new[j + 1])).norm() <= (at(old[i + 1]) - at(new[j])).norm()
        };
        let triangle = if take_new {
            [old[i], new[j], new[j + 1]]
        } else {
            [old[i], new[j], old[i + 1]]
        };
        if take_new {
            j += 1;
        } else {
            i += 1;
        }
        let [a, b, c] = triangle;
        if a != b && b != c && c != a {
            mesh.triangles.push(triangle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crack::LinePoint;
    use crate::geometry::block_mesh;

    fn notch() -> (TetMesh, CrackSurface) {
        let mesh = block_mesh(Vec3::zeros(), Vec3::new(10.0, 8.0, 6.0), [10, 8, 6]);
        let at = |y: f64| LinePoint {
            at: Vec3::new(0.0, y, 3.1),
            toward: Vec3::x(),
            depth: 3.0,
        };
        let line: Vec<_> = (0..9).map(|k| at(f64::from(k))).collect();
        (
            mesh,
            CrackSurface {
                sheets: vec![Sheet::ribbon("notch", &line, 0.5, 1.0, 1.0)],
            },
        )
    }

    #[test]
    fn a_front_advances_without_folding() {
        let (mesh, mut crack) = notch();
        let locator = TetLocator::new(&mesh);
        let lengths = GrowthLengths::for_element_size(1.3);
        let around = Surroundings {
            mesh: &mesh,
            locator: &locator,
            lengths,
        };
        for step in 0..4 {
            let fronts = crack.fronts(&mesh, &locator, lengths.stick());
            assert_eq!(fronts.len(), 1, "step {step}");
            let n = fronts[0].vertices.len();
            let moves: Vec<_> = (0..n)
                .map(|k| Vec3::new(1.0 + 0.3 * (k as f64).sin(), 0.0, 0.1))
                .collect();
            let before = crack.sheets[0].mesh.area();
            let strip = grow(&mut crack, &fronts[0], &moves, &around);
            let mesh = &crack.sheets[0].mesh;
            let gain = mesh.area() - before;
            assert!((6.0..14.0).contains(&gain), "step {step} gained {gain} mm2");
            for t in strip.first_triangle..mesh.triangles.len() {
                let n = mesh.area_normal(t);
                assert!(
                    n.z > 0.9 * n.norm() && n.norm() > 1e-3,
                    "step {step}: folded or flat triangle"
                );
            }
            // Manifold: no directed edge is used twice.
            let mut edges: Vec<_> = mesh
                .triangles
                .iter()
                .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
                .collect();
            edges.sort_unstable();
            assert!(
                edges.windows(2).all(|w| w[0] != w[1]),
                "step {step}: edge used twice"
            );
        }
    }

    #[test]
    fn a_front_that_left_the_body_is_gone() {
        let (mesh, mut crack) = notch();
        let locator = TetLocator::new(&mesh);
        let lengths = GrowthLengths::for_element_size(1.3);
        let around = Surroundings {
            mesh: &mesh,
            locator: &locator,
            lengths,
        };
        let front = crack.fronts(&mesh, &locator, lengths.stick()).remove(0);
        grow(
            &mut crack,
            &front,
            &vec![Vec3::x() * 8.0; front.vertices.len()],
            &around,
        );
        assert!(crack.fronts(&mesh, &locator, lengths.stick()).is_empty());
    }

    #[test]
    fn a_resting_part_is_pinned() {
        let (mesh, mut crack) = notch();
        let locator = TetLocator::new(&mesh);
        let lengths = GrowthLengths::for_element_size(1.3);
        let around = Surroundings {
            mesh: &mesh,
            locator: &locator,
            lengths,
        };
        let front = crack.fronts(&mesh, &locator, lengths.stick()).remove(0);
        let n = front.vertices.len();
        let moves: Vec<_> = (0..n)
            .map(|k| if k < n / 2 { Vec3::x() } else { Vec3::zeros() })
            .collect();
        let before = crack.sheets[0].mesh.area();
        grow(&mut crack, &front, &moves, &around);
        assert!(crack.sheets[0].mesh.area() > before + 2.0);
        assert_eq!(crack.fronts(&mesh, &locator, lengths.stick()).len(), 1);
    }
}
