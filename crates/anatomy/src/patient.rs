//! A patient: everything about one jaw that the simulation starts from.
use crate::canal::{Canal, read_canal};
use crate::density::{Density, DensitySpec};
use crate::error::AnatomyError;
use crate::folder::PatientFolder;
use crate::input::read_surface;
use crate::landmarks::{JawFrame, Landmarks};
use crate::materials::MaterialSpec;
use crate::mesher::{self, Body};
use crate::mouth;
use crate::msh::read_msh;
use crate::osteotomy::{DEFAULT_KERF, Osteotomy, PointSpec, Side, Technique, read_osteotomy};
use crate::parametric::{Parameters, ParametricMandible};
use crate::point_shell::{SurfacePoint, point_shell, toothed_point_shell};
use crate::surface::ClosedSurface;
use crate::teeth::{Crown, ScannedTooth, Tooth, ToothBody};
use osteotome_mechanics::bone::TetMaterial;
use osteotome_mechanics::geometry::{MeshDistance, TetMesh, TriMesh, Vec3};
use std::path::PathBuf;

/// Everything about one jaw that the simulation starts from; checked.
#[derive(Clone, Debug)]
pub struct Patient {
    /// Of whom, or of what.
    pub name: String,
    /// What is constructed, not measured, in words.
    pub constructed: Vec<String>,
    /// What was mended in the files, in words.
    pub notes: Vec<String>,
    /// The bone's surface, closed and outward \[mm, LPS\].
    pub surface: TriMesh,
    /// Crowns of the teeth, where they are known. The bone carries them; they are no part of `surface` or `mesh`: at 600 nodes a
    /// crown is about as wide as a tetrahedron, and a mesh that followed them would be a worse one of the bone.
    pub teeth: Vec<Tooth>,
    /// The bone's tetrahedra.
    pub mesh: TetMesh,
    /// By tetrahedron.
    pub materials: Vec<TetMaterial>,
    /// Points spread over the surface and the crowns, where neither covers the other.
    pub shell: Vec<SurfacePoint>,
    /// The pre-sawn line.
    pub osteotomy: Osteotomy,
    /// Condyle centres, right and left.
    pub condyles: [Vec3; 2],
    /// Condyles, jaw angles and centre line as found on the surface.
    pub frame: JawFrame,
    /// Named places, where they are known.
    pub landmarks: Option<Landmarks>,
    /// The canals that are known.
    pub canals: Vec<Canal>,
    /// Surfaces around the jaw that came with the patient, each with what it is.
    pub context: Vec<(String, TriMesh)>,
}

/// Where the bone's surface comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfaceSource {
    /// The idealised jaw.
    Parametric(Parameters),
    /// A closed surface in a file (STL, PLY or OBJ), mm, LPS.
    File(PathBuf),
    /// A folder that `prepare` made, with all that it holds.
    Folder(PathBuf),
}

/// Where the tetrahedra come from.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshSource {
    /// The own mesher, with about so many nodes; the mesh of a patient's folder if it was made with as many.
    Nodes(usize),
    /// The own mesher, finer about the pre-sawn line; see [`Body::graded`].
    Graded {
        /// About so many.
        nodes: usize,
        /// Coarsest spacing over that about the line: 1 (the same everywhere) to 6.
        ratio: f64,
    },
    /// A Gmsh file.
    File(PathBuf),
}

/// Where the pre-sawn line comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum OsteotomySource {
    /// An osteotomy file.
    File(PathBuf),
    /// Points, as a scenario gives them.
    Points(Vec<PointSpec>),
    /// By a technique, on landmarks.
    Technique(Technique),
}

/// What a patient is made from. A side or kerf given here goes before that of an osteotomy file.
#[derive(Clone, Debug, PartialEq)]
pub struct PatientSpec {
    /// The bone.
    pub surface: SurfaceSource,
    /// Its tetrahedra.
    pub mesh: MeshSource,
    /// Its tissue.
    pub material: MaterialSpec,
    /// Stiffness by a scan's density; by depth alone without.
    pub density: Option<DensitySpec>,
    /// The pre-sawn line.
    pub osteotomy: OsteotomySource,
    /// Side of the osteotomy; must agree with that of a file.
    pub side: Option<Side>,
    /// Width of the saw cut \[mm\].
    pub kerf: Option<f64>,
    /// Number of points of the shell.
    pub shell_points: usize,
    /// A file with the canal of the operated side; goes before the parametric mandible's own.
    pub canal: Option<PathBuf>,
}

impl Default for PatientSpec {
    fn default() -> Self {
        Self {
            surface: SurfaceSource::Parametric(Parameters::default()),
            mesh: MeshSource::Nodes(5_000),
            material: MaterialSpec::default(),
            density: None,
            osteotomy: OsteotomySource::Technique(Technique::Hunsuck),
            side: None,
            kerf: None,
            shell_points: 100_000,
            canal: None,
        }
    }
}

/// Fineness of the parametric mandible's surface \[mm\].
const PARAMETRIC_SPACING: f64 = 2.0;
/// A mesh from a file may differ from the surface's volume by this much, relatively: more is another bone.
const MAX_VOLUME_DIFFERENCE: f64 = 0.25;

struct Bone {
    name: String,
    constructed: Vec<String>,
    surface: ClosedSurface,
    parametric: Option<ParametricMandible>,
    folder: Option<Box<PatientFolder>>,
}

impl Patient {
    /// Reads, meshes and checks. `progress` gets the name of the stage and how far all is, 0 to 1.
    ///
    /// # Errors
    /// [`AnatomyError`], one line, for whatever is wrong first.
    pub fn build(
        spec: &PatientSpec,
        progress: &mut dyn FnMut(&str, f64),
    ) -> Result<Self, AnatomyError> {
        // What is cheap to refuse goes first.
        spec.material.check()?;
        progress("surface", 0.0);
        let mut bone = spec.surface.read()?;
        let frame = JawFrame::find(&bone.surface.mesh, &bone.name)?;
        let distance = MeshDistance::new(bone.surface.mesh.clone());
        let landmarks = match (&bone.parametric, &bone.folder) {
            (Some(parametric), _) => Some(parametric.landmarks(&distance)?),
            (None, Some(folder)) => folder.landmarks.clone(),
            (None, None) => None,
        };
        let canals = spec.canals(&bone, &frame)?;
        if canals.iter().any(|c| c.is_constructed) {
            let note = "the canal is placed by published mean distances, not seen in images";
            bone.constructed.push(note.to_owned());
        }
        progress("osteotomy", 0.1);
        let osteotomy = spec.osteotomy(&bone.name, landmarks.as_ref(), &distance)?;
        if matches!(spec.osteotomy, OsteotomySource::Technique(_)) {
            let note = "the osteotomy line is placed on landmarks, not planned by a surgeon";
            bone.constructed.push(note.to_owned());
        }
        let place = osteotomy.place();
        let mesh = spec.mesh(&bone, &distance, &frame, &place, progress)?;
        progress("materials", 0.85);
        let teeth = bone.teeth(&distance)?;
        let bodies: Vec<&dyn ToothBody> = teeth.iter().map(|(_, body)| &**body).collect();
        let density = spec.scan(&mesh)?;
        let materials =
            (spec.material).assign(&mesh, &distance, &frame, &bodies, density.as_ref())?;
        let note =
            "bone regions go by depth under the surface; osteons follow the jaw's centre line";
        bone.constructed.push(note.to_owned());
        bone.constructed.extend(density.map(|d| d.note()));
        progress("point shell", 0.95);
        let shell = if teeth.is_empty() {
            point_shell(&bone.surface.mesh, spec.shell_points)?
        } else {
            let teeth: Vec<(&dyn ToothBody, &TriMesh)> = teeth
                .iter()
                .map(|(tooth, body)| (&**body, &tooth.surface))
                .collect();
            toothed_point_shell(&distance, &teeth, spec.shell_points)?
        };
        let context = match (&bone.parametric, bone.folder) {
            (Some(jaw), _) if jaw.parameters().mouth_opening > 0.0 => {
                let note = "what stands around the jaw is schematic, not a patient's";
                bone.constructed.push(note.to_owned());
                mouth::around(jaw, osteotomy.side)?
            }
            (_, folder) => folder.map(|f| f.context).unwrap_or_default(),
        };
        progress("patient", 1.0);
        Ok(Self {
            name: bone.name,
            constructed: bone.constructed,
            notes: bone.surface.notes,
            surface: bone.surface.mesh,
            teeth: teeth.into_iter().map(|(tooth, _)| tooth).collect(),
            context,
            mesh,
            materials,
            shell,
            osteotomy,
            condyles: frame.condyles,
            frame,
            landmarks,
            canals,
        })
    }

    /// A number that changes whenever surface, teeth, mesh, materials, shell or osteotomy do, down to the last bit (FNV-1a, 64 bits).
    pub fn digest(&self) -> u64 {
        let mut h = Digest::default();
        h.points(&self.surface.vertices);
        self.surface
            .triangles
            .iter()
            .flatten()
            .for_each(|i| h.word(u64::from(*i)));
        for tooth in &self.teeth {
            h.word(u64::from(tooth.fdi));
            h.points(&tooth.surface.vertices);
        }
        h.points(self.mesh.nodes());
        self.mesh
            .tets()
            .iter()
            .flatten()
            .for_each(|i| h.word(u64::from(*i)));
        for m in &self.materials {
            h.numbers(&[
                m.young_modulus,
                m.poisson_ratio,
                m.toughness_along,
                m.toughness_across,
            ]);
            h.points(&[m.osteon]);
            if let Some(law) = &m.orthotropic {
                // Any two gradients that no symmetry favours tell laws and axes apart.
                let (a, b) = (Vec3::new(1.0, 0.5, 0.25), Vec3::new(0.3, -0.2, 1.0));
                h.numbers(law.block(&a, &b).as_slice());
            }
        }
        for p in &self.shell {
            h.points(&[p.position, p.normal, p.anchor]);
            h.numbers(&[p.area]);
        }
        h.numbers(&[self.osteotomy.side.sign(), self.osteotomy.kerf]);
        for part in &self.osteotomy.parts {
            part.kind.name().bytes().for_each(|b| h.word(u64::from(b)));
            for p in &part.points {
                h.points(&[p.at, p.toward]);
                h.numbers(&[p.depth]);
            }
        }
        h.points(&self.condyles);
        h.0
    }
}

impl SurfaceSource {
    fn read(&self) -> Result<Bone, AnatomyError> {
        match self {
            Self::Parametric(parameters) => {
                let mandible = ParametricMandible::new(*parameters)?;
                let mesh = mesher::contour(&mandible, PARAMETRIC_SPACING * parameters.scale)?;
                let name = "parametric mandible";
                Ok(Bone {
                    name: name.to_owned(),
                    constructed: vec![
                        "the bone is an idealised shape with published mean sizes, not a patient's"
                            .to_owned(),
                        "the crowns are simple shapes of textbook mean sizes, not a patient's"
                            .to_owned(),
                    ],
                    surface: ClosedSurface::new(mesh, name)?,
                    parametric: Some(mandible),
                    folder: None,
                })
            }
            Self::File(path) => {
                let name = path.display().to_string();
                let surface = ClosedSurface::new(read_surface(path)?, &name)?;
                Ok(Bone {
                    name,
                    constructed: Vec::new(),
                    surface,
                    parametric: None,
                    folder: None,
                })
            }
            Self::Folder(path) => {
                let folder = PatientFolder::read(path)?;
                Ok(Bone {
                    name: folder.name.clone(),
                    constructed: folder.constructed.clone(),
                    surface: ClosedSurface {
                        mesh: folder.surface.clone(),
                        notes: folder.notes.clone(),
                    },
                    parametric: None,
                    folder: Some(Box::new(folder)),
                })
            }
        }
    }
}

/// A tooth as seen and as a body.
type CarriedTooth = (Tooth, Box<dyn ToothBody>);

impl Bone {
    /// The teeth that are known, as seen and as bodies.
    fn teeth(&self, surface: &MeshDistance) -> Result<Vec<CarriedTooth>, AnatomyError> {
        let crown = |c: &Crown| {
            let tooth = Tooth {
                fdi: c.kind.fdi(c.is_left),
                surface: c.surface()?,
            };
            Ok((tooth, Box::new(c.clone()) as Box<dyn ToothBody>))
        };
        let scanned = |t: &Tooth| {
            let body = ScannedTooth::new(t.surface.clone(), surface, &self.name)?;
            Ok((t.clone(), Box::new(body) as Box<dyn ToothBody>))
        };
        match (&self.parametric, &self.folder) {
            (Some(parametric), _) => parametric.teeth().iter().map(crown).collect(),
            (None, Some(folder)) => folder.teeth.iter().map(scanned).collect(),
            (None, None) => Ok(vec![]),
        }
    }
}

impl PatientSpec {
    /// The scan that gives the stiffness, if any does; it must reach all of the bone.
    fn scan(&self, mesh: &TetMesh) -> Result<Option<Density>, AnatomyError> {
        let Some(spec) = &self.density else {
            return Ok(None);
        };
        if self.material.cortical_orthotropic.is_some() {
            return Err(AnatomyError::Foreign {
                path: "material.density".to_owned(),
                what: "an isotropic stiffness, but material.cortical_orthotropic gives nine constants",
                mend: "one of the two",
            });
        }
        Density::read(spec, mesh.nodes()).map(Some)
    }

    fn canals(&self, bone: &Bone, frame: &JawFrame) -> Result<Vec<Canal>, AnatomyError> {
        match (&self.canal, &bone.parametric, &bone.folder) {
            (Some(path), _, _) => {
                let canal = read_canal(path)?;
                let [right, left] = frame.condyles;
                canal.check_side(0.5 * (right.x + left.x), &path.display().to_string())?;
                Ok(vec![canal])
            }
            (None, Some(mandible), _) => Ok(mandible.canals().into()),
            (None, None, Some(folder)) => Ok(folder.canals.clone()),
            (None, None, None) => Ok(vec![]),
        }
    }

    fn osteotomy(
        &self,
        name: &str,
        landmarks: Option<&Landmarks>,
        surface: &MeshDistance,
    ) -> Result<Osteotomy, AnatomyError> {
        let refuse = |reason: String| Err(AnatomyError::Osteotomy { reason });
        let kerf = self.kerf.unwrap_or(DEFAULT_KERF);
        match &self.osteotomy {
            OsteotomySource::File(path) => {
                let file = read_osteotomy(path)?;
                if let Some(side) = self.side.filter(|s| *s != file.side) {
                    return refuse(format!(
                        "the scenario says side {side:?}, but {} is for the {:?} side",
                        path.display(),
                        file.side
                    ));
                }
                let kerf = self.kerf.or(file.kerf).unwrap_or(DEFAULT_KERF);
                Osteotomy::from_points(file.side, kerf, &file.points, surface)
            }
            OsteotomySource::Points(points) => {
                let Some(side) = self.side else {
                    return refuse("no side is given; say side = \"right\" or \"left\"".to_owned());
                };
                Osteotomy::from_points(side, kerf, points, surface)
            }
            OsteotomySource::Technique(technique) => {
                let Some(landmarks) = landmarks else {
                    return refuse(format!(
                        "technique \"{}\" needs landmarks, which {name} has not; give a file or points",
                        technique.name()
                    ));
                };
                let side = self.side.unwrap_or(Side::Right);
                Osteotomy::by_technique(*technique, landmarks, side, kerf, surface)
            }
        }
    }

    fn mesh(
        &self,
        bone: &Bone,
        distance: &MeshDistance,
        frame: &JawFrame,
        place: &[Vec3],
        progress: &mut dyn FnMut(&str, f64),
    ) -> Result<TetMesh, AnatomyError> {
        let body = Body::mandible(distance, frame);
        let volume = body.volume;
        let mut inner = |f: f64| progress("mesh", 0.15 + 0.7 * f);
        match &self.mesh {
            MeshSource::Nodes(target)
                if let Some(folder) = &bone.folder
                    && folder.figures.target == *target =>
            {
                Ok(folder.mesh.clone())
            }
            MeshSource::Nodes(target) => {
                Ok(mesher::mesh_to_nodes(&body, *target, &mut inner)?.mesh)
            }
            MeshSource::Graded { nodes, ratio } => {
                let body = body.graded(distance.mesh(), place, *ratio, *nodes)?;
                Ok(mesher::mesh_to_nodes(&body, *nodes, &mut inner)?.mesh)
            }
            MeshSource::File(path) => {
                let mesh = read_msh(path)?.mesh;
                let difference = mesh.volume() / volume - 1.0;
                let overlap = mesh.bounds().overlaps(&bone.surface.mesh.bounds());
                if difference.abs() > MAX_VOLUME_DIFFERENCE || !overlap {
                    let reason = format!(
                        "{} holds {:.0} mm3, {} {:.0} mm3; mesh and surface must be of the same bone in the same frame",
                        path.display(),
                        mesh.volume(),
                        bone.name,
                        volume
                    );
                    return Err(AnatomyError::Mesher { reason });
                }
                Ok(mesh)
            }
        }
    }
}

struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    fn word(&mut self, word: u64) {
        for byte in word.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    fn numbers(&mut self, numbers: &[f64]) {
        numbers.iter().for_each(|x| self.word(x.to_bits()));
    }
    fn points(&mut self, points: &[Vec3]) {
        points
            .iter()
            .flat_map(|p| p.iter())
            .for_each(|x| self.word(x.to_bits()));
    }
}
