//! `--heuristic auto`: which recipe makes the best tree for these queries, found out by trying.
//!
//! Data flows so: the training queries are parted once more, by pixel, into those that trees are fitted to and those that judge; recipes
//! are followed with the first and judged by what a depth-first traversal of the second really counts: box and primitive tests,
//! occlusions that end early included. So a recipe that fits its own rays too well loses.
//!
//! 1. Trees from area alone, with spatial splits and with a full sweep, with the same optimisers and as they are built (optimisers raise what diffuse
//!    rays cost on some objects): what rays have to beat. The cheapest is the answer when they do not, and the splits of the cheaper optimised one are used from here on.
//! 2. Every way to use rays, quickly: few queries, rotations only.
//! 3. The two best of them, and the best with another exponent, in full. The cheapest tree of 1 and 3 wins.
//! 4. The winner once more, from all training queries.
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
}

/// Most triangles of a scene for which all trees can be tried in no time.
pub const EXHAUSTIVE: usize = 12;

/// Ways to use rays that are tried.
const HEURISTICS: [Heuristic; 5] = [
    Heuristic::Blend { weight: 0.5 },
    Heuristic::Blend { weight: 0.8 },
    Heuristic::Blend { weight: 0.95 },
    // Not 1: where no training ray passes, area has to decide, or the tree is arbitrary there and ruinous for any other ray.
    Heuristic::Blend { weight: 0.99 },
    Heuristic::Rdh { floor: 1.0 },
];

/// Most primitives in a leaf, where nothing else is asked for. A test of a primitive is a test like that of a box, so pairs always pay and more do at times.
pub const MAX_LEAF: usize = 8;

/// The other exponent that is tried: the best of the paper's powerplant (0.88) to one digit.
const ALPHA: f64 = 0.9;

/// Queries that the quick trials are fitted to.
const QUICK: usize = 1 << 14;

/// Queries that judge.
const JUDGES: usize = 1 << 15;

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
    /// In the order in which they were made; the first four are area alone. Empty when there were no queries to judge by, or no time.
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
    let mut chooser = Chooser { scene, judges, config, exact, started: Instant::now(), trials: Vec::new() };

    let mut splits = Splits::Spatial(spatial::Options::default());
    let area = chooser.recipe(Heuristic::Sah, splits);
    let mut made = vec![(chooser.follow(&area, &[])?, 0)];
    if !chooser.judges.is_empty() && !segments.is_empty() && chooser.seconds_left() > 0.0 {
        let spatial = chooser.judge(&area, 0, &made[0].0.tree);
        let sweep = chooser.recipe(Heuristic::Sah, Splits::Sweep);
        let as_built = |recipe: &Recipe| Recipe { stages: Vec::new(), ..recipe.clone() };
        for recipe in [sweep.clone(), as_built(&sweep), as_built(&area)] {
            if let Some((tree, cost)) = chooser.attempt(&recipe, &[])? {
                made.push((tree, chooser.trials.len() - 1));
                if recipe == sweep && cost < spatial {
                    splits = Splits::Sweep;
                }
            }
        }
        let few = even(&segments, QUICK);
        let mut quick = Vec::new();
        for heuristic in HEURISTICS {
            let stages = vec![Stage::Rotations(rotations::Config::default())];
            let recipe = Recipe { stages, ..chooser.recipe(heuristic, splits) };
            if let Some((_, cost)) = chooser.attempt(&recipe, &few)? {
                quick.push((heuristic, cost));
            }
        }
        quick.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut full: Vec<Recipe> =
            quick.iter().take(2).map(|&(heuristic, _)| chooser.recipe(heuristic, splits)).collect();
        if let Some(best) = full.first().cloned() {
            full.push(Recipe { builder: builder::Config { alpha: ALPHA, ..best.builder }, ..best });
        }
        for recipe in &full {
            if let Some((tree, _)) = chooser.attempt(recipe, &segments)? {
                made.push((tree, chooser.trials.len() - 1));
            }
        }
    }
    let cost = |trial: usize| chooser.trials.get(trial).map_or(0.0, |trial| trial.cost);
    let best = (0..made.len())
        .fold(0, |best, next| if cost(made[next].1) < cost(made[best].1) { next } else { best });
    let (mut best, winner) = made.swap_remove(best);
    let recipe = chooser.trials.get(winner).map_or(area, |trial| trial.recipe.clone());
    let mut built_from = if recipe.heuristic.needs_rays() { segments.len() } else { 0 };
    if built_from > 0 && chooser.seconds_left() > 0.0 {
        let all: Vec<Ray> = queries.iter().map(|query| query.segment).collect();
        best = chooser.follow(&recipe, &all)?;
        built_from = all.len();
    }
    Ok(Chosen {
        recipe: Recipe { budget: Some(config.budget), ..recipe },
        made: best,
        winner: (!chooser.trials.is_empty()).then_some(winner),
        queries: built_from,
        judges: chooser.judges.len(),
        trials: chooser.trials,
    })
}

struct Chooser<'a> {
    scene: Scene<'a>,
    judges: Vec<&'a Query>,
    config: &'a Config,
    exact: bool,
    started: Instant,
    trials: Vec<Trial>,
}

impl Chooser<'_> {
    fn seconds_left(&self) -> f64 {
        self.config.budget.as_secs_f64() - self.started.elapsed().as_secs_f64()
    }

    /// The recipe in full.
    fn recipe(&self, heuristic: Heuristic, splits: Splits) -> Recipe {
        let Config { c_i, c_p, max_leaf, .. } = *self.config;
        let builder = builder::Config { splits, max_leaf, c_i, c_p, ..Default::default() };
        let stages = if self.exact {
            vec![Stage::Treelets(treelets::Config { leaves: treelets::MAX_LEAVES, ..Default::default() })]
        } else {
            vec![
                Stage::Rotations(rotations::Config::default()),
                Stage::Reinsertion(reinsertion::Config::default()),
            ]
        };
        Recipe { heuristic, builder, stages, budget: None }
    }

    /// Makes the tree in the time that is left.
    fn follow(&self, recipe: &Recipe, rays: &[Ray]) -> Result<Made, RecipeError> {
        let budget = Some(Duration::from_secs_f64(self.seconds_left().max(0.0)));
        Recipe { budget, ..recipe.clone() }.make(self.scene.triangles, rays, &Progress::hidden())
    }

    /// Makes the tree and judges it, if there is time.
    fn attempt(&mut self, recipe: &Recipe, rays: &[Ray]) -> Result<Option<(Made, f64)>, RecipeError> {
        if self.seconds_left() <= 0.0 {
            return Ok(None);
        }
        let made = self.follow(recipe, rays)?;
        let cost = self.judge(recipe, rays.len(), &made.tree);
        Ok(Some((made, cost)))
    }

    fn judge(&mut self, recipe: &Recipe, queries: usize, tree: &Tree) -> f64 {
        let counts = count(self.scene, tree, &self.judges);
        let sum = self.config.c_i * counts.box_tests as f64 + self.config.c_p * counts.primitive_tests as f64;
        let cost = sum / self.judges.len() as f64;
        self.trials.push(Trial { recipe: recipe.clone(), queries, cost });
        cost
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
