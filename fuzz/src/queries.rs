//! What queries in the formats of others are once their reader has accepted them: a recording that our own format takes, and that goes back.

use super::rays::{self, Content};
use super::{bits, check_line};
use bytes::Bytes;
use embree_trace::convert::{ConvertError, Kind, sink, source};
use embree_trace::format::rays::{Chunk, ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, Rays, Record};

/// Of a file with more queries only the first ones are looked at: a table needs hardly a byte for a million equal rows.
const LOOKED_AT: usize = 4096;

/// Reads any bytes as rays of 2011.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_rays_2011(bytes: &[u8]) {
    let Some(content) = accepted(bytes, Kind::Rays2011) else { return };
    // A hit's t and an occlusion's end are 1, so each vector is its own target, and only what is no number changes its bits.
    let again = own(&write(&content, Kind::Rays2011), Kind::Rays2011);
    let (before, after) = (content.records(), again.records());
    assert_eq!(before.len(), after.len());
    for (before, after) in before.iter().zip(&after) {
        assert_eq!(without_payloads(before), without_payloads(after));
    }
}

/// The bits of a record, with one pattern for every NaN of its direction.
fn without_payloads(record: &Record) -> [u32; 16] {
    let direction = record.direction.map(|value| f32::from_bits(bits(value)));
    bytemuck::cast(Record { direction, ..*record })
}

/// Reads any bytes as an array of NumPy.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_npy(bytes: &[u8]) {
    let Some(content) = accepted(bytes, Kind::Npy) else { return };
    assert_eq!(own(&write(&content, Kind::Npy), Kind::Npy).chunks, content.chunks);
}

/// Reads any bytes as a table.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_parquet(bytes: &[u8]) {
    let Some(content) = accepted(bytes, Kind::Parquet) else { return };
    check_numbers(&content);
    assert_eq!(own(&write(&content, Kind::Parquet), Kind::Parquet), content);
}

/// No thread has two queries of one number, as far as numbers go.
fn check_numbers(content: &Content) {
    let mut ends = std::collections::HashMap::new();
    for (ChunkInfo { thread, sequence, .. }, records, _) in &content.chunks {
        let end = ends.entry(*thread).or_insert(0);
        assert!(*sequence >= *end, "query {sequence} of thread {thread} behind number {end}");
        *end = sequence.saturating_add((records.len() / size_of::<Record>()) as u64);
    }
}

/// What the reader of a format takes, once our own format has taken it, too.
fn accepted(bytes: &[u8], kind: Kind) -> Option<Content> {
    let content = match read(bytes, kind) {
        Ok(content) => content,
        Err(error) => {
            check_line(&error);
            return None;
        }
    };
    let ours = write(&content, Kind::Rays);
    rays::check(&ours);
    let Ok(found) = Rays::parse(&ours).and_then(|rays| Content::of(&rays)) else {
        panic!("our own file is refused")
    };
    // The header of a recording has less room than a table.
    assert!(content.header.producer.starts_with(&found.header.producer));
    let header = Header { producer: content.header.producer.clone(), ..found.header };
    assert_eq!(Content { header, ..found }, content);
    Some(content)
}

/// What was written by us.
fn own(bytes: &[u8], kind: Kind) -> Content {
    read(bytes, kind).unwrap_or_else(|error| panic!("our own file is refused: {error}"))
}

/// What a reader makes of a file: all of it, or its first chunks, of at most [`LOOKED_AT`] queries.
pub fn read(bytes: &[u8], kind: Kind) -> Result<Content, ConvertError> {
    let bytes = Bytes::copy_from_slice(bytes);
    let mut source = source(&bytes, kind)?;
    let header = source.header();
    let (mut chunks, mut count) = (Vec::new(), 0);
    while let Some(chunk) = source.next()? {
        assert!((1..=MAX_CHUNK_RECORDS).contains(&chunk.records.len()));
        rays::check_chunk(&chunk);
        count += chunk.records.len();
        if count > LOOKED_AT {
            return Ok(Content { header, chunks });
        }
        chunks.push(rays::own(chunk));
    }
    assert_eq!(count as u64, source.count());
    Ok(Content { header, chunks })
}

/// A file of what was read.
pub fn write(content: &Content, kind: Kind) -> Vec<u8> {
    let mut bytes = Vec::new();
    let count =
        content.chunks.iter().map(|(_, records, _)| records.len() / size_of::<Record>()).sum::<usize>();
    let written = sink(&mut bytes, kind, &content.header, count as u64, Codec::Raw).and_then(|mut sink| {
        for (info, records, rejects) in &content.chunks {
            let records: Vec<Record> = bytemuck::pod_collect_to_vec(records);
            sink.write(&Chunk { info: *info, records: records.into(), rejects: rejects.into() })?;
        }
        sink.finish()
    });
    if let Err(error) = written {
        panic!("what was read cannot be written: {error}");
    }
    bytes
}
