//! What every binary shares: exit codes, the one line of an error, output formats.
//!
//! Exit codes: 0 good, 1 a comparison failed, 2 bad input or usage. A broken pipe is success (`… | head`).

use clap::ValueEnum;
use std::fmt;
use std::io;
use std::process::ExitCode;

/// How a command ended, when it could do its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Good,
    /// A comparison failed: the difference that the command looks for is there.
    Failed,
}

/// What went wrong, as one line. Anything that displays itself converts into it with `?`.
#[derive(Debug)]
pub struct Failure {
    line: String,
    broken_pipe: bool,
}

impl Failure {
    pub fn new(line: impl fmt::Display) -> Failure {
        Failure { line: line.to_string(), broken_pipe: false }
    }
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Failure {
        let broken_pipe = (&error as &dyn std::error::Error)
            .downcast_ref::<io::Error>()
            .is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe);
        Failure { line: error.to_string(), broken_pipe }
    }
}

/// Runs a binary's body and turns its end into an exit code.
pub fn run(program: &str, body: impl FnOnce() -> Result<Outcome, Failure>) -> ExitCode {
    match body() {
        Ok(Outcome::Good) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::from(1),
        Err(failure) if failure.broken_pipe => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("{program}: error: {}", failure.line.replace('\n', " "));
            ExitCode::from(2)
        }
    }
}

/// `--format` of commands that print for people or for machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TextOrJson {
    Text,
    Json,
}
