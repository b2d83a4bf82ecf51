//! Planting: the tree of a `.bvh` goes back into the scene that it was made for, so that Embree's
//! own kernels traverse it.
//!
//! A file that cannot be read is an error; a tree that is not one for the scene is left out, and
//! the reason is one line. What is checked, and how a tree becomes Embree's, is in
//! [`crate::embree`].

use crate::embree::{EmbreeError, Planted, Scene};
use crate::files::{FileError, MappedFile};
use crate::format::FormatError;
use crate::format::bvh::Bvh;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use thiserror::Error;

/// A tree that was planted.
#[derive(Clone, Debug, Serialize)]
pub struct PlantedLine {
    pub path: String,
    /// Trees of Embree's that it stands in for.
    pub trees: u64,
    /// Children that Embree's nodes have room for.
    pub width: u64,
    pub nodes: u64,
    /// Of up to four triangles or quads.
    pub blocks: u64,
    /// Memory that it takes.
    pub bytes: u64,
    /// Entries of the stack that a traversal needs at most.
    pub stack: u64,
    /// All of it: reading and checking the file and the scene, making and reading back the tree.
    pub seconds: f64,
}

impl PlantedLine {
    fn new(path: &Path, planted: &Planted, seconds: f64) -> PlantedLine {
        PlantedLine {
            path: path.display().to_string(),
            trees: planted.trees as u64,
            width: planted.width as u64,
            nodes: planted.nodes as u64,
            blocks: planted.blocks as u64,
            bytes: planted.bytes as u64,
            stack: planted.stack as u64,
            seconds,
        }
    }
}

/// What became of a tree.
#[derive(Clone, Debug)]
pub enum Outcome {
    Planted(PlantedLine),
    /// The scene keeps the tree that it has: one line says why.
    LeftOut(String),
}

/// Why a tree could not even be looked at.
#[derive(Debug, Error)]
pub enum PlantError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: {source}", path.display())]
    Format { path: PathBuf, source: FormatError },
    #[error(transparent)]
    Embree(EmbreeError),
}

/// Plants the tree of the file `path` in a scene that nobody asks yet.
///
/// # Errors
/// When the file cannot be read, or is no whole `.bvh`, or there is no memory.
pub fn plant_file(scene: &mut Scene, path: &Path) -> Result<Outcome, PlantError> {
    let started = Instant::now();
    let bytes = MappedFile::open(path)?;
    let bvh = Bvh::parse(&bytes).map_err(|source| PlantError::Format { path: path.to_owned(), source })?;
    match scene.plant(&bvh) {
        Ok(planted) => {
            let seconds = started.elapsed().as_secs_f64();
            Ok(Outcome::Planted(PlantedLine::new(path, &planted, seconds)))
        }
        Err(EmbreeError::NotPlanted(reason)) => Ok(Outcome::LeftOut(format!(
            "{}: not planted, and Embree's own tree is traversed: {reason}",
            path.display()
        ))),
        Err(error) => Err(PlantError::Embree(error)),
    }
}
