//! The pipelines, one a shader.
use super::device::Device;
use wgpu::{BindGroup, Buffer, ComputePipeline, RenderPipeline, ShaderModule};

pub const FRAME: &str = include_str!("shaders/frame.wgsl");
const DEFORM: &str = include_str!("shaders/deform.wgsl");
const PROJECT: &str = include_str!("shaders/project.wgsl");
const APPEND: &str = include_str!("shaders/append.wgsl");
const CHOOSE: &str = include_str!("shaders/choose.wgsl");
const CORNERS: &str = include_str!("shaders/corners.wgsl");
const SURFACE: &str = include_str!("shaders/surface.wgsl");
const WALK: &str = include_str!("shaders/walk.wgsl");
const FIRST: &str = include_str!("shaders/first.wgsl");
const BLEND: &str = include_str!("shaders/blend.wgsl");
const PIXEL: &str = include_str!("shaders/pixel.wgsl");
const LIGHT: &str = include_str!("shaders/light.wgsl");
const AVERAGE: &str = include_str!("shaders/average.wgsl");

/// Everything that is compiled once.
pub struct Passes {
    /// Skins: where their vertices are, and their normals.
    pub deform: ComputePipeline,
    pub normals: ComputePipeline,
    pub project: ComputePipeline,
    pub append: RenderPipeline,
    /// Which triangles are near lists, and those into lists that have begun.
    pub choose: ComputePipeline,
    pub begun: RenderPipeline,
    /// Which tiles have lists.
    pub begun_tiles: ComputePipeline,
    /// The nearest of all others.
    pub nearest: RenderPipeline,
    /// Opaque frames: what is seen first, and its light.
    pub first: ComputePipeline,
    pub light: ComputePipeline,
    /// Transparent frames: all layers, and the samples' mean.
    pub blend: ComputePipeline,
    pub average: ComputePipeline,
}

/// A pass without any attachment is refused: this one is never written.
pub const UNWRITTEN: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;
/// Number and facing of the nearest triangle, and its depth's bits.
const NEAREST: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
/// Near plane over distance.
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Where a depth buffer draws.
pub struct Targets {
    pub nearest: wgpu::TextureView,
    depth: wgpu::TextureView,
    pub size: [u32; 2],
}

impl Targets {
    pub fn new(device: &Device, size: [u32; 2]) -> Self {
        let usage = wgpu::TextureUsages::COPY_SRC;
        Self {
            nearest: target(device, NEAREST, size, usage),
            depth: target(device, DEPTH, size, wgpu::TextureUsages::empty()),
            size,
        }
    }

    /// A pass on them, cleared.
    pub fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder) -> wgpu::RenderPass<'a> {
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.nearest,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}

impl Passes {
    pub fn new(device: &Device) -> Self {
        let compute = |entry, parts: &[&str]| compute(device, &module(device, parts), entry);
        let lists = module(device, &[FRAME, APPEND]);
        Self {
            deform: compute("deform", &[FRAME, DEFORM]),
            normals: compute("normals", &[FRAME, DEFORM]),
            project: compute("project", &[FRAME, PROJECT]),
            append: append(device, &lists, ["vertex", "every"]),
            choose: compute("choose", &[FRAME, CHOOSE]),
            begun_tiles: compute("begun_tiles", &[FRAME, CHOOSE]),
            begun: append(device, &lists, ["vertex_chosen", "begun"]),
            nearest: nearest(device, &lists, "nearest"),
            first: compute("first", &[FRAME, CORNERS, WALK, FIRST]),
            light: compute("light", &[FRAME, CORNERS, SURFACE, PIXEL, LIGHT]),
            blend: compute("blend", &[FRAME, CORNERS, SURFACE, WALK, BLEND]),
            average: compute("average", &[FRAME, PIXEL, AVERAGE]),
        }
    }
}

pub fn module(device: &Device, parts: &[&str]) -> ShaderModule {
    device
        .device
        .create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(parts.concat().into()),
        })
}

pub fn compute(device: &Device, module: &ShaderModule, entry: &str) -> ComputePipeline {
    device
        .device
        .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        })
}

fn append(device: &Device, module: &ShaderModule, entries: [&str; 2]) -> RenderPipeline {
    let target = wgpu::ColorTargetState {
        format: UNWRITTEN,
        blend: None,
        write_mask: wgpu::ColorWrites::empty(),
    };
    raster(device, module, entries, target, None)
}

/// Draws triangles into [`NEAREST`], the nearest of each sample.
pub fn nearest(device: &Device, module: &ShaderModule, entry: &str) -> RenderPipeline {
    let target = wgpu::ColorTargetState {
        format: NEAREST,
        blend: None,
        write_mask: wgpu::ColorWrites::ALL,
    };
    let depth = wgpu::DepthStencilState {
        format: DEPTH,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Greater),
        stencil: Default::default(),
        bias: Default::default(),
    };
    raster(device, module, ["vertex", entry], target, Some(depth))
}

/// Draws triangles, both faces.
fn raster(
    device: &Device,
    module: &ShaderModule,
    [vertex, fragment]: [&str; 2],
    target: wgpu::ColorTargetState,
    depth_stencil: Option<wgpu::DepthStencilState>,
) -> RenderPipeline {
    device
        .device
        .create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: None,
            layout: None,
            vertex: wgpu::VertexState {
                module,
                entry_point: Some(vertex),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some(fragment),
                compilation_options: Default::default(),
                targets: &[Some(target)],
            }),
            multiview_mask: None,
            cache: None,
        })
}

/// Something to draw on.
pub fn target(
    device: &Device,
    format: wgpu::TextureFormat,
    [width, height]: [u32; 2],
    usage: wgpu::TextureUsages,
) -> wgpu::TextureView {
    let texture = device.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    texture.create_view(&Default::default())
}

/// Buffers with the numbers of their bindings.
pub fn bind(
    device: &Device,
    layout: &wgpu::BindGroupLayout,
    buffers: &[(u32, &Buffer)],
) -> BindGroup {
    let entries: Vec<_> = buffers
        .iter()
        .map(|(binding, buffer)| wgpu::BindGroupEntry {
            binding: *binding,
            resource: buffer.as_entire_binding(),
        })
        .collect();
    device.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout,
        entries: &entries,
    })
}

/// Runs a compute shader over so many groups.
pub fn run(
    device: &Device,
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &ComputePipeline,
    buffers: &[(u32, &Buffer)],
    [across, down]: [u32; 2],
) {
    let group = bind(device, &pipeline.get_bind_group_layout(0), buffers);
    let mut pass = encoder.begin_compute_pass(&Default::default());
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.dispatch_workgroups(across, down, 1);
}

/// The same over as many as the device has found itself.
pub fn run_counted(
    device: &Device,
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &ComputePipeline,
    buffers: &[(u32, &Buffer)],
    groups: &Buffer,
) {
    let group = bind(device, &pipeline.get_bind_group_layout(0), buffers);
    let mut pass = encoder.begin_compute_pass(&Default::default());
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.dispatch_workgroups_indirect(groups, 0);
}
