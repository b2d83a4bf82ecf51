//! A recording over a tree: every query again, what it costs, and whether the answer is the recorded one.
//!
//! Chunks are read a few at a time and cut into pieces of `PIECE` queries, which threads share. Within a piece the queries of one kind, depth
//! and purpose run together, so that each group is timed without a clock in the loop. Memory does not grow with
//! the file: a few chunks per thread, tallies, one image when pixels are wanted.

pub mod check;
pub mod pixels;
pub mod select;
pub mod tally;

use crate::format::FormatError;
use crate::format::rays::{Chunk, NO_PATH, Rays, Record, Reject, flag};
use crate::geometry::Ray;
use crate::progress::Progress;
use crate::traverse::{
    Counts, Hit, OcclusionOrder, Overlap, Prepared, PreparedRay, Recorded, Scratch, Traversal,
};
use check::{Judge, Verdict};
use pixels::{ImageSize, Pixels};
use rayon::prelude::*;
use select::{Filter, Portion, Sample};
use std::ops::Range;
use std::time::Instant;
use tally::{Replayed, Tallies};

/// Queries that one thread replays at a time.
const PIECE: usize = 2048;

/// How to replay.
#[derive(Clone, Debug)]
pub struct Options {
    pub traversal: Traversal,
    /// In which order depth-first occlusion queries visit children; that of the tree which is replayed.
    pub occlusion_order: OcclusionOrder,
    /// Only queries of this scene number ([`crate::format::rays::ChunkInfo::scene`]).
    pub scene: u16,
    pub filter: Filter,
    /// Leave out the queries that this portion trains with.
    pub held_out: Option<Portion>,
    /// Only so many, spread over the file; before the filter.
    pub sample: Option<u64>,
    /// Also count P_R, for T_R and Γ_R, and hold RayOrder to it.
    pub overlap: bool,
    /// Also sum costs by pixel.
    pub image: Option<ImageSize>,
}

/// A query whose answer is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mismatch {
    /// Number of the query in the file.
    pub query: u64,
    pub record: Record,
    pub found: Option<Hit>,
}

/// What a replay found.
#[derive(Debug)]
pub struct Outcome {
    pub tallies: Tallies,
    /// The first one in the file.
    pub mismatch: Option<Mismatch>,
    /// Number of the first query for which RayOrder did not test exactly the boxes that its effective segment overlaps.
    pub violation: Option<u64>,
    pub pixels: Option<Pixels>,
}

/// What threads add up.
#[derive(Default)]
struct Sum {
    tallies: Tallies,
    mismatch: Option<Mismatch>,
    violation: Option<u64>,
}

impl Sum {
    fn merge(self, other: Sum) -> Sum {
        let first = |a: Option<Mismatch>, b: Option<Mismatch>| a.into_iter().chain(b).min_by_key(|m| m.query);
        Sum {
            tallies: self.tallies.merge(other.tallies),
            mismatch: first(self.mismatch, other.mismatch),
            violation: self.violation.into_iter().chain(other.violation).min(),
        }
    }
}

/// What every piece needs.
struct Job<'a> {
    prepared: &'a Prepared,
    judge: &'a Judge<'a>,
    options: &'a Options,
    sample: Option<Sample>,
    pixels: Option<Pixels>,
}

/// Replays the chosen queries of `rays` over `prepared`, on rayon's threads. Advances `progress` by every query of the file.
///
/// # Errors
/// When a chunk is damaged.
pub fn replay(
    prepared: &Prepared,
    judge: &Judge,
    rays: &Rays,
    options: &Options,
    progress: &Progress,
) -> Result<Outcome, FormatError> {
    let job = Job {
        prepared,
        judge,
        options,
        sample: options.sample.and_then(|size| Sample::new(size, rays.query_count())),
        pixels: options.image.map(Pixels::new),
    };
    let mut sum = Sum::default();
    let mut start = 0u64;
    let numbers: Vec<usize> = (0..rays.chunks().len()).collect();
    for wave in numbers.chunks(2 * rayon::current_num_threads()) {
        let chunks: Vec<Chunk> = wave.par_iter().map(|&index| rays.chunk(index)).collect::<Result<_, _>>()?;
        let mut pieces = Vec::new();
        for chunk in &chunks {
            for first in (0..chunk.records.len()).step_by(PIECE) {
                let range = first..chunk.records.len().min(first + PIECE);
                pieces.push((chunk, start, range));
            }
            start += chunk.records.len() as u64;
        }
        let found = pieces
            .into_par_iter()
            .fold(
                || (Sum::default(), Scratch::default()),
                |(mut sum, mut scratch), (chunk, start, range)| {
                    let queries = range.len() as u64;
                    job.piece(chunk, start, range, &mut sum, &mut scratch);
                    progress.advance(queries);
                    (sum, scratch)
                },
            )
            .map(|(sum, _)| sum)
            .reduce(Sum::default, Sum::merge);
        sum = sum.merge(found);
    }
    let Sum { tallies, mismatch, violation } = sum;
    Ok(Outcome { tallies, mismatch, violation, pixels: job.pixels })
}

/// A chosen query.
struct Query<'a> {
    number: u64,
    record: &'a Record,
    ray: Ray,
    candidates: Recorded<'a>,
}

impl Job<'_> {
    fn piece(&self, chunk: &Chunk, start: u64, range: Range<usize>, sum: &mut Sum, scratch: &mut Scratch) {
        if chunk.info.scene != self.options.scene {
            return;
        }
        let whole = start + range.start as u64..start + range.end as u64;
        let mut queries: Vec<Query> = match self.sample {
            None => whole.filter_map(|number| self.query(chunk, start, number)).collect(),
            Some(sample) => {
                sample.within(whole).filter_map(|number| self.query(chunk, start, number)).collect()
            }
        };
        queries.sort_by_key(|query| tally::cell(query.record));
        let mut answers = vec![(None, Counts::default()); queries.len()];
        let mut replayed = Vec::with_capacity(queries.len());
        for group in queries.chunk_by(|a, b| tally::cell(a.record) == tally::cell(b.record)) {
            let answers = &mut answers[..group.len()];
            let started = Instant::now();
            for (query, answer) in group.iter().zip(&mut *answers) {
                *answer = self.answer(query, scratch);
            }
            let seconds = started.elapsed().as_secs_f64();
            replayed.clear();
            replayed.extend(
                group.iter().zip(&*answers).map(|(query, answer)| self.assess(query, *answer, sum, scratch)),
            );
            sum.tallies.add(tally::cell(group[0].record), &replayed, seconds);
        }
    }

    fn query<'c>(&self, chunk: &'c Chunk, start: u64, number: u64) -> Option<Query<'c>> {
        let index = (number - start) as usize;
        let record = &chunk.records[index];
        let trained = |portion: &Portion| portion.trains(record, number);
        if !self.options.filter.accepts(record) || self.options.held_out.as_ref().is_some_and(trained) {
            return None;
        }
        let rejects = if record.flags & flag::HAS_REJECTS != 0 {
            rejects_of(&chunk.rejects, index as u32)
        } else {
            &[]
        };
        let mut ray = record.ray();
        // Something that is not a triangle ended the ray: no triangle is hit before it.
        if record.flags & flag::NOT_A_TRIANGLE != 0 && record.is_hit() && !record.is_occlusion() {
            ray.tfar = ray.tfar.min(record.t);
        }
        Some(Query { number, record, ray, candidates: Recorded { mask: record.mask, rejects } })
    }

    #[inline]
    fn answer(&self, query: &Query, scratch: &mut Scratch) -> (Option<Hit>, Counts) {
        let mut counts = Counts::default();
        let ray = PreparedRay::new(&query.ray);
        let traversal = self.options.traversal;
        let (prepared, candidates) = (self.prepared, &query.candidates);
        let hit = match (query.record.is_occlusion(), traversal) {
            (false, _) => prepared.closest_hit(traversal, &ray, candidates, &mut counts, scratch),
            (true, Traversal::RayOrder) => {
                prepared.occluder(traversal, &ray, candidates, &mut counts, scratch)
            }
            (true, Traversal::Odf) => {
                let order = &self.options.occlusion_order;
                prepared.occluder_in(order, &ray, candidates, &mut counts, scratch)
            }
        };
        (hit, counts)
    }

    fn assess(
        &self,
        query: &Query,
        (hit, counts): (Option<Hit>, Counts),
        sum: &mut Sum,
        scratch: &mut Scratch,
    ) -> Replayed {
        let verdict = self.judge.judge(query.record, &query.ray, hit, &query.candidates);
        if verdict == Verdict::Mismatch && sum.mismatch.is_none_or(|first| query.number < first.query) {
            sum.mismatch = Some(Mismatch { query: query.number, record: *query.record, found: hit });
        }
        let mut overlap = Overlap::default();
        if self.options.overlap {
            // The effective segment ends at the answer; that of an occlusion query is the whole interval, although
            // an occluded one may be answered before its end.
            let occlusion = query.record.is_occlusion();
            let end = if occlusion { query.ray.tfar } else { hit.map_or(query.ray.tfar, |hit| hit.t) };
            self.prepared.overlap(&PreparedRay::new(&query.ray), end, &mut overlap, scratch);
            let held = self.options.traversal == Traversal::RayOrder && !(occlusion && hit.is_some());
            if held && counts.box_tests != 1 + overlap.children {
                sum.violation = Some(sum.violation.map_or(query.number, |first| first.min(query.number)));
            }
        }
        if let Some(pixels) = &self.pixels
            && query.record.path != NO_PATH
        {
            pixels.add(query.record.path, &counts);
        }
        Replayed { hit: hit.is_some(), counts, verdict, overlap }
    }
}

/// The rejects of one record; they are sorted by record.
fn rejects_of(rejects: &[Reject], record: u32) -> &[Reject] {
    let start = rejects.partition_point(|reject| reject.record < record);
    let count = rejects[start..].partition_point(|reject| reject.record == record);
    &rejects[start..start + count]
}
