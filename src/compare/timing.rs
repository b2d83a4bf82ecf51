//! How long trees take under our traversals and under Embree's kernels: the same queries, without counting, on one pinned thread.
//!
//! Queries stay in the order of the file, but for blocks of `BLOCK` in which those of one kind, depth and purpose stand together: a *run*, the
//! unit that is timed. All contenders take turns in every round, so that a machine that slows down slows all of them; the first round warms up
//! and is dropped. What is reported of a time is its median over the rounds, and the least and the greatest.

pub(super) mod clock;
mod observe;
mod queries;
mod rounds;

pub use observe::{Follower, Observation};

use super::kernels::EmbreeScenes;
use super::{Candidate, CompareError, Recording, RecordingResult, Run, Settings};
use crate::format::rays::Purpose;
use crate::median::median;
use crate::traverse::{OcclusionOrder, Prepared, Traversal};
use observe::observe_all;
use queries::Queries;
use rounds::{Contender, Rounds};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Queries of a recording that are timed at most: more of them only make the same medians slower.
pub const MOST_QUERIES: u64 = 1 << 20;
/// Of fewer, where time is short, none are timed.
const LEAST_QUERIES: u64 = 1 << 14;
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

/// Times every tree and traversal, and Embree's kernels, over every recording, `rounds` times after one that is dropped. All prepared trees are in
/// memory at once. Takes a thread of its own, which it pins. With a budget, as many queries are timed as are expected to fit in it, from what
/// counting them took (`results`); where those are too few, what is returned of a recording is a line that says so.
///
/// # Errors
/// When a file is damaged.
pub(super) fn time(
    trees: &[Candidate],
    (recordings, results): (&[Recording], &[RecordingResult]),
    settings: &Settings,
    (rounds, budget): (u32, Option<Duration>),
    mut scenes: Option<&mut EmbreeScenes>,
) -> Result<Vec<Result<Timing, String>>, CompareError> {
    let started = Instant::now();
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
        for (recording, result) in recordings.iter().zip(results) {
            let Recording { path, .. } = recording;
            let mut queries = Queries::read(recording, settings)
                .map_err(|source| CompareError::File { path: path.clone(), source })?;
            let kernels = own_trees + trees.len();
            if let Some(budget) = budget {
                // Of what is left, each recording that is left has its part.
                let left = budget.saturating_sub(started.elapsed()).as_secs_f64();
                let left = left / (recordings.len() - timings.len()) as f64;
                match affordable(result, (ways.len(), kernels), f64::from(rounds + 1), left) {
                    Ok(most) => queries = queries.thinned(most, settings),
                    Err(why) => {
                        timings.push(Err(why));
                        continue;
                    }
                }
            }
            let Rounds { taken, taken_by_kernels, sorting } =
                Rounds::measure(&queries, &contenders, settings, rounds, (scenes.as_deref_mut(), kernels));
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
            timings.push(Ok(Timing {
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
            }));
        }
        Ok(timings)
    };
    std::thread::scope(|scope| match std::thread::Builder::new().spawn_scoped(scope, measure) {
        Ok(thread) => thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
        Err(error) if budget.is_some() => Ok(recordings
            .iter()
            .map(|_| Err(format!("No times: there is no thread for them: {error}.")))
            .collect()),
        Err(error) => Err(CompareError::Thread(error)),
    })
}

/// How many queries can be timed in `left` seconds, in so many rounds and ways beside the plain one, under so many of Embree's trees.
///
/// # Errors
/// A line, when those are too few.
fn affordable(
    result: &RecordingResult,
    (ways, kernels): (usize, usize),
    rounds: f64,
    left: f64,
) -> Result<usize, String> {
    let run = |run: &Run| {
        let total = &run.outcome.tallies.total;
        total.seconds / total.queries.max(1) as f64
    };
    let trees = result.trees.iter();
    let ours: f64 = trees.clone().flat_map(|tree| &tree.runs).map(run).sum();
    let least: f64 = trees.map(|tree| tree.runs.iter().map(run).fold(f64::INFINITY, f64::min)).sum();
    let each = ours * (1 + ways) as f64 + least * kernels as f64 / result.trees.len() as f64;
    let all = result.trees[0].runs[0].outcome.tallies.total.queries.min(MOST_QUERIES);
    let fewest = all.min(LEAST_QUERIES) as f64;
    let affordable = left / (rounds * each);
    if affordable < fewest {
        let seconds = rounds * each * fewest;
        return Err(format!("No times: they would take {seconds:.1} s or more; --time measures them."));
    }
    Ok(affordable.min(all as f64) as usize)
}
