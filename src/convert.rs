//! Recordings and trees in the formats of other programs, and back: what `trace-convert` does.
//!
//! Queries flow in pieces of at most a chunk from a [`Source`] (ours, the 2011 files, NumPy) through a [`Selection`] to a
//! [`Sink`], so memory does not grow with the file, and every source goes with every sink. What a format has no place for is counted in [`Losses`] and
//! reported: nothing is dropped silently. Each format is read and written in one module.

pub mod kinds;
pub mod losses;
pub mod npy;
pub mod queries;
pub mod rays;
pub mod rays_2011;
pub mod replayed;
mod summary;

pub use kinds::Kind;
pub use losses::Losses;
pub use queries::{Selection, Sink, Source, copy};
pub use summary::Summary;

use crate::format::FormatError;
use crate::format::rays::{Codec, Header, Rays};
use npy::{NpySink, NpySource};
use rays::{RaysSink, RaysSource};
use rays_2011::{Rays2011Sink, Rays2011Source};
use std::io::{self, Write};
use thiserror::Error;

/// Why a file cannot be converted.
#[derive(Debug, Error)]
pub enum ConvertError {
    /// The input is damaged.
    #[error(transparent)]
    Input(#[from] FormatError),
    /// The output cannot be written.
    #[error(transparent)]
    Output(#[from] io::Error),
    /// The recording's fingerprint is not the tree's.
    #[error("the tree is of another scene (fingerprint {tree:016x}) than the queries ({queries:016x})")]
    OtherScene { tree: u64, queries: u64 },
}

/// The queries of a file of the given format.
///
/// # Errors
/// When the file is damaged, or of another format.
pub fn source<'a>(bytes: &'a [u8], from: Kind) -> Result<Box<dyn Source + 'a>, ConvertError> {
    Ok(match from {
        Kind::Rays => Box::new(RaysSource::new(Rays::parse(bytes)?)),
        Kind::Rays2011 => Box::new(Rays2011Source::parse(bytes)?),
        Kind::Npy => Box::new(NpySource::parse(bytes)?),
    })
}

/// Begins a file of the given format. `header` says what is known of all queries; `count`, which only an array needs, how many will come; `codec`
/// how a `.rays` stores them.
///
/// # Errors
/// When `out` cannot be written.
pub fn sink<'a>(
    out: impl Write + 'a,
    to: Kind,
    header: &Header,
    count: u64,
    codec: Codec,
) -> Result<Box<dyn Sink + 'a>, ConvertError> {
    Ok(match to {
        Kind::Rays => Box::new(RaysSink::new(out, header, codec)?),
        Kind::Rays2011 => Box::new(Rays2011Sink::new(out, header)),
        Kind::Npy => Box::new(NpySink::new(out, header, count)?),
    })
}
