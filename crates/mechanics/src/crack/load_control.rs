//! Growth under a load that follows the crack: which criterion, which load, how far each point of a front moves.
use super::body::EvaluatedFront;
use super::criterion::StressIntensity;
use super::growth::{self, Drive, GrowthLengths, smoothed};
use super::stress_intensity::Station;
use crate::geometry::Vec3;

/// How the direction of growth is chosen and its strength judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Criterion {
    /// Maximum strain energy release rate.
    #[default]
    Mserrc,
    /// Maximum tangential (hoop) stress, Erdogan & Sih 1963; K_III has no say.
    Mts,
}

impl Criterion {
    /// Drive and kink of one station.
    pub fn drive(self, station: &Station, max_kink: f64) -> Drive {
        match self {
            Self::Mserrc => growth::drive(station, max_kink),
            Self::Mts => hoop_stress_drive(station, max_kink),
        }
    }
}

/// Energy release rate of a crack under the equivalent K_I of the largest hoop stress, over the toughness in that direction;
/// scaled by the domain integral like [`growth::drive`].
fn hoop_stress_drive(station: &Station, max_kink: f64) -> Drive {
    let kink = hoop_stress_angle(&station.k).clamp(-max_kink, max_kink);
    let equivalent = hoop_stress(&station.k, kink);
    let straight = station.k.straight_release(station.material.poisson_ratio);
    if station.g <= 0.0 || straight <= 0.0 || equivalent <= 0.0 {
        return Drive {
            ratio: 0.0,
            kink: 0.0,
        };
    }
    let normal = station.normal * kink.cos() - station.advance * kink.sin();
    Drive {
        ratio: station.g * equivalent * equivalent / straight / station.material.toughness(&normal),
        kink,
    }
}

/// Where the hoop stress round the front is largest \[rad\].
pub fn hoop_stress_angle(k: &StressIntensity) -> f64 {
    // The usual 2 atan((K_I - root) / (4 K_II)) without its cancellation at small K_II.
    let root = (k.k1 * k.k1 + 8.0 * k.k2 * k.k2).sqrt();
    if k.k1 + root <= 0.0 {
        return 0.0;
    }
    2.0 * (-2.0 * k.k2 / (k.k1 + root)).atan()
}

/// sqrt(2 pi r) times the hoop stress at `angle`.
fn hoop_stress(k: &StressIntensity, angle: f64) -> f64 {
    let (s, c) = (0.5 * angle).sin_cos();
    c * c * (c * k.k1 - 3.0 * s * k.k2)
}

/// Angle by which K_III would turn the front out of its plane \[rad\]: half the angle of the principal stress in the plane
/// normal to the kink, `tan 2 psi = 2 tau / sigma` (Schoellmann et al. 2002). Reported, not fed back into growth.
pub fn twist(k: &StressIntensity, kink: f64) -> f64 {
    let tearing = k.k3 * (0.5 * kink).cos();
    let opening = hoop_stress(k, kink).max(0.0);
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
    /// Applies a criterion.
    pub fn new(fronts: &[EvaluatedFront], criterion: Criterion, lengths: &GrowthLengths) -> Self {
        let mut drives = Self::default();
        for f in fronts {
            let raw: Vec<_> = f
                .stations
                .iter()
                .map(|s| criterion.drive(s, lengths.max_kink))
                .collect();
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

    /// How each vertex moves \[mm\]: by the increment where the drive is largest, elsewhere in proportion to it; not at all where
    /// it is below `least`.
    pub fn moves(
        &self,
        fronts: &[EvaluatedFront],
        lengths: &GrowthLengths,
        least: f64,
    ) -> Vec<Vec<Vec3>> {
        let all = self.smooth.iter().flatten().map(|d| d.ratio);
        let largest = all.fold(0.0, f64::max);
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

    /// Angles, equivalent K and twists of the reference table.
    #[test]
    fn angles_match_the_table() {
        for (k1, k2, degrees, equivalent) in [
            (1.0, 0.1, -11.20, 1.0147),
            (1.0, 0.25, -25.33, 1.0853),
            (1.0, 0.5, -40.21, 1.2828),
            (1.0, 1.0, -53.13, 1.7889),
            (0.0, 1.0, -70.53, 1.1547),
        ] {
            let k = StressIntensity { k1, k2, k3: 0.0 };
            let angle = hoop_stress_angle(&k);
            assert!((angle.to_degrees() - degrees).abs() < 0.006, "{k1}, {k2}");
            assert!(
                (hoop_stress(&k, angle) - equivalent).abs() < 6e-5,
                "{k1}, {k2}"
            );
        }
        for (k1, k3, degrees) in [
            (1.0, 0.25, 13.28),
            (1.0, 0.5, 22.5),
            (1.0, 1.0, 31.72),
            (0.0, 1.0, 45.0),
        ] {
            let k = StressIntensity { k1, k2: 0.0, k3 };
            assert!(
                (twist(&k, 0.0).to_degrees() - degrees).abs() < 0.006,
                "{k1}, {k3}"
            );
        }
    }

    #[test]
    fn a_closing_front_goes_nowhere() {
        let k = StressIntensity {
            k1: -1.0,
            k2: 0.0,
            k3: 0.0,
        };
        assert_eq!(hoop_stress_angle(&k), 0.0);
        assert!(hoop_stress(&k, 0.0) < 0.0);
    }
}
