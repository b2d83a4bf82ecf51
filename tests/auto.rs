//! `--heuristic auto`: what it chooses is what counts least, it is never worse than area alone, and no recording harms it.

mod compare_support;

use compare_support::files::{rays_bytes, records, tree_bytes};
use compare_support::*;
use embree_trace::builder::Splits;
use embree_trace::cost::Costs;
use embree_trace::format::bvh::{self, Bvh, Contents, fingerprint};
use embree_trace::format::rays::{Purpose, Rays, Record, flag};
use embree_trace::geometry::{Ray, Triangle, Vec3};
use embree_trace::progress::Progress;
use embree_trace::recipe::auto::{self, Chosen, Scene};
use embree_trace::recipe::finish::{self, Shape};
use embree_trace::recipe::{Heuristic, Recipe, RecipeError, best, judge};
use embree_trace::replay::query::Choice;
use embree_trace::replay::select::{Filter, Portion};
use embree_trace::training::Selection;
use embree_trace::training::queries::Query;
use embree_trace::traverse::{All, Counts, OcclusionOrder, Prepared, PreparedRay, Scratch, Traversal};
use embree_trace::tree::Tree;
use std::process::{Command, Output};
use std::time::Duration;

/// Closest-hit queries that end at their hits, a quarter of them judges.
fn queries(triangles: &[Triangle], rays: &[Ray]) -> Vec<Query> {
    let tree = random_tree(triangles, 2, 1, &mut Random(2));
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let mut scratch = Scratch::default();
    let mut query = |(number, &ray): (usize, &Ray)| {
        let hit = prepared.closest_hit(Traversal::Odf, &PreparedRay::new(&ray), &All, &mut (), &mut scratch);
        Query {
            ray,
            segment: Ray { tfar: hit.map_or(ray.tfar, |hit| hit.t), ..ray },
            is_occlusion: number % 3 == 0,
            mask: u32::MAX,
            rejects: Box::default(),
            judges: number % 4 == 0,
        }
    };
    rays.iter().enumerate().map(&mut query).collect()
}

/// A file with the tree is valid. Spatial splits put a triangle in several leaves.
fn verify(tree: &Tree, triangles: &[Triangle]) {
    let contents = Contents {
        tree: tree.view(),
        triangles,
        geometries: &[],
        order: None,
        meta: None,
        flags: bvh::flag::SPATIAL_SPLITS,
        producer: "test",
    };
    let mut bytes = Vec::new();
    bvh::write(&mut bytes, &contents).expect("written to memory");
    Bvh::parse(&bytes).and_then(|bvh| bvh.verify()).expect("a valid tree");
}

fn choose(triangles: &[Triangle], queries: &[Query], seconds: u64) -> Result<Chosen, RecipeError> {
    choose_with(triangles, queries, seconds, true)
}

fn choose_with(
    triangles: &[Triangle],
    queries: &[Query],
    seconds: u64,
    cuts: bool,
) -> Result<Chosen, RecipeError> {
    let budget = Duration::from_secs(seconds);
    let config = auto::Config { budget, c_i: 1.0, c_p: 1.0, max_leaf: auto::MAX_LEAF, cuts };
    auto::choose(Scene { triangles, geometries: &[] }, queries, &config)
}

/// Box and primitive tests of the judging queries, each.
fn cost(tree: &Tree, triangles: &[Triangle], queries: &[Query]) -> f64 {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let (mut counts, mut scratch, mut judges) = (Counts::default(), Scratch::default(), 0);
    for query in queries.iter().filter(|query| query.judges) {
        let ray = PreparedRay::new(&query.ray);
        judges += 1;
        if query.is_occlusion {
            prepared.occluder(Traversal::Odf, &ray, &All, &mut counts, &mut scratch);
        } else {
            prepared.closest_hit(Traversal::Odf, &ray, &All, &mut counts, &mut scratch);
        }
    }
    (counts.box_tests + counts.primitive_tests) as f64 / f64::from(judges)
}

/// What is no triangle ended a ray: the judges ask it up to there, as `bvh-compare` does, and meet
/// nothing that stands behind.
#[test]
fn rays_end_at_what_is_no_triangle() {
    let wall = Triangle([Vec3::new(-9.0, -9.0, 5.0), Vec3::new(9.0, -9.0, 5.0), Vec3::new(0.0, 9.0, 5.0)]);
    let triangles = [wall];
    let tree = random_tree(&triangles, 2, 1, &mut Random(1));
    let file = tree_bytes(&triangles, &tree, None);
    let bvh = Bvh::parse(&file).expect("valid");
    // Along z from the origin: the wall is met at 5, a curve was met at 2.
    let record = Record {
        tfar: f32::INFINITY,
        direction: Vec3::Z,
        mask: u32::MAX,
        t: 2.0,
        triangle: u32::MAX,
        flags: flag::HIT | flag::UNDECIDED,
        ..bytemuck::Zeroable::zeroed()
    };
    let rays = rays_bytes(fingerprint(&triangles), &[record], &[], 1);
    let rays = Rays::parse(&rays).expect("valid");
    let portion = Portion { share: 1.0, seed: 1 };
    let selection = Selection { scene: None, filter: Filter::default(), portion, most: 9 };
    let read = embree_trace::training::queries::read(&selection, &rays, &bvh).expect("a query");
    let prepared = Prepared::new(bvh.tree, bvh.triangles, bvh.geometries);
    let hit = |ray: &Ray| {
        let (ray, mut scratch) = (PreparedRay::new(ray), Scratch::default());
        prepared.closest_hit(Traversal::Odf, &ray, &All, &mut (), &mut scratch).map(|hit| hit.t)
    };
    assert_eq!(hit(&record.ray()), Some(5.0), "as it was asked, it would go on to the wall");
    assert_eq!((read.len(), read[0].ray.tfar, hit(&read[0].ray)), (1, 2.0, None));
    let choice = Choice { scene: 0, filter: Filter::default(), held_out: None, sample: None };
    let mut compared = Vec::new();
    choice
        .for_each_chunk(&rays, |queries| compared.extend(queries.iter().map(|query| query.ray)))
        .expect("valid");
    assert_eq!(compared, [read[0].ray]);
}

/// Rays that cross the scene in one direction only: the case for trees from rays.
fn beam(count: usize) -> Vec<Ray> {
    let mut random = Random(7);
    (0..count)
        .map(|_| {
            let (from, to) = (random.vector() * 0.1, random.vector() * 0.1);
            let direction = to - from + Vec3::X * 3.0;
            Ray { origin: from - Vec3::X * 2.0, tnear: 0.0, direction, tfar: 10.0 }
        })
        .collect()
}

#[test]
fn the_cheapest_trial_wins_and_its_cost_is_what_a_traversal_counts() {
    let triangles = soup(600, 0.3, &mut Random(1));
    let queries = queries(&triangles, &beam(2000));
    let chosen = choose(&triangles, &queries, 600).expect("queries");
    let winner = &chosen.trials[chosen.winner.expect("judged")];
    let full = chosen.trials.iter().filter(|trial| trial.recipe.stages.len() > 1);
    assert!(full.clone().count() == 6 && full.clone().all(|trial| trial.cost >= winner.cost));
    assert!(
        winner.recipe.heuristic.needs_rays() && winner.cost < 0.95 * chosen.trials[0].cost,
        "{:?}",
        chosen.trials
    );
    let fit: Vec<Ray> = queries.iter().filter(|query| !query.judges).map(|query| query.segment).collect();
    assert_eq!(chosen.queries, fit.len());

    // Followed by hand, the winner costs what was said.
    let recipe: &Recipe = &winner.recipe;
    let made = recipe.make(&triangles, &fit, &Progress::hidden()).expect("valid");
    assert!((cost(&made.tree, &triangles, &queries) - winner.cost).abs() < 1e-9);
    let area = chosen.trials[0].recipe.make(&triangles, &[], &Progress::hidden()).expect("valid");
    assert!((cost(&area.tree, &triangles, &queries) - chosen.trials[0].cost).abs() < 1e-9);
    assert!((cost(&chosen.made.tree, &triangles, &queries) - winner.cost).abs() < 1e-9);
    verify(&chosen.made.tree, &triangles);
}

/// Where triangles may not be cut, each stands in one leaf.
#[test]
fn without_cuts_every_triangle_stands_once() {
    // Long and thin: with cuts, they are cut.
    let triangles = soup(300, 2.0, &mut Random(5));
    let queries = queries(&triangles, &beam(500));
    let cut = choose(&triangles, &queries, 600).expect("queries").made.tree;
    let whole = choose_with(&triangles, &queries, 600, false).expect("queries");
    assert!(cut.primitives.len() > triangles.len());
    assert_eq!(whole.made.tree.primitives.len(), triangles.len());
    assert!(whole.trials.iter().all(|trial| matches!(trial.recipe.builder.splits, Splits::Sweep)));
    let different = whole.trials.iter().map(|trial| (trial.cost.to_bits(), trial.queries));
    assert_eq!(different.collect::<std::collections::HashSet<_>>().len(), whole.trials.len());
    verify(&whole.made.tree, &triangles);
}

#[test]
fn any_number_of_threads_chooses_the_same() {
    let triangles = soup(300, 0.3, &mut Random(3));
    let queries = queries(&triangles, &beam(500));
    let trees = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| choose(&triangles, &queries, 600)).expect("queries").made.tree
    });
    assert!(trees.iter().all(|tree| *tree == trees[0]));
}

#[test]
fn without_time_or_judges_it_is_the_area_tree() {
    let triangles = soup(300, 0.3, &mut Random(3));
    let mut queries = queries(&triangles, &beam(200));
    let chosen = choose(&triangles, &queries, 0).expect("queries");
    assert!(chosen.trials.is_empty() && !chosen.recipe.heuristic.needs_rays());
    verify(&chosen.made.tree, &triangles);
    queries.iter_mut().for_each(|query| query.judges = false);
    let chosen = choose(&triangles, &queries, 60).expect("queries");
    assert!(chosen.trials.is_empty() && !chosen.recipe.heuristic.needs_rays());
    assert_eq!(choose(&triangles, &[], 60).err(), Some(RecipeError::NoRays("auto")));
}

/// A tree of eight children a node, as a program has.
fn wide_input(triangles: &[Triangle]) -> Tree {
    random_tree(triangles, 8, 4, &mut Random(9))
}

/// Costs of what a traversal counts alone.
fn without_misses() -> Costs {
    let entry =
        |kind: &str| format!(r#"{{"width": 8, "kind": "{kind}", "visit": 6, "leaf": 7, "block": 2}}"#);
    let json = format!(r#"{{"costs": [{}, {}]}}"#, entry("closest_hit"), entry("occlusion"));
    Costs::parse(&json).expect("costs")
}

fn best_with(
    triangles: &[Triangle],
    queries: &[Query],
    change: impl Fn(&mut best::Config),
) -> Result<best::Chosen, RecipeError> {
    let shape = Shape { width: 8, max_leaf: finish::MAX_LEAF, costs: without_misses() };
    let budget = Duration::from_secs(600);
    let mut config = best::Config { shape, budget, trials: usize::MAX, area_only: false, cuts: true };
    change(&mut config);
    let (scene, tree) = (judge::Scene { triangles, geometries: &[] }, wide_input(triangles));
    let input = best::Input { tree: tree.view(), order: OcclusionOrder::Last, is_cut: false };
    best::choose(scene, input, queries, &config, &Progress::hidden())
}

/// Nanoseconds of every other judging query, followed one by one in the order of the file.
fn nanoseconds(tree: &Tree, triangles: &[Triangle], queries: &[Query], odd: usize) -> f64 {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let (costs, mut scratch, mut sum, mut count) = (without_misses(), Scratch::default(), 0.0, 0);
    for query in queries.iter().filter(|query| query.judges).skip(odd).step_by(2) {
        let ray = PreparedRay::new(&query.ray);
        let mut counts = Counts::default();
        if query.is_occlusion {
            prepared.occluder_in(&OcclusionOrder::First, &ray, &All, &mut counts, &mut scratch);
        } else {
            prepared.closest_hit(Traversal::Odf, &ray, &All, &mut counts, &mut scratch);
        }
        let constants = costs.of(8, query.is_occlusion);
        sum += constants.visit * counts.node_visits as f64
            + constants.leaf * counts.leaf_visits as f64
            + constants.block * counts.block_tests as f64;
        count += 1;
    }
    sum / f64::from(count)
}

#[test]
fn the_tree_for_the_machine_is_the_cheapest_tried_by_what_a_traversal_counts() {
    let triangles = soup(300, 0.3, &mut Random(1));
    let queries = queries(&triangles, &beam(1600));
    let chosen = best_with(&triangles, &queries, |_| ()).expect("queries");
    let winner = &chosen.trials[chosen.winner.expect("judged")];
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9 * b;
    assert!(near(nanoseconds(&chosen.tree, &triangles, &queries, 0), winner.cost));
    let after = chosen.after.all.expect("confirmed");
    assert!(near(nanoseconds(&chosen.tree, &triangles, &queries, 1), after));
    let [before, area] = [chosen.before, chosen.area].map(|cost| cost.all.expect("confirmed"));
    assert!(after <= area && after < 0.9 * before, "{after} {area} {before}");
    verify(&chosen.tree, &triangles);
    let whole = best_with(&triangles, &queries, |config| config.cuts = false).expect("queries");
    assert_eq!((whole.tree.primitives.len(), whole.is_cut), (triangles.len(), false));
    let control = best_with(&triangles, &queries, |config| config.area_only = true).expect("queries");
    let by_area =
        |start: best::Start| matches!(start, best::Start::Input | best::Start::Built(Heuristic::Sah, ..));
    assert!(control.trials.iter().all(|trial| by_area(trial.plan.start)));
}

#[test]
fn more_time_for_the_machines_tree_means_more_trials_never_others() {
    let triangles = soup(200, 0.3, &mut Random(2));
    let queries = queries(&triangles, &beam(800));
    let plans = |chosen: &best::Chosen| -> Vec<(best::Plan, u64)> {
        chosen.trials.iter().map(|trial| (trial.plan, trial.cost.to_bits())).collect()
    };
    let on = |threads: usize, budget: Duration| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| best_with(&triangles, &queries, |config| config.budget = budget)).expect("queries")
    };
    let all = on(1, Duration::from_secs(600));
    let also = on(3, Duration::from_secs(600));
    assert_eq!((&all.tree, plans(&all)), (&also.tree, plans(&also)));
    for budget in [0, 20, 100].map(Duration::from_millis) {
        let some = on(1, budget);
        assert!(!some.trials.is_empty() && plans(&all).starts_with(&plans(&some)));
        let least =
            |chosen: &best::Chosen| chosen.trials.iter().map(|t| t.cost).fold(f64::INFINITY, f64::min);
        assert!(least(&all) <= least(&some));
    }
    assert_eq!(on(1, Duration::ZERO).trials.len(), 1);
}

/// With one trial more, and one more: the tree never costs the judges more than before, followed
/// one by one, nor more than the best from area.
#[test]
fn more_trials_never_give_a_tree_that_is_worse_for_the_judges() {
    let triangles = soup(150, 0.3, &mut Random(2));
    for (rays, count) in [(beam(600), 600), (beam(40), 40), (rays(&triangles, 300, &mut Random(8)), 300)] {
        let queries = queries(&triangles, &rays);
        let judges = queries.iter().filter(|query| query.judges).count();
        assert_eq!(judges, count / 4);
        let total = |tree: &Tree| {
            let halves = [judges.div_ceil(2), judges / 2].map(|half| half as f64);
            let costs = [0, 1].map(|odd| nanoseconds(tree, &triangles, &queries, odd));
            (halves[0] * costs[0] + halves[1] * costs[1]) / judges as f64
        };
        let after = |trials: usize, area_only: bool| {
            let change = |config: &mut best::Config| (config.trials, config.area_only) = (trials, area_only);
            let chosen = best_with(&triangles, &queries, change).expect("queries");
            assert!(chosen.trials.len() <= trials);
            (total(&chosen.tree), chosen.trials.len())
        };
        let costs: Vec<f64> = (1..=22).map(|trials| after(trials, false).0).collect();
        assert!(costs.is_sorted_by(|a, b| *b <= a * (1.0 + 1e-12)), "{costs:?}");
        // The first trial is area's.
        assert!(costs[21] <= costs[0] && after(1, true).0 == costs[0]);
    }
}

#[test]
fn queries_of_little_use_give_the_machine_a_tree_all_the_same() {
    let triangles = soup(100, 0.3, &mut Random(3));
    let few = |change: fn(&mut Query)| {
        let mut queries = queries(&triangles, &beam(400));
        queries.iter_mut().for_each(change);
        queries
    };
    for queries in [
        few(|query| query.is_occlusion = false),
        few(|query| query.is_occlusion = true),
        few(|query| query.judges = false),
        few(|query| query.judges = true),
        few(|query| query.segment.tfar = -1.0),
        few(|query| query.ray.direction = Vec3::ZERO),
        Vec::new(),
    ] {
        let chosen = best_with(&triangles, &queries, |_| ()).expect("a tree");
        verify(&chosen.tree, &triangles);
        let [before, after] = [chosen.before.all, chosen.after.all];
        assert!(after <= before, "{after:?} {before:?}");
    }
    for count in 0..4 {
        let triangles = soup(count, 0.3, &mut Random(4));
        verify(&best_with(&triangles, &[], |_| ()).expect("a tree").tree, &triangles);
    }
}

/// Records of a program that refused nothing.
fn accepted(triangles: &[Triangle], count: usize) -> Vec<Record> {
    let (mut records, _) = records(triangles, count, 5);
    records.iter_mut().for_each(|record| record.flags &= !flag::HAS_REJECTS);
    records
}

struct Files {
    directory: tempfile::TempDir,
}

impl Files {
    fn new(triangles: &[Triangle], records: &[Record], scene: u64) -> Files {
        Files::around(random_tree(triangles, 2, 1, &mut Random(12)), triangles, records, scene)
    }

    /// With a tree as a program has it.
    fn wide(triangles: &[Triangle], records: &[Record], scene: u64) -> Files {
        Files::around(wide_input(triangles), triangles, records, scene)
    }

    fn around(tree: Tree, triangles: &[Triangle], records: &[Record], scene: u64) -> Files {
        let directory = tempfile::tempdir().expect("a temporary directory");
        std::fs::write(directory.path().join("in.bvh"), tree_bytes(triangles, &tree, None)).expect("written");
        let rays = rays_bytes(scene, records, &[], 700);
        std::fs::write(directory.path().join("casts.rays"), rays).expect("written");
        Files { directory }
    }

    fn build(&self, line: &str) -> Output {
        self.run(&format!("in.bvh out.bvh --rays casts.rays --heuristic auto --budget 60 {line}"))
    }

    fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_bvh-build"))
            .args(line.split_whitespace())
            .current_dir(self.directory.path())
            .output()
            .expect("runs")
    }
}

#[test]
fn the_command_says_what_it_chose_and_stores_it() {
    let triangles = soup(400, 0.25, &mut Random(11));
    let files = Files::new(&triangles, &accepted(&triangles, 3000), fingerprint(&triangles));
    let output = files.build("--train 0.5");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(
        text.contains("judging queries")
            && text.contains("chosen")
            && text.contains("blend 0.95 + rotations"),
        "{text}"
    );
    let bytes = std::fs::read(files.directory.path().join("out.bvh")).expect("written");
    let bvh = Bvh::parse(&bytes).expect("valid");
    let meta: serde_json::Value = serde_json::from_str(bvh.meta.expect("META")).expect("JSON");
    assert!(
        meta["auto"]["trials"].as_array().is_some_and(|trials| [13, 15].contains(&trials.len())),
        "{meta}"
    );
    assert_eq!(bvh.order.map(<[u8]>::len), Some(bvh.tree.nodes.len()));
}

#[test]
fn what_the_command_makes_of_a_wide_tree_is_for_the_machine() {
    let triangles = soup(400, 0.25, &mut Random(11));
    let files = Files::wide(&triangles, &accepted(&triangles, 3000), fingerprint(&triangles));
    let path = |name: &str| files.directory.path().join(name);
    let good = |line: &str| -> (String, Vec<usize>) {
        let output = files.run(line);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let bytes = std::fs::read(path("out.bvh")).expect("written");
        let bvh = Bvh::parse(&bytes).expect("valid");
        bvh.verify().expect("a valid tree");
        assert!(bvh.order.is_some_and(|order| order.iter().all(|&rule| rule == 1)));
        assert_eq!(bvh.statistics.max_children, 8);
        let leaves = bvh.tree.nodes.iter().filter(|node| node.is_leaf()).map(|node| node.len());
        (String::from_utf8_lossy(&output.stdout).into_owned(), leaves.collect())
    };
    let (said, _) = good("in.bvh out.bvh --rays casts.rays --train 0.5 --budget 60");
    assert!(said.contains("chosen") && said.contains("expected of other queries"), "{said}");
    let (report, _) = good("in.bvh out.bvh --rays casts.rays --train 0.5 --budget 60 --format json");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let cost = |tree: &str| report["build"]["auto"]["cost"][tree]["all"].as_f64().expect("confirmed");
    assert!(cost("tree") < cost("input") && cost("tree") <= cost("area"), "{report}");
    good("in.bvh out.bvh");
    good("in.bvh out.bvh --width 8 --splits sweep --rays casts.rays");
    // Where visits cost next to nothing, leaves are small, where blocks do, large.
    let sizes = ["1000", "0.001"].map(|block| {
        let entry = |kind: &str| {
            format!(r#"{{"width": 8, "kind": "{kind}", "visit": 1, "leaf": 1, "block": {block}}}"#)
        };
        let costs = format!(r#"{{"costs": [{}, {}]}}"#, entry("closest_hit"), entry("occlusion"));
        std::fs::write(path("costs.json"), costs).expect("written");
        let (_, leaves) = good("in.bvh out.bvh --costs costs.json");
        leaves.iter().sum::<usize>() as f64 / leaves.len() as f64
    });
    assert!(sizes[0] < 4.1 && sizes[1] > 8.0, "{sizes:?}");
    std::fs::remove_file(path("out.bvh")).expect("there");
    for (costs, expected) in [(r#"{"costs": []}"#, "there is no entry"), ("no JSON", "not a file of costs")] {
        std::fs::write(path("costs.json"), costs).expect("written");
        let output = files.run("in.bvh out.bvh --costs costs.json");
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains("costs.json") && error.contains(expected), "{error}");
        assert!(error.lines().count() == 1 && !path("out.bvh").exists(), "{error}");
    }
}

#[test]
fn recordings_of_no_use_give_a_line_or_the_area_tree() {
    let triangles = soup(200, 0.25, &mut Random(11));
    let good = accepted(&triangles, 400);
    let with = |change: fn(&mut Record)| -> Vec<Record> {
        let mut records = good.clone();
        records.iter_mut().for_each(change);
        records
    };
    let scene = fingerprint(&triangles);
    for records in [
        with(|record| (record.origin, record.tfar) = (Vec3::splat(100.0), 1e-3)),
        with(|record| (record.origin, record.direction) = (Vec3::splat(0.5), Vec3::X)),
        with(|record| record.direction = Vec3::ZERO),
        with(|record| (record.tnear, record.tfar) = (f32::INFINITY, f32::INFINITY)),
        with(|record| record.tfar = f32::INFINITY),
    ] {
        for files in [Files::new, Files::wide] {
            let output = files(&triangles, &records, scene).build("");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
    }
    let refused = |files: &Files, line: &str, expected: &str| {
        let output = files.build(line);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(expected) && error.lines().count() == 1, "{error}");
        assert!(!files.directory.path().join("out.bvh").exists());
    };
    let files = Files::new(&triangles, &good, scene);
    refused(&files, "--filter path=4000000000", "no query is left to train with");
    refused(&files, "--optimize rotations", "leave out --optimize");
    refused(&files, "--alpha -1", "alpha is -1");
    refused(&files, "--ci -1", "c_I is -1");
    refused(&files, "--train 0", "above 0");
    refused(&Files::new(&triangles, &[], scene), "", "the recording is empty");
    refused(&Files::new(&triangles, &good, scene ^ 1), "", "of scene");
}

/// Builds with JSON; what auto says of it.
fn best_report(files: &Files, line: &str) -> serde_json::Value {
    let output = files.run(&format!("in.bvh out.bvh --rays casts.rays --format json {line}"));
    assert_eq!(output.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    let bytes = std::fs::read(files.directory.path().join("out.bvh")).expect("written");
    let bvh = Bvh::parse(&bytes).expect("valid");
    bvh.verify().expect("a valid tree");
    assert!(bvh.statistics.max_children <= 8);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    report["build"].clone()
}

/// No tree from area that was tried is cheaper by what chooses: queries, or area where no query
/// judges. And none by what confirms.
fn no_worse_than_area(build: &serde_json::Value) {
    let auto = &build["auto"];
    let trials = auto["trials"].as_array().expect("trials");
    let by_area = build["area_only"] == true;
    let is_area = |trial: &&serde_json::Value| by_area || trial["plan"]["heuristic"] == "sah";
    let cost = |trial: &serde_json::Value| trial["cost"].as_f64().expect("a cost");
    let area = trials.iter().filter(is_area).map(cost).fold(f64::INFINITY, f64::min);
    assert!(area.is_finite() && trials.iter().all(|trial| cost(trial).is_finite()), "{auto}");
    let Some(winner) = auto["winner"].as_u64() else {
        assert_eq!(auto["judges"], 0);
        return;
    };
    let chosen = &trials[winner as usize];
    assert_eq!(auto["plan"], chosen["plan"]);
    // Of all judges: those that choose, and those that confirm.
    let [choosing, confirming] = ["judges", "confirming"].map(|key| auto[key].as_f64().expect(key));
    let total = |cost: f64, tree: &str| {
        let confirmed = auto["cost"][tree]["all"].as_f64().unwrap_or_default();
        (choosing * cost + confirming * confirmed) / (choosing + confirming)
    };
    assert!(total(cost(chosen), "tree") <= total(area, "area") * (1.0 + 1e-12), "{auto}");
}

/// Recordings that say little, with time for one tree and for all of them.
#[test]
fn recordings_that_say_little_give_a_tree_no_worse_than_area() {
    let triangles = soup(120, 0.25, &mut Random(11));
    let scene = fingerprint(&triangles);
    let all = accepted(&triangles, 900);
    let only = |accepts: &dyn Fn(&Record) -> bool| -> Vec<Record> {
        all.iter().filter(|record| accepts(record)).copied().collect()
    };
    // As a program would have recorded it: answered by a loop over all triangles, of which each
    // sees all.
    let towards = |direction: Vec3| -> Vec<Record> {
        let mut random = Random(3);
        let aimed = |(path, kind): (u32, u8)| {
            let origin = random.vector() - 3.0 * direction;
            let ray = Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY };
            let hits = triangles.iter().enumerate().filter_map(|(index, triangle)| {
                let hit = exact(&ray, triangle)?;
                (hit.margin >= 0.0 && hit.t > 0.0).then_some((index as u32, hit.t as f32))
            });
            let nearest = hits.min_by(|a, b| a.1.total_cmp(&b.1));
            let (triangle, t) = nearest.unwrap_or((u32::MAX, f32::INFINITY));
            let occluded = kind == 1 && nearest.is_some();
            Record {
                origin,
                direction,
                tfar: f32::INFINITY,
                mask: u32::MAX,
                t: if occluded { f32::NEG_INFINITY } else { t },
                triangle: if kind == 1 { u32::MAX } else { triangle },
                path,
                kind,
                flags: nearest.map_or(0, |_| flag::HIT),
                ..bytemuck::Zeroable::zeroed()
            }
        };
        (0..600).map(|path| (path, (path % 3 == 0) as u8)).map(aimed).collect()
    };
    let few = |count: usize| all[..count].to_vec();
    for (what, records) in [
        ("closest hits alone", only(&|record| !record.is_occlusion())),
        ("occlusions alone", only(&Record::is_occlusion)),
        ("misses alone", only(&|record| !record.is_hit())),
        ("one direction", towards(Vec3::new(0.6, -0.7, 0.4))),
        ("along an axis", towards(Vec3::X)),
        ("against an axis", towards(-Vec3::Y)),
        ("along an axis, with a zero below zero", towards(Vec3::new(-0.0, 0.0, 1.0))),
        ("one query", few(1)),
        ("two queries", few(2)),
        ("ten queries", few(10)),
        ("one query, again and again", vec![all[0]; 500]),
    ] {
        let files = Files::wide(&triangles, &records, scene);
        for line in ["--budget 0", "--budget 60", "--budget 60 --no-splits"] {
            let build = best_report(&files, line);
            assert_eq!(build["training"]["queries"], records.len(), "{what}");
            no_worse_than_area(&build);
            let trials = build["auto"]["trials"].as_array().map_or(0, Vec::len);
            assert_eq!(trials == 1, line == "--budget 0", "{what}: {trials}");
        }
    }
    let files = Files::wide(&triangles, &[], scene);
    let output = files.run("in.bvh out.bvh --rays casts.rays");
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("the recording is empty") && error.lines().count() == 1, "{error}");
    assert!(!files.directory.path().join("out.bvh").exists());
}

/// Costs that no tree can be chosen by are one line, wherever they are read.
#[test]
fn costs_of_no_use_are_one_line() {
    let triangles = soup(60, 0.25, &mut Random(11));
    let files = Files::wide(&triangles, &accepted(&triangles, 50), fingerprint(&triangles));
    let path = |name: &str| files.directory.path().join(name);
    let entry = |change: &str, to: &str| {
        let entry =
            r#"{"costs": [{"width": 8, "kind": "occlusion", "visit": 6.1, "leaf": 7.7, "block": 2.0}]}"#;
        assert!(entry.contains(change), "{change}");
        entry.replace(change, to)
    };
    let toml =
        "[[costs]]\nwidth = 8\nkind = \"occlusion\"\nvisit = 6.1\nleaf = 7.7\nblock = 2.0\n".to_owned();
    for (costs, expected) in [
        (entry("6.1", "0"), "costs[0].visit is 0"),
        (entry("7.7", "0.0"), "costs[0].leaf is 0"),
        (entry("2.0", "-0.0"), "costs[0].block is -0"),
        (entry("2.0", "-2"), "costs[0].block is -2"),
        (entry("2.0", "1e300"), "costs[0].block is 1"),
        (entry("2.0", "1e999"), "not a file of costs"),
        (entry("2.0", "NaN"), "not a file of costs"),
        (entry("2.0", "\"2\""), "not a file of costs"),
        (entry(r#", "block": 2.0"#, ""), "missing field `block`"),
        (entry(r#""width": 8, "#, ""), "missing field `width`"),
        (entry("occlusion", "shadow"), "shadow"),
        (entry("8", "16"), "has width 16"),
        (entry("8", "-8"), "not a file of costs"),
        (entry("]}", "]"), "not a file of costs"),
        (toml, "not a file of costs"),
        (String::new(), "not a file of costs"),
        ("null".to_owned(), "not a file of costs"),
        ("[".repeat(100_000), "not a file of costs"),
    ] {
        std::fs::write(path("costs.json"), &costs).expect("written");
        let output = files.run("in.bvh out.bvh --rays casts.rays --costs costs.json");
        let error = String::from_utf8_lossy(&output.stderr);
        let shown = &costs[..costs.len().min(200)];
        assert_eq!(output.status.code(), Some(2), "{shown}: {error}");
        assert!(error.contains("costs.json") && error.contains(expected), "{shown}: {error}");
        assert!(error.lines().count() == 1 && !path("out.bvh").exists(), "{shown}: {error}");
    }
    for costs in ["missing.json", ".", "in.bvh"] {
        let output = files.run(&format!("in.bvh out.bvh --rays casts.rays --costs {costs}"));
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(costs) && error.lines().count() == 1, "{error}");
    }
    // The least and the most that are accepted make a tree like any other.
    for value in ["1e-300", "1e9"] {
        let costs =
            ["6.1", "7.7", "2.0"].iter().fold(entry("8", "8"), |costs, old| costs.replace(old, value));
        std::fs::write(path("costs.json"), costs).expect("written");
        no_worse_than_area(&best_report(&files, "--costs costs.json --budget 60"));
    }
}

/// The control: as many trials, none of which is fitted to rays, and the same queries judge it.
#[test]
fn the_control_tries_area_alone_as_often() {
    let triangles = soup(300, 0.3, &mut Random(1));
    let files = Files::wide(&triangles, &accepted(&triangles, 2000), fingerprint(&triangles));
    let ours = best_report(&files, "--budget 600");
    let control = best_report(&files, "--budget 600 --area-only");
    let trials = |build: &serde_json::Value| build["auto"]["trials"].as_array().expect("trials").clone();
    let is_first_part = |trial: &&serde_json::Value| trial["plan"]["part"] == 0;
    let [of_rays, of_area] =
        [&ours, &control].map(|build| trials(build).iter().filter(is_first_part).count());
    assert!(of_area.abs_diff(of_rays) <= 2, "{of_area} trials for {of_rays}");
    assert_eq!(of_area, trials(&control).len());
    let by_area = |plan: &serde_json::Value| plan["heuristic"] == "sah" || plan["start"] == "input";
    assert!(trials(&control).iter().all(|trial| by_area(&trial["plan"])), "{control}");
    let plans: std::collections::HashSet<String> =
        trials(&control).iter().map(|trial| trial["plan"].to_string()).collect();
    assert_eq!(plans.len(), of_area, "none is tried twice");
    assert_eq!((&control["area_only"], &ours["area_only"]), (&true.into(), &false.into()));
    assert_eq!(control["auto"]["judges"], ours["auto"]["judges"]);
    assert_eq!(control["auto"]["cost"]["tree"], control["auto"]["cost"]["area"]);
    no_worse_than_area(&control);

    let refused = |files: &Files, line: &str, expected: &str| {
        let output = files.run(&format!("in.bvh other.bvh --area-only {line}"));
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert!(error.contains(expected) && error.lines().count() == 1, "{error}");
    };
    refused(&files, "", "--rays");
    refused(&files, "--rays casts.rays --splits sweep", "leave out what names a recipe");
    let few = best_report(&files, "--budget 600 --trials 3");
    assert_eq!(few["auto"]["trials"].as_array().expect("trials"), &trials(&ours)[..3]);
    let binary = Files::new(&triangles, &accepted(&triangles, 100), fingerprint(&triangles));
    refused(&binary, "--rays casts.rays", "--width 8");
}

/// A tree for one purpose is fitted to its queries, judged by them, and says so.
#[test]
fn a_tree_for_one_purpose_sees_no_other_queries() {
    let triangles = soup(150, 0.25, &mut Random(11));
    let scene = fingerprint(&triangles);
    let mut records = accepted(&triangles, 1500);
    let camera = Purpose::Camera as u8;
    let files = Files::wide(&triangles, &records, scene);
    let build = best_report(&files, "--budget 600 --filter purpose=camera");
    let tree = std::fs::read(files.directory.path().join("out.bvh")).expect("written");
    let auto = &build["auto"];
    let count = records.iter().filter(|record| record.purpose == camera).count();
    assert_eq!(build["training"]["queries"], count);
    assert!(auto["judges"].as_u64().is_some_and(|judges| 0 < judges && 2 * judges < count as u64), "{auto}");
    assert!(auto["cost"]["tree"]["occlusion"].is_null() && auto["cost"]["tree"]["closest_hit"].is_f64());
    no_worse_than_area(&build);
    // Whatever the others ask, the tree is the same, byte for byte.
    for record in records.iter_mut().filter(|record| record.purpose != camera) {
        record.origin += Vec3::splat(50.0);
    }
    let others = Files::wide(&triangles, &records, scene);
    assert_eq!(best_report(&others, "--budget 600 --filter purpose=camera"), build);
    assert!(std::fs::read(others.directory.path().join("out.bvh")).expect("written") == tree);
    let output = files.run("in.bvh out.bvh --rays casts.rays --filter purpose=camera --budget 0");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("expected of other queries with purpose=camera"), "{said}");
}
