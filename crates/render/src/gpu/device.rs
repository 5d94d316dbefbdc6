//! A graphics device, found at run time.
use std::fmt::{self, Display, Formatter};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

/// Why there is no picture from a graphics device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No Vulkan driver, or none that can do what is needed.
    NoDevice,
    /// The frame, or its scene, does not fit the device's buffers.
    TooLarge,
    /// What the driver said.
    Driver(String),
}

impl Display for Fault {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoDevice => f.write_str("no graphics device with a Vulkan driver was found"),
            Self::TooLarge => f.write_str("the picture does not fit the graphics device's buffers"),
            Self::Driver(text) => write!(f, "the graphics device failed: {text}"),
        }
    }
}

impl std::error::Error for Fault {}

/// A device and its queue.
pub struct Device {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    /// As its driver calls it.
    pub name: String,
    /// Whether it is a program on the processor.
    pub is_software: bool,
    /// Bytes of a buffer at most.
    pub most_bytes: u64,
    /// Samples across and down at most.
    pub most_across: usize,
    /// The first thing that went wrong since it was last asked for.
    failed: Arc<Mutex<Option<String>>>,
}

impl Device {
    /// The fastest kind there is; with `is_hardware` no program on the processor.
    pub fn open(is_hardware: bool) -> Result<Self, Fault> {
        if is_hardware && !may_have_hardware() {
            return Err(Fault::NoDevice);
        }
        let mut wanted = wgpu::InstanceDescriptor::new_without_display_handle();
        wanted.backends = wgpu::Backends::VULKAN;
        // Validation layers are the developer's: they must not slow down or print to whoever has them installed.
        wanted.flags = wgpu::InstanceFlags::empty();
        let instance = wgpu::Instance::new(wanted);
        let mut found = at_once(instance.enumerate_adapters(wgpu::Backends::VULKAN))?;
        found.retain(|a| can_draw(a) && !(is_hardware && rank(a) == SOFTWARE));
        let adapter = found.into_iter().min_by_key(rank).ok_or(Fault::NoDevice)?;
        let has = adapter.limits();
        let required_limits = wgpu::Limits {
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
            max_buffer_size: has.max_buffer_size,
            max_texture_dimension_2d: has.max_texture_dimension_2d,
            ..wgpu::Limits::default()
        };
        let wanted = wgpu::DeviceDescriptor {
            label: None,
            required_limits,
            ..Default::default()
        };
        let driver = |e: &dyn Display| Fault::Driver(e.to_string());
        let (device, queue) = at_once(adapter.request_device(&wanted))?.map_err(|e| driver(&e))?;
        let failed = Arc::new(Mutex::new(None));
        let seen = failed.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let mut first = seen.lock().unwrap_or_else(PoisonError::into_inner);
            first.get_or_insert_with(|| error.to_string());
        }));
        Ok(Self {
            device,
            queue,
            name: adapter.get_info().name,
            is_software: rank(&adapter) == SOFTWARE,
            most_bytes: has.max_buffer_size.min(has.max_storage_buffer_binding_size),
            most_across: has.max_texture_dimension_2d as usize,
            failed,
        })
    }

    /// Whether the driver has refused anything.
    pub fn check(&self) -> Result<(), Fault> {
        let mut first = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        first.take().map_or(Ok(()), |text| Err(Fault::Driver(text)))
    }

    /// Waits for all that was submitted.
    pub fn wait(&self) -> Result<(), Fault> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| Fault::Driver(e.to_string()))?;
        self.check()
    }
}

/// Whether a search for hardware is worth its time: on Linux graphics devices are files. Without one no driver is loaded.
fn may_have_hardware() -> bool {
    let files = [
        "/dev/dri",
        "/dev/nvidiactl",
        "/dev/dxg",
        "/dev/kgsl-3d0",
        "/dev/mali0",
    ];
    !cfg!(target_os = "linux") || files.iter().any(|f| std::path::Path::new(f).exists())
}

const SOFTWARE: u8 = 4;

fn rank(adapter: &wgpu::Adapter) -> u8 {
    match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => SOFTWARE,
    }
}

/// Lists are filled by fragment shaders and walked by compute shaders.
fn can_draw(adapter: &wgpu::Adapter) -> bool {
    let needed = wgpu::DownlevelFlags::FRAGMENT_WRITABLE_STORAGE
        | wgpu::DownlevelFlags::COMPUTE_SHADERS
        | wgpu::DownlevelFlags::INDIRECT_EXECUTION
        | wgpu::DownlevelFlags::VERTEX_STORAGE;
    let (has, least) = (adapter.limits(), wgpu::Limits::default());
    adapter.get_downlevel_capabilities().flags.contains(needed)
        && has.max_storage_buffers_per_shader_stage >= least.max_storage_buffers_per_shader_stage
        && has.max_storage_buffer_binding_size >= least.max_storage_buffer_binding_size
        && has.max_buffer_size >= least.max_buffer_size
        && has.max_texture_dimension_2d >= least.max_texture_dimension_2d
}

/// Outside of a browser wgpu answers such questions before it returns.
fn at_once<T>(question: impl Future<Output = T>) -> Result<T, Fault> {
    let question = std::pin::pin!(question);
    match question.poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(answer) => Ok(answer),
        Poll::Pending => Err(Fault::Driver("no answer from the driver".into())),
    }
}
