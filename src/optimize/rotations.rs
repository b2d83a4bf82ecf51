//! Tree rotations: Kensler, "Tree Rotations for Improving Bounding Volume Hierarchies", RT 2008.
//!
//! A rotation at an inner node n exchanges two nodes below it so that only one or both of n's children change: a child with a
//! grandchild below the other child (four ways), or two grandchildren below different children (two ways). The leaves below n, and so
//! its box, stay. All rays that matter are in n's list, so the eight boxes that the six rotations could make are tested against
//! that list in one pass.
//!
//! [`climb`] takes the best rotation at each node, as long as there is one that lowers the cost, until none does at any node.

use super::Step;
use super::measure::Measure;
use super::working::Working;
use crate::geometry::padded::Extent;

/// How to climb.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Stop when so many boxes have been tested against rays (or their area taken). Counted, not timed, so that a limit gives
    /// the same tree on every machine. No limit by default.
    pub max_work: u64,
}

impl Default for Config {
    fn default() -> Config {
        Config { max_work: u64::MAX }
    }
}

/// Rotations at a node: 0 to 3 exchange a child with a grandchild, 4 and 5 two grandchildren.
pub(super) const KINDS: usize = 6;

/// Gains below this share of a node's own P are rounding, or not worth the work.
const WORTHWHILE: f64 = 1e-6;

/// What the six rotations at a node gain; -inf for those that it does not have.
pub(super) struct Gains {
    pub gains: [f64; KINDS],
    pub work: u64,
}

/// Children and grandchildren of an inner node; a leaf child has none.
struct Family {
    children: [u32; 2],
    grandchildren: [Option<[u32; 2]>; 2],
}

impl Family {
    fn of<M: Measure>(working: &Working<M>, index: u32) -> Family {
        let children = working.node(index).children();
        let below = |child: u32| (!working.node(child).is_leaf()).then(|| working.node(child).children());
        Family { children, grandchildren: children.map(below) }
    }

    /// The two nodes that rotation `kind` exchanges, if they exist.
    fn exchanged(&self, kind: usize) -> Option<[u32; 2]> {
        let [left, right] = self.grandchildren;
        Some(match kind {
            0 | 1 => [self.children[0], right?[kind]],
            2 | 3 => [self.children[1], left?[kind - 2]],
            _ => [left?[0], right?[kind - 4]],
        })
    }
}

/// Gains of all rotations at an inner node.
pub(super) fn gains<M: Measure>(working: &Working<M>, index: u32) -> Gains {
    let family = Family::of(working, index);
    let bounds = |node: u32| working.bounds(node);
    let list = working.list(index);
    let mut gains = [f64::NEG_INFINITY; KINDS];
    let [a, b] = family.children;
    let boxes_tested = match family.grandchildren {
        [None, None] => 0,
        // With one inner child, one box can change, in two ways.
        [None, Some([c, d])] => {
            let values =
                working.measure.values(list, &[bounds(a).union(bounds(d)), bounds(a).union(bounds(c))]);
            (gains[0], gains[1]) = (working.value(b) - values[0], working.value(b) - values[1]);
            2
        }
        [Some([c, d]), None] => {
            let values =
                working.measure.values(list, &[bounds(b).union(bounds(d)), bounds(b).union(bounds(c))]);
            (gains[2], gains[3]) = (working.value(a) - values[0], working.value(a) - values[1]);
            2
        }
        [Some([a0, a1]), Some([b0, b1])] => {
            let pairs = [[a, b1], [a, b0], [b, a1], [b, a0], [b0, a1], [a0, b1], [b1, a1], [b0, a0]];
            let boxes = pairs.map(|pair| working.union(pair));
            let new = working.measure.values(list, &boxes);
            let (old_a, old_b) = (working.value(a), working.value(b));
            gains = [
                old_b - new[0],
                old_b - new[1],
                old_a - new[2],
                old_a - new[3],
                old_a + old_b - new[4] - new[5],
                old_a + old_b - new[6] - new[7],
            ];
            8
        }
    };
    Gains { gains, work: boxes_tested * working.measure.work(list) }
}

/// The gain of rotation `kind`, and what it cost to know; none when the node has no such rotation.
pub(super) fn gain<M: Measure>(working: &Working<M>, index: u32, kind: usize) -> Option<(f64, u64)> {
    let family = Family::of(working, index);
    let [first, second] = family.exchanged(kind)?;
    let list = working.list(index);
    let work = working.measure.work(list);
    let grown = |moved: u32, remaining: u32| working.bounds(moved).union(working.bounds(remaining));
    let old_right = working.value(working.node(second).parent);
    if kind < 4 {
        let boxes = [grown(first, working.sibling(second))];
        let [new] = working.measure.values(list, &boxes);
        return Some((old_right - new, work));
    }
    let boxes = [grown(second, working.sibling(first)), grown(first, working.sibling(second))];
    let [new_left, new_right] = working.measure.values(list, &boxes);
    let old_left = working.value(working.node(first).parent);
    Some((old_left + old_right - new_left - new_right, 2 * work))
}

/// Carries out rotation `kind`, which the node must have. Returns the children whose boxes changed.
pub(super) fn rotate<M: Measure>(working: &mut Working<M>, index: u32, kind: usize) -> [Option<u32>; 2] {
    let family = Family::of(working, index);
    let Some([first, second]) = family.exchanged(kind) else { return [None; 2] };
    let (first_parent, second_parent) = (working.node(first).parent, working.node(second).parent);
    working.replace_child(first_parent, first, second);
    working.replace_child(second_parent, second, first);
    let changed = [(kind >= 4).then_some(first_parent), Some(second_parent)];
    for child in changed.into_iter().flatten() {
        let bounds = working.union(working.node(child).children());
        let list = working.measure.within(working.list(index), &bounds);
        working.set(child, bounds, list);
    }
    changed
}

/// Rotates until no rotation at any node lowers the cost, on the threads of the current rayon pool: first in disjoint
/// subtrees side by side, then at their tops and wherever that opens a way below.
pub fn climb<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let (roots, top) = working.cut();
    let share = config.max_work / (roots.len() as u64 + 1);
    let mut counts = working.apart(&roots, |_, subtree| {
        let open = subtree.order();
        climb_from(subtree, open, share)
    });
    let below = Count::sum(&counts);
    let mut steps = vec![below.step(working)];
    // A changed subtree has the same box: at its root and at the top everything is as before, only above it may see other grandchildren.
    counts.push(climb_from(working, top, config.max_work.saturating_sub(below.work)));
    steps.push(Count::sum(&counts).step(working));
    steps
}

/// What has been done.
#[derive(Clone, Copy, Default)]
struct Count {
    work: u64,
    moves: u64,
}

impl Count {
    fn sum(counts: &[Count]) -> Count {
        counts.iter().fold(Count::default(), |sum, count| Count {
            work: sum.work + count.work,
            moves: sum.moves + count.moves,
        })
    }

    fn step<M: Measure>(&self, working: &Working<M>) -> Step {
        Step { cost: working.cost(), moves: self.moves, work: self.work }
    }
}

/// Climbs at the nodes of `open`, last first, and again at every node whose rotations change on the way.
fn climb_from<M: Measure>(working: &mut Working<M>, mut open: Vec<u32>, max_work: u64) -> Count {
    let mut is_open = vec![false; working.nodes.len()];
    for &index in &open {
        is_open[index as usize] = true;
    }
    let mut count = Count::default();
    let mut visits = 0u64;
    while let Some(index) = open.pop() {
        is_open[index as usize] = false;
        if working.node(index).is_leaf() {
            continue;
        }
        visits += 1;
        if count.work >= max_work || (visits.is_multiple_of(256) && working.out_of_time()) {
            break;
        }
        let Gains { gains, work } = gains(working, index);
        count.work += work;
        let mut best = 0;
        for kind in 1..KINDS {
            if gains[kind] > gains[best] {
                best = kind;
            }
        }
        if gains[best] > WORTHWHILE * working.value(index) {
            let changed = rotate(working, index, best);
            count.moves += 1;
            // The rotations of a node depend on its children and grandchildren: those of the parent, of this one, and of the changed children are new.
            let parent = working.node(index).parent;
            let parent = (parent != super::working::NONE).then_some(parent);
            for next in [parent, Some(index), changed[0], changed[1]].into_iter().flatten() {
                if !std::mem::replace(&mut is_open[next as usize], true) {
                    open.push(next);
                }
            }
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_consistent, blend, poor_tree, rays, triangles};
    use super::*;
    use crate::random::Random;

    #[test]
    fn gains_are_what_recounting_says_after_thousands_of_rotations() {
        let triangles = triangles(60, 1);
        let tree = poor_tree(&triangles);
        let measure = blend(&tree, &rays(300, 2));
        let mut working = Working::new(&tree, &measure);
        let mut random = Random::new(3);
        let mut rotated = 0;
        while rotated < 4000 {
            let index = random.below(working.nodes.len() as u64) as u32;
            if working.node(index).is_leaf() {
                continue;
            }
            let all = gains(&working, index).gains;
            let kind = random.below(KINDS as u64) as usize;
            let Some((expected, _)) = gain(&working, index, kind) else {
                assert_eq!(all[kind], f64::NEG_INFINITY);
                continue;
            };
            assert!((all[kind] - expected).abs() < 1e-12);
            let before = working.cost();
            rotate(&mut working, index, kind);
            rotated += 1;
            assert!((before - working.cost() - expected).abs() < 1e-9, "rotation {kind} at {index}");
            if rotated % 100 == 0 {
                assert_consistent(&working);
            }
        }
    }

    #[test]
    fn after_climbing_no_rotation_helps() {
        let triangles = triangles(500, 4);
        let tree = poor_tree(&triangles);
        let measure = blend(&tree, &rays(300, 5));
        let mut working = Working::new(&tree, &measure);
        let before = working.cost();
        let steps = climb(&mut working, &Config::default());
        assert_consistent(&working);
        assert_eq!(steps[1].cost, working.cost());
        assert!(steps[1].cost < 0.8 * before, "{} {before}", steps[1].cost);
        for index in 0..working.nodes.len() as u32 {
            if !working.node(index).is_leaf() {
                let most = gains(&working, index).gains.into_iter().fold(f64::NEG_INFINITY, f64::max);
                assert!(most <= WORTHWHILE * working.value(index), "{index} could still gain {most}");
            }
        }
    }

    #[test]
    fn a_limit_on_work_is_kept() {
        let triangles = triangles(2000, 4);
        let tree = poor_tree(&triangles);
        let measure = blend(&tree, &rays(100, 5));
        let work = |max_work| {
            let mut working = Working::new(&tree, &measure);
            climb(&mut working, &Config { max_work }).last().map_or(0, |step| step.work)
        };
        let all = work(u64::MAX);
        // One node's eight boxes can be tested after the limit was nearly reached, in each of the subtrees and at the top.
        assert!(work(all / 10) < all / 10 + 66 * 8 * 101);
        assert_eq!(work(0), 0);
    }
}
