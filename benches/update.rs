//! What it takes to bring a tree to the next frame: `cargo bench --bench update -- [TRIANGLES]`.
//!
//! Refitting and a pass of rotations over generated scenes, beside a rebuild of our own and beside copying the same bytes: boxes come from memory and go
//! there, so copying is the limit. Median wall clock of rounds that take each in turn; on as many threads as are said.

#[allow(dead_code, reason = "all threads are measured here, by the wall clock")]
mod stopwatch;

use embree_trace::builder::{self, Config};
use embree_trace::geometry::Triangle;
use embree_trace::mesh::generate::{Sequence, terrain};
use embree_trace::progress::Progress;
use embree_trace::update::Moving;
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use std::hint::black_box;
use stopwatch::{Stopwatch, median};

const ROUNDS: usize = 7;
const TRIANGLES: u32 = 1_000_000;

fn main() {
    let count = std::env::args().skip(1).find_map(|text| text.parse().ok()).unwrap_or(TRIANGLES);
    println!(
        "{:<28}{:>8}{:>14}{:>12}{:>12}{:>12}{:>12}{:>12}",
        "", "threads", "refit, M/s", "of copying", "refit, ms", "rotate, ms", "over refit", "build, ms"
    );
    // All threads start before the first measurement.
    let pools = [1, 2].map(|threads| ThreadPoolBuilder::new().num_threads(threads).build().expect("threads"));
    for max_leaf in [1, 4] {
        let config = Config { max_leaf, ..Config::default() };
        let frames = [0.5, 0.52].map(|time| Sequence::Twist.frame(count, time).triangles());
        let land = terrain(count as usize, 1).triangles();
        for (name, before, after) in [("twist", &frames[0], &frames[1]), ("terrain, at rest", &land, &land)] {
            for pool in &pools {
                pool.install(|| compare(&format!("{name}, leaves of {max_leaf}"), before, after, &config));
            }
        }
    }
}

fn compare(name: &str, before: &[Triangle], after: &[Triangle], config: &Config) {
    let tree = builder::build(before, config, &Progress::hidden()).expect("a valid configuration");
    let start = Moving::new(tree.view()).expect("a tree of a builder");
    let mut moving = start.clone();
    let mut copy = tree.nodes.clone();
    let mut triangles = after.to_vec();
    let (mut refits, mut rotations, mut copies, mut builds) = (vec![], vec![], vec![], vec![]);
    for _ in 0..ROUNDS {
        refits.push(seconds(|| moving.refit(after)));
        // From the same tree each time: what is rotated already costs less.
        let mut rotated = start.clone();
        rotations.push(seconds(|| {
            black_box(rotated.rotate(after));
        }));
        // What a refit cannot do without: nodes are read and written, triangles read.
        copies.push(seconds(|| {
            let part = tree.nodes.len().div_ceil(64);
            copy.par_chunks_mut(part)
                .zip(tree.nodes.par_chunks(part))
                .for_each(|(to, from)| to.copy_from_slice(from));
            let part = after.len().div_ceil(64);
            triangles
                .par_chunks_mut(part)
                .zip(after.par_chunks(part))
                .for_each(|(to, from)| to.copy_from_slice(from));
            black_box((&mut copy, &mut triangles));
        }));
        builds.push(seconds(|| drop(black_box(builder::build(after, config, &Progress::hidden())))));
    }
    let [refit, rotate, copy, build] =
        [refits, rotations, copies, builds].map(|mut times| median(&mut times));
    println!(
        "{name:<28}{:>8}{:>14.1}{:>11.0}%{:>12.2}{:>12.2}{:>12.2}{:>12.0}",
        rayon::current_num_threads(),
        1e-6 * after.len() as f64 / refit,
        100.0 * copy / refit,
        1e3 * refit,
        1e3 * rotate,
        rotate / refit,
        1e3 * build,
    );
}

fn seconds(work: impl FnOnce()) -> f64 {
    let watch = Stopwatch::start();
    work();
    watch.stop().wall
}
