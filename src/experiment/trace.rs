//! A recorded scene as the experiments take it: triangles, a sample of the queries, and a way to part them by pixel.

use super::ExperimentError;
use crate::format::FormatError;
use crate::format::bvh::{Bvh, Geometry};
use crate::format::rays::{NO_DEPTH, Rays, Record, Reject};
use crate::geometry::Triangle;
use crate::replay::scene::{SceneError, Scenes};
use crate::replay::select::{Portion, pixel};
use crate::traverse::{Overlap, Prepared, PreparedRay, Recorded, Scratch};
use crate::tree::Tree;
use rayon::prelude::*;
use thiserror::Error;

/// Why a pair of files is no trace.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TraceError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("there are no queries in the rays: record the scene again")]
    NoQueries,
    #[error(
        "none of the pixels of {all} queries was drawn for about {most} of them: ask for more with --queries"
    )]
    NoneDrawn { all: u64, most: u64 },
    #[error(
        "query {query} names triangle {triangle}, but the tree has {triangles}: give the two files of one recording"
    )]
    Triangle { query: u64, triangle: u32, triangles: usize },
    #[error("rays: {0}")]
    Format(#[from] FormatError),
}

/// A query and what its program's filter refused.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    pub record: Record,
    pub rejects: Box<[Reject]>,
    /// Queries of one group are on the same side of every split: those of a pixel.
    pub group: u64,
}

impl Query {
    /// The triangles that it may hit.
    pub fn candidates(&self) -> Recorded<'_> {
        Recorded { mask: self.record.mask, rejects: &self.rejects }
    }
}

/// Triangles and queries.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    pub triangles: Vec<Triangle>,
    pub geometries: Vec<Geometry>,
    pub queries: Vec<Query>,
}

impl Trace {
    /// Takes about `most` queries of a scene of the file, by default of the one that the tree is
    /// of: whole pixels, chosen by `seed`.
    ///
    /// # Errors
    /// When a chunk is damaged, the files belong to different scenes, or there is no query.
    pub fn new(
        bvh: &Bvh,
        rays: &Rays,
        scene: Option<u16>,
        most: u64,
        seed: u64,
    ) -> Result<Trace, TraceError> {
        let scene = Scenes::of(rays).of_trees(&[bvh], scene)?;
        let own = rays.chunks().iter().filter(|chunk| chunk.info.scene == scene);
        let all: u64 = own.map(|chunk| u64::from(chunk.records)).sum();
        if all == 0 {
            return Err(TraceError::NoQueries);
        }
        // Another seed than that by which they are parted.
        let sample = Portion { share: most as f64 / all as f64, seed: !seed };
        let firsts = rays.first_queries();
        let triangles = bvh.triangles.len();
        let chunks = rays.map_chunks(|index, chunk| {
            let mut queries = Vec::new();
            if chunk.info.scene != scene {
                return Ok(queries);
            }
            for (offset, record) in chunk.records.iter().enumerate() {
                let query = firsts[index] + offset as u64;
                if record.is_hit() && record.triangle != u32::MAX && record.triangle as usize >= triangles {
                    return Err(TraceError::Triangle { query, triangle: record.triangle, triangles });
                }
                let group = pixel(record, query);
                if sample.has(group) {
                    let rejects = chunk.rejects_of(offset).into();
                    queries.push(Query { record: *record, rejects, group });
                }
            }
            Ok(queries)
        })?;
        let queries: Vec<Query> = chunks.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
        if queries.is_empty() {
            return Err(TraceError::NoneDrawn { all, most });
        }
        Ok(Trace { triangles: bvh.triangles.to_vec(), geometries: bvh.geometries.to_vec(), queries })
    }

    /// Bounces: queries of depth 1 and above; all queries when there is none.
    pub fn bounces(&self) -> Vec<Query> {
        let bounce =
            |query: &&Query| (1..NO_DEPTH).contains(&query.record.depth) && !query.record.is_occlusion();
        let bounces: Vec<Query> = self.queries.iter().filter(bounce).cloned().collect();
        if bounces.is_empty() { self.queries.clone() } else { bounces }
    }

    /// Distinct pixels.
    pub fn groups(&self) -> Vec<u64> {
        groups(&self.queries)
    }
}

fn groups(queries: &[Query]) -> Vec<u64> {
    let mut groups: Vec<u64> = queries.iter().map(|query| query.group).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// Parts queries into those of about `share` of the pixels, and the others, as `bvh-build --train`
/// and `bvh-compare --held-out` do.
///
/// # Errors
/// When there is none on one side.
pub fn part(queries: &[Query], share: f64, seed: u64) -> Result<(Vec<Query>, Vec<Query>), ExperimentError> {
    let portion = Portion { share, seed };
    let (training, held_out): (Vec<Query>, Vec<Query>) =
        queries.iter().cloned().partition(|query| portion.has(query.group));
    if training.is_empty() || held_out.is_empty() {
        let pixels = groups(queries).len();
        let side = if training.is_empty() { "count on" } else { "build from" };
        return Err(ExperimentError::OneSided { queries: queries.len(), pixels, share, seed, side });
    }
    Ok((training, held_out))
}

/// T_R of queries on a tree, over their effective segments.
pub fn t_r(tree: &Prepared, queries: &[Query]) -> u64 {
    let count = |queries: &[Query]| {
        let (mut overlap, mut scratch) = (Overlap::default(), Scratch::default());
        for query in queries {
            let segment = PreparedRay::new(&query.record.effective_segment());
            tree.overlap(&segment, segment.tfar, &mut overlap, &mut scratch);
        }
        overlap.inner
    };
    queries.par_chunks(4096).map(count).sum()
}

/// A tree of the trace's triangles, made ready to be traversed.
pub fn prepared(tree: &Tree, trace: &Trace) -> Prepared {
    Prepared::new(tree.view(), &trace.triangles, &trace.geometries)
}
