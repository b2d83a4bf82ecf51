//! Reading a file whose recording was cut off: every chunk whose checksum holds is kept.

use super::layout::{CHUNK_MAGIC, ChunkEntry, ChunkHeader, HEADER_BYTES, INDEX_MAGIC};
use crate::format::{ALIGNMENT, align, checksum};

/// What was saved of a file without an end mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recovery {
    /// Queries in the chunks that are whole.
    pub queries: u64,
    /// Bytes that belong to no whole chunk.
    pub lost_bytes: u64,
}

/// Finds the whole chunks of a file. Behind one that is damaged, the search goes on at every place where a chunk could start.
///
/// Hashing is bounded: chunks that turn out damaged may cost as much as four times the file, then the search ends.
/// Without that bound, a file made of overlapping chunk headers would take time quadratic in its length.
pub(super) fn recover(bytes: &[u8]) -> (Vec<ChunkEntry>, Recovery) {
    let length = bytes.len() as u64;
    let mut chunks: Vec<ChunkEntry> = Vec::new();
    let mut kept = HEADER_BYTES;
    let mut budget = length.saturating_mul(4);
    let mut offset = HEADER_BYTES;
    while offset < length {
        if let Some(entry) = plausible(bytes, offset) {
            let body = &bytes[entry.body() as usize..(entry.body() + entry.stored_bytes) as usize];
            if checksum(body) == entry.checksum {
                let end = entry.body() + entry.stored_bytes;
                offset = align(end).unwrap_or(length).min(length);
                kept += offset - entry.offset;
                chunks.push(entry);
                continue;
            }
            if entry.stored_bytes > budget {
                break;
            }
            budget -= entry.stored_bytes;
        } else if bytes[offset as usize..].starts_with(&INDEX_MAGIC) {
            // Only the end is missing: behind the chunks there is nothing to lose.
            kept += length - offset;
            break;
        }
        offset += ALIGNMENT;
    }
    let queries = chunks.iter().map(|chunk| u64::from(chunk.records)).sum();
    (chunks, Recovery { queries, lost_bytes: length - kept })
}

fn plausible(bytes: &[u8], offset: u64) -> Option<ChunkEntry> {
    if !bytes[offset as usize..].starts_with(&CHUNK_MAGIC) {
        return None;
    }
    ChunkHeader::read(bytes, offset).and_then(|header| header.entry(offset, bytes.len() as u64)).ok()
}
