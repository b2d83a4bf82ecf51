//! One run of a program whose time is taken, on trees of ours or on Embree's: what it took in all, and its queries in Embree.
//!
//! Between a query and Embree stands a counter, and a clock at one of 64 (`embree-shim/preload_clock.cpp`): the same in both runs that are compared.

use super::clocks::{self, Clocks, SceneKey, SceneTime};
use super::run::{PAUSE, pass_on};
use super::trees::{self, Planting, Trees, Wanted};
use super::{Program, ProgramError, ending, exit_code, library_file};
use std::collections::BTreeMap;
use std::io;
use std::mem::MaybeUninit;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus};
use std::time::Instant;

/// The preload library that plants, and takes times.
const LIBRARY: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/preload_clock.so"));

/// What a run took.
#[derive(Clone, Debug)]
pub struct Timed {
    /// How the program ended: its exit code, or 128 and the signal.
    pub status: i32,
    pub planting: Planting,
    pub times: BTreeMap<SceneKey, SceneTime>,
    /// Processor time of the program and of its children that it has waited for, with that of the system.
    pub processor_seconds: f64,
    /// From start to end.
    pub seconds: f64,
}

impl Timed {
    /// All that was asked.
    pub fn total(&self) -> SceneTime {
        self.times.values().fold(SceneTime::default(), |mut sum, time| {
            sum.add(time);
            sum
        })
    }
}

/// Runs the program to its end, on the trees that are wanted; on Embree's where none is. SIGTERM and SIGHUP are passed on to it.
///
/// # Errors
/// When it cannot be run, or a tree cannot be read.
pub fn run(program: &Program, wanted: &Wanted) -> Result<Timed, ProgramError> {
    ending::note_signals();
    let trees = Trees::new(wanted)?;
    let rows = Clocks::new().map_err(ProgramError::Exchange)?;
    let library = library_file(LIBRARY).map_err(ProgramError::Exchange)?;
    let environment = [(trees::VARIABLE, trees.path()), (clocks::VARIABLE, rows.path())];
    let started = Instant::now();
    let child = program.start(&environment, &library)?;
    let (status, processor_seconds) = wait(child).map_err(ProgramError::Exchange)?;
    let seconds = started.elapsed().as_secs_f64();
    let planting = trees.planting().map_err(ProgramError::Exchange)?;
    Ok(Timed { status: exit_code(status), planting, times: rows.times(), processor_seconds, seconds })
}

/// Waits for the program's end; its processor time, in seconds.
fn wait(child: Child) -> io::Result<(ExitStatus, f64)> {
    let mut passed_on = false;
    loop {
        let mut status = 0;
        let mut usage = MaybeUninit::<libc::rusage>::zeroed();
        // SAFETY: the process is a child that has not been waited for; both results are written to places of our own.
        let found =
            unsafe { libc::wait4(child.id() as libc::pid_t, &mut status, libc::WNOHANG, usage.as_mut_ptr()) };
        match found {
            0 => {}
            -1 => {
                let error = io::Error::last_os_error();
                if error.kind() != io::ErrorKind::Interrupted {
                    return Err(error);
                }
            }
            _ => {
                // SAFETY: plain numbers, zeroed before and filled by the kernel.
                let usage = unsafe { usage.assume_init() };
                let seconds = |time: libc::timeval| time.tv_sec as f64 + 1e-6 * time.tv_usec as f64;
                return Ok((ExitStatus::from_raw(status), seconds(usage.ru_utime) + seconds(usage.ru_stime)));
            }
        }
        pass_on(&child, &mut passed_on);
        std::thread::sleep(PAUSE);
    }
}
