//! What rays cost a build: binned and sweep, from recorded rays, beside our own SAH builds on the same threads:
//! `cargo bench --bench rdh -- SCENE.bvh…` (each with a .rays of the same name).
//!
//! Published for SRDH: 2.4 × the time of SAH (Feltman, Lee, Fatahalian 2012). Every round runs each contender once, because a
//! shared machine drifts; the table shows medians over ROUNDS rounds (an environment variable), by processor time of all
//! threads and by the wall clock.

mod stopwatch;

use embree_trace::builder::{Config, Splits};
use embree_trace::experiment::measure::{area_tree, ray_tree};
use embree_trace::experiment::trace::Trace;
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Rays;
use embree_trace::probability::rays::{Count, RaySet};
use rayon::ThreadPoolBuilder;
use std::hint::black_box;
use std::path::Path;
use stopwatch::{Stopwatch, median};

/// Rounds, unless the environment variable ROUNDS says another number.
const ROUNDS: usize = 7;
const QUERIES: [usize; 2] = [32_768, 1 << 20];

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if paths.is_empty() {
        println!("give recorded scenes: cargo bench --bench rdh -- SCENE.bvh…");
    }
    for path in &paths {
        if let Err(error) = compare(Path::new(path)) {
            eprintln!("{path}: {error}");
        }
    }
}

fn compare(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let (bvh, rays) = (MappedFile::open(path)?, MappedFile::open(&path.with_extension("rays"))?);
    let trace = Trace::new(&Bvh::parse(&bvh)?, &Rays::parse(&rays)?, None, u64::MAX, 1)?;
    println!("{}: {} triangles, {} queries", path.display(), trace.triangles.len(), trace.queries.len());
    let sets = QUERIES.map(|most| {
        let count = most.min(trace.queries.len());
        let place = |index: usize| index * trace.queries.len() / count;
        RaySet::of_records((0..count).map(|index| &trace.queries[place(index)].record))
    });
    println!(
        "{:<8}{:>8}{:>10}{:>12}{:>12}{:>8}{:>12}{:>12}{:>8}",
        "", "threads", "queries", "SAH cpu s", "RDH cpu s", "ratio", "SAH wall s", "RDH wall s", "ratio"
    );
    let rounds = std::env::var("ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(ROUNDS).max(1);
    // All threads start before the first measurement: one that ends takes its time with it.
    let pools =
        [ThreadPoolBuilder::new().num_threads(1).build()?, ThreadPoolBuilder::new().num_threads(2).build()?];
    for (name, splits) in [("binned", Config::default().splits), ("sweep", Splits::Sweep)] {
        let config = Config { splits, ..Config::default() };
        for pool in &pools {
            // SAH, then one column for each set; processor and wall seconds.
            let mut seconds = vec![[Vec::new(), Vec::new()]; 1 + sets.len()];
            for _ in 0..rounds {
                for (column, seconds) in seconds.iter_mut().enumerate() {
                    let stopwatch = Stopwatch::start();
                    black_box(pool.install(|| match column {
                        0 => area_tree(&trace.triangles, &config),
                        _ => ray_tree(&trace.triangles, &sets[column - 1], Count::default(), &config),
                    })?);
                    let took = stopwatch.stop();
                    seconds[0].push(took.processor);
                    seconds[1].push(took.wall);
                }
            }
            let seconds: Vec<[f64; 2]> =
                seconds.into_iter().map(|seconds| seconds.map(|mut s| median(&mut s))).collect();
            for (set, [cpu, wall]) in sets.iter().zip(&seconds[1..]) {
                let [sah_cpu, sah_wall] = seconds[0];
                println!(
                    "{name:<8}{:>8}{:>10}{sah_cpu:>12.3}{cpu:>12.3}{:>8.2}{sah_wall:>12.3}{wall:>12.3}{:>8.2}",
                    pool.current_num_threads(),
                    set.len(),
                    cpu / sah_cpu,
                    wall / sah_wall
                );
            }
        }
    }
    Ok(())
}
