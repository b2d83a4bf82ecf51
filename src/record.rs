//! The one writer of `.rays`: queries of many threads in, one file out whose bytes do not depend on the threads.
//!
//! The work is numbered in units (tiles of an image, say). A thread opens a [`Unit`], gives it as the sink of a recording
//! intersector, and drops it when the work is done; any thread may do any unit, in rising order. A unit fills chunks and hands them over; the
//! writing thread takes them in the order of the units, compresses if asked (off the threads that record), and writes each at
//! once, so that a killed program leaves all full chunks but those few in flight.
//!
//! Memory is bounded: a thread whose unit's turn is not near waits once enough chunks are in flight, while the unit
//! whose turn it is may always go on, so nobody waits for ever. A write error stops every unit at its next batch.

pub mod host;
pub mod program;
mod queue;

use crate::embree::{BatchSink, Stop};
use crate::format::rays::{
    ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, RaysWriter, Record, Reject, Totals, encode_chunk,
};
use queue::{Queue, Records};
use rayon::prelude::*;
use std::io::{self, Write};
use std::sync::Arc;
use std::thread::JoinHandle;
use thiserror::Error;

/// A recording that could not be written to its end. What had been written can be read.
#[derive(Debug, Error)]
#[error("recording stopped after {} queries ({} bytes, readable): {source}", .written.records, .written.bytes)]
pub struct RecordError {
    pub written: Totals,
    pub source: io::Error,
}

/// A recording under way.
pub struct Recorder {
    queue: Arc<Queue>,
    /// `None` only while it is being joined.
    writer: Option<JoinHandle<Result<Totals, RecordError>>>,
}

impl Recorder {
    /// Writes the header, and starts the writing thread. `threads` is how many will record.
    ///
    /// # Errors
    /// When the header cannot be written.
    pub fn start<W: Write + Send + 'static>(
        out: W,
        header: &Header,
        codec: Codec,
        threads: usize,
    ) -> Result<Recorder, RecordError> {
        let at_start = |source| RecordError { written: Totals::default(), source };
        let mut writer = RaysWriter::new(out, header).map_err(at_start)?;
        // Raw chunks are written as fast as one thread can; compression keeps up with about four that record.
        let at_once = match codec {
            Codec::Raw => 1,
            Codec::Compressed => threads.div_ceil(4),
        };
        let queue = Arc::new(Queue::new(2 * threads + at_once));
        let shared = Arc::clone(&queue);
        let work = move || {
            let outcome = write_all(&shared, &mut writer, codec, at_once);
            // Also after a panic below, nobody may wait for a writer that is gone: see `Closing`.
            let written = writer.totals();
            match outcome.and_then(|()| writer.finish()) {
                Ok((_, totals)) => Ok(totals),
                Err(source) => Err(RecordError { written, source }),
            }
        };
        let writer = std::thread::Builder::new().name("record".into()).spawn(work).map_err(at_start)?;
        Ok(Recorder { queue, writer: Some(writer) })
    }

    /// A sink for unit `index`. Each index is opened once, lower ones before higher ones, and none is left out.
    pub fn unit(&self, index: u64) -> Unit<'_> {
        Unit { queue: &self.queue, index, buffer: self.queue.open(index) }
    }

    /// Whether a write has failed, so that further work is in vain.
    pub fn has_failed(&self) -> bool {
        self.queue.has_failed()
    }

    /// Waits until everything is written, and ends the file with its index.
    ///
    /// # Errors
    /// The write error that ended the recording early, with what had been written by then.
    pub fn finish(mut self) -> Result<Totals, RecordError> {
        self.queue.close();
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(outcome)) => outcome,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => unreachable!("only `finish` and `drop` take the writer, and both consume the recorder"),
        }
    }
}

impl Drop for Recorder {
    /// Without [`Self::finish`] what came so far is written, as a complete file.
    fn drop(&mut self) {
        self.queue.close();
        if let Some(writer) = self.writer.take() {
            // An error has nobody to go to any more.
            let _ = writer.join();
        }
    }
}

/// Ends the queue when the writing thread ends, by an error or by a panic.
struct Closing<'a>(&'a Queue);

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.fail();
    }
}

/// The writing thread: chunks in order, `at_once` of them compressed in parallel.
fn write_all<W: Write>(
    queue: &Queue,
    writer: &mut RaysWriter<W>,
    codec: Codec,
    at_once: usize,
) -> io::Result<()> {
    let _closing = Closing(queue);
    let mut sequence = 0;
    loop {
        let chunks = queue.take(at_once);
        if chunks.is_empty() {
            return Ok(());
        }
        let infos: Vec<ChunkInfo> = chunks
            .iter()
            .map(|chunk| {
                let info = ChunkInfo { scene: 0, thread: 0, sequence };
                sequence += chunk.records.len() as u64;
                info
            })
            .collect();
        match &chunks[..] {
            [chunk] => {
                writer.write_encoded(&encode_chunk(&infos[0], &chunk.records, &chunk.rejects, codec)?)?;
            }
            several => {
                let encoded: Vec<_> = several
                    .par_iter()
                    .zip(&infos)
                    .map(|(chunk, info)| encode_chunk(info, &chunk.records, &chunk.rejects, codec))
                    .collect();
                for chunk in encoded {
                    writer.write_encoded(&chunk?)?;
                }
            }
        }
        queue.give_back(chunks);
    }
}

/// The queries of one unit of work, in their order. Dropping it ends the unit.
pub struct Unit<'a> {
    queue: &'a Queue,
    index: u64,
    buffer: Records,
}

impl Unit<'_> {
    /// Hands over what is in the buffer.
    fn hand_over(&mut self) -> Result<(), Stop> {
        let full = std::mem::take(&mut self.buffer);
        self.buffer = self.queue.put(self.index, full)?;
        Ok(())
    }
}

impl BatchSink for Unit<'_> {
    fn batch(&mut self, records: &[Record], rejects: &[Reject]) -> Result<(), Stop> {
        // A batch is much smaller than a chunk, and stays in one piece, so its rejects do too.
        if self.buffer.records.len() + records.len() > MAX_CHUNK_RECORDS {
            self.hand_over()?;
        } else if self.queue.has_failed() {
            return Err(Stop);
        }
        let first = self.buffer.records.len() as u32;
        self.buffer.records.extend_from_slice(records);
        let in_chunk = |reject: &Reject| Reject { record: first + reject.record, ..*reject };
        self.buffer.rejects.extend(rejects.iter().map(in_chunk));
        Ok(())
    }
}

impl Drop for Unit<'_> {
    fn drop(&mut self) {
        // A failure is known to the recorder.
        let _ = self.queue.put_last(self.index, std::mem::take(&mut self.buffer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::rays::Rays;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// A file in memory that is full after some bytes.
    #[derive(Clone, Default)]
    struct Disk(Arc<Mutex<Vec<u8>>>, Option<usize>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut file = self.0.lock().unwrap();
            let room = self.1.unwrap_or(usize::MAX) - file.len();
            if room == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(room);
            file.extend_from_slice(&bytes[..taken]);
            Ok(taken)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn record(number: u64) -> Record {
        let mut record: Record = bytemuck::Zeroable::zeroed();
        record.path = number as u32;
        record.tfar = 1.0;
        record.t = f32::INFINITY;
        record.triangle = crate::format::rays::NO_TRIANGLE;
        record
    }

    /// Records of unit `index`: none, few, or more than two chunks, in batches.
    fn fill(unit: &mut Unit, index: u64) -> Result<(), Stop> {
        let count = [0, 100, 70_000, 5, 200_000, 1000][index as usize % 6];
        let records: Vec<Record> = (0..count).map(|n| record(index << 24 | n)).collect();
        records.chunks(512).try_for_each(|batch| unit.batch(batch, &[]))
    }

    fn header() -> Header {
        Header { fingerprint: 7, embree_version: 31305, deterministic: true, producer: "test".into() }
    }

    fn run(disk: Disk, threads: usize, codec: Codec) -> Result<Totals, RecordError> {
        let recorder = Recorder::start(disk, &header(), codec, threads)?;
        let next = Mutex::new(0u64);
        let stopped = AtomicU64::new(0);
        std::thread::scope(|scope| {
            for thread in 0..threads {
                let (next, recorder, stopped) = (&next, &recorder, &stopped);
                scope.spawn(move || {
                    loop {
                        let (index, mut unit) = {
                            let mut next = next.lock().unwrap();
                            if *next == 24 || recorder.has_failed() {
                                return;
                            }
                            *next += 1;
                            (*next - 1, recorder.unit(*next - 1))
                        };
                        // Some threads are slow, so that units end out of order.
                        if (index + thread as u64).is_multiple_of(3) {
                            std::thread::sleep(std::time::Duration::from_millis(3));
                        }
                        if fill(&mut unit, index).is_err() {
                            stopped.fetch_add(1, Ordering::Relaxed);
                        }
                    }
                });
            }
        });
        recorder.finish()
    }

    #[test]
    fn bytes_do_not_depend_on_threads() {
        for codec in [Codec::Raw, Codec::Compressed] {
            let file = |threads| {
                let disk = Disk::default();
                let totals = run(disk.clone(), threads, codec).unwrap();
                let bytes = disk.0.lock().unwrap().clone();
                assert_eq!((totals.records, totals.bytes), (4 * 271_105, bytes.len() as u64));
                bytes
            };
            let one = file(1);
            for threads in [2, 7] {
                assert!(file(threads) == one, "{threads} threads, {codec:?}");
            }
            let rays = Rays::parse(&one).unwrap();
            assert!(rays.recovery.is_none() && rays.header == header());
            let mut expected = Vec::new();
            for index in 0..24 {
                let count = [0, 100, 70_000, 5, 200_000, 1000][index as usize % 6];
                expected.extend((0..count).map(|n| (index << 24 | n) as u32));
            }
            let mut found = Vec::new();
            for chunk in 0..rays.chunks().len() {
                let chunk = rays.chunk(chunk).unwrap();
                assert_eq!(chunk.info, ChunkInfo { scene: 0, thread: 0, sequence: found.len() as u64 });
                found.extend(chunk.records.iter().map(|record| record.path));
            }
            assert!(found == expected);
        }
    }

    /// A full disk stops the units, says how much was kept, and leaves just that to be read.
    #[test]
    fn a_full_disk_keeps_what_was_written() {
        for threads in [1, 3] {
            for bytes in [63, 64, 100, 10_000_000] {
                let disk = Disk(Arc::default(), Some(bytes));
                let error = run(disk.clone(), threads, Codec::Raw).unwrap_err();
                assert_eq!(error.source.kind(), io::ErrorKind::StorageFull);
                let file = disk.0.lock().unwrap();
                if bytes >= 64 {
                    let rays = Rays::parse(&file).unwrap();
                    assert_eq!(rays.query_count(), error.written.records, "{bytes}");
                    assert!(bytes < 1000 || error.written.records > 70_000, "{error}");
                }
            }
        }
    }

    /// A unit that goes away by a panic does not hold up the others.
    #[test]
    fn a_panic_does_not_hang() {
        let disk = Disk::default();
        let recorder = Recorder::start(disk.clone(), &header(), Codec::Raw, 2).unwrap();
        let broken = std::thread::scope(|scope| {
            let broken = scope.spawn(|| {
                let mut unit = recorder.unit(0);
                fill(&mut unit, 1).unwrap();
                panic!("on purpose");
            });
            broken.join()
        });
        assert!(broken.is_err());
        fill(&mut recorder.unit(1), 5).unwrap();
        assert_eq!(recorder.finish().unwrap().records, 1100);
    }

    /// Rejects follow their records into the chunk.
    #[test]
    fn rejects_are_numbered_by_chunk() {
        let disk = Disk::default();
        let recorder = Recorder::start(disk.clone(), &header(), Codec::Raw, 1).unwrap();
        let mut rejecting = record(1);
        rejecting.flags |= crate::format::rays::flag::HAS_REJECTS;
        let mut unit = recorder.unit(0);
        unit.batch(&[record(0); 10], &[]).unwrap();
        unit.batch(&[record(0), rejecting], &[Reject { record: 1, triangle: 9 }]).unwrap();
        drop(unit);
        recorder.finish().unwrap();
        let bytes = disk.0.lock().unwrap();
        let chunk = Rays::parse(&bytes).unwrap().chunk(0).unwrap();
        assert_eq!(chunk.rejects[..], [Reject { record: 11, triangle: 9 }]);
    }
}
