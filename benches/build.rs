//! Build time and SAH cost, ours beside other crates', in one run: `cargo bench --bench build -- [SCENE…]`.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender once; the table shows medians over rounds. Beside the wall clock it shows processor seconds of
//! all threads on a pool of one: other processes disturb them less, and they are what tinybvh, which makes its own
//! threads, can be compared by.
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

/// Rounds, unless the environment variable ROUNDS says another number.
const ROUNDS: usize = 7;
const THREADS: [usize; 2] = [1, 2];

/// Builds on the threads of a pool, and says how long it took; on request also what came out.
type Run<'a> = Box<dyn FnMut(&ThreadPool, bool) -> (Took, Option<Tree>) + 'a>;

/// Seconds by the wall clock and of the processors.
struct Took {
    wall: f64,
    processor: f64,
}

/// Measures from now until it is asked.
struct Stopwatch(Instant, f64);

impl Stopwatch {
    fn start() -> Stopwatch {
        Stopwatch(Instant::now(), processor_seconds())
    }

    fn stop(self) -> Took {
        Took { wall: self.0.elapsed().as_secs_f64(), processor: processor_seconds() - self.1 }
    }
}

/// Time that this process' threads have spent on a processor, from Linux; 0 elsewhere.
fn processor_seconds() -> f64 {
    let nanoseconds = |task: std::io::Result<std::fs::DirEntry>| -> Option<u64> {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse().ok()
    };
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten();
    tasks.filter_map(nanoseconds).sum::<u64>() as f64 * 1e-9
}

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
    let rounds = std::env::var("ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(ROUNDS).max(1);
    let mut contenders = contenders(triangles);
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
        "{:<24}{:>10}{:>10}{:>10}{:>10}{:>7}{:>10}",
        "", "processor", "1 thread", "2 threads", "SAH cost", "depth", "nodes"
    );
    for ((name, run), mut seconds) in contenders.into_iter().zip(seconds) {
        let mut run = run;
        let tree = run(&pools[1], true).1.expect("asked for");
        let note =
            validate(&tree, triangles, usize::MAX).map_or_else(|error| error.to_string(), |()| String::new());
        let [processor, one, two] = seconds.each_mut().map(|s| median(s));
        let cost = sah_cost(tree.view(), 0.6, 1.0);
        let Statistics { depth, nodes, .. } = Statistics::of(tree.view());
        println!(
            "{name:<24}{processor:>10.3}{one:>10.3}{two:>10.3}{cost:>10.3}{depth:>7}{nodes:>10}  {note}"
        );
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
