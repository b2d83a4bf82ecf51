//! The command line: bad input is one line and exit code 2; a screenshot says what was opened.

use crate::room::Room;
use serde_json::Value;
use std::process::{Command, Output};

fn run(room: &Room, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bvh-view"))
        .args(arguments)
        .current_dir(room.directory.path())
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .expect("running bvh-view")
}

fn refused(room: &Room, arguments: &[&str], expected: &str) {
    let output = run(room, arguments);
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
    let said: Vec<&str> = line.lines().filter(|line| line.starts_with("bvh-view: error: ")).collect();
    assert!(said.len() == 1 && said[0].contains(expected), "{arguments:?}: {line:?} lacks {expected:?}");
}

#[test]
fn a_screenshot_says_what_was_opened() {
    let room = Room::new();
    let arguments =
        ["sweep.bvh", "casts.rays", "--screenshot", "out.png", "--size", "320x200", "--format", "json"];
    let output = run(&room, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let said: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(said["trees"][0]["triangles"], room.triangles.len());
    assert_eq!(said["recording"]["queries"], said["recording"]["counted"]);
    let tree = &said["trees"][0];
    assert!(tree["cost"].as_f64().is_some_and(|cost| cost > 6.1) && tree["cost_ratio"] == 1.0);
    assert!(tree["gamma"].as_f64().is_some_and(|gamma| gamma > 2.0) && tree["gamma_ratio"] == 1.0);
    let picture = image::open(room.path("out.png")).expect("a picture");
    assert_eq!((picture.width(), picture.height()), (320, 200));
}

/// The number that is shown first is the one that `bvh-compare` reports, and trees of different
/// widths do not compare by their tests.
#[test]
fn costs_are_those_of_a_comparison() {
    let room = Room::new();
    let trees = ["sweep.bvh", "wide.bvh"];
    let output = run(
        &room,
        &[&trees[..], &["casts.rays", "--screenshot", "out.png", "--size", "320x200", "--format", "json"]]
            .concat(),
    );
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let shown: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let output = Command::new(env!("CARGO_BIN_EXE_bvh-compare"))
        .args(trees)
        .args(["casts.rays", "--format", "json", "--traversal", "odf", "--no-time"])
        .current_dir(room.directory.path())
        .output()
        .expect("running bvh-compare");
    let compared: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for (tree, shown) in shown["trees"].as_array().expect("trees").iter().enumerate() {
        let compared = &compared["trees"][tree]["traversals"]["odf"];
        for key in ["cost", "cost_ratio"] {
            let [shown, compared] = [&shown[key], &compared[key]].map(|value| value.as_f64().expect(key));
            assert!(
                shown > 0.0 && (shown - compared).abs() < 1e-9 * shown,
                "{tree} {key}: {shown} {compared}"
            );
        }
    }
    assert_eq!(shown["trees"][1]["gamma_ratio"], Value::Null);
}

#[test]
fn bad_input_is_one_line() {
    let room = Room::new();
    room.write("broken.bvh", b"\x89BVH\r\n\x1a\nand no more");
    let mut other = std::fs::read(room.path("casts.rays")).expect("a recording");
    other[16] ^= 1;
    room.write("other.rays", &other);
    let shot = ["--screenshot", "out.png", "--size", "64x64"];
    let with = |files: &[&str]| files.iter().chain(&shot).map(ToString::to_string).collect::<Vec<String>>();
    for (files, expected) in [
        (vec!["none.bvh"], "none.bvh"),
        (vec!["broken.bvh"], "broken.bvh"),
        (vec!["casts.rays"], "one or two trees"),
        (vec!["sweep.bvh", "casts.rays", "casts.rays"], "at most one recording"),
        (vec!["sweep.bvh", "other.rays"], "sweep.bvh"),
        (vec!["sweep.bvh", "--node", "100000"], "the tree has nodes 0 to"),
        (vec!["sweep.bvh", "--view", "1,1,1/1,1,1"], "same point"),
        (vec!["sweep.bvh", "--pixel", "1,1"], "needs a recording"),
        (vec!["sweep.bvh", "casts.rays", "--pixel", "48,0"], "48 x 48"),
        (vec!["sweep.bvh", "--pixels", "cost"], "needs a recording"),
        (vec!["sweep.bvh", "casts.rays", "--pixels", "difference"], "two trees"),
        (vec!["sweep.bvh", "casts.rays", "--image", "0x4"], "pixels"),
    ] {
        let arguments = with(&files);
        refused(&room, &arguments.iter().map(String::as_str).collect::<Vec<&str>>(), expected);
    }
    refused(&room, &["sweep.bvh", "--size", "0x0"], "WIDTHxHEIGHT");
    refused(&room, &["sweep.bvh", "--boxes", "all"], "children");
    assert!(!room.path("out.png").exists(), "nothing is written when something is wrong");
}

#[test]
fn without_a_display_there_is_no_window() {
    let room = Room::new();
    refused(&room, &["sweep.bvh"], "no window");
}

#[test]
fn help_has_examples() {
    let room = Room::new();
    let output = run(&room, &["--help"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.contains("Examples:") && text.contains("--screenshot"));
}
