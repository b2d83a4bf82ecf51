//! Mode *crossplane*: a plane across the scene, and what passes it: queries one by one, their traffic, or boxes of the tree.

use super::{Input, Mode};
use crate::explore::crossing::{Grid, Plane, Traffic, overlaps, traffic};
use crate::explore::queries::Source;
use crate::geometry::Vec3;
use crate::view::heat::short;
use crate::view::overlay::{Corner, Line, Overlay, Point, Shapes, rectangle};
use crate::view::paint::{ColorMap, HIT, MISS, SELECTED};
use crate::view::panels::{self, count};
use crate::view::results::every_query;
use crate::view::shared::{Legend, Shared};
use crate::view::work::Latest;
use eframe::egui::{self, Key, Ui};
use std::sync::Arc;

/// Cells along the longer side of the plane.
const CELLS: usize = 128;
/// Points that are drawn.
const MOST_POINTS: usize = 100_000;
/// Queries that are looked at.
const LOOKED_AT: u64 = 2_000_000;

/// What the plane shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Shown {
    /// Where queries cross it, hits and misses apart
    Points,
    /// How many cross each part of it
    #[default]
    Traffic,
    /// How many boxes of the tree overlap at each point
    Boxes,
}

impl Shown {
    pub const ALL: [Shown; 3] = [Shown::Points, Shown::Traffic, Shown::Boxes];

    fn name(self) -> &'static str {
        match self {
            Shown::Points => "crossing points",
            Shown::Traffic => "traffic",
            Shown::Boxes => "overlapping boxes",
        }
    }
}

/// Which way the plane stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Facing {
    /// Perpendicular to the x axis
    X,
    /// Perpendicular to the y axis
    #[default]
    Y,
    /// Perpendicular to the z axis
    Z,
    /// Towards the camera, and with it
    Camera,
}

impl Facing {
    pub const ALL: [Facing; 4] = [Facing::X, Facing::Y, Facing::Z, Facing::Camera];

    fn name(self) -> &'static str {
        match self {
            Facing::X => "across x",
            Facing::Y => "across y",
            Facing::Z => "across z",
            Facing::Camera => "facing the camera",
        }
    }
}

/// What a plane shows, ready to be drawn.
struct Picture {
    faces: Arc<Vec<Corner>>,
    points: Arc<Vec<Point>>,
    legend: Legend,
    /// What was counted, in words.
    words: Vec<String>,
}

/// What a picture depends on.
#[derive(Clone, Debug, PartialEq)]
struct Question {
    plane: Plane,
    shown: Shown,
    /// For boxes: the tree, and levels.
    tree: (usize, usize, usize),
}

/// The plane.
pub struct Crossplane {
    pub shown: Shown,
    pub facing: Facing,
    /// Where along its normal, in shares of the scene: 0 to 1. From the camera: of the diagonal.
    pub place: f32,
    /// The plane as it was frozen, when it does not follow what moves it.
    frozen: Option<Plane>,
    levels: [usize; 2],
    opacity: f32,
    pictures: Vec<Latest<Question, Picture>>,
}

impl Default for Crossplane {
    fn default() -> Crossplane {
        Crossplane {
            shown: Shown::default(),
            facing: Facing::default(),
            place: 0.5,
            frozen: None,
            levels: [0, 64],
            opacity: 0.85,
            pictures: Vec::new(),
        }
    }
}

impl Crossplane {
    /// The plane now.
    fn plane(&self, shared: &Shared) -> Plane {
        if let Some(frozen) = self.frozen {
            return frozen;
        }
        let bounds = shared.opened.bounds;
        let extent = bounds.extent().max(Vec3::splat(1e-3 * shared.opened.size()));
        let across = |axis: usize, up: Vec3, [width, height]: [f32; 2]| {
            let mut center = bounds.center();
            center[axis] = bounds.lower[axis] + self.place * extent[axis];
            Plane::facing(center, Vec3::AXES[axis], up, [width, height])
        };
        match self.facing {
            Facing::X => across(0, Vec3::Y, [extent.z, extent.y]),
            Facing::Y => across(1, Vec3::Z, [extent.x, extent.z]),
            Facing::Z => across(2, Vec3::Y, [extent.x, extent.y]),
            Facing::Camera => {
                let view = shared.camera.view;
                let [forward, _, up] = shared.camera.axes();
                let distance = self.place * shared.opened.size();
                let height = 2.0 * distance * (view.fov_degrees.to_radians() / 2.0).tan();
                let center = view.eye + forward * distance;
                Plane::facing(center, -forward, up, [1.6 * height, height].map(|side| 0.9 * side.max(1e-6)))
            }
        }
    }

    fn grid(plane: &Plane) -> Grid {
        let (width, height) = (plane.across.length(), plane.up.length());
        let longer = width.max(height).max(f32::MIN_POSITIVE);
        let cells = |side: f32| ((CELLS as f32 * side / longer) as usize).max(8);
        Grid { columns: cells(width), rows: cells(height) }
    }

    /// Has what is shown worked out.
    fn ask(&mut self, shared: &Shared) {
        let plane = self.plane(shared);
        let trees = shared.opened.trees.len();
        self.pictures.resize_with(trees, Latest::default);
        for (number, latest) in self.pictures.iter_mut().enumerate() {
            let tree = shared.opened.tree(number).clone();
            let [first, last] = self.levels;
            let of_tree = if self.shown == Shown::Boxes { (number, first, last) } else { (0, 0, 0) };
            let question = Question { plane, shown: self.shown, tree: of_tree };
            let (shown, grid) = (self.shown, Crossplane::grid(&plane));
            let recording = shared.opened.recording.clone();
            let steps = recording.as_ref().map_or(1, |recording| recording.rays.query_count().min(LOOKED_AT));
            latest.ask(&question, steps, &shared.wake, move |progress| {
                if shown == Shown::Boxes {
                    let counts = overlaps(tree.bvh.tree, &plane, grid, first..=last);
                    return Ok(boxes(&plane, grid, &counts));
                }
                let recording =
                    recording.ok_or("open a recording (.rays) too, to see its queries cross the plane")?;
                let source =
                    Source { rays: &recording.rays, choice: every_query(&recording), limit: LOOKED_AT };
                let found = traffic(&source, &plane, grid, MOST_POINTS, progress);
                Ok(passing(&plane, &found.map_err(|error| error.to_string())?, shown))
            });
        }
    }
}

/// Cells with a value as faces, in colours of their share of the highest.
fn cells(plane: &Plane, grid: Grid, counts: &[u32], high: f64, map: ColorMap) -> Vec<Corner> {
    let mut faces = Vec::new();
    for (cell, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let [a, b] = grid.middle(cell);
        let (half_a, half_b) = (1.0 / grid.columns as f32, 1.0 / grid.rows as f32);
        let corners = [[-half_a, -half_b], [half_a, -half_b], [half_a, half_b], [-half_a, half_b]];
        let corners = corners.map(|[da, db]| plane.at([a + da, b + db]));
        rectangle(corners, map.color(f64::from(count).ln_1p() / high.ln_1p()), &mut faces);
    }
    faces
}

fn high(counts: &[u32]) -> f64 {
    let mut positive: Vec<u32> = counts.iter().copied().filter(|&count| count > 0).collect();
    positive.sort_unstable();
    positive.get(positive.len().saturating_sub(1) * 995 / 1000).copied().unwrap_or(1).into()
}

fn boxes(plane: &Plane, grid: Grid, counts: &[u32]) -> Picture {
    let high = high(counts);
    let map = ColorMap::Viridis;
    let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len().max(1) as f64;
    let most = counts.iter().max().copied().unwrap_or(0);
    Picture {
        faces: Arc::new(cells(plane, grid, counts, high, map)),
        points: Arc::default(),
        legend: Legend::Scale {
            title: "boxes that overlap at a point".to_owned(),
            low: "0".to_owned(),
            high: format!("{} or more", short(high)),
            map,
        },
        words: vec![format!("{mean:.1} boxes at a point on average, {most} at most")],
    }
}

fn passing(plane: &Plane, found: &Traffic, shown: Shown) -> Picture {
    let mut words = vec![
        format!("{} queries cross the plane", count(found.hits + found.misses)),
        format!("{} of them hit something, {} do not", count(found.hits), count(found.misses)),
    ];
    if !found.sampled.is_all() {
        words.push(format!(
            "of a sample: {} of {} queries",
            count(found.sampled.looked_at),
            count(found.sampled.of)
        ));
    }
    if shown == Shown::Points {
        let point = |point: &crate::explore::crossing::Point| Point {
            at: plane.at(point.place),
            size: 3.0,
            color: if point.hit { HIT } else { MISS },
        };
        let kinds =
            vec![(HIT, "queries that hit something".to_owned()), (MISS, "queries that do not".to_owned())];
        return Picture {
            faces: Arc::default(),
            points: Arc::new(found.points.iter().map(point).collect()),
            legend: Legend::Kinds { title: "crossing points".to_owned(), kinds },
            words,
        };
    }
    let sums = found.hits_by_cell.iter().zip(&found.misses_by_cell).map(|(hits, misses)| hits + misses);
    let sums: Vec<u32> = sums.collect();
    let (high, map) = (high(&sums), ColorMap::Inferno);
    Picture {
        faces: Arc::new(cells(plane, found.grid, &sums, high, map)),
        points: Arc::default(),
        legend: Legend::Scale {
            title: "queries through a cell (log)".to_owned(),
            low: "1".to_owned(),
            high: format!("{} or more", short(high)),
            map,
        },
        words,
    }
}

impl Mode for Crossplane {
    fn name(&self) -> &'static str {
        "Crossplane"
    }

    fn purpose(&self) -> &'static str {
        "Cut the scene with a plane, and see what passes it"
    }

    fn keys(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("↑ ↓, Ctrl + drag", "move the plane along its normal"),
            ("X Y Z C", "across an axis, or facing the camera"),
            ("Space", "freeze the plane, or let it follow again"),
            ("T", "show points, traffic, boxes"),
        ]
    }

    fn update(&mut self, shared: &mut Shared, input: &Input) {
        let step = 0.02;
        let moved = [(Key::ArrowUp, step), (Key::ArrowDown, -step)];
        let mut change: f32 = moved.iter().filter(|(key, _)| input.pressed(*key)).map(|(_, step)| step).sum();
        change -= input.drag.map_or(0.0, |[_, down]| down);
        if change != 0.0 {
            self.frozen = None;
            self.place = (self.place + change).clamp(0.0, 1.0);
        }
        let facings =
            [(Key::X, Facing::X), (Key::Y, Facing::Y), (Key::Z, Facing::Z), (Key::C, Facing::Camera)];
        for (_, facing) in facings.into_iter().filter(|(key, _)| input.pressed(*key)) {
            (self.facing, self.frozen) = (facing, None);
        }
        if input.pressed(Key::Space) {
            self.frozen = if self.frozen.is_some() { None } else { Some(self.plane(shared)) };
        }
        if input.pressed(Key::T) {
            let next = Shown::ALL.iter().position(|&shown| shown == self.shown).unwrap_or(0) + 1;
            self.shown = Shown::ALL[next % Shown::ALL.len()];
        }
        self.ask(shared);
    }

    fn overlay(&self, shared: &Shared, pane: usize, overlay: &mut Overlay) {
        let plane = self.plane(shared);
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|place| plane.at(place));
        let lines = (0..4).map(|side| Line {
            from: corners[side],
            width: 2.0,
            to: corners[(side + 1) % 4],
            color: SELECTED,
        });
        if let Some(picture) = self.pictures.get(pane).and_then(|latest| latest.value.as_ref()) {
            overlay.push(Shapes::Faces(picture.faces.clone()), self.opacity, 0.15);
            overlay.push(Shapes::Points(picture.points.clone()), self.opacity, 0.15);
        }
        overlay.push(Shapes::Lines(Arc::new(lines.collect())), 1.0, 0.3);
    }

    fn legend(&self, pane: usize) -> Option<Legend> {
        Some(self.pictures.get(pane)?.value.as_ref()?.legend.clone())
    }

    fn panel(&mut self, ui: &mut Ui, shared: &mut Shared) {
        ui.heading("Crossplane");
        panels::choose(ui, "facing", &mut self.facing, &Facing::ALL, |facing| facing.name().to_owned());
        ui.add_enabled(
            self.frozen.is_none(),
            egui::Slider::new(&mut self.place, 0.0..=1.0).text(match self.facing {
                Facing::Camera => "diagonals from the eye",
                _ => "across the scene",
            }),
        );
        let mut frozen = self.frozen.is_some();
        ui.checkbox(&mut frozen, "frozen")
            .on_hover_text("The plane stays where it is, wherever the camera goes");
        if frozen != self.frozen.is_some() {
            self.frozen = frozen.then(|| self.plane(shared));
        }
        ui.add_space(6.0);
        ui.strong("Shows");
        for shown in Shown::ALL {
            ui.radio_value(&mut self.shown, shown, shown.name());
        }
        if self.shown == Shown::Boxes {
            let deepest = shared.tree().bvh.statistics.depth.saturating_sub(1);
            let [first, last] = &mut self.levels;
            *last = (*last).min(deepest);
            ui.add(egui::Slider::new(first, 0..=deepest).text("from level"));
            ui.add(egui::Slider::new(last, 0..=deepest).text("to level"));
            *last = (*last).max(*first);
        }
        ui.add(egui::Slider::new(&mut self.opacity, 0.0..=1.0).text("opacity").fixed_decimals(2));
        ui.add_space(6.0);
        for latest in self.pictures.iter().skip(shared.active).take(1) {
            if let Some(error) = &latest.error {
                ui.colored_label(ui.visuals().warn_fg_color, error);
            }
            if let Some(picture) = &latest.value {
                picture.words.iter().for_each(|line| {
                    ui.label(line);
                });
            }
            if let Some(done) = latest.fraction() {
                ui.weak(format!("counting: {:.0}%", 100.0 * done));
            }
        }
    }

    fn is_settled(&self) -> bool {
        self.pictures.iter().all(|latest| latest.fraction().is_none())
    }
}
