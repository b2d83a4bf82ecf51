//! `bvh-build built.bvh ours.bvh [--rays casts.rays]` with nothing else: the best tree for the machine, as wide as the input's.

use crate::arguments::Arguments;
use crate::report::{described, print};
use embree_trace::builder;
use embree_trace::cli::{Failure, Outcome};
use embree_trace::files::{MappedFile, OutputFile};
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Rays;
use embree_trace::progress::Progress;
use embree_trace::recipe::best::{self, Config};
use embree_trace::recipe::finish::Shape;
use embree_trace::training::queries::{self, Query};
use serde_json::json;
use std::time::{Duration, Instant};

/// Time for all of it, where nothing else is asked for.
const BUDGET: Duration = Duration::from_secs(30);

pub fn run(arguments: &Arguments, before: &Bvh, shape: Shape) -> Result<Outcome, Failure> {
    let queries = training(arguments, before)?;
    let output = OutputFile::create(&arguments.output)?;
    let started = Instant::now();
    let config = Config {
        shape,
        budget: arguments.budget.unwrap_or(BUDGET),
        trials: arguments.trials.unwrap_or(usize::MAX),
        area_only: arguments.area_only,
        cuts: !arguments.no_splits,
    };
    let progress = Progress::new("trying recipes", best::TRIALS);
    let mut built = best::build(before, &queries, &config, &progress)
        .map_err(|error| Failure::in_file(&arguments.input, error))?;
    drop(progress);
    let seconds = started.elapsed().as_secs_f64();
    built.meta["training"] = json!({
        "queries": queries.len(), "filter": arguments.filter.to_string(), "train": arguments.train,
        "seed": arguments.seed,
    });
    output.commit_with(|out| built.write(before, out))?;
    let tree = &built.chosen.tree;
    let costs = builder::Config { c_i: arguments.ci, c_p: arguments.cp, ..builder::Config::default() };
    let report = json!({
        "triangles": before.triangles.len(),
        "left_out": before.triangles.iter().filter(|triangle| !triangle.is_finite()).count(),
        "references": tree.primitives.len(),
        "training_queries": queries.len(),
        "seconds": seconds,
        "threads": rayon::current_num_threads(),
        "build": built.meta,
        "before": described(before.tree, &costs),
        "after": described(tree.view(), &costs),
    });
    print(&report, arguments.format)?;
    Ok(Outcome::Good)
}

/// The training queries; none without a recording.
fn training(arguments: &Arguments, bvh: &Bvh) -> Result<Vec<Query>, Failure> {
    let Some(path) = &arguments.rays else { return Ok(Vec::new()) };
    let bytes = MappedFile::open(path)?;
    let rays = Rays::parse(&bytes).map_err(|error| Failure::in_file(path, error))?;
    queries::read(&arguments.selection(), &rays, bvh).map_err(|error| Failure::in_file(path, error))
}
