//! A patient's folder: all of one jaw that is made once and used often, behind one manifest.
//!
//! `patient.toml` lists every file with its SHA-256, and that of each file which the patient was made from. A folder that is read
//! again is the same to the last bit.
use crate::canal::{Canal, parse_canal};
use crate::deviation::Deviation;
use crate::error::AnatomyError;
use crate::landmarks::{JawFrame, Landmarks, parse_landmarks};
use crate::mesher::dihedral_range;
use crate::ply::{parse_ply, to_binary_ply};
use crate::stl::read_limited;
use crate::surface::ClosedSurface;
use crate::teeth::{ScannedTooth, Tooth};
use crate::vtu::{parse_vtu, to_vtu};
use osteotome_mechanics::geometry::{MeshDistance, TetMesh, TriMesh};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Component, Path, PathBuf};

/// Of the manifest.
pub const SCHEMA: &str = "osteotome.patient/1";
/// By this file a patient's folder is known.
pub const MANIFEST: &str = "patient.toml";
/// No file of a folder is larger.
const MAX_BYTES: u64 = 1 << 30;
/// No folder has more files.
const MAX_FILES: usize = 1_000;
/// A mesh may differ from its surface's volume by this much, relatively.
pub const VOLUME_TOLERANCE: f64 = 0.01;
/// What 95 of 100 points of mesh and surface are apart at most, as aimed at \[mm\].
pub const DEVIATION_AIM: f64 = 0.3;
/// No dihedral angle of a usable mesh is smaller \[degrees\].
const LEAST_DIHEDRAL: f64 = 8.0;

/// What `patient.toml` holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`SCHEMA`].
    pub schema: String,
    /// `mm`.
    pub units: String,
    /// `LPS`.
    pub frame: String,
    /// Of whom, or of what.
    pub name: String,
    /// What is constructed, not measured, in words.
    #[serde(default)]
    pub constructed: Vec<String>,
    /// What was mended or is to be known, in words.
    #[serde(default)]
    pub notes: Vec<String>,
    /// About the mesh.
    pub mesh: MeshFigures,
    /// Files that the patient was made from.
    #[serde(default)]
    pub input: Vec<InputFile>,
    /// Files of the folder.
    #[serde(default)]
    pub file: Vec<FolderFile>,
}

/// The mesh in figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshFigures {
    /// Nodes that were asked for.
    pub target: usize,
    /// Nodes.
    pub nodes: usize,
    /// Tetrahedra.
    pub tets: usize,
    /// Its volume \[mm3\].
    pub volume: f64,
    /// That of the surface \[mm3\].
    pub surface_volume: f64,
    /// Smallest and largest dihedral angle \[degrees\].
    pub dihedral: [f64; 2],
    /// From the surface \[mm\].
    pub deviation: Deviation,
}

impl MeshFigures {
    /// Measures a mesh against its surface.
    ///
    /// # Errors
    /// As [`Deviation::of`].
    pub fn of(mesh: &TetMesh, target: usize, surface: &MeshDistance) -> Result<Self, AnatomyError> {
        Ok(Self {
            target,
            nodes: mesh.nodes().len(),
            tets: mesh.tets().len(),
            volume: mesh.volume(),
            surface_volume: surface.mesh().volume(),
            dihedral: dihedral_range(mesh),
            deviation: Deviation::of(mesh, surface)?,
        })
    }
}

/// A file that a patient was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputFile {
    /// What it was used for.
    pub role: String,
    /// Its name, without folders.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256.
    pub sha256: String,
}

impl InputFile {
    /// Looks at a file.
    ///
    /// # Errors
    /// [`AnatomyError::Read`] if it cannot be read.
    pub fn of(role: &str, path: &Path) -> Result<Self, AnatomyError> {
        let unreadable = |e: std::io::Error| AnatomyError::Read {
            path: path.display().to_string(),
            reason: e.to_string(),
        };
        let mut file = crate::input::open_limited(path, u64::MAX)?;
        let (mut digest, mut bytes) = (Sha256::new(), 0);
        let mut buffer = vec![0; 1 << 16];
        loop {
            let n = std::io::Read::read(&mut file, &mut buffer).map_err(unreadable)?;
            if n == 0 {
                break;
            }
            digest.update(&buffer[..n]);
            bytes += n as u64;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self {
            role: role.to_owned(),
            name: name.into_owned(),
            bytes,
            sha256: hex(&digest.finalize()),
        })
    }
}

/// What a file of the folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// The bone's closed surface (PLY).
    Surface,
    /// Its tetrahedra (VTU).
    Mesh,
    /// A tooth's closed surface (PLY); `of` is its FDI number, or 0.
    Tooth,
    /// A canal (JSON).
    Canal,
    /// Named places (JSON).
    Landmarks,
    /// A surface around the jaw (PLY); `of` says what.
    Context,
    /// A picture, to be looked at only.
    Picture,
    /// The report of `prepare`.
    Report,
}

/// A file of the folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FolderFile {
    /// What it is.
    pub role: Role,
    /// What of it there may be several of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// Within the folder.
    pub path: String,
    /// SHA-256.
    pub sha256: String,
}

/// A file to be: role, what of, path, content.
pub struct Content {
    /// What it is.
    pub role: Role,
    /// What of it there may be several of.
    pub of: Option<String>,
    /// Within the folder.
    pub path: String,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// A jaw that is ready to be simulated.
#[derive(Clone, Debug)]
pub struct PatientFolder {
    /// Of whom, or of what.
    pub name: String,
    /// What is constructed, not measured, in words.
    pub constructed: Vec<String>,
    /// What was mended or is to be known, in words.
    pub notes: Vec<String>,
    /// Files that it was made from.
    pub inputs: Vec<InputFile>,
    /// The bone's surface, closed and outward \[mm, LPS\].
    pub surface: TriMesh,
    /// The bone's tetrahedra.
    pub mesh: TetMesh,
    /// About them.
    pub figures: MeshFigures,
    /// Teeth, numbered after the Fédération Dentaire Internationale, or 0.
    pub teeth: Vec<Tooth>,
    /// The canals that are known.
    pub canals: Vec<Canal>,
    /// Named places, where they are known.
    pub landmarks: Option<Landmarks>,
    /// Surfaces around the jaw, each with what it is.
    pub context: Vec<(String, TriMesh)>,
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn json<T: Serialize>(value: &T, path: &str) -> Result<Vec<u8>, AnatomyError> {
    let text = serde_json::to_string_pretty(value).map_err(|e| AnatomyError::Folder {
        path: path.to_owned(),
        reason: e.to_string(),
    })?;
    Ok((text + "\n").into_bytes())
}

impl PatientFolder {
    /// The files that hold it, without the manifest.
    ///
    /// # Errors
    /// [`AnatomyError::Folder`] for a number that JSON has no word for.
    pub fn contents(&self) -> Result<Vec<Content>, AnatomyError> {
        let content = |role, of, path: String, bytes| Content {
            role,
            of,
            path,
            bytes,
        };
        let mut files = vec![
            content(
                Role::Surface,
                None,
                "surface.ply".to_owned(),
                to_binary_ply(&self.surface),
            ),
            content(Role::Mesh, None, "mesh.vtu".to_owned(), to_vtu(&self.mesh)),
        ];
        for (i, tooth) in self.teeth.iter().enumerate() {
            files.push(content(
                Role::Tooth,
                Some(tooth.fdi.to_string()),
                format!("teeth/{:02}.ply", i + 1),
                to_binary_ply(&tooth.surface),
            ));
        }
        for (i, canal) in self.canals.iter().enumerate() {
            let path = format!("canal_{}.json", i + 1);
            let bytes = json(&canal.to_file(), &path)?;
            files.push(content(Role::Canal, None, path, bytes));
        }
        if let Some(landmarks) = &self.landmarks {
            let path = "landmarks.json".to_owned();
            let bytes = json(&landmarks.to_file(), &path)?;
            files.push(content(Role::Landmarks, None, path, bytes));
        }
        for (i, (role, mesh)) in self.context.iter().enumerate() {
            files.push(content(
                Role::Context,
                Some(role.clone()),
                format!("context/{:02}.ply", i + 1),
                to_binary_ply(mesh),
            ));
        }
        Ok(files)
    }

    /// Writes it into an empty folder, the manifest last; `more`: files beside its own, such as pictures.
    ///
    /// # Errors
    /// [`AnatomyError::Folder`] with the system's own words.
    pub fn write(&self, folder: &Path, more: Vec<Content>) -> Result<(), AnatomyError> {
        let mut list = Vec::new();
        let mut contents = self.contents()?;
        contents.extend(more);
        for file in contents {
            put(folder, &file.path, &file.bytes)?;
            list.push(FolderFile {
                role: file.role,
                of: file.of,
                sha256: sha256(&file.bytes),
                path: file.path,
            });
        }
        let manifest = Manifest {
            schema: SCHEMA.to_owned(),
            units: "mm".to_owned(),
            frame: "LPS".to_owned(),
            name: self.name.clone(),
            constructed: self.constructed.clone(),
            notes: self.notes.clone(),
            mesh: self.figures,
            input: self.inputs.clone(),
            file: list,
        };
        let text = toml::to_string(&manifest).map_err(|e| AnatomyError::Folder {
            path: MANIFEST.to_owned(),
            reason: e.to_string(),
        })?;
        put(folder, MANIFEST, text.as_bytes())
    }

    /// Reads a folder; every file must be as it was written.
    ///
    /// # Errors
    /// [`AnatomyError::Folder`] for the first thing that is wrong; [`check`] names all.
    pub fn read(folder: &Path) -> Result<Self, AnatomyError> {
        let mut reading = Reading::new(folder)?;
        let patient = reading.patient();
        match (patient, reading.faults.into_iter().next()) {
            (Some(patient), None) => Ok(patient),
            (_, fault) => Err(fault.unwrap_or_else(|| AnatomyError::Folder {
                path: folder.display().to_string(),
                reason: "it is not whole".to_owned(),
            })),
        }
    }
}

fn put(folder: &Path, path: &str, bytes: &[u8]) -> Result<(), AnatomyError> {
    let path = folder.join(path);
    let written = path
        .parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| std::fs::write(&path, bytes));
    written.map_err(|e| AnatomyError::Folder {
        path: path.display().to_string(),
        reason: e.to_string(),
    })
}

/// Reads the manifest alone.
///
/// # Errors
/// [`AnatomyError::Folder`] if there is none, or it is of another form.
pub fn read_manifest(folder: &Path) -> Result<Manifest, AnatomyError> {
    let path = folder.join(MANIFEST);
    let fault = |reason: String| AnatomyError::Folder {
        path: path.display().to_string(),
        reason,
    };
    if folder.is_dir() && !path.exists() {
        return Err(AnatomyError::Folder {
            path: folder.display().to_string(),
            reason: format!(
                "it holds no {MANIFEST}; give a folder that `osteotome prepare` has made"
            ),
        });
    }
    let bytes = read_limited(&path, 4 << 20)?;
    let text = String::from_utf8(bytes).map_err(|_| fault("it is not text".to_owned()))?;
    let manifest: Manifest = toml::from_str(&text).map_err(|e| {
        let line = e.span().map_or(1, |s| {
            1 + text[..s.start.min(text.len())].matches('\n').count()
        });
        let message = e.message().replace('\n', ", ");
        fault(format!(
            "line {line}: {message}; prepare the patient again, or take the change back"
        ))
    })?;
    for (key, found, want) in [
        ("schema", &manifest.schema, SCHEMA),
        ("units", &manifest.units, "mm"),
        ("frame", &manifest.frame, "LPS"),
    ] {
        if found != want {
            return Err(fault(format!(
                "{key} is \"{found}\"; this program reads \"{want}\""
            )));
        }
    }
    if manifest.file.len() > MAX_FILES {
        let n = manifest.file.len();
        return Err(fault(format!("it lists {n} files; at most {MAX_FILES}")));
    }
    Ok(manifest)
}

/// A folder while it is read: what is wrong is collected, and reading goes on.
struct Reading {
    folder: PathBuf,
    manifest: Manifest,
    faults: Vec<AnatomyError>,
}

impl Reading {
    fn new(folder: &Path) -> Result<Self, AnatomyError> {
        Ok(Self {
            folder: folder.to_owned(),
            manifest: read_manifest(folder)?,
            faults: Vec::new(),
        })
    }

    fn fault(&mut self, path: &str, reason: impl Into<String>) {
        self.faults.push(AnatomyError::Folder {
            path: self.folder.join(path).display().to_string(),
            reason: reason.into(),
        });
    }

    /// A file's content, if it is the one that was written.
    fn content(&mut self, file: &FolderFile) -> Option<Vec<u8>> {
        let is_plain = |c: Component| matches!(c, Component::Normal(_));
        if file.path.is_empty() || !Path::new(&file.path).components().all(is_plain) {
            let reason = format!(
                "\"{}\" leads out of the folder; paths must stay within it",
                file.path
            );
            self.fault(MANIFEST, reason);
            return None;
        }
        let bytes = match read_limited(&self.folder.join(&file.path), MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) => {
                self.faults.push(error);
                return None;
            }
        };
        if sha256(&bytes) != file.sha256 {
            self.fault(
                &file.path,
                "it is not the file that was written (its SHA-256 differs from the manifest's); prepare the patient again, or put the file back",
            );
            return None;
        }
        Some(bytes)
    }

    /// What a file's content means.
    fn parsed<T>(
        &mut self,
        file: &FolderFile,
        parse: impl Fn(&[u8], &str) -> Result<T, AnatomyError>,
    ) -> Option<T> {
        let bytes = self.content(file)?;
        let name = self.folder.join(&file.path).display().to_string();
        parse(&bytes, &name)
            .map_err(|error| self.faults.push(error))
            .ok()
    }

    fn one<T>(
        &mut self,
        role: Role,
        what: &str,
        parse: impl Fn(&[u8], &str) -> Result<T, AnatomyError>,
    ) -> Option<T> {
        let files = self.of_role(role);
        let [file] = &files[..] else {
            let reason = format!(
                "it lists {} files with the role \"{what}\"; there must be one",
                files.len()
            );
            self.fault(MANIFEST, reason);
            return None;
        };
        self.parsed(file, parse)
    }

    fn all<T>(
        &mut self,
        role: Role,
        parse: impl Fn(&[u8], &str) -> Result<T, AnatomyError>,
    ) -> Vec<(Option<String>, T)> {
        let files = self.of_role(role);
        let parsed = files
            .iter()
            .map(|f| Some((f.of.clone(), self.parsed(f, &parse)?)));
        parsed.collect::<Vec<_>>().into_iter().flatten().collect()
    }

    fn of_role(&self, role: Role) -> Vec<FolderFile> {
        let files = self.manifest.file.iter();
        files.filter(|f| f.role == role).cloned().collect()
    }

    /// All of it, in the manifest's order of importance.
    fn patient(&mut self) -> Option<PatientFolder> {
        let closed = |b: &[u8], n: &str| Ok(ClosedSurface::new(parse_ply(b, n)?, n)?.mesh);
        let surface = self.one(Role::Surface, "surface", closed);
        let mesh = self.one(Role::Mesh, "mesh", |b, n| Ok(parse_vtu(b, n)?.mesh));
        let teeth = self.all(Role::Tooth, closed);
        let canals = self.all(Role::Canal, parse_canal);
        let landmarks = self.all(Role::Landmarks, parse_landmarks);
        let context = self.all(Role::Context, parse_ply);
        for file in [Role::Picture, Role::Report]
            .into_iter()
            .flat_map(|r| self.of_role(r))
            .collect::<Vec<_>>()
        {
            self.content(&file);
        }
        if let (Some(mesh), figures) = (&mesh, self.manifest.mesh)
            && (mesh.nodes().len(), mesh.tets().len()) != (figures.nodes, figures.tets)
        {
            let (n, t) = (mesh.nodes().len(), mesh.tets().len());
            let reason = format!(
                "[mesh] says {} nodes and {} tetrahedra, the mesh has {n} and {t}",
                figures.nodes, figures.tets
            );
            self.fault(MANIFEST, reason);
        }
        let m = &self.manifest;
        Some(PatientFolder {
            name: m.name.clone(),
            constructed: m.constructed.clone(),
            notes: m.notes.clone(),
            inputs: m.input.clone(),
            figures: m.mesh,
            surface: surface?,
            mesh: mesh?,
            teeth: teeth
                .into_iter()
                .map(|(fdi, surface)| Tooth {
                    fdi: fdi.and_then(|f| f.parse().ok()).unwrap_or(0),
                    surface,
                })
                .collect(),
            canals: canals.into_iter().map(|(_, c)| c).collect(),
            landmarks: landmarks.into_iter().next().map(|(_, l)| l),
            context: context
                .into_iter()
                .map(|(of, mesh)| (of.unwrap_or_else(|| "context".to_owned()), mesh))
                .collect(),
        })
    }
}

/// What [`check`] found.
#[derive(Debug, Default)]
pub struct Checked {
    /// What makes the folder unusable, in order, each with the mend.
    pub faults: Vec<String>,
    /// What is to be known.
    pub remarks: Vec<String>,
    /// The patient, if it could be read.
    pub patient: Option<PatientFolder>,
}

/// Looks at all of a folder and names everything that is wrong.
pub fn check(folder: &Path) -> Checked {
    let mut checked = Checked::default();
    let mut reading = match Reading::new(folder) {
        Ok(reading) => reading,
        Err(error) => {
            checked.faults.push(error.to_string());
            return checked;
        }
    };
    let patient = reading.patient();
    let texts = reading.faults.iter().map(ToString::to_string);
    checked.faults = texts.collect();
    if let Some(patient) = patient {
        patient.judge(folder, &mut checked);
        checked.remarks.extend(patient.notes.iter().cloned());
        checked.patient = Some(patient);
    }
    checked
}

impl PatientFolder {
    /// Whether its parts are sound and belong together.
    fn judge(&self, folder: &Path, checked: &mut Checked) {
        let at = |path: &str| folder.join(path).display().to_string();
        let surface = MeshDistance::new(self.surface.clone());
        if let Err(error) = JawFrame::find(&self.surface, &at("surface.ply")) {
            checked.faults.push(error.to_string());
        }
        self.judge_mesh(&surface, &at("mesh.vtu"), checked);
        for (i, tooth) in self.teeth.iter().enumerate() {
            let name = at(&format!("teeth/{:02}.ply", i + 1));
            if let Err(error) = ScannedTooth::new(tooth.surface.clone(), &surface, &name) {
                checked.faults.push(error.to_string());
            }
        }
        for (i, canal) in self.canals.iter().enumerate() {
            let outside = canal.line.iter().filter(|p| surface.signed(p) > 1.0);
            let (n, of) = (outside.count(), canal.line.len());
            if 10 * n > of {
                checked.faults.push(format!(
                    "{}: {n} of {of} points lie more than 1 mm outside the bone; canal and bone must be in one frame",
                    at(&format!("canal_{}.json", i + 1))
                ));
            }
            if canal.is_constructed {
                let side = canal.side;
                checked.remarks.push(format!(
                    "the canal of the {side:?} side is constructed, not seen in images"
                ));
            }
        }
        if self.canals.is_empty() {
            let text = "there is no canal: distances to the nerve are not scored";
            checked.remarks.push(text.to_owned());
        }
        let marks = self.landmarks.iter().flat_map(Landmarks::named);
        for (name, p) in marks {
            let off = surface.unsigned(&p);
            if off > 5.0 {
                checked.faults.push(format!(
                    "{}: {name} is {off:.1} mm away from the bone's surface; it must lie on it",
                    at("landmarks.json")
                ));
            }
        }
        for (i, (role, mesh)) in self.context.iter().enumerate() {
            let name = at(&format!("context/{:02}.ply", i + 1));
            if let Err(error) = ClosedSurface::new(mesh.clone(), &name) {
                checked.remarks.push(format!(
                    "{error}; as {role} it is shown, but tools do not touch it"
                ));
            }
        }
    }

    fn judge_mesh(&self, surface: &MeshDistance, name: &str, checked: &mut Checked) {
        let difference = self.mesh.volume() / self.surface.volume() - 1.0;
        let is_apart = !self.mesh.bounds().overlaps(&self.surface.bounds());
        if is_apart || difference.abs() > VOLUME_TOLERANCE {
            checked.faults.push(format!(
                "{name} holds {:.0} mm3, the surface {:.0} mm3; they must agree within {:.0} %: prepare with more nodes",
                self.mesh.volume(),
                self.surface.volume(),
                100.0 * VOLUME_TOLERANCE
            ));
        }
        let [least, _] = dihedral_range(&self.mesh);
        if least < LEAST_DIHEDRAL {
            checked.remarks.push(format!(
                "{name}: its smallest dihedral angle is {least:.1} degrees; below {LEAST_DIHEDRAL:.0} stresses are not to be trusted there"
            ));
        }
        match Deviation::of(&self.mesh, surface) {
            Ok(deviation) if deviation.p95() > DEVIATION_AIM => checked.remarks.push(format!(
                "{name}: 95 of 100 points lie within {:.2} mm of the surface, where {DEVIATION_AIM} mm is aimed at; more nodes bring it down",
                deviation.p95()
            )),
            Ok(_) => {}
            Err(error) => checked.faults.push(error.to_string()),
        }
    }
}
