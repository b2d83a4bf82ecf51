//! Trees over the same recorded queries: what each costs, whether each answers right, and how they relate to the first.
//!
//! One tree at a time is prepared and replayed, so memory holds one prepared tree, whatever the number of trees.

use crate::format::FormatError;
use crate::format::bvh::{Bvh, flag};
use crate::format::rays::{NO_DEPTH, NO_PATH, Purpose, Rays, Record};
use crate::progress::Progress;
use crate::replay::check::{Judge, T_TOLERANCE};
use crate::replay::pixels::ImageSize;
use crate::replay::select::{Filter, Portion};
use crate::replay::tally::Tally;
use crate::replay::{self, Mismatch, Outcome};
use crate::traverse::{Masks, OcclusionOrder, OrderError, OrderName, Overlap, Prepared, Traversal};
use crate::tree::statistics::{Statistics, sah_cost};
use std::fmt::Write;
use thiserror::Error;

/// Weights of Γ_R and of the SAH cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// Of a box test.
    pub c_i: f64,
    /// Of a primitive test.
    pub c_p: f64,
}

impl Costs {
    /// Γ as measured: `c_i` · box tests + `c_p` · primitive tests.
    pub fn gamma(&self, tally: &Tally) -> f64 {
        self.c_i * tally.counts.box_tests as f64 + self.c_p * tally.counts.primitive_tests as f64
    }

    /// Γ_R of a tree: what strictly front-to-back traversal of every effective segment costs,
    /// `c_i` · (queries + Σ P_R(b) · children of b) + `c_p` · Σ P_R(l) · primitives of l.
    ///
    /// The paper's section 2.3 with the root's box test added, and for any number of children and primitives.
    pub fn expected(&self, queries: u64, overlap: &Overlap) -> f64 {
        self.c_i * (queries + overlap.children) as f64 + self.c_p * overlap.primitives as f64
    }
}

/// A tree to compare, and what to call it.
pub struct Candidate<'a> {
    pub path: String,
    pub bvh: &'a Bvh<'a>,
}

/// How to compare.
#[derive(Clone, Debug)]
pub struct Settings {
    /// In this order; at least one.
    pub traversals: Vec<Traversal>,
    /// Of depth-first occlusion queries; `None` is what each tree has recorded, else nearest first.
    pub occlusion_order: Option<OrderName>,
    pub costs: Costs,
    pub scene: u16,
    pub filter: Filter,
    /// Only queries that a builder with this portion has not seen.
    pub held_out: Option<Portion>,
    pub sample: Option<u64>,
    /// Size of the traced image, where it is known.
    pub image: Option<ImageSize>,
    /// Whether to sum costs per pixel; needs the size.
    pub pixels: bool,
}

/// One traversal of one tree.
#[derive(Debug)]
pub struct Run {
    pub traversal: Traversal,
    pub outcome: Outcome,
}

/// What was found of one tree.
#[derive(Debug)]
pub struct TreeResult {
    pub path: String,
    pub producer: String,
    pub statistics: Statistics,
    pub sah_cost: f64,
    /// In which its occlusion queries were followed, depth first.
    pub occlusion_order: OrderName,
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
}

/// All trees, in the order given.
#[derive(Debug)]
pub struct Comparison {
    pub settings: Settings,
    pub trees: Vec<TreeResult>,
}

/// Why trees and rays cannot be compared.
#[derive(Debug, Error)]
pub enum CompareError {
    #[error(
        "{path}: the tree is of scene {found:016x}, but {other} is of scene {expected:016x}; give trees and rays of one scene"
    )]
    OtherScene { path: String, found: u64, other: String, expected: u64 },
    #[error("{path}: {source}")]
    File { path: String, source: FormatError },
    #[error("{path}: {source}")]
    Order { path: String, source: OrderError },
    #[error("{path}: no query is left to replay{why}")]
    NoQueries { path: String, why: &'static str },
}

/// Checks that all belong to one scene. Returns a warning when the rays do not say to which they belong.
///
/// # Errors
/// Naming both fingerprints.
pub fn check_scenes(
    trees: &[Candidate],
    rays_path: &str,
    rays: &Rays,
) -> Result<Option<String>, CompareError> {
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
    Ok((recorded == 0).then(|| {
        format!("{rays_path}: does not say of which scene it is (fingerprint 0); it is taken to be of these trees'")
    }))
}

/// Replays `rays` over every tree in every order. The caller has called [`check_scenes`].
///
/// # Errors
/// When a file is damaged, or no query is left.
pub fn compare(
    trees: &[Candidate],
    rays_path: &str,
    rays: &Rays,
    settings: Settings,
    progress: &Progress,
) -> Result<Comparison, CompareError> {
    // RayOrder's own answers end the segments that it is held to.
    let overlap_run = settings.traversals.iter().position(|&t| t == Traversal::RayOrder).unwrap_or(0);
    let mut results = Vec::with_capacity(trees.len());
    for Candidate { path, bvh } in trees {
        bvh.verify().map_err(|source| CompareError::File { path: path.clone(), source })?;
        let order = OcclusionOrder::new(settings.occlusion_order, bvh.tree, bvh.order)
            .map_err(|source| CompareError::Order { path: path.clone(), source })?;
        let prepared = Prepared::new(bvh.tree, bvh.triangles, bvh.geometries);
        let judge = Judge {
            tree: bvh.tree,
            triangles: bvh.triangles,
            masks: Masks::new(bvh.geometries),
            flattened: bvh.header.flags & flag::FLATTENED != 0,
        };
        let mut runs = Vec::with_capacity(settings.traversals.len());
        for (index, &traversal) in settings.traversals.iter().enumerate() {
            let options = replay::Options {
                traversal,
                occlusion_order: order.clone(),
                scene: settings.scene,
                filter: settings.filter.clone(),
                held_out: settings.held_out,
                sample: settings.sample,
                overlap: index == overlap_run,
                image: settings.image.filter(|_| settings.pixels),
            };
            let outcome = replay::replay(&prepared, &judge, rays, &options, progress)
                .map_err(|source| CompareError::File { path: rays_path.to_owned(), source })?;
            if outcome.tallies.total.queries == 0 {
                let why = if rays.query_count() == 0 {
                    "; the recording is empty"
                } else {
                    "; --filter, --held-out, --sample or --scene leave none"
                };
                return Err(CompareError::NoQueries { path: rays_path.to_owned(), why });
            }
            runs.push(Run { traversal, outcome });
        }
        results.push(TreeResult {
            path: path.clone(),
            producer: bvh.header.producer.clone(),
            statistics: Statistics::of(bvh.tree),
            sah_cost: sah_cost(bvh.tree, settings.costs.c_i, settings.costs.c_p),
            occlusion_order: order.name(),
            runs,
            overlap_run,
        });
    }
    Ok(Comparison { settings, trees: results })
}

impl Comparison {
    /// Γ of a tally relative to the same tally of the first tree; 1 when that costs nothing either.
    pub fn ratio(&self, tally: &Tally, first: &Tally) -> f64 {
        relative(self.settings.costs.gamma(tally), self.settings.costs.gamma(first))
    }

    /// Wrong answers and broken identities, a line each; none when all is well.
    pub fn failures(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for tree in &self.trees {
            for Run { traversal, outcome } in &tree.runs {
                let name = traversal.name();
                if let Some(first) = &outcome.mismatch {
                    let wrong = outcome.tallies.total.mismatches;
                    let told = describe(first, self.settings.image);
                    lines.push(format!("{}: {name}: {wrong} wrong answers, first {told}", tree.path));
                }
                if let Some(query) = outcome.violation {
                    lines.push(format!(
                        "{}: {name}: box tests of query {query} are not those of T_R; please report this",
                        tree.path
                    ));
                }
            }
        }
        lines
    }

    /// Trees whose measured Γ under the first traversal exceeds `limit` times the first tree's, a line each.
    pub fn above(&self, limit: f64) -> Vec<String> {
        let Some(first) = self.trees.first() else { return Vec::new() };
        let base = &first.runs[0];
        self.trees
            .iter()
            .map(|tree| (tree, self.ratio(&tree.runs[0].outcome.tallies.total, &base.outcome.tallies.total)))
            .filter(|(_, ratio)| *ratio > limit)
            .map(|(tree, ratio)| {
                let name = base.traversal.name();
                format!("{}: cost under {name} is {ratio:.4} of {}'s, above {limit}", tree.path, first.path)
            })
            .collect()
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

/// The query, what was recorded and what was found, in one line.
fn describe(mismatch: &Mismatch, image: Option<ImageSize>) -> String {
    let Mismatch { query, record, found } = mismatch;
    let mut text =
        format!("query {query} ({}, {}", kind_name(record.kind), Purpose::from_byte(record.purpose).name());
    // Writing to a String cannot fail.
    let _ = match image.and_then(|image| image.pixel(record.path)) {
        _ if record.path == NO_PATH => Ok(()),
        Some((x, y)) => write!(text, ", pixel {x},{y}"),
        None => write!(text, ", path {}", record.path),
    };
    if record.depth != NO_DEPTH {
        let _ = write!(text, ", depth {}", record.depth);
    }
    let recorded = recorded_answer(record);
    let found = match (found, record.is_occlusion()) {
        (None, true) => "not occluded".to_owned(),
        (None, false) => "a miss".to_owned(),
        (Some(hit), true) => format!("occluded by triangle {} at t {}", hit.triangle, hit.t),
        (Some(hit), false) => format!("triangle {} at t {}", hit.triangle, hit.t),
    };
    let _ = write!(text, "): recorded {recorded}, found {found} (tolerance {T_TOLERANCE:e})");
    text
}

fn recorded_answer(record: &Record) -> String {
    match (record.is_occlusion(), record.is_hit()) {
        (true, true) => "occluded".to_owned(),
        (true, false) => "not occluded".to_owned(),
        (false, true) => format!("triangle {} at t {}", record.triangle, record.t),
        (false, false) => "a miss".to_owned(),
    }
}

/// The name of a kind in tables, JSON and CSV.
pub fn kind_name(kind: u8) -> &'static str {
    if kind == crate::format::rays::kind::OCCLUSION { "occlusion" } else { "closest_hit" }
}

/// The name of a depth in tables, JSON and CSV.
pub fn depth_name(depth: u8) -> String {
    if depth == NO_DEPTH { "unknown".to_owned() } else { depth.to_string() }
}
