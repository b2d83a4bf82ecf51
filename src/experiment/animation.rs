//! Trees for moving scenes (section 2.5): what each way to bring a tree to the next frame takes, and what the frame's queries then cost.
//!
//! Data flows so: frames are loaded one after the other; each [`Method`] keeps a tree of its own and brings it to the frame with the rays of the frame
//! *before*; then queries of the frame that no tree was made from are asked. Trees for the whole animation are made before, from a few key frames.

mod results;

use super::measure::area_tree;
use super::scenes::TRAINING;
use super::trace::{Query, Trace, part, prepared, t_r};
use super::{ExperimentError, Settings};
use crate::builder::{Config, Splits};
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Ray, Triangle};
use crate::optimize::frames::Frames;
use crate::optimize::measure::{AreaMeasure, Estimate, Measure, RayMeasure};
use crate::optimize::{self, Stage, reinsertion};
use crate::progress::Progress;
use crate::recipe::{Heuristic, Recipe};
use crate::replay::check::{Judge, Verdict};
use crate::traverse::{Counts, Masks, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::Tree;
use crate::tree::statistics::sah_cost;
use crate::update::Moving;
use crate::update::policy::{self, MOST_RAYS, Policy, State};
use rayon::prelude::*;
pub use results::{figure, markdown, write_csv};
use std::time::Instant;

/// Frames that a tree for the whole animation is made from, evenly spread.
const KEYS: usize = 4;

/// By how much a ray may become more expensive before a tree is rebuilt.
const LIMIT: f64 = 1.2;

/// How a tree gets from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    Step(policy::Method),
    /// Refitted, and rebuilt when a recorded ray has become 1.2 times as expensive.
    RefitUntil,
    /// Rotated, and rebuilt likewise.
    RotateUntil,
    /// One tree for all frames by area (T-SAH), refitted.
    OneByArea,
    /// One tree for all frames by rays recorded in some of them, refitted.
    OneByRays,
}

impl Method {
    pub const ALL: [Method; 8] = [
        Method::Step(policy::Method::Rebuild),
        Method::Step(policy::Method::Refit),
        Method::Step(policy::Method::Rotate),
        Method::Step(policy::Method::RotateByRays),
        Method::RefitUntil,
        Method::RotateUntil,
        Method::OneByArea,
        Method::OneByRays,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Method::Step(method) => method.name(),
            Method::RefitUntil => "refit or rebuild",
            Method::RotateUntil => "rotate or rebuild",
            Method::OneByArea => "one tree by area",
            Method::OneByRays => "one tree by rays",
        }
    }

    fn policy(self) -> Policy {
        let recipe = Recipe {
            heuristic: Heuristic::Sah,
            builder: Config::default(),
            stages: Vec::new(),
            budget: None,
        };
        let (method, limit) = match self {
            Method::Step(method) => (method, None),
            Method::RefitUntil => (policy::Method::Refit, Some(LIMIT)),
            Method::RotateUntil => (policy::Method::Rotate, Some(LIMIT)),
            Method::OneByArea | Method::OneByRays => (policy::Method::Refit, None),
        };
        Policy { method, limit, recipe }
    }
}

/// One method on one frame; the first frame is only where trees start.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub frame: usize,
    pub method: Method,
    /// Wall-clock seconds that the step took, on the threads of the current rayon pool.
    pub update_seconds: f64,
    pub rebuilt: bool,
    pub rotations: u64,
    pub sah_cost: f64,
    pub queries: u64,
    /// Per query, depth first.
    pub box_tests: f64,
    pub primitive_tests: f64,
    /// T_R per query.
    pub t_r: f64,
    /// Of one thread.
    pub seconds_per_query: f64,
    pub mismatches: u64,
}

impl Row {
    /// Box and primitive tests per query.
    pub fn tests(&self) -> f64 {
        self.box_tests + self.primitive_tests
    }
}

/// A frame, its queries parted by pixel.
struct Frame {
    trace: Trace,
    training: Vec<Ray>,
    held_out: Vec<Query>,
}

impl Frame {
    fn new(trace: Trace, seed: u64) -> Result<Frame, ExperimentError> {
        let (training, held_out) = part(&trace.queries, TRAINING, seed)?;
        let training = training.iter().map(|query| query.record.effective_segment()).collect();
        Ok(Frame { trace, training, held_out })
    }
}

/// What [`run`] advances its progress by.
pub fn steps(count: usize) -> u64 {
    (count.saturating_sub(1) * Method::ALL.len()) as u64
}

/// Runs every method over `count` frames, which `load` reads by number.
///
/// # Errors
/// What `load` says; when frames are not of one mesh.
pub fn run<E: From<ExperimentError>>(
    count: usize,
    load: impl Fn(usize) -> Result<Trace, E>,
    settings: &Settings,
    progress: &Progress,
) -> Result<Vec<Row>, E> {
    let load = |number: usize| Ok::<_, E>(Frame::new(load(number)?, settings.seed)?);
    let first = load(0)?;
    let start = area_tree(&first.trace.triangles, &Config::default()).map_err(ExperimentError::from)?;
    let mut states = Vec::new();
    for method in Method::ALL {
        let tree = match method {
            Method::OneByArea | Method::OneByRays => one_tree(count, &load, method == Method::OneByRays)?,
            _ => start.clone(),
        };
        states.push((method, State::new(&tree).map_err(ExperimentError::from)?));
    }
    let (mut before, mut rows) = (first, Vec::new());
    for number in 1..count {
        let frame = load(number)?;
        Moving::check_frame(&before.trace.triangles, &frame.trace.triangles)
            .map_err(|error| ExperimentError::Frame(number, error))?;
        for (method, state) in &mut states {
            let started = Instant::now();
            let step = method.policy().step(state, &frame.trace.triangles, &before.training);
            let step = step.map_err(ExperimentError::from)?;
            let update_seconds = started.elapsed().as_secs_f64();
            let tree = state.moving.tree();
            rows.push(Row {
                frame: number,
                method: *method,
                update_seconds,
                rebuilt: step.rebuilt,
                rotations: step.rotations,
                ..asked(tree, &frame)
            });
            progress.advance(1);
        }
        before = frame;
    }
    Ok(rows)
}

/// What the held-out queries of a frame cost, and whether every answer is right.
fn asked(tree: &Tree, frame: &Frame) -> Row {
    let prepared = prepared(tree, &frame.trace);
    let judge = Judge {
        tree: tree.view(),
        triangles: &frame.trace.triangles,
        masks: Masks::new(&frame.trace.geometries),
        flattened: false,
    };
    let ask = |queries: &[Query]| {
        let (mut counts, mut scratch, mut mismatches) = (Counts::default(), Scratch::default(), 0u64);
        for query in queries {
            let (ray, candidates) = (query.record.ray_among_triangles(), query.candidates());
            let prepared_ray = PreparedRay::new(&ray);
            let answer = if query.record.is_occlusion() {
                prepared.occluder(Traversal::Odf, &prepared_ray, &candidates, &mut counts, &mut scratch)
            } else {
                prepared.closest_hit(Traversal::Odf, &prepared_ray, &candidates, &mut counts, &mut scratch)
            };
            let verdict = judge.judge(&query.record, &ray, answer, &candidates);
            mismatches += u64::from(verdict == Verdict::Mismatch);
        }
        (counts, mismatches)
    };
    let add = |mut a: (Counts, u64), b: (Counts, u64)| {
        a.0 += b.0;
        (a.0, a.1 + b.1)
    };
    let (counts, mismatches) =
        frame.held_out.par_chunks(4096).map(ask).reduce(|| (Counts::default(), 0), add);
    let queries = frame.held_out.len();
    let mean = |total: u64| total as f64 / queries.max(1) as f64;
    Row {
        frame: 0,
        method: Method::OneByArea,
        update_seconds: 0.0,
        rebuilt: false,
        rotations: 0,
        sah_cost: sah_cost(tree.view(), 1.0, 1.0),
        queries: queries as u64,
        box_tests: mean(counts.box_tests),
        primitive_tests: mean(counts.primitive_tests),
        t_r: mean(t_r(&prepared, &frame.held_out)),
        seconds_per_query: timed(&prepared, &frame.held_out),
        mismatches,
    }
}

/// Seconds per query of one thread, nobody counting; the least of three.
fn timed(prepared: &Prepared, queries: &[Query]) -> f64 {
    let mut scratch = Scratch::default();
    let mut once = || {
        let started = Instant::now();
        for query in queries {
            let (ray, candidates) =
                (PreparedRay::new(&query.record.ray_among_triangles()), query.candidates());
            let found = if query.record.is_occlusion() {
                prepared.occluder(Traversal::Odf, &ray, &candidates, &mut (), &mut scratch)
            } else {
                prepared.closest_hit(Traversal::Odf, &ray, &candidates, &mut (), &mut scratch)
            };
            std::hint::black_box(found);
        }
        started.elapsed().as_secs_f64()
    };
    let least = [once(), once(), once()].into_iter().fold(f64::INFINITY, f64::min);
    least / queries.len().max(1) as f64
}

/// A tree that is good for the key frames together, with the boxes of the first frame.
fn one_tree<E: From<ExperimentError>>(
    count: usize,
    load: &impl Fn(usize) -> Result<Frame, E>,
    by_rays: bool,
) -> Result<Tree, E> {
    let mut keys = Vec::with_capacity(KEYS);
    for key in 0..KEYS {
        keys.push(load(key * (count - 1) / (KEYS - 1))?);
    }
    let config = Config { splits: Splits::Sweep, ..Config::default() };
    let mut tree = area_tree(&keys[0].trace.triangles, &config).map_err(ExperimentError::from)?;
    let scenes: Vec<PaddedAabb> = keys.iter().map(|key| scene(&key.trace.triangles)).collect();
    let triangles: [&[Triangle]; KEYS] = std::array::from_fn(|key| &keys[key].trace.triangles[..]);
    if by_rays {
        let measures = std::array::from_fn::<_, KEYS, _>(|key| {
            let rays = &keys[key].training;
            let few: Vec<Ray> = rays.iter().step_by(rays.len().div_ceil(MOST_RAYS).max(1)).copied().collect();
            RayMeasure::new(&few, Estimate::default(), &scenes[key])
        });
        improve(&mut tree, Frames::new(measures, triangles))?;
    } else {
        let measures = std::array::from_fn::<_, KEYS, _>(|key| AreaMeasure::new(&scenes[key]));
        improve(&mut tree, Frames::new(measures, triangles))?;
    }
    Ok(tree)
}

fn scene(triangles: &[Triangle]) -> PaddedAabb {
    let finite = triangles.iter().filter(|triangle| triangle.is_finite());
    finite.fold(Aabb::EMPTY, |sum, triangle| sum.union(&triangle.bounds())).into()
}

fn improve(tree: &mut Tree, measure: impl Measure) -> Result<(), ExperimentError> {
    let stages = vec![Stage::Reinsertion(reinsertion::Config::default())];
    optimize::run(tree, &measure, &optimize::Config { stages, deadline: None }, &Progress::hidden())?;
    Ok(())
}
