//! How a hand moves: path, movements, smoothness.
use osteotome_mechanics::geometry::Vec3;
use std::ops::Range;

/// Length of a path \[mm\].
pub fn path_length(points: &[Vec3]) -> f64 {
    points.windows(2).map(|p| (p[1] - p[0]).norm()).sum()
}

/// Speeds between points `dt` apart \[mm/s\], smoothed over five of them.
pub fn speeds(points: &[Vec3], dt: f64) -> Vec<f64> {
    let raw: Vec<f64> = points
        .windows(2)
        .map(|p| (p[1] - p[0]).norm() / dt)
        .collect();
    let mean = |i: usize| {
        let near = &raw[i.saturating_sub(2)..(i + 3).min(raw.len())];
        near.iter().sum::<f64>() / near.len() as f64
    };
    (0..raw.len()).map(mean).collect()
}

/// A hand slower than this rests \[mm/s\].
const RESTS: f64 = 2.0;
/// What is shorter is no movement and no rest \[s\].
const SHORTEST: f64 = 0.1;

/// The movements: stretches faster than 2 mm/s that last at least .1 s, parted by rests of at least .1 s.
pub fn movements(speed: &[f64], dt: f64) -> Vec<Range<usize>> {
    let least = (SHORTEST / dt).round() as usize;
    let mut found: Vec<Range<usize>> = vec![];
    for (k, _) in speed.iter().enumerate().filter(|(_, v)| **v > RESTS) {
        match found.last_mut() {
            Some(last) if k - last.end < least => last.end = k + 1,
            _ => found.push(k..k + 1),
        }
    }
    found.retain(|m| m.len() >= least);
    found
}

/// Mean [`spectral_arc_length`] of the movements: rests between them count for nothing, so that long sessions compare with short ones.
pub fn smoothness(speed: &[f64], dt: f64) -> Option<f64> {
    let each = movements(speed, dt);
    let each = each.into_iter().map(|m| spectral_arc_length(&speed[m], dt));
    let known: Vec<f64> = each.flatten().collect();
    (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
}

/// Spectral arc length of a speed profile: the negative length of its amplitude spectrum's curve, normalised by its value
/// at 0 and by the band; 0 would be perfectly smooth, a single smooth reach has about -1.5. The band ends where the amplitude
/// stays below 5 %, at most at 10 Hz. `None` for a hand that does not move.
///
/// Source: the standard measure of Balasubramanian, Melendez-Calderon and Burdet (2012), with its usual settings.
pub fn spectral_arc_length(speed: &[f64], dt: f64) -> Option<f64> {
    const BAND: f64 = 10.0;
    const FAINT: f64 = 0.05;
    let total: f64 = speed.iter().sum();
    if speed.len() < 10 || total * dt < 0.5 {
        return None;
    }
    // Frequencies 16 times finer than the record's own.
    let df = 1.0 / (16.0 * dt * speed.len() as f64);
    let n = (BAND / df).ceil() as usize;
    let spectrum: Vec<f64> = (0..=n)
        .map(|k| amplitude(speed, std::f64::consts::TAU * df * k as f64 * dt) / total)
        .collect();
    let end = spectrum.iter().rposition(|a| *a >= FAINT)?.max(1);
    let step = 1.0 / end as f64;
    let arc = spectrum[..=end]
        .windows(2)
        .map(|a| step.hypot(a[1] - a[0]))
        .sum::<f64>();
    Some(-arc)
}

/// |sum of v_j exp(-i j angle)|.
fn amplitude(values: &[f64], angle: f64) -> f64 {
    let turn = nalgebra::Complex::from_polar(1.0, -angle);
    let mut phase = nalgebra::Complex::new(1.0, 0.0);
    let mut sum = nalgebra::Complex::new(0.0, 0.0);
    for v in values {
        sum += phase * *v;
        phase *= turn;
    }
    sum.norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minimum-jerk reach of 1 s: speed 30 (t^2 - 2 t^3 + t^4).
    fn reach(dt: f64) -> Vec<f64> {
        let at = |k: usize| {
            let t = k as f64 * dt;
            30.0 * (t * t - 2.0 * t.powi(3) + t.powi(4))
        };
        (0..=(1.0 / dt).round() as usize).map(at).collect()
    }

    #[test]
    fn a_straight_line_is_as_long_as_it_is() {
        let line: Vec<Vec3> = (0..=100)
            .map(|i| Vec3::new(0.0, 0.3 * f64::from(i), 0.4 * f64::from(i)))
            .collect();
        assert!((path_length(&line) - 50.0).abs() < 1e-9);
        assert!(speeds(&line, 0.01).iter().all(|v| (v - 50.0).abs() < 1e-9));
    }

    #[test]
    fn movements_are_parted_by_rests() {
        let profile = |parts: &[(usize, f64)]| -> Vec<f64> {
            parts.iter().flat_map(|(n, v)| vec![*v; *n]).collect()
        };
        let three = profile(&[(50, 9.0), (20, 0.0), (30, 5.0), (15, 1.0), (12, 8.0)]);
        assert_eq!(movements(&three, 0.01), [0..50, 70..100, 115..127]);
        // A rest of 50 ms parts nothing, a twitch of 50 ms is nothing.
        let short_rest = profile(&[(50, 9.0), (5, 0.0), (50, 9.0)]);
        assert_eq!(movements(&short_rest, 0.01).len(), 1);
        let twitch = profile(&[(50, 0.0), (5, 9.0), (50, 0.0)]);
        assert_eq!(movements(&twitch, 0.01), []);
    }

    #[test]
    fn smoothness_tells_one_reach_from_many() {
        let dt = 0.01;
        let one = spectral_arc_length(&reach(dt), dt).unwrap();
        // The published figure for a minimum-jerk reach with these settings is -1.41.
        assert!((one + 1.41).abs() < 0.05, "{one}");
        // Neither size nor pace counts.
        let larger: Vec<f64> = reach(dt).iter().map(|v| 7.0 * v).collect();
        assert!((spectral_arc_length(&larger, dt).unwrap() - one).abs() < 1e-9);
        assert!((spectral_arc_length(&reach(0.005), 0.01).unwrap() - one).abs() < 0.05);
        let mut many = reach(dt);
        for _ in 0..4 {
            many.extend([0.0; 40]);
            many.extend(reach(dt));
        }
        assert!(spectral_arc_length(&many, dt).unwrap() < 2.0 * one);
        // With rests between them, five smooth reaches are as smooth as one.
        let faster: Vec<f64> = many.iter().map(|v| 50.0 * v).collect();
        let each = smoothness(&faster, dt).unwrap();
        assert!((each - one).abs() < 0.1, "{each} and {one}");
        assert_eq!(smoothness(&[0.0; 100], dt), None);
        assert_eq!(spectral_arc_length(&[0.0; 100], dt), None);
    }
}
