//! Two trees beside each other: what each costs, and the nodes in which one is most expensive
//! relative to the other, to be clicked.

use super::panels::percent;
use super::shared::{COST_HINT, Shared};
use super::work::Latest;
use crate::explore::heat::per_triangle;
use crate::explore::versus::{Contrast, Side, Versus};
use eframe::egui::{self, RichText, Ui};
use std::sync::Arc;

/// A difference below this share of all cost is not worth a line.
const LEAST: f64 = 0.002;
/// Nodes in a list.
const LISTED: usize = 8;

/// Nodes of the active tree, dearer first and cheaper first.
struct Lists {
    dearer: Vec<Contrast>,
    cheaper: Vec<Contrast>,
}

/// The lists for the active tree, made in the background.
#[derive(Default)]
pub struct Compared {
    lists: Latest<(usize, [usize; 2]), Lists>,
}

impl Compared {
    /// Whether nothing is being compared.
    pub fn is_settled(&self) -> bool {
        self.lists.fraction().is_none()
    }

    /// Shows nothing unless there are two trees whose queries have been counted.
    pub fn ui(&mut self, ui: &mut Ui, shared: &mut Shared) {
        if shared.opened.trees.len() != 2 {
            return;
        }
        let active = shared.active;
        let counted = [active, 1 - active]
            .map(|tree| Some((shared.opened.trees[tree].clone(), shared.results[tree].shares.clone()?)));
        let [Some(first), Some(second)] = counted else { return };
        let stamps = [&first, &second].map(|(_, shares)| Arc::as_ptr(shares) as usize);
        self.lists.ask(&(active, stamps), 1, &shared.wake, move |_| {
            let costs = [&first, &second].map(|(tree, shares)| per_triangle(&tree.walk, shares));
            let walk = &first.0.walk;
            let versus = Versus::new(walk, [&costs[0], &costs[1]]);
            let of = |side| versus.dearest(walk, side, LEAST);
            Ok(Lists { dearer: of(Side::First), cheaper: of(Side::Second) })
        });
        ui.add_space(6.0);
        let Some(lists) = self.lists.value.clone() else { return };
        for (title, list) in
            [("relatively dearer here", &lists.dearer), ("relatively cheaper here", &lists.cheaper)]
        {
            ui.label(RichText::new(title).underline()).on_hover_text(
                "Nodes by the share of all cost that their triangles have in this tree, and in the other",
            );
            if list.is_empty() {
                ui.weak("none");
            }
            for contrast in list.iter().take(LISTED) {
                let [own, other] = contrast.shares.map(percent);
                let text = format!("{own:>6} : {other:>6}  node {}", contrast.node);
                let here = shared.node() == contrast.node;
                if ui.add(egui::Button::selectable(here, RichText::new(text).monospace())).clicked() {
                    shared.go(contrast.node);
                    let bounds = shared.bounds(contrast.node);
                    shared.camera.frame(&bounds, shared.aspect);
                }
            }
        }
    }
}

/// Shows what a query costs in each of two trees, and the tests that explain it; nothing until
/// queries have been counted over both.
pub fn means(ui: &mut Ui, shared: &Shared) {
    let [Some(first), Some(second)] =
        [0, 1].map(|tree: usize| shared.results.get(tree).and_then(|results| results.shares.as_ref()))
    else {
        return;
    };
    ui.strong("Cost of a query").on_hover_text(COST_HINT);
    for (number, tree) in shared.opened.trees.iter().enumerate() {
        let cost = shared.cost_said(number).unwrap_or_default();
        ui.label(format!("{}: {cost}", tree.name())).on_hover_text(COST_HINT);
    }
    let gammas = [first, second].map(|shares| shares.mean_gamma());
    let ratio = shared.gamma_ratio(1).map_or("–".to_owned(), |ratio| format!("×{ratio:.3}"));
    ui.weak(format!("Γ {:.1} and {:.1}, {ratio}", gammas[0], gammas[1]))
        .on_hover_text("Tests of boxes and triangles per query: the paper's cost");
    if !first.price.compares_tests(&second.price) {
        ui.weak("–: boxes of a node are tested together, so Γ does not compare trees of different widths");
    }
    ui.separator();
}
