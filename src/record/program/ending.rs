//! A signal that ends the recording, and not the recorded program: SIGTERM or SIGHUP sent to `embree-trace record` alone.
//!
//! The handler only notes which it was. The thread that empties the slots looks there, completes the files with what has been asked until
//! then, and removes the scenes' directory, which a handler could not do.

use std::sync::atomic::{AtomicI32, Ordering};

/// The first signal that came; 0 when none has.
static SIGNAL: AtomicI32 = AtomicI32::new(0);

/// Notes SIGTERM and SIGHUP from now on, unless they are ignored (`nohup`). A program that is started later does not inherit that.
pub fn note_signals() {
    for signal in [libc::SIGTERM, libc::SIGHUP] {
        // SAFETY: both structures are plain data, for which zeros are valid, and are filled before they are used. The handler has the
        // signature that no SA_SIGINFO asks for, and touches one atomic only. Calls that a signal interrupts go on.
        unsafe {
            let mut before: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &mut before);
            if before.sa_sigaction == libc::SIG_IGN {
                continue;
            }
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = note as extern "C" fn(libc::c_int) as usize;
            action.sa_flags = libc::SA_RESTART;
            libc::sigaction(signal, &action, std::ptr::null_mut());
        }
    }
}

extern "C" fn note(signal: libc::c_int) {
    // Another one changes nothing.
    let _ = SIGNAL.compare_exchange(0, signal, Ordering::Relaxed, Ordering::Relaxed);
}

/// The signal that has asked for an end.
pub fn signal() -> Option<i32> {
    Some(SIGNAL.load(Ordering::Relaxed)).filter(|&signal| signal != 0)
}
