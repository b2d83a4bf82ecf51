//! A comparison as JSON. Keys are a contract: scripts read `trees[].traversals.odf.by_purpose.shadow.box_tests` and the like.

use super::mean;
use crate::compare::{Comparison, Costs, Run, TreeResult, depth_name, kind_name, relative};
use crate::replay::tally::{Histogram, Tally};
use serde::Serialize;
use std::collections::BTreeMap;

#[derive(Serialize)]
struct Report<'a> {
    rays: &'a str,
    c_i: f64,
    c_p: f64,
    trees: Vec<Tree<'a>>,
    failures: &'a [String],
}

#[derive(Serialize)]
struct Tree<'a> {
    path: &'a str,
    producer: &'a str,
    nodes: usize,
    leaves: usize,
    depth: usize,
    max_children: usize,
    max_leaf: usize,
    sah_cost: f64,
    /// In which depth-first occlusion queries visited children.
    occlusion_order: &'static str,
    t_r: u64,
    t_r_by_kind: BTreeMap<&'static str, u64>,
    /// Γ_R, strictly front to back over every effective segment.
    gamma: f64,
    gamma_ratio: f64,
    traversals: BTreeMap<&'static str, Traversal>,
}

#[derive(Serialize)]
struct Traversal {
    #[serde(flatten)]
    total: Group,
    by_kind: BTreeMap<&'static str, Group>,
    by_depth: BTreeMap<String, Group>,
    by_purpose: BTreeMap<&'static str, Group>,
}

#[derive(Serialize)]
struct Group {
    queries: u64,
    hits: u64,
    box_tests: u64,
    node_visits: u64,
    primitive_tests: u64,
    mismatches: u64,
    borderline: u64,
    unchecked: u64,
    seconds: f64,
    /// c_i · box tests + c_p · primitive tests, as measured.
    gamma: f64,
    /// Relative to the first tree, same traversal and group; absent where the first tree has no such queries.
    gamma_ratio: Option<f64>,
    per_query: PerQuery,
}

#[derive(Serialize)]
struct PerQuery {
    box_tests: Distribution,
    node_visits: Distribution,
    primitive_tests: Distribution,
}

#[derive(Serialize)]
struct Distribution {
    mean: f64,
    median: u64,
    p99: u64,
}

/// The whole comparison, pretty-printed, with the lines that made it fail.
pub fn render(comparison: &Comparison, rays: &str, failures: &[String]) -> serde_json::Result<String> {
    let Costs { c_i, c_p } = comparison.settings.costs;
    let trees = comparison.trees.iter().map(|tree| tree_of(comparison, tree)).collect();
    serde_json::to_string_pretty(&Report { rays, c_i, c_p, trees, failures })
}

fn tree_of<'a>(comparison: &'a Comparison, tree: &'a TreeResult) -> Tree<'a> {
    let costs = &comparison.settings.costs;
    let first = comparison.trees.first().unwrap_or(tree);
    let gamma = tree.gamma(costs);
    Tree {
        path: &tree.path,
        producer: &tree.producer,
        nodes: tree.statistics.nodes,
        leaves: tree.statistics.leaves,
        depth: tree.statistics.depth,
        max_children: tree.statistics.max_children,
        max_leaf: tree.statistics.max_leaf,
        sah_cost: tree.sah_cost,
        occlusion_order: tree.occlusion_order.key(),
        t_r: tree.t_r(),
        t_r_by_kind: tree
            .overlap()
            .tallies
            .by_kind
            .iter()
            .map(|(kind, tally)| (kind_name(*kind), tally.overlap.inner))
            .collect(),
        gamma,
        gamma_ratio: relative(gamma, first.gamma(costs)),
        traversals: tree
            .runs
            .iter()
            .zip(&first.runs)
            .map(|(run, first)| (run.traversal.key(), traversal_of(costs, run, first)))
            .collect(),
    }
}

fn traversal_of(costs: &Costs, run: &Run, first: &Run) -> Traversal {
    let (tallies, first) = (&run.outcome.tallies, &first.outcome.tallies);
    let group = |tally: &Tally, first: Option<&Tally>| group_of(costs, tally, first);
    Traversal {
        total: group(&tallies.total, Some(&first.total)),
        by_kind: tallies
            .by_kind
            .iter()
            .map(|(kind, tally)| (kind_name(*kind), group(tally, first.by_kind.get(kind))))
            .collect(),
        by_depth: tallies
            .by_depth
            .iter()
            .map(|(depth, tally)| (depth_name(*depth), group(tally, first.by_depth.get(depth))))
            .collect(),
        by_purpose: tallies
            .by_purpose
            .iter()
            .map(|(purpose, tally)| (purpose.name(), group(tally, first.by_purpose.get(purpose))))
            .collect(),
    }
}

fn group_of(costs: &Costs, tally: &Tally, first: Option<&Tally>) -> Group {
    let gamma = costs.gamma(tally);
    let distribution = |sum: u64, histogram: &Histogram| Distribution {
        mean: mean(sum, tally.queries),
        median: histogram.quantile(0.5),
        p99: histogram.quantile(0.99),
    };
    let counts = &tally.counts;
    Group {
        queries: tally.queries,
        hits: tally.hits,
        box_tests: counts.box_tests,
        node_visits: counts.node_visits,
        primitive_tests: counts.primitive_tests,
        mismatches: tally.mismatches,
        borderline: tally.borderline,
        unchecked: tally.unchecked,
        seconds: tally.seconds,
        gamma,
        gamma_ratio: first.map(|first| relative(gamma, costs.gamma(first))),
        per_query: PerQuery {
            box_tests: distribution(counts.box_tests, &tally.box_tests),
            node_visits: distribution(counts.node_visits, &tally.node_visits),
            primitive_tests: distribution(counts.primitive_tests, &tally.primitive_tests),
        },
    }
}
