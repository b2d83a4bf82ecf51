//! Opening, mapping and making files, for the binaries: the only module of the library that knows paths.
//!
//! Contract of the maps: the file is only read, and must not be truncated by another program while a tool runs
//! (the kernel then sends SIGBUS, which ends a binary with one line: `signals`). Writers make a new file and give it the name, they
//! never truncate one, so that none of our own tools breaks this.

pub(crate) mod signals;

use memmap2::Mmap;
use signals::Held;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
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
pub struct MappedFile {
    /// Leaves the table before the map goes.
    _held: Option<Held>,
    map: Option<Mmap>,
}

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
            return Ok(MappedFile { _held: None, map: None });
        }
        // SAFETY: the map is read-only and lives as long as the `Mmap`; that nobody truncates the file meanwhile is
        // the documented contract of this module.
        let map = unsafe { Mmap::map(&file) }.map_err(|e| FileError::new(path, "map", e))?;
        Ok(MappedFile { _held: Some(signals::hold_map(path, &map)), map: Some(map) })
    }
}

impl Deref for MappedFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.map.as_deref().unwrap_or(&[])
    }
}

/// For owners of bytes that other libraries know.
impl AsRef<[u8]> for MappedFile {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

/// A file that appears under its name only when it is whole. Until [`Self::commit`] it is a hidden neighbour, which is
/// removed when the value is dropped, or a signal ends a binary; an older file of the name stays as it is. Where the name is a device or a pipe, it is
/// written straight; where it is a link, the file that it points to is replaced.
///
/// For `.bvh` files, images and reports. A `.rays` is written straight to its path ([`create`]): what a killed
/// recording leaves there can be read.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    /// What the neighbour is called now, and what it will be called; `None` when the path is written straight.
    rename: Option<(PathBuf, PathBuf)>,
    file: File,
    /// Of the neighbour.
    _held: Option<Held>,
}

impl OutputFile {
    /// Makes the neighbour. The process number in its name keeps two programs that write the same path apart.
    ///
    /// # Errors
    /// When the path is a directory, or its directory does not exist or cannot be written.
    pub fn create(path: &Path) -> Result<OutputFile, FileError> {
        let error = |error| FileError::new(path, "create", error);
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => return Err(error(io::ErrorKind::IsADirectory.into())),
            Ok(metadata) if !metadata.is_file() => {
                let file = File::options().write(true).open(path).map_err(error)?;
                return Ok(OutputFile { path: path.to_owned(), rename: None, file, _held: None });
            }
            _ => {}
        }
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let name = target.file_name().ok_or_else(|| error(io::ErrorKind::IsADirectory.into()))?;
        let neighbour =
            target.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
        // Held before it is there: a signal may come at once.
        let held = Some(signals::hold_neighbour(&neighbour));
        let file = File::create(&neighbour).map_err(error)?;
        Ok(OutputFile { path: path.to_owned(), rename: Some((neighbour, target)), file, _held: held })
    }

    /// The error of writing this file: use it for what a library's writer returned.
    pub fn write_error(&self, source: io::Error) -> FileError {
        FileError::new(&self.path, "write", source)
    }

    /// Writes the whole file through a buffer, and gives it its name.
    ///
    /// # Errors
    /// What `write` returns, with the path, or as for [`Self::commit`].
    pub fn commit_with<T>(
        mut self,
        write: impl FnOnce(&mut dyn Write) -> io::Result<T>,
    ) -> Result<T, FileError> {
        let mut out = BufWriter::with_capacity(1 << 20, &mut self.file);
        let written = write(&mut out).and_then(|value| out.flush().map(|()| value));
        // A buffer that could not be flushed must not try again when it is dropped.
        drop(out.into_parts());
        let value = written.map_err(|error| self.write_error(error))?;
        self.commit()?;
        Ok(value)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// When the system reports a late write error (a full disk), or the name cannot be given.
    pub fn commit(mut self) -> Result<(), FileError> {
        let Some((neighbour, target)) = &self.rename else { return Ok(()) };
        self.file.sync_data().map_err(|error| self.write_error(error))?;
        fs::rename(neighbour, target).map_err(|error| FileError::new(&self.path, "rename to", error))?;
        self.rename = None;
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
        if let Some((neighbour, _)) = &self.rename {
            // Nothing can be done about a neighbour that cannot be removed, and the first error is already on its way.
            let _ = fs::remove_file(neighbour);
        }
    }
}

/// Makes a file to be written straight to its path: for a `.rays`, of which every moment is worth keeping. An older file of the name
/// is unlinked, not truncated, so that whoever has it mapped keeps what is in it. Where the name is a device or a pipe, it is written as it is.
///
/// # Errors
/// When the file cannot be made.
pub fn create(path: &Path) -> Result<File, FileError> {
    let error = |error| FileError::new(path, "create", error);
    let mut target = path.to_owned();
    if fs::metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        // Of a link, the file that it points to is replaced.
        target = fs::canonicalize(path).map_err(error)?;
        // A file that may not be written may not be replaced either, even where its directory would allow it.
        File::options().write(true).open(&target).map_err(error)?;
        fs::remove_file(&target).map_err(error)?;
    }
    File::create(target).map_err(error)
}

/// Whether `path` can be opened to be read: for files that are needed later.
///
/// # Errors
/// When it cannot.
pub fn check_readable(path: &Path) -> Result<(), FileError> {
    File::open(path).map(|_| ()).map_err(|error| FileError::new(path, "open", error))
}

/// Makes a directory, and those above it; one that is there already must be empty, so that what is written can be told from
/// what was there.
///
/// # Errors
/// When it cannot be made or read, or is not empty.
pub fn create_empty_directory(path: &Path) -> Result<(), FileError> {
    fs::create_dir_all(path).map_err(|error| FileError::new(path, "create the directory", error))?;
    let mut entries =
        fs::read_dir(path).map_err(|error| FileError::new(path, "read the directory", error))?;
    match entries.next() {
        None => Ok(()),
        Some(_) => {
            let error = io::Error::other("the directory is not empty");
            Err(FileError::new(path, "record into", error))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn an_output_replaces_the_old_file_only_when_committed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("out.bvh");
        fs::write(&path, "old").unwrap();
        let mut output = OutputFile::create(&path).unwrap();
        output.write_all(b"half").unwrap();
        drop(output);
        assert_eq!(fs::read(&path).unwrap(), b"old");

        let mut output = OutputFile::create(&path).unwrap();
        output.write_all(b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        output.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(directory.path()), ["out.bvh"]);
    }

    #[test]
    fn a_link_stays_a_link() {
        let directory = tempfile::tempdir().unwrap();
        let (file, link) = (directory.path().join("file"), directory.path().join("link"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let mut output = OutputFile::create(&link).unwrap();
        output.write_all(b"new").unwrap();
        output.commit().unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(link.is_symlink());
    }

    #[test]
    fn a_file_that_is_replaced_at_once_stays_whole_for_whoever_maps_it() {
        let directory = tempfile::tempdir().unwrap();
        let (path, link) = (directory.path().join("casts.rays"), directory.path().join("link"));
        fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let old = MappedFile::open(&path).unwrap();
        create(&link).unwrap().write_all(b"newer").unwrap();
        assert_eq!(&old[..], b"old");
        assert_eq!(fs::read(&path).unwrap(), b"newer");
        assert!(link.is_symlink());
        assert!(create(Path::new("/dev/null")).is_ok());
    }

    #[test]
    fn what_cannot_be_made_is_named() {
        let directory = tempfile::tempdir().unwrap();
        for path in [directory.path().to_owned(), directory.path().join("none/out"), PathBuf::from("/")] {
            let line = OutputFile::create(&path).unwrap_err().to_string();
            assert!(line.starts_with(&format!("{}: cannot create: ", path.display())), "{line}");
        }
    }

    #[test]
    fn a_full_disk_is_an_error_with_the_path() {
        let path = Path::new("/dev/full");
        let mut output = OutputFile::create(path).unwrap();
        let error = output.write_all(b"lost").unwrap_err();
        let line = output.write_error(error).to_string();
        assert!(line.starts_with("/dev/full: cannot write: No space left"), "{line}");
        let buffered = OutputFile::create(path).unwrap().commit_with(|out| out.write_all(b"lost"));
        assert_eq!(buffered.unwrap_err().to_string(), line);
        assert!(path.exists());
    }

    #[test]
    fn a_directory_to_fill_is_empty() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a/b");
        create_empty_directory(&path).unwrap();
        create_empty_directory(&path).unwrap();
        fs::write(path.join("old"), "").unwrap();
        let line = create_empty_directory(&path).unwrap_err().to_string();
        assert_eq!(line, format!("{}: cannot record into: the directory is not empty", path.display()));
        let line = create_empty_directory(&path.join("old")).unwrap_err().to_string();
        assert!(line.starts_with(&format!("{}: cannot create", path.join("old").display())), "{line}");
    }

    #[test]
    fn what_cannot_be_mapped_is_named() {
        let directory = tempfile::tempdir().unwrap();
        assert!(
            MappedFile::open(&directory.path().join("none")).unwrap_err().to_string().contains("cannot open")
        );
        assert!(MappedFile::open(directory.path()).unwrap_err().to_string().contains("not a regular file"));
        fs::write(directory.path().join("empty"), "").unwrap();
        assert!(MappedFile::open(&directory.path().join("empty")).unwrap().is_empty());
    }
}
