//! Running a program on trees of ours, without recording it: queries go to Embree as they always do, and only commits pass
//! through the preload library.

use super::ending;
use super::trees::{Planting, Trees, Wanted};
use super::{Program, ProgramError, exit_code, library_file};
use serde::Serialize;
use std::process::Child;
use std::time::Duration;

/// The preload library that only plants.
const LIBRARY: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/preload_plant.so"));
/// How often is looked whether the program has ended.
pub(super) const PAUSE: Duration = Duration::from_millis(5);

/// What to run, and what to plant.
#[derive(Clone, Debug)]
pub struct Options {
    pub program: Program,
    pub wanted: Wanted,
}

/// What came of it.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// How the program ended: its exit code, or 128 and the signal.
    pub status: i32,
    #[serde(flatten)]
    pub planting: Planting,
}

/// Runs the program to its end. SIGTERM and SIGHUP are passed on to it.
///
/// # Errors
/// When it cannot be run, or a tree cannot be read.
pub fn run(options: &Options) -> Result<Report, ProgramError> {
    ending::note_signals();
    let trees = Trees::new(&options.wanted)?;
    let library = library_file(LIBRARY).map_err(ProgramError::Exchange)?;
    let environment = [(super::trees::VARIABLE, trees.path())];
    let mut child = options.program.start(&environment, &library)?;
    let mut passed_on = false;
    let status = loop {
        if let Some(status) = child.try_wait().map_err(ProgramError::Exchange)? {
            break status;
        }
        pass_on(&child, &mut passed_on);
        std::thread::sleep(PAUSE);
    };
    let planting = trees.planting().map_err(ProgramError::Exchange)?;
    Ok(Report { status: exit_code(status), planting })
}

/// Sends the program, once, the signal that asks us for an end.
pub(super) fn pass_on(child: &Child, passed_on: &mut bool) {
    if let Some(signal) = ending::signal().filter(|_| !*passed_on) {
        *passed_on = true;
        // SAFETY: the process is a child that has not been waited for, so its number is still its own.
        unsafe { libc::kill(child.id() as libc::pid_t, signal) };
    }
}
