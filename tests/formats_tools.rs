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

type ChangeRecords = dyn Fn(&mut Vec<Record>);

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
    let value = &report["first"]["values"][0];
    assert_eq!(
        (&value["name"], &value["a"], &value["b"]),
        (&"t".into(), &"256.0".into(), &"256.00256".into())
    );
    // Relative to the vector's length, a component of 1e-6 is as good as none.
    assert_eq!(compare(&nudge, &["--tolerance", "1e-4"]).0, 0);
    assert_eq!(compare(&nudge, &["--tolerance", "1e-6"]).0, 1);

    let changes: [(&str, &ChangeRecords); 8] = [
        ("triangle", &|r| r[3].triangle = 4),
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
    }
    // A flag that has no meaning yet is ignored.
    assert_eq!(compare(&|r| r[3].flags |= 0x80, &[]).0, 0);
    // NaN equals itself, exactly and with a tolerance.
    let nan = |r: &mut Vec<Record>| r[3].time = f32::NAN;
    assert_eq!(compare(&nan, &["--tolerance", "0.5"]).0, 1);

    let (code, report) = compare(&|r| r.truncate(90), &[]);
    assert_eq!((code, &report["differences"], &report["count_b"]), (1, &10.into(), &90.into()));
    assert_eq!(report["first"]["element"], "queries 90");
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
