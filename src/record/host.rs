//! Recording a scene of the program that this library is linked with: its tree into a `.bvh` at
//! once, and what the program asks into a `.rays` while it asks.
//!
//! Batches of the program's threads go through a bounded channel to one thread, which puts them
//! together by thread into chunks, compresses and writes them. A thread whose batch finds no room
//! waits: nothing is lost, and memory is bounded. What a killed program leaves can be read up to
//! its last full chunk.

use crate::embree::BuiltTree;
use crate::embree::host::{Ended, HostError, HostScene, HostSink};
use crate::files::{self, FileError, OutputFile};
use crate::format::bvh;
use crate::format::rays::{ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, RaysWriter, Record, Reject, Totals};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use thiserror::Error;

/// Batches that may wait for the writing thread.
const WAITING: usize = 64;

/// What a chunk of the files says.
const PRODUCER: &str = concat!("embree-trace plant.h ", env!("CARGO_PKG_VERSION"));

/// Why there is no recording, or only a part of one.
#[derive(Debug, Error)]
pub enum HostRecordError {
    #[error(transparent)]
    Host(#[from] HostError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: recording stopped after {records} queries (readable): {source}", path.display())]
    Write { path: PathBuf, records: u64, source: io::Error },
    /// The process was forked, and this is the child.
    #[error("the recording belongs to the process that began it")]
    Forked,
}

/// What was recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recorded {
    pub totals: Totals,
    pub ended: Ended,
}

/// A recording under way.
#[derive(Debug)]
pub struct HostRecording {
    rays: PathBuf,
    /// Of the process that began it: a forked child has no writing thread.
    process: u32,
    writer: JoinHandle<Result<Totals, (Totals, io::Error)>>,
}

/// What a thread of the program has asked.
struct Batch {
    thread: u32,
    records: Vec<Record>,
    rejects: Vec<Reject>,
}

struct Sender(SyncSender<Batch>);

impl HostSink for Sender {
    fn batch(&self, thread: u32, records: &[Record], rejects: &[Reject]) -> bool {
        let batch = Batch { thread, records: records.to_vec(), rejects: rejects.to_vec() };
        // The writer is gone when it cannot write.
        self.0.send(batch).is_ok()
    }
}

impl HostRecording {
    /// Writes the scene's tree, as it is traversed now, and records from then on.
    ///
    /// # Errors
    /// When the scene cannot be read or recorded, or a file not be made: then there is neither.
    ///
    /// # Safety
    /// As for [`HostScene::plant`].
    pub unsafe fn begin(
        scene: &mut HostScene,
        rays: &Path,
        bvh: &Path,
        codec: Codec,
    ) -> Result<HostRecording, HostRecordError> {
        // SAFETY: the caller's promise.
        let capture = unsafe { scene.capture()? };
        let built = capture.built();
        let tree = OutputFile::create(bvh)?;
        let out = files::create(rays)?;
        let begun = write_tree(tree, &built).map_err(HostRecordError::from).and_then(|fingerprint| {
            let header = Header {
                fingerprint,
                embree_version: capture.version(),
                deterministic: false,
                producer: PRODUCER.to_owned(),
            };
            let (sender, receiver) = sync_channel(WAITING);
            let writer = RaysWriter::new(out, &header).and_then(|writer| {
                let work = move || write_all(writer, &receiver, codec);
                std::thread::Builder::new().name("embree-trace".into()).spawn(work)
            });
            let failed = |source| HostRecordError::Write { path: rays.to_owned(), records: 0, source };
            let writer = writer.map_err(failed)?;
            // SAFETY: the caller's promise.
            match unsafe { scene.record(&capture, Box::new(Sender(sender))) } {
                Ok(()) => Ok(writer),
                Err(error) => {
                    // Its channel has gone, so it ends.
                    let _ = writer.join();
                    Err(error.into())
                }
            }
        });
        let writer = begun.inspect_err(|_| [rays, bvh].into_iter().for_each(remove))?;
        Ok(HostRecording { rays: rays.to_owned(), process: std::process::id(), writer })
    }

    /// Ends the recording of the scene that it was begun with, and completes the `.rays`.
    ///
    /// # Errors
    /// When it could not be written to its end; what there is can be read.
    ///
    /// # Safety
    /// As for [`HostScene::plant`].
    pub unsafe fn end(self, scene: &mut HostScene) -> Result<Recorded, HostRecordError> {
        // SAFETY: the caller's promise.
        let ended = unsafe { scene.end() };
        if self.process != std::process::id() {
            // A thread that is not there can neither be joined nor let go of.
            std::mem::forget(self.writer);
            return Err(HostRecordError::Forked);
        }
        match self.writer.join() {
            Ok(Ok(totals)) => Ok(Recorded { totals, ended }),
            Ok(Err((totals, source))) => {
                Err(HostRecordError::Write { path: self.rays, records: totals.records, source })
            }
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

/// What one thread has asked and is not written yet.
#[derive(Default)]
struct Stream {
    records: Vec<Record>,
    rejects: Vec<Reject>,
    /// Queries that are written.
    sequence: u64,
}

impl Stream {
    fn write(&mut self, writer: &mut RaysWriter<File>, thread: usize, codec: Codec) -> io::Result<()> {
        if self.records.is_empty() {
            return Ok(());
        }
        let info = ChunkInfo { scene: 0, thread: thread as u32, sequence: self.sequence };
        writer.write_chunk(&info, &self.records, &self.rejects, codec)?;
        self.sequence += self.records.len() as u64;
        self.records.clear();
        self.rejects.clear();
        Ok(())
    }

    fn add(&mut self, batch: &Batch) {
        let first = self.records.len() as u32;
        self.records.extend_from_slice(&batch.records);
        self.rejects
            .extend(batch.rejects.iter().map(|reject| Reject { record: first + reject.record, ..*reject }));
    }
}

/// Removes a file of a recording that does not begin; what is a device or a pipe stays.
fn remove(path: &Path) {
    if fs::metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        // What went wrong before is on its way.
        let _ = fs::remove_file(path);
    }
}

/// Writes a scene's tree; returns its fingerprint.
fn write_tree(file: OutputFile, built: &BuiltTree) -> Result<u64, FileError> {
    file.commit_with(|out| bvh::write(out, &built.contents()))
}

/// The writing thread. Returns, with an error, what had been written before it.
fn write_all(
    mut writer: RaysWriter<File>,
    batches: &Receiver<Batch>,
    codec: Codec,
) -> Result<Totals, (Totals, io::Error)> {
    let written = add_all(&mut writer, batches, codec);
    let totals = writer.totals();
    match written.and_then(|()| writer.finish()) {
        Ok((_, totals)) => Ok(totals),
        Err(source) => Err((totals, source)),
    }
}

fn add_all(writer: &mut RaysWriter<File>, batches: &Receiver<Batch>, codec: Codec) -> io::Result<()> {
    let mut streams: Vec<Stream> = Vec::new();
    for batch in batches {
        let thread = batch.thread as usize;
        if streams.len() <= thread {
            streams.resize_with(thread + 1, Stream::default);
        }
        let stream = &mut streams[thread];
        if stream.records.len() + batch.records.len() > MAX_CHUNK_RECORDS {
            stream.write(writer, thread, codec)?;
        }
        stream.add(&batch);
    }
    for (thread, stream) in streams.iter_mut().enumerate() {
        stream.write(writer, thread, codec)?;
    }
    Ok(())
}
