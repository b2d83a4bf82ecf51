//! Moving one subtree to another place: the step of insertion-based optimisation and of reinsertion.
//!
//! Node x leaves its parent p; p's other child takes p's place. Then p becomes the parent of x and a target y, where y was. Boxes
//! between p and the lowest common ancestor of both places shrink, those on the way down to y grow, and nothing
//! else changes, the common ancestor included. The lists of grown boxes come out of the common ancestor's.

use super::measure::Measure;
use super::working::{Node, Working};
use crate::geometry::padded::Extent;

/// A move with all that it changes, worked out but not done.
pub struct Plan<M: Measure> {
    node: u32,
    target: u32,
    /// Inner nodes whose boxes change, with their new boxes and lists.
    changes: Vec<(u32, M::Bounds, M::List)>,
    /// By how much the cost falls.
    pub gain: f64,
    /// Boxes tested against rays.
    pub work: u64,
}

/// Whether a node can move at all: it needs a grandparent.
pub fn can_move<M: Measure>(working: &Working<M>, node: u32) -> bool {
    node != 0 && working.node(node).parent != 0
}

/// Works out the move of `node` beside `target`. None when there is no such move, or it would change nothing.
pub fn plan<M: Measure>(working: &Working<M>, node: u32, target: u32) -> Option<Plan<M>> {
    if !can_move(working, node) || target == 0 {
        return None;
    }
    let parent = working.node(node).parent;
    let sibling = working.sibling(node);
    if target == parent || target == sibling || target == node {
        return None;
    }
    let above = working.node(target).parent;
    let (common, down) = paths(working, node, parent, above)?;
    let measure = working.measure;
    let moved = *working.bounds(node);
    let mut changes = Vec::new();
    let (mut gain, mut work) = (working.value(parent), 0);

    // Up from the parent: boxes without the node. `remaining` ends as the box that holds the target if that is an ancestor of the node.
    let mut remaining = *working.bounds(sibling);
    let mut target_bounds = *working.bounds(target);
    let mut below = parent;
    while below != common && working.node(below).parent != common {
        let index = working.node(below).parent;
        remaining = remaining.union(working.bounds(working.sibling(below)));
        if remaining == *working.bounds(index) {
            // Nor does anything above change.
            break;
        }
        work += measure.work(working.list(index));
        let list = measure.within(working.list(index), &remaining);
        gain += working.value(index) - measure.value(&remaining, &list);
        changes.push((index, remaining, list));
        if index == target {
            target_bounds = remaining;
        }
        below = index;
    }

    // Down to the target: boxes with the node.
    let mut outer = working.list(common);
    for &index in down.iter().rev() {
        let bounds = working.bounds(index).union(&moved);
        if bounds == *working.bounds(index) {
            outer = working.list(index);
            continue;
        }
        work += measure.work(outer);
        let list = measure.within(outer, &bounds);
        gain -= measure.value(&bounds, &list) - working.value(index);
        changes.push((index, bounds, list));
        outer = changes.last().map(|(_, _, list)| list)?;
    }
    let bounds = target_bounds.union(&moved);
    work += measure.work(outer);
    let list = measure.within(outer, &bounds);
    gain -= measure.value(&bounds, &list);
    changes.push((parent, bounds, list));
    Some(Plan { node, target, changes, gain, work })
}

/// What a move replaced.
pub struct Undo<M: Measure> {
    /// Nodes as they were.
    nodes: Vec<(u32, Node<M::Bounds>)>,
    /// Inner nodes with their old lists.
    lists: Vec<(u32, M::List)>,
}

impl<M: Measure> Undo<M> {
    /// Nodes whose links or boxes the move changed.
    pub fn touched(&self) -> impl Iterator<Item = u32> {
        self.nodes.iter().map(|(index, _)| *index)
    }
}

/// Carries a plan out. The tree must be the one that it was made for.
pub fn carry_out<M: Measure>(working: &mut Working<M>, plan: Plan<M>) -> Undo<M> {
    let Plan { node, target, changes, .. } = plan;
    let parent = working.node(node).parent;
    let sibling = working.sibling(node);
    let (from, to) = (working.node(parent).parent, working.node(target).parent);
    let touched =
        [from, to, parent, sibling, node, target].into_iter().chain(changes.iter().map(|change| change.0));
    let mut undo =
        Undo { nodes: touched.map(|index| (index, *working.node(index))).collect(), lists: Vec::new() };
    working.replace_child(from, parent, sibling);
    working.replace_child(to, target, parent);
    working.adopt(parent, [target, node]);
    for (index, bounds, list) in changes {
        undo.lists.push((index, working.set(index, bounds, list)));
    }
    undo
}

/// Takes the latest move back.
pub fn take_back<M: Measure>(working: &mut Working<M>, undo: Undo<M>) {
    for (index, node) in undo.nodes {
        working.nodes[index as usize] = node;
    }
    for (index, list) in undo.lists {
        working.lists[index as usize] = list;
    }
}

/// The lowest node at or above both `parent` and `above`, and the nodes from `above` up to below it. None when `node` is among
/// them: a node cannot move below itself.
fn paths<M: Measure>(working: &Working<M>, node: u32, parent: u32, above: u32) -> Option<(u32, Vec<u32>)> {
    let depth = |mut index: u32| {
        let mut depth = 0;
        while index != 0 {
            index = working.node(index).parent;
            depth += 1;
        }
        depth
    };
    let (mut left, mut right) = (parent, above);
    let (mut left_depth, mut right_depth) = (depth(left), depth(right));
    let mut down = Vec::new();
    while left != right {
        if right == node {
            return None;
        }
        if right_depth >= left_depth {
            down.push(right);
            right = working.node(right).parent;
            right_depth -= 1;
        } else {
            left = working.node(left).parent;
            left_depth -= 1;
        }
    }
    Some((left, down))
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_consistent, blend, poor_tree, rays, triangles};
    use super::*;
    use crate::random::Random;

    #[test]
    fn gains_are_what_recounting_says_and_moves_can_be_taken_back() {
        let triangles = triangles(50, 1);
        let tree = poor_tree(&triangles);
        let measure = blend(&tree, &rays(300, 2));
        let mut working = Working::new(&tree, &measure);
        let mut random = Random::new(3);
        let mut moved = 0;
        while moved < 4000 {
            let [node, target] = [0; 2].map(|_| random.below(working.nodes.len() as u64) as u32);
            let Some(plan) = plan(&working, node, target) else { continue };
            let (before, expected) = (working.cost(), plan.gain);
            let undo = carry_out(&mut working, plan);
            assert!((before - working.cost() - expected).abs() < 1e-9, "{node} beside {target}");
            moved += 1;
            if moved % 100 == 0 {
                assert_consistent(&working);
            }
            if moved % 3 == 0 {
                take_back(&mut working, undo);
                assert_eq!(working.cost(), before);
                if moved % 99 == 0 {
                    assert_consistent(&working);
                }
            }
        }
    }

    #[test]
    fn what_cannot_move_has_no_plan() {
        let triangles = triangles(20, 1);
        let tree = poor_tree(&triangles);
        let measure = blend(&tree, &rays(10, 2));
        let working = Working::new(&tree, &measure);
        let [left, right] = working.node(0).children();
        let below = working.node(left).children();
        let deeper = working.node(below[0]).children();
        for (node, target) in [
            (0, left),
            (left, right),
            (below[0], 0),
            (below[0], left),
            (below[0], below[1]),
            (below[0], below[0]),
            (below[0], deeper[0]),
        ] {
            assert!(plan(&working, node, target).is_none(), "{node} beside {target}");
        }
        assert!(plan(&working, below[0], right).is_some());
    }
}
