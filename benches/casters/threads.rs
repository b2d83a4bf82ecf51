//! How much faster two threads cast than one: wall clock, rounds of one and of two in turn.

use super::Caster;
use super::packets::is_right;
use embree_trace::format::rays::Record;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::time::Instant;

/// Queries that a thread takes at a time: a chunk's, as a replay does.
const SHARE: usize = 4096;

/// Median over `rounds` of the time of one thread over that of two; each thread has a caster of its own from `caster`.
pub fn two_over_one<C: Caster>(
    caster: impl Fn() -> C + Sync,
    records: &[Record],
    least: f64,
    rounds: usize,
) -> f64 {
    if records.is_empty() {
        return f64::NAN;
    }
    let pools = [1, 2].map(|threads| {
        ThreadPoolBuilder::new().num_threads(threads).build().expect("threads of a machine at rest")
    });
    let run = |pool: &ThreadPool, passes: usize| {
        let before = Instant::now();
        pool.install(|| {
            let shares = records.len().div_ceil(SHARE);
            (0..passes * shares).into_par_iter().for_each_init(&caster, |caster, index| {
                let share = records.chunks(SHARE).nth(index % shares).unwrap_or_default();
                std::hint::black_box(share.iter().filter(|record| is_right(caster, record)).count());
            });
        });
        before.elapsed().as_secs_f64()
    };
    let passes = (least / run(&pools[0], 1).max(1e-3)).ceil() as usize;
    let mut ratios: Vec<f64> = (0..rounds).map(|_| run(&pools[0], passes) / run(&pools[1], passes)).collect();
    ratios.sort_by(f64::total_cmp);
    ratios[rounds / 2]
}
