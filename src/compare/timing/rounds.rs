//! Rounds in which all contenders take turns.

use super::super::Settings;
use super::super::kernels::EmbreeScenes;
use super::queries::Queries;
use super::{Way, clock};
use crate::replay::tally::Cell;
use crate::replay::together::Together;
use crate::traverse::packet::MOST;
use crate::traverse::{OcclusionOrder, Prepared, Scratch, Traversal};
use std::hint::black_box;
use std::ops::Range;

/// One tree under one traversal, asked in one way.
pub(super) struct Contender<'a> {
    pub prepared: &'a Prepared,
    pub traversal: Traversal,
    pub order: &'a OcclusionOrder,
    pub way: Way,
}

impl Contender<'_> {
    /// Seconds of each run.
    fn round(&self, queries: &Queries, scratch: &mut Scratch) -> Vec<f64> {
        let (mut together, mut answers) = (Together::default(), [None; MOST]);
        let mut ready = Vec::new();
        let timed = |(_, range): &(Cell, Range<usize>)| {
            // As Embree's are: queries are made before the clock runs.
            ready.clear();
            ready.extend(queries.run(range));
            let start = clock::thread_seconds();
            match self.way.packet {
                None => {
                    for query in &ready {
                        black_box(query.ask(self.prepared, self.traversal, self.order, &mut (), scratch));
                    }
                }
                Some(size) => {
                    for packet in ready.chunks(size) {
                        let packet = packet.iter().copied();
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

/// Seconds of all contenders, in which they took turns.
pub(super) struct Rounds {
    /// By contender, round and run.
    pub taken: Vec<Vec<Vec<f64>>>,
    /// The same of Embree's kernels; no round where they could not be asked.
    pub taken_by_kernels: Vec<Vec<Vec<f64>>>,
    /// To sort all queries, by round.
    pub sorting: Vec<f64>,
}

impl Rounds {
    /// Of so many rounds after one that is dropped, with Embree's scenes where there are any and how many trees these have.
    pub fn measure(
        queries: &Queries,
        contenders: &[Contender],
        settings: &Settings,
        rounds: u32,
        (mut scenes, kernels): (Option<&mut EmbreeScenes>, usize),
    ) -> Rounds {
        let sorted = settings.sort.map(|sort| queries.clone().sorted(sort));
        let mut scratch = Scratch::default();
        let mut all = Rounds {
            taken: vec![Vec::new(); contenders.len()],
            taken_by_kernels: vec![Vec::new(); kernels],
            sorting: Vec::new(),
        };
        for round in 0..=rounds {
            for (contender, taken) in contenders.iter().zip(&mut all.taken) {
                let queries = sorted.as_ref().filter(|_| contender.way.sorted).unwrap_or(queries);
                let seconds = contender.round(queries, &mut scratch);
                taken.extend((round > 0).then_some(seconds));
            }
            if let Some(sort) = settings.sort {
                let unsorted = queries.clone();
                let start = clock::thread_seconds();
                black_box(unsorted.sorted(sort));
                all.sorting.extend((round > 0).then_some(clock::thread_seconds() - start));
            }
            if let Some(scenes) = &mut scenes {
                for (number, taken) in all.taken_by_kernels.iter_mut().enumerate() {
                    let runs = queries.runs.iter().map(|(_, range)| queries.run(range));
                    taken.extend(scenes.round(number, runs).filter(|_| round > 0));
                }
            }
        }
        all
    }
}
