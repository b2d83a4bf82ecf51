//! Work on a thread beside the window: its result when it is there, what it has done so far, and an end to it when nobody wants it any more.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// Called when there is something new to be shown.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// Tells work to stop; shared with it.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    pub fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }
}

/// Work that gives values of one kind, one after another. Dropped, it is told to stop.
#[derive(Debug)]
pub struct Work<T> {
    values: Receiver<T>,
    stop: Stop,
    ended: bool,
}

impl<T: Send + 'static> Work<T> {
    /// Starts `work`, which hands its values to the function that it is given.
    pub fn start(wake: &Wake, work: impl FnOnce(&Stop, &dyn Fn(T)) + Send + 'static) -> Work<T> {
        let (sender, values) = channel();
        let stop = Stop::default();
        let (own_stop, wake) = (stop.clone(), wake.clone());
        std::thread::spawn(move || {
            work(&own_stop, &|value| {
                // Nobody listens any more when the window has changed its mind.
                let _ = sender.send(value);
                wake();
            });
            drop(sender);
            wake();
        });
        Work { values, stop, ended: false }
    }

    /// The values that have come since the last call.
    pub fn all(&mut self) -> Vec<T> {
        let mut values = Vec::new();
        loop {
            match self.values.try_recv() {
                Ok(value) => values.push(value),
                Err(TryRecvError::Empty) => return values,
                Err(TryRecvError::Disconnected) => {
                    self.ended = true;
                    return values;
                }
            }
        }
    }

    /// The last of the values that have come since the last call.
    pub fn newest(&mut self) -> Option<T> {
        self.all().pop()
    }

    /// Whether no value will come any more, as of the last call of [`Self::newest`].
    pub fn has_ended(&self) -> bool {
        self.ended
    }
}

impl<T> Drop for Work<T> {
    fn drop(&mut self) {
        self.stop.stop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nobody() -> Wake {
        Arc::new(|| ())
    }

    #[test]
    fn the_newest_value_and_the_end_are_seen() {
        let mut work = Work::start(&nobody(), |_, give| (1..=3).for_each(give));
        let mut last = None;
        while !work.has_ended() {
            last = work.newest().or(last);
        }
        assert_eq!(last, Some(3));
    }

    #[test]
    fn dropped_work_is_told_to_stop() {
        let (sender, stopped) = channel();
        let work: Work<()> = Work::start(&nobody(), move |stop, _| {
            while !stop.is_stopped() {
                std::thread::yield_now();
            }
            let _ = sender.send(());
        });
        drop(work);
        assert!(stopped.recv().is_ok());
    }
}
