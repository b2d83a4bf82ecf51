//! The window on a desktop: eframe around a [`Viewer`].

use super::app::Viewer;
use super::wishes::Wishes;
use eframe::egui::{self, Ui, vec2};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use thiserror::Error;

/// Why there is no window.
#[derive(Debug, Error)]
pub enum WindowError {
    #[error("no window: {0}")]
    Desktop(String),
    /// The window has said so, too.
    #[error("{0}")]
    Files(String),
}

struct App {
    viewer: Viewer,
    /// Why files could not be shown, for after the window.
    failure: Arc<Mutex<Option<String>>>,
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.viewer.ui(ui);
    }

    fn on_exit(&mut self) {
        if let Ok(mut failure) = self.failure.lock() {
            *failure = self.viewer.error().map(str::to_owned);
        }
    }
}

/// Shows files in a window until it is closed.
///
/// # Errors
/// When there is no display, or no graphics device; and, once the window is closed, when it could not show the files.
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
    let failure = Arc::new(Mutex::new(None));
    let own = failure.clone();
    let create = move |context: &eframe::CreationContext<'_>| -> Result<Box<dyn eframe::App>, _> {
        let target = context.wgpu_render_state.as_ref().ok_or("no graphics device")?;
        let viewer = Viewer::new(paths, wishes, target, &context.egui_ctx);
        Ok(Box::new(App { viewer, failure: own }) as Box<dyn eframe::App>)
    };
    eframe::run_native("bvh-view", options, Box::new(create))
        .map_err(|error| WindowError::Desktop(error.to_string().replace('\n', " ")))?;
    match failure.lock().ok().and_then(|mut failure| failure.take()) {
        Some(line) => Err(WindowError::Files(line)),
        None => Ok(()),
    }
}
