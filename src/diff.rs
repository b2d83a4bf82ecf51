//! Whether two files hold the same: what `trace-diff` says, and what regression tests of a renderer stand on.
//!
//! Two parsed files → a [`Report`]: the number of differences, the first one with both values, and notes on what
//! is told but does not count. [`rays`] compares queries, [`bvh`] trees.

pub mod bvh;
pub mod rays;

use crate::format::{FileKind, FormatError};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Formatter};

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
        let magnitude = a.abs().max_element().max(b.abs().max_element());
        a.to_array().iter().zip(b.to_array()).all(|(&a, b)| self.equal(a, b, magnitude))
    }
}

/// A value that is not the same in both files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Value {
    pub name: String,
    pub a: String,
    pub b: String,
}

impl Value {
    fn new(name: impl ToString, a: impl ToString, b: impl ToString) -> Value {
        Value { name: name.to_string(), a: a.to_string(), b: b.to_string() }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        write!(f, "{}: {} in A, {} in B", self.name, self.a, self.b)
    }
}

/// The first element that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct First {
    /// What differs: a query with its pixel, depth and purpose, or an element of a section.
    pub element: String,
    pub values: Vec<Value>,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// What was compared, in A and in B: queries, or nodes.
    pub unit: &'static str,
    pub count_a: u64,
    pub count_b: u64,
    /// Elements that differ; those that only the longer file has are differences, too.
    pub differences: u64,
    /// How many of them differ in which value.
    pub by_value: BTreeMap<&'static str, u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<First>,
    /// What is different and does not count.
    pub notes: Vec<Value>,
}

impl Report {
    /// Whether nothing that counts differs.
    pub fn is_equal(&self) -> bool {
        self.differences == 0
    }

    /// One more element differs, in the named values; `describe` tells of the first.
    fn differ(&mut self, names: &[&'static str], describe: impl FnOnce() -> First) {
        self.differences += 1;
        for &name in names {
            *self.by_value.entry(name).or_default() += 1;
        }
        if self.first.is_none() {
            self.first = Some(describe());
        }
    }

    /// Elements that only one file has, `described` by the first of them.
    fn differ_in_length(&mut self, name: &'static str, a: u64, b: u64) {
        let more = a.abs_diff(b);
        if more == 0 {
            return;
        }
        self.differences += more;
        *self.by_value.entry(name).or_default() += more;
        if self.first.is_none() {
            let element = format!("{name} {}", a.min(b));
            self.first = Some(First { element, values: vec![Value::new(format!("number of {name}"), a, b)] });
        }
    }

    fn note(&mut self, name: &str, a: impl ToString, b: impl ToString) {
        let value = Value::new(name, a, b);
        if value.a != value.b {
            self.notes.push(value);
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let Report { unit, count_a, count_b, differences, .. } = self;
        match (self.is_equal(), count_a == count_b) {
            (true, _) => writeln!(f, "equal: {count_a} {unit}")?,
            (false, true) => writeln!(f, "different: {differences} differences in {count_a} {unit}")?,
            (false, false) => {
                writeln!(f, "different: {differences} differences, {count_a} {unit} in A, {count_b} in B")?;
            }
        }
        if let Some(first) = &self.first {
            writeln!(f, "first: {}", first.element)?;
            first.values.iter().try_for_each(|value| writeln!(f, "  {value}"))?;
        }
        if !self.by_value.is_empty() {
            let counts: Vec<String> =
                self.by_value.iter().map(|(name, count)| format!("{name} {count}")).collect();
            writeln!(f, "by value: {}", counts.join(", "))?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "note: {note}"))
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
}

/// Compares two files of the same kind.
///
/// # Errors
/// When a file is damaged or of another kind.
pub fn compare(
    a: &[u8],
    b: &[u8],
    tolerance: Tolerance,
    progress: &crate::progress::Progress,
) -> Result<Report, DiffError> {
    match (FileKind::of(a), FileKind::of(b)) {
        (Some(kind_a), Some(kind_b)) if kind_a != kind_b => Err(DiffError::Kinds(kind_a, kind_b)),
        (Some(FileKind::Bvh), _) | (None, Some(FileKind::Bvh)) => bvh::compare(a, b, tolerance),
        _ => rays::compare(a, b, tolerance, progress),
    }
}
