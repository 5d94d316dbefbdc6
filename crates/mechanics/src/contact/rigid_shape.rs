use crate::geometry::{Aabb, DistanceGrid, DistanceSample, Vec3};

/// A point on a rigid shape's surface that stands for a patch of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// In the shape's frame.
    pub position: Vec3,
    /// \[mm2\]
    pub area: f64,
}

/// A convex rigid body as contact sees it, in its own frame; constant.
#[derive(Clone, Debug)]
pub struct RigidShape {
    /// Signed distance.
    pub field: DistanceGrid,
    /// For a blade, whose sides face -y and +y: the distances of the blade extended without end to +y and to -y.
    ///
    /// A point on a wall of the crack knows on which side of the blade its bone lies, so it is asked only how deep it is
    /// behind *that* side of the blade. Else a blade that has run ahead of the crack would pull new faces together.
    pub sided: Option<[DistanceGrid; 2]>,
    /// Tight box around the body.
    pub bounds: Aabb,
    /// What another shape's field is asked about.
    pub samples: Vec<SurfaceSample>,
}

/// A wall looks at the blade's side if its normal is within 70 degrees of the blade's.
const SIDE_COSINE: f32 = 0.34;
/// Deeper than this behind its own side \[mm\] a wall's point takes the nearest way out after all: then the blade did not
/// come down the crack, and a first contact must not begin with the whole thickness of the blade.
pub(crate) const SIDE_DEPTH: f64 = 2.5;

impl RigidShape {
    /// How deep a point of the bone is inside; none outside and where the position is not finite. A point of a crack's wall
    /// comes with the wall's normal; all in the shape's frame.
    pub fn penetration(
        &self,
        position: [f32; 3],
        wall_normal: Option<&[f32; 3]>,
    ) -> Option<DistanceSample> {
        let own = wall_normal.and_then(|n| self.on_own_side(position, n, 0.0));
        // NaN is not inside.
        let sample = own.or_else(|| self.field.look_up(position))?;
        (sample.distance < 0.0).then_some(sample)
    }

    /// As [`penetration`](Self::penetration), for points that could be inside once the shape has moved by up to `margin` \[mm\].
    /// The margin must be less than the grids'.
    pub(super) fn nearness(
        &self,
        position: [f32; 3],
        wall_normal: Option<&[f32; 3]>,
        margin: f32,
    ) -> Option<DistanceSample> {
        let near = |s: &DistanceSample| s.distance < margin;
        let own = wall_normal.and_then(|n| self.on_own_side(position, n, margin));
        let own = own.filter(near);
        own.or_else(|| self.field.look_up(position).filter(near))
    }

    /// For a point of a wall that looks at a side of a blade: how deep it is behind that side, even where it has come out
    /// of the blade's other side. A thin blade that twists in the crack must not slip through its walls.
    fn on_own_side(
        &self,
        position: [f32; 3],
        normal: &[f32; 3],
        margin: f32,
    ) -> Option<DistanceSample> {
        let sided = self.sided.as_ref()?;
        let side = match normal[1] {
            y if y > SIDE_COSINE => &sided[0],
            y if y < -SIDE_COSINE => &sided[1],
            _ => return None,
        };
        let sample = side.look_up(position)?;
        (sample.distance > -SIDE_DEPTH as f32 - margin).then_some(sample)
    }
}
