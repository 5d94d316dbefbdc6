//! Growth under a load that follows the crack: how hard each point of a front is driven, and how far it moves.
use super::body::EvaluatedFront;
use super::criterion::StressIntensity;
use super::growth::{Drive, GrowthLengths, drive, smoothed};
use super::stress_intensity::Station;
use crate::geometry::Vec3;

/// Angle by which K_III would turn the front out of its plane \[rad\]: half the angle of the principal stress in the plane
/// normal to the kink, `tan 2 psi = 2 tau / sigma` (Schoellmann et al. 2002). Fed back by [`GrowthLengths::twist`].
pub fn twist(k: &StressIntensity, kink: f64) -> f64 {
    let tearing = k.k3 * (0.5 * kink).cos();
    let opening = k.hoop_intensity(kink).max(0.0);
    if tearing == 0.0 {
        0.0
    } else {
        0.5 * (2.0 * tearing).atan2(opening)
    }
}

/// Share of a station's surroundings in the body from which it sets the pace.
const WELL_INSIDE: f64 = 0.5;

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

    /// The drive that moves a front by the whole increment: the largest of all stations that lie well inside the body. A front's end
    /// that has run out of it can be driven many times as hard, which says nothing about the rest.
    pub(crate) fn pace(&self, fronts: &[EvaluatedFront]) -> f64 {
        let all = fronts.iter().zip(&self.smooth);
        let all = all.flat_map(|(f, drives)| f.stations.iter().zip(drives));
        let inner = all.filter(|(s, _)| s.inside >= WELL_INSIDE);
        let pace = inner.fold(0.0, |most, (_, d)| d.ratio.max(most));
        if pace > 0.0 { pace } else { self.largest() }
    }

    /// How each vertex moves \[mm\]: by the increment where the drive is largest, elsewhere in proportion to it; not at all where
    /// it is below `least`.
    pub fn moves(
        &self,
        fronts: &[EvaluatedFront],
        lengths: &GrowthLengths,
        least: f64,
    ) -> Vec<Vec<Vec3>> {
        let pace = self.pace(fronts);
        let step = |s: &Station, d: &Drive| {
            if pace <= 0.0 || d.ratio < least {
                return Vec3::zeros();
            }
            let direction = s.advance * d.kink.cos() + s.normal * d.kink.sin();
            direction * (lengths.increment * (d.ratio / pace).min(1.0))
        };
        fronts
            .iter()
            .zip(&self.smooth)
            .map(|(f, drives)| {
                let heights = twisted(f, drives, lengths);
                let all = f.stations.iter().zip(drives).zip(heights);
                let moved = |((s, d), height): ((&Station, &Drive), f64)| {
                    let plain = step(s, d);
                    plain + s.normal * (height * plain.norm())
                };
                all.map(moved).collect()
            })
            .collect()
    }
}

/// How far K_III tilts each point of a front out of its plane, over its advance.
///
/// The tilt asked for, tan psi along the front, is summed up along it; what does not close round a closed front and the mean are
/// taken out, so that the front turns but does not drift. The line runs against t = q x n, so that a positive twist raises it.
fn twisted(front: &EvaluatedFront, drives: &[Drive], lengths: &GrowthLengths) -> Vec<f64> {
    /// No point leaves the plane of its kink by more than this share of its advance in one step.
    const STEEPEST: f64 = 0.5;
    let (stations, n) = (&front.stations, front.stations.len());
    if lengths.twist == 0.0 || n < 2 {
        return vec![0.0; n];
    }
    let slope = |k: usize| match &stations[k] {
        s if s.is_trusted() => twist(&s.k, drives[k].kink).tan(),
        _ => 0.0,
    };
    let (mut heights, mut arc) = (vec![0.0], vec![0.0]);
    for k in 0..n {
        let next = (k + 1) % n;
        let ds = (stations[next].position - stations[k].position).norm();
        heights.push(heights[k] + 0.5 * (slope(k) + slope(next)) * ds);
        arc.push(arc[k] + ds);
    }
    let gap = if front.front.closed {
        heights[n] / arc[n].max(1e-12)
    } else {
        0.0
    };
    heights.truncate(n);
    heights
        .iter_mut()
        .zip(&arc)
        .for_each(|(h, s)| *h -= gap * s);
    let own: Vec<usize> = (0..n).filter(|&k| stations[k].is_trusted()).collect();
    let mean = own.iter().map(|&k| heights[k]).sum::<f64>() / own.len().max(1) as f64;
    let gain = lengths.twist / lengths.increment;
    let tilt = |h: f64| (gain * (h - mean)).clamp(-STEEPEST, STEEPEST);
    heights.into_iter().map(tilt).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crack::Front;

    /// A circle torn in opposite senses on its two halves tilts about the line between them: up on one side, down on the other, on
    /// no average and without a step where it closes. A circle torn all round cannot tilt.
    #[test]
    fn a_closed_front_tilts_as_a_whole() {
        let n = 36;
        let station = |k: usize, k3: f64| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
            let advance = Vec3::new(cos, sin, 0.0);
            let mut station = Station {
                position: 5.0 * advance,
                advance,
                ..Station::of_mode_one()
            };
            station.k.k3 = k3;
            station
        };
        let heights = |k3: &dyn Fn(f64) -> f64| {
            let of = |k: usize| station(k, k3(std::f64::consts::TAU * k as f64 / n as f64));
            let front = EvaluatedFront {
                front: Front {
                    sheet: 0,
                    vertices: (0..n as u32).collect(),
                    closed: true,
                },
                stations: (0..n).map(of).collect(),
            };
            let lengths = GrowthLengths {
                twist: 0.05,
                ..GrowthLengths::for_element_size(1.0)
            };
            let drives = vec![
                Drive {
                    ratio: 1.0,
                    kink: 0.0
                };
                n
            ];
            twisted(&front, &drives, &lengths)
        };
        let tilted = heights(&|w| 0.5 * w.sin());
        assert!(tilted.iter().sum::<f64>().abs() < 1e-9);
        assert!((tilted[0] + tilted[n / 2]).abs() < 1e-9 && tilted[0].abs() > 0.05);
        assert!((tilted[0] - tilted[n - 1]).abs() < 0.1 * tilted[0].abs());
        assert!(heights(&|_| 0.5).iter().all(|h| h.abs() < 1e-9));
    }

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
