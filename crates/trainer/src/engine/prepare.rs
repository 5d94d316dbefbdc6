//! A scenario made into a bone with its saw cuts.
use super::fineness::fineness;
use super::surroundings::{Surrounding, surroundings};
use crate::scenario::{self, Scenario};
use crate::surgeon::{Mark, SplitLine};
use anyhow::{Context, Result, anyhow};
use osteotome_anatomy::osteotomy::PointSpec;
use osteotome_anatomy::{
    MaterialSpec, MeshSource, Osteotomy, OsteotomySource, PartKind, Patient, PatientSpec, Side,
    SurfacePoint, SurfaceSource, Technique, Tissue,
};
use osteotome_mechanics::bone::Supports;
use osteotome_mechanics::contact::{PointOrigin, ShellPoint};
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{CrackSurface, LinePoint, Sheet, Solid};
use osteotome_mechanics::geometry::{MeshDistance, TetLocator, TetMesh, Vec3};
use osteotome_mechanics::step::{Body, Bone, Region};
use std::sync::Arc;

/// All that a session starts from.
pub struct Prepared {
    /// The patient.
    pub patient: Patient,
    /// The sawn bone, not yet broken.
    pub bone: Arc<Bone>,
    /// The pre-sawn line, for the surgeon.
    pub line: SplitLine,
    /// What stands still around the jaw.
    pub surroundings: Vec<Surrounding>,
    /// What is to be known of the mesh before a split on it is trusted.
    pub remarks: Vec<String>,
    /// Digest of the patient.
    pub digest: String,
}

/// Nodes this near to a condyle's centre are held, but at least three \[mm\].
const CONDYLE_RADIUS: f64 = 6.0;
/// The capsule of a jaw joint in translation \[N/mm\]; assumed. About the condyle's centre it is 9 mm2 times as stiff, so that
/// a loose ramus turns by hand.
const CAPSULE: f64 = 500.0;
/// Drag of the soft tissue around the whole jaw \[N s/mm\]; assumed. A fragment of a sixth of it that leaps a millimetre within
/// a main step of 20 ms is held back by some 33 N.
const SOFT_TISSUE_DRAG: f64 = 4.0;
/// The hand that steadies the chin holds the nodes this near to its middle \[mm\].
const CHIN_RADIUS: f64 = 15.0;
/// The element size that counts for growth is that within this distance of the line \[mm\].
const NEAR_LINE: f64 = 15.0;
/// Saw cuts reach this far out of the bone, so that no rim of bone stays at the surface \[mm\].
const OUTSIDE: f64 = 2.0;

/// Builds the patient and the bone. `progress` gets the stage and how far all is, 0 to 1.
///
/// # Errors
/// One line for whatever is wrong with the scenario's files and numbers.
pub fn prepare(s: &Scenario, progress: &mut dyn FnMut(&str, f64)) -> Result<Prepared> {
    let mut patient = Patient::build(&patient_spec(s), progress)?;
    let marks = (patient.osteotomy.parts.iter()).flat_map(|p| p.points.iter().map(|m| m.at));
    let came_with = std::mem::take(&mut patient.context);
    let stiffness = s.contact.stiffness;
    let notes = &mut patient.notes;
    let surroundings = surroundings(&s.patient.context, came_with, marks, stiffness, notes)?;
    let line = split_line(&patient.osteotomy)?;
    let body = body(s, &patient);
    let remarks = fineness(s, &patient, body.solid.lengths.h);
    let cuts = saw_cuts(&patient, body.lengths.overshoot());
    let bone = Bone::new(Arc::new(body), cuts).context("the bone cannot be computed")?;
    Ok(Prepared {
        digest: format!("{:016x}", patient.digest()),
        bone: Arc::new(bone),
        line,
        surroundings,
        remarks,
        patient,
    })
}

/// The bone's regions as a scenario describes them.
pub fn material_spec(s: &Scenario) -> MaterialSpec {
    let tissue = |m: &scenario::Material| Tissue {
        young_modulus: m.young_modulus,
        poisson_ratio: m.poisson_ratio,
        toughness: m.toughness,
    };
    MaterialSpec {
        cortical: tissue(&s.material.cortical),
        cortical_orthotropic: s.material.cortical_orthotropic,
        trabecular: tissue(&s.material.trabecular),
        cortical_thickness: s.material.cortical_thickness,
        cortical_regions: s.material.cortical_regions,
        ..MaterialSpec::default()
    }
}

fn patient_spec(s: &Scenario) -> PatientSpec {
    PatientSpec {
        surface: match (
            &s.patient.surface,
            &s.patient.directory,
            &s.patient.parametric,
        ) {
            (Some(path), _, _) => SurfaceSource::File(path.clone()),
            (None, Some(path), _) => SurfaceSource::Folder(path.clone()),
            (None, None, sizes) => SurfaceSource::Parametric(sizes.unwrap_or_default()),
        },
        mesh: match &s.mesh.file {
            Some(path) => MeshSource::File(path.clone()),
            None if s.mesh.grading > 1.0 => MeshSource::Graded {
                nodes: s.mesh.nodes,
                ratio: s.mesh.grading,
            },
            None => MeshSource::Nodes(s.mesh.nodes),
        },
        material: material_spec(s),
        density: s.material.density.clone(),
        osteotomy: match (&s.osteotomy.file, &s.osteotomy.points) {
            (Some(path), _) => OsteotomySource::File(path.clone()),
            (None, Some(points)) => OsteotomySource::Points(points.iter().map(point).collect()),
            (None, None) => {
                OsteotomySource::Technique(s.osteotomy.technique.unwrap_or(Technique::Hunsuck))
            }
        },
        side: Some(match s.osteotomy.side {
            scenario::Side::Right => Side::Right,
            scenario::Side::Left => Side::Left,
        }),
        kerf: Some(s.osteotomy.kerf),
        shell_points: s.mesh.shell_points,
        canal: s.patient.canal.clone(),
    }
}

fn point(p: &scenario::LinePoint) -> PointSpec {
    PointSpec {
        at: p.at,
        toward: p.toward,
        depth: p.depth,
        part: p.part.clone(),
    }
}

fn split_line(osteotomy: &Osteotomy) -> Result<SplitLine> {
    let marks = osteotomy.parts.iter().flat_map(|part| {
        part.points.iter().map(|p| Mark {
            at: p.at,
            toward: p.toward,
            depth: p.depth,
            is_ridge: part.kind == PartKind::Ridge,
        })
    });
    SplitLine::new(marks.collect()).map_err(|e| anyhow!("osteotomy: {e}; give at least two points"))
}

/// Neighbouring saw cuts cross by as much as fronts run beyond another sheet, so that no pin-hole stays between them.
fn saw_cuts(patient: &Patient, overlap: f64) -> CrackSurface {
    let osteotomy = &patient.osteotomy;
    let sheet = |part: &osteotome_anatomy::OsteotomyPart| {
        let line: Vec<_> = part
            .points
            .iter()
            .map(|p| LinePoint {
                at: p.at,
                toward: p.toward,
                depth: p.depth,
            })
            .collect();
        Sheet::ribbon(part.kind.name(), &line, osteotomy.kerf, OUTSIDE, overlap)
    };
    CrackSurface {
        sheets: osteotomy.parts.iter().map(sheet).collect(),
    }
}

fn body(s: &Scenario, patient: &Patient) -> Body {
    let mesh = patient.mesh.clone();
    let locator = TetLocator::new(&mesh);
    let young_modulus = s.material.cortical.young_modulus;
    let held = |centres: &[Vec3]| {
        Supports::near(
            &mesh,
            centres,
            CONDYLE_RADIUS,
            s.supports.soft_tissue,
            young_modulus,
        )
    };
    let mut supports = match s.supports.condyles {
        scenario::Condyles::Fixed => held(&patient.condyles),
        scenario::Condyles::Joint => held(&[]),
    };
    if s.supports.condyles == scenario::Condyles::Joint {
        for condyle in &patient.condyles {
            supports.steady(&mesh, condyle, CONDYLE_RADIUS, CAPSULE);
        }
    }
    let chin = patient.frame.path[patient.frame.path.len() / 2];
    supports.steady(&mesh, &chin, CHIN_RADIUS, s.supports.chin);
    supports.drag = SOFT_TISSUE_DRAG * s.loops.main_hz / mesh.nodes().len() as f64;
    let ends = patient.condyles.map(|c| held(&[c]).fixed);
    let h = element_size(&mesh, &patient.osteotomy);
    let area: f64 = patient.shell.iter().map(|p| p.area).sum();
    let mut body = Body {
        wall_density: patient.shell.len() as f64 / area,
        region: Region(Arc::new(MeshDistance::new(patient.surface.clone()))),
        surface: Vec::new(),
        solid: Arc::new(Solid {
            lengths: GrowthLengths::for_element_size(h),
            materials: patient.materials.clone(),
            supports,
            locator,
            mesh,
        }),
        ends,
    };
    body.surface = shell_points(&patient.shell, &body);
    body
}

/// Mean edge length near the line; of the whole mesh where none is near \[mm\].
pub(super) fn element_size(mesh: &TetMesh, osteotomy: &Osteotomy) -> f64 {
    let marks: Vec<Vec3> = osteotomy
        .parts
        .iter()
        .flat_map(|p| &p.points)
        .map(|p| p.at)
        .collect();
    let is_near = |p: &Vec3| marks.iter().any(|m| (m - p).norm() < NEAR_LINE);
    let near: Vec<bool> = mesh.nodes().iter().map(is_near).collect();
    let lengths: Vec<f64> = mesh
        .edges()
        .iter()
        .filter(|e| e.iter().all(|n| near[*n as usize]))
        .map(|e| mesh.edge_vector(e).norm())
        .collect();
    if lengths.is_empty() {
        mesh.mean_edge_length()
    } else {
        lengths.iter().sum::<f64>() / lengths.len() as f64
    }
}

/// Embeds the surface in the mesh; a crown's points all in the tetrahedron under its neck.
fn shell_points(shell: &[SurfacePoint], body: &Body) -> Vec<ShellPoint> {
    let embed = |p: &SurfacePoint| {
        let (tet, _) = body.embed(&p.anchor)?;
        let weights = body.mesh.barycentric(tet as usize, &p.position);
        Some(ShellPoint {
            position: p.position,
            tet,
            weights: weights.map(|w| w as f32),
            area: p.area as f32,
            origin: PointOrigin::Surface,
        })
    };
    shell.iter().filter_map(embed).collect()
}
