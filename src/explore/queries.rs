//! The recorded queries that take part in an answer, shared among threads.
//!
//! A window cannot wait for a hundred million queries: of a large recording, chunks spread over the file are read, and of those a sample is
//! taken. Which ones depends on the file and the limit alone, so a picture is the same each time; [`Sampled`] says what it stands for.

use super::price::Price;
use crate::format::FormatError;
use crate::format::rays::{Chunk, Rays};
use crate::progress::Progress;
use crate::replay::query::{Choice, Query};
use crate::replay::select::Sample;
use crate::traverse::{Hit, Observer, OcclusionOrder, Prepared, Scratch, Traversal};
use rayon::prelude::*;
use std::sync::Mutex;

/// Records that a thread looks at before it asks for more.
const PIECE: usize = 2048;

/// So many records are read for each one that is looked at, before whole chunks are left out: more spread a sample better over
/// the file, and take longer to read.
const SPREAD: u64 = 16;

/// A tree, how it is asked, and what that costs.
#[derive(Clone, Copy, Debug)]
pub struct Asked<'a> {
    pub prepared: &'a Prepared,
    pub traversal: Traversal,
    /// Of depth-first occlusion queries.
    pub order: &'a OcclusionOrder,
    pub price: Price,
}

impl Asked<'_> {
    pub fn ask(&self, query: &Query, observer: &mut impl Observer, scratch: &mut Scratch) -> Option<Hit> {
        query.ask(self.prepared, self.traversal, self.order, observer, scratch)
    }
}

/// A recording, and which of its queries.
#[derive(Clone, Debug)]
pub struct Source<'a> {
    pub rays: &'a Rays<'a>,
    pub choice: Choice,
    /// At most so many are looked at, before the filter.
    pub limit: u64,
}

/// What part of a recording was looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampled {
    /// Queries that were chosen from those looked at.
    pub taken: u64,
    pub looked_at: u64,
    /// Queries of the scene in the recording.
    pub of: u64,
}

impl Sampled {
    /// Whether nothing was left out.
    pub fn is_all(&self) -> bool {
        self.looked_at == self.of
    }

    /// Adds up what was seen of one recording.
    pub fn and(self, other: Sampled) -> Sampled {
        Sampled {
            taken: self.taken + other.taken,
            looked_at: self.looked_at + other.looked_at,
            of: self.of.max(other.of),
        }
    }
}

/// The chunks that are read, and the sample of the records in them.
struct Plan {
    /// Number of a chunk, of its first query in the file, and of the same among all that are read.
    chunks: Vec<(usize, u64, u64)>,
    sample: Option<Sample>,
    read: u64,
    of: u64,
}

impl Source<'_> {
    fn limit(&self) -> u64 {
        self.limit.min(self.choice.sample.unwrap_or(u64::MAX))
    }

    fn plan(&self) -> Plan {
        let firsts = self.rays.first_queries();
        let own = |(index, entry): (usize, &crate::format::rays::ChunkEntry)| {
            (entry.info.scene == self.choice.scene).then_some((index, u64::from(entry.records)))
        };
        let own: Vec<(usize, u64)> = self.rays.chunks().iter().enumerate().filter_map(own).collect();
        let of: u64 = own.iter().map(|chunk| chunk.1).sum();
        let limit = self.limit();
        let wanted = u128::from(limit.saturating_mul(SPREAD)) * own.len() as u128 / u128::from(of.max(1));
        let all = own.len() as u64;
        let wanted = u64::try_from(wanted).map_or(all, |wanted| wanted.clamp(1, all.max(1)));
        let chosen: Vec<(usize, u64)> = match Sample::new(wanted, all) {
            None => own,
            Some(sample) => sample.within(0..all).map(|place| own[place as usize]).collect(),
        };
        let mut read = 0;
        let place = |(index, records)| {
            read += records;
            (index, firsts[index], read - records)
        };
        let chunks = chosen.into_iter().map(place).collect();
        Plan { chunks, sample: Sample::new(limit, read), read, of }
    }

    /// How many steps [`Self::gather`] advances its progress by: records read.
    pub fn steps(&self) -> u64 {
        self.plan().read
    }

    /// Calls `work` with every chosen query, on rayon's threads. Each thread has an `A` of its own, which is returned; which queries went
    /// to which depends on timing, so whoever merges them must not care (sums of integers do not).
    ///
    /// Ends early when `progress` is stopped.
    ///
    /// # Errors
    /// When a chunk is damaged.
    pub fn gather<A: Send>(
        &self,
        progress: &Progress,
        new: impl Fn() -> A + Sync,
        work: impl Fn(&mut A, &Query) + Sync,
    ) -> Result<(Vec<A>, Sampled), FormatError> {
        let plan = self.plan();
        let idle: Mutex<Vec<(A, Sampled)>> = Mutex::new(Vec::new());
        for wave in plan.chunks.chunks(2 * rayon::current_num_threads()) {
            if progress.is_stopped() {
                break;
            }
            let chunks: Vec<(Chunk, u64, u64)> = wave
                .par_iter()
                .map(|&(index, first, place)| Ok((self.rays.chunk(index)?, first, place)))
                .collect::<Result<_, FormatError>>()?;
            let mut pieces = Vec::new();
            for (chunk, first, place) in &chunks {
                let starts = (0..chunk.records.len() as u64).step_by(PIECE);
                pieces.extend(starts.map(|start| (chunk, *first, *place, start)));
            }
            pieces.into_par_iter().for_each(|(chunk, first, place, start)| {
                if progress.is_stopped() {
                    return;
                }
                let taken = idle.lock().ok().and_then(|mut idle| idle.pop());
                let (mut gathered, mut sampled) = taken.unwrap_or_else(|| (new(), Sampled::default()));
                let end = (start + PIECE as u64).min(chunk.records.len() as u64);
                let mut visit = |index: u64| {
                    sampled.looked_at += 1;
                    if let Some(query) = self.choice.query(chunk, first, first + index) {
                        sampled.taken += 1;
                        work(&mut gathered, &query);
                    }
                };
                match plan.sample {
                    None => (start..end).for_each(&mut visit),
                    Some(sample) => {
                        sample.within(place + start..place + end).for_each(|number| visit(number - place));
                    }
                }
                if let Ok(mut idle) = idle.lock() {
                    idle.push((gathered, sampled));
                }
                progress.advance(end - start);
            });
        }
        let gathered = idle.into_inner().unwrap_or_default();
        let none = Sampled { of: plan.of, ..Sampled::default() };
        let sampled = gathered.iter().fold(none, |sum, (_, sampled)| sum.and(*sampled));
        Ok((gathered.into_iter().map(|(gathered, _)| gathered).collect(), sampled))
    }
}
