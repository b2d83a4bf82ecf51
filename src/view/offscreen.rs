//! The viewer without a screen: the same content, fed with events and drawn into a texture that is read back. For screenshots, measurements
//! and tests.

use super::app::Viewer;
use super::wishes::Wishes;
use eframe::egui::{self, Event, FullOutput, RawInput, Rect, pos2, vec2};
use eframe::egui_wgpu::wgpu;
use eframe::egui_wgpu::{
    RenderState, RendererOptions, ScreenDescriptor, WgpuConfiguration, WgpuError, WgpuSetup,
    WgpuSetupCreateNew,
};
use image::RgbaImage;
use std::path::PathBuf;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use thiserror::Error;

/// Sides of a screenshot may be so long.
pub const LONGEST_SIDE: u32 = 8192;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum OffscreenError {
    #[error("no graphics device: {0} (Mesa's software driver would do: Debian package mesa-vulkan-drivers)")]
    Device(#[from] WgpuError),
    #[error("reading the picture back: {0}")]
    Read(String),
    #[error("{0}")]
    Files(String),
    #[error("the picture was not finished within {} seconds", .0.as_secs())]
    Patience(Duration),
}

/// A viewer whose window exists in memory only.
pub struct Offscreen {
    pub viewer: Viewer,
    context: egui::Context,
    target: RenderState,
    size: [u32; 2],
    started: Instant,
    last: FullOutput,
}

impl Offscreen {
    /// Starts to open files, for a window of `size` pixels.
    ///
    /// # Errors
    /// When there is no graphics device, not even one in software.
    pub fn new(paths: Vec<PathBuf>, wishes: Wishes, size: [u32; 2]) -> Result<Offscreen, OffscreenError> {
        let size = size.map(|side| side.clamp(1, LONGEST_SIDE));
        let setup = WgpuSetup::CreateNew(WgpuSetupCreateNew::without_display_handle());
        let configuration = WgpuConfiguration { wgpu_setup: setup.clone(), ..Default::default() };
        let target = pollster::block_on(async {
            let instance = setup.new_instance().await;
            RenderState::create(&configuration, &instance, None, RendererOptions::PREDICTABLE).await
        })?;
        let context = egui::Context::default();
        let viewer = Viewer::new(paths, wishes, &target, &context);
        let last = FullOutput::default();
        Ok(Offscreen { viewer, context, target, size, started: Instant::now(), last })
    }

    /// One frame, in which `events` have happened.
    pub fn frame(&mut self, events: Vec<Event>) {
        let [width, height] = self.size.map(|side| side as f32);
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(width, height))),
            max_texture_side: Some(self.target.device.limits().max_texture_dimension_2d as usize),
            time: Some(self.started.elapsed().as_secs_f64()),
            events,
            ..RawInput::default()
        };
        let viewer = &mut self.viewer;
        let mut output = self.context.run_ui(input, |ui| viewer.ui(ui));
        let mut renderer = self.target.renderer.write();
        for (id, deltas) in output.textures_delta.set.drain() {
            for delta in deltas {
                renderer.update_texture(&self.target.device, &self.target.queue, id, &delta);
            }
        }
        for id in output.textures_delta.free.drain() {
            renderer.free_texture(&id);
        }
        drop(renderer);
        self.last = output;
    }

    /// Frames until nothing changes by itself any more.
    ///
    /// # Errors
    /// When the files cannot be shown, or it takes longer than `patience`.
    pub fn settle(&mut self, patience: Duration) -> Result<(), OffscreenError> {
        let started = Instant::now();
        loop {
            self.frame(Vec::new());
            if let Some(error) = self.viewer.error() {
                return Err(OffscreenError::Files(error.to_owned()));
            }
            if self.viewer.is_settled() {
                // Once more, with all that is known now; and panels take their sizes in a frame after the first.
                self.frame(Vec::new());
                self.frame(Vec::new());
                return Ok(());
            }
            if started.elapsed() > patience {
                return Err(OffscreenError::Patience(patience));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Times of `frames` frames in which the camera goes round its target, a degree a frame: each from its start until the device has drawn it.
    ///
    /// # Errors
    /// When the files are not open, or the device fails.
    pub fn measure(&mut self, frames: u32) -> Result<Vec<Duration>, OffscreenError> {
        let mut times = Vec::with_capacity(frames as usize);
        for _ in 0..frames {
            let started = Instant::now();
            let session =
                self.viewer.session().ok_or_else(|| OffscreenError::Files("not open".to_owned()))?;
            session.shared.camera.orbit(1f32.to_radians(), 0.0);
            self.frame(Vec::new());
            self.finish()?;
            times.push(started.elapsed());
        }
        Ok(times)
    }

    /// The window as the last frame left it.
    ///
    /// # Errors
    /// When the device fails.
    pub fn picture(&mut self) -> Result<RgbaImage, OffscreenError> {
        let texture = self.draw();
        self.read(&texture)
    }

    /// Draws the last frame, and waits for it: what a frame costs, all in all.
    ///
    /// # Errors
    /// When the device fails.
    pub fn finish(&mut self) -> Result<(), OffscreenError> {
        self.draw();
        self.wait()
    }

    fn wait(&self) -> Result<(), OffscreenError> {
        let poll = self.target.device.poll(wgpu::PollType::wait_indefinitely());
        poll.map(|_| ()).map_err(|error| OffscreenError::Read(error.to_string()))
    }

    fn draw(&self) -> wgpu::Texture {
        let RenderState { device, queue, renderer, target_format, .. } = &self.target;
        let [width, height] = self.size;
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("window"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: *target_format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let screen = ScreenDescriptor { size_in_pixels: self.size, pixels_per_point: 1.0 };
        let shapes = self.context.tessellate(self.last.shapes.clone(), 1.0);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut renderer = renderer.write();
        let before = renderer.update_buffers(device, queue, &mut encoder, &shapes, &screen);
        let mut pass = encoder
            .begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("window"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            })
            .forget_lifetime();
        renderer.render(&mut pass, &shapes, &screen);
        drop(pass);
        queue.submit(before.into_iter().chain([encoder.finish()]));
        texture
    }

    fn read(&self, texture: &wgpu::Texture) -> Result<RgbaImage, OffscreenError> {
        let RenderState { device, queue, .. } = &self.target;
        let [width, height] = self.size;
        let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: u64::from(row) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        queue.submit([encoder.finish()]);
        let (sender, mapped) = channel();
        buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            // The receiver is there until the result is.
            let _ = sender.send(result);
        });
        self.wait()?;
        let failed = |error: String| OffscreenError::Read(error);
        mapped
            .recv()
            .map_err(|error| failed(error.to_string()))?
            .map_err(|error| failed(error.to_string()))?;
        let bytes = buffer.slice(..).get_mapped_range().map_err(|error| failed(error.to_string()))?;
        let mut pixels = Vec::with_capacity(4 * width as usize * height as usize);
        for line in bytes.chunks(row as usize) {
            pixels.extend_from_slice(&line[..4 * width as usize]);
        }
        if self.target.target_format == wgpu::TextureFormat::Bgra8Unorm {
            pixels.chunks_exact_mut(4).for_each(|pixel| pixel.swap(0, 2));
        }
        RgbaImage::from_raw(width, height, pixels).ok_or_else(|| failed("too few pixels".to_owned()))
    }
}
