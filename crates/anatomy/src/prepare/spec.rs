//! What a patient is to be made from.
use crate::orient::{Axes, Unit};
use std::path::{Path, PathBuf};

/// What a patient is to be made from.
#[derive(Clone, Debug)]
pub struct PrepareSpec {
    /// The bone: any of [`crate::input::FORMATS`].
    pub input: PathBuf,
    /// Of the patient; `None`: the input's file name.
    pub name: Option<String>,
    /// A surface of teeth, each a piece of its own.
    pub teeth: Option<PathBuf>,
    /// Canal files, one a side.
    pub canals: Vec<PathBuf>,
    /// A landmarks file.
    pub landmarks: Option<PathBuf>,
    /// Surfaces around the jaw, each with what it is.
    pub context: Vec<(String, PathBuf)>,
    /// Nodes of the mesh; `None`: 5,000, or those of a mesh that is given.
    pub nodes: Option<usize>,
    /// Unit of all surfaces and meshes.
    pub unit: Unit,
    /// Axes of all surfaces and meshes.
    pub axes: Axes,
    /// What the labels of a volume mean.
    pub labels: Labels,
}

impl PrepareSpec {
    /// A bone alone, with all else by default.
    pub fn of(input: &Path) -> Self {
        Self {
            input: input.to_owned(),
            name: None,
            teeth: None,
            canals: Vec::new(),
            landmarks: None,
            context: Vec::new(),
            nodes: None,
            unit: Unit::Mm,
            axes: Axes::LPS,
            labels: Labels::default(),
        }
    }
}

/// What the labels of a volume mean; by default as DentalSegmentator writes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Labels {
    /// Maxilla and upper skull.
    pub maxilla: u8,
    /// Mandible.
    pub mandible: u8,
    /// Upper teeth.
    pub upper_teeth: u8,
    /// Lower teeth.
    pub lower_teeth: u8,
    /// Mandibular canal.
    pub canal: u8,
}

impl Default for Labels {
    fn default() -> Self {
        Self {
            maxilla: 1,
            mandible: 2,
            upper_teeth: 3,
            lower_teeth: 4,
            canal: 5,
        }
    }
}
