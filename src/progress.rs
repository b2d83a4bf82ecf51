//! A progress bar on stderr for work over a second, and only on a terminal: scripts and logs never see it.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How long work may take before it is worth a bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// Progress of one task, counted in steps of its own choosing. Cheap to advance from many threads, a batch at a time.
pub struct Progress {
    started: Instant,
    bar: ProgressBar,
    shown: Mutex<bool>,
}

impl Progress {
    /// A task of `steps` steps; `what` stands before the bar.
    pub fn new(what: &'static str, steps: u64) -> Progress {
        let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template("{msg:12} [{bar:40}] {percent:>3}%  {eta} left") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        Progress { started: Instant::now(), bar, shown: Mutex::new(!std::io::stderr().is_terminal()) }
    }

    /// A task that nobody watches: for library calls from tests and other programs.
    pub fn hidden() -> Progress {
        let progress = Progress::new("", 0);
        if let Ok(mut shown) = progress.shown.lock() {
            *shown = true;
        }
        progress
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
