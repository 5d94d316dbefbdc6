//! What benches hold the A-buffer against: a plain z-buffer of the same triangles on the same device, with the same light.
use super::Gpu;
use super::device::{Device, Fault};
use super::draw::Job;
use super::passes::{FRAME, bind, compute, module, raster, target};
use crate::frame::{Image, Options};
use crate::scene::{Camera, Scene};
use std::time::Instant;
use wgpu::{CommandEncoder, TextureFormat, TextureUsages};

const PLAIN: &str = include_str!("shaders/plain.wgsl");
const GATHER: &str = include_str!("shaders/gather.wgsl");

/// Number and facing of the nearest triangle, and its depth's bits.
const NEAREST: TextureFormat = TextureFormat::Rg32Uint;
const DEPTH: TextureFormat = TextureFormat::Depth32Float;

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

/// A z-buffer's pipelines and targets.
pub struct Yardstick {
    raster: wgpu::RenderPipeline,
    gather: wgpu::ComputePipeline,
    targets: Option<([wgpu::TextureView; 2], [u32; 2])>,
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
        yardstick: &mut Yardstick,
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
        self.buffers
            .reserve(&self.device, &job, self.geometry.n_vertices)?;
        let band = job.bands().next().ok_or(Fault::TooLarge)?;
        let uniforms = job.uniforms(&self.geometry, band);
        self.buffers.uniforms.write(&self.device, &uniforms)?;
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
            yardstick.draw(self, &mut encoder, &job);
        }
        let mut image = None;
        if work == Work::PlainFrame {
            yardstick.gather(self, &mut encoder, &job);
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
        let nearest = wgpu::ColorTargetState {
            format: NEAREST,
            blend: None,
            write_mask: wgpu::ColorWrites::ALL,
        };
        let depth = wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        };
        Self {
            raster: raster(
                device,
                &module(device, &[FRAME, PLAIN]),
                nearest,
                Some(depth),
            ),
            gather: compute(device, &module(device, &[FRAME, GATHER]), "gather"),
            targets: None,
        }
    }

    fn draw(&mut self, gpu: &Gpu, encoder: &mut CommandEncoder, job: &Job) {
        let (b, g) = (&gpu.buffers, &gpu.geometry);
        let size = job.bands.size;
        if self.targets.as_ref().is_none_or(|t| t.1 != size) {
            let make = |format, usage| target(&gpu.device, format, size, usage);
            let targets = [
                make(NEAREST, TextureUsages::TEXTURE_BINDING),
                make(DEPTH, TextureUsages::empty()),
            ];
            self.targets = Some((targets, size));
        }
        let Some(([nearest, depth], _)) = &self.targets else {
            return;
        };
        let buffers = [(1, b.clip.get()), (2, g.triangles.get())];
        let layout = self.raster.get_bind_group_layout(0);
        let group = bind(&gpu.device, &layout, &buffers);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: nearest,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&self.raster);
        pass.set_bind_group(0, &group, &[]);
        for (_, triangles) in &g.parts {
            pass.draw(3 * triangles.start..3 * triangles.end, 0..1);
        }
    }

    fn gather(&self, gpu: &Gpu, encoder: &mut CommandEncoder, job: &Job) {
        let Some(([nearest, _], _)) = &self.targets else {
            return;
        };
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let entries = [
            entry(0, gpu.buffers.uniforms.get().as_entire_binding()),
            entry(5, gpu.buffers.hits.get().as_entire_binding()),
            entry(7, wgpu::BindingResource::TextureView(nearest)),
        ];
        let group = gpu
            .device
            .device
            .create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &self.gather.get_bind_group_layout(0),
                entries: &entries,
            });
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.gather);
        pass.set_bind_group(0, &group, &[]);
        let [w, h] = job.bands.size;
        pass.dispatch_workgroups(w.div_ceil(8), h.div_ceil(8), 1);
    }
}
