use super::{ContactScene, NearPoints, RigidShape};
use crate::geometry::Pose;
use wide::f32x4;

/// The points near one shape at the last few places where it was tried: a solve goes to and fro between where the shape is and where
/// it might be, and the points must not be looked for at each end anew.
#[derive(Clone, Debug)]
pub struct NearPlaces {
    places: [NearPoints; N_PLACES],
    /// The higher, the later.
    used: [u64; N_PLACES],
    last: usize,
}

/// Where the shape is, and up to three trials that were refused before one was taken.
const N_PLACES: usize = 4;

impl NearPlaces {
    /// Room for `n_points` near points at each place.
    pub fn with_capacity(n_points: usize) -> Self {
        Self {
            places: std::array::from_fn(|_| NearPoints::with_capacity(n_points)),
            used: [0; N_PLACES],
            last: 0,
        }
    }

    /// The points near the shape at `world_from_shape`. Looks for them only if no place serves; the one that was of no use for
    /// longest is given up for that. `lent`: those that somebody else found in this very state. Does not allocate.
    pub fn follow(
        &mut self,
        shape: &RigidShape,
        world_from_shape: &Pose,
        scene: &ContactScene,
        lent: Option<&NearPoints>,
    ) -> &NearPoints {
        let serves = |near: &NearPoints| near.serves(shape, world_from_shape, scene);
        let oldest = (0..N_PLACES).min_by_key(|k| self.used[*k]).unwrap_or(0);
        let serving = self.places.iter().position(serves);
        let place = serving.unwrap_or(oldest);
        if serving.is_none() {
            // The surroundings of another place may do: then only the points there change hands.
            let knows = |near: &NearPoints| near.knows(shape, world_from_shape, scene);
            let knowing = self.places.iter().position(knows);
            if let Some(k) = knowing
                && let Ok([near, other]) = self.places.get_disjoint_mut([place, k])
            {
                near.take_around(other);
            }
        }
        self.used[place] = self.used[self.last] + 1;
        self.last = place;
        let near = &mut self.places[place];
        if serving.is_none() {
            near.renew::<f32x4>(shape, world_from_shape, scene, lent);
        }
        near
    }

    /// Those of the last [`follow`](Self::follow).
    pub fn last(&self) -> &NearPoints {
        &self.places[self.last]
    }
}
