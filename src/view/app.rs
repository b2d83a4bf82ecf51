//! The window's content from the first moment on: what is being opened, why it could not be, or the files themselves.

use super::load::Opened;
use super::session::Session;
use super::shared::Shared;
use super::wishes::Wishes;
use super::work::{Wake, Work};
use eframe::egui::{self, RichText, Ui};
use eframe::egui_wgpu::RenderState;
use std::path::PathBuf;
use std::sync::Arc;

/// What the thread that opens files says.
enum News {
    Stage(String),
    Opened(Box<Opened>),
    Failed(String),
}

/// Where things stand.
enum State {
    Opening { work: Work<News>, stage: String },
    Failed(String),
    Ready(Box<Session>),
}

/// The whole viewer, whatever shows it: a window or a screenshot.
pub struct Viewer {
    state: State,
    wishes: Wishes,
    target: RenderState,
    wake: Wake,
}

impl Viewer {
    /// Starts to open files, on a thread of their own.
    pub fn new(paths: Vec<PathBuf>, wishes: Wishes, target: &RenderState, context: &egui::Context) -> Viewer {
        style(context);
        let repaint = context.clone();
        let wake: Wake = Arc::new(move || repaint.request_repaint());
        let (image, scene) = (wishes.image, wishes.scene);
        let work = Work::start(&wake, move |stop, give| {
            let opened = Opened::open(&paths, image, scene, &|stage| give(News::Stage(stage)));
            match opened {
                Err(error) => give(News::Failed(error.to_string())),
                Ok(opened) => {
                    let trees = opened.trees.clone();
                    give(News::Opened(Box::new(opened)));
                    // Pictures are there already; now they become quicker.
                    trees.iter().take_while(|_| !stop.is_stopped()).for_each(|tree| tree.widen());
                }
            }
        });
        let state = State::Opening { work, stage: "opening".to_owned() };
        Viewer { state, wishes, target: target.clone(), wake }
    }

    /// Everything in the window.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.take_news();
        match &mut self.state {
            State::Ready(session) => session.ui(ui),
            State::Opening { stage, .. } => {
                let stage = stage.clone();
                notice(ui, |ui| {
                    ui.spinner();
                    ui.add_space(8.0);
                    ui.label(stage);
                });
            }
            State::Failed(error) => {
                notice(ui, |ui| {
                    ui.heading("This cannot be shown");
                    ui.add_space(8.0);
                    ui.label(RichText::new(&*error).color(ui.visuals().error_fg_color));
                    ui.add_space(8.0);
                    ui.weak("Esc closes the window");
                });
                if ui.input(|input| input.key_pressed(egui::Key::Escape)) {
                    ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
                }
            }
        }
    }

    fn take_news(&mut self) {
        let State::Opening { work, stage } = &mut self.state else { return };
        for news in work.all() {
            match news {
                News::Stage(now) => *stage = now,
                News::Failed(error) => {
                    self.state = State::Failed(error);
                    return;
                }
                News::Opened(opened) => {
                    let shared = Shared::new(Arc::new(*opened), self.wake.clone());
                    let mut session = Session::new(shared, &self.target);
                    self.state = match self.wishes.apply(&mut session) {
                        Ok(()) => State::Ready(Box::new(session)),
                        Err(error) => State::Failed(error.to_string()),
                    };
                    return;
                }
            }
        }
    }

    /// Whether nothing will change any more by itself.
    pub fn is_settled(&mut self) -> bool {
        match &mut self.state {
            State::Opening { .. } => false,
            State::Failed(_) => true,
            State::Ready(session) => session.is_settled(),
        }
    }

    /// Why there is nothing to be seen.
    pub fn error(&self) -> Option<&str> {
        match &self.state {
            State::Failed(error) => Some(error),
            _ => None,
        }
    }

    /// The window with the files in it, once they are open.
    pub fn session(&mut self) -> Option<&mut Session> {
        match &mut self.state {
            State::Ready(session) => Some(session),
            _ => None,
        }
    }
}

/// Something in the middle of the window.
fn notice(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    egui::CentralPanel::default().show(ui, |ui| {
        ui.vertical_centered(|ui| {
            ui.add_space(0.4 * ui.available_height());
            contents(ui);
        });
    });
}

/// Dark, so that colours of the scene stand out; text as large as is read without effort.
fn style(context: &egui::Context) {
    context.set_theme(egui::Theme::Dark);
    context.all_styles_mut(|style| {
        for (kind, size) in [
            (egui::TextStyle::Body, 14.0),
            (egui::TextStyle::Button, 14.0),
            (egui::TextStyle::Monospace, 13.0),
            (egui::TextStyle::Small, 12.0),
            (egui::TextStyle::Heading, 17.0),
        ] {
            if let Some(font) = style.text_styles.get_mut(&kind) {
                font.size = size;
            }
        }
        style.visuals.override_text_color = Some(egui::Color32::from_gray(222));
        style.spacing.slider_width = 92.0;
    });
}
