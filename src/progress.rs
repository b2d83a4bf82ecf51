//! A progress bar on stderr for work over a second, and only on a terminal: scripts and logs never see it.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// How long work may take before it is worth a bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// Progress of one task, counted in steps of its own choosing. Cheap to advance from many threads, a batch at a time.
pub struct Progress {
    started: Instant,
    bar: ProgressBar,
    shown: Mutex<bool>,
    stopped: AtomicBool,
}

impl Progress {
    /// A task of `steps` steps; `what` stands before the bar.
    pub fn new(what: &'static str, steps: u64) -> Progress {
        let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template("{msg:12} [{bar:40}] {percent:>3}%  {eta} left") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        let shown = Mutex::new(!std::io::stderr().is_terminal());
        Progress { started: Instant::now(), bar, shown, stopped: AtomicBool::new(false) }
    }

    /// A task that nobody watches: for library calls from tests and other programs.
    pub fn hidden() -> Progress {
        Progress::watched(0)
    }

    /// A task of `steps` steps without a bar, for a window that shows its [`Self::fraction`], and may stop it.
    pub fn watched(steps: u64) -> Progress {
        let progress = Progress::new("", steps);
        if let Ok(mut shown) = progress.shown.lock() {
            *shown = true;
        }
        progress
    }

    /// How much is done: 0 to 1.
    pub fn fraction(&self) -> f64 {
        let steps = self.bar.length().unwrap_or(0).max(1);
        (self.bar.position() as f64 / steps as f64).min(1.0)
    }

    /// Nobody wants the result any more: a task that knows how to ends early.
    pub fn stop(&self) {
        self.stopped.store(true, Relaxed);
    }

    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Relaxed)
    }

    /// `steps` more are done.
    pub fn advance(&self, steps: u64) {
        self.bar.inc(steps);
        if self.started.elapsed() > PATIENCE
            && let Ok(mut shown) = self.shown.try_lock()
            && !*shown
        {
            *shown = true;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
