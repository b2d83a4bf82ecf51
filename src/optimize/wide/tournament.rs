//! Tournament of subtrees: the parts below a node, opened from the likeliest on, are put together anew in several ways ([`super::hierarchy`]), each
//! is collapsed in the cheapest way ([`super::forest`]), and the cheapest of all is kept where it is cheaper than what there was. Then the same
//! for each child, from the root down.

use super::forest::{Forest, Join};
use super::hierarchy::{Merit, Part, cluster, sweep};
use super::round::{Known, Round, WORTHWHILE};
use super::working::{Below, Node};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// How much is tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Parts that a node is opened to, at most.
    pub parts: usize,
    /// Rays of a node that ways are found with. The way that is found is judged by all.
    pub sample: usize,
    /// Exponents of the sweeps that are tried.
    pub alphas: &'static [f64],
}

impl Default for Config {
    fn default() -> Config {
        Config { parts: 64, sample: 1 << 12, alphas: &[1.0, 0.5] }
    }
}

/// The round that puts the parts below each node together anew.
pub struct Tournament<'a> {
    pub known: Known<'a>,
    pub config: &'a Config,
}

impl Round for Tournament<'_> {
    fn known(&self) -> &Known<'_> {
        &self.known
    }

    fn change(&self, node: &mut Node, list: &[u32]) {
        let (parts, opened) = opened(node, self.config.parts);
        if parts.len() < 3 {
            return;
        }
        let local = self.known.likelihood.local(list, self.config.sample);
        let sides: Vec<Part> = parts.iter().map(|part| Part::new(&local, part.bounds)).collect();
        let ways = [Merit::Union, Merit::Growth].into_iter().map(|merit| cluster(&local, &sides, merit));
        let sweeps = self.config.alphas.iter().map(|&alpha| sweep(&local, &sides, alpha));
        let mut best: Option<(f64, Vec<Join>)> = None;
        for joins in ways.chain(sweeps) {
            let cost = Forest::new(&joins, &parts, self.known.prices).cost();
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, joins));
            }
        }
        let Some((_, mut joins)) = best else { return };
        if !local.is_exact() {
            // The hierarchy stays; what it costs is counted with all rays.
            for join in &mut joins {
                let rays = self.known.likelihood.within(list, &join.bounds).len();
                join.p = self.known.likelihood.of(&join.bounds, rays);
            }
        }
        let forest = Forest::new(&joins, &parts, self.known.prices);
        if forest.cost() < node.cost - WORTHWHILE * node.cost {
            let mut parts = Vec::with_capacity(parts.len());
            let taken = std::mem::replace(&mut node.below, Below::Leaf(Vec::new()));
            take(taken, &mut opened.into_iter(), &mut parts);
            if let Some(new) = forest.tree(parts) {
                *node = new;
            }
        }
    }
}

/// Parts of the subtree at `node`: its children, and instead of the likeliest of them theirs, as long as there are at most `most` of them. Also says
/// of each node below `node` that was met on the way, depth first, whether it was opened.
fn opened(node: &Node, most: usize) -> (Vec<&Node>, Vec<bool>) {
    struct Met<'a> {
        node: &'a Node,
        /// Places of the children of what was opened.
        below: Vec<usize>,
    }
    let mut met = vec![Met { node, below: Vec::new() }];
    let mut count = 1;
    // P is not negative, so its bits are in order; of equals the first that was met.
    let mut waiting = BinaryHeap::from([(node.p.to_bits(), Reverse(0))]);
    while let Some((_, Reverse(place))) = waiting.pop() {
        let children = met[place].node.children();
        if place != 0 && count - 1 + children.len() > most {
            continue;
        }
        count += children.len() - 1;
        for child in children {
            if !child.is_leaf() {
                waiting.push((child.p.to_bits(), Reverse(met.len())));
            }
            let new = met.len();
            met[place].below.push(new);
            met.push(Met { node: child, below: Vec::new() });
        }
    }
    let (mut parts, mut opened) = (Vec::with_capacity(count), Vec::with_capacity(met.len()));
    let mut open: Vec<usize> = met[0].below.iter().rev().copied().collect();
    while let Some(place) = open.pop() {
        let below = &met[place].below;
        opened.push(!below.is_empty());
        if below.is_empty() {
            parts.push(met[place].node);
        }
        open.extend(below.iter().rev());
    }
    (parts, opened)
}

/// Adds those parts, in the same order, to `parts`.
fn take(below: Below, opened: &mut impl Iterator<Item = bool>, parts: &mut Vec<Node>) {
    let Below::Inner(children) = below else { return };
    for child in children {
        if opened.next() == Some(true) {
            take(child.below, opened, parts);
        } else {
            parts.push(child);
        }
    }
}
