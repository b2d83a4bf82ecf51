//! The tree as an icicle or a sunburst, coloured by cost, to be clicked: the diagram and the picture show the same node.

use super::paint::{self, color32};
use super::panels::{count, percent};
use super::shared::Shared;
use crate::explore::diagram::{Block, Diagram, Layout, Shown, Sunburst};
use crate::explore::shares::{Measure, Shares};
use crate::explore::walk::Walk;
use eframe::egui::{self, Color32, Pos2, Rect, Sense, Shape, Stroke, Ui, pos2, vec2};
use std::sync::Arc;

/// Levels that are drawn.
const LEVELS: usize = 14;
/// Points of height of a level of an icicle.
const ROW: f32 = 15.0;
/// Narrowest block, in points.
const NARROWEST: f64 = 2.5;

/// How the diagram looks, and the last one that was laid out.
pub struct DiagramView {
    measure: Measure,
    round: bool,
    /// Whether the current node takes the whole width, not the root.
    zoomed: bool,
    laid_out: Option<(Key, Diagram)>,
}

/// What a layout depends on: tree, counts, root, measure, width.
type Key = (usize, usize, u32, Measure, u32);

impl Default for DiagramView {
    fn default() -> DiagramView {
        DiagramView { measure: Measure::Cost, round: false, zoomed: false, laid_out: None }
    }
}

fn measure_name(measure: Measure) -> &'static str {
    match measure {
        Measure::Triangles => "triangles",
        Measure::Cost => "cost",
        Measure::Area => "expected by area",
    }
}

impl DiagramView {
    /// Draws the diagram of the active tree; a click goes to a node.
    pub fn ui(&mut self, ui: &mut Ui, shared: &mut Shared, shares: &Arc<Shares>) {
        ui.horizontal(|ui| {
            ui.label("width:");
            super::panels::choose(ui, "measure", &mut self.measure, &Measure::ALL, |measure| {
                measure_name(measure).to_owned()
            });
        });
        ui.horizontal(|ui| {
            ui.toggle_value(&mut self.round, "round").on_hover_text("A sunburst instead of an icicle");
            ui.toggle_value(&mut self.zoomed, "from here")
                .on_hover_text("The current node takes the whole width");
        });
        let tree = shared.tree().clone();
        let walk = &tree.walk;
        let width = ui.available_width();
        let root = if self.zoomed { shared.node() } else { 0 };
        let key = (shared.active, Arc::as_ptr(shares) as usize, root, self.measure, width as u32);
        if self.laid_out.as_ref().is_none_or(|(old, _)| *old != key) {
            let least = NARROWEST / f64::from(width.max(1.0));
            let layout = Layout { measure: self.measure, root, levels: LEVELS, least };
            self.laid_out = Some((key, Diagram::new(walk, shares, &layout)));
        }
        let Some((_, diagram)) = &self.laid_out else { return };
        let height = if self.round { width } else { ROW * diagram.depth() as f32 };
        let (area, response) = ui.allocate_exact_size(vec2(width, height), Sense::click());
        let sunburst = Sunburst { depth: diagram.depth() };
        let here = diagram.block_of(walk, shared.node()).map(|block| block.shown);
        for block in &diagram.blocks {
            let stroke = if Some(block.shown) == here {
                Stroke::new(2.0, color32(paint::SELECTED))
            } else {
                Stroke::new(0.5, Color32::from_black_alpha(160))
            };
            let fill = color(walk, shares, block);
            if self.round {
                ui.painter().add(ring(area, &sunburst, block, fill, stroke));
            } else {
                ui.painter().rect(bar(area, block), 0.0, fill, stroke, egui::StrokeKind::Inside);
            }
        }
        if let Some(block) = response.hover_pos().and_then(|pointer| self.block_at(area, pointer)).cloned() {
            let text = hint(walk, shares, &block);
            if response.clicked() {
                shared.go(block.shown.node());
            }
            response.on_hover_text_at_pointer(text);
        }
        ui.weak("color: cost over what the area predicts; blue less, orange more");
    }

    fn block_at(&self, area: Rect, pointer: Pos2) -> Option<&Block> {
        let (_, diagram) = self.laid_out.as_ref()?;
        if self.round {
            let place = (pointer - area.center()) / (0.5 * area.width());
            let (x, level) = Sunburst { depth: diagram.depth() }.place(place.x.into(), (-place.y).into())?;
            return diagram.hit(x, level);
        }
        let x = f64::from((pointer.x - area.left()) / area.width());
        diagram.hit(x, ((pointer.y - area.top()) / ROW).max(0.0) as usize)
    }
}

/// Blue where a node costs less than its area predicts, orange where it costs more: by magnitudes, up to eight times.
fn color(walk: &Walk, shares: &Shares, block: &Block) -> Color32 {
    let node = match block.shown {
        Shown::Node(node) => node,
        Shown::Rest { .. } => return Color32::from_gray(70),
    };
    let [cost, area] = [Measure::Cost, Measure::Area].map(|measure| shares.share(walk, measure, node));
    if cost <= 0.0 || area <= 0.0 {
        return Color32::from_gray(110);
    }
    color32(paint::difference((cost / area).log2() / 3.0))
}

fn hint(walk: &Walk, shares: &Shares, block: &Block) -> String {
    match block.shown {
        Shown::Node(node) => {
            let share = |measure| percent(shares.share(walk, measure, node));
            format!(
                "node {node}, level {}\n{} triangles ({})\n{} of the cost, {} expected by area",
                walk.level(node),
                count(walk.triangles(node).len() as u64),
                share(Measure::Triangles),
                share(Measure::Cost),
                share(Measure::Area),
            )
        }
        Shown::Rest { parent, count } => {
            format!("{count} children of node {parent}, each too narrow to be drawn")
        }
    }
}

fn bar(area: Rect, block: &Block) -> Rect {
    let x = |share: f64| area.left() + area.width() * share as f32;
    let top = area.top() + ROW * block.level as f32;
    Rect::from_min_max(pos2(x(block.x.start), top), pos2(x(block.x.end), top + ROW))
}

/// A part of a ring as a polygon; a whole one as a disc or a circle.
fn ring(area: Rect, sunburst: &Sunburst, block: &Block, fill: Color32, stroke: Stroke) -> Shape {
    let (angles, radii) = sunburst.ring(block);
    let scale = 0.5 * area.width();
    let point = |angle: f64, radius: f64| {
        area.center() + scale * radius as f32 * vec2(angle.sin() as f32, -angle.cos() as f32)
    };
    if radii.start == 0.0 {
        return Shape::Circle(egui::epaint::CircleShape {
            center: area.center(),
            radius: scale * radii.end as f32,
            fill,
            stroke,
        });
    }
    // Short pieces: each is convex, which is what can be filled.
    let pieces =
        (((angles.end - angles.start) * radii.end * f64::from(scale) / 4.0).ceil() as usize).clamp(1, 200);
    let angle = |piece: usize| angles.start + (angles.end - angles.start) * piece as f64 / pieces as f64;
    let mut mesh = egui::Mesh::default();
    for piece in 0..=pieces {
        mesh.colored_vertex(point(angle(piece), radii.start), fill);
        mesh.colored_vertex(point(angle(piece), radii.end), fill);
    }
    for piece in 0..pieces as u32 {
        mesh.add_triangle(2 * piece, 2 * piece + 1, 2 * piece + 2);
        mesh.add_triangle(2 * piece + 1, 2 * piece + 3, 2 * piece + 2);
    }
    let mut outline: Vec<Pos2> = (0..=pieces).map(|piece| point(angle(piece), radii.end)).collect();
    outline.extend((0..=pieces).rev().map(|piece| point(angle(piece), radii.start)));
    Shape::Vec(vec![Shape::mesh(mesh), Shape::closed_line(outline, stroke)])
}
