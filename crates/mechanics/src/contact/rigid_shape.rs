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
    /// The body is what of the box lies within both `a y + b z <= c`, with (a, b) of length 1: towards -y, then towards +y.
    pub bevels: [[f32; 3]; 2],
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
        let own = self.on_own_side(positions, facing);
        self.fill(positions, own)
    }

    /// The own sides' answers where these are finite, elsewhere the body's.
    #[inline]
    fn fill<L: Lanes>(
        &self,
        positions: [L; 3],
        own: Option<DistanceSamples<L>>,
    ) -> DistanceSamples<L> {
        let zero = L::splat(0.0);
        let Some(own) = own else {
            return self.field.look_up_in(positions, zero.at_least(zero));
        };
        let infinite = L::splat(f32::INFINITY);
        let others = own.distance.at_least(infinite);
        let body = self.field.look_up_in(positions, others);
        own.or(own.distance.less(infinite), body)
    }

    /// For points of walls that look at a side of a blade: how deep they are behind that side, even where they have come out
    /// of the blade's other side. A thin blade that twists in the crack must not slip through its walls. Infinite where that
    /// says nothing; none if it says nothing of any.
    #[inline]
    fn on_own_side<L: Lanes>(&self, positions: [L; 3], facing: L) -> Option<DistanceSamples<L>> {
        let [right, left] = self.sided.as_ref()?;
        let to_right = L::splat(SIDE_COSINE).less(facing);
        let to_left = facing.less(L::splat(-SIDE_COSINE));
        if L::bits(to_right | to_left) == 0 {
            return None;
        }
        let found = right.look_up_in(positions, to_right);
        let found = found.or(to_right, left.look_up_in(positions, to_left));
        let deepest = L::splat(-SIDE_DEPTH as f32);
        let counts = deepest.less(found.distance);
        let distance = L::choose(counts, found.distance, L::splat(f32::INFINITY));
        Some(DistanceSamples { distance, ..found })
    }
}

/// Where the faces of a shape are: which places are near it follows from these alone, without a look at its fields.
///
/// A field is convex, and its interpolation nowhere below it, so that what is inside by the field is inside by the faces, and a place
/// farther than w outside one of the faces cannot come inside on a way of w. Of the field alone that cannot be said: it may rise faster than
/// the place moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Faces {
    low: [f32; 3],
    high: [f32; 3],
    bevels: [[f32; 3]; 2],
    /// How far to -y and +y the distances to the sides are known, for a blade.
    beside: Option<[f32; 2]>,
}

impl RigidShape {
    pub(super) fn faces(&self) -> Faces {
        let (low, high) = (&self.bounds.min, &self.bounds.max);
        let reach = self.reach();
        let beside = [reach.min.y as f32, reach.max.y as f32];
        Faces {
            low: [0, 1, 2].map(|k| low[k] as f32),
            high: [0, 1, 2].map(|k| high[k] as f32),
            bevels: self.bevels,
            beside: self.sided.as_ref().map(|_| beside),
        }
    }

    /// Where contacts can be: the body's box, and on both sides of a blade as far as distances to its sides are known.
    pub(super) fn reach(&self) -> Aabb {
        let mut reach = self.bounds;
        if let Some([right, left]) = &self.sided {
            reach.min.y = left.bounds().min.y;
            reach.max.y = right.bounds().max.y;
        }
        reach
    }
}

impl Faces {
    /// Which of some places are farther than `within` outside no face: of all, and of those for a wall that may look to +y (`right`) or
    /// to -y (`left`), which the faces on its far side do not concern.
    #[inline]
    pub fn near<L: Lanes>(
        &self,
        place: [L; 3],
        within: L,
        right: L::Mask,
        left: L::Mask,
    ) -> L::Mask {
        let [body, of_right, of_left] = self.near_sides(place, within);
        body | (right & of_right) | (left & of_left)
    }

    /// Likewise: of all, for walls that look to +y, and for walls that look to -y.
    #[inline]
    pub fn near_sides<L: Lanes>(&self, [x, y, z]: [L; 3], within: L) -> [L::Mask; 3] {
        let splat = L::splat;
        let above = |v: L, low: f32| (splat(low) - v).less(within);
        let below = |v: L, high: f32| (v - splat(high)).less(within);
        let bevel = |[a, b, c]: [f32; 3]| (splat(a) * y + splat(b) * z - splat(c)).less(within);
        let ends = above(x, self.low[0]) & below(x, self.high[0]);
        let ends = ends & above(z, self.low[2]) & below(z, self.high[2]);
        let low = ends & above(y, self.low[1]) & bevel(self.bevels[0]);
        let high = ends & below(y, self.high[1]) & bevel(self.bevels[1]);
        let body = low & high;
        match self.beside {
            None => [body; 3],
            Some([least, most]) => [body, low & below(y, most), high & above(y, least)],
        }
    }

    /// As [`near`](Self::near) for points of walls by how much these look to +y, now or once the shape has turned a little.
    #[inline]
    pub fn near_facing<L: Lanes>(&self, place: [L; 3], within: L, facing: L) -> L::Mask {
        const COSINE: f32 = SIDE_COSINE - TURN;
        let (right, left) = (
            L::splat(COSINE).less(facing),
            facing.less(L::splat(-COSINE)),
        );
        self.near(place, within, right, left)
    }

    /// How deep a place lies within the faces at most \[mm\], negative outside; of a wall, within those that concern it.
    pub fn depth(&self, [x, y, z]: [f32; 3], facing: f32) -> f32 {
        let bevel = |[a, b, c]: [f32; 3]| a * y + b * z - c;
        let ends = (x - self.high[0]).max(self.low[0] - x);
        let ends = ends.max(z - self.high[2]).max(self.low[2] - z);
        let low = bevel(self.bevels[0]).max(self.low[1] - y);
        let high = bevel(self.bevels[1]).max(y - self.high[1]);
        let sides = if facing > SIDE_COSINE {
            low
        } else if facing < -SIDE_COSINE {
            high
        } else {
            low.max(high)
        };
        -ends.max(sides)
    }
}

#[cfg(test)]
mod tests {
    use crate::tool::{Chisel, ChiselParameters};

    /// What the fields call inside is inside the faces, for points of the surface and of walls on either side.
    #[test]
    fn faces_hold_what_the_fields_hold() {
        let shape = Chisel::new(ChiselParameters::default()).unwrap().shape();
        let faces = shape.faces();
        let mut n_inside = [0; 3];
        for i in 0..300_000u32 {
            let a = [0.819_172_513_396, 0.671_043_606_704, 0.549_700_477_901];
            let t = a.map(|a: f64| (0.5 + a * f64::from(i + 1)).fract());
            let p = [11.0 * t[0] - 5.5, 10.0 * t[1] - 5.0, 1.0 - 20.0 * t[2]].map(|v| v as f32);
            for (n, facing) in n_inside.iter_mut().zip([0.0, 0.9, -0.9]) {
                if shape.inside(p, facing).distance < 0.0 {
                    assert!(faces.near_facing(p, 1e-5, facing), "{p:?}, {facing}");
                    *n += 1;
                }
            }
        }
        assert!(n_inside.iter().all(|n| *n > 10_000), "{n_inside:?}");
    }
}
