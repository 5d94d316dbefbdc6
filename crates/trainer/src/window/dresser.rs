//! A thread that makes skins while the eye goes on drawing the ones before.
use crate::picture::{Dressed, Skinner};
use crate::session::{BoneSample, GrowthSample};
use anyhow::Result;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A generation of the bone to be dressed, in the state it was seen in.
#[derive(Clone)]
pub struct Wanted {
    /// The state; `None`: the sawn bone at rest.
    pub bone: Option<Arc<BoneSample>>,
    /// `growth[k]` led to generation `k`.
    pub growth: Vec<Arc<GrowthSample>>,
}

impl Wanted {
    fn generation(&self) -> u64 {
        self.bone.as_ref().map_or(0, |b| b.generation)
    }
}

#[derive(Default)]
struct Desk {
    wanted: Option<Wanted>,
    /// Of which generation skins are being made, or lie ready.
    under_way: Option<u64>,
    made: Option<Result<(Arc<Dressed>, Wanted)>>,
    is_over: bool,
}

/// Where the eye and the thread meet. The eye never waits here.
#[derive(Default)]
pub struct Dresser {
    desk: Mutex<Desk>,
    changed: Condvar,
}

/// Dropped, it ends the thread.
pub struct Closing<'a>(&'a Dresser);

impl Dresser {
    /// Asks for skins, unless those of the same generation are being made. Only the last that was asked for is made.
    pub fn want(&self, wanted: Wanted) {
        let mut desk = self.desk();
        if desk.under_way != Some(wanted.generation()) {
            desk.wanted = Some(wanted);
            self.changed.notify_one();
        }
    }

    /// What has been made since, once.
    ///
    /// # Errors
    /// A growth that does not fit the bone.
    pub fn take(&self) -> Result<Option<(Arc<Dressed>, Wanted)>> {
        let mut desk = self.desk();
        let Some(made) = desk.made.take() else {
            return Ok(None);
        };
        let is_last = |(_, wanted): &(_, Wanted)| desk.under_way == Some(wanted.generation());
        if made.as_ref().map_or(true, is_last) {
            desk.under_way = None;
        }
        made.map(Some)
    }

    /// Ends [`work`](Self::work) when it is dropped.
    pub fn closing(&self) -> Closing<'_> {
        Closing(self)
    }

    /// Makes what is wanted until the end.
    pub fn work(&self, mut skinner: Skinner) {
        let mut desk = self.desk();
        while !desk.is_over {
            let Some(wanted) = desk.wanted.take() else {
                let waited = self.changed.wait(desk);
                desk = waited.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            desk.under_way = Some(wanted.generation());
            drop(desk);
            let made = skinner.make(wanted.generation() as usize, &wanted.growth);
            desk = self.desk();
            desk.made = Some(made.map(|dressed| (dressed, wanted)));
        }
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.desk.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.desk().is_over = true;
        self.0.changed.notify_one();
    }
}
