//! Build time and what comes out, ours beside other crates' and Embree's, in one run:
//! `cargo bench --bench build -- [SCENE [RAYS]]…`.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender once; the table shows medians over rounds. Beside the wall clock it shows processor seconds of
//! all threads on a pool of one: other processes disturb them less, and they are what tinybvh, which makes its own
//! threads, can be compared by.
//!
//! SAH cost: c_I 1.2 for a node visit (0.6 a box test), c_P 1, relative to the root's area, with our code for all.
//! ODF cost, with a recording of the scene: 0.6 for a box test and 1 for a primitive test, per recorded query. A node visit of a
//! binary tree tests two boxes, so it counts 1.2; wide trees pay for each of their boxes.
//! Scenes are files (`.obj`, `.ply`, also `.zst`); without any, one that is generated. ONLY=TEXT runs the contenders whose names contain it.

mod peers;
mod stopwatch;

use embree_trace::builder::spatial::Options;
use embree_trace::builder::{self, Config, Splits};
use embree_trace::files::MappedFile;
use embree_trace::format::rays::{Rays, Record, flag};
use embree_trace::geometry::Triangle;
use embree_trace::mesh::generate::courtyard;
use embree_trace::mesh::{self, Mesh};
use embree_trace::optimize::{Stage, reinsertion};
use embree_trace::progress::Progress;
use embree_trace::recipe::{Heuristic, Recipe};
use embree_trace::traverse::{All, Counts, Prepared, PreparedRay, Scratch, Traversal};
use embree_trace::tree::Tree;
use embree_trace::tree::statistics::{Statistics, sah_cost};
use embree_trace::tree::validate::validate;
use obvhs::BvhBuildParams;
use peers::Peer;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::hint::black_box;
use std::path::Path;
use stopwatch::{Stopwatch, Took, median};

/// Rounds, unless the environment variable ROUNDS says another number.
const ROUNDS: usize = 7;
const THREADS: [usize; 2] = [1, 2];
/// Queries that trees are judged by.
const QUERIES: usize = 200_000;

/// Builds on the threads of a pool, and says how long it took; on request also what came out.
type Run<'a> = Box<dyn FnMut(&ThreadPool, bool) -> (Took, Option<Tree>) + 'a>;

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if paths.is_empty() {
        compare("generated courtyard", &courtyard(64, 1), &[]);
    }
    let mut paths = paths.iter().peekable();
    while let Some(path) = paths.next() {
        let rays = paths.next_if(|next| next.ends_with(".rays"));
        match mesh::read(Path::new(path)) {
            Ok((mesh, _)) => compare(path, &mesh, &rays.map_or(Vec::new(), |rays| sample(rays))),
            Err(error) => eprintln!("{error}"),
        }
    }
}

/// Queries spread over a recording.
fn sample(path: &str) -> Vec<Record> {
    let bytes = MappedFile::open(Path::new(path)).expect("a readable file");
    let rays = Rays::parse(&bytes).expect("a .rays");
    let every = (rays.query_count() as usize / QUERIES).max(1);
    let records = (0..rays.chunks().len())
        .flat_map(|index| rays.chunk(index).expect("a whole chunk").records.into_owned());
    records.step_by(every).filter(|record| record.flags & flag::HAS_REJECTS == 0).collect()
}

/// What a query costs on average, depth first.
fn odf_cost(tree: &Tree, triangles: &[Triangle], records: &[Record]) -> f64 {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let (mut scratch, mut counts) = (Scratch::default(), Counts::default());
    for record in records {
        let ray = PreparedRay::new(&record.ray());
        if record.is_occlusion() {
            prepared.occluder(Traversal::Odf, &ray, &All, &mut counts, &mut scratch);
        } else {
            prepared.closest_hit(Traversal::Odf, &ray, &All, &mut counts, &mut scratch);
        }
    }
    (0.6 * counts.box_tests as f64 + counts.primitive_tests as f64) / records.len() as f64
}

fn compare(name: &str, mesh: &Mesh, records: &[Record]) {
    let triangles = &mesh.triangles();
    let pools = THREADS.map(|threads| {
        ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started")
    });
    let rounds = std::env::var("ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(ROUNDS).max(1);
    let mut contenders = contenders(mesh, triangles);
    if let Ok(only) = std::env::var("ONLY") {
        contenders.retain(|(name, _)| only.split(',').any(|text| name.contains(text)));
    }
    // Processor seconds on one thread, then wall seconds for each number of threads.
    let mut seconds = vec![[const { Vec::new() }; 1 + THREADS.len()]; contenders.len()];
    for _ in 0..rounds {
        for (column, pool) in pools.iter().enumerate() {
            for ((_, run), seconds) in contenders.iter_mut().zip(&mut seconds) {
                let took = run(pool, false).0;
                seconds[1 + column].push(took.wall);
                if column == 0 {
                    seconds[0].push(took.processor);
                }
            }
        }
    }
    println!("\n{name}, {} triangles: median of {rounds} rounds", triangles.len());
    println!(
        "{:<34}{:>10}{:>10}{:>10}{:>10}{:>10}{:>7}{:>10}{:>10}",
        "", "processor", "1 thread", "2 threads", "SAH cost", "ODF cost", "depth", "nodes", "entries"
    );
    for ((name, run), mut seconds) in contenders.into_iter().zip(seconds) {
        let mut run = run;
        let tree = run(&pools[1], true).1.expect("asked for");
        let entries = tree.primitives.len();
        let note = if entries > triangles.len() {
            // Boxes of fragments cannot be told from wrong ones.
            String::new()
        } else {
            validate(&tree, triangles, usize::MAX).map_or_else(|error| error.to_string(), |()| String::new())
        };
        let odf = if records.is_empty() { f64::NAN } else { odf_cost(&tree, triangles, records) };
        let [processor, one, two] = seconds.each_mut().map(|s| median(s));
        let cost = sah_cost(tree.view(), 0.6, 1.0);
        let Statistics { depth, nodes, .. } = Statistics::of(tree.view());
        println!(
            "{name:<34}{processor:>10.3}{one:>10.3}{two:>10.3}{cost:>10.3}{odf:>10.3}{depth:>7}{nodes:>10}{entries:>10}  {note}"
        );
    }
}

fn contenders<'a>(mesh: &'a Mesh, triangles: &'a [Triangle]) -> Vec<(&'static str, Run<'a>)> {
    let sweep = Config::of(Splits::Sweep);
    let spatial = Config::of(Splits::Spatial(Options::default()));
    let full = reinsertion::Config::default();
    let quick = reinsertion::Config::QUICK;
    let leaves = |config| Config { max_leaf: 8, ..config };
    let theirs_obvhs = |params| theirs(peers::obvhs_crate::Obvhs(params), triangles);
    let mut contenders = vec![
        ("ours, binned", ours(triangles, Config::default())),
        ("ours, binned, leaf 4", ours(triangles, Config { max_leaf: 4, ..Config::default() })),
        ("ours, binned, leaf 8", ours(triangles, leaves(Config::default()))),
        ("ours, sweep", ours(triangles, sweep)),
        ("ours, sweep, leaf 8", ours(triangles, leaves(sweep))),
        ("ours, spatial", ours(triangles, spatial)),
        ("ours, spatial, leaf 8", ours(triangles, leaves(spatial))),
        ("ours, binned + quick, leaf 8", optimized(triangles, leaves(Config::default()), quick)),
        ("ours, sweep + reinsertion", optimized(triangles, sweep, full)),
        ("ours, spatial + quick, leaf 8", optimized(triangles, leaves(spatial), quick)),
        ("ours, spatial + reinsertion", optimized(triangles, spatial, full)),
        ("ours, spatial + reinsertion, leaf 8", optimized(triangles, leaves(spatial), full)),
        ("tinybvh-rs", theirs(peers::tinybvh_crate::TinyBvh { spatial: false }, triangles)),
        ("tinybvh-rs spatial", theirs(peers::tinybvh_crate::TinyBvh { spatial: true }, triangles)),
        ("bvh", theirs(peers::bvh_crate::BvhCrate, triangles)),
        ("parry3d", theirs(peers::parry_crate::Parry, triangles)),
        ("obvhs fastest", theirs_obvhs(BvhBuildParams::fastest_build())),
        ("obvhs fast", theirs_obvhs(BvhBuildParams::fast_build())),
        ("obvhs medium", theirs_obvhs(BvhBuildParams::medium_build())),
        ("obvhs slow", theirs_obvhs(BvhBuildParams::slow_build())),
        ("obvhs very slow", theirs_obvhs(BvhBuildParams::very_slow_build())),
    ];
    #[cfg(feature = "embree")]
    contenders.extend([
        ("Embree medium", embree(mesh, embree_trace::embree::Quality::Medium)),
        ("Embree high", embree(mesh, embree_trace::embree::Quality::High)),
    ]);
    #[cfg(not(feature = "embree"))]
    let _ = mesh;
    contenders
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

fn ours(triangles: &[Triangle], config: Config) -> Run<'_> {
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
