use osteotome_mechanics::bone::MaterialError;
use osteotome_mechanics::geometry::{MeshError, Vec3};

/// Why a patient, or a file for one, was refused. Each text is one line: what, where, and what would be right.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AnatomyError {
    /// The file is missing or unreadable.
    #[error("cannot read {path}: {reason}")]
    Read {
        /// Which file.
        path: String,
        /// The system's own words.
        reason: String,
    },
    /// The file is not what its name or header says.
    #[error("{path} is not a usable {format} file: {reason}")]
    Format {
        /// Which file.
        path: String,
        /// The format it was read as.
        format: &'static str,
        /// What is wrong and where.
        reason: String,
    },
    /// A file of another kind than what is asked for.
    #[error("{path} is {what}; give {mend}")]
    Foreign {
        /// Which file.
        path: String,
        /// What it is.
        what: &'static str,
        /// What would be right.
        mend: &'static str,
    },
    /// A file or request beyond the limits of this program.
    #[error("{what} is too large: {size}; at most {limit} can be used")]
    TooLarge {
        /// What.
        what: String,
        /// How large.
        size: u64,
        /// The limit.
        limit: u64,
    },
    /// No triangles.
    #[error("{name} holds no triangles with an area; a closed surface is needed")]
    EmptySurface {
        /// Which surface.
        name: String,
    },
    /// A coordinate is not a number.
    #[error("{name}: vertex {vertex} has a coordinate that is not a finite number")]
    NotFinite {
        /// Which surface.
        name: String,
        /// Which vertex.
        vertex: usize,
    },
    /// An elastic law that is not possible.
    #[error("{key}: {source}")]
    Material {
        /// Which of the specification's materials.
        key: &'static str,
        /// What is wrong with it.
        source: MaterialError,
    },
    /// The surface has holes.
    #[error(
        "{name} is an open surface: {n_edges} border edges, the first near {}; close the holes",
        show(near)
    )]
    OpenSurface {
        /// Which surface.
        name: String,
        /// How many edges have a triangle on one side only.
        n_edges: usize,
        /// Where the first of them is.
        near: Vec3,
    },
    /// More than two triangles meet in an edge.
    #[error(
        "{name} is not manifold: {n_edges} edges with more than two triangles, the first near {}; remove doubled or inner faces",
        show(near)
    )]
    NonManifold {
        /// Which surface.
        name: String,
        /// How many such edges.
        n_edges: usize,
        /// Where the first of them is.
        near: Vec3,
    },
    /// Neighbouring triangles disagree about which side is outside.
    #[error(
        "{name} is not consistently oriented: {n_edges} edges whose two triangles face opposite ways, the first near {}; recompute outward normals",
        show(near)
    )]
    Orientation {
        /// Which surface.
        name: String,
        /// How many such edges.
        n_edges: usize,
        /// Where the first of them is.
        near: Vec3,
    },
    /// The surface encloses nothing.
    #[error("{name} encloses no volume ({volume:.3} mm3); coordinates must be in mm")]
    NoVolume {
        /// Which surface.
        name: String,
        /// What it encloses.
        volume: f64,
    },
    /// No condyles could be found.
    #[error(
        "{name} does not look like a mandible in the LPS frame (x left, y posterior, z superior, mm): {reason}"
    )]
    NotAMandible {
        /// Which surface.
        name: String,
        /// What is missing.
        reason: String,
    },
    /// The size is not that of a mandible.
    #[error("{name} is {:.3} x {:.3} x {:.3} mm, which is no mandible; {mend}", extent.x, extent.y, extent.z)]
    Units {
        /// Which surface.
        name: String,
        /// How large it is.
        extent: Vec3,
        /// What would be right.
        mend: String,
    },
    /// The axes are others than those claimed.
    #[error(
        "{name} lies as a mandible does not lie in LPS (x left, y posterior, z superior), but would in {letters}; say --axes {letters}"
    )]
    Axes {
        /// Which surface.
        name: String,
        /// The axes that would do.
        letters: &'static str,
    },
    /// A patient's folder cannot be used.
    #[error("{path}: {reason}")]
    Folder {
        /// The folder or a file in it.
        path: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A number outside its range.
    #[error("{key} = {value} is outside its range; {range}")]
    OutOfRange {
        /// The setting, by the name it has in a scenario.
        key: String,
        /// Its value.
        value: f64,
        /// What would be right.
        range: String,
    },
    /// The pre-sawn line as a whole cannot be used.
    #[error("osteotomy: {reason}")]
    Osteotomy {
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A point of the pre-sawn line cannot be used.
    #[error("osteotomy point {index} ({part}) {reason}")]
    OsteotomyPoint {
        /// Which, counted from 0 in the order of the file.
        index: usize,
        /// The part it belongs to.
        part: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The tetrahedral mesh is broken.
    #[error("{name}: {source}")]
    Mesh {
        /// Which mesh.
        name: String,
        /// What is wrong.
        source: MeshError,
    },
    /// The mesher found no mesh.
    #[error("the surface could not be meshed: {reason}")]
    Mesher {
        /// Why, and what would help.
        reason: String,
    },
}

fn show(p: &Vec3) -> String {
    format!("({:.1}, {:.1}, {:.1})", p.x, p.y, p.z)
}

/// Refuses a number outside `[low, high]` or not finite.
pub(crate) fn in_range(key: &str, value: f64, low: f64, high: f64) -> Result<(), AnatomyError> {
    if value.is_finite() && (low..=high).contains(&value) {
        return Ok(());
    }
    Err(AnatomyError::OutOfRange {
        key: key.to_owned(),
        value,
        range: format!("it must lie between {low} and {high}"),
    })
}
