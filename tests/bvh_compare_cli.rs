//! `bvh-compare` as a user meets it: files in, text and exit codes out.

#[cfg(feature = "embree")]
mod compare_kernels;
mod compare_support;

use compare_support::cli::*;
use compare_support::files::*;
use compare_support::*;
use embree_trace::format::bvh::fingerprint;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no count"))
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
            // The default constants, worked out for each kind, and the mean of both kinds.
            let [closest, occlusion] = ["closest_hit", "occlusion"].map(|kind| &run["by_kind"][kind]);
            let nanoseconds = |group: &Value, leaf: f64, block: f64| {
                let count = |name: &str| number(&group[name]) as f64;
                6.1 * count("node_visits") + leaf * count("leaf_visits") + block * count("block_tests")
            };
            let sums = [nanoseconds(closest, 7.7, 2.0), nanoseconds(occlusion, 6.2, 2.9)];
            for (group, sum) in [(closest, sums[0]), (occlusion, sums[1]), (run, sums[0] + sums[1])] {
                let cost = group["cost"].as_f64().expect("a cost");
                assert!((cost * number(&group["queries"]) as f64 - sum).abs() < 1e-6 * sum, "{group}");
            }
            let cost = |tree: &Value| tree["traversals"][order]["cost"].as_f64().expect("a cost");
            let ratio = run["cost_ratio"].as_f64().expect("a ratio");
            assert!((ratio - cost(tree) / cost(&trees[0])).abs() < 1e-9);
            assert_eq!(run["gamma_ratio"].is_null(), number(&trees[0]["max_children"]) != width);
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
    assert!(table.contains("does not compare trees of different widths"), "{table}");
    for part in [
        "Cost per query",
        "Counts per query",
        "RayOrder",
        "two",
        "four",
        "shadow",
        "closest hit",
        "depth 0",
        "T_R",
    ] {
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

/// Two scenes in one recording: every command takes the queries of the one that its tree is of, and
/// refuses the other.
#[test]
fn of_a_recording_of_two_scenes_the_trees_own_is_taken() {
    let files = Files::new();
    let other = soup(300, 0.3, &mut Random(21));
    let (first, first_rejects) = records(&files.triangles, 900, 31);
    let (second, second_rejects) = records(&other, 500, 32);
    let scenes: [(&[_], &[_]); 2] = [(&first, &first_rejects), (&second, &second_rejects)];
    files.write("two.rays", &scenes_bytes(0, &scenes, 300));
    let number = |scene: u16| format!("{{\"recorded\":{{\"number\":{scene}}}}}");
    files.write("0.bvh", &bvh_bytes(&files.triangles, 2, 1, 1, Some(&number(0))));
    files.write("1.bvh", &bvh_bytes(&other, 2, 1, 1, Some(&number(1))));
    files.write("5.bvh", &bvh_bytes(&other, 2, 1, 1, Some(&number(5))));
    files.write("silent.bvh", &bvh_bytes(&other, 4, 2, 2, None));
    let run = |program: &str, words: &[&str]| {
        let output = Command::new(program).args(words).current_dir(files.directory.path()).output();
        let output = output.expect("running it");
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let refused = |program: &str, words: &[&str], expected: &str| {
        let (code, _, said) = run(program, words);
        assert_eq!((code, said.lines().count()), (Some(2), 1), "{words:?}: {said}");
        assert!(said.contains(expected), "{words:?}: {said}");
    };
    let good = |program: &str, words: &[&str]| {
        let (code, out, said) = run(program, words);
        assert_eq!(code, Some(0), "{words:?}: {said}");
        out
    };
    let counted = |words: &[&str]| {
        let report = files.json(words);
        let odf = &report["trees"][0]["traversals"]["odf"];
        (odf["queries"].as_u64(), odf["mismatches"].as_u64())
    };
    assert_eq!(counted(&["0.bvh", "two.rays"]), (Some(900), Some(0)));
    assert_eq!(counted(&["1.bvh", "two.rays"]), (Some(500), Some(0)));
    assert_eq!(counted(&["1.bvh", "two.rays", "--scene", "1"]), (Some(500), Some(0)));
    assert_eq!(counted(&["silent.bvh", "two.rays", "--scene", "1"]), (Some(500), Some(0)));

    let [build, experiment, convert] = [
        env!("CARGO_BIN_EXE_bvh-build"),
        env!("CARGO_BIN_EXE_bvh-experiment"),
        env!("CARGO_BIN_EXE_trace-convert"),
    ];
    for heuristic in ["blend", "auto"] {
        let words = ["1.bvh", "ours.bvh", "--rays", "two.rays", "--heuristic", heuristic, "--budget", "1"];
        let report = good(build, &[&words[..], &["--format", "json"]].concat());
        let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
        assert_eq!(report["training_queries"], 500, "{heuristic}");
        // The new tree knows of which scene it is.
        assert_eq!(counted(&["ours.bvh", "two.rays"]), (Some(500), Some(0)));
    }
    good(experiment, &["traversal", "1.bvh", "--rays", "two.rays", "--out", "out"]);
    good(convert, &["two.rays", "one.rays", "--scene", "1", "--bvh", "1.bvh"]);
    assert_eq!(counted(&["1.bvh", "one.rays"]), (Some(500), Some(0)));

    let compare = env!("CARGO_BIN_EXE_bvh-compare");
    for (program, words) in [
        (compare, vec!["TREE", "two.rays"]),
        (build, vec!["TREE", "no.bvh", "--rays", "two.rays"]),
        (build, vec!["TREE", "no.bvh", "--rays", "two.rays", "--heuristic", "auto"]),
        (build, vec!["TREE", "no.bvh", "--rays", "two.rays", "--order"]),
        (experiment, vec!["alpha", "TREE", "--rays", "two.rays"]),
        (convert, vec!["two.rays", "no.rays", "--bvh", "TREE"]),
    ] {
        let with = |tree: &'static str, more: &[&'static str]| {
            let words = words.iter().map(|&word| if word == "TREE" { tree } else { word });
            words.chain(more.iter().copied()).collect::<Vec<&str>>()
        };
        refused(program, &with("1.bvh", &["--scene", "0"]), "the tree is of scene 1");
        refused(program, &with("silent.bvh", &[]), "--scene");
        refused(program, &with("silent.bvh", &["--scene", "7"]), "scenes 0, 1");
        refused(program, &with("5.bvh", &[]), "scene 5");
    }
    refused(compare, &["1.bvh", "5.bvh", "two.rays"], "scenes 1 and 5");
}

#[test]
fn several_recordings_are_reported_apart() {
    let files = Files::new();
    let (others, rejects) = records(&files.triangles, 1000, 77);
    files.write("other.rays", &rays_bytes(fingerprint(&files.triangles), &others, &rejects, 300));
    let trees = ["two.bvh", "four.bvh"];
    let both = timeless(files.json(&[&trees[..], &["casts.rays", "other.rays"]].concat()));
    let parts = both["recordings"].as_array().expect("recordings");
    assert_eq!(parts.len(), 2);
    for (part, name) in parts.iter().zip(["casts.rays", "other.rays"]) {
        // Each part is what the recording gives alone, but for the failures, which are said once.
        let mut alone = timeless(files.json(&[&trees[..], &[name]].concat()));
        alone.as_object_mut().expect("an object").remove("failures");
        assert_eq!(part, &alone, "{name}");
    }
    assert_eq!(both["failures"], serde_json::json!([]));

    let run = |format: &str| {
        let output = files.run(&[&trees[..], &["casts.rays", "other.rays", "--format", format]].concat());
        assert_eq!(output.status.code(), Some(0));
        text(&output.stdout)
    };
    let table = run("table");
    assert!(table.contains("Recording casts.rays") && table.contains("Recording other.rays"));
    let csv = run("csv");
    // Two trees, two orders; all, 2 kinds, 3 depths, 3 purposes.
    for name in ["casts.rays", "other.rays"] {
        assert_eq!(csv.lines().filter(|line| line.ends_with(&format!(",{name}"))).count(), 2 * 2 * 9);
    }
    let pictures = ["casts.rays", "other.rays", "--traversal", "odf", "--heatmap", "pictures"];
    assert_eq!(files.run(&[&trees[..], &pictures].concat()).status.code(), Some(0));
    for name in ["1-casts.rays-1-two-odf.png", "2-other.rays-2-four-odf.png"] {
        assert!(files.path("pictures").join(name).exists(), "{name}");
    }

    // Each is checked: its scene, its answers, its costs.
    let other = soup(50, 0.3, &mut Random(99));
    files.write("foreign.rays", &rays_bytes(fingerprint(&other), &others, &rejects, 300));
    files.refused(&["two.bvh", "casts.rays", "foreign.rays"], &["foreign.rays", "scene"]);
    files.refused(&["two.bvh", "casts.rays", "four.bvh"], &["four.bvh", "swapped"]);
    files.refused(&["casts.rays", "other.rays"], &["casts.rays", "swapped"]);
    let mut wrong = others.clone();
    let hit = wrong.iter().position(|record| !record.is_occlusion() && record.is_hit()).expect("a hit");
    wrong[hit].t *= 1.01;
    files.write("wrong.rays", &rays_bytes(fingerprint(&files.triangles), &wrong, &rejects, 300));
    let output = files.run(&["two.bvh", "casts.rays", "wrong.rays", "--traversal", "odf"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("ODF over wrong.rays: 1 wrong answers"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn details_tell_levels_and_cache_lines() {
    let files = Files::new();
    let arguments = ["two.bvh", "eight.bvh", "casts.rays", "--details"];
    let report = files.json(&arguments);
    for tree in report["trees"].as_array().expect("trees") {
        assert!(tree["epo"].as_f64() > Some(0.0) && tree["leaf_count_variability"].as_f64() > Some(0.0));
        for order in ["odf", "ray_order"] {
            let run = &tree["traversals"][order];
            let levels = run["by_level"].as_array().expect("levels");
            assert_eq!(levels.len() as u64, number(&tree["depth"]));
            for key in ["box_tests", "node_visits", "primitive_tests"] {
                assert_eq!(levels.iter().map(|level| number(&level[key])).sum::<u64>(), number(&run[key]));
            }
            assert_eq!(number(&levels[0]["box_tests"]), number(&run["queries"]), "each tests the root's box");
            // A node visit reads at most all its children's lines, a primitive test one triangle's.
            let lines = number(&run["cache_lines"]);
            let most = number(&run["box_tests"]) + 2 * number(&run["primitive_tests"]);
            assert!(lines >= number(&run["queries"]) && lines <= most, "{lines}, {most}");
        }
    }
    let plain = files.json(&arguments[..3]);
    assert!(plain["trees"][0]["traversals"]["odf"].get("by_level").is_none());
    let output = files.run(&arguments);
    let table = text(&output.stdout);
    assert!(
        table.contains("cache lines") && table.lines().all(|line| line.chars().count() <= 100),
        "{table}"
    );
}

#[test]
fn times_fits_and_rankings_are_reported() {
    let files = Files::new();
    let trees = ["two.bvh", "four.bvh", "eight.bvh"];
    let report = files.json(&[&trees[..], &["casts.rays", "--fit", "--rounds", "3"]].concat());
    assert_eq!(number(&report["timing"]["queries"]), 3000);
    assert_eq!(number(&report["timing"]["rounds"]), 3);
    let ordered = |time: &Value| {
        let [least, median, greatest] =
            ["least", "seconds", "greatest"].map(|key| time[key].as_f64().expect(key));
        assert!(0.0 < least && least <= median && median <= greatest, "{time}");
        median
    };
    for tree in report["trees"].as_array().expect("trees") {
        for order in ["odf", "ray_order"] {
            let time = &tree["traversals"][order]["time"];
            let total = ordered(time);
            for groups in ["by_kind", "by_purpose"] {
                let parts = time[groups].as_object().expect("groups");
                let sum: f64 = parts.values().map(ordered).sum();
                assert!(sum > 0.3 * total && sum < 3.0 * total, "{sum} of {total}");
            }
        }
    }
    if cfg!(feature = "embree") {
        ordered(&report["embree"]);
        // The recording has rejects, which Embree is not told of.
        let differing = number(&report["embree"]["differing"]);
        assert!((1..=number(&report["embree"]["answers"]["unjudged"])).contains(&differing), "{differing}");
    }
    for fit in report["fit"].as_array().expect("fits") {
        assert!(fit["r_squared"].as_f64().is_none_or(|share| share <= 1.0), "{fit}");
        for key in ["query", "visit", "leaf", "block", "miss"] {
            assert!(fit[key]["ns"].as_f64().is_none_or(|ns| ns >= 0.0), "{fit}");
        }
    }
    // Two kinds of three widths, of ours and of Embree's kernels, where they have room for eight children.
    let fitted = |follower: &str| {
        let fits = report["fit"].as_array().expect("fits").iter();
        fits.filter(|fit| fit["follower"] == follower).count()
    };
    assert_eq!(fitted("ours"), 2 * (3 + 1), "and all widths together");
    assert_eq!(fitted("embree") > 0, cfg!(feature = "embree"));
    assert!(report.get("ranking").is_none(), "three trees have no ranks");
    // What was observed is what was counted, by another part of the program.
    for (place, tree) in report["trees"].as_array().expect("trees").iter().enumerate() {
        for (kind, counted) in tree["traversals"]["odf"]["by_kind"].as_object().expect("kinds") {
            let rows = report["observations"].as_array().expect("observations").iter().filter(|row| {
                row["follower"] == "ours" && place as u64 == row["tree"] && row["kind"] == kind.as_str()
            });
            let rows: Vec<&Value> = rows.collect();
            for key in ["queries", "node_visits", "leaf_visits", "block_tests"] {
                assert_eq!(
                    rows.iter().map(|row| number(&row[key])).sum::<u64>(),
                    number(&counted[key]),
                    "{key}"
                );
            }
            assert!(rows.iter().all(|row| row["seconds"].as_f64() > Some(0.0)));
        }
    }
    let plain = files.json(&["two.bvh", "casts.rays", "--time", "--rounds", "1"]);
    assert!(plain.get("fit").is_none() && plain["timing"].is_object());
    let output =
        files.run(&[&trees[..], &["casts.rays", "--fit", "--rounds", "1", "--html", "r.html"]].concat());
    let table = text(&output.stdout);
    for part in ["Time per query", "Fitted costs", "ranks need five trees or more"] {
        assert!(table.contains(part), "{part}");
    }
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
    assert!(text(&files.read("r.html")).contains("id=\"r1-time\""));
    files.refused(&["two.bvh", "casts.rays", "--time", "--rounds", "0"], &["--rounds"]);
}

/// Where nobody says whether to, times are measured that are measured soon, and fail nothing.
#[test]
fn times_are_there_without_being_asked_for() {
    let files = Files::new();
    let run = |words: &[&str]| {
        let output = files.run_as_given(&[&["two.bvh", "four.bvh"], words].concat());
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let json = |words: &[&str]| -> Value {
        let (code, out, said) = run(&[words, &["--format", "json"]].concat());
        assert_eq!((code, said.as_str()), (Some(0), ""), "{words:?}");
        serde_json::from_str(&out).expect("JSON")
    };
    let timed = json(&["casts.rays"]);
    assert_eq!(number(&timed["timing"]["queries"]), 3000);
    for tree in timed["trees"].as_array().expect("trees") {
        assert!(tree["traversals"]["odf"]["time"]["seconds"].as_f64() > Some(0.0));
        let embree = &tree["time"]["embree"];
        assert!(
            embree["answers"].is_null() && embree["ns"].is_number() == cfg!(feature = "embree"),
            "{embree}"
        );
    }
    assert!(timed["embree"].get("answers").is_none());
    // Without Embree a line says so, else there is nothing to say.
    assert_eq!(timed.get("left_out").is_none(), cfg!(feature = "embree"));
    let plain = json(&["casts.rays", "--no-time"]);
    for key in ["timing", "embree", "left_out"] {
        assert!(plain.get(key).is_none(), "{key}");
    }
    files.write("then.json", plain.to_string().as_bytes());
    json(&["casts.rays", "--baseline", "then.json", "--fail-above", "1.0"]);

    // Embree's kernels, which find the same wrong answer, are not asked for it.
    let (mut records, rejects) = records(&files.triangles, 3000, 5);
    let wrong = records.iter().position(|record| !record.is_occlusion() && record.is_hit()).expect("a hit");
    records[wrong].t *= 1.01;
    files.write("wrong.rays", &rays_bytes(fingerprint(&files.triangles), &records, &rejects, 700));
    let (code, _, said) = run(&["wrong.rays", "--traversal", "odf"]);
    assert_eq!((code, said.lines().count()), (Some(1), 2), "{said}");
    assert!(!said.contains("Embree"), "{said}");

    let (_, table, _) = run(&["casts.rays"]);
    assert!(
        table.contains("Time per query") && table.lines().all(|line| line.chars().count() <= 100),
        "{table}"
    );
    assert_eq!(table.contains("Embree's own: Embree "), cfg!(feature = "embree"), "{table}");
    let (_, csv, _) = run(&["casts.rays", "--traversal", "odf", "--format", "csv"]);
    // Without what is quoted, and may hold commas.
    let fields = |line: &str| line.split('"').step_by(2).collect::<String>().split(',').count();
    let columns = csv.lines().next().map_or(0, fields);
    assert!(csv.lines().all(|line| fields(line) == columns), "{csv}");
    assert!(csv.lines().next().is_some_and(|header| header.ends_with(",rays,ns,ns_least,ns_greatest")));
    let rows = |part: &str| csv.lines().filter(|line| line.contains(part)).count();
    // All, 2 kinds, 3 depths, 3 purposes; Embree's have no depths, and its own trees are two.
    assert_eq!(rows(",odf,"), 2 * 9);
    if cfg!(feature = "embree") {
        assert_eq!(
            (rows(",embree,"), rows("without filters; not what was recorded: the program has filters")),
            (4 * 6, 2 * 6)
        );
    }
    files.refused(&["two.bvh", "casts.rays", "--time", "--no-time"], &["--no-time"]);
}

#[test]
fn five_trees_are_ranked() {
    let files = Files::new();
    let trees = [[2, 1], [2, 4], [4, 3], [8, 1], [8, 6]].map(|[width, max_leaf]| {
        let name = format!("{width}-{max_leaf}.bvh");
        files.write(&name, &bvh_bytes(&files.triangles, width, max_leaf, 7, None));
        name
    });
    let mut words: Vec<&str> = trees.iter().map(String::as_str).collect();
    words.extend(["casts.rays", "--fit", "--rounds", "1"]);
    let report = files.json(&words);
    let ours = &report["ranking"][0];
    assert_eq!((&ours["follower"], number(&ours["trees"])), (&Value::from("ours"), 5));
    assert!(number(&ours["pairs"]) <= 10);
    for key in
        ["cost", "cost_with_misses", "sah_cost", "epo", "leaf_count_variability", "t_r", "gamma_r", "gamma"]
    {
        assert!(ours[key].as_f64().is_none_or(|tau| tau.abs() <= 1.0), "{ours}");
    }
    let table = text(&files.run(&words).stdout);
    assert!(table.contains("Kendall") && !table.contains("ranks need"), "{table}");
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
}

/// Observations whose times follow costs that were made up, of eight-wide trees under Embree's kernels: those costs are fitted and written, and read by
/// `--costs`, for trees of any width, which the kernels follow in the same nodes.
#[test]
fn costs_are_fitted_to_reports_and_read_back() {
    let files = Files::new();
    let truth = |kind: &str| {
        if kind == "occlusion" { [30.0, 5.0, 4.0, 3.0, 11.0] } else { [40.0, 6.0, 9.0, 1.5, 20.0] }
    };
    let report = |name: &str, slower: f64| {
        let mut rows = Vec::new();
        for (tree, kind, part) in (0..6u64)
            .flat_map(|t| ["closest_hit", "occlusion"].map(|k| (t, k)))
            .flat_map(|(t, k)| (0..4u64).map(move |p| (t, k, p)))
        {
            let n = 17 * tree + 5 * part;
            let [visits, leaves, blocks, misses] =
                [1000 + n * 13 % 170, 200 + n * 7 % 50, 300 + n * 29 % 31, n * 11 % 40];
            let [query, visit, leaf, block, miss] = truth(kind);
            let nanoseconds = 100.0 * (query + slower)
                + visit * visits as f64
                + leaf * leaves as f64
                + block * blocks as f64
                + miss * misses as f64;
            rows.push(serde_json::json!({
                "follower": "embree", "tree": tree, "part": part, "kind": kind, "depth": "0", "purpose": "camera", "queries": 100,
                "node_visits": visits, "leaf_visits": leaves, "block_tests": blocks, "misses": misses,
                "seconds": nanoseconds * 1e-9,
            }));
        }
        let trees: Vec<Value> = (0..6).map(|_| serde_json::json!({"max_children": 7})).collect();
        let embree = serde_json::json!({"version": 31305, "isa": "avx2", "structure": "BVH8<triangle4>", "robust": false});
        let report = serde_json::json!({"trees": trees, "observations": rows, "embree": embree});
        files.write(name, report.to_string().as_bytes());
    };
    // The second scene's queries take longer for themselves, which no tree changes.
    report("one.json", 0.0);
    report("two.json", 50.0);
    let output = files.run(&[
        "--fit-reports",
        "one.json",
        "two.json",
        "--fit-costs",
        "costs.json",
        "--format",
        "json",
    ]);
    let said = text(&output.stderr);
    assert_eq!((output.status.code(), said.lines().count()), (Some(0), 1), "{said}");
    assert!(said.contains("Embree's kernels") && !said.contains("by default"), "{said}");
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let written: Value = serde_json::from_slice(&files.read("costs.json")).expect("JSON");
    assert_eq!(written["fitted"]["kernels"], "Embree 3.13.5, avx2, BVH8<triangle4>");
    assert_eq!(written["costs"].as_array().map(Vec::len), Some(2 * 3));
    for entry in written["costs"].as_array().expect("entries") {
        let kind = entry["kind"].as_str().expect("a kind");
        let mut fits = printed["fit"].as_array().expect("fits").iter();
        let fit = fits.find(|fit| fit["kind"] == kind).expect("a fit");
        assert_eq!((number(&fit["width"]), number(&fit["trees"])), (8, 12));
        for (key, value) in ["visit", "leaf", "block", "miss"].into_iter().zip(&truth(kind)[1..]) {
            let of = |json: &Value| json.as_f64().expect(key);
            assert!((of(&entry[key]) - value).abs() < 1e-6, "{entry}");
            assert_eq!(of(&fit[key]["ns"]), of(&entry[key]));
            assert!(of(&entry["standard_errors"][key]) < 1e-6, "{entry}");
        }
    }
    let report =
        files.json(&["eight.bvh", "two.bvh", "casts.rays", "--costs", "costs.json", "--traversal", "odf"]);
    for (tree, constants) in [(0, truth("occlusion")), (1, truth("occlusion"))] {
        let group = &report["trees"][tree]["traversals"]["odf"]["by_kind"]["occlusion"];
        let count = |key: &str| number(&group[key]) as f64;
        let written =
            written["costs"].as_array().expect("entries").iter().find(|entry| entry["kind"] == "occlusion");
        let query = written.expect("it")["query"].as_f64().expect("ns");
        let sum = constants[1] * count("node_visits")
            + constants[2] * count("leaf_visits")
            + constants[3] * count("block_tests");
        let cost = group["cost"].as_f64().expect("a cost");
        assert!((cost - query - sum / count("queries")).abs() < 1e-6 * cost, "{group}");
    }
    let table = text(&files.run(&["--fit-reports", "one.json"]).stdout);
    assert!(
        table.starts_with("Fitted costs") && table.lines().all(|line| line.chars().count() <= 100),
        "{table}"
    );
    files.refused(&["--fit-reports", "casts.rays"], &["casts.rays"]);
    files.write("plain.json", br#"{"trees": [{"max_children": 8}]}"#);
    files.refused(&["--fit-reports", "plain.json"], &["plain.json", "without --fit"]);
    files.refused(&["two.bvh", "casts.rays", "--fit-reports", "one.json"], &["--fit-reports"]);
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
    let allowing = |option: &str, most: &str| {
        let words = ["two.bvh", "four.bvh", "wrong.rays", option, most];
        let output = files.run(&words);
        (output.status.code(), text(&output.stderr))
    };
    assert_eq!(allowing("--allow-wrong", "1").0, Some(0));
    assert_eq!(allowing("--allow-wrong", "0").0, Some(1));
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
    let words = ["two.bvh", "bad.bvh", "casts.rays", "--traversal", "odf"];
    let run = |limit: f64| files.run(&[&words[..], &["--fail-above", &limit.to_string()]].concat());
    let report = files.json(&words);
    let ratio = report["trees"][1]["traversals"]["odf"]["cost_ratio"].as_f64().expect("a ratio");
    let output = run(0.99 * ratio);
    assert_eq!(output.status.code(), Some(1));
    let lines = text(&output.stderr);
    let line = lines.lines().last().expect("a line");
    assert!(line.starts_with("bvh-compare: above the limit: bad.bvh: cost under ODF is "), "{lines}");
    assert_eq!(run(1000.0).status.code(), Some(0));
    // Few leaves are few visits, so this measure says the opposite.
    let by = |metric: &str, limit: &str| {
        let words = ["two.bvh", "bad.bvh", "casts.rays", "--traversal", "odf", "--format", "json"];
        files.run(&[&words[..], &["--rounds", "1", "--fail-metric", metric, "--fail-above", limit]].concat())
    };
    for (metric, fails) in [("gamma", true), ("sah", true), ("visits", false)] {
        let output = by(metric, "1.5");
        assert_eq!(output.status.code(), Some(i32::from(fails)), "{metric}: {}", text(&output.stderr));
        let named = text(&output.stderr).contains(&format!("bad.bvh: {metric} under ODF is "));
        assert_eq!(named, fails, "{metric}: {}", text(&output.stderr));
    }
    let report: Value = serde_json::from_slice(&by("ns", "1e9").stdout).expect("a report");
    assert!(report["trees"][1]["traversals"]["odf"]["time"].is_object(), "{report}");
    files.refused(&["two.bvh", "casts.rays", "--fail-above", "1", "--fail-metric", "tests"], &["cost, ns"]);
    files.refused(&["two.bvh", "casts.rays", "--fail-metric", "ns"], &["--fail-above"]);
    files.refused(&["two.bvh", "casts.rays", "--costs", "casts.rays"], &["casts.rays"]);

    // An earlier report: every tree is held to itself, by name.
    let words = ["two.bvh", "bad.bvh", "casts.rays", "--traversal", "odf", "--format", "json"];
    let report: Value = serde_json::from_slice(&files.run(&words).stdout).expect("a report");
    files.write("then.json", report.to_string().as_bytes());
    let against =
        |limit: &str| files.run(&[&words[..], &["--baseline", "then.json", "--fail-above", limit]].concat());
    let again = against("1.0");
    assert_eq!(again.status.code(), Some(0), "{}", text(&again.stderr));
    let again: Value = serde_json::from_slice(&again.stdout).expect("a report");
    assert_eq!(again["trees"][1]["baseline_cost"], report["trees"][1]["traversals"]["odf"]["cost"]);
    assert_eq!(against("0.99").status.code(), Some(1));
    let output = files.run(&["four.bvh", "casts.rays", "--baseline", "then.json", "--fail-above", "9"]);
    assert!(
        text(&output.stderr).contains("four.bvh: cost is not in the baseline"),
        "{}",
        text(&output.stderr)
    );
    files.refused(&["two.bvh", "casts.rays", "--baseline", "casts.rays"], &["casts.rays"]);
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
