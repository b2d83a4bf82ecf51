//! A comparison as JSON. Keys are a contract: scripts read `trees[].traversals.odf.by_purpose.shadow.box_tests` and the like.
//!
//! Of several recordings, `recordings` holds for each what the whole would be for it alone.

use super::json_kernels::{EmbreeJson, TreeTimeJson};
use super::json_time::{FitJson, TimeJson, Timed};
use super::time::way_key;
use super::{gamma_quantile, mean};
use crate::compare::explained::Fitted;
use crate::compare::limit::Metric;
use crate::compare::{Comparison, RecordingResult, Run, Settings, depth_name, kind_name};
use crate::replay::profile::Profile;
use crate::replay::sort::Sort;
use crate::replay::tally::{Histogram, Tally};
use crate::traverse::{Counts, Decisions};
use serde::Serialize;
use std::collections::BTreeMap;

#[derive(Serialize)]
struct Report<'a> {
    rays: &'a str,
    c_i: f64,
    c_p: f64,
    /// Queries in a packet, where they do not go alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    packet: Option<usize>,
    /// By what queries were sorted.
    #[serde(skip_serializing_if = "Option::is_none")]
    sort: Option<&'static str>,
    trees: Vec<Tree<'a>>,
    #[serde(flatten)]
    timing: Option<Timed>,
    #[serde(skip_serializing_if = "Option::is_none")]
    embree: Option<EmbreeJson>,
    /// Why there are no times, where nobody said whether to measure them.
    #[serde(skip_serializing_if = "Option::is_none")]
    left_out: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    failures: Option<&'a [String]>,
}

#[derive(Serialize)]
struct Several<'a> {
    recordings: Vec<Report<'a>>,
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
    /// End-point overlap.
    epo: f64,
    leaf_count_variability: f64,
    /// In which depth-first occlusion queries visited children.
    occlusion_order: &'static str,
    t_r: u64,
    t_r_by_kind: BTreeMap<&'static str, u64>,
    /// Γ_R, strictly front to back over every effective segment.
    gamma: f64,
    /// Relative to the first tree; null between trees of different widths.
    gamma_ratio: Option<f64>,
    traversals: BTreeMap<&'static str, Traversal>,
    /// What a query of the first traversal cost in the baseline.
    #[serde(skip_serializing_if = "Option::is_none")]
    baseline_cost: Option<f64>,
    /// Under others' kernels.
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<TreeTimeJson>,
}

#[derive(Serialize)]
struct Traversal {
    #[serde(flatten)]
    total: Group,
    by_kind: BTreeMap<&'static str, Group>,
    by_depth: BTreeMap<String, Group>,
    by_purpose: BTreeMap<&'static str, Group>,
    #[serde(flatten)]
    profile: Option<Levels>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<TimeJson>,
    /// By way of asking, where queries also went in packets or sorted.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    other_times: BTreeMap<&'static str, TimeJson>,
}

/// What a profile adds.
#[derive(Serialize)]
struct Levels {
    cache_lines: u64,
    /// The root's level first.
    by_level: Vec<Level>,
}

#[derive(Serialize)]
struct Level {
    box_tests: u64,
    node_visits: u64,
    primitive_tests: u64,
}

#[derive(Serialize)]
struct Group {
    queries: u64,
    hits: u64,
    /// Nanoseconds that a query is expected to take; null of packets.
    cost: Option<f64>,
    /// Relative to the first tree, same traversal and group.
    cost_ratio: Option<f64>,
    box_tests: u64,
    node_visits: u64,
    primitive_tests: u64,
    leaf_visits: u64,
    block_tests: u64,
    mismatches: u64,
    borderline: u64,
    /// Not judged: what was hit is not a triangle.
    unchecked: u64,
    /// Not judged: what was hit moves.
    moving: u64,
    seconds: f64,
    /// c_i · box tests + c_p · primitive tests, as measured.
    gamma: f64,
    /// Relative to the first tree, same traversal and group; null where the first tree has no such queries, or is of another width.
    gamma_ratio: Option<f64>,
    per_query: PerQuery,
    #[serde(skip_serializing_if = "Option::is_none")]
    packets: Option<Packets>,
}

/// By which rule it was decided whether packets enter boxes.
#[derive(Serialize)]
struct Packets {
    decisions: u64,
    early_hits: u64,
    early_misses: u64,
    /// All active rays were tested: neither rule could tell.
    by_rays: u64,
    /// All active rays were tested at once: they were few.
    few: u64,
    /// Tests of eight rays against a box.
    octets: u64,
}

#[derive(Serialize)]
struct PerQuery {
    box_tests: Distribution<u64>,
    node_visits: Distribution<u64>,
    primitive_tests: Distribution<u64>,
    /// To within 1/16.
    gamma: Distribution<f64>,
}

#[derive(Serialize)]
struct Distribution<T> {
    mean: f64,
    median: T,
    p99: T,
}

/// The whole comparison, pretty-printed, with the lines that made it fail.
pub fn render(comparison: &Comparison, failures: &[String]) -> serde_json::Result<String> {
    match comparison.recordings.as_slice() {
        [only] => serde_json::to_string_pretty(&report_of(comparison, only, Some(failures))),
        several => {
            let recordings = several.iter().map(|recording| report_of(comparison, recording, None)).collect();
            serde_json::to_string_pretty(&Several { recordings, failures })
        }
    }
}

/// Fitted costs alone, as `fit` of a recording has them.
pub fn render_fits(fits: &[Fitted]) -> serde_json::Result<String> {
    #[derive(Serialize)]
    struct Fits {
        fit: Vec<FitJson>,
    }
    serde_json::to_string_pretty(&Fits { fit: fits.iter().map(FitJson::of).collect() })
}

fn report_of<'a>(
    comparison: &'a Comparison,
    recording: &'a RecordingResult,
    failures: Option<&'a [String]>,
) -> Report<'a> {
    let costs = &comparison.settings.costs;
    let mut trees: Vec<Tree> =
        (0..recording.trees.len()).map(|tree| tree_of(comparison, recording, tree)).collect();
    if let Some(timing) = &recording.timing {
        for ((tree, times), by_way) in trees.iter_mut().zip(&timing.trees).zip(&timing.by_way) {
            for ((traversal, time), others) in comparison.settings.traversals.iter().zip(times).zip(by_way) {
                let Some(place) = tree.traversals.get_mut(traversal.key()) else { continue };
                place.time = Some(TimeJson::of(time));
                let others = timing.ways.iter().zip(others);
                place.other_times = others.map(|(way, time)| (way_key(way), TimeJson::of(time))).collect();
            }
        }
    }
    let Settings { packet, sort, .. } = comparison.settings;
    Report {
        rays: &recording.path,
        c_i: costs.c_i,
        c_p: costs.c_p,
        packet,
        sort: sort.map(Sort::key),
        trees,
        timing: Timed::of(comparison, recording),
        embree: EmbreeJson::of(comparison, recording),
        left_out: comparison.left_out.as_deref(),
        failures,
    }
}

fn tree_of<'a>(comparison: &'a Comparison, recording: &RecordingResult, number: usize) -> Tree<'a> {
    let (facts, tree) = (&comparison.trees[number], &recording.trees[number]);
    Tree {
        path: &facts.path,
        producer: &facts.producer,
        nodes: facts.statistics.nodes,
        leaves: facts.statistics.leaves,
        depth: facts.statistics.depth,
        max_children: facts.statistics.max_children,
        max_leaf: facts.statistics.max_leaf,
        sah_cost: facts.sah_cost,
        epo: facts.epo,
        leaf_count_variability: tree.leaf_count_variability(),
        occlusion_order: facts.occlusion_order.key(),
        t_r: tree.t_r(),
        t_r_by_kind: tree
            .overlap()
            .tallies
            .by_kind
            .iter()
            .map(|(kind, tally)| (kind_name(*kind), tally.overlap.inner))
            .collect(),
        gamma: tree.gamma(&comparison.settings.costs),
        gamma_ratio: comparison.gamma_r_ratio(recording, number),
        traversals: tree
            .runs
            .iter()
            .zip(&recording.trees[0].runs)
            .map(|(run, first)| (run.traversal.key(), traversal_of(comparison, number, run, first)))
            .collect(),
        baseline_cost: comparison
            .recordings
            .iter()
            .position(|other| std::ptr::eq(other, recording))
            .and_then(|place| comparison.at_baseline(place, Metric::Cost)[number]),
        time: TreeTimeJson::of(comparison, recording, number),
    }
}

fn levels_of(profile: &Profile) -> Levels {
    let level = |&Counts { box_tests, node_visits, primitive_tests, .. }: &Counts| Level {
        box_tests,
        node_visits,
        primitive_tests,
    };
    Levels { cache_lines: profile.cache_lines, by_level: profile.levels.iter().map(level).collect() }
}

fn traversal_of(comparison: &Comparison, tree: usize, run: &Run, first: &Run) -> Traversal {
    let (tallies, first) = (&run.outcome.tallies, &first.outcome.tallies);
    let group = |tally: &Tally, first: Option<&Tally>| group_of(comparison, tree, tally, first);
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
        profile: run.outcome.profile.as_ref().map(levels_of),
        time: None,
        other_times: BTreeMap::new(),
    }
}

fn group_of(comparison: &Comparison, tree: usize, tally: &Tally, first: Option<&Tally>) -> Group {
    let gamma = comparison.settings.costs.gamma(&tally.counts);
    let distribution = |sum: u64, histogram: &Histogram| Distribution {
        mean: mean(sum, tally.queries),
        median: histogram.quantile(0.5),
        p99: histogram.quantile(0.99),
    };
    let counts = &tally.counts;
    Group {
        queries: tally.queries,
        hits: tally.hits,
        cost: comparison.cost(tree, tally),
        cost_ratio: first.and_then(|first| comparison.cost_ratio(tree, tally, first)),
        box_tests: counts.box_tests,
        node_visits: counts.node_visits,
        primitive_tests: counts.primitive_tests,
        leaf_visits: counts.leaf_visits,
        block_tests: counts.block_tests,
        mismatches: tally.mismatches,
        borderline: tally.borderline,
        unchecked: tally.unchecked,
        moving: tally.moving,
        seconds: tally.seconds,
        gamma,
        gamma_ratio: first.and_then(|first| comparison.gamma_ratio(tree, tally, first)),
        per_query: PerQuery {
            box_tests: distribution(counts.box_tests, &tally.box_tests),
            node_visits: distribution(counts.node_visits, &tally.node_visits),
            primitive_tests: distribution(counts.primitive_tests, &tally.primitive_tests),
            gamma: Distribution {
                mean: gamma / tally.queries.max(1) as f64,
                median: gamma_quantile(tally, 0.5),
                p99: gamma_quantile(tally, 0.99),
            },
        },
        packets: (tally.packets.total() > 0).then(|| packets_of(&tally.packets)),
    }
}

fn packets_of(packets: &Decisions) -> Packets {
    let &Decisions { early_hits, early_misses, by_rays, few, octets } = packets;
    Packets { decisions: packets.total(), early_hits, early_misses, by_rays, few, octets }
}
