//! Pictures of a session: from a recording to the scene at any of its times, to the frame, to the file.
//!
//! [`Stage`] is the way in: it rebuilds the bone of any moment from the recording alone, also of a session in real time, which a
//! recomputation would not repeat.
mod anchored;
mod bone_skin;
mod closing;
mod crack_skin;
mod head;
mod look;
mod orbit;
mod patient;
mod print;
mod props;
mod restore;
mod saw_cuts;
mod session_pictures;
mod skins;
mod stage;
#[cfg(test)]
mod tests;
mod views;

pub use anchored::{Anchor, Skin, moved_cells, piece_of, tet_at};
pub use bone_skin::Places;
pub use look::{BACKGROUND, LOAD_LETTERS};
pub use orbit::Orbit;
pub use patient::patient_pictures;
pub use print::{Finish, StereoMode, Video, write_png};
pub use props::chisel;
pub use restore::Restored;
pub use session_pictures::{shots, write_pictures};
pub use skins::{Dressed, Skinner, Skins};
pub use stage::{Instant, Moment, Scenery, Stage, away, load_on_bone};
pub use views::View;
