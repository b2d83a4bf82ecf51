//! What rays cost a build: binned and sweep, from recorded rays, beside our own SAH builds on the same threads:
//! `cargo bench --bench rdh -- SCENE.bvh…` (each with a .rays of the same name).
//!
//! Published for SRDH: 2.4 × the time of SAH (Feltman, Lee, Fatahalian 2012). Every round runs each contender once, because a shared
//! machine drifts; the table shows medians over rounds and their ratio.

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
use std::time::Instant;

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
    let trace = Trace::new(&Bvh::parse(&bvh)?, &Rays::parse(&rays)?, u64::MAX, 1)?;
    println!("{}: {} triangles, {} queries", path.display(), trace.triangles.len(), trace.queries.len());
    let sets = QUERIES.map(|most| {
        let step = trace.queries.len().div_ceil(most).max(1);
        RaySet::of_records(trace.queries.iter().step_by(step).map(|query| &query.record))
    });
    println!("{:<8}{:>8}{:>10}{:>10}{:>10}{:>8}", "", "threads", "queries", "SAH s", "RDH s", "ratio");
    for (name, splits) in [("binned", Config::default().splits), ("sweep", Splits::Sweep)] {
        let config = Config { splits, ..Config::default() };
        for threads in [1, 2] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
            let mut seconds = [const { Vec::new() }; 3];
            for _ in 0..ROUNDS {
                seconds[0].push(timed(|| pool.install(|| area_tree(&trace.triangles, &config)))?);
                for (set, seconds) in sets.iter().zip(&mut seconds[1..]) {
                    let build = || ray_tree(&trace.triangles, set, Count::default(), &config);
                    seconds.push(timed(|| pool.install(build))?);
                }
            }
            let [sah, with_rays @ ..] = seconds.map(|mut seconds| {
                seconds.sort_by(f64::total_cmp);
                seconds[ROUNDS / 2]
            });
            for (set, rdh) in sets.iter().zip(with_rays) {
                let ratio = rdh / sah;
                println!("{name:<8}{threads:>8}{:>10}{sah:>10.3}{rdh:>10.3}{ratio:>8.2}", set.len());
            }
        }
    }
    Ok(())
}

fn timed<T, E>(build: impl FnOnce() -> Result<T, E>) -> Result<f64, E> {
    let start = Instant::now();
    black_box(build()?);
    Ok(start.elapsed().as_secs_f64())
}
