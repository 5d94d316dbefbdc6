//! Named places on a mandible, and finding them on a surface that comes without.
use crate::error::AnatomyError;
use crate::stl::read_limited;
use osteotome_mechanics::geometry::{MeshDistance, TriMesh, Vec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Named places on one side \[mm, LPS\].
#[derive(Clone, Debug, PartialEq)]
pub struct SideLandmarks {
    /// Middle of the condyle's head, inside the bone.
    pub condyle_centre: Vec3,
    /// Highest point of the condyle.
    pub condyle_top: Vec3,
    /// Tip of the coronoid process.
    pub coronoid_tip: Vec3,
    /// Deepest point of the notch between them.
    pub sigmoid_notch: Vec3,
    /// Corner between the lower and the posterior border.
    pub gonion: Vec3,
    /// Above the mandibular foramen, on the medial surface of the ramus.
    pub lingula: Vec3,
    /// From the ramus' front edge above the lingula down to the second molar.
    pub external_oblique_ridge: Vec<Vec3>,
    /// On the crest, at the cheek side of the second molar.
    pub second_molar_buccal: Vec3,
    /// On the lower border under the second molar, where the buccal cut ends.
    pub lower_border: Vec3,
}

/// Named places on a mandible \[mm, LPS\].
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    /// Lowest point of the chin in the midline.
    pub menton: Vec3,
    /// The patient's right side (negative x).
    pub right: SideLandmarks,
    /// The patient's left side.
    pub left: SideLandmarks,
}

/// A landmarks file (JSON). Names that are not listed here are passed over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarksFile {
    /// Must be `mm`; LPS.
    pub units: String,
    /// As in [`Landmarks`].
    pub menton: [f64; 3],
    /// The patient's right side.
    pub right: SideFile,
    /// The patient's left side.
    pub left: SideFile,
}

/// One side of a landmarks file; as [`SideLandmarks`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct SideFile {
    pub condyle_centre: [f64; 3],
    pub condyle_top: [f64; 3],
    pub coronoid_tip: [f64; 3],
    pub sigmoid_notch: [f64; 3],
    pub gonion: [f64; 3],
    pub lingula: [f64; 3],
    pub external_oblique_ridge: Vec<[f64; 3]>,
    pub second_molar_buccal: [f64; 3],
    #[serde(alias = "buccal_cut_lower_border")]
    pub lower_border: [f64; 3],
}

impl From<&SideLandmarks> for SideFile {
    fn from(s: &SideLandmarks) -> Self {
        Self {
            condyle_centre: s.condyle_centre.into(),
            condyle_top: s.condyle_top.into(),
            coronoid_tip: s.coronoid_tip.into(),
            sigmoid_notch: s.sigmoid_notch.into(),
            gonion: s.gonion.into(),
            lingula: s.lingula.into(),
            external_oblique_ridge: s
                .external_oblique_ridge
                .iter()
                .map(|p| (*p).into())
                .collect(),
            second_molar_buccal: s.second_molar_buccal.into(),
            lower_border: s.lower_border.into(),
        }
    }
}

impl From<&SideFile> for SideLandmarks {
    fn from(s: &SideFile) -> Self {
        Self {
            condyle_centre: s.condyle_centre.into(),
            condyle_top: s.condyle_top.into(),
            coronoid_tip: s.coronoid_tip.into(),
            sigmoid_notch: s.sigmoid_notch.into(),
            gonion: s.gonion.into(),
            lingula: s.lingula.into(),
            external_oblique_ridge: s
                .external_oblique_ridge
                .iter()
                .map(|p| (*p).into())
                .collect(),
            second_molar_buccal: s.second_molar_buccal.into(),
            lower_border: s.lower_border.into(),
        }
    }
}

impl Landmarks {
    /// As they are written to a file.
    pub fn to_file(&self) -> LandmarksFile {
        LandmarksFile {
            units: "mm".to_owned(),
            menton: self.menton.into(),
            right: (&self.right).into(),
            left: (&self.left).into(),
        }
    }

    /// All of them, with names for messages.
    pub fn named(&self) -> Vec<(String, Vec3)> {
        let mut all = vec![("menton".to_owned(), self.menton)];
        for (side, s) in [("right", &self.right), ("left", &self.left)] {
            let on_surface = [
                ("condyle_top", s.condyle_top),
                ("coronoid_tip", s.coronoid_tip),
                ("sigmoid_notch", s.sigmoid_notch),
                ("gonion", s.gonion),
                ("lingula", s.lingula),
                ("second_molar_buccal", s.second_molar_buccal),
                ("lower_border", s.lower_border),
            ];
            all.extend(on_surface.map(|(name, p)| (format!("{side}.{name}"), p)));
            let ridge = s.external_oblique_ridge.iter().enumerate();
            all.extend(ridge.map(|(i, p)| (format!("{side}.external_oblique_ridge.{i}"), *p)));
        }
        all
    }
}

/// Reads a landmarks file.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, not of this form, or not in mm.
pub fn read_landmarks(path: &Path) -> Result<Landmarks, AnatomyError> {
    parse_landmarks(&read_limited(path, 4 << 20)?, &path.display().to_string())
}

/// Parses a landmarks file from memory; `name` is for error texts.
///
/// # Errors
/// As [`read_landmarks`].
pub fn parse_landmarks(bytes: &[u8], name: &str) -> Result<Landmarks, AnatomyError> {
    let bad = |reason: String| AnatomyError::Format {
        path: name.to_owned(),
        format: "landmarks",
        reason,
    };
    let file: LandmarksFile = serde_json::from_slice(bytes).map_err(|e| bad(e.to_string()))?;
    if file.units != "mm" {
        let units = file.units;
        return Err(bad(format!("units are \"{units}\"; they must be \"mm\"")));
    }
    let landmarks = Landmarks {
        menton: file.menton.into(),
        right: (&file.right).into(),
        left: (&file.left).into(),
    };
    // A mirror image looks like another jaw; names on the wrong side do not.
    let [right, left] =
        [&landmarks.right, &landmarks.left].map(|s| s.condyle_centre.x + s.gonion.x);
    if right > left {
        return Err(bad(
            "what is called right lies on the patient's left (x points to the left, LPS); swap right and left, or mirror x of all points"
                .to_owned(),
        ));
    }
    Ok(landmarks)
}

/// The frame of a mandible, found on any surface: enough for supports and the run of the osteons.
#[derive(Clone, Debug, PartialEq)]
pub struct JawFrame {
    /// Condyle centres, right and left.
    pub condyles: [Vec3; 2],
    /// Corners of the jaw, right and left.
    pub gonions: [Vec3; 2],
    /// Centre line of the bone from the right condyle over gonion and chin to the left condyle.
    pub path: Vec<Vec3>,
}

/// The first point of the surface met from `origin`, outside, along the unit vector `direction`, within 200 mm.
pub fn cast(surface: &MeshDistance, origin: &Vec3, direction: &Vec3) -> Option<Vec3> {
    const TOLERANCE: f64 = 1e-4;
    let mut along = 0.0;
    for _ in 0..400 {
        let p = origin + direction * along;
        let d = surface.signed(&p);
        if d < TOLERANCE {
            return Some(p);
        }
        along += d;
        if along > 200.0 {
            break;
        }
    }
    None
}

impl JawFrame {
    /// Finds condyles (the highest bump at the back of each side), jaw corners and centre line of a mandible in the LPS frame.
    ///
    /// # Errors
    /// [`AnatomyError::NotAMandible`] if the back of the surface has no two bumps well apart and high.
    pub fn find(surface: &TriMesh, name: &str) -> Result<Self, AnatomyError> {
        let refuse = |reason: String| AnatomyError::NotAMandible {
            name: name.to_owned(),
            reason,
        };
        let patches = Patches::new(surface);
        let bounds = surface.bounds();
        let (middle, size) = (bounds.centre(), bounds.extent());
        let mut condyles = [Vec3::zeros(); 2];
        let mut gonions = condyles;
        for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
            let name = ["right", "left"][side];
            let on_side = |p: &Vec3| sign * (p.x - middle.x) > 0.15 * size.x;
            // The condyles are in the hindmost third, the coronoids before it.
            let top = patches
                .highest(&Vec3::z(), |p| {
                    on_side(p) && p.y > bounds.max.y - size.y / 3.0
                })
                .ok_or_else(|| refuse(format!("nothing at the back of the {name} side")))?;
            if top.z < middle.z + 0.2 * size.z {
                return Err(refuse(format!(
                    "no condyle high at the back of the {name} side"
                )));
            }
            let head = patches
                .centre(|p| (p - top).xy().norm() < 0.14 * size.z && top.z - p.z < 0.12 * size.z);
            condyles[side] = head.unwrap_or(top);
            let down_and_back = Vec3::new(0.0, 1.0, -1.0).normalize();
            gonions[side] = patches
                .highest(&down_and_back, on_side)
                .ok_or_else(|| refuse(format!("no jaw angle on the {name} side")))?;
            if gonions[side].z > condyles[side].z - 0.2 * size.z {
                return Err(refuse(format!(
                    "the jaw angle of the {name} side is not below its condyle"
                )));
            }
        }
        // Wide apart, unlike the two halves of a chin that lies at the back.
        let width = condyles[1].x - condyles[0].x;
        if width < 0.6 * size.x {
            return Err(refuse(format!(
                "its highest points at the back are only {width:.0} mm apart"
            )));
        }
        let path = centre_line(&patches, &bounds.min, &size, condyles, gonions);
        Ok(Self {
            condyles,
            gonions,
            path,
        })
    }

    /// Direction of the jaw's centre line near `p`, smoothly blended between its segments; a unit vector.
    pub fn along(&self, p: &Vec3) -> Vec3 {
        let mut sum = Vec3::zeros();
        for pair in self.path.windows(2) {
            let edge = pair[1] - pair[0];
            let length = edge.norm();
            if length < 1e-9 {
                continue;
            }
            let s = ((p - pair[0]).dot(&edge) / (length * length)).clamp(0.0, 1.0);
            let d2 = (p - pair[0] - edge * s).norm_squared();
            // Softened over about 5 mm, so that the direction turns gradually at the jaw angle.
            sum += edge / (d2 + 25.0).powi(2);
        }
        sum.try_normalize(1e-12).unwrap_or_else(Vec3::y)
    }
}

/// Triangle centres and areas.
struct Patches<'a> {
    vertices: &'a [Vec3],
    centres: Vec<(Vec3, f64)>,
}

impl<'a> Patches<'a> {
    fn new(surface: &'a TriMesh) -> Self {
        let patch = |t: usize| {
            let [a, b, c] = surface.corners(t);
            ((a + b + c) / 3.0, 0.5 * surface.area_normal(t).norm())
        };
        Self {
            vertices: &surface.vertices,
            centres: (0..surface.triangles.len()).map(patch).collect(),
        }
    }

    fn highest(&self, up: &Vec3, keep: impl Fn(&Vec3) -> bool) -> Option<Vec3> {
        self.vertices
            .iter()
            .filter(|p| keep(p))
            .max_by(|a, b| a.dot(up).total_cmp(&b.dot(up)))
            .copied()
    }

    /// Area centre of the patches that are kept.
    fn centre(&self, keep: impl Fn(&Vec3) -> bool) -> Option<Vec3> {
        let mut sum = (Vec3::zeros(), 0.0);
        for (p, area) in self.centres.iter().filter(|(p, _)| keep(p)) {
            sum = (sum.0 + p * *area, sum.1 + area);
        }
        (sum.1 > 0.0).then(|| sum.0 / sum.1)
    }
}

fn centre_line(
    patches: &Patches,
    low: &Vec3,
    size: &Vec3,
    condyles: [Vec3; 2],
    gonions: [Vec3; 2],
) -> Vec<Vec3> {
    const SLICES: usize = 6;
    let middle = low.x + 0.5 * size.x;
    let side = |k: usize, sign: f64| {
        let (condyle, gonion) = (condyles[k], gonions[k]);
        // The body proper: forward of the jaw angle and below the middle of the ramus.
        let (back, roof) = (gonion.y - 0.15 * size.y, 0.5 * (gonion.z + condyle.z));
        let front = low.y + 0.08 * size.y;
        let step = (back - front) / SLICES as f64;
        // Just inside the jaw angle.
        let corner = gonion + Vec3::new(0.0, -0.1 * size.y, 0.12 * size.z);
        let mut path = vec![condyle, corner];
        for i in (0..SLICES).rev() {
            let y = front + step * i as f64;
            path.extend(patches.centre(|p| {
                sign * (p.x - middle) > 0.0 && (y..y + step).contains(&p.y) && p.z < roof
            }));
        }
        path
    };
    let mut path = side(0, -1.0);
    path.extend(
        patches.centre(|p| (p.x - middle).abs() < 0.1 * size.x && p.y < low.y + 0.3 * size.y),
    );
    path.extend(side(1, 1.0).into_iter().rev());
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesher::contour;
    use crate::parametric::{Parameters, ParametricMandible};

    #[test]
    fn condyles_are_found_without_landmarks() {
        for scale in [0.75, 1.0, 1.25] {
            for gonial_angle in [112.0, 124.8, 138.0] {
                let parameters = Parameters {
                    scale,
                    gonial_angle,
                    ..Parameters::default()
                };
                let mandible = ParametricMandible::new(parameters).unwrap();
                let mut surface = contour(&mandible, 2.5 * scale).unwrap();
                // Far from the origin, as scans are.
                let shift = Vec3::new(20.0, -140.0, 1480.0);
                surface.vertices.iter_mut().for_each(|p| *p += shift);
                let frame = JawFrame::find(&surface, "jaw").unwrap();
                let half = 0.5 * parameters.condyle_distance * scale;
                for (found, sign) in frame.condyles.iter().zip([-1.0, 1.0]) {
                    let want = Vec3::new(sign * half, 0.0, 0.0) + shift;
                    assert!((found - want).norm() < 2.0, "{found} instead of {want}");
                }
            }
        }
    }

    #[test]
    fn osteons_run_along_the_body_and_up_the_ramus() {
        let mandible = ParametricMandible::new(Parameters::default()).unwrap();
        let surface = contour(&mandible, 2.5).unwrap();
        let frame = JawFrame::find(&surface, "jaw").unwrap();
        let distance = MeshDistance::new(surface);
        let marks = mandible.landmarks(&distance).unwrap();
        // At the chin across, in the ramus steeply up, at the molars along the arch.
        assert!(frame.along(&marks.menton).x.abs() > 0.9);
        assert!(frame.along(&marks.right.lingula).z.abs() > 0.7);
        let molar = frame.along(&marks.right.second_molar_buccal);
        assert!(molar.z.abs() < 0.7 && molar.xy().norm() > 0.7, "{molar}");
    }

    #[test]
    fn swapped_sides_are_noticed() {
        let mandible = ParametricMandible::new(Parameters::default()).unwrap();
        let surface = contour(&mandible, 2.5).unwrap();
        let marks = mandible.landmarks(&MeshDistance::new(surface)).unwrap();
        let mut file = marks.to_file();
        let parse = |f: &LandmarksFile| parse_landmarks(&serde_json::to_vec(f).unwrap(), "marks");
        assert_eq!(parse(&file).unwrap(), marks);
        std::mem::swap(&mut file.right, &mut file.left);
        let text = parse(&file).unwrap_err().to_string();
        assert!(
            text.contains("called right lies on the patient's left"),
            "{text}"
        );
    }

    #[test]
    fn other_things_are_refused() {
        let ball = crate::surface::tests::tetrahedron();
        let text = JawFrame::find(&ball, "lump.stl").unwrap_err().to_string();
        assert!(
            text.starts_with("lump.stl does not look like a mandible"),
            "{text}"
        );
    }
}
