//! What explains times: counts of groups of queries, those of one cell in a part of the recording, beside the time that they took.
//!
//! They are counted as trees are judged ([`crate::cost::counter`]), once the times are known: for our traversal depth first, and for Embree's kernels over the same tree with
//! children in the order in which these ask them. The groups are the same for every tree.

use super::super::Candidate;
use super::Seconds;
use super::queries::Queries;
use crate::cost::Counted;
use crate::cost::counter::Counter;
use crate::optimize::slots;
use crate::replay::tally::Cell;
use crate::traverse::{OcclusionOrder, Prepared};
use crate::tree::TreeView;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Parts of a recording whose queries of one cell are a group: large enough that the clock's noise averages out.
const PARTS: usize = 16;

/// Who followed a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Follower {
    /// Our traversal, depth first.
    Ours,
    /// Embree's kernels, on the tree planted.
    Embree,
}

impl Follower {
    pub const ALL: [Follower; 2] = [Follower::Ours, Follower::Embree];

    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Follower::Ours => "ours",
            Follower::Embree => "embree",
        }
    }

    /// The name for people.
    pub fn name(self) -> &'static str {
        match self {
            Follower::Ours => "ours",
            Follower::Embree => "Embree",
        }
    }
}

/// Counts and the median time of one group under one tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    pub follower: Follower,
    /// As in the comparison.
    pub tree: usize,
    pub part: usize,
    pub cell: Cell,
    pub counted: Counted,
    pub seconds: f64,
}

/// A tree as it was followed.
struct Followed<'a> {
    follower: Follower,
    number: usize,
    tree: TreeView<'a>,
    prepared: &'a Prepared,
    order: &'a OcclusionOrder,
    /// Seconds by round, then by run.
    rounds: &'a [Vec<f64>],
}

impl Followed<'_> {
    /// Every group, in the order of the recording.
    fn observe(&self, queries: &Queries) -> Vec<Observation> {
        let mut groups: BTreeMap<(usize, Cell), (Counted, Vec<f64>)> = BTreeMap::new();
        let mut counter = Counter::new(self.prepared, self.tree, self.order);
        for (number, (cell, range)) in queries.runs.iter().enumerate() {
            let part = range.start * PARTS / queries.list.len();
            let (counted, seconds) = groups.entry((part, *cell)).or_default();
            for query in queries.run(range) {
                *counted += counter.ask(&query.ray, query.record.is_occlusion(), &query.candidates);
            }
            seconds.resize(self.rounds.len(), 0.0);
            seconds.iter_mut().zip(self.rounds).for_each(|(sum, round)| *sum += round[number]);
        }
        let observation = |((part, cell), (counted, rounds))| Observation {
            follower: self.follower,
            tree: self.number,
            part,
            cell,
            counted,
            seconds: Seconds::of(rounds).median,
        };
        groups.into_iter().map(observation).collect()
    }
}

/// Observations of all trees, on rayon's threads: `ours` and `kernels` have for each the seconds by round and run, none of a tree that was not followed.
pub(super) fn observe_all<'a>(
    trees: &[Candidate],
    prepared: &[(Prepared, OcclusionOrder)],
    queries: &Queries,
    ours: impl Iterator<Item = &'a Vec<Vec<f64>>>,
    kernels: &[Vec<Vec<f64>>],
) -> Vec<Observation> {
    let ours: Vec<&Vec<Vec<f64>>> = ours.take(trees.len()).collect();
    let of_tree = |number: usize| {
        let bvh = trees[number].bvh;
        let (prepared, order) = &prepared[number];
        let mut observations = Vec::new();
        if let Some(rounds) = ours.get(number) {
            let follower = Follower::Ours;
            let followed = Followed { follower, number, tree: bvh.tree, prepared, order, rounds };
            observations = followed.observe(queries);
        }
        if let Some(rounds) = kernels.get(number).filter(|rounds| !rounds.is_empty()) {
            let planted = slots::as_planted(bvh.tree, bvh.order);
            let prepared = &Prepared::new(planted.view(), bvh.triangles, bvh.geometries);
            let (follower, order) = (Follower::Embree, &OcclusionOrder::First);
            let followed = Followed { follower, number, tree: planted.view(), prepared, order, rounds };
            observations.extend(followed.observe(queries));
        }
        observations
    };
    let each: Vec<Vec<Observation>> = (0..trees.len()).into_par_iter().map(of_tree).collect();
    each.concat()
}
