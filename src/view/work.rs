//! Work on a thread beside the window: its result when it is there, what it has done so far, and an end to it when nobody wants it any more.

use crate::progress::Progress;
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

/// The answer to the newest of a series of questions. While one is being answered, the last answer stays; a question that is replaced before it was
/// asked is never asked.
pub struct Latest<K, T> {
    /// What `value` answers, and what is being answered.
    answered: Option<K>,
    asked: Option<K>,
    work: Option<Work<Result<T, String>>>,
    progress: Arc<Progress>,
    pub value: Option<Arc<T>>,
    pub error: Option<String>,
}

impl<K, T> Default for Latest<K, T> {
    fn default() -> Latest<K, T> {
        let progress = Arc::new(Progress::watched(1));
        Latest { answered: None, asked: None, work: None, progress, value: None, error: None }
    }
}

impl<K: Clone + PartialEq, T: Send + 'static> Latest<K, T> {
    /// Takes an answer that is there, and asks `question` unless it is answered or another is being answered still. Returns whether there is
    /// a new answer.
    pub fn ask(
        &mut self,
        question: &K,
        steps: u64,
        wake: &Wake,
        work: impl FnOnce(&Progress) -> Result<T, String> + Send + 'static,
    ) -> bool {
        let mut new = false;
        if let Some(running) = &mut self.work {
            match running.newest() {
                Some(Ok(value)) => (self.value, self.error, new) = (Some(Arc::new(value)), None, true),
                Some(Err(error)) => (self.value, self.error, new) = (None, Some(error), true),
                None if running.has_ended() => {}
                None => return false,
            }
            (self.work, self.answered) = (None, self.asked.take());
        }
        if self.answered.as_ref() != Some(question) {
            self.asked = Some(question.clone());
            let progress = Arc::new(Progress::watched(steps));
            self.progress = progress.clone();
            self.work = Some(Work::start(wake, move |_, give| {
                // Threads of its own: pictures do not wait behind it.
                match rayon::ThreadPoolBuilder::new().build() {
                    Ok(pool) => give(pool.install(|| work(&progress))),
                    Err(error) => give(Err(error.to_string())),
                }
            }));
        }
        new
    }

    /// How much of an answer is there, while it is worked out.
    pub fn fraction(&self) -> Option<f64> {
        self.work.as_ref().map(|_| self.progress.fraction())
    }

    /// Nobody asks any more.
    pub fn forget(&mut self) {
        self.progress.stop();
        *self = Latest::default();
    }
}

impl<K, T> Drop for Latest<K, T> {
    fn drop(&mut self) {
        self.progress.stop();
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

    #[test]
    fn the_latest_question_is_answered() {
        let mut latest: Latest<u32, u32> = Latest::default();
        let mut answer = |question: u32| {
            while !latest.ask(&question, 1, &nobody(), move |_| match question {
                7 => Err("seven".to_owned()),
                _ => Ok(question * 10),
            }) {}
            (latest.value.as_deref().copied(), latest.error.clone())
        };
        assert_eq!(answer(1), (Some(10), None));
        assert_eq!(answer(7), (None, Some("seven".to_owned())));
        assert_eq!(answer(2), (Some(20), None));
        assert!(!latest.ask(&2, 1, &nobody(), |_| Ok(0)), "it is answered already");
    }
}
