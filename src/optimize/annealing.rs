//! Simulated annealing with tree rotations: Kensler, "Tree Rotations for Improving Bounding Volume Hierarchies", RT 2008.
//!
//! A sweep tries one random rotation at every inner node. One that lowers the cost is taken; one that raises it by d is taken with
//! probability exp(-d / temperature). The temperature falls geometrically from `start` to `end` times the mean P of the inner
//! nodes, so that early sweeps rearrange and late ones settle; [`climb`] finishes. The best state of all sweeps is kept.
//!
//! Subtrees are annealed side by side, each with random numbers of its own, then the top of the tree over them.

use super::Step;
use super::measure::Measure;
use super::rotations::{self, KINDS, climb, gain, rotate};
use super::working::Working;
use crate::random::Random;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Sweeps over the tree.
    pub iterations: usize,
    /// First temperature, in mean P of an inner node.
    pub start: f64,
    /// Last temperature.
    pub end: f64,
    pub seed: u64,
    /// Stop after so many boxes tested; the climb at the end included.
    pub max_work: u64,
}

impl Default for Config {
    fn default() -> Config {
        Config { iterations: 100, start: 0.3, end: 0.001, seed: 1, max_work: u64::MAX }
    }
}

/// Anneals, then climbs. Steps: the annealed subtrees, the annealed top, the climbs.
pub fn anneal<M: Measure>(working: &mut Working<M>, config: &Config) -> Vec<Step> {
    let before = working.nodes.clone();
    let cost = working.cost();
    let (roots, top) = working.cut();
    let share = config.max_work / (roots.len() as u64 + 2);
    let counts: Vec<(u64, u64)> = working.apart(&roots, |number, subtree| {
        let order = subtree.order();
        let inner = order.into_iter().filter(|&index| !subtree.node(index).is_leaf()).collect();
        sweep(subtree, inner, config, share, 1 + number as u64)
    });
    let (mut moves, mut work) = counts.iter().fold((0, 0), |sum, count| (sum.0 + count.0, sum.1 + count.1));
    let mut steps = vec![Step { cost: working.cost(), moves, work }];
    let (top_moves, top_work) = sweep(working, top, config, share, 0);
    moves += top_moves;
    work += top_work;
    steps.push(Step { cost: working.cost(), moves, work });
    for step in climb(working, &rotations::Config { max_work: config.max_work.saturating_sub(work) }) {
        steps.push(Step { cost: step.cost, moves: moves + step.moves, work: work + step.work });
    }
    if working.cost() > cost {
        working.restore(before);
    }
    steps
}

/// All sweeps over `nodes`, inner ones. Leaves the best state that a sweep ended with, or the first. Returns moves and work.
fn sweep<M: Measure>(
    working: &mut Working<M>,
    nodes: Vec<u32>,
    config: &Config,
    max_work: u64,
    stream: u64,
) -> (u64, u64) {
    let mut random = Random::stream(config.seed, &[stream]);
    let mean = nodes.iter().map(|&index| working.value(index)).sum::<f64>() / nodes.len().max(1) as f64;
    let (mut moves, mut work) = (0, 0);
    // Cost relative to the first state.
    let (mut cost, mut best_cost) = (0.0, 0.0);
    let mut best = working.nodes.clone();
    for iteration in 0..config.iterations {
        if work >= max_work || working.out_of_time() {
            break;
        }
        let progress = iteration as f64 / (config.iterations - 1).max(1) as f64;
        let temperature = mean * config.start * (config.end / config.start).powf(progress);
        for &index in &nodes {
            let kind = random.below(KINDS as u64) as usize;
            let chance = random.uniform();
            let Some((gained, tested)) = gain(working, index, kind) else { continue };
            work += tested;
            if gained > 0.0 || chance < (gained / temperature).exp() {
                rotate(working, index, kind);
                cost -= gained;
                moves += 1;
            }
        }
        if cost < best_cost {
            best_cost = cost;
            best.copy_from_slice(&working.nodes);
        }
    }
    if cost != best_cost {
        working.restore(best);
    }
    (moves, work)
}
