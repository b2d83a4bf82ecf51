//! A recording over a tree: every query again, what it costs, and whether the answer is the recorded one.
//!
//! Chunks are read a few at a time and cut into pieces of `PIECE` queries, which threads share. Within a piece the queries of one kind, depth
//! and purpose run together, so that each group is timed without a clock in the loop; where they are sorted or go in packets, a piece is a
//! whole chunk. Memory does not grow with the file: a few chunks per thread, tallies, one image when pixels are wanted.

pub mod check;
pub mod exact;
pub mod pixels;
pub mod profile;
pub mod query;
pub mod scene;
pub mod select;
pub mod sort;
pub mod tally;
pub mod together;

use crate::format::FormatError;
use crate::format::rays::{Chunk, NO_PATH, Rays, Record};
use crate::progress::Progress;
use crate::ranks::Share;
use crate::traverse::packet::MOST;
use crate::traverse::{
    Counts, Decisions, Hit, Observer, OcclusionOrder, Overlap, PacketCounts, Prepared, PreparedRay, Scratch,
    Traversal,
};
use check::{Judge, Verdict};
use pixels::{ImageSize, Pixels};
use profile::{Levels, Profile, Profiler};
use query::{Choice, Query};
use rayon::prelude::*;
use select::Sample;
use serde::{Deserialize, Serialize};
use sort::Sort;
use std::ops::Range;
use std::time::Instant;
use tally::{Costs, GAMMA_UNITS, Replayed, Tallies};
use together::Together;

/// Queries that one thread replays at a time.
const PIECE: usize = 2048;

/// How to replay.
#[derive(Clone, Debug)]
pub struct Options<'a> {
    pub traversal: Traversal,
    /// In which order depth-first occlusion queries visit children; that of the tree which is replayed.
    pub occlusion_order: OcclusionOrder,
    pub choice: Choice,
    /// Also count P_R, for T_R and Γ_R, and hold RayOrder to it where queries go alone.
    pub overlap: bool,
    /// Weights of each query's Γ.
    pub costs: Costs,
    /// Queries of a chunk and of one kind, depth and purpose are sorted before they are asked.
    pub sort: Option<Sort>,
    /// They are asked in packets of so many, [`MOST`] at most, not one by one.
    pub packet: Option<usize>,
    /// Also count tests by level and cache lines, in a second pass over each query, in which it goes alone.
    pub profile: Option<&'a Levels>,
    /// Also sum costs by pixel.
    pub image: Option<ImageSize>,
}

/// A query whose answer is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mismatch {
    /// Number of the query in the file.
    pub query: u64,
    #[serde(with = "as_words")]
    pub record: Record,
    pub found: Option<Hit>,
}

/// A record as sixteen words, for messages between ranks.
mod as_words {
    use super::Record;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    type Words = [u32; 16];

    pub fn serialize<S: Serializer>(record: &Record, to: S) -> Result<S::Ok, S::Error> {
        bytemuck::cast::<Record, Words>(*record).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Record, D::Error> {
        Words::deserialize(from).map(bytemuck::cast)
    }
}

/// What a replay found.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Outcome {
    pub tallies: Tallies,
    /// The first one in the file.
    pub mismatch: Option<Mismatch>,
    /// Number of the first query for which RayOrder did not test exactly the boxes that its effective segment overlaps.
    pub violation: Option<u64>,
    pub pixels: Option<Pixels>,
    pub profile: Option<Profile>,
}

impl Outcome {
    /// Adds what was found in another part of the same recording.
    pub fn merge(self, other: Outcome) -> Outcome {
        let first = |a: Option<Mismatch>, b: Option<Mismatch>| a.into_iter().chain(b).min_by_key(|m| m.query);
        if let (Some(sum), Some(more)) = (&self.pixels, &other.pixels) {
            sum.merge(more);
        }
        let mut profile = self.profile;
        if let (Some(sum), Some(more)) = (&mut profile, &other.profile) {
            sum.merge(more);
        }
        Outcome {
            tallies: self.tallies.merge(other.tallies),
            mismatch: first(self.mismatch, other.mismatch),
            violation: self.violation.into_iter().chain(other.violation).min(),
            pixels: self.pixels.or(other.pixels),
            profile: profile.or(other.profile),
        }
    }
}

/// What one thread uses again and again.
#[derive(Default)]
struct Room {
    scratch: Scratch,
    lines: Vec<u64>,
}

/// What every piece needs.
struct Job<'a> {
    prepared: &'a Prepared,
    judge: &'a Judge<'a>,
    options: &'a Options<'a>,
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
    replay_share(prepared, judge, rays, options, Share::WHOLE, progress)
}

/// Replays as [`replay`] does, of the chunks only those of `share`. [`Outcome::merge`] of all shares is the outcome of the whole.
///
/// # Errors
/// When one of those chunks is damaged.
pub fn replay_share(
    prepared: &Prepared,
    judge: &Judge,
    rays: &Rays,
    options: &Options,
    share: Share,
    progress: &Progress,
) -> Result<Outcome, FormatError> {
    let job = Job {
        prepared,
        judge,
        options,
        sample: options.choice.sample_of(rays.query_count()),
        pixels: options.image.map(Pixels::new),
    };
    let mut sum = Outcome { profile: options.profile.map(Profile::new), ..Outcome::default() };
    let firsts = rays.first_queries();
    let numbers: Vec<usize> = share.in_turn(rays.chunks().len()).collect();
    for wave in numbers.chunks(2 * rayon::current_num_threads()) {
        let chunks: Vec<Chunk> = wave.par_iter().map(|&index| rays.chunk(index)).collect::<Result<_, _>>()?;
        let mut pieces = Vec::new();
        for (chunk, &number) in chunks.iter().zip(wave) {
            let start = firsts[number];
            let whole = options.sort.is_some() || options.packet.is_some();
            let size = if whole { chunk.records.len().max(1) } else { PIECE };
            for first in (0..chunk.records.len()).step_by(size) {
                let range = first..chunk.records.len().min(first + size);
                pieces.push((chunk, start, range));
            }
        }
        let found = pieces
            .into_par_iter()
            .fold(
                || {
                    let profile = options.profile.map(Profile::new);
                    (Outcome { profile, ..Outcome::default() }, Room::default())
                },
                |(mut sum, mut room), (chunk, start, range)| {
                    let queries = range.len() as u64;
                    job.piece(chunk, start, range, &mut sum, &mut room);
                    progress.advance(queries);
                    (sum, room)
                },
            )
            .map(|(sum, _)| sum)
            .reduce(Outcome::default, Outcome::merge);
        sum = sum.merge(found);
    }
    Ok(Outcome { pixels: job.pixels, ..sum })
}

impl Job<'_> {
    fn piece(&self, chunk: &Chunk, start: u64, range: Range<usize>, sum: &mut Outcome, room: &mut Room) {
        let mut queries = self.options.choice.within(chunk, start, range, self.sample);
        queries.sort_by_key(|query| tally::cell(query.record));
        let (mut hits, mut counts) = (vec![None; queries.len()], vec![Counts::default(); queries.len()]);
        let mut replayed = Vec::with_capacity(queries.len());
        let mut together = Together::default();
        for group in queries.chunk_by_mut(|a, b| tally::cell(a.record) == tally::cell(b.record)) {
            if let Some(sort) = self.options.sort {
                sort.apply(group, |query| query.ray);
            }
            let (hits, counts) = (&mut hits[..group.len()], &mut counts[..group.len()]);
            counts.fill(Counts::default());
            let started = Instant::now();
            let packets = match self.options.packet {
                Some(size) => self.ask_together(group, size, hits, counts, &mut together),
                None => {
                    for ((query, hit), counts) in group.iter().zip(&mut *hits).zip(&mut *counts) {
                        *hit = self.ask(query, counts, &mut room.scratch);
                    }
                    Decisions::default()
                }
            };
            let seconds = started.elapsed().as_secs_f64();
            replayed.clear();
            let answers = hits.iter().zip(&*counts);
            replayed.extend(
                group
                    .iter()
                    .zip(answers)
                    .map(|(query, (hit, counts))| self.assess(query, (*hit, *counts), sum, room)),
            );
            sum.tallies.add(tally::cell(group[0].record), &replayed, &packets, seconds);
        }
    }

    /// Asks a group in packets of `size`.
    fn ask_together<'q>(
        &self,
        group: &[Query<'q>],
        size: usize,
        hits: &mut [Option<Hit>],
        counts: &mut [Counts],
        together: &mut Together<'q>,
    ) -> Decisions {
        let Options { traversal, occlusion_order, .. } = self.options;
        let mut decisions = Decisions::default();
        let answers = &mut [None; MOST];
        for ((queries, hits), counts) in
            group.chunks(size).zip(hits.chunks_mut(size)).zip(counts.chunks_mut(size))
        {
            let observer = &mut PacketCounts { queries: counts, decisions: &mut decisions };
            let queries = queries.iter().copied();
            let found = together.ask(queries, self.prepared, *traversal, occlusion_order, observer, answers);
            hits.copy_from_slice(found);
        }
        decisions
    }

    #[inline]
    fn ask(&self, query: &Query, observer: &mut impl Observer, scratch: &mut Scratch) -> Option<Hit> {
        query.ask(self.prepared, self.options.traversal, &self.options.occlusion_order, observer, scratch)
    }

    fn assess(
        &self,
        query: &Query,
        (hit, counts): (Option<Hit>, Counts),
        sum: &mut Outcome,
        Room { scratch, lines }: &mut Room,
    ) -> Replayed {
        let verdict = self.judge.judge(query.record, &query.ray, hit, &query.candidates);
        if verdict == Verdict::Mismatch && sum.mismatch.is_none_or(|first| query.number < first.query) {
            sum.mismatch = Some(Mismatch { query: query.number, record: *query.record, found: hit });
        }
        let mut overlap = Overlap::default();
        if self.options.overlap {
            let occlusion = query.record.is_occlusion();
            let end = query.end(hit);
            self.prepared.overlap(&PreparedRay::new(&query.ray), end, &mut overlap, scratch);
            let alone = self.options.packet.is_none();
            let held =
                alone && self.options.traversal == Traversal::RayOrder && !(occlusion && hit.is_some());
            if held && counts.box_tests != 1 + overlap.children {
                sum.violation = Some(sum.violation.map_or(query.number, |first| first.min(query.number)));
            }
        }
        if let Some(pixels) = &self.pixels
            && query.record.path != NO_PATH
        {
            pixels.add(query.record.path, &counts);
        }
        if let (Some(levels), Some(profile)) = (self.options.profile, &mut sum.profile) {
            let mut profiler = Profiler::new(levels, profile, lines);
            self.ask(query, &mut profiler, scratch);
            profiler.finish();
        }
        let gamma = (self.options.costs.gamma(&counts) * GAMMA_UNITS).round() as u64;
        Replayed { hit: hit.is_some(), counts, verdict, overlap, gamma }
    }
}
