//! The queries that are timed, in runs: those of one kind, depth and purpose that stand together.

use super::super::{Recording, Settings};
use super::{MOST_QUERIES, Seconds, Time};
use crate::format::FormatError;
use crate::format::rays::{MAX_CHUNK_RECORDS, Record, Reject};
use crate::geometry::Ray;
use crate::replay::query::{Choice, Query};
use crate::replay::sort::Sort;
use crate::replay::tally::{Cell, cell};
use crate::traverse::Recorded;
use std::collections::BTreeMap;
use std::ops::Range;

/// Queries that are sorted into runs at a time.
const BLOCK: usize = 8192;
/// The same where they go in packets or in an order of their own, as many as a chunk may hold: as they are replayed.
const LONG_BLOCK: usize = MAX_CHUNK_RECORDS;

/// Timed queries, which no chunk of a file has to stay in memory for.
#[derive(Clone)]
pub(super) struct Queries {
    pub list: Vec<(Record, Ray, Range<usize>)>,
    rejects: Vec<Reject>,
    /// Queries of one cell that stand together.
    pub runs: Vec<(Cell, Range<usize>)>,
}

impl Queries {
    pub fn read(
        Recording { rays, scene, .. }: &Recording,
        settings: &Settings,
    ) -> Result<Queries, FormatError> {
        let sample = settings.choice.sample.unwrap_or(u64::MAX).min(MOST_QUERIES);
        let choice = Choice { scene: *scene, sample: Some(sample), ..settings.choice.clone() };
        let (mut list, mut rejects) = (Vec::new(), Vec::new());
        choice.for_each_chunk(rays, |chosen| {
            for query in chosen {
                let start = rejects.len();
                rejects.extend(query.candidates.rejects);
                list.push((*query.record, query.ray, start..rejects.len()));
            }
        })?;
        Ok(Queries::of(list, rejects, settings))
    }

    fn of(list: Vec<(Record, Ray, Range<usize>)>, rejects: Vec<Reject>, settings: &Settings) -> Queries {
        let long = settings.packet.is_some() || settings.sort.is_some();
        let size = if long { LONG_BLOCK } else { BLOCK };
        let mut queries = Queries { list, rejects, runs: Vec::new() };
        for block in queries.list.chunks_mut(size) {
            block.sort_by_key(|(record, ..)| cell(record));
        }
        for start in (0..queries.list.len()).step_by(size) {
            let block = &queries.list[start..queries.list.len().min(start + size)];
            let mut first = start;
            for run in block.chunk_by(|a, b| cell(&a.0) == cell(&b.0)) {
                queries.runs.push((cell(&run[0].0), first..first + run.len()));
                first += run.len();
            }
        }
        queries
    }

    /// So many of them, spread evenly.
    pub fn thinned(&self, most: usize, settings: &Settings) -> Queries {
        let all = self.list.len();
        let places = (0..most.min(all)).map(|place| (place as u128 * all as u128 / most as u128) as usize);
        let list = places.map(|place| self.list[place].clone()).collect();
        Queries::of(list, self.rejects.clone(), settings)
    }

    /// The same queries, those of each run in an order of their own.
    pub fn sorted(mut self, sort: Sort) -> Queries {
        for (_, range) in &self.runs {
            sort.apply(&mut self.list[range.clone()], |(_, ray, _)| *ray);
        }
        self
    }

    /// The queries of one run; they have lost their numbers, which nothing here needs.
    pub fn run(&self, range: &Range<usize>) -> impl Iterator<Item = Query<'_>> + Clone {
        self.list[range.clone()].iter().map(|(record, ray, rejects)| Query {
            number: 0,
            record,
            ray: *ray,
            candidates: Recorded { mask: record.mask, rejects: &self.rejects[rejects.clone()] },
        })
    }

    pub fn count<K: Ord>(&self, key: impl Fn(&Cell) -> K) -> BTreeMap<K, u64> {
        let mut counts = BTreeMap::new();
        for (cell, run) in &self.runs {
            *counts.entry(key(cell)).or_insert(0) += run.len() as u64;
        }
        counts
    }

    /// Sums up what a contender took: `rounds` by round, then by run.
    pub fn time(&self, rounds: &[Vec<f64>]) -> Time {
        let sum = |round: &Vec<f64>, wanted: &dyn Fn(&Cell) -> bool| -> f64 {
            self.runs
                .iter()
                .zip(round)
                .filter(|((cell, _), _)| wanted(cell))
                .map(|(_, seconds)| seconds)
                .sum()
        };
        let seconds = |wanted: &dyn Fn(&Cell) -> bool| {
            Seconds::of(rounds.iter().map(|round| sum(round, wanted)).collect())
        };
        let by_kind = self.count(|cell| cell.0).into_keys();
        let by_purpose = self.count(|cell| cell.2).into_keys();
        Time {
            total: seconds(&|_| true),
            by_kind: by_kind.map(|kind| (kind, seconds(&|cell| cell.0 == kind))).collect(),
            by_purpose: by_purpose.map(|purpose| (purpose, seconds(&|cell| cell.2 == purpose))).collect(),
        }
    }
}
