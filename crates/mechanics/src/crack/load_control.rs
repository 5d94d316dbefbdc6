//! Growth under a load that follows the crack: how hard each point of a front is driven, and how far it moves.
use super::body::EvaluatedFront;
use super::criterion::StressIntensity;
use super::growth::{Drive, GrowthLengths, drive, smoothed};
use super::stress_intensity::Station;
use crate::geometry::Vec3;

/// Angle by which K_III would turn the front out of its plane \[rad\]: half the angle of the principal stress in the plane
/// normal to the kink, `tan 2 psi = 2 tau / sigma` (Schoellmann et al. 2002). Reported, not fed back into growth.
pub fn twist(k: &StressIntensity, kink: f64) -> f64 {
    let tearing = k.k3 * (0.5 * kink).cos();
    let opening = k.hoop_intensity(kink).max(0.0);
    if tearing == 0.0 {
        0.0
    } else {
        0.5 * (2.0 * tearing).atan2(opening)
    }
}

/// What drives all fronts: as found at each station, and smoothed along each front.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrontDrives {
    /// By front and vertex.
    pub raw: Vec<Vec<Drive>>,
    /// Averaged over a hat of 1.5 h along the front: what moves.
    pub smooth: Vec<Vec<Drive>>,
    /// Largest raw drive of any station that is well inside the body.
    pub strongest: f64,
}

impl FrontDrives {
    /// Applies the criterion of `lengths`.
    pub fn new(fronts: &[EvaluatedFront], lengths: &GrowthLengths) -> Self {
        let mut drives = Self::default();
        for f in fronts {
            let raw: Vec<_> = f.stations.iter().map(|s| drive(s, lengths)).collect();
            let own = f.stations.iter().zip(&raw);
            drives.strongest = own
                .filter(|(s, _)| s.is_trusted())
                .map(|(_, d)| d.ratio)
                .fold(drives.strongest, f64::max);
            drives
                .smooth
                .push(smoothed(&f.stations, &raw, f.front.closed, 1.5 * lengths.h));
            drives.raw.push(raw);
        }
        drives
    }

    /// Largest smoothed drive of all.
    pub fn largest(&self) -> f64 {
        let all = self.smooth.iter().flatten();
        all.fold(0.0, |most, d| d.ratio.max(most))
    }

    /// How each vertex moves \[mm\]: by the increment where the drive is largest, elsewhere in proportion to it; not at all where
    /// it is below `least`.
    pub fn moves(
        &self,
        fronts: &[EvaluatedFront],
        lengths: &GrowthLengths,
        least: f64,
    ) -> Vec<Vec<Vec3>> {
        let largest = self.largest();
        let step = |s: &Station, d: &Drive| {
            if largest <= 0.0 || d.ratio < least {
                return Vec3::zeros();
            }
            let direction = s.advance * d.kink.cos() + s.normal * d.kink.sin();
            direction * (lengths.increment * d.ratio / largest)
        };
        fronts
            .iter()
            .zip(&self.smooth)
            .map(|(f, drives)| {
                let pairs = f.stations.iter().zip(drives);
                pairs.map(|(s, d)| step(s, d)).collect()
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twists of the reference table.
    #[test]
    fn twists_match_the_table() {
        for (k1, k3, degrees) in [
            (1.0, 0.25, 13.28),
            (1.0, 0.5, 22.5),
            (1.0, 1.0, 31.72),
            (0.0, 1.0, 45.0),
        ] {
            let k = StressIntensity { k1, k2: 0.0, k3 };
            let found = twist(&k, 0.0).to_degrees();
            assert!((found - degrees).abs() < 0.006, "{k1}, {k3}: {found}");
        }
    }
}
