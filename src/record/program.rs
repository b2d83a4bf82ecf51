//! Recording a program that we did not write: it runs unmodified, with a preload library that decorates Embree's calls.
//!
//! The library (`embree-shim/preload*.cpp`) is in this binary; the program's loader gets it through a file without a name. Inside
//! the program, each thread copies its queries and their answers to a slot of shared memory, and each commit of a scene leaves a file
//! with its triangles and its tree (`exchange`, `capture`). Here, one thread empties the slots, guesses what queries were for
//! ([`purpose`]), chooses ([`select`]), puts scenes and their instances together (`flatten`), and writes (`collect`).
//!
//! So whatever happens to the program, what it has asked is here: an exit without destructors, a crash or a kill loses
//! at most the query that each thread was at. When this process is killed, the file is good up to its last chunk, and the program goes on.

mod capture;
pub mod clocks;
mod collect;
mod ending;
mod exchange;
mod flatten;
pub mod purpose;
pub mod report;
pub mod run;
pub mod select;
pub mod timed;
pub mod trees;

use crate::files::{self, FileError};
use crate::format::rays::Codec;
use collect::{CollectError, Collector, Target};
use exchange::{Exchange, memory_file, path_of};
use purpose::Rules;
use report::Report;
use select::{Selection, Selector};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;
use thiserror::Error;
use trees::{Trees, TreesError, Wanted};

/// The preload library.
const LIBRARY: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/preload.so"));
/// Set for the program: the path of the exchange.
const VARIABLE: &str = "EMBREE_TRACE_EXCHANGE";
/// A scene with more triangles, once its instances are flattened, gets no tree where nothing else is said.
pub const MOST_TRIANGLES: u32 = 100_000_000;
/// How long to wait when the program has handed over nothing.
const PAUSE: Duration = Duration::from_millis(1);

/// A program that somebody else wrote.
#[derive(Clone, Debug)]
pub struct Program {
    pub name: OsString,
    pub arguments: Vec<OsString>,
    /// What its standard output and error are added to, and then it reads nothing; ours when `None`.
    pub said: Option<PathBuf>,
}

impl Program {
    /// A program and its arguments as a command line has them; `None` without any word.
    pub fn from_words(words: Vec<OsString>) -> Option<Program> {
        let mut words = words.into_iter();
        words.next().map(|name| Program { name, arguments: words.collect(), said: None })
    }

    /// All words.
    pub fn words(&self) -> impl Iterator<Item = &OsString> {
        std::iter::once(&self.name).chain(&self.arguments)
    }

    /// Starts it with a preload library, and with variables set for it.
    fn start(&self, environment: &[(&str, String)], library: &File) -> Result<Child, ProgramError> {
        // Other libraries that are to be preloaded stay, behind ours.
        let mut preload = OsString::from(path_of(library));
        if let Some(others) = std::env::var_os("LD_PRELOAD").filter(|others| !others.is_empty()) {
            preload.push(":");
            preload.push(others);
        }
        let mut command = Command::new(&self.name);
        command
            .args(&self.arguments)
            .env("LD_PRELOAD", preload)
            .envs(environment.iter().map(|(name, value)| (name, value)));
        if let Some(path) = &self.said {
            let error = |source| ProgramError::File(FileError::new(path, "open", source));
            let file = File::options().append(true).create(true).open(path).map_err(error)?;
            command.stdin(Stdio::null()).stdout(file.try_clone().map_err(error)?).stderr(file);
        }
        let failed =
            |source| ProgramError::Start { program: self.name.to_string_lossy().into_owned(), source };
        let child = command.spawn().map_err(failed)?;
        // A terminal sends an interrupt to both: the program decides what it does then, and we write down what it asked.
        // SAFETY: to ignore a signal needs no handler.
        unsafe { libc::signal(libc::SIGINT, libc::SIG_IGN) };
        Ok(child)
    }
}

/// What to run, and what to write.
#[derive(Clone, Debug)]
pub struct Options {
    pub program: Program,
    pub rays: PathBuf,
    /// Of the first scene; see [`report::SceneLine::path`] for the others.
    pub bvh: PathBuf,
    pub codec: Codec,
    pub selection: Selection,
    /// By the program's name when `None`.
    pub rules: Option<Rules>,
    /// A scene with more, once its instances are flattened, gets no tree.
    pub max_triangles: u32,
    /// Trees that are planted in the program's scenes, and then recorded as theirs.
    pub wanted: Wanted,
}

/// Why there is no recording.
#[derive(Debug, Error)]
pub enum ProgramError {
    #[error("{0}")]
    File(#[from] FileError),
    #[error(transparent)]
    Trees(#[from] TreesError),
    #[error("cannot run {program}: {source}")]
    Start { program: String, source: io::Error },
    #[error("cannot share memory with the program: {0}")]
    Exchange(io::Error),
    #[error(
        "{path}: recording stopped after {records} queries (readable): {source}; the program was left to run on to its end"
    )]
    Write { path: String, records: u64, source: io::Error },
    #[error(
        "{path}: {records} queries are recorded and readable, but their scene is not: {source}; the program was left to run on to its end"
    )]
    Scene { path: String, records: u64, source: FileError },
}

/// Runs the program to its end and records what it asks Embree. SIGTERM and SIGHUP end the recording, whose files are then as complete as any, and
/// leave the program alone.
///
/// # Errors
/// When it cannot be run, or a file cannot be written. Also then the program runs to its end.
pub fn record(options: &Options) -> Result<Report, ProgramError> {
    ending::note_signals();
    let trees = (!options.wanted.is_empty()).then(|| Trees::new(&options.wanted)).transpose()?;
    let out = files::create(&options.rays)?;
    let directory = Directory::beside(&options.rays)?;
    let exchange = Exchange::new(&directory.0).map_err(ProgramError::Exchange)?;
    let library = library_file(LIBRARY).map_err(ProgramError::Exchange)?;
    let rules = options.rules.unwrap_or_else(|| Rules::of_program(Path::new(&options.program.name)));
    let selector = Selector::new(options.selection.clone(), rules);
    let command = options.program.words();
    let target = Target {
        bvh: options.bvh.clone(),
        directory: directory.0.clone(),
        codec: options.codec,
        max_triangles: options.max_triangles,
        command: command.map(|word| word.to_string_lossy().into_owned()).collect(),
        planted: trees.as_ref().map(Trees::candidates).unwrap_or_default(),
    };
    let failed = |records, error| match error {
        CollectError::Rays(source) => {
            ProgramError::Write { path: options.rays.display().to_string(), records, source }
        }
        CollectError::Tree(source) => {
            ProgramError::Scene { path: options.rays.display().to_string(), records, source }
        }
    };
    let mut collector =
        Collector::new(target, out, selector).map_err(|error| failed(0, CollectError::Rays(error)))?;

    let mut environment = vec![(VARIABLE, exchange.path())];
    environment.extend(trees.as_ref().map(|trees| (trees::VARIABLE, trees.path())));
    let mut child = options.program.start(&environment, &library)?;
    let end = match collect(&mut child, &mut collector, &exchange) {
        Ok(end) => end,
        Err(error) => {
            exchange.stop();
            // The program runs on to its end; what it says comes before what we say.
            while matches!(child.try_wait(), Ok(None)) && ending::signal().is_none() {
                std::thread::sleep(PAUSE);
            }
            return Err(failed(collector.totals().records, error));
        }
    };
    let records = collector.totals().records;
    let (totals, scenes, seen) = collector.finish(&exchange).map_err(|error| failed(records, error))?;
    let counters = exchange.counters();
    let mut report = Report {
        status: end.exit_code(),
        rays: options.rays.display().to_string(),
        bytes: totals.bytes,
        seen,
        records: totals.records,
        rejects: totals.rejects,
        threads: counters.threads,
        processes: counters.processes,
        scenes,
        planting: None,
        warnings: Vec::new(),
    };
    if let Some(trees) = &trees {
        report.planting = Some(trees.planting().map_err(ProgramError::Exchange)?);
    }
    report.warnings.extend(end.warning());
    for scene in &report.scenes {
        let named = |warning: &String| format!("scene {}: {warning}", scene.number);
        report.warnings.extend(scene.warnings.iter().map(named));
    }
    report.warn(&counters);
    Ok(report)
}

/// A file in memory with a preload library in it.
fn library_file(library: &[u8]) -> io::Result<File> {
    let mut file = memory_file(c"libembree_trace_preload.so")?;
    file.write_all(library)?;
    Ok(file)
}

/// As a shell says it.
fn exit_code(status: ExitStatus) -> i32 {
    status.code().unwrap_or_else(|| 128 + status.signal().unwrap_or(0))
}

/// Why there is nothing more to record.
enum End {
    Program(ExitStatus),
    /// This process was sent a signal; the program runs on.
    Signal(i32),
}

impl End {
    /// As a shell says it.
    fn exit_code(&self) -> i32 {
        match self {
            End::Program(status) => exit_code(*status),
            End::Signal(signal) => 128 + signal,
        }
    }

    fn warning(&self) -> Option<String> {
        match self {
            End::Program(status) => status.signal().map(|signal| {
                format!("the program was ended by signal {signal}; what it had asked until then is recorded")
            }),
            End::Signal(signal) => Some(format!(
                "the recording was ended by signal {signal}; the program runs on, and what it had asked until then is recorded"
            )),
        }
    }
}

/// Empties the slots until the program or a signal ends that.
fn collect(child: &mut Child, collector: &mut Collector, exchange: &Exchange) -> Result<End, CollectError> {
    loop {
        let busy = collector.step(exchange)?;
        if let Some(status) = child.try_wait().map_err(CollectError::Rays)? {
            return Ok(End::Program(status));
        }
        if let Some(signal) = ending::signal() {
            return Ok(End::Signal(signal));
        }
        if !busy {
            std::thread::sleep(PAUSE);
        }
    }
}

/// Where the program puts its scenes: beside the recording, for that is where room for them is; removed at the end.
struct Directory(PathBuf);

impl Directory {
    fn beside(rays: &Path) -> Result<Directory, FileError> {
        let error = |source| FileError::new(rays, "create a directory beside", source);
        let parent = rays.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let parent = fs::canonicalize(parent).map_err(error)?;
        let name = rays.file_name().unwrap_or_default().to_string_lossy().into_owned();
        remove_abandoned(&parent, &name);
        let path = parent.join(format!(".{name}.{}.scenes", std::process::id()));
        fs::create_dir(&path).map_err(error)?;
        Ok(Directory(path))
    }
}

/// Removes what recorders of the same file left that were killed.
fn remove_abandoned(parent: &Path, name: &str) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let file_name = entry.file_name();
        let process = file_name
            .to_str()
            .and_then(|file| file.strip_prefix('.')?.strip_prefix(name)?.strip_prefix('.'))
            .and_then(|rest| rest.strip_suffix(".scenes")?.parse::<u32>().ok());
        if process.is_some_and(|process| !Path::new(&format!("/proc/{process}")).exists()) {
            // What cannot be removed is in nobody's way.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        // What cannot be removed is in nobody's way.
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_recorder_left_is_removed_and_nothing_else() {
        let parent = tempfile::tempdir().expect("a temporary directory");
        let living = std::process::id();
        // No process has the greatest number.
        let [abandoned, other, alive] = [
            format!(".a.rays.{}.scenes", u32::MAX),
            format!(".b.rays.{}.scenes", u32::MAX),
            format!(".a.rays.{living}.scenes"),
        ]
        .map(|name| parent.path().join(name));
        for path in [&abandoned, &other, &alive] {
            fs::create_dir(path).expect("made");
            fs::write(path.join("0.scene"), "triangles").expect("written");
        }
        remove_abandoned(parent.path(), "a.rays");
        assert_eq!([abandoned.exists(), other.exists(), alive.exists()], [false, true, true]);
    }
}
