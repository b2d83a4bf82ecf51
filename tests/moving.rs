//! Frames of moving scenes: `bvh-build --update` from frame to frame, judged by `bvh-compare` on answers of a loop over all triangles, and the
//! experiment over all of them.

mod compare_support;

use compare_support::cli::text;
use compare_support::files::*;
use embree_trace::builder::{self, Config, MAX_DEPTH};
use embree_trace::format::bvh::{Bvh, fingerprint};
use embree_trace::geometry::{Aabb, Triangle};
use embree_trace::mesh::generate::Sequence;
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use embree_trace::tree::validate::validate;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const FRAMES: usize = 4;

fn frame(sequence: Sequence, number: usize) -> Vec<Triangle> {
    sequence.frame(900, number as f64 / (FRAMES - 1) as f64).triangles()
}

fn name(number: usize, extension: &str) -> String {
    format!("{number:04}.{extension}")
}

/// A directory with frames and their recordings, as `embree-trace FRAMES… --savetrace DIR` writes them.
fn recorded(sequence: Sequence) -> tempfile::TempDir {
    let directory = tempfile::tempdir().expect("a temporary directory");
    for number in 0..FRAMES {
        let triangles = frame(sequence, number);
        let tree = builder::build(&triangles, &Config::default(), &Progress::hidden())
            .expect("a valid configuration");
        let (records, rejects) = records(&triangles, 1200, 3 + number as u64);
        let rays = rays_bytes(fingerprint(&triangles), &records, &rejects, 500);
        let write = |extension, bytes: &[u8]| {
            std::fs::write(directory.path().join(name(number, extension)), bytes).expect("written");
        };
        write("bvh", &tree_bytes(&triangles, &tree, Some("{\"image\":[16,12]}")));
        write("rays", &rays);
    }
    directory
}

fn run(program: &str, directory: &Path, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).current_dir(directory).output().expect("it runs")
}

fn build(directory: &Path, arguments: &[&str]) -> Value {
    let arguments = [arguments, &["--format", "json"]].concat();
    let output = run(env!("CARGO_BIN_EXE_bvh-build"), directory, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn read(path: &Path, check: impl FnOnce(&Tree, &[Triangle], &Value)) {
    let bytes = std::fs::read(path).expect("a file");
    let bvh = Bvh::parse(&bytes).expect("a .bvh");
    bvh.verify().expect("a whole tree");
    let tree = Tree { nodes: bvh.tree.nodes.to_vec(), primitives: bvh.tree.primitives.to_vec() };
    check(&tree, bvh.triangles, &serde_json::from_str(bvh.meta.expect("META")).expect("JSON"));
}

#[test]
fn every_update_answers_every_query_of_every_frame() {
    for sequence in Sequence::ALL {
        let directory = recorded(sequence);
        let directory = directory.path();
        for method in ["refit", "rotate", "rotate-by-rays", "rebuild"] {
            std::fs::copy(directory.join("0000.bvh"), directory.join("tree.0.bvh")).expect("copied");
            for number in 1..FRAMES {
                let [before, after] = [number - 1, number].map(|number| format!("tree.{number}.bvh"));
                let (input, rays) = (name(number, "bvh"), name(number - 1, "rays"));
                let report =
                    build(directory, &[&input, &after, "--update", method, &before, "--rays", &rays]);
                assert_eq!(report["build"]["update"]["method"], method);
                assert_eq!(report["build"]["update"]["rebuilt"], method == "rebuild");
                read(&directory.join(&after), |tree, triangles, meta| {
                    assert_eq!(triangles, frame(sequence, number));
                    validate(tree, triangles, MAX_DEPTH).expect("a valid tree");
                    assert_eq!(meta["image"], serde_json::json!([16, 12]));
                    let whole = triangles.iter().fold(Aabb::EMPTY, |sum, t| sum.union(&t.bounds()));
                    assert_eq!(tree.nodes[0].bounds(), whole);
                    if method == "refit" {
                        read(&directory.join("0000.bvh"), |first, _, _| {
                            assert_eq!(tree.primitives, first.primitives);
                            assert_eq!(tree.nodes.len(), first.nodes.len());
                        });
                    }
                });
                let output = run(
                    env!("CARGO_BIN_EXE_bvh-compare"),
                    directory,
                    &[&after, &name(number, "rays"), "--no-time", "--format", "json"],
                );
                assert_eq!(
                    output.status.code(),
                    Some(0),
                    "{} {method}: {}",
                    sequence.name(),
                    text(&output.stdout)
                );
            }
        }
    }
}

#[test]
fn a_limit_rebuilds_when_rays_have_become_expensive_and_remembers_what_they_cost() {
    let directory = recorded(Sequence::Twist);
    let directory = directory.path();
    let step = |limit: &str, before: &str, number: usize, after: &str| {
        let (input, rays) = (name(number, "bvh"), name(number - 1, "rays"));
        let arguments = [&input, after, "--update", "refit", before, "--rays", &rays, "--limit", limit];
        build(directory, &arguments)["build"]["update"].clone()
    };
    let first = step("1000", "0000.bvh", 1, "a.bvh");
    assert_eq!(first["rebuilt"], false);
    let built = first["cost_when_built"].as_f64().expect("a cost");
    assert!(first["cost"].as_f64().expect("a cost") > built, "a turn by a half turn stretches boxes");
    // The second step compares with the first tree, not with the first step.
    let second = step("1000", "a.bvh", 2, "b.bvh");
    assert_eq!(second["cost_when_built"].as_f64(), Some(built));
    assert_eq!(second["frames_since_build"], 2);
    let rebuilt = step("1.01", "a.bvh", 2, "c.bvh");
    assert_eq!((&rebuilt["rebuilt"], &rebuilt["frames_since_build"]), (&true.into(), &0.into()));
    assert!(rebuilt["cost_when_built"].as_f64().expect("a cost") < second["cost"].as_f64().expect("a cost"));
}

#[test]
fn frames_that_do_not_fit_are_refused_in_one_line() {
    let directory = recorded(Sequence::Cloth);
    let directory = directory.path();
    let other = Sequence::Cloth.frame(2000, 0.5).triangles();
    let tree = builder::build(&other, &Config::default(), &Progress::hidden()).expect("valid");
    std::fs::write(directory.join("other.bvh"), tree_bytes(&other, &tree, None)).expect("written");
    std::fs::write(directory.join("wide.bvh"), bvh_bytes(&frame(Sequence::Cloth, 0), 4, 2, 1, None))
        .expect("written");
    let refused = |arguments: &[&str], mentions: &str| {
        let output = run(env!("CARGO_BIN_EXE_bvh-build"), directory, arguments);
        let line = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}");
        assert!(line.contains(mentions) && line.lines().count() == 1, "{line}");
        assert!(!directory.join("out.bvh").exists());
    };
    refused(
        &["other.bvh", "out.bvh", "--update", "refit", "0000.bvh"],
        "frames of one mesh have the same faces",
    );
    refused(&["0001.bvh", "out.bvh", "--update", "rotate", "wide.bvh"], "only binary trees can be rotated");
    refused(
        &["0001.bvh", "out.bvh", "--update", "rotate-by-rays", "0000.bvh"],
        "the recording of the frame before",
    );
    refused(&["0001.bvh", "out.bvh", "--update", "turn", "0000.bvh"], "expected one of refit, rotate");
    refused(&["0001.bvh", "out.bvh", "--update", "refit", "0000.bvh", "--limit", "0.5"], "at least 1");
    refused(&["0001.bvh", "out.bvh", "--update", "refit", "0000.bvh", "--rays", "0001.rays"], "0001.rays");
}

#[test]
fn the_experiment_asks_every_frame_and_finds_nothing_wrong() {
    let directory = recorded(Sequence::Twist);
    let output =
        run(env!("CARGO_BIN_EXE_bvh-experiment"), directory.path(), &["animation", ".", "--out", "results"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let csv = std::fs::read_to_string(directory.path().join("results/animation.csv")).expect("a CSV");
    let rows: Vec<Vec<&str>> = csv.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 8 * (FRAMES - 1));
    for row in &rows {
        assert_eq!(row[11], "0", "{row:?}");
        let number = |column: usize| row[column].parse::<f64>().expect("a number");
        assert!(number(6) > 500.0 && number(7) > 1.0 && number(9) > 0.5 && number(2) > 0.0, "{row:?}");
    }
    // On the last frame the twisted boxes cost more than new ones.
    let tests = |method: &str| {
        let row = rows.iter().rfind(|row| row[1] == method).expect("a row");
        row[7].parse::<f64>().expect("a number") + row[8].parse::<f64>().expect("a number")
    };
    assert!(tests("refit") > 1.2 * tests("rebuild"));
    assert!(tests("rotate") < tests("refit"));
    for extension in ["svg", "png"] {
        assert!(
            directory
                .path()
                .join(format!("results/animation.{extension}"))
                .metadata()
                .expect("a figure")
                .len()
                > 1000
        );
    }
    let alone = tempfile::tempdir().expect("a directory");
    for extension in ["bvh", "rays"] {
        let file = name(0, extension);
        std::fs::copy(directory.path().join(&file), alone.path().join(&file)).expect("copied");
    }
    let output = run(env!("CARGO_BIN_EXE_bvh-experiment"), alone.path(), &["animation", "."]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("one frame alone does not move"));
}
