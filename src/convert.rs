//! Recordings and trees in the formats of other programs, and back: what `trace-convert` does.
//!
//! Queries flow in pieces of at most a chunk from a [`Source`] (ours, the 2011 files, NumPy, Parquet) through a [`Selection`] to a
//! [`Sink`] (the same, and lines of an OBJ), so memory does not grow with the file, and every source goes with every sink. Trees are mapped or
//! read whole ([`trees`]). What a format has no place for is counted in [`Losses`] and reported: nothing is dropped silently. Each format is
//! read and written in one module.

pub mod boxes;
pub mod bvh_2011;
pub mod kinds;
pub mod lines;
pub mod losses;
pub mod npy;
pub mod numbering;
pub mod parquet;
pub mod queries;
pub mod rays;
pub mod rays_2011;
pub mod replayed;
mod summary;
pub mod trees;

pub use kinds::Kind;
pub use losses::Losses;
pub use queries::{Selection, Sink, Source, copy, scenes};
pub use summary::Summary;

use self::parquet::{ParquetSink, ParquetSource};
use crate::format::FormatError;
use crate::format::rays::{Codec, Header, Rays};
use crate::replay::scene::SceneError;
use bytes::Bytes;
use lines::LinesSink;
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
    /// The input is a table that is damaged, or not one of queries.
    #[error("not a table of queries, or damaged: {0}")]
    Table(String),
    /// There is no way from one format to the other.
    #[error("{from} cannot become {to}; see trace-convert --help for what can")]
    Pair { from: &'static str, to: &'static str },
    /// The output cannot hold that part of a tree.
    #[error("--part {part} cannot be written as {to}; see trace-convert --help for what can")]
    Part { part: &'static str, to: &'static str },
    /// The output cannot be written.
    #[error(transparent)]
    Output(#[from] io::Error),
    /// The tree is not of the scene of the queries.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// The queries of a file of the given format.
///
/// # Errors
/// When the file is damaged, or of another format.
pub fn source<'a>(bytes: &'a Bytes, from: Kind) -> Result<Box<dyn Source + 'a>, ConvertError> {
    Ok(match from {
        Kind::Rays => Box::new(RaysSource::new(Rays::parse(bytes)?)),
        Kind::Rays2011 => Box::new(Rays2011Source::parse(bytes)?),
        Kind::Npy => Box::new(NpySource::parse(bytes)?),
        Kind::Parquet => Box::new(ParquetSource::parse(bytes.clone())?),
        Kind::Bvh | Kind::Bvh2011 | Kind::Obj => {
            return Err(ConvertError::Pair { from: from.name(), to: "queries" });
        }
    })
}

/// Begins a file of the given format. `header` says what is known of all queries; `count`, which only an array needs, how many will come; `codec`
/// how a `.rays` stores them.
///
/// # Errors
/// When the format is not one of queries, or `out` cannot be written.
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
        Kind::Parquet => Box::new(ParquetSink::new(out, header)?),
        Kind::Obj => Box::new(LinesSink::new(out)),
        Kind::Bvh | Kind::Bvh2011 => return Err(ConvertError::Pair { from: "queries", to: to.name() }),
    })
}
