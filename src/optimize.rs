//! Optimisers of binary trees: each takes a tree and a [`measure`] of boxes, moves subtrees, and returns a tree that is no worse.
//!
//! What they lower is T, the sum of P over the inner nodes (paper, section 2.3). Leaves stay as they are, boxes included (those of a spatial
//! split are smaller than their triangles), so what they add to a tree's cost never changes, and greedy decisions of any builder
//! can be mended without touching a triangle.
//!
//! Data flows so: [`run`] reads the tree into a [`working::Working`] tree, which has parents, P of every node and, when the measure is of
//! rays, the list of rays that overlap every inner node; the stages of the [`Config`] change it, and keep all that up to
//! date node by node; then it is written back, depth first.
//!
//! | stage | moves | source |
//! |---|---|---|
//! | [`rotations`] | children and grandchildren of a node, as long as it pays | Kensler 2008 |
//! | [`annealing`] | the same at random, uphill too while it is warm | Kensler 2008 |
//! | [`insertion`] | children of inefficient nodes to their best places | Bittner, Hapala and Havran 2013 |
//! | [`reinsertion`] | every subtree to its best place, many at a time | Meister and Bittner 2018 |
//! | [`treelets`] | the top of every subtree put together in the best way | Karras and Aila 2013 |
//!
//! [`wide`] is an optimiser of its own, for the wide tree that a binary one is collapsed to; [`order`] and [`slots`] choose in which order
//! occlusion queries visit children, a rule for each node or the order itself.
//!
//! The measure may be of one frame or of several ([`frames`]).
//!
//! All of them give the same tree, byte for byte, for any number of threads, unless a deadline ends them: the limits of the stages are counted
//! in boxes tested. Whenever they end, the tree is no worse than before.

pub mod annealing;
#[cfg(test)]
mod checks;
pub mod frames;
pub mod insertion;
pub mod measure;
pub mod moves;
pub mod order;
pub mod reinsertion;
pub mod rotations;
pub mod search;
pub mod segments;
pub mod slots;
pub mod treelets;
pub mod wide;
pub mod working;

use crate::builder::MAX_DEPTH;
use crate::progress::Progress;
use crate::tree::Tree;
use crate::tree::statistics::Statistics;
use measure::Measure;
use std::time::Instant;
use thiserror::Error;
use working::Working;

/// One optimiser and how it is to work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    Rotations(rotations::Config),
    Annealing(annealing::Config),
    Insertion(insertion::Config),
    Reinsertion(reinsertion::Config),
    Treelets(treelets::Config),
}

impl Stage {
    /// The name used in options, tables and JSON.
    pub fn name(&self) -> &'static str {
        match self {
            Stage::Rotations(_) => "rotations",
            Stage::Annealing(_) => "annealing",
            Stage::Insertion(_) => "insertion",
            Stage::Reinsertion(_) => "reinsertion",
            Stage::Treelets(_) => "treelets",
        }
    }
}

/// Which optimisers run, one after another.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    pub stages: Vec<Stage>,
    /// When to stop, finished or not. Two runs with a deadline may give different trees.
    pub deadline: Option<Instant>,
}

impl Default for Config {
    /// Rotations, which are quick, then reinsertion, which goes further.
    fn default() -> Config {
        let rotations = Stage::Rotations(rotations::Config::default());
        let reinsertion = Stage::Reinsertion(reinsertion::Config::default());
        Config { stages: vec![rotations, reinsertion], deadline: None }
    }
}

/// The state after one step of an optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// T of the whole tree in the optimiser's measure.
    pub cost: f64,
    /// Moves since the stage began.
    pub moves: u64,
    /// Boxes tested since the stage began: one for area, one for each ray it was tested with for rays.
    pub work: u64,
}

/// What one stage did.
#[derive(Clone, Debug, PartialEq)]
pub struct StageReport {
    pub stage: Stage,
    pub steps: Vec<Step>,
    /// The stage made the tree deeper than any may be, and was undone.
    pub undone: bool,
}

/// What became of the cost.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// T before.
    pub before: f64,
    /// T after; never more.
    pub after: f64,
    pub stages: Vec<StageReport>,
    /// P of every node of the tree as it is now.
    pub probabilities: Vec<f64>,
}

/// Why a tree cannot be optimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum OptimizeError {
    #[error("node {node} has {children} children: only binary trees can be optimised")]
    NotBinary { node: usize, children: usize },
    #[error(
        "the share of nodes, the temperature, the least gain or the leaves of {0} are not in their range"
    )]
    OutOfRange(&'static str),
}

/// Optimises `tree`, on the threads of the current rayon pool. `progress` advances by one for each stage.
/// The tree keeps its leaves; when nothing gets better, it stays as it is, byte for byte.
///
/// # Errors
/// When an inner node has not two children, or the configuration is out of range. The tree is then unchanged.
pub fn run<M: Measure>(
    tree: &mut Tree,
    measure: &M,
    config: &Config,
    progress: &Progress,
) -> Result<Report, OptimizeError> {
    check(tree, config)?;
    let read = |tree: &Tree| {
        let mut working = Working::new(tree, measure);
        working.deadline = config.deadline;
        (working, tree.primitives.clone())
    };
    let (mut working, mut primitives) = read(tree);
    let before = working.cost();
    let mut after = before;
    let mut probabilities = None;
    let mut stages = Vec::with_capacity(config.stages.len());
    for (number, &stage) in config.stages.iter().enumerate() {
        let steps = match stage {
            Stage::Rotations(config) => rotations::climb(&mut working, &config),
            Stage::Annealing(config) => annealing::anneal(&mut working, &config),
            Stage::Insertion(config) => insertion::insert(&mut working, &config),
            Stage::Reinsertion(config) => reinsertion::reinsert(&mut working, &config),
            Stage::Treelets(config) => treelets::restructure(&mut working, &config),
        };
        let written = working.written(&primitives);
        let (cost, depth) = (written.cost(), written.depth);
        let too_deep = depth > MAX_DEPTH && depth > Statistics::of(tree.view()).depth;
        if !too_deep && cost < after {
            after = cost;
            (*tree, probabilities) = (written.tree, Some(written.values));
        } else if number + 1 < config.stages.len() {
            (working, primitives) = read(tree);
        }
        stages.push(StageReport { stage, steps, undone: too_deep });
        progress.advance(1);
    }
    let probabilities = probabilities.unwrap_or_else(|| Working::new(tree, measure).values());
    Ok(Report { before, after, stages, probabilities })
}

fn check(tree: &Tree, config: &Config) -> Result<(), OptimizeError> {
    let wide = |node: &&crate::tree::Node| !node.is_leaf() && node.len() != 2;
    if let Some(index) = tree.nodes.iter().position(|node| wide(&node)) {
        return Err(OptimizeError::NotBinary { node: index, children: tree.nodes[index].len() });
    }
    for stage in &config.stages {
        let share = |share: f64| (0.0..=1.0).contains(&share);
        let good = match stage {
            Stage::Rotations(_) => true,
            Stage::Annealing(config) => {
                config.start.is_finite() && config.end > 0.0 && config.end <= config.start
            }
            Stage::Insertion(config) => share(config.share) && share(config.least_gain),
            Stage::Reinsertion(config) => share(config.share) && share(config.least_gain),
            Stage::Treelets(config) => {
                (3..=treelets::MAX_LEAVES).contains(&config.leaves) && share(config.least_gain)
            }
        };
        if !good {
            return Err(OptimizeError::OutOfRange(stage.name()));
        }
    }
    Ok(())
}
