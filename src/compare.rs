//! Trees over the same recorded queries: what each costs, whether each answers right, and how they relate to the first.
//!
//! One tree at a time is prepared and replayed, over one recording after the other, so memory holds one prepared tree,
//! whatever the number of trees. Embree's kernels ([`kernels`]) and the clock ([`timing`]) come after that, with all trees in memory.

pub mod baseline;
pub mod cost;
pub mod explained;
pub mod fit;
pub mod kernels;
pub mod limit;
pub mod reports;
pub mod timing;
mod verdict;

use crate::format::FormatError;
use crate::format::bvh::{Bvh, flag};
use crate::format::rays::{ChunkEntry, NO_DEPTH, Rays};
use crate::progress::Progress;
use crate::ranks::{RankFailed, Ranks, Share, merge_all};
use crate::replay::check::Judge;
use crate::replay::pixels::ImageSize;
use crate::replay::profile::Levels;
use crate::replay::query::Choice;
use crate::replay::scene::{self, SceneError, Scenes};
use crate::replay::sort::Sort;
use crate::replay::tally::Costs;
use crate::replay::{self, Outcome};
use crate::traverse::{Masks, OcclusionOrder, OrderError, OrderName, Prepared, Traversal};
use crate::tree::epo::end_point_overlap;
use crate::tree::statistics::{Statistics, sah_cost};
use baseline::Baseline;
use kernels::{AnswersOnTrees, EmbreeScenes, Kernels, Wanted};
use std::time::{Duration, Instant};
use thiserror::Error;
use timing::Timing;
pub use verdict::Allowed;

/// A tree to compare, and what to call it.
pub struct Candidate<'a> {
    pub path: String,
    pub bvh: &'a Bvh<'a>,
}

/// A recording to replay, and what to call it.
pub struct Recording<'a> {
    pub path: String,
    pub rays: &'a Rays<'a>,
    /// Number of the scene that the trees are of; see [`check_scenes`].
    pub scene: u16,
    /// Size of the traced image, where it is known.
    pub image: Option<ImageSize>,
}

/// How to compare.
#[derive(Clone, Debug)]
pub struct Settings {
    /// In this order; at least one.
    pub traversals: Vec<Traversal>,
    /// Of depth-first occlusion queries; `None` is what each tree has recorded, else nearest first.
    pub occlusion_order: Option<OrderName>,
    pub costs: Costs,
    /// What visits, leaves and blocks take, for the cost that is reported first.
    pub machine: crate::cost::Costs,
    /// What trees are held to, in place of the first one.
    pub baseline: Option<Baseline>,
    /// Answers that are not as recorded, and no failure.
    pub allowed: Allowed,
    /// Of each recording, whose own scene it is.
    pub choice: Choice,
    /// Whether to sum costs per pixel, of recordings whose image's size is known.
    pub pixels: bool,
    /// Queries of a chunk and of one kind, depth and purpose are sorted before they are asked.
    pub sort: Option<Sort>,
    /// They are asked in packets of so many queries, not one by one.
    pub packet: Option<usize>,
    /// Whether to count tests by level of the tree, and cache lines: every query is followed once more, alone. Not for packets.
    pub profile: bool,
    /// Embree's own kernels are asked on each tree, too: which. By one rank alone only.
    pub kernels: Option<Wanted>,
    /// Whether they are also asked for their answers, which are checked; without this, they are only timed.
    pub answers: bool,
    /// Rounds of timing, after all that; `None` when times are not wanted.
    pub rounds: Option<u32>,
    /// Time that all of measuring may take: fewer queries are timed, or none, where all would take longer. `None`: however long it takes.
    pub budget: Option<Duration>,
    /// Whether to fit costs to the times.
    pub fit: bool,
}

/// A tree without any ray.
#[derive(Debug)]
pub struct TreeFacts {
    pub path: String,
    pub producer: String,
    /// Whether it is the one that a program's Embree traversed, and instances in it were flattened.
    pub is_live: bool,
    pub is_flattened: bool,
    /// `META`: how it was built.
    pub meta: Option<String>,
    pub fingerprint: u64,
    pub triangles: usize,
    pub statistics: Statistics,
    /// Whether every inner node has two children, so that it is traversed as such.
    pub binary: bool,
    pub sah_cost: f64,
    /// See [`crate::tree::epo`].
    pub epo: f64,
    /// In which its occlusion queries are followed, depth first.
    pub occlusion_order: OrderName,
}

/// One traversal of one tree.
#[derive(Debug)]
pub struct Run {
    pub traversal: Traversal,
    pub outcome: Outcome,
}

/// One tree over one recording.
#[derive(Debug)]
pub struct TreeResult {
    pub runs: Vec<Run>,
    /// Which of the runs also counted P_R.
    overlap_run: usize,
}

impl TreeResult {
    /// The tallies that hold P_R.
    pub fn overlap(&self) -> &Outcome {
        &self.runs[self.overlap_run].outcome
    }

    /// T_R: inner nodes that effective segments overlap, summed over queries.
    pub fn t_r(&self) -> u64 {
        self.overlap().tallies.total.overlap.inner
    }

    /// Γ_R, see [`Costs::expected`].
    pub fn gamma(&self, costs: &Costs) -> f64 {
        let total = &self.overlap().tallies.total;
        costs.expected(total.queries, &total.overlap)
    }

    /// See [`crate::replay::tally::Tally::leaf_count_variability`].
    pub fn leaf_count_variability(&self) -> f64 {
        self.overlap().tallies.total.leaf_count_variability()
    }
}

/// All trees over one recording.
#[derive(Debug)]
pub struct RecordingResult {
    pub path: String,
    pub producer: String,
    /// 0 when the recording does not say.
    pub fingerprint: u64,
    /// 31305 for 3.13.5; 0 when not recorded from Embree.
    pub embree_version: u32,
    /// Whether the program's filters refused hits.
    pub has_filters: bool,
    /// Number of the scene that was replayed.
    pub scene: u16,
    /// In the file, before any filter.
    pub queries: u64,
    pub image: Option<ImageSize>,
    /// As [`Comparison::trees`].
    pub trees: Vec<TreeResult>,
    /// Of Embree's kernels, where there are any.
    pub kernels: Option<AnswersOnTrees>,
    /// When it was asked for.
    pub timing: Option<Timing>,
}

/// Trees and recordings in the order given, at least one of each.
#[derive(Debug)]
pub struct Comparison {
    pub settings: Settings,
    pub trees: Vec<TreeFacts>,
    /// Embree's kernels where they were asked for, or why Embree has no such scene.
    pub kernels: Option<Result<Kernels, String>>,
    /// Why times, or those of Embree's kernels, were not measured, where it was left open whether to.
    pub left_out: Option<String>,
    pub recordings: Vec<RecordingResult>,
}

impl Comparison {
    /// Every tree over every recording.
    pub fn results(&self) -> impl Iterator<Item = (&RecordingResult, &TreeFacts, &TreeResult)> {
        self.recordings.iter().flat_map(|recording| {
            self.trees.iter().zip(&recording.trees).map(move |(tree, result)| (recording, tree, result))
        })
    }
}

/// Why trees and rays cannot be compared.
#[derive(Debug, Error)]
pub enum CompareError {
    #[error(
        "{path}: the tree is of scene {found:016x}, but {other} is of scene {expected:016x}; give trees and rays of one scene"
    )]
    OtherScene { path: String, found: u64, other: String, expected: u64 },
    #[error("{path}: {source}")]
    Scene { path: String, source: SceneError },
    #[error("{path}: {source}")]
    File { path: String, source: FormatError },
    #[error("{path}: {source}")]
    Order { path: String, source: OrderError },
    #[error("{path}: no query is left to replay{why}")]
    NoQueries { path: String, why: &'static str },
    #[error("Embree: {0}")]
    Embree(String),
    #[error("there is no thread to measure times on: {0}")]
    Thread(std::io::Error),
    #[error("{0}")]
    Rank(#[from] RankFailed),
}

/// Checks that all belong to one scene. Returns its number in the recording, and a warning when the
/// rays do not say to which they belong.
///
/// # Errors
/// Naming both fingerprints, or both numbers; see also [`Scenes::of_trees`].
pub fn check_scenes(
    trees: &[Candidate],
    rays_path: &str,
    rays: &Rays,
    asked: Option<u16>,
) -> Result<(u16, Option<String>), CompareError> {
    let recorded = rays.header.fingerprint;
    let (other, expected) = match trees.first() {
        Some(first) if recorded == 0 => (first.path.clone(), first.bvh.header.fingerprint),
        _ => (rays_path.to_owned(), recorded),
    };
    for tree in trees {
        let found = tree.bvh.header.fingerprint;
        if found != expected {
            return Err(CompareError::OtherScene { path: tree.path.clone(), found, other, expected });
        }
    }
    let scenes = Scenes::of(rays);
    let of_trees: Vec<&Bvh> = trees.iter().map(|tree| tree.bvh).collect();
    let number = scenes
        .of_trees(&of_trees, asked)
        .map_err(|source| CompareError::Scene { path: rays_path.to_owned(), source })?;
    // Of several scenes no fingerprint can be said, and a tree that names its own is taken at its
    // word.
    let is_named = scenes.numbers.len() > 1 && of_trees.iter().all(|bvh| scene::named(bvh).is_some());
    let warning = (recorded == 0 && !is_named).then(|| {
        format!("{rays_path}: does not say of which scene it is (fingerprint 0); it is taken to be of these trees'")
    });
    Ok((number, warning))
}

/// Replays every recording over every tree in every order. The caller has called [`check_scenes`].
///
/// Each of the `ranks` replays its share of the chunks, and each gets the whole comparison; times are measured by one rank alone only.
///
/// # Errors
/// When a file is damaged, no query of a recording is left, or another rank fails.
pub fn compare(
    trees: &[Candidate],
    recordings: &[Recording],
    settings: Settings,
    ranks: &dyn Ranks,
    progress: &Progress,
) -> Result<Comparison, CompareError> {
    // RayOrder's own answers end the segments that it is held to.
    let overlap_run = settings.traversals.iter().position(|&t| t == Traversal::RayOrder).unwrap_or(0);
    let mut facts = Vec::with_capacity(trees.len());
    let mut results: Vec<RecordingResult> = recordings.iter().map(RecordingResult::new).collect();
    for Candidate { path, bvh } in trees {
        bvh.verify().map_err(|source| CompareError::File { path: path.clone(), source })?;
        let order = OcclusionOrder::new(settings.occlusion_order, bvh.tree, bvh.order)
            .map_err(|source| CompareError::Order { path: path.clone(), source })?;
        let prepared = Prepared::new(bvh.tree, bvh.triangles, bvh.geometries);
        facts.push(TreeFacts::of(path, bvh, &prepared, &settings.costs, order.name()));
        let judge = Judge {
            tree: bvh.tree,
            triangles: bvh.triangles,
            masks: Masks::new(bvh.geometries),
            flattened: bvh.header.flags & flag::FLATTENED != 0,
        };
        let levels = (settings.profile && settings.packet.is_none()).then(|| Levels::of(bvh.tree));
        for (recording, result) in recordings.iter().zip(&mut results) {
            let mut runs = Vec::with_capacity(settings.traversals.len());
            for (index, &traversal) in settings.traversals.iter().enumerate() {
                let options = replay::Options {
                    traversal,
                    occlusion_order: order.clone(),
                    choice: Choice { scene: recording.scene, ..settings.choice.clone() },
                    overlap: index == overlap_run,
                    costs: settings.costs,
                    sort: settings.sort,
                    packet: settings.packet,
                    profile: levels.as_ref(),
                    image: recording.image.filter(|_| settings.pixels),
                };
                runs.push(Run {
                    traversal,
                    outcome: replay_all(recording, &prepared, &judge, &options, ranks, progress)?,
                });
            }
            result.trees.push(TreeResult { runs, overlap_run });
        }
    }
    let started = Instant::now();
    let (mut scenes, mut left_out) = scenes(trees, &settings);
    if let Some(Ok(scenes)) = scenes.as_mut().filter(|_| settings.answers) {
        for (recording, result) in recordings.iter().zip(&mut results) {
            result.kernels = Some(scenes.answers(trees, recording, &settings.choice, progress)?);
        }
    }
    if let Some(rounds) = settings.rounds {
        let scenes = scenes.as_mut().and_then(|scenes| scenes.as_mut().ok());
        let budget = settings.budget.map(|budget| budget.saturating_sub(started.elapsed()));
        let replayed = (recordings, &results[..]);
        let timings = timing::time(trees, replayed, &settings, (rounds, budget), scenes)?;
        for (result, timing) in results.iter_mut().zip(timings) {
            match timing {
                Ok(timing) => result.timing = Some(timing),
                Err(why) => left_out = Some(why),
            }
        }
    }
    let kernels = scenes.map(|scenes| scenes.map(|scenes| scenes.kernels().clone()));
    Ok(Comparison { settings, trees: facts, kernels, left_out, recordings: results })
}

/// Seconds for each triangle of a scene, once and for each tree that is planted, that are allowed for before Embree's kernels can be timed.
const SECONDS_A_TRIANGLE: f64 = 1e-6;

/// Embree's scenes where they are wanted, or why there are none; where it was left open whether to ask Embree, that is no more than a line.
fn scenes(
    trees: &[Candidate],
    settings: &Settings,
) -> (Option<Result<EmbreeScenes, String>>, Option<String>) {
    let Some(wanted) = settings.kernels else { return (None, None) };
    let Some(budget) = settings.budget.filter(|_| !settings.answers) else {
        return (Some(EmbreeScenes::of(trees, wanted)), None);
    };
    // Its own two trees, of which one takes a multiple of the other.
    let times = 3 + trees.len();
    let expected = (trees[0].bvh.triangles.len() * times) as f64 * SECONDS_A_TRIANGLE;
    let found = if expected > budget.as_secs_f64() / 2.0 {
        Err(format!("its trees and planting would take {expected:.0} s or more"))
    } else {
        EmbreeScenes::of(trees, wanted)
    };
    match found {
        Ok(scenes) => (Some(Ok(scenes)), None),
        Err(why) => (None, Some(format!("No times of Embree's kernels, which --time measures: {why}."))),
    }
}

/// Replays one recording, of which at least one query has to be left.
fn replay_all(
    Recording { path, rays, .. }: &Recording,
    prepared: &Prepared,
    judge: &Judge,
    options: &replay::Options,
    ranks: &dyn Ranks,
    progress: &Progress,
) -> Result<Outcome, CompareError> {
    let own = replay::replay_share(prepared, judge, rays, options, Share::of(ranks), progress)
        .map_err(|source| CompareError::File { path: path.clone(), source })?;
    let outcome = merge_all(ranks, own, Outcome::merge)?;
    if outcome.tallies.total.queries == 0 {
        let why = if rays.query_count() == 0 {
            "; the recording is empty"
        } else {
            "; --filter, --held-out or --sample leave none"
        };
        return Err(CompareError::NoQueries { path: path.clone(), why });
    }
    Ok(outcome)
}

impl TreeFacts {
    fn of(
        path: &str,
        bvh: &Bvh,
        prepared: &Prepared,
        costs: &Costs,
        occlusion_order: OrderName,
    ) -> TreeFacts {
        let Costs { c_i, c_p } = *costs;
        TreeFacts {
            path: path.to_owned(),
            producer: bvh.header.producer.clone(),
            is_live: bvh.header.flags & flag::LIVE != 0,
            is_flattened: bvh.header.flags & flag::FLATTENED != 0,
            meta: bvh.meta.map(str::to_owned),
            fingerprint: bvh.header.fingerprint,
            triangles: bvh.triangles.len(),
            statistics: bvh.statistics,
            binary: prepared.is_binary(),
            sah_cost: sah_cost(bvh.tree, c_i, c_p),
            epo: end_point_overlap(bvh.tree, bvh.triangles, c_i, c_p),
            occlusion_order,
        }
    }
}

impl RecordingResult {
    fn new(recording: &Recording) -> RecordingResult {
        let header = &recording.rays.header;
        RecordingResult {
            path: recording.path.clone(),
            producer: header.producer.clone(),
            fingerprint: header.fingerprint,
            embree_version: header.embree_version,
            has_filters: {
                let own = |chunk: &&ChunkEntry| chunk.info.scene == recording.scene;
                recording.rays.chunks().iter().filter(own).any(|chunk| chunk.rejects > 0)
            },
            scene: recording.scene,
            queries: recording.rays.query_count(),
            image: recording.image,
            trees: Vec::new(),
            kernels: None,
            timing: None,
        }
    }
}

/// The size of the image that a tree's recording traced: `META`'s key `image`, [width, height].
pub fn image_size(bvh: &Bvh) -> Option<ImageSize> {
    let meta: serde_json::Value = serde_json::from_str(bvh.meta?).ok()?;
    let [width, height] = meta.get("image")?.as_array()?.as_slice() else { return None };
    let number = |value: &serde_json::Value| u32::try_from(value.as_u64()?).ok();
    ImageSize::new(number(width)?, number(height)?).ok()
}

/// `value` / `first`; 1 when both are 0.
pub fn relative(value: f64, first: f64) -> f64 {
    if value == first { 1.0 } else { value / first }
}

/// The name of a kind in tables, JSON and CSV.
pub fn kind_name(kind: u8) -> &'static str {
    if kind == crate::format::rays::kind::OCCLUSION { "occlusion" } else { "closest_hit" }
}

/// The name of a depth in tables, JSON and CSV.
pub fn depth_name(depth: u8) -> String {
    if depth == NO_DEPTH { "unknown".to_owned() } else { depth.to_string() }
}
