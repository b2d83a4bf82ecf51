//! A whole way to make a tree: how likely boxes are hit, which candidates a greedy builder chooses from, and which
//! optimisers run afterwards. `bvh-build` types one, experiments try many.
//!
//! Data flows so: triangles (+ effective segments) → [`crate::builder`] with a probability → [`crate::optimize`] with the measure
//! that belongs to it → [`crate::tree::leaves`], where leaves may hold several → a tree. Builder and optimisers see the same heuristic, so that the one does not undo the other.

pub mod auto;
pub mod best;
pub mod finish;
pub mod judge;

use crate::builder::reference::References;
use crate::builder::{self, BuildError, build_with};
use crate::geometry::{Ray, Triangle};
use crate::optimize::measure::{AreaMeasure, Estimate, Measure, RayMeasure};
use crate::optimize::{self, OptimizeError, Stage};
use crate::probability::area::Area;
use crate::probability::blend::{Blend, WeightError};
use crate::probability::rays::{Count, RaySet, Rays};
use crate::progress::Progress;
use crate::ranks::{Alone, Ranks};
use crate::tree::Tree;
use crate::tree::collapse::CollapseError;
use crate::tree::leaves::merge_leaves;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How likely a box is taken to be hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heuristic {
    /// P_U, surface area.
    Sah,
    /// P_R, the number of training queries whose effective segments overlap the box, and a floor added to each count.
    Rdh { floor: f64 },
    /// w · rays + (1 - w) · area, each relative to the node.
    Blend { weight: f64 },
}

impl Heuristic {
    /// The name used in options, producers and `META`.
    pub fn name(self) -> &'static str {
        match self {
            Heuristic::Sah => "sah",
            Heuristic::Rdh { .. } => "rdh",
            Heuristic::Blend { .. } => "blend",
        }
    }

    /// Whether it asks for training queries.
    pub fn needs_rays(self) -> bool {
        self != Heuristic::Sah
    }
}

/// A way to make a tree.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    pub heuristic: Heuristic,
    pub builder: builder::Config,
    /// Optimisers, one after another; none leaves the greedy tree.
    pub stages: Vec<Stage>,
    /// Time for everything: optimisers stop when it is over (the greedy build is always finished). With it, two runs may give different trees.
    pub budget: Option<Duration>,
}

/// A tree and what became of its cost.
#[derive(Clone, Debug)]
pub struct Made {
    pub tree: Tree,
    /// What the optimisers did; `None` without any.
    pub optimized: Option<optimize::Report>,
}

/// Why a recipe cannot be followed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RecipeError {
    #[error(transparent)]
    Build(#[from] BuildError),
    #[error(transparent)]
    Optimize(#[from] OptimizeError),
    #[error(transparent)]
    Weight(#[from] WeightError),
    #[error(transparent)]
    Collapse(#[from] CollapseError),
    #[error("floor is {0}: it must be a finite number, not negative")]
    Floor(f64),
    #[error(
        "the heuristic {0} needs training queries, and there are none: give a recording with --rays, or use --heuristic sah"
    )]
    NoRays(&'static str),
    #[error("optimisers need all training queries in one process: leave out --optimize, or --mpi")]
    SharedRays,
}

impl Recipe {
    /// Checks every number, before any work.
    ///
    /// # Errors
    /// The first one that is out of range.
    pub fn check(&self) -> Result<(), RecipeError> {
        self.builder.check()?;
        match self.heuristic {
            Heuristic::Sah => {}
            Heuristic::Rdh { floor } if floor.is_finite() && floor >= 0.0 => {}
            Heuristic::Rdh { floor } => return Err(RecipeError::Floor(floor)),
            Heuristic::Blend { weight } => drop(Blend::new(weight)?),
        }
        Ok(())
    }

    /// Makes a tree over `triangles`, on the threads of the current rayon pool. `rays` are the effective segments of the training
    /// queries; area alone ignores them. `progress` advances by the number of primitives, then by one for each stage.
    ///
    /// # Errors
    /// When a number is out of range, or a heuristic that needs rays has none.
    pub fn make(
        &self,
        triangles: &[Triangle],
        rays: &[Ray],
        progress: &Progress,
    ) -> Result<Made, RecipeError> {
        self.make_on_ranks(triangles, rays, &Alone, progress)
    }

    /// Makes the tree as [`Self::make`] does where each of `ranks` has a part of the training queries ([`crate::training::Segments`]). Each gets the tree,
    /// which is the one that a single process would make. With more than one rank, the current rayon pool has one thread.
    ///
    /// # Errors
    /// As [`Self::make`], and when queries that several ranks have are to be used by an optimiser.
    pub fn make_on_ranks(
        &self,
        triangles: &[Triangle],
        rays: &[Ray],
        ranks: &dyn Ranks,
        progress: &Progress,
    ) -> Result<Made, RecipeError> {
        let started = Instant::now();
        self.check()?;
        if triangles.len() > builder::MAX_TRIANGLES {
            return Err(BuildError::TooManyTriangles(triangles.len()).into());
        }
        let mut all = [rays.len() as u64];
        ranks.sum(&mut all);
        if self.heuristic.needs_rays() && all == [0] {
            return Err(RecipeError::NoRays(self.heuristic.name()));
        }
        if self.heuristic.needs_rays() && !self.stages.is_empty() && ranks.count() > 1 {
            return Err(RecipeError::SharedRays);
        }
        let references = References::of(triangles);
        let bounds = references.bounds;
        // A budget that ends beyond all time is none.
        let deadline = self.budget.and_then(|budget| started.checked_add(budget));
        // Area says as much about small boxes as about large ones, so optimisers can have the leaves as the builder makes them: there
        // is half as much to move. Near the leaves rays are few: they are not to decide what is a leaf before they must.
        let optimises_single = self.heuristic.needs_rays() && !self.stages.is_empty();
        let max_leaf = if optimises_single { 1 } else { self.builder.max_leaf };
        let config = builder::Config { max_leaf, ..self.builder };
        let mut made = Made { tree: Tree::default(), optimized: None };
        let estimate = match self.heuristic {
            Heuristic::Sah => {
                made.tree = build_with(references, &Area::of_scene(&bounds), &config, progress)?;
                if !self.stages.is_empty() {
                    self.optimize(&mut made, &AreaMeasure::new(&bounds), deadline, progress)?;
                }
                return Ok(made);
            }
            Heuristic::Rdh { floor } => {
                let set = RaySet::of_rays(rays.iter().copied());
                let count = Count { floor: floor as f32, ..Count::default() };
                made.tree =
                    build_with(references, &Rays::shared(&set, &bounds, count, ranks), &config, progress)?;
                // Counts alone fit the training rays too well where few of them pass.
                Estimate::default()
            }
            Heuristic::Blend { weight } => {
                let set = RaySet::of_rays(rays.iter().copied());
                let blend = Blend::new(weight)?;
                made.tree =
                    build_with(references, &Rays::shared(&set, &bounds, blend, ranks), &config, progress)?;
                Estimate::Blend { weight }
            }
        };
        if !self.stages.is_empty() {
            self.optimize(&mut made, &RayMeasure::new(rays, estimate, &bounds), deadline, progress)?;
        }
        Ok(made)
    }

    /// Runs the stages, then makes leaves of as many as are allowed.
    fn optimize<M: Measure>(
        &self,
        made: &mut Made,
        measure: &M,
        deadline: Option<Instant>,
        progress: &Progress,
    ) -> Result<(), OptimizeError> {
        let stages = optimize::Config { stages: self.stages.clone(), deadline };
        let report = optimize::run(&mut made.tree, measure, &stages, progress)?;
        let builder::Config { max_leaf, c_i, c_p, .. } = self.builder;
        if max_leaf > 1 {
            made.tree = merge_leaves(&made.tree, &report.probabilities, c_i, c_p, max_leaf);
        }
        made.optimized = Some(report);
        Ok(())
    }

    /// The recipe as the `META` section has it. Nothing in it differs between two runs on the same input.
    pub fn meta(&self) -> Value {
        let mut meta = self.builder.meta(self.heuristic.name());
        match self.heuristic {
            Heuristic::Sah => {}
            Heuristic::Rdh { floor } => meta["floor"] = json!(floor),
            Heuristic::Blend { weight } => meta["weight"] = json!(weight),
        }
        if !self.stages.is_empty() {
            meta["optimize"] = self.stages.iter().map(Stage::name).collect();
            if let Some(budget) = self.budget {
                meta["budget"] = json!(budget.as_secs_f64());
            }
        }
        meta
    }
}
