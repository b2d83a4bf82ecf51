//! Mode *explore*: walking about in a tree, and seeing at each node what its queries cost.

use super::{Input, Mode};
use crate::explore::shares::NodeShare;
use crate::traverse::PreparedRay;
use crate::view::diagram::DiagramView;
use crate::view::heat::short;
use crate::view::layers::{Boxes, SurfaceColor};
use crate::view::paint::{self, color32};
use crate::view::panels::{count, facts, percent};
use crate::view::shared::{Shared, Spot, child_name};
use crate::view::versus::{self, Compared};
use eframe::egui::{self, Key, RichText, Ui};

/// Nodes in the list of the most expensive ones.
const LISTED: usize = 12;

/// Where one stands is shared; this is what the panel remembers.
#[derive(Default)]
pub struct Explore {
    entered: bool,
    diagram: DiagramView,
    versus: Compared,
}

impl Mode for Explore {
    fn name(&self) -> &'static str {
        "Explore"
    }

    fn purpose(&self) -> &'static str {
        "Walk through the tree, and see what each node costs"
    }

    fn keys(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("← →", "to the left or the right child (of a wide node: the first or the last)"),
            ("↑", "to the parent"),
            ("↓", "back down to where one came from"),
            (", .", "to the sibling on the left or the right"),
            ("click", "one level down, to the child under the mouse"),
            ("double click", "to the leaf of the triangle under the mouse"),
            ("B", "other boxes: children, a level, nodes above a cost"),
            ("L", "one level further down (with Shift: up) for the boxes of a level"),
        ]
    }

    fn enter(&mut self, shared: &mut Shared) {
        // The first time, what the mode is about becomes visible; later, what the user has chosen stays.
        if !std::mem::replace(&mut self.entered, true) {
            shared.layers.boxes.visible = true;
            if shared.layers.surfaces.color == SurfaceColor::Plain {
                shared.layers.surfaces.color = SurfaceColor::Subtree;
            }
        }
    }

    fn update(&mut self, shared: &mut Shared, input: &Input) {
        if let Some(click) = input.click {
            shared.active = click.pane;
        }
        let tree = shared.tree().clone();
        let cursor = &mut shared.cursors[shared.active];
        let children = tree.walk.children(cursor.node()).len() as u32;
        let moves = [(Key::ArrowLeft, 0), (Key::ArrowRight, children.saturating_sub(1))];
        for (key, number) in moves {
            if input.pressed(key) && !cursor.child(&tree.walk, number) {
                shared.note = Some("this is a leaf: it has no children".to_owned());
            }
        }
        if input.pressed(Key::ArrowUp) && !cursor.up() {
            shared.note = Some("this is the root".to_owned());
        }
        if input.pressed(Key::ArrowDown) {
            cursor.down(&tree.walk);
        }
        for (key, steps) in [(Key::Comma, -1), (Key::Period, 1)] {
            if input.pressed(key) {
                cursor.sideways(&tree.walk, steps);
            }
        }
        if let Some(click) = input.click {
            match (input.double_click, click.triangle) {
                (true, Some(triangle)) => {
                    cursor.leaf_of(&tree.walk, triangle);
                }
                (true, None) => {}
                (false, _) => descend(shared, &click),
            }
        }
        let boxes = &mut shared.layers.boxes;
        if input.pressed(Key::B) {
            let next = Boxes::ALL.iter().position(|&which| which == boxes.which).unwrap_or(0) + 1;
            (boxes.which, boxes.visible) = (Boxes::ALL[next % Boxes::ALL.len()], true);
        }
        for &(key, modifiers) in &input.keys {
            if key == Key::L {
                (boxes.which, boxes.visible) = (Boxes::Level, true);
                boxes.levels =
                    if modifiers.shift { boxes.levels.saturating_sub(1) } else { boxes.levels + 1 };
            }
        }
    }

    fn is_settled(&self) -> bool {
        self.versus.is_settled()
    }

    fn panel(&mut self, ui: &mut Ui, shared: &mut Shared) {
        versus::means(ui, shared);
        breadcrumb(ui, shared);
        ui.separator();
        let node = shared.node();
        let tree = shared.tree().clone();
        let shares = shared.results[shared.active].shares.clone();
        let walk = &tree.walk;
        match &shares {
            Some(shares) => {
                describe(ui, node, &shares.node(walk, node), shares.counted.queries);
                super::super::panels::sampled(ui, &shares.counted.sampled);
            }
            None => describe_geometry(ui, shared, node),
        }
        children(ui, shared, node);
        if let Some(shares) = &shares {
            ui.add_space(6.0);
            self.versus.ui(ui, shared);
            self.diagram.ui(ui, shared, shares);
            ui.add_space(6.0);
            ui.label(RichText::new("Where most is spent").strong()).on_hover_text(
                "Nodes by what is spent at each itself: on visiting its children, or on its triangles",
            );
            let mut nodes = shares.nodes_above(walk, crate::explore::shares::Measure::Cost, 0.002);
            let own = |node: u32| shares.own_share(walk, node);
            nodes.sort_by(|&a, &b| own(b).total_cmp(&own(a)));
            for &other in nodes.iter().take(LISTED) {
                let kind = if tree.bvh.tree.nodes[other as usize].is_leaf() { "leaf" } else { "node" };
                let text = format!("{:>6}  {kind} {other}, level {}", percent(own(other)), walk.level(other));
                if ui.selectable_label(other == node, RichText::new(text).monospace()).clicked() {
                    shared.go(other);
                }
            }
        }
    }
}

/// The path from the root, each step to be clicked; long ones are cut in the middle.
fn breadcrumb(ui: &mut Ui, shared: &mut Shared) {
    let path = shared.cursors[shared.active].path().to_vec();
    let tree = shared.tree().clone();
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for (level, &node) in path.iter().enumerate() {
            let hidden = path.len() > 12 && (3..path.len() - 8).contains(&level);
            if hidden {
                if level == 3 {
                    ui.label("…");
                }
                continue;
            }
            let name = match level {
                0 => "root".to_owned(),
                _ => {
                    let siblings = tree.walk.children(path[level - 1]).len();
                    let number = tree.walk.number(node) as usize;
                    let short = if siblings == 2 {
                        ["L", "R"][number.min(1)].to_owned()
                    } else {
                        (number + 1).to_string()
                    };
                    format!("› {short}")
                }
            };
            let hint = format!("node {node}, level {level}");
            if ui.selectable_label(level + 1 == path.len(), name).on_hover_text(hint).clicked() {
                shared.go(node);
            }
        }
    });
}

fn describe(ui: &mut Ui, number: u32, node: &NodeShare, queries: u64) {
    let below = &node.below;
    let level = match node.is_leaf {
        true => node.level.to_string(),
        false => format!("{}, {}", node.level, node.children),
    };
    let mean = |&count: &u64| format!("{:.2}", count as f64 / queries.max(1) as f64);
    let per_query = |counts: &[u64]| counts.iter().map(mean).collect::<Vec<String>>().join("  ");
    let kind = if node.is_leaf { "Leaf" } else { "Node" };
    ui.heading(format!("{kind} {number}"));
    facts(
        ui,
        "node",
        &[
            (
                "cost below",
                format!("{} ns ({})", short(node.cost), percent(node.share)),
                "What a query is expected to spend in the node and below, on average over all queries: ns of visits, leaves and blocks \
                 of triangles; and its part of the whole",
            ),
            ("spent here", percent(node.own_share), "Part of all cost in the node itself"),
            (
                "expected by area",
                percent(node.area_share),
                "Part of all cost that is below when each box is hit as its surface area predicts, as SAH takes it",
            ),
            ("level, children", level, "The root's level is 0"),
            (
                "triangles below",
                count(node.triangles as u64),
                "One that stands in several leaves counts in each",
            ),
            (
                "area",
                format!("{} ({})", short(node.area), percent(node.area_to_root)),
                "Surface of the box, and its part of the root's: what SAH takes for the chance of being hit",
            ),
            (
                "queries through it",
                format!("{} ({})", count(node.overlapped), percent(node.overlapped_share)),
                "P_R: queries whose effective segment overlaps the box",
            ),
            (
                "opened by",
                count(node.opened),
                "Queries that tested the boxes of its children, or its triangles",
            ),
            (
                "visits, leaves, blocks",
                per_query(&[below.node_visits, below.leaf_visits, below.block_tests]),
                "Below, for a query on average: inner nodes visited, leaves opened, blocks of up to four triangles tested",
            ),
            (
                "box, triangle tests",
                per_query(&[below.box_tests, below.primitive_tests]),
                "Likewise boxes and triangles, each: the paper's terms",
            ),
        ],
    );
    let ratio = node.share / node.area_share;
    if node.area_share > 0.0 && node.level > 0 && !(0.67..=1.5).contains(&ratio) {
        let text = if ratio > 1.0 {
            format!("costs {ratio:.1} × what its area predicts")
        } else {
            format!("costs {:.2} of what its area predicts", ratio)
        };
        ui.label(RichText::new(text).color(color32(paint::SELECTED)));
    }
}

/// What is known without a recording.
fn describe_geometry(ui: &mut Ui, shared: &Shared, number: u32) {
    let tree = shared.tree();
    let node = &tree.bvh.tree.nodes[number as usize];
    let root = f64::from(tree.bvh.tree.nodes[0].bounds().area()).max(f64::MIN_POSITIVE);
    let area = f64::from(node.bounds().area());
    ui.heading(format!("{} {number}", if node.is_leaf() { "Leaf" } else { "Node" }));
    facts(
        ui,
        "node",
        &[
            ("level", tree.walk.level(number).to_string(), "Of the root: 0"),
            ("children", if node.is_leaf() { "–".to_owned() } else { node.len().to_string() }, ""),
            ("triangles below", count(tree.walk.triangles(number).len() as u64), ""),
            (
                "area",
                format!("{} ({})", short(area), percent(area / root)),
                "Surface of the box, and its part of the root's",
            ),
        ],
    );
    ui.weak(if shared.opened.recording.is_some() {
        "counting queries …"
    } else {
        "Open a recording (.rays) too, to see what queries cost here."
    });
}

/// A button for each child, in its colour, with its share.
fn children(ui: &mut Ui, shared: &mut Shared, node: u32) {
    let tree = shared.tree().clone();
    let children = tree.walk.children(node);
    ui.horizontal_wrapped(|ui| {
        if ui.add_enabled(node != 0, egui::Button::new("parent")).clicked() {
            shared.cursors[shared.active].up();
        }
        let shares = shared.results[shared.active].shares.clone();
        for (number, child) in children.clone().enumerate() {
            let mut text = child_name(number, children.len());
            if let Some(shares) = &shares {
                let share = shares.share(&tree.walk, crate::explore::shares::Measure::Cost, child);
                text += &format!("  {}", percent(share));
            }
            let text = RichText::new(text).color(color32(paint::child(number)));
            if ui.button(text).on_hover_text(format!("node {child}")).clicked() {
                shared.go(child);
            }
        }
    });
}

/// Goes from the current node one level down to what is under the mouse: the child that holds the triangle there, or the nearest child
/// whose box is there. Outside of the current node, to the lowest node that holds both.
fn descend(shared: &mut Shared, click: &Spot) {
    let tree = shared.tree().clone();
    let (node, walk) = (shared.node(), &tree.walk);
    if let Some(triangle) = click.triangle {
        let leaves: Vec<u32> = walk.leaves_of(triangle).collect();
        let towards = leaves.iter().find_map(|&leaf| {
            let path = walk.path(leaf);
            let here = path.iter().position(|&step| step == node)?;
            path.get(here + 1).copied()
        });
        if let Some(child) = towards {
            shared.go(child);
            return;
        }
        // At the leaf already, or elsewhere.
        if let Some(&leaf) = leaves.first().filter(|&&leaf| leaf != node) {
            shared.go(walk.common(node, leaf));
        }
        return;
    }
    let Some(ray) = click.ray else { return };
    let ray = PreparedRay::new(&ray);
    let entered = walk.children(node).filter_map(|child| {
        let entry = ray.entry(&tree.bvh.tree.nodes[child as usize].bounds(), ray.tfar)?;
        Some((child, entry))
    });
    if let Some((child, _)) = entered.min_by(|a, b| a.1.total_cmp(&b.1)) {
        shared.go(child);
    }
}
