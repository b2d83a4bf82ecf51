//! Opening and mapping files, for the binaries: the only module of the library that knows paths.
//!
//! Contract of the maps: the file is only read, and must not be truncated by another program while a tool runs
//! (the kernel then ends the process with SIGBUS). Writers make a new file beside the old one and rename it, so
//! that none of our own tools breaks this.

use memmap2::Mmap;
use std::fs::File;
use std::io;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A path and what the system said about it.
#[derive(Debug, Error)]
#[error("{}: cannot {action}: {source}", path.display())]
pub struct FileError {
    pub path: PathBuf,
    pub action: &'static str,
    pub source: io::Error,
}

impl FileError {
    pub fn new(path: &Path, action: &'static str, source: io::Error) -> FileError {
        FileError { path: path.to_owned(), action, source }
    }
}

/// A whole file, mapped read-only. Page-aligned, so that 64-byte aligned sections can be viewed in place.
#[derive(Debug)]
pub struct MappedFile(Option<Mmap>);

impl MappedFile {
    /// Maps `path`; an empty file is an empty slice.
    ///
    /// # Errors
    /// When the file cannot be opened, is not a regular file, or cannot be mapped.
    pub fn open(path: &Path) -> Result<MappedFile, FileError> {
        let file = File::open(path).map_err(|e| FileError::new(path, "open", e))?;
        let metadata = file.metadata().map_err(|e| FileError::new(path, "stat", e))?;
        if !metadata.is_file() {
            return Err(FileError::new(path, "map", io::Error::other("not a regular file")));
        }
        if metadata.len() == 0 {
            return Ok(MappedFile(None));
        }
        // SAFETY: the map is read-only and lives as long as the `Mmap`; that nobody truncates the file meanwhile is
        // the documented contract of this module.
        let map = unsafe { Mmap::map(&file) }.map_err(|e| FileError::new(path, "map", e))?;
        Ok(MappedFile(Some(map)))
    }
}

impl Deref for MappedFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.0.as_deref().unwrap_or(&[])
    }
}
