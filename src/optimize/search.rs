//! Where a subtree would best be put: branch and bound over the places of a tree (Bittner, Hapala and Havran, "Fast Insertion-Based
//! Optimization of Bounding Volume Hierarchies", 2013), walking up from the node's own place as Meister and Bittner
//! ("Parallel Reinsertion for Bounding Volume Hierarchy Optimization", 2018) do, so that near places are tried first and bound the rest.
//!
//! Going down, what a place gains only falls: every box on the way grows, and the new parent is at least as likely to be hit as the node. A subtree
//! whose best case is not better than what was found is left out.
//!
//! Counting rays is what takes the time, and nearly all of it is avoided without changing what is found:
//! - a box that holds the moved one already does not grow;
//! - a box that grows is overlapped by its own rays and by those of the moved one, which are few: often that is too many already;
//! - else rays are counted until there are too many for the place to be any better.

use super::measure::Measure;
use super::working::Working;
use crate::geometry::padded::Extent;
use std::borrow::Cow;

/// A place: beside which node, and by how much the cost falls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub target: u32,
    pub gain: f64,
}

/// How far a search goes.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Only places that gain more, as a share of P of the node's parent.
    pub least_gain: f64,
    /// After so many boxes tested against rays a search returns what it has.
    pub work: u64,
}

/// The place for `node` that lowers the cost most, if there is one, and the work that it took to find it. `node` must be able to move.
pub fn place<M: Measure>(working: &Working<M>, node: u32, limits: &Limits) -> (Option<Place>, u64) {
    let parent = working.node(node).parent;
    let sibling = working.sibling(node);
    let bounds = *working.bounds(node);
    let own = working.node(node).is_leaf().then(|| working.measure.within(working.list(parent), &bounds));
    let mut search = Search {
        working,
        moved: bounds,
        rays: own.as_ref().unwrap_or(working.list(node)),
        least: working.value(node),
        best: None,
        bound: limits.least_gain * working.value(parent),
        open: Vec::new(),
        work: 0,
    };
    // What is gained by taking the node out, as far up as the pivot's children.
    let mut gained = working.value(parent);
    // The pivot's child that held the node, without it.
    let mut remaining = *working.bounds(sibling);
    let (mut pivot, mut other) = (parent, sibling);
    loop {
        // `other` and everything below it. At the parent, beside the sibling is where the node was.
        if gained - search.least > search.bound {
            search.consider(other, gained, Cow::Borrowed(working.list(pivot)), pivot != parent);
        }
        while let Some(Open { index, gained, list }) = search.open.pop() {
            if gained - search.least <= search.bound {
                continue;
            }
            if search.work > limits.work {
                return (search.best, search.work);
            }
            for child in search.nearer_first(index) {
                search.consider(child, gained, Cow::Borrowed(&list), true);
            }
        }
        // One level up: the pivot loses the node too, and the search goes on below its sibling, or stops beside the pivot itself.
        if pivot == 0 {
            return (search.best, search.work);
        }
        if pivot != parent {
            remaining = remaining.union(working.bounds(other));
            if remaining != *working.bounds(pivot) {
                search.work += working.measure.work(working.list(pivot));
                let [shrunk] = working.measure.values(working.list(pivot), &[remaining]);
                gained += working.value(pivot) - shrunk;
            }
            search.offer(pivot, gained - working.value(pivot));
        }
        other = working.sibling(pivot);
        pivot = working.node(pivot).parent;
    }
}

/// A node whose children are to be looked at.
struct Open<'a, L: Clone> {
    index: u32,
    /// What taking the node out gains, less what the boxes on the way here grow.
    gained: f64,
    /// Rays that overlap the grown box.
    list: Cow<'a, L>,
}

struct Search<'a, 'm, M: Measure> {
    working: &'a Working<'m, M>,
    moved: M::Bounds,
    /// List of the moved box.
    rays: &'a M::List,
    /// P of the moved box: what a new parent costs at least.
    least: f64,
    best: Option<Place>,
    /// Only what gains more is of interest.
    bound: f64,
    open: Vec<Open<'a, M::List>>,
    work: u64,
}

impl<'a, M: Measure> Search<'a, '_, M> {
    fn offer(&mut self, target: u32, gain: f64) {
        if gain > self.bound {
            self.bound = gain;
            self.best = Some(Place { target, gain });
        }
    }

    /// The place beside `index` when `beside`, and, later, those below it. `outer` is the list of a box around what would be the new parent.
    fn consider(&mut self, index: u32, gained: f64, outer: Cow<'_, M::List>, beside: bool) {
        let working = self.working;
        let bounds = working.bounds(index);
        let value = working.value(index);
        let is_leaf = working.node(index).is_leaf();
        let union = bounds.union(&self.moved);
        if union == *bounds {
            if beside {
                self.offer(index, gained - value);
            }
            if !is_leaf && gained - self.least > self.bound {
                self.open.push(Open { index, gained, list: Cow::Borrowed(working.list(index)) });
            }
            return;
        }
        // Above it, neither beside nor below can anything be better.
        let mut limit = if beside { gained - self.bound } else { 0.0 };
        if !is_leaf {
            limit = limit.max(gained - self.bound - self.least + value);
        }
        if limit <= value.max(self.least) {
            return;
        }
        let measure = working.measure;
        if !is_leaf
            && !measure.can_be_below((bounds, working.list(index)), self.rays, &union, limit, &mut self.work)
        {
            return;
        }
        let Some(merged) = measure.value_below(&outer, &union, limit, &mut self.work) else { return };
        if beside {
            self.offer(index, gained - merged);
        }
        let below = gained - merged + value;
        if !is_leaf && below - self.least > self.bound {
            self.work += measure.work(&outer);
            self.open.push(Open { index, gained: below, list: Cow::Owned(measure.within(&outer, &union)) });
        }
    }

    /// The children, the one first that lies nearer to the moved box, so that it bounds the other.
    fn nearer_first(&self, index: u32) -> [u32; 2] {
        let [left, right] = self.working.node(index).children();
        let distance = |child: u32| self.working.bounds(child).apart(&self.moved);
        if distance(right) < distance(left) { [right, left] } else { [left, right] }
    }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{blend, poor_tree, rays, triangles};
    use super::super::measure::AreaMeasure;
    use super::super::moves::{can_move, plan};
    use super::*;
    use crate::geometry::Ray;

    /// The best gain of all places, each worked out in full.
    fn exhaustive<M: Measure>(working: &Working<M>, node: u32) -> f64 {
        let gains = (0..working.nodes.len() as u32)
            .filter_map(|target| plan(working, node, target))
            .map(|plan| plan.gain);
        gains.fold(0.0, f64::max)
    }

    fn check<M: Measure>(working: &Working<M>) {
        let limits = Limits { least_gain: 1e-9, work: u64::MAX };
        let mut found = 0;
        for node in (0..working.nodes.len() as u32).filter(|&node| can_move(working, node)) {
            let (place, _) = place(working, node, &limits);
            let best = exhaustive(working, node);
            let gain = place.map_or(0.0, |place| place.gain);
            assert!((gain - best).abs() < 1e-8, "{node}: found {gain}, there is {best}");
            if let Some(place) = place {
                let expected = plan(working, node, place.target).map(|plan| plan.gain);
                assert!(
                    (place.gain - expected.unwrap_or(f64::NAN)).abs() < 1e-9,
                    "{node}: {place:?} {expected:?}"
                );
                found += 1;
            }
        }
        assert!(found > 0, "no move of a poor tree helps");
    }

    #[test]
    fn the_best_place_of_all_is_found_and_its_gain_is_right() {
        for seed in 0..5 {
            let triangles = triangles(40, seed);
            let tree = poor_tree(&triangles);
            check(&Working::new(&tree, &blend(&tree, &rays(200, seed))));
            check(&Working::new(&tree, &AreaMeasure::new(&tree.nodes[0].bounds().into())));
            let none: [Ray; 0] = [];
            check(&Working::new(&tree, &blend(&tree, &none)));
        }
    }
}
