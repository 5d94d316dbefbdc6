use crate::geometry::{Aabb, DistanceGrid, Vec3};

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
