//! Treelets made optimal: Karras and Aila, "Fast Parallel Construction of High-Quality Bounding Volume Hierarchies", HPG 2013.
//!
//! A treelet is the top of a subtree: its root, and the nodes that come out when again and again the likeliest node below it is replaced
//! by its children, until there are `leaves` of them. Those are put together anew in the best of all ways, which dynamic programming
//! finds ([`Divisions`]). A round does so at every inner node, children before parents. Rotations are what treelets of four leaves can do.
//!
//! A tree of no more than `leaves` leaves is one treelet: it becomes the best tree there is.

use super::Step;
use super::measure::Measure;
use super::working::Working;
use crate::builder::exhaustive::{Divisions, MAX_PRIMITIVES, unions};
use crate::geometry::padded::Extent;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Leaves of a treelet, 3 to [`MAX_LEAVES`]. Its boxes grow with 2ⁿ, the ways to put it together with 3ⁿ.
    pub leaves: usize,
    /// Most rounds over the tree.
    pub rounds: usize,
    /// A round that lowers the cost by a smaller share than this is the last.
    pub least_gain: f64,
}

/// Most leaves of a treelet.
pub const MAX_LEAVES: usize = MAX_PRIMITIVES;

impl Default for Config {
    /// Seven leaves and three rounds, as in the paper.
    fn default() -> Config {
        Config { leaves: 7, rounds: 3, least_gain: 1e-3 }
    }
}

/// Gains below this share of the root's P are rounding.
const WORTHWHILE: f64 = 1e-6;

/// Boxes whose P is asked for in one call.
const LANES: usize = 8;

/// Makes the treelet of every inner node optimal, on the threads of the current rayon pool. One step a round.
pub fn restructure<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let mut steps = Vec::new();
    let (mut cost, mut count) = (working.cost(), Count::default());
    for _ in 0..config.rounds {
        let (roots, top) = working.cut();
        let counts = working.apart(&roots, |_, subtree| {
            let order = subtree.order();
            round(subtree, &order, config.leaves)
        });
        counts.iter().for_each(|done| count.add(done));
        count.add(&round(working, &top, config.leaves));
        let new = working.cost();
        steps.push(Step { cost: new, moves: count.moves, work: count.work });
        if new > cost * (1.0 - config.least_gain) || working.out_of_time() {
            break;
        }
        cost = new;
    }
    steps
}

/// What has been done.
#[derive(Clone, Copy, Default)]
struct Count {
    work: u64,
    moves: u64,
}

impl Count {
    fn add(&mut self, other: &Count) {
        self.work += other.work;
        self.moves += other.moves;
    }
}

/// The treelets of `nodes`, which lists parents before children, from the last to the first.
fn round<M: Measure>(working: &mut Working<M>, nodes: &[u32], leaves: usize) -> Count {
    let mut treelet = Treelet::new();
    let mut count = Count::default();
    for (number, &root) in nodes.iter().rev().enumerate() {
        if number % 256 == 255 && working.out_of_time() {
            break;
        }
        if !working.node(root).is_leaf() {
            treelet.form(working, root, leaves);
            count.moves += treelet.improve(working, &mut count.work) as u64;
        }
    }
    count
}

/// The top of a subtree, and what is worked out for it; made once and used for many.
struct Treelet<B> {
    /// Its inner nodes, the root first.
    inner: Vec<u32>,
    leaves: Vec<u32>,
    /// The box around every set of leaves, and P of it.
    bounds: Vec<B>,
    values: Vec<f64>,
    divisions: Divisions,
}

impl<B: Extent> Treelet<B> {
    fn new() -> Treelet<B> {
        let (inner, leaves, divisions) = Default::default();
        Treelet { inner, leaves, bounds: Vec::new(), values: Vec::new(), divisions }
    }

    fn form<M: Measure<Bounds = B>>(&mut self, working: &Working<M>, root: u32, most: usize) {
        self.inner.clear();
        self.leaves.clear();
        self.inner.push(root);
        self.leaves.extend(working.node(root).children());
        while self.leaves.len() < most {
            let inner = (0..self.leaves.len()).filter(|&place| !working.node(self.leaves[place]).is_leaf());
            let value = |place: usize| working.value(self.leaves[place]);
            let Some(place) = inner.max_by(|&a, &b| value(a).total_cmp(&value(b))) else { break };
            let opened = self.leaves.swap_remove(place);
            self.inner.push(opened);
            self.leaves.extend(working.node(opened).children());
        }
    }

    /// Puts the leaves together in the best way, when that is better than how they are. Adds to `work`.
    fn improve<M: Measure<Bounds = B>>(&mut self, working: &mut Working<M>, work: &mut u64) -> bool {
        // Two leaves can be put together in one way only.
        if self.leaves.len() < 3 {
            return false;
        }
        let root = self.inner[0];
        unions(self.leaves.iter().map(|&leaf| *working.bounds(leaf)), &mut self.bounds);
        let sets = self.bounds.len();
        self.values.clear();
        self.values.resize(sets, 0.0);
        let list = working.list(root);
        let (mut asked, mut places) = ([B::EMPTY; LANES], [0; LANES]);
        let mut full = 0;
        for set in (1..sets - 1).filter(|set| !set.is_power_of_two()) {
            (asked[full], places[full]) = (self.bounds[set], set);
            full += 1;
            if full == LANES {
                self.ask(working, list, &asked, &places);
                full = 0;
            }
        }
        if full > 0 {
            self.ask(working, list, &asked, &places[..full]);
        }
        self.values[sets - 1] = working.value(root);
        *work += sets as u64 * working.measure.work(list);
        self.divisions.find(&self.values);
        let before: f64 = self.inner.iter().map(|&node| working.value(node)).sum();
        if before - self.divisions.least() <= WORTHWHILE * working.value(root) {
            return false;
        }
        let mut spare = self.inner[1..].iter().copied();
        let mut open = vec![(root, sets - 1)];
        while let Some((node, set)) = open.pop() {
            let children = self.divisions.sides(set).map(|side| {
                if side.is_power_of_two() {
                    self.leaves[side.trailing_zeros() as usize]
                } else {
                    // A binary tree over n leaves has n - 1 inner nodes, however it is put together.
                    let child = spare.next().unwrap_or(root);
                    let list = working.measure.within(working.list(node), &self.bounds[side]);
                    working.set(child, self.bounds[side], list);
                    open.push((child, side));
                    child
                }
            });
            working.adopt(node, children);
        }
        true
    }

    /// P of some sets' boxes.
    fn ask<M: Measure<Bounds = B>>(
        &mut self,
        working: &Working<M>,
        list: &M::List,
        boxes: &[B; LANES],
        sets: &[usize],
    ) {
        for (&set, value) in sets.iter().zip(working.measure.values(list, boxes)) {
            self.values[set] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_consistent, blend, poor_tree, rays, triangles};
    use super::super::measure::AreaMeasure;
    use super::*;
    use crate::builder::exhaustive::optimum;
    use crate::geometry::padded::PaddedAabb;

    fn check<M: Measure<Bounds = PaddedAabb>>(
        count: usize,
        leaves: usize,
        make: impl Fn(&crate::tree::Tree) -> M,
    ) where
        M::List: PartialEq + std::fmt::Debug,
    {
        let triangles = triangles(count, 6);
        let tree = poor_tree(&triangles);
        let measure = make(&tree);
        let mut working = Working::new(&tree, &measure);
        let before = working.cost();
        let steps = restructure(&mut working, &Config { leaves, ..Default::default() });
        assert_consistent(&working);
        assert_eq!(steps.last().map(|step| step.cost), Some(working.cost()));
        assert!(working.cost() < before);
        if count <= leaves {
            let leaves: Vec<_> = triangles.iter().zip(0..).map(|(t, index)| (t.bounds(), index)).collect();
            let value = |bounds: &PaddedAabb| measure.values(&measure.whole(), &[*bounds])[0];
            let best = optimum(&leaves, value).unwrap();
            assert!(
                (working.cost() - best.cost).abs() < 1e-5 * best.cost,
                "{} {}",
                working.cost(),
                best.cost
            );
        }
    }

    #[test]
    fn trees_stay_consistent_and_small_ones_become_the_best() {
        for (count, leaves) in [(9, 9), (6, 12), (300, 3), (300, 7)] {
            check(count, leaves, |tree| blend(tree, &rays(200, 3)));
            check(count, leaves, |tree| AreaMeasure::new(&tree.nodes[0].bounds().into()));
        }
    }
}
