//! The ray files of RayVisualizer (2011), read and written.
//!
//! Little-endian words: 32 bytes a query, `i32 id, i32 depth, f32[3] origin, f32[3] v`, and at the end `i32 9215`. id 0: closest hit that hit,
//! v from the origin to the hit; 1: closest hit that missed, v the direction; 2: occlusion that was blocked, 3: one that was
//! not, v from the origin to the target. There is no interval, no triangle, no pixel: see [`Rays2011Source`] and [`Rays2011Sink`] for what becomes of them.

use super::queries::Pieces;
use super::{ConvertError, Losses, Sink, Source};
use crate::format::rays::{
    Chunk, ChunkInfo, Header, NO_DEPTH, NO_PATH, NO_TRIANGLE, Purpose, Record, flag, kind,
};
use crate::format::{FormatError, Problem};
use crate::geometry::Vec3;
use bytemuck::{Pod, Zeroable};
use std::borrow::Cow;
use std::io::Write;
use std::ops::Range;

/// The word that ends a file.
const END: i32 = 9215;

/// Values of [`Legacy::id`].
mod id {
    pub const HIT: i32 = 0;
    pub const MISS: i32 = 1;
    pub const BLOCKED: i32 = 2;
    pub const UNBLOCKED: i32 = 3;
}

/// A query as it stands in the file: 32 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct Legacy {
    id: i32,
    depth: i32,
    origin: Vec3,
    v: Vec3,
}

const BYTES: usize = size_of::<Legacy>();

/// Whether the length and the last word are those of such a file.
pub fn looks_like(bytes: &[u8]) -> bool {
    bytes.len() % BYTES == size_of_val(&END) && bytes.ends_with(&END.to_le_bytes())
}

/// Reads a file. A query's interval is [0, +inf) for a closest hit, whose t is 1 where it hit, and [0, 1] for an occlusion; it sees every
/// geometry, at time 0. The triangle of a hit is not known, so the flag [`flag::UNDECIDED`] says that no triangle decides it.
pub struct Rays2011Source<'a> {
    bytes: &'a [u8],
    pieces: Pieces,
    losses: Losses,
}

impl<'a> Rays2011Source<'a> {
    /// Checks the length and the end; the queries are checked as they are read.
    ///
    /// # Errors
    /// When the file is cut off or is none of these.
    pub fn parse(bytes: &'a [u8]) -> Result<Rays2011Source<'a>, FormatError> {
        let count = bytes.len() / BYTES;
        let tail = &bytes[count * BYTES..];
        let offset = (count * BYTES) as u64;
        if tail.len() < size_of_val(&END) {
            let (what, available) = ("end of a 2011 ray file (the word 9215)", tail.len() as u64);
            return Err(FormatError::new(offset, Problem::Truncated { what, needed: Some(4), available }));
        }
        if tail != END.to_le_bytes() {
            let expected = format!("the word {END} behind whole records of {BYTES} bytes");
            let name = "end of a 2011 ray file";
            return Err(FormatError::field(offset, name, format!("\"{}\"", tail.escape_ascii()), expected));
        }
        Ok(Rays2011Source { bytes, pieces: Pieces::of(count as u64), losses: Losses::default() })
    }

    fn record(&mut self, legacy: &Legacy, offset: u64) -> Result<Record, FormatError> {
        let Legacy { id, depth, origin, v } = *legacy;
        let (kind, hit, tfar, t) = match id {
            id::HIT => (kind::CLOSEST_HIT, true, f32::INFINITY, 1.0),
            id::MISS => (kind::CLOSEST_HIT, false, f32::INFINITY, f32::INFINITY),
            id::BLOCKED => (kind::OCCLUSION, true, 1.0, f32::NEG_INFINITY),
            id::UNBLOCKED => (kind::OCCLUSION, false, 1.0, f32::INFINITY),
            other => return Err(FormatError::field(offset, "id of a query", other, "0, 1, 2 or 3")),
        };
        let known = u8::try_from(depth).ok().filter(|&depth| depth != NO_DEPTH);
        if known.is_none() && depth != UNKNOWN_DEPTH {
            self.losses.lose("depth that is not from 0 to 254", 1);
        }
        let undecided = if id == id::HIT { flag::UNDECIDED } else { 0 };
        Ok(Record {
            origin,
            tnear: 0.0,
            direction: v,
            tfar,
            time: 0.0,
            mask: u32::MAX,
            t,
            triangle: NO_TRIANGLE,
            u: 0.0,
            v: 0.0,
            path: NO_PATH,
            kind,
            depth: known.unwrap_or(NO_DEPTH),
            flags: if hit { flag::HIT | undecided } else { 0 },
            purpose: Purpose::Unknown as u8,
        })
    }
}

/// The depth that we write where none is known.
const UNKNOWN_DEPTH: i32 = -1;

impl Source for Rays2011Source<'_> {
    fn header(&self) -> Header {
        Header { producer: "RayVisualizer, converted".into(), ..Header::default() }
    }

    fn count(&self) -> u64 {
        self.pieces.count
    }

    fn next(&mut self) -> Result<Option<Chunk<'_>>, ConvertError> {
        let Some(Range { start: first, end }) = self.pieces.next() else { return Ok(None) };
        let piece = &self.bytes[first as usize * BYTES..end as usize * BYTES];
        let mut records = Vec::with_capacity(piece.len() / BYTES);
        for (place, bytes) in piece.chunks_exact(BYTES).enumerate() {
            // The map of a file is aligned, but any slice is taken.
            let legacy: Legacy = bytemuck::pod_read_unaligned(bytes);
            records.push(self.record(&legacy, (first + place as u64) * BYTES as u64)?);
        }
        let info = ChunkInfo { sequence: first, ..ChunkInfo::default() };
        Ok(Some(Chunk { info, records: Cow::Owned(records), rejects: Cow::Borrowed(&[]) }))
    }

    fn losses(&self) -> Losses {
        self.losses.clone()
    }
}

/// Writes a file. v is t · direction for a hit, the direction for a miss, tfar · direction for an occlusion. A query without such
/// a vector is left out; values that the format has no place for are lost.
pub struct Rays2011Sink<W: Write> {
    out: W,
    losses: Losses,
}

impl<W: Write> Rays2011Sink<W> {
    /// `header` is that of the queries.
    pub fn new(out: W, header: &Header) -> Rays2011Sink<W> {
        let mut losses = Losses::default();
        losses.lose_header(header);
        Rays2011Sink { out, losses }
    }

    /// The query as the format has it, or why it has no place for it.
    fn legacy(record: &Record) -> Result<Legacy, &'static str> {
        let (id, v) = match (record.is_occlusion(), record.is_hit()) {
            (false, true) => (id::HIT, record.t * record.direction),
            (false, false) => (id::MISS, record.direction),
            (true, _) if record.tfar == f32::INFINITY => {
                return Err("occlusion query without an end (tfar is +inf)");
            }
            (true, true) => (id::BLOCKED, record.tfar * record.direction),
            (true, false) => (id::UNBLOCKED, record.tfar * record.direction),
        };
        if !v.is_finite() && record.direction.is_finite() {
            return Err("query whose t or tfar times its direction is not finite");
        }
        let depth = if record.depth == NO_DEPTH { UNKNOWN_DEPTH } else { record.depth.into() };
        Ok(Legacy { id, depth, origin: record.origin, v })
    }

    /// Counts what of a record that is written is not in it.
    fn count_lost(&mut self, record: &Record) {
        // The end of an occlusion query is its target, and that of a hit decides nothing.
        let bounded_miss = !record.is_occlusion() && !record.is_hit() && record.tfar != f32::INFINITY;
        for (name, lost) in [
            ("tnear other than 0", record.tnear != 0.0),
            ("tfar of a closest-hit query that missed", bounded_miss),
            ("time other than 0", record.time != 0.0),
            ("mask", record.mask != u32::MAX),
            ("triangle and barycentrics of a hit", record.triangle != NO_TRIANGLE),
            ("pixel", record.path != NO_PATH),
            ("purpose", record.purpose != Purpose::Unknown as u8),
            ("coherent flag", record.flags & flag::COHERENT != 0),
        ] {
            self.losses.lose(name, lost.into());
        }
    }
}

impl<W: Write> Sink for Rays2011Sink<W> {
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError> {
        self.losses.lose_chunk(chunk);
        let mut piece = Vec::with_capacity(chunk.records.len());
        for record in chunk.records.iter() {
            match Self::legacy(record) {
                Ok(legacy) => {
                    self.count_lost(record);
                    piece.push(legacy);
                }
                Err(reason) => self.losses.leave_out(reason, 1),
            }
        }
        self.out.write_all(bytemuck::cast_slice(&piece))?;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Losses, ConvertError> {
        self.out.write_all(&END.to_le_bytes())?;
        self.out.flush()?;
        Ok(self.losses)
    }
}
