//! Whether, how far and in which direction a crack grows: maximum strain energy release rate (MSERRC) or hoop stress (MTS).
use std::f64::consts::PI;

/// Stress intensity factors \[MPa sqrt(mm)\] in the front's frame: q outward, n normal, t = q x n.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StressIntensity {
    /// Opening.
    pub k1: f64,
    /// Sliding along q: positive turns the crack to negative angles.
    pub k2: f64,
    /// Tearing along t.
    pub k3: f64,
}

/// What a crack maximises when it chooses its direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Criterion {
    /// The energy that an infinitesimal kink releases, over the toughness in its direction.
    #[default]
    EnergyRelease,
    /// The hoop stress before the front (Erdogan & Sih 1963): K_eq = cos^3(a/2) K_I - 3 cos^2(a/2) sin(a/2) K_II, compared as
    /// K_eq^2 with the toughness in its direction. Tearing has no say in it.
    HoopStress,
}

impl StressIntensity {
    /// E' G that `criterion` sets against the toughness of a kink at `angle` \[rad\] \[MPa2 mm\].
    pub fn drive(&self, criterion: Criterion, angle: f64, poisson_ratio: f64) -> f64 {
        match criterion {
            Criterion::EnergyRelease => self.kinked_release(angle, poisson_ratio),
            Criterion::HoopStress => self.hoop_intensity(angle).max(0.0).powi(2),
        }
    }

    /// K_eq of the hoop stress at `angle` \[rad\].
    pub fn hoop_intensity(&self, angle: f64) -> f64 {
        let (s, c) = (0.5 * angle).sin_cos();
        c * c * (c * self.k1 - 3.0 * s * self.k2)
    }

    /// E' G = K_I^2 + K_II^2 + K_III^2 / (1 - nu) of straight growth \[MPa2 mm\].
    pub fn straight_release(&self, poisson_ratio: f64) -> f64 {
        self.k1 * self.k1 + self.k2 * self.k2 + self.k3 * self.k3 / (1.0 - poisson_ratio)
    }

    /// E' G(theta) of an infinitesimal kink at `angle` \[rad\]. Where the kink would close, its faces press on each other and
    /// only sliding and tearing release energy (without friction between the faces).
    ///
    /// In-plane part: series of Amestoy & Leblond (1992), good to 0.1 % up to 80 degrees. Out of plane: the factor
    /// ((1 - m) / (1 + m))^(m/2), m = angle / pi, of the antiplane problem.
    pub fn kinked_release(&self, angle: f64, poisson_ratio: f64) -> f64 {
        let m = angle / PI;
        let [f11, f12, f21, f22] = amestoy_leblond(m);
        let k1 = f11 * self.k1 + f12 * self.k2;
        let k2 = f21 * self.k1 + f22 * self.k2;
        let k1 = k1.max(0.0);
        let k3 = ((1.0 - m) / (1.0 + m)).powf(0.5 * m) * self.k3;
        k1 * k1 + k2 * k2 + k3 * k3 / (1.0 - poisson_ratio)
    }

    /// The angle \[rad\] within +-`limit` that maximises the drive of `criterion` over `toughness(theta)`, and that maximum.
    ///
    /// Scanned by the degree, then refined by parabolas to 1e-6 rad.
    pub fn preferred_kink(
        &self,
        criterion: Criterion,
        poisson_ratio: f64,
        limit: f64,
        toughness: impl Fn(f64) -> f64,
    ) -> (f64, f64) {
        let drive = |a: f64| self.drive(criterion, a, poisson_ratio) / toughness(a);
        let steps = (limit.to_degrees().floor() as i32).max(1);
        let step = limit / f64::from(steps);
        let mut best = (0.0, drive(0.0));
        for k in (-steps..=steps).filter(|k| *k != 0) {
            let a = f64::from(k) * step;
            if drive(a) > best.1 {
                best = (a, drive(a));
            }
        }
        let mut width = step;
        while width > 1e-6 {
            let [l, c, r] = [-width, 0.0, width].map(|d| drive((best.0 + d).clamp(-limit, limit)));
            let bend = l - 2.0 * c + r;
            let shift = if bend < 0.0 {
                (0.5 * width * (l - r) / bend).clamp(-width, width)
            } else {
                0.0
            };
            let a = (best.0 + shift).clamp(-limit, limit);
            if drive(a) > best.1 {
                best = (a, drive(a));
            }
            width *= 0.4;
        }
        best
    }
}

/// F11, F12, F21, F22 of Amestoy & Leblond for m = angle / pi.
fn amestoy_leblond(m: f64) -> [f64; 4] {
    let p2 = PI * PI;
    let p4 = p2 * p2;
    let p3 = p2 * PI;
    let p5 = p4 * PI;
    let p6 = p4 * p2;
    let even = |c: [f64; 11]| c.iter().rev().fold(0.0, |s, c| s * m * m + c);
    let odd = |c: [f64; 10]| m * c.iter().rev().fold(0.0, |s, c| s * m * m + c);
    [
        even([
            1.0,
            -3.0 * p2 / 8.0,
            p2 - 5.0 * p4 / 128.0,
            p2 / 9.0 - 11.0 * p4 / 72.0 + 119.0 * p6 / 15360.0,
            5.07790,
            -2.88312,
            -0.0925,
            2.996,
            -4.059,
            1.63,
            4.1,
        ]),
        odd([
            -1.5 * PI,
            10.0 * PI / 3.0 + p3 / 16.0,
            -2.0 * PI - 133.0 * p3 / 180.0 + 59.0 * p5 / 1280.0,
            12.313906,
            -7.32433,
            1.5793,
            4.0216,
            -6.915,
            4.21,
            4.56,
        ]),
        odd([
            0.5 * PI,
            -(4.0 * PI / 3.0 + p3 / 48.0),
            -2.0 * PI / 3.0 + 13.0 * p3 / 30.0 - 59.0 * p5 / 3840.0,
            -6.176023,
            4.44112,
            -1.5340,
            -2.0700,
            4.684,
            -3.95,
            -1.32,
        ]),
        even([
            1.0,
            -(4.0 + 3.0 * p2 / 8.0),
            8.0 / 3.0 + 29.0 * p2 / 18.0 - 5.0 * p4 / 128.0,
            -32.0 / 15.0 - 4.0 * p2 / 9.0 - 1159.0 * p4 / 7200.0 + 119.0 * p6 / 15360.0,
            10.58254,
            -4.78511,
            -1.8804,
            7.280,
            -7.591,
            0.25,
            12.5,
        ]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angles and releases computed from the series, to the digits of the reference table.
    #[test]
    fn kinks_match_the_table() {
        for (k1, k2, degrees, release) in [
            (1.0, 0.1, -11.25, 1.0298),
            (1.0, 0.25, -25.86, 1.1803),
            (1.0, 0.5, -42.03, 1.6678),
            (1.0, 1.0, -56.56, 3.3361),
            (0.0, 1.0, -75.75, 1.5172),
        ] {
            let k = StressIntensity { k1, k2, k3: 0.0 };
            let (angle, best) = k.preferred_kink(Criterion::EnergyRelease, 0.3, 1.4, |_| 1.0);
            assert!(
                (angle.to_degrees() - degrees).abs() < 0.02,
                "{k1}, {k2}: {}",
                angle.to_degrees()
            );
            assert!((best - release).abs() < 2e-4, "{k1}, {k2}: {best}");
        }
    }

    /// Angles and K_eq of the closed form, theta = 2 atan((K_I - sqrt(K_I^2 + 8 K_II^2)) / (4 K_II)).
    #[test]
    fn hoop_stress_kinks_match_the_closed_form() {
        for (k1, k2, degrees, k_eq) in [
            (1.0, 0.1, -11.20, 1.0147),
            (1.0, 0.25, -25.33, 1.0853),
            (1.0, 0.5, -40.21, 1.2828),
            (1.0, 1.0, -53.13, 1.7889),
            (0.0, 1.0, -70.53, 1.1547),
        ] {
            let k = StressIntensity { k1, k2, k3: 0.0 };
            let (angle, best) = k.preferred_kink(Criterion::HoopStress, 0.3, 1.4, |_| 1.0);
            assert!(
                (angle.to_degrees() - degrees).abs() < 0.01,
                "{k1}, {k2}: {angle}"
            );
            assert!((best.sqrt() - k_eq).abs() < 1e-4, "{k1}, {k2}: {best}");
        }
    }

    #[test]
    fn a_tough_direction_is_avoided_and_symmetry_kept() {
        let k = StressIntensity {
            k1: 1.0,
            k2: 0.5,
            k3: 0.0,
        };
        let (free, _) = k.preferred_kink(Criterion::EnergyRelease, 0.3, 1.2, |_| 1.0);
        let (steered, _) = k.preferred_kink(Criterion::EnergyRelease, 0.3, 1.2, |a| {
            1.0 + 3.0 * a.sin().powi(2)
        });
        assert!(steered.abs() < 0.6 * free.abs());
        let (mirrored, _) = StressIntensity { k2: -0.5, ..k }.preferred_kink(
            Criterion::EnergyRelease,
            0.3,
            1.2,
            |_| 1.0,
        );
        assert!((mirrored + free).abs() < 1e-5);
    }

    #[test]
    fn a_closing_front_releases_nothing() {
        let k = StressIntensity {
            k1: -1.0,
            k2: 0.0,
            k3: 0.0,
        };
        assert_eq!(k.kinked_release(0.0, 0.3), 0.0);
    }
}
