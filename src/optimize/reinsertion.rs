//! Reinsertion: subtrees move to where they cost least, many in a batch.
//!
//! With area this is Meister and Bittner, "Parallel Reinsertion for Bounding Volume Hierarchy Optimization", 2018: all subtrees of a batch
//! look for their best place at the same time, in the tree as it is. There, threads then fight for the nodes that a move changes
//! and moves that lose wait for the next round. Here moves are carried out one after another, greatest gain first, each after its gain
//! in the tree as it then is has been worked out anew. That takes little beside the searches, makes the cost fall with every move, and
//! leaves nothing to chance, so the tree is the same for any number of threads.
//!
//! With recorded rays a move is worth what it does to the estimate of T_R, to the last ray, and places are found by the same measure.
//!
//! Nodes that are hardly ever hit have little to gain and are most of the nodes: a batch tries the likeliest third, and loses little by it. From the second batch
//! on it tries those of them that have changed, or whose neighbours have.

use super::Step;
use super::measure::Measure;
use super::moves::{can_move, carry_out, plan};
use super::search::{Limits, place};
use super::working::Working;
use rayon::prelude::*;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Most batches. It ends earlier when a batch lowers the cost by less than `least_gain` of it.
    pub batches: usize,
    /// Share of the nodes that a batch tries to move, those with the greatest P first; all of a small tree. 0 to 1.
    pub share: f64,
    /// Least relative fall of the cost for going on.
    pub least_gain: f64,
    /// Boxes that one search may test.
    pub search_work: u64,
    /// Stop after so many boxes in all. Counted, not timed: the same on every machine.
    pub max_work: u64,
}

impl Default for Config {
    fn default() -> Config {
        Config { batches: 10, share: 0.3, least_gain: 1e-3, search_work: 1 << 20, max_work: u64::MAX }
    }
}

impl Config {
    /// One batch over the likeliest twentieth: most of the gain for little of the time.
    pub const QUICK: Config =
        Config { batches: 1, share: 0.05, least_gain: 1e-3, search_work: 1 << 20, max_work: u64::MAX };

    /// Batches over all nodes until hardly anything moves: another hundredth, for several times the time.
    pub const PATIENT: Config =
        Config { batches: 100, share: 1.0, least_gain: 1e-4, search_work: 1 << 20, max_work: u64::MAX };
}

/// Gains below this share of the parent's P are rounding, or not worth the work.
const WORTHWHILE: f64 = 1e-6;

/// So many nodes are tried in any case: small trees take no time.
const LEAST: usize = 1 << 14;

/// Moves subtrees until it does not pay any more. One step a batch.
pub fn reinsert<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let (mut cost, mut work, mut moves) = (working.cost(), 0, 0);
    let mut new = cost;
    // Nodes that may have a better place: those that were not searched for since anything near them changed.
    let mut open = vec![true; working.nodes.len()];
    let least = least_likely(working, config.share);
    for _ in 0..config.batches {
        let nodes = likeliest(working, least, &open);
        for batch in nodes.chunks(M::BATCH) {
            if work >= config.max_work || working.out_of_time() {
                break;
            }
            let done = move_batch(working, batch, config, &mut open);
            moves += done.moves;
            work += done.work;
            new -= done.gain;
        }
        steps.push(Step { cost: new, moves, work });
        if new > cost * (1.0 - config.least_gain) || work >= config.max_work || working.out_of_time() {
            break;
        }
        cost = new;
    }
    steps
}

/// P, inverted, so that the greatest comes first, in single precision: it is not negative, so its bits are in order.
fn rank(value: f64) -> u32 {
    !(value as f32).to_bits()
}

/// The rank of the last node that belongs to the share with the greatest P.
fn least_likely<M: Measure>(working: &Working<M>, share: f64) -> u32 {
    let nodes = 0..working.nodes.len() as u32;
    let mut ranks: Vec<u32> = nodes.map(|node| rank(working.value(node))).collect();
    let count = ((ranks.len() as f64 * share).ceil() as usize).max(LEAST);
    if count < ranks.len() { *ranks.select_nth_unstable(count).1 } else { u32::MAX }
}

/// The open nodes of at most this rank, greatest P first.
fn likeliest<M: Measure>(working: &Working<M>, least: u32, open: &[bool]) -> Vec<u32> {
    let key = |(node, &open): (usize, &bool)| {
        let key = || u64::from(rank(working.value(node as u32))) << 32 | node as u64;
        open.then(key).filter(|key| (key >> 32) as u32 <= least && can_move(working, node as u32))
    };
    let mut keys: Vec<u64> = open.par_iter().enumerate().filter_map(key).collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|key| key as u32).collect()
}

/// What a batch did.
struct Done {
    moves: u64,
    work: u64,
    gain: f64,
}

/// Searches for all of `batch` at once, then moves one after another.
fn move_batch<M: Measure>(
    working: &mut Working<M>,
    batch: &[u32],
    config: &Config,
    open: &mut [bool],
) -> Done {
    let limits = Limits { least_gain: WORTHWHILE, work: config.search_work };
    let tree = &*working;
    let search = |&node: &u32| if can_move(tree, node) { place(tree, node, &limits) } else { (None, 0) };
    // In the order of their numbers, which is nearly that of the tree: searches that follow each other see the same nodes.
    let mut batch = batch.to_vec();
    batch.par_sort_unstable();
    let found: Vec<_> = batch.par_iter().map(search).collect();
    let mut work: u64 = found.iter().map(|(_, work)| work).sum();
    let mut places = Vec::new();
    for (node, (place, _)) in batch.into_iter().zip(found) {
        open[node as usize] = false;
        places.extend(place.map(|place| (node, place)));
    }
    places.sort_by(|(_, a), (_, b)| b.gain.total_cmp(&a.gain));
    let (mut moves, mut gain) = (0, 0.0);
    for (node, place) in places {
        let plan = plan(working, node, place.target);
        work += plan.as_ref().map_or(0, |plan| plan.work);
        let Some(plan) = plan.filter(|plan| plan.gain > 0.0) else {
            // Something else moved first: it may have another place now.
            open[node as usize] = true;
            continue;
        };
        gain += plan.gain;
        let undo = carry_out(working, plan);
        moves += 1;
        for index in undo.touched() {
            open[index as usize] = true;
            if !working.node(index).is_leaf() {
                working.node(index).children().into_iter().for_each(|child| open[child as usize] = true);
            }
        }
    }
    Done { moves, work, gain }
}
