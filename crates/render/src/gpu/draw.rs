//! One attempt at a frame: what the device is told to do, and what is read back.
use super::Gpu;
use super::buffers::Growing;
use super::device::{Device, Fault};
use super::geometry::Geometry;
use super::lists::{Bands, LINE, NODE, Room};
use super::passes::{Targets, UNWRITTEN, bind, run, run_counted, target};
use crate::frame::{Frame, Image, Options};
use crate::project::{NEAR, Raster};
use crate::scene::Kind;
use wgpu::{BufferUsages as Usage, CommandEncoder};

/// A hit's number of a triangle, without its facing; as in frame.wgsl.
const TRIANGLE: u32 = 0x0fff_ffff;

/// What is to be drawn, and with how much room.
pub struct Job<'a> {
    pub raster: &'a Raster,
    pub options: &'a Options,
    pub background: [[f32; 3]; 2],
    pub bands: Bands,
    pub room: Room,
    /// Whether ids and depths are wanted besides the picture.
    pub is_hit_wanted: bool,
    /// Whether only what the crack reaches has lists.
    pub is_sparse: bool,
}

/// A band of the frame: its first row, and how many.
#[derive(Clone, Copy)]
pub struct Band {
    pub start: u32,
    pub rows: u32,
}

/// How much is read back: a word for each band, then the pixels, then the hits.
#[derive(Clone, Copy)]
struct Readback {
    n_bands: usize,
    n_pixels: usize,
    n_hits: usize,
}

/// Buffers of a frame.
pub struct Buffers {
    pub uniforms: Growing,
    taps: Growing,
    pub clip: Growing,
    heads: Growing,
    nodes: Growing,
    counters: Growing,
    /// Numbers of the triangles that are near lists, and the call that draws them.
    chosen: Growing,
    call: Growing,
    /// Numbers of the tiles that have lists, and the call that walks them.
    tiles: Growing,
    tile_call: Growing,
    pub hits: Growing,
    colors: Growing,
    pixels: Growing,
    readback: Growing,
    unwritten: Option<(wgpu::TextureView, [u32; 2])>,
    targets: Option<Targets>,
}

impl Buffers {
    pub fn new(device: &Device, taps: &[[f32; 2]]) -> Result<Self, Fault> {
        let call = |name| Growing::new(name, Usage::STORAGE | Usage::INDIRECT | Usage::COPY_DST);
        let uniform = |name| Growing::new(name, Usage::UNIFORM | Usage::COPY_DST);
        let mut buffers = Self {
            uniforms: uniform("uniforms"),
            taps: uniform("taps"),
            clip: Growing::storage("clip"),
            heads: Growing::storage("heads"),
            nodes: Growing::storage("nodes"),
            counters: Growing::result("counters"),
            chosen: Growing::storage("chosen"),
            call: call("call"),
            tiles: Growing::storage("tiles"),
            tile_call: call("tile call"),
            hits: Growing::result("hits"),
            colors: Growing::storage("colors"),
            pixels: Growing::result("pixels"),
            readback: Growing::new("readback", Usage::MAP_READ | Usage::COPY_DST),
            unwritten: None,
            targets: None,
        };
        buffers.taps.write(device, taps)?;
        Ok(buffers)
    }

    pub fn reserve(&mut self, device: &Device, job: &Job, of: &Geometry) -> Result<(), Fault> {
        let [w, h] = job.bands.size.map(|n| n as usize);
        let bytes = [
            (&mut self.clip, 16 * of.n_vertices as usize),
            (&mut self.chosen, 4 * of.n_triangles() as usize),
            (&mut self.heads, 4 * w * job.bands.rows as usize),
            (
                &mut self.nodes,
                4 * NODE as usize * job.room.capacity(job.bands) as usize,
            ),
            (
                &mut self.counters,
                4 * (LINE * (job.bands.tiles() + 1)) as usize,
            ),
            (&mut self.tiles, 4 * job.bands.tiles() as usize),
            (&mut self.hits, 8 * job.stride() as usize * h),
            (
                &mut self.colors,
                if job.options.is_transparent {
                    16 * w * h
                } else {
                    0
                },
            ),
            (&mut self.pixels, 4 * job.readback().n_pixels),
            (&mut self.readback, 4 * job.readback().words()),
        ];
        for (buffer, bytes) in bytes {
            buffer.reserve(device, bytes)?;
        }
        if self
            .unwritten
            .as_ref()
            .is_none_or(|u| u.1 != job.bands.size)
        {
            let view = target(
                device,
                UNWRITTEN,
                job.bands.size,
                wgpu::TextureUsages::empty(),
            );
            self.unwritten = Some((view, job.bands.size));
        }
        if (self.targets.as_ref()).is_none_or(|t| t.size != job.bands.size) {
            self.targets = Some(Targets::new(device, job.bands.size));
        }
        Ok(())
    }

    /// A pass that fills lists and is never written itself; made before.
    fn unwritten_pass<'a>(&self, encoder: &'a mut CommandEncoder) -> wgpu::RenderPass<'a> {
        let unwritten = (self.unwritten.as_ref()).map(|(view, _)| view);
        let attachment = unwritten.map(|view| wgpu::RenderPassColorAttachment {
            view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                store: wgpu::StoreOp::Discard,
            },
        });
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[attachment],
            ..Default::default()
        })
    }

    /// Nothing is to be drawn yet: vertices, instances, where both start; groups for tiles, for the 8 x 8 samples of one.
    pub fn no_calls(&mut self, device: &Device) -> Result<(), Fault> {
        self.call.write(device, &[0, 1, 0, 0])?;
        self.tile_call.write(device, &[0, 64, 1, 0])
    }

    /// What the depth buffer found in a band becomes its hits.
    pub fn take_nearest(&self, encoder: &mut CommandEncoder, job: &Job, band: Band) {
        let mut nearest = self.targets().nearest.texture().as_image_copy();
        nearest.origin.y = band.start;
        let row = 8 * job.stride();
        let hits = wgpu::TexelCopyBufferInfo {
            buffer: self.hits.get(),
            layout: wgpu::TexelCopyBufferLayout {
                offset: u64::from(band.start * row),
                bytes_per_row: Some(row),
                rows_per_image: None,
            },
        };
        let size = wgpu::Extent3d {
            width: job.bands.size[0],
            height: band.rows,
            depth_or_array_layers: 1,
        };
        encoder.copy_texture_to_buffer(nearest, hits, size);
    }

    /// A depth buffer's; made before.
    pub fn targets(&self) -> &Targets {
        (self.targets.as_ref()).expect("targets are made before they are drawn on")
    }
}

/// Groups of 64 across and down for so many elements.
fn of_64(n: u32) -> [u32; 2] {
    let groups = n.div_ceil(64);
    [groups.min(4096), groups.div_ceil(4096)]
}

impl Readback {
    fn words(self) -> usize {
        self.n_bands + self.n_pixels + 2 * self.n_hits
    }
}

impl Job<'_> {
    fn readback(&self) -> Readback {
        let h = self.bands.size[1] as usize;
        Readback {
            n_bands: self.bands.starts().count(),
            n_pixels: self.options.width * self.options.height,
            n_hits: if self.is_hit_wanted {
                self.stride() as usize * h
            } else {
                0
            },
        }
    }

    /// From a row of hits to the next: rows are copied from a texture, which takes steps of 256 bytes.
    fn stride(&self) -> u32 {
        self.bands.size[0].next_multiple_of(32)
    }

    pub fn bands(&self) -> impl Iterator<Item = Band> {
        self.bands.starts().map(|start| Band {
            start,
            rows: self.bands.rows.min(self.bands.size[1] - start),
        })
    }

    /// `Frame` of frame.wgsl.
    pub fn uniforms(&self, geometry: &Geometry, band: Band) -> [u32; 36] {
        let c = &self.raster.camera;
        let row = |v: [f32; 3], w: u32| [v[0].to_bits(), v[1].to_bits(), v[2].to_bits(), w];
        let [right, up, forward] = c.axes;
        let [top, bottom] = self.background;
        let [w, h] = self.bands.size;
        let samples = (self.raster.width / self.options.width) as u32;
        let rows = [
            row(c.eye, c.tangent.to_bits()),
            row(right, c.shift.to_bits()),
            row(up, c.distance.to_bits()),
            row(forward, NEAR.to_bits()),
            row(top, geometry.n_vertices),
            row(bottom, u32::from(self.options.is_transparent)),
            [w, h, samples, band.start],
            [
                band.rows,
                self.room.own(self.bands),
                self.room.spill(self.bands),
                self.room.capacity(self.bands),
            ],
            [
                geometry.n_anchored,
                geometry.n_triangles(),
                self.stride(),
                0,
            ],
        ];
        std::array::from_fn(|k| rows[k / 4][k % 4])
    }
}

impl Gpu {
    /// Draws with the room there is; gives how many fragments asked for shared places in the fullest band.
    pub fn draw(&mut self, job: &Job) -> Result<(u32, Frame), Fault> {
        let device = &self.device;
        self.buffers.reserve(device, job, &self.geometry)?;
        for (k, band) in job.bands().enumerate() {
            let uniforms = job.uniforms(&self.geometry, band);
            self.buffers.uniforms.write(device, &uniforms)?;
            self.buffers.no_calls(device)?;
            let mut encoder = device.device.create_command_encoder(&Default::default());
            if k == 0 {
                self.project(&mut encoder);
            }
            self.append(&mut encoder, job, band);
            self.resolve(&mut encoder, job, band, k);
            if k + 1 == job.readback().n_bands {
                self.light(&mut encoder, job);
            }
            device.queue.submit([encoder.finish()]);
        }
        self.read(job)
    }

    /// Vertices to where the cells have moved them, and into clip space.
    pub fn project(&self, encoder: &mut CommandEncoder) {
        let (b, g) = (&self.buffers, &self.geometry);
        if g.n_anchored > 0 {
            let buffers = [
                (0, b.uniforms.get()),
                (1, g.positions.get()),
                (2, g.anchors.get()),
                (3, g.cells.get()),
            ];
            let groups = of_64(g.n_anchored);
            run(&self.device, encoder, &self.passes.deform, &buffers, groups);
            let buffers = [
                (0, b.uniforms.get()),
                (1, g.positions.get()),
                (2, g.anchors.get()),
                (4, g.attributes.get()),
                (5, g.triangles.get()),
                (6, g.incident.get()),
            ];
            run(
                &self.device,
                encoder,
                &self.passes.normals,
                &buffers,
                groups,
            );
        }
        let buffers = [
            (0, b.uniforms.get()),
            (1, g.positions.get()),
            (2, b.clip.get()),
        ];
        let groups = of_64(g.n_vertices);
        run(
            &self.device,
            encoder,
            &self.passes.project,
            &buffers,
            groups,
        );
    }

    /// Fills the lists of a band.
    pub fn append(&self, encoder: &mut CommandEncoder, job: &Job, band: Band) {
        let (b, g, append) = (&self.buffers, &self.geometry, &self.passes.append);
        let w = job.bands.size[0];
        encoder.clear_buffer(b.heads.get(), 0, Some(4 * u64::from(w * band.rows)));
        encoder.clear_buffer(b.counters.get(), 0, None);
        let buffers = [
            (0, b.uniforms.get()),
            (1, b.clip.get()),
            (2, g.triangles.get()),
            (3, g.meshes.get()),
            (4, b.heads.get()),
            (5, b.nodes.get()),
            (6, b.counters.get()),
        ];
        let cuts = |kind| !matches!(kind, Kind::Bone | Kind::Within | Kind::Solid);
        // What lies within the bone is for transparent bones only.
        let is_shown = |kind| kind != Kind::Within || job.options.is_transparent;
        let bound = |layout: wgpu::BindGroupLayout, of: &[(u32, &wgpu::Buffer)]| {
            bind(&self.device, &layout, of)
        };
        let group = bound(append.get_bind_group_layout(0), &buffers);
        let mut pass = b.unwritten_pass(encoder);
        pass.set_pipeline(append);
        pass.set_bind_group(0, &group, &[]);
        pass.set_scissor_rect(0, band.start, w, band.rows);
        g.draw(&mut pass, |kind| {
            is_shown(kind) && (!job.is_sparse || cuts(kind))
        });
        drop(pass);
        if !job.is_sparse {
            return;
        }
        let chosen = (7, b.chosen.get());
        let to_choose = [
            &buffers[..4],
            &[(6, b.counters.get()), chosen, (8, b.call.get())],
        ];
        let groups = of_64(g.n_triangles());
        let choose = &self.passes.choose;
        run(&self.device, encoder, choose, &to_choose.concat(), groups);
        let begun = &self.passes.begun;
        let with_chosen = [&buffers[..], &[chosen]].concat();
        let group = bound(begun.get_bind_group_layout(0), &with_chosen);
        let mut pass = b.unwritten_pass(encoder);
        pass.set_pipeline(begun);
        pass.set_bind_group(0, &group, &[]);
        pass.set_scissor_rect(0, band.start, w, band.rows);
        pass.draw_indirect(b.call.get(), 0);
        drop(pass);
        let nearest = &self.passes.nearest;
        let group = bound(nearest.get_bind_group_layout(0), &buffers[1..4]);
        let mut pass = b.targets().pass(encoder);
        pass.set_pipeline(nearest);
        pass.set_bind_group(0, &group, &[]);
        pass.set_scissor_rect(0, band.start, w, band.rows);
        g.draw(&mut pass, |kind| is_shown(kind) && !cuts(kind));
    }

    /// What surface.wgsl binds.
    fn surface(&self) -> [(u32, &wgpu::Buffer); 6] {
        let (b, g) = (&self.buffers, &self.geometry);
        [
            (0, b.uniforms.get()),
            (1, g.triangles.get()),
            (2, g.meshes.get()),
            (3, g.positions.get()),
            (4, g.attributes.get()),
            (5, b.hits.get()),
        ]
    }

    /// Walks the lists of a band, and notes how many fragments asked for shared places.
    pub fn resolve(&self, encoder: &mut CommandEncoder, job: &Job, band: Band, k: usize) {
        let b = &self.buffers;
        let lists = [(7, b.heads.get()), (8, b.nodes.get())];
        let groups = [job.bands.size[0].div_ceil(8), band.rows.div_ceil(8)];
        if job.options.is_transparent {
            let buffers = [&self.surface()[..], &[(6, b.colors.get())], &lists].concat();
            run(&self.device, encoder, &self.passes.blend, &buffers, groups);
        } else {
            if job.is_sparse {
                b.take_nearest(encoder, job, band);
            } else {
                let row = 8 * u64::from(job.stride());
                let [start, rows] = [band.start, band.rows].map(u64::from);
                encoder.clear_buffer(b.hits.get(), start * row, Some(rows * row));
            }
            let device = &self.device;
            let (uniforms, tiles) = ((0, b.uniforms.get()), (9, b.tiles.get()));
            let counted = [
                uniforms,
                (6, b.counters.get()),
                tiles,
                (10, b.tile_call.get()),
            ];
            let of = of_64(job.bands.tiles());
            run(device, encoder, &self.passes.begun_tiles, &counted, of);
            let g = &self.geometry;
            let corners = [(1, g.triangles.get()), (3, g.positions.get())];
            let own = [uniforms, (5, b.hits.get()), tiles];
            let buffers = [&own[..], &corners, &lists].concat();
            let calls = b.tile_call.get();
            run_counted(device, encoder, &self.passes.first, &buffers, calls);
        }
        encoder.copy_buffer_to_buffer(b.counters.get(), 0, b.readback.get(), 4 * k as u64, 4);
    }

    /// Samples to pixels, and those to where they can be read.
    pub fn light(&self, encoder: &mut CommandEncoder, job: &Job) {
        let b = &self.buffers;
        let groups = [job.options.width, job.options.height].map(|n| (n as u32).div_ceil(8));
        let (pixels, taps) = ((7, b.pixels.get()), (8, b.taps.get()));
        if job.options.is_transparent {
            let buffers = [(0, b.uniforms.get()), (6, b.colors.get()), pixels];
            run(
                &self.device,
                encoder,
                &self.passes.average,
                &buffers,
                groups,
            );
        } else {
            let buffers = [&self.surface()[..], &[pixels, taps]].concat();
            run(&self.device, encoder, &self.passes.light, &buffers, groups);
        }
        let r = job.readback();
        let (mut at, bytes) = (4 * r.n_bands as u64, 4 * r.n_pixels as u64);
        encoder.copy_buffer_to_buffer(b.pixels.get(), 0, b.readback.get(), at, bytes);
        at += bytes;
        if r.n_hits > 0 {
            let bytes = 8 * r.n_hits as u64;
            encoder.copy_buffer_to_buffer(b.hits.get(), 0, b.readback.get(), at, bytes);
        }
    }

    /// Waits for the frame and takes it.
    pub fn read(&self, job: &Job) -> Result<(u32, Frame), Fault> {
        let r = job.readback();
        let slice = self.buffers.readback.get().slice(..4 * r.words() as u64);
        slice.map_async(wgpu::MapMode::Read, |_| {});
        self.device.wait()?;
        let view = slice
            .get_mapped_range()
            .map_err(|e| Fault::Driver(e.to_string()))?;
        let words: &[u32] = bytemuck::cast_slice(&view);
        let (spilled, rest) = words.split_at(r.n_bands);
        let (pixels, hits) = rest.split_at(r.n_pixels);
        let rows = bytemuck::cast_slice(hits).chunks(job.stride() as usize);
        let w = job.bands.size[0] as usize;
        let hits = || rows.clone().flat_map(|row: &[[u32; 2]]| &row[..w]);
        let id = |h: &[u32; 2]| match h[1] {
            0 => 0,
            _ => self.geometry.mesh_of(h[0] & TRIANGLE) + 1,
        };
        let spilled = spilled.iter().copied().max().unwrap_or(0);
        let frame = Frame {
            image: Image {
                width: job.options.width,
                height: job.options.height,
                pixels: bytemuck::cast_slice(pixels).to_vec(),
            },
            ids: hits().map(id).collect(),
            depths: hits().map(|h| f32::from_bits(h[1])).collect(),
        };
        drop(view);
        self.buffers.readback.get().unmap();
        Ok((spilled, frame))
    }
}
