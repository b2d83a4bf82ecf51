//! `.rays` files from a description: written by the library, taken apart ([`pieces`]), changed ([`changes`]), and put together again with checksums
//! that hold.

mod changes;
mod pieces;

pub use pieces::{Pieces, Remake};

use super::edit::damage;
use super::rays::{self, Content};
use super::text;
use arbitrary::{Arbitrary, Result, Unstructured};
use changes::Edit;
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
    let damaged = damage(u, &mut changed)?;
    rays::check(&changed);

    let all = remake.bodies && remake.entries && remake.index && remake.end;
    if let Some(order) = pieces.order().filter(|_| frame_kept && all && !damaged) {
        let mut expected = file.content();
        expected.chunks = order.iter().map(|&number| expected.chunks[number].clone()).collect();
        assert_eq!(Rays::parse(&changed).and_then(|rays| Content::of(&rays)), Ok(expected));
    }
    Ok(())
}
