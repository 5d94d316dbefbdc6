//! What benches hold the A-buffer against: a plain z-buffer of the same triangles on the same device, with the same light.
use super::Gpu;
use super::device::{Device, Fault};

use super::passes::{FRAME, bind, module, nearest};
use crate::frame::{Image, Options};
use crate::scene::{Camera, Scene};
use std::time::Instant;
use wgpu::CommandEncoder;

const PLAIN: &str = include_str!("shaders/plain.wgsl");

/// What is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// What the processor does for a skin from frame to frame: the moved cells are sent, and the device is told to move vertices
    /// and normals. Not until it has done so.
    Update,
    /// Projection, lists and walk.
    Lists,
    /// The same with light, to a picture in memory.
    Frame,
    /// Projection and z-buffer.
    Plain,
    /// The same with light, to a picture in memory.
    PlainFrame,
}

/// A z-buffer's pipelines.
pub struct Yardstick {
    raster: wgpu::RenderPipeline,
}

impl Gpu {
    /// For benches.
    pub fn yardstick(&self) -> Yardstick {
        Yardstick::new(&self.device)
    }

    /// Milliseconds that some work takes from the scene in memory on, and the picture if there is one.
    ///
    /// # Errors
    /// If it does not fit the device, or the driver fails.
    pub fn timed(
        &mut self,
        yardstick: &Yardstick,
        work: Work,
        scene: &Scene,
        camera: &Camera,
        options: &Options,
    ) -> Result<(f64, Option<Image>), Fault> {
        let start = Instant::now();
        if work == Work::Frame {
            let image = self.image(scene, camera, options)?;
            return Ok((ms(start), Some(image)));
        }
        let raster = self.raster(camera, options)?;
        self.geometry.upload(&self.device, scene)?;
        let job = self.job(scene, &raster, options, false);
        self.buffers.reserve(&self.device, &job, &self.geometry)?;
        let band = job.bands().next().ok_or(Fault::TooLarge)?;
        let uniforms = job.uniforms(&self.geometry, band);
        self.buffers.uniforms.write(&self.device, &uniforms)?;
        self.buffers.no_calls(&self.device)?;
        let mut encoder = self
            .device
            .device
            .create_command_encoder(&Default::default());
        self.project(&mut encoder);
        if work == Work::Update {
            self.device.queue.submit([encoder.finish()]);
            let taken = ms(start);
            self.device.wait()?;
            return Ok((taken, None));
        }
        if work == Work::Lists {
            self.append(&mut encoder, &job, band);
            self.resolve(&mut encoder, &job, band, 0);
        } else {
            yardstick.draw(self, &mut encoder);
        }
        let mut image = None;
        if work == Work::PlainFrame {
            self.buffers.take_nearest(&mut encoder, &job, band);
            self.light(&mut encoder, &job);
            self.device.queue.submit([encoder.finish()]);
            image = Some(self.read(&job)?.1.image);
        } else {
            self.device.queue.submit([encoder.finish()]);
            self.device.wait()?;
        }
        Ok((ms(start), image))
    }
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

impl Yardstick {
    fn new(device: &Device) -> Self {
        Self {
            raster: nearest(device, &module(device, &[FRAME, PLAIN]), "fragment"),
        }
    }

    fn draw(&self, gpu: &Gpu, encoder: &mut CommandEncoder) {
        let (b, g) = (&gpu.buffers, &gpu.geometry);
        let buffers = [(1, b.clip.get()), (2, g.triangles.get())];
        let layout = self.raster.get_bind_group_layout(0);
        let group = bind(&gpu.device, &layout, &buffers);
        let mut pass = b.targets().pass(encoder);
        pass.set_pipeline(&self.raster);
        pass.set_bind_group(0, &group, &[]);
        g.draw(&mut pass, |_| true);
    }
}
