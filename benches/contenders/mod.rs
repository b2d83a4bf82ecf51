//! Who builds: our recipes, other people's crates, Embree; each as something that can be run on the threads of a pool.

use crate::peers::{self, Peer};
use crate::stopwatch::{Stopwatch, Took};
use embree_trace::builder::spatial::Options;
use embree_trace::builder::{self, Config, Splits};
use embree_trace::geometry::Triangle;
use embree_trace::mesh::Mesh;
use embree_trace::optimize::{Stage, reinsertion};
use embree_trace::progress::Progress;
use embree_trace::recipe::{Heuristic, Recipe};
use embree_trace::tree::Tree;
use obvhs::BvhBuildParams;
use rayon::ThreadPool;
use std::hint::black_box;

/// Builds on the threads of a pool, and says how long it took; on request also what came out.
pub type Run<'a> = Box<dyn FnMut(&ThreadPool, bool) -> (Took, Option<Tree>) + 'a>;

/// One of ours, all of it: what is compared with Embree's best and with every crate on every scene.
pub const BEST: &str = "ours, spatial + reinsertion, leaf 8";

/// Embree's best.
pub const HIGH: &str = "Embree high";

/// Our recipes.
pub fn ours(triangles: &[Triangle]) -> Vec<(&'static str, Run<'_>)> {
    let sweep = Config::of(Splits::Sweep);
    let spatial = Config::of(Splits::Spatial(Options::default()));
    let full = reinsertion::Config::default();
    let quick = reinsertion::Config::QUICK;
    let leaves = |config| Config { max_leaf: 8, ..config };
    vec![
        ("ours, binned", built(triangles, Config::default())),
        ("ours, binned, leaf 4", built(triangles, Config { max_leaf: 4, ..Config::default() })),
        ("ours, binned, leaf 8", built(triangles, leaves(Config::default()))),
        ("ours, sweep", built(triangles, sweep)),
        ("ours, sweep, leaf 8", built(triangles, leaves(sweep))),
        ("ours, spatial", built(triangles, spatial)),
        ("ours, spatial, leaf 8", built(triangles, leaves(spatial))),
        ("ours, binned + quick, leaf 8", optimized(triangles, leaves(Config::default()), quick)),
        ("ours, sweep + reinsertion", optimized(triangles, sweep, full)),
        ("ours, spatial + quick, leaf 8", optimized(triangles, leaves(spatial), quick)),
        ("ours, spatial + reinsertion", optimized(triangles, spatial, full)),
        (BEST, optimized(triangles, leaves(spatial), full)),
    ]
}

/// Every crate with every setting.
pub fn crates(triangles: &[Triangle]) -> Vec<(&'static str, Run<'_>)> {
    let theirs_obvhs = |params| theirs(peers::obvhs_crate::Obvhs(params), triangles);
    vec![
        ("tinybvh-rs", theirs(peers::tinybvh_crate::TinyBvh { spatial: false }, triangles)),
        ("tinybvh-rs spatial", theirs(peers::tinybvh_crate::TinyBvh { spatial: true }, triangles)),
        ("bvh", theirs(peers::bvh_crate::BvhCrate, triangles)),
        ("parry3d", theirs(peers::parry_crate::Parry, triangles)),
        ("obvhs fastest", theirs_obvhs(BvhBuildParams::fastest_build())),
        ("obvhs fast", theirs_obvhs(BvhBuildParams::fast_build())),
        ("obvhs medium", theirs_obvhs(BvhBuildParams::medium_build())),
        ("obvhs slow", theirs_obvhs(BvhBuildParams::slow_build())),
        ("obvhs very slow", theirs_obvhs(BvhBuildParams::very_slow_build())),
    ]
}

/// Embree's builders.
#[cfg(feature = "embree")]
pub fn embrees(mesh: &Mesh) -> Vec<(&'static str, Run<'_>)> {
    use embree_trace::embree::Quality;
    vec![("Embree medium", embree(mesh, Quality::Medium)), (HIGH, embree(mesh, Quality::High))]
}

#[cfg(not(feature = "embree"))]
pub fn embrees(_mesh: &Mesh) -> Vec<(&'static str, Run<'_>)> {
    Vec::new()
}

/// Embree's own tree for tracing, with the copy of the scene that Embree makes; as many threads as the pool has.
#[cfg(feature = "embree")]
fn embree(mesh: &Mesh, quality: embree_trace::embree::Quality) -> Run<'_> {
    use embree_trace::embree::{Scene, Settings, TreeSource};
    Box::new(move |pool, keep| {
        let settings = Settings { threads: pool.current_num_threads(), quality, ..Settings::default() };
        let stopwatch = Stopwatch::start();
        let scene = Scene::new(mesh, &settings).expect("Embree builds a scene");
        let took = stopwatch.stop();
        (took, keep.then(|| scene.tree(TreeSource::Live).expect("a tree").tree))
    })
}

/// Built, then optimised by area.
fn optimized(triangles: &[Triangle], builder: Config, reinsertion: reinsertion::Config) -> Run<'_> {
    let stages = vec![Stage::Reinsertion(reinsertion)];
    let recipe = Recipe { heuristic: Heuristic::Sah, builder, stages, budget: None };
    Box::new(move |pool, keep| {
        pool.install(|| {
            let stopwatch = Stopwatch::start();
            let made = recipe.make(triangles, &[], &Progress::hidden()).expect("the configuration is valid");
            let took = stopwatch.stop();
            (took, keep.then_some(made.tree))
        })
    })
}

fn built(triangles: &[Triangle], config: Config) -> Run<'_> {
    Box::new(move |pool, keep| {
        pool.install(|| {
            let stopwatch = Stopwatch::start();
            let tree =
                builder::build(triangles, &config, &Progress::hidden()).expect("the configuration is valid");
            let took = stopwatch.stop();
            (took, keep.then_some(tree))
        })
    })
}

fn theirs<'a, P: Peer + Send + Sync + 'a>(peer: P, triangles: &[Triangle]) -> Run<'a>
where
    P::Input: 'a,
{
    let mut input = P::prepare(triangles);
    Box::new(move |pool, keep| {
        pool.install(|| {
            let stopwatch = Stopwatch::start();
            let built = black_box(peer.build(&mut input));
            let took = stopwatch.stop();
            (took, keep.then(|| P::tree(&built)))
        })
    })
}
