use super::Vec3;

/// Closest point of a triangle to `p`, as barycentric coordinates (Ericson 2005, section 5.1.5).
pub fn closest_on_triangle(p: &Vec3, [a, b, c]: &[Vec3; 3]) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

/// Where the segment from `p` to `q` crosses a triangle, as the share of its length; `None` if it does not.
///
/// Inclusive at the border by `TOLERANCE`, so that a segment through the shared edge of two triangles never slips between.
pub fn segment_crosses(p: &Vec3, q: &Vec3, [a, b, c]: &[Vec3; 3]) -> Option<f64> {
    const TOLERANCE: f64 = 1e-9;
    let (d, ab, ac) = (q - p, b - a, c - a);
    let h = d.cross(&ac);
    let det = ab.dot(&h);
    if det.abs() < 1e-14 * d.norm() * ab.norm() * ac.norm() {
        return None;
    }
    let s = p - a;
    let u = s.dot(&h) / det;
    let k = s.cross(&ab);
    let v = d.dot(&k) / det;
    if u < -TOLERANCE || v < -TOLERANCE || u + v > 1.0 + TOLERANCE {
        return None;
    }
    let t = ac.dot(&k) / det;
    (-TOLERANCE..=1.0 + TOLERANCE).contains(&t).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [Vec3; 3] = [
        Vec3::new(0.0, 0.0, 0.0),
        Vec3::new(2.0, 0.0, 0.0),
        Vec3::new(0.0, 1.0, 0.0),
    ];

    #[test]
    fn closest_point_beats_every_sample() {
        for i in 0..200 {
            let f = f64::from(i);
            let p = Vec3::new(
                (f * 0.7).sin() * 3.0,
                (f * 1.3).cos() * 2.0,
                (f * 0.37).sin(),
            );
            let w = closest_on_triangle(&p, &TRIANGLE);
            let d = |w: [f64; 3]| ((0..3).map(|k| TRIANGLE[k] * w[k]).sum::<Vec3>() - p).norm();
            for k in 0..=20 {
                for l in 0..=20 - k {
                    let s = [
                        f64::from(k) / 20.0,
                        f64::from(l) / 20.0,
                        f64::from(20 - k - l) / 20.0,
                    ];
                    assert!(d(w) <= d(s) + 1e-12);
                }
            }
        }
    }

    #[test]
    fn crossing_is_found_and_missed() {
        let hit = segment_crosses(
            &Vec3::new(0.5, 0.2, -1.0),
            &Vec3::new(0.5, 0.2, 3.0),
            &TRIANGLE,
        );
        assert!((hit.unwrap() - 0.25).abs() < 1e-12);
        let miss = segment_crosses(
            &Vec3::new(1.5, 0.6, -1.0),
            &Vec3::new(1.5, 0.6, 3.0),
            &TRIANGLE,
        );
        assert_eq!(miss, None);
        let short = segment_crosses(
            &Vec3::new(0.5, 0.2, -1.0),
            &Vec3::new(0.5, 0.2, -0.1),
            &TRIANGLE,
        );
        assert_eq!(short, None);
    }
}
