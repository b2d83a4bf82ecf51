//! What a `.rays` keeps once its reader has accepted it.

use super::check_line;
use embree_trace::format::FormatError;
use embree_trace::format::rays::{Chunk, ChunkInfo, Header, Rays, RaysWriter, Record, Reject, flag};

/// Files with more queries than this are not written again: the time is better spent on other files.
const REWRITTEN: u64 = 4096;

/// The content of one chunk: where it comes from, records bit for bit, rejects.
pub type ChunkContent = (ChunkInfo, Vec<u8>, Vec<Reject>);

/// A file as a reader sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Content {
    pub header: Header,
    pub chunks: Vec<ChunkContent>,
}

/// A query as it would be without chunks.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Query {
    scene: u16,
    thread: u32,
    /// Within the thread.
    number: u64,
    record: Vec<u8>,
    rejects: Vec<u32>,
}

impl Content {
    /// What is in a file all of whose chunks can be read.
    pub fn of(rays: &Rays) -> Result<Content, FormatError> {
        let chunks: Result<_, _> = (0..rays.chunks().len()).map(|index| rays.chunk(index).map(own)).collect();
        Ok(Content { header: rays.header.clone(), chunks: chunks? })
    }

    /// Every record, in the order of the file.
    pub fn records(&self) -> Vec<Record> {
        self.chunks.iter().flat_map(|(_, records, _)| bytemuck::pod_collect_to_vec(records)).collect()
    }

    /// Every query, in an order that does not depend on that of the chunks.
    pub fn queries(&self) -> Vec<Query> {
        let mut queries = Vec::new();
        for (info, records, rejects) in &self.chunks {
            for (number, record) in records.chunks_exact(size_of::<Record>()).enumerate() {
                let own = rejects.iter().filter(|reject| reject.record as usize == number);
                queries.push(Query {
                    scene: info.scene,
                    thread: info.thread,
                    number: info.sequence.wrapping_add(number as u64),
                    record: record.to_vec(),
                    rejects: own.map(|reject| reject.triangle).collect(),
                });
            }
        }
        queries.sort();
        queries
    }
}

pub(crate) fn own(chunk: Chunk) -> ChunkContent {
    (chunk.info, bytemuck::cast_slice(&chunk.records).to_vec(), chunk.rejects.into_owned())
}

/// Reads any bytes as a `.rays`.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    let rays = match Rays::parse(bytes) {
        Ok(rays) => rays,
        Err(error) => return check_line(&error),
    };
    check_places(&rays, bytes.len() as u64);
    let chunks: Vec<_> = (0..rays.chunks().len()).map(|index| rays.chunk(index)).collect();
    for (chunk, entry) in chunks.iter().zip(rays.chunks()) {
        match chunk {
            Ok(chunk) => {
                assert_eq!(
                    (chunk.records.len(), chunk.rejects.len()),
                    (entry.records as usize, entry.rejects as usize)
                );
                check_chunk(chunk);
            }
            Err(error) => check_line(error),
        }
    }

    let first = chunks.iter().find_map(|chunk| chunk.as_ref().err());
    assert_eq!(
        rays.validate_all().err().as_ref(),
        first,
        "all chunks are good, or the first bad one is named"
    );
    let verified = rays.verify();
    if let Err(error) = &verified {
        check_line(error);
    }
    assert!(verified.is_err() || first.is_none(), "what is verified can be read");
    assert!(
        rays.recovery.is_none() || rays.chunks().is_empty() || checksums_hold(&chunks),
        "recovered chunks are whole"
    );
    if first.is_none() && rays.query_count() <= REWRITTEN {
        check_again(&rays, bytes, verified.is_ok());
    }
}

/// A recovered chunk may still hold records that are none; its bytes are those written.
fn checksums_hold(chunks: &[Result<Chunk, FormatError>]) -> bool {
    use embree_trace::format::Problem;
    chunks.iter().all(|chunk| !matches!(chunk, Err(FormatError { problem: Problem::Checksum { .. }, .. })))
}

/// Chunks lie in the file one behind the other, and are counted.
fn check_places(rays: &Rays, length: u64) {
    let mut end = 64;
    for chunk in rays.chunks() {
        assert!(chunk.offset >= end && chunk.offset.is_multiple_of(64));
        end = chunk.body() + chunk.stored_bytes;
        assert!(end <= length);
    }
    let queries: u64 = rays.chunks().iter().map(|chunk| u64::from(chunk.records)).sum();
    assert_eq!(rays.query_count(), queries);
    if let Some(recovery) = rays.recovery {
        assert_eq!(recovery.queries, queries);
        assert!(recovery.lost_bytes <= length - 64);
    }
}

/// Kinds are known, rejects are sorted and belong to the records whose flags say so.
pub(crate) fn check_chunk(chunk: &Chunk) {
    let mut named = vec![false; chunk.records.len()];
    for reject in chunk.rejects.iter() {
        named[reject.record as usize] = true;
    }
    assert!(chunk.rejects.is_sorted_by_key(|reject| reject.record));
    for (record, named) in chunk.records.iter().zip(named) {
        assert!(record.kind <= 1);
        assert_eq!(record.flags & flag::HAS_REJECTS != 0, named);
    }
}

/// A file all of whose chunks can be read has the same content wherever it lies in memory, without its end mark, and written again.
fn check_again(rays: &Rays, bytes: &[u8], verified: bool) {
    let Ok(content) = Content::of(rays) else { panic!("read once, and not again") };
    let mut shifted = vec![0; bytes.len() + 1];
    shifted[1..].copy_from_slice(bytes);
    assert_eq!(Rays::parse(&shifted[1..]).and_then(|rays| Content::of(&rays)).as_ref(), Ok(&content));

    if rays.recovery.is_none() {
        let cut = &bytes[..bytes.len() - 1];
        let Ok(recovered) = Rays::parse(cut) else { panic!("a file without its end mark is refused") };
        assert_eq!(recovered.recovery.map(|recovery| recovery.lost_bytes), Some(0));
        assert_eq!(Content::of(&recovered).as_ref(), Ok(&content));
    }

    let written = write(rays, &content);
    let Ok(again) = Rays::parse(&written) else { panic!("our own file is refused") };
    assert!(again.recovery.is_none());
    assert_eq!(again.verify().is_ok(), verified);
    let Ok(read) = Content::of(&again) else { panic!("our own chunks are refused") };
    // What is no UTF-8 takes more room once it is replaced, and the producer is cut.
    assert!(content.header.producer.starts_with(&read.header.producer));
    let producer = read.header.producer.clone();
    let header = Header { producer, ..content.header.clone() };
    assert_eq!(read, Content { header, chunks: content.chunks.clone() });
    assert_eq!(write(&again, &read), written, "the same content makes the same bytes");
}

fn write(rays: &Rays, content: &Content) -> Vec<u8> {
    let Ok(mut writer) = RaysWriter::new(Vec::new(), &content.header) else {
        panic!("memory is no full disk")
    };
    for ((info, records, rejects), entry) in content.chunks.iter().zip(rays.chunks()) {
        let records: Vec<Record> = bytemuck::pod_collect_to_vec(records);
        if let Err(error) = writer.write_chunk(info, &records, rejects, entry.codec) {
            panic!("the writer refuses what the reader took: {error}");
        }
    }
    match writer.finish() {
        Ok((bytes, totals)) => {
            assert_eq!((totals.records, totals.bytes), (rays.query_count(), bytes.len() as u64));
            bytes
        }
        Err(error) => panic!("cannot finish: {error}"),
    }
}
