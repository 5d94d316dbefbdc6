//! The mandibular canal, in which the inferior alveolar nerve runs.
use crate::error::AnatomyError;
use crate::osteotomy::Side;
use crate::stl::read_limited;
use osteotome_mechanics::geometry::Vec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The canal of one side.
#[derive(Clone, Debug, PartialEq)]
pub struct Canal {
    /// Side of the patient.
    pub side: Side,
    /// Centre line from the mandibular to the mental foramen \[mm, LPS\].
    pub line: Vec<Vec3>,
    /// Half its width \[mm\].
    pub radius: f64,
    /// Whether it was placed by published mean distances rather than seen in images.
    pub is_constructed: bool,
}

/// Middle of the published range of diameters, 2.6 to 3.0 mm.
pub const MEAN_DIAMETER: f64 = 2.8;
const MAX_POINTS: usize = 10_000;

/// A canal file (JSON).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanalFile {
    /// Must be `mm`.
    pub units: String,
    /// Side of the patient.
    pub side: Side,
    /// Width \[mm\].
    #[serde(default = "mean_diameter")]
    pub diameter: f64,
    /// Whether it was placed by mean distances rather than seen in images.
    #[serde(default)]
    pub constructed: bool,
    /// Centre line, LPS.
    pub points: Vec<[f64; 3]>,
}

impl Canal {
    /// The canal as it is written to a file.
    pub fn to_file(&self) -> CanalFile {
        CanalFile {
            units: "mm".to_owned(),
            side: self.side,
            diameter: 2.0 * self.radius,
            constructed: self.is_constructed,
            points: self.line.iter().map(|p| (*p).into()).collect(),
        }
    }
}

fn mean_diameter() -> f64 {
    MEAN_DIAMETER
}

/// Reads a canal file (JSON).
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, not of this form, or not in mm.
pub fn read_canal(path: &Path) -> Result<Canal, AnatomyError> {
    parse_canal(&read_limited(path, 4 << 20)?, &path.display().to_string())
}

/// Parses a canal file from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_canal`].
pub fn parse_canal(bytes: &[u8], name: &str) -> Result<Canal, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "canal",
        reason,
    };
    let file: CanalFile = serde_json::from_slice(bytes).map_err(|e| bad(e.to_string()))?;
    if file.units != "mm" {
        return Err(bad(format!(
            "units are \"{}\"; they must be \"mm\"",
            file.units
        )));
    }
    if !(0.5..=10.0).contains(&file.diameter) {
        return Err(bad(format!(
            "the diameter is {}; it must be between 0.5 and 10 mm",
            file.diameter
        )));
    }
    let n = file.points.len();
    if !(2..=MAX_POINTS).contains(&n) || !file.points.iter().flatten().all(|c| c.is_finite()) {
        return Err(bad(format!(
            "{n} points; a canal needs 2 to {MAX_POINTS}, of finite numbers"
        )));
    }
    Ok(Canal {
        side: file.side,
        line: file.points.into_iter().map(Vec3::from).collect(),
        radius: 0.5 * file.diameter,
        is_constructed: file.constructed,
    })
}

impl Canal {
    /// Refuses a canal whose name for its side and whose place contradict each other; `middle`: x between the jaw's sides \[mm\].
    ///
    /// # Errors
    /// [`AnatomyError::Format`] if all of it lies on the other side.
    pub fn check_side(&self, middle: f64, name: &str) -> Result<(), AnatomyError> {
        let is_wrong = |p: &Vec3| (p.x - middle) * self.side.sign() < 0.0;
        if !self.line.iter().all(is_wrong) {
            return Ok(());
        }
        let [said, found] = match self.side {
            Side::Right => ["right", "left"],
            Side::Left => ["left", "right"],
        };
        Err(AnatomyError::Format {
            path: name.to_owned(),
            format: "canal",
            reason: format!(
                "it is called the {said} one, but lies on the patient's {found} (x points to the left, LPS); say \"side\": \"{found}\", or mirror its points"
            ),
        })
    }
}

/// A smooth line through points (Catmull-Rom), with `steps` pieces between two.
pub(crate) fn smooth_line(points: &[Vec3], steps: usize) -> Vec<Vec3> {
    let at = |i: isize| points[i.clamp(0, points.len() as isize - 1) as usize];
    let mut line = Vec::new();
    for i in 0..points.len() as isize - 1 {
        let [a, b, c, d] = [at(i - 1), at(i), at(i + 1), at(i + 2)];
        let (u, v) = ((c - a) * 0.5, (d - b) * 0.5);
        line.extend((0..steps).map(|k| {
            let t = k as f64 / steps as f64;
            let (t2, t3) = (t * t, t * t * t);
            b * (2.0 * t3 - 3.0 * t2 + 1.0)
                + u * (t3 - 2.0 * t2 + t)
                + c * (3.0 * t2 - 2.0 * t3)
                + v * (t3 - t2)
        }));
    }
    line.extend(points.last());
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parametric::{Parameters, ParametricMandible};
    use osteotome_mechanics::geometry::SignedDistance;

    #[test]
    fn the_built_in_canal_lies_where_it_was_measured() {
        for (scale, gonial_angle) in [(1.0, 124.8), (0.75, 115.0), (1.2, 135.0)] {
            let parameters = Parameters {
                scale,
                gonial_angle,
                ..Parameters::default()
            };
            let mandible = ParametricMandible::new(parameters).unwrap();
            for canal in mandible.canals() {
                let depth: Vec<f64> = canal.line.iter().map(|p| -mandible.signed(p)).collect();
                let n = depth.len();
                // Out at both foramina, and within the bone between them.
                assert!(depth[0] < 2.0 * scale && depth[n - 1] < 2.0 * scale);
                let least = depth[n / 6..n - n / 6].iter().copied().fold(9.0, f64::min);
                assert!(least > 2.0 * scale, "{least}: {depth:?}");
                assert!(canal.is_constructed);
                let sign = canal.side.sign();
                assert!(canal.line.iter().all(|p| p.x * sign > 0.0));
            }
        }
    }

    #[test]
    fn wrong_canal_files_are_named() {
        let folder = std::env::temp_dir().join(format!("osteotome-canal-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("canal.json");
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_canal(&path).unwrap_err().to_string()
        };
        let inch = error(r#"{"units":"inch","side":"left","points":[[0,0,0],[1,0,0]]}"#);
        assert!(inch.contains("inch") && inch.contains("mm"), "{inch}");
        let few = error(r#"{"units":"mm","side":"left","points":[[0,0,0]]}"#);
        assert!(few.contains("1 points"), "{few}");
        let wide =
            error(r#"{"units":"mm","side":"left","diameter":99,"points":[[0,0,0],[1,0,0]]}"#);
        assert!(wide.contains("99"), "{wide}");
        std::fs::write(
            &path,
            r#"{"units":"mm","side":"left","points":[[0,0,0],[1,0,0]]}"#,
        )
        .unwrap();
        let canal = read_canal(&path).unwrap();
        assert_eq!((canal.line.len(), canal.is_constructed), (2, false));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
