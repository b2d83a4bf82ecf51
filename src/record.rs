//! The one writer of `.rays`: queries of many threads in, one file out whose bytes do not depend on the threads.
//!
//! The work is numbered in units (tiles of an image, say). A thread opens a [`Unit`], gives it as the sink of a recording
//! intersector, and drops it when the work is done; any thread may do any unit, in rising order. A unit fills chunks and hands them over; the
//! writing thread takes them in the order of the units, compresses if asked (off the threads that record), and writes each at
//! once, so that a killed program leaves all full chunks but those few in flight.
//!
//! Memory is bounded: a thread whose unit's turn is not near waits once enough chunks are in flight, while the unit
//! whose turn it is may always go on, so nobody waits for ever. A write error stops every unit at its next batch.

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
