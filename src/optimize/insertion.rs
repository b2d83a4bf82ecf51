//! Insertion-based optimisation: Bittner, Hapala and Havran, "Fast Insertion-Based Optimization of Bounding Volume Hierarchies", 2013.
//!
//! A round picks inner nodes by how inefficient they are, M = P(n) · P(n)/mean P(children) · P(n)/least P(child): a large box around
//! small ones, and two that differ. Each picked node is dissolved: its children are put where they cost
//! least, the likelier one first. When a round brings next to nothing, the next picks at random, as the paper does, until that brings nothing either.
//!
//! Here the first child leaves while the second still stands in the node's place, and both moves are taken back unless together they
//! lower the cost, where the paper inserts both anew and keeps what comes out.

use super::Step;
use super::measure::Measure;
use super::moves::{can_move, carry_out, plan, take_back};
use super::search::{Limits, place};
use super::working::Working;
use crate::random::Random;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Most rounds.
    pub rounds: usize,
    /// Share of the inner nodes that a round picks, 0 to 1; all of a small tree.
    pub share: f64,
    /// A round that lowers the cost by a smaller share than this counts as none; two in a row end it.
    pub least_gain: f64,
    pub seed: u64,
    /// Boxes that one search may test.
    pub search_work: u64,
    /// Stop after so many boxes in all.
    pub max_work: u64,
}

impl Default for Config {
    fn default() -> Config {
        Config {
            rounds: 50,
            share: 0.02,
            least_gain: 1e-4,
            seed: 1,
            search_work: 1 << 20,
            max_work: u64::MAX,
        }
    }
}

/// So many nodes are picked in any case, if there are: small trees take no time.
const LEAST: usize = 64;

/// Dissolves inefficient nodes until it does not pay any more. One step a round.
pub fn insert<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let mut random = Random::new(config.seed);
    let mut steps = Vec::new();
    let (mut cost, mut moves, mut work) = (working.cost(), 0, 0);
    let mut at_random = false;
    for _ in 0..config.rounds {
        for node in picked(working, config, at_random.then_some(&mut random)) {
            if work >= config.max_work || working.out_of_time() {
                break;
            }
            moves += dissolve(working, node, config, &mut work);
        }
        let new = working.cost();
        steps.push(Step { cost: new, moves, work });
        let enough = new < cost * (1.0 - config.least_gain);
        if (!enough && at_random) || work >= config.max_work || working.out_of_time() {
            break;
        }
        at_random = !enough;
        cost = new;
    }
    steps
}

/// The nodes of a round: the most inefficient ones, or random ones.
fn picked<M: Measure>(working: &Working<M>, config: &Config, random: Option<&mut Random>) -> Vec<u32> {
    let mut nodes: Vec<u32> =
        (0..working.nodes.len() as u32).filter(|&node| !working.node(node).is_leaf()).collect();
    let count = ((nodes.len() as f64 * config.share).ceil() as usize).max(LEAST).min(nodes.len());
    match random {
        Some(random) => {
            for index in 0..count {
                let other = index + random.below((nodes.len() - index) as u64) as usize;
                nodes.swap(index, other);
            }
        }
        None => nodes.sort_by_cached_key(|&node| {
            let value = working.value(node);
            let [left, right] =
                working.node(node).children().map(|child| working.value(child).max(1e-12 * value));
            let inefficiency = value * (2.0 * value / (left + right)) * (value / left.min(right));
            // Not negative, so the bits are in order; greatest first.
            std::cmp::Reverse(inefficiency.to_bits())
        }),
    }
    nodes.truncate(count);
    nodes
}

/// Puts the children of an inner node where they cost least. Returns the number of moves: 0 when staying was best.
fn dissolve<M: Measure>(working: &mut Working<M>, node: u32, config: &Config, work: &mut u64) -> u64 {
    if node == 0 || !can_move(working, node) {
        return 0;
    }
    let [left, right] = working.node(node).children();
    let (first, second) =
        if working.value(right) > working.value(left) { (right, left) } else { (left, right) };
    // The first may lose up to the node's P if the second makes up for it.
    let mut limits = Limits { least_gain: -1.0, work: config.search_work };
    let Some((first_gain, undo)) = best_move(working, first, &limits, work) else { return 0 };
    limits.least_gain = 0.0;
    let second_move = best_move(working, second, &limits, work);
    let second_gain = second_move.as_ref().map_or(0.0, |(gain, _)| *gain);
    if first_gain + second_gain > 1e-6 * working.value(0).min(working.value(node)) {
        return 1 + second_move.is_some() as u64;
    }
    if let Some((_, undo)) = second_move {
        take_back(working, undo);
    }
    take_back(working, undo);
    0
}

type Moved<M> = (f64, super::moves::Undo<M>);

/// Moves a node to its best place; its gain, and the way back.
fn best_move<M: Measure>(
    working: &mut Working<M>,
    node: u32,
    limits: &Limits,
    work: &mut u64,
) -> Option<Moved<M>> {
    if !can_move(working, node) {
        return None;
    }
    let (place, tested) = place(working, node, limits);
    *work += tested;
    let plan = plan(working, node, place?.target)?;
    *work += plan.work;
    let gain = plan.gain;
    Some((gain, carry_out(working, plan)))
}
