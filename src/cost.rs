//! What a query is expected to take on a machine that tests the children of a node together and triangles in blocks of four: the number by
//! which trees are chosen, and which is reported first.
//!
//! Data flows so: a traversal counts ([`Counts`]), [`Costs`] has the constants of a width and of a kind of query, [`Constants::of`] makes
//! nanoseconds of both. [`counter`] counts with the misses of a simulated [`cache`] beside, where somebody asks for them.
//!
//! The default constants are the same on every machine, so that the same input gives the same tree. Those of eight children a node are of a study
//! of Embree's kernels on some 35 planted trees for each of six scenes (one Zen 5 core, recordings that no tree was made from):
//! time = query + 6.1 ns · visits + 7.7 · leaf visits + 2.0 · blocks for closest hits (R² .84 within a scene), 6.1, 6.2 and 2.9 for occlusion
//! (.92). Embree's kernels follow narrower trees in the same nodes, so that a visit costs the same there. A miss of the second level, 1 MB, costs
//! as much as a visit. On another machine (Zen 4) these rank 28 trees of each of four scenes with a Kendall's τ of .96 to .98, as well as what is fitted
//! there, and SAH with -.24 to .17 (`docs/comparing.md`; `tools/fit-costs` repeats it). What was measured elsewhere is read from a file ([`Costs::parse`]).

pub mod cache;
pub mod counter;
mod file;

pub use file::CostsError;

use crate::traverse::Counts;
use serde::{Deserialize, Serialize};

/// What things cost, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants {
    /// A query, whatever the tree.
    pub query: f64,
    /// A visit of an inner node, whose children are tested together.
    pub visit: f64,
    /// A leaf, whatever is in it.
    pub leaf: f64,
    /// A block of up to four triangles.
    pub block: f64,
    /// A cache line that the simulated cache does not hold.
    pub miss: f64,
}

/// Closest hits in Embree's kernels, see above.
const CLOSEST_HIT: Constants = Constants { query: 0.0, visit: 6.1, leaf: 7.7, block: 2.0, miss: 6.0 };

/// Occlusion in Embree's kernels.
const OCCLUSION: Constants = Constants { query: 0.0, visit: 6.1, leaf: 6.2, block: 2.9, miss: 6.0 };

/// Widths that have constants of their own. A tree is of the least that holds its widest node; a wider one is of the last.
pub const WIDTHS: [usize; 3] = [2, 4, 8];

/// The width whose constants a tree of up to `width` children a node has.
pub fn width_class(width: usize) -> usize {
    WIDTHS.into_iter().find(|&least| width <= least).unwrap_or(WIDTHS[WIDTHS.len() - 1])
}

/// Counts of some queries of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counted {
    pub queries: u64,
    pub counts: Counts,
    /// Of the simulated cache; 0 without one.
    pub misses: u64,
}

impl std::ops::AddAssign for Counted {
    fn add_assign(&mut self, other: Counted) {
        self.queries += other.queries;
        self.counts += other.counts;
        self.misses += other.misses;
    }
}

/// Counts of some queries over one tree, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ByKind {
    pub closest_hit: Counted,
    pub occlusion: Counted,
}

impl ByKind {
    pub fn of(&mut self, occlusion: bool) -> &mut Counted {
        if occlusion { &mut self.occlusion } else { &mut self.closest_hit }
    }
}

impl std::ops::AddAssign for ByKind {
    fn add_assign(&mut self, other: ByKind) {
        self.closest_hit += other.closest_hit;
        self.occlusion += other.occlusion;
    }
}

/// Nanoseconds of a query; `None` of a kind that was not asked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    pub all: Option<f64>,
    pub closest_hit: Option<f64>,
    pub occlusion: Option<f64>,
}

impl Constants {
    /// What they cost together, in nanoseconds.
    pub fn of(&self, counted: &Counted) -> f64 {
        let Counted { queries, counts, misses } = counted;
        self.query * *queries as f64
            + self.visit * counts.node_visits as f64
            + self.leaf * counts.leaf_visits as f64
            + self.block * counts.block_tests as f64
            + self.miss * *misses as f64
    }

    fn blended(&self, other: &Constants, share: f64) -> Constants {
        let between = |a: f64, b: f64| (1.0 - share) * a + share * b;
        Constants {
            query: between(self.query, other.query),
            visit: between(self.visit, other.visit),
            leaf: between(self.leaf, other.leaf),
            block: between(self.block, other.block),
            miss: between(self.miss, other.miss),
        }
    }
}

/// The constants of every width and kind of query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// By [`WIDTHS`].
    closest_hit: [Constants; WIDTHS.len()],
    occlusion: [Constants; WIDTHS.len()],
}

impl Default for Costs {
    fn default() -> Costs {
        Costs { closest_hit: [CLOSEST_HIT; WIDTHS.len()], occlusion: [OCCLUSION; WIDTHS.len()] }
    }
}

impl Costs {
    /// Of trees of up to `width` children a node.
    pub fn of(&self, width: usize, occlusion: bool) -> &Constants {
        let class = width_class(width);
        let place = WIDTHS.iter().position(|&known| known == class).unwrap_or(WIDTHS.len() - 1);
        let of_kind = if occlusion { &self.occlusion } else { &self.closest_hit };
        &of_kind[place]
    }

    /// What a query costs over a tree of up to `width` children a node.
    pub fn per_query(&self, width: usize, counted: &ByKind) -> Cost {
        let ByKind { closest_hit, occlusion } = counted;
        let sums = [self.of(width, false).of(closest_hit), self.of(width, true).of(occlusion)];
        let each = |sum: f64, queries: u64| (queries > 0).then(|| sum / queries as f64);
        Cost {
            all: each(sums[0] + sums[1], closest_hit.queries + occlusion.queries),
            closest_hit: each(sums[0], closest_hit.queries),
            occlusion: each(sums[1], occlusion.queries),
        }
    }

    /// Where `share` of the queries, 0 to 1, ask for occlusion.
    pub fn mixed(&self, width: usize, share: f64) -> Constants {
        self.of(width, false).blended(self.of(width, true), share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cost_is_the_sum_of_its_terms() {
        let counts =
            Counts { node_visits: 10, leaf_visits: 3, block_tests: 4, box_tests: 999, primitive_tests: 999 };
        let counted = Counted { queries: 2, counts, misses: 5 };
        let constants = Constants { query: 100.0, visit: 6.0, leaf: 8.0, block: 2.0, miss: 30.0 };
        assert_eq!(constants.of(&counted), 200.0 + 60.0 + 24.0 + 8.0 + 150.0);
        let mut twice = counted;
        twice += counted;
        assert_eq!(constants.of(&twice), 2.0 * constants.of(&counted));
    }

    #[test]
    fn a_query_costs_what_those_of_its_kind_do_on_average() {
        let counts = |node_visits| Counts { node_visits, ..Counts::default() };
        let counted = |queries, visits| Counted { queries, counts: counts(visits), misses: 0 };
        let by_kind = ByKind { closest_hit: counted(3, 30), occlusion: counted(1, 2) };
        let cost = Costs::default().per_query(8, &by_kind);
        let close = |found: Option<f64>, expected: f64| found.is_some_and(|it| (it - expected).abs() < 1e-9);
        assert!(close(cost.closest_hit, 61.0) && close(cost.occlusion, 12.2) && close(cost.all, 48.8));
        let none = Costs::default().per_query(8, &ByKind { occlusion: Counted::default(), ..by_kind });
        assert_eq!((none.occlusion, none.all), (None, none.closest_hit));
    }

    #[test]
    fn every_width_has_constants_and_mixtures_lie_between() {
        let costs = Costs::default();
        for (width, like) in [(0, 2), (1, 2), (3, 4), (5, 8), (8, 8), (100, 8)] {
            assert_eq!(costs.of(width, true), costs.of(like, true));
        }
        assert_eq!(costs.mixed(8, 0.0), CLOSEST_HIT);
        assert_eq!(costs.mixed(8, 1.0), OCCLUSION);
        assert!((costs.mixed(8, 0.5).block - 2.45).abs() < 1e-12);
    }
}
