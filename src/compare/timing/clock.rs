//! The clock of a measurement: processor time of this thread, which others on the machine do not add to, on one processor.

/// Seconds of processor time that this thread has used.
#[cfg(target_os = "linux")]
pub fn thread_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Seconds since the first call: other systems have no clock of their own for a thread that is as simple to ask.
#[cfg(not(target_os = "linux"))]
pub fn thread_seconds() -> f64 {
    use std::sync::LazyLock;
    use std::time::Instant;
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    START.elapsed().as_secs_f64()
}

/// Keeps this thread on the processor that it is on; its number, or `None` where that is not possible.
#[cfg(target_os = "linux")]
pub fn pin() -> Option<usize> {
    use rustix::thread::{CpuSet, sched_getcpu, sched_setaffinity};
    let processor = sched_getcpu();
    if processor >= CpuSet::MAX_CPU {
        return None;
    }
    let mut only = CpuSet::new();
    only.set(processor);
    sched_setaffinity(None, &only).ok().map(|()| processor)
}

/// Not possible here.
#[cfg(not(target_os = "linux"))]
pub fn pin() -> Option<usize> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_runs_with_the_work() {
        let start = thread_seconds();
        let mut sum = 0u64;
        while thread_seconds() - start < 0.001 {
            sum = std::hint::black_box(sum + 1);
        }
        assert!(sum > 0 && thread_seconds() > start);
    }

    #[test]
    fn a_pinned_thread_stays() {
        let pinned = std::thread::spawn(|| (pin(), pin())).join().expect("no panic");
        assert_eq!(pinned.0, pinned.1);
        #[cfg(target_os = "linux")]
        assert!(pinned.0.is_some());
    }
}
