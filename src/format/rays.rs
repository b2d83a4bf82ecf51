//! `.rays`: ray queries and their results.
//!
//! Writing: records in batches → `codec` encodes each batch as a chunk, on any thread → [`RaysWriter`] puts chunks
//! one behind another and an index at the end. Reading: [`Rays::parse`] checks the header, every chunk's header and
//! the index (or, when recording was cut off, recovers what is whole) without touching the bodies; [`Rays::chunk`]
//! checks one body and gives its records, in place where they are stored raw.

mod codec;
mod layout;
mod read;
mod record;
mod recover;
mod write;

pub use codec::{Codec, EncodedChunk, encode_chunk};
pub use layout::{ChunkEntry, ChunkInfo, Header, MAX_CHUNK_RECORDS, MAX_DECODED_BYTES};
pub use read::{Chunk, Rays};
pub use record::{NO_DEPTH, NO_PATH, NO_TRIANGLE, Purpose, Record, Reject, flag, kind};
pub use recover::Recovery;
pub use write::{RaysWriter, Totals};
