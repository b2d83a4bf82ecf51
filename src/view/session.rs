//! A window with files in it: panels around one picture, or two beside each other, and what mouse and keys do to them.

use super::gpu::{Canvas, Look, Painter};
use super::modes::{Input, ModeName, Modes};
use super::overlay::Overlay;
use super::pace::Pace;
use super::pane::{Pane, Subject};
use super::panels;
use super::pixels;
use super::shared::{COST_HINT, Legend, Shared, Spot};
use crate::geometry::Vec3;
use crate::render::camera::{Camera, View};
use eframe::egui::{self, Event, Key, Modifiers, PointerButton, Rect, Response, RichText, Sense, Ui, vec2};
use eframe::egui_wgpu::{RenderState, wgpu};
use std::time::Instant;

/// Radians of a turn per height of the picture that the mouse goes.
const TURN: f32 = 3.0;
/// Diagonals of the scene per second, when flying.
const SPEED: f32 = 0.15;
/// Widths of the panels: the same in every mode, so that pictures stay where they are.
const LEFT: f32 = 272.0;
const RIGHT: f32 = 340.0;
/// Overlays begin at this share of the scene's diagonal from the eye.
const NEAR: f32 = 1e-5;

/// One picture in the window.
struct Frame {
    pane: Pane,
    canvas: Canvas,
    texture: egui::TextureId,
    /// What is on the canvas beside the picture.
    drawn: Option<(View, Overlay, Look)>,
}

/// Everything in the window.
pub struct Session {
    pub shared: Shared,
    pub modes: Modes,
    /// Whether panels are shown.
    pub panels: bool,
    keys_shown: bool,
    painter: Painter,
    target: RenderState,
    frames: Vec<Frame>,
    pace: Pace,
    flown: Option<Instant>,
}

impl Session {
    pub fn new(shared: Shared, target: &RenderState) -> Session {
        let painter = Painter::new(&target.device, &target.queue);
        let frames = (0..shared.opened.trees.len())
            .map(|_| {
                let canvas = painter.canvas([1, 1]);
                let texture = target.renderer.write().register_native_texture(
                    &target.device,
                    &canvas.view(),
                    wgpu::FilterMode::Linear,
                );
                Frame { pane: Pane::default(), canvas, texture, drawn: None }
            })
            .collect();
        Session {
            shared,
            modes: Modes::default(),
            panels: true,
            keys_shown: false,
            painter,
            target: target.clone(),
            frames,
            pace: Pace::default(),
            flown: None,
        }
    }

    /// Whether the window shows all it is going to show, unless something happens.
    pub fn is_settled(&mut self) -> bool {
        let pictures = self.frames.iter().all(|frame| frame.pane.is_finished());
        pictures && !self.shared.is_counting() && self.modes.current().is_settled()
    }

    /// Whether pictures are coarse because the camera moves.
    pub fn coarseness(&self) -> u32 {
        self.frames.iter().map(|frame| frame.pane.coarseness()).max().unwrap_or(1)
    }

    /// The whole window.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.shared.update();
        let moving = self.frames.iter().any(|frame| frame.pane.has_just_changed());
        self.pace.frame(moving, Instant::now());
        let mut input = Input::default();
        self.keys(ui, &mut input);
        if self.panels {
            self.bars(ui);
        }
        egui::CentralPanel::no_frame().show(ui, |ui| self.pictures(ui, &mut input));
        self.modes.current().update(&mut self.shared, &input);
        let mode = self.modes.current();
        panels::keys(ui, &mut self.keys_shown, mode.name(), mode.keys());
    }

    /// Bars and panels around the pictures.
    fn bars(&mut self, ui: &mut Ui) {
        egui::Panel::top("modes").show(ui, |ui| {
            ui.horizontal(|ui| {
                let current = self.modes.name();
                for (number, name) in ModeName::ALL.into_iter().enumerate() {
                    let mode = self.modes.mode(name);
                    let (label, purpose) = (mode.name(), mode.purpose());
                    let text = RichText::new(format!("{} {label}", number + 1));
                    if ui.selectable_label(name == current, text).on_hover_text(purpose).clicked() {
                        self.modes.switch(name, &mut self.shared);
                    }
                }
                ui.separator();
                self.trees(ui);
                ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                    if ui.button("?").on_hover_text("Keys").clicked() {
                        self.keys_shown = !self.keys_shown;
                    }
                });
            });
        });
        egui::Panel::bottom("status").show(ui, |ui| self.status(ui));
        egui::Panel::left("layers").exact_size(LEFT).show(ui, |ui| {
            panels::scrolled(ui, |ui| panels::layers(ui, &mut self.shared));
        });
        egui::Panel::right("mode").exact_size(RIGHT).show(ui, |ui| {
            panels::scrolled(ui, |ui| self.modes.current().panel(ui, &mut self.shared));
        });
    }

    /// Which tree the panels speak of, and how it is traversed.
    fn trees(&mut self, ui: &mut Ui) {
        let shared = &mut self.shared;
        let names: Vec<String> = shared.opened.trees.iter().map(|tree| tree.name()).collect();
        for (number, name) in names.iter().enumerate() {
            let path = shared.opened.trees[number].path.display().to_string();
            if names.len() == 1 {
                ui.label(name).on_hover_text(path);
            } else if ui.selectable_label(shared.active == number, name).on_hover_text(path).clicked() {
                shared.active = number;
            }
        }
        if shared.opened.recording.is_some() {
            ui.separator();
            let choices = crate::traverse::Traversal::ALL;
            panels::choose(ui, "traversal", &mut shared.traversal, &choices, |traversal| match traversal {
                crate::traverse::Traversal::Odf => "ODF (depth first)".to_owned(),
                crate::traverse::Traversal::RayOrder => "RayOrder (front to back)".to_owned(),
            });
        }
    }

    fn status(&mut self, ui: &mut Ui) {
        let shared = &self.shared;
        ui.horizontal(|ui| {
            let tree = shared.tree();
            if let Some(cost) = shared.cost_said(shared.active) {
                ui.strong(format!("cost of a query: {cost}")).on_hover_text(COST_HINT);
            }
            ui.label(format!("{} triangles", panels::count(tree.triangles().len() as u64)));
            ui.label(format!("{} nodes", panels::count(tree.bvh.tree.nodes.len() as u64)));
            if let Some(recording) = &shared.opened.recording {
                ui.label(format!("{} queries", panels::count(recording.rays.query_count())));
            }
            for (number, results) in shared.results.iter().enumerate() {
                if let Some(error) = &results.error {
                    ui.colored_label(ui.visuals().error_fg_color, error);
                } else if let Some(done) = results.fraction() {
                    let name = shared.opened.trees[number].name();
                    ui.weak(format!("counting over {name}: {:.0}%", 100.0 * done));
                } else if let Some(shares) = &results.shares
                    && number == shared.active
                {
                    panels::sampled(ui, &shares.counted.sampled);
                }
            }
            for warning in &shared.opened.warnings {
                ui.colored_label(ui.visuals().warn_fg_color, warning);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                if let Some(note) = &shared.note {
                    ui.strong(note);
                } else if let Some(Spot { triangle: Some(triangle), point: Some(point), .. }) = shared.hovered
                {
                    let Vec3 { x, y, z } = point;
                    ui.monospace(format!("triangle {triangle} at {x:.3} {y:.3} {z:.3}"));
                }
                let coarseness = self.coarseness();
                if coarseness > 1 {
                    ui.weak(format!("moving: 1/{coarseness} resolution"));
                }
            });
        });
    }

    /// One picture, or two beside each other.
    fn pictures(&mut self, ui: &mut Ui, input: &mut Input) {
        let area = ui.available_rect_before_wrap();
        let count = self.frames.len();
        let gap = if count > 1 { 2.0 } else { 0.0 };
        let width = (area.width() - gap * (count as f32 - 1.0)) / count as f32;
        for number in 0..count {
            let left = area.left() + number as f32 * (width + gap);
            let rect = Rect::from_min_size(egui::pos2(left, area.top()), vec2(width, area.height()));
            let id = ui.scope_id().with(("picture", number));
            let response = ui.interact(rect, id, Sense::click_and_drag());
            self.mouse(ui, number, &response, input);
            let mut legends: Vec<Legend> = self.picture(ui, number, rect).into_iter().collect();
            let layer = &self.shared.layers.rays;
            let drawn = self.shared.rays.drawn().filter(|_| layer.visible || layer.points);
            legends.extend(drawn.map(|drawn| drawn.legend.clone()));
            legends.extend(self.modes.current().legend(number));
            legends.extend(pixels::show(ui, &mut self.shared, number, rect));
            self.captions(ui, number, rect, &legends);
        }
        self.painter.forget();
    }

    /// Brings a picture up to date, and shows it.
    fn picture(&mut self, ui: &mut Ui, number: usize, rect: Rect) -> Option<Legend> {
        let scale = ui.ctx().pixels_per_point();
        let size = [rect.width(), rect.height()].map(|side| (side * scale).round().max(1.0) as u32);
        self.shared.aspect = rect.width() / rect.height().max(1.0);
        let (paint, legend) = self.shared.paint(number);
        let view = self.shared.camera.view;
        let frame = &mut self.frames[number];
        if frame.canvas.size() != size {
            frame.canvas = self.painter.canvas(size);
            frame.drawn = None;
            self.target.renderer.write().update_egui_texture_from_wgpu_texture(
                &self.target.device,
                &frame.canvas.view(),
                wgpu::FilterMode::Linear,
                frame.texture,
            );
            if let Some(image) = frame.pane.image() {
                self.painter.upload(&mut frame.canvas, image);
            }
        }
        let size = frame.canvas.size();
        let subject = Subject { tree: self.shared.opened.tree(number).clone(), view, size, paint };
        let progressed = frame.pane.show(subject, &self.shared.wake);
        if progressed.new
            && let Some(image) = frame.pane.image()
        {
            self.painter.upload(&mut frame.canvas, image);
        }
        if let Some(again) = progressed.again {
            ui.ctx().request_repaint_after(again);
        }
        let mut overlay = Overlay::default();
        self.shared.rays.overlay(&self.shared.layers.rays, &mut overlay);
        self.shared.boxes(number, &mut overlay);
        self.modes.current().overlay(&self.shared, number, &mut overlay);
        let surfaces = &self.shared.layers.surfaces;
        let look = Look {
            surface: if surfaces.visible { surfaces.opacity } else { 0.0 },
            near: NEAR * self.shared.opened.size(),
            most: if frame.pane.is_moving() { self.pace.shapes() } else { usize::MAX },
        };
        // A window that only answers the mouse does not draw the scene again: in software that takes its time.
        let drawn = Some((view, overlay, look));
        if (progressed.new || frame.drawn != drawn)
            && let (Ok(camera), Some((_, overlay, _))) = (Camera::new(&view, size[0], size[1]), &drawn)
        {
            self.painter.draw(&frame.canvas, &camera, overlay, &look);
            frame.drawn = drawn;
        }
        let whole = Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(1.0, 1.0));
        ui.painter().image(frame.texture, rect, whole, egui::Color32::WHITE);
        legend
    }

    /// What stands in a picture: the tree's name where there are two, and what colours mean.
    fn captions(&self, ui: &mut Ui, number: usize, rect: Rect, legends: &[Legend]) {
        let boxed = |ui: &mut Ui, place: Rect, contents: &mut dyn FnMut(&mut Ui)| {
            let mut inner = ui.new_child(egui::UiBuilder::new().max_rect(place));
            let fill = egui::Color32::from_black_alpha(170);
            egui::Frame::new()
                .fill(fill)
                .corner_radius(4.0)
                .inner_margin(6.0)
                .show(&mut inner, |ui| contents(ui));
        };
        if self.frames.len() > 1 {
            let active = self.shared.active == number;
            let mut name = self.shared.opened.trees[number].name();
            if let Some(cost) = self.shared.cost_said(number) {
                name += &format!(": {cost}");
            }
            let place = Rect::from_min_size(rect.min + vec2(8.0, 8.0), vec2(rect.width() - 16.0, 24.0));
            boxed(ui, place, &mut |ui| {
                let text = RichText::new(&name);
                ui.label(if active { text.strong() } else { text });
            });
        }
        let mut bottom = rect.bottom() - 8.0;
        for legend in legends {
            let rows = match legend {
                Legend::Kinds { kinds, .. } => kinds.len() as f32 + 1.0,
                _ => 2.5,
            };
            let height = 22.0 * rows + 10.0;
            let width = (rect.width() - 16.0).min(250.0);
            let place =
                Rect::from_min_size(egui::pos2(rect.left() + 8.0, bottom - height), vec2(width, height));
            boxed(ui, place, &mut |ui| panels::legend(ui, legend));
            bottom -= height + 8.0;
        }
    }

    /// The place under a pointer.
    fn spot(&self, number: usize, rect: Rect, pointer: egui::Pos2) -> Spot {
        let place = [(pointer.x - rect.left()) / rect.width(), (pointer.y - rect.top()) / rect.height()];
        let view = &self.shared.camera.view;
        let (width, height) = (rect.width().max(1.0), rect.height().max(1.0));
        let camera = Camera::new(view, width as u32, height as u32).ok();
        let ray =
            camera.map(|camera| (camera, camera.ray(place[0] * width.floor(), place[1] * height.floor())));
        let seen = self.frames[number].pane.image().and_then(|image| image.at(place[0], place[1]));
        let point = seen.zip(ray).map(|((_, depth), (camera, ray))| {
            ray.at(depth / ray.direction.dot(camera.forward).max(f32::MIN_POSITIVE))
        });
        Spot {
            pane: number,
            place,
            aspect: width / height,
            triangle: seen.map(|seen| seen.0),
            point,
            ray: ray.map(|(_, ray)| ray),
        }
    }

    /// What the mouse does to a picture: the camera moves, or the mode is told of a click.
    fn mouse(&mut self, ui: &Ui, number: usize, response: &Response, input: &mut Input) {
        let rect = response.rect;
        let modifiers = ui.input(|state| state.modifiers);
        let step = response.drag_delta() / rect.height().max(1.0);
        let camera = &mut self.shared.camera;
        if response.dragged_by(PointerButton::Primary) && modifiers.command {
            input.drag = Some([step.x, step.y]);
        } else if response.dragged_by(PointerButton::Middle)
            || (response.dragged_by(PointerButton::Primary) && modifiers.shift)
        {
            // What is at the target follows the mouse.
            let height = 2.0 * (camera.view.fov_degrees.to_radians() / 2.0).tan();
            camera.pan(step.x * height, -step.y * height);
        } else if response.dragged_by(PointerButton::Primary) {
            camera.orbit(TURN * step.x, TURN * step.y);
        } else if response.dragged_by(PointerButton::Secondary) {
            camera.look(TURN * 0.5 * step.x, -TURN * 0.5 * step.y);
        }
        if let Some(pointer) = response.hover_pos() {
            let scrolled = ui.input(|state| state.smooth_scroll_delta().y);
            if scrolled != 0.0 {
                self.shared.camera.dolly((-0.004 * scrolled).exp());
            }
            self.shared.hovered = Some(self.spot(number, rect, pointer));
        } else if self.shared.hovered.is_some_and(|spot| spot.pane == number) {
            self.shared.hovered = None;
        }
        if response.clicked()
            && let Some(pointer) = response.interact_pointer_pos()
        {
            input.click = Some(self.spot(number, rect, pointer));
            input.double_click = response.double_clicked();
            self.shared.note = None;
        }
    }

    /// Keys of every mode; the rest goes to the mode.
    fn keys(&mut self, ui: &Ui, input: &mut Input) {
        if ui.ctx().egui_wants_keyboard_input() {
            self.flown = None;
            return;
        }
        let events = ui.input(|state| state.events.clone());
        for event in events {
            let Event::Key { key, pressed: true, modifiers, .. } = event else { continue };
            self.shared.note = None;
            if !self.key(key, modifiers) {
                input.keys.push((key, modifiers));
            }
        }
        self.fly(ui);
    }

    /// Whether a key means the same in every mode, and was obeyed.
    fn key(&mut self, key: Key, modifiers: Modifiers) -> bool {
        let shared = &mut self.shared;
        let aspect = shared.aspect;
        let plain = !modifiers.command && !modifiers.alt;
        let digits = [Key::Num1, Key::Num2, Key::Num3, Key::Num4];
        match key {
            Key::Questionmark | Key::F1 => self.keys_shown = !self.keys_shown,
            Key::Slash if modifiers.shift => self.keys_shown = !self.keys_shown,
            Key::Escape if self.keys_shown => self.keys_shown = false,
            Key::F if plain => {
                let bounds = shared.bounds(shared.node());
                shared.camera.frame(&bounds, aspect);
            }
            Key::Home => shared.camera.frame(&shared.opened.bounds.clone(), aspect),
            Key::H if plain => self.panels = !self.panels,
            Key::V if plain => shared.active = (shared.active + 1) % shared.opened.trees.len(),
            _ if plain && digits.contains(&key) => {
                let number = digits.iter().position(|&digit| digit == key).unwrap_or(0);
                if let Some(&name) = ModeName::ALL.get(number) {
                    self.modes.switch(name, shared);
                }
            }
            _ => return false,
        }
        true
    }

    /// Flies while W, A, S, D, Q or E is held.
    fn fly(&mut self, ui: &Ui) {
        let (steps, fast) = ui.input(|state| {
            let axis = |more, less| {
                let held = |key| f32::from(u8::from(state.key_down(key)));
                held(more) - held(less)
            };
            let held = Vec3::new(axis(Key::W, Key::S), axis(Key::D, Key::A), axis(Key::E, Key::Q));
            let still = state.modifiers.command || state.modifiers.alt;
            (if still { Vec3::ZERO } else { held }, state.modifiers.shift)
        });
        if steps == Vec3::ZERO {
            self.flown = None;
            return;
        }
        let now = Instant::now();
        let seconds = self.flown.map_or(1.0 / 60.0, |last| (now - last).as_secs_f32().min(0.2));
        self.flown = Some(now);
        let speed = if fast { 4.0 * SPEED } else { SPEED };
        self.shared.camera.fly(steps * (speed * seconds));
        ui.ctx().request_repaint();
    }
}
