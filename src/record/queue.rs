//! Chunks of many threads, taken in the order of their units.

use crate::embree::Stop;
use crate::format::rays::{MAX_CHUNK_RECORDS, Record, Reject};
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// What becomes a chunk.
#[derive(Debug, Default)]
pub struct Records {
    pub records: Vec<Record>,
    pub rejects: Vec<Reject>,
}

/// Chunks that the unit whose turn it is may have waiting beyond the capacity, so that it never waits for others.
const RESERVED: usize = 2;

/// See the module.
pub struct Queue {
    state: Mutex<State>,
    /// Chunks were taken, or the turn has moved on: recording threads may go on.
    taken: Condvar,
    /// A chunk or the end of a unit has come: the writer may go on.
    arrived: Condvar,
    /// Chunks that may wait.
    capacity: usize,
    failed: AtomicBool,
}

#[derive(Default)]
struct State {
    /// The unit whose chunks are taken.
    turn: u64,
    /// Units that were opened, from `turn` on.
    units: BTreeMap<u64, Unit>,
    /// Chunks in all units.
    waiting: usize,
    /// Emptied buffers, to be filled again.
    free: Vec<Records>,
    closed: bool,
}

#[derive(Default)]
struct Unit {
    chunks: VecDeque<Records>,
    ended: bool,
}

impl Queue {
    pub fn new(capacity: usize) -> Queue {
        Queue {
            state: Mutex::default(),
            taken: Condvar::new(),
            arrived: Condvar::new(),
            capacity,
            failed: AtomicBool::new(false),
        }
    }

    /// A poisoned lock is as good as any: no update below panics half-way.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers a unit, and gives it an empty buffer.
    pub fn open(&self, index: u64) -> Records {
        let mut state = self.lock();
        state.units.insert(index, Unit::default());
        state.free.pop().unwrap_or_else(empty)
    }

    /// Hands a chunk over and gets an empty buffer; waits while too much is in flight and it is another unit's turn.
    pub fn put(&self, index: u64, chunk: Records) -> Result<Records, Stop> {
        let mut state = self.room(index)?;
        self.insert(&mut state, index, chunk);
        Ok(state.free.pop().unwrap_or_else(empty))
    }

    /// Hands over a unit's last chunk, which may be empty, and ends the unit.
    pub fn put_last(&self, index: u64, chunk: Records) -> Result<(), Stop> {
        let mut state = if chunk.records.is_empty() { self.lock() } else { self.room(index)? };
        if !chunk.records.is_empty() {
            self.insert(&mut state, index, chunk);
        } else if chunk.records.capacity() > 0 {
            state.free.push(chunk);
        }
        if let Some(unit) = state.units.get_mut(&index) {
            unit.ended = true;
        }
        self.arrived.notify_one();
        Ok(())
    }

    /// Waits until unit `index` may hand a chunk over.
    fn room(&self, index: u64) -> Result<MutexGuard<'_, State>, Stop> {
        let mut state = self.lock();
        loop {
            if self.has_failed() {
                return Err(Stop);
            }
            let own = state.units.get(&index).map_or(0, |unit| unit.chunks.len());
            if state.waiting < self.capacity || (state.turn == index && own < RESERVED) {
                return Ok(state);
            }
            state = self.taken.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn insert(&self, state: &mut State, index: u64, chunk: Records) {
        state.units.entry(index).or_default().chunks.push_back(chunk);
        state.waiting += 1;
        self.arrived.notify_one();
    }

    /// The next chunks in order, at least one and at most `most`; none when the queue was closed and all are taken.
    pub fn take(&self, most: usize) -> Vec<Records> {
        let mut chunks = Vec::new();
        let mut state = self.lock();
        loop {
            let (turn, closed) = (state.turn, state.closed);
            match state.units.get_mut(&turn) {
                Some(unit) if chunks.len() < most && !unit.chunks.is_empty() => {
                    chunks.extend(unit.chunks.pop_front());
                    state.waiting -= 1;
                    self.taken.notify_all();
                }
                Some(unit) if chunks.len() < most && unit.ended => {
                    state.units.remove(&turn);
                    state.turn += 1;
                    self.taken.notify_all();
                }
                // Closed: every unit has ended, so the next one was never opened.
                None if chunks.is_empty() && closed => return chunks,
                _ if !chunks.is_empty() => return chunks,
                _ => state = self.arrived.wait(state).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    /// Takes buffers back.
    pub fn give_back(&self, chunks: Vec<Records>) {
        let mut state = self.lock();
        for mut chunk in chunks {
            chunk.records.clear();
            chunk.rejects.clear();
            state.free.push(chunk);
        }
    }

    /// No unit will be opened any more.
    pub fn close(&self) {
        self.lock().closed = true;
        self.arrived.notify_one();
    }

    /// Nothing will be taken any more.
    pub fn fail(&self) {
        // Under the lock, so that nobody checks it before and waits after.
        let state = self.lock();
        self.failed.store(true, Ordering::Relaxed);
        drop(state);
        self.taken.notify_all();
    }

    #[inline]
    pub fn has_failed(&self) -> bool {
        self.failed.load(Ordering::Relaxed)
    }
}

fn empty() -> Records {
    Records { records: Vec::with_capacity(MAX_CHUNK_RECORDS), rejects: Vec::new() }
}
