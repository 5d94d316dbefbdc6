//! What comes with the bone in files of its own.
use super::PrepareSpec;
use super::bone::Raw;
use super::mend::add_teeth;
use crate::canal::read_canal;
use crate::error::AnatomyError;
use crate::folder::InputFile;
use crate::input::read_surface;
use crate::landmarks::read_landmarks;
use crate::surface::ClosedSurface;
use crate::teeth::ScannedTooth;
use osteotome_mechanics::geometry::MeshDistance;
use std::path::{Path, PathBuf};

/// A file of so many bytes has more triangles, however they are written.
const MAX_SURFACE_BYTES: u64 = 800_000_000;

impl PrepareSpec {
    /// Teeth, canals, landmarks and context from files of their own.
    pub(super) fn add_files(&self, raw: &mut Raw, bone: &MeshDistance) -> Result<(), AnatomyError> {
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
            let condyles = raw.frame.condyles;
            canal.check_side(
                0.5 * (condyles[0].x + condyles[1].x),
                &path.display().to_string(),
            )?;
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

    pub(super) fn inputs(&self) -> Result<Vec<InputFile>, AnatomyError> {
        let mut files = vec![("bone", &self.input)];
        files.extend(self.teeth.iter().map(|p| ("teeth", p)));
        files.extend(self.canals.iter().map(|p| ("canal", p)));
        files.extend(self.landmarks.iter().map(|p| ("landmarks", p)));
        files.extend(self.context.iter().map(|(role, p)| (role.as_str(), p)));
        let of = |(role, path): &(&str, &PathBuf)| InputFile::of(role, path);
        files.iter().map(of).collect()
    }
}

/// Refuses a file that cannot but hold more than can be prepared; volumes have limits of their own.
pub(super) fn check_bytes(path: &Path) -> Result<(), AnatomyError> {
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
