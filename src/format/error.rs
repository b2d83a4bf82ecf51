//! What is wrong with a file: where, what was found, what was expected, and what to do about it, in one line.

use super::FileKind;
use std::fmt::Display;
use thiserror::Error;

/// A file that cannot be read as what it should be. The binaries put the path before it.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("at byte {offset}: {problem}")]
pub struct FormatError {
    /// Byte offset in the file.
    pub offset: u64,
    pub problem: Problem,
}

/// The kinds of damage.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Problem {
    #[error("the file is empty, expected a {} file; record it again", expected.name())]
    Empty { expected: FileKind },
    #[error("found a {} file, expected a {} file; were two arguments swapped?", found.name(), expected.name())]
    OtherKind { found: FileKind, expected: FileKind },
    #[error(
        "found a file that starts with \"{}\", expected the magic of a {} file; give a file that embree-trace wrote",
        found.escape_ascii(), expected.name()
    )]
    Magic { found: Vec<u8>, expected: FileKind },
    #[error(
        "found format version {found}, expected {supported}; use the version of embree-trace that wrote the file"
    )]
    Version { found: u16, supported: u16 },
    #[error("the file ends inside the {what}: {available} bytes left{}; copy or record it again", needed_text(*needed))]
    Truncated { what: &'static str, needed: Option<u64>, available: u64 },
    #[error(
        "checksum of the {what}: found {found:016x}, expected {expected:016x}; the file is damaged, copy or record it again"
    )]
    Checksum { what: String, found: u64, expected: u64 },
    #[error(
        "{name}: found {found}, expected {expected}; the file is damaged or its writer is wrong, record it again"
    )]
    Field { name: String, found: String, expected: String },
    #[error(
        "the bytes in memory start at an address that is no multiple of 4: give an aligned buffer or a memory map"
    )]
    Unaligned,
}

/// Text from a file, as it may stand in an error: its first `most` characters, in one line.
pub fn excerpt(text: &str, most: usize) -> String {
    text.chars().take(most).map(|c| if c.is_control() { '?' } else { c }).collect()
}

fn needed_text(needed: Option<u64>) -> String {
    needed.map_or(String::new(), |needed| format!(", expected {needed}"))
}

impl FormatError {
    pub fn new(offset: u64, problem: Problem) -> FormatError {
        FormatError { offset, problem }
    }

    /// A value that is not what it has to be.
    pub fn field(
        offset: u64,
        name: impl Display,
        found: impl Display,
        expected: impl Display,
    ) -> FormatError {
        let (name, found, expected) = (name.to_string(), found.to_string(), expected.to_string());
        FormatError { offset, problem: Problem::Field { name, found, expected } }
    }
}
