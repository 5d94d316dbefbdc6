//! What is timed along a replay, each with the baselines that it is held against.
mod contact;
mod growth;
mod hand;
mod relaxation;
mod view;

pub use contact::Contacts;
pub use growth::Growths;
pub use hand::Hands;
pub use relaxation::Relaxations;
pub use view::{SIZE, Views};

use crate::loops::timed;

/// A result and how long it took \[ms\].
fn in_ms<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let (result, us) = timed(work);
    (result, 1e-3 * us)
}

/// The same, the least time of three calls: for work that is repeated beside the simulation, where other programs take the
/// processor away at times.
fn least_ms<T>(mut work: impl FnMut() -> T) -> (T, f64) {
    let first = in_ms(&mut work);
    (0..2).fold(first, |best, _| {
        let next = in_ms(&mut work);
        if next.1 < best.1 { next } else { best }
    })
}
