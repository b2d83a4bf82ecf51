//! Changes to the pieces of a `.rays`: fields of its headers, bodies before and after compression, the order of chunks, the index.

use super::super::edit::{Value, pick, set};
use super::pieces::{Piece, Pieces};
use arbitrary::Arbitrary;

/// A field of a chunk's header or the index's.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub(super) enum Field {
    Magic,
    Codec,
    Scene,
    Records,
    Rejects,
    Thread,
    Sequence,
    Stored,
    Decoded,
    Checksum,
    Reserved,
}

impl Field {
    fn range(self) -> std::ops::Range<usize> {
        match self {
            Field::Magic => 0..4,
            Field::Codec => 4..5,
            Field::Scene => 6..8,
            Field::Records => 8..12,
            Field::Rejects => 12..16,
            Field::Thread => 16..20,
            Field::Sequence => 24..32,
            Field::Stored => 32..40,
            Field::Decoded => 40..48,
            Field::Checksum => 48..56,
            Field::Reserved => 56..64,
        }
    }
}

/// What becomes of a body.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub(super) enum Body {
    Byte {
        at: u16,
        value: u8,
    },
    /// Compressed anew, with a change to what it decodes to; a raw body only changes.
    Plain {
        at: u16,
        value: u8,
    },
    PlainLonger(u8),
    PlainShorter(u8),
    /// A second frame behind the first.
    Twice,
    /// An empty skippable frame behind it, or before it.
    Skippable {
        before: bool,
    },
    Longer(u8),
    Shorter(u8),
    Empty,
    /// By a streaming encoder, which does not state the size of the content, at another level.
    Streamed(u8),
}

/// A change to one piece, or to their order.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub(super) enum Edit {
    Header { at: u8, value: Value },
    Chunk { chunk: u8, field: Field, value: Value },
    Body { chunk: u8, body: Body },
    Swap(u8, u8),
    Repeat(u8),
    Remove(u8),
    Index { field: Field, value: Value },
    Entry { entry: u8, at: u8, value: Value },
    EntryRemoved,
    End { at: u8, value: Value },
}

impl Body {
    fn apply(self, piece: &mut Piece) {
        let compressed = piece.header[4] == 1;
        let body = &mut piece.body;
        let plain = |body: &[u8]| match compressed {
            true => zstd::bulk::decompress(body, 1 << 20).unwrap_or_default(),
            false => body.to_vec(),
        };
        let stored = |plain: Vec<u8>| match compressed {
            true => zstd::bulk::compress(&plain, 1).unwrap_or_default(),
            false => plain,
        };
        match self {
            Body::Byte { at, value } => set(body, at, value),
            Body::Plain { at, value } => {
                let mut content = plain(body);
                set(&mut content, at, value);
                *body = stored(content);
            }
            Body::PlainLonger(count) => {
                let mut content = plain(body);
                content.resize(content.len() + count as usize, count);
                *body = stored(content);
            }
            Body::PlainShorter(count) => {
                let mut content = plain(body);
                content.truncate(content.len().saturating_sub(count.into()));
                *body = stored(content);
            }
            Body::Twice => body.extend(body.clone()),
            Body::Skippable { before } => {
                let frame = [0x50, 0x2A, 0x4D, 0x18, 0, 0, 0, 0];
                let at = if before { 0 } else { body.len() };
                body.splice(at..at, frame);
            }
            Body::Longer(count) => body.resize(body.len() + count as usize, 0),
            Body::Shorter(count) => body.truncate(body.len().saturating_sub(count.into())),
            Body::Empty => body.clear(),
            Body::Streamed(level) => {
                *body = zstd::encode_all(&plain(body)[..], (level % 10).into()).unwrap_or_default();
            }
        }
        piece.header[Field::Stored.range()].copy_from_slice(&(piece.body.len() as u64).to_le_bytes());
    }
}

impl Edit {
    /// Changes the pieces; whether what is around the chunks is as it was.
    pub(super) fn apply(self, pieces: &mut Pieces) -> bool {
        let chunks = &mut pieces.chunks;
        match self {
            Edit::Header { at, value } => {
                let at = at as usize % 16 * 4;
                value.apply(&mut pieces.header[at..at + 4]);
                return false;
            }
            Edit::Chunk { chunk, field, value } => {
                if let Some(piece) = pick(chunks, chunk) {
                    value.apply(&mut piece.header[field.range()]);
                    piece.unchanged = None;
                }
            }
            Edit::Body { chunk, body } => {
                if let Some(piece) = pick(chunks, chunk) {
                    body.apply(piece);
                    piece.unchanged = None;
                }
            }
            Edit::Swap(a, b) if !chunks.is_empty() => {
                let count = chunks.len();
                chunks.swap(a as usize % count, b as usize % count);
            }
            Edit::Repeat(chunk) if chunks.len() < 16 => {
                let copy = pick(chunks, chunk).cloned();
                chunks.extend(copy);
            }
            Edit::Remove(chunk) if !chunks.is_empty() => drop(chunks.remove(chunk as usize % chunks.len())),
            Edit::Swap(..) | Edit::Repeat(_) | Edit::Remove(_) => {}
            Edit::Index { field, value } => {
                value.apply(&mut pieces.index_header[field.range()]);
                return false;
            }
            Edit::Entry { entry, at, value } => {
                if let Some(entry) = pick(&mut pieces.entries, entry) {
                    let range = [0..8, 8..12, 12..16][at as usize % 3].clone();
                    value.apply(&mut entry[range]);
                }
                return false;
            }
            Edit::EntryRemoved => drop(pieces.entries.pop()),
            Edit::End { at, value } => {
                let at = at as usize % 2 * 8;
                value.apply(&mut pieces.end[at..at + 8]);
                return false;
            }
        }
        true
    }
}
