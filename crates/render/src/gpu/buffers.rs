//! Buffers that grow with what they have to hold.
use super::device::{Device, Fault};
use wgpu::BufferUsages as Usage;

/// A buffer that is made anew, half as large again as asked for, when it is too small.
pub struct Growing {
    buffer: Option<wgpu::Buffer>,
    usage: Usage,
    name: &'static str,
}

impl Growing {
    pub const fn new(name: &'static str, usage: Usage) -> Self {
        Self {
            buffer: None,
            usage,
            name,
        }
    }

    /// A storage buffer that can be written and cleared.
    pub fn storage(name: &'static str) -> Self {
        Self::new(name, Usage::STORAGE | Usage::COPY_DST)
    }

    /// The same that can be read back.
    pub fn result(name: &'static str) -> Self {
        Self::new(name, Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC)
    }

    /// Makes room for so many bytes, rounded up to whole words; says whether what was there is lost.
    pub fn reserve(&mut self, device: &Device, bytes: usize) -> Result<bool, Fault> {
        let bytes = (bytes as u64).next_multiple_of(4).max(64);
        if bytes > device.most_bytes {
            return Err(Fault::TooLarge);
        }
        let is_small = self.buffer.as_ref().is_none_or(|b| b.size() < bytes);
        if is_small {
            let size = (bytes + bytes / 2)
                .next_multiple_of(4)
                .min(device.most_bytes & !3);
            self.buffer = None;
            self.buffer = Some(device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(self.name),
                size,
                usage: self.usage,
                mapped_at_creation: false,
            }));
        }
        Ok(is_small)
    }

    /// Makes room and writes.
    pub fn write<T: bytemuck::NoUninit>(
        &mut self,
        device: &Device,
        data: &[T],
    ) -> Result<(), Fault> {
        self.reserve(device, size_of_val(data))?;
        self.write_from(device, 0, data);
        Ok(())
    }

    /// Writes behind so many elements; room has been made before.
    pub fn write_from<T: bytemuck::NoUninit>(&self, device: &Device, first: usize, data: &[T]) {
        let offset = (first * size_of::<T>()) as u64;
        if !data.is_empty() {
            let bytes = bytemuck::cast_slice(data);
            device.queue.write_buffer(self.get(), offset, bytes);
        }
    }

    /// The buffer; room has been made before.
    pub fn get(&self) -> &wgpu::Buffer {
        self.buffer
            .as_ref()
            .expect("room is made for a buffer before it is used")
    }
}
