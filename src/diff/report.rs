//! What a comparison found, as text and as JSON.

use crate::replay::pixels::ImageSize;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Formatter};

/// A value that is not the same in both files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Value {
    pub name: String,
    pub a: String,
    pub b: String,
}

impl Value {
    pub(super) fn new(name: impl ToString, a: impl ToString, b: impl ToString) -> Value {
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

/// A pixel whose queries differ.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Differing {
    /// y * width + x.
    pub path: u32,
    /// Where that is, when the image's size is known and the pixel is in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel: Option<[u32; 2]>,
    /// Depth of the first of its queries that differs; none where it is not known.
    pub depth: Option<u8>,
    pub differences: u64,
}

impl Differing {
    pub(super) fn new(path: u32, depth: Option<u8>, image: Option<ImageSize>) -> Differing {
        let pixel = image.and_then(|image| image.pixel(path)).map(|(x, y)| [x, y]);
        Differing { path, pixel, depth, differences: 1 }
    }
}

impl fmt::Display for Differing {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        match self.pixel {
            Some([x, y]) => write!(f, "{x},{y}")?,
            None => write!(f, "path {}", self.path)?,
        }
        match self.depth {
            Some(depth) => write!(f, " at depth {depth}"),
            None => write!(f, " at an unknown depth"),
        }
    }
}

/// Differences and ties by the pixel that was asked for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PixelReport {
    /// Pixels that either recording asked for.
    pub total: u64,
    /// Pixels none of whose queries differs.
    pub agree: u64,
    /// Pixels that agree, and have a tie.
    pub agree_with_ties: u64,
    /// The first pixels that differ, in the order of A.
    pub first: Vec<Differing>,
}

/// How queries differ.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct QueryReport {
    /// Queries of both files that are not the same.
    pub changed: u64,
    /// Queries that only A has.
    pub missing: u64,
    /// Queries that only B has.
    pub added: u64,
    /// Queries whose answers name two triangles at one t; they are no differences.
    pub ties: u64,
    /// Differences behind a tie in the same path of a pixel: what is asked there may follow from it.
    pub after_ties: u64,
    /// None when no query says its pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixels: Option<PixelReport>,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// What was compared, in A and in B: queries, or nodes.
    pub unit: &'static str,
    pub count_a: u64,
    pub count_b: u64,
    /// Elements that differ; those that only one file has are differences, too.
    pub differences: u64,
    /// How many of them differ in which value.
    pub by_value: BTreeMap<&'static str, u64>,
    /// Of recordings.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub queries: Option<QueryReport>,
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
    pub(super) fn differ(&mut self, names: &[&'static str], describe: impl FnOnce() -> First) {
        self.differences += 1;
        for &name in names {
            *self.by_value.entry(name).or_default() += 1;
        }
        if self.first.is_none() {
            self.first = Some(describe());
        }
    }

    /// Elements that only one file has, `described` by the first of them.
    pub(super) fn differ_in_length(&mut self, name: &'static str, a: u64, b: u64) {
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

    pub(super) fn note(&mut self, name: &str, a: impl ToString, b: impl ToString) {
        let value = Value::new(name, a, b);
        if value.a != value.b {
            self.notes.push(value);
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let Report { unit, .. } = self;
        let [count_a, count_b, differences] =
            [self.count_a, self.count_b, self.differences].map(crate::inspect::text::grouped);
        let same_count = self.count_a == self.count_b;
        match self.is_equal() {
            true if same_count => write!(f, "equal: {count_a} {unit}")?,
            true => write!(f, "equal: {count_a} {unit} in A, {count_b} in B")?,
            false if same_count => write!(f, "different: {differences} differences in {count_a} {unit}")?,
            false => {
                write!(f, "different: {differences} differences, {count_a} {unit} in A, {count_b} in B")?;
            }
        }
        writeln!(f)?;
        if let Some(queries) = &self.queries {
            write!(f, "{queries}")?;
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

impl fmt::Display for QueryReport {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let text = crate::inspect::text::grouped;
        if self.changed + self.missing + self.added > 0 {
            let [changed, missing, added] = [self.changed, self.missing, self.added].map(text);
            writeln!(f, "queries: {changed} changed, {missing} only in A, {added} only in B")?;
        }
        if self.ties > 0 {
            write!(f, "ties: {} queries hit two triangles at one t", text(self.ties))?;
            if self.after_ties > 0 {
                write!(f, "; {} differences come behind one in their path", text(self.after_ties))?;
            }
            writeln!(f)?;
        }
        let Some(pixels) = &self.pixels else { return Ok(()) };
        if pixels.agree < pixels.total {
            write!(f, "pixels: {} of {} agree", text(pixels.agree), text(pixels.total))?;
            if let Some(first) = pixels.first.first() {
                write!(f, "; the first that differs is {first}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
