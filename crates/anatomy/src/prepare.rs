//! From files to a patient's folder: look, mend, mesh, measure.
use crate::canal::read_canal;
use crate::canal_label::canals;
use crate::deviation::Deviation;
use crate::diagnosis::{Diagnosis, closed_contour, solidify};
use crate::error::AnatomyError;
use crate::fit::fit;
use crate::folder::{DEVIATION_AIM, InputFile, MeshFigures, PatientFolder, VOLUME_TOLERANCE};
use crate::input::{Shape, read_shape, read_surface};
use crate::labels::LabelVolume;
use crate::landmarks::{JawFrame, read_landmarks};
use crate::mesher::{self, Body};
use crate::orient::{Axes, Unit, look};
use crate::surface::{ClosedSurface, compact, split_pieces, weld};
use crate::teeth::{ScannedTooth, Tooth};
use crate::winding::TriangleTree;
use osteotome_mechanics::geometry::{MeshDistance, SignedDistance, TetMesh, TriMesh, Vec3};
use serde::Serialize;
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

/// Triangles of a surface to be prepared, at most: two million keep memory below 2 GiB.
const MAX_TRIANGLES: u64 = 2_000_000;
/// A file of so many bytes has more triangles, however they are written.
const MAX_SURFACE_BYTES: u64 = 800_000_000;
/// Nodes where none are asked for.
const DEFAULT_NODES: usize = 5_000;
/// A tooth smaller than this is a crumb \[mm3\].
const LEAST_TOOTH: f64 = 20.0;
/// No jaw has more teeth.
const MAX_TEETH: usize = 20;
/// Fineness of surfaces around the jaw that come from labels \[mm\].
const CONTEXT_SPACING: f64 = 1.6;
/// How far around the mandible they are of use \[mm\].
const CONTEXT_REACH: f64 = 20.0;

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
        check_bytes(path)?;
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
                make_mesh(&distance, &raw.frame, target, &mut inner)?,
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

/// What the input gives.
struct Raw {
    surface: TriMesh,
    frame: JawFrame,
    mesh: Option<TetMesh>,
    diagnosis: Option<Diagnosis>,
    mending: Option<Deviation>,
    teeth: Vec<Tooth>,
    canals: Vec<crate::canal::Canal>,
    landmarks: Option<crate::landmarks::Landmarks>,
    context: Vec<(String, TriMesh)>,
    notes: Vec<String>,
    constructed: Vec<String>,
}

impl Raw {
    fn new(surface: ClosedSurface, frame: JawFrame) -> Self {
        Self {
            surface: surface.mesh,
            notes: surface.notes,
            frame,
            mesh: None,
            diagnosis: None,
            mending: None,
            teeth: Vec::new(),
            canals: Vec::new(),
            landmarks: None,
            context: Vec::new(),
            constructed: Vec::new(),
        }
    }

    /// Refuses a mesh that is another body than its surface; says so where it is a poor one.
    fn judge(&mut self, figures: &MeshFigures) -> Result<(), AnatomyError> {
        let difference = figures.volume / figures.surface_volume - 1.0;
        if difference.abs() > VOLUME_TOLERANCE {
            let reason = format!(
                "the mesh of {} nodes holds {:+.1} % of the surface's volume more or less, at most {:.0} % is allowed; ask for more nodes",
                figures.nodes,
                100.0 * difference,
                100.0 * VOLUME_TOLERANCE
            );
            return Err(AnatomyError::Mesher { reason });
        }
        let p95 = figures.deviation.p95();
        if p95 > DEVIATION_AIM {
            self.notes.push(format!(
                "95 of 100 points of mesh and surface lie within {p95:.2} mm of each other, where {DEVIATION_AIM} mm is aimed at; more nodes bring it down"
            ));
        }
        Ok(())
    }
}

impl PrepareSpec {
    fn raw_of_surface(
        &self,
        mut mesh: TriMesh,
        name: &str,
        progress: &mut dyn FnMut(&str, f64),
    ) -> Result<Raw, AnatomyError> {
        self.turn(&mut mesh, name)?;
        let frame = look(&mesh, name)?;
        progress("looking for faults", 0.05);
        let (surface, diagnosis, mending) = mended(mesh, name, &mut |f| {
            progress("mending", 0.1 + 0.1 * f);
        })?;
        let mut raw = Raw::new(surface, frame);
        if let Some(mending) = &mending {
            let faults = diagnosis.faults().join(", ");
            raw.notes.push(format!(
                "the surface was mended ({faults}) by winding numbers: 95 of 100 of its points lie within {:.2} mm of the given one, all within {:.1} mm",
                mending.of_mesh.p95, mending.of_mesh.max
            ));
            // A mended surface is not quite where the raw one was.
            raw.frame = JawFrame::find(&raw.surface, name)?;
        }
        raw.diagnosis = Some(diagnosis);
        raw.mending = mending;
        Ok(raw)
    }

    fn turn(&self, mesh: &mut TriMesh, name: &str) -> Result<(), AnatomyError> {
        let n = mesh.triangles.len() as u64;
        if n > MAX_TRIANGLES {
            return Err(AnatomyError::TooLarge {
                what: format!("{name} (triangles)"),
                size: n,
                limit: MAX_TRIANGLES,
            });
        }
        self.axes.apply(self.unit, mesh);
        Ok(())
    }

    fn raw_of_tets(&self, mesh: &TetMesh, name: &str) -> Result<Raw, AnatomyError> {
        let mut shell = TriMesh {
            vertices: mesh.nodes().to_vec(),
            triangles: mesh.boundary_faces().to_vec(),
        };
        self.turn(&mut shell, name)?;
        let turned = |t: &[u32; 4]| match (self.axes.is_mirrored(), *t) {
            (true, [a, b, c, d]) => [a, b, d, c],
            (false, t) => t,
        };
        let tets: Vec<[u32; 4]> = mesh.tets().iter().map(turned).collect();
        let whole = in_order_of_use(&shell.vertices, &tets);
        let whole = whole.map_err(|source| AnatomyError::Mesh {
            name: name.to_owned(),
            source,
        })?;
        let surface = compact(&shell.vertices, &shell.triangles);
        let frame = look(&surface, name)?;
        let closed = ClosedSurface::new(surface, name)?;
        let is_whole = closed.notes.is_empty();
        let mut raw = Raw::new(closed, frame);
        raw.notes.push(
            "the surface is the boundary of the tetrahedra that were given, no finer than they are"
                .to_owned(),
        );
        // Of a mesh in several pieces only the largest is kept, and meshed anew.
        raw.mesh = is_whole.then_some(whole);
        Ok(raw)
    }

    fn raw_of_labels(
        &self,
        volume: &LabelVolume,
        name: &str,
        progress: &mut dyn FnMut(&str, f64),
    ) -> Result<Raw, AnatomyError> {
        if self.unit != Unit::Mm || self.axes != Axes::LPS {
            return Err(AnatomyError::Foreign {
                path: name.to_owned(),
                what: "a label volume, which says its own units and axes",
                mend: "it without --unit and --axes",
            });
        }
        let l = self.labels;
        let counts = volume.counts();
        if counts[usize::from(l.mandible)] == 0 {
            return Err(no_mandible(&counts, l.mandible, name));
        }
        progress("surface of the labels", 0.05);
        // The canal is bone to the mesh, and what of a tooth stands in its socket.
        let rooted = crate::roots::in_sockets(volume, l.mandible, l.lower_teeth);
        let is_bone = |i: usize| {
            let v = volume.voxels[i];
            v == l.mandible || v == l.canal || rooted.contains(&(i as u32))
        };
        let field = volume
            .mask_field(&is_bone, name)?
            .ok_or_else(|| no_mandible(&counts, l.mandible, name))?;
        let spacing = (1.5 * field.edges().mean()).clamp(0.5, 1.5);
        let surface = closed_contour(&field, spacing, name)?;
        let frame = look(&surface.mesh, name)?;
        let mut raw = Raw::new(surface, frame);
        let share = 100.0 * (raw.surface.volume() / field.volume - 1.0);
        let edges = field.edges();
        raw.notes.push(format!(
            "the surface is the smoothed border of labels with voxels of {:.2} x {:.2} x {:.2} mm; it holds {share:+.1} % more or less than they",
            edges.x, edges.y, edges.z
        ));
        progress("teeth and canal", 0.12);
        let middle = 0.5 * (raw.frame.condyles[0].x + raw.frame.condyles[1].x);
        if counts[usize::from(l.canal)] > 0 {
            raw.canals = canals(volume, l.canal, middle, &mut raw.notes);
        }
        if let Some(field) = volume.field(&[l.lower_teeth], name)? {
            let spacing = (1.5 * field.edges().mean()).clamp(0.5, 1.0);
            let all = all_pieces(&field, spacing)?;
            add_teeth(&mut raw, &all, name)?;
        }
        let around = raw.surface.bounds().grown(CONTEXT_REACH);
        for (label, role) in [(l.maxilla, "maxilla"), (l.upper_teeth, "upper teeth")] {
            let is_near = |i: usize| volume.voxels[i] == label && around.contains(&volume.place(i));
            if let Some(field) = volume.mask_field(&is_near, name)? {
                let mesh = mesher::contour(&field, CONTEXT_SPACING)?;
                raw.context.push((role.to_owned(), mesh));
            }
        }
        Ok(raw)
    }

    /// Teeth, canals, landmarks and context from files of their own.
    fn add_files(&self, raw: &mut Raw, bone: &MeshDistance) -> Result<(), AnatomyError> {
        if let Some(path) = &self.teeth {
            let name = path.display().to_string();
            let mut mesh = read_surface(path)?;
            self.turn(&mut mesh, &name)?;
            raw.teeth.clear();
            add_teeth(raw, &mesh, &name)?;
        }
        for tooth in &raw.teeth {
            ScannedTooth::new(tooth.surface.clone(), bone, "a tooth")?;
        }
        for path in &self.canals {
            let canal = read_canal(path)?;
            let outside = canal.line.iter().filter(|p| bone.signed(p) > 1.0).count();
            if 10 * outside > canal.line.len() {
                return Err(AnatomyError::Format {
                    path: path.display().to_string(),
                    format: "canal",
                    reason: format!(
                        "{outside} of {} points lie more than 1 mm outside the bone; canal (LPS, mm) and bone must be in one frame",
                        canal.line.len()
                    ),
                });
            }
            raw.canals.retain(|c| c.side != canal.side);
            raw.canals.push(canal);
        }
        if raw.canals.iter().any(|c| c.is_constructed) {
            let note = "the canal is placed by published mean distances, not seen in images";
            raw.constructed.push(note.to_owned());
        }
        if let Some(path) = &self.landmarks {
            let landmarks = read_landmarks(path)?;
            for (name, p) in landmarks.named() {
                let off = bone.unsigned(&p);
                if off > 5.0 {
                    return Err(AnatomyError::Format {
                        path: path.display().to_string(),
                        format: "landmarks",
                        reason: format!(
                            "{name} is {off:.1} mm away from the bone's surface; it must lie on it (LPS, mm)"
                        ),
                    });
                }
            }
            raw.landmarks = Some(landmarks);
        }
        for (role, path) in &self.context {
            let name = path.display().to_string();
            let mut mesh = read_surface(path)?;
            self.turn(&mut mesh, &name)?;
            if let Err(error) = ClosedSurface::new(mesh.clone(), &name) {
                raw.notes.push(format!(
                    "{error}; as {role} it is shown, but tools do not touch it"
                ));
            }
            raw.context.push((role.clone(), mesh));
        }
        Ok(())
    }

    fn inputs(&self) -> Result<Vec<InputFile>, AnatomyError> {
        let mut files = vec![("bone", &self.input)];
        files.extend(self.teeth.iter().map(|p| ("teeth", p)));
        files.extend(self.canals.iter().map(|p| ("canal", p)));
        files.extend(self.landmarks.iter().map(|p| ("landmarks", p)));
        files.extend(self.context.iter().map(|(role, p)| (role.as_str(), p)));
        let of = |(role, path): &(&str, &PathBuf)| InputFile::of(role, path);
        files.iter().map(of).collect()
    }
}

fn no_mandible(counts: &[usize; 256], label: u8, name: &str) -> AnatomyError {
    let present: Vec<String> = (1..256)
        .filter(|l| counts[*l] > 0)
        .map(|l| l.to_string())
        .collect();
    let present = if present.is_empty() {
        "no label at all".to_owned()
    } else {
        format!("the labels {}", present.join(", "))
    };
    AnatomyError::Format {
        path: name.to_owned(),
        format: "label",
        reason: format!(
            "no voxel has the mandible's label {label}; it holds {present}: say which is the mandible's by --label mandible=N"
        ),
    }
}

/// Refuses a file that cannot but hold more than can be prepared; volumes have limits of their own.
fn check_bytes(path: &Path) -> Result<(), AnatomyError> {
    let name = path.display().to_string();
    let lower = name.to_lowercase();
    let is_volume = [".nii", ".nii.gz", ".nrrd", ".nhdr"]
        .iter()
        .any(|e| lower.ends_with(e));
    let size = std::fs::metadata(path).map_or(0, |m| m.len());
    if size > MAX_SURFACE_BYTES && !is_volume {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (bytes)"),
            size,
            limit: MAX_SURFACE_BYTES,
        });
    }
    Ok(())
}

/// The surface, closed; mended only where that is needed.
fn mended(
    mut mesh: TriMesh,
    name: &str,
    progress: &mut dyn FnMut(f64),
) -> Result<(ClosedSurface, Diagnosis, Option<Deviation>), AnatomyError> {
    let mut tree = TriangleTree::new(&mesh);
    let mut diagnosis = Diagnosis::of(&mesh, &tree);
    if diagnosis.open_edges > 0 {
        // Exporters leave triangles loose, or doubled vertices along seams.
        let corners: Vec<[Vec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
        let welded = weld(&corners);
        tree = TriangleTree::new(&welded);
        diagnosis = Diagnosis::of(&welded, &tree);
        mesh = welded;
    }
    if !diagnosis.needs_repair() {
        return Ok((ClosedSurface::new(mesh, name)?, diagnosis, None));
    }
    progress(0.3);
    let closed = solidify(&mesh, &tree, name).map_err(|error| match error {
        AnatomyError::Mesher { .. } => AnatomyError::Format {
            path: name.to_owned(),
            format: "surface",
            reason: format!(
                "its triangles ({}) go round no volume; give the bone's whole surface",
                diagnosis.faults().join(", ")
            ),
        },
        other => other,
    })?;
    progress(0.8);
    let mending = Deviation::between(
        &MeshDistance::new(closed.mesh.clone()),
        &MeshDistance::new(mesh),
    )?;
    Ok((closed, diagnosis, Some(mending)))
}

/// All of a region's boundary, of whatever many pieces.
fn all_pieces(region: &dyn SignedDistance, spacing: f64) -> Result<TriMesh, AnatomyError> {
    let how = mesher::Stuffing {
        spacing,
        shift: 0.0,
        offset: Vec3::new(0.0, 0.25, 0.25),
    };
    let tets = mesher::stuff_all(region, &how)?;
    Ok(compact(&tets.nodes, &tets.boundary()))
}

/// Each piece is a tooth.
fn add_teeth(raw: &mut Raw, mesh: &TriMesh, name: &str) -> Result<(), AnatomyError> {
    let pieces = split_pieces(mesh);
    if pieces.len() > 50 * MAX_TEETH {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (pieces)"),
            size: pieces.len() as u64,
            limit: 50 * MAX_TEETH as u64,
        });
    }
    let mut crumbs = 0;
    for piece in pieces {
        if piece.volume().abs() < LEAST_TOOTH {
            crumbs += 1;
            continue;
        }
        let (surface, _, mending) = mended(piece, name, &mut |_| {})?;
        if mending.is_some() {
            raw.notes
                .push(format!("{name}: a tooth's surface was mended"));
        }
        raw.teeth.push(Tooth {
            fdi: 0,
            surface: surface.mesh,
        });
    }
    if raw.teeth.len() > MAX_TEETH {
        return Err(AnatomyError::TooLarge {
            what: format!("{name} (teeth)"),
            size: raw.teeth.len() as u64,
            limit: MAX_TEETH as u64,
        });
    }
    if crumbs > 0 {
        raw.notes.push(format!(
            "{name}: {crumbs} pieces smaller than {LEAST_TOOTH} mm3 were left out of the teeth"
        ));
    }
    // From the patient's right to the left.
    let place = |t: &Tooth| t.surface.bounds().centre().x;
    raw.teeth.sort_by(|a, b| place(a).total_cmp(&place(b)));
    Ok(())
}

/// Tetrahedra of the bone, pulled onto its surface, nodes in the order of first use.
fn make_mesh(
    surface: &MeshDistance,
    frame: &JawFrame,
    target: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<TetMesh, AnatomyError> {
    let body = Body::mandible(surface, frame);
    let meshed = mesher::mesh_to_nodes(&body, target, &mut |f| progress(0.8 * f))?;
    let fitted = fit(&meshed.mesh, surface)?;
    progress(1.0);
    let made = in_order_of_use(fitted.nodes(), fitted.tets());
    made.map_err(|source| AnatomyError::Mesh {
        name: "the mesher's own mesh".to_owned(),
        source,
    })
}

/// The mesh with nodes numbered in the order in which tetrahedra name them: as a reader numbers them.
fn in_order_of_use(
    nodes: &[Vec3],
    tets: &[[u32; 4]],
) -> Result<TetMesh, osteotome_mechanics::geometry::MeshError> {
    let mut number = vec![u32::MAX; nodes.len()];
    let mut ordered = Vec::with_capacity(nodes.len());
    let mut place = |n: u32| {
        let slot = &mut number[n as usize];
        if *slot == u32::MAX {
            *slot = ordered.len() as u32;
            ordered.push(nodes[n as usize]);
        }
        *slot
    };
    let tets = tets.iter().map(|t| t.map(&mut place)).collect();
    TetMesh::new(ordered, tets)
}
