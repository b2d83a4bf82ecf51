//! What all modes and panels share: the files, the camera, where one stands in each tree, what has been counted, what is visible.

use super::heat;
use super::layers::{Boxes, Layers, SurfaceColor};
use super::load::{OpenTree, Opened};
use super::navigate::Navigator;
use super::overlay::Overlay;
use super::paint::{self, Paint, Rgba};
use super::pixels::Pixels;
use super::rays::Rays;
use super::results::Results;
use super::work::Wake;
use crate::compare::relative;
use crate::explore::shares::{Measure, Shares};
use crate::explore::walk::Cursor;
use crate::geometry::{Aabb, Ray, Vec3};
use crate::traverse::Traversal;
use std::sync::Arc;

/// What cost is.
pub const COST_HINT: &str = "What a query is expected to take, in ns of visits, leaves and blocks of triangles, as bvh-compare reports it; \
     × is relative to the first tree";

/// Most boxes that are drawn: more could not be told apart.
pub const MOST_BOXES: usize = 4000;

/// A place in a picture, and what is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Number of the pane.
    pub pane: usize,
    /// In shares of the pane's width and height.
    pub place: [f32; 2],
    /// Width by height of the pane.
    pub aspect: f32,
    pub triangle: Option<u32>,
    /// In world space, where there is a triangle.
    pub point: Option<Vec3>,
    /// The camera's ray through the place.
    pub ray: Option<Ray>,
}

/// Colours of triangles, and what they were made from.
struct Painted {
    key: (usize, SurfaceColor, u32, usize, &'static str),
    colors: Arc<Vec<Rgba>>,
    legend: Option<Legend>,
}

/// What colours mean.
#[derive(Clone, Debug, PartialEq)]
pub enum Legend {
    /// A scale from `low` to `high`, of which colours are those of a map.
    Scale {
        title: String,
        low: String,
        high: String,
        map: paint::ColorMap,
    },
    /// From blue over white to orange.
    Difference {
        title: String,
        low: String,
        high: String,
    },
    Kinds {
        title: String,
        kinds: Vec<(Rgba, String)>,
    },
}

/// The state of a window with files in it.
pub struct Shared {
    pub opened: Arc<Opened>,
    pub camera: Navigator,
    pub layers: Layers,
    /// Where one stands, by tree.
    pub cursors: Vec<Cursor>,
    /// The tree that panels speak of.
    pub active: usize,
    pub traversal: Traversal,
    pub results: Vec<Results>,
    pub rays: Rays,
    pub pixels: Pixels,
    pub hovered: Option<Spot>,
    /// Width by height of a picture.
    pub aspect: f32,
    /// Something to be said for a moment.
    pub note: Option<String>,
    pub wake: Wake,
    painted: Vec<Option<Painted>>,
}

impl Shared {
    pub fn new(opened: Arc<Opened>, wake: Wake) -> Shared {
        let trees = opened.trees.len();
        Shared {
            camera: Navigator::new(opened.start, opened.size()),
            layers: Layers::default(),
            cursors: vec![Cursor::default(); trees],
            active: 0,
            traversal: Traversal::Odf,
            results: (0..trees).map(|_| Results::default()).collect(),
            rays: Rays::default(),
            pixels: Pixels::default(),
            hovered: None,
            aspect: 1.0,
            note: None,
            painted: (0..trees).map(|_| None).collect(),
            wake,
            opened,
        }
    }

    /// The tree that panels speak of.
    pub fn tree(&self) -> &Arc<OpenTree> {
        self.opened.tree(self.active)
    }

    /// The node that one stands at, in the active tree.
    pub fn node(&self) -> u32 {
        self.cursors[self.active].node()
    }

    /// Goes to a node of the active tree.
    pub fn go(&mut self, node: u32) {
        self.cursors[self.active].go(&self.opened.trees[self.active].walk, node);
    }

    /// The box of a node of the active tree.
    pub fn bounds(&self, node: u32) -> Aabb {
        self.tree().bvh.tree.nodes[node as usize].bounds()
    }

    /// Nanoseconds of a query over a tree, on average, once queries have been counted.
    pub fn cost(&self, tree: usize) -> Option<f64> {
        self.results.get(tree)?.shares.as_ref().map(|shares| shares.mean_cost())
    }

    /// The same relative to the first tree, once the same queries have been counted over both.
    pub fn cost_ratio(&self, tree: usize) -> Option<f64> {
        self.ratio(tree, Shares::mean_cost)
    }

    /// Γ relative to the first tree; also `None` between trees of different widths.
    pub fn gamma_ratio(&self, tree: usize) -> Option<f64> {
        let [own, first] = [tree, 0].map(|tree| self.opened.tree(tree).price);
        own.compares_tests(&first).then(|| self.ratio(tree, Shares::mean_gamma)).flatten()
    }

    fn ratio(&self, tree: usize, mean: fn(&Shares) -> f64) -> Option<f64> {
        let [first, own] = [0, tree].map(|tree| self.results.get(tree)?.shares.as_ref());
        let (first, own) = first.zip(own)?;
        (first.counted.sampled == own.counted.sampled).then(|| relative(mean(own), mean(first)))
    }

    /// The cost in words; of another than the first tree with its ratio.
    pub fn cost_said(&self, tree: usize) -> Option<String> {
        let ratio = self.cost_ratio(tree).filter(|_| tree > 0);
        let ratio = ratio.map_or(String::new(), |ratio| format!(", ×{ratio:.3}"));
        Some(format!("{:.1} ns{ratio}", self.cost(tree)?))
    }

    /// Takes what was counted in the background, and starts what has to be counted.
    pub fn update(&mut self) {
        let recording = self.opened.recording.as_ref();
        for (tree, results) in self.opened.trees.iter().zip(&mut self.results) {
            results.update(tree, recording, self.traversal, &self.wake);
        }
        if let Some(recording) = recording {
            let tree = (self.active, self.opened.tree(self.active));
            let (bounds, traversal) = (self.opened.bounds, self.traversal);
            self.rays.update(&self.layers.rays, tree, recording, traversal, bounds, &self.wake);
        }
        if self.layers.pixels.visible {
            (0..self.opened.trees.len()).for_each(|tree| self.ask_pixels(tree));
        }
    }

    /// Has the costs of the recorded image's pixels counted over a tree.
    pub fn ask_pixels(&mut self, tree: usize) {
        if let Some(recording) = &self.opened.recording {
            self.pixels.ask(tree, self.opened.tree(tree), recording, self.traversal, &self.wake);
        }
    }

    /// Whether anything is being counted.
    pub fn is_counting(&self) -> bool {
        self.rays.is_busy()
            || self.pixels.is_busy()
            || self.results.iter().any(|results| results.fraction().is_some())
    }

    /// How surfaces look in a pane, and what their colours mean.
    pub fn paint(&mut self, pane: usize) -> (Paint, Option<Legend>) {
        let color = self.layers.surfaces.color;
        let stamp = self.results.iter().fold(0, |stamp: usize, results| {
            let address = results.shares.as_ref().map_or(0, |shares| Arc::as_ptr(shares) as usize);
            stamp.rotate_left(7) ^ address
        });
        let node = if color == SurfaceColor::Subtree { self.cursors[pane].node() } else { 0 };
        let key = (pane, color, node, stamp, self.layers.surfaces.map.name());
        if self.painted[pane].as_ref().is_none_or(|painted| painted.key != key) {
            let made = match color {
                SurfaceColor::Plain => None,
                SurfaceColor::Subtree => Some(self.by_subtree(pane, node)),
                _ => self.by_heat(pane),
            };
            self.painted[pane] =
                made.map(|(colors, legend)| Painted { key, colors: Arc::new(colors), legend });
        }
        match &self.painted[pane] {
            Some(painted) => (Paint::Each(painted.colors.clone()), painted.legend.clone()),
            None => (Paint::Plain, None),
        }
    }

    /// Triangles below the children of a node, each child in its colour.
    fn by_subtree(&self, pane: usize, node: u32) -> (Vec<Rgba>, Option<Legend>) {
        let tree = self.opened.tree(pane);
        let mut colors = vec![[0; 4]; tree.triangles().len()];
        let children = tree.walk.children(node);
        let mut kinds = Vec::new();
        for (number, child) in children.clone().enumerate() {
            let color = paint::child(number);
            for &triangle in tree.walk.triangles(child) {
                colors[triangle as usize] = color;
            }
            kinds.push((color, child_name(number, children.len())));
        }
        if children.is_empty() {
            for &triangle in tree.walk.triangles(node) {
                colors[triangle as usize] = paint::SELECTED;
            }
            kinds.push((paint::SELECTED, "this leaf".to_owned()));
        }
        (colors, Some(Legend::Kinds { title: "triangles below".to_owned(), kinds }))
    }

    fn by_heat(&self, pane: usize) -> Option<(Vec<Rgba>, Option<Legend>)> {
        let surfaces = &self.layers.surfaces;
        let counted = |tree: usize| {
            Some((&self.opened.trees.get(tree)?.walk, &**self.results.get(tree)?.shares.as_ref()?))
        };
        let (colors, legend) = if surfaces.color == SurfaceColor::Difference {
            heat::differences([counted(0)?, counted(1)?])
        } else {
            let (walk, shares) = counted(pane)?;
            heat::triangles(surfaces.color, walk, shares, surfaces.map)?
        };
        Some((colors, Some(legend)))
    }

    /// Draws the boxes that the layer asks for.
    pub fn boxes(&self, pane: usize, overlay: &mut Overlay) {
        let layer = &self.layers.boxes;
        if !layer.visible {
            return;
        }
        let tree = self.opened.tree(pane);
        let node = self.cursors[pane].node();
        let bounds = |node: u32| tree.bvh.tree.nodes[node as usize].bounds();
        let walk = &tree.walk;
        let mut boxes: Vec<(Aabb, Rgba, f32)> = match layer.which {
            Boxes::Children => walk
                .children(node)
                .enumerate()
                .map(|(number, child)| (bounds(child), paint::child(number), 1.6))
                .collect(),
            Boxes::Level => {
                let nodes = walk.below(node, layer.levels, MOST_BOXES);
                let color = |child: u32| paint::child(walk.number(child) as usize);
                nodes.into_iter().map(|child| (bounds(child), color(child), 1.0)).collect()
            }
            Boxes::Above => match &self.results[pane].shares {
                None => Vec::new(),
                Some(shares) => {
                    let measure = Measure::Cost;
                    let nodes = shares.nodes_above(walk, measure, layer.share);
                    let inside = nodes.into_iter().filter(|&other| walk.common(other, node) == node);
                    let color = |other: u32| {
                        let share = shares.share(walk, measure, other);
                        // From the threshold to the whole, on a scale of magnitudes.
                        let place = 1.0 - share.ln() / layer.share.min(0.999).ln();
                        self.layers.surfaces.map.color(0.15 + 0.85 * place)
                    };
                    inside.take(MOST_BOXES).map(|other| (bounds(other), color(other), 1.2)).collect()
                }
            },
        };
        boxes.push((bounds(node), paint::SELECTED, 2.4));
        overlay.boxes(&boxes, layer.opacity, layer.behind);
    }
}

/// What child `number` of so many is called.
pub fn child_name(number: usize, children: usize) -> String {
    match (number, children) {
        (0, 2) => "left child".to_owned(),
        (1, 2) => "right child".to_owned(),
        _ => format!("child {}", number + 1),
    }
}
