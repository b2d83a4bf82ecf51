//! `.rays` against its specification: files made byte by byte, every bit flipped, every length cut, hostile headers.

use embree_trace::format::rays::{
    Chunk, ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, NO_TRIANGLE, Rays, RaysWriter, Record, Reject,
    encode_chunk, flag, kind,
};
use embree_trace::format::{FileKind, Problem, checksum};
use embree_trace::geometry::Vec3;
use proptest::prelude::*;
use std::borrow::Cow;
use std::io::{self, Write};
use std::time::{Duration, Instant};

/// Little-endian bytes, appended as the specification lists them.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn raw(mut self, bytes: &[u8]) -> Bytes {
        self.0.extend_from_slice(bytes);
        self
    }
    fn u8(self, value: u8) -> Bytes {
        self.raw(&[value])
    }
    fn u16(self, value: u16) -> Bytes {
        self.raw(&value.to_le_bytes())
    }
    fn u32(self, value: u32) -> Bytes {
        self.raw(&value.to_le_bytes())
    }
    fn u64(self, value: u64) -> Bytes {
        self.raw(&value.to_le_bytes())
    }
    fn f32(self, value: f32) -> Bytes {
        self.raw(&value.to_le_bytes())
    }
    fn pad(mut self) -> Bytes {
        self.0.resize(self.0.len().next_multiple_of(64), 0);
        self
    }
}

fn file_header() -> Bytes {
    let start = Bytes::default().raw(&[0x89, 0x52, 0x41, 0x59, 0x53, 0x0D, 0x0A, 0x1A]).u16(1).u16(0).u32(64);
    let mut producer = [0u8; 32];
    producer[..4].copy_from_slice(b"hand");
    start.u64(0x1122_3344_5566_7788).u32(31305).u32(1).raw(&producer)
}

/// A chunk's header: the arguments are what hostile tests vary.
fn chunk_header(codec: u8, records: u32, rejects: u32, stored: u64, decoded: u64, checksum: u64) -> Bytes {
    let start = Bytes::default().raw(b"RCHK").u8(codec).u8(0).u16(3).u32(records).u32(rejects).u32(2).u32(0);
    start.u64(7).u64(stored).u64(decoded).u64(checksum).u64(0)
}

fn index(offset: u64, entries: &[(u64, u32, u32)]) -> Bytes {
    let body = entries.iter().fold(Bytes::default(), |bytes, &(at, n, m)| bytes.u64(at).u32(n).u32(m)).0;
    let start = Bytes::default().raw(b"RIDX").u8(0).u8(0).u16(0).u32(0).u32(0).u32(0).u32(0).u64(0);
    let length = body.len() as u64;
    start.u64(length).u64(length).u64(checksum(&body)).u64(0).raw(&body).u64(offset).raw(b"RAYSEND\0")
}

/// Two records by the specification's table: a closest hit with a reject, an occlusion without hit.
fn hand_records() -> Vec<u8> {
    let hit = Bytes::default().f32(1.0).f32(2.0).f32(3.0).f32(0.5).f32(0.0).f32(0.0).f32(-2.0).f32(100.0);
    let hit =
        hit.f32(0.25).u32(0xFFFF).f32(1.5).u32(9).f32(0.125).f32(0.75).u32(640).u8(0).u8(2).u8(0b101).u8(4);
    let miss = hit.f32(-1.0).f32(-2.0).f32(-3.0).f32(0.0).f32(1.0).f32(0.0).f32(0.0).f32(f32::INFINITY);
    let miss = miss.f32(0.0).u32(u32::MAX).f32(f32::INFINITY).u32(u32::MAX).f32(0.0).f32(0.0).u32(u32::MAX);
    miss.u8(1).u8(0xFF).u8(0b10).u8(2).0
}

/// The column layout, written down naively: for each of 16 fields, byte 0 of all records, then byte 1, …
fn columns(records: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for field in 0..16 {
        for byte in 0..4 {
            out.extend(records.chunks(64).map(|record| record[4 * field + byte]));
        }
    }
    out
}

/// A file of one chunk around a stored body.
fn file_with(header: Bytes, body: &[u8], records: u32, rejects: u32) -> Vec<u8> {
    let file = file_header().raw(&header.0).raw(body).pad();
    let offset = file.0.len() as u64;
    file.raw(&index(offset, &[(64, records, rejects)]).0).0
}

fn hand_file(codec: u8) -> Vec<u8> {
    let records = hand_records();
    let rejects = Bytes::default().u32(0).u32(11).0;
    let body = match codec {
        0 => [records, rejects].concat(),
        // A streaming encoder does not say how large the content is; that is allowed.
        _ => zstd::encode_all(&[columns(&records), rejects].concat()[..], 3).unwrap(),
    };
    let header = chunk_header(codec, 2, 1, body.len() as u64, 136, checksum(&body));
    file_with(header, &body, 2, 1)
}

fn check_hand_content(bytes: &[u8]) {
    let rays = Rays::parse(bytes).unwrap();
    let header = &rays.header;
    assert_eq!((header.fingerprint, header.embree_version), (0x1122_3344_5566_7788, 31305));
    assert_eq!((header.deterministic, header.producer.as_str()), (true, "hand"));
    assert_eq!((rays.query_count(), rays.chunks().len(), rays.recovery), (2, 1, None));
    let chunk = rays.chunk(0).unwrap();
    assert_eq!(chunk.info, ChunkInfo { scene: 3, thread: 2, sequence: 7 });
    let hit = chunk.records[0];
    assert_eq!((hit.origin, hit.direction), (Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.0, 0.0, -2.0)));
    assert_eq!([hit.tnear, hit.tfar, hit.time, hit.t, hit.u, hit.v], [0.5, 100.0, 0.25, 1.5, 0.125, 0.75]);
    assert_eq!((hit.mask, hit.triangle, hit.path), (0xFFFF, 9, 640));
    assert_eq!((hit.kind, hit.depth, hit.flags, hit.purpose), (0, 2, flag::HIT | flag::HAS_REJECTS, 4));
    let miss = chunk.records[1];
    assert_eq!((miss.kind, miss.depth, miss.flags, miss.purpose), (kind::OCCLUSION, 0xFF, flag::COHERENT, 2));
    assert_eq!((miss.t, miss.triangle), (f32::INFINITY, NO_TRIANGLE));
    assert_eq!(*chunk.rejects, [Reject { record: 0, triangle: 11 }]);
}

#[test]
fn a_file_made_by_hand_is_read_raw_and_compressed() {
    check_hand_content(&hand_file(0));
    check_hand_content(&hand_file(1));
}

#[test]
fn the_writer_makes_the_bytes_of_the_specification() {
    let by_hand = hand_file(0);
    let rays = Rays::parse(&by_hand).unwrap();
    let chunk = rays.chunk(0).unwrap();
    let mut writer = RaysWriter::new(Vec::new(), &rays.header).unwrap();
    writer.write_chunk(&chunk.info, &chunk.records, &chunk.rejects, Codec::Raw).unwrap();
    let (bytes, totals) = writer.finish().unwrap();
    assert_eq!(bytes, by_hand);
    assert_eq!((totals.chunks, totals.records, totals.rejects, totals.bytes), (1, 2, 1, bytes.len() as u64));
}

/// A valid record that depends on a number.
fn record(number: u32) -> Record {
    let x = number as f32;
    Record {
        origin: Vec3::new(x, -x, 0.5 * x),
        tnear: 0.0,
        direction: Vec3::new(0.0, 1.0, 0.1 * x),
        tfar: f32::INFINITY,
        time: 0.0,
        mask: u32::MAX,
        t: if number.is_multiple_of(3) { f32::INFINITY } else { 1.0 + x },
        triangle: if number.is_multiple_of(3) { NO_TRIANGLE } else { number },
        u: 0.25,
        v: 0.5,
        path: number,
        kind: kind::CLOSEST_HIT,
        depth: (number % 5) as u8,
        flags: if number.is_multiple_of(3) { 0 } else { flag::HIT },
        purpose: (number % 6) as u8,
    }
}

fn records(range: std::ops::Range<u32>) -> Vec<Record> {
    range.map(record).collect()
}

/// Three chunks of 30, 5 and 40 records; the second has rejects.
fn small_file(codec: Codec) -> (Vec<u8>, Vec<Record>) {
    let header =
        Header { fingerprint: 5, embree_version: 31305, deterministic: true, producer: "test".into() };
    let mut writer = RaysWriter::new(Vec::new(), &header).unwrap();
    let mut all = Vec::new();
    for (range, rejects) in [(0..30, 0), (30..35, 2), (35..75, 0)] {
        let mut part = records(range.clone());
        let info = ChunkInfo { sequence: range.start.into(), ..ChunkInfo::default() };
        let rejects: Vec<Reject> = (0..rejects).map(|triangle| Reject { record: 3, triangle }).collect();
        if !rejects.is_empty() {
            part[3].flags |= flag::HAS_REJECTS;
        }
        writer.write_chunk(&info, &part, &rejects, codec).unwrap();
        all.extend(part);
    }
    (writer.finish().unwrap().0, all)
}

type Content = (Header, Vec<(ChunkInfo, Vec<u8>, Vec<Reject>)>);

/// Everything that a reader gets from a file, or nothing where something is refused.
fn content(bytes: &[u8]) -> Option<(Content, bool)> {
    let rays = Rays::parse(bytes).ok()?;
    let own = |chunk: Chunk| {
        (chunk.info, bytemuck::cast_slice(&chunk.records).to_vec(), chunk.rejects.into_owned())
    };
    let chunks = rays.map_chunks(|_, chunk| own(chunk)).ok()?;
    Some(((rays.header.clone(), chunks), rays.recovery.is_some()))
}

#[test]
fn every_flipped_bit_is_found_or_harmless() {
    for codec in [Codec::Raw, Codec::Compressed] {
        let (bytes, _) = small_file(codec);
        let (right, _) = content(&bytes).unwrap();
        let chunks: Vec<u64> =
            Rays::parse(&bytes).unwrap().chunks().iter().map(|chunk| chunk.offset).collect();
        let (mut refused, mut recovered, mut described) = (0, 0, 0);
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let Some(((header, found), cut_off)) = content(&flipped) else {
                refused += 1;
                continue;
            };
            let position = (bit / 8) as u64;
            // What describes the whole file or chunk has no checksum of its own.
            let in_chunk =
                chunks.iter().map(|chunk| position.wrapping_sub(*chunk)).find(|&offset| offset < 64);
            let describes = (16..64).contains(&position)
                || in_chunk
                    .is_some_and(|offset| [6..8, 16..20, 24..32].iter().any(|range| range.contains(&offset)));
            if describes {
                described += 1;
                let bodies = |chunks: &[(ChunkInfo, Vec<u8>, Vec<Reject>)]| -> Vec<(Vec<u8>, Vec<Reject>)> {
                    chunks.iter().map(|(_, records, rejects)| (records.clone(), rejects.clone())).collect()
                };
                assert_eq!(bodies(&found), bodies(&right.1), "bit {bit}");
            } else {
                recovered += u32::from(cut_off);
                assert_eq!((header, found), right, "bit {bit}");
            }
        }
        // The end mark's 64 bits make a file look cut off; then all of it is recovered.
        assert_eq!(recovered, 64);
        assert!(refused > 200 * 8 && described > 0, "{refused} {described}");
    }
}

#[test]
fn every_length_is_refused_or_recovered() {
    for codec in [Codec::Raw, Codec::Compressed] {
        let (bytes, all) = small_file(codec);
        let ends: Vec<(u64, u64)> = {
            let rays = Rays::parse(&bytes).unwrap();
            rays.chunks()
                .iter()
                .map(|chunk| (chunk.body() + chunk.stored_bytes, chunk.records.into()))
                .collect()
        };
        for length in 0..bytes.len() {
            let cut = &bytes[..length];
            let Ok(rays) = Rays::parse(cut) else {
                assert!(length < 64, "{length}");
                continue;
            };
            let expected: u64 =
                ends.iter().filter(|(end, _)| *end <= length as u64).map(|(_, records)| records).sum();
            let recovery = rays.recovery.unwrap();
            assert_eq!((recovery.queries, rays.query_count()), (expected, expected), "{length}");
            assert!(recovery.lost_bytes < length as u64);
            let found: Vec<Record> = rays
                .map_chunks(|_, chunk| chunk.records.into_owned())
                .unwrap()
                .into_iter()
                .flatten()
                .collect();
            assert_eq!(found, all[..found.len()]);
            assert_eq!(found.len() as u64, expected);
        }
    }
}

#[test]
fn a_damaged_chunk_of_a_cut_off_file_costs_only_itself() {
    let (mut bytes, all) = small_file(Codec::Raw);
    let (second, third) = {
        let rays = Rays::parse(&bytes).unwrap();
        (rays.chunks()[1], rays.chunks()[2].offset)
    };
    bytes.truncate(bytes.len() - 1);
    for damaged in [second.offset, second.body()] {
        let mut bytes = bytes.clone();
        bytes[damaged as usize] ^= 0xFF;
        let rays = Rays::parse(&bytes).unwrap();
        assert_eq!(rays.recovery.unwrap().queries, 70);
        assert_eq!(rays.recovery.unwrap().lost_bytes, third - second.offset);
        assert_eq!(*rays.chunk(1).unwrap().records, all[35..]);
    }
}

#[test]
fn recovery_of_overlapping_headers_ends_soon() {
    // Each header claims the rest of the file as its body, with a wrong checksum.
    let length = 8 << 20;
    let mut bytes = file_header().0;
    while bytes.len() < length {
        let rejects = (length - bytes.len() - 64) / 8;
        let header = chunk_header(0, 0, rejects as u32, rejects as u64 * 8, rejects as u64 * 8, 1).0;
        bytes.extend(header);
    }
    let start = Instant::now();
    assert_eq!(Rays::parse(&bytes).unwrap().recovery.unwrap().queries, 0);
    assert!(start.elapsed() < Duration::from_secs(2));
}

fn field_of(bytes: &[u8]) -> (u64, String) {
    let rays = match Rays::parse(bytes) {
        Ok(rays) => rays,
        Err(error) => return (error.offset, error.to_string()),
    };
    let error = rays.validate_all().unwrap_err();
    (error.offset, error.to_string())
}

#[test]
fn hostile_headers_are_refused_with_their_place() {
    let body = [hand_records(), Bytes::default().u32(0).u32(11).0].concat();
    let sum = checksum(&body);
    let file = |header: Bytes| file_with(header, &body, 2, 1);
    let cases = [
        (file(chunk_header(2, 2, 1, 136, 136, sum)), 68, "codec: found 2"),
        (file(chunk_header(0, 65_537, 1, 136, 136, sum)), 72, "record count of a chunk: found 65537"),
        (file(chunk_header(0, u32::MAX, u32::MAX, 136, 136, sum)), 72, "record count"),
        (file(chunk_header(0, 2, u32::MAX, 136, 136, sum)), 104, "bytes of a decoded body: found 136"),
        (file(chunk_header(0, 2, 1, u64::MAX, 136, sum)), 96, "stored bytes of a raw body"),
        (file(chunk_header(1, 2, 1, u64::MAX, 136, sum)), 128, "the file ends inside the body of a chunk"),
        (file(chunk_header(1, 2, u32::MAX, 136, 128 + 8 * 0xFFFF_FFFF, sum)), 104, "at most 16777216"),
        (file(chunk_header(0, 2, 1, 136, 136, sum ^ 1)), 128, "checksum of the body"),
        (file_with(chunk_header(0, 2, 1, 136, 136, sum), &body, 3, 1), 392, "index: found 3 and 1"),
        (file_with(chunk_header(0, 2, 1, 136, 136, sum), &body, 2, 0), 392, "index: found 2 and 0"),
    ];
    for (bytes, offset, text) in cases {
        let (found, line) = field_of(&bytes);
        assert!(found == offset && line.contains(text), "{found} {line}, expected {offset} {text}");
        assert!(!line.contains('\n') && line.starts_with(&format!("at byte {offset}: ")), "{line}");
    }
}

#[test]
fn fields_of_records_and_rejects_are_checked() {
    let rejects = |pairs: &[(u32, u32)]| {
        pairs.iter().fold(Bytes::default(), |bytes, &(record, triangle)| bytes.u32(record).u32(triangle)).0
    };
    let file = |records: Vec<u8>, pairs: &[(u32, u32)]| {
        let body = [records, rejects(pairs)].concat();
        let (count, length) = (pairs.len() as u32, body.len() as u64);
        file_with(chunk_header(0, 2, count, length, length, checksum(&body)), &body, 2, count)
    };
    let mut strange_kind = hand_records();
    strange_kind[64 + 60] = 2;
    let cases = [
        (file(strange_kind, &[(0, 1)]), 128 + 64 + 60, "kind of record 1 of the chunk: found 2"),
        (file(hand_records(), &[(0, 1), (2, 1)]), 128 + 128 + 8, "record of a reject: found 2"),
        (file(hand_records(), &[(u32::MAX, 1)]), 128 + 128, "record of a reject: found 4294967295"),
        (file(hand_records(), &[(1, 1)]), 128 + 128, "flags say that it has none"),
        (file(hand_records(), &[]), 128, "records with rejects in the chunk: found 0, expected 1"),
    ];
    for (bytes, offset, text) in cases {
        let (found, line) = field_of(&bytes);
        assert!(found == offset && line.contains(text), "{found} {line}, expected {offset} {text}");
    }
}

#[test]
fn compressed_bodies_must_be_one_frame_of_the_declared_size() {
    let plain = [columns(&hand_records()), Bytes::default().u32(0).u32(11).0].concat();
    let frame = |bytes: &[u8]| zstd::bulk::compress(bytes, 1).unwrap();
    let skippable = Bytes::default().u32(0x184D_2A50).u32(0).0;
    let bodies = [
        frame(&plain[1..]),
        frame(&[plain.clone(), vec![0]].concat()),
        frame(&vec![0; 64 << 20]),
        [frame(&plain), skippable].concat(),
        [frame(&plain[..100]), frame(&plain[100..])].concat(),
        b"not zstd".to_vec(),
        Vec::new(),
    ];
    for body in bodies {
        let header = chunk_header(1, 2, 1, body.len() as u64, 136, checksum(&body));
        let (offset, line) = field_of(&file_with(header, &body, 2, 1));
        assert!(offset == 128 && line.contains("zstd body of a chunk"), "{line}");
    }
}

#[test]
fn a_broken_index_is_refused() {
    let (bytes, _) = small_file(Codec::Raw);
    let footer = bytes.len() - 16;
    for offset in [0, 63, 65, 128, footer as u64, u64::MAX, u64::MAX - 63, 1 << 40] {
        let mut bytes = bytes.clone();
        bytes[footer..footer + 8].copy_from_slice(&offset.to_le_bytes());
        assert!(Rays::parse(&bytes).is_err(), "{offset}");
    }
    // An index that leaves a chunk out, with a checksum of its own.
    let chunks: Vec<_> = Rays::parse(&bytes).unwrap().chunks().to_vec();
    let end = bytes.len() - 64 - 3 * 16 - 16;
    let entry = |number: usize| (chunks[number].offset, chunks[number].records, chunks[number].rejects);
    for entries in [vec![entry(0), entry(1)], vec![entry(0), entry(2), entry(1)], vec![entry(1)], Vec::new()]
    {
        let forged = [&bytes[..end], &index(end as u64, &entries).0].concat();
        assert!(Rays::parse(&forged).is_err());
    }
    let right = [&bytes[..end], &index(end as u64, &[entry(0), entry(1), entry(2)]).0].concat();
    assert_eq!(right, bytes);
    // The end follows the entries at once.
    for zeros in [1, 15, 16, 48, 64] {
        let apart = [&bytes[..footer], &vec![0; zeros][..], &bytes[footer..]].concat();
        assert!(Rays::parse(&apart).is_err(), "{zeros}");
    }
}

#[test]
fn other_files_are_told_apart() {
    let cases: [(&[u8], Problem); 3] = [
        (b"", Problem::Empty { expected: FileKind::Rays }),
        (
            b"\x89BVH\r\n\x1a\n and more",
            Problem::OtherKind { found: FileKind::Bvh, expected: FileKind::Rays },
        ),
        (b"v 0 0 0\nv 1", Problem::Magic { found: b"v 0 0 0\n".to_vec(), expected: FileKind::Rays }),
    ];
    for (bytes, problem) in cases {
        assert_eq!(Rays::parse(bytes).unwrap_err().problem, problem);
    }
    let mut newer = small_file(Codec::Raw).0;
    newer[8] = 2;
    let problem = Rays::parse(&newer).unwrap_err().problem;
    assert_eq!(problem, Problem::Version { found: 2, supported: 1 });
    // Another minor version only adds what a reader may ignore.
    newer[8] = 1;
    newer[10] = 9;
    assert!(Rays::parse(&newer).is_ok());
}

#[test]
fn raw_chunks_are_viewed_in_place_and_copied_only_when_they_must() {
    let (bytes, all) = small_file(Codec::Raw);
    let rays = Rays::parse(&bytes).unwrap();
    let Cow::Borrowed(borrowed) = rays.chunk(2).unwrap().records else { panic!("copied") };
    assert_eq!(borrowed, &all[35..]);
    let mut shifted = vec![0];
    shifted.extend_from_slice(&bytes);
    // One of the two is not aligned to 4, wherever the allocation starts.
    for copy in [&shifted[1..], &bytes[..]] {
        assert_eq!(*Rays::parse(copy).unwrap().chunk(2).unwrap().records, all[35..]);
    }
}

#[test]
fn rejects_come_sorted_by_record() {
    let mut records = hand_records();
    records[64 + 62] |= flag::HAS_REJECTS;
    let rejects = Bytes::default().u32(1).u32(5).u32(0).u32(8).u32(1).u32(4).0;
    let body = [records, rejects].concat();
    let header = chunk_header(0, 2, 3, body.len() as u64, body.len() as u64, checksum(&body));
    let bytes = file_with(header, &body, 2, 3);
    let rejects = Rays::parse(&bytes).unwrap().chunk(0).unwrap().rejects.into_owned();
    let reject = |record, triangle| Reject { record, triangle };
    assert_eq!(rejects, [reject(0, 8), reject(1, 5), reject(1, 4)]);
}

#[test]
fn the_writer_refuses_what_no_reader_takes() {
    let info = ChunkInfo::default();
    let too_many = vec![record(1); MAX_CHUNK_RECORDS + 1];
    assert!(encode_chunk(&info, &too_many, &[], Codec::Raw).is_err());
    assert!(encode_chunk(&info, &too_many[1..], &[], Codec::Raw).is_ok());
    let rejects = [Reject { record: 1, triangle: 0 }];
    assert!(encode_chunk(&info, &records(0..1), &rejects, Codec::Raw).is_err());
    assert!(encode_chunk(&info, &records(0..2), &rejects, Codec::Raw).is_err());
    let strange = Record { kind: 7, ..record(1) };
    assert!(encode_chunk(&info, &[strange], &[], Codec::Raw).is_err());
}

/// A disk with room for so many bytes.
struct Disk {
    room: usize,
    written: Vec<u8>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = bytes.len().min(self.room);
        if count == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.room -= count;
        self.written.extend_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_keeps_the_count_and_the_chunks_before() {
    let mut disk = Disk { room: 64 + 2 * (64 + 64 * 10) + 100, written: Vec::new() };
    let mut writer = RaysWriter::new(&mut disk, &Header::default()).unwrap();
    let part = records(0..10);
    let mut write =
        || writer.write_chunk(&ChunkInfo::default(), &part, &[], Codec::Raw).map_err(|error| error.kind());
    assert_eq!([write(), write(), write()], [Ok(()), Ok(()), Err(io::ErrorKind::StorageFull)]);
    // Nothing is written behind half a chunk.
    assert_eq!(write(), Err(io::ErrorKind::Other));
    assert_eq!((writer.totals().records, writer.totals().chunks), (20, 2));
    assert!(writer.finish().is_err());
    let rays = Rays::parse(&disk.written).unwrap();
    assert_eq!(rays.recovery.unwrap().queries, 20);
    assert_eq!(rays.recovery.unwrap().lost_bytes, 100);
}

#[test]
fn verify_finds_results_that_contradict_themselves() {
    let write = |part: &[Record], sequences: [u64; 2], codec| {
        let mut writer = RaysWriter::new(Vec::new(), &Header::default()).unwrap();
        for sequence in sequences {
            writer.write_chunk(&ChunkInfo { sequence, ..ChunkInfo::default() }, part, &[], codec).unwrap();
        }
        writer.finish().unwrap().0
    };
    let verify = |bytes: &[u8]| Rays::parse(bytes).unwrap().verify();
    let good = records(0..100);
    assert_eq!(verify(&write(&good, [0, 100], Codec::Raw)), Ok(()));
    assert_eq!(verify(&write(&good, [100, 0], Codec::Compressed)), Ok(()));
    let overlap = verify(&write(&good, [0, 99], Codec::Raw)).unwrap_err();
    assert!(overlap.to_string().contains("sequence number"), "{overlap}");

    let hit = record(1);
    let occlusion = Record { kind: kind::OCCLUSION, t: f32::NEG_INFINITY, triangle: NO_TRIANGLE, ..hit };
    // A moving triangle, and something that is none.
    let moving = Record { flags: hit.flags | flag::UNDECIDED, ..hit };
    for right in [moving, Record { triangle: NO_TRIANGLE, ..moving }] {
        let mut part = good.clone();
        part[42] = right;
        assert_eq!(verify(&write(&part, [0, 100], Codec::Raw)), Ok(()));
    }
    let bad = [
        Record { t: f32::NAN, ..hit },
        Record { t: f32::INFINITY, ..hit },
        Record { triangle: NO_TRIANGLE, ..hit },
        Record { flags: 0, ..hit },
        Record { flags: flag::HIT, ..record(3) },
        Record { t: 1.0, ..occlusion },
        Record { flags: 0, ..occlusion },
    ];
    for wrong in bad {
        let mut part = good.clone();
        part[42] = wrong;
        for codec in [Codec::Raw, Codec::Compressed] {
            let error = verify(&write(&part, [0, 100], codec)).unwrap_err();
            let offset = if codec == Codec::Raw { 128 + 42 * 64 + 40 } else { 128 };
            assert!(error.offset == offset && error.to_string().contains("result of record 42"), "{error}");
        }
    }
    assert_eq!(verify(&write(&[hit, occlusion], [0, 2], Codec::Raw)), Ok(()));
}

#[test]
fn the_first_damaged_chunk_is_the_one_reported() {
    let (mut bytes, _) = small_file(Codec::Raw);
    let bodies: Vec<u64> = Rays::parse(&bytes).unwrap().chunks().iter().map(|chunk| chunk.body()).collect();
    bytes[bodies[1] as usize] ^= 1;
    bytes[bodies[2] as usize] ^= 1;
    let rays = Rays::parse(&bytes).unwrap();
    for _ in 0..20 {
        assert_eq!(rays.validate_all().unwrap_err().offset, bodies[1]);
        assert_eq!(rays.map_chunks(|_, _| ()).unwrap_err().offset, bodies[1]);
    }
}

/// Any bits in any field that no rule restricts, NaN included.
fn any_record() -> impl Strategy<Value = Record> {
    (any::<[u32; 15]>(), 0..2u8, any::<[u8; 3]>()).prop_map(|(words, kind, [depth, flags, purpose])| {
        let mut record: Record = bytemuck::Zeroable::zeroed();
        bytemuck::cast_slice_mut(std::slice::from_mut(&mut record))[..15].copy_from_slice(&words);
        Record { kind, depth, flags: flags & !flag::HAS_REJECTS, purpose, ..record }
    })
}

type AnyChunk = (Vec<Record>, Vec<Reject>, ChunkInfo, bool);

fn any_chunk() -> impl Strategy<Value = AnyChunk> {
    let records = prop::collection::vec(any_record(), 0..200);
    let rejects = prop::collection::vec((any::<prop::sample::Index>(), any::<u32>()), 0..20);
    (records, rejects, any::<(u16, u32, u64)>(), any::<bool>()).prop_map(
        |(mut records, rejects, (scene, thread, sequence), raw)| {
            let mut sorted = Vec::new();
            for (index, triangle) in rejects.iter().filter(|_| !records.is_empty()) {
                let record = index.index(records.len()) as u32;
                sorted.push(Reject { record, triangle: *triangle });
            }
            sorted.sort_by_key(|reject| reject.record);
            sorted.iter().for_each(|reject| records[reject.record as usize].flags |= flag::HAS_REJECTS);
            (records, sorted, ChunkInfo { scene, thread, sequence }, raw)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_read(
        chunks in prop::collection::vec(any_chunk(), 0..6),
        numbers in any::<(u64, u32, bool)>(),
        producer in "[^\0]{0,12}",
    ) {
        let producer = producer.chars().take(8).collect::<String>();
        let header = Header { fingerprint: numbers.0, embree_version: numbers.1, deterministic: numbers.2, producer };
        let mut writer = RaysWriter::new(Vec::new(), &header).unwrap();
        for (records, rejects, info, raw) in &chunks {
            let codec = if *raw { Codec::Raw } else { Codec::Compressed };
            writer.write_encoded(&encode_chunk(info, records, rejects, codec).unwrap().into_owned()).unwrap();
        }
        let (bytes, totals) = writer.finish().unwrap();
        prop_assert_eq!(bytes.len() as u64, totals.bytes);
        let rays = Rays::parse(&bytes).unwrap();
        prop_assert_eq!(&rays.header, &header);
        prop_assert_eq!(rays.chunks().len(), chunks.len());
        for (index, (records, rejects, info, _)) in chunks.iter().enumerate() {
            let chunk = rays.chunk(index).unwrap();
            let bits = |records: &[Record]| bytemuck::cast_slice::<_, u8>(records).to_vec();
            prop_assert_eq!(bits(&chunk.records), bits(records));
            prop_assert_eq!(&*chunk.rejects, &rejects[..]);
            prop_assert_eq!(chunk.info, *info);
        }
    }

    #[test]
    fn no_bytes_make_a_reader_panic(tail in prop::collection::vec(any::<u8>(), 0..400), end in any::<bool>()) {
        let mut bytes = file_header().0;
        bytes.extend(tail);
        if end {
            bytes.extend_from_slice(b"RAYSEND\0");
        }
        if let Ok(rays) = Rays::parse(&bytes) {
            let _ = rays.validate_all();
        }
    }
}
