//! Reinsertion: subtrees move to where they cost least, many in a batch.
//!
//! With area this is Meister and Bittner, "Parallel Reinsertion for Bounding Volume Hierarchy Optimization", 2018: all subtrees of a batch
//! look for their best place at the same time, in the tree as it is. There, threads then fight for the nodes that a move changes
//! and moves that lose wait for the next round. Here moves are carried out one after another, greatest gain first, each after its gain
//! in the tree as it then is has been worked out anew. That takes little beside the searches, makes the cost fall with every move, and
//! leaves nothing to chance, so the tree is the same for any number of threads.
//!
//! With recorded rays a move is worth what it does to the blend of T_R and area, to the last ray. Places are found by area
//! ([`Search::Area`]: quick proposals, of which the best by rays is taken), or by branch and bound on the measure itself ([`Search::Measure`]).

use super::Step;
use super::measure::{AreaMeasure, Measure};
use super::moves::{can_move, carry_out, plan};
use super::search::{ByArea, ByMeasure, Guide, Limits, places};
use super::working::Working;
use rayon::prelude::*;

/// What places are searched by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// By area, so many places each; the one that gains most by the measure is taken.
    Area { places: usize },
    /// By the measure.
    Measure,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    pub search: Search,
    /// Most batches. It ends earlier when a batch over all nodes lowers the cost by less than `least_gain` of it.
    pub batches: usize,
    /// Share of the nodes that a batch tries to move, those with the greatest P first. 0 to 1.
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
        Config {
            search: Search::Measure,
            batches: 10,
            share: 1.0,
            least_gain: 1e-3,
            search_work: 1 << 20,
            max_work: u64::MAX,
        }
    }
}

/// Gains below this share of the parent's P are rounding, or not worth the work.
const WORTHWHILE: f64 = 1e-6;

/// Nodes that search side by side before their moves are carried out. Fewer see a fresher tree, more keep more threads busy.
const BATCH: usize = 1 << 13;

/// Moves subtrees until it does not pay any more. One step a batch.
pub fn reinsert<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let scene = *working.bounds(0);
    let mut steps: Vec<Step> = Vec::new();
    let (mut cost, mut work, mut moves) = (working.cost(), 0, 0);
    for _ in 0..config.batches {
        if work >= config.max_work {
            break;
        }
        let mut nodes: Vec<u32> =
            (0..working.nodes.len() as u32).filter(|&node| can_move(working, node)).collect();
        nodes.sort_by(|&a, &b| working.value(b).total_cmp(&working.value(a)));
        nodes.truncate((nodes.len() as f64 * config.share).ceil() as usize);
        for batch in nodes.chunks(BATCH) {
            let (done, tested) = match config.search {
                Search::Area { places } => {
                    let limits =
                        Limits { least_gain: WORTHWHILE, places: places.max(1), work: config.search_work };
                    move_batch(working, &ByArea(AreaMeasure::new(&scene)), batch, &limits)
                }
                Search::Measure => {
                    let limits = Limits { least_gain: WORTHWHILE, places: 1, work: config.search_work };
                    move_batch(working, &ByMeasure(working.measure), batch, &limits)
                }
            };
            moves += done;
            work += tested;
            if work >= config.max_work {
                break;
            }
        }
        let new = working.cost();
        steps.push(Step { cost: new, moves, work });
        if new > cost * (1.0 - config.least_gain) {
            break;
        }
        cost = new;
    }
    steps
}

/// Searches for all of `batch` at once, then moves one after another. Returns the number of moves and the work.
fn move_batch<M: Measure, G: Guide<M>>(
    working: &mut Working<M>,
    guide: &G,
    batch: &[u32],
    limits: &Limits,
) -> (u64, u64) {
    let tree = &*working;
    let found: Vec<_> = batch
        .par_iter()
        .map(
            |&node| if can_move(tree, node) { places(tree, guide, node, limits) } else { Default::default() },
        )
        .collect();
    let mut work: u64 = found.iter().map(|(_, work)| work).sum();
    let mut order: Vec<usize> = (0..batch.len()).filter(|&index| !found[index].0.is_empty()).collect();
    order.sort_by(|&a, &b| found[b].0[0].gain.total_cmp(&found[a].0[0].gain));
    let mut moves = 0;
    for index in order {
        let mut best = None;
        for place in &found[index].0 {
            let Some(plan) = plan(working, batch[index], place.target) else { continue };
            work += plan.work;
            if best.as_ref().is_none_or(|best: &super::moves::Plan<_>| plan.gain > best.gain) {
                best = Some(plan);
            }
        }
        if let Some(plan) = best
            && plan.gain > 0.0
        {
            carry_out(working, plan);
            moves += 1;
        }
    }
    (moves, work)
}
