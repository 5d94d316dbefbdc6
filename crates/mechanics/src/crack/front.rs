//! A crack front as a curve with frames: what lies where along it, ahead of it and above it.
use super::cut_polygon::face_pieces;
use super::stress_intensity::Fields;
use super::surface::{Front, Sheet};
use crate::geometry::{Aabb, TetMesh, Vec3};
use rustc_hash::FxHashMap;
use std::ops::Range;

/// Half width of the hat that averages frames along the front, in element sizes.
const FRAME_HAT: f64 = 1.5;
/// Half width of the hat that averages curvature and effective position, in element sizes.
const WIDE_HAT: f64 = 2.0;
/// Largest curvature times element size that the fields near the front are corrected for.
const LARGEST_CURVATURE: f64 = 0.4;
/// The effective front is at most this far from the geometric one, in element sizes.
const LARGEST_OFFSET: f64 = 0.5;

/// A front with right-handed frames (q outward, n normal, t = q x n); t runs against the line.
#[derive(Debug)]
pub(super) struct FrontLine {
    pub(super) points: Vec<Vec3>,
    pub(super) arc: Vec<f64>,
    pub(super) advance: Vec<Vec3>,
    pub(super) normal: Vec<Vec3>,
    /// dq/dt . t \[1/mm\]: positive where the crack is convex.
    pub(super) curvature: Vec<f64>,
    pub(super) closed_length: Option<f64>,
    segments: Vec<Segment>,
    stretches: Vec<Stretch>,
    bounds: Aabb,
}

/// A few segments that follow each other, passed over where they are too far.
#[derive(Debug)]
struct Stretch {
    segments: Range<usize>,
    bounds: Aabb,
}

/// Segments in a stretch.
const STRETCH: usize = 6;

/// A straight piece of the line.
#[derive(Debug)]
struct Segment {
    begin: Vec3,
    along: Vec3,
    per_length_squared: f64,
    /// Arc length where it begins, and its own.
    arc: f64,
    length: f64,
}

/// A place beside a front: distance, arc length, and the two coordinates across it in the frame there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) r: f64,
    pub(super) s: f64,
    /// Ahead, along q.
    pub(super) x: f64,
    /// Above, along n.
    pub(super) y: f64,
}

/// The frame at some arc length.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalFrame {
    pub(super) origin: Vec3,
    pub(super) advance: Vec3,
    pub(super) normal: Vec3,
    pub(super) curvature: f64,
}

impl FrontLine {
    pub(super) fn new(sheet: &Sheet, front: &Front, h: f64) -> Self {
        let at = |v: &u32| sheet.mesh.vertices[*v as usize];
        let mut line = Self {
            points: front.vertices.iter().map(at).collect(),
            arc: Vec::new(),
            advance: Vec::new(),
            normal: Vec::new(),
            curvature: Vec::new(),
            closed_length: front.closed.then_some(0.0),
            segments: Vec::new(),
            stretches: Vec::new(),
            bounds: Aabb::EMPTY,
        };
        line.measure();
        line.set_frames(&raw_normals(sheet, front), h);
        line.set_curvature(h);
        line
    }

    /// Arc lengths and segments.
    fn measure(&mut self) {
        let n = self.points.len();
        self.arc = vec![0.0];
        for k in 1..n {
            self.arc
                .push(self.arc[k - 1] + (self.points[k] - self.points[k - 1]).norm());
        }
        let gap = (self.points[0] - self.points[n - 1]).norm();
        let total = self.arc[n - 1];
        self.closed_length = self.closed_length.map(|_| total + gap);
        self.bounds = Aabb::around(&self.points);
        self.segments = (0..self.n_segments())
            .map(|k| {
                let (begin, end, arc) = self.segment(k);
                let along = end - begin;
                Segment {
                    begin,
                    along,
                    per_length_squared: along.norm_squared().max(1e-18).recip(),
                    arc,
                    length: along.norm(),
                }
            })
            .collect();
        self.stretches = (0..self.segments.len())
            .step_by(STRETCH)
            .map(|first| {
                let segments = first..(first + STRETCH).min(self.segments.len());
                let own = &self.segments[segments.clone()];
                let ends = own.iter().flat_map(|s| [s.begin, s.begin + s.along]);
                let bounds = Aabb::around(&ends.collect::<Vec<_>>());
                Stretch { segments, bounds }
            })
            .collect();
    }

    pub(super) fn n_segments(&self) -> usize {
        self.points.len() - usize::from(self.closed_length.is_none())
    }

    /// Begin, end and arc length at the begin of segment `k`.
    pub(super) fn segment(&self, k: usize) -> (Vec3, Vec3, f64) {
        let next = (k + 1) % self.points.len();
        (self.points[k], self.points[next], self.arc[k])
    }

    /// Normals averaged over about one element size; q from the chord.
    fn set_frames(&mut self, raw: &[Vec3], h: f64) {
        let unit = |v: Vec3| v.try_normalize(1e-12).unwrap_or_else(Vec3::zeros);
        for k in 0..self.points.len() {
            let window = self.window(k, FRAME_HAT * h);
            let normal = unit(window.iter().map(|(j, w)| raw[*j] * *w).sum());
            let chord: Vec3 = window.iter().map(|(j, w)| self.direction(*j) * *w).sum();
            self.advance.push(unit(chord.cross(&normal)));
            self.normal.push(normal);
        }
    }

    fn set_curvature(&mut self, h: f64) {
        let n = self.points.len();
        let raw: Vec<f64> = (0..n)
            .map(|k| {
                let (before, after) = self.neighbours(k);
                let along = self.points[after] - self.points[before];
                let turn = self.advance[after] - self.advance[before];
                turn.dot(&along) / along.norm_squared().max(1e-18)
            })
            .collect();
        let limit = LARGEST_CURVATURE / h;
        self.curvature = (0..n)
            .map(|k| {
                self.average(k, WIDE_HAT * h, |j| raw[j])
                    .clamp(-limit, limit)
            })
            .collect();
    }

    /// Vertices within `half_width` of vertex `k` along the line, with their hat.
    fn window(&self, k: usize, half_width: f64) -> Vec<(usize, f64)> {
        let near = self.vertices_within(self.arc[k], half_width);
        let weighted = |j: usize| (j, self.hat(self.arc[j], self.arc[k], half_width));
        near.into_iter().map(weighted).collect()
    }

    pub(super) fn average(&self, k: usize, half_width: f64, value: impl Fn(usize) -> f64) -> f64 {
        let window = self.window(k, half_width);
        let sum: f64 = window.iter().map(|(j, w)| w * value(*j)).sum();
        sum / window.iter().map(|w| w.1).sum::<f64>()
    }

    fn neighbours(&self, k: usize) -> (usize, usize) {
        let n = self.points.len();
        match self.closed_length {
            Some(_) => ((k + n - 1) % n, (k + 1) % n),
            None => (k.saturating_sub(1), (k + 1).min(n - 1)),
        }
    }

    fn direction(&self, k: usize) -> Vec3 {
        let (before, after) = self.neighbours(k);
        (self.points[after] - self.points[before])
            .try_normalize(1e-12)
            .unwrap_or_else(Vec3::zeros)
    }

    /// 1 at `at`, falling to 0 at `half_width` along the line.
    pub(super) fn hat(&self, s: f64, at: f64, half_width: f64) -> f64 {
        let mut d = (s - at).abs();
        if let Some(length) = self.closed_length {
            d = d.min(length - d);
        }
        (1.0 - d / half_width).max(0.0)
    }

    /// The vertices before and after `s` and the share of the way between them.
    pub(super) fn between(&self, s: f64) -> (usize, usize, f64) {
        let n = self.points.len();
        let k = self.arc.partition_point(|a| *a <= s).clamp(1, n) - 1;
        let (after, end) = if k + 1 < n {
            (k + 1, self.arc[k + 1])
        } else {
            match self.closed_length {
                Some(length) => (0, length),
                None => (k, self.arc[k]),
            }
        };
        let w = if end > self.arc[k] {
            ((s - self.arc[k]) / (end - self.arc[k])).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (k, after, w)
    }

    pub(super) fn frame_at(&self, s: f64) -> LocalFrame {
        let (a, b, w) = self.between(s);
        let mix = |v: &[Vec3]| v[a] * (1.0 - w) + v[b] * w;
        let advance = mix(&self.advance)
            .try_normalize(1e-12)
            .unwrap_or(self.advance[a]);
        let normal = mix(&self.normal);
        let normal = (normal - advance * normal.dot(&advance))
            .try_normalize(1e-12)
            .unwrap_or(self.normal[a]);
        LocalFrame {
            origin: mix(&self.points),
            advance,
            normal,
            curvature: self.curvature[a] * (1.0 - w) + self.curvature[b] * w,
        }
    }

    /// Distance to the front and arc length of its nearest point; `None` beyond `reach`.
    pub(super) fn project(&self, p: &Vec3, reach: f64) -> Option<(f64, f64)> {
        if !self.bounds.grown(reach).contains(p) {
            return None;
        }
        // Ties go to the smaller arc length.
        let mut best = (reach * reach, None);
        for stretch in &self.stretches {
            if stretch.bounds.distance_squared(p) >= best.0 {
                continue;
            }
            for segment in &self.segments[stretch.segments.clone()] {
                let from = p - segment.begin;
                let w = (from.dot(&segment.along) * segment.per_length_squared).clamp(0.0, 1.0);
                let distance = (from - segment.along * w).norm_squared();
                if distance < best.0 {
                    best = (distance, Some(segment.arc + w * segment.length));
                }
            }
        }
        best.1.map(|s| (best.0.sqrt(), s))
    }

    pub(super) fn place(&self, p: &Vec3, reach: f64) -> Option<(Place, LocalFrame)> {
        let (r, s) = self.project(p, reach)?;
        let frame = self.frame_at(s);
        let d = p - frame.origin;
        let (x, y) = (d.dot(&frame.advance), d.dot(&frame.normal));
        Some((Place { r, s, x, y }, frame))
    }

    /// For each vertex: share of its hat inside the body, and the integral of the hat there \[mm\].
    pub(super) fn inside_share(&self, fields: &Fields, half_width: f64) -> Vec<(f64, f64)> {
        const SAMPLES: usize = 4;
        let mut sums = vec![(0.0, 0.0); self.points.len()];
        for k in 0..self.n_segments() {
            let (a, b, s) = self.segment(k);
            let d = b - a;
            for i in 0..SAMPLES {
                let w = (i as f64 + 0.5) / SAMPLES as f64;
                let is_in = fields.locator.find(fields.mesh, &(a + d * w)).is_some();
                let (at, length) = (s + w * d.norm(), d.norm() / SAMPLES as f64);
                for j in self.vertices_within(at, half_width) {
                    let part = length * self.hat(at, self.arc[j], half_width);
                    sums[j].0 += part;
                    sums[j].1 += if is_in { part } else { 0.0 };
                }
            }
        }
        let share = |(all, inside): (f64, f64)| if all > 0.0 { inside / all } else { 0.0 };
        sums.into_iter().map(|s| (share(s), s.1)).collect()
    }

    /// Vertices whose hat of `half_width` holds `s`.
    pub(super) fn vertices_within(&self, s: f64, half_width: f64) -> Vec<usize> {
        let range = |lo: f64, hi: f64| {
            self.arc.partition_point(|a| *a <= lo)..self.arc.partition_point(|a| *a < hi)
        };
        let mut found: Vec<usize> = range(s - half_width, s + half_width).collect();
        if let Some(length) = self.closed_length {
            found.extend(range(s - half_width + length, s + half_width + length));
            found.extend(range(s - half_width - length, s + half_width - length));
            found.sort_unstable();
            found.dedup();
        }
        found
    }

    /// Where the effective front lies ahead of each vertex \[mm\]: the crack's area as mechanics knows it, each piece counted as
    /// far as it is free to open, against the area behind the line.
    pub(super) fn effective_offsets(&self, fields: &Fields, h: f64) -> Vec<f64> {
        let n = self.points.len();
        let mut excess = vec![0.0; n];
        let half_width = WIDE_HAT * h;
        let divided = (0..fields.mesh.tets().len() as u32).filter(|&t| {
            let bounds = || Aabb::around(&fields.mesh.corners(t as usize));
            fields.topology.is_divided(t) && self.comes_within(1.5 * h, &bounds())
        });
        for t in divided {
            face_pieces(fields.mesh, fields.cuts, fields.topology, t, |f| {
                let Some((place, frame)) = self.place(&f.centre, 2.2 * h) else {
                    return;
                };
                let area = f.area_normal.norm();
                let own =
                    place.y.abs() < 0.6 * h && f.area_normal.dot(&frame.normal).abs() > 0.5 * area;
                // Beyond an end of the line nothing is ahead of it or behind it.
                if !own || (place.x.hypot(place.y) - place.r).abs() > 0.3 * h {
                    return;
                }
                let behind = f64::from(u8::from(place.x < 0.0));
                for j in self.vertices_within(place.s, half_width) {
                    let w = self.hat(place.s, self.arc[j], half_width);
                    excess[j] += w * area * (f.freedom - behind);
                }
            });
        }
        let inside = self.inside_share(fields, half_width);
        (0..n)
            .map(|k| {
                if inside[k].1 <= 0.2 * h {
                    return 0.0;
                }
                let limit = LARGEST_OFFSET * h;
                (excess[k] / inside[k].1).clamp(-limit, limit)
            })
            .collect()
    }

    /// The line moved ahead by `offsets`, with the same frames.
    pub(super) fn moved(mut self, offsets: &[f64]) -> Self {
        for (k, d) in offsets.iter().enumerate() {
            self.points[k] += self.advance[k] * *d;
        }
        self.measure();
        self
    }

    /// Whether the box of some segment, grown by `reach`, meets a box.
    fn comes_within(&self, reach: f64, bounds: &Aabb) -> bool {
        let query = bounds.grown(reach);
        self.stretches.iter().any(|stretch| {
            let segment = |s: &Segment| Aabb::around(&[s.begin, s.begin + s.along]);
            stretch.bounds.overlaps(&query)
                && (self.segments[stretch.segments.clone()].iter())
                    .any(|s| segment(s).overlaps(&query))
        })
    }

    /// Nodes within `reach` of the line, ascending.
    pub(super) fn nodes_near(&self, mesh: &TetMesh, reach: f64) -> Vec<NearNode> {
        let near = |(node, at): (u32, &Vec3)| {
            let (r, s) = self.project(at, reach)?;
            Some(NearNode { node, r, s })
        };
        (0u32..).zip(mesh.nodes()).filter_map(near).collect()
    }
}

/// A node near the front: distance and place along it.
#[derive(Debug)]
pub(super) struct NearNode {
    pub(super) node: u32,
    pub(super) r: f64,
    pub(super) s: f64,
}

/// Unit normals at a front's vertices from the triangles that have an edge on it: only they say which way the crack is heading.
fn raw_normals(sheet: &Sheet, front: &Front) -> Vec<Vec3> {
    let n = front.vertices.len();
    let numbered = front.vertices.iter().enumerate();
    let place: FxHashMap<u32, usize> = numbered.map(|(k, v)| (*v, k)).collect();
    let mut raw = vec![Vec3::zeros(); n];
    for (t, triangle) in sheet.mesh.triangles.iter().enumerate() {
        for e in 0..3 {
            let [a, b] = [triangle[e], triangle[(e + 1) % 3]].map(|v| place.get(&v).copied());
            let (Some(a), Some(b)) = (a, b) else { continue };
            let adjoin = a.abs_diff(b) == 1 || (front.closed && a.abs_diff(b) == n - 1);
            if adjoin {
                let normal = sheet.mesh.area_normal(t);
                raw[a] += normal;
                raw[b] += normal;
            }
        }
    }
    let unit = |v: Vec3| v.try_normalize(1e-12).unwrap_or_else(Vec3::zeros);
    raw.into_iter().map(unit).collect()
}
