//! The same pictures from a graphics device: A-buffer, walk and light as on the processor, each shader the twin of a module.
//!
//! Vulkan is loaded at run time: without a driver [`Gpu::open`] says so, and nothing else changes. The fragments of a sample
//! are linked lists; a frame whose lists do not fit is drawn again with more room, and where there is no more room, in bands.
mod buffers;
mod device;
mod draw;
mod geometry;
mod lists;
mod passes;
mod yardstick;

pub use device::Fault;
pub use yardstick::{Work, Yardstick};

use crate::ambient::turned_taps;
use crate::frame::{Frame, Image, Options};
use crate::project::Raster;
use crate::scene::{Camera, Scene};
use device::Device;
use draw::{Buffers, Job};
use geometry::Geometry;
use lists::{Bands, NODE, Room};
use passes::Passes;

/// A graphics device that draws scenes.
pub struct Gpu {
    device: Device,
    passes: Passes,
    geometry: Geometry,
    buffers: Buffers,
    room: Room,
    /// Of the last frame.
    bands: Option<Bands>,
}

impl Gpu {
    /// The fastest device that can draw; with `is_hardware` no program on the processor.
    ///
    /// # Errors
    /// [`Fault::NoDevice`], or what the driver says.
    pub fn open(is_hardware: bool) -> Result<Self, Fault> {
        let device = Device::open(is_hardware)?;
        let passes = Passes::new(&device);
        let buffers = Buffers::new(&device, &turned_taps())?;
        device.check()?;
        let most = device.most_bytes / u64::from(4 * NODE);
        Ok(Self {
            passes,
            geometry: Geometry::new(),
            buffers,
            room: Room::usual(u32::try_from(most).unwrap_or(u32::MAX)),
            bands: None,
            device,
        })
    }

    /// As its driver calls it.
    pub fn name(&self) -> &str {
        &self.device.name
    }

    /// Whether it is a program on the processor.
    pub fn is_software(&self) -> bool {
        self.device.is_software
    }

    /// Gives room for so many fragments a tile and so many shared ones at first, and for so many altogether at most. For tests:
    /// what does not fit is drawn again with more room, or in bands.
    pub fn limit(&mut self, of_tile: u32, shared: u32, most: u32) {
        self.room = Room {
            of_tile,
            shared,
            most: most.min(self.room.most),
        };
        self.bands = None;
    }

    /// A frame as [`render`](crate::render) makes it.
    ///
    /// # Errors
    /// If it does not fit the device, or the driver fails.
    pub fn frame(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        options: &Options,
    ) -> Result<Frame, Fault> {
        self.make(scene, camera, options, true)
    }

    /// The picture alone.
    ///
    /// # Errors
    /// If it does not fit the device, or the driver fails.
    pub fn image(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        options: &Options,
    ) -> Result<Image, Fault> {
        Ok(self.make(scene, camera, options, false)?.image)
    }

    fn make(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        options: &Options,
        is_hit_wanted: bool,
    ) -> Result<Frame, Fault> {
        let raster = self.raster(camera, options)?;
        self.geometry.upload(&self.device, scene)?;
        let mut job = self.job(scene, &raster, options, is_hit_wanted);
        loop {
            let (spilled, frame) = self.draw(&job)?;
            match job.room.grown(job.bands, spilled)? {
                Some(next) => (job.room, job.bands) = next,
                None => {
                    (self.room, self.bands) = (job.room, Some(job.bands));
                    return Ok(frame);
                }
            }
        }
    }

    fn raster(&self, camera: &Camera, options: &Options) -> Result<Raster, Fault> {
        let samples = options.samples.clamp(1, 4);
        let raster = Raster {
            camera: *camera,
            width: options.width * samples,
            height: options.height * samples,
        };
        let is_large = raster.width.max(raster.height) > self.device.most_across;
        if is_large {
            Err(Fault::TooLarge)
        } else {
            Ok(raster)
        }
    }

    /// A frame with the room that the last one needed.
    fn job<'a>(
        &self,
        scene: &Scene,
        raster: &'a Raster,
        options: &'a Options,
        is_hit_wanted: bool,
    ) -> Job<'a> {
        let size = [raster.width as u32, raster.height as u32];
        let same = self.bands.filter(|b| b.size == size);
        Job {
            raster,
            options,
            background: scene.background,
            bands: same.unwrap_or_else(|| Bands::whole(size)),
            room: self.room,
            is_hit_wanted,
            is_sparse: !options.is_transparent && self.geometry.is_outside(raster.camera.eye),
        }
    }
}
