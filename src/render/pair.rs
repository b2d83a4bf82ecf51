//! A recording and its tree: the `.bvh` of a scene as it is committed now, and a recorder whose `.rays` belongs to it.

use crate::embree::{EmbreeError, Scene, TreeSource};
use crate::files::{self, FileError, OutputFile};
use crate::format::bvh::{self, Contents};
use crate::format::rays::{Codec, Header};
use crate::record::{RecordError, Recorder};
use crate::render::summary::{RaysLine, TreeLine};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Where the two files go, and how they are written.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    pub rays: &'a Path,
    pub bvh: &'a Path,
    pub codec: Codec,
    pub source: TreeSource,
}

/// Why there is no whole pair.
#[derive(Debug, Error)]
pub enum PairError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Tree(#[from] EmbreeError),
    #[error("{}: {source}", path.display())]
    Rays { path: PathBuf, source: RecordError },
}

/// A tree that is written, and a recorder that waits for queries.
pub struct Started {
    pub recorder: Recorder,
    pub tree: TreeLine,
    /// What is not as was asked for ([`crate::embree::BuiltTree::warning`]).
    pub warning: Option<String>,
}

impl Pair<'_> {
    /// Writes the tree, with `meta` as its `META`, and starts to record on `threads` threads.
    ///
    /// # Errors
    /// When a file cannot be written, or Embree has no tree.
    pub fn start(
        &self,
        scene: &Scene,
        meta: &serde_json::Value,
        threads: usize,
    ) -> Result<Started, PairError> {
        // The file of rays first: the tree must not replace an old one when there will be no rays.
        let out = files::create(self.rays)?;
        let built = scene.tree(self.source)?;
        let meta = meta.to_string();
        let contents = Contents { meta: Some(&meta), ..built.contents() };
        let fingerprint = OutputFile::create(self.bvh)?.commit_with(|out| bvh::write(out, &contents))?;
        let bytes = std::fs::metadata(self.bvh).map_or(0, |metadata| metadata.len());
        let tree = TreeLine::new(self.bvh.display().to_string(), bytes, built.producer, built.tree.view());
        let header = Header {
            fingerprint,
            embree_version: Scene::version(),
            deterministic: true,
            producer: concat!("embree-trace ", env!("CARGO_PKG_VERSION")).to_owned(),
        };
        let recorder =
            Recorder::start(out, &header, self.codec, threads).map_err(|source| self.rays_error(source))?;
        Ok(Started { recorder, tree, warning: built.warning })
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// The write error that ended it early, with what can be read.
    pub fn finish(&self, recorder: Recorder) -> Result<RaysLine, PairError> {
        let totals = recorder.finish().map_err(|source| self.rays_error(source))?;
        Ok(RaysLine::new(self.rays.display().to_string(), &totals))
    }

    /// A recorder's error, which knows no path, with its path.
    fn rays_error(&self, source: RecordError) -> PairError {
        PairError::Rays { path: self.rays.to_owned(), source }
    }
}
