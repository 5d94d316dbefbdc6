//! The whole list of what crosses threads.
//!
//! | from | to | what | how |
//! |---|---|---|---|
//! | haptic | main | device poses and tool states | latest: [`latest`] (triple buffer) |
//! | main | haptic | deformed bone, bounding volumes, point shell (`Arc`) | latest |
//! | main | propagation | bone state | latest |
//! | propagation | main | the next bone (`Arc`) | latest |
//! | propagation | haptic | crack front for the surgeon | latest |
//! | each loop | recorder | every sample | ring ([`rings`]); a full ring counts drops, never waits |
//! | haptic | main, propagation | number of haptic steps made | [`Shared::steps`] |
//! | any | all | stop | [`Shared::stop`] |
//! | whoever looks on | all | pause, stop | [`Control`] |
//!
//! A triple buffer's reader never frees: the writer overwrites, and with it drops, the value two publications old.
use crate::session::{BoneSample, GrowthSample, HapticSample, MainSample, Seen};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The writing end of a latest value.
pub type Published<T> = triple_buffer::Input<T>;
/// The reading end of a latest value.
pub type Subscribed<T> = triple_buffer::Output<T>;

/// A latest value: written without waiting, read without waiting.
pub fn latest<T: Clone + Send>(initial: &T) -> (Published<T>, Subscribed<T>) {
    triple_buffer::triple_buffer(initial)
}

/// A sample with the time its step took \[us\].
pub struct Timed<T> {
    /// The sample.
    pub sample: T,
    /// What its step read of the other loops.
    pub seen: Seen,
    /// \[us\]
    pub step_us: f64,
}

/// What the propagation loop tells: a growth, or only that it looked.
pub struct Looked {
    /// Simulated time \[s\].
    pub time: f64,
    /// The growth, if any.
    pub growth: Option<Box<GrowthSample>>,
}

/// A ring's writing end. Wait-free; a full ring drops the value and counts it.
pub struct RingIn<T> {
    producer: Producer<T>,
    dropped: u64,
}

impl<T> RingIn<T> {
    /// Puts a value in, or counts it as dropped.
    pub fn put(&mut self, value: T) {
        self.dropped += u64::from(self.producer.push(value).is_err());
    }

    /// Whether all that was put in has been taken.
    pub fn is_empty(&self) -> bool {
        self.producer.slots() == self.producer.buffer().capacity()
    }

    /// Values dropped so far.
    pub fn n_dropped(&self) -> u64 {
        self.dropped
    }
}

fn ring<T>(capacity: usize) -> (RingIn<T>, Consumer<T>) {
    let (producer, consumer) = RingBuffer::new(capacity);
    (
        RingIn {
            producer,
            dropped: 0,
        },
        consumer,
    )
}

/// The loops' ends of the rings.
pub struct RingsIn {
    /// Haptic steps.
    pub haptic: RingIn<Timed<HapticSample>>,
    /// Main steps.
    pub main: RingIn<Timed<MainSample>>,
    /// The bone, now and then.
    pub bone: RingIn<BoneSample>,
    /// Propagation steps.
    pub propagation: RingIn<Timed<Looked>>,
}

/// The recorder's ends of the rings.
pub struct RingsOut {
    /// Haptic steps.
    pub haptic: Consumer<Timed<HapticSample>>,
    /// Main steps.
    pub main: Consumer<Timed<MainSample>>,
    /// The bone, now and then.
    pub bone: Consumer<BoneSample>,
    /// Propagation steps.
    pub propagation: Consumer<Timed<Looked>>,
}

/// Rings that hold four seconds of each loop.
pub fn rings() -> (RingsIn, RingsOut) {
    let (haptic, haptic_out) = ring(4096);
    let (main, main_out) = ring(512);
    let (bone, bone_out) = ring(64);
    let (propagation, propagation_out) = ring(4096);
    (
        RingsIn {
            haptic,
            main,
            bone,
            propagation,
        },
        RingsOut {
            haptic: haptic_out,
            main: main_out,
            bone: bone_out,
            propagation: propagation_out,
        },
    )
}

/// What somebody outside asks of the loops while they run; clones ask the same loops.
#[derive(Clone, Debug, Default)]
pub struct Control(Arc<Asked>);

#[derive(Debug, Default)]
struct Asked {
    stop: AtomicBool,
    pause: AtomicBool,
}

impl Control {
    /// Lets time stand still, or go on.
    pub fn pause(&self, is_paused: bool) {
        self.0.pause.store(is_paused, Ordering::Release);
    }
    /// Whether time is to stand still.
    pub fn is_paused(&self) -> bool {
        self.0.pause.load(Ordering::Acquire)
    }
    /// Ends the session; what it has recorded is kept.
    pub fn stop(&self) {
        self.0.stop.store(true, Ordering::Release);
    }
    /// Whether it is to end.
    pub fn is_stopped(&self) -> bool {
        self.0.stop.load(Ordering::Acquire)
    }
}

/// Flags and counters all loops see.
#[derive(Default)]
pub struct Shared {
    stop: AtomicBool,
    steps: AtomicU64,
    control: Control,
}

impl Shared {
    /// Of a session that obeys `control`.
    pub fn under(control: &Control) -> Self {
        Self {
            control: control.clone(),
            ..Self::default()
        }
    }
    /// Whether time is to stand still.
    pub fn is_paused(&self) -> bool {
        self.control.is_paused()
    }
    /// Asks every loop to end.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }
    /// Whether to end.
    pub fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Acquire) || self.control.is_stopped()
    }
    /// Says how many haptic steps have been made.
    pub fn count(&self, steps: u64) {
        self.steps.store(steps, Ordering::Release);
    }
    /// Haptic steps made.
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_counts_drops_and_keeps_the_oldest() {
        let (mut tx, mut rx) = ring(2);
        (0..5).for_each(|i| tx.put(i));
        assert_eq!(tx.n_dropped(), 3);
        assert_eq!([rx.pop(), rx.pop()], [Ok(0), Ok(1)]);
    }

    #[test]
    fn the_reader_of_a_latest_value_never_frees() {
        use std::sync::Arc;
        let first = Arc::new(0);
        let (mut tx, mut rx) = latest(&first);
        let old = Arc::downgrade(&first);
        drop(first);
        for i in 1..=3 {
            tx.write(Arc::new(i));
            assert!(old.upgrade().is_some() || i > 1, "a write may drop it");
            let held = old.strong_count();
            assert_eq!(**rx.read(), i);
            assert_eq!(old.strong_count(), held, "a read does not");
        }
        assert!(old.upgrade().is_none());
    }
}
