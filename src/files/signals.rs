//! What a signal that ends the process leaves behind: no half-written neighbour of an output file, and one line when it
//! was a mapped file that shrank.
//!
//! [`super::MappedFile`] and [`super::OutputFile`] enter what they hold into a table; the handler, which a binary installs, walks it. A
//! read behind the new end of a file that was truncated is answered with SIGBUS. There is nothing to go on with then, for
//! what was read before may be wrong too: the handler says so and ends the process with exit code 2. After SIGINT, SIGTERM, SIGHUP
//! and SIGABRT (out of memory) it removes the neighbours, and the process ends by the signal, as it would have.

use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr;
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering::SeqCst};

/// More than any command holds at once. What finds no room is not looked after: its signal ends the process as if
/// there was no handler, and its neighbour stays.
const ROOM: usize = 256;

/// One held file: a map of `length` bytes at `start`, or an output's neighbour, which has length 0.
struct Slot {
    taken: AtomicBool,
    start: AtomicUsize,
    length: AtomicUsize,
    /// From [`CString::into_raw`]; null while there is nothing to see here.
    path: AtomicPtr<c_char>,
}

static TABLE: [Slot; ROOM] = [const {
    Slot {
        taken: AtomicBool::new(false),
        start: AtomicUsize::new(0),
        length: AtomicUsize::new(0),
        path: AtomicPtr::new(ptr::null_mut()),
    }
}; ROOM];

/// Set by the handler before it reads the table; from then on no path is freed.
static ENDING: AtomicBool = AtomicBool::new(false);

/// An entry of the table, for as long as the file is held.
#[derive(Debug)]
pub(super) struct Held(Option<usize>);

/// Enters a map.
pub(super) fn hold_map(path: &Path, map: &[u8]) -> Held {
    hold(path, map.as_ptr().addr(), map.len())
}

/// Enters a file to be removed when a signal ends the process.
pub(super) fn hold_neighbour(path: &Path) -> Held {
    // By its whole path: the process may go elsewhere.
    hold(&std::path::absolute(path).unwrap_or_else(|_| path.to_owned()), 0, 0)
}

fn hold(path: &Path, start: usize, length: usize) -> Held {
    let Ok(path) = CString::new(path.as_os_str().as_encoded_bytes()) else { return Held(None) };
    let free = |slot: &Slot| slot.taken.compare_exchange(false, true, SeqCst, SeqCst).is_ok();
    let Some(index) = TABLE.iter().position(free) else { return Held(None) };
    let slot = &TABLE[index];
    slot.start.store(start, SeqCst);
    slot.length.store(length, SeqCst);
    slot.path.store(path.into_raw(), SeqCst);
    Held(Some(index))
}

impl Drop for Held {
    fn drop(&mut self) {
        let Some(slot) = self.0.map(|index| &TABLE[index]) else { return };
        let path = slot.path.swap(ptr::null_mut(), SeqCst);
        // A handler that has seen the path set ENDING before it looked, so before the swap: then it is left to the handler.
        if !ENDING.load(SeqCst) {
            // SAFETY: `path` is from `into_raw` in `hold`; the swap took it out of the table, and no handler has it.
            drop(unsafe { CString::from_raw(path) });
            slot.taken.store(false, SeqCst);
        }
    }
}

#[cfg(unix)]
pub(crate) use handler::install;

/// Elsewhere there are no such signals.
#[cfg(not(unix))]
pub(crate) fn install(_program: &str) {}

#[cfg(unix)]
mod handler {
    use super::{CString, ENDING, TABLE, ptr};
    use libc::{c_int, c_void, siginfo_t};
    use std::ffi::CStr;
    use std::sync::atomic::{AtomicPtr, Ordering::SeqCst};

    /// What a line of the program starts with; null until there is a handler.
    static PREFIX: AtomicPtr<libc::c_char> = AtomicPtr::new(ptr::null_mut());
    const SHRANK: &CStr =
        c": the file became shorter, or its disk failed, while it was read: leave it alone meanwhile, or copy it\n";

    /// Installs the handler, which calls nothing but what POSIX allows in one. Signals that are ignored stay ignored.
    pub(crate) fn install(program: &str) {
        let Ok(prefix) = CString::new(format!("{program}: error: ")) else { return };
        if !PREFIX.swap(prefix.into_raw(), SeqCst).is_null() {
            // The handler is there already. The older prefix stays allocated: a signal may be using it.
            return;
        }
        for signal in [libc::SIGBUS, libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGABRT] {
            // SAFETY: both structures are plain data, for which zeros are valid, and are filled before they are used;
            // `ended` has the signature that SA_SIGINFO asks for. The handler stays for as long as it runs: several threads may read behind the
            // end of a file at once, and the default action of the second one's signal would end the process before the first has said why.
            unsafe {
                let mut before: libc::sigaction = std::mem::zeroed();
                libc::sigaction(signal, ptr::null(), &mut before);
                if before.sa_sigaction == libc::SIG_IGN {
                    continue;
                }
                let mut action: libc::sigaction = std::mem::zeroed();
                action.sa_sigaction = ended as extern "C" fn(c_int, *mut siginfo_t, *mut c_void) as usize;
                action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
                libc::sigaction(signal, &action, ptr::null_mut());
            }
        }
    }

    extern "C" fn ended(signal: c_int, info: *mut siginfo_t, _context: *mut c_void) {
        if ENDING.swap(true, SeqCst) {
            // Another thread is ending the process: this one must not go on with what it cannot read.
            loop {
                // SAFETY: waits for a signal, and takes nothing.
                unsafe { libc::pause() };
            }
        }
        // SAFETY: the kernel gives a valid `info` to a handler with SA_SIGINFO.
        let address = unsafe { (*info).si_addr() }.addr();
        let mut shrunk = ptr::null_mut();
        for slot in &TABLE {
            let path = slot.path.load(SeqCst);
            let (start, length) = (slot.start.load(SeqCst), slot.length.load(SeqCst));
            if path.is_null() {
                continue;
            }
            if length == 0 {
                // SAFETY: a path in the table is a C string, and none is freed any more.
                unsafe { libc::unlink(path) };
            } else if signal == libc::SIGBUS && address.wrapping_sub(start) < length {
                shrunk = path;
            }
        }
        if shrunk.is_null() {
            // The process ends by the signal once this handler returns, for then it is let through; a SIGBUS that is not of a map of ours
            // comes back by itself, too.
            // SAFETY: POSIX allows both in a handler; the first puts the default action in place, the second raises a signal for this thread.
            unsafe {
                libc::signal(signal, libc::SIG_DFL);
                libc::raise(signal);
            }
            return;
        }
        for text in [PREFIX.load(SeqCst), shrunk, SHRANK.as_ptr().cast_mut()] {
            // SAFETY: all three are C strings that live as long as the process; `_exit` below runs no code of ours.
            unsafe { libc::write(2, text.cast(), libc::strlen(text)) };
        }
        // SAFETY: ends the process at once.
        unsafe { libc::_exit(2) };
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::super::{MappedFile, OutputFile};
    use std::fs;
    use std::io::Write;
    use std::os::unix::process::ExitStatusExt;
    use std::path::PathBuf;
    use std::process::{Command, Output};

    const DIRECTORY: &str = "EMBREE_TRACE_TEST_SIGNALS";

    /// Runs the test of this name in a process of its own, which finds `directory` in its environment.
    fn run_apart(test: &str, directory: &std::path::Path) -> Output {
        let name = format!("files::signals::tests::{test}");
        Command::new(std::env::current_exe().unwrap())
            .args(["--exact", &name, "--nocapture"])
            .env(DIRECTORY, directory)
            .output()
            .unwrap()
    }

    #[test]
    fn a_file_that_shrinks_is_one_line_and_no_neighbour_stays() {
        if let Some(directory) = std::env::var_os(DIRECTORY).map(PathBuf::from) {
            super::install("reader");
            let path = directory.join("casts.rays");
            let _closed = MappedFile::open(&path).map(drop);
            let (map, other) = (MappedFile::open(&path).unwrap(), MappedFile::open(&path).unwrap());
            drop(other);
            let mut output = OutputFile::create(&directory.join("out.bvh")).unwrap();
            output.write_all(b"half").unwrap();
            fs::File::options().write(true).open(&path).unwrap().set_len(10).unwrap();
            // Ends the process here.
            let sum: u64 = map.iter().map(|&byte| u64::from(byte)).sum();
            panic!("the sum of a file that is not there is {sum}");
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("casts.rays");
        fs::write(&path, vec![1; 1 << 20]).unwrap();
        let ended = run_apart("a_file_that_shrinks_is_one_line_and_no_neighbour_stays", directory.path());
        let said = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(2), "{said}");
        assert!(
            said.contains(&format!("reader: error: {}: the file became shorter", path.display())),
            "{said}"
        );
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_interrupt_ends_by_its_signal_and_leaves_the_older_output() {
        if let Some(directory) = std::env::var_os(DIRECTORY).map(PathBuf::from) {
            super::install("writer");
            let mut output = OutputFile::create(&directory.join("out.bvh")).unwrap();
            output.write_all(b"half").unwrap();
            // SAFETY: raises a signal for this thread.
            unsafe { libc::raise(libc::SIGTERM) };
            panic!("the signal did not end the process");
        }
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("out.bvh"), "older").unwrap();
        let ended =
            run_apart("an_interrupt_ends_by_its_signal_and_leaves_the_older_output", directory.path());
        assert_eq!(ended.status.signal(), Some(libc::SIGTERM));
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
        assert_eq!(fs::read(directory.path().join("out.bvh")).unwrap(), b"older");
    }
}
