//! Greedy top-down building of binary trees (paper, section 2.4, algorithm 3).
//!
//! Triangles become [`reference::Reference`]s; at each node an algorithm ([`binned`], [`sweep`], [`spatial`]) finds the candidate of
//! least [`cost`], divides the references, and `recursion` goes on with both halves, on several threads, writing each
//! node where the number of primitives says that it belongs. How likely a box is to be hit comes from a
//! [`Probability`]: with [`Area`] this is a SAH builder.
//!
//! The tree is the same, byte for byte, for any number of threads: every decision is made on exact minima, maxima and
//! counts, ties go to the first axis and the first candidate, and references stay in a defined order.

pub mod binned;
pub mod clip;
pub mod cost;
mod describe;
pub mod exhaustive;
mod recursion;
pub mod reference;
pub mod spatial;
pub mod sweep;

use crate::geometry::{Aabb, Triangle};
use crate::probability::Probability;
use crate::probability::area::Area;
use crate::progress::Progress;
use crate::tree::{Node, Tree};
use cost::{Linear, Power};
use reference::References;
use thiserror::Error;

/// No tree is deeper, whatever the triangles: a split that could lead below is replaced by one in the middle.
/// SAH trees of real scenes stay well above it, so it costs them nothing.
pub const MAX_DEPTH: usize = 96;

/// Triangles that one tree can hold: its at most 2 n - 1 nodes are numbered with 32 bits.
pub const MAX_TRIANGLES: usize = 1 << 31;

/// Which candidates a node's split is chosen from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Splits {
    /// Planes at equal distances between the centroids' bounds, on each axis.
    Binned { bins: Bins },
    /// Every way to cut the centroids' order, on each axis.
    Sweep,
    /// As binned, and planes that cut triangles where that pays.
    Spatial(spatial::Options),
}

/// How many bins an axis has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bins {
    /// min(32, 4 + n/20) for n primitives, the rule of the paper's experiments. The default, because it spends on a
    /// node in proportion to what the node decides: 32 bins where a plane divides many primitives, 4 at the bottom,
    /// where most nodes are.
    Adaptive,
    /// The same number at every node, 2 to [`MAX_BINS`].
    Fixed(usize),
}

/// Most bins that an axis can have.
pub const MAX_BINS: usize = 256;

impl Bins {
    /// The number of bins for a node of `primitives`.
    #[inline]
    pub fn of(self, primitives: usize) -> usize {
        match self {
            Bins::Adaptive => (4 + primitives / 20).min(32),
            Bins::Fixed(bins) => bins.clamp(2, MAX_BINS),
        }
    }
}

/// What a side's probability is multiplied with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// (|L|-1)^α: the inner nodes that the side will have.
    MinusOne,
    /// |L|^α: its primitives.
    All,
    /// (ln |L|)^α: what T below a node follows most closely (the paper's section 4; `bvh-experiment static-cost`).
    Log,
}

/// How to build.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    pub splits: Splits,
    /// Exponent of the count, not negative: 1 takes a subtree to cost as much as its size says.
    pub alpha: f64,
    pub count: Count,
    /// Most primitives in a leaf. With 1, as in the paper, every leaf has one; above 1, a subtree of no more than that
    /// many becomes a leaf when that does not raise the SAH cost.
    pub max_leaf: usize,
    /// Cost of a box test, for that decision.
    pub c_i: f64,
    /// Cost of a primitive test, for that decision.
    pub c_p: f64,
}

impl Default for Config {
    /// Binned, one primitive a leaf, α = 1. c_I is half of the usual 1.2 for a node visit, which tests two boxes.
    fn default() -> Config {
        Config {
            splits: Splits::Binned { bins: Bins::Adaptive },
            alpha: 1.0,
            count: Count::MinusOne,
            max_leaf: 1,
            c_i: 0.6,
            c_p: 1.0,
        }
    }
}

/// Why a tree cannot be built.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BuildError {
    #[error("{0} triangles: at most {MAX_TRIANGLES} fit in a tree")]
    TooManyTriangles(usize),
    #[error("alpha is {0}: it must be a number from 0 to 16")]
    Alpha(f64),
    #[error("{0} bins: from 2 to {MAX_BINS} are possible")]
    Bins(usize),
    #[error("a leaf of at most {0} primitives: from 1 to 65536 are possible")]
    MaxLeaf(usize),
    #[error("a duplication of at most {0}: from 0 to 15 times the triangles is possible")]
    Duplication(f64),
    #[error("an overlap of {0}: it must be a finite number, not negative")]
    Overlap(f64),
    #[error("{0} is {1}: a cost must be a finite number, not negative")]
    Cost(&'static str, f64),
}

impl Splits {
    /// The count that suits the candidates. What a split of space adds is leaves, which n - 1 does not charge for.
    pub fn count(self) -> Count {
        match self {
            Splits::Binned { .. } | Splits::Sweep => Count::MinusOne,
            Splits::Spatial(_) => Count::All,
        }
    }
}

impl Config {
    /// The default for these candidates.
    pub fn of(splits: Splits) -> Config {
        Config { splits, count: splits.count(), ..Config::default() }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn check(&self) -> Result<(), BuildError> {
        if !(0.0..=16.0).contains(&self.alpha) {
            return Err(BuildError::Alpha(self.alpha));
        }
        if let Splits::Binned { bins: Bins::Fixed(bins) } = self.splits
            && !(2..=MAX_BINS).contains(&bins)
        {
            return Err(BuildError::Bins(bins));
        }
        if let Splits::Spatial(options) = self.splits {
            options.check()?;
        }
        if !(1..=65536).contains(&self.max_leaf) {
            return Err(BuildError::MaxLeaf(self.max_leaf));
        }
        for (name, cost) in [("c_I", self.c_i), ("c_P", self.c_p)] {
            if !(cost.is_finite() && cost >= 0.0) {
                return Err(BuildError::Cost(name, cost));
            }
        }
        Ok(())
    }
}

/// Builds a binary tree over `triangles` with the surface area heuristic, on the threads of the current rayon pool.
/// Triangles with a vertex that is not finite are in no leaf. `progress` advances by the number of primitives.
///
/// # Errors
/// When the configuration is out of range, or there are more than [`MAX_TRIANGLES`].
pub fn build(triangles: &[Triangle], config: &Config, progress: &Progress) -> Result<Tree, BuildError> {
    if triangles.len() > MAX_TRIANGLES {
        return Err(BuildError::TooManyTriangles(triangles.len()));
    }
    let references = References::of(triangles);
    let area = Area::of_scene(&references.bounds);
    build_with(references, &area, config, progress)
}

/// Builds a binary tree over `references`, with any probability.
///
/// # Errors
/// When the configuration is out of range.
pub fn build_with<P: Probability>(
    references: References,
    probability: &P,
    config: &Config,
    progress: &Progress,
) -> Result<Tree, BuildError> {
    config.check()?;
    if references.list.is_empty() {
        return Ok(Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() });
    }
    let tree = if config.alpha == 1.0 && config.count != Count::Log {
        let weight = Linear::new(config.count);
        recursion::Builder { probability, weight, config, progress }.run(references)
    } else {
        let most = match config.splits {
            Splits::Spatial(options) => options.capacity(references.list.len()),
            _ => references.list.len(),
        };
        let weight = Power::new(config, most);
        recursion::Builder { probability, weight, config, progress }.run(references)
    };
    Ok(tree)
}
