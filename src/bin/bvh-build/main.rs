//! `bvh-build IN.bvh OUT.bvh`: the same triangles, another tree.

mod arguments;
mod machine;
mod order;
mod report;
mod update;

use arguments::Arguments;
use embree_trace::builder::Splits;
use embree_trace::cli::{self, Failure, Outcome};
use embree_trace::files::{MappedFile, OutputFile};
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::format::rays::Rays;
use embree_trace::progress::Progress;
use embree_trace::ranks::{Ranks, gather_all};
use embree_trace::recipe::finish::{Effort, Queries, finish};
use embree_trace::recipe::judge::Scene;
use embree_trace::recipe::{Made, Recipe, RecipeError, auto};
use embree_trace::replay::scene;
use embree_trace::training::Segments;
use embree_trace::training::occlusions::{self, Occlusions};
use embree_trace::training::queries::{self, Query};
use embree_trace::traverse::Prepared;
use embree_trace::traverse::child_order::rule;
use embree_trace::tree::binary::binary;
use order::ordered;
use report::{described, optimization, print};
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// What a recording gives: effective segments, the queries whole for auto, occlusion queries for an order.
#[derive(Default)]
struct Training {
    segments: Segments,
    queries: Vec<Query>,
    occlusions: Occlusions,
}

impl Training {
    /// What a wide tree is finished with.
    fn for_finish(&self) -> Queries<'_> {
        let (all, occlusions) = (self.segments.own.len(), &self.occlusions.training);
        let share = (occlusions.len() as f64 / all.max(1) as f64).min(1.0);
        Queries { segments: &self.segments.own, occlusions, share }
    }
}

/// Tournaments for a tree that is followed by name.
const ROUNDS: usize = 2;

/// Time for auto.
const BUDGET: Duration = Duration::from_secs(30);

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("bvh-build", std::env::args_os());
    // Ranks that ask each other have to ask in the same order.
    let threads = if arguments.mpi { 1 } else { arguments.threads.into() };
    cli::run_on_ranks("bvh-build", arguments.mpi, threads, |ranks| run(&arguments, ranks))
}

fn run(arguments: &Arguments, ranks: &dyn Ranks) -> Result<Outcome, Failure> {
    if let Some(follow) = arguments.follow()? {
        return update::run(arguments, &follow);
    }
    let asked = arguments.recipe();
    asked.check()?;
    let cuts = matches!(asked.builder.splits, Splits::Spatial(_));
    if !cuts && (arguments.max_duplication.is_some() || arguments.overlap.is_some()) {
        return Err(Failure::new("--max-duplication and --overlap are for --splits spatial: add that"));
    }
    if cuts && arguments.no_splits {
        return Err(Failure::new("--splits spatial cuts triangles, and --no-splits forbids it"));
    }
    let shape = arguments.width.map(|width| arguments.shape(width.into())).transpose()?;
    if arguments.is_auto() && !arguments.optimize.is_empty() {
        return Err(Failure::new("--heuristic auto chooses the optimisers itself: leave out --optimize"));
    }
    if arguments.is_auto() && arguments.mpi {
        return Err(Failure::new("--heuristic auto needs all queries in one process: leave out --mpi"));
    }
    let bytes = MappedFile::open(&arguments.input)?;
    let before = Bvh::parse(&bytes).map_err(|error| Failure::in_file(&arguments.input, error))?;
    if arguments.binary && arguments.no_splits && before.header.flags & flag::SPATIAL_SPLITS != 0 {
        return Err(Failure::new(
            "the tree has spatial splits, which --binary keeps and --no-splits forbids",
        ));
    }
    if let Some(width) = arguments.best_width(before.tree) {
        return machine::run(arguments, &before, arguments.shape(width)?);
    }
    if arguments.area_only || arguments.trials.is_some() {
        return Err(Failure::new(
            "--area-only and --trials are for the best tree for the machine: leave out what names a recipe, and give a binary input --width 8",
        ));
    }
    let training = arguments.training(&before, ranks)?;
    let training_queries = training.segments.all;
    let output = (ranks.rank() == 0).then(|| OutputFile::create(&arguments.output)).transpose()?;
    // Nobody builds when the first cannot write.
    gather_all(ranks, ())?;

    let started = Instant::now();
    let (recipe, made, auto) = if arguments.binary {
        (asked, Made { tree: binary(before.tree, before.triangles), optimized: None }, None)
    } else {
        arguments
            .make(&before, &training, ranks)
            .map_err(|error| Failure::in_file(&arguments.input, error))?
    };
    let Made { mut tree, optimized } = made;
    if let Some(shape) = &shape {
        let scene = Scene { triangles: before.triangles, geometries: before.geometries };
        let queries = training.for_finish();
        let effort = Effort { rounds: ROUNDS, deadline: None };
        tree = finish(scene, tree.view(), &queries, shape, &effort)?;
    }
    let seconds = started.elapsed().as_secs_f64();

    let is_cut = !arguments.binary && matches!(recipe.builder.splits, Splits::Spatial(_));
    let mut meta = if arguments.binary { json!({ "binary": true }) } else { recipe.meta() };
    if let Some(shape) = &shape {
        meta["width"] = json!(shape.width);
        meta["max_leaf"] = json!(shape.max_leaf);
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
    scene::inherit(&mut meta, &before, &["image"]);
    let wants_order = arguments.order || (shape.is_none() && !training.occlusions.training.is_empty());
    let in_place = vec![rule::FIRST; if shape.is_some() { tree.nodes.len() } else { 0 }];
    let ordered = wants_order.then(|| {
        let prepared = Prepared::new(tree.view(), before.triangles, before.geometries);
        ordered(&prepared, tree.view(), &training.occlusions, arguments)
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
        order: ordered
            .as_ref()
            .map(|(orders, _)| orders.as_slice())
            .or(shape.is_some().then_some(&in_place[..])),
        meta: Some(&meta.to_string()),
        flags: before.header.flags & kept | if is_cut { flag::SPATIAL_SPLITS } else { 0 },
        producer: &producer,
    };
    let Some(output) = output else { return Ok(Outcome::Good) };
    output.commit_with(|out| bvh::write(out, &contents))?;

    let mut report = json!({
        "triangles": before.triangles.len(),
        "left_out": before.triangles.iter().filter(|triangle| !triangle.is_finite()).count(),
        "references": tree.primitives.len(),
        "training_queries": training_queries,
        "seconds": seconds,
        "threads": rayon::current_num_threads(),
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

impl Arguments {
    /// What the tree is made from: nothing without a recording.
    fn training(&self, bvh: &Bvh, ranks: &dyn Ranks) -> Result<Training, Failure> {
        let Some(path) = &self.rays else { return Ok(Default::default()) };
        let bytes = MappedFile::open(path)?;
        let rays = Rays::parse(&bytes).map_err(|error| Failure::in_file(path, error))?;
        let selection = self.selection();
        let mut training = Training::default();
        if self.is_auto() {
            training.queries =
                queries::read(&selection, &rays, bvh).map_err(|error| Failure::in_file(path, error))?;
            let own: Vec<_> = training.queries.iter().map(|query| query.segment).collect();
            training.segments = Segments { all: own.len(), own };
        } else {
            training.segments =
                selection.read(&rays, bvh, ranks).map_err(|error| Failure::in_file(path, error))?;
        }
        if self.order || self.is_auto() || self.width.is_some() {
            training.occlusions =
                occlusions::read(&selection, &rays, bvh).map_err(|error| Failure::in_file(path, error))?;
        }
        Ok(training)
    }

    /// Makes the tree, and says what auto tried.
    fn make(
        &self,
        bvh: &Bvh,
        training: &Training,
        ranks: &dyn Ranks,
    ) -> Result<(Recipe, Made, Option<Value>), RecipeError> {
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
                cuts: !self.no_splits,
            };
            let chosen = auto::choose(scene, &training.queries, &config)?;
            let report = chosen.report();
            return Ok((chosen.recipe, chosen.made, Some(report)));
        }
        let steps = (bvh.triangles.len() + recipe.stages.len()) as u64;
        let progress = if ranks.rank() == 0 { Progress::new("building", steps) } else { Progress::hidden() };
        let made = recipe.make_on_ranks(bvh.triangles, &training.segments.own, ranks, &progress)?;
        Ok((recipe, made, None))
    }
}
