//! Whether two files hold the same: what `trace-diff` says, and what regression tests of a renderer stand on.
//!
//! Two parsed files → a [`Report`]: the number of differences, the first one with both values, and notes on what
//! is told but does not count. [`bvh`] compares trees element by element. [`rays`] compares queries: `in_order`
//! (or `any_order`) finds which query of the one file answers to which of the other, `query` compares such a pair,
//! `tie` says whether two triangles are hit at one t, and `tally` counts.

mod any_order;
pub mod bvh;
mod in_order;
mod pairing;
mod path_set;
mod query;
pub mod rays;
mod reader;
mod report;
mod tally;
mod tie;

pub use report::{Differing, First, PixelReport, QueryReport, Report, Value};
pub use tie::{Trees, TreesError};

use crate::format::rays::{Header, Rays};
use crate::format::{FileKind, FormatError};
use crate::progress::Progress;
use crate::replay::pixels::ImageSize;

/// How close two floats have to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// The same bits: 0 and -0 differ, a NaN equals itself.
    Exact,
    /// Not further apart than this, relative to the larger of both (for a vector: to its largest component).
    Relative(f32),
}

impl Tolerance {
    /// Whether two numbers of the given magnitude are equal; at least the larger of both is the magnitude.
    fn equal(self, a: f32, b: f32, magnitude: f32) -> bool {
        match self {
            Tolerance::Exact => a.to_bits() == b.to_bits(),
            Tolerance::Relative(tolerance) => {
                // Equal infinities have no difference to take; a NaN equals a NaN.
                let scale = magnitude.max(a.abs()).max(b.abs());
                a == b
                    || (a.is_nan() && b.is_nan())
                    || (scale.is_finite() && (a - b).abs() <= tolerance * scale)
            }
        }
    }

    fn equal_vectors(self, a: glam::Vec3, b: glam::Vec3) -> bool {
        if self == Tolerance::Exact {
            return bytemuck::bytes_of(&a) == bytemuck::bytes_of(&b);
        }
        let magnitude = a.abs().max_element().max(b.abs().max_element());
        a.to_array().iter().zip(b.to_array()).all(|(&a, b)| self.equal(a, b, magnitude))
    }
}

/// What counts as a difference, and what is known beside the two files.
#[derive(Clone, Copy, Debug)]
pub struct Options<'a> {
    /// Of what was asked: origins, directions, intervals and times; and of everything in trees.
    pub questions: Tolerance,
    /// Of what was answered: t, u and v. Unless it is [`Tolerance::Exact`], two triangles at one t are a tie.
    pub answers: Tolerance,
    /// Compare the queries as multisets: their order does not count.
    pub any_order: bool,
    /// The trees that the recordings were made with, as far as they are known: they tell a tie from another hit.
    pub trees: Trees<'a>,
    /// Which pixel a path is.
    pub image: Option<ImageSize>,
}

impl Options<'_> {
    /// One tolerance for everything, and nothing known beside the files.
    pub fn new(tolerance: Tolerance) -> Self {
        Options {
            questions: tolerance,
            answers: tolerance,
            any_order: false,
            trees: Trees::default(),
            image: None,
        }
    }
}

/// Why two files could not be compared.
#[derive(Debug, thiserror::Error)]
pub enum DiffError {
    #[error("A: {0}")]
    A(FormatError),
    #[error("B: {0}")]
    B(FormatError),
    #[error("A is a {} file and B a {} file: give two of a kind", .0.name(), .1.name())]
    Kinds(FileKind, FileKind),
    #[error("{0} has no queries: there is nothing to compare, record it again")]
    NoQueries(&'static str),
    #[error("{0}; it belongs to recordings (.rays), and A and B are trees")]
    NotForTrees(&'static str),
    #[error(transparent)]
    Trees(#[from] TreesError),
}

/// Compares two files of the same kind.
///
/// # Errors
/// When a file is damaged, of another kind or without queries, or a tree is of another scene.
pub fn compare(a: &[u8], b: &[u8], options: &Options, progress: &Progress) -> Result<Report, DiffError> {
    match (FileKind::of(a), FileKind::of(b)) {
        (Some(kind_a), Some(kind_b)) if kind_a != kind_b => Err(DiffError::Kinds(kind_a, kind_b)),
        (Some(FileKind::Bvh), _) | (None, Some(FileKind::Bvh)) => {
            let misplaced = [
                (options.any_order, "--any-order compares queries"),
                (!options.trees.is_empty(), "--tree tells a tie from another hit"),
                (options.image.is_some(), "--image says which pixel a query serves"),
            ];
            match misplaced.iter().find(|(given, _)| *given) {
                Some((_, what)) => Err(DiffError::NotForTrees(what)),
                None => bvh::compare(a, b, options.questions),
            }
        }
        _ => rays::compare(a, b, options, progress),
    }
}

/// The headers of two recordings, to find out which trees are theirs.
///
/// # Errors
/// When one of them is no recording, or its header is damaged.
pub fn headers(a: &[u8], b: &[u8]) -> Result<[Header; 2], DiffError> {
    Ok([Rays::parse(a).map_err(DiffError::A)?.header, Rays::parse(b).map_err(DiffError::B)?.header])
}
