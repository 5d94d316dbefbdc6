//! Where a driver's thread meets the 1 kHz thread: latest values only, no lock, no allocation on either side.
use crate::{
    DeviceFault, HapticDevice, Health, OpenError, Reading, Specification, Wrench, limited,
};
use std::any::Any;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// A driver that hears nothing from the simulation for so long displays zero.
const SILENCE: Duration = Duration::from_millis(50);

/// What a driver wants to know again of the reading that a wrench answers.
pub(crate) type Tag = (u32, u64);

/// A reading and when it was taken since the link was made.
#[derive(Clone, Copy, Default)]
struct Stamped {
    reading: Reading,
    at: Duration,
    tag: Tag,
}

/// A wrench, when it was given, and the stamp of the reading it answers.
#[derive(Clone, Copy, Default)]
struct Command {
    wrench: Wrench,
    at: Duration,
    answers: Duration,
    tag: Tag,
}

#[derive(Default)]
struct Shared {
    /// A [`DeviceFault`]'s code; 0: none.
    fault: AtomicU8,
    /// Bits of an `f32` above 0; 0: unknown.
    motor_temperature: AtomicU32,
    is_abandoned: AtomicBool,
    latency: Latency,
}

/// The device's end: a [`HapticDevice`] whose driver runs on another thread.
///
/// `read` and `write` neither allocate nor wait. A reading older than the limit given to the driver counts as
/// [`DeviceFault::Stale`]; while there is any fault, zero is displayed whatever is written. The driver in turn displays
/// zero once `write` has been silent for 50 ms. Dropping it ends the driver, and
/// waits for that.
pub struct LinkedDevice {
    specification: Specification,
    readings: triple_buffer::Output<Stamped>,
    commands: triple_buffer::Input<Command>,
    shared: Arc<Shared>,
    newest: Stamped,
    stale_after: Duration,
    epoch: Instant,
    _driver: Arc<dyn Any + Send + Sync>,
}

/// The driver's end.
pub(crate) struct DriverEnd {
    readings: triple_buffer::Input<Stamped>,
    commands: triple_buffer::Output<Command>,
    shared: Arc<Shared>,
    epoch: Instant,
    silence: Duration,
}

/// A driver's thread. Dropping it waits for the thread's end, so that the program does not end before the device has been
/// told to display zero; the thread must end by itself once all its devices are abandoned.
#[derive(Default)]
pub(crate) struct DriverThread(Mutex<Option<JoinHandle<()>>>);

impl DriverThread {
    pub(crate) fn start(
        &self,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), OpenError> {
        let thread = Builder::new().name(name.to_owned()).spawn(work);
        let thread = thread.map_err(|error| OpenError::Io {
            what: name.to_owned(),
            error,
        })?;
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Ok(())
    }
}

impl Drop for DriverThread {
    fn drop(&mut self) {
        let thread = self.0.get_mut().unwrap_or_else(PoisonError::into_inner);
        // A thread that has panicked has said so already.
        let _ = thread.take().map(JoinHandle::join);
    }
}

/// Both ends. `driver`: dropped with the device; whatever keeps the driver running.
pub(crate) fn link(
    specification: Specification,
    stale_after: Duration,
    driver: Arc<dyn Any + Send + Sync>,
) -> (LinkedDevice, DriverEnd) {
    let (readings_in, readings) = triple_buffer::triple_buffer(&Stamped::default());
    let (commands, commands_out) = triple_buffer::triple_buffer(&Command::default());
    let shared = Arc::new(Shared::default());
    let epoch = Instant::now();
    let end = DriverEnd {
        readings: readings_in,
        commands: commands_out,
        shared: shared.clone(),
        epoch,
        silence: SILENCE,
    };
    let device = LinkedDevice {
        specification,
        readings,
        commands,
        shared,
        newest: Stamped::default(),
        stale_after,
        epoch,
        _driver: driver,
    };
    (device, end)
}

impl LinkedDevice {
    /// From the reading of a pose to the driver's handing on of the wrench that answers it.
    pub fn latency(&self) -> &Latency {
        &self.shared.latency
    }

    fn fault(&self) -> Option<DeviceFault> {
        let reported = DeviceFault::from_code(self.shared.fault.load(Ordering::Acquire));
        reported.or_else(|| {
            let never = self.newest.at.is_zero();
            let age = self.epoch.elapsed().saturating_sub(self.newest.at);
            (never || age > self.stale_after).then_some(DeviceFault::Stale)
        })
    }
}

impl HapticDevice for LinkedDevice {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self) -> Reading {
        self.newest = *self.readings.read();
        self.newest.reading
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceFault> {
        let allowed = match self.fault() {
            Some(fault) => Err(fault),
            None => limited(wrench, &self.specification),
        };
        self.commands.write(Command {
            wrench: allowed.unwrap_or_default(),
            at: self.epoch.elapsed(),
            answers: self.newest.at,
            tag: self.newest.tag,
        });
        allowed.map(|_| ())
    }

    fn health(&self) -> Health {
        let bits = self.shared.motor_temperature.load(Ordering::Relaxed);
        Health {
            fault: self.fault(),
            motor_temperature: (bits != 0).then(|| f32::from_bits(bits)),
        }
    }
}

impl Drop for LinkedDevice {
    fn drop(&mut self) {
        self.shared.is_abandoned.store(true, Ordering::Release);
    }
}

impl DriverEnd {
    /// Hands over a reading, stamped with the time of this call. One that is not finite is kept back.
    pub(crate) fn publish(&mut self, reading: Reading) -> Result<(), DeviceFault> {
        self.publish_tagged(reading, Tag::default())
    }

    /// Likewise; the wrench that answers it will carry the tag.
    pub(crate) fn publish_tagged(
        &mut self,
        mut reading: Reading,
        tag: Tag,
    ) -> Result<(), DeviceFault> {
        if !is_finite(&reading) {
            return Err(DeviceFault::Malformed);
        }
        let at = self.epoch.elapsed();
        reading.time = at.as_secs_f64();
        self.readings.write(Stamped { reading, at, tag });
        Ok(())
    }

    /// The wrench to display now.
    pub(crate) fn wrench(&mut self) -> Wrench {
        let is_new = self.commands.update();
        let command = *self.commands.output_buffer_mut();
        let now = self.epoch.elapsed();
        if is_new && !command.answers.is_zero() {
            let latency = now.saturating_sub(command.answers);
            self.shared.latency.count(latency);
        }
        let is_silent = now.saturating_sub(command.at) > self.silence;
        if is_silent || self.fault().is_some() {
            Wrench::default()
        } else {
            command.wrench
        }
    }

    /// The tag of the reading that the last [`wrench`](Self::wrench) answers.
    pub(crate) fn answered(&mut self) -> Tag {
        self.commands.output_buffer_mut().tag
    }

    /// Whether a wrench has come that [`wrench`](Self::wrench) has not given yet.
    pub(crate) fn has_news(&self) -> bool {
        self.commands.updated()
    }

    /// What is wrong with the device, or that nothing is.
    pub(crate) fn set_fault(&self, fault: Option<DeviceFault>) {
        let code = fault.map_or(0, |f| f as u8);
        self.shared.fault.store(code, Ordering::Release);
    }

    pub(crate) fn fault(&self) -> Option<DeviceFault> {
        DeviceFault::from_code(self.shared.fault.load(Ordering::Acquire))
    }

    pub(crate) fn set_motor_temperature(&self, share: f32) {
        let bits = if share > 0.0 { share.to_bits() } else { 0 };
        self.shared.motor_temperature.store(bits, Ordering::Relaxed);
    }

    /// Whether the device's end is gone.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.shared.is_abandoned.load(Ordering::Acquire)
    }
}

fn is_finite(reading: &Reading) -> bool {
    let pose = &reading.pose;
    let numbers = pose.translation.vector.iter();
    numbers
        .chain(pose.rotation.coords.iter())
        .chain(&reading.velocity)
        .chain(&reading.angular_velocity)
        .all(|c| c.is_finite())
}

const N_BINS: usize = 1000;
const BIN_US: u32 = 20;

/// A histogram of latencies, 20 us a bin up to 20 ms. Counting and reading are wait-free.
pub struct Latency {
    bins: Box<[AtomicU32; N_BINS]>,
}

impl Default for Latency {
    fn default() -> Self {
        Self {
            bins: Box::new([const { AtomicU32::new(0) }; N_BINS]),
        }
    }
}

impl Latency {
    /// Adds one.
    pub fn count(&self, latency: Duration) {
        let bin = latency.as_micros() as usize / BIN_US as usize;
        self.bins[bin.min(N_BINS - 1)].fetch_add(1, Ordering::Relaxed);
    }

    /// How many have been counted.
    pub fn n(&self) -> u64 {
        self.bins
            .iter()
            .map(|b| u64::from(b.load(Ordering::Relaxed)))
            .sum()
    }

    /// The latency that a `share` (0 to 1) of all keeps within, rounded up to a bin \[us\]; `None` without any.
    pub fn quantile_us(&self, share: f64) -> Option<u32> {
        let wanted = (share * self.n() as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        let bin = self.bins.iter().position(|b| {
            seen += u64::from(b.load(Ordering::Relaxed));
            seen >= wanted
        })?;
        Some((bin as u32 + 1) * BIN_US)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{OMNI, Pose, Vec3};

    fn pair(stale_after: Duration) -> (LinkedDevice, DriverEnd) {
        let (device, mut end) = link(Specification::of(&OMNI, "1"), stale_after, Arc::new(()));
        end.silence = LONG;
        (device, end)
    }

    fn at(x: f64) -> Reading {
        Reading {
            pose: Pose::translation(x, 0.0, 0.0),
            ..Reading::default()
        }
    }

    fn push(x: f64) -> Wrench {
        Wrench {
            force: Vec3::new(x, 0.0, 0.0),
            torque: Vec3::zeros(),
        }
    }

    const LONG: Duration = Duration::from_secs(3600);

    #[test]
    fn the_newest_values_pass_and_forces_are_clamped() {
        let (mut device, mut driver) = pair(LONG);
        assert_eq!(
            device.health().fault,
            Some(DeviceFault::Stale),
            "never read"
        );
        for x in 1..4 {
            driver.publish(at(f64::from(x))).unwrap();
        }
        assert_eq!(device.read().pose.translation.x, 3.0);
        assert_eq!(device.health().fault, None);
        device.write(&push(100.0)).unwrap();
        assert!(driver.has_news());
        assert!((driver.wrench().force.x - OMNI.max_force).abs() < 1e-12);
        assert_eq!(device.latency().n(), 1);
    }

    #[test]
    fn any_fault_displays_zero_until_it_passes() {
        let (mut device, mut driver) = pair(LONG);
        driver.publish(at(1.0)).unwrap();
        device.read();
        device.write(&push(1.0)).unwrap();
        driver.set_fault(Some(DeviceFault::WarmMotors));
        assert_eq!(driver.wrench(), Wrench::default(), "before it is told");
        assert_eq!(device.write(&push(1.0)), Err(DeviceFault::WarmMotors));
        driver.set_fault(None);
        assert_eq!(
            driver.wrench(),
            Wrench::default(),
            "what was refused stays so"
        );
        device.write(&push(1.0)).unwrap();
        assert_eq!(driver.wrench(), push(1.0));
    }

    #[test]
    fn old_readings_and_a_silent_simulation_give_zero() {
        let (mut device, mut driver) = pair(Duration::ZERO);
        driver.publish(at(1.0)).unwrap();
        device.read();
        std::thread::sleep(Duration::from_millis(1));
        assert_eq!(device.write(&push(1.0)), Err(DeviceFault::Stale));

        let (mut device, mut driver) = pair(LONG);
        driver.publish(at(1.0)).unwrap();
        device.read();
        device.write(&push(1.0)).unwrap();
        assert_eq!(driver.wrench(), push(1.0));
        driver.silence = Duration::ZERO;
        assert_eq!(driver.wrench(), Wrench::default());
    }

    #[test]
    fn what_is_not_finite_does_not_pass() {
        let (mut device, mut driver) = pair(LONG);
        driver.publish(at(1.0)).unwrap();
        assert_eq!(driver.publish(at(f64::NAN)), Err(DeviceFault::Malformed));
        assert_eq!(device.read().pose.translation.x, 1.0);
        assert_eq!(device.write(&push(f64::NAN)), Err(DeviceFault::NotFinite));
        assert_eq!(driver.wrench(), Wrench::default());
    }

    #[test]
    fn quantiles_are_bin_edges() {
        let latency = Latency::default();
        assert_eq!(latency.quantile_us(0.5), None);
        (0..100).for_each(|i| latency.count(Duration::from_micros(i * 10)));
        assert_eq!(latency.quantile_us(0.5), Some(500));
        assert_eq!(latency.quantile_us(1.0), Some(1000));
    }
}
