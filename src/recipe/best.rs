//! The best tree for recorded queries that can be found in a time: whole recipes are tried and judged by what the finished tree really costs.
//!
//! A recipe goes all the way, from the probability of the greedy build over optimisers and exponents to the wide tree and the order of its
//! children ([`super::finish`]), because what is cheaper as a binary tree need not be cheaper as the tree that is followed. Data flows so: the
//! training queries are parted by pixel into those that trees are fitted to, those that choose between trees, and those that confirm the choice;
//! the cost of a tree is counted by the traversal ([`super::judge`]) and priced by [`crate::cost`].
//!
//! Trials come in levels, each of which takes more time for fewer recipes (successive halving: Karnin, Koren and Somekh, "Almost optimal
//! exploration in multi-armed bandits", 2013):
//!
//! 1. area alone, two blends of rays and area, and the input's own tree optimised, quickly: few queries, rotations, leaves only; then the
//!    best of those with more queries, reinsertion and a tournament of subtrees;
//! 2. other blends with both ways to split, quickly, and the best that has not been tried so in full;
//! 3. other costs of a side (n^0.9, ∛(n-1), log n) for the best two starts, quickly, and the best two of all that are left in full;
//! 4. the best two of those with insertion, treelets and more rounds;
//! 5. the best two again and again, from other training queries: which ones a tree is fitted to decides up to 6% of its cost.
//!
//! Where triangles may not be cut, a full sweep is all there is, and the input's own tree takes
//! part if it cuts none either. Without queries to fit trees to, as for the control
//! ([`Config::area_only`]), other ways to split and other costs of a side take the place of the
//! blends, so that there are as many trials.
//!
//! What is tried next depends on what was found, never on the clock; the clock only ends it. So
//! more time means more trials, never others. The choice is confirmed by queries that did not make
//! it, and never becomes worse for the judges (`standing`). A trial is begun when one like it would
//! end in time, and is not cut short.
//!
//! [`build`] is the whole of it for a file and its recording, [`Built`] what is written or planted afterwards.

mod file;
mod plan;
mod standing;

pub use file::{Built, build};
pub use plan::{Level, Plan, Start};

use super::finish::{Effort, Queries, Shape, finish};
use super::judge::{Scene, judge};
use super::{Heuristic, Recipe, RecipeError};
use crate::builder::{self, Splits};
use crate::cost::{Constants, Cost};
use crate::format::bvh::{Bvh, flag};
use crate::geometry::Ray;
use crate::progress::Progress;
use crate::random::mixed;
use crate::training::even;
use crate::training::occlusions::Occlusion;
use crate::training::queries::Query;
use crate::traverse::OcclusionOrder;
use crate::tree::statistics::Statistics;
use crate::tree::{Node, Tree, TreeView};
use plan::{BLENDS, EARLY, SIDES, SPATIAL, WAYS};
use standing::{Candidate, Standing};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How to choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    pub shape: Shape,
    /// Time for all of it. The first tree is always finished.
    pub budget: Duration,
    /// Trials at most. Where they end before the time does, the tree is the same on every machine.
    pub trials: usize,
    /// Whether trees from area alone are all that is tried, between which queries only choose: the
    /// control of what rays bring.
    pub area_only: bool,
    /// Whether triangles may be cut, and stand in several leaves.
    pub cuts: bool,
}

/// The tree that is to be replaced, as it is followed now.
#[derive(Clone, Debug)]
pub struct Input<'a> {
    pub tree: TreeView<'a>,
    /// In which order occlusion queries visit its children.
    pub order: OcclusionOrder,
    /// Whether it has spatial splits.
    pub is_cut: bool,
}

impl<'a> Input<'a> {
    /// The tree of a file. Without a section `ORDR`, it is taken to be followed as Embree's kernels do, the last child first.
    pub fn of(bvh: &Bvh<'a>) -> Input<'a> {
        let order = bvh.order.and_then(|order| OcclusionOrder::new(None, bvh.tree, Some(order)).ok());
        Input {
            tree: bvh.tree,
            order: order.unwrap_or(OcclusionOrder::Last),
            is_cut: bvh.header.flags & flag::SPATIAL_SPLITS != 0,
        }
    }
}

/// One plan that was followed.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    pub plan: Plan,
    /// Nanoseconds of a query that chooses.
    pub cost: f64,
    pub seconds: f64,
}

/// What was chosen.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// Children in the order in which occlusion queries are to visit them.
    pub tree: Tree,
    pub plan: Plan,
    /// Whether the tree has spatial splits.
    pub is_cut: bool,
    /// In the order in which they were made.
    pub trials: Vec<Trial>,
    /// Which of them was chosen; `None` when there was nothing to choose by.
    pub winner: Option<usize>,
    /// What a confirming query costs in the input's tree, in the best from area alone, and in this one.
    pub before: Cost,
    pub area: Cost,
    pub after: Cost,
    /// Queries that chose, and that confirmed.
    pub judges: [usize; 2],
}

/// About so many trials are made where there is time for every level once.
pub const TRIALS: u64 = 24;

/// Queries that judge, at most, on either side.
const JUDGES: usize = 1 << 15;

/// Other parts of the queries that are tried at most, and trials in a row that may bring nothing.
const MOST_PARTS: u64 = 64;
const PATIENCE: usize = 8;

/// Tries plans and returns the best tree, on the threads of the current rayon pool. Without `queries` it is the best from area alone, by area.
///
/// # Errors
/// When a number of `config` is out of range.
pub fn choose(
    scene: Scene,
    input: Input,
    queries: &[Query],
    config: &Config,
    progress: &Progress,
) -> Result<Chosen, RecipeError> {
    let started = Instant::now();
    let (judges, fit): (Vec<&Query>, Vec<&Query>) = queries.iter().partition(|query| query.judges);
    let mut chooser = Chooser {
        scene,
        input,
        config,
        started,
        fit,
        choosing: even(&judges.iter().copied().step_by(2).collect::<Vec<_>>(), JUDGES),
        confirming: even(&judges.iter().copied().skip(1).step_by(2).collect::<Vec<_>>(), JUDGES),
        share: queries.iter().filter(|query| query.is_occlusion).count() as f64 / queries.len().max(1) as f64,
        trials: Vec::new(),
        standing: Standing::default(),
        progress,
    };
    chooser.run()?;
    chooser.end()
}

struct Chooser<'a> {
    scene: Scene<'a>,
    input: Input<'a>,
    config: &'a Config,
    started: Instant,
    /// Queries that trees are fitted to.
    fit: Vec<&'a Query>,
    choosing: Vec<&'a Query>,
    confirming: Vec<&'a Query>,
    /// Of occlusion.
    share: f64,
    trials: Vec<Trial>,
    standing: Standing,
    progress: &'a Progress,
}

impl Chooser<'_> {
    /// Makes trials until time is over, or more of them are of no use; whether there was time for all.
    fn run(&mut self) -> Result<bool, RecipeError> {
        let quick = |start| Plan { start, level: Level::Quick, part: 0 };
        let allowed = |splits: &Splits| self.config.cuts || *splits == Splits::Sweep;
        let area = [SPATIAL, Splits::Sweep].into_iter().filter(allowed);
        let mut area = area.map(|splits| quick(Start::built(Heuristic::Sah, splits)));
        let has_rays = self.has_rays();
        let blends = BLENDS.into_iter().filter(|(_, splits)| has_rays && allowed(splits));
        let mut blends =
            blends.map(|(weight, splits)| quick(Start::built(Heuristic::Blend { weight }, splits)));
        let own = self.improves_input().then(|| quick(Start::Input));
        // Area first: it is the answer when there is time for nothing else.
        let opening: Vec<Plan> =
            area.by_ref().take(1).chain(blends.by_ref().take(EARLY)).chain(own).collect();
        let others: Vec<Plan> = area.chain(blends).collect();
        if !(self.attempt_all(opening)? && self.deepen(Level::Quick, 1)?) {
            return Ok(false);
        }
        if !(self.attempt_all(others)? && self.deepen(Level::Quick, 1)?) {
            return Ok(false);
        }
        // The sides of the best start, and the likeliest for the next.
        let mut sides = Vec::new();
        let of_next = if has_rays { 1 } else { SIDES.len() };
        for (plan, most) in self.cheapest(Level::Quick, 2).into_iter().zip([SIDES.len(), of_next]) {
            if let Start::Built(heuristic, splits, ..) = plan.start {
                let side = |&(count, alpha)| quick(Start::Built(heuristic, splits, count, alpha));
                sides.extend(SIDES[..most].iter().map(side));
            }
        }
        if !has_rays {
            let ways = WAYS.into_iter().filter(allowed);
            sides.extend(ways.map(|splits| quick(Start::built(Heuristic::Sah, splits))));
        }
        if !(self.attempt_all(sides)? && self.deepen(Level::Quick, 2)? && self.deepen(Level::Full, 2)?) {
            return Ok(false);
        }
        let mut finalists: Vec<Plan> = self.cheapest(Level::Patient, 2);
        finalists.retain(|plan| self.fits_rays(plan.start));
        for part in 1..MOST_PARTS {
            for plan in &finalists {
                let since = self.standing.best().map_or(0, |best| self.trials.len() - best);
                if since > PATIENCE {
                    return Ok(true);
                }
                if !self.attempt(Plan { part, ..*plan })? {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// Whether trees are fitted to queries.
    fn has_rays(&self) -> bool {
        !self.fit.is_empty() && !self.config.area_only
    }

    /// Whether what comes from `start` is fitted to queries.
    fn fits_rays(&self, start: Start) -> bool {
        self.has_rays() && start.needs_rays()
    }

    /// Follows plans, as long as there is time; whether there was for all.
    fn attempt_all(&mut self, plans: Vec<Plan>) -> Result<bool, RecipeError> {
        for plan in plans {
            if !self.attempt(plan)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Gives the cheapest plans of a level that have not had it yet the effort of the next.
    fn deepen(&mut self, level: Level, most: usize) -> Result<bool, RecipeError> {
        let next = |plan: Plan| Plan { level: level.next(), ..plan };
        let is_new = |plan: &Plan| self.trials.iter().all(|trial| trial.plan != *plan);
        let deeper = self.cheapest(level, usize::MAX).into_iter().map(next).filter(is_new).take(most);
        self.attempt_all(deeper.collect())
    }

    /// Whether the input's own tree is a start: a tree of this width and not too deep to be walked node by node, without
    /// splits where there may be none.
    fn improves_input(&self) -> bool {
        let Statistics { depth, max_children, .. } = Statistics::of(self.input.tree);
        let fits = max_children <= self.config.shape.width && depth <= builder::MAX_DEPTH;
        fits && (self.config.cuts || !self.input.is_cut)
    }

    /// The plans of a level by cost, the cheapest first.
    fn cheapest(&self, level: Level, most: usize) -> Vec<Plan> {
        let mut of_level: Vec<&Trial> =
            self.trials.iter().filter(|trial| trial.plan.level == level).collect();
        of_level.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        of_level.iter().take(most).map(|trial| trial.plan).collect()
    }

    /// Seconds that a trial is expected to take: the longest of its level, or some times that of the level below.
    fn expected(&self, level: Level) -> f64 {
        let longest = |level: Level| {
            let seconds =
                self.trials.iter().filter(|trial| trial.plan.level == level).map(|trial| trial.seconds);
            seconds.fold(0.0, f64::max)
        };
        let known = longest(level);
        match level {
            _ if known > 0.0 => known,
            Level::Quick => 0.0,
            Level::Full => 3.0 * longest(Level::Quick),
            Level::Patient => 3.0 * longest(Level::Full).max(longest(Level::Quick)),
        }
    }

    /// Follows a plan, if there is time; whether there was.
    fn attempt(&mut self, plan: Plan) -> Result<bool, RecipeError> {
        let elapsed = self.started.elapsed().as_secs_f64();
        let first = self.trials.is_empty();
        let late = elapsed + self.expected(plan.level) > self.config.budget.as_secs_f64();
        if !first && (late || self.trials.len() >= self.config.trials) {
            return Ok(false);
        }
        let begun = Instant::now();
        let tree = self.follow(&plan)?;
        let cost = self.cost(&tree);
        let seconds = begun.elapsed().as_secs_f64();
        let number = self.trials.len();
        let is_area = !self.fits_rays(plan.start);
        if self.standing.wants(cost, is_area) {
            let candidate = self.candidate(number, tree, cost);
            self.standing.take(candidate, is_area);
        }
        self.trials.push(Trial { plan, cost, seconds });
        self.progress.advance(1);
        Ok(true)
    }

    /// The tree of a trial that costs the choosing queries `cost`.
    fn candidate(&self, number: usize, tree: Tree, cost: f64) -> Candidate {
        let confirmed = self.judged(tree.view(), &OcclusionOrder::First, &self.confirming);
        let [choosing, confirming] = [&self.choosing, &self.confirming].map(|queries| queries.len() as f64);
        let total = confirmed
            .all
            .map_or(cost, |other| (choosing * cost + confirming * other) / (choosing + confirming));
        Candidate { number, tree: Arc::new(tree), cost, confirmed, total }
    }

    /// Queries of a part: those whose numbers, mixed with the part's, are the least.
    fn part(&self, plan: &Plan) -> Vec<&Query> {
        let most = plan.level.queries().min(self.fit.len());
        if plan.part == 0 {
            return even(&self.fit, most);
        }
        // Where there are no others, most of them, but not all.
        let most = most.min((self.fit.len() * 9).div_ceil(10));
        let mut keys: Vec<(u64, usize)> = (0..self.fit.len())
            .map(|place| (mixed(plan.part.wrapping_mul(0x9E37_79B9).wrapping_add(place as u64)), place))
            .collect();
        keys.sort_unstable();
        keys.truncate(most);
        keys.sort_unstable_by_key(|&(_, place)| place);
        keys.into_iter().map(|(_, place)| self.fit[place]).collect()
    }

    fn follow(&self, plan: &Plan) -> Result<Tree, RecipeError> {
        let queries = if self.fits_rays(plan.start) { self.part(plan) } else { Vec::new() };
        let segments: Vec<Ray> = queries.iter().map(|query| query.segment).collect();
        let occlusion = |query: &&Query| {
            query.is_occlusion.then(|| Occlusion {
                ray: query.ray,
                mask: query.mask,
                rejects: query.rejects.clone(),
            })
        };
        let occlusions: Vec<Occlusion> = queries.iter().filter_map(occlusion).collect();
        let made;
        let tree = match plan.start {
            Start::Input => self.input.tree,
            Start::Built(heuristic, splits, count, alpha) => {
                let builder = builder::Config { count, alpha, ..builder::Config::of(splits) };
                let recipe = Recipe { heuristic, builder, stages: plan.level.stages(), budget: None };
                made = recipe.make(self.scene.triangles, &segments, &Progress::hidden())?.tree;
                made.view()
            }
        };
        let effort = Effort { rounds: plan.level.rounds(), deadline: None };
        let queries = Queries { segments: &segments, occlusions: &occlusions, share: self.share };
        Ok(finish(self.scene, tree, &queries, &self.config.shape, &effort)?)
    }

    /// Nanoseconds of a query that chooses; without any, of a random ray by area.
    fn cost(&self, tree: &Tree) -> f64 {
        let Shape { width, costs, .. } = &self.config.shape;
        let cost = self.judged(tree.view(), &OcclusionOrder::First, &self.choosing).all;
        cost.unwrap_or_else(|| area_cost(tree, &costs.mixed(*width, 0.0)))
    }

    fn judged(&self, tree: TreeView, order: &OcclusionOrder, queries: &[&Query]) -> Cost {
        judge(self.scene, tree, order, queries, &self.config.shape.costs)
    }

    /// The tree that stands, and what is to be expected of it.
    fn end(self) -> Result<Chosen, RecipeError> {
        let before = self.judged(self.input.tree, &self.input.order, &self.confirming);
        let judged = !self.choosing.is_empty();
        let judges = [self.choosing.len(), self.confirming.len()];
        let (chosen, area) = self.standing.end().ok_or(RecipeError::NoRays("auto"))?;
        let Candidate { number: winner, tree, confirmed: after, .. } = chosen;
        let plan = self.trials[winner].plan;
        Ok(Chosen {
            tree: Arc::unwrap_or_clone(tree),
            plan,
            is_cut: plan.start.is_cut() || (plan.start == Start::Input && self.input.is_cut),
            winner: judged.then_some(winner),
            before,
            area,
            after,
            judges,
            trials: self.trials,
        })
    }
}

/// What a random ray that meets the root costs, by area.
fn area_cost(tree: &Tree, constants: &Constants) -> f64 {
    let area = |node: &Node| f64::from(node.bounds().area());
    let whole = area(&tree.nodes[0]).max(f64::MIN_POSITIVE);
    let cost = |node: &Node| {
        let own = if node.is_leaf() {
            constants.leaf + constants.block * node.len().div_ceil(4) as f64
        } else {
            constants.visit
        };
        area(node) / whole * own
    };
    tree.nodes.iter().map(cost).sum()
}

/// Most children of a node of a tree that `input` is to be replaced by: as many as its own have, two to eight.
pub fn width_of(input: TreeView) -> usize {
    Statistics::of(input).max_children.clamp(2, 8)
}
