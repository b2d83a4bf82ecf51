//! Damage: whatever the bytes, one line and no more memory than the file is worth.

use super::support::{Place, hit, legacy, legacy_file, recording};
use super::trees::plain;
use bytes::Bytes;
use embree_trace::convert::{ConvertError, Kind, bvh_2011, sink, source};
use embree_trace::format::rays::{Chunk, ChunkInfo, Codec, Header, Record, Reject, flag};
use embree_trace::geometry::{Triangle, Vec3};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::sync::Arc;

/// Reads all queries of a file that may be anything.
fn read(bytes: &[u8], kind: Kind) -> Result<usize, ConvertError> {
    let bytes = Bytes::copy_from_slice(bytes);
    let mut source = source(&bytes, kind)?;
    let mut count = 0;
    while let Some(chunk) = source.next()? {
        assert!(chunk.records.len() <= 65_536);
        count += chunk.records.len();
    }
    // Every record takes at least 32 bytes of a file that is not compressed.
    assert!((count <= bytes.len() / 32 || kind == Kind::Parquet) && count as u64 == source.count());
    Ok(count)
}

/// Every beginning of a file, and the file with each of its bits flipped: how many of each could still be read.
fn damaged(bytes: &[u8], kind: Kind) -> (usize, usize) {
    let cut = (0..bytes.len()).filter(|&end| read(&bytes[..end], kind).is_ok()).count();
    let mut copy = bytes.to_vec();
    let flipped = (0..bytes.len() * 8).filter(|&bit| {
        copy[bit / 8] ^= 1 << (bit % 8);
        let good = read(&copy, kind).is_ok();
        copy[bit / 8] ^= 1 << (bit % 8);
        good
    });
    (cut, flipped.count())
}

#[test]
fn damaged_rays_of_2011_are_refused_or_other_queries() {
    let bytes = legacy_file(&[legacy(0, 0, [1.0; 3], [2.0; 3]), legacy(3, 1, [1.0; 3], [2.0; 3])]);
    // Of a record, the depth and the floats may be anything, and two bits of id; the end mark nothing.
    assert_eq!(damaged(&bytes, Kind::Rays2011), (0, 2 * (28 * 8 + 2)));
}

#[test]
fn errors_of_2011_name_the_place() {
    let place = Place::new();
    let wrong = |id| legacy_file(&[legacy(0, 0, [1.0; 3], [2.0; 3]), legacy(id, 1, [1.0; 3], [2.0; 3])]);
    place.put("id.rays2011", &wrong(4));
    let line = place.refuse("id.rays2011 out.rays");
    assert!(
        line.contains("id.rays2011: at byte 32: id of a query: found 4, expected 0, 1, 2 or 3"),
        "{line}"
    );
    assert!(!place.path("out.rays").exists());
    place.put("cut.rays2011", &wrong(0)[..66]);
    let line = place.refuse("cut.rays2011 out.rays");
    assert!(
        line.contains(
            "at byte 64: the file ends inside the end of a 2011 ray file (the word 9215): 2 bytes left"
        ),
        "{line}"
    );
    place.put("end.rays2011", &[&wrong(0)[..64], &[0; 4]].concat());
    let line = place.refuse("end.rays2011 out.rays");
    assert!(line.contains("at byte 64: end of a 2011 ray file: found"), "{line}");
}

#[test]
fn damaged_arrays_are_refused_or_other_queries() {
    let place = Place::new();
    recording(&place.path("ours.rays"));
    place.convert("ours.rays ours.npy --sample 3");
    let bytes = place.get("ours.npy");
    let start = bytes.len() - 3 * 64;
    let (cut, flipped) = damaged(&bytes, Kind::Npy);
    assert_eq!(cut, 0);
    // Every bit of a record but the seven of its kind, and few of the header: spaces, and the ending of a name in an unread place.
    let of_records = 3 * (64 * 8 - 7);
    assert!((of_records..of_records + 8 * start).contains(&flipped), "{flipped}");
}

#[test]
fn arrays_of_other_dtypes_and_shapes_are_refused() {
    let place = Place::new();
    place.python(
        r#"
import numpy as np
np.save("floats.npy", np.zeros((10, 3), "f4"))
np.save("table.npy", np.zeros(10, [("origin", "<f4", 3), ("t", "<f8")]))
"#,
    );
    for name in ["floats.npy", "table.npy"] {
        let line = place.refuse(&format!("{name} out.rays"));
        assert!(
            line.contains("dtype of the .npy: found") && line.contains("('origin', '<f4', (3,))"),
            "{line}"
        );
    }
    recording(&place.path("ours.rays"));
    place.convert("ours.rays ours.npy");
    place.python(
        r#"
import numpy as np
np.save("square.npy", np.load("ours.npy").reshape(10, 10))
open("bytes.npy", "wb").write(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{")
"#,
    );
    for (name, expected) in [
        ("square.npy", "shape of the .npy: found (10,10), expected one dimension"),
        ("bytes.npy", "the file ends inside the header of an .npy: 13 bytes left, expected 4294967307"),
    ] {
        let line = place.refuse(&format!("{name} out.rays"));
        assert!(line.contains(expected), "{line}");
    }
    // 2^58 records of 64 bytes are 2^64 bytes: a product that wraps to what is there.
    let mut wrapped = place.get("ours.npy");
    let at = wrapped.windows(6).position(|window| window == b"(100,)").unwrap();
    let number = format!("({},), }}", (1_u64 << 58) + 100);
    wrapped[at..at + number.len()].copy_from_slice(number.as_bytes());
    place.put("wrapped.npy", &wrapped);
    let line = place.refuse("wrapped.npy out.rays");
    assert!(
        line.contains("data of the .npy: found 6400 bytes, expected 288230376151711844 records"),
        "{line}"
    );
}

#[test]
fn damaged_tables_are_refused_or_other_queries() {
    let place = Place::new();
    recording(&place.path("ours.rays"));
    place.convert("ours.rays ours.parquet --sample 40");
    let bytes = place.get("ours.parquet");
    let cut = (0..bytes.len()).filter(|&end| read(&bytes[..end], Kind::Parquet).is_ok()).count();
    assert_eq!(cut, 0);
    // Pages have no checksums that the reader asks for, so much damage gives other numbers: none may panic.
    let mut copy = bytes.clone();
    for bit in (0..bytes.len() * 8).step_by(17) {
        copy[bit / 8] ^= 1 << (bit % 8);
        if let Err(error) = read(&copy, Kind::Parquet) {
            assert!(error.to_string().starts_with("not a table of queries, or damaged: "), "{error}");
        }
        copy[bit / 8] ^= 1 << (bit % 8);
    }
}

/// The error of the first thing that is wrong with a table.
fn refused_table(bytes: &[u8]) -> String {
    read(bytes, Kind::Parquet).unwrap_err().to_string()
}

/// A table without rows.
fn empty_table(columns: &str) -> Vec<u8> {
    let schema = parse_message_type(&format!("message table {{ {columns} }}")).unwrap();
    let properties = Arc::new(WriterProperties::new());
    let writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties).unwrap();
    writer.into_inner().unwrap()
}

#[test]
fn tables_with_two_columns_of_one_name_are_refused() {
    let whole = "REQUIRED FLOAT t; REQUIRED GROUP rejects (LIST) { REPEATED GROUP list { REQUIRED INT32 a;";
    for (columns, name) in [("} } REQUIRED DOUBLE t;", "t"), ("REQUIRED INT32 b; } }", "rejects")] {
        let line = refused_table(&empty_table(&format!("{whole} {columns}")));
        assert!(line.ends_with(&format!("column {name}: there is a second one")), "{line}");
    }
}

#[test]
fn tables_of_columns_within_columns_are_refused() {
    let nested = |depth: usize| {
        format!("{}REQUIRED INT32 a;{}", "REQUIRED GROUP g { ".repeat(depth), " }".repeat(depth))
    };
    for (depth, expected) in [(900, "the columns origin_x, "), (1100, "1101 columns that consist of others")]
    {
        let line = refused_table(&empty_table(&nested(depth)));
        assert!(line.contains(expected), "{line}");
    }
}

/// A table of one query with so many rejects, all of one triangle.
fn table_of_rejects(count: usize) -> Vec<u8> {
    let records = [Record { flags: flag::HIT | flag::HAS_REJECTS, ..hit() }];
    let rejects = vec![Reject { record: 0, triangle: 7 }; count];
    let mut bytes = Vec::new();
    let mut sink = sink(&mut bytes, Kind::Parquet, &Header::default(), 1, Codec::Raw).unwrap();
    let info = ChunkInfo::default();
    sink.write(&Chunk { info, records: records[..].into(), rejects: rejects.into() }).unwrap();
    sink.finish().unwrap();
    bytes
}

#[test]
fn tables_with_more_than_their_bytes_are_worth_are_refused() {
    assert_eq!(read(&table_of_rejects(1000), Kind::Parquet).unwrap(), 1);
    // One value more than one per row and 2^24 beside.
    let bytes = table_of_rejects((16 << 20) + 2);
    assert!(bytes.len() < 20_000, "{}", bytes.len());
    let line = refused_table(&bytes);
    assert!(line.contains("over 16777216 values in the 1 rows of a row group"), "{line}");

    // A page header: type 2, a dictionary; two sizes; in field 7, the number of values.
    let mut bytes = table_of_rejects(1);
    let at = bytes.windows(8).position(
        |header| matches!(header, [0x15, 0x04, 0x15, decoded, 0x15, _, 0x4C, 0x15] if decoded >> 1 == 4),
    );
    let values = at.expect("a dictionary of one value") + 8;
    assert_eq!(bytes[values] >> 1, 1);
    bytes[values] = 2 << 1;
    let line = refused_table(&bytes);
    assert!(line.contains("the header of a page, or the size that it says, is damaged"), "{line}");
}

fn scene() -> Vec<Triangle> {
    (0..4).map(|z| Triangle([Vec3::X, Vec3::Y, Vec3::Z].map(|v| v + z as f32 * Vec3::Z))).collect()
}

#[test]
fn damaged_trees_of_2011_are_refused_or_other_trees() {
    let (bytes, triangles) = (plain().0, scene());
    assert!(bvh_2011::read(&bytes, &triangles).is_ok());
    assert!((0..bytes.len()).all(|end| bvh_2011::read(&bytes[..end], &triangles).is_err()));
    let mut copy = bytes.clone();
    for bit in 0..bytes.len() * 8 {
        copy[bit / 8] ^= 1 << (bit % 8);
        if let Ok(read) = bvh_2011::read(&copy, &triangles) {
            assert!(
                read.tree.nodes.len() <= bytes.len() / 4 && read.tree.primitives.len() <= bytes.len() / 4
            );
        }
        copy[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn errors_of_trees_of_2011_name_the_place() {
    let refused = |words: &[i32]| {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        bvh_2011::read(&bytes, &scene()).unwrap_err().to_string()
    };
    for (words, expected) in [
        (&[][..], "at byte 0: the file ends inside the magic of a 2011 tree: 0 bytes left, expected 4"),
        (&[1], "at byte 0: magic of a 2011 tree: found 1, expected 267534"),
        (&[267_534, 203], "at byte 4: type of the tree: found 203, expected 201 or 202"),
        (&[267_534, 201, 4], "at byte 8: id of a node: found 4, expected 0, 1, 2 or 3"),
        (
            &[267_534, 201, 2, 2, 2],
            "at byte 12: the file ends inside the nodes of a 2011 tree: 8 bytes left, expected 20",
        ),
        (
            &[267_534, 201, 3, i32::MAX, 0],
            "at byte 12: number of triangles of a leaf: found 2147483647, expected 0 to 1,",
        ),
        (&[267_534, 201, 3, -1, 0], "at byte 12: number of triangles of a leaf: found -1, expected 0 to 1,"),
        (
            &[267_534, 201, 3, 1, 4, 9215],
            "at byte 16: triangle of a leaf: found 4, expected 0 up to the 4 triangles",
        ),
        (&[267_534, 201, 3, 1, -1, 9215], "at byte 16: triangle of a leaf: found -1"),
        (&[267_534, 201, 3, 1, 0, 1], "at byte 20: end of a 2011 tree: found 1, expected 9215"),
        (
            &[267_534, 201, 3, 1, 0, 9215, 9215],
            "at byte 24: end of a 2011 tree: found 4 bytes more, expected none",
        ),
    ] {
        let line = refused(words);
        assert!(line.starts_with(expected), "{line}");
    }
}

#[test]
fn a_tree_of_2011_may_be_a_long_chain() {
    const DEPTH: usize = 200_000;
    let mut words = vec![267_534, 201];
    for _ in 0..DEPTH {
        // A branch whose left child is a leaf of nothing.
        words.extend([2, 3, 0]);
    }
    words.extend([3, 1, 0, 9215]);
    let bytes: Vec<u8> = words.iter().flat_map(|word: &i32| word.to_le_bytes()).collect();
    let read = bvh_2011::read(&bytes, &scene()).unwrap();
    assert_eq!((read.tree.nodes.len(), read.tree.primitives.len()), (2 * DEPTH + 1, 1));
    assert_eq!(read.tree.nodes[0].bounds(), scene()[0].bounds());
}
