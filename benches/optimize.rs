//! Optimisers on one thread: rotations and reinsertion, on area and on 32,768 rays.
//!
//! Scenes come from `$EMBREE_TRACE_SCENES` or `../shared/scenes` when they are there, and are generated otherwise. Rays
//! connect points of random triangles: as many as there are, through the whole scene, which is the hardest case for ray lists.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use embree_trace::builder::{self, Splits};
use embree_trace::geometry::{Ray, Triangle};
use embree_trace::mesh::{self, generate};
use embree_trace::optimize::measure::{AreaMeasure, Estimate, Measure, RayMeasure};
use embree_trace::optimize::reinsertion;
use embree_trace::optimize::{Config, Stage, rotations, run};
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use std::path::PathBuf;

const RAYS: usize = 32_768;

fn scenes() -> Vec<(String, Vec<Triangle>)> {
    let folder = std::env::var_os("EMBREE_TRACE_SCENES")
        .map_or_else(|| PathBuf::from("../shared/scenes"), PathBuf::from);
    let mut scenes: Vec<(String, Vec<Triangle>)> = ["sponza", "crytek_sponza"]
        .into_iter()
        .filter_map(|name| {
            let (mesh, _) = mesh::read(&folder.join(format!("{name}.obj.zst"))).ok()?;
            Some((name.to_owned(), mesh.triangles()))
        })
        .collect();
    if scenes.is_empty() {
        scenes.push(("courtyard".to_owned(), generate::courtyard(8, 1).triangles()));
    }
    scenes
}

/// Segments between the centroids of triangles far apart in the list.
fn rays(triangles: &[Triangle]) -> Vec<Ray> {
    let point = |index: usize| triangles[index.wrapping_mul(2_654_435_761) % triangles.len()].centroid();
    (0..RAYS)
        .map(|index| {
            let (from, to) = (point(2 * index), point(2 * index + 1));
            Ray { origin: from, tnear: 0.0, direction: to - from, tfar: 1.0 }
        })
        .collect()
}

fn optimisers(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    for (name, triangles) in scenes() {
        let sweep = builder::Config { splits: Splits::Sweep, ..Default::default() };
        let tree = builder::build(&triangles, &sweep, &Progress::hidden()).expect("a valid configuration");
        let scene = tree.nodes[0].bounds().into();
        let area = AreaMeasure::new(&scene);
        let seen = RayMeasure::new(&rays(&triangles), Estimate::default(), &scene);
        let climb = Stage::Rotations(rotations::Config::default());
        let reinsert = Stage::Reinsertion(reinsertion::Config::default());
        let mut group = c.benchmark_group(format!("optimize/{name}"));
        group.sample_size(10);
        let mut measured = |what: &str, stage: Stage, rays: bool| {
            let config = Config { stages: vec![stage], deadline: None };
            group.bench_function(what, |b| {
                let work = |mut tree: Tree| {
                    if rays {
                        once(&mut tree, &seen, &config)
                    } else {
                        once(&mut tree, &area, &config)
                    }
                    tree
                };
                pool.install(|| b.iter_batched(|| tree.clone(), work, BatchSize::LargeInput));
            });
        };
        measured("rotations, area", climb, false);
        measured("rotations, rays", climb, true);
        measured("reinsertion, area", reinsert, false);
        measured("reinsertion, rays", reinsert, true);
        group.finish();
    }
}

fn once<M: Measure>(tree: &mut Tree, measure: &M, config: &Config) {
    run(tree, measure, config, &Progress::hidden()).expect("a binary tree");
}

criterion_group! {
    name = benches;
    // Its plots want a font that the machine may not have.
    config = Criterion::default().without_plots();
    targets = optimisers
}
criterion_main!(benches);
