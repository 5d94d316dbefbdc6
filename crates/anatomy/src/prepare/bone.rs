//! The bone out of a surface, tetrahedra or voxels.
use super::PrepareSpec;
use super::mend::{add_teeth, all_pieces, mended};
use super::mesh::in_order_of_use;
use crate::canal::Canal;
use crate::canal_label::canals;
use crate::deviation::Deviation;
use crate::diagnosis::{Diagnosis, closed_contour};
use crate::error::AnatomyError;
use crate::folder::{DEVIATION_AIM, MeshFigures, VOLUME_TOLERANCE};
use crate::labels::LabelVolume;
use crate::landmarks::{JawFrame, Landmarks};
use crate::mesher;
use crate::orient::{Axes, Unit, look};
use crate::surface::{ClosedSurface, compact};
use crate::teeth::Tooth;
use osteotome_mechanics::geometry::{TetMesh, TriMesh};

/// Triangles of a surface to be prepared, at most: two million keep memory below 2 GiB.
const MAX_TRIANGLES: u64 = 2_000_000;
/// Fineness of surfaces around the jaw that come from labels \[mm\].
const CONTEXT_SPACING: f64 = 1.6;
/// How far around the mandible they are of use \[mm\].
const CONTEXT_REACH: f64 = 20.0;

/// What the input gives.
pub(super) struct Raw {
    pub surface: TriMesh,
    pub frame: JawFrame,
    pub mesh: Option<TetMesh>,
    pub diagnosis: Option<Diagnosis>,
    pub mending: Option<Deviation>,
    pub teeth: Vec<Tooth>,
    pub canals: Vec<Canal>,
    pub landmarks: Option<Landmarks>,
    pub context: Vec<(String, TriMesh)>,
    pub notes: Vec<String>,
    pub constructed: Vec<String>,
}

impl Raw {
    pub(super) fn new(surface: ClosedSurface, frame: JawFrame) -> Self {
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
    pub(super) fn judge(&mut self, figures: &MeshFigures) -> Result<(), AnatomyError> {
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
    pub(super) fn raw_of_surface(
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

    pub(super) fn turn(&self, mesh: &mut TriMesh, name: &str) -> Result<(), AnatomyError> {
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

    pub(super) fn raw_of_tets(&self, mesh: &TetMesh, name: &str) -> Result<Raw, AnatomyError> {
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

    pub(super) fn raw_of_labels(
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
