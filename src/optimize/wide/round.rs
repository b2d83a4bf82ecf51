//! A round over a wide tree: one change after another, of each inner node from the root down. A
//! node's rays are those of its parent that overlap it; disjoint subtrees go on different threads.

use super::likelihood::Likelihood;
use super::working::{Below, Node, PARALLEL, Prices};
use rayon::prelude::*;
use std::time::Instant;

/// A cost must fall by this share of the node's to be no rounding.
pub const WORTHWHILE: f64 = 1e-9;

/// What every round knows.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    pub likelihood: &'a Likelihood,
    pub prices: &'a Prices,
    /// When to stop, finished or not.
    pub deadline: Option<Instant>,
}

/// A kind of change.
pub trait Round: Sync {
    fn known(&self) -> &Known<'_>;

    /// Changes what is below one inner node, whose rays are `list`, where that is cheaper.
    fn change(&self, node: &mut Node, list: &[u32]);

    /// Changes the node once its subtree is done and its cost is known.
    fn finish(&self, _node: &mut Node) {}

    /// Improves the subtree at `node`, whose rays are `list`. Costs below are those of the new tree
    /// afterwards.
    fn run(&self, node: &mut Node, list: &[u32]) {
        let Known { likelihood, prices, deadline } = *self.known();
        if node.is_leaf() || deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            return;
        }
        self.change(node, list);
        if let Below::Inner(children) = &mut node.below {
            let each = |child: &mut Node| {
                if !child.is_leaf() {
                    let own = likelihood.within(list, &child.bounds);
                    self.run(child, &own);
                }
            };
            if list.len() > PARALLEL {
                children.par_iter_mut().for_each(each);
            } else {
                children.iter_mut().for_each(each);
            }
        }
        node.settle(prices);
        self.finish(node);
    }
}
