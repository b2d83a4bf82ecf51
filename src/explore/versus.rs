//! Two trees over the same triangles and the same queries: where one spends more than the other.
//!
//! Nodes of different trees cannot be compared, triangles can: each tree's cost is laid out over
//! them ([`super::heat`]), and a node of one tree is then as expensive in the other as its
//! triangles are there. What counts are shares of each tree's own cost, so that a tree that is
//! dearer everywhere does not hide where.

use super::walk::Walk;

/// A node of the first tree, and what its triangles cost in both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// In the first tree.
    pub node: u32,
    /// Of its triangles, as a part of all cost of the tree that they are in: the first, the second.
    pub shares: [f64; 2],
}

impl Contrast {
    /// How much larger the share in the first tree is.
    pub fn difference(&self) -> f64 {
        self.shares[0] - self.shares[1]
    }
}

/// The costs of both trees summed below every node of the first one.
#[derive(Clone, Debug)]
pub struct Versus {
    /// Sums of shares over the places of the first tree, up to each place and without it.
    sums: [Vec<f64>; 2],
}

/// Which tree spends the larger share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    First,
    Second,
}

/// A child that has this part of a node's difference is listed in the node's stead.
const EXPLAINS: f64 = 0.8;

impl Versus {
    /// `walk` is of the first tree; `costs` are what [`super::heat::per_triangle`] says of both. A triangle that has several places in the
    /// first tree has the same part of its costs at each.
    pub fn new(walk: &Walk, costs: [&[f64]; 2]) -> Versus {
        let places = walk.places();
        let sums = costs.map(|costs| {
            let total: f64 = costs.iter().sum();
            let scale = if total > 0.0 { total.recip() } else { 0.0 };
            let mut sum = 0.0;
            let mut sums = vec![0.0];
            sums.extend(places.triangles().iter().map(|&triangle| {
                sum += scale * costs[triangle as usize] / places.of_triangle(triangle).len() as f64;
                sum
            }));
            sums
        });
        Versus { sums }
    }

    /// Of any node of the first tree.
    pub fn contrast(&self, walk: &Walk, node: u32) -> Contrast {
        let below = walk.places().below(node as usize);
        let shares = [0, 1].map(|tree: usize| self.sums[tree][below.end] - self.sums[tree][below.start]);
        Contrast { node, shares }
    }

    /// The nodes in which `side` spends more than the other tree, the largest difference first; none lies below another.
    ///
    /// Among all sets of nodes that do not overlap, the one whose differences have the greatest sum, when every node in the list costs `least`, a share of
    /// the whole: so a node stands for its parts unless they say more, and all that are listed differ by more than `least`. But a node that owes nearly all
    /// of its difference to one child is not listed in that child's stead.
    pub fn dearest(&self, walk: &Walk, side: Side, least: f64) -> Vec<Contrast> {
        let nodes = walk.tree().nodes;
        let difference = |node: usize| {
            let difference = self.contrast(walk, node as u32).difference();
            if side == Side::First { difference } else { -difference }
        };
        // What the best set below each node brings. Children stand behind their parents.
        let mut gains = vec![0.0f64; nodes.len()];
        let mut is_listed = vec![false; nodes.len()];
        for (index, node) in nodes.iter().enumerate().rev() {
            let own = difference(index) - least;
            let mut below = 0.0;
            let mut is_explained = false;
            if !node.is_leaf() {
                for child in node.range() {
                    below += gains[child];
                    is_explained |= difference(child) >= EXPLAINS * difference(index);
                }
            }
            // With an explained node, what explains it is listed: it, or its own parts.
            is_listed[index] = own > 0.0 && own >= below && !(is_explained && below > 0.0);
            gains[index] = if is_listed[index] { own } else { below };
        }
        let mut listed = Vec::new();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            if is_listed[node as usize] {
                listed.push(self.contrast(walk, node));
            } else {
                open.extend(walk.children(node));
            }
        }
        listed.sort_by(|a, b| {
            let size = |contrast: &Contrast| contrast.difference().abs();
            size(b).total_cmp(&size(a)).then(a.node.cmp(&b.node))
        });
        listed
    }
}
