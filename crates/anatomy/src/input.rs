//! Files by what they hold: a surface, tetrahedra, or a label volume.
use crate::error::AnatomyError;
use crate::labels::LabelVolume;
use crate::msh::{MeshFile, read_msh};
use crate::nifti::read_nifti;
use crate::nrrd::read_nrrd;
use crate::obj::read_obj;
use crate::ply::read_ply;
use crate::segmentation::read_segmentation;
use crate::stl::read_stl;
use crate::vtu::read_vtu;
use osteotome_mechanics::geometry::TriMesh;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What a file holds.
pub enum Shape {
    /// Triangles (STL, PLY, OBJ).
    Surface(TriMesh),
    /// Tetrahedra (Gmsh .msh, VTK .vtu).
    Tets(Box<MeshFile>),
    /// Voxels (NIfTI, NRRD, DICOM).
    Labels(LabelVolume),
}

/// All that can be read, for messages.
pub const FORMATS: &str = "STL, PLY, OBJ, NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), a DICOM segmentation, Gmsh .msh or VTK .vtu";

/// Reads any of [`FORMATS`], told apart by the name's ending, DICOM by its mark; a beginning that belongs to something else is said.
///
/// # Errors
/// [`AnatomyError`] for a file that is missing, of another kind, or not usable.
pub fn read_shape(path: &Path) -> Result<Shape, AnatomyError> {
    let name = path.display().to_string();
    let beginning = beginning(path)?;
    if beginning.get(128..132) == Some(b"DICM") {
        return Ok(Shape::Labels(read_segmentation(path)?));
    }
    if let Some(what) = foreign(&beginning) {
        return Err(AnatomyError::Foreign {
            path: name,
            what,
            mend: FORMATS,
        });
    }
    let lower = name.to_lowercase();
    let ends = |ending: &str| lower.ends_with(ending);
    if ends(".stl") {
        Ok(Shape::Surface(read_stl(path)?))
    } else if ends(".ply") {
        Ok(Shape::Surface(read_ply(path)?))
    } else if ends(".obj") {
        Ok(Shape::Surface(read_obj(path)?))
    } else if ends(".nii") || ends(".nii.gz") {
        Ok(Shape::Labels(read_nifti(path)?))
    } else if ends(".nrrd") || ends(".nhdr") {
        Ok(Shape::Labels(read_nrrd(path)?))
    } else if ends(".msh") {
        Ok(Shape::Tets(Box::new(read_msh(path)?)))
    } else if ends(".vtu") {
        Ok(Shape::Tets(Box::new(read_vtu(path)?)))
    } else {
        Err(AnatomyError::Foreign {
            path: name,
            what: "a file whose name has no known ending",
            mend: FORMATS,
        })
    }
}

/// Reads a surface; see [`read_shape`].
///
/// # Errors
/// As there, and for tetrahedra or voxels.
pub fn read_surface(path: &Path) -> Result<TriMesh, AnatomyError> {
    let what = match read_shape(path)? {
        Shape::Surface(mesh) => return Ok(mesh),
        Shape::Tets(_) => "a tetrahedral mesh",
        Shape::Labels(_) => "a label volume",
    };
    Err(AnatomyError::Foreign {
        path: path.display().to_string(),
        what,
        mend: "a surface in STL, PLY or OBJ",
    })
}

/// Kinds of files that people hand over by mistake, by their first bytes.
fn foreign(beginning: &[u8]) -> Option<&'static str> {
    let known: [(&[u8], &'static str); 6] = [
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (
            b"PK\x03\x04",
            "a ZIP archive (3MF and numpy's .npz are such)",
        ),
        (b"%PDF", "a PDF document"),
        (b"glTF", "a glTF scene"),
        (b"\x89HDF", "an HDF5 file"),
    ];
    let found = known.iter().find(|(magic, _)| beginning.starts_with(magic));
    found.map(|(_, what)| *what)
}

/// The first bytes of a file.
pub(crate) fn beginning(path: &Path) -> Result<Vec<u8>, AnatomyError> {
    let mut bytes = Vec::new();
    open_limited(path, u64::MAX)?
        .take(132)
        .read_to_end(&mut bytes)
        .map_err(|e| unreadable(path, e.to_string()))?;
    Ok(bytes)
}

/// Opens a regular file of at most `limit` bytes.
pub(crate) fn open_limited(path: &Path, limit: u64) -> Result<File, AnatomyError> {
    let error = |e: std::io::Error| unreadable(path, e.to_string());
    let metadata = std::fs::metadata(path).map_err(error)?;
    if !metadata.is_file() {
        // A folder cannot be read, a device may never end.
        return Err(unreadable(path, "it is not a regular file".to_owned()));
    }
    if metadata.len() > limit {
        return Err(AnatomyError::TooLarge {
            what: format!("{} (bytes)", path.display()),
            size: metadata.len(),
            limit,
        });
    }
    File::open(path).map_err(error)
}

fn unreadable(path: &Path, reason: String) -> AnatomyError {
    AnatomyError::Read {
        path: path.display().to_string(),
        reason,
    }
}
