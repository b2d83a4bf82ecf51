//! `trace-info` and `trace-diff` as programs: what they print, and their exit codes.

use embree_trace::format::bvh::{self, Contents, flag as tree_flag};
use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, NO_TRIANGLE, RaysWriter, Record, Reject, flag, kind,
};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::tree::{Node, Tree};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

struct Run {
    code: i32,
    out: String,
    error: String,
}

fn run(program: &str, arguments: &[&str]) -> Run {
    let output = Command::new(program).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Run { code: output.status.code().unwrap(), out: text(output.stdout), error: text(output.stderr) }
}

fn info(arguments: &[&str]) -> Run {
    run(env!("CARGO_BIN_EXE_trace-info"), arguments)
}

fn diff(arguments: &[&str]) -> Run {
    run(env!("CARGO_BIN_EXE_trace-diff"), arguments)
}

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.out).unwrap_or_else(|error| panic!("{error}: {} {}", run.out, run.error))
}

/// 40 closest hits at distances 1, 2, 4, …, and 60 occlusions, a third of them hits; the last has two rejects.
fn records() -> (Vec<Record>, Vec<Reject>) {
    let base = Record {
        origin: Vec3::ONE,
        tnear: 0.0,
        direction: Vec3::new(0.0, 0.0, 2.0),
        tfar: 100.0,
        time: 0.0,
        mask: u32::MAX,
        t: f32::INFINITY,
        triangle: NO_TRIANGLE,
        u: 0.0,
        v: 0.0,
        path: 17,
        kind: kind::CLOSEST_HIT,
        depth: 0,
        flags: 0,
        purpose: 1,
    };
    let closest =
        (0..40).map(|i| Record { t: (i as f32 / 4.0).floor().exp2(), triangle: i, flags: flag::HIT, ..base });
    let shadow = Record { kind: kind::OCCLUSION, purpose: 2, depth: 1, ..base };
    let blocked = Record { t: f32::NEG_INFINITY, flags: flag::HIT, ..shadow };
    let mut records: Vec<Record> =
        closest.chain((0..60).map(|i| if i % 3 == 0 { blocked } else { shadow })).collect();
    records[99].flags |= flag::HAS_REJECTS;
    (records, vec![Reject { record: 99, triangle: 4 }, Reject { record: 99, triangle: 5 }])
}

fn header() -> Header {
    Header { fingerprint: 0xABCD, embree_version: 31305, deterministic: true, producer: "tools test".into() }
}

/// Writes records in chunks of the given size.
fn write_rays(
    directory: &TempDir,
    name: &str,
    header: &Header,
    records: &[Record],
    chunk: usize,
    codec: Codec,
) -> String {
    let path = directory.path().join(name);
    let mut writer = RaysWriter::new(fs::File::create(&path).unwrap(), header).unwrap();
    for (number, part) in records.chunks(chunk).enumerate() {
        let rejects = part.iter().enumerate().filter(|(_, record)| record.flags & flag::HAS_REJECTS != 0);
        let rejects: Vec<Reject> = rejects
            .flat_map(|(index, _)| [4, 5].map(|triangle| Reject { record: index as u32, triangle }))
            .collect();
        let info = ChunkInfo { sequence: (number * chunk) as u64, ..ChunkInfo::default() };
        writer.write_chunk(&info, part, &rejects, codec).unwrap();
    }
    writer.finish().unwrap();
    path.display().to_string()
}

fn write_bvh(
    directory: &TempDir,
    name: &str,
    change: impl Fn(&mut Tree, &mut Vec<Triangle>, &mut u32),
) -> String {
    let triangle =
        |x: f32| Triangle([Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 0.0, 0.0), Vec3::new(x, 1.0, 0.0)]);
    let mut triangles = vec![triangle(0.0), triangle(2.0), triangle(4.0)];
    let bounds = triangles[0].bounds().union(&triangles[2].bounds());
    let right = triangles[1].bounds().union(&triangles[2].bounds());
    let mut tree = Tree {
        nodes: vec![
            Node::inner(bounds, 1, 2),
            Node::leaf(triangles[0].bounds(), 0, 1),
            Node::leaf(right, 1, 2),
        ],
        primitives: vec![0, 1, 2],
    };
    let mut flags = tree_flag::LIVE;
    change(&mut tree, &mut triangles, &mut flags);
    let path = directory.path().join(name);
    let contents = Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: &[],
        order: None,
        meta: Some("{\"heuristic\":\"sah\"}"),
        flags,
        producer: name,
    };
    bvh::write(fs::File::create(&path).unwrap(), &contents).unwrap();
    path.display().to_string()
}

#[test]
fn info_counts_queries_by_every_property() {
    let directory = tempfile::tempdir().unwrap();
    let (records, _) = records();
    for codec in [Codec::Raw, Codec::Compressed] {
        let path = write_rays(&directory, "casts.rays", &header(), &records, 30, codec);
        let run = info(&[&path, "--verify", "--format", "json"]);
        assert_eq!((run.code, run.error.as_str()), (0, ""));
        let value = json(&run);
        assert_eq!((&value["kind"], &value["path"]), (&"rays".into(), &path.as_str().into()));
        assert_eq!(value["fingerprint"], "000000000000abcd");
        assert_eq!(
            (&value["queries"], &value["hits"], &value["rejects"]),
            (&100.into(), &60.into(), &2.into())
        );
        assert_eq!((&value["with_rejects"], &value["most_rejects"]), (&1.into(), &2.into()));
        assert_eq!(value["by_kind"]["closest_hit"]["hit_rate"], 1.0);
        assert_eq!(value["by_purpose"]["shadow"]["queries"], 60);
        assert_eq!(value["by_purpose"]["shadow"]["hits"], 20);
        assert!(value["by_purpose"].get("diffuse").is_none());
        assert_eq!(value["by_depth"]["1"]["queries"], 60);
        assert_eq!(value["chunks"]["count"], 4);
        assert_eq!(value["chunks"]["decoded_bytes"], 100 * 64 + 2 * 8);
        let histograms = value["histograms"].as_array().unwrap();
        let named = |name: &str| histograms.iter().find(|histogram| histogram["name"] == name).unwrap();
        // t = 1, 2, 4, … 512, four times each: ten bins of a power of two.
        let t = named("t of closest hits")["bins"].as_array().unwrap();
        assert_eq!(t.len(), 10);
        assert!(t.iter().all(|bin| bin["count"] == 4));
        assert_eq!((&t[9]["from"], &t[9]["to"]), (&512.0.into(), &1024.0.into()));
        // |direction| = 2, tfar = 100: the 60 occlusions and the 12 hits behind tfar have a segment of 200.
        let lengths = named("length of effective segments")["bins"].as_array().unwrap();
        assert_eq!(lengths.last().unwrap()["label"], "128 to 256");
        assert_eq!(lengths.last().unwrap()["count"], 60 + 12 + 4);

        let text = info(&[&path]);
        assert_eq!(text.code, 0);
        for part in ["tools test", "3.13.5", "100", "shadow", "33.33%", "512 to 1024", "####"] {
            assert!(text.out.contains(part), "{part}: {}", text.out);
        }
    }
}

#[test]
fn info_shows_a_tree() {
    let directory = tempfile::tempdir().unwrap();
    let path = write_bvh(&directory, "live.bvh", |_, _, _| ());
    let value = json(&info(&[&path, "--verify", "--format", "json"]));
    assert_eq!((&value["kind"], &value["producer"]), (&"bvh".into(), &"live.bvh".into()));
    assert_eq!((&value["nodes"], &value["leaves"], &value["depth"]), (&3.into(), &2.into(), &2.into()));
    assert_eq!(
        (&value["triangles"], &value["max_leaf"], &value["max_children"]),
        (&3.into(), &2.into(), &2.into())
    );
    assert_eq!((&value["mean_children"], &value["mean_leaf"]), (&2.0.into(), &1.5.into()));
    // Areas of flat boxes 5 x 1, 1 x 1 and 3 x 1 by hand: (2 · 5 + 1 · 1 + 2 · 3) / 5.
    assert!((value["sah_cost"].as_f64().unwrap() - 17.0 / 5.0).abs() < 1e-9);
    assert_eq!(value["meta"]["heuristic"], "sah");
    assert_eq!(value["flags"], serde_json::json!(["Embree's live memory"]));
    let tags: Vec<&str> =
        value["sections"].as_array().unwrap().iter().map(|s| s["tag"].as_str().unwrap()).collect();
    assert_eq!(tags, ["NODE", "PRIM", "TRIS", "GEOM", "META"]);
    let text = info(&[&path]);
    for part in ["live.bvh", "NODE", "primitives per leaf", "3.4000"] {
        assert!(text.out.contains(part), "{part}: {}", text.out);
    }
}

#[test]
fn a_cut_off_recording_is_shown_and_fails_only_verify() {
    let directory = tempfile::tempdir().unwrap();
    let path = write_rays(&directory, "casts.rays", &header(), &records().0, 30, Codec::Raw);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..64 + 2 * (64 + 30 * 64) + 1000]).unwrap();
    let run = info(&[&path]);
    assert_eq!(run.code, 0);
    assert!(run.out.contains("recovered 60 queries; 1,000 bytes belong to no whole chunk"), "{}", run.out);
    let run = info(&[&path, "--verify", "--format", "json"]);
    assert_eq!(run.code, 1);
    assert_eq!(json(&run)["recovery"], serde_json::json!({"queries": 60, "lost_bytes": 1000}));
}

/// One line on stderr with the program, the path and a part of the message; exit code 2.
fn assert_refused(run: &Run, path: &str, part: &str) {
    assert_eq!(run.code, 2, "{} {}", run.out, run.error);
    assert!(run.error.starts_with("trace-") && run.error.ends_with('\n'), "{}", run.error);
    assert!(
        run.error.lines().count() == 1 && run.error.contains(path) && run.error.contains(part),
        "{}",
        run.error
    );
}

#[test]
fn bad_files_get_one_line_and_code_2() {
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = directory.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.display().to_string()
    };
    let rays = write_rays(&directory, "casts.rays", &header(), &records().0, 30, Codec::Raw);
    let tree = write_bvh(&directory, "live.bvh", |_, _, _| ());
    let mut flipped = fs::read(&rays).unwrap();
    flipped[200] ^= 1;
    let mut damaged_tree = fs::read(&tree).unwrap();
    damaged_tree.truncate(300);
    let missing = directory.path().join("none").display().to_string();
    let cases = [
        (file("flipped.rays", &flipped), "at byte 128: checksum of the body"),
        (file("short.bvh", &damaged_tree), "at byte "),
        (file("empty.rays", b""), "the file is empty"),
        (file("scene.obj", b"v 0 0 0\n"), "found a file that starts with"),
        (missing, "cannot open"),
        (directory.path().display().to_string(), "not a regular file"),
    ];
    for (path, part) in &cases {
        assert_refused(&info(&[path]), path, part);
        assert_refused(&info(&[path, "--format", "json"]), path, part);
        assert_refused(&diff(&[path, path]), path, part);
    }
    // The good file behind a bad one is still shown.
    let both = info(&[&cases[0].0, &tree]);
    assert_refused(&both, "flipped.rays", "checksum");
    assert!(both.out.contains("live.bvh"));
    assert_refused(&diff(&[&rays, &tree]), "", "A is a .rays file and B a .bvh file");

    // Only `--verify` looks at results and boxes.
    let mut wrong = records().0;
    wrong[5].triangle = NO_TRIANGLE;
    let wrong = write_rays(&directory, "wrong.rays", &header(), &wrong, 100, Codec::Raw);
    let small_box = write_bvh(&directory, "small.bvh", |tree, _, _| tree.nodes[2].lower.x = 3.0);
    for (path, part) in [(wrong, "result of record 5"), (small_box, "box of a leaf")] {
        assert_eq!(info(&[&path]).code, 0);
        assert_refused(&info(&[&path, "--verify"]), &path, part);
    }
    assert_eq!(info(&[]).code, 2);
    assert_eq!(diff(&[&rays]).code, 2);
    assert_eq!(diff(&[&rays, &rays, "--tolerance", "nan"]).code, 2);
}

#[test]
fn traces_are_equal_whatever_their_chunks_codec_and_producer() {
    let directory = tempfile::tempdir().unwrap();
    let (records, _) = records();
    let a = write_rays(&directory, "a.rays", &header(), &records, 30, Codec::Raw);
    let other = Header { producer: "someone else".into(), embree_version: 1, ..header() };
    let b = write_rays(&directory, "b.rays", &other, &records, 7, Codec::Compressed);
    let run = diff(&[&a, &b]);
    assert_eq!(run.code, 0, "{}", run.out);
    assert!(
        run.out.starts_with("equal: 100 queries\n")
            && run.out.contains("note: Embree version: 31305 in A, 1 in B")
    );
}

type ChangeRecords<'a> = dyn Fn(&mut Vec<Record>) + 'a;

#[test]
fn trace_diff_says_the_first_difference_and_how_many() {
    let directory = tempfile::tempdir().unwrap();
    let (records, _) = records();
    let a = write_rays(&directory, "a.rays", &header(), &records, 30, Codec::Raw);
    let compare = |change: &ChangeRecords, more: &[&str]| {
        let mut changed = records.clone();
        change(&mut changed);
        let b = write_rays(&directory, "b.rays", &header(), &changed, 9, Codec::Raw);
        let run = diff(&[&[a.as_str(), b.as_str(), "--format", "json"], more].concat());
        (run.code, json(&run))
    };
    let nudge = |records: &mut Vec<Record>| {
        records[33].t *= 1.0 + 1e-5;
        records[34].t *= 1.0 + 1e-5;
        records[34].direction.x = 1e-6;
    };
    let (code, report) = compare(&nudge, &[]);
    assert_eq!((code, &report["differences"], &report["equal"]), (1, &2.into(), &false.into()));
    assert_eq!(report["by_value"], serde_json::json!({"t": 2, "direction": 1}));
    assert_eq!(report["first"]["element"], "query 33, closest hit, pixel 17, depth 0, purpose camera");
    assert_eq!((&report["changed"], &report["missing"], &report["added"]), (&2.into(), &0.into(), &0.into()));
    let value = &report["first"]["values"][0];
    assert_eq!(
        (&value["name"], &value["a"], &value["b"]),
        (&"t".into(), &"256.0".into(), &"256.00256".into())
    );
    // Relative to the vector's length, a component of 1e-6 is as good as none.
    assert_eq!(compare(&nudge, &["--tolerance", "1e-4"]).0, 0);
    assert_eq!(compare(&nudge, &["--tolerance", "1e-6"]).0, 1);

    let changes: [(&str, &ChangeRecords); 8] = [
        ("hit", &|r| {
            r[3] = Record { t: f32::INFINITY, triangle: NO_TRIANGLE, flags: 0, ..r[3] };
        }),
        ("mask", &|r| r[3].mask = 4),
        ("path", &|r| r[3].path = 4),
        ("depth", &|r| r[3].depth = 4),
        ("flags", &|r| r[3].flags |= flag::COHERENT),
        ("purpose", &|r| r[3].purpose = 4),
        ("u", &|r| r[3].u = 0.5),
        ("rejects", &|r| {
            r[99].flags &= !flag::HAS_REJECTS;
            r[98].flags |= flag::HAS_REJECTS;
        }),
    ];
    for (name, change) in changes {
        let (code, report) = compare(change, &["--tolerance", "0.01"]);
        assert_eq!((code, report["by_value"].get(name).is_some()), (1, true), "{name}: {report}");
        let rejects = if name == "rejects" { 2 } else { 1 };
        assert_eq!(report["differences"], rejects, "{name}: {report}");
    }
    // A flag that has no meaning yet is ignored.
    assert_eq!(compare(&|r| r[3].flags |= 0x80, &[]).0, 0);
    // NaN equals itself, exactly and with a tolerance.
    let nan = |r: &mut Vec<Record>| r[3].time = f32::NAN;
    assert_eq!(compare(&nan, &["--tolerance", "0.5"]).0, 1);

    let (code, report) = compare(&|r| r.truncate(90), &[]);
    assert_eq!((code, &report["differences"], &report["count_b"]), (1, &10.into(), &90.into()));
    assert_eq!((&report["missing"], &report["changed"]), (&10.into(), &0.into()));
    assert_eq!(
        report["first"]["element"],
        "query 90, occlusion, pixel 17, depth 1, purpose shadow, only in A"
    );
}

#[test]
fn another_scene_is_a_difference_unless_unknown() {
    let directory = tempfile::tempdir().unwrap();
    let (records, _) = records();
    let a = write_rays(&directory, "a.rays", &header(), &records, 100, Codec::Raw);
    let code = |fingerprint: u64, more: &[&str]| {
        let header = Header { fingerprint, ..header() };
        let b = write_rays(&directory, "b.rays", &header, &records, 100, Codec::Raw);
        diff(&[&[a.as_str(), b.as_str()], more].concat()).code
    };
    assert_eq!(
        [code(0xABCD, &[]), code(1, &[]), code(0, &[]), code(1, &["--tolerance", "1e-3"])],
        [0, 1, 0, 0]
    );
}

/// `count` pixels of an image 100 wide, each with a camera ray, a shadow ray and a bounce with its shadow ray. Every ray is another
/// one. `known`: whether the recording knows pixels and depths, as ours do and those of other programs do not.
fn pixels(count: u32, known: bool) -> Vec<Record> {
    let (closest, shadow) = (records().0[0], records().0[41]);
    let pixel = |path: u32| {
        (0..4u8).map(move |step| {
            let at = (path * 4 + u32::from(step)) as f32;
            let base = if step % 2 == 0 { closest } else { shadow };
            let triangle = if step % 2 == 0 { path } else { NO_TRIANGLE };
            let direction = Vec3::new((0.1 * at).sin(), (0.1 * at).cos(), 1.0);
            let record = Record { origin: Vec3::new(at, 1.0, 0.5), direction, triangle, path, ..base };
            let depth = step.div_ceil(2);
            let purpose = [1, 2, 4, 2][step as usize];
            let unknown = Record { path: u32::MAX, depth: u8::MAX, purpose: 0, ..record };
            if known { Record { depth, purpose, ..record } } else { unknown }
        })
    };
    (0..count).flat_map(pixel).collect()
}

/// By hand: what is missing or added is counted as that, and nothing behind it, wherever it is and whatever else is near.
#[test]
fn what_is_missing_or_added_does_not_shift_the_rest() {
    let directory = tempfile::tempdir().unwrap();
    // How many pixels; what is changed, missing and added.
    type Case<'a> = (&'static str, u32, &'a ChangeRecords<'a>, [u64; 3]);
    let add_two = |r: &mut Vec<Record>| {
        for (at, x) in [(404, 7e6), (4002, 8e6)] {
            r.insert(at, Record { origin: Vec3::splat(x), ..r[at] });
        }
    };
    let drop_and_change = |r: &mut Vec<Record>| {
        r[4005].tfar = 3.0;
        r.drain(4001..4002);
    };
    let cases: [Case; 9] = [
        ("drop one", 2000, &|r| drop(r.drain(4001..4002)), [0, 1, 0]),
        ("drop the first", 2000, &|r| drop(r.drain(..1)), [0, 1, 0]),
        ("drop the last", 2000, &|r| r.truncate(7999), [0, 1, 0]),
        ("add two", 2000, &add_two, [0, 0, 2]),
        ("drop and change", 2000, &drop_and_change, [1, 1, 0]),
        ("drop a tile", 10_000, &|r| drop(r.drain(8000..28_000)), [0, 20_000, 0]),
        // More than a window holds.
        ("drop most", 80_000, &|r| drop(r.drain(100..290_100)), [0, 290_000, 0]),
        ("answers", 10_000, &|r| r.iter_mut().step_by(1000).for_each(|r| r.t *= 1.5), [40, 0, 0]),
        ("masks", 10_000, &|r| r.iter_mut().for_each(|r| r.mask = 1), [40_000, 0, 0]),
    ];
    for known in [true, false] {
        for (name, count, change, expected) in &cases {
            let mut records = pixels(*count, known);
            let a = write_rays(&directory, "a.rays", &header(), &records, 65_536, Codec::Raw);
            change(&mut records);
            let b = write_rays(&directory, "b.rays", &header(), &records, 50_000, Codec::Raw);
            for more in [&["--format", "json"][..], &["--format", "json", "--any-order"]] {
                let report = json(&diff(&[&[a.as_str(), b.as_str()], more].concat()));
                let found = ["changed", "missing", "added"].map(|what| report[what].as_u64().unwrap());
                assert_eq!(found, *expected, "{name} {known} {more:?}: {report}");
                assert_eq!(report["differences"], expected.iter().sum::<u64>());
            }
            // The other way round, missing and added change places.
            let report = json(&diff(&[&b, &a, "--format", "json"]));
            let found = ["changed", "added", "missing"].map(|what| report[what].as_u64().unwrap());
            assert_eq!(found, *expected, "{name} {known}, turned round: {report}");
        }
    }
}

/// Half of the queries of most pixels differ, some are gone: pixel by pixel, by depth and purpose, they still find their partners.
#[test]
fn queries_are_paired_within_their_pixel() {
    let directory = tempfile::tempdir().unwrap();
    let records = pixels(6000, true);
    let a = write_rays(&directory, "a.rays", &header(), &records, 10_000, Codec::Raw);
    let mut changed = records.clone();
    for (index, record) in changed.iter_mut().enumerate().filter(|(index, _)| index / 4 > 100) {
        // No ray of the other file is near this one.
        record.origin.z += 1000.0 + index as f32;
        record.direction = -record.direction;
    }
    // The bounce of every tenth pixel.
    let mut place = 0;
    changed.retain(|_| {
        place += 1;
        !(place > 2000 && (place - 1) % 40 == 2)
    });
    let missing = (records.len() - changed.len()) as u64;
    let b = write_rays(&directory, "b.rays", &header(), &changed, 10_000, Codec::Raw);
    for more in [&["--format", "json"][..], &["--format", "json", "--any-order"]] {
        let report = json(&diff(&[&[a.as_str(), b.as_str(), "--image", "100x60"], more].concat()));
        let found = ["changed", "missing", "added"].map(|what| report[what].as_u64().unwrap());
        assert_eq!(found, [(6000 - 101) * 4 - missing, missing, 0], "{more:?}: {report}");
        assert_eq!(report["pixels"]["total"], 6000);
        assert_eq!(report["pixels"]["agree"], 101);
        let first = &report["pixels"]["first"][0];
        assert_eq!((&first["path"], &first["pixel"]), (&101.into(), &serde_json::json!([1, 1])), "{first}");
        assert_eq!((&first["depth"], &first["differences"]), (&0.into(), &4.into()));
    }
    let text = diff(&[&a, &b, "--image", "100x60"]).out;
    assert!(
        text.contains("pixels: 101 of 6,000 agree; the first that differs is 1,1 at depth 0\n"),
        "{text}"
    );
    assert!(text.contains("pixel 1,1, depth 0"), "{text}");
    // Without an image's size, a pixel is its number.
    assert!(diff(&[&a, &b]).out.contains("the first that differs is path 101 at depth 0\n"));
}

/// Several threads: the same queries in another order are equal as sets, and only so; a set in which one query is twice is another one.
#[test]
fn any_order_compares_sets() {
    let directory = tempfile::tempdir().unwrap();
    for known in [true, false] {
        let records = pixels(3000, known);
        let a = write_rays(&directory, "a.rays", &header(), &records, 4096, Codec::Raw);
        let mut turned: Vec<Record> = records.iter().rev().copied().collect();
        turned.rotate_left(777);
        let b = write_rays(&directory, "b.rays", &header(), &turned, 1000, Codec::Compressed);
        assert_eq!(diff(&[&a, &b]).code, 1);
        let run = diff(&[&a, &b, "--any-order"]);
        assert_eq!((run.code, run.out.as_str()), (0, "equal: 12,000 queries\n"));

        // One less of one and one more of another; and the last bits of some answers.
        turned[5] = turned[6];
        for record in turned.iter_mut().filter(|record| record.is_hit()).step_by(50) {
            record.t *= 1.0 + 1e-6;
        }
        let b = write_rays(&directory, "b.rays", &header(), &turned, 1000, Codec::Raw);
        let json_of = |more: &[&str]| {
            json(&diff(&[&[a.as_str(), b.as_str(), "--any-order", "--format", "json"], more].concat()))
        };
        let report = json_of(&["--tolerance", "1e-4"]);
        assert_eq!(report["differences"].as_u64().unwrap(), 2, "{known}: {report}");
        assert!(json_of(&[])["differences"].as_u64().unwrap() > 100);
    }
}

/// Two triangles at one t are a tie under a tolerance; a tree tells it from a hit of another triangle that is only near.
#[test]
fn a_tree_tells_a_tie_from_another_hit() {
    let directory = tempfile::tempdir().unwrap();
    // Triangle 1 is triangle 0 once more; triangle 2 stands behind it by 1e-4, nearer than a tolerance of 1e-3 sees.
    let tree = write_bvh(&directory, "scene.bvh", |tree, triangles, _| {
        let floor =
            |z: f32| Triangle([Vec3::new(0.0, 0.0, z), Vec3::new(4.0, 0.0, z), Vec3::new(0.0, 4.0, z)]);
        *triangles = vec![floor(0.0), floor(0.0), floor(-1e-4)];
        let bounds = triangles[0].bounds().union(&triangles[2].bounds());
        *tree = Tree { nodes: vec![Node::leaf(bounds, 0, 3)], primitives: vec![0, 1, 2] };
    });
    let fingerprint = bvh::Bvh::parse(&fs::read(&tree).unwrap()).unwrap().header.fingerprint;
    let header = Header { fingerprint, ..header() };
    let down = Record {
        direction: Vec3::new(0.0, 0.0, -1.0),
        t: 1.0,
        triangle: 0,
        u: 0.25,
        v: 0.25,
        ..records().0[0]
    };
    let a = write_rays(&directory, "a.rays", &header, &[down; 3], 3, Codec::Raw);
    let named = |triangle: u32, t: f32| {
        let other = Record { triangle, t, u: 0.1, ..down };
        write_rays(&directory, "b.rays", &header, &[down, other, down], 3, Codec::Raw)
    };
    let with = ["--tolerance", "1e-3", "--format", "json"];
    let compare = |b: &str, more: &[&str]| {
        let run = diff(&[&[a.as_str(), b, "--tolerance", "1e-3", "--format", "json"], more].concat());
        let report = json(&run);
        (run.code, report["ties"].as_u64().unwrap(), report["differences"].as_u64().unwrap())
    };
    let tie = named(1, 1.0);
    assert_eq!(compare(&tie, &[]), (0, 1, 0));
    assert_eq!(compare(&tie, &["--tree", &tree]), (0, 1, 0));
    assert_eq!(compare(&tie, &["--tree", &tree, "--any-order"]), (0, 1, 0));
    let text = diff(&[&a, &tie, "--tolerance", "1e-3"]).out;
    assert_eq!(text, "equal: 3 queries\nties: 1 queries hit two triangles at one t\n");
    // Exactly, another triangle is a difference.
    assert_eq!(diff(&[&a, &tie]).code, 1);
    let near = named(2, 1.0001);
    assert_eq!(compare(&near, &[]), (0, 1, 0));
    assert_eq!(compare(&near, &["--tree", &tree]), (1, 0, 1));
    assert_eq!(compare(&near, &["--tree", &tree, "--tree", &tree]), (1, 0, 1));

    // What is no tree of these recordings is refused.
    let other = write_bvh(&directory, "other.bvh", |_, _, _| ());
    assert_refused(&diff(&[&[a.as_str(), &tie, "--tree", &other], &with[..]].concat()), "", "another scene");
    let few = Header { fingerprint: 0, ..header.clone() };
    let far = Record { triangle: 9, ..down };
    let a = write_rays(&directory, "a.rays", &few, &[far], 3, Codec::Raw);
    let b = write_rays(&directory, "b.rays", &few, &[Record { triangle: 8, ..down }], 3, Codec::Raw);
    assert_refused(&diff(&[&a, &b, "--tolerance", "1e-3", "--tree", &tree]), "", "hit triangle 9");
    assert_refused(&diff(&[&tree, &tree, "--any-order"]), "", "belongs to recordings");
    assert_eq!(diff(&[&a, &b, "--exact-queries"]).code, 2);

    let none = write_rays(&directory, "none.rays", &header, &[], 3, Codec::Raw);
    assert_refused(&diff(&[&a, &none]), "", "B has no queries");
    assert_refused(&diff(&[&none, &a, "--any-order"]), "", "A has no queries");
    let mut flipped =
        fs::read(write_rays(&directory, "c.rays", &header, &pixels(100, true), 100, Codec::Raw)).unwrap();
    let whole = write_rays(&directory, "whole.rays", &header, &pixels(100, true), 100, Codec::Raw);
    let last = flipped.len() - 1000;
    flipped[last] ^= 1;
    let damaged = directory.path().join("damaged.rays").display().to_string();
    fs::write(&damaged, flipped).unwrap();
    for more in [&[][..], &["--any-order"]] {
        assert_refused(&diff(&[&[whole.as_str(), &damaged], more].concat()), &damaged, "checksum");
        assert_refused(&diff(&[&[damaged.as_str(), &whole], more].concat()), &damaged, "checksum");
    }
}

/// `tools/golden` sees every change that it is there for, and names it. The goldens are those of this machine, so that only what
/// is changed can differ.
#[cfg(feature = "embree")]
#[test]
fn golden_traces_see_every_change() {
    let directory = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let here = directory.path();
    fs::create_dir(here.join("golden")).unwrap();
    for name in ["cornell-box.obj", "cornell-box.mtl", "slivers.obj", "slivers.mtl"] {
        fs::copy(fixtures.join(name), here.join(name)).unwrap();
    }
    let options = here.join("golden/box.options");
    fs::write(&options, "cornell-box.obj --size 16x16 --integrator path --max-depth 3\n").unwrap();
    let golden = |mode: &str| {
        let bin = Path::new(env!("CARGO_BIN_EXE_trace-diff")).parent().unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/golden");
        let mut command = Command::new(script);
        command.arg(mode).env("EMBREE_TRACE_BIN", bin).env("FIXTURES", here);
        let output = command.output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Run { code: output.status.code().unwrap(), out: text(output.stdout), error: text(output.stderr) }
    };
    let run = golden("--update");
    assert_eq!(run.code, 0, "{}", run.error);
    let run = golden("--check");
    assert_eq!(run.code, 0, "{} {}", run.out, run.error);

    let seen = |what: &[&str]| {
        let run = golden("--check");
        assert_eq!(run.code, 1, "{what:?}: {} {}", run.out, run.error);
        assert_eq!(run.error, "tools/golden: 1 of 1 differ: box\n");
        for part in what {
            assert!(run.out.contains(part), "{part}: {}", run.out);
        }
    };
    // A vertex that moves by 1e-3.
    let scene = here.join("cornell-box.obj");
    let text = fs::read_to_string(&scene).unwrap();
    let mut vertices = 0;
    let moved = text.lines().map(|line| match line.strip_prefix("v ") {
        Some(numbers)
            if {
                vertices += 1;
                vertices == 1
            } =>
        {
            let mut numbers: Vec<f64> = numbers.split_whitespace().map(|n| n.parse().unwrap()).collect();
            numbers[0] += 1e-3;
            format!("v {} {} {}\n", numbers[0], numbers[1], numbers[2])
        }
        _ => format!("{line}\n"),
    });
    fs::write(&scene, moved.collect::<String>()).unwrap();
    seen(&["first: ", "triangle ", "fingerprint"]);
    fs::write(&scene, &text).unwrap();

    // Another quality of the tree, where triangles are long enough to be split.
    let line = fs::read_to_string(&options).unwrap();
    let slivers = line.replace("cornell-box.obj", "slivers.obj");
    fs::write(&options, &slivers).unwrap();
    assert_eq!(golden("--update").code, 0);
    fs::write(&options, format!("{} --quality high\n", slivers.trim())).unwrap();
    seen(&["different: ", "nodes", "structure"]);
    fs::write(&options, &line).unwrap();
    assert_eq!(golden("--update").code, 0);

    // A query less; shadow rays that end elsewhere, as with another constant of the integrator; and another mask.
    let path = here.join("golden/box.rays");
    let whole = fs::read(&path).unwrap();
    let rays = embree_trace::format::rays::Rays::parse(&whole).unwrap();
    let recorded: Vec<Record> =
        (0..rays.chunks().len()).flat_map(|index| rays.chunk(index).unwrap().records.into_owned()).collect();
    let shadow = recorded.iter().position(|record| record.is_occlusion()).unwrap();
    let changes: [(&[&str], &ChangeRecords); 3] = [
        (&["queries: 0 changed, 0 only in A, 1 only in B", "pixels: 255 of 256 agree"], &|r| {
            r.remove(shadow);
        }),
        (&["only in A, 0 only in B", "tfar: ", "purpose shadow"], &|r| {
            let shadows = r.iter_mut().filter(|record| record.is_occlusion());
            shadows.for_each(|record| record.tfar *= (1.0 - 1.0 / 8192.0) / (1.0 - 1.0 / 4096.0));
        }),
        (&["queries: 1 changed", "mask: 0xfffffffe in A, 0xffffffff in B"], &|r| r[shadow].mask = !1),
    ];
    for (what, change) in changes {
        let mut changed = recorded.clone();
        change(&mut changed);
        write_rays(&directory, "golden/box.rays", &rays.header, &changed, 1000, Codec::Raw);
        seen(what);
    }
    fs::write(&path, &whole).unwrap();
    assert_eq!(golden("--check").code, 0);

    // What cannot be checked is no good result.
    fs::write(&path, &whole[..100]).unwrap();
    assert_eq!(golden("--check").code, 2);
}

type ChangeTree = dyn Fn(&mut Tree, &mut Vec<Triangle>, &mut u32);

#[test]
fn trees_are_compared_by_section() {
    let directory = tempfile::tempdir().unwrap();
    let a = write_bvh(&directory, "a.bvh", |_, _, _| ());
    let cases: [(&str, &str, &ChangeTree); 5] = [
        ("box", "nodes 2", &|tree, _, _| tree.nodes[2].upper.x += 0.5),
        ("structure", "nodes 1", &|tree, _, _| {
            tree.nodes[1].first = 2;
            tree.nodes[2].first = 0;
        }),
        ("primitive", "primitives 0", &|tree, _, _| tree.primitives.swap(0, 1)),
        ("triangle", "triangles 1", &|_, triangles, _| triangles[1].0[2].y = 0.5),
        ("triangles", "triangles 3", &|_, triangles, _| triangles.push(Triangle([Vec3::NAN; 3]))),
    ];
    for (name, element, change) in cases {
        let b = write_bvh(&directory, "b.bvh", change);
        let run = diff(&[&a, &b, "--format", "json"]);
        let report = json(&run);
        assert_eq!((run.code, &report["first"]["element"]), (1, &element.into()), "{report}");
        assert!(report["by_value"].get(name).is_some(), "{report}");
    }
    // Another producer and other flags are no difference.
    let b = write_bvh(&directory, "b.bvh", |_, _, flags| *flags = 0);
    let run = diff(&[&a, &b]);
    assert_eq!(run.code, 0);
    assert!(
        run.out.contains("equal: 3 nodes") && run.out.contains("note: flags: 0x4 in A, 0x0 in B"),
        "{}",
        run.out
    );
    let close = write_bvh(&directory, "c.bvh", |tree, _, _| tree.nodes[0].upper.x += 1e-4);
    assert_eq!([diff(&[&a, &close]).code, diff(&[&a, &close, "--tolerance", "1e-3"]).code], [1, 0]);
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let directory = tempfile::tempdir().unwrap();
    let path = write_rays(&directory, "casts.rays", &header(), &records().0, 1, Codec::Raw);
    for (program, arguments) in [
        (env!("CARGO_BIN_EXE_trace-info"), vec![&path]),
        (env!("CARGO_BIN_EXE_trace-diff"), vec![&path, &path]),
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = Command::new(program).args(arguments).stdout(writer).output().unwrap();
        assert_eq!((output.status.code(), output.stderr.len()), (Some(0), 0));
    }
}

#[test]
fn help_has_examples_and_exit_codes() {
    for run in [info(&["--help"]), diff(&["--help"])] {
        assert_eq!(run.code, 0);
        assert!(run.out.contains("Examples:") && run.out.contains("Exit codes:"));
    }
}

#[test]
fn unwritable_output_is_not_silent() {
    let directory = tempfile::tempdir().unwrap();
    let path: PathBuf = write_rays(&directory, "casts.rays", &header(), &records().0, 30, Codec::Raw).into();
    let full = fs::File::options().write(true).open(Path::new("/dev/full")).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_trace-info")).arg(&path).stdout(full).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8(output.stderr).unwrap().contains("No space left"));
}
