//! How long something takes, by the wall clock and by the processors: other processes disturb the latter less.

use std::time::Instant;

/// Seconds by the wall clock and of the processors.
#[derive(Clone, Copy)]
pub struct Took {
    pub wall: f64,
    pub processor: f64,
}

/// Measures from now until it is asked.
pub struct Stopwatch(Instant, f64);

impl Stopwatch {
    pub fn start() -> Stopwatch {
        Stopwatch(Instant::now(), processor_seconds())
    }

    pub fn stop(self) -> Took {
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

pub fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
