//! Which of the program's queries are kept: in the order in which they arrive, thread by thread.

use super::exchange::Batch;
use super::purpose::{Guess, Rules};
use crate::format::rays::{Record, Reject};
use crate::replay::select::Filter;
use std::collections::HashMap;

/// What to keep.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Leave out so many at the start.
    pub skip: u64,
    /// Keep at most so many.
    pub limit: Option<u64>,
    /// Of every so many paths keep one. A path is a camera query and what the thread asks until the next; where no camera
    /// query is recognised, a query.
    pub every: u64,
    pub filter: Filter,
}

impl Default for Selection {
    fn default() -> Selection {
        Selection { skip: 0, limit: None, every: 1, filter: Filter::default() }
    }
}

/// Where the selection stands.
pub struct Selector {
    selection: Selection,
    rules: Rules,
    seen: u64,
    kept: u64,
    threads: HashMap<u32, Thread>,
}

/// What is remembered of a thread.
struct Thread {
    guess: Guess,
    /// Paths so far, and whether they start with camera queries.
    paths: u64,
    have_cameras: bool,
}

/// Records of one scene that one thread asked, one behind another.
#[derive(Debug, Default, PartialEq)]
pub struct Run {
    pub records: Vec<Record>,
    pub rejects: Vec<Reject>,
}

impl Selector {
    pub fn new(selection: Selection, rules: Rules) -> Selector {
        Selector { selection, rules, seen: 0, kept: 0, threads: HashMap::new() }
    }

    /// Whether nothing more will be kept.
    pub fn is_done(&self) -> bool {
        self.selection.limit.is_some_and(|limit| self.kept >= limit)
    }

    /// Queries that arrived.
    pub fn seen(&self) -> u64 {
        self.seen
    }

    /// Fills in purposes, and divides what is kept by scene; scenes in the order of their numbers.
    pub fn divide(&mut self, batch: &Batch) -> Vec<(u16, Run)> {
        let Selector { selection, rules, seen, kept, threads } = self;
        let new = || Thread { guess: Guess::new(*rules), paths: 0, have_cameras: false };
        let thread = threads.entry(batch.thread).or_insert_with(new);
        let mut runs: Vec<(u16, Run)> = Vec::new();
        let mut current = 0;
        let mut rejects = batch.rejects.iter().peekable();
        for (index, (record, &scene)) in batch.records.iter().zip(&batch.scenes).enumerate() {
            let mut record = *record;
            let starts = thread.guess.fill(&mut record);
            if starts || !thread.have_cameras {
                thread.paths += 1;
            }
            thread.have_cameras |= starts;
            let keep = *seen >= selection.skip
                && (selection.every == 1 || (thread.paths - 1).is_multiple_of(selection.every))
                && selection.filter.accepts(&record)
                && selection.limit.is_none_or(|limit| *kept < limit);
            *seen += 1;
            *kept += u64::from(keep);
            let own = std::iter::from_fn(|| rejects.next_if(|reject| reject.record as usize <= index));
            if !keep {
                own.for_each(drop);
                continue;
            }
            if runs.get(current).is_none_or(|(number, _)| *number != scene) {
                current = runs.iter().position(|(number, _)| *number == scene).unwrap_or(runs.len());
                if current == runs.len() {
                    let records = Vec::with_capacity(batch.records.len() - index);
                    runs.push((scene, Run { records, rejects: Vec::new() }));
                }
            }
            let run = &mut runs[current].1;
            let number = run.records.len() as u32;
            run.rejects.extend(own.map(|reject| Reject { record: number, ..*reject }));
            run.records.push(record);
        }
        runs.sort_by_key(|(scene, _)| *scene);
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::rays::{flag, kind};
    use bytemuck::Zeroable;

    /// Ten queries of two scenes; each second one of an eye at 0, each third one rejects its own number.
    fn batch() -> Batch {
        let records: Vec<Record> = (0..10)
            .map(|number| Record {
                path: number,
                kind: kind::CLOSEST_HIT,
                flags: if number % 3 == 0 { flag::HAS_REJECTS } else { 0 },
                origin: crate::geometry::Vec3::splat((number % 2) as f32),
                ..Record::zeroed()
            })
            .collect();
        let rejects = (0..10).step_by(3).map(|record| Reject { record, triangle: record }).collect();
        let scenes = (0..10).map(|number| u16::from(number >= 4 && number % 2 == 0)).collect();
        Batch { thread: 0, sequence: 100, records, scenes, rejects }
    }

    /// By scene: the numbers of what is kept, and rejects as record and triangle.
    type Kept = Vec<(u16, Vec<u32>, Vec<(u32, u32)>)>;

    fn kept(selection: Selection) -> Kept {
        let mut selector = Selector::new(selection, Rules::General);
        selector
            .divide(&batch())
            .into_iter()
            .map(|(scene, run)| {
                let rejects = run.rejects.iter().map(|reject| (reject.record, reject.triangle)).collect();
                (scene, run.records.iter().map(|record| record.path).collect(), rejects)
            })
            .collect()
    }

    #[test]
    fn rejects_follow_their_records() {
        let all = kept(Selection::default());
        assert_eq!(all[0], (0, vec![0, 1, 2, 3, 5, 7, 9], vec![(0, 0), (3, 3), (6, 9)]));
        assert_eq!(all[1], (1, vec![4, 6, 8], vec![(1, 6)]));
    }

    #[test]
    fn parts_are_chosen() {
        let numbers = |selection| {
            let mut numbers: Vec<u32> =
                kept(selection).into_iter().flat_map(|(_, numbers, _)| numbers).collect();
            numbers.sort();
            numbers
        };
        let some = |skip, limit, every, filter: &str| {
            numbers(Selection { skip, limit, every, filter: filter.parse().unwrap() })
        };
        assert_eq!(some(3, None, 1, ""), [3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(some(3, Some(2), 1, ""), [3, 4]);
        // A path is a camera query and the next one.
        assert_eq!(some(0, None, 2, ""), [0, 1, 4, 5, 8, 9]);
        assert_eq!(some(0, None, 1, "purpose=camera"), [0, 2, 4, 6, 8]);
        assert_eq!(some(0, Some(2), 2, "purpose=unknown"), [1, 5]);
        assert_eq!(some(0, None, 1, "kind=occlusion"), [0; 0]);
    }
}
