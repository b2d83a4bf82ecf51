//! `bvh-build IN.bvh OUT.bvh`: the same triangles, another tree.

use clap::Parser;
use clap::ValueEnum;
use embree_trace::builder::{Config, Count, Splits};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::{MappedFile, OutputFile};
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::format::rays::Rays;
use embree_trace::geometry::{Ray, Triangle};
use embree_trace::optimize::{Report, Stage, annealing, insertion, order, reinsertion, rotations};
use embree_trace::progress::Progress;
use embree_trace::recipe::{Heuristic, Made, Recipe, RecipeError, auto};
use embree_trace::replay::select::{Filter, Portion};
use embree_trace::training::Selection;
use embree_trace::training::occlusions::{self, Occlusions};
use embree_trace::training::queries::{self, Query};
use embree_trace::traverse::{Counts, OcclusionOrder, OrderName, Prepared};
use embree_trace::tree::collapse::{self, CollapseError};
use embree_trace::tree::statistics::{Statistics, sah_cost};
use embree_trace::tree::{Tree, TreeView};
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Rebuild the tree of a .bvh from its triangles: a binary tree, greedy from the top, with surface area or recorded rays as
/// the probability that a box is hit, and optimised afterwards when asked.
///
/// The output is the same, byte for byte, for any number of threads.
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  bvh-build embBuilt.bvh ours.bvh                            binned SAH, one triangle a leaf
  bvh-build embBuilt.bvh ours.bvh --splits sweep             every possible cut: slower, better
  bvh-build embBuilt.bvh ours.bvh --splits sweep --alpha 0.88
  bvh-build embBuilt.bvh ours.bvh --splits spatial --optimize reinsertion   the lowest SAH cost
  bvh-build embBuilt.bvh ours.bvh --max-leaf 8               leaves of up to 8 where that lowers the SAH cost
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --heuristic auto   the best tree for these rays that it finds in 30 s
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays       a tree for these rays: blend 0.95
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --splits sweep --optimize rotations
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --train 0.1 --order   and an order for its occlusion queries
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --filter kind=closest --train 0.1
  bvh-build embBuilt.bvh ours.bvh --splits sweep --width 8 --max-leaf 8    up to eight children a node
  bvh-build embBuilt.bvh same.bvh --binary                                 Embree's own tree, made binary

Exit codes: 0 good, 2 bad input or usage."
)]
struct Arguments {
    /// The .bvh whose triangles to build over
    input: PathBuf,
    /// The .bvh to write
    output: PathBuf,
    /// Candidates at each node: binned (min(32, 4 + n/20) bins an axis), binned:N, sweep, or spatial (binned, and planes that cut
    /// triangles)
    #[arg(long, default_value = "binned", value_name = "KIND")]
    splits: Splits,
    /// With --splits spatial: most references that may be added, as a share of the triangles
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    max_duplication: Option<f64>,
    /// With --splits spatial: cut only where the best other split's children overlap in more than this share of the root's area
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    overlap: Option<f64>,
    /// Exponent of the count in a side's cost, count^ALPHA · P
    #[arg(long, default_value_t = 1.0, value_name = "ALPHA", allow_negative_numbers = true)]
    alpha: f64,
    /// The count in a side's cost: n-1 or n
    #[arg(long, default_value = "n-1", value_name = "COUNT")]
    count: Count,
    /// Most triangles in a leaf; above 1, subtrees become leaves where that does not raise the SAH cost
    #[arg(long, default_value_t = 1, value_name = "N")]
    max_leaf: usize,
    /// Cost of a box test, for the SAH cost that is printed and for leaves
    #[arg(long, default_value_t = 1.0, value_name = "COST", allow_negative_numbers = true)]
    ci: f64,
    /// Cost of a triangle test, for the same
    #[arg(long, default_value_t = 1.0, value_name = "COST", allow_negative_numbers = true)]
    cp: f64,
    /// A recording of the scene: its queries are the rays that the tree is for
    #[arg(long, value_name = "RAYS")]
    rays: Option<PathBuf>,
    /// How likely a box is hit: its area, the queries that overlap it, or both; without this, blend where there are rays
    #[arg(long, value_enum)]
    heuristic: Option<Kind>,
    /// Weight of the rays in a blend: 0 is area, 1 is rays
    #[arg(long, default_value_t = 0.95, value_name = "W", allow_negative_numbers = true)]
    weight: f64,
    /// Added to every count of rays (rdh), so that a box without rays still has a cost
    #[arg(long, default_value_t = 0.0, value_name = "RAYS", allow_negative_numbers = true)]
    floor: f64,
    /// Train with these queries only, written as for bvh-compare: purpose=camera+diffuse,depth=1..
    #[arg(long, default_value = "", hide_default_value = true)]
    filter: Filter,
    /// Train with the queries of this share of the pixels; bvh-compare --held-out counts on the others
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = share)]
    train: f64,
    /// Train with at most this many queries, evenly chosen
    #[arg(long, default_value_t = 1 << 20, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 31))]
    train_limit: u64,
    /// The queries of this scene, when the recording holds several
    #[arg(long, default_value_t = 0)]
    scene: u16,
    /// Optimisers to run after the build, in this order, with the same heuristic
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAMES")]
    optimize: Vec<Optimizer>,
    /// Sweeps of annealing, rounds of insertion, batches of reinsertion; 0 is the default of each
    #[arg(long, default_value_t = 0, value_name = "N")]
    iterations: u32,
    /// Optimisers stop after so many seconds from the start of the build, and auto tries no more (30 by default). What they reach in a time
    /// differs from run to run: without it, the same input gives the same tree
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    budget: Option<Duration>,
    /// Choose a traversal order for the occlusion queries of every node from the recorded ones, and store it (section ORDR);
    /// says what they cost in every order, on the training queries and on the others
    #[arg(long, requires = "rays")]
    order: bool,
    /// Build with one triangle a leaf and collapse to at most N children a node and --max-leaf triangles a leaf, at least cost: --ci a
    /// node, --cp four triangles, by area or, where there are any, by the training queries
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=8))]
    width: Option<u8>,
    /// Do not build: make the tree of the input binary, with one triangle a leaf
    #[arg(long, conflicts_with_all = ["rays", "heuristic", "optimize", "width"])]
    binary: bool,
    /// Seed of --train and of the optimisers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads to build with; 0 is one per processor
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// How to print what was built
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Surface area
    Sah,
    /// Number of queries whose effective segments overlap the box
    Rdh,
    /// --weight · rays + (1 - weight) · area
    Blend,
    /// Whichever costs the queries least that a quarter of the training pixels were set apart for: chooses splits, leaves, weight, exponent and
    /// optimisers within --budget, and area alone where rays do not help
    Auto,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Optimizer {
    /// Children and grandchildren exchanged while it pays (Kensler 2008)
    Rotations,
    /// The same with simulated annealing (Kensler 2008)
    Annealing,
    /// Inefficient nodes inserted anew (Bittner et al. 2013)
    Insertion,
    /// Every subtree to its best place, in parallel (Meister and Bittner 2018)
    Reinsertion,
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if share > 0.0 && share <= 1.0 => Ok(share),
        _ => Err("expected a number above 0 and at most 1".into()),
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    seconds.ok_or_else(|| "expected a number of seconds, not negative".into())
}

impl Arguments {
    fn recipe(&self) -> Recipe {
        let kind = self.heuristic.unwrap_or(if self.rays.is_some() { Kind::Blend } else { Kind::Sah });
        let heuristic = match kind {
            // Area alone is the first that it tries.
            Kind::Sah | Kind::Auto => Heuristic::Sah,
            Kind::Rdh => Heuristic::Rdh { floor: self.floor },
            Kind::Blend => Heuristic::Blend { weight: self.weight },
        };
        let mut splits = self.splits;
        if let Splits::Spatial(options) = &mut splits {
            options.max_duplication = self.max_duplication.unwrap_or(options.max_duplication);
            options.overlap = self.overlap.unwrap_or(options.overlap);
        }
        let builder = Config {
            splits,
            alpha: self.alpha,
            count: self.count,
            // Collapsing merges leaves itself, and better where it has the choice.
            max_leaf: if self.width.is_some() { 1 } else { self.max_leaf },
            c_i: self.ci,
            c_p: self.cp,
        };
        let stages = self.optimize.iter().map(|&name| self.stage(name)).collect();
        Recipe { heuristic, builder, stages, budget: self.budget }
    }

    fn stage(&self, optimizer: Optimizer) -> Stage {
        let seed = self.seed;
        let or = |default: usize| if self.iterations == 0 { default } else { self.iterations as usize };
        match optimizer {
            Optimizer::Rotations => Stage::Rotations(rotations::Config::default()),
            Optimizer::Annealing => {
                let default = annealing::Config::default();
                Stage::Annealing(annealing::Config { iterations: or(default.iterations), seed, ..default })
            }
            Optimizer::Insertion => {
                let default = insertion::Config::default();
                Stage::Insertion(insertion::Config { rounds: or(default.rounds), seed, ..default })
            }
            Optimizer::Reinsertion => {
                let default = reinsertion::Config::default();
                Stage::Reinsertion(reinsertion::Config { batches: or(default.batches), ..default })
            }
        }
    }

    /// How to collapse to `width`.
    fn collapsing(&self, width: u8) -> collapse::Config {
        let config = collapse::Config::vector(width.into());
        collapse::Config { max_leaf: self.max_leaf, node: self.ci, block: self.cp, ..config }
    }

    /// The built tree with at most `width` children a node. With training queries a node's probability is as in a blend.
    fn collapsed(
        &self,
        tree: &Tree,
        width: u8,
        triangles: &[Triangle],
        rays: &[Ray],
    ) -> Result<Tree, CollapseError> {
        let config = self.collapsing(width);
        let whole = f64::from(tree.nodes[0].bounds().area()).max(f64::MIN_POSITIVE);
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area()) / whole;
        if rays.is_empty() {
            return collapse::collapse(tree.view(), area, &config);
        }
        let overlaps = Prepared::new(tree.view(), triangles, &[]).overlaps(rays);
        let share = |node: usize| overlaps[node] as f64 / rays.len() as f64;
        let blend = |node: usize| self.weight * share(node) + (1.0 - self.weight) * area(node);
        collapse::collapse(tree.view(), blend, &config)
    }

    fn is_auto(&self) -> bool {
        self.heuristic == Some(Kind::Auto)
    }

    /// What the tree is made from: nothing without a recording.
    fn training(&self, bvh: &Bvh) -> Result<Training, Failure> {
        let Some(path) = &self.rays else { return Ok(Default::default()) };
        let at = |error: &dyn std::fmt::Display| Failure::new(format!("{}: {error}", path.display()));
        let bytes = MappedFile::open(path)?;
        let rays = Rays::parse(&bytes).map_err(|error| at(&error))?;
        let selection = Selection {
            scene: self.scene,
            filter: self.filter.clone(),
            portion: Portion { share: self.train, seed: self.seed },
            most: self.train_limit as usize,
        };
        let mut training = Training::default();
        if self.is_auto() {
            training.queries = queries::read(&selection, &rays, bvh).map_err(|error| at(&error))?;
            training.segments = training.queries.iter().map(|query| query.segment).collect();
        } else {
            training.segments = selection.read(&rays, bvh).map_err(|error| at(&error))?;
        }
        if self.order || self.is_auto() {
            training.occlusions = occlusions::read(&selection, &rays, bvh).map_err(|error| at(&error))?;
        }
        Ok(training)
    }

    /// Makes the tree, and says what auto tried.
    fn make(&self, bvh: &Bvh, training: &Training) -> Result<(Recipe, Made, Option<Value>), RecipeError> {
        let recipe = self.recipe();
        if self.is_auto() {
            let scene = auto::Scene { triangles: bvh.triangles, geometries: bvh.geometries };
            let budget = self.budget.unwrap_or(BUDGET);
            let config = auto::Config {
                budget,
                c_i: self.ci,
                c_p: self.cp,
                // Collapsing makes leaves itself.
                max_leaf: if self.width.is_some() { 1 } else { auto::MAX_LEAF },
            };
            let chosen = auto::choose(scene, &training.queries, &config)?;
            let report = chosen.report();
            return Ok((chosen.recipe, chosen.made, Some(report)));
        }
        let steps = (bvh.triangles.len() + recipe.stages.len()) as u64;
        let progress = Progress::new("building", steps);
        let made = recipe.make(bvh.triangles, &training.segments, &progress)?;
        Ok((recipe, made, None))
    }
}

/// What a recording gives: effective segments, the queries whole for auto, occlusion queries for an order.
#[derive(Default)]
struct Training {
    segments: Vec<Ray>,
    queries: Vec<Query>,
    occlusions: Occlusions,
}

/// Time for auto.
const BUDGET: Duration = Duration::from_secs(30);

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::run("bvh-build", || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let asked = arguments.recipe();
    asked.check()?;
    let cuts = matches!(asked.builder.splits, Splits::Spatial(_));
    if !cuts && (arguments.max_duplication.is_some() || arguments.overlap.is_some()) {
        return Err(Failure::new("--max-duplication and --overlap are for --splits spatial: add that"));
    }
    if let Some(width) = arguments.width {
        arguments.collapsing(width).check()?;
    }
    if arguments.is_auto() && !arguments.optimize.is_empty() {
        return Err(Failure::new("--heuristic auto chooses the optimisers itself: leave out --optimize"));
    }
    let in_input =
        |error: &dyn std::fmt::Display| Failure::new(format!("{}: {error}", arguments.input.display()));
    let bytes = MappedFile::open(&arguments.input)?;
    let before = Bvh::parse(&bytes).map_err(|error| in_input(&error))?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads.into()).build()?;
    let training = pool.install(|| arguments.training(&before))?;
    let training_queries = training.segments.len();
    let mut output = OutputFile::create(&arguments.output)?;

    let started = Instant::now();
    let (recipe, made, auto) = if arguments.binary {
        (asked, Made { tree: collapse::binary(before.tree, before.triangles), optimized: None }, None)
    } else {
        pool.install(|| arguments.make(&before, &training)).map_err(|error| in_input(&error))?
    };
    let Made { mut tree, optimized } = made;
    if let Some(width) = arguments.width {
        tree = arguments.collapsed(&tree, width, before.triangles, &training.segments)?;
    }
    let seconds = started.elapsed().as_secs_f64();

    let is_cut = !arguments.binary && matches!(recipe.builder.splits, Splits::Spatial(_));
    let mut meta = if arguments.binary { json!({ "binary": true }) } else { recipe.meta() };
    if let Some(width) = arguments.width {
        meta["width"] = json!(width);
        meta["max_leaf"] = json!(arguments.max_leaf);
    }
    if let Some(auto) = &auto {
        meta["auto"] = auto.clone();
    }
    if recipe.heuristic.needs_rays() || auto.is_some() {
        meta["training"] = json!({
            "queries": training_queries, "filter": arguments.filter.to_string(), "train": arguments.train, "seed": arguments.seed,
        });
    }
    // Where the image's size is known, it stays known.
    let recorded = before.meta.and_then(|meta| serde_json::from_str::<Value>(meta).ok());
    if let Some(image) = recorded.as_ref().and_then(|meta| meta.get("image")) {
        meta["image"] = image.clone();
    }
    let wants_order = arguments.order || !training.occlusions.training.is_empty();
    let ordered = wants_order.then(|| {
        let prepared = Prepared::new(tree.view(), before.triangles, before.geometries);
        pool.install(|| ordered(&prepared, tree.view(), &training.occlusions, arguments))
    });
    let kept = flag::FLATTENED | if arguments.binary { flag::SPATIAL_SPLITS } else { 0 };
    let mut producer = recipe.builder.producer(recipe.heuristic.name());
    if arguments.binary {
        producer = "bvh-build binary".into();
    }
    let contents = Contents {
        tree: tree.view(),
        triangles: before.triangles,
        geometries: before.geometries,
        order: ordered.as_ref().map(|(orders, _)| orders.as_slice()),
        meta: Some(&meta.to_string()),
        flags: before.header.flags & kept | if is_cut { flag::SPATIAL_SPLITS } else { 0 },
        producer: &producer,
    };
    bvh::write(&mut output, &contents).map_err(|error| output.write_error(error))?;
    output.commit()?;

    let mut report = json!({
        "triangles": before.triangles.len(),
        "left_out": before.triangles.iter().filter(|triangle| !triangle.is_finite()).count(),
        "references": tree.primitives.len(),
        "training_queries": training_queries,
        "seconds": seconds,
        "threads": pool.current_num_threads(),
        "build": meta,
        "before": described(before.tree, &recipe.builder),
        "after": described(tree.view(), &recipe.builder),
    });
    if let Some(optimized) = &optimized {
        report["optimized"] = optimization(optimized);
    }
    if let Some((_, order)) = ordered {
        report["order"] = order;
    }
    print(&report, arguments.format)?;
    Ok(Outcome::Good)
}

/// What each optimiser did to T, in its own measure (the root's P is about 1), step by step.
fn optimization(report: &Report) -> Value {
    let stages: Vec<Value> = report
        .stages
        .iter()
        .map(|stage| {
            json!({
                "name": stage.stage.name(),
                "undone": stage.undone,
                "moves": stage.steps.last().map_or(0, |step| step.moves),
                "cost": stage.steps.iter().map(|step| step.cost).collect::<Vec<f64>>(),
            })
        })
        .collect();
    json!({ "before": report.before, "after": report.after, "stages": stages })
}

/// The order of every node, and what occlusion queries cost in it and in every other.
fn ordered(
    prepared: &Prepared,
    tree: TreeView,
    queries: &Occlusions,
    arguments: &Arguments,
) -> (Vec<u8>, Value) {
    let config = order::Config { c_i: arguments.ci, c_p: arguments.cp, ..Default::default() };
    let started = Instant::now();
    let chosen = order::choose(prepared, tree.nodes.len(), &queries.training, &config);
    let seconds = started.elapsed().as_secs_f64();
    let mut report = json!({
        "training": queries.training.len(), "held_out": queries.held_out.len(), "deciding": chosen.deciding,
        "rounds": chosen.rounds, "seconds": seconds,
    });
    let counts = |counts: Counts| {
        json!({
            "node_visits": counts.node_visits, "box_tests": counts.box_tests, "primitive_tests": counts.primitive_tests,
        })
    };
    for (side, queries) in [("costs_training", &queries.training), ("costs_held_out", &queries.held_out)] {
        for name in OrderName::ALL {
            // Every name but `recorded` fits every tree, and that was made for this one.
            if let Ok(order) = OcclusionOrder::new(Some(name), tree, Some(&chosen.orders)) {
                report[side][name.key()] = counts(order::measure(prepared, &order, queries));
            }
        }
        report[side]["limit"] = counts(order::limit(prepared, queries));
    }
    (chosen.orders, report)
}

/// What a tree looks like, in the names of `bvh-compare`.
fn described(tree: TreeView, config: &Config) -> Value {
    let Statistics { nodes, leaves, depth, max_children, max_leaf } = Statistics::of(tree);
    let sah_cost = sah_cost(tree, config.c_i, config.c_p);
    json!({
        "nodes": nodes, "leaves": leaves, "depth": depth, "max_children": max_children, "max_leaf": max_leaf,
        "sah_cost": sah_cost,
    })
}

fn print(report: &Value, format: TextOrJson) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if format == TextOrJson::Json {
        return writeln!(out, "{report:#}");
    }
    writeln!(
        out,
        "{} triangles in {:.3} s, {} left out (vertices that are not finite)",
        report["triangles"],
        report["seconds"].as_f64().unwrap_or_default(),
        report["left_out"],
    )?;
    if report["training_queries"] != 0 {
        writeln!(out, "{} training queries", report["training_queries"])?;
    }
    print_trials(&mut out, &report["build"]["auto"])?;
    if let Some(stages) = report["optimized"]["stages"].as_array() {
        let mut cost = report["optimized"]["before"].as_f64().unwrap_or_default();
        for stage in stages {
            let after = stage["cost"].as_array().and_then(|costs| costs.last()?.as_f64()).unwrap_or(cost);
            let name = stage["name"].as_str().unwrap_or_default();
            writeln!(out, "{name}: {} moves, T from {cost:.4} to {after:.4} per query", stage["moves"])?;
            cost = after;
        }
    }
    writeln!(out, "{:<12}{:>10}{:>12}", "", "before", "after")?;
    for name in ["nodes", "leaves", "depth", "max_children", "max_leaf"] {
        let value = |tree: &str| report[tree][name].to_string();
        writeln!(out, "{:<12}{:>10}{:>12}", name.replace('_', " "), value("before"), value("after"))?;
    }
    print_order(&mut out, &report["order"])?;
    let cost = |tree: &str| report[tree]["sah_cost"].as_f64().unwrap_or_default();
    writeln!(out, "{:<12}{:>10.2}{:>12.2}", "SAH cost", cost("before"), cost("after"))
}

/// What auto tried: a line for each recipe, with what it costs a judging query and what that is of area alone.
fn print_trials(out: &mut impl Write, auto: &Value) -> std::io::Result<()> {
    let Some(trials) = auto["trials"].as_array().filter(|trials| !trials.is_empty()) else { return Ok(()) };
    writeln!(
        out,
        "{} judging queries: each\n{:<40}{:>10}{:>10}{:>10}",
        auto["judges"], "", "fitted to", "cost", "ratio"
    )?;
    let cost = |trial: &Value| trial["cost"].as_f64().unwrap_or_default();
    for (index, trial) in trials.iter().enumerate() {
        let recipe = &trial["recipe"];
        let mut name = recipe["heuristic"].as_str().unwrap_or_default().to_owned();
        if let Some(weight) = recipe["weight"].as_f64() {
            name += &format!(" {weight}");
        }
        if let Some(alpha) = recipe["alpha"].as_f64().filter(|&alpha| alpha != 1.0) {
            name += &format!(" alpha {alpha}");
        }
        for stage in recipe["optimize"].as_array().into_iter().flatten() {
            name += &format!(" + {}", stage.as_str().unwrap_or_default());
        }
        let chosen = if auto["winner"] == index { "  chosen" } else { "" };
        let ratio = cost(trial) / cost(&trials[0]);
        writeln!(
            out,
            "{name:<40}{:>10}{:>10.2}{ratio:>10.3}{chosen}",
            trial["queries"].to_string(),
            cost(trial)
        )?;
    }
    Ok(())
}

/// A line for each order: what an occlusion query costs in it, and what that is of nearest first.
fn print_order(out: &mut impl Write, order: &Value) -> std::io::Result<()> {
    for (side, count, name) in [
        ("costs_training", "training", "training occlusion queries"),
        ("costs_held_out", "held_out", "held-out occlusion queries"),
    ] {
        let queries = order[count].as_u64().unwrap_or_default();
        if queries == 0 {
            continue;
        }
        writeln!(out, "{queries} {name}: each\n{:<12}{:>10}{:>12}{:>10}", "", "visits", "box+prim", "ratio")?;
        let costs = &order[side];
        let number = |name: &str, key: &str| costs[name][key].as_u64().unwrap_or_default() as f64;
        let tests = |name: &str| number(name, "box_tests") + number(name, "primitive_tests");
        for name in OrderName::ALL.map(OrderName::key).into_iter().chain(["limit"]) {
            let (visits, tests, ratio) =
                (number(name, "node_visits"), tests(name), tests(name) / tests("nearest"));
            let each = queries as f64;
            writeln!(out, "{name:<12}{:>10.2}{:>12.2}{ratio:>10.3}", visits / each, tests / each)?;
        }
    }
    Ok(())
}
