//! `bvh-build` as it is run: files in, files out, exit codes and its one line of error.

mod soup;

use embree_trace::builder::{self, Config, MAX_DEPTH};
use embree_trace::format::bvh::{self, Bvh, Contents, Geometry, NO_INSTANCE, flag};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use embree_trace::tree::validate::validate;
use soup::{degenerate, soup};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bvh-build")).args(arguments).output().expect("bvh-build runs")
}

/// A directory with `in.bvh` over the triangles.
fn input(triangles: &[Triangle]) -> (tempfile::TempDir, PathBuf, PathBuf) {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let tree = builder::build(triangles, &Config::default(), &Progress::hidden()).expect("valid");
    let half = triangles.len() as u32 / 2;
    let geometry = |geometry, first_triangle, triangle_count| Geometry {
        instance: NO_INSTANCE,
        geometry,
        first_triangle,
        triangle_count,
        mask: 5,
        kind: 0,
        flags: 0,
        instance_mask: 0,
    };
    let contents = Contents {
        tree: tree.view(),
        triangles,
        geometries: &[geometry(0, 0, half), geometry(3, half, triangles.len() as u32 - half)],
        order: None,
        meta: None,
        flags: flag::FLATTENED | flag::LIVE,
        producer: "test",
    };
    let mut bytes = Vec::new();
    bvh::write(&mut bytes, &contents).expect("written to memory");
    let (from, to) = (directory.path().join("in.bvh"), directory.path().join("out.bvh"));
    std::fs::write(&from, bytes).expect("written");
    (directory, from, to)
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// What every refusal looks like: exit code 2, one line, no output file.
fn refused(output: &Output, to: &Path, mentions: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains(mentions), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(!to.exists());
}

#[test]
fn rebuilds_and_reports() {
    let triangles = soup(2_000, 1);
    let (_directory, from, to) = input(&triangles);
    let output = run(&[text(&from), text(&to), "--splits", "sweep", "--max-leaf", "4", "--format", "json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let bytes = std::fs::read(&to).expect("written");
    let written = Bvh::parse(&bytes).expect("a valid file");
    written.verify().expect("a valid tree");
    let tree = Tree { nodes: written.tree.nodes.to_vec(), primitives: written.tree.primitives.to_vec() };
    assert_eq!(validate(&tree, &triangles, MAX_DEPTH), Ok(()));
    assert_eq!(report["after"]["nodes"], tree.nodes.len());
    assert_eq!(report["before"]["nodes"], 3_999);
    assert_eq!(report["triangles"], 2_000);
    let cost = |tree: &str| report[tree]["sah_cost"].as_f64().expect("a number");
    assert!(0.0 < cost("after") && cost("after") < cost("before"));

    let before_bytes = std::fs::read(&from).expect("there");
    let before = Bvh::parse(&before_bytes).expect("valid");
    assert_eq!(written.triangles, before.triangles);
    assert_eq!(written.geometries, before.geometries);
    assert_eq!(written.header.fingerprint, before.header.fingerprint);
    assert_eq!(
        written.header.flags,
        flag::FLATTENED,
        "where the triangles come from stays; whose tree it was goes"
    );
    let meta: serde_json::Value = serde_json::from_str(written.meta.expect("META")).expect("JSON");
    assert_eq!((&meta["splits"], &meta["max_leaf"]), (&"sweep".into(), &4.into()));
}

#[test]
fn threads_and_runs_give_the_same_file() {
    let (_directory, from, to) = input(&soup(20_000, 2));
    let bytes = |threads| {
        let output = run(&[text(&from), text(&to), "--threads", threads]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let table = String::from_utf8(output.stdout).expect("text");
        assert!(table.contains("SAH cost") && table.contains("20000 triangles"), "{table}");
        std::fs::read(&to).expect("written")
    };
    let one = bytes("1");
    assert!(["1", "2", "3"].into_iter().all(|threads| bytes(threads) == one));
}

#[test]
fn spatial_splits_are_flagged_and_whole() {
    // Long triangles, so that some are cut.
    let long =
        soup(2_000, 4).into_iter().map(|t| Triangle([t.0[0], t.0[1] + (t.0[1] - t.0[0]) * 9.0, t.0[2]]));
    let (_directory, from, to) = input(&long.collect::<Vec<_>>());
    for options in [&[][..], &["--optimize", "reinsertion", "--max-leaf", "4"], &["--max-duplication", "2"]] {
        let mut arguments = vec![text(&from), text(&to), "--splits", "spatial", "--format", "json"];
        arguments.extend(options);
        let output = run(&arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let bytes = std::fs::read(&to).expect("written");
        let written = Bvh::parse(&bytes).expect("a valid file");
        assert_eq!(written.header.flags, flag::FLATTENED | flag::SPATIAL_SPLITS);
        let duplicates = written.verify().expect("a valid tree").duplicates;
        assert!(duplicates > 0 && report["references"] == 2_000 + duplicates, "{report}");
    }
}

#[test]
fn a_tree_may_replace_its_own_file() {
    let (_directory, from, _) = input(&soup(100, 2));
    assert!(run(&[text(&from), text(&from)]).status.success());
    Bvh::parse(&std::fs::read(&from).expect("there")).expect("valid").verify().expect("valid");
}

#[test]
fn degenerate_scenes_are_built() {
    let nan = Triangle([Vec3::NAN; 3]);
    let huge = Triangle([Vec3::splat(-1e38), Vec3::splat(1e38), Vec3::new(1e38, 0.0, -1e38)]);
    let mut scenes = vec![vec![], vec![nan], vec![huge], vec![huge, nan, huge, huge]];
    scenes.extend(degenerate().into_iter().step_by(20).map(|(_, triangles)| triangles));
    for triangles in &scenes {
        let (_directory, from, to) = input(triangles);
        let output = run(&[text(&from), text(&to), "--format", "json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let finite = triangles.iter().filter(|t| t.is_finite()).count();
        assert_eq!(report["left_out"], triangles.len() - finite);
        let bytes = std::fs::read(&to).expect("written");
        Bvh::parse(&bytes).expect("a valid file").verify().expect("a valid tree");
    }
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let (directory, from, to) = input(&soup(50, 3));
    let missing = directory.path().join("missing.bvh");
    refused(&run(&[text(&missing), text(&to)]), &to, "missing.bvh");
    refused(&run(&[text(directory.path()), text(&to)]), &to, "regular file");
    let good = std::fs::read(&from).expect("there");
    let broken = directory.path().join("broken.bvh");
    for length in (0..good.len()).step_by(97) {
        std::fs::write(&broken, &good[..length]).expect("written");
        let output = run(&[text(&broken), text(&to)]);
        refused(&output, &to, "broken.bvh");
        assert_eq!(String::from_utf8_lossy(&output.stderr).lines().count(), 1);
    }
    let nowhere = directory.path().join("no/such/directory/out.bvh");
    refused(&run(&[text(&from), text(&nowhere)]), &nowhere, "out.bvh");
}

#[test]
fn bad_options_are_refused() {
    let (_directory, from, to) = input(&soup(50, 3));
    for (option, value) in [
        ("--alpha", "-1"),
        ("--alpha", "nan"),
        ("--alpha", "one"),
        ("--splits", "binned:1"),
        ("--splits", "spatial:3"),
        ("--max-duplication", "1"),
        ("--overlap", "0"),
        ("--count", "2n"),
        ("--max-leaf", "0"),
        ("--ci", "-1"),
        ("--cp", "inf"),
        ("--threads", "100000"),
        ("--budget", "-1"),
        ("--budget", "nan"),
        ("--train", "0"),
        ("--train", "1.5"),
        ("--no-such-option", "1"),
        ("--format", "xml"),
    ] {
        refused(&run(&[text(&from), text(&to), option, value]), &to, "");
    }
    for (option, value) in [("--max-duplication", "-1"), ("--max-duplication", "99"), ("--overlap", "inf")] {
        refused(&run(&[text(&from), text(&to), "--splits", "spatial", option, value]), &to, "");
    }
    for (heuristic, option, value) in [
        ("blend", "--weight", "1.5"),
        ("blend", "--weight", "-0.1"),
        ("blend", "--weight", "nan"),
        ("rdh", "--floor", "-1"),
        ("rdh", "--floor", "inf"),
    ] {
        let rays = ["--rays", "casts.rays", "--heuristic", heuristic, option, value];
        refused(&run(&[&[text(&from), text(&to)], &rays[..]].concat()), &to, &option[2..]);
    }
    let help = run(&["--help"]);
    assert!(help.status.success() && String::from_utf8_lossy(&help.stdout).contains("Examples:"));
}
