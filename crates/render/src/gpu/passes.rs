//! The pipelines, one a shader.
use super::device::Device;
use wgpu::{BindGroup, Buffer, ComputePipeline, RenderPipeline, ShaderModule};

const FRAME: &str = include_str!("shaders/frame.wgsl");
const PROJECT: &str = include_str!("shaders/project.wgsl");
const APPEND: &str = include_str!("shaders/append.wgsl");
const SURFACE: &str = include_str!("shaders/surface.wgsl");
const RESOLVE: &str = include_str!("shaders/resolve.wgsl");
const LIGHT: &str = include_str!("shaders/light.wgsl");

/// Everything that is compiled once.
pub struct Passes {
    pub project: ComputePipeline,
    pub append: RenderPipeline,
    pub resolve: ComputePipeline,
    pub opaque: ComputePipeline,
    pub transparent: ComputePipeline,
}

/// A pass without any attachment is refused: this one is never written.
pub const UNWRITTEN: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

impl Passes {
    pub fn new(device: &Device) -> Self {
        let light = module(device, &[FRAME, SURFACE, LIGHT]);
        Self {
            project: compute(device, &module(device, &[FRAME, PROJECT]), "project"),
            append: append(device, &module(device, &[FRAME, APPEND])),
            resolve: compute(
                device,
                &module(device, &[FRAME, SURFACE, RESOLVE]),
                "resolve",
            ),
            opaque: compute(device, &light, "opaque"),
            transparent: compute(device, &light, "transparent"),
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

fn append(device: &Device, module: &ShaderModule) -> RenderPipeline {
    let target = wgpu::ColorTargetState {
        format: UNWRITTEN,
        blend: None,
        write_mask: wgpu::ColorWrites::empty(),
    };
    device
        .device
        .create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("append"),
            layout: None,
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vertex"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some("fragment"),
                compilation_options: Default::default(),
                targets: &[Some(target)],
            }),
            multiview_mask: None,
            cache: None,
        })
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
