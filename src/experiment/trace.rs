//! A recorded scene as the experiments take it: triangles, a sample of the queries, and a way to part them by pixel.

use crate::format::FormatError;
use crate::format::bvh::{Bvh, Geometry};
use crate::format::rays::{NO_DEPTH, NO_PATH, Rays, Record, Reject};
use crate::geometry::Triangle;
use crate::random::Random;
use crate::traverse::{Overlap, Prepared, PreparedRay, Recorded, Scratch};
use crate::tree::Tree;
use rayon::prelude::*;
use thiserror::Error;

/// Queries that follow each other count as one pixel where the pixel is not known: neighbours must not leak.
const NEIGHBOURS: u64 = 256;

/// Why a pair of files is no trace.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TraceError {
    #[error(
        "the rays are of scene {rays:016x}, the tree is of scene {tree:016x}: give the two files of one recording"
    )]
    OtherScene { rays: u64, tree: u64 },
    #[error("there are no queries in the rays: record the scene again")]
    NoQueries,
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
    pub rejects: Vec<Reject>,
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
    /// Takes about `most` queries of the file: whole pixels, chosen by `seed`.
    ///
    /// # Errors
    /// When a chunk is damaged, the files belong to different scenes, or there is no query.
    pub fn new(bvh: &Bvh, rays: &Rays, most: u64, seed: u64) -> Result<Trace, TraceError> {
        let (tree, of_rays) = (bvh.header.fingerprint, rays.header.fingerprint);
        if of_rays != 0 && of_rays != tree {
            return Err(TraceError::OtherScene { rays: of_rays, tree });
        }
        if rays.query_count() == 0 {
            return Err(TraceError::NoQueries);
        }
        let share = most as f64 / rays.query_count() as f64;
        let firsts = rays.first_queries();
        let triangles = bvh.triangles.len();
        let chunks = rays.map_chunks(|index, chunk| {
            let mut rejects = chunk.rejects.iter().peekable();
            let mut queries = Vec::new();
            for (offset, record) in chunk.records.iter().enumerate() {
                let mut refused = Vec::new();
                while let Some(reject) = rejects.next_if(|reject| reject.record as usize == offset) {
                    refused.push(*reject);
                }
                let query = firsts[index] + offset as u64;
                if record.is_hit() && record.triangle != u32::MAX && record.triangle as usize >= triangles {
                    return Err(TraceError::Triangle { query, triangle: record.triangle, triangles });
                }
                let group = match record.path {
                    NO_PATH => (1 << 32) + query / NEIGHBOURS,
                    path => u64::from(path),
                };
                if share >= 1.0 || chance(seed, group) < share {
                    queries.push(Query { record: *record, rejects: refused, group });
                }
            }
            Ok(queries)
        })?;
        let queries: Vec<Query> = chunks.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
        if queries.is_empty() {
            return Err(TraceError::NoQueries);
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
        let mut groups: Vec<u64> = self.queries.iter().map(|query| query.group).collect();
        groups.sort_unstable();
        groups.dedup();
        groups
    }
}

/// Parts queries into those of about `share` of the pixels, and the others.
pub fn part(queries: &[Query], share: f64, seed: u64) -> (Vec<Query>, Vec<Query>) {
    queries.iter().cloned().partition(|query| chance(seed ^ 0x5EED, query.group) < share)
}

fn chance(seed: u64, group: u64) -> f64 {
    Random::stream(seed, &[group]).uniform()
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
