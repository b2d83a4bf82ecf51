//! The experiments end to end: the paper's figure against an independent re-run, the command line, traces, bad input.

use embree_trace::experiment::shape::Shape;
use embree_trace::experiment::{Settings, blend, published, shapes, summary};
use std::path::Path;
use std::process::{Command, Output};

/// Spread over trials of the re-run, standard deviation / mean, the largest over focus.
fn spread(shape: Shape, focus: f64) -> f64 {
    let (at_0, at_middle, at_1) = match shape {
        Shape::Sphere => (0.18, 0.05, 0.02),
        Shape::Hemisphere => (0.12, 0.03, 0.01),
        Shape::Plane => (0.04, 0.014, 0.006),
        Shape::Tube => (0.40, 0.40, 0.40),
    };
    if focus < 0.2 {
        at_0
    } else if focus < 0.9 {
        at_middle + (at_0 - at_middle) * (0.4 - focus).max(0.0)
    } else {
        at_1
    }
}

/// Trials of the re-run.
const AGAIN: f64 = 40.0;

#[test]
fn figure_1_comes_out_as_published() {
    let settings = Settings { quick: true, seed: 1, trials: 10 };
    let rows = shapes::run(&settings, false).unwrap();
    for shape in Shape::ALL {
        let again = published::shapes_again(shape);
        let of = |weight: f64| {
            let rows = rows.iter().filter(move |row| row.experiment == shape.name() && row.weight == weight);
            rows.map(|row| (row.focus, row.cost.box_tests as f64 / 1e4)).collect::<Vec<_>>()
        };
        let (area, full) = (of(0.0), of(1.0));
        for (weight, values, expected) in [(0.0, &area, again.area), (1.0, &full, again.rays)] {
            for (point, expected) in summary(values.iter().copied()).into_iter().zip(expected) {
                // Ten trials estimate their own spread badly: the larger of both estimates counts.
                let sd = spread(shape, point.x) * expected;
                let ours = point.error.max(sd / (settings.trials as f64).sqrt());
                let limit = 3.0 * ours.hypot(sd / AGAIN.sqrt()) + 0.005 * expected;
                let (mean, name) = (point.mean, shape.name());
                assert!(
                    (mean - expected).abs() < limit,
                    "{name} at focus {}, weight {weight}: {mean} against {expected} ± {limit}",
                    point.x
                );
            }
        }
        // Each trial against itself: rays bring what they bring in the paper.
        let ratios = area.iter().zip(&full).map(|(area, full)| (area.0, full.1 / area.1));
        for (point, index) in summary(ratios).into_iter().zip(0..) {
            let expected = again.rays[index] / again.area[index];
            let limit = (0.05 * expected).max(4.0 * point.error);
            let difference = (point.mean - expected).abs();
            assert!(
                difference < limit,
                "{} at focus {}: {} against {expected}",
                shape.name(),
                point.x,
                point.mean
            );
            assert!(point.mean < 1.0);
        }
    }
}

#[test]
fn optimised_trees_cost_no_more_than_greedy_ones_on_every_shape_and_focus() {
    let settings = Settings { quick: true, seed: 2, trials: 1 };
    let rows = shapes::run(&settings, true).unwrap();
    assert_eq!(rows.len(), 3 * Shape::ALL.len() * published::FOCI.len());
    for trial in rows.chunks(3) {
        let [area, full, optimized] = trial else { unreachable!("three trees a trial") };
        assert_eq!(area.cost.rays, optimized.cost.rays);
        assert!(optimized.experiment.starts_with(full.experiment));
        // Where all rays take one way, both may be the best there is.
        assert!(optimized.cost.box_tests <= full.cost.box_tests, "{full:?} {optimized:?}");
    }
    let cost = |tree: usize| rows.iter().skip(tree).step_by(3).map(|row| row.cost.t_r).sum::<u64>();
    assert!(cost(2) < cost(1));
}

#[test]
fn the_blend_goes_from_area_to_rays_and_its_ends_are_those_of_figure_1() {
    let settings = Settings { quick: true, seed: 3, trials: 2 };
    let rows = blend::run(&settings).unwrap();
    let ends = shapes::run(&settings, false).unwrap();
    for row in &rows {
        if let Some(end) = ends.iter().find(|end| {
            end.experiment == "sphere"
                && (end.focus, end.trial, end.weight) == (row.focus, row.trial, row.weight)
        }) {
            assert_eq!(row.cost.rays, end.cost.rays);
            let ratio = row.cost.t_r as f64 / end.cost.t_r as f64;
            assert!((ratio - 1.0).abs() < 0.03, "{row:?} {end:?}");
        }
    }
    let mean = |weight: f64| {
        let costs: Vec<f64> =
            rows.iter().filter(|row| row.weight == weight).map(|row| row.cost.t_r as f64).collect();
        costs.iter().sum::<f64>() / costs.len() as f64
    };
    let means = published::WEIGHTS.map(mean);
    assert!(means.is_sorted_by(|a, b| *a > 0.99 * b), "more rays, less cost: {means:?}");
}

fn run(arguments: &[&str], directory: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bvh-experiment"));
    command.args(arguments).current_dir(directory).output().unwrap()
}

/// Runs what must be refused: exit code 2, one line, no panic.
fn refused(arguments: &[&str], directory: &Path) -> String {
    let output = run(arguments, directory);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
    text
}

#[test]
fn saved_traces_feed_the_other_experiments_and_bad_input_is_refused_in_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let output = run(&["blend", "--quick", "--trials", "1", "--save", "traces", "--out", "out"], here);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let csv = std::fs::read_to_string(here.join("out/blend.csv")).unwrap();
    assert!(csv.starts_with("experiment,focus,trial,weight,bvh_cost,rays,t_r\nblend,0,0,0,"), "{csv}");
    for row in csv.lines().skip(1) {
        let cells: Vec<u64> = row.split(',').skip(4).map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(cells[0], cells[1] + 2 * cells[2], "BVH cost = rays + 2 T_R: {row}");
    }

    let scene = "traces/sphere-0.2.bvh";
    for arguments in
        [vec!["alpha", scene], vec!["traversal", scene], vec!["static-cost", scene], vec!["scenes", "traces"]]
    {
        let arguments = [arguments, vec!["--quick", "--out", "out"]].concat();
        let output = run(&arguments, here);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        for path in String::from_utf8(output.stdout).unwrap().lines().filter(|line| line.starts_with("out")) {
            assert!(here.join(path).metadata().unwrap().len() > 100, "{path}");
        }
    }

    let other = ["alpha", scene, "--rays", "traces/sphere-0.4.rays"];
    assert!(run(&other, here).status.success(), "the same sphere, other rays: the same scene");
    std::fs::write(here.join("empty.rays"), b"").unwrap();
    std::fs::copy(here.join("traces/sphere-0.rays"), here.join("cut.rays")).unwrap();
    std::fs::OpenOptions::new().write(true).open(here.join("cut.rays")).unwrap().set_len(100).unwrap();
    for (arguments, expected) in [
        (vec!["alpha", "missing.bvh"], "missing.bvh"),
        (vec!["alpha", "traces/sphere-0.rays", "--rays", scene], "swapped"),
        (vec!["alpha", scene, "--rays", "empty.rays"], "empty"),
        (vec!["alpha", scene, "--rays", "cut.rays"], "no queries"),
        (vec!["sampling", scene, "--queries", "100"], "too few"),
        (vec!["scenes", "out"], "record scenes there"),
    ] {
        let text = refused(&arguments, here);
        assert!(text.contains(expected) && text.trim_end().lines().count() == 1, "{arguments:?}: {text}");
    }
    for arguments in [
        vec!["shapes", "--trials", "0"],
        vec!["alpha", scene, "--queries", "0"],
        vec!["optimum", "--triangles", "15"],
        vec!["optimum", "--scenes", "0"],
        vec![],
    ] {
        refused(&arguments, here);
    }
}

/// Whoever trains with a tenth of the pixels has the same ones: `bvh-experiment` and `bvh-build
/// --train`.
#[test]
fn pixels_are_parted_as_everywhere() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let output = run(&["blend", "--quick", "--trials", "1", "--save", "traces", "--out", "out"], here);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    std::fs::create_dir(here.join("one")).unwrap();
    for extension in ["bvh", "rays"] {
        let from = here.join(format!("traces/sphere-0.2.{extension}"));
        std::fs::copy(from, here.join(format!("one/sphere.{extension}"))).unwrap();
    }
    for seed in ["1", "2", "77"] {
        let queries = u64::MAX.to_string();
        let words = ["scenes", "one", "--quick", "--seed", seed, "--queries", &queries, "--out", "out"];
        let output = run(&words, here);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let csv = std::fs::read_to_string(here.join("out/scenes.csv")).unwrap();
        let cells: Vec<&str> = csv.lines().nth(1).unwrap().split(',').collect();
        let built = Command::new(env!("CARGO_BIN_EXE_bvh-build"))
            .args(["one/sphere.bvh", "ours.bvh", "--rays", "one/sphere.rays"])
            .args(["--train", "0.1", "--seed", seed, "--format", "json"])
            .current_dir(here)
            .output()
            .unwrap();
        let report: serde_json::Value = serde_json::from_slice(&built.stdout).unwrap();
        assert_eq!(report["training_queries"].to_string(), cells[12], "seed {seed}: {csv}");
        // What the recorded tree costs the others is what `bvh-compare` says.
        let compared = Command::new(env!("CARGO_BIN_EXE_bvh-compare"))
            .args([
                "one/sphere.bvh",
                "one/sphere.rays",
                "--held-out",
                "0.1",
                "--seed",
                seed,
                "--format",
                "json",
            ])
            .arg("--no-time")
            .current_dir(here)
            .output()
            .unwrap();
        let report: serde_json::Value = serde_json::from_slice(&compared.stdout).unwrap();
        let cost = report["trees"][0]["traversals"]["odf"]["cost"].as_f64().unwrap();
        assert!((cells[2].parse::<f64>().unwrap() - cost).abs() < 1e-3, "{cost}: {csv}");
    }
    // Of 3,000 pixels, the seed draws none for about one query.
    let text = refused(&["scenes", "one", "--queries", "1", "--seed", "3", "--out", "out"], here);
    assert!(text.contains("--queries"), "{text}");
    // A single query is on one side.
    let few = Command::new(env!("CARGO_BIN_EXE_trace-convert"))
        .args(["traces/sphere-0.2.rays", "one/sphere.rays", "--sample", "1"])
        .current_dir(here)
        .output()
        .unwrap();
    assert!(few.status.success());
    let text = refused(&["scenes", "one", "--out", "out"], here);
    assert!(text.contains("1 queries are of 1 pixels") && text.contains("--seed"), "{text}");
    assert!(!text.contains("at least 2"), "{text}");
}

#[test]
fn the_optimum_is_below_every_heuristic_and_auto_is_near_it() {
    let directory = tempfile::tempdir().unwrap();
    let output = run(&["optimum", "--quick", "--out", "out"], directory.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let row = |tree: &str| -> Vec<f64> {
        let row = text.lines().find(|line| line.starts_with(&format!("| {tree} |"))).expect("a row");
        row.trim_matches('|').split('|').skip(1).map(|cell| cell.trim().parse().unwrap()).collect()
    };
    assert!(row("auto")[0] <= 2.0, "{text}");
    assert_eq!(row("the optimum for the rays")[..4], [0.0; 4]);
    assert_eq!(row("the optimum for area")[4..], [0.0; 4]);
    // Seven nodes at a time are nearly all of ten.
    assert!(row("SAH sweep + treelets")[4] < row("SAH sweep")[4], "{text}");
    let csv = std::fs::read_to_string(directory.path().join("out/optimum.csv")).unwrap();
    assert!(csv.starts_with("scene,tree,t_r,least_t_r,t_u,least_t_u\n0,SAH binned,"), "{csv}");
    for name in ["out/optimum.svg", "out/optimum.png"] {
        assert!(directory.path().join(name).metadata().unwrap().len() > 100, "{name}");
    }
}
