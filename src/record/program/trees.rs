//! The trees that are planted in a program's scenes: files → the table that the preload library reads; what it says of each
//! scene → [`Planting`].
//!
//! Files are parsed here, checksums and indices included; the library reads the arrays from them itself, and believes nothing
//! of what it reads (`embree-shim/preload_trees.hpp`).

use super::exchange::{memory_file, path_of};
use crate::embree::ffi::{
    self, EXCHANGE_CHANGES, EXCHANGE_FOREIGN, EXCHANGE_LEFT, EXCHANGE_MAGIC, EXCHANGE_PATH, EXCHANGE_PLANTED,
    EXCHANGE_UNKNOWN, ExchangeOutcome, ExchangeTree, ExchangeTrees, ShimGeometry,
};
use crate::files::{FileError, MappedFile};
use crate::format::bvh::{Bvh, flag};
use crate::geometry::Triangle;
use crate::tree::TreeView;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read, Seek, Write};
use std::mem::MaybeUninit;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Set for the program: the path of the table.
pub const VARIABLE: &str = "EMBREE_TRACE_TREES";

/// Which trees are to be planted.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Files, each of which must be a tree.
    pub trees: Vec<PathBuf>,
    /// A directory whose `.bvh` files are taken, too, behind those.
    pub directory: Option<PathBuf>,
}

impl Wanted {
    pub fn is_empty(&self) -> bool {
        self.trees.is_empty() && self.directory.is_none()
    }
}

/// Why there are no trees to plant.
#[derive(Debug, Error)]
pub enum TreesError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: {problem}", path.display())]
    Tree { path: PathBuf, problem: String },
    #[error(
        "{}: its triangles were placed by instances, and no scene of the program has them so", path.display()
    )]
    Instances { path: PathBuf },
    #[error("cannot share memory with the program: {0}")]
    Share(#[from] io::Error),
}

/// What the program is given, and what it says.
pub struct Trees {
    /// In the order of the table; first those that were named one by one.
    paths: Vec<String>,
    candidates: Vec<Candidate>,
    named: usize,
    table: File,
    outcomes: File,
    /// Of files that were left out.
    warnings: Vec<String>,
}

impl Trees {
    /// Reads and checks every file.
    ///
    /// # Errors
    /// When a file that was named is no whole `.bvh`, or there is no memory. A file of a directory is only left out, as a tree of
    /// flattened instances is, and a warning says so.
    pub fn new(wanted: &Wanted) -> Result<Trees, TreesError> {
        let mut trees = Trees {
            paths: Vec::new(),
            candidates: Vec::new(),
            named: 0,
            table: memory_file(c"embree-trace trees")?,
            outcomes: memory_file(c"embree-trace outcomes")?,
            warnings: Vec::new(),
        };
        let found = wanted.directory.iter().map(|directory| found_in(directory));
        let found = found.collect::<Result<Vec<_>, _>>()?.concat();
        let mut entries = Vec::new();
        for (number, path) in wanted.trees.iter().chain(&found).enumerate() {
            match entry(path) {
                Ok(entry) => {
                    trees.candidates.push(Candidate {
                        path: path.clone(),
                        nodes: entry.node_count as usize,
                        primitives: entry.primitive_count as usize,
                        triangles: entry.triangle_count as usize,
                    });
                    entries.push(entry);
                    trees.paths.push(path.display().to_string());
                    trees.named += usize::from(number < wanted.trees.len());
                }
                // What was named is to be a tree. One that no scene can have is left out as others are that none has.
                Err(error)
                    if number < wanted.trees.len() && !matches!(error, TreesError::Instances { .. }) =>
                {
                    return Err(error);
                }
                Err(error) => trees.warnings.push(format!("{error}; it is left out")),
            }
        }
        let outcomes = path_of(&trees.outcomes);
        let table = ExchangeTrees {
            magic: EXCHANGE_MAGIC,
            count: entries.len() as u64,
            outcomes: letters(&outcomes)?,
        };
        trees.table.write_all(bytes_of(&table))?;
        for entry in &entries {
            trees.table.write_all(bytes_of(entry))?;
        }
        Ok(trees)
    }

    /// What [`VARIABLE`] is set to.
    pub fn path(&self) -> String {
        path_of(&self.table)
    }

    /// The trees that may be planted.
    pub fn candidates(&self) -> Vec<Candidate> {
        self.candidates.clone()
    }

    /// What became of the scenes until now.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn planting(&self) -> io::Result<Planting> {
        let mut bytes = Vec::new();
        let mut file = &self.outcomes;
        file.rewind()?;
        file.read_to_end(&mut bytes)?;
        let outcomes: Vec<ExchangeOutcome> =
            bytes.chunks_exact(size_of::<ExchangeOutcome>()).map(outcome).collect();
        Ok(Planting::new(&self.paths, self.named, &outcomes, self.warnings.clone()))
    }
}

/// The `.bvh` files of a directory, by name.
fn found_in(directory: &Path) -> Result<Vec<PathBuf>, FileError> {
    let error = |source| FileError::new(directory, "read", source);
    let mut paths = Vec::new();
    for entry in fs::read_dir(directory).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if path.extension().is_some_and(|extension| extension == "bvh") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// The row of the table of one file.
fn entry(path: &Path) -> Result<ExchangeTree, TreesError> {
    let file_error = |source| FileError::new(path, "open", source);
    let absolute = fs::canonicalize(path).map_err(file_error)?;
    let metadata = fs::metadata(&absolute).map_err(file_error)?;
    let bytes = MappedFile::open(path)?;
    let problem = |problem: String| TreesError::Tree { path: path.to_owned(), problem };
    let bvh = Bvh::parse(&bytes).map_err(|error| problem(error.to_string()))?;
    if bvh.header.flags & flag::FLATTENED != 0 {
        return Err(TreesError::Instances { path: path.to_owned() });
    }
    // Sections are viewed in place.
    let offset = |start: *const u8| (start as usize - bytes.as_ptr() as usize) as u64;
    Ok(ExchangeTree {
        path: letters(&absolute.to_string_lossy())?,
        bytes: metadata.len(),
        inode: metadata.ino(),
        nodes: offset(bvh.tree.nodes.as_ptr().cast()),
        node_count: bvh.tree.nodes.len() as u64,
        primitives: offset(bvh.tree.primitives.as_ptr().cast()),
        primitive_count: bvh.tree.primitives.len() as u64,
        triangles: offset(bvh.triangles.as_ptr().cast()),
        triangle_count: bvh.triangles.len() as u64,
        geometries: offset(bvh.geometries.as_ptr().cast()),
        geometry_count: bvh.geometries.len() as u64,
        order: bvh.order.map_or(0, |order| offset(order.as_ptr())),
        flags: bvh.header.flags,
        unused: 0,
    })
}

/// A zero-terminated text of a path.
fn letters(path: &str) -> io::Result<[std::ffi::c_char; EXCHANGE_PATH as usize]> {
    let mut letters = [0; EXCHANGE_PATH as usize];
    if path.len() >= letters.len() {
        return Err(io::Error::other(format!(
            "the path has {} bytes, at most {EXCHANGE_PATH} fit",
            path.len()
        )));
    }
    for (letter, &byte) in letters.iter_mut().zip(path.as_bytes()) {
        *letter = byte as std::ffi::c_char;
    }
    Ok(letters)
}

/// A struct of the exchange that has no padding.
trait Plain {}
impl Plain for ExchangeTrees {}
impl Plain for ExchangeTree {}
const _: () = assert!(size_of::<ExchangeTrees>() == 16 + EXCHANGE_PATH as usize);
const _: () = assert!(size_of::<ExchangeTree>() == EXCHANGE_PATH as usize + 11 * 8 + 8);
const _: () = assert!(size_of::<ShimGeometry>() == 32);

fn bytes_of<T: Plain>(plain: &T) -> &[u8] {
    // SAFETY: as many bytes as the struct has, borrowed as long; none of them is padding, as asserted above.
    unsafe { std::slice::from_raw_parts(std::ptr::from_ref(plain).cast(), size_of::<T>()) }
}

fn outcome(bytes: &[u8]) -> ExchangeOutcome {
    let mut outcome = MaybeUninit::<ExchangeOutcome>::zeroed();
    let length = bytes.len().min(size_of::<ExchangeOutcome>());
    // SAFETY: no more bytes than either has; the struct holds numbers and letters only, so any bytes are one.
    unsafe {
        std::ptr::copy_nonoverlapping(bytes.as_ptr(), outcome.as_mut_ptr().cast(), length);
        outcome.assume_init()
    }
}

/// What was planted in one scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlantedScene {
    /// Of the program.
    pub process: u32,
    /// Which of the process's scenes, from 0.
    pub scene: u32,
    /// The tree that was planted last; `None` where none was.
    pub tree: Option<String>,
    /// How many times a tree was planted: once a commit that changed something.
    pub plantings: u32,
    /// Children that Embree's nodes have room for; and what the tree has and takes.
    pub width: u32,
    pub nodes: u64,
    pub blocks: u64,
    pub bytes: u64,
    /// Of all its commits, spent with planting.
    pub seconds: f64,
    /// Why Embree's own tree is traversed since the last commit that changed something.
    pub left_out: Option<String>,
}

/// A tree that may be planted, and how large it is.
#[derive(Clone, Debug)]
pub struct Candidate {
    path: PathBuf,
    nodes: usize,
    primitives: usize,
    triangles: usize,
}

/// In which order occlusion queries visit the children of `tree`, over `triangles`, where it is one of `candidates` that was
/// planted and is read back: its section `ORDR`, which memory does not hold. Only files of the same sizes are read.
pub fn order_of(candidates: &[Candidate], tree: TreeView, triangles: &[Triangle]) -> Option<Vec<u8>> {
    let sizes = (tree.nodes.len(), tree.primitives.len(), triangles.len());
    let fits = |candidate: &&Candidate| (candidate.nodes, candidate.primitives, candidate.triangles) == sizes;
    candidates.iter().filter(fits).find_map(|candidate| {
        let bytes = MappedFile::open(&candidate.path).ok()?;
        let bvh = Bvh::parse(&bytes).ok()?;
        let is_same = bvh.tree.nodes == tree.nodes
            && bvh.tree.primitives == tree.primitives
            && bytemuck::cast_slice::<_, u8>(bvh.triangles) == bytemuck::cast_slice::<_, u8>(triangles);
        bvh.order.filter(|_| is_same).map(<[u8]>::to_vec)
    })
}

/// What became of a program's scenes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Planting {
    /// Those whose geometries some tree has.
    pub scenes: Vec<PlantedScene>,
    /// How many others there are that have triangles or quads.
    pub unknown: u64,
    /// Calls of Embree went to a library that is neither Embree 3 nor Embree 4.
    pub foreign: bool,
    pub warnings: Vec<String>,
}

impl Planting {
    fn new(
        paths: &[String],
        named: usize,
        outcomes: &[ExchangeOutcome],
        mut warnings: Vec<String>,
    ) -> Planting {
        let mut scenes: BTreeMap<(u32, u32), PlantedScene> = BTreeMap::new();
        let mut unknown = BTreeSet::new();
        let mut tried = BTreeSet::new();
        let mut foreign = false;
        // A process is only told by its number when there are several.
        let processes: BTreeSet<u32> = outcomes.iter().map(|outcome| outcome.process).collect();
        for outcome in outcomes {
            let key = (outcome.process, outcome.scene);
            match outcome.outcome {
                EXCHANGE_UNKNOWN => {
                    unknown.insert(key);
                    continue;
                }
                EXCHANGE_FOREIGN => {
                    foreign = true;
                    continue;
                }
                EXCHANGE_PLANTED | EXCHANGE_LEFT | EXCHANGE_CHANGES => {}
                _ => continue,
            }
            let line = scenes.entry(key).or_insert_with(|| PlantedScene {
                process: outcome.process,
                scene: outcome.scene,
                tree: None,
                plantings: 0,
                width: 0,
                nodes: 0,
                blocks: 0,
                bytes: 0,
                seconds: 0.0,
                left_out: None,
            });
            line.seconds += outcome.seconds;
            let path = usize::try_from(outcome.tree).ok().and_then(|tree| paths.get(tree));
            match (outcome.outcome, path) {
                (EXCHANGE_CHANGES, _) => line.left_out = Some(ffi::text(&outcome.reason)),
                (EXCHANGE_PLANTED, Some(path)) => {
                    tried.insert(outcome.tree);
                    line.tree = Some(path.clone());
                    line.plantings += 1;
                    (line.width, line.nodes) = (outcome.planted.width, outcome.planted.nodes);
                    (line.blocks, line.bytes) = (outcome.planted.blocks, outcome.planted.bytes);
                    line.left_out = None;
                }
                (_, Some(path)) => {
                    tried.insert(outcome.tree);
                    line.left_out = Some(format!("{path} is not planted: {}", ffi::text(&outcome.reason)));
                }
                _ => {}
            }
        }
        for line in scenes.values() {
            if let Some(reason) = &line.left_out {
                let name = Name { line, several: processes.len() > 1 };
                warnings.push(format!("{name} keeps Embree's own tree: {reason}"));
            }
        }
        // A directory holds trees of other programs, too.
        for (number, path) in paths.iter().take(named).enumerate() {
            if !tried.contains(&(number as u64)) && !outcomes.is_empty() && !foreign {
                warnings.push(format!(
                    "{path}: not planted: no scene that the program has committed has the geometries, by number, kind and count, that it is of"
                ));
            }
        }
        Planting { scenes: scenes.into_values().collect(), unknown: unknown.len() as u64, foreign, warnings }
    }

    /// Whether the program has shown Embree anything.
    pub fn is_empty(&self) -> bool {
        self.scenes.is_empty() && self.unknown == 0
    }
}

/// How a scene is called.
struct Name<'a> {
    line: &'a PlantedScene,
    several: bool,
}

impl fmt::Display for Name<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "scene {}", self.line.scene)?;
        if self.several {
            write!(f, " of process {}", self.line.process)?;
        }
        Ok(())
    }
}

impl fmt::Display for Planting {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let processes: BTreeSet<u32> = self.scenes.iter().map(|line| line.process).collect();
        for line in &self.scenes {
            let Some(tree) = &line.tree else { continue };
            let PlantedScene { width, nodes, blocks, bytes, seconds, .. } = line;
            let name = Name { line, several: processes.len() > 1 };
            write!(
                f,
                "planted  {tree} in {name}: {nodes} nodes of {width}, {blocks} blocks, {bytes} bytes; {seconds:.3} s"
            )?;
            match line.plantings {
                1 => writeln!(f)?,
                count => writeln!(f, ", {count} times, as it was committed again")?,
            }
        }
        match self.unknown {
            0 => Ok(()),
            1 => writeln!(f, "left     1 scene that no tree is of"),
            count => writeln!(f, "left     {count} scenes that no tree is of"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(scene: u32, what: u32, tree: u64) -> ExchangeOutcome {
        ExchangeOutcome { process: 7, scene, outcome: what, tree, seconds: 0.5, ..ExchangeOutcome::default() }
    }

    #[test]
    fn the_last_word_of_each_scene_counts() {
        let paths = ["a.bvh".to_owned(), "b.bvh".to_owned(), "c.bvh".to_owned()];
        let outcomes = [
            told(1, EXCHANGE_LEFT, 0),
            told(1, EXCHANGE_PLANTED, 1),
            told(0, EXCHANGE_UNKNOWN, 0),
            told(2, EXCHANGE_PLANTED, 1),
            told(2, EXCHANGE_PLANTED, 1),
            told(2, EXCHANGE_LEFT, 1),
        ];
        let planting = Planting::new(&paths, paths.len(), &outcomes, Vec::new());
        assert_eq!((planting.unknown, planting.scenes.len()), (1, 2));
        let [first, second] = &planting.scenes[..] else { panic!() };
        assert_eq!(
            (first.tree.as_deref(), first.plantings, first.left_out.is_none()),
            (Some("b.bvh"), 1, true)
        );
        assert_eq!((second.plantings, second.seconds, second.left_out.is_some()), (2, 1.5, true));
        assert_eq!(planting.warnings.len(), 2, "{:?}", planting.warnings);
        assert!(
            planting.warnings[0].starts_with("scene 2 keeps") && planting.warnings[1].starts_with("c.bvh")
        );
    }
}
