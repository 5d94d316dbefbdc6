//! The debrief: what a recording says about a session, its score, and the page that shows it.
//!
//! All figures come from the recording alone and the bone rebuilt from the scenario in it, so that any session ever recorded can be
//! looked at again. `docs/debrief.md` defines each of them.
mod bad_split;
mod context;
mod course;
mod findings;
mod hands;
mod motion;
mod nerve;
mod packed;
mod page;
mod path;
mod score;
mod shapes;

pub use bad_split::BadSplit;
pub use context::ContextFindings;
pub use findings::{Findings, TeethFindings};
pub use hands::HandFindings;
pub use nerve::{NerveFindings, dense, nearest_crack, reach};
pub use page::{Figures, Subject, page};
pub use path::{CrackTriangle, PathFindings, Plane};
pub use score::Score;
