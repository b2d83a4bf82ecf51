//! Build time and SAH cost, ours beside other crates', in one run: `cargo bench --bench build -- [SCENE…]`.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender once; the table shows medians over rounds. Pin the process to one processor (`taskset -c 0`) to
//! see tinybvh on one thread: it makes its own threads.
//!
//! SAH cost: c_I 1.2 for a node visit (0.6 a box test), c_P 1, relative to the root's area, with our code for all.
//! Scenes are files (`.obj`, `.ply`, also `.zst`); without any, one that is generated.

mod peers;

use embree_trace::builder::{self, Config, Splits};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::mesh;
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use embree_trace::tree::statistics::{Statistics, sah_cost};
use embree_trace::tree::validate::validate;
use obvhs::BvhBuildParams;
use peers::Peer;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

const ROUNDS: usize = 9;
const THREADS: [usize; 2] = [1, 2];

/// Builds on the threads of a pool, and says how long it took; on request also what came out.
type Run<'a> = Box<dyn FnMut(&ThreadPool, bool) -> (f64, Option<Tree>) + 'a>;

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if paths.is_empty() {
        compare("generated terrain", &terrain(512));
    }
    for path in &paths {
        match mesh::read(Path::new(path)) {
            Ok((mesh, _)) => compare(path, &mesh.triangles()),
            Err(error) => eprintln!("{error}"),
        }
    }
}

fn compare(name: &str, triangles: &[Triangle]) {
    let pools = THREADS.map(|threads| {
        ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started")
    });
    let mut contenders = contenders(triangles);
    let mut seconds = vec![[const { Vec::new() }; THREADS.len()]; contenders.len()];
    for _ in 0..ROUNDS {
        for (pool, threads) in pools.iter().zip(0..) {
            for ((_, run), seconds) in contenders.iter_mut().zip(&mut seconds) {
                seconds[threads as usize].push(run(pool, false).0);
            }
        }
    }
    println!("\n{name}, {} triangles: median of {ROUNDS} rounds", triangles.len());
    println!("{:<24}{:>9}{:>9}{:>11}{:>7}{:>11}", "", "1 thread", "2", "SAH cost", "depth", "nodes");
    for ((name, run), mut seconds) in contenders.into_iter().zip(seconds) {
        let mut run = run;
        let tree = run(&pools[1], true).1.expect("asked for");
        let note =
            validate(&tree, triangles, usize::MAX).map_or_else(|error| error.to_string(), |()| String::new());
        let [one, two] = seconds.each_mut().map(|s| median(s));
        let cost = sah_cost(tree.view(), 0.6, 1.0);
        let Statistics { depth, nodes, .. } = Statistics::of(tree.view());
        println!("{name:<24}{one:>9.3}{two:>9.3}{cost:>11.3}{depth:>7}{nodes:>11}  {note}");
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn contenders(triangles: &[Triangle]) -> Vec<(&'static str, Run<'_>)> {
    let sweep = Config { splits: Splits::Sweep, ..Config::default() };
    vec![
        ("ours, binned", ours(triangles, Config::default())),
        ("ours, binned, leaf 4", ours(triangles, Config { max_leaf: 4, ..Config::default() })),
        ("ours, binned, leaf 8", ours(triangles, Config { max_leaf: 8, ..Config::default() })),
        ("ours, sweep", ours(triangles, sweep)),
        ("ours, sweep, leaf 8", ours(triangles, Config { max_leaf: 8, ..sweep })),
        ("tinybvh-rs", theirs(peers::tinybvh_crate::TinyBvh, triangles)),
        ("bvh", theirs(peers::bvh_crate::BvhCrate, triangles)),
        ("parry3d", theirs(peers::parry_crate::Parry, triangles)),
        ("obvhs fastest", theirs(peers::obvhs_crate::Obvhs(BvhBuildParams::fastest_build()), triangles)),
        ("obvhs fast", theirs(peers::obvhs_crate::Obvhs(BvhBuildParams::fast_build()), triangles)),
        ("obvhs medium", theirs(peers::obvhs_crate::Obvhs(BvhBuildParams::medium_build()), triangles)),
    ]
}

fn ours(triangles: &[Triangle], config: Config) -> Run<'_> {
    Box::new(move |pool, keep| {
        pool.install(|| {
            let started = Instant::now();
            let tree =
                builder::build(triangles, &config, &Progress::hidden()).expect("the configuration is valid");
            let seconds = started.elapsed().as_secs_f64();
            (seconds, keep.then_some(tree))
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
            let started = Instant::now();
            let built = black_box(peer.build(&mut input));
            let seconds = started.elapsed().as_secs_f64();
            (seconds, keep.then(|| P::tree(&built)))
        })
    })
}

/// Two triangles a cell of a rough height field, with 2 · `side`² triangles.
fn terrain(side: usize) -> Vec<Triangle> {
    let height =
        |x: usize, y: usize| ((x * 7919 + y * 104_729) % 97) as f32 / 97.0 + (x as f32 / 40.0).sin() * 9.0;
    let vertex = |x: usize, y: usize| Vec3::new(x as f32, height(x, y), y as f32);
    let cells = (0..side * side).map(|cell| (cell % side, cell / side));
    cells
        .flat_map(|(x, y)| {
            let corners = [vertex(x, y), vertex(x + 1, y), vertex(x, y + 1), vertex(x + 1, y + 1)];
            [Triangle([corners[0], corners[1], corners[2]]), Triangle([corners[1], corners[3], corners[2]])]
        })
        .collect()
}
