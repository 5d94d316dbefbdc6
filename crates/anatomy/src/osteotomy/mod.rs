//! The pre-sawn line: where the saw went in before the chisels come.
use crate::error::{AnatomyError, in_range};
use crate::stl::read_limited;
use osteotome_mechanics::geometry::{MeshDistance, Vec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

pub mod plan;
pub mod review;
pub mod technique;

pub use plan::{Plan, PlanPoint};
pub use review::{PointFigures, Review, Situation};
pub use technique::Technique;

/// Side of the patient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Negative x.
    Right,
    /// Positive x.
    Left,
}

impl Side {
    /// Sign of x on this side.
    pub fn sign(self) -> f64 {
        match self {
            Self::Right => -1.0,
            Self::Left => 1.0,
        }
    }
}

/// What a part of the line is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PartKind {
    /// The horizontal cut through the lingual cortex above the lingula.
    Medial,
    /// The sagittal cut along the external oblique ridge.
    Ridge,
    /// The vertical cut through the buccal cortex at the molars and through the lower border.
    Buccal,
    /// A part by another name.
    Other(String),
}

impl PartKind {
    /// The kind with this name.
    pub fn named(name: &str) -> Self {
        match name {
            "medial" => Self::Medial,
            "ridge" => Self::Ridge,
            "buccal" => Self::Buccal,
            other => Self::Other(other.to_owned()),
        }
    }

    /// The name in files.
    pub fn name(&self) -> &str {
        match self {
            Self::Medial => "medial",
            Self::Ridge => "ridge",
            Self::Buccal => "buccal",
            Self::Other(name) => name,
        }
    }
}

/// A point of the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    /// On the bone's surface \[mm\].
    pub at: Vec3,
    /// Unit vector from there into the bone, in the plane of the cut.
    pub toward: Vec3,
    /// How deep the saw went \[mm\].
    pub depth: f64,
}

/// One saw cut: a polyline on the surface, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct OsteotomyPart {
    /// What it is.
    pub kind: PartKind,
    /// At least two points.
    pub points: Vec<LinePoint>,
}

/// The whole pre-sawn line on one side.
#[derive(Clone, Debug, PartialEq)]
pub struct Osteotomy {
    /// Side of the patient.
    pub side: Side,
    /// Width of the saw cut \[mm\].
    pub kerf: f64,
    /// The cuts, in the order of the file; neighbours in the list meet.
    pub parts: Vec<OsteotomyPart>,
}

/// Default width of a saw cut \[mm\]: a reciprocating saw blade with its set.
pub const DEFAULT_KERF: f64 = 0.8;
/// Points further than this from the surface are refused \[mm\].
const SURFACE_TOLERANCE: f64 = 1.5;
const MAX_POINTS: usize = 10_000;

/// A point as written in a scenario or an osteotomy file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointSpec {
    /// On the surface \[mm\].
    pub at: [f64; 3],
    /// Into the bone; a unit vector.
    pub toward: [f64; 3],
    /// \[mm\].
    pub depth: f64,
    /// Name of the part; points of one part follow each other.
    pub part: String,
}

/// An osteotomy file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OsteotomyFile {
    /// Must be `mm`.
    pub units: String,
    /// Side of the patient.
    pub side: Side,
    /// Width of the saw cut \[mm\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kerf: Option<f64>,
    /// The line.
    pub points: Vec<PointSpec>,
}

/// Reads an osteotomy file (JSON).
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, not of this form, or not in mm.
pub fn read_osteotomy(path: &Path) -> Result<OsteotomyFile, AnatomyError> {
    let bytes = read_limited(path, 16 << 20)?;
    parse_osteotomy(&bytes, &path.display().to_string())
}

/// Parses an osteotomy file from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_osteotomy`].
pub fn parse_osteotomy(bytes: &[u8], name: &str) -> Result<OsteotomyFile, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "osteotomy",
        reason,
    };
    let file: OsteotomyFile = serde_json::from_slice(bytes).map_err(|e| bad(e.to_string()))?;
    if file.units != "mm" {
        return Err(bad(format!(
            "units are \"{}\"; they must be \"mm\"",
            file.units
        )));
    }
    Ok(file)
}

impl Osteotomy {
    /// Makes the line from points and checks it against the bone.
    ///
    /// Points are taken as they are, up to 1.5 mm off the surface; directions within 5 % of unit length are normalised.
    ///
    /// # Errors
    /// [`AnatomyError`] naming the first point that is off the surface, points outward, or has no unit direction or positive depth.
    pub fn from_points(
        side: Side,
        kerf: f64,
        points: &[PointSpec],
        surface: &MeshDistance,
    ) -> Result<Self, AnatomyError> {
        if points.len() < 2 || points.len() > MAX_POINTS {
            let reason = format!("{} points; a line needs 2 to {MAX_POINTS}", points.len());
            return Err(AnatomyError::Osteotomy { reason });
        }
        let mut parts: Vec<OsteotomyPart> = Vec::new();
        for (index, spec) in points.iter().enumerate() {
            let mut point = LinePoint {
                at: Vec3::from(spec.at),
                toward: Vec3::from(spec.toward),
                depth: spec.depth,
            };
            check_point(&mut point, surface).map_err(|reason| AnatomyError::OsteotomyPoint {
                index,
                part: spec.part.clone(),
                reason,
            })?;
            let kind = PartKind::named(&spec.part);
            match parts.last_mut() {
                Some(part) if part.kind == kind => part.points.push(point),
                _ => parts.push(OsteotomyPart {
                    kind,
                    points: vec![point],
                }),
            }
        }
        Self::new(side, kerf, parts, middle_of(surface))
    }

    fn new(
        side: Side,
        kerf: f64,
        parts: Vec<OsteotomyPart>,
        middle: f64,
    ) -> Result<Self, AnatomyError> {
        // Below, the walls touch; above, it is no saw cut.
        in_range("osteotomy.kerf", kerf, 0.05, 5.0)?;
        for (i, part) in parts.iter().enumerate() {
            let name = part.kind.name();
            if part.points.len() < 2 {
                let reason = format!(
                    "part \"{name}\" has one point only; each part needs two or more in a row"
                );
                return Err(AnatomyError::Osteotomy { reason });
            }
            if parts[..i].iter().any(|p| p.kind == part.kind) {
                let reason = format!(
                    "the points of part \"{name}\" do not follow each other; list each part in one run"
                );
                return Err(AnatomyError::Osteotomy { reason });
            }
        }
        let wrong = |p: &&LinePoint| (p.at.x - middle) * side.sign() < 0.0;
        let n = parts.iter().map(|p| p.points.len()).sum::<usize>();
        let n_wrong = parts.iter().flat_map(|p| &p.points).filter(wrong).count();
        if n_wrong == n && n > 0 {
            let reason = format!(
                "side is {side:?}, but all points lie on the other side of the jaw's middle at x = {middle:.1} mm (x = patient left)"
            );
            return Err(AnatomyError::Osteotomy { reason });
        }
        Ok(Self { side, kerf, parts })
    }

    /// The line as it is written to a file.
    pub fn to_file(&self) -> OsteotomyFile {
        OsteotomyFile {
            units: "mm".to_owned(),
            side: self.side,
            kerf: Some(self.kerf),
            points: self.parts.iter().flat_map(specs).collect(),
        }
    }

    /// Points of the line and where the saw's tip went: the place about which the bone splits first \[mm\].
    pub fn place(&self) -> Vec<Vec3> {
        let points = self.parts.iter().flat_map(|part| &part.points);
        points
            .flat_map(|p| [p.at, p.at + p.toward * p.depth])
            .collect()
    }

    fn by_parts(
        side: Side,
        kerf: f64,
        parts: &[OsteotomyPart],
        surface: &MeshDistance,
    ) -> Result<Self, AnatomyError> {
        let specs: Vec<_> = parts.iter().flat_map(specs).collect();
        Self::from_points(side, kerf, &specs, surface)
    }

    /// The part of one kind.
    pub fn part(&self, kind: &PartKind) -> Option<&OsteotomyPart> {
        self.parts.iter().find(|p| p.kind == *kind)
    }
}

/// Between the jaw's sides: a scan's frame need not be centred on them \[mm\].
fn middle_of(surface: &MeshDistance) -> f64 {
    surface.mesh().bounds().centre().x
}

fn specs(part: &OsteotomyPart) -> Vec<PointSpec> {
    let spec = |p: &LinePoint| PointSpec {
        at: p.at.into(),
        toward: p.toward.into(),
        depth: p.depth,
        part: part.kind.name().to_owned(),
    };
    part.points.iter().map(spec).collect()
}

/// Says what is wrong with a point, and normalises its direction.
fn check_point(p: &mut LinePoint, surface: &MeshDistance) -> Result<(), String> {
    if !p.at.iter().chain(p.toward.iter()).all(|c| c.is_finite()) {
        return Err("has a coordinate that is not a finite number".to_owned());
    }
    let length = p.toward.norm();
    if !(0.95..1.05).contains(&length) {
        return Err(format!(
            "has a direction of length {length:.3}; `toward` must be a unit vector"
        ));
    }
    p.toward /= length;
    if !(p.depth > 0.0 && p.depth <= 50.0) {
        return Err(format!(
            "has depth {}; it must be above 0 and at most 50 mm",
            p.depth
        ));
    }
    let distance = surface.signed(&p.at);
    if distance.abs() > SURFACE_TOLERANCE {
        let place = if distance > 0.0 {
            "outside the bone"
        } else {
            "inside the bone"
        };
        return Err(format!(
            "is {:.1} mm {place}; it must lie on the surface, within {SURFACE_TOLERANCE} mm",
            distance.abs()
        ));
    }
    // Half way in, or at least a little further in than at the start: thin edges let the tip come out again.
    let inside = |s: f64| surface.signed(&(p.at + p.toward * s));
    if inside(0.5 * p.depth) > 0.0 && inside(0.5 * p.depth) > distance - 0.1 {
        return Err("points out of the bone; `toward` must point into it".to_owned());
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::landmarks::Landmarks;
    use crate::mesher::contour;
    use crate::parametric::{Parameters, ParametricMandible};
    use osteotome_mechanics::geometry::SignedDistance;

    pub(crate) fn mandible(parameters: Parameters) -> (MeshDistance, Landmarks) {
        let mandible = ParametricMandible::new(parameters).unwrap();
        let surface = MeshDistance::new(contour(&mandible, 2.0).unwrap());
        let landmarks = mandible.landmarks(&surface).unwrap();
        (surface, landmarks)
    }

    #[test]
    fn hunsucks_line_runs_on_the_bone_of_any_jaw() {
        let defaults = Parameters::default();
        let jaws = [
            defaults,
            Parameters {
                scale: 0.8,
                ..defaults
            },
            Parameters {
                gonial_angle: 112.0,
                ..defaults
            },
            Parameters {
                gonial_angle: 138.0,
                ramus_thickness: 6.5,
                ..defaults
            },
        ];
        for parameters in jaws {
            let (surface, landmarks) = mandible(parameters);
            let jaw = ParametricMandible::new(parameters).unwrap();
            let teeth = jaw.teeth();
            for side in [Side::Right, Side::Left] {
                let line =
                    Osteotomy::by_technique(Technique::Hunsuck, &landmarks, side, 0.8, &surface)
                        .unwrap();
                let names: Vec<_> = line.parts.iter().map(|p| p.kind.name()).collect();
                assert_eq!(names, ["medial", "ridge", "buccal"]);
                let gap = |a: usize, b: usize| {
                    let (from, to) = (&line.parts[a].points, &line.parts[b].points);
                    (from[from.len() - 1].at - to[0].at).norm()
                };
                // In the real line the gaps are 3.2 and 2.1 mm.
                let gaps = [gap(0, 1), gap(1, 2)];
                // Nowhere over a tooth; the real line passes the second molar at about 2 mm.
                for p in line.parts.iter().flat_map(|part| &part.points) {
                    let free = teeth.iter().map(|c| c.signed(&p.at));
                    let free = free.fold(f64::INFINITY, f64::min);
                    assert!(free > 0.5, "{free} from a crown, {parameters:?}");
                }
                assert!(gaps[0] < 5.0 && gaps[1] < 2.5, "{gaps:?} {parameters:?}");
                for part in &line.parts {
                    assert!(
                        part.points.len() >= 8,
                        "{} {parameters:?}",
                        part.kind.name()
                    );
                    for pair in part.points.windows(2) {
                        let step = (pair[1].at - pair[0].at).norm();
                        assert!((0.5..3.2).contains(&step), "{step} in {}", part.kind.name());
                        assert!(pair[0].toward.dot(&pair[1].toward) > 0.5);
                    }
                    for p in &part.points {
                        assert!(surface.unsigned(&p.at) < 1e-3);
                        assert!(surface.signed(&(p.at + p.toward * 0.5)) < 0.0);
                    }
                }
                // The buccal cut goes round the lower border: it ends pointing up.
                let buccal = &line.parts[2].points;
                assert!(buccal[buccal.len() - 1].toward.z > 0.7);
            }
        }
    }

    #[test]
    fn both_sides_are_mirror_images() {
        let (surface, landmarks) = mandible(Parameters::default());
        let [right, left] = [Side::Right, Side::Left].map(|side| {
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, side, 0.8, &surface).unwrap()
        });
        for (a, b) in right.parts.iter().zip(&left.parts) {
            assert_eq!(a.points.len(), b.points.len());
            for (p, q) in a.points.iter().zip(&b.points) {
                // The lattice of the surface is not symmetric, so neither is its last half millimetre.
                assert!((p.at - Vec3::new(-q.at.x, q.at.y, q.at.z)).norm() < 0.5);
            }
        }
    }

    #[test]
    fn a_line_survives_its_file() {
        let (surface, landmarks) = mandible(Parameters::default());
        let line =
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, Side::Left, 0.6, &surface)
                .unwrap();
        let json = serde_json::to_vec(&line.to_file()).unwrap();
        let file = parse_osteotomy(&json, "line.json").unwrap();
        let kerf = file.kerf.unwrap();
        let again = Osteotomy::from_points(file.side, kerf, &file.points, &surface).unwrap();
        assert_eq!(again.kerf, 0.6);
        for (p, q) in line.parts.iter().zip(&again.parts) {
            assert_eq!(p.kind, q.kind);
            for (a, b) in p.points.iter().zip(&q.points) {
                assert!((a.at - b.at).norm() + (a.toward - b.toward).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn each_fault_names_the_point() {
        let (surface, landmarks) = mandible(Parameters::default());
        let line =
            Osteotomy::by_technique(Technique::Hunsuck, &landmarks, Side::Right, 0.8, &surface)
                .unwrap();
        let good = line.to_file().points;
        let n_medial = line.parts[0].points.len();
        let refusal = |change: &dyn Fn(&mut Vec<PointSpec>)| {
            let mut points = good.clone();
            change(&mut points);
            Osteotomy::from_points(Side::Right, 0.8, &points, &surface)
                .unwrap_err()
                .to_string()
        };
        let text = refusal(&|p| p[n_medial + 2].at[1] -= 12.0);
        let name = format!("osteotomy point {} (ridge) is ", n_medial + 2);
        assert!(
            text.starts_with(&name) && text.contains("mm outside the bone"),
            "{text}"
        );
        assert!(
            refusal(&|p| p[3].toward[0] = 1.0).contains("point 3 (medial) points out of the bone")
        );
        assert!(refusal(&|p| p[0].toward[0] = -2.0).contains("must be a unit vector"));
        assert!(refusal(&|p| p[1].depth = 0.0).contains("has depth 0"));
        assert!(refusal(&|p| p[1].at[2] = f64::NAN).contains("not a finite number"));
        assert!(refusal(&|p| p.truncate(1)).contains("needs 2 to"));
        assert!(refusal(&|p| p[5].part = "ridge".to_owned()).contains("one point only"));
        let wrong_kerf = Osteotomy::from_points(Side::Right, -1.0, &good, &surface).unwrap_err();
        assert!(
            wrong_kerf
                .to_string()
                .starts_with("osteotomy.kerf = -1 is outside")
        );
        let wrong_side = Osteotomy::from_points(Side::Left, 0.8, &good, &surface).unwrap_err();
        assert!(wrong_side.to_string().contains("side is Left"));
    }

    #[test]
    fn files_must_say_their_units() {
        let refusal = |s: &str| {
            parse_osteotomy(s.as_bytes(), "line.json")
                .unwrap_err()
                .to_string()
        };
        assert!(refusal(r#"{"side": "right", "points": []}"#).contains("missing field `units`"));
        let text = refusal(r#"{"units": "cm", "side": "right", "points": []}"#);
        assert!(
            text.ends_with("units are \"cm\"; they must be \"mm\""),
            "{text}"
        );
        assert!(refusal("{").starts_with("line.json is not a usable osteotomy file: "));
    }
}
