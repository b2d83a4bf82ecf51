//! Errors as C has them: a code, and a line that the calling thread can ask for.

use crate::header::{
    ET_ERROR_ARGUMENT, ET_ERROR_FILE, ET_ERROR_INTERNAL, ET_ERROR_MEMORY, ET_ERROR_REFUSED, ET_ERROR_STATE,
    ET_OK,
};
use embree_trace::embree::host::HostError;
use embree_trace::record::host::HostRecordError;
use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char, c_int};
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// RTC_ERROR_OUT_OF_MEMORY.
const OUT_OF_MEMORY: i32 = 4;

thread_local! {
    static MESSAGE: RefCell<CString> = RefCell::default();
}

/// Why a call failed.
#[derive(Debug)]
pub struct Failure {
    code: u32,
    message: String,
}

impl Failure {
    pub fn argument(message: impl Display) -> Failure {
        Failure { code: ET_ERROR_ARGUMENT, message: message.to_string() }
    }

    pub fn file(message: impl Display) -> Failure {
        Failure { code: ET_ERROR_FILE, message: message.to_string() }
    }

    pub fn state(message: impl Display) -> Failure {
        Failure { code: ET_ERROR_STATE, message: message.to_string() }
    }

    /// Of a tree that the scene does not take.
    pub fn not_planted(error: HostError) -> Failure {
        let mut failure = Failure::from(error);
        failure.message =
            format!("not planted, and the scene keeps the tree that it has: {}", failure.message);
        failure
    }

    /// The same, of a file.
    pub fn of(mut self, path: &Path) -> Failure {
        self.message = format!("{}: {}", path.display(), self.message);
        self
    }

    fn panic(panic: &(dyn Any + Send)) -> Failure {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        Failure { code: ET_ERROR_INTERNAL, message: format!("a defect of embree-trace: {text}") }
    }
}

impl From<HostError> for Failure {
    fn from(error: HostError) -> Failure {
        let code = match error {
            HostError::Refused(_) => ET_ERROR_REFUSED,
            HostError::Other { code: OUT_OF_MEMORY, .. } => ET_ERROR_MEMORY,
            HostError::Other { .. } => ET_ERROR_INTERNAL,
        };
        Failure { code, message: error.to_string() }
    }
}

impl From<HostRecordError> for Failure {
    fn from(error: HostRecordError) -> Failure {
        match error {
            HostRecordError::Host(error) => error.into(),
            HostRecordError::Forked => Failure::state(error),
            HostRecordError::File(_) | HostRecordError::Write { .. } => Failure::file(error),
        }
    }
}

/// Runs the work of a call. No panic leaves it.
pub fn guarded(work: impl FnOnce() -> Result<(), Failure>) -> c_int {
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(Failure::panic(&*panic)));
    let code = match outcome {
        Ok(()) => ET_OK,
        Err(failure) => {
            remember(&failure.message);
            failure.code
        }
    };
    code as c_int
}

/// Keeps a message as one line.
fn remember(message: &str) {
    let line: String = message.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).collect();
    // A line without control characters has no zero. A thread that is ending has no message any
    // more.
    let _ = MESSAGE.try_with(|kept| *kept.borrow_mut() = CString::new(line).unwrap_or_default());
}

/// See the header.
pub fn message() -> *const c_char {
    MESSAGE.try_with(|kept| kept.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}
