//! What `trace-info` shows: a summary of either file, as text for people and as the same numbers in JSON.
//!
//! A parsed file → [`rays::Summary`] or [`bvh::Summary`], which serialise, and print themselves through `text`.

pub mod bvh;
pub mod histogram;
pub mod rays;
pub(crate) mod text;

use crate::format::FormatError;
use crate::progress::Progress;
use serde::Serialize;

/// The summary of a file of either kind.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Summary {
    Rays(rays::Summary),
    Bvh(bvh::Summary),
}

impl Summary {
    /// Reads the whole of a file of either kind.
    ///
    /// # Errors
    /// When the bytes are of neither kind, or damaged; with `verify` also when a check of [`crate::format::rays::Rays::verify`] or
    /// [`crate::format::bvh::Bvh::verify`] fails.
    pub fn of(bytes: &[u8], verify: bool, progress: &Progress) -> Result<Summary, FormatError> {
        // What is of neither kind gets the error of a `.rays`, which shows the bytes that were found.
        if crate::format::FileKind::of(bytes) == Some(crate::format::FileKind::Bvh) {
            return bvh::Summary::of(bytes, verify).map(Summary::Bvh);
        }
        rays::Summary::of(bytes, verify, progress).map(Summary::Rays)
    }

    /// Whether recording of the file was cut off.
    pub fn is_cut_off(&self) -> bool {
        matches!(self, Summary::Rays(summary) if summary.recovery.is_some())
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Summary::Rays(summary) => summary.fmt(f),
            Summary::Bvh(summary) => summary.fmt(f),
        }
    }
}
