//! Which of the trees that were tried would be chosen now: it is known after every trial, so that
//! time may end any of them.

use crate::cost::Cost;
use crate::tree::Tree;
use std::sync::Arc;

/// A tree that may be chosen.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// Of its trial.
    pub number: usize,
    pub tree: Arc<Tree>,
    /// Nanoseconds of a query that chooses; without any, of a random ray by area.
    pub cost: f64,
    /// What it costs the queries that confirm.
    pub confirmed: Cost,
    /// Nanoseconds of a query of all that judge; without any, `cost`.
    pub total: f64,
}

/// The best so far.
#[derive(Debug, Default)]
pub(super) struct Standing {
    /// The cheapest tree for the queries that choose, and the cheapest from area alone.
    best: Option<Candidate>,
    area: Option<Candidate>,
    kept: Option<Candidate>,
}

impl Standing {
    /// Whether a tree that costs the choosing queries so much, from area alone or not, is one that
    /// [`Self::take`] has use for.
    pub fn wants(&self, cost: f64, is_area: bool) -> bool {
        let is_cheaper =
            |than: &Option<Candidate>| than.as_ref().is_none_or(|candidate| cost < candidate.cost);
        is_cheaper(&self.best) || (is_area && is_cheaper(&self.area))
    }

    /// Takes a tree, and decides anew.
    ///
    /// Of the cheapest tree and the cheapest from area alone, the one is chosen that the confirming
    /// queries like better; but what was chosen earlier is kept when it costs all judges less. So
    /// one tree more never makes the choice worse for the judges, nor is it ever worse for them
    /// than the best from area.
    pub fn take(&mut self, candidate: Candidate, is_area: bool) {
        let is_cheaper =
            |than: &Option<Candidate>| than.as_ref().is_none_or(|other| candidate.cost < other.cost);
        if is_area && is_cheaper(&self.area) {
            self.area = Some(candidate.clone());
        }
        if is_cheaper(&self.best) {
            self.best = Some(candidate);
        }
        let Some(best) = &self.best else { return };
        let is_preferred = |area: &&Candidate| area.confirmed.all < best.confirmed.all;
        let now = self.area.as_ref().filter(is_preferred).unwrap_or(best);
        if self.kept.as_ref().is_none_or(|kept| now.total < kept.total) {
            self.kept = Some(now.clone());
        }
    }

    /// Number of the trial of the cheapest tree.
    pub fn best(&self) -> Option<usize> {
        self.best.as_ref().map(|best| best.number)
    }

    /// The tree that is chosen, and what the confirming queries say of the best from area alone.
    pub fn end(self) -> Option<(Candidate, Cost)> {
        let kept = self.kept?;
        let area = self.area.map_or(kept.confirmed, |area| area.confirmed);
        Some((kept, area))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As many queries choose as confirm.
    fn candidate(number: usize, cost: f64, confirmed: f64) -> Candidate {
        let tree = Arc::new(Tree { nodes: Vec::new(), primitives: Vec::new() });
        let confirmed_cost = Cost { all: Some(confirmed), ..Cost::default() };
        Candidate { number, tree, cost, confirmed: confirmed_cost, total: 0.5 * (cost + confirmed) }
    }

    #[test]
    fn a_choice_is_confirmed_and_never_becomes_worse() {
        let mut standing = Standing::default();
        // Number, cost for those that choose and for those that confirm, whether from area; then
        // which is chosen.
        for (number, cost, confirmed, is_area, expected) in [
            (0, 10.0, 10.0, true, 0),
            (1, 9.0, 11.0, false, 0),
            (2, 8.0, 9.5, false, 2),
            // Cheaper for those that choose, but dearer for all judges.
            (3, 7.9, 9.9, false, 2),
            // From area, and liked better by those that confirm, but not by all.
            (4, 9.5, 9.0, true, 2),
            (5, 8.1, 8.8, true, 5),
        ] {
            assert!(standing.wants(cost, is_area));
            standing.take(candidate(number, cost, confirmed), is_area);
            assert_eq!(standing.kept.as_ref().map(|kept| kept.number), Some(expected), "{number}");
        }
        assert!(!standing.wants(8.05, false) && standing.wants(8.05, true) && standing.wants(7.8, false));
        assert_eq!(standing.best(), Some(3));
        let (kept, area) = standing.end().expect("chosen");
        assert_eq!((kept.number, area.all), (5, Some(8.8)));
    }
}
