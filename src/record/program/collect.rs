//! From the exchange into the files: full slots -> chunks of the `.rays`; scenes that were asked -> a `.bvh` each.
//!
//! One thread does it, the one that waits for the program; compression is spread over the others.

use super::capture::{Capture, Kind};
use super::exchange::{Batch, Exchange};
use super::flatten::{Flattened, flatten};
use super::report::{LeftOut, SceneLine};
use super::select::{Run, Selector};
use super::trees::{Candidate, order_of};
use crate::files::{FileError, OutputFile};
use crate::format::bvh::{self, Contents};
use crate::format::rays::{ChunkInfo, Codec, Header, RaysWriter, Totals, encode_chunk};
use rayon::prelude::*;
use serde_json::json;
use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// What stays the same while a program is recorded.
pub struct Target {
    /// Path of the first scene's tree; that of scene n has n before its extension.
    pub bvh: PathBuf,
    /// Where the program puts its scenes.
    pub directory: PathBuf,
    pub codec: Codec,
    pub max_triangles: u32,
    /// As it was called, for `META`.
    pub command: Vec<String>,
    /// Trees that may have been planted.
    pub planted: Vec<Candidate>,
}

/// See the module.
pub struct Collector {
    target: Target,
    writer: RaysWriter<File>,
    selector: Selector,
    /// Captures that are or can be instanced, by number.
    captures: HashMap<u32, Capture>,
    /// Captures whose release has been seen, below which all have.
    released: u32,
    /// Scenes whose tree has been written, or could not be.
    scenes: Vec<SceneLine>,
    fingerprints: Vec<u64>,
    /// Batches that came before an earlier one of their thread, and what each thread's next sequence number is.
    early: BTreeMap<(u32, u64), Batch>,
    expected: HashMap<u32, u64>,
    /// How many records of each thread are in the file.
    written: HashMap<u32, u64>,
}

impl Collector {
    /// Writes the header.
    ///
    /// # Errors
    /// When that cannot be written.
    pub fn new(target: Target, out: File, selector: Selector) -> io::Result<Collector> {
        let writer = RaysWriter::new(out, &header(0, 0))?;
        Ok(Collector {
            target,
            writer,
            selector,
            captures: HashMap::new(),
            released: 0,
            scenes: Vec::new(),
            fingerprints: Vec::new(),
            early: BTreeMap::new(),
            expected: HashMap::new(),
            written: HashMap::new(),
        })
    }

    /// Takes what is there. Returns whether there was anything.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn step(&mut self, exchange: &Exchange) -> Result<bool, CollectError> {
        let batches = exchange.take_full();
        let found = !batches.is_empty();
        self.scenes(exchange)?;
        self.add(batches, false)?;
        if self.selector.is_done() {
            exchange.stop();
        }
        Ok(found)
    }

    /// Takes what is left when the program has ended, and completes the file. Returns what was written, the scenes, and how
    /// many queries arrived.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn finish(mut self, exchange: &Exchange) -> Result<(Totals, Vec<SceneLine>, u64), CollectError> {
        exchange.stop();
        let batches = exchange.take_all();
        self.scenes(exchange)?;
        self.add(batches, true)?;
        let fingerprint = match self.fingerprints[..] {
            [only] => only,
            _ => 0,
        };
        // A pipe keeps the header that it got.
        let _ = self.writer.replace_header(&header(fingerprint, exchange.counters().embree_version));
        let seen = self.selector.seen();
        let (_, totals) = self.writer.finish().map_err(CollectError::Rays)?;
        Ok((totals, self.scenes, seen))
    }

    /// What has been written so far.
    pub fn totals(&self) -> Totals {
        self.writer.totals()
    }

    /// Writes batches, those of each thread in their order.
    fn add(&mut self, batches: Vec<Batch>, last: bool) -> Result<(), CollectError> {
        self.early.extend(batches.into_iter().map(|batch| ((batch.thread, batch.sequence), batch)));
        let mut chunks: Vec<(ChunkInfo, Run)> = Vec::new();
        for (key, batch) in std::mem::take(&mut self.early) {
            let expected = self.expected.entry(batch.thread).or_default();
            if batch.sequence != *expected && !last {
                self.early.insert(key, batch);
                continue;
            }
            *expected = batch.sequence + batch.records.len() as u64;
            let written = self.written.entry(batch.thread).or_default();
            for (scene, run) in self.selector.divide(&batch) {
                let info = ChunkInfo { scene, thread: batch.thread, sequence: *written };
                *written += run.records.len() as u64;
                chunks.push((info, run));
            }
        }
        let codec = self.target.codec;
        let encoded: Vec<_> = chunks
            .par_iter()
            .map(|(info, run)| encode_chunk(info, &run.records, &run.rejects, codec))
            .collect();
        for chunk in encoded {
            let written = chunk.and_then(|chunk| self.writer.write_encoded(&chunk));
            written.map_err(CollectError::Rays)?;
        }
        for (info, run) in &chunks {
            if let Some(line) = self.scenes.get_mut(info.scene as usize) {
                line.queries += run.records.len() as u64;
                line.rejects += run.rejects.len() as u64;
            }
        }
        Ok(())
    }

    /// Writes the trees of scenes that were asked since the last time, and forgets captures that the program has released.
    fn scenes(&mut self, exchange: &Exchange) -> Result<(), CollectError> {
        // A capture that is released now was numbered before: so this is looked at first.
        let count = exchange.capture_count();
        let released: Vec<u32> =
            (self.released..count).filter(|&capture| exchange.is_released(capture)).collect();
        while self.scenes.len() < exchange.scene_count() as usize {
            let number = self.scenes.len() as u32;
            let Some(capture) = exchange.capture_of(number) else { break };
            let line = self.scene(number, capture)?;
            self.scenes.push(line);
        }
        for capture in released {
            self.captures.remove(&capture);
            // It is not there when the program had no time to write it.
            let _ = fs::remove_file(self.target.directory.join(format!("{capture}.scene")));
            if capture == self.released {
                self.released += 1;
            }
        }
        Ok(())
    }

    /// Writes the tree of one scene; a scene that cannot have one is reported, and its queries kept.
    fn scene(&mut self, number: u32, capture: u32) -> Result<SceneLine, CollectError> {
        let read = |number| Capture::read(&self.target.directory, number).map_err(|error| error.to_string());
        let mut line = SceneLine { number, ..SceneLine::default() };
        let top = match read(capture) {
            Ok(top) => top,
            Err(problem) => {
                line.warnings.push(problem);
                return Ok(line);
            }
        };
        (line.scene, line.commit) = (top.scene, top.commit);
        let instanced = top.parts.iter().filter_map(|part| match part.kind {
            Kind::Instance { capture, .. } => Some(capture),
            _ => None,
        });
        for capture in instanced.collect::<std::collections::BTreeSet<u32>>() {
            if let std::collections::hash_map::Entry::Vacant(entry) = self.captures.entry(capture) {
                match read(capture) {
                    Ok(read) => {
                        entry.insert(read);
                    }
                    Err(problem) => line.warnings.push(problem),
                }
            }
        }
        line.left_out = LeftOut::of(&top, |capture| self.captures.get(&capture));
        match flatten(&top, |capture| self.captures.get(&capture), self.target.max_triangles) {
            Ok(flattened) => self.write_tree(&mut line, flattened)?,
            Err(problem) => line.warnings.push(format!("no tree is written: {problem}")),
        }
        Ok(line)
    }

    fn write_tree(&mut self, line: &mut SceneLine, flattened: Flattened) -> Result<(), CollectError> {
        let Flattened { tree, triangles, geometries, producer, flags, instances, moving, warnings } =
            flattened;
        let meta = json!({
            "recorded": {
                "command": self.target.command,
                "number": line.number,
                "scene": line.scene,
                "commit": line.commit,
                "left_out": line.left_out,
                "moving": moving,
                "warnings": warnings,
            }
        })
        .to_string();
        let order = order_of(&self.target.planted, tree.view(), &triangles);
        let contents = Contents {
            tree: tree.view(),
            triangles: &triangles,
            geometries: &geometries,
            order: order.as_deref(),
            meta: Some(&meta),
            flags,
            producer: &producer,
        };
        let path = path_of_scene(&self.target.bvh, line.number);
        let fingerprint = OutputFile::create(&path)?.commit_with(|out| bvh::write(out, &contents))?;
        self.fingerprints.push(fingerprint);
        (line.triangles, line.instances, line.moving, line.nodes) =
            (triangles.len() as u64, instances as u64, moving as u64, tree.nodes.len() as u64);
        (line.path, line.producer) = (Some(path.display().to_string()), producer);
        line.warnings.extend(warnings);
        Ok(())
    }
}

/// What a recording of somebody else's program says of itself.
fn header(fingerprint: u64, embree_version: u32) -> Header {
    Header {
        fingerprint,
        embree_version,
        deterministic: false,
        producer: concat!("embree-trace record ", env!("CARGO_PKG_VERSION")).to_owned(),
    }
}

/// `built.bvh`, `built.1.bvh`, `built.2.bvh`, ….
fn path_of_scene(first: &Path, number: u32) -> PathBuf {
    if number == 0 {
        return first.to_owned();
    }
    let mut name = first.file_stem().unwrap_or_default().to_owned();
    name.push(format!(".{number}"));
    if let Some(extension) = first.extension() {
        name.push(".");
        name.push(extension);
    }
    first.with_file_name(name)
}

/// What ends a recording.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// The `.rays` cannot be written.
    #[error("{0}")]
    Rays(io::Error),
    #[error("{0}")]
    Tree(#[from] FileError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_have_paths() {
        let path = |first: &str, number| path_of_scene(Path::new(first), number).display().to_string();
        assert_eq!(path("a/built.bvh", 0), "a/built.bvh");
        assert_eq!(path("a/built.bvh", 12), "a/built.12.bvh");
        assert_eq!(path("built", 1), "built.1");
    }
}
