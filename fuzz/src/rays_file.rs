//! `.rays` files from a description: written by the library, taken apart, changed, and put together again with checksums that hold.

use super::edit::{Damage, Value, pick};
use super::rays::{self, Content};
use super::text;
use arbitrary::{Arbitrary, Result, Unstructured};
use embree_trace::format::checksum;
use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, NO_TRIANGLE, Rays, RaysWriter, Record, Reject, flag, kind,
};

/// A valid file.
#[derive(Debug)]
pub struct File {
    pub header: Header,
    pub chunks: Vec<FileChunk>,
}

/// One chunk of it.
#[derive(Debug)]
pub struct FileChunk {
    pub info: ChunkInfo,
    pub codec: Codec,
    pub records: Vec<Record>,
    pub rejects: Vec<Reject>,
}

impl<'a> Arbitrary<'a> for File {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<File> {
        let header = Header {
            fingerprint: u.arbitrary()?,
            embree_version: u.arbitrary()?,
            deterministic: u.arbitrary()?,
            producer: text(u)?,
        };
        let count = u.int_in_range(0..=5)?;
        Ok(File { header, chunks: (0..count).map(|_| u.arbitrary()).collect::<Result<_>>()? })
    }
}

impl<'a> Arbitrary<'a> for FileChunk {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<FileChunk> {
        let info = ChunkInfo { scene: u.arbitrary()?, thread: u.arbitrary()?, sequence: u.arbitrary()? };
        let codec = if u.arbitrary()? { Codec::Raw } else { Codec::Compressed };
        // A few records over and over: many for few bytes, and they compress.
        let patterns: u8 = u.int_in_range(1..=5)?;
        let patterns: Vec<Record> = (0..patterns).map(|_| record(u)).collect::<Result<_>>()?;
        let count: u8 = u.int_in_range(0..=70)?;
        let mut records: Vec<Record> = patterns.into_iter().cycle().take(count.into()).collect();
        let mut rejects = Vec::new();
        if let Some(last) = count.checked_sub(1) {
            for _ in 0..u.int_in_range(0..=9u8)? {
                rejects.push(Reject { record: u.int_in_range(0..=last)?.into(), triangle: u.arbitrary()? });
            }
        }
        rejects.sort_by_key(|reject| reject.record);
        rejects.iter().for_each(|reject| records[reject.record as usize].flags |= flag::HAS_REJECTS);
        Ok(FileChunk { info, codec, records, rejects })
    }
}

/// Any bits that a reader must take; every other record is one that `verify` takes, too.
fn record(u: &mut Unstructured) -> Result<Record> {
    let mut bytes = [0; size_of::<Record>()];
    u.fill_buffer(&mut bytes)?;
    let mut record: Record = bytemuck::pod_read_unaligned(&bytes);
    record.kind %= 2;
    record.flags &= !flag::HAS_REJECTS;
    if u.arbitrary()? {
        let occlusion = record.kind == kind::OCCLUSION;
        let hit = record.flags & flag::HIT != 0;
        record.t = match (occlusion, hit) {
            (true, true) => f32::NEG_INFINITY,
            (_, false) => f32::INFINITY,
            (false, true) => 1.5,
        };
        record.triangle = if hit { record.triangle % 100 } else { NO_TRIANGLE };
    }
    Ok(record)
}

impl File {
    /// The file as our writer makes it.
    ///
    /// # Panics
    /// When the writer refuses it.
    pub fn bytes(&self) -> Vec<u8> {
        let written = RaysWriter::new(Vec::new(), &self.header).and_then(|mut writer| {
            for FileChunk { info, codec, records, rejects } in &self.chunks {
                writer.write_chunk(info, records, rejects, *codec)?;
            }
            writer.finish()
        });
        match written {
            Ok((bytes, _)) => bytes,
            Err(error) => panic!("a valid file is refused: {error}"),
        }
    }

    /// What a reader must find in it.
    pub fn content(&self) -> Content {
        let own = |chunk: &FileChunk| {
            (chunk.info, bytemuck::cast_slice(&chunk.records).to_vec(), chunk.rejects.clone())
        };
        Content { header: self.header.clone(), chunks: self.chunks.iter().map(own).collect() }
    }
}

/// A chunk of a file taken apart.
#[derive(Clone, Debug)]
pub struct Piece {
    header: [u8; 64],
    body: Vec<u8>,
    /// Its number in the file, as long as nothing in it was changed.
    unchanged: Option<usize>,
}

/// A file taken apart.
#[derive(Clone, Debug)]
pub struct Pieces {
    header: [u8; 64],
    pub chunks: Vec<Piece>,
    index_header: [u8; 64],
    entries: Vec<[u8; 16]>,
    end: [u8; 16],
}

/// Which numbers are made new when a file is put together, so that they fit what was changed.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub struct Remake {
    /// Checksums of bodies.
    pub bodies: bool,
    /// The entries of the index, from the chunks' headers and places.
    pub entries: bool,
    /// The index's sizes and checksum.
    pub index: bool,
    /// The offset of the index at the end.
    pub end: bool,
}

impl Remake {
    pub const ALL: Remake = Remake { bodies: true, entries: true, index: true, end: true };
}

impl Pieces {
    /// Takes apart what [`File::bytes`] made.
    ///
    /// # Panics
    /// When it is not a valid file.
    pub fn of(bytes: &[u8]) -> Pieces {
        let rays = match Rays::parse(bytes) {
            Ok(rays) => rays,
            Err(error) => panic!("our own file is refused: {error}"),
        };
        let array = |at: usize| std::array::from_fn(|byte| bytes[at + byte]);
        let chunks = rays.chunks().iter().enumerate().map(|(number, chunk)| Piece {
            header: array(chunk.offset as usize),
            body: bytes[chunk.body() as usize..][..chunk.stored_bytes as usize].to_vec(),
            unchanged: Some(number),
        });
        let entries_at = bytes.len() - 16 - 16 * rays.chunks().len();
        let (entries, _) = bytes[entries_at..bytes.len() - 16].as_chunks::<16>();
        Pieces {
            header: array(0),
            chunks: chunks.collect(),
            index_header: array(entries_at - 64),
            entries: entries.to_vec(),
            end: std::array::from_fn(|byte| bytes[bytes.len() - 16 + byte]),
        }
    }

    /// The numbers that the chunks had in the file, when none was changed.
    pub fn order(&self) -> Option<Vec<usize>> {
        self.chunks.iter().map(|chunk| chunk.unchanged).collect()
    }

    /// Puts the file together.
    pub fn bytes(&self, remake: Remake) -> Vec<u8> {
        let mut bytes = self.header.to_vec();
        let mut entries = Vec::new();
        for Piece { header, body, .. } in &self.chunks {
            let mut header = *header;
            if remake.bodies {
                header[48..56].copy_from_slice(&checksum(body).to_le_bytes());
            }
            entries.extend((bytes.len() as u64).to_le_bytes());
            entries.extend_from_slice(&header[8..16]);
            bytes.extend_from_slice(&header);
            bytes.extend_from_slice(body);
            bytes.resize(bytes.len().next_multiple_of(64), 0);
        }
        if !remake.entries {
            entries = self.entries.concat();
        }
        let (mut index_header, mut end) = (self.index_header, self.end);
        if remake.index {
            let length = (entries.len() as u64).to_le_bytes();
            index_header[32..40].copy_from_slice(&length);
            index_header[40..48].copy_from_slice(&length);
            index_header[48..56].copy_from_slice(&checksum(&entries).to_le_bytes());
        }
        if remake.end {
            end[..8].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
        }
        bytes.extend_from_slice(&index_header);
        bytes.extend_from_slice(&entries);
        bytes.extend_from_slice(&end);
        bytes
    }

    /// The chunks only: a recording that was killed.
    pub fn bytes_without_index(&self) -> Vec<u8> {
        let whole = self.bytes(Remake::ALL);
        whole[..whole.len() - 16 - 16 * self.chunks.len() - 64].to_vec()
    }
}

/// A field of a chunk's header or the index's.
#[derive(Clone, Copy, Debug, Arbitrary)]
enum Field {
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
enum Body {
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

#[derive(Clone, Copy, Debug, Arbitrary)]
enum Edit {
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

fn set(bytes: &mut [u8], at: u16, value: u8) {
    let at = at as usize % bytes.len().max(1);
    if let Some(byte) = bytes.get_mut(at) {
        *byte = value;
    }
}

impl Edit {
    /// Changes the pieces; whether what is around the chunks is as it was.
    fn apply(self, pieces: &mut Pieces) -> bool {
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

/// The file that bytes describe, without changes.
pub fn described(bytes: &[u8]) -> Option<Vec<u8>> {
    Unstructured::new(bytes).arbitrary().ok().map(|file: File| file.bytes())
}

/// Takes bytes as the description of a file and of changes, and gives the changed file to the reader.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    // An error says that the bytes describe nothing; there are none left to say more.
    let _ = run(&mut Unstructured::new(bytes));
}

fn run(u: &mut Unstructured) -> Result<()> {
    let file: File = u.arbitrary()?;
    let mut pieces = Pieces::of(&file.bytes());
    let mut frame_kept = true;
    for _ in 0..u.int_in_range(0..=5u8)? {
        frame_kept &= u.arbitrary::<Edit>()?.apply(&mut pieces);
    }
    // Mostly, or little would be seen behind the checksums.
    let remake = if u.ratio(1, 4)? { u.arbitrary()? } else { Remake::ALL };
    let mut changed = pieces.bytes(remake);
    let damages = u.int_in_range(0..=2u8)?;
    for _ in 0..damages {
        u.arbitrary::<Damage>()?.apply(&mut changed);
    }
    rays::check(&changed);

    let all = remake.bodies && remake.entries && remake.index && remake.end;
    if let Some(order) = pieces.order().filter(|_| frame_kept && all && damages == 0) {
        let mut expected = file.content();
        expected.chunks = order.iter().map(|&number| expected.chunks[number].clone()).collect();
        assert_eq!(Rays::parse(&changed).and_then(|rays| Content::of(&rays)), Ok(expected));
    }
    Ok(())
}
