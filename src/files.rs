//! Opening, mapping and making files, for the binaries: the only module of the library that knows paths.
//!
//! Contract of the maps: the file is only read, and must not be truncated by another program while a tool runs
//! (the kernel then ends the process with SIGBUS). Writers make a new file beside the old one and rename it, so
//! that none of our own tools breaks this.

use memmap2::Mmap;
use std::fs::{self, File};
use std::io::{self, Write};
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

/// A file that appears under its name only when it is whole. Until [`Self::commit`] it is a hidden neighbour, which is
/// removed when the value is dropped; an older file of the name stays as it is.
///
/// For `.bvh` files, images and reports. A `.rays` is written straight to its path ([`create`]): what a killed
/// recording leaves there can be read.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    neighbour: PathBuf,
    file: File,
    committed: bool,
}

impl OutputFile {
    /// Makes the neighbour. The process number in its name keeps two programs that write the same path apart.
    ///
    /// # Errors
    /// When the path is a directory, or its directory does not exist or cannot be written.
    pub fn create(path: &Path) -> Result<OutputFile, FileError> {
        let unnamed = || FileError::new(path, "create", io::ErrorKind::IsADirectory.into());
        if path.is_dir() {
            return Err(unnamed());
        }
        let name = path.file_name().ok_or_else(unnamed)?;
        let neighbour =
            path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
        let file = File::create(&neighbour).map_err(|error| FileError::new(path, "create", error))?;
        Ok(OutputFile { path: path.to_owned(), neighbour, file, committed: false })
    }

    /// The error of writing this file: use it for what a library writer returned.
    pub fn write_error(&self, source: io::Error) -> FileError {
        FileError::new(&self.path, "write", source)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// When the system reports a late write error (a full disk), or the name cannot be given.
    pub fn commit(mut self) -> Result<(), FileError> {
        self.file.sync_data().map_err(|error| FileError::new(&self.path, "write", error))?;
        fs::rename(&self.neighbour, &self.path)
            .map_err(|error| FileError::new(&self.path, "rename to", error))?;
        self.committed = true;
        Ok(())
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if !self.committed {
            // Nothing can be done about a neighbour that cannot be removed, and the first error is already on its way.
            let _ = fs::remove_file(&self.neighbour);
        }
    }
}

/// Opens a file to be written straight to its path, truncated: for a `.rays`, of which every moment is worth keeping.
///
/// # Errors
/// When the file cannot be made.
pub fn create(path: &Path) -> Result<File, FileError> {
    File::create(path).map_err(|error| FileError::new(path, "create", error))
}
