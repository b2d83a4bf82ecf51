//! Counts what a comparison finds, query by query and pixel by pixel.

use super::pairing::{Event, pair_up};
use super::path_set::PathSet;
use super::query::{Judge, Kept, Query, Relation, describe, known_depth, unpaired};
use super::report::{Differing, First, PixelReport, QueryReport, Report};
use super::{DiffError, Options, Tolerance};
use crate::format::rays::{NO_PATH, Record};
use crate::replay::pixels::ImageSize;

/// Pixels that differ of which the report tells.
const FIRST_PIXELS: usize = 10;

/// What has been found so far. Its memory is that of a few sets of pixels.
pub(super) struct Tally<'o> {
    pub(super) judge: Judge<'o>,
    pub(super) report: Report,
    image: Option<ImageSize>,
    /// Whether queries come in the order in which they were asked.
    in_order: bool,
    queries: QueryReport,
    /// Pixels that either recording asked for, those with differences, and those with ties.
    seen: PathSet,
    differing: PathSet,
    tied: PathSet,
    /// Pixels with a tie whose path goes on: it ends at the pixel's next camera ray.
    behind_tie: PathSet,
    last_seen: u32,
    first_pixels: Vec<Differing>,
}

impl<'o> Tally<'o> {
    pub(super) fn new(report: Report, options: &Options<'o>) -> Tally<'o> {
        Tally {
            judge: Judge::new(options),
            report,
            image: options.image,
            in_order: !options.any_order,
            queries: QueryReport::default(),
            seen: PathSet::default(),
            differing: PathSet::default(),
            tied: PathSet::default(),
            behind_tie: PathSet::default(),
            last_seen: NO_PATH,
            first_pixels: Vec::new(),
        }
    }

    pub(super) fn answers(&self) -> Tolerance {
        self.judge.answers
    }

    /// Pixels that either recording asked for.
    pub(super) fn see(&mut self, paths: PathSet) {
        self.seen.unite(paths);
    }

    /// Differences that are too many to be looked at: queries of A and of B without an equal.
    pub(super) fn only_counted(&mut self, of_a: u64, of_b: u64) {
        let changed = of_a.min(of_b);
        self.queries.changed += changed;
        self.queries.missing += of_a - changed;
        self.queries.added += of_b - changed;
        let count = of_a.max(of_b);
        self.report.differences += count;
        if count > 0 {
            *self.report.by_value.entry("only counted").or_default() += count;
        }
    }

    /// A query that is in both files.
    pub(super) fn agree(&mut self, record: &Record) {
        // Queries of one pixel follow upon another, mostly.
        if record.path != self.last_seen && record.path != NO_PATH {
            self.last_seen = record.path;
            self.seen.insert(record.path);
        }
        if record.depth == 0 && !self.behind_tie.is_empty() {
            self.behind_tie.remove(record.path);
        }
    }

    /// A query of A and the one of B that answers to it.
    pub(super) fn pair(&mut self, a: &Query, b: &Query) {
        let relation = self.judge.compare(a, b);
        self.relate(a, b, relation);
    }

    /// The same when it is known how they compare.
    pub(super) fn relate(&mut self, a: &Query, b: &Query, relation: Relation) {
        self.agree(a.record);
        match relation {
            Relation::Same => {}
            Relation::Tie => {
                self.queries.ties += 1;
                if a.record.path != NO_PATH {
                    self.tied.insert(a.record.path);
                    if self.in_order {
                        self.behind_tie.insert(a.record.path);
                    }
                }
            }
            Relation::Changed(fields) => {
                self.queries.changed += 1;
                self.differ_at(a.record);
                let image = self.image;
                self.report.differ(&fields.names(), || First {
                    element: describe(a, image),
                    values: fields.values(a, b),
                });
            }
        }
    }

    /// A piece of A and a piece of B in which queries differ.
    pub(super) fn pair_up(&mut self, a: &[Kept], b: &[Kept]) {
        let a: Vec<Query> = a.iter().map(Kept::query).collect();
        let b: Vec<Query> = b.iter().map(Kept::query).collect();
        for event in pair_up(&self.judge, &a, &b) {
            match event {
                Event::Pair(one, other) => self.pair(&a[one], &b[other]),
                Event::Missing(one) => self.missing(&a[one]),
                Event::Added(other) => self.added(&b[other]),
            }
        }
    }

    pub(super) fn missing(&mut self, a: &Query) {
        self.queries.missing += 1;
        self.unpaired(a, "A", "only in A");
    }

    pub(super) fn added(&mut self, b: &Query) {
        self.queries.added += 1;
        self.unpaired(b, "B", "only in B");
    }

    fn unpaired(&mut self, query: &Query, only: &'static str, value: &'static str) {
        self.agree(query.record);
        self.differ_at(query.record);
        let image = self.image;
        self.report.differ(&[value], || unpaired(query, only, image));
    }

    fn differ_at(&mut self, record: &Record) {
        let path = record.path;
        if path == NO_PATH {
            return;
        }
        if self.behind_tie.contains(path) {
            self.queries.after_ties += 1;
        }
        if self.differing.insert(path) && self.first_pixels.len() < FIRST_PIXELS {
            self.first_pixels.push(Differing::new(path, known_depth(record), self.image));
        } else if let Some(pixel) = self.first_pixels.iter_mut().find(|pixel| pixel.path == path) {
            pixel.differences += 1;
        }
    }

    /// The report, with what belongs to the whole.
    ///
    /// # Errors
    /// When a tree was not that of its recording.
    pub(super) fn finish(self) -> Result<Report, DiffError> {
        self.judge.finish()?;
        let Tally { mut report, mut queries, seen, differing, tied, first_pixels, .. } = self;
        queries.pixels = (!seen.is_empty()).then(|| PixelReport {
            total: seen.len(),
            agree: seen.len() - differing.len(),
            agree_with_ties: tied.count_without(&differing),
            first: first_pixels,
        });
        report.queries = Some(queries);
        Ok(report)
    }
}
