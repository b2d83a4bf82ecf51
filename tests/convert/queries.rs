//! Queries: the 2011 files, NumPy, Parquet, and lines.

use super::support::{Place, blocked, hit, legacy, legacy_file, recording, write_rays};
use embree_trace::format::bvh::{self, Contents};
use embree_trace::format::rays::{ChunkInfo, Header, NO_DEPTH, NO_PATH, NO_TRIANGLE, Record, flag, kind};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{Node, Tree};
use parquet::basic::Compression;
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::fs;

const INF: f32 = f32::INFINITY;

/// One of each id, with the depths 0, 3, unknown and one that is too large.
fn four() -> Vec<u8> {
    legacy_file(&[
        legacy(0, 0, [1.0, 2.0, 3.0], [0.0, 0.0, 5.0]),
        legacy(1, 3, [0.5, 0.0, 0.0], [0.0, -1.0, 0.25]),
        legacy(2, -1, [0.0; 3], [4.0, 0.0, 0.0]),
        legacy(3, 1000, [-1.0; 3], [0.0, 8.0, 0.0]),
    ])
}

#[test]
fn a_file_of_2011_means_what_its_specification_says() {
    let place = Place::new();
    place.put("old.rays2011", &four());
    let said = place.convert("old.rays2011 new.rays");
    assert_eq!(
        (&said["from"], &said["to"], &said["count"]),
        (&"rays-2011".into(), &"rays".into(), &4.into())
    );
    assert_eq!(said["lost"], serde_json::json!({"depth that is not from 0 to 254": 1}));

    let (header, records, _) = place.queries("new.rays");
    assert_eq!((header.fingerprint, header.embree_version, header.deterministic), (0, 0, false));
    let expected = |origin: [f32; 3], direction: [f32; 3], kind, tfar, t, depth, flags| Record {
        origin: origin.into(),
        direction: direction.into(),
        tnear: 0.0,
        tfar,
        time: 0.0,
        mask: u32::MAX,
        t,
        triangle: NO_TRIANGLE,
        u: 0.0,
        v: 0.0,
        path: NO_PATH,
        kind,
        depth,
        flags,
        purpose: 0,
    };
    let (closest, occlusion) = (kind::CLOSEST_HIT, kind::OCCLUSION);
    assert_eq!(
        records,
        [
            expected([1.0, 2.0, 3.0], [0.0, 0.0, 5.0], closest, INF, 1.0, 0, flag::HIT | flag::UNDECIDED),
            expected([0.5, 0.0, 0.0], [0.0, -1.0, 0.25], closest, INF, INF, 3, 0),
            expected([0.0; 3], [4.0, 0.0, 0.0], occlusion, 1.0, -INF, NO_DEPTH, flag::HIT),
            expected([-1.0; 3], [0.0, 8.0, 0.0], occlusion, 1.0, INF, NO_DEPTH, 0),
        ]
    );
    let verified = place.run(env!("CARGO_BIN_EXE_trace-info"), "new.rays --verify");
    assert_eq!(verified.code, 0, "{}", verified.error);
}

#[test]
fn a_file_of_2011_comes_back_byte_for_byte() {
    let place = Place::new();
    let mut bytes = four();
    // The depth that our records cannot hold becomes unknown.
    bytes[100..104].copy_from_slice(&(-1_i32).to_le_bytes());
    place.put("old.rays2011", &bytes);
    place.convert("old.rays2011 new.rays");
    let said = place.convert("new.rays again.bin --to rays-2011");
    assert_eq!((&said["lost"], &said["left_out"]), (&serde_json::json!({}), &serde_json::json!({})));
    assert_eq!(place.get("again.bin"), bytes);
    // Content tells without a name that does.
    place.convert("again.bin direct.npy");
    place.convert("direct.npy third.rays2011");
    assert_eq!(place.get("third.rays2011"), bytes);
}

#[test]
fn more_than_a_chunk_of_2011_is_cut_into_chunks() {
    let place = Place::new();
    let many: Vec<Vec<u8>> =
        (0..70_000).map(|i| legacy(1, 0, [i as f32, 0.0, 0.0], [1.0, 0.0, 0.0])).collect();
    place.put("many.rays2011", &legacy_file(&many));
    place.convert("many.rays2011 many.rays");
    let (_, records, _) = place.queries("many.rays");
    assert!(records.len() == 70_000 && records.iter().enumerate().all(|(i, r)| r.origin.x == i as f32));
    place.convert("many.rays back.rays2011");
    assert_eq!(place.get("back.rays2011"), place.get("many.rays2011"));
}

#[test]
fn ours_becomes_2011_and_says_what_is_lost() {
    let place = Place::new();
    let miss = Record { t: INF, triangle: NO_TRIANGLE, u: 0.0, v: 0.0, flags: 0, tfar: 9.0, ..hit() };
    let endless = Record { tfar: INF, ..blocked() };
    let huge = Record { t: 1e38, direction: Vec3::new(0.0, 0.0, 1e10), ..hit() };
    let free = Record { t: INF, flags: flag::COHERENT, tnear: 0.5, time: 0.25, mask: 3, ..blocked() };
    let records = [hit(), miss, blocked(), endless, huge, Record { depth: NO_DEPTH, ..free }];
    let info = ChunkInfo { scene: 2, thread: 1, sequence: 0 };
    write_rays(
        &place.path("ours.rays"),
        &Header { fingerprint: 5, ..Header::default() },
        &[(info, &records, &[])],
    );

    let said = place.convert("ours.rays old.rays2011");
    let origin = [1.0, 2.0, 3.0];
    assert_eq!(
        place.get("old.rays2011"),
        legacy_file(&[
            legacy(0, 1, origin, [0.0, 0.0, 5.0]),
            legacy(1, 1, origin, [0.0, 0.0, 2.0]),
            legacy(2, 1, origin, [0.0, 0.0, 8.0]),
            legacy(3, -1, origin, [0.0, 0.0, 8.0]),
        ])
    );
    assert_eq!(said["count"], 4);
    assert_eq!(
        said["left_out"],
        serde_json::json!({
            "occlusion query without an end (tfar is +inf)": 1,
            "query whose t or tfar times its direction is not finite": 1,
        })
    );
    assert_eq!(
        said["lost"],
        serde_json::json!({
            "scene fingerprint": 1, "scene number of a chunk": 1, "thread of a chunk": 1, "tnear other than 0": 1,
            "time other than 0": 1, "mask": 1, "tfar of a closest-hit query that missed": 1,
            "triangle and barycentrics of a hit": 1, "pixel": 4, "purpose": 4, "coherent flag": 1,
        })
    );
    // For people, a line each.
    let text = place.run(env!("CARGO_BIN_EXE_trace-convert"), "ours.rays old.rays2011").out;
    assert!(text.contains("4 queries, 132 bytes") && text.lines().count() == 1 + 2 + 11, "{text}");
}

/// Two squares across the z axis, at z = 0 and z = 4: triangles 0, 1 and 2, 3.
fn squares(place: &Place) {
    let corner = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let at = |z: f32| {
        let (a, b, c, d) =
            (corner(0.0, 0.0, z), corner(8.0, 0.0, z), corner(8.0, 8.0, z), corner(0.0, 8.0, z));
        [Triangle([a, b, c]), Triangle([a, c, d])]
    };
    let triangles = [at(0.0), at(4.0)].concat();
    let bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::new(8.0, 8.0, 4.0) };
    let tree = Tree { nodes: vec![Node::leaf(bounds, 0, 4)], primitives: vec![0, 1, 2, 3] };
    let contents = Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: &[],
        order: None,
        meta: None,
        flags: 0,
        producer: "test",
    };
    bvh::write(fs::File::create(place.path("squares.bvh")).unwrap(), &contents).unwrap();
}

#[test]
fn a_tree_tells_the_triangle_that_a_file_of_2011_does_not() {
    let place = Place::new();
    squares(&place);
    place.put(
        "old.rays2011",
        &legacy_file(&[
            // To the first square at (2, 6): in triangle 1 = (0,0), (8,8), (0,8), so u = 2/8, v = (6 - 2)/8.
            legacy(0, 0, [2.0, 6.0, -3.0], [0.0, 0.0, 3.0]),
            // To the second square at (6, 1), through the first: triangle 2 = (0,0), (8,0), (8,8).
            legacy(0, 1, [6.0, 1.0, -4.0], [0.0, 0.0, 8.0]),
            // To where nothing is.
            legacy(0, 0, [2.0, 6.0, -3.0], [0.0, 0.0, 5.0]),
            legacy(1, 0, [2.0, 6.0, -3.0], [0.0, 0.0, -1.0]),
            legacy(2, 0, [2.0, 6.0, -3.0], [0.0, 0.0, 5.0]),
        ]),
    );
    let said = place.convert("old.rays2011 new.rays --bvh squares.bvh");
    assert_eq!(said["triangles"], serde_json::json!({"found": 2, "not_found": 1, "met_before": 1}));
    let (header, records, _) = place.queries("new.rays");
    let tree = place.get("squares.bvh");
    assert_eq!(header.fingerprint, bvh::Bvh::parse(&tree).unwrap().header.fingerprint);
    let results = |r: &Record| (r.triangle, r.t, r.u, r.v, r.flags);
    assert_eq!(results(&records[0]), (1, 1.0, 0.25, 0.5, flag::HIT));
    assert_eq!(results(&records[1]), (2, 1.0, 0.625, 0.125, flag::HIT));
    assert_eq!(results(&records[2]), (NO_TRIANGLE, 1.0, 0.0, 0.0, flag::HIT | flag::UNDECIDED));
    assert_eq!(results(&records[3]), (NO_TRIANGLE, INF, 0.0, 0.0, 0));

    // A recording that names its scene is not completed over another one's tree.
    recording(&place.path("other.rays"));
    let line = place.refuse("other.rays out.rays --bvh squares.bvh");
    assert!(line.contains("squares.bvh: the queries are of scene 00000000abcdef01"), "{line}");
}

#[test]
fn numpy_maps_the_records() {
    let place = Place::new();
    let (_, records, _) = recording(&place.path("ours.rays"));
    let said = place.convert("ours.rays ours.npy");
    assert_eq!(
        said["lost"],
        serde_json::json!({
            "scene fingerprint": 1, "Embree's version": 1, "note that the order does not depend on threads": 1,
            "reject": 3, "thread of a chunk": 1,
        })
    );
    let seen = place.python(
        r#"
import numpy as np
a = np.load("ours.npy", mmap_mode="r")
assert isinstance(a, np.memmap) and a.shape == (100,) and a.dtype.itemsize == 64 and a.offset % 64 == 0
assert (a["path"] == np.arange(100)).all() and (a["time"] == np.arange(100, dtype="f4") / np.float32(100)).all()
first = a[0]
print(first["origin"].tolist(), first["tnear"], first["direction"].tolist(), first["tfar"], first["mask"], first["t"], first["triangle"],
      first["uv"].tolist(), first["kind"], first["depth"], first["flags"], first["purpose"])
print((a["kind"] == 1).sum(), np.isneginf(a["t"]).sum(), (a["purpose"] == 2).sum())
# What a user does: some of them, changed, saved under another version of the format.
some = np.array(a[a["kind"] == 0])
some["depth"] = 9
np.lib.format.write_array(open("some.npy", "wb"), some, version=(3, 0))
"#,
    );
    assert_eq!(
        seen,
        "[1.0, 2.0, 3.0] 0.0 [0.0, 0.0, 2.0] inf 4294967295 2.5 7 [0.25, 0.5] 0 1 1 4\n50 25 50"
    );

    let said = place.convert("some.npy some.rays");
    assert_eq!(said["count"], 50);
    let (_, some, _) = place.queries("some.rays");
    let expected: Vec<Record> = records
        .iter()
        .filter(|record| !record.is_occlusion())
        .map(|record| Record { depth: 9, flags: record.flags & !flag::HAS_REJECTS, ..*record })
        .collect();
    assert_eq!(some, expected);
    let lost = "flag of a query that says that it had rejects, which the array does not hold";
    assert_eq!(said["lost"], serde_json::json!({lost: 1}), "query 60 had some");
}

#[test]
fn filters_and_samples_choose_and_keep_rejects_with_their_queries() {
    let place = Place::new();
    let (_, records, rejects) = recording(&place.path("ours.rays"));
    place.convert("ours.rays all.rays --codec raw");
    assert_eq!(place.queries("all.rays"), place.queries("ours.rays"));
    assert_eq!(place.queries("all.rays").2, rejects);

    place.convert("ours.rays occlusions.rays --filter kind=occlusion");
    let (_, chosen, kept) = place.queries("occlusions.rays");
    let expected: Vec<Record> = records.iter().filter(|record| record.is_occlusion()).copied().collect();
    assert_eq!(chosen, expected);
    // Query 98 is the 50th occlusion; 60 is a closest hit.
    assert_eq!(kept, [(48, 9), (48, 5)]);

    for (words, most) in
        [("--sample 10", 10), ("--sample 1000", 100), ("--sample 20 --filter kind=closest", 20)]
    {
        let said = place.convert(&format!("ours.rays some.npy {words}"));
        let count = place.python("import numpy; print(len(numpy.load('some.npy')))");
        assert_eq!(said["count"].to_string(), count);
        assert!(said["count"].as_u64().unwrap() <= most && said["count"] != 0, "{said}");
    }
}

#[test]
fn what_a_cut_off_recording_lost_is_said() {
    let place = Place::new();
    let (_, records, _) = recording(&place.path("ours.rays"));
    let bytes = place.get("ours.rays");
    // Header, a chunk of 40 records, and a part of the next.
    place.put("cut.rays", &bytes[..64 + 64 + 40 * 64 + 100]);
    let said = place.convert("cut.rays cut.parquet");
    assert_eq!(said["count"], 40);
    assert_eq!(
        said["lost"],
        serde_json::json!({"byte of the recording, which was cut off: in no whole chunk": 100})
    );
    place.convert("cut.parquet back.rays");
    assert_eq!(place.queries("back.rays").1, records[..40]);
}

#[test]
fn wrong_usage_is_one_line() {
    let place = Place::new();
    recording(&place.path("ours.rays"));
    place.put("what.bin", b"no format that we know");
    for (words, expected) in [
        ("what.bin out.rays", "what.bin: neither content nor ending says which format this is: add --from"),
        ("ours.rays out.txt", "out.txt: neither content nor ending says which format this is: add --to"),
        ("ours.rays out.npy --part nodes", "ours.rays: --mesh and --part are for trees"),
        ("ours.rays out.bvh", "ours.rays: queries cannot become bvh"),
        ("none.rays out.npy", "none.rays: cannot open"),
        ("what.bin out.rays --from npy", "what.bin: at byte 0: magic: found \"no for\""),
        ("ours.rays out.npy --from rays-2011", "ours.rays: at byte"),
        ("ours.rays no/out.npy", "no/out.npy: cannot create"),
        ("ours.rays /dev/full --to npy", "/dev/full: cannot write: No space left"),
    ] {
        let line = place.refuse(words);
        assert!(line.starts_with(&format!("trace-convert: error: {expected}")), "{line}");
    }
    assert!(!place.path("out.npy").exists());
}

#[test]
fn a_table_comes_back_as_the_same_recording() {
    let place = Place::new();
    let (header, records, rejects) = recording(&place.path("ours.rays"));
    let said = place.convert("ours.rays ours.parquet");
    assert_eq!(
        (&said["count"], &said["lost"], &said["left_out"]),
        (&100.into(), &serde_json::json!({}), &serde_json::json!({}))
    );
    assert!(place.get("ours.parquet").starts_with(b"PAR1") && place.get("ours.parquet").ends_with(b"PAR1"));
    let said = place.convert("ours.parquet back.rays --codec raw");
    assert_eq!((&said["from"], &said["lost"]), (&"parquet".into(), &serde_json::json!({})));
    assert_eq!(place.queries("back.rays"), (header, records, rejects));
    // Chunks, too: the whole file, byte for byte.
    assert_eq!(place.get("back.rays"), place.get("ours.rays"));
}

#[test]
fn a_table_has_a_row_group_per_chunk_and_plain_columns() {
    let place = Place::new();
    recording(&place.path("ours.rays"));
    place.convert("ours.rays ours.parquet");
    let reader = SerializedFileReader::new(bytes::Bytes::from(place.get("ours.parquet"))).unwrap();
    let groups: Vec<i64> = reader.metadata().row_groups().iter().map(|group| group.num_rows()).collect();
    assert_eq!(groups, [40, 60]);
    assert!(
        reader
            .metadata()
            .row_groups()
            .iter()
            .flat_map(|group| group.columns())
            .all(|column| { matches!(column.compression(), Compression::ZSTD(_)) })
    );
    // The crate's own rows, as other readers would show them.
    let rows: Vec<String> = reader.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string()).collect();
    assert_eq!(rows.len(), 100);
    for part in [
        "origin_y: 2.0",
        "direction_z: 2.0",
        "mask: 4294967295",
        "triangle: 7",
        "u: 0.25",
        "kind: 0",
        "thread: 0",
        "rejects: []",
    ] {
        assert!(rows[0].contains(part), "{part}: {}", rows[0]);
    }
    for part in ["path: 98", "kind: 1", "thread: 3", "sequence: 135", "rejects: [9, 5]"] {
        assert!(rows[98].contains(part), "{part}: {}", rows[98]);
    }
}

#[test]
fn lines_are_the_effective_segments() {
    let place = Place::new();
    let miss = Record { t: INF, triangle: NO_TRIANGLE, u: 0.0, v: 0.0, flags: 0, purpose: 1, ..hit() };
    let broken = Record { origin: Vec3::NAN, ..hit() };
    let info = ChunkInfo::default();
    write_rays(
        &place.path("ours.rays"),
        &Header::default(),
        &[(info, &[hit(), miss, blocked(), broken, hit()], &[])],
    );
    let said = place.convert("ours.rays lines.obj");
    assert_eq!(said["left_out"].as_object().unwrap().values().next(), Some(&1.into()));
    assert_eq!((&said["count"], &said["unit"]), (&4.into(), &"queries".into()));
    let (models, _) = tobj::load_obj(place.path("lines.obj"), &tobj::LoadOptions::default()).unwrap();
    let lines: Vec<(&str, &[f32], usize)> =
        models.iter().map(|m| (m.name.as_str(), &m.mesh.positions[..], m.mesh.indices.len())).collect();
    let from = [1.0, 2.0, 3.0];
    let line = |z: f32| [&from[..], &[1.0, 2.0, z]].concat();
    // From z = 3: hits at 3 + 2.5 · 2, blocked up to 3 + 4 · 2, and the miss as long as all that.
    let (hits, miss, blocked) = ([line(8.0), line(8.0)].concat(), line(11.0), line(11.0));
    assert_eq!(
        lines,
        [("camera_miss", &miss[..], 2), ("shadow_blocked", &blocked[..], 2), ("diffuse_hit", &hits[..], 4)]
    );

    let text = String::from_utf8(place.get("lines.obj")).unwrap();
    assert_eq!(
        text.lines().filter(|line| line.starts_with("l ")).collect::<Vec<_>>(),
        ["l 1 2", "l 3 4", "l 5 6", "l 7 8"]
    );
}
