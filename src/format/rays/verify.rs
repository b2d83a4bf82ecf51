//! The checks of a `.rays` that reading does not need: whether results agree with themselves, and threads with their sequence.

use super::read::{Chunk, Rays};
use super::record::{NO_TRIANGLE, Record, flag};
use crate::format::FormatError;
use std::mem::offset_of;

impl Rays<'_> {
    /// Reads every chunk, and checks that each result is one: a closest hit has a finite t and a triangle (or says that it hit
    /// something else), a miss has +inf and none; an occlusion has -inf when it hit and +inf when not. Also that the sequence
    /// numbers of one thread's chunks do not overlap.
    ///
    /// # Errors
    /// At the first chunk, in file order, for which that does not hold.
    pub fn verify(&self) -> Result<(), FormatError> {
        self.check_sequences()?;
        self.fold_chunks(
            || None,
            |first, index, chunk| keep_first(first, self.check_results(index, &chunk)),
            earlier,
        )?
        .map_or(Ok(()), Err)
    }

    fn check_sequences(&self) -> Result<(), FormatError> {
        let mut sorted: Vec<_> = self.chunks().iter().filter(|chunk| chunk.records > 0).collect();
        sorted.sort_by_key(|chunk| (chunk.info.thread, chunk.info.sequence));
        for pair in sorted.windows(2) {
            let [before, after] = [pair[0].info, pair[1].info];
            let end = before.sequence.saturating_add(pair[0].records.into());
            if before.thread == after.thread && after.sequence < end {
                let name = format!("sequence number of a chunk of thread {}", after.thread);
                let expected = format!("at least {end}, behind the chunk at byte {}", pair[0].offset);
                return Err(FormatError::field(pair[1].offset + 24, name, after.sequence, expected));
            }
        }
        Ok(())
    }

    /// The first record of a chunk whose result is none. Offsets are those in the file where the chunk is raw, and the start of the
    /// body where it is compressed.
    fn check_results(&self, index: usize, chunk: &Chunk) -> Option<FormatError> {
        let record = chunk.records.iter().position(|record| !is_result(record))?;
        let entry = &self.chunks()[index];
        let within = match entry.codec {
            super::Codec::Raw => record * size_of::<Record>() + offset_of!(Record, t),
            super::Codec::Compressed => 0,
        };
        let Record { t, triangle, kind, flags, .. } = chunk.records[record];
        let found = format!("kind {kind}, flags {flags:#x}, t {t}, triangle {triangle}");
        let name = format!("result of record {record}");
        Some(FormatError::field(
            entry.body() + within as u64,
            name,
            found,
            "flags, t and triangle that agree",
        ))
    }
}

fn is_result(record: &Record) -> bool {
    match (record.is_occlusion(), record.is_hit()) {
        (true, true) => record.t == f32::NEG_INFINITY,
        (_, false) => record.t == f32::INFINITY && record.triangle == NO_TRIANGLE,
        (false, true) => {
            let undecided = record.flags & flag::UNDECIDED != 0;
            record.t.is_finite() && (record.triangle != NO_TRIANGLE || undecided)
        }
    }
}

fn keep_first(first: &mut Option<FormatError>, next: Option<FormatError>) {
    *first = earlier(first.take(), next);
}

fn earlier(a: Option<FormatError>, b: Option<FormatError>) -> Option<FormatError> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.offset < a.offset { b } else { a }),
        (a, b) => a.or(b),
    }
}
