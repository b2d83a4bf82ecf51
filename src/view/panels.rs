//! What stands around the pictures: the list of layers, the legend, the keys, and how numbers are written.

use super::layers::{BoxLayer, Boxes, RayColor, RayLayer, SurfaceColor, SurfaceLayer};
use super::paint::{ColorMap, color32, difference};
use super::pixels;
use super::shared::{Legend, Shared};
use crate::explore::queries::Sampled;
use crate::format::rays::Purpose;
use eframe::egui::{self, Color32, RichText, Sense, Ui, vec2};

/// 1234567 as 1,234,567.
pub fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A share as a percentage, with as many places as say something.
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent == 0.0 {
        "0%".to_owned()
    } else if percent < 0.1 {
        format!("{percent:.2}%")
    } else {
        format!("{percent:.1}%")
    }
}

/// A table of names and values, each with a hint.
pub fn facts(ui: &mut Ui, id: &str, rows: &[(&str, String, &str)]) {
    egui::Grid::new(id).num_columns(2).spacing([12.0, 3.0]).striped(true).show(ui, |ui| {
        for (name, value, hint) in rows {
            let name = ui.label(*name);
            let value = ui.monospace(value);
            if !hint.is_empty() {
                name.on_hover_text(*hint);
                value.on_hover_text(*hint);
            }
            ui.end_row();
        }
    });
}

/// Says what was looked at, where it was not everything.
pub fn sampled(ui: &mut Ui, sampled: &Sampled) {
    let text = if sampled.is_all() {
        format!("all {} queries", count(sampled.of))
    } else {
        format!("a sample: {} of {} queries", count(sampled.looked_at), count(sampled.of))
    };
    ui.weak(text).on_hover_text("The queries that these numbers count");
}

/// The content of a panel: scrolled where it is too long, and cut where it is too wide. Without that, a panel of fixed width whose content is wider moves
/// out of the window by as much.
pub fn scrolled(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    let area = ui.available_rect_before_wrap();
    let mut inner = ui.new_child(egui::UiBuilder::new().max_rect(area));
    inner.shrink_clip_rect(area);
    egui::ScrollArea::vertical().auto_shrink(false).show(&mut inner, contents);
    ui.allocate_rect(area, Sense::hover());
}

/// The list of layers.
pub fn layers(ui: &mut Ui, shared: &mut Shared) {
    let recorded = shared.opened.recording.is_some();
    let two = shared.opened.trees.len() == 2;
    surfaces(ui, &mut shared.layers.surfaces, recorded, two);
    boxes(ui, &mut shared.layers.boxes, recorded);
    if recorded {
        rays(ui, &mut shared.layers.rays);
        pixels::settings(ui, shared);
    }
}

/// An entry of the list: whether it is to be seen, and what belongs to it if it is.
pub fn section<R>(
    ui: &mut Ui,
    visible: &mut bool,
    name: &str,
    hint: &str,
    contents: impl FnOnce(&mut Ui) -> R,
) {
    ui.checkbox(visible, RichText::new(name).strong()).on_hover_text(hint);
    if *visible {
        ui.indent(name, contents);
    }
    ui.add_space(6.0);
}

/// How much of something is drawn.
pub fn opacity(ui: &mut Ui, opacity: &mut f32) {
    ui.add(egui::Slider::new(opacity, 0.0..=1.0).text("opacity").fixed_decimals(2));
}

fn behind(ui: &mut Ui, behind: &mut f32) {
    ui.add(egui::Slider::new(behind, 0.0..=1.0).text("seen through").fixed_decimals(2))
        .on_hover_text("How much of it is drawn where surfaces hide it");
}

/// A choice among named things.
pub fn choose<T: Copy + PartialEq>(
    ui: &mut Ui,
    id: &str,
    value: &mut T,
    choices: &[T],
    name: impl Fn(T) -> String,
) {
    egui::ComboBox::from_id_salt(id).selected_text(name(*value)).width(170.0).show_ui(ui, |ui| {
        for &choice in choices {
            ui.selectable_value(value, choice, name(choice));
        }
    });
}

fn surfaces(ui: &mut Ui, layer: &mut SurfaceLayer, recorded: bool, two: bool) {
    let SurfaceLayer { visible, opacity: opaque, color, map } = layer;
    section(ui, visible, "Surfaces", "The triangles of the scene", |ui| {
        let possible: Vec<SurfaceColor> = SurfaceColor::ALL
            .into_iter()
            .filter(|color| match color {
                SurfaceColor::Plain | SurfaceColor::Subtree => true,
                SurfaceColor::Difference => recorded && two,
                _ => recorded,
            })
            .collect();
        choose(ui, "surfaces", color, &possible, |color| color.name().to_owned());
        if !matches!(color, SurfaceColor::Plain | SurfaceColor::Subtree | SurfaceColor::Difference) {
            choose(ui, "map", map, &ColorMap::ALL, |map| map.name().to_owned());
        }
        opacity(ui, opaque);
    });
}

fn boxes(ui: &mut Ui, layer: &mut BoxLayer, recorded: bool) {
    let BoxLayer { visible, opacity: opaque, behind: through, which, levels, share } = layer;
    section(ui, visible, "Boxes", "Boxes of the tree's nodes", |ui| {
        let possible = if recorded { &Boxes::ALL[..] } else { &Boxes::ALL[..2] };
        choose(ui, "boxes", which, possible, |which| which.name().to_owned());
        match which {
            Boxes::Children => {}
            Boxes::Level => {
                ui.add(egui::Slider::new(levels, 0..=20).text("levels below"));
            }
            Boxes::Above => {
                ui.add(
                    egui::Slider::new(share, 0.0005..=0.5)
                        .logarithmic(true)
                        .text("of all cost")
                        .custom_formatter(|share, _| percent(share))
                        .custom_parser(|text| Some(text.trim_end_matches('%').parse::<f64>().ok()? / 100.0)),
                );
            }
        }
        opacity(ui, opaque);
        behind(ui, through);
    });
}

fn rays(ui: &mut Ui, layer: &mut RayLayer) {
    let RayLayer { visible, points, opacity: opaque, behind: through, width, size, color, .. } = layer;
    let shown = *visible || *points;
    ui.horizontal(|ui| {
        ui.checkbox(visible, RichText::new("Rays").strong())
            .on_hover_text("Effective segments of recorded queries: up to the hit, or as long as asked");
        ui.checkbox(points, RichText::new("Hit points").strong())
            .on_hover_text("Where recorded queries hit something");
    });
    if shown {
        ui.indent("rays", |ui| {
            choose(ui, "ray color", color, &RayColor::ALL, |color| format!("by {}", color.name()));
            ui.horizontal_wrapped(|ui| {
                for purpose in Purpose::ALL {
                    ui.toggle_value(&mut layer.purposes[purpose as usize], purpose.name());
                }
            });
            ui.horizontal(|ui| {
                ui.toggle_value(&mut layer.hits, "hits");
                ui.toggle_value(&mut layer.misses, "misses");
                let mut limited = layer.depth.is_some();
                ui.checkbox(&mut limited, "depth");
                layer.depth = limited.then(|| layer.depth.unwrap_or(0));
                if let Some(depth) = &mut layer.depth {
                    ui.add(egui::DragValue::new(depth).range(0..=254));
                }
            });
            ui.add(egui::Slider::new(&mut layer.most, 100..=200_000).logarithmic(true).text("at most"));
            ui.add(egui::Slider::new(&mut layer.every, 1..=10_000).logarithmic(true).text("every nth"));
            opacity(ui, opaque);
            behind(ui, through);
            if layer.visible {
                ui.add(egui::Slider::new(width, 0.5..=6.0).text("width").suffix(" px"));
            }
            if layer.points {
                ui.add(egui::Slider::new(size, 1.0..=12.0).text("points").suffix(" px"));
            }
        });
    }
    ui.add_space(6.0);
}

/// What colours mean.
pub fn legend(ui: &mut Ui, legend: &Legend) {
    let bar = |ui: &mut Ui, low: &str, high: &str, color: &dyn Fn(f64) -> Color32| {
        let width = ui.available_width().min(200.0);
        let (area, _) = ui.allocate_exact_size(vec2(width, 12.0), Sense::hover());
        let steps = 50;
        for step in 0..steps {
            let share = (step as f32 + 0.5) / steps as f32;
            let mut cell = area;
            cell.set_left(area.left() + area.width() * step as f32 / steps as f32);
            cell.set_right(area.left() + area.width() * (step + 1) as f32 / steps as f32);
            ui.painter().rect_filled(cell, 0.0, color(share.into()));
        }
        ui.allocate_ui(vec2(width, 14.0), |ui| {
            ui.horizontal(|ui| {
                ui.small(low);
                ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.small(high));
            });
        });
    };
    match legend {
        Legend::Scale { title, low, high, map } => {
            ui.label(title);
            bar(ui, low, high, &|share| color32(map.color(share)));
        }
        Legend::Difference { title, low, high } => {
            ui.label(title);
            bar(ui, low, high, &|share| color32(difference(2.0 * share - 1.0)));
        }
        Legend::Kinds { title, kinds } => {
            ui.label(title);
            for (color, name) in kinds {
                ui.horizontal(|ui| {
                    let (area, _) = ui.allocate_exact_size(vec2(12.0, 12.0), Sense::hover());
                    ui.painter().rect_filled(area, 2.0, color32(*color));
                    ui.label(name);
                });
            }
        }
    }
}

/// Keys that work in every mode.
pub const KEYS: &[(&str, &str)] = &[
    ("left drag", "orbit around the target"),
    ("middle drag, Shift + left drag", "move sideways"),
    ("right drag", "look around"),
    ("wheel", "nearer, farther"),
    ("W A S D Q E", "fly; with Shift faster"),
    ("F", "frame the current node"),
    ("Home", "frame the whole scene"),
    ("1 2 3 4", "modes: move, explore, crossplane, query"),
    ("V", "the other tree"),
    ("H", "hide or show the panels"),
    ("?", "this list"),
];

/// The list of keys, in a window of its own.
pub fn keys(ui: &Ui, open: &mut bool, mode: &str, own: &[(&str, &str)]) {
    egui::Window::new("Keys").open(open).collapsible(false).resizable(false).default_pos([260.0, 80.0]).show(
        ui.ctx(),
        |ui| {
            for (title, keys) in [("Everywhere".to_owned(), KEYS), (format!("In mode {mode}"), own)] {
                ui.strong(title.clone());
                egui::Grid::new(title).num_columns(2).spacing([20.0, 4.0]).show(ui, |ui| {
                    for (key, action) in keys {
                        ui.monospace(*key);
                        ui.label(*action);
                        ui.end_row();
                    }
                });
                ui.add_space(8.0);
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_to_be_read() {
        assert_eq!([0, 999, 1000, 1_234_567].map(count), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!([0.0, 0.000_51, 0.5, 1.0].map(percent), ["0%", "0.05%", "50.0%", "100.0%"]);
    }
}
