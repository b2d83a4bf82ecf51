//! `bvh-compare --packet` and `--sort`: the same answers in other company, and a report of how packets decided.

mod compare_support;

use compare_support::cli::*;
use serde_json::Value;

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no count"))
}

fn runs(report: &Value) -> impl Iterator<Item = &Value> {
    let trees = report["trees"].as_array().expect("trees").iter();
    trees.flat_map(|tree| tree["traversals"].as_object().expect("traversals").values())
}

const TREES: [&str; 4] = ["two.bvh", "four.bvh", "eight.bvh", "casts.rays"];

#[test]
fn packets_of_any_size_and_order_find_what_was_recorded() {
    let files = Files::new();
    let alone = files.json(&TREES);
    assert!(alone.get("packet").is_none() && runs(&alone).all(|run| run.get("packets").is_none()));
    for (size, sort) in
        [("16", None), ("100", Some("both")), ("256", Some("direction")), ("256", Some("origin"))]
    {
        let mut arguments = [&TREES[..], &["--packet", size]].concat();
        arguments.extend(sort.into_iter().flat_map(|sort| ["--sort", sort]));
        let report = files.json(&arguments);
        assert_eq!(report["packet"].to_string(), size);
        assert_eq!(report["sort"].as_str(), sort);
        for (run, alone) in runs(&report).zip(runs(&alone)) {
            // The recording has masks, rejects and odd intervals.
            assert_eq!(number(&run["mismatches"]), 0);
            for key in ["queries", "hits", "borderline"] {
                assert_eq!(run[key], alone[key], "{key}");
            }
            for groups in ["by_kind", "by_depth", "by_purpose"] {
                let parts = run[groups].as_object().expect("groups");
                for key in ["decisions", "early_hits", "early_misses", "by_rays", "few", "octets"] {
                    let sum: u64 = parts.values().map(|part| number(&part["packets"][key])).sum();
                    assert_eq!(sum, number(&run["packets"][key]), "{groups} {key}");
                }
            }
            let packets = &run["packets"];
            let parts = ["early_hits", "early_misses", "by_rays", "few"].map(|key| number(&packets[key]));
            assert_eq!(parts.iter().sum::<u64>(), number(&packets["decisions"]));
            assert!(number(&packets["octets"]) > 0);
        }
        // P_R is a matter of the tree and the queries.
        for (tree, alone) in report["trees"]
            .as_array()
            .into_iter()
            .flatten()
            .zip(alone["trees"].as_array().into_iter().flatten())
        {
            assert_eq!(tree["t_r"], alone["t_r"]);
        }
    }
}

#[test]
fn packets_do_not_depend_on_threads() {
    let files = Files::new();
    let counts = |threads: &str| {
        let report =
            files.json(&["two.bvh", "casts.rays", "--packet", "64", "--sort", "both", "--threads", threads]);
        let of = |run: &Value| (run["box_tests"].clone(), run["packets"].clone());
        runs(&report).map(of).collect::<Vec<_>>()
    };
    assert_eq!(counts("1"), counts("3"));
}

#[test]
fn sorting_changes_no_count_of_single_queries() {
    let files = Files::new();
    let (plain, sorted) = (files.json(&TREES), files.json(&[&TREES[..], &["--sort", "direction"]].concat()));
    for (plain, sorted) in runs(&plain).zip(runs(&sorted)) {
        for key in ["box_tests", "node_visits", "primitive_tests", "mismatches", "per_query"] {
            assert_eq!(plain[key], sorted[key], "{key}");
        }
    }
}

#[test]
fn tables_pages_and_csv_say_how_packets_decided() {
    let files = Files::new();
    let arguments = ["two.bvh", "four.bvh", "casts.rays", "--packet", "64", "--sort", "direction"];
    let output = files.run(&[&arguments[..], &["--html", "page.html", "--details"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (table, page) = (text(&output.stdout), text(&files.read("page.html")));
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
    for part in ["Packets of 64 queries, sorted by direction", "early hit", "early miss", "few", "octets"] {
        assert!(table.contains(part) && page.contains(part), "{part}");
    }
    let csv = text(&files.run(&[&arguments[..], &["--format", "csv"]].concat()).stdout);
    let mut lines = csv.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    let place = header.iter().position(|name| *name == "early_hits").expect("a column");
    for line in lines {
        assert_eq!(line.len(), header.len());
        assert!(line[place..place + 5].iter().any(|count| *count != "0"), "{line:?}");
    }
}

#[test]
fn packets_and_sorted_queries_are_timed_beside_single_ones() {
    let files = Files::new();
    let report =
        files.json(&[&TREES[..], &["--packet", "32", "--sort", "both", "--time", "--rounds", "2"]].concat());
    assert!(report["timing"]["sort_seconds"].as_f64() > Some(0.0));
    for run in runs(&report) {
        let others = run["other_times"].as_object().expect("other times");
        assert_eq!(others.keys().collect::<Vec<_>>(), ["packets", "packets_sorted", "sorted"]);
        for time in others.values().chain([&run["time"]]) {
            let [least, median, greatest] =
                ["least", "seconds", "greatest"].map(|key| time[key].as_f64().expect(key));
            assert!(0.0 < least && least <= median && median <= greatest, "{time}");
        }
    }
    let output =
        files.run(&["two.bvh", "casts.rays", "--packet", "32", "--sort", "both", "--time", "--rounds", "1"]);
    let table = text(&output.stdout);
    for part in ["ODF, packets of 32", "ODF, sorted", "RayOrder, packets", "Sorting took"] {
        assert!(table.contains(part), "{part}: {table}");
    }
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
}

#[test]
fn sizes_and_keys_that_cannot_be_are_refused() {
    let files = Files::new();
    for size in ["0", "15", "257", "many"] {
        files.refused(&["two.bvh", "casts.rays", "--packet", size], &["--packet"]);
    }
    files.refused(&["two.bvh", "casts.rays", "--sort", "luck"], &["--sort", "direction"]);
}
