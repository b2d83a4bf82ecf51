//! How far counts explain measured times, and how well measures of a tree rank the trees.

use super::fit::{Fit, Observation, kendall};
use super::{Comparison, RecordingResult};
use crate::traverse::Traversal;

/// Costs fitted to one traversal of trees that are traversed in one form.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub traversal: Traversal,
    /// "binary" or "wide": their visits are different work.
    pub form: &'static str,
    pub trees: usize,
    /// `None` when the groups of queries are too few or too much alike.
    pub fit: Option<Fit>,
}

/// How measures rank the trees by their time under one traversal.
#[derive(Clone, Debug)]
pub struct Ranking {
    pub traversal: Traversal,
    /// Name of a measure and Kendall's τ_b between it and the median times; `None` when it, or the time, ranks nothing.
    pub measures: Vec<(&'static str, Option<f64>)>,
}

/// Fits for each traversal and form; none when they were not asked for.
pub fn fitted(comparison: &Comparison, recording: &RecordingResult) -> Vec<Fitted> {
    let Some(timing) = recording.timing.as_ref().filter(|_| comparison.settings.fit) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for (run, &traversal) in comparison.settings.traversals.iter().enumerate() {
        for (form, binary) in [("binary", true), ("wide", false)] {
            let of_form = |tree: usize| comparison.trees[tree].binary == binary;
            let trees: Vec<usize> = (0..comparison.trees.len()).filter(|&tree| of_form(tree)).collect();
            let observations: Vec<Observation> =
                trees.iter().flat_map(|&tree| timing.trees[tree][run].observations.iter().copied()).collect();
            if !trees.is_empty() {
                found.push(Fitted { traversal, form, trees: trees.len(), fit: Fit::of(&observations) });
            }
        }
    }
    found
}

/// Rankings for each traversal; none when they were not asked for, or of one tree.
pub fn rankings(comparison: &Comparison, recording: &RecordingResult) -> Vec<Ranking> {
    let Some(timing) = recording.timing.as_ref().filter(|_| comparison.settings.fit) else {
        return Vec::new();
    };
    if comparison.trees.len() < 2 {
        return Vec::new();
    }
    let costs = &comparison.settings.costs;
    let facts =
        |measure: fn(&super::TreeFacts) -> f64| comparison.trees.iter().map(measure).collect::<Vec<f64>>();
    let results = |measure: &dyn Fn(&super::TreeResult) -> f64| {
        recording.trees.iter().map(measure).collect::<Vec<f64>>()
    };
    let ranking = |(run, &traversal): (usize, &Traversal)| {
        let times: Vec<f64> = timing.trees.iter().map(|tree| tree[run].total.median).collect();
        let measures = [
            ("sah_cost", facts(|tree| tree.sah_cost)),
            ("epo", facts(|tree| tree.epo)),
            ("leaf_count_variability", results(&|tree| tree.leaf_count_variability())),
            ("t_r", results(&|tree| tree.t_r() as f64)),
            ("gamma_r", results(&|tree| tree.gamma(costs))),
            ("gamma", results(&|tree| costs.gamma(&tree.runs[run].outcome.tallies.total.counts))),
        ];
        let measures = measures.into_iter().map(|(name, values)| (name, kendall(&values, &times))).collect();
        Ranking { traversal, measures }
    };
    comparison.settings.traversals.iter().enumerate().map(ranking).collect()
}
