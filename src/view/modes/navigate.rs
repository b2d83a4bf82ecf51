//! Mode *move*: the camera, and views that are kept.

use super::{Input, Mode};
use crate::geometry::Vec3;
use crate::view::shared::Shared;
use eframe::egui::{self, Key, Ui};

/// Ctrl with a digit keeps a view, Alt with the digit goes back to it.
const DIGITS: [Key; 9] =
    [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];

/// The mode has no state of its own: the camera is everybody's.
#[derive(Default)]
pub struct Navigate;

impl Mode for Navigate {
    fn name(&self) -> &'static str {
        "Move"
    }

    fn purpose(&self) -> &'static str {
        "Go round the scene and through it, and keep views"
    }

    fn keys(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("double click", "orbit around the point"),
            ("Ctrl + 1 … 9", "keep the view under a number"),
            ("Alt + 1 … 9", "go back to a kept view"),
        ]
    }

    fn update(&mut self, shared: &mut Shared, input: &Input) {
        for &(key, modifiers) in &input.keys {
            let Some(number) = DIGITS.iter().position(|&digit| digit == key).map(|index| index + 1) else {
                continue;
            };
            if modifiers.command {
                shared.camera.save(number);
                shared.note = Some(format!("view {number} kept: Alt+{number} goes back to it"));
            } else if modifiers.alt && !shared.camera.restore(number) {
                shared.note = Some(format!("no view is kept under {number}: Ctrl+{number} keeps one"));
            }
        }
        if let (true, Some(point)) = (input.double_click, input.click.and_then(|click| click.point)) {
            shared.camera.view.target = point;
        }
    }

    fn panel(&mut self, ui: &mut Ui, shared: &mut Shared) {
        ui.heading("Camera");
        let view = shared.camera.view;
        egui::Grid::new("camera").num_columns(2).show(ui, |ui| {
            for (name, point) in [("eye", view.eye), ("target", view.target)] {
                ui.label(name);
                ui.monospace(triple(point));
                ui.end_row();
            }
            ui.label("height of the image");
            ui.add(
                egui::Slider::new(&mut shared.camera.view.fov_degrees, 10.0..=120.0)
                    .suffix("°")
                    .fixed_decimals(0),
            )
            .on_hover_text("The angle between the upper and the lower edge of the picture");
            ui.end_row();
        });
        ui.horizontal_wrapped(|ui| {
            if ui.button("Whole scene").on_hover_text("Key: Home").clicked() {
                shared.camera.frame(&shared.opened.bounds, shared.aspect);
            }
            if ui
                .button("Start view")
                .on_hover_text("Where the recording's camera stood, or the view chosen at the start")
                .clicked()
            {
                shared.camera.view = shared.opened.start;
            }
            let text = format!("{}/{}/{}", flat(view.eye), flat(view.target), flat(view.up));
            if ui
                .button("Copy as --view")
                .on_hover_text("For bvh-view --screenshot, and embree-trace --camera")
                .clicked()
            {
                ui.ctx().copy_text(text);
            }
        });
        ui.add_space(8.0);
        ui.heading("Kept views");
        ui.horizontal_wrapped(|ui| {
            for number in 1..=9 {
                let kept = shared.camera.has(number);
                let button = egui::Button::new(number.to_string()).selected(kept);
                let response = ui.add(button).on_hover_text(if kept {
                    "Click: go there. Right click: keep the present view instead"
                } else {
                    "Click: keep the present view"
                });
                if response.secondary_clicked() || (response.clicked() && !kept) {
                    shared.camera.save(number);
                } else if response.clicked() {
                    shared.camera.restore(number);
                }
            }
        });
    }
}

fn triple(point: Vec3) -> String {
    format!("{:.4} {:.4} {:.4}", point.x, point.y, point.z)
}

fn flat(point: Vec3) -> String {
    format!("{},{},{}", point.x, point.y, point.z)
}
