//! Reading a `.rays` file in place: header, chunk headers and index at once, bodies chunk by chunk on any thread.

use super::codec::{Codec, Place, RecordCheck, decompress};
use super::layout::{
    ChunkEntry, ChunkHeader, ChunkInfo, END_MARK, ENTRY_BYTES, FOOTER_BYTES, HEADER_BYTES, Header,
    INDEX_MAGIC,
};
use super::record::{Record, Reject, flag};
use super::recover::{Recovery, recover};
use crate::format::{ALIGNMENT, FormatError, Problem, align, checksum, parse_at};
use nom::number::complete::{le_u32, le_u64};
use rayon::prelude::*;
use std::borrow::Cow;
use std::hash::Hasher;
use std::ops::Range;

/// Bytes hashed before their records are checked: they stay in the first cache between the two.
const PIECE: usize = 16 << 10;

/// A `.rays` file over borrowed bytes, usually a memory map.
#[derive(Clone, Debug)]
pub struct Rays<'a> {
    pub header: Header,
    /// What was saved, when recording was cut off; `None` for a complete file.
    pub recovery: Option<Recovery>,
    bytes: &'a [u8],
    chunks: Vec<ChunkEntry>,
    queries: u64,
}

/// The content of one chunk, checked.
#[derive(Clone, Debug)]
pub struct Chunk<'a> {
    pub info: ChunkInfo,
    pub records: Cow<'a, [Record]>,
    /// Sorted by record.
    pub rejects: Cow<'a, [Reject]>,
}

impl Chunk<'_> {
    /// What the program refused of the record at `place`.
    pub fn rejects_of(&self, place: usize) -> &[Reject] {
        if self.records[place].flags & flag::HAS_REJECTS == 0 {
            return &[];
        }
        let start = self.rejects.partition_point(|reject| (reject.record as usize) < place);
        let count = self.rejects[start..].partition_point(|reject| reject.record as usize == place);
        &self.rejects[start..start + count]
    }
}

impl<'a> Rays<'a> {
    /// Checks the header, every chunk's header and the index. The bodies are left to [`Self::chunk`], except in a file
    /// without an end mark: there every chunk's checksum decides whether it is kept, and `recovery` says what was lost.
    ///
    /// # Errors
    /// When the header, a chunk's header or the index is not what `docs/formats.md` says.
    pub fn parse(bytes: &'a [u8]) -> Result<Rays<'a>, FormatError> {
        let header = Header::read(bytes)?;
        let length = bytes.len() as u64;
        let complete = length >= HEADER_BYTES + FOOTER_BYTES && bytes.ends_with(&END_MARK);
        let (chunks, recovery) = if complete {
            (indexed_chunks(bytes)?, None)
        } else {
            let (chunks, recovery) = recover(bytes);
            (chunks, Some(recovery))
        };
        let queries = chunks.iter().map(|chunk| u64::from(chunk.records)).sum();
        Ok(Rays { header, recovery, bytes, chunks, queries })
    }

    /// Every chunk, in file order.
    pub fn chunks(&self) -> &[ChunkEntry] {
        &self.chunks
    }

    /// Queries of all chunks.
    pub fn query_count(&self) -> u64 {
        self.queries
    }

    /// Bytes of the file.
    pub fn file_bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Checks the body of chunk `index` (its checksum, then every field), and decodes it. A raw chunk is not copied, unless the
    /// bytes are not aligned to 4 or its rejects are not sorted; a compressed one takes [`super::MAX_DECODED_BYTES`] at most, twice.
    ///
    /// # Errors
    /// When the body is damaged.
    ///
    /// # Panics
    /// When `index` is not less than the number of [`Self::chunks`].
    pub fn chunk(&self, index: usize) -> Result<Chunk<'a>, FormatError> {
        let entry = &self.chunks[index];
        let stored = self.stored(entry);
        let (records, rejects) = match entry.codec {
            Codec::Raw => read_raw(entry, stored)?,
            Codec::Compressed => read_compressed(entry, stored)?,
        };
        let rejects = if rejects.is_sorted_by_key(|reject| reject.record) {
            rejects
        } else {
            let mut sorted = rejects.into_owned();
            sorted.sort_by_key(|reject| reject.record);
            Cow::Owned(sorted)
        };
        Ok(Chunk { info: entry.info, records, rejects })
    }

    /// The number, within the file, of each chunk's first query.
    pub fn first_queries(&self) -> Vec<u64> {
        let mut next = 0;
        let first = |chunk: &ChunkEntry| {
            next += u64::from(chunk.records);
            next - u64::from(chunk.records)
        };
        self.chunks.iter().map(first).collect()
    }

    /// Calls `work` with the number and content of every chunk, on rayon's threads; the results are in file order.
    ///
    /// # Errors
    /// That of the first chunk, in file order, that is damaged.
    pub fn map_chunks<T, F>(&self, work: F) -> Result<Vec<T>, FormatError>
    where
        T: Send,
        F: Fn(usize, Chunk<'a>) -> T + Sync,
    {
        self.map_chunks_of(0..self.chunks.len(), work)
    }

    /// The same for some of the chunks.
    ///
    /// # Errors
    /// That of the first of them, in file order, that is damaged.
    pub fn map_chunks_of<T, F>(&self, chunks: Range<usize>, work: F) -> Result<Vec<T>, FormatError>
    where
        T: Send,
        F: Fn(usize, Chunk<'a>) -> T + Sync,
    {
        let results: Vec<Result<T, FormatError>> =
            chunks.into_par_iter().map(|index| self.chunk(index).map(|chunk| work(index, chunk))).collect();
        results.into_iter().collect()
    }

    /// Calls `work` with every chunk on rayon's threads, and merges what each has gathered. Which chunks are gathered together
    /// depends on timing: `work` and `merge` must not care (sums of integers do not).
    ///
    /// Unlike [`Self::map_chunks`] it keeps nothing per chunk, of which a hostile file has one per 64 bytes.
    ///
    /// # Errors
    /// That of the first chunk, in file order, that is damaged.
    pub fn fold_chunks<A, I, F, M>(&self, identity: I, work: F, merge: M) -> Result<A, FormatError>
    where
        A: Send,
        I: Fn() -> A + Sync,
        F: Fn(&mut A, usize, Chunk<'a>) + Sync,
        M: Fn(A, A) -> A + Sync,
    {
        let add = |gathered: Result<A, FormatError>, index| {
            // Chunks of one fold come in file order: after an error, no later one matters.
            let mut gathered = gathered?;
            work(&mut gathered, index, self.chunk(index)?);
            Ok(gathered)
        };
        let join = |left: Result<A, FormatError>, right: Result<A, FormatError>| match (left, right) {
            (Ok(left), Ok(right)) => Ok(merge(left, right)),
            (Err(left), Err(right)) => Err(if right.offset < left.offset { right } else { left }),
            (Err(error), _) | (_, Err(error)) => Err(error),
        };
        (0..self.chunks.len()).into_par_iter().fold(|| Ok(identity()), add).reduce(|| Ok(identity()), join)
    }

    /// Checks every chunk, on rayon's threads.
    ///
    /// # Errors
    /// That of the first chunk, in file order, that is damaged.
    pub fn validate_all(&self) -> Result<(), FormatError> {
        self.fold_chunks(|| (), |(), _, _| (), |(), ()| ())
    }

    fn stored(&self, entry: &ChunkEntry) -> &'a [u8] {
        // In range: `ChunkHeader::entry` has checked it against the length of these bytes.
        &self.bytes[entry.body() as usize..(entry.body() + entry.stored_bytes) as usize]
    }
}

type Content<'a> = (Cow<'a, [Record]>, Cow<'a, [Reject]>);

fn read_raw<'a>(entry: &ChunkEntry, stored: &'a [u8]) -> Result<Content<'a>, FormatError> {
    let (records, rejects) = stored.split_at(entry.records as usize * size_of::<Record>());
    let records: Cow<[Record]> = view(records);
    let rejects: Cow<[Reject]> = view(rejects);
    // Hash and check piece by piece: each byte comes from memory once.
    let mut hasher = twox_hash::XxHash3_64::new();
    let mut check = RecordCheck::default();
    for piece in records.chunks(PIECE / size_of::<Record>()) {
        hasher.write(bytemuck::cast_slice(piece));
        check.add(piece);
    }
    hasher.write(bytemuck::cast_slice(&rejects));
    compare_checksum(entry, hasher.finish())?;
    check.finish(&Place::Raw(entry.body()), &records, &rejects)?;
    Ok((records, rejects))
}

fn read_compressed<'a>(entry: &ChunkEntry, stored: &'a [u8]) -> Result<Content<'a>, FormatError> {
    compare_checksum(entry, checksum(stored))?;
    let (records, rejects) = decompress(entry, stored)?;
    let mut check = RecordCheck::default();
    check.add(&records);
    check.finish(&Place::Decoded(entry.body()), &records, &rejects)?;
    Ok((Cow::Owned(records), Cow::Owned(rejects)))
}

fn compare_checksum(entry: &ChunkEntry, found: u64) -> Result<(), FormatError> {
    if found == entry.checksum {
        return Ok(());
    }
    let (what, expected) = ("body of a chunk".to_string(), entry.checksum);
    Err(FormatError::new(entry.body(), Problem::Checksum { what, found, expected }))
}

/// The elements in place, or a copy where the bytes are not aligned. The length is a multiple of the element's.
fn view<T: bytemuck::Pod>(bytes: &[u8]) -> Cow<'_, [T]> {
    match bytemuck::try_cast_slice(bytes) {
        Ok(elements) => Cow::Borrowed(elements),
        Err(_) => Cow::Owned(bytemuck::pod_collect_to_vec(bytes)),
    }
}

/// The chunks of a complete file: their headers walked in order, and compared with the index.
fn indexed_chunks(bytes: &[u8]) -> Result<Vec<ChunkEntry>, FormatError> {
    let footer = bytes.len() as u64 - FOOTER_BYTES;
    let index = parse_at(bytes, footer, "end mark", le_u64)?;
    if index < HEADER_BYTES || index % ALIGNMENT != 0 || index > footer.saturating_sub(HEADER_BYTES) {
        let expected =
            format!("a multiple of {ALIGNMENT} from {HEADER_BYTES}, with a header before byte {footer}");
        return Err(FormatError::field(footer, "offset of the index", index, expected));
    }
    let header = ChunkHeader::read(bytes, index)?;
    if header.magic != INDEX_MAGIC {
        return Err(FormatError::field(index, "magic of the index", header.magic.escape_ascii(), "RIDX"));
    }
    let body = index + HEADER_BYTES;
    let available = footer - body;
    if header.stored_bytes != available || !available.is_multiple_of(ENTRY_BYTES) {
        let expected = format!("a multiple of {ENTRY_BYTES}: the {available} bytes up to the end mark");
        return Err(FormatError::field(index + 32, "bytes of the index", header.stored_bytes, expected));
    }
    if header.codec != 0 || header.decoded_bytes != header.stored_bytes {
        return Err(FormatError::field(
            index + 40,
            "decoded bytes of the index",
            header.decoded_bytes,
            header.stored_bytes,
        ));
    }
    let entries = &bytes[body as usize..(body + header.stored_bytes) as usize];
    let found = checksum(entries);
    if found != header.checksum {
        let (what, expected) = ("index".to_string(), header.checksum);
        return Err(FormatError::new(body, Problem::Checksum { what, found, expected }));
    }

    let mut chunks = Vec::with_capacity(entries.len() / ENTRY_BYTES as usize);
    let mut offset = HEADER_BYTES;
    for number in 0..header.stored_bytes / ENTRY_BYTES {
        let at = body + number * ENTRY_BYTES;
        let (listed, records, rejects) = parse_at(bytes, at, "index", (le_u64, le_u32, le_u32))?;
        if listed != offset {
            return Err(FormatError::field(
                at,
                format!("offset of chunk {number} in the index"),
                listed,
                offset,
            ));
        }
        let chunk = ChunkHeader::read(bytes, offset)?.entry(offset, index)?;
        if (records, rejects) != (chunk.records, chunk.rejects) {
            let name = format!("records and rejects of chunk {number} in the index");
            let expected = format!("{} and {}, as its header says", chunk.records, chunk.rejects);
            return Err(FormatError::field(at + 8, name, format!("{records} and {rejects}"), expected));
        }
        // No overflow: the body ends before the index, whose offset is aligned.
        offset = align(chunk.body() + chunk.stored_bytes).unwrap_or(index);
        chunks.push(chunk);
    }
    if offset != index {
        return Err(FormatError::field(
            footer,
            "offset of the index",
            index,
            format!("{offset}, where the chunks end"),
        ));
    }
    Ok(chunks)
}
