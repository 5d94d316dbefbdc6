//! What recording costs the haptic loop: a sample put into the ring that the recorder empties.
use crate::loops::{Timed, rings};
use crate::session::{HapticSample, Seen};
use std::time::Instant;

/// So many samples are put in at a stretch: less than the ring holds, so that none is dropped.
const STRETCH: usize = 1000;

/// Median time for one sample \[ms\], while another thread empties the ring as the recorder does. None without samples.
pub fn per_sample_ms(samples: &[HapticSample]) -> Option<f64> {
    let (mut into, mut from) = rings();
    let mut times = Vec::new();
    std::thread::scope(|scope| {
        let recorder = scope.spawn(move || {
            while !from.haptic.is_abandoned() || !from.haptic.is_empty() {
                if from.haptic.pop().is_err() {
                    std::thread::yield_now();
                }
            }
        });
        for stretch in samples.chunks_exact(STRETCH) {
            let start = Instant::now();
            for sample in stretch {
                into.haptic.put(Timed {
                    sample: *sample,
                    seen: Seen::default(),
                    step_us: 0.0,
                });
            }
            times.push(start.elapsed().as_secs_f64() * 1e3 / STRETCH as f64);
            while !into.haptic.is_empty() && !recorder.is_finished() {
                std::thread::yield_now();
            }
        }
        drop(into);
    });
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}
