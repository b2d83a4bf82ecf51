//! Reads one recording query by query: in place while both files agree, into memory where a piece has to be looked at as a whole.

use super::query::{Kept, Query};
use crate::format::FormatError;
use crate::format::rays::{Chunk, Rays};
use std::collections::VecDeque;

/// Where reading has come to.
pub(super) struct Reader<'r, 'a> {
    rays: &'r Rays<'a>,
    chunk: Option<Chunk<'a>>,
    next_chunk: usize,
    /// Queries of `chunk` that have been taken.
    taken: usize,
    /// Number in the file of the next query.
    number: u64,
}

impl<'r, 'a> Reader<'r, 'a> {
    pub(super) fn new(rays: &'r Rays<'a>) -> Reader<'r, 'a> {
        Reader { rays, chunk: None, next_chunk: 0, taken: 0, number: 0 }
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Queries that can be looked at without reading on.
    pub(super) fn at_hand(&self) -> usize {
        self.chunk.as_ref().map_or(0, |chunk| chunk.records.len() - self.taken)
    }

    /// Makes sure that there is one at hand, unless the file has ended.
    pub(super) fn fill(&mut self) -> Result<bool, FormatError> {
        while self.at_hand() == 0 {
            if self.next_chunk == self.rays.chunks().len() {
                return Ok(false);
            }
            self.chunk = Some(self.rays.chunk(self.next_chunk)?);
            self.next_chunk += 1;
            self.taken = 0;
        }
        Ok(true)
    }

    /// The chunk at hand and how many of its queries have been taken; none before [`Self::fill`].
    pub(super) fn chunk(&self) -> Option<(&Chunk<'a>, usize)> {
        self.chunk.as_ref().map(|chunk| (chunk, self.taken))
    }

    pub(super) fn take(&mut self, count: usize) {
        self.taken += count;
        self.number += count as u64;
    }

    /// Takes `count` queries, or what the file still has, behind those in `window`; true when the file has ended.
    pub(super) fn keep(&mut self, count: usize, window: &mut VecDeque<Kept>) -> Result<bool, FormatError> {
        let mut left = count;
        while left > 0 {
            if !self.fill()? {
                return Ok(true);
            }
            let number = self.number;
            let taken = left.min(self.at_hand());
            if let Some((chunk, start)) = self.chunk() {
                window.extend((0..taken).map(|ahead| {
                    let query = query(chunk, start + ahead, number + ahead as u64);
                    let Query { number, scene, record, rejects } = query;
                    Kept { number, scene, record: *record, rejects: rejects.into() }
                }));
            }
            self.take(taken);
            left -= taken;
        }
        Ok(false)
    }
}

/// The query at `place` of a chunk.
pub(super) fn query<'c>(chunk: &'c Chunk, place: usize, number: u64) -> Query<'c> {
    let (record, rejects) = (&chunk.records[place], chunk.rejects_of(place));
    Query { number, scene: chunk.info.scene, record, rejects }
}
