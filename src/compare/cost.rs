//! What trees cost, absolutely and relative to the first one: the number that is reported first, and Γ where it can be compared.

use super::{Comparison, RecordingResult, TreeFacts, relative};
use crate::cost::{ByKind, Counted, width_class};
use crate::replay::tally::Tally;
use crate::traverse::Counts;

impl TreeFacts {
    /// The width whose constants its visits have: 2, 4 or 8.
    pub fn width_class(&self) -> usize {
        width_class(self.statistics.max_children)
    }
}

impl Comparison {
    /// Nanoseconds that a query of `tally`, asked of a tree, is expected to take. `None` of packets, whose rays share visits, and of no query.
    pub fn cost(&self, tree: usize, tally: &Tally) -> Option<f64> {
        let alone = self.settings.packet.is_none();
        let width = self.trees[tree].statistics.max_children;
        alone.then(|| self.settings.machine.per_query(width, &tally.by_kind).all).flatten()
    }

    /// The same in two parts: visits of inner nodes, and all that leaves take.
    pub fn cost_parts(&self, tree: usize, tally: &Tally) -> Option<[f64; 2]> {
        let visits = |counted: &Counted| {
            let counts = Counts { leaf_visits: 0, block_tests: 0, ..counted.counts };
            Counted { counts, ..*counted }
        };
        let ByKind { closest_hit, occlusion } = &tally.by_kind;
        let inner = ByKind { closest_hit: visits(closest_hit), occlusion: visits(occlusion) };
        let whole = self.cost(tree, tally)?;
        let width = self.trees[tree].statistics.max_children;
        let inner = self.settings.machine.per_query(width, &inner).all?;
        Some([inner, whole - inner])
    }

    /// The cost of a tally relative to that of the same queries in the first tree.
    pub fn cost_ratio(&self, tree: usize, tally: &Tally, first: &Tally) -> Option<f64> {
        Some(relative(self.cost(tree, tally)?, self.cost(0, first)?))
    }

    /// Γ of a tally relative to that of the same queries in the first tree, 1 when that costs nothing either. `None` between trees of different
    /// widths: a machine tests the boxes of a node together, so their number says nothing.
    pub fn gamma_ratio(&self, tree: usize, tally: &Tally, first: &Tally) -> Option<f64> {
        let costs = &self.settings.costs;
        self.is_like_first(tree).then(|| relative(costs.gamma(&tally.counts), costs.gamma(&first.counts)))
    }

    /// Γ_R of a tree relative to the first one's; `None` as of [`Self::gamma_ratio`].
    pub fn gamma_r_ratio(&self, recording: &RecordingResult, tree: usize) -> Option<f64> {
        let gamma = |tree: usize| recording.trees[tree].gamma(&self.settings.costs);
        self.is_like_first(tree).then(|| relative(gamma(tree), gamma(0)))
    }

    fn is_like_first(&self, tree: usize) -> bool {
        self.trees[tree].width_class() == self.trees[0].width_class()
    }

    /// Whether some tree's Γ cannot be compared with the first one's.
    pub fn mixes_widths(&self) -> bool {
        (0..self.trees.len()).any(|tree| !self.is_like_first(tree))
    }
}
