//! `bvh-build FRAME.bvh OUT.bvh --update METHOD PREVIOUS.bvh`: the tree of the frame before, brought to the triangles of this one.

use crate::arguments::{Arguments, Follow};
use crate::report::{described, print};
use embree_trace::cli::{Failure, Outcome};
use embree_trace::files::{MappedFile, OutputFile};
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::format::rays::Rays;
use embree_trace::geometry::Ray;
use embree_trace::ranks::Alone;
use embree_trace::recipe::{Heuristic, Recipe};
use embree_trace::replay::scene;
use embree_trace::update::Moving;
use embree_trace::update::policy::{Policy, State};
use serde_json::{Value, json};
use std::time::Instant;

pub fn run(arguments: &Arguments, follow: &Follow) -> Result<Outcome, Failure> {
    let recipe = arguments.recipe();
    recipe.check()?;
    let [bytes, bytes_before] = [MappedFile::open(&arguments.input)?, MappedFile::open(&follow.previous)?];
    let frame = Bvh::parse(&bytes).map_err(|error| Failure::in_file(&arguments.input, error))?;
    let previous = Bvh::parse(&bytes_before).map_err(|error| Failure::in_file(&follow.previous, error))?;
    Moving::check_frame(previous.triangles, frame.triangles)
        .map_err(|error| Failure::in_file(&arguments.input, error))?;
    let rays = segments(arguments, &previous)?;
    let output = OutputFile::create(&arguments.output)?;

    // What the steps before left for this one.
    let before = previous.meta.and_then(|meta| serde_json::from_str::<Value>(meta).ok()).unwrap_or_default();
    let cost_when_built = before["update"]["cost_when_built"].as_f64();
    let moving = Moving::new(previous.tree).map_err(|error| Failure::in_file(&follow.previous, error))?;
    let mut state = State { moving, cost_when_built };
    let heuristic =
        if recipe.heuristic.needs_rays() && rays.is_empty() { Heuristic::Sah } else { recipe.heuristic };
    let policy =
        Policy { method: follow.method, limit: arguments.limit, recipe: Recipe { heuristic, ..recipe } };
    let started = Instant::now();
    let step = policy.step(&mut state, frame.triangles, &rays);
    let step = step.map_err(|error| Failure::in_file(&follow.previous, error))?;
    let seconds = started.elapsed().as_secs_f64();
    let cost_when_built = state.cost_when_built;
    let tree = state.moving.tree();

    let frames = before["update"]["frames_since_build"].as_u64().unwrap_or(0) + 1;
    let mut meta = json!({
        "update": {
            "method": follow.method.name(), "limit": arguments.limit, "rebuilt": step.rebuilt, "rotations": step.rotations,
            "frames_since_build": if step.rebuilt { 0 } else { frames }, "cost": step.cost, "cost_when_built": cost_when_built,
            "previous": format!("{:016x}", previous.header.fingerprint), "rays": rays.len(),
        },
    });
    // What is known of the frame itself stays known.
    scene::inherit(&mut meta, &frame, &["image", "frame"]);
    let contents = Contents {
        tree: tree.view(),
        triangles: frame.triangles,
        geometries: frame.geometries,
        order: None,
        meta: Some(&meta.to_string()),
        flags: frame.header.flags & flag::FLATTENED,
        producer: &format!("bvh-build update {}", follow.method.name()),
    };
    output.commit_with(|out| bvh::write(out, &contents))?;
    let report = json!({
        "triangles": frame.triangles.len(),
        "left_out": frame.triangles.iter().filter(|triangle| !triangle.is_finite()).count(),
        "references": tree.primitives.len(),
        "training_queries": rays.len(),
        "seconds": seconds,
        "threads": rayon::current_num_threads(),
        "build": meta,
        "before": described(previous.tree, &policy.recipe.builder),
        "after": described(tree.view(), &policy.recipe.builder),
    });
    print(&report, arguments.format)?;
    Ok(Outcome::Good)
}

/// Effective segments of the frame before.
fn segments(arguments: &Arguments, previous: &Bvh) -> Result<Vec<Ray>, Failure> {
    let Some(path) = &arguments.rays else { return Ok(Vec::new()) };
    let bytes = MappedFile::open(path)?;
    let rays = Rays::parse(&bytes).map_err(|error| Failure::in_file(path, error))?;
    Ok(arguments
        .selection()
        .read(&rays, previous, &Alone)
        .map_err(|error| Failure::in_file(path, error))?
        .own)
}
