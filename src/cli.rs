//! What every binary shares: exit codes, the one line of an error, output formats.
//!
//! Exit codes: 0 good, 1 a comparison failed, 2 bad input or usage. A broken pipe is success (`… | head`).

mod generate;

use crate::cost::Costs;
use crate::files::{MappedFile, signals};
use crate::ranks::{self, RankFailed, Ranks};
use clap::{Command, Parser, ValueEnum};
use std::ffi::OsString;
use std::fmt;
use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

/// How a command ended, when it could do its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Good,
    /// A comparison failed: the difference that the command looks for is there.
    Failed,
}

impl Outcome {
    fn code(self) -> u8 {
        match self {
            Outcome::Good => 0,
            Outcome::Failed => 1,
        }
    }
}

/// What went wrong, as one line. Anything that displays itself converts into it with `?`.
#[derive(Debug)]
pub struct Failure {
    line: String,
    broken_pipe: bool,
    /// Another rank failed, not this one.
    elsewhere: Option<RankFailed>,
}

impl Failure {
    pub fn new(line: impl fmt::Display) -> Failure {
        Failure { line: line.to_string(), broken_pipe: false, elsewhere: None }
    }

    /// What is wrong with a file.
    pub fn in_file(path: &Path, error: impl std::error::Error + 'static) -> Failure {
        let failure = Failure::from(error);
        Failure { line: format!("{}: {}", path.display(), failure.line), ..failure }
    }
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Failure {
        let broken_pipe = (&error as &dyn std::error::Error)
            .downcast_ref::<io::Error>()
            .is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe);
        let sources = std::iter::successors(Some(&error as &dyn std::error::Error), |error| error.source());
        let elsewhere = sources.filter_map(|error| error.downcast_ref::<RankFailed>()).next().cloned();
        Failure { line: error.to_string(), broken_pipe, elsewhere }
    }
}

/// Reads a file of costs ([`Costs::parse`]).
///
/// # Errors
/// When it cannot be opened, or has no costs that can be used.
pub fn costs(path: &Path) -> Result<Costs, Failure> {
    let bytes = MappedFile::open(path)?;
    let text = std::str::from_utf8(&bytes).map_err(|error| Failure::in_file(path, error))?;
    Costs::parse(text).map_err(|error| Failure::in_file(path, error))
}

/// Parses a command line. Help and version go to the standard output, and the program ends well; what cannot be parsed ends it with one line
/// and exit code 2.
pub fn parse<A: Parser>(program: &'static str, words: impl IntoIterator<Item = OsString>) -> A {
    parse_beside(program, words, |command| command)
}

/// Parses as [`parse`] does. `beside` adds subcommands that the binary parses elsewhere, so that man pages and completions have them.
pub fn parse_beside<A: Parser>(
    program: &'static str,
    words: impl IntoIterator<Item = OsString>,
    beside: impl FnOnce(Command) -> Command,
) -> A {
    let words: Vec<OsString> = words.into_iter().collect();
    if let Some(prefix) = generate::wanted(&words) {
        let Err(failure) = generate::write(program, beside(A::command()), prefix) else {
            std::process::exit(0)
        };
        eprintln!("{program}: error: {}", failure.line);
        std::process::exit(2)
    }
    A::try_parse_from(words).unwrap_or_else(|error| {
        if !error.use_stderr() {
            error.exit();
        }
        eprintln!("{program}: error: {}; see {program} --help", usage_line(&error.to_string()));
        std::process::exit(2)
    })
}

/// What clap says in several lines: the fault and its tips, without the usage.
fn usage_line(text: &str) -> String {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let said =
        lines.take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more information"));
    said.collect::<Vec<&str>>().join(" ").trim_start_matches("error: ").to_owned()
}

/// Runs a binary's body and turns its end into an exit code. A signal that ends it leaves no half-written output.
pub fn run(program: &str, body: impl FnOnce() -> Result<Outcome, Failure>) -> ExitCode {
    run_with_code(program, || body().map(Outcome::code))
}

/// Runs a body as [`run`] does that has an exit code of its own: that of a program which it started.
pub fn run_with_code(program: &str, body: impl FnOnce() -> Result<u8, Failure>) -> ExitCode {
    signals::install(program);
    ended(program, start_threads(0).and_then(|()| body()), true)
}

/// Starts the threads of rayon's pool; 0 is one per processor. Rayon would do so at their first use, and panic where there is no memory for them.
fn start_threads(count: usize) -> Result<(), Failure> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().map_err(Failure::from)
}

/// Runs a binary's body, with so many threads (0: one per processor), on every rank of an MPI job where `mpi` asks for it, else in this process alone. Where a rank fails, all end with
/// exit code 2, and the first says what failed and on which.
pub fn run_on_ranks(
    program: &str,
    mpi: bool,
    threads: usize,
    body: impl FnOnce(&dyn Ranks) -> Result<Outcome, Failure>,
) -> ExitCode {
    signals::install(program);
    match ranks::start(mpi) {
        Ok(ranks) => {
            let result = start_threads(threads).and_then(|()| body(&*ranks));
            ended(program, agreed(&*ranks, result).map(Outcome::code), ranks.rank() == 0)
        }
        Err(error) => ended(program, Err(error.into()), true),
    }
}

/// The exit code, after one line where there is an error to be told.
fn ended(program: &str, result: Result<u8, Failure>, tells: bool) -> ExitCode {
    match result {
        Ok(code) => ExitCode::from(code),
        Err(failure) if failure.broken_pipe => ExitCode::SUCCESS,
        Err(failure) => {
            if tells {
                eprintln!("{program}: error: {}", failure.line.replace('\n', " "));
            }
            ExitCode::from(2)
        }
    }
}

/// A result that is good only where every rank's is.
fn agreed(ranks: &dyn Ranks, result: Result<Outcome, Failure>) -> Result<Outcome, Failure> {
    if ranks.count() == 1 {
        return result;
    }
    let failed = match result {
        Ok(outcome) => match ranks::gather_all(ranks, ()) {
            Ok(_) => return Ok(outcome),
            Err(failed) => failed,
        },
        Err(Failure { elsewhere: Some(failed), .. }) => failed,
        Err(failure) => ranks::tell_failure(ranks, &failure.line),
    };
    // What the first says needs no name: it is what one process would have said.
    Err(if failed.rank == 0 { Failure::new(failed.line) } else { Failure::new(failed) })
}

/// A length of time in seconds, as `--budget` has it.
///
/// # Errors
/// When it is no number, is negative, or longer than any time.
pub fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    seconds.ok_or_else(|| "expected a number of seconds, not negative".into())
}

/// `--format` of commands that print for people or for machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TextOrJson {
    Text,
    Json,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usage_is_one_line() {
        #[derive(Debug, Parser)]
        struct Arguments {
            #[arg(long)]
            budget: f64,
            path: String,
        }
        let said = |words: &[&str]| {
            let error = Arguments::try_parse_from([&["program"], words].concat()).unwrap_err();
            usage_line(&error.to_string())
        };
        assert_eq!(
            said(&["a", "--budget", "x"]),
            "invalid value 'x' for '--budget <BUDGET>': invalid float literal"
        );
        assert!(said(&["--budget", "1"]).ends_with("arguments were not provided: <PATH>"));
        let tip = said(&["a", "--budge", "1"]);
        assert!(tip.starts_with("unexpected argument '--budge'") && tip.contains("'--budget'"), "{tip}");
    }
}
