//! What can be tried: where a tree comes from, and how much is done with it.

use crate::builder::{Bins, Count, Splits, spatial};
use crate::optimize::{Stage, insertion, reinsertion, rotations, treelets};
use crate::recipe::Heuristic;
use serde_json::{Value, json};

/// From what a binary tree is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// The input's own tree.
    Input,
    /// A greedy build.
    Built(Heuristic, Splits, Count, f64),
}

/// How much a trial takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    Quick,
    Full,
    Patient,
}

/// A recipe, all the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    pub start: Start,
    pub level: Level,
    /// Which part of the queries it is fitted to.
    pub part: u64,
}

pub(super) const SPATIAL: Splits = Splits::Spatial(spatial::Options { max_duplication: 1.0, overlap: 1e-5 });

/// Weights of the rays in a blend, and how to split, the likeliest to win first.
pub(super) const BLENDS: [(f64, Splits); 7] = [
    (0.5, SPATIAL),
    (0.8, Splits::Sweep),
    // A greedy build from area, and rays from there on.
    (0.0, SPATIAL),
    (0.95, SPATIAL),
    (0.8, SPATIAL),
    (0.5, Splits::Sweep),
    (0.95, Splits::Sweep),
];

/// Other ways to split by area: more and fewer cuts, and bins without any.
pub(super) const WAYS: [Splits; 5] = [
    Splits::Spatial(spatial::Options { max_duplication: 1.0, overlap: 1e-3 }),
    Splits::Spatial(spatial::Options { max_duplication: 0.2, overlap: 1e-5 }),
    Splits::Spatial(spatial::Options { max_duplication: 3.0, overlap: 1e-6 }),
    Splits::Spatial(spatial::Options { max_duplication: 1.0, overlap: 1e-2 }),
    Splits::Binned { bins: Bins::Adaptive },
];

/// So many blends come before all else but one tree from area, so that a large scene has a tree from rays even when there is no time for more.
pub(super) const EARLY: usize = 2;

/// Other costs of a side.
pub(super) const SIDES: [(Count, f64); 3] =
    [(Count::All, 0.9), (Count::MinusOne, 1.0 / 3.0), (Count::Log, 1.0)];

impl Level {
    /// The next one, of which there is none above the last.
    pub(super) fn next(self) -> Level {
        if self == Level::Quick { Level::Full } else { Level::Patient }
    }

    /// Queries that a tree is fitted to.
    pub(super) fn queries(self) -> usize {
        if self == Level::Quick { 1 << 14 } else { 1 << 16 }
    }

    /// Optimisers of the binary tree.
    pub(super) fn stages(self) -> Vec<Stage> {
        let mut stages = vec![Stage::Rotations(rotations::Config::default())];
        if self >= Level::Full {
            stages.push(Stage::Reinsertion(reinsertion::Config::default()));
        }
        if self == Level::Patient {
            stages.push(Stage::Insertion(insertion::Config::default()));
            stages.push(Stage::Treelets(treelets::Config::default()));
        }
        stages
    }

    /// Rounds for the wide tree.
    pub(super) fn rounds(self) -> usize {
        match self {
            Level::Quick => 0,
            Level::Full => 1,
            Level::Patient => 3,
        }
    }
}

impl Start {
    pub(super) fn needs_rays(self) -> bool {
        matches!(self, Start::Built(heuristic, ..) if heuristic.needs_rays()) || self == Start::Input
    }

    pub(super) fn built(heuristic: Heuristic, splits: Splits) -> Start {
        Start::Built(heuristic, splits, splits.count(), 1.0)
    }

    pub(super) fn is_cut(self) -> bool {
        matches!(self, Start::Built(_, Splits::Spatial(_), ..))
    }
}

impl Plan {
    /// The plan as `META` and JSON have it.
    pub fn meta(&self) -> Value {
        let level = match self.level {
            Level::Quick => "quick",
            Level::Full => "full",
            Level::Patient => "patient",
        };
        let mut meta = match self.start {
            Start::Input => json!({ "start": "input" }),
            Start::Built(heuristic, splits, count, alpha) => {
                let mut meta = json!({
                    "start": "built", "heuristic": heuristic.name(), "splits": splits.to_string(), "count": count.to_string(),
                    "alpha": alpha,
                });
                if let Heuristic::Blend { weight } = heuristic {
                    meta["weight"] = json!(weight);
                }
                if let Splits::Spatial(spatial::Options { max_duplication, overlap }) = splits {
                    (meta["max_duplication"], meta["overlap"]) = (json!(max_duplication), json!(overlap));
                }
                meta
            }
        };
        meta["level"] = json!(level);
        meta["part"] = json!(self.part);
        meta
    }
}
