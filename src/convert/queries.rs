//! Queries on their way from one file to another, a piece of at most a chunk at a time.

use super::{ConvertError, Losses};
use crate::format::rays::{Chunk, Header, MAX_CHUNK_RECORDS, Reject};
use crate::progress::Progress;
use crate::replay::scene::Scenes;
use crate::replay::select::{Filter, Sample};
use std::borrow::Cow;
use std::ops::Range;

/// Where queries come from.
pub trait Source {
    /// What is known of all of them.
    fn header(&self) -> Header;

    /// How many there are.
    fn count(&self) -> u64;

    /// The next piece, checked: what [`crate::format::rays::encode_chunk`] takes. `None` at the end.
    ///
    /// # Errors
    /// At the first thing in the input that cannot be.
    fn next(&mut self) -> Result<Option<Chunk<'_>>, ConvertError>;

    /// What of the input has no place in our records, so far.
    fn losses(&self) -> Losses {
        Losses::default()
    }
}

/// Where queries go.
pub trait Sink {
    /// # Errors
    /// When the output cannot be written.
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError>;

    /// Writes what belongs at the end, and says what could not be kept.
    ///
    /// # Errors
    /// When the output cannot be written.
    fn finish(self: Box<Self>) -> Result<Losses, ConvertError>;
}

/// The numbers of the queries of a file without chunks, so many at a time as a chunk may hold.
pub(super) struct Pieces {
    next: u64,
    pub(super) count: u64,
}

impl Pieces {
    pub(super) fn of(count: u64) -> Pieces {
        Pieces { next: 0, count }
    }
}

impl Iterator for Pieces {
    type Item = Range<u64>;

    fn next(&mut self) -> Option<Range<u64>> {
        let first = self.next;
        self.next = self.count.min(first + MAX_CHUNK_RECORDS as u64);
        (first < self.next).then_some(first..self.next)
    }
}

/// Which queries to convert: a sample of the file as for `bvh-compare`, and of that what passes the filter.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    pub filter: Filter,
    /// Evenly chosen, of the whole file.
    pub sample: Option<u64>,
    /// Only of this scene.
    pub scene: Option<u16>,
}

/// What a source says of its scenes; reads it to its end.
///
/// # Errors
/// When it is damaged.
pub fn scenes(source: &mut dyn Source) -> Result<Scenes, ConvertError> {
    let mut scenes = Scenes { fingerprint: source.header().fingerprint, ..Scenes::default() };
    while let Some(chunk) = source.next()? {
        if !chunk.records.is_empty() {
            scenes.numbers.insert(chunk.info.scene);
        }
    }
    Ok(scenes)
}

impl Selection {
    fn is_everything(&self) -> bool {
        self.sample.is_none() && self.scene.is_none() && self.filter == Filter::default()
    }

    /// How many queries of `source` are chosen; reads it to its end where that must be seen.
    ///
    /// # Errors
    /// When the source is damaged.
    pub fn count(&self, source: &mut dyn Source) -> Result<u64, ConvertError> {
        if self.is_everything() {
            return Ok(source.count());
        }
        let total = source.count();
        let (mut start, mut count) = (0, 0);
        while let Some(chunk) = source.next()? {
            count += self.within(&chunk, start, total).count() as u64;
            start += chunk.records.len() as u64;
        }
        Ok(count)
    }

    /// The places of the chosen ones among the records of a chunk, of which the first is number
    /// `start` of `total`.
    fn within<'a>(&'a self, chunk: &'a Chunk, start: u64, total: u64) -> impl Iterator<Item = usize> + 'a {
        let records = &chunk.records;
        let is_chosen = self.scene.is_none_or(|scene| scene == chunk.info.scene);
        let sample = self.sample.and_then(|size| Sample::new(size, total));
        let whole = start..start + records.len() as u64;
        let places: Box<dyn Iterator<Item = u64>> = match sample {
            Some(sample) => Box::new(sample.within(whole)),
            None => Box::new(whole),
        };
        places
            .map(move |number| (number - start) as usize)
            .filter(move |&place| is_chosen && self.filter.accepts(&records[place]))
    }

    /// The part of a chunk that is chosen.
    fn of<'a>(&self, chunk: Chunk<'a>, start: u64, total: u64) -> Chunk<'a> {
        if self.is_everything() {
            return chunk;
        }
        let mut records = Vec::new();
        let mut rejects = Vec::new();
        for place in self.within(&chunk, start, total) {
            let moved = |reject: &Reject| Reject { record: records.len() as u32, ..*reject };
            rejects.extend(chunk.rejects_of(place).iter().map(moved));
            records.push(chunk.records[place]);
        }
        Chunk { info: chunk.info, records: Cow::Owned(records), rejects: Cow::Owned(rejects) }
    }
}

/// Takes every chosen query from `source` to `sink`, and returns how many that were, and what was lost. `progress` advances by query of
/// the source; `change` may complete records on the way, but not their number.
///
/// # Errors
/// When the input is damaged, or the output cannot be written.
pub fn copy(
    source: &mut dyn Source,
    selection: &Selection,
    mut change: impl FnMut(&mut Chunk),
    mut sink: Box<dyn Sink + '_>,
    progress: &Progress,
) -> Result<(u64, Losses), ConvertError> {
    let total = source.count();
    let (mut start, mut chosen) = (0, 0);
    while let Some(chunk) = source.next()? {
        let read = chunk.records.len() as u64;
        let mut chunk = selection.of(chunk, start, total);
        start += read;
        chosen += chunk.records.len() as u64;
        if !chunk.records.is_empty() {
            change(&mut chunk);
            sink.write(&chunk)?;
        }
        progress.advance(read);
    }
    Ok((chosen, source.losses().and(sink.finish()?)))
}
