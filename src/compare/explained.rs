//! How far counts explain measured times, and how well measures of a tree rank the trees: of our traversal and of Embree's kernels.
//!
//! [`Measured`] has the samples of one comparison, of several, or of earlier reports; [`fitted`] fits each follower, width and kind apart.

use super::fit::{Fit, Sample, kendall};
use super::timing::{Follower, Timing};
use super::{Comparison, RecordingResult, TreeFacts, TreeResult};
use crate::cost::{Costs, Counted, WIDTHS};
use crate::format::rays::kind;
use crate::traverse::Traversal;
use std::collections::{BTreeMap, BTreeSet};

/// Trees from which on something is said of how measures rank them.
pub const LEAST_TREES: usize = 5;

/// What there is to say of ranks where trees are fewer.
pub const TOO_FEW: &str = "ranks need five trees or more";

/// A group of queries under a tree of one width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    pub follower: Follower,
    /// Of [`WIDTHS`].
    pub width: usize,
    pub is_occlusion: bool,
    /// The same number for the same tree.
    pub tree: usize,
    pub sample: Sample,
}

/// Costs fitted to one follower's times over trees of one width, or of all, for one kind of query.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub follower: Follower,
    /// `None` is of all widths together.
    pub width: Option<usize>,
    pub is_occlusion: bool,
    pub trees: usize,
    /// `None` when the groups of queries are too few or too much alike.
    pub fit: Option<Fit>,
}

/// How measures rank the trees by the time of one follower.
#[derive(Clone, Debug)]
pub struct Ranking {
    pub follower: Follower,
    pub trees: usize,
    /// `None` of fewer than [`LEAST_TREES`] trees.
    pub ranks: Option<Ranks>,
}

#[derive(Clone, Debug)]
pub struct Ranks {
    /// Pairs of trees whose times are far enough apart.
    pub pairs: usize,
    /// Name of a measure and Kendall's τ_b between it and the median times; `None` when it, or the time, ranks nothing.
    pub measures: Vec<(&'static str, Option<f64>)>,
}

/// The samples of one recording.
pub fn measured(comparison: &Comparison, recording: &RecordingResult) -> Vec<Measured> {
    let observations = recording.timing.iter().flat_map(|timing| &timing.observations);
    let mut groups = BTreeMap::new();
    let measured = |observation: &super::timing::Observation| {
        let next = groups.len();
        let group = *groups.entry((observation.part, observation.cell)).or_insert(next);
        Measured {
            follower: observation.follower,
            width: comparison.trees[observation.tree].width_class(),
            is_occlusion: observation.cell.0 == kind::OCCLUSION,
            tree: observation.tree,
            sample: Sample { group, counted: observation.counted, seconds: observation.seconds },
        }
    };
    observations.map(measured).collect()
}

/// The samples of several recordings or reports together: neither groups nor trees of two of them are the same.
pub fn together(parts: impl IntoIterator<Item = Vec<Measured>>) -> Vec<Measured> {
    let mut all: Vec<Measured> = Vec::new();
    for part in parts {
        let after = |number: fn(&Measured) -> usize| all.iter().map(number).max().map_or(0, |last| last + 1);
        let (groups, trees) = (after(|measured| measured.sample.group), after(|measured| measured.tree));
        all.extend(part.into_iter().map(|measured| {
            let sample = Sample { group: measured.sample.group + groups, ..measured.sample };
            Measured { tree: measured.tree + trees, sample, ..measured }
        }));
    }
    all
}

/// Fits for each follower, width and kind that was measured, and of all widths together where there are several: those queries are the same, too.
pub fn fitted(measured: &[Measured]) -> Vec<Fitted> {
    let known = Costs::default();
    let mut found = Vec::new();
    for follower in Follower::ALL {
        let widths: BTreeSet<usize> =
            measured.iter().filter(|it| it.follower == follower).map(|it| it.width).collect();
        let all = (widths.len() > 1).then_some(None);
        for width in widths.into_iter().map(Some).chain(all) {
            for is_occlusion in [false, true] {
                let of = |it: &&Measured| {
                    (it.follower, it.is_occlusion) == (follower, is_occlusion)
                        && width.is_none_or(|width| width == it.width)
                };
                let these: Vec<&Measured> = measured.iter().filter(of).collect();
                if these.is_empty() {
                    continue;
                }
                let trees = these.iter().map(|measured| measured.tree).collect::<BTreeSet<_>>().len();
                let samples: Vec<Sample> = these.iter().map(|measured| measured.sample).collect();
                let known = known.of(width.unwrap_or(WIDTHS[WIDTHS.len() - 1]), is_occlusion);
                found.push(Fitted { follower, width, is_occlusion, trees, fit: Fit::of(&samples, known) });
            }
        }
    }
    found
}

/// Rankings for each follower; none when they were not asked for.
pub fn rankings(comparison: &Comparison, recording: &RecordingResult) -> Vec<Ranking> {
    let Some(timing) = recording.timing.as_ref().filter(|_| comparison.settings.fit) else {
        return Vec::new();
    };
    let ranking = |follower: Follower| {
        let times = times(comparison, timing, follower)?;
        let ranks = (times.len() >= LEAST_TREES).then(|| ranks(comparison, recording, follower, &times));
        (!times.is_empty()).then_some(Ranking { follower, trees: times.len(), ranks })
    };
    Follower::ALL.into_iter().filter_map(ranking).collect()
}

/// Trees and their median times.
fn times(comparison: &Comparison, timing: &Timing, follower: Follower) -> Option<Vec<(usize, f64)>> {
    Some(match follower {
        Follower::Ours => {
            let odf = comparison.settings.traversals.iter().position(|&it| it == Traversal::Odf)?;
            timing.trees.iter().map(|tree| tree[odf].total.median).enumerate().collect()
        }
        Follower::Embree => {
            let trees = timing.kernels.as_ref()?.trees.iter().enumerate();
            trees.filter_map(|(tree, time)| Some((tree, time.as_ref()?.total.median))).collect()
        }
    })
}

fn ranks(
    comparison: &Comparison,
    recording: &RecordingResult,
    follower: Follower,
    times: &[(usize, f64)],
) -> Ranks {
    let measured = measured(comparison, recording);
    let (machine, costs) = (&comparison.settings.machine, &comparison.settings.costs);
    let price = |tree: usize, with_misses: bool| price(&measured, machine, (follower, tree), with_misses);
    let facts = |tree: usize| -> &TreeFacts { &comparison.trees[tree] };
    let result = |tree: usize| -> &TreeResult { &recording.trees[tree] };
    let odf = |tree: usize| result(tree).runs.iter().find(|run| run.traversal == Traversal::Odf);
    let gamma =
        |tree: usize| odf(tree).map_or(f64::NAN, |run| costs.gamma(&run.outcome.tallies.total.counts));
    let measures: [(&'static str, &dyn Fn(usize) -> f64); 8] = [
        ("cost", &|tree| price(tree, false)),
        ("cost_with_misses", &|tree| price(tree, true)),
        ("sah_cost", &|tree| facts(tree).sah_cost),
        ("epo", &|tree| facts(tree).epo),
        ("leaf_count_variability", &|tree| result(tree).leaf_count_variability()),
        ("t_r", &|tree| result(tree).t_r() as f64),
        ("gamma_r", &|tree| result(tree).gamma(costs)),
        ("gamma", &gamma),
    ];
    let (trees, seconds): (Vec<usize>, Vec<f64>) = times.iter().copied().unzip();
    let mut pairs = 0;
    let measures = measures.map(|(name, measure)| {
        let values: Vec<f64> = trees.iter().map(|&tree| measure(tree)).collect();
        let (tau, apart) = kendall(&values, &seconds);
        pairs = apart;
        (name, tau)
    });
    Ranks { pairs, measures: measures.to_vec() }
}

/// Nanoseconds that the timed queries are expected to take of a follower in a tree.
fn price(measured: &[Measured], costs: &Costs, of: (Follower, usize), with_misses: bool) -> f64 {
    let these = measured.iter().filter(|measured| (measured.follower, measured.tree) == of);
    let nanoseconds = |measured: &Measured| {
        let counted = measured.sample.counted;
        let misses = if with_misses { counted.misses } else { 0 };
        costs.of(measured.width, measured.is_occlusion).of(&Counted { misses, ..counted })
    };
    these.map(nanoseconds).sum()
}
