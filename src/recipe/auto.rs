//! `--heuristic auto`: which recipe makes the best tree for these queries, found out by trying.
//!
//! Data flows so: the training queries are parted once more, by pixel, into those that trees are fitted to and those that judge; recipes
//! are followed with the first and judged by what a depth-first traversal of the second really counts: box and primitive tests,
//! occlusions that end early included. So a recipe that fits its own rays too well loses.
//!
//! 1. A tree from area alone, with spatial splits, optimised: what rays have to beat, and the answer when they do not.
//! 2. Two ways to use rays, quickly: few queries, rotations only. They come early so that a scene for which there is no time for more has a tree from rays.
//! 3. Area with a full sweep. The splits of the cheaper optimised tree are used from here on, for the two and all other ways to use rays, quickly. Then both trees
//!    from area as they are built (optimisers raise what diffuse rays cost on some objects).
//! 4. The two best ways, and the best with another exponent, optimised in full. The cheapest tree so far wins.
//! 5. The winner's recipe once more, with more patient optimisers and as many of the queries that are fitted as there is time for. It wins where the judges agree.
//!
//! Steps 2 and 3 begin trials in the first two fifths of the time, step 4 in the first seven tenths. More queries than 65,536 make hardly better trees and take
//! their time, so that is the last that more time is spent on.
//!
//! Where triangles may not be cut, step 1 is a full sweep, and step 3 has nothing to decide.
//!
//! In a scene of a dozen triangles or fewer, the optimiser of every recipe is the exact one: the best of all trees takes no time.
//!
//! A step for which no time is left is not begun, and optimisers stop at the end of it: what is best so far is the answer. Where the time suffices, the same input gives the same tree.

use super::{Heuristic, Made, Recipe, RecipeError};
use crate::builder::{self, Splits, spatial};
use crate::format::bvh::Geometry;
use crate::geometry::{Ray, Triangle};
use crate::optimize::{Stage, reinsertion, rotations, treelets};
use crate::progress::Progress;
use crate::training::even;
use crate::training::queries::Query;
use crate::traverse::{Counts, Prepared, PreparedRay, Recorded, Scratch, Traversal};
use crate::tree::Tree;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// How to choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Time for all trials and the tree itself.
    pub budget: Duration,
    /// Cost of a box test.
    pub c_i: f64,
    /// Cost of a primitive test.
    pub c_p: f64,
    /// Most primitives in a leaf.
    pub max_leaf: usize,
    /// Whether triangles may be cut, and stand in several leaves.
    pub cuts: bool,
}

/// Most triangles of a scene for which all trees can be tried in no time.
pub const EXHAUSTIVE: usize = 12;

/// Ways to use rays that are tried; first the [`EARLY`] ones that are best most often.
const HEURISTICS: [Heuristic; 5] = [
    Heuristic::Blend { weight: 0.8 },
    Heuristic::Blend { weight: 0.95 },
    Heuristic::Blend { weight: 0.5 },
    // Not 1: where no training ray passes, area has to decide, or the tree is arbitrary there and ruinous for any other ray.
    Heuristic::Blend { weight: 0.99 },
    Heuristic::Rdh { floor: 1.0 },
];

const EARLY: usize = 2;

/// Most primitives in a leaf, where nothing else is asked for. A test of a primitive is a test like that of a box, so pairs always pay and more do at times.
pub const MAX_LEAF: usize = 8;

/// The other exponent that is tried: the best of the paper's powerplant (0.88) to one digit.
const ALPHA: f64 = 0.9;

/// Queries that the quick trials are fitted to.
const QUICK: usize = 1 << 14;

/// Queries that the trials in full are fitted to.
const FULL: usize = 1 << 16;

/// Queries that judge.
const JUDGES: usize = 1 << 15;

/// Shares of the time before whose end a quick trial begins, and one in full.
const BROWSING: f64 = 0.4;
const TRYING: f64 = 0.7;

/// One recipe that was tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    pub recipe: Recipe,
    /// With how many queries.
    pub queries: usize,
    /// `c_i` · box tests + `c_p` · primitive tests of a judging query.
    pub cost: f64,
}

/// What was chosen.
#[derive(Clone, Debug)]
pub struct Chosen {
    pub recipe: Recipe,
    pub made: Made,
    /// In the order in which they were made; the first is area alone. Empty when there were no queries to judge by, or no time.
    pub trials: Vec<Trial>,
    /// Which of the trials won.
    pub winner: Option<usize>,
    /// Queries that the tree is built from.
    pub queries: usize,
    /// Queries that judged.
    pub judges: usize,
}

/// The scene that trees are made for.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Geometry],
}

/// Tries recipes and makes the best tree, on the threads of the current rayon pool.
///
/// # Errors
/// When there are no queries, or a cost is out of range.
pub fn choose(scene: Scene, queries: &[Query], config: &Config) -> Result<Chosen, RecipeError> {
    choose_with(scene, queries, config, scene.triangles.len() <= EXHAUSTIVE)
}

/// As [`choose`]; `exact` says whether the optimiser of every recipe is the exact one.
///
/// # Errors
/// As [`choose`].
pub fn choose_with(
    scene: Scene,
    queries: &[Query],
    config: &Config,
    exact: bool,
) -> Result<Chosen, RecipeError> {
    if queries.is_empty() {
        return Err(RecipeError::NoRays("auto"));
    }
    let (judges, fit): (Vec<&Query>, Vec<&Query>) = queries.iter().partition(|query| query.judges);
    let judges = even(&judges, JUDGES);
    let segments: Vec<Ray> = fit.iter().map(|query| query.segment).collect();
    let mut splits = if config.cuts { Splits::Spatial(spatial::Options::default()) } else { Splits::Sweep };
    let recipes = Recipes { config, exact };
    let area = recipes.full(Heuristic::Sah, splits);
    let mut chooser = Chooser::new(scene, judges, config, &area)?;
    if chooser.judges.is_empty() || segments.is_empty() || chooser.seconds_left() <= 0.0 {
        return Ok(chooser.end(area, None, 0));
    }
    let by_area = chooser.cost(&chooser.best.tree);
    chooser.enter(&area, 0, by_area);
    let few = even(&segments, QUICK);
    let mut tried = chooser.quick(&recipes, splits, &HEURISTICS[..EARLY], &few)?;
    let sweep = recipes.full(Heuristic::Sah, Splits::Sweep);
    // Without cuts, a sweep is what all began with.
    if config.cuts && chooser.attempt(&sweep, &[], BROWSING)?.is_some_and(|by_sweep| by_sweep < by_area) {
        splits = Splits::Sweep;
        tried.clear();
    }
    tried.extend(chooser.quick(&recipes, splits, &HEURISTICS[tried.len()..], &few)?);
    for recipe in [&sweep, &area].into_iter().take(if config.cuts { 2 } else { 1 }) {
        chooser.attempt(&Recipe { stages: Vec::new(), ..recipe.clone() }, &[], BROWSING)?;
    }
    tried.sort_by(|a, b| a.1.total_cmp(&b.1));
    // With no time for any of them, the first is tried in full.
    if tried.is_empty() {
        tried.push((HEURISTICS[0], f64::INFINITY));
    }
    let mut full: Vec<Recipe> =
        tried.iter().take(2).map(|&(heuristic, _)| recipes.full(heuristic, splits)).collect();
    full.push(Recipe { builder: builder::Config { alpha: ALPHA, ..full[0].builder }, ..full[0].clone() });
    let many = even(&segments, FULL);
    for recipe in &full {
        chooser.attempt(recipe, &many, TRYING)?;
    }
    let all: Vec<Ray> = queries.iter().map(|query| query.segment).collect();
    chooser.finish(&recipes, &segments, &all)
}

/// The recipes that are tried.
#[derive(Clone, Copy)]
struct Recipes<'a> {
    config: &'a Config,
    exact: bool,
}

impl Recipes<'_> {
    fn with(&self, heuristic: Heuristic, splits: Splits, stages: Vec<Stage>) -> Recipe {
        let Config { c_i, c_p, max_leaf, .. } = *self.config;
        let builder = builder::Config { max_leaf, c_i, c_p, ..builder::Config::of(splits) };
        Recipe { heuristic, builder, stages, budget: None }
    }

    fn quick(&self, heuristic: Heuristic, splits: Splits) -> Recipe {
        self.with(heuristic, splits, vec![Stage::Rotations(rotations::Config::default())])
    }

    fn full(&self, heuristic: Heuristic, splits: Splits) -> Recipe {
        let exact = treelets::Config { leaves: treelets::MAX_LEAVES, ..Default::default() };
        let stages = if self.exact {
            vec![Stage::Treelets(exact)]
        } else {
            vec![
                Stage::Rotations(rotations::Config::default()),
                Stage::Reinsertion(reinsertion::Config::default()),
            ]
        };
        self.with(heuristic, splits, stages)
    }

    /// A recipe with more patient optimisers.
    fn patient(recipe: &Recipe) -> Recipe {
        let stages = vec![
            Stage::Rotations(rotations::Config::default()),
            Stage::Reinsertion(reinsertion::Config::default()),
            Stage::Treelets(treelets::Config::default()),
            Stage::Reinsertion(reinsertion::Config::PATIENT),
        ];
        Recipe { stages, ..recipe.clone() }
    }
}

struct Chooser<'a> {
    scene: Scene<'a>,
    judges: Vec<&'a Query>,
    config: &'a Config,
    started: Instant,
    trials: Vec<Trial>,
    /// The tree of the cheapest trial, and which that is.
    best: Made,
    winner: usize,
    /// What it took to make it, and the last tree.
    best_seconds: f64,
    seconds: f64,
}

impl<'a> Chooser<'a> {
    /// Makes the first tree.
    fn new(
        scene: Scene<'a>,
        judges: Vec<&'a Query>,
        config: &'a Config,
        first: &Recipe,
    ) -> Result<Chooser<'a>, RecipeError> {
        let best = Made { tree: Tree::default(), optimized: None };
        let started = Instant::now();
        let mut chooser = Chooser {
            scene,
            judges,
            config,
            started,
            trials: Vec::new(),
            best,
            winner: 0,
            best_seconds: 0.0,
            seconds: 0.0,
        };
        chooser.best = chooser.follow(first, &[])?;
        chooser.best_seconds = chooser.seconds;
        Ok(chooser)
    }

    fn seconds_left(&self) -> f64 {
        self.config.budget.as_secs_f64() - self.started.elapsed().as_secs_f64()
    }

    /// Makes the tree in the time that is left.
    fn follow(&mut self, recipe: &Recipe, rays: &[Ray]) -> Result<Made, RecipeError> {
        let begun = Instant::now();
        let budget = Some(Duration::from_secs_f64(self.seconds_left().max(0.0)));
        let made =
            Recipe { budget, ..recipe.clone() }.make(self.scene.triangles, rays, &Progress::hidden())?;
        self.seconds = begun.elapsed().as_secs_f64();
        Ok(made)
    }

    /// Makes the tree and judges it, if no more than a share of the time is over. It is kept if none was cheaper.
    fn attempt(&mut self, recipe: &Recipe, rays: &[Ray], share: f64) -> Result<Option<f64>, RecipeError> {
        if self.seconds_left() <= (1.0 - share) * self.config.budget.as_secs_f64() {
            return Ok(None);
        }
        let made = self.follow(recipe, rays)?;
        let cost = self.cost(&made.tree);
        if cost < self.trials[self.winner].cost {
            (self.best, self.winner, self.best_seconds) = (made, self.trials.len(), self.seconds);
        }
        self.enter(recipe, rays.len(), cost);
        Ok(Some(cost))
    }

    /// Tries heuristics quickly, and returns those for which there was time.
    fn quick(
        &mut self,
        recipes: &Recipes,
        splits: Splits,
        heuristics: &[Heuristic],
        rays: &[Ray],
    ) -> Result<Vec<(Heuristic, f64)>, RecipeError> {
        let mut tried = Vec::new();
        for &heuristic in heuristics {
            let cost = self.attempt(&recipes.quick(heuristic, splits), rays, BROWSING)?;
            tried.extend(cost.map(|cost| (heuristic, cost)));
        }
        Ok(tried)
    }

    /// What a judging query costs.
    fn cost(&self, tree: &Tree) -> f64 {
        let counts = count(self.scene, tree, &self.judges);
        let sum = self.config.c_i * counts.box_tests as f64 + self.config.c_p * counts.primitive_tests as f64;
        sum / self.judges.len() as f64
    }

    fn enter(&mut self, recipe: &Recipe, queries: usize, cost: f64) {
        self.trials.push(Trial { recipe: recipe.clone(), queries, cost });
    }

    /// The winner's recipe once more, from as many of `fit` as there is time for; it is kept where it is cheaper, for patience can fit rays too well.
    /// Trees that are the best of all for their rays do not need that check, and take the rays of the judges, too.
    fn finish(mut self, recipes: &Recipes, fit: &[Ray], all: &[Ray]) -> Result<Chosen, RecipeError> {
        let Trial { recipe, queries, .. } = self.trials[self.winner].clone();
        if recipes.exact {
            let needs_rays = recipe.heuristic.needs_rays();
            if needs_rays && self.seconds_left() > 0.0 {
                self.best = self.follow(&recipe, all)?;
            }
            let winner = Some(self.winner);
            return Ok(self.end(recipe, winner, if needs_rays { all.len() } else { 0 }));
        }
        // Optimisers stop in time, and queries take it in proportion; but builders have to come to their end.
        let room = self.seconds_left() / (1.5 * self.best_seconds);
        if room >= 1.0 && !recipe.stages.is_empty() {
            let most = (queries as f64 * room) as usize;
            self.attempt(&Recipes::patient(&recipe), &even(fit, most), 1.0)?;
        }
        let Trial { recipe, queries, .. } = self.trials[self.winner].clone();
        let winner = Some(self.winner);
        Ok(self.end(recipe, winner, queries))
    }

    fn end(self, recipe: Recipe, winner: Option<usize>, queries: usize) -> Chosen {
        Chosen {
            recipe: Recipe { budget: Some(self.config.budget), ..recipe },
            made: self.best,
            winner,
            queries,
            judges: self.judges.len(),
            trials: self.trials,
        }
    }
}

/// What the queries cost, depth first.
fn count(scene: Scene, tree: &Tree, queries: &[&Query]) -> Counts {
    let prepared = Prepared::new(tree.view(), scene.triangles, scene.geometries);
    let count = |queries: &[&Query]| {
        let (mut counts, mut scratch) = (Counts::default(), Scratch::default());
        for query in queries {
            let ray = PreparedRay::new(&query.ray);
            let candidates = Recorded { mask: query.mask, rejects: &query.rejects };
            if query.is_occlusion {
                prepared.occluder(Traversal::Odf, &ray, &candidates, &mut counts, &mut scratch);
            } else {
                prepared.closest_hit(Traversal::Odf, &ray, &candidates, &mut counts, &mut scratch);
            }
        }
        counts
    };
    let add = |mut a: Counts, b: Counts| {
        a += b;
        a
    };
    queries.par_chunks(1 << 10).map(count).reduce(Counts::default, add)
}

impl Chosen {
    /// What was tried, for `META` and JSON.
    pub fn report(&self) -> Value {
        let trials: Vec<Value> = self
            .trials
            .iter()
            .map(|trial| {
                json!({ "recipe": trial.recipe.meta(), "queries": trial.queries, "cost": trial.cost })
            })
            .collect();
        json!({ "judges": self.judges, "queries": self.queries, "winner": self.winner, "trials": trials })
    }
}
