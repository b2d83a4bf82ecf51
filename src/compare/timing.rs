//! How long trees take under our traversals and under Embree's kernels: the same queries, without counting, on one pinned thread.
//!
//! Queries stay in the order of the file, but for blocks of `BLOCK` in which those of one kind, depth and purpose stand together: a *run*, the
//! unit that is timed. All contenders take turns in every round, so that a machine that slows down slows all of them; the first round warms up
//! and is dropped. What is reported of a time is its median over the rounds, and the least and the greatest.

pub(super) mod clock;
mod observe;

pub use observe::{Follower, Observation};

use super::kernels::EmbreeScenes;
use super::{Candidate, CompareError, Recording, Settings};
use crate::format::FormatError;
use crate::format::rays::{MAX_CHUNK_RECORDS, Purpose, Record, Reject};
use crate::geometry::Ray;
use crate::median::median;
use crate::optimize::slots;
use crate::replay::query::{Choice, Query};
use crate::replay::sort::Sort;
use crate::replay::tally::{Cell, cell};
use crate::replay::together::Together;
use crate::traverse::packet::MOST;
use crate::traverse::{OcclusionOrder, Prepared, Recorded, Scratch, Traversal};
use observe::Followed;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::ops::Range;

/// Queries of a recording that are timed at most: more of them only make the same medians slower.
pub const MOST_QUERIES: u64 = 1 << 20;
/// Queries that are sorted into runs at a time.
const BLOCK: usize = 8192;
/// The same where they go in packets or in an order of their own, as many as a chunk may hold: as they are replayed.
const LONG_BLOCK: usize = MAX_CHUNK_RECORDS;

/// A time in seconds over the rounds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    pub median: f64,
    pub least: f64,
    pub greatest: f64,
}

impl Seconds {
    fn of(mut rounds: Vec<f64>) -> Seconds {
        let Some(median) = median(&mut rounds) else { return Seconds::default() };
        Seconds { median, least: rounds[0], greatest: rounds[rounds.len() - 1] }
    }
}

/// What one contender took for all timed queries.
#[derive(Clone, Debug, Default)]
pub struct Time {
    pub total: Seconds,
    pub by_kind: BTreeMap<u8, Seconds>,
    pub by_purpose: BTreeMap<Purpose, Seconds>,
}

/// What Embree's kernels took; `None` where they could not be asked.
#[derive(Clone, Debug)]
pub struct KernelTimes {
    /// On the trees that Embree built, as [`super::kernels::Kernels::own`].
    pub own: Vec<Option<Time>>,
    /// By tree, as in the comparison.
    pub trees: Vec<Option<Time>>,
}

impl KernelTimes {
    /// What others are relative to: the time on the first tree, or on Embree's own where that is not planted.
    pub fn base(&self) -> Option<&Time> {
        self.trees.first()?.as_ref().or(self.own.first()?.as_ref())
    }

    /// The least median of a part of the time among Embree's own trees.
    pub fn best(&self, part: impl Fn(&Time) -> Option<Seconds>) -> Option<f64> {
        let medians = self.own.iter().flatten().filter_map(|time| Some(part(time)?.median));
        medians.min_by(f64::total_cmp)
    }
}

/// How queries are asked, other than one by one in the order of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Way {
    /// In packets of so many.
    pub packet: Option<usize>,
    /// In the order of [`Settings::sort`].
    pub sorted: bool,
}

impl Way {
    const PLAIN: Way = Way { packet: None, sorted: false };

    /// All that `settings` ask for but the plain one.
    fn all(settings: &Settings) -> Vec<Way> {
        let packets = settings.packet.map(Some);
        let orders = if settings.sort.is_some() { &[false, true][..] } else { &[false] };
        let ways = orders.iter().flat_map(|&sorted| {
            std::iter::once(None).chain(packets).map(move |packet| Way { packet, sorted })
        });
        ways.filter(|way| *way != Way::PLAIN).collect()
    }
}

/// What was measured over one recording.
#[derive(Clone, Debug)]
pub struct Timing {
    pub queries: u64,
    pub by_kind: BTreeMap<u8, u64>,
    pub by_purpose: BTreeMap<Purpose, u64>,
    pub rounds: u32,
    /// Number of the processor; `None` when the thread could not be pinned.
    pub processor: Option<usize>,
    /// By tree, then by traversal, as in the comparison.
    pub trees: Vec<Vec<Time>>,
    /// Other ways of asking the same queries.
    pub ways: Vec<Way>,
    /// By tree, traversal and way.
    pub by_way: Vec<Vec<Vec<Time>>>,
    /// What sorting all queries took.
    pub sort: Option<Seconds>,
    /// When they were asked for, and Embree has such a scene.
    pub kernels: Option<KernelTimes>,
    /// Of each tree, where costs are to be fitted.
    pub observations: Vec<Observation>,
}

/// Timed queries, which no chunk of a file has to stay in memory for.
#[derive(Clone)]
struct Queries {
    list: Vec<(Record, Ray, Range<usize>)>,
    rejects: Vec<Reject>,
    /// Queries of one cell that stand together.
    runs: Vec<(Cell, Range<usize>)>,
}

impl Queries {
    fn read(Recording { rays, scene, .. }: &Recording, settings: &Settings) -> Result<Queries, FormatError> {
        let sample = settings.choice.sample.unwrap_or(u64::MAX).min(MOST_QUERIES);
        let choice = Choice { scene: *scene, sample: Some(sample), ..settings.choice.clone() };
        let long = settings.packet.is_some() || settings.sort.is_some();
        let size = if long { LONG_BLOCK } else { BLOCK };
        let mut queries = Queries { list: Vec::new(), rejects: Vec::new(), runs: Vec::new() };
        choice.for_each_chunk(rays, |chosen| {
            for query in chosen {
                let start = queries.rejects.len();
                queries.rejects.extend(query.candidates.rejects);
                queries.list.push((*query.record, query.ray, start..queries.rejects.len()));
            }
        })?;
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
        Ok(queries)
    }

    /// The same queries, those of each run in an order of their own.
    fn sorted(mut self, sort: Sort) -> Queries {
        for (_, range) in &self.runs {
            sort.apply(&mut self.list[range.clone()], |(_, ray, _)| *ray);
        }
        self
    }

    /// The queries of one run; they have lost their numbers, which nothing here needs.
    fn run(&self, range: &Range<usize>) -> impl Iterator<Item = Query<'_>> + Clone {
        self.list[range.clone()].iter().map(|(record, ray, rejects)| Query {
            number: 0,
            record,
            ray: *ray,
            candidates: Recorded { mask: record.mask, rejects: &self.rejects[rejects.clone()] },
        })
    }

    fn count<K: Ord>(&self, key: impl Fn(&Cell) -> K) -> BTreeMap<K, u64> {
        let mut counts = BTreeMap::new();
        for (cell, run) in &self.runs {
            *counts.entry(key(cell)).or_insert(0) += run.len() as u64;
        }
        counts
    }

    /// Sums up what a contender took: `rounds` by round, then by run.
    fn time(&self, rounds: &[Vec<f64>]) -> Time {
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

/// One tree under one traversal, asked in one way.
struct Contender<'a> {
    prepared: &'a Prepared,
    traversal: Traversal,
    order: &'a OcclusionOrder,
    way: Way,
}

impl Contender<'_> {
    /// Seconds of each run.
    fn round(&self, queries: &Queries, scratch: &mut Scratch) -> Vec<f64> {
        let (mut together, mut answers) = (Together::default(), [None; MOST]);
        let timed = |(_, range): &(Cell, Range<usize>)| {
            let start = clock::thread_seconds();
            match self.way.packet {
                None => {
                    for query in queries.run(range) {
                        black_box(query.ask(self.prepared, self.traversal, self.order, &mut (), scratch));
                    }
                }
                Some(size) => {
                    for start in range.clone().step_by(size) {
                        let range = start..range.end.min(start + size);
                        let packet = queries.run(&range);
                        let (traversal, order) = (self.traversal, self.order);
                        let answers = &mut answers;
                        black_box(together.ask(packet, self.prepared, traversal, order, &mut (), answers));
                    }
                }
            }
            clock::thread_seconds() - start
        };
        queries.runs.iter().map(timed).collect()
    }
}

/// Times every tree and traversal, and Embree's kernels, over every recording, `rounds` times after one that is dropped. All prepared trees are in
/// memory at once. Takes a thread of its own, which it pins.
///
/// # Errors
/// When a file is damaged.
pub(super) fn time(
    trees: &[Candidate],
    recordings: &[Recording],
    settings: &Settings,
    rounds: u32,
    mut scenes: Option<&mut EmbreeScenes>,
) -> Result<Vec<Timing>, CompareError> {
    let mut prepared = Vec::with_capacity(trees.len());
    for Candidate { path, bvh } in trees {
        let order = OcclusionOrder::new(settings.occlusion_order, bvh.tree, bvh.order)
            .map_err(|source| CompareError::Order { path: path.clone(), source })?;
        prepared.push((Prepared::new(bvh.tree, bvh.triangles, bvh.geometries), order));
    }
    let own_trees = scenes.as_ref().map_or(0, |scenes| scenes.kernels().own.len());
    let ways = Way::all(settings);
    let of = |way: Way| {
        prepared.iter().flat_map(move |(prepared, order)| {
            settings.traversals.iter().map(move |&traversal| Contender { prepared, traversal, order, way })
        })
    };
    // The plain ones first, then those of each way.
    let contenders: Vec<Contender> = of(Way::PLAIN).chain(ways.iter().flat_map(|&way| of(way))).collect();
    let measure = || {
        let processor = clock::pin();
        let mut timings = Vec::with_capacity(recordings.len());
        for recording in recordings {
            let Recording { path, .. } = recording;
            let queries = Queries::read(recording, settings)
                .map_err(|source| CompareError::File { path: path.clone(), source })?;
            let sorted = settings.sort.map(|sort| queries.clone().sorted(sort));
            let mut sorting = Vec::new();
            let mut scratch = Scratch::default();
            let mut taken = vec![Vec::new(); contenders.len()];
            let mut taken_by_kernels = vec![Vec::new(); own_trees + trees.len()];
            for round in 0..=rounds {
                for (contender, taken) in contenders.iter().zip(&mut taken) {
                    let queries = sorted.as_ref().filter(|_| contender.way.sorted).unwrap_or(&queries);
                    let seconds = contender.round(queries, &mut scratch);
                    taken.extend((round > 0).then_some(seconds));
                }
                if let Some(sort) = settings.sort {
                    let unsorted = queries.clone();
                    let start = clock::thread_seconds();
                    black_box(unsorted.sorted(sort));
                    sorting.extend((round > 0).then_some(clock::thread_seconds() - start));
                }
                if let Some(scenes) = &mut scenes {
                    for (number, taken) in taken_by_kernels.iter_mut().enumerate() {
                        let runs = queries.runs.iter().map(|(_, range)| queries.run(range));
                        taken.extend(scenes.round(number, runs).filter(|_| round > 0));
                    }
                }
            }
            let mut times: Vec<Time> = taken.iter().map(|taken| queries.time(taken)).collect();
            let others = times.split_off(prepared.len() * settings.traversals.len());
            let observations = if settings.fit {
                let odf = settings.traversals.iter().position(|&traversal| traversal == Traversal::Odf);
                let every = settings.traversals.len();
                let ours = odf.map(|odf| taken.iter().skip(odf).step_by(every)).into_iter().flatten();
                observe_all(trees, &prepared, &queries, ours, &taken_by_kernels[own_trees..])
            } else {
                Vec::new()
            };
            // From ways of trees and traversals to trees and traversals of ways.
            let of_way = |place: usize| others.iter().skip(place).step_by(times.len()).cloned().collect();
            let by_way: Vec<Vec<Time>> = (0..times.len()).map(of_way).collect();
            timings.push(Timing {
                queries: queries.list.len() as u64,
                by_kind: queries.count(|cell| cell.0),
                by_purpose: queries.count(|cell| cell.2),
                rounds,
                processor,
                trees: times.chunks(settings.traversals.len()).map(<[Time]>::to_vec).collect(),
                ways: ways.clone(),
                by_way: by_way.chunks(settings.traversals.len()).map(<[Vec<Time>]>::to_vec).collect(),
                sort: settings.sort.map(|_| Seconds::of(sorting)),
                kernels: scenes.is_some().then(|| {
                    let time = |taken: &Vec<Vec<f64>>| (!taken.is_empty()).then(|| queries.time(taken));
                    let (own, trees) = taken_by_kernels.split_at(own_trees);
                    KernelTimes {
                        own: own.iter().map(time).collect(),
                        trees: trees.iter().map(time).collect(),
                    }
                }),
                observations,
            });
        }
        Ok(timings)
    };
    std::thread::scope(|scope| match scope.spawn(measure).join() {
        Ok(timings) => timings,
        Err(panic) => std::panic::resume_unwind(panic),
    })
}

/// Observations of all trees, on rayon's threads: `ours` and `kernels` have for each the seconds by round and run, none of a tree that was not followed.
fn observe_all<'a>(
    trees: &[Candidate],
    prepared: &[(Prepared, OcclusionOrder)],
    queries: &Queries,
    ours: impl Iterator<Item = &'a Vec<Vec<f64>>>,
    kernels: &[Vec<Vec<f64>>],
) -> Vec<Observation> {
    let ours: Vec<&Vec<Vec<f64>>> = ours.take(trees.len()).collect();
    let of_tree = |number: usize| {
        let bvh = trees[number].bvh;
        let (prepared, order) = &prepared[number];
        let mut observations = Vec::new();
        if let Some(rounds) = ours.get(number) {
            let follower = Follower::Ours;
            let followed = Followed { follower, number, tree: bvh.tree, prepared, order, rounds };
            observations = followed.observe(queries);
        }
        if let Some(rounds) = kernels.get(number).filter(|rounds| !rounds.is_empty()) {
            let planted = slots::as_planted(bvh.tree, bvh.order);
            let prepared = &Prepared::new(planted.view(), bvh.triangles, bvh.geometries);
            let (follower, order) = (Follower::Embree, &OcclusionOrder::First);
            let followed = Followed { follower, number, tree: planted.view(), prepared, order, rounds };
            observations.extend(followed.observe(queries));
        }
        observations
    };
    let each: Vec<Vec<Observation>> = (0..trees.len()).into_par_iter().map(of_tree).collect();
    each.concat()
}
