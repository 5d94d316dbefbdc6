use super::near::TURN;
use crate::geometry::{Aabb, DistanceGrid, DistanceSample, DistanceSamples, Lanes, Vec3};

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
        let facing = wall_normal.map_or(0.0, |n| n[1]);
        let found = self.inside(position, facing);
        // NaN is not inside.
        (found.distance < 0.0).then_some(DistanceSample {
            distance: found.distance,
            gradient: found.gradient,
        })
    }

    /// How deep points of the bone are: negative distances are inside. `facing`: how much each looks to the shape's +y, 0 for those
    /// on no wall.
    #[inline]
    pub(super) fn inside<L: Lanes>(&self, positions: [L; 3], facing: L) -> DistanceSamples<L> {
        let own = self.on_own_side(positions, facing, 0.0);
        self.fill(positions, own, f32::INFINITY)
    }

    /// As [`inside`](Self::inside), for points that could be inside once the shape has moved by up to `margin` \[mm\]: those whose
    /// distance is less than it. The margin must be less than the grids'.
    #[inline]
    pub(super) fn nearness<L: Lanes>(
        &self,
        positions: [L; 3],
        facing: L,
        margin: f32,
    ) -> DistanceSamples<L> {
        let own = self.on_own_side(positions, facing, margin);
        self.fill(positions, own, margin)
    }

    /// The own sides' answers where these are below `accepted`, elsewhere the body's.
    #[inline]
    fn fill<L: Lanes>(
        &self,
        positions: [L; 3],
        own: Option<DistanceSamples<L>>,
        accepted: f32,
    ) -> DistanceSamples<L> {
        let zero = L::splat(0.0);
        let Some(own) = own else {
            return self.field.look_up_in(positions, zero.at_least(zero));
        };
        let accepted = L::splat(accepted);
        let others = own.distance.at_least(accepted);
        let body = self.field.look_up_in(positions, others);
        own.or(own.distance.less(accepted), body)
    }

    /// For points of walls that look at a side of a blade: how deep they are behind that side, even where they have come out
    /// of the blade's other side. A thin blade that twists in the crack must not slip through its walls. Infinite where that
    /// says nothing; none if it says nothing of any.
    #[inline]
    fn on_own_side<L: Lanes>(
        &self,
        positions: [L; 3],
        facing: L,
        margin: f32,
    ) -> Option<DistanceSamples<L>> {
        let [right, left] = self.sided.as_ref()?;
        // With a margin, also walls that would look at a side once the shape has turned.
        let cosine = SIDE_COSINE - if margin > 0.0 { TURN } else { 0.0 };
        let to_right = L::splat(cosine).less(facing);
        let to_left = facing.less(L::splat(-cosine));
        if L::bits(to_right | to_left) == 0 {
            return None;
        }
        let found = right.look_up_in(positions, to_right);
        let found = found.or(to_right, left.look_up_in(positions, to_left));
        let deepest = L::splat(-SIDE_DEPTH as f32 - margin);
        let counts = deepest.less(found.distance);
        let distance = L::choose(counts, found.distance, L::splat(f32::INFINITY));
        Some(DistanceSamples { distance, ..found })
    }
}
