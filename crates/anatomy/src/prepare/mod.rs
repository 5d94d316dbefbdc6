//! From files to a patient's folder: look, mend, mesh, measure.
mod bone;
mod files;
mod mend;
mod mesh;
mod spec;

pub use spec::{Labels, PrepareSpec};

use crate::deviation::Deviation;
use crate::diagnosis::Diagnosis;
use crate::error::AnatomyError;
use crate::folder::{MeshFigures, PatientFolder};
use crate::input::{Shape, read_shape};
use crate::mesher;
use osteotome_mechanics::geometry::MeshDistance;
use serde::Serialize;

/// What was made and found.
#[derive(Debug)]
pub struct Preparation {
    /// The patient.
    pub patient: PatientFolder,
    /// In figures and words.
    pub report: Report,
}

/// What `prepare` says about its work.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// `osteotome.prepare/1`.
    pub schema: &'static str,
    /// Units of all numbers.
    pub units: &'static str,
    /// Of the patient.
    pub name: String,
    /// What was found about the surface; absent for tetrahedra and voxels.
    pub diagnosis: Option<Diagnosis>,
    /// How far the mended surface lies from the one that was given; absent if nothing was mended.
    pub mending: Option<Deviation>,
    /// Length, breadth and height of the bone \[mm\].
    pub extent: [f64; 3],
    /// About the mesh.
    pub mesh: MeshFigures,
    /// Teeth.
    pub teeth: usize,
    /// Canals.
    pub canals: usize,
    /// Surfaces around the jaw.
    pub context: usize,
    /// What was mended or is to be known.
    pub notes: Vec<String>,
    /// What is constructed, not measured.
    pub constructed: Vec<String>,
}

/// Nodes where none are asked for.
const DEFAULT_NODES: usize = 5_000;

/// Makes a patient. `progress` gets the stage and how far all is, 0 to 1. The same files give the same bits.
///
/// # Errors
/// [`AnatomyError`], one line, for whatever makes a patient impossible.
pub fn prepare(
    spec: &PrepareSpec,
    progress: &mut dyn FnMut(&str, f64),
) -> Result<Preparation, AnatomyError> {
    if let Some(nodes) = spec.nodes {
        let [least, most] = mesher::NODE_RANGE.map(|n| n as f64);
        crate::error::in_range("--nodes", nodes as f64, least, most)?;
    }
    progress("reading", 0.0);
    let name = spec.input.display().to_string();
    for path in [Some(&spec.input), spec.teeth.as_ref()]
        .into_iter()
        .flatten()
        .chain(spec.context.iter().map(|(_, p)| p))
    {
        files::check_bytes(path)?;
    }
    let mut raw = match read_shape(&spec.input)? {
        Shape::Surface(mesh) => spec.raw_of_surface(mesh, &name, progress)?,
        Shape::Tets(file) => spec.raw_of_tets(&file.mesh, &name)?,
        Shape::Labels(volume) => spec.raw_of_labels(&volume, &name, progress)?,
    };
    progress("meshing", 0.2);
    let distance = MeshDistance::new(raw.surface.clone());
    let (mesh, target) = match (raw.mesh.take(), spec.nodes) {
        (Some(mesh), None) => {
            let n = mesh.nodes().len();
            (mesh, n)
        }
        (_, nodes) => {
            let target = nodes.unwrap_or(DEFAULT_NODES);
            let mut inner = |f: f64| progress("meshing", 0.2 + 0.6 * f);
            (
                mesh::make_mesh(&distance, &raw.frame, target, &mut inner)?,
                target,
            )
        }
    };
    progress("measuring", 0.85);
    let figures = MeshFigures::of(&mesh, target, &distance)?;
    raw.judge(&figures)?;
    spec.add_files(&mut raw, &distance)?;
    let short = spec.input.file_stem().unwrap_or_default().to_string_lossy();
    let patient = PatientFolder {
        name: spec.name.clone().unwrap_or_else(|| short.into_owned()),
        constructed: raw.constructed,
        notes: raw.notes,
        inputs: spec.inputs()?,
        surface: raw.surface,
        mesh,
        figures,
        teeth: raw.teeth,
        canals: raw.canals,
        landmarks: raw.landmarks,
        context: raw.context,
    };
    progress("measuring", 1.0);
    let report = Report {
        schema: "osteotome.prepare/1",
        units: "mm",
        name: patient.name.clone(),
        diagnosis: raw.diagnosis,
        mending: raw.mending,
        extent: patient.surface.bounds().extent().into(),
        mesh: figures,
        teeth: patient.teeth.len(),
        canals: patient.canals.len(),
        context: patient.context.len(),
        notes: patient.notes.clone(),
        constructed: patient.constructed.clone(),
    };
    Ok(Preparation { patient, report })
}
