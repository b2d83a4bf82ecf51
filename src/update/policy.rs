//! What a program does with its tree from frame to frame.
//!
//! [`Policy::step`] takes the triangles of the next frame and, where there are any, the effective segments of the queries of the frame before; it
//! changes the tree in the way that the policy says. A policy with a limit rebuilds when the cost per recorded ray has grown by that factor since the
//! last build: boxes that a ray's segment overlaps where there are rays, T by area where there are none.

use super::{Moving, UpdateError};
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Ray, Triangle};
use crate::optimize::measure::{Estimate, RayMeasure};
use crate::optimize::{self, OptimizeError, Stage, rotations};
use crate::progress::Progress;
use crate::recipe::{Recipe, RecipeError};
use crate::traverse::{Prepared, PreparedRay, Scratch};
use crate::tree::Tree;
use crate::tree::statistics::sah_cost;
use rayon::prelude::*;
use thiserror::Error;

/// Rays that are asked what the tree costs, and that rotations are chosen by: evenly chosen when there are more.
pub const MOST_RAYS: usize = 4096;

/// How a tree is brought to the next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// New boxes.
    Refit,
    /// New boxes, and a pass of rotations that shrink areas.
    Rotate,
    /// New boxes, and rotations that lower P as recorded rays and area say, until there is none.
    RotateByRays,
    /// Another tree.
    Rebuild,
}

impl Method {
    pub const ALL: [Method; 4] = [Method::Refit, Method::Rotate, Method::RotateByRays, Method::Rebuild];

    pub fn name(self) -> &'static str {
        match self {
            Method::Refit => "refit",
            Method::Rotate => "rotate",
            Method::RotateByRays => "rotate-by-rays",
            Method::Rebuild => "rebuild",
        }
    }
}

/// A method, and when not to use it.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    pub method: Method,
    /// Rebuild when the cost has grown by this factor since the last build.
    pub limit: Option<f64>,
    /// How trees are built.
    pub recipe: Recipe,
}

/// A tree on its way from frame to frame.
#[derive(Clone, Debug)]
pub struct State {
    pub moving: Moving,
    /// The cost per ray after the last build, if it was asked for.
    pub cost_when_built: Option<f64>,
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    pub rebuilt: bool,
    pub rotations: u64,
    /// The cost per ray of the frame before, over the new triangles; only where a limit asks for it.
    pub cost: Option<f64>,
}

/// Why a step was not possible.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PolicyError {
    #[error(transparent)]
    Update(#[from] UpdateError),
    #[error(transparent)]
    Build(#[from] RecipeError),
    #[error(transparent)]
    Optimize(#[from] OptimizeError),
    #[error("rotations by rays need the recording of the frame before: give it with --rays")]
    NoRays,
}

impl State {
    /// A tree as it was built, or as it was left.
    ///
    /// # Errors
    /// See [`Moving::new`].
    pub fn new(tree: &Tree) -> Result<State, UpdateError> {
        Ok(State { moving: Moving::new(tree.view())?, cost_when_built: None })
    }
}

impl Policy {
    /// Brings the tree to the frame whose triangles are given. `rays` are effective segments of the frame before; none for area.
    ///
    /// # Errors
    /// When the tree cannot follow, or nothing can be built.
    pub fn step(&self, state: &mut State, triangles: &[Triangle], rays: &[Ray]) -> Result<Step, PolicyError> {
        let rays = thinned(rays);
        if self.limit.is_some() && state.cost_when_built.is_none() {
            // Over the triangles of the frame before: the boxes are still those.
            state.cost_when_built = Some(cost(state.moving.tree(), triangles, &rays));
        }
        let mut step = Step::default();
        match self.method {
            Method::Rebuild => return self.rebuild(state, triangles, &rays, step),
            Method::Refit => state.moving.refit(triangles),
            Method::Rotate => {
                state.moving.check_binary()?;
                step.rotations = state.moving.rotate(triangles) as u64;
            }
            Method::RotateByRays => {
                state.moving.refit(triangles);
                step.rotations = rotate_by_rays(&mut state.moving, &rays)?;
            }
        }
        if let Some((limit, built)) = self.limit.zip(state.cost_when_built) {
            let now = cost(state.moving.tree(), triangles, &rays);
            step.cost = Some(now);
            if now > limit * built {
                return self.rebuild(state, triangles, &rays, step);
            }
        }
        Ok(step)
    }

    fn rebuild(
        &self,
        state: &mut State,
        triangles: &[Triangle],
        rays: &[Ray],
        step: Step,
    ) -> Result<Step, PolicyError> {
        let made = self.recipe.make(triangles, rays, &Progress::hidden())?;
        *state = State::new(&made.tree)?;
        if self.limit.is_some() {
            state.cost_when_built = Some(cost(&made.tree, triangles, rays));
        }
        Ok(Step { rebuilt: true, ..step })
    }
}

/// At most [`MOST_RAYS`], evenly chosen.
fn thinned(rays: &[Ray]) -> Vec<Ray> {
    rays.iter().step_by(rays.len().div_ceil(MOST_RAYS).max(1)).copied().collect()
}

/// Boxes per ray that it overlaps, or T by area. Only boxes are looked at, so `triangles` may be those of another frame.
fn cost(tree: &Tree, triangles: &[Triangle], rays: &[Ray]) -> f64 {
    if rays.is_empty() {
        // Two box tests an inner node.
        return 0.5 * sah_cost(tree.view(), 1.0, 0.0);
    }
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let count = |rays: &[Ray]| {
        let mut scratch = Scratch::default();
        rays.iter().map(|ray| prepared.overlapped(&PreparedRay::new(ray), &mut scratch)).sum::<usize>()
    };
    let all: usize = rays.par_chunks(256).map(count).sum();
    all as f64 / rays.len() as f64
}

/// Rotations until none lowers P, which rays and area estimate together.
fn rotate_by_rays(moving: &mut Moving, rays: &[Ray]) -> Result<u64, PolicyError> {
    if rays.is_empty() {
        return Err(PolicyError::NoRays);
    }
    let mut tree = moving.tree().clone();
    let scene = PaddedAabb::from(tree.nodes[0].bounds());
    let measure = RayMeasure::new(rays, Estimate::default(), &scene);
    let config =
        optimize::Config { stages: vec![Stage::Rotations(rotations::Config::default())], deadline: None };
    let report = optimize::run(&mut tree, &measure, &config, &Progress::hidden())?;
    *moving = Moving::new(tree.view())?;
    Ok(report.stages.iter().flat_map(|stage| &stage.steps).map(|step| step.moves).max().unwrap_or(0))
}
