//! What explains times: counts of groups of queries, those of one cell in a part of the recording, beside the time that they took.
//!
//! They are counted as trees are judged ([`crate::cost::counter`]), once the times are known: for our traversal depth first, and for Embree's kernels over the same tree with
//! children in the order in which these ask them. The groups are the same for every tree.

use super::{Queries, Seconds};
use crate::cost::Counted;
use crate::cost::counter::Counter;
use crate::replay::tally::Cell;
use crate::traverse::{OcclusionOrder, Prepared};
use crate::tree::TreeView;
use std::collections::BTreeMap;

/// Parts of a recording whose queries of one cell are a group: large enough that the clock's noise averages out.
const PARTS: usize = 16;

/// Who followed a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
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
pub(super) struct Followed<'a> {
    pub follower: Follower,
    pub number: usize,
    pub tree: TreeView<'a>,
    pub prepared: &'a Prepared,
    pub order: &'a OcclusionOrder,
    /// Seconds by round, then by run.
    pub rounds: &'a [Vec<f64>],
}

impl Followed<'_> {
    /// Every group, in the order of the recording.
    pub fn observe(&self, queries: &Queries) -> Vec<Observation> {
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
