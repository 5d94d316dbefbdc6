use osteotome_mechanics::geometry::{Pose, Vec3};

/// One point of the pre-sawn line, as the surgeon sees it.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    /// On the bone's surface \[mm\].
    pub at: Vec3,
    /// Unit vector into the bone.
    pub toward: Vec3,
    /// Depth of the slit \[mm\].
    pub depth: f64,
    /// Whether it belongs to the ridge part.
    pub is_ridge: bool,
}

/// A line too short to put a chisel into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the osteotomy line has no two points apart from each other")]
pub struct NoLine;

/// The osteotomy's own frame: arc length along the line, depth into the bone, and across.
#[derive(Clone, Debug)]
pub struct SplitLine {
    marks: Vec<Mark>,
    arc: Vec<f64>,
    ridge: [f64; 2],
    /// Square to the ridge as a whole, in its slit: the way both chisels are driven, so that their shafts are parallel.
    drive: Vec3,
}

/// A blade leans from square to the slit's edge by no more than this \[rad\]: its leading corner then goes in by a
/// quarter of its width before the other does.
const MOST_LEAN: f64 = 0.3;

impl SplitLine {
    /// Measures the line. Where no point is marked as ridge, the whole line counts as one.
    ///
    /// # Errors
    /// `NoLine`.
    pub fn new(marks: Vec<Mark>) -> Result<Self, NoLine> {
        let mut arc = Vec::with_capacity(marks.len());
        let mut length = 0.0;
        for (i, mark) in marks.iter().enumerate() {
            length += (mark.at - marks[i.saturating_sub(1)].at).norm();
            arc.push(length);
        }
        if length.is_nan() || length <= 0.0 {
            return Err(NoLine);
        }
        let first = marks.iter().position(|m| m.is_ridge);
        let last = marks.iter().rposition(|m| m.is_ridge);
        let ridge = match (first, last) {
            (Some(a), Some(b)) if b > a => [arc[a], arc[b]],
            _ => [0.0, length],
        };
        let on_ridge: Vec<Mark> = (marks.iter().zip(&arc))
            .filter(|(_, s)| (ridge[0]..=ridge[1]).contains(*s))
            .map(|(m, _)| *m)
            .collect();
        let drive = edge_and_square(&on_ridge).map_or(marks[0].toward, |(_, square)| square);
        Ok(Self {
            marks,
            arc,
            ridge,
            drive,
        })
    }

    /// Arc length at a share of the ridge.
    pub fn on_ridge(&self, share: f64) -> f64 {
        self.ridge[0] + share * (self.ridge[1] - self.ridge[0])
    }

    /// Where the ridge begins and ends.
    pub fn ridge(&self) -> [f64; 2] {
        self.ridge
    }

    /// Arc length of the whole line \[mm\].
    pub fn length(&self) -> f64 {
        self.arc[self.arc.len() - 1]
    }

    /// The marks.
    pub fn marks(&self) -> &[Mark] {
        &self.marks
    }

    /// The mark at or after `s`, and the share of the way to it.
    fn place(&self, s: f64) -> (usize, f64) {
        let upper = self
            .arc
            .partition_point(|a| *a <= s)
            .clamp(1, self.arc.len() - 1);
        let span = self.arc[upper] - self.arc[upper - 1];
        let w = if span > 0.0 {
            ((s - self.arc[upper - 1]) / span).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (upper, w)
    }

    /// A vector at arc length `s` from one at each mark; zero where there are none.
    pub fn interpolate(&self, s: f64, at_marks: &[Vec3]) -> Vec3 {
        let (upper, w) = self.place(s);
        match at_marks.get(upper - 1..=upper) {
            Some([a, b]) => a.lerp(b, w),
            _ => Vec3::zeros(),
        }
    }

    /// Position, direction into the bone and depth of the slit at arc length `s`.
    pub fn mark(&self, s: f64) -> Mark {
        let (upper, w) = self.place(s);
        let (a, b) = (&self.marks[upper - 1], &self.marks[upper]);
        Mark {
            at: a.at.lerp(&b.at, w),
            toward: a
                .toward
                .lerp(&b.toward, w)
                .try_normalize(1e-9)
                .unwrap_or(a.toward),
            depth: a.depth + w * (b.depth - a.depth),
            is_ridge: a.is_ridge && b.is_ridge,
        }
    }

    /// The frame of a blade of this width at `s`: origin on the surface, +z the way it is driven, x along its edge, y across.
    ///
    /// A slit is neither straight nor flat, a blade is both. Its plane is the slit's mean one: through the chord over the
    /// blade's width and the mean direction of the saw, in the middle of the slit. Within this plane the edge would best
    /// lie along the chord, but on a hollow ridge two such blades' shafts would meet: so each leans towards the
    /// common `drive`, by no more than `MOST_LEAN`.
    pub fn frame(&self, s: f64, width: f64) -> Pose {
        let here = self.mark(s);
        let marks = self.below_blade(s, width);
        let (chord, square) = edge_and_square(&marks).unwrap_or_else(|| {
            let x = any_across(&here.toward);
            (x, here.toward)
        });
        let y = square.cross(&chord);
        let lean = chord.dot(&self.drive).atan2(square.dot(&self.drive));
        let lean = lean.clamp(-MOST_LEAN, MOST_LEAN);
        let z = square * lean.cos() + chord * lean.sin();
        let off = |m: &Mark| y.dot(&(m.at + m.toward * (0.5 * m.depth) - here.at));
        let n = marks.len() as f64;
        let origin = here.at + y * (marks.iter().map(off).sum::<f64>() / n);
        let axes = nalgebra::Matrix3::from_columns(&[y.cross(&z), y, z]);
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(axes);
        let rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
        Pose::from_parts(origin.into(), rotation)
    }

    /// The marks below a blade of this width, evenly from end to end: it spans a handful of the line's own.
    fn below_blade(&self, s: f64, width: f64) -> [Mark; 9] {
        std::array::from_fn(|k| {
            let offset = width * (k as f64 / 8.0 - 0.5);
            self.mark((s + offset).clamp(0.0, self.length()))
        })
    }

    /// How far a blade of this width can go in at `s` before it stands on the slit's bottom \[mm\].
    pub fn room(&self, s: f64, width: f64) -> f64 {
        let frame = self.frame(s, width);
        let z = frame.rotation * Vec3::z();
        let bottom = |m: &Mark| z.dot(&(m.at + m.toward * m.depth - frame.translation.vector));
        let marks = self.below_blade(s, width);
        marks.iter().map(bottom).fold(f64::INFINITY, f64::min)
    }

    /// Least distance between the axes of two blades of these widths and this length outside the bone \[mm\].
    pub fn shaft_distance(&self, s: [f64; 2], width: &[f64; 2], length: f64) -> f64 {
        const STRIDE: f64 = 4.0; // mm
        let frames = [0, 1].map(|i| self.frame(s[i], width[i]));
        let n = (length / STRIDE) as i32;
        let point = |i: usize, k: i32| {
            let frame = &frames[i];
            frame.translation.vector - frame.rotation * Vec3::z() * (STRIDE * f64::from(k))
        };
        let mut least = f64::INFINITY;
        for a in 0..=n {
            for b in 0..=n {
                least = least.min((point(0, a) - point(1, b)).norm());
            }
        }
        least
    }

    /// How far the slit's middle, at its mouth and its bottom, strays from the plane of a blade of this width at `s` \[mm\].
    pub fn misfit(&self, s: f64, width: f64) -> f64 {
        let frame = self.frame(s, width);
        let y = frame.rotation * Vec3::y();
        let stray = |p: Vec3| y.dot(&(p - frame.translation.vector)).abs();
        self.below_blade(s, width)
            .iter()
            .map(|m| stray(m.at).max(stray(m.at + m.toward * m.depth)))
            .fold(0.0, f64::max)
    }
}

/// The chord of these marks and, in the plane of chord and mean direction, what is square to it; both of unit length.
fn edge_and_square(marks: &[Mark]) -> Option<(Vec3, Vec3)> {
    let [first, .., last] = marks else {
        return None;
    };
    let chord = (last.at - first.at).try_normalize(1e-9)?;
    let into: Vec3 = marks.iter().map(|m| m.toward).sum();
    let square = (into - chord * chord.dot(&into)).try_normalize(1e-6)?;
    Some((chord, square))
}

fn any_across(z: &Vec3) -> Vec3 {
    let other = if z.x.abs() < 0.9 {
        Vec3::x()
    } else {
        Vec3::y()
    };
    (other - z * z.dot(&other)).normalize()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Along x, 40 mm, into -z; the ridge is the first 30 mm.
    pub fn straight() -> SplitLine {
        let marks = (0..=40).map(|i| Mark {
            at: Vec3::new(f64::from(i), 0.0, 0.0),
            toward: -Vec3::z(),
            depth: 4.0,
            is_ridge: i <= 30,
        });
        SplitLine::new(marks.collect()).unwrap()
    }

    #[test]
    fn the_frame_points_into_the_bone_with_the_blade_along_the_line() {
        let frame = straight().frame(10.0, 10.0);
        assert!((frame.translation.vector - Vec3::new(10.0, 0.0, 0.0)).norm() < 1e-12);
        assert!((frame.rotation * Vec3::z() + Vec3::z()).norm() < 1e-12);
        assert!((frame.rotation * Vec3::x() - Vec3::x()).norm() < 1e-12);
    }

    /// On an arc of radius 30 mm the blade's edge stays within the slit's half width (.4 mm) all along.
    #[test]
    fn a_blade_fits_a_curved_slit() {
        let mark = |i: i32| {
            let (sin, cos) = (f64::from(i) / 30.0).sin_cos();
            Mark {
                at: Vec3::new(30.0 * sin, 30.0 * cos, 0.0),
                toward: -Vec3::z(),
                depth: 4.0,
                is_ridge: true,
            }
        };
        let line = SplitLine::new((0..=40).map(mark).collect()).unwrap();
        let frame = line.frame(20.0, 10.0);
        for x in [-5.0, -2.5, 0.0, 2.5, 5.0] {
            let edge = frame * nalgebra::Point3::new(x, 0.0, 2.0);
            let radius = edge.x.hypot(edge.y);
            assert!((radius - 30.0).abs() < 0.35, "{radius} at {x}");
        }
        assert!(line.misfit(20.0, 10.0) < 0.35 && line.misfit(20.0, 20.0) > 0.4);
    }

    #[test]
    fn places_and_shares_are_measured_along_the_line() {
        let line = straight();
        assert!((line.on_ridge(0.5) - 15.0).abs() < 1e-12);
        assert!((line.mark(7.5).at.x - 7.5).abs() < 1e-12);
    }

    #[test]
    fn a_single_point_is_no_line() {
        let mark = straight().mark(1.0);
        assert_eq!(SplitLine::new(vec![mark, mark]).unwrap_err(), NoLine);
    }
}
