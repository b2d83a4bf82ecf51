//! Embree's kernels on each tree, as `bvh-compare` tells of them: truth is brute force, by which the
//! recording was answered.

use crate::compare_support::cli::*;
use crate::compare_support::files::*;
use crate::compare_support::*;
use crate::number;
use embree_trace::format::bvh::{self, Contents, Geometry, NO_INSTANCE, fingerprint, flag, geometry_kind};
use embree_trace::format::rays::{Record, flag as rays_flag};
use embree_trace::geometry::{Aabb, Triangle};
use embree_trace::tree::{Node, Tree};
use serde_json::Value;

const NAMES: [&str; 3] = ["two", "four", "eight"];

/// Children that nodes of the scene have room for.
fn width(report: &Value) -> u64 {
    if report["embree"]["structure"].as_str().expect("a structure").contains("BVH8") { 8 } else { 4 }
}

/// What is said of a tree.
fn on(report: &Value, tree: usize) -> &Value {
    &report["trees"][tree]["time"]["embree"]
}

/// Whether every answer of a planted tree that can be judged is brute force's, and, where all can
/// be, Embree's on its own tree.
fn assert_right(answers: &Value, queries: u64, filtered: u64) {
    assert_eq!(number(&answers["queries"]), queries, "{answers}");
    assert_eq!(number(&answers["mismatches"]), 0, "{answers}");
    assert!(number(&answers["borderline"]) <= 3, "{answers}");
    assert_eq!(number(&answers["unjudged"]), filtered, "{answers}");
    if filtered == 0 {
        for part in [answers, &answers["packets"]] {
            assert_eq!((number(&part["flipped"]), number(&part["apart"])), (0, 0), "{answers}");
        }
    }
}

/// Recorded without a filter, and with a mask that sees everything.
fn plain(records: Vec<Record>) -> Vec<Record> {
    records.into_iter().filter(|record| record.mask == u32::MAX && record.flags <= rays_flag::HIT).collect()
}

/// A `.bvh` with other geometries.
fn of_geometries(triangles: &[Triangle], geometries: &[Geometry], tree: &Tree, flags: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let contents = Contents {
        tree: tree.view(),
        triangles,
        geometries,
        order: None,
        meta: None,
        flags,
        producer: "a test",
    };
    bvh::write(&mut bytes, &contents).expect("writing to memory");
    bytes
}

fn geometry(number: u32, first_triangle: u32, triangle_count: u32, kind: u32) -> Geometry {
    Geometry {
        instance: NO_INSTANCE,
        geometry: number,
        first_triangle,
        triangle_count,
        mask: u32::MAX,
        kind,
        flags: 0,
        instance_mask: 0,
    }
}

/// Every triangle a leaf of its own, on one long branch: as bad as a tree can be.
fn chain(triangles: &[Triangle]) -> Tree {
    let bounds = |list: &[Triangle]| list.iter().fold(Aabb::EMPTY, |all, one| all.union(&one.bounds()));
    let leaf = |index: u32| Node::leaf(triangles[index as usize].bounds(), index, 1);
    let last = triangles.len() as u32 - 1;
    let mut tree = Tree { nodes: Vec::new(), primitives: (0..=last).collect() };
    for index in 0..last {
        let rest = bounds(&triangles[index as usize..]);
        tree.nodes.extend([Node::inner(rest, 2 * index + 1, 2), leaf(index)]);
    }
    tree.nodes.push(leaf(last));
    tree
}

#[test]
fn answers_on_planted_trees_are_those_of_brute_force_and_json_has_its_keys() {
    let files = Files::new();
    let (all, rejects) = records(&files.triangles, 3000, 5);
    let mut filtered: Vec<u32> = rejects.iter().map(|reject| reject.record).collect();
    filtered.dedup();
    let trees = NAMES.map(|name| format!("{name}.bvh"));
    let [two, four, eight] = [0, 1, 2].map(|tree| trees[tree].as_str());
    let report =
        files.json(&[two, four, eight, "casts.rays", "--time", "--rounds", "3", "--traversal", "odf"]);
    let embree = &report["embree"];
    assert!(number(&embree["version"]) > 30000 && embree["quality"] == "medium" && embree["robust"] == false);
    // What Embree's own is, and in what it is not what was recorded: brute force, with filters.
    assert_eq!((&embree["flattened"], &embree["filters"]), (&false.into(), &false.into()));
    assert_eq!(embree["recorded"], serde_json::json!({"version": null, "isa": null, "filters": true}));
    assert_eq!(embree["unlike_recorded"], serde_json::json!(["the program has filters"]));
    assert!(embree["seconds"].as_f64() > Some(0.0) && embree["high"]["seconds"].as_f64() > Some(0.0));
    assert_right(&embree["answers"], 3000, filtered.len() as u64);
    for (tree, children) in [2, 4, 8].into_iter().enumerate() {
        let found = on(&report, tree);
        assert_eq!(found["planted"], children <= width(&report), "{found}");
        if found["planted"] == false {
            continue;
        }
        assert_right(&found["answers"], 3000, filtered.len() as u64);
        // Embree splits no node and merges none; the root alone may be a leaf.
        assert!(number(&found["nodes"]) > 1 && number(&found["bytes"]) > number(&found["blocks"]));
        let mut groups = vec![found];
        for by in ["by_kind", "by_purpose"] {
            let names: Vec<&String> = found[by].as_object().expect("groups").keys().collect();
            let timed: Vec<&String> = embree[by].as_object().expect("groups").keys().collect();
            assert_eq!(names, timed);
            groups.extend(found[by].as_object().expect("groups").values());
        }
        for group in groups {
            let of = |key: &str| group[key].as_f64().expect(key);
            assert!(0.0 < of("least") && of("least") <= of("ns") && of("ns") <= of("greatest"), "{group}");
            assert!((of("spread") - (of("greatest") - of("least")) / of("ns")).abs() < 1e-9, "{group}");
            assert!(of("ratio_to_own") > 0.0 && of("ratio_to_best") >= of("ratio_to_own"), "{group}");
        }
        let own = embree["seconds"].as_f64().expect("seconds") * 1e9 / 3000.0;
        let ratio = found["ns"].as_f64().expect("ns") / own;
        assert!((found["ratio_to_own"].as_f64().expect("a ratio") - ratio).abs() < 1e-9, "{found}");
    }
    assert_eq!(on(&report, 0)["ratio"].as_f64(), Some(1.0));

    // Masks are part of the scene; where no filter was, every answer is that on Embree's own tree.
    let mut unfiltered = all.clone();
    unfiltered.retain(|record| record.flags & rays_flag::HAS_REJECTS == 0);
    let queries = unfiltered.len() as u64;
    assert!(unfiltered.iter().any(|record| record.mask == 2) && queries > 2000);
    files.write("unfiltered.rays", &rays_bytes(fingerprint(&files.triangles), &unfiltered, &[], 700));
    let report = files.json(&[two, four, eight, "unfiltered.rays", "--embree", "--traversal", "odf"]);
    for tree in (0..3).filter(|&tree| on(&report, tree)["planted"] == true) {
        assert_right(&on(&report, tree)["answers"], queries, 0);
    }
    assert_eq!(number(&report["embree"]["differing"]), 0);
}

#[test]
fn a_tree_that_does_not_fit_is_a_dash_and_a_line_says_why() {
    let files = Files::new();
    // 4 wide on every processor.
    let arguments = ["two.bvh", "eight.bvh", "casts.rays", "--time", "--rounds", "1", "--isa", "sse42"];
    let report = files.json(&arguments);
    assert_eq!(report["embree"]["isa"], "sse42");
    assert_eq!([&on(&report, 0)["planted"], &on(&report, 1)["planted"]], [true, false]);
    assert!(on(&report, 1)["why"].as_str().is_some_and(|why| why.contains("4 wide")));
    assert!(on(&report, 1).get("ns").is_none() && on(&report, 1).get("answers").is_none());
    let output = files.run(&[&arguments[..], &["--html", "page.html"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    let lines: Vec<&str> =
        table.lines().filter(|line| line.starts_with("eight.bvh: not planted: ")).collect();
    assert_eq!(lines.len(), 1, "{table}");
    let rows = |name: &str| table.lines().filter(|line| line.contains(name) && line.contains('—')).count();
    assert_eq!((rows(" two "), rows(" eight ")), (0, 2), "{table}");
    assert!(table.contains("sse42 medium") && table.contains("sse42 high"), "{table}");
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
    let page = text(&files.read("page.html"));
    assert!(page.contains("id=\"r1-embree\"") && page.contains("eight.bvh: not planted: "));
    files.refused(&["two.bvh", "casts.rays", "--time", "--isa", "mmx"], &["sse42"]);
}

#[test]
fn without_time_only_answers_are_asked_for() {
    let files = Files::new();
    let report = files.json(&["two.bvh", "casts.rays", "--embree", "--robust", "--traversal", "odf"]);
    assert!(report.get("timing").is_none());
    let embree = &report["embree"];
    // Robust scenes have no trees of high quality.
    assert!(embree["robust"] == true && embree.get("high").is_none() && embree.get("seconds").is_none());
    assert_eq!(number(&on(&report, 0)["answers"]["mismatches"]), 0);
    assert!(on(&report, 0).get("ns").is_none());
    let few = files.json(&["two.bvh", "casts.rays", "--embree", "--sample", "100"]);
    assert_eq!(number(&on(&few, 0)["answers"]["queries"]), 100);
    assert!(files.json(&["two.bvh", "casts.rays"]).get("embree").is_none());
    let table = text(&files.run(&["two.bvh", "casts.rays", "--embree"]).stdout);
    assert!(table.contains("Embree's kernels on each tree") && !table.contains("/ medium"), "{table}");
}

#[test]
fn wrong_answers_of_embrees_kernels_fail() {
    let files = Files::new();
    let (mut records, rejects) = records(&files.triangles, 3000, 5);
    let wrong = records
        .iter()
        .position(|record| record.is_hit() && !record.is_occlusion() && record.flags == rays_flag::HIT);
    let wrong = wrong.expect("a closest hit without rejects");
    records[wrong].t *= 1.01;
    files.write("wrong.rays", &rays_bytes(fingerprint(&files.triangles), &records, &rejects, 700));
    let output = files.run(&["two.bvh", "wrong.rays", "--traversal", "odf", "--embree"]);
    assert_eq!(output.status.code(), Some(1));
    let lines = text(&output.stderr);
    let line = format!("two.bvh: Embree's kernels: 1 wrong answers, first query {wrong} ");
    assert!(lines.contains(&line), "{lines}");
    let allowing = ["two.bvh", "wrong.rays", "--traversal", "odf", "--embree", "--allow-wrong", "1"];
    assert_eq!(files.run(&allowing).status.code(), Some(0));
}

/// Geometries by other numbers and in another order, none, some, and quads; a tree that is a branch.
#[test]
fn scenes_are_made_of_whatever_geometries_a_file_has() {
    let files = Files::new();
    let mut random = Random(3);
    let triangles = soup(60, 0.4, &mut random);
    let tree = random_tree(&triangles, 4, 3, &mut random);
    let triangle = geometry_kind::TRIANGLES;
    let (records, _) = records(&triangles, 500, 8);
    let records = plain(records);
    files.write("soup.rays", &rays_bytes(fingerprint(&triangles), &records, &[], 100));
    let numbered = [geometry(7, 0, 25, triangle), geometry(2, 25, 35, triangle)];
    let gaps = [geometry(1, 10, 5, triangle), geometry(0, 20, 30, triangle)];
    for (name, geometries) in [("numbered", &numbered[..]), ("none", &[]), ("gaps", &gaps)] {
        files.write("own.bvh", &of_geometries(&triangles, geometries, &tree, 0));
        files.write("chain.bvh", &of_geometries(&triangles, geometries, &chain(&triangles), 0));
        let report = files.json(&["own.bvh", "chain.bvh", "soup.rays", "--time", "--rounds", "1"]);
        for tree in [0, 1] {
            assert_eq!(on(&report, tree)["planted"], true, "{name}: {}", on(&report, tree));
            assert_right(&on(&report, tree)["answers"], records.len() as u64, 0);
        }
        assert_right(&report["embree"]["answers"], records.len() as u64, 0);
    }
}

#[test]
fn quads_are_planted_and_instances_are_not() {
    let files = Files::new();
    let mut random = Random(5);
    // Pairs of triangles that make quads, then single ones.
    let mut triangles = height_field(6, 0.2, &mut random);
    let quads = triangles.len() as u32;
    triangles.extend(soup(40, 0.3, &mut random));
    let (records, _) = records(&triangles, 400, 9);
    let records = plain(records);
    files.write("field.rays", &rays_bytes(fingerprint(&triangles), &records, &[], 100));
    let both =
        [geometry(0, 0, quads, geometry_kind::QUADS), geometry(1, quads, 40, geometry_kind::TRIANGLES)];
    let tree = random_tree(&triangles, 4, 3, &mut random);
    files.write("quads.bvh", &of_geometries(&triangles, &both, &tree, 0));
    let report = files.json(&["quads.bvh", "field.rays", "--time", "--rounds", "1"]);
    assert_eq!(on(&report, 0)["planted"], true, "{}", on(&report, 0));
    assert_right(&on(&report, 0)["answers"], records.len() as u64, 0);
    let placed = both.map(|geometry| Geometry { instance: 4, ..geometry });
    files.write("placed.bvh", &of_geometries(&triangles, &placed, &tree, flag::FLATTENED));
    let report = files.json(&["placed.bvh", "field.rays", "--time", "--rounds", "1"]);
    assert_eq!(on(&report, 0)["planted"], false);
    assert!(on(&report, 0)["why"].as_str().is_some_and(|why| why.contains("instances")));
    assert_eq!(report["embree"]["unlike_recorded"], serde_json::json!(["the program has instances"]));
    let table = text(&files.run(&["placed.bvh", "field.rays", "--time", "--rounds", "1"]).stdout);
    assert!(table.contains("instances flattened, without filters"), "{table}");
    // Embree on its own tree goes on beside it.
    assert_right(&report["embree"]["answers"], records.len() as u64, 0);
}
