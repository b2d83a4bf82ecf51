//! Planting: the tree of a `.bvh` goes back into the scene that it was made for, so that Embree's
//! own kernels traverse it.
//!
//! A file that cannot be read is an error; a tree that is not one for the scene is left out, and
//! the reason is one line. What is checked, and how a tree becomes Embree's, is in
//! [`crate::embree`].

use crate::embree::{Arrays, EmbreeError, Planted, Scene};
use crate::files::{FileError, MappedFile};
use crate::format::FormatError;
use crate::format::bvh::{Bvh, Geometry};
use crate::geometry::Triangle;
use crate::update::{Moving, UpdateError};
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
    let bvh = parse(path, &bytes)?;
    outcome(path, started, scene.plant(&bvh))
}

fn parse<'a>(path: &Path, bytes: &'a [u8]) -> Result<Bvh<'a>, PlantError> {
    Bvh::parse(bytes).map_err(|source| PlantError::Format { path: path.to_owned(), source })
}

fn outcome(
    path: &Path,
    started: Instant,
    planted: Result<Planted, EmbreeError>,
) -> Result<Outcome, PlantError> {
    match planted {
        Ok(planted) => {
            let seconds = started.elapsed().as_secs_f64();
            Ok(Outcome::Planted(PlantedLine::new(path, &planted, seconds)))
        }
        Err(EmbreeError::NotPlanted(reason)) => Ok(left_out(path, &reason)),
        Err(error) => Err(PlantError::Embree(error)),
    }
}

fn left_out(path: &Path, reason: &dyn std::fmt::Display) -> Outcome {
    Outcome::LeftOut(format!("{}: not planted, and Embree's own tree is traversed: {reason}", path.display()))
}

/// The trees of a moving scene: one that follows the frames, or one a frame.
#[derive(Debug)]
pub struct Frames<'a> {
    path: &'a Path,
    state: State,
}

/// Of the one tree that follows.
#[derive(Debug)]
enum State {
    Unread,
    Following(Box<Following>),
    /// It was none of the first frame.
    LeftOut(String),
}

/// The first frame's tree, on its way from frame to frame.
#[derive(Debug)]
struct Following {
    tree: Moving,
    triangles: Vec<Triangle>,
    geometries: Vec<Geometry>,
    order: Option<Vec<u8>>,
    flags: u32,
}

impl Following {
    fn new(bvh: &Bvh) -> Result<Following, UpdateError> {
        let mut tree = Moving::new(bvh.tree)?;
        // The order is by node: it is of no use where those were put in another one.
        let same = tree.tree().nodes == bvh.tree.nodes;
        Ok(Following {
            tree,
            triangles: bvh.triangles.to_vec(),
            geometries: bvh.geometries.to_vec(),
            order: bvh.order.filter(|_| same).map(<[u8]>::to_vec),
            flags: bvh.header.flags,
        })
    }

    /// Refits the tree to the scene as it is committed now, and plants it.
    fn plant(&mut self, scene: &mut Scene) -> Result<Planted, EmbreeError> {
        let (triangles, _) = scene.triangles();
        Moving::check_frame(&self.triangles, &triangles)
            .map_err(|error| EmbreeError::NotPlanted(error.to_string()))?;
        self.tree.refit(&triangles);
        self.triangles = triangles;
        let (geometries, order) = (&self.geometries[..], self.order.as_deref());
        let (tree, triangles) = (self.tree.tree().view(), &self.triangles[..]);
        scene.plant(Arrays { tree, triangles, geometries, order, flags: self.flags })
    }
}

impl<'a> Frames<'a> {
    /// `path` is a directory with a tree for each frame, `0000.bvh`, `0001.bvh`, …, or the first frame's tree, which then
    /// follows: its boxes are fitted to each frame.
    pub fn new(path: &'a Path) -> Frames<'a> {
        Frames { path, state: State::Unread }
    }

    /// Plants the tree of frame `number`, named with `digits` digits, in the scene as it is committed now. Frames come in
    /// their order.
    ///
    /// # Errors
    /// As [`plant_file`].
    pub fn plant(&mut self, scene: &mut Scene, number: usize, digits: usize) -> Result<Outcome, PlantError> {
        if self.path.is_dir() {
            return plant_file(scene, &self.path.join(format!("{number:0digits$}.bvh")));
        }
        match &mut self.state {
            State::Unread => self.plant_first(scene),
            State::Following(following) => {
                let started = Instant::now();
                outcome(self.path, started, following.plant(scene))
            }
            State::LeftOut(why) => Ok(Outcome::LeftOut(why.clone())),
        }
    }

    fn plant_first(&mut self, scene: &mut Scene) -> Result<Outcome, PlantError> {
        let started = Instant::now();
        let bytes = MappedFile::open(self.path)?;
        let bvh = parse(self.path, &bytes)?;
        let outcome = match Following::new(&bvh) {
            Ok(following) => {
                self.state = State::Following(Box::new(following));
                outcome(self.path, started, scene.plant(&bvh))?
            }
            Err(error) => left_out(self.path, &error),
        };
        if let Outcome::LeftOut(why) = &outcome {
            self.state = State::LeftOut(why.clone());
        }
        Ok(outcome)
    }
}
