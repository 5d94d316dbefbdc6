//! A gentle spring on a device, and how well it keeps up.
use crate::pace::{Pace, raise_priority};
use crate::{DeviceFault, HapticDevice, Latency, Vec3, Wrench};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(1);
/// \[N/mm\]; a tenth of what a simulated bone shows at most.
const STIFFNESS: f64 = 0.03;
/// The spring pulls with no more than this \[N\].
const GENTLE: f64 = 0.5;
/// The spring's end circles on this radius \[mm\] once a second.
const RADIUS: f64 = 5.0;

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exercise {
    /// New readings a second.
    pub rate_hz: f64,
    /// 99 % of the intervals between new readings were within this of their median \[us\].
    pub jitter_us: f64,
    /// From taking a reading to having written the wrench that answers it, on the haptic thread: median and 99 % \[us\].
    pub read_to_write_us: [u32; 2],
    /// The last fault that was reported, if any.
    pub fault: Option<DeviceFault>,
}

/// Pulls the handle gently along a circle about where it is, for so long. Raises the calling thread's priority if it may.
pub fn exercise(device: &mut dyn HapticDevice, duration: Duration) -> Exercise {
    raise_priority();
    let latency = Latency::default();
    let mut intervals = Vec::new();
    let mut fault = None;
    let mut newest = device.read();
    let middle = newest.pose.translation.vector;
    let start = Instant::now();
    let mut pace = Pace::new(PERIOD);
    let mut seen = start;
    while start.elapsed() < duration {
        let read = Instant::now();
        let reading = device.read();
        if reading.time != newest.time {
            intervals.push(read - seen);
            seen = read;
        }
        newest = reading;
        let phase = start.elapsed().as_secs_f64() * std::f64::consts::TAU;
        let end = middle + RADIUS * Vec3::new(phase.sin(), 0.0, phase.cos() - 1.0);
        let pull = STIFFNESS * (end - reading.pose.translation.vector);
        let force = pull * (GENTLE / pull.norm().max(GENTLE));
        let told = device.write(&Wrench {
            force,
            torque: Vec3::zeros(),
        });
        latency.count(read.elapsed());
        fault = told.err().or(device.health().fault).or(fault);
        pace.wait();
    }
    let seconds = start.elapsed().as_secs_f64();
    let _ = device.write(&Wrench::default());
    Exercise {
        rate_hz: intervals.len() as f64 / seconds,
        jitter_us: jitter_us(&intervals),
        read_to_write_us: [0.5, 0.99].map(|q| latency.quantile_us(q).unwrap_or(0)),
        fault,
    }
}

fn jitter_us(intervals: &[Duration]) -> f64 {
    let quantile = |values: &mut [f64], share: f64| {
        values.sort_by(f64::total_cmp);
        let at = (share * values.len() as f64) as usize;
        values
            .get(at.min(values.len().saturating_sub(1)))
            .copied()
            .unwrap_or(0.0)
    };
    let mut us: Vec<f64> = intervals.iter().map(|i| i.as_secs_f64() * 1e6).collect();
    let median = quantile(&mut us, 0.5);
    let mut off: Vec<f64> = us.iter().map(|i| (i - median).abs()).collect();
    quantile(&mut off, 0.99)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HandParameters, Pose, SimulatedHand};

    #[test]
    fn a_simulated_hand_is_led_along_and_measured() {
        let mut hand =
            SimulatedHand::new(HandParameters::default(), Pose::identity(), 1e-3).unwrap();
        let found = exercise(&mut hand, Duration::from_millis(300));
        assert!(found.rate_hz > 0.0 && found.read_to_write_us[1] > 0);
        assert_eq!(found.fault, None);
        assert!(hand.read().pose.translation.vector.norm() > 0.0);
    }

    #[test]
    fn jitter_is_the_spread_about_the_median() {
        let ms = |i: &u64| Duration::from_micros(*i);
        let mut even: Vec<_> = [1000; 50].iter().map(ms).collect();
        assert_eq!(jitter_us(&even), 0.0);
        even[7] = Duration::from_micros(1400);
        assert!((jitter_us(&even) - 400.0).abs() < 1e-6);
        assert_eq!(jitter_us(&[]), 0.0);
    }
}
