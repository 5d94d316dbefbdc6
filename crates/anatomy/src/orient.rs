//! Units and axes of a file, as said or as anatomy shows them.
use crate::error::AnatomyError;
use crate::landmarks::JawFrame;
use nalgebra::Matrix3;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use std::str::FromStr;

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Millimetre.
    Mm,
    /// Centimetre.
    Cm,
    /// Metre.
    M,
    /// Inch.
    Inch,
}

impl Unit {
    const ALL: [Self; 4] = [Self::Mm, Self::Cm, Self::M, Self::Inch];

    /// Its length \[mm\].
    pub fn in_mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Cm => 10.0,
            Self::M => 1000.0,
            Self::Inch => 25.4,
        }
    }

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Cm => "cm",
            Self::M => "m",
            Self::Inch => "inch",
        }
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|u| u.name() == text);
        found.ok_or_else(|| "give mm, cm, m or inch".to_owned())
    }
}

/// Axes of a file: whither x, y and z point, as in LPS or RAS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    letters: [u8; 3],
    to_lps: Matrix3<f64>,
}

impl Axes {
    /// The house's own.
    pub const LPS: Self = Self {
        letters: *b"LPS",
        to_lps: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    };

    /// The three letters.
    pub fn name(&self) -> String {
        String::from_utf8_lossy(&self.letters).into_owned()
    }

    /// A place in LPS.
    pub fn to_lps(&self, p: &Vec3) -> Vec3 {
        self.to_lps * p
    }

    /// Whether they are left-handed, so that what is read by them is a mirror image of its numbers.
    pub fn is_mirrored(&self) -> bool {
        self.to_lps.determinant() < 0.0
    }

    /// Turns a mesh into LPS and mm, its normals kept outward.
    pub fn apply(&self, unit: Unit, mesh: &mut TriMesh) {
        let turn = self.to_lps * unit.in_mm();
        mesh.vertices.iter_mut().for_each(|p| *p = turn * *p);
        if self.is_mirrored() {
            mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "give three letters that say whither x, y and z point, of L/R, A/P and S/I, like LPS or RAS"
                .to_owned()
        };
        let letters: [u8; 3] = text
            .to_uppercase()
            .into_bytes()
            .try_into()
            .map_err(|_| wrong())?;
        let mut to_lps = Matrix3::zeros();
        for (column, letter) in letters.iter().enumerate() {
            let (row, sign) = match letter {
                b'L' => (0, 1.0),
                b'R' => (0, -1.0),
                b'P' => (1, 1.0),
                b'A' => (1, -1.0),
                b'S' => (2, 1.0),
                b'I' => (2, -1.0),
                _ => return Err(wrong()),
            };
            to_lps[(row, column)] = sign;
        }
        if to_lps.determinant() == 0.0 {
            return Err(wrong());
        }
        Ok(Self { letters, to_lps })
    }
}

/// A mandible's largest extent lies between these \[mm\]: from a small child's to beyond any adult's.
const EXTENTS: [f64; 2] = [55.0, 190.0];

/// Looks whether a surface, in mm and LPS as it claims, has the size of a mandible and lies as one: condyles up and behind, chin in front.
/// A mirror image cannot be told.
///
/// # Errors
/// [`AnatomyError::Units`] or [`AnatomyError::Axes`] where other units or axes make it a mandible, and what is wrong otherwise.
pub fn look(mesh: &TriMesh, name: &str) -> Result<JawFrame, AnatomyError> {
    let extent = mesh.bounds().extent();
    let is_size = |mm: f64| (EXTENTS[0]..=EXTENTS[1]).contains(&(extent.max() * mm));
    if !is_size(1.0) {
        let is_one = |unit: &Unit| {
            let mut scaled = mesh.clone();
            Axes::LPS.apply(*unit, &mut scaled);
            upright(&scaled, name).is_ok() || other_axes(&scaled, name).is_some()
        };
        let other = [Unit::Cm, Unit::M, Unit::Inch]
            .into_iter()
            .find(|u| is_size(u.in_mm()) && is_one(u));
        let mend = other.map_or_else(
            || "give the bone alone, in one piece, in mm".to_owned(),
            |u| format!("it would be one in {0}; say --unit {0}", u.name()),
        );
        return Err(AnatomyError::Units {
            name: name.to_owned(),
            extent,
            mend,
        });
    }
    if extent.min() < LEAST_HEIGHT * extent.max() {
        return Err(AnatomyError::NotAMandible {
            name: name.to_owned(),
            reason: "it is too flat to have rami".to_owned(),
        });
    }
    upright(mesh, name).map_err(|error| match other_axes(mesh, name) {
        Some(letters) => AnatomyError::Axes {
            name: name.to_owned(),
            letters,
        },
        None => error,
    })
}

/// Axes, other than LPS, in which the surface would lie as a mandible does.
fn other_axes(mesh: &TriMesh, name: &str) -> Option<&'static str> {
    let lies_right = |letters: &&str| {
        let mut turned = mesh.clone();
        letters.parse::<Axes>().is_ok_and(|axes| {
            axes.apply(Unit::Mm, &mut turned);
            upright(&turned, name).is_ok()
        })
    };
    [
        "RAS", "LSA", "RSP", "LAI", "RPI", "LIP", "PSL", "ASR", "SLP", "SRA",
    ]
    .into_iter()
    .find(lies_right)
}

/// A mandible is at least so thick in its smallest extent, relative to its largest: the gums of a lower jaw are flatter (.48).
const LEAST_HEIGHT: f64 = 0.5;
/// At most so much of a mandible's surface lies near the midline in its hindmost half: it is open there.
const SHARE_BETWEEN: f64 = 0.02;

/// The frame of a mandible that does not stand on its head: the front is lower than the back, between the rami is nothing.
fn upright(mesh: &TriMesh, name: &str) -> Result<JawFrame, AnatomyError> {
    let frame = JawFrame::find(mesh, name)?;
    let refuse = |reason: &str| {
        Err(AnatomyError::NotAMandible {
            name: name.to_owned(),
            reason: reason.to_owned(),
        })
    };
    let (low, size) = (mesh.bounds().min, mesh.bounds().extent());
    let place = |t: usize| {
        let centre = mesh.corners(t).iter().sum::<Vec3>() / 3.0 - low;
        (centre.component_div(&size), mesh.area_normal(t).norm())
    };
    let (mut front, mut between, mut all) = ([0.0; 2], 0.0, 0.0);
    for (at, area) in (0..mesh.triangles.len()).map(place) {
        all += area;
        if at.y < 0.25 {
            front = [front[0] + area * at.z, front[1] + area];
        }
        if at.y > 0.5 && (at.x - 0.5).abs() < 0.1 {
            between += area;
        }
    }
    if front[0] > 0.5 * front[1] {
        return refuse("its front lies above the middle of its height");
    }
    if between > SHARE_BETWEEN * all {
        return refuse("there is bone between its rami");
    }
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesher::contour;
    use crate::parametric::{Parameters, ParametricMandible};

    fn jaw() -> TriMesh {
        contour(
            &ParametricMandible::new(Parameters::default()).unwrap(),
            3.0,
        )
        .unwrap()
    }

    #[test]
    fn wrong_units_are_named() {
        for (unit, factor) in [("cm", 0.1), ("m", 1e-3), ("inch", 1.0 / 25.4)] {
            let mut mesh = jaw();
            mesh.vertices.iter_mut().for_each(|p| *p *= factor);
            let text = look(&mesh, "jaw.stl").unwrap_err().to_string();
            assert!(text.contains(&format!("--unit {unit}")), "{text}");
            Axes::LPS.apply(unit.parse().unwrap(), &mut mesh);
            look(&mesh, "jaw.stl").unwrap();
        }
    }

    /// A tooth of 18 mm would have a mandible's size in cm; and an arch without rami is none.
    #[test]
    fn what_is_no_mandible_in_any_unit_is_not_called_one() {
        let mut block = jaw();
        block.vertices.iter_mut().for_each(|p| *p *= 0.15);
        for p in &mut block.vertices {
            p.x *= 0.1;
        }
        let text = look(&block, "molar.stl").unwrap_err().to_string();
        assert!(text.contains("give the bone alone"), "{text}");
        let mut arch = jaw();
        arch.vertices.iter_mut().for_each(|p| p.z *= 0.4);
        let text = look(&arch, "gums.stl").unwrap_err().to_string();
        assert!(text.contains("too flat to have rami"), "{text}");
    }

    #[test]
    fn wrong_axes_are_named() {
        for letters in ["RAS", "LSA", "LAI"] {
            let axes: Axes = letters.parse().unwrap();
            let mut mesh = jaw();
            let back = axes.to_lps.transpose();
            mesh.vertices.iter_mut().for_each(|p| *p = back * *p);
            let text = look(&mesh, "jaw.stl").unwrap_err().to_string();
            assert!(text.contains(&format!("--axes {letters}")), "{text}");
            axes.apply(Unit::Mm, &mut mesh);
            look(&mesh, "jaw.stl").unwrap();
            assert!(mesh.volume() > 0.0);
        }
    }

    #[test]
    fn letters_are_checked() {
        for wrong in ["LP", "LLS", "XYZ", "LPSX"] {
            assert!(
                wrong
                    .parse::<Axes>()
                    .unwrap_err()
                    .contains("like LPS or RAS")
            );
        }
        let mirrored: Axes = "RPS".parse().unwrap();
        let mut mesh = jaw();
        let volume = mesh.volume();
        mirrored.apply(Unit::Mm, &mut mesh);
        assert!((mesh.volume() / volume - 1.0).abs() < 1e-9);
    }
}
