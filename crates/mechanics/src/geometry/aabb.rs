use super::{Pose, Vec3};

/// An axis-aligned box \[mm\]; empty until something is added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest corner.
    pub min: Vec3,
    /// Largest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        min: Vec3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        max: Vec3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    /// The smallest box around some points.
    pub fn around<'a>(points: impl IntoIterator<Item = &'a Vec3>) -> Self {
        let mut bounds = Self::EMPTY;
        for p in points {
            bounds.add(p);
        }
        bounds
    }

    /// The box around this one after a rigid motion.
    pub fn moved(&self, motion: &Pose) -> Self {
        let centre = (motion * nalgebra::Point3::from(self.centre())).coords;
        let turn = motion.rotation.to_rotation_matrix();
        let half = turn.matrix().abs() * (self.extent() * 0.5);
        Self {
            min: centre - half,
            max: centre + half,
        }
    }

    /// Whether all of another box lies inside.
    pub fn holds(&self, other: &Self) -> bool {
        (0..3).all(|k| self.min[k] <= other.min[k] && other.max[k] <= self.max[k])
    }

    /// Widens the box to hold `p`.
    pub fn add(&mut self, p: &Vec3) {
        self.min = self.min.inf(p);
        self.max = self.max.sup(p);
    }

    /// The box grown by `margin` on every side.
    pub fn grown(&self, margin: f64) -> Self {
        Self {
            min: self.min.add_scalar(-margin),
            max: self.max.add_scalar(margin),
        }
    }

    /// Whether the two boxes share a point.
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|k| self.min[k] <= other.max[k] && other.min[k] <= self.max[k])
    }

    /// Whether `p` lies inside or on the border.
    pub fn contains(&self, p: &Vec3) -> bool {
        (0..3).all(|k| self.min[k] <= p[k] && p[k] <= self.max[k])
    }

    /// Square of the distance to a point, 0 inside.
    pub fn distance_squared(&self, p: &Vec3) -> f64 {
        let beyond = (self.min - p).sup(&(p - self.max));
        beyond.sup(&Vec3::zeros()).norm_squared()
    }

    /// Edge lengths.
    pub fn extent(&self) -> Vec3 {
        self.max - self.min
    }

    /// Centre.
    pub fn centre(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }
}
