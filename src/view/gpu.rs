//! A cast picture and its overlay, drawn by wgpu into a texture: what a window shows and what a screenshot reads back.
//!
//! [`Painter`] has the pipelines and keeps the buffers of batches that do not change; a [`Canvas`] has the textures of one view. The depths of the
//! cast picture become the depth buffer, so that lines are hidden by surfaces that no GPU has ever seen.

mod pipelines;

use super::cast::Image;
use super::overlay::{Batch, Corner, Line, Overlay, Point, Shapes};
use crate::render::camera::Camera;
use bytemuck::{Pod, Zeroable};
use eframe::egui_wgpu::wgpu::{self, util::DeviceExt};
use pipelines::{COLOR, DEPTH, Pipelines, Sides};
use std::collections::HashMap;

/// What is the same for all shapes of a frame; as in `overlay.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Frame {
    eye: [f32; 3],
    near: f32,
    right: [f32; 3],
    width: f32,
    down: [f32; 3],
    height: f32,
    forward: [f32; 3],
    surface: f32,
}

/// How a picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Opacity of surfaces.
    pub surface: f32,
    /// Nothing nearer than this is drawn of overlays.
    pub near: f32,
    /// Most shapes of a batch that is thinned.
    pub most: usize,
}

/// The buffers of a batch.
struct Kept {
    /// Keeps the shapes alive, so that their address stays theirs.
    _shapes: Shapes,
    vertices: wgpu::Buffer,
    settings: wgpu::Buffer,
    group: wgpu::BindGroup,
    used: bool,
}

/// Everything that views share.
pub struct Painter {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipelines: Pipelines,
    /// By the address of the batch's shapes.
    kept: HashMap<usize, Kept>,
    /// Whether anything was drawn since buffers were given up.
    drawn: bool,
}

/// The textures of one view.
pub struct Canvas {
    size: [u32; 2],
    color: wgpu::Texture,
    depth: wgpu::TextureView,
    frame: wgpu::Buffer,
    frame_group: wgpu::BindGroup,
    cast: Option<Cast>,
}

/// The cast picture as textures.
struct Cast {
    size: [u32; 2],
    color: wgpu::Texture,
    depth: wgpu::Texture,
    group: wgpu::BindGroup,
}

impl Canvas {
    pub fn view(&self) -> wgpu::TextureView {
        self.color.create_view(&wgpu::TextureViewDescriptor::default())
    }

    pub fn size(&self) -> [u32; 2] {
        self.size
    }
}

impl Painter {
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Painter {
        let pipelines = Pipelines::new(device);
        let (device, queue) = (device.clone(), queue.clone());
        Painter { device, queue, pipelines, kept: HashMap::new(), drawn: false }
    }

    fn texture(
        &self,
        size: [u32; 2],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: extent(size),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    }

    /// An empty view of so many pixels, at least one.
    pub fn canvas(&self, size: [u32; 2]) -> Canvas {
        let most = self.device.limits().max_texture_dimension_2d;
        let size = size.map(|side| side.clamp(1, most));
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let color = self.texture(
            size,
            COLOR,
            attachment | wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC,
        );
        let depth = self.texture(size, DEPTH, attachment).create_view(&Default::default());
        let frame = self.uniform(size_of::<Frame>());
        let frame_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipelines.frame_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() }],
        });
        Canvas { size, color, depth, frame, frame_group, cast: None }
    }

    fn uniform(&self, bytes: usize) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Puts a cast picture on a canvas; it stays until the next one.
    pub fn upload(&self, canvas: &mut Canvas, image: &Image) {
        let size = [image.width as u32, image.height as u32];
        let cast = match canvas.cast.take().filter(|cast| cast.size == size) {
            Some(cast) => cast,
            None => self.cast(size),
        };
        self.write(&cast.color, bytemuck::cast_slice(&image.colors), size);
        // Infinity is not sure to survive a texture.
        let depths: Vec<f32> = image.depths.iter().map(|depth| depth.min(1e38)).collect();
        self.write(&cast.depth, bytemuck::cast_slice(&depths), size);
        canvas.cast = Some(cast);
    }

    fn cast(&self, size: [u32; 2]) -> Cast {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        let color = self.texture(size, COLOR, usage);
        let depth = self.texture(size, wgpu::TextureFormat::R32Float, usage);
        let views = [&color, &depth].map(|texture| texture.create_view(&Default::default()));
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipelines.cast_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&views[0]) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&views[1]) },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::Sampler(&self.pipelines.smooth),
                },
            ],
        });
        Cast { size, color, depth, group }
    }

    /// Writes texels of four bytes.
    fn write(&self, texture: &wgpu::Texture, bytes: &[u8], size: [u32; 2]) {
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * size[0]), rows_per_image: None };
        self.queue.write_texture(texture.as_image_copy(), bytes, layout, extent(size));
    }

    /// Draws the picture that was uploaded last, seen by `camera`, and `overlay` over it.
    pub fn draw(&mut self, canvas: &Canvas, camera: &Camera, overlay: &Overlay, look: &Look) {
        let [right, down] = camera.half_plane().map(|axis| axis / axis.length_squared());
        let frame = Frame {
            eye: camera.eye.into(),
            near: look.near,
            right: right.into(),
            width: canvas.size[0] as f32,
            down: down.into(),
            height: canvas.size[1] as f32,
            forward: camera.forward.into(),
            surface: look.surface,
        };
        self.queue.write_buffer(&canvas.frame, 0, bytemuck::bytes_of(&frame));
        let batches: Vec<(usize, u32, &Batch)> = overlay
            .batches
            .iter()
            .filter_map(|batch| {
                let (key, count) = self.keep(batch)?;
                let most = if batch.thinned { look.most } else { usize::MAX };
                Some((key, count.min(most) as u32, batch))
            })
            .collect();
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let view = canvas.view();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("view"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &canvas.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_bind_group(0, &canvas.frame_group, &[]);
        if let Some(cast) = &canvas.cast {
            pass.set_pipeline(&self.pipelines.surface);
            pass.set_bind_group(1, &cast.group, &[]);
            pass.draw(0..3, 0..1);
        }
        for (key, count, batch) in batches {
            let Some(kept) = self.kept.get(&key) else { continue };
            pass.set_bind_group(1, &kept.group, &[]);
            pass.set_vertex_buffer(0, kept.vertices.slice(..));
            let (sides, vertices, instances) = match &batch.shapes {
                Shapes::Lines(_) => (&self.pipelines.lines, 6, count),
                Shapes::Points(_) => (&self.pipelines.points, 6, count),
                Shapes::Faces(_) => (&self.pipelines.faces, count, 1),
            };
            let Sides { before, behind } = sides;
            if batch.behind > 0.0 {
                pass.set_pipeline(behind);
                pass.draw(0..vertices, 0..instances);
            }
            pass.set_pipeline(before);
            pass.draw(0..vertices, 0..instances);
        }
        drop(pass);
        self.queue.submit([encoder.finish()]);
        self.drawn = true;
    }

    /// The buffers of a batch, made or found again, and the number of its shapes; `None` when it has none.
    fn keep(&mut self, batch: &Batch) -> Option<(usize, usize)> {
        let (key, count, bytes): (usize, usize, &[u8]) = match &batch.shapes {
            Shapes::Lines(lines) => (lines.as_ptr() as usize, lines.len(), bytemuck::cast_slice(lines)),
            Shapes::Points(points) => (points.as_ptr() as usize, points.len(), bytemuck::cast_slice(points)),
            Shapes::Faces(corners) => {
                (corners.as_ptr() as usize, corners.len(), bytemuck::cast_slice(corners))
            }
        };
        // What a device cannot hold in one buffer is not drawn in full, but drawn.
        let most = self.device.limits().max_buffer_size as usize / 64 * 32;
        let bytes = &bytes[..bytes.len().min(most)];
        if bytes.is_empty() {
            return None;
        }
        if !self.kept.contains_key(&key) {
            let vertices = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: bytes,
                usage: wgpu::BufferUsages::VERTEX,
            });
            let settings = self.uniform(16);
            let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &self.pipelines.batch_layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: settings.as_entire_binding() }],
            });
            let kept = Kept { _shapes: batch.shapes.clone(), vertices, settings, group, used: true };
            self.kept.insert(key, kept);
        }
        let kept = self.kept.get_mut(&key)?;
        kept.used = true;
        let settings = [batch.opacity, batch.behind, batch.scale, 0.0];
        self.queue.write_buffer(&kept.settings, 0, bytemuck::cast_slice(&settings));
        let shape = match &batch.shapes {
            Shapes::Lines(_) => size_of::<Line>(),
            Shapes::Points(_) => size_of::<Point>(),
            Shapes::Faces(_) => size_of::<Corner>(),
        };
        Some((key, count.min(bytes.len() / shape)))
    }

    /// Gives up the buffers of batches that no canvas has drawn since the last call, if any has drawn anything.
    pub fn forget(&mut self) {
        if std::mem::take(&mut self.drawn) {
            self.kept.retain(|_, kept| std::mem::take(&mut kept.used));
        }
    }
}

fn extent([width, height]: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}
