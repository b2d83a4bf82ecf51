//! The window on a desktop: eframe around a [`Viewer`].

use super::app::Viewer;
use super::wishes::Wishes;
use eframe::egui::{self, Ui, vec2};
use std::path::PathBuf;
use thiserror::Error;

/// Why there is no window.
#[derive(Debug, Error)]
pub enum WindowError {
    #[error("no window: {0}")]
    Desktop(String),
}

struct App(Viewer);

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.0.ui(ui);
    }
}

/// Shows files in a window until it is closed.
///
/// # Errors
/// When there is no display, or no graphics device.
pub fn show(paths: Vec<PathBuf>, wishes: Wishes, [width, height]: [u32; 2]) -> Result<(), WindowError> {
    let names: Vec<String> = paths
        .iter()
        .filter_map(|path| path.file_name())
        .map(|name| name.to_string_lossy().into_owned())
        .collect();
    let title = format!("bvh-view {}", names.join(" "));
    let viewport = egui::ViewportBuilder::default()
        .with_title(&title)
        .with_app_id("bvh-view")
        .with_inner_size(vec2(width as f32, height as f32));
    let options = eframe::NativeOptions { viewport, renderer: eframe::Renderer::Wgpu, ..Default::default() };
    let create = move |context: &eframe::CreationContext<'_>| -> Result<Box<dyn eframe::App>, _> {
        let target = context.wgpu_render_state.as_ref().ok_or("no graphics device")?;
        Ok(Box::new(App(Viewer::new(paths, wishes, target, &context.egui_ctx))) as Box<dyn eframe::App>)
    };
    eframe::run_native("bvh-view", options, Box::new(create))
        .map_err(|error| WindowError::Desktop(error.to_string().replace('\n', " ")))
}
