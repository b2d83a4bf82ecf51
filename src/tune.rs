//! A program made faster without a change to it: what it asks Embree is recorded, a tree is built for each of its scenes, and it runs on
//! Embree's trees and on ours in turn.
//!
//! Data flows so: a first run is counted, so that the share of paths that gives [`Options::queries`] is known → a recorded run
//! ([`crate::record::program`]) → trees (`build`) → rounds of one run on Embree's trees and one on ours ([`timed`]) → medians and spread
//! ([`report`]). Files that the program writes are compared after each run ([`outputs`]). What does not pay is moved out of the
//! directory of trees, so that `embree-trace run --trees` has what does.

mod build;
pub mod outputs;
pub mod report;

use crate::files::{self, FileError};
use crate::format::FormatError;
use crate::format::rays::Codec;
use crate::progress::Progress;
use crate::recipe::RecipeError;
use crate::record::program::select::Selection;
use crate::record::program::timed::{self, Timed};
use crate::record::program::trees::Wanted;
use crate::record::program::{self, Program, ProgramError};
use crate::training::TrainingError;
use build::Building;
use outputs::Outputs;
use report::{Report, Round};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// What is tuned, and how much may be tried.
#[derive(Clone, Debug)]
pub struct Options {
    /// It is run again and again, and must ask the same each time; what it says goes to a file.
    pub program: Program,
    /// Where trees go: one for each scene, named by the scene's fingerprint.
    pub trees: PathBuf,
    /// Queries that are recorded at most, about: of whole paths, an even part.
    pub queries: u64,
    /// Time for all trees; each scene has the share of it that it has of the queries.
    pub budget: Duration,
    /// How often the program runs on Embree's trees and on ours.
    pub rounds: u32,
    /// Files that the program writes.
    pub outputs: Vec<PathBuf>,
    /// Whether triangles may be cut, and stand in several leaves. They never are where the program's filters refuse hits.
    pub cuts: bool,
}

/// Why nothing was tuned.
#[derive(Debug, Error)]
pub enum TuneError {
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error("{0}")]
    File(#[from] FileError),
    #[error("{}: {source}", path.display())]
    Format { path: PathBuf, source: FormatError },
    #[error("{}: {source}", path.display())]
    Training { path: PathBuf, source: TrainingError },
    #[error("{}: {source}", path.display())]
    Recipe { path: PathBuf, source: RecipeError },
    #[error("the program ended with {status} {run}: what it said is in {}", said.display())]
    Failed { status: i32, run: &'static str, said: PathBuf },
    #[error(
        "the program has asked Embree nothing: it may have none, another version than 3, or one linked into it; what it said is in {}", said.display()
    )]
    NoQueries { said: PathBuf },
    #[error("there is nothing to plant: {0}")]
    NoTrees(String),
}

/// Where everything but the trees is kept, below their directory.
const KEPT: &str = "tune";
/// What the program says, there.
const SAID: &str = "said.txt";

/// Runs the program 2 + 2 · rounds times.
///
/// # Errors
/// When the program cannot be run or fails, asks Embree nothing, has no scene that a tree can be planted in, or a file cannot be
/// written.
pub fn tune(options: &Options) -> Result<Report, TuneError> {
    let kept = options.trees.join(KEPT);
    let said = kept.join(SAID);
    if said.exists() {
        // Of the last time. Somebody else's directory of this name has no such file.
        fs::remove_dir_all(&kept).map_err(|error| FileError::new(&kept, "remove", error))?;
    }
    files::create_empty_directory(&kept)?;
    // From now on it is ours.
    File::create(&said).map_err(|error| FileError::new(&said, "create", error))?;
    let program = Program { said: Some(said.clone()), ..options.program.clone() };
    let mut outputs = Outputs::new(&options.outputs, &kept.join("outputs"));
    let progress = Progress::new("tuning", u64::from(options.rounds) * 2 + 3);
    let run = |outputs: &mut Outputs, wanted: &Wanted, name| -> Result<Timed, TuneError> {
        outputs.before_run();
        let timed = timed::run(&program, wanted)?;
        progress.advance(1);
        match timed.status {
            0 => Ok(timed),
            status => Err(TuneError::Failed { status, run: name, said: said.clone() }),
        }
    };

    let counted = run(&mut outputs, &Wanted::default(), "in its first run")?;
    let queries = counted.total().queries();
    if queries == 0 {
        return Err(TuneError::NoQueries { said });
    }
    outputs.plain()?;
    outputs.before_run();
    let recorded = record(options, &program, &kept, queries)?;
    progress.advance(1);
    if recorded.status != 0 {
        return Err(TuneError::Failed { status: recorded.status, run: "while it was recorded", said });
    }
    outputs.plain()?;

    let built = Building { options, recorded: &recorded, kept: &kept }.build()?;
    progress.advance(1);
    if built.trees.is_empty() {
        return Err(TuneError::NoTrees(built.left_out.join("; ")));
    }
    let wanted =
        Wanted { trees: built.trees.iter().map(|tree| tree.path.clone()).collect(), directory: None };
    let mut rounds = Vec::new();
    for number in 0..options.rounds {
        let plain = |outputs: &mut Outputs| {
            let timed = run(outputs, &Wanted::default(), "on Embree's trees")?;
            outputs.plain()?;
            Ok::<_, TuneError>(timed)
        };
        let planted = |outputs: &mut Outputs| {
            let timed = run(outputs, &wanted, "on planted trees")?;
            outputs.planted()?;
            Ok::<_, TuneError>(timed)
        };
        // Whoever comes second finds a warmer machine: they take turns.
        rounds.push(if number % 2 == 0 {
            let plain = plain(&mut outputs)?;
            Round { plain, planted: planted(&mut outputs)? }
        } else {
            let planted = planted(&mut outputs)?;
            Round { plain: plain(&mut outputs)?, planted }
        });
    }
    drop(progress);
    let mut report = Report::new(options, &recorded, built, &rounds, outputs.finish());
    report.put_aside(&kept)?;
    report.write(&kept.join("report.json"))?;
    Ok(report)
}

/// Records an even part of the program's paths.
fn record(
    options: &Options,
    program: &Program,
    kept: &Path,
    queries: u64,
) -> Result<program::report::Report, TuneError> {
    let every = queries.div_ceil(options.queries.max(1));
    Ok(program::record(&program::Options {
        program: program.clone(),
        rays: kept.join("casts.rays"),
        bvh: kept.join("built.bvh"),
        codec: Codec::Raw,
        selection: Selection { every, ..Selection::default() },
        rules: None,
        max_triangles: program::MOST_TRIANGLES,
        wanted: Wanted::default(),
    })?)
}
