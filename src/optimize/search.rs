//! Where a subtree would best be put: branch and bound over the places of a tree (Bittner, Hapala and Havran, "Fast Insertion-Based
//! Optimization of Bounding Volume Hierarchies", 2013), walking up from the node's own place as Meister and Bittner
//! ("Parallel Reinsertion for Bounding Volume Hierarchy Optimization", 2018) do, so that near places are tried first and bound the rest.
//!
//! Going down, what a place gains only falls: every box on the way grows, and the new parent is at least as likely to be hit as the node. A subtree
//! whose best case is not better than what was found is left out.
//!
//! The search is guided by the measure itself, or by area alone, which is quick and then only proposes places.

use super::measure::{AreaMeasure, Measure};
use super::working::Working;
use crate::geometry::padded::PaddedAabb;

/// What a search is guided by.
pub trait Guide<M: Measure>: Sync {
    /// What is known of a box.
    type List;

    fn list<'a>(&'a self, working: &'a Working<M>, node: u32) -> &'a Self::List;
    fn value(&self, working: &Working<M>, node: u32) -> f64;
    fn within(&self, working: &Working<M>, outer: &Self::List, bounds: &PaddedAabb) -> Self::List;
    fn values<const N: usize>(
        &self,
        working: &Working<M>,
        outer: &Self::List,
        boxes: &[PaddedAabb; N],
    ) -> [f64; N];
    fn work(&self, list: &Self::List) -> u64;
}

/// Guided by the tree's own measure: what is found is the best place.
pub struct ByMeasure<'m, M>(pub &'m M);

impl<M: Measure> Guide<M> for ByMeasure<'_, M> {
    type List = M::List;

    fn list<'a>(&'a self, working: &'a Working<M>, node: u32) -> &'a M::List {
        working.list(node)
    }

    fn value(&self, working: &Working<M>, node: u32) -> f64 {
        working.value(node)
    }

    fn within(&self, working: &Working<M>, outer: &M::List, bounds: &PaddedAabb) -> M::List {
        working.measure.within(outer, bounds)
    }

    fn values<const N: usize>(
        &self,
        working: &Working<M>,
        outer: &M::List,
        boxes: &[PaddedAabb; N],
    ) -> [f64; N] {
        working.measure.values(outer, boxes)
    }

    fn work(&self, list: &M::List) -> u64 {
        self.0.work(list)
    }
}

/// Guided by area, whatever the tree's measure is.
pub struct ByArea(pub AreaMeasure);

impl<M: Measure> Guide<M> for ByArea {
    type List = ();

    fn list<'a>(&'a self, _working: &'a Working<M>, _node: u32) -> &'a () {
        &()
    }

    fn value(&self, working: &Working<M>, node: u32) -> f64 {
        self.0.of(working.bounds(node))
    }

    fn within(&self, _working: &Working<M>, _outer: &(), _bounds: &PaddedAabb) {}

    fn values<const N: usize>(
        &self,
        _working: &Working<M>,
        _outer: &(),
        boxes: &[PaddedAabb; N],
    ) -> [f64; N] {
        std::array::from_fn(|index| self.0.of(&boxes[index]))
    }

    fn work(&self, _list: &()) -> u64 {
        1
    }
}

/// A place: beside which node, and what the guide expects of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub target: u32,
    pub gain: f64,
}

/// The best places, best first; ties in the order in which they were found.
struct Best {
    places: Vec<Place>,
    most: usize,
    least_gain: f64,
}

impl Best {
    fn bound(&self) -> f64 {
        if self.places.len() < self.most { self.least_gain } else { self.places[self.most - 1].gain }
    }

    fn offer(&mut self, target: u32, gain: f64) {
        if gain <= self.bound() {
            return;
        }
        self.places.truncate(self.most - 1);
        let rank = self.places.partition_point(|place| place.gain >= gain);
        self.places.insert(rank, Place { target, gain });
    }
}

/// How far a search goes.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Only places that gain more, as a share of P of the node's parent.
    pub least_gain: f64,
    /// How many places to return; at least 1.
    pub places: usize,
    /// After so many boxes tested against rays a search returns what it has.
    pub work: u64,
}

/// The places for `node` that lower the cost most, and the work that it took to find them. `node` must be able to move.
pub fn places<M: Measure, G: Guide<M>>(
    working: &Working<M>,
    guide: &G,
    node: u32,
    limits: &Limits,
) -> (Vec<Place>, u64) {
    let moved = *working.bounds(node);
    let parent = working.node(node).parent;
    let sibling = working.sibling(node);
    let least = guide.value(working, node);
    let mut best = Best {
        places: Vec::new(),
        most: limits.places,
        least_gain: limits.least_gain * guide.value(working, parent),
    };
    let mut work = 0;
    // What is gained by taking the node out, as far up as the pivot's children.
    let mut gained = guide.value(working, parent);
    // The pivot's child that held the node, without it.
    let mut remaining = *working.bounds(sibling);
    let (mut pivot, mut other) = (parent, sibling);
    let mut open: Vec<(u32, f64, G::List)> = Vec::new();
    loop {
        // `other` and everything below it. At the parent, beside the sibling is where the node was.
        let outer = guide.list(working, pivot);
        if gained - least > best.bound() {
            let bounds = working.bounds(other).union(&moved);
            work += guide.work(outer);
            let [merged] = guide.values(working, outer, &[bounds]);
            if pivot != parent {
                best.offer(other, gained - merged);
            }
            let below = gained - merged + guide.value(working, other);
            if !working.node(other).is_leaf() && below - least > best.bound() {
                open.push((other, below, guide.within(working, outer, &bounds)));
            }
        }
        while let Some((index, gained, outer)) = open.pop() {
            if gained - least <= best.bound() {
                continue;
            }
            if work > limits.work {
                return (best.places, work);
            }
            let children = working.node(index).children();
            let boxes = children.map(|child| working.bounds(child).union(&moved));
            work += 2 * guide.work(&outer);
            let merged = guide.values(working, &outer, &boxes);
            // The child that grows less is looked at first, so it is pushed last.
            let order = if merged[0] < merged[1] { [1, 0] } else { [0, 1] };
            for side in order.into_iter().rev() {
                best.offer(children[side], gained - merged[side]);
            }
            for side in order {
                let child = children[side];
                let below = gained - merged[side] + guide.value(working, child);
                if !working.node(child).is_leaf() && below - least > best.bound() {
                    open.push((child, below, guide.within(working, &outer, &boxes[side])));
                }
            }
        }
        // One level up: the pivot loses the node too, and the search goes on below its sibling, or stops beside the pivot itself.
        if pivot == 0 {
            return (best.places, work);
        }
        if pivot != parent {
            work += guide.work(outer);
            remaining = remaining.union(working.bounds(other));
            let [shrunk] = guide.values(working, outer, &[remaining]);
            gained += guide.value(working, pivot) - shrunk;
            best.offer(pivot, gained - guide.value(working, pivot));
        }
        other = working.sibling(pivot);
        pivot = working.node(pivot).parent;
    }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{blend, poor_tree, rays, triangles};
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
        let limits = Limits { least_gain: 1e-9, places: 3, work: u64::MAX };
        let mut found = 0;
        for node in (0..working.nodes.len() as u32).filter(|&node| can_move(working, node)) {
            let (places, _) = places(working, &ByMeasure(working.measure), node, &limits);
            let best = exhaustive(working, node);
            let gain = places.first().map_or(0.0, |place| place.gain);
            assert!((gain - best).abs() < 1e-8, "{node}: found {gain}, there is {best}");
            for place in &places {
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
