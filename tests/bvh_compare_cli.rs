//! `bvh-compare` as a user meets it: files in, text and exit codes out.

mod compare_support;

use compare_support::files::*;
use compare_support::*;
use embree_trace::format::bvh::fingerprint;
use embree_trace::geometry::Triangle;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A directory with trees of width 2, 4 and 8 over one scene, and a recording of 3000 queries.
struct Files {
    directory: tempfile::TempDir,
    triangles: Vec<Triangle>,
}

impl Files {
    fn new() -> Files {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let triangles = soup(400, 0.25, &mut Random(11));
        let files = Files { directory, triangles };
        let meta = format!("{{\"image\":[{},{}]}}", IMAGE[0], IMAGE[1]);
        files.write("two.bvh", &bvh_bytes(&files.triangles, 2, 1, 1, None));
        files.write("four.bvh", &bvh_bytes(&files.triangles, 4, 2, 2, Some(&meta)));
        files.write("eight.bvh", &bvh_bytes(&files.triangles, 8, 4, 3, None));
        let (records, rejects) = records(&files.triangles, 3000, 5);
        assert!(rejects.len() > 50, "rejects are part of the test");
        let rays = rays_bytes(fingerprint(&files.triangles), &records, &rejects, 700);
        files.write("casts.rays", &rays);
        files
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("writing a test file");
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).expect("reading a test file")
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_bvh-compare"))
            .args(arguments)
            .current_dir(self.directory.path())
            .output()
            .expect("running bvh-compare")
    }

    /// Runs with `--format json`, expects success.
    fn json(&self, arguments: &[&str]) -> Value {
        let output = self.run(&[arguments, &["--format", "json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("JSON on stdout")
    }

    /// Expects bad input: exit code 2 and one line that says `expected`.
    fn refused(&self, arguments: &[&str], expected: &[&str]) {
        let output = self.run(arguments);
        let line = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
        for part in expected {
            assert!(line.contains(part), "{arguments:?}: {line:?} lacks {part:?}");
        }
        assert!(output.stdout.is_empty());
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no count"))
}

/// Without what depends on the clock.
fn timeless(mut value: Value) -> Value {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(map) => {
                map.remove("seconds");
                map.values_mut().for_each(strip);
            }
            Value::Array(list) => list.iter_mut().for_each(strip),
            _ => {}
        }
    }
    strip(&mut value);
    value
}

#[test]
fn trees_of_every_width_agree_with_brute_force_and_json_has_its_keys() {
    let files = Files::new();
    let report = files.json(&["two.bvh", "four.bvh", "eight.bvh", "casts.rays", "--ci", "1.5", "--cp", "2"]);
    let trees = report["trees"].as_array().expect("trees");
    assert_eq!(trees.len(), 3);
    for (tree, width) in trees.iter().zip([2, 4, 8]) {
        assert_eq!(number(&tree["max_children"]), width);
        for key in ["nodes", "leaves", "depth", "t_r"] {
            assert!(number(&tree[key]) > 1, "{key}");
        }
        assert!(tree["sah_cost"].as_f64() > Some(1.0));
        for order in ["odf", "ray_order"] {
            let run = &tree["traversals"][order];
            assert_eq!(number(&run["queries"]), 3000);
            assert_eq!(number(&run["mismatches"]), 0);
            assert!(number(&run["borderline"]) <= 3);
            let gamma = 1.5 * number(&run["box_tests"]) as f64 + 2.0 * number(&run["primitive_tests"]) as f64;
            assert_eq!(run["gamma"].as_f64(), Some(gamma));
            for groups in ["by_kind", "by_depth", "by_purpose"] {
                for key in
                    ["queries", "box_tests", "node_visits", "primitive_tests", "mismatches", "borderline"]
                {
                    let parts = run[groups].as_object().expect("groups");
                    assert_eq!(
                        parts.values().map(|part| number(&part[key])).sum::<u64>(),
                        number(&run[key]),
                        "{groups}"
                    );
                }
                for part in run[groups].as_object().expect("groups").values() {
                    assert!(part["seconds"].as_f64() > Some(0.0));
                    let boxes = &part["per_query"]["box_tests"];
                    assert!(number(&boxes["median"]) <= number(&boxes["p99"]));
                }
            }
            assert!(run["by_purpose"]["shadow"].is_object() && run["by_purpose"]["camera"].is_object());
        }
        // RayOrder tests what T_R says, for queries that run to their end.
        let kinds = &tree["traversals"]["ray_order"]["by_kind"];
        let closest = &kinds["closest_hit"];
        let t_r = number(&tree["t_r_by_kind"]["closest_hit"]);
        assert_eq!(number(&closest["node_visits"]), t_r);
        if width == 2 {
            assert_eq!(number(&closest["box_tests"]), number(&closest["queries"]) + 2 * t_r);
        }
        assert!(number(&kinds["occlusion"]["node_visits"]) <= number(&tree["t_r_by_kind"]["occlusion"]));
        assert_eq!(number(&tree["t_r"]), t_r + number(&tree["t_r_by_kind"]["occlusion"]));
    }
    assert_eq!(trees[0]["gamma_ratio"].as_f64(), Some(1.0));
}

#[test]
fn results_do_not_depend_on_threads() {
    let files = Files::new();
    let with = |threads| timeless(files.json(&["two.bvh", "eight.bvh", "casts.rays", "--threads", threads]));
    assert_eq!(with("1"), with("3"));
}

#[test]
fn tables_fit_a_terminal_and_csv_has_a_row_per_group() {
    let files = Files::new();
    let output = files.run(&["two.bvh", "four.bvh", "casts.rays"]);
    assert_eq!(output.status.code(), Some(0));
    let table = text(&output.stdout);
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
    for part in ["Cost per query", "RayOrder", "two", "four", "shadow", "closest hit", "depth 0", "T_R"] {
        assert!(table.contains(part), "{part}");
    }
    let output = files.run(&["two.bvh", "casts.rays", "--format", "csv", "--traversal", "odf"]);
    let csv = text(&output.stdout);
    let columns = csv.lines().next().map_or(0, |header| header.split(',').count());
    assert!(csv.lines().all(|line| line.split(',').count() == columns));
    // All, 2 kinds, 3 depths, 3 purposes.
    assert_eq!(csv.lines().count(), 1 + 9);
}

#[test]
fn what_a_tree_was_trained_with_is_not_held_out() {
    let files = Files::new();
    let build = |options: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_bvh-build"))
            .args(["two.bvh", "ours.bvh", "--rays", "casts.rays", "--format", "json"])
            .args(options)
            .current_dir(files.directory.path())
            .output()
            .expect("running bvh-build");
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_str::<serde_json::Value>(&text(&output.stdout)).expect("JSON")
    };
    let trained = build(&["--train", "0.3", "--seed", "5", "--optimize", "rotations"]);
    let report = files.json(&["ours.bvh", "casts.rays", "--held-out", "0.3", "--seed", "5"]);
    let odf = &report["trees"][0]["traversals"]["odf"];
    let (training, held_out) = (number(&trained["training_queries"]), number(&odf["queries"]));
    assert!(training > 0 && held_out > training);
    assert_eq!(training + held_out, 3000);
    assert_eq!(number(&odf["mismatches"]), 0);
    let all = build(&["--heuristic", "rdh", "--filter", "kind=closest"]);
    let closest = files.json(&["ours.bvh", "casts.rays", "--filter", "kind=closest"]);
    assert_eq!(
        number(&all["training_queries"]),
        number(&closest["trees"][0]["traversals"]["odf"]["queries"])
    );
    files.refused(&["two.bvh", "casts.rays", "--held-out", "1.5"], &["--held-out"]);
}

#[test]
fn filters_and_samples_choose_queries() {
    let files = Files::new();
    let total = |arguments: &[&str]| {
        let report = files.json(&[&["two.bvh", "casts.rays", "--traversal", "odf"], arguments].concat());
        report["trees"][0]["traversals"]["odf"].clone()
    };
    let whole = total(&[]);
    let shadow = total(&["--filter", "purpose=shadow"]);
    assert_eq!(number(&shadow["queries"]), number(&whole["by_purpose"]["shadow"]["queries"]));
    assert_eq!(number(&shadow["box_tests"]), number(&whole["by_purpose"]["shadow"]["box_tests"]));
    let deep = total(&["--filter", "depth=1..,kind=closest"]);
    assert!(number(&deep["queries"]) > 0 && deep["by_depth"].get("0").is_none());
    assert_eq!(number(&total(&["--sample", "100"])["queries"]), 100);
    assert_eq!(number(&total(&["--sample", "1000000"])["queries"]), 3000);
    files.refused(&["two.bvh", "casts.rays", "--filter", "depth=9"], &["no query is left"]);
    files.refused(&["two.bvh", "casts.rays", "--filter", "purpose=sun"], &["purpose=sun", "expected"]);
    files.refused(&["two.bvh", "casts.rays", "--sample", "0"], &["--sample"]);
}

#[test]
fn a_wrong_answer_fails_and_is_told() {
    let files = Files::new();
    let (mut records, rejects) = records(&files.triangles, 3000, 5);
    let wrong = records
        .iter()
        .position(|record| !record.is_occlusion() && record.is_hit() && record.depth == 1)
        .expect("a closest hit at depth 1");
    records[wrong].t *= 1.01;
    files.write("wrong.rays", &rays_bytes(fingerprint(&files.triangles), &records, &rejects, 700));
    let output = files.run(&["two.bvh", "four.bvh", "wrong.rays", "--format", "json"]);
    assert_eq!(output.status.code(), Some(1));
    let lines = text(&output.stderr);
    let (x, y) = (wrong as u32 % 192 % IMAGE[0], wrong as u32 % 192 / IMAGE[0]);
    for part in
        [format!("query {wrong} "), format!("pixel {x},{y}"), "depth 1".into(), records[wrong].t.to_string()]
    {
        assert!(lines.lines().all(|line| line.contains(&part)), "{lines} lacks {part}");
    }
    assert_eq!(lines.lines().count(), 4, "two trees, two orders");
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report in spite of it");
    assert_eq!(number(&report["trees"][1]["traversals"]["odf"]["mismatches"]), 1);
}

#[test]
fn costs_above_the_limit_fail() {
    let files = Files::new();
    // A tree with one leaf tests every triangle.
    let one = random_tree(&files.triangles[..], 2, usize::MAX, &mut Random(12));
    assert!(one.nodes.len() < 5, "the seed should give a tree of few leaves");
    files.write("bad.bvh", &tree_bytes(&files.triangles, &one, None));
    let run =
        |limit| files.run(&["two.bvh", "bad.bvh", "casts.rays", "--traversal", "odf", "--fail-above", limit]);
    let output = run("1.5");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("bad.bvh: cost under ODF is "), "{}", text(&output.stderr));
    assert_eq!(run("1000").status.code(), Some(0));
}

#[test]
fn heat_maps_are_written() {
    let files = Files::new();
    let output = files.run(&["two.bvh", "four.bvh", "casts.rays", "--heatmap", "pictures"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    for name in ["1-two-odf", "1-two-ray_order", "2-four-odf", "2-four-ray_order"] {
        let path = files.path("pictures").join(format!("{name}.png"));
        let picture = image::open(&path).expect("a picture").to_rgb8();
        // 16 x 12 pixels in squares of 30, and room for title and bar.
        assert!(picture.width() > 480 && picture.height() > 360);
        let colors: std::collections::HashSet<[u8; 3]> = picture.pixels().map(|pixel| pixel.0).collect();
        assert!(colors.len() > 50, "{name} shows {} colours", colors.len());
    }
    files.refused(&["two.bvh", "casts.rays", "--heatmap", "pictures"], &["--size"]);
    let sized = files.run(&["two.bvh", "casts.rays", "--heatmap", "sized", "--size", "8x24"]);
    assert_eq!(sized.status.code(), Some(0));
    files.refused(&["two.bvh", "casts.rays", "--size", "0x5"], &["--size"]);
    files.refused(&["four.bvh", "casts.rays", "--heatmap", "two.bvh"], &["two.bvh"]);
}

#[test]
fn scenes_must_be_the_same() {
    let files = Files::new();
    let other = soup(50, 0.3, &mut Random(99));
    files.write("other.bvh", &bvh_bytes(&other, 2, 1, 1, None));
    let (own, foreign) = (fingerprint(&files.triangles), fingerprint(&other));
    let both = [format!("{own:016x}"), format!("{foreign:016x}")];
    let both = [both[0].as_str(), both[1].as_str()];
    files.refused(&["two.bvh", "other.bvh", "casts.rays"], &both);
    files.refused(&["other.bvh", "casts.rays"], &both);
    // A recording that does not know its scene is taken with a warning, but the trees must still be of one.
    let (records, rejects) = records(&files.triangles, 500, 5);
    files.write("unknown.rays", &rays_bytes(0, &records, &rejects, 700));
    let output = files.run(&["two.bvh", "unknown.rays"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stderr).contains("warning"));
    files.refused(&["two.bvh", "other.bvh", "unknown.rays"], &both);
}

#[test]
fn bad_files_get_one_line() {
    let files = Files::new();
    files.write("empty", &[]);
    files.refused(&["two.bvh", "missing.rays"], &["missing.rays"]);
    files.refused(&["missing.bvh", "casts.rays"], &["missing.bvh"]);
    files.refused(&["casts.rays", "two.bvh"], &["swapped"]);
    files.refused(&["empty", "casts.rays"], &["empty"]);
    files.refused(&["two.bvh", "empty"], &["empty"]);
    files.refused(&["two.bvh"], &["BVH"]);
    files.refused(&["two.bvh", "casts.rays", "--ci=-1"], &["--ci"]);
    files.refused(&["two.bvh", "casts.rays", "--traversal", "bfs"], &["bfs"]);
    files.write("none.rays", &rays_bytes(fingerprint(&files.triangles), &[], &[], 700));
    files.refused(&["two.bvh", "none.rays"], &["none.rays", "empty"]);
    // A recording that was cut off is replayed as far as it goes.
    let rays = files.read("casts.rays");
    files.write("cut.rays", &rays[..rays.len() * 2 / 3]);
    let output = files.run(&["two.bvh", "cut.rays"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("cut off"));
}

#[test]
fn damaged_files_never_panic() {
    let files = Files::new();
    let random = &mut Random(4);
    for name in ["two.bvh", "casts.rays"] {
        let whole = files.read(name);
        for round in 0..40 {
            let mut bytes = whole.clone();
            if round % 2 == 0 {
                bytes.truncate(random.below(bytes.len()));
            } else {
                let at = random.below(bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
            let damaged = format!("damaged-{name}");
            files.write(&damaged, &bytes);
            let (tree, rays) = if name == "two.bvh" {
                (damaged.as_str(), "casts.rays")
            } else {
                ("two.bvh", damaged.as_str())
            };
            let output = files.run(&[tree, rays, "--traversal", "odf", "--sample", "200"]);
            let line = text(&output.stderr);
            assert!(
                matches!(output.status.code(), Some(0..=2)) && !line.contains("panicked"),
                "{name} {round}: {line}"
            );
        }
    }
    assert!(Path::new(&files.path("two.bvh")).exists());
}
