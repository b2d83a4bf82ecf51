//! Mode *query*: one query, its traversal step by step, and the whole path that it is a part of.

mod drawing;

use super::{Input, Mode};
use crate::compare::relative;
use crate::explore::rays::{Kept, PixelIndex, fetch, origins};
use crate::explore::steps::{Event, Steps, question};
use crate::format::rays::{NO_PATH, Purpose};
use crate::render::camera::Camera;
use crate::traverse::{Counts, Traversal};
use crate::view::load::OpenTree;
use crate::view::overlay::Overlay;
use crate::view::paint::{self, SELECTED, color32};
use crate::view::panels::{count, facts};
use crate::view::pixels;
use crate::view::results::every_query;
use crate::view::shared::{Shared, Spot};
use crate::view::work::Latest;
use eframe::egui::{self, Key, RichText, Ui};
use std::sync::Arc;

/// Rows of the list of steps, and of what waits.
const ROWS: usize = 11;
/// Rays nearer to a click than this many hundredths of the picture's height are picked.
const NEAR: f32 = 0.8;

/// The traversal of the query in one tree.
struct Followed {
    steps: Steps,
    /// For which traversal.
    traversal: Traversal,
}

/// What is picked, and how far it has been followed.
#[derive(Default)]
pub struct QueryMode {
    /// The queries of a path, in the order in which they were asked; one alone when there is no path.
    path: Vec<Kept>,
    /// Which query of the path each comes from.
    origins: Vec<Option<usize>>,
    chosen: usize,
    step: usize,
    /// By tree.
    followed: Vec<Followed>,
    index: Latest<(), PixelIndex>,
    /// To be picked as soon as it can be.
    wanted: Option<Wanted>,
    error: Option<String>,
}

/// What is to be picked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted {
    /// Of the recorded image: y * width + x.
    Pixel(u32),
    /// By its number in the file.
    Number(u64),
}

impl QueryMode {
    /// Picks a query or a pixel of the recording, and goes to a step.
    pub fn want(&mut self, wanted: Wanted, step: usize) {
        (self.wanted, self.step) = (Some(wanted), step);
    }

    fn query(&self) -> Option<&Kept> {
        self.path.get(self.chosen)
    }

    fn pick(&mut self, path: Vec<Kept>, chosen: usize) {
        self.origins = origins(&path);
        self.chosen = chosen.min(path.len().saturating_sub(1));
        self.path = path;
        self.followed.clear();
    }

    /// Picks what is wanted, when the index of pixels is there if it is needed.
    fn fulfil(&mut self, shared: &Shared) {
        let (Some(wanted), Some(recording)) = (self.wanted, &shared.opened.recording) else { return };
        let rays = &recording.rays;
        let choice = every_query(recording);
        let found = match wanted {
            Wanted::Number(number) => match fetch(rays, &choice, number) {
                Err(error) => Err(error.to_string()),
                Ok(None) => Err(format!("there is no query {number}")),
                Ok(Some(query)) if query.record.path == NO_PATH => Ok((vec![query], 0)),
                Ok(Some(query)) => {
                    let Some(index) = &self.index.value else { return };
                    let path = index.queries(rays, &choice, query.record.path);
                    path.map_err(|error| error.to_string()).map(|path| {
                        let place = path.iter().position(|other| other.number == number).unwrap_or(0);
                        (path, place)
                    })
                }
            },
            Wanted::Pixel(pixel) => {
                let Some(index) = &self.index.value else { return };
                match index.queries(rays, &choice, pixel) {
                    Err(error) => Err(error.to_string()),
                    Ok(path) if path.is_empty() => Err("no query was recorded for this pixel".to_owned()),
                    Ok(path) => Ok((path, 0)),
                }
            }
        };
        self.wanted = None;
        let step = self.step;
        match found {
            Ok((path, place)) => {
                self.error = None;
                self.pick(path, place);
                self.step = step;
            }
            Err(error) => self.error = Some(error),
        }
    }

    /// Follows the query through every tree, where that has not been done.
    fn follow(&mut self, shared: &Shared) {
        let traversal = shared.traversal;
        if self.followed.first().is_some_and(|followed| followed.traversal != traversal) {
            self.followed.clear();
        }
        let Some(kept) = self.path.get(self.chosen) else { return };
        if self.followed.is_empty() {
            let follow = |tree: &Arc<OpenTree>| Followed {
                steps: Steps::of(&tree.asked(traversal), tree.bvh.tree, &kept.query()),
                traversal,
            };
            self.followed = shared.opened.trees.iter().map(follow).collect();
        }
    }

    fn last_step(&self) -> usize {
        let lengths = self.followed.iter().map(|followed| followed.steps.steps.len());
        lengths.max().unwrap_or(0).saturating_sub(1)
    }

    fn choose(&mut self, chosen: usize) {
        (self.chosen, self.step) = (chosen, 0);
        self.followed.clear();
    }

    /// The recorded ray that is drawn nearest to a click; else the camera's own ray through it, as a query that nobody recorded.
    fn click(&mut self, shared: &Shared, click: &Spot) {
        let near = shared.rays.drawn().filter(|_| shared.layers.rays.visible).and_then(|drawn| {
            let camera = Camera::new(&shared.camera.view, (100.0 * click.aspect) as u32, 100).ok()?;
            let at = [click.place[0] * 100.0 * click.aspect, click.place[1] * 100.0];
            let distance = |segment: &crate::explore::rays::Segment| {
                let (a, b) = (camera.project(segment.from)?.0, camera.project(segment.to)?.0);
                Some(distance_to(at, a, b))
            };
            let all = drawn.segments.iter().filter_map(|segment| Some((segment.query, distance(segment)?)));
            all.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, distance)| *distance < NEAR)
        });
        self.step = 0;
        match (near, click.ray) {
            (Some((number, _)), _) => self.want(Wanted::Number(number), 0),
            (None, Some(ray)) => self.pick(vec![Kept::from(question(ray, false))], 0),
            (None, None) => {}
        }
    }

    fn ask(&mut self, shared: &mut Shared) {
        shared.ask_pixels(shared.active);
        let Some(recording) = &shared.opened.recording else { return };
        let own = recording.clone();
        let steps = recording.rays.query_count();
        self.index.ask(&(), steps, &shared.wake, move |progress| {
            PixelIndex::of(&own.rays, progress).map_err(|error| error.to_string())
        });
    }

    /// The path: what was asked for one pixel, bounce after bounce.
    fn path(&mut self, ui: &mut Ui, shared: &Shared) {
        if self.path.len() < 2 {
            return;
        }
        let image = shared.opened.recording.as_ref().and_then(|recording| recording.image);
        let pixel = self.path[0].record.path;
        let title = match image.and_then(|image| image.pixel(pixel)) {
            Some((x, y)) => format!("Pixel {x}, {y}: {} queries", self.path.len()),
            None => format!("Path {pixel}: {} queries", self.path.len()),
        };
        ui.strong(title);
        let mut next = None;
        egui::ScrollArea::vertical().id_salt("path").max_height(130.0).show(ui, |ui| {
            for (place, query) in self.path.iter().enumerate() {
                let record = &query.record;
                let purpose = Purpose::from_byte(record.purpose);
                let answer = match (record.is_occlusion(), record.is_hit()) {
                    (true, true) => "occluded",
                    (true, false) => "free",
                    (false, true) => "hit",
                    (false, false) => "miss",
                };
                let indent = "  ".repeat(record.depth.min(8).into());
                let text = format!("{indent}{} {answer}", purpose.name());
                let text = RichText::new(text).monospace().color(color32(paint::purpose(purpose)));
                let label = ui.selectable_label(place == self.chosen, text);
                if label.on_hover_text(format!("query {}, depth {}", query.number, record.depth)).clicked() {
                    next = Some(place);
                }
            }
        });
        if let Some(place) = next {
            self.choose(place);
        }
    }

    /// Steps of one tree around the current one, and what waits.
    fn traversal(&self, ui: &mut Ui, shared: &Shared, number: usize) {
        let Some(Followed { steps, .. }) = self.followed.get(number) else { return };
        let last = steps.steps.len().saturating_sub(1);
        let here = self.step.min(last);
        let Some(step) = steps.steps.get(here) else { return };
        let whole = |number: usize| Some(self.followed.get(number)?.steps.steps.last()?.cost);
        if shared.opened.trees.len() > 1 {
            let ratio = if number == 0 { None } else { whole(0).zip(whole(number)) };
            let ratio = ratio.map_or(String::new(), |(first, own)| format!(", ×{:.2}", relative(own, first)));
            let name = shared.opened.trees[number].name();
            let cost = whole(number).unwrap_or_default();
            ui.strong(format!("{name}: {cost:.1} ns{ratio}")).on_hover_text(
                "What the query costs in this tree, and relative to the first: ns of visits, leaves and blocks of triangles",
            );
        }
        facts(
            ui,
            &format!("steps {number}"),
            &[
                (
                    "cost so far",
                    format!("{:.1} of {:.1} ns", step.cost, whole(number).unwrap_or_default()),
                    "What visits, leaves and blocks of triangles are expected to take",
                ),
                ("step", format!("{} of {}", here + 1, last + 1), ""),
                ("visits, leaves, blocks", parts(&step.counts), "So far"),
                ("box tests so far", count(step.counts.box_tests), ""),
                ("primitive tests so far", count(step.counts.primitive_tests), ""),
                ("interval ends at", distance(step.end), "The best hit so far, else the end of the ray"),
            ],
        );
        let first = here.saturating_sub(ROWS / 2).min((last + 1).saturating_sub(ROWS));
        for (place, step) in steps.steps.iter().enumerate().skip(first).take(ROWS) {
            let text = RichText::new(words(&step.event)).monospace();
            let text = if place == here { text.strong().color(color32(SELECTED)) } else { text.weak() };
            ui.label(text);
        }
        let waiting = steps.state_at(here);
        let what = if steps.traversal == Traversal::Odf { "Stack" } else { "Queue" };
        ui.add_space(4.0);
        ui.strong(format!("{what}: {} wait", waiting.len())).on_hover_text(
            "Subtrees that are put off, the next one first, and where the ray enters their boxes",
        );
        for waiting in waiting.iter().take(ROWS) {
            let behind = if waiting.entry > step.end { "  behind the end" } else { "" };
            ui.monospace(format!("node {:<8} at {}{behind}", waiting.node, distance(waiting.entry)));
        }
        if waiting.len() > ROWS {
            ui.weak(format!("and {} more", waiting.len() - ROWS));
        }
    }
}

/// How far a point is from a segment, in the image.
fn distance_to([x, y]: [f32; 2], [ax, ay]: [f32; 2], [bx, by]: [f32; 2]) -> f32 {
    let (dx, dy) = (bx - ax, by - ay);
    let length = (dx * dx + dy * dy).max(f32::MIN_POSITIVE);
    let along = (((x - ax) * dx + (y - ay) * dy) / length).clamp(0.0, 1.0);
    (x - ax - along * dx).hypot(y - ay - along * dy)
}

/// What cost is made of.
fn parts(counts: &Counts) -> String {
    let Counts { node_visits, leaf_visits, block_tests, .. } = *counts;
    format!("{}, {}, {}", count(node_visits), count(leaf_visits), count(block_tests))
}

/// A distance along a ray; one that stands for no end is called so.
fn distance(t: f32) -> String {
    if t.abs() < 1e30 { format!("{t:.4}") } else { "no end".to_owned() }
}

/// A step in words.
fn words(event: &Event) -> String {
    match event {
        Event::Root { entry: Some(entry) } => format!("root entered at {entry:.4}"),
        Event::Root { entry: None } => "root missed".to_owned(),
        Event::Visit { node, children, .. } => {
            let entered = children.iter().filter(|child| child.entry.is_some()).count();
            format!("visit {node}: {entered} of {} entered", children.len())
        }
        Event::Leaf { node } => format!("leaf {node}"),
        Event::Triangle { triangle, hit: Some(t), .. } => format!("  triangle {triangle} hit at {t:.4}"),
        Event::Triangle { triangle, hit: None, .. } => format!("  triangle {triangle} no"),
        Event::Taken(waiting) => format!("take {} from {:.4}", waiting.node, waiting.entry),
        Event::Culled(waiting) => format!("drop {} at {:.4}", waiting.node, waiting.entry),
    }
}

impl Mode for QueryMode {
    fn name(&self) -> &'static str {
        "Query"
    }

    fn purpose(&self) -> &'static str {
        "Follow one query through the tree, step by step"
    }

    fn keys(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("click", "the drawn ray there, or a ray of the camera's own"),
            ("Space, →", "one step on"),
            ("Backspace, ←", "one step back"),
            ("↑ ↓", "ten steps"),
            ("N P", "next and previous query of the path"),
            ("O", "the other traversal: ODF or RayOrder"),
        ]
    }

    fn update(&mut self, shared: &mut Shared, input: &Input) {
        if let Some(click) = input.click {
            shared.active = click.pane;
            self.click(shared, &click);
        }
        self.ask(shared);
        self.fulfil(shared);
        if input.pressed(Key::O) {
            let other = Traversal::ALL.into_iter().find(|&other| other != shared.traversal);
            shared.traversal = other.unwrap_or(shared.traversal);
        }
        if input.pressed(Key::N) && self.chosen + 1 < self.path.len() {
            self.choose(self.chosen + 1);
        }
        if input.pressed(Key::P) && self.chosen > 0 {
            self.choose(self.chosen - 1);
        }
        self.follow(shared);
        let last = self.last_step();
        let steps = [
            (Key::Space, 1),
            (Key::ArrowRight, 1),
            (Key::Backspace, -1),
            (Key::ArrowLeft, -1),
            (Key::ArrowDown, 10),
            (Key::ArrowUp, -10),
        ];
        for (_, by) in steps.into_iter().filter(|(key, _)| input.pressed(*key)) {
            self.step = self.step.saturating_add_signed(by);
        }
        self.step = if self.followed.is_empty() { self.step } else { self.step.min(last) };
    }

    fn overlay(&self, shared: &Shared, pane: usize, overlay: &mut Overlay) {
        let Some(kept) = self.query() else { return };
        drawing::path(shared, &self.path, &self.origins, self.chosen, overlay);
        if let Some(Followed { steps, .. }) = self.followed.get(pane) {
            let here = self.step.min(steps.steps.len().saturating_sub(1));
            drawing::step(shared, pane, kept, steps, here, overlay);
        }
    }

    fn panel(&mut self, ui: &mut Ui, shared: &mut Shared) {
        if shared.opened.recording.is_some() {
            let current = self.query().map(|query| query.record.path);
            if let Some(pixel) = pixels::picker(ui, shared, current) {
                self.want(Wanted::Pixel(pixel), 0);
            }
            ui.add_space(4.0);
        }
        if let Some(error) = self.error.as_ref().or(self.index.error.as_ref()) {
            ui.colored_label(ui.visuals().warn_fg_color, error);
        }
        if self.wanted.is_some()
            && let Some(done) = self.index.fraction()
        {
            ui.weak(format!("finding pixels in the recording: {:.0}%", 100.0 * done));
        }
        if self.path.is_empty() {
            ui.label("Click a pixel of the recorded image, a drawn ray, or any place in the picture.");
            return;
        }
        self.path(ui, shared);
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            for (text, by) in [("|<", isize::MIN), ("<", -1), (">", 1), (">|", isize::MAX)] {
                if ui.button(text).clicked() {
                    self.step = self.step.saturating_add_signed(by);
                }
            }
            let last = self.last_step();
            self.step = self.step.min(last);
            ui.spacing_mut().slider_width = 130.0;
            ui.add(egui::Slider::new(&mut self.step, 0..=last).show_value(false));
        });
        for number in 0..self.followed.len() {
            self.traversal(ui, shared, number);
            ui.separator();
        }
        ui.weak(
            "yellow: the node in question; colored: children that are entered; gray: missed; blue: waiting",
        );
    }

    fn is_settled(&self) -> bool {
        self.wanted.is_none() && self.index.fraction().is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_click_is_so_far_from_a_segment() {
        assert_eq!(distance_to([5.0, 3.0], [0.0, 0.0], [10.0, 0.0]), 3.0);
        assert_eq!(distance_to([13.0, 4.0], [0.0, 0.0], [10.0, 0.0]), 5.0);
        assert_eq!(distance_to([3.0, 4.0], [0.0, 0.0], [0.0, 0.0]), 5.0);
    }
}
