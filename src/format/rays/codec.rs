//! Records and rejects to and from the body of a chunk.
//!
//! Raw: as they stand in memory. Compressed: byte b of field f of every record stands together (64 columns of n bytes),
//! then the rejects, as one zstd frame. Columns of like bytes compress 2 to 4 times at level 1; higher levels gain a few percent.

use super::layout::{
    CHUNK_MAGIC, ChunkEntry, ChunkHeader, ChunkInfo, HEADER_BYTES, MAX_CHUNK_RECORDS, MAX_DECODED_BYTES,
};
use super::record::{Record, Reject};
use crate::format::{FormatError, checksum};
use crate::zeroed::zeroed_vec;
use std::borrow::Cow;
use std::hash::Hasher;
use std::io;

/// Level of zstd that the writer uses.
const LEVEL: i32 = 1;
const RECORD_BYTES: usize = size_of::<Record>();

/// How a body is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    Raw,
    Compressed,
}

impl Codec {
    pub(super) fn from_byte(byte: u8) -> Option<Codec> {
        match byte {
            0 => Some(Codec::Raw),
            1 => Some(Codec::Compressed),
            _ => None,
        }
    }

    fn byte(self) -> u8 {
        match self {
            Codec::Raw => 0,
            Codec::Compressed => 1,
        }
    }

    /// The name used in tables and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Codec::Raw => "raw",
            Codec::Compressed => "compressed",
        }
    }
}

/// A chunk as it goes to the file: made on any thread, written by the one that holds the writer.
pub struct EncodedChunk<'a> {
    pub(super) header: [u8; HEADER_BYTES as usize],
    /// The body: records and rejects of a raw chunk, or the compressed frame and nothing.
    pub(super) body: [Cow<'a, [u8]>; 2],
    pub(super) records: u32,
    pub(super) rejects: u32,
}

impl EncodedChunk<'_> {
    /// Bytes of the body.
    pub fn stored_bytes(&self) -> u64 {
        self.body.iter().map(|part| part.len() as u64).sum()
    }

    /// The same chunk without what it borrows, to send it to another thread.
    pub fn into_owned(self) -> EncodedChunk<'static> {
        let body = self.body.map(|part| Cow::Owned(part.into_owned()));
        EncodedChunk { header: self.header, body, records: self.records, rejects: self.rejects }
    }
}

/// Encodes one chunk. With [`Codec::Compressed`], a chunk that compression would not make smaller is stored raw.
///
/// # Errors
/// `InvalidInput` for more than [`MAX_CHUNK_RECORDS`] records, or rejects that name no record, are not sorted by
/// record, or do not match [`super::flag::HAS_REJECTS`]: no reader would take such a chunk.
pub fn encode_chunk<'a>(
    info: &ChunkInfo,
    records: &'a [Record],
    rejects: &'a [Reject],
    codec: Codec,
) -> io::Result<EncodedChunk<'a>> {
    let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
    if records.len() > MAX_CHUNK_RECORDS {
        return Err(invalid(format!(
            "{} records in a chunk, at most {MAX_CHUNK_RECORDS} fit",
            records.len()
        )));
    }
    let reject_count =
        u32::try_from(rejects.len()).map_err(|_| invalid("4 billion rejects in a chunk".into()))?;
    let mut check = RecordCheck::default();
    check.add(records);
    check.finish(&Place::Decoded(0), records, rejects).map_err(|error| invalid(error.problem.to_string()))?;
    if !rejects.is_sorted_by_key(|reject| reject.record) {
        return Err(invalid("rejects that are not sorted by record".into()));
    }

    let raw: [&[u8]; 2] = [bytemuck::cast_slice(records), bytemuck::cast_slice(rejects)];
    let decoded_bytes = (raw[0].len() + raw[1].len()) as u64;
    let frame = match codec {
        Codec::Compressed if decoded_bytes <= MAX_DECODED_BYTES => Some(compress(raw)?),
        _ => None,
    };
    let (codec, body) = match frame.filter(|frame| (frame.len() as u64) < decoded_bytes) {
        Some(frame) => (Codec::Compressed, [Cow::Owned(frame), Cow::Borrowed(&[][..])]),
        None => (Codec::Raw, raw.map(Cow::Borrowed)),
    };
    let header = ChunkHeader {
        magic: CHUNK_MAGIC,
        codec: codec.byte(),
        info: *info,
        records: records.len() as u32,
        rejects: reject_count,
        stored_bytes: body.iter().map(|part| part.len() as u64).sum(),
        decoded_bytes,
        checksum: checksum_of_parts(&body),
    };
    Ok(EncodedChunk { header: header.bytes(), body, records: header.records, rejects: header.rejects })
}

fn checksum_of_parts(parts: &[Cow<[u8]>; 2]) -> u64 {
    if parts[1].is_empty() {
        return checksum(&parts[0]);
    }
    let mut hasher = twox_hash::XxHash3_64::new();
    parts.iter().for_each(|part| hasher.write(part));
    hasher.finish()
}

fn compress([records, rejects]: [&[u8]; 2]) -> io::Result<Vec<u8>> {
    let mut columns = vec![0; records.len() + rejects.len()];
    let (record_columns, tail) = columns.split_at_mut(records.len());
    to_columns(records, record_columns);
    tail.copy_from_slice(rejects);
    zstd::bulk::compress(&columns, LEVEL)
}

/// Decodes the body of a compressed chunk, whose sizes have been checked.
///
/// # Errors
/// When the body is not one zstd frame of exactly the declared size.
pub(super) fn decompress(
    entry: &ChunkEntry,
    stored: &[u8],
) -> Result<(Vec<Record>, Vec<Reject>), FormatError> {
    let wrong = |found: String| {
        let expected = format!("one frame of {} bytes", entry.decoded_bytes());
        FormatError::field(entry.body(), "zstd body of a chunk", found, expected)
    };
    // A bulk decoder would also take several frames in a row.
    let frame_bytes = zstd::zstd_safe::find_frame_compressed_size(stored)
        .map_err(|code| wrong(zstd::zstd_safe::get_error_name(code).to_string()))?;
    if frame_bytes != stored.len() {
        return Err(wrong(format!("a frame that ends after {frame_bytes} of {} bytes", stored.len())));
    }
    let mut columns = vec![0; entry.decoded_bytes() as usize];
    let decoded =
        zstd::bulk::decompress_to_buffer(stored, &mut columns).map_err(|error| wrong(error.to_string()))?;
    if decoded != columns.len() {
        return Err(wrong(format!("{decoded} bytes")));
    }
    let mut records: Vec<Record> = zeroed_vec(entry.records as usize);
    let (record_columns, tail) = columns.split_at(entry.records as usize * RECORD_BYTES);
    from_columns(record_columns, bytemuck::cast_slice_mut(&mut records));
    Ok((records, bytemuck::pod_collect_to_vec(tail)))
}

/// Records whose columns are moved together: 64 cache lines in, one piece of a line of each column out.
const BLOCK: usize = 64;

/// Splits records into 64 columns, one per byte of a record.
fn to_columns(records: &[u8], columns: &mut [u8]) {
    let count = records.len() / RECORD_BYTES;
    for (block, rows) in records.chunks(BLOCK * RECORD_BYTES).enumerate() {
        for column in 0..RECORD_BYTES {
            let start = column * count + block * BLOCK;
            let part = &mut columns[start..start + rows.len() / RECORD_BYTES];
            for (byte, row) in part.iter_mut().zip(rows.chunks_exact(RECORD_BYTES)) {
                *byte = row[column];
            }
        }
    }
}

/// The inverse of [`to_columns`].
fn from_columns(columns: &[u8], records: &mut [u8]) {
    let count = records.len() / RECORD_BYTES;
    for (block, rows) in records.chunks_mut(BLOCK * RECORD_BYTES).enumerate() {
        for column in 0..RECORD_BYTES {
            let start = column * count + block * BLOCK;
            let part = &columns[start..start + rows.len() / RECORD_BYTES];
            for (byte, row) in part.iter().zip(rows.chunks_exact_mut(RECORD_BYTES)) {
                row[column] = *byte;
            }
        }
    }
}

/// Where the body of a chunk stands in the file, for errors.
pub(super) enum Place {
    /// Byte by byte from this offset.
    Raw(u64),
    /// Compressed, so that only the start of the whole body can be named.
    Decoded(u64),
}

impl Place {
    fn offset(&self, within: usize) -> u64 {
        match self {
            Place::Raw(body) => body + within as u64,
            Place::Decoded(body) => *body,
        }
    }
}

/// The check of every record's fields, gathered so that the loop has no branch and vectorises.
#[derive(Default)]
pub(super) struct RecordCheck {
    /// All kinds, or-ed: a kind above 1 sets another bit than the lowest.
    kinds: u8,
    /// Records that say that they have rejects.
    with_rejects: usize,
}

impl RecordCheck {
    #[inline]
    pub(super) fn add(&mut self, records: &[Record]) {
        let (mut kinds, mut with_rejects) = (0, 0);
        for record in records {
            kinds |= record.kind;
            with_rejects += usize::from(record.flags & super::flag::HAS_REJECTS != 0);
        }
        self.kinds |= kinds;
        self.with_rejects += with_rejects;
    }

    /// Whether all that was added is right, together with its rejects.
    pub(super) fn finish(
        &self,
        body: &Place,
        records: &[Record],
        rejects: &[Reject],
    ) -> Result<(), FormatError> {
        if self.kinds > super::kind::OCCLUSION
            && let Some(index) = records.iter().position(|record| record.kind > super::kind::OCCLUSION)
        {
            let offset = body.offset(index * RECORD_BYTES + std::mem::offset_of!(Record, kind));
            return Err(FormatError::field(
                offset,
                format!("kind of record {index} of the chunk"),
                records[index].kind,
                "0 or 1",
            ));
        }
        if self.with_rejects == 0 && rejects.is_empty() {
            return Ok(());
        }
        self.check_rejects(body, records, rejects)
    }

    #[cold]
    fn check_rejects(&self, body: &Place, records: &[Record], rejects: &[Reject]) -> Result<(), FormatError> {
        let mut named = vec![false; records.len()];
        for (index, reject) in rejects.iter().enumerate() {
            let offset = body.offset(size_of_val(records) + index * size_of::<Reject>());
            let record = reject.record as usize;
            let Some(name) = named.get_mut(record) else {
                let expected = format!("less than the {} records of the chunk", records.len());
                return Err(FormatError::field(offset, "record of a reject", reject.record, expected));
            };
            if records[record].flags & super::flag::HAS_REJECTS == 0 {
                let found = format!("record {record}, whose flags say that it has none");
                return Err(FormatError::field(
                    offset,
                    "record of a reject",
                    found,
                    "a record with flag bit 2",
                ));
            }
            *name = true;
        }
        let found = named.iter().filter(|&&named| named).count();
        if found != self.with_rejects {
            let expected = format!("{}, as their flags say", self.with_rejects);
            return Err(FormatError::field(
                body.offset(0),
                "records with rejects in the chunk",
                found,
                expected,
            ));
        }
        Ok(())
    }
}
