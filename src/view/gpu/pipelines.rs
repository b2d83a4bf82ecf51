//! How wgpu draws: the shaders of `overlay.wgsl` with what they are given, once for the surfaces of a cast picture, and twice for every kind of shape.

use crate::view::overlay::{Corner, Line, Point};
use eframe::egui_wgpu::wgpu;

/// Of the texture that is shown.
pub(super) const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A pipeline for what is before surfaces, and one for what is behind them.
pub(super) struct Sides {
    pub(super) before: wgpu::RenderPipeline,
    pub(super) behind: wgpu::RenderPipeline,
}

/// Every pipeline, and the layouts of what it is given.
pub(super) struct Pipelines {
    pub(super) frame_layout: wgpu::BindGroupLayout,
    pub(super) batch_layout: wgpu::BindGroupLayout,
    pub(super) cast_layout: wgpu::BindGroupLayout,
    pub(super) surface: wgpu::RenderPipeline,
    pub(super) lines: Sides,
    pub(super) points: Sides,
    pub(super) faces: Sides,
    /// How the colours of a cast picture are read.
    pub(super) smooth: wgpu::Sampler,
}

impl Pipelines {
    pub(super) fn new(device: &wgpu::Device) -> Pipelines {
        let layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let frame_layout = layout("frame", &[uniform_entry(0)]);
        let batch_layout = layout("batch", &[uniform_entry(0)]);
        let sampler = wgpu::BindGroupLayoutEntry {
            binding: 2,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
            count: None,
        };
        let cast_layout = layout("cast", &[texture_entry(0, true), texture_entry(1, false), sampler]);
        let module = device.create_shader_module(wgpu::include_wgsl!("../overlay.wgsl"));
        let maker = Maker { device, module, frame: &frame_layout };
        let steps = wgpu::VertexStepMode::Instance;
        let attributes = wgpu::vertex_attr_array![0 => Float32x4, 1 => Float32x3, 2 => Unorm8x4];
        let lines = maker.shapes("line", &batch_layout, size_of::<Line>(), steps, &attributes);
        let attributes = wgpu::vertex_attr_array![0 => Float32x4, 1 => Unorm8x4];
        let points = maker.shapes("point", &batch_layout, size_of::<Point>(), steps, &attributes);
        let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm8x4];
        let steps = wgpu::VertexStepMode::Vertex;
        let faces = maker.shapes("face", &batch_layout, size_of::<Corner>(), steps, &attributes);
        let surface = maker.surface(&cast_layout);
        let smooth = device.create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Pipelines { frame_layout, batch_layout, cast_layout, surface, lines, points, faces, smooth }
    }
}

fn uniform_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    }
}

fn texture_entry(binding: u32, filterable: bool) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty: wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        },
        count: None,
    }
}

/// Makes pipelines.
struct Maker<'a> {
    device: &'a wgpu::Device,
    module: wgpu::ShaderModule,
    frame: &'a wgpu::BindGroupLayout,
}

/// What tells two pipelines apart.
struct Stage<'a> {
    name: &'a str,
    group: &'a wgpu::BindGroupLayout,
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    depth_write: bool,
    compare: wgpu::CompareFunction,
    blend: wgpu::BlendState,
    constants: &'a [(&'a str, f64)],
}

impl Maker<'_> {
    fn surface(&self, group: &wgpu::BindGroupLayout) -> wgpu::RenderPipeline {
        self.pipeline(&Stage {
            name: "surface",
            group,
            buffers: &[],
            depth_write: true,
            compare: wgpu::CompareFunction::Always,
            blend: wgpu::BlendState::REPLACE,
            constants: &[],
        })
    }

    fn shapes(
        &self,
        name: &str,
        group: &wgpu::BindGroupLayout,
        bytes: usize,
        step_mode: wgpu::VertexStepMode,
        attributes: &[wgpu::VertexAttribute],
    ) -> Sides {
        let buffer = wgpu::VertexBufferLayout { array_stride: bytes as u64, step_mode, attributes };
        let pipeline = |compare, behind| {
            self.pipeline(&Stage {
                name,
                group,
                buffers: &[Some(buffer.clone())],
                depth_write: false,
                compare,
                blend: wgpu::BlendState::ALPHA_BLENDING,
                constants: &[("BEHIND", behind)],
            })
        };
        // Greater is nearer.
        Sides {
            before: pipeline(wgpu::CompareFunction::GreaterEqual, 0.0),
            behind: pipeline(wgpu::CompareFunction::Less, 1.0),
        }
    }

    fn pipeline(&self, stage: &Stage) -> wgpu::RenderPipeline {
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(stage.name),
            bind_group_layouts: &[Some(self.frame), Some(stage.group)],
            immediate_size: 0,
        });
        let options = wgpu::PipelineCompilationOptions { constants: stage.constants, ..Default::default() };
        let (vertex, fragment) = (format!("{}_vertex", stage.name), format!("{}_fragment", stage.name));
        self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(stage.name),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some(&vertex),
                compilation_options: options.clone(),
                buffers: stage.buffers,
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(stage.depth_write),
                depth_compare: Some(stage.compare),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some(&fragment),
                compilation_options: options,
                targets: &[Some(wgpu::ColorTargetState {
                    format: COLOR,
                    blend: Some(stage.blend),
                    write_mask: wgpu::ColorWrites::ALL,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}
