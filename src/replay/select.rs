//! Which queries of a file take part: a filter on what they are, and a sample spread over the file.

use crate::format::rays::{NO_DEPTH, NO_PATH, Purpose, Record, kind};
use crate::random::mixed;
use std::fmt;
use std::ops::{Range, RangeInclusive};
use std::str::FromStr;
use thiserror::Error;

/// Conditions that a query must meet, all of them; none given, every query meets it.
///
/// As text: conditions separated by commas, each `key=value`.
/// - `purpose=NAME`: unknown, camera, shadow, ao, diffuse, specular; several joined by `+`
/// - `kind=closest` or `kind=occlusion`
/// - `depth=N`, `depth=A..B` (without B), `A..=B`, `A..`, `..B`, or `depth=unknown`
/// - `path=…` likewise: the pixel as y * width + x
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filter {
    /// Accepted purposes; empty accepts all.
    purposes: Vec<Purpose>,
    kind: Option<u8>,
    /// Accepted range of depths.
    depth: Option<Bounds>,
    path: Option<Bounds>,
}

/// A range of numbers that may be unknown, with both ends inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bounds {
    Unknown,
    Within(u32, u32),
}

impl Bounds {
    fn holds(self, value: u32, unknown: u32) -> bool {
        match self {
            Bounds::Unknown => value == unknown,
            Bounds::Within(first, last) => value != unknown && (first..=last).contains(&value),
        }
    }
}

/// What is wrong with a filter's text.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FilterError {
    #[error("filter condition \"{0}\": expected key=value")]
    NoValue(String),
    #[error("filter key \"{0}\": expected purpose, kind, depth or path")]
    Key(String),
    #[error("filter key \"{0}\" is given twice; join purposes with +, or widen the range")]
    Twice(String),
    #[error("filter {key}={found}: expected {expected}")]
    Value { key: String, found: String, expected: &'static str },
}

impl Filter {
    pub fn accepts(&self, record: &Record) -> bool {
        (self.purposes.is_empty() || self.purposes.contains(&Purpose::from_byte(record.purpose)))
            && self.kind.is_none_or(|kind| kind == record.kind)
            && self.depth.is_none_or(|depth| depth.holds(record.depth.into(), NO_DEPTH.into()))
            && self.path.is_none_or(|path| path.holds(record.path, u32::MAX))
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match *self {
            Bounds::Unknown => f.write_str("unknown"),
            Bounds::Within(first, last) if first == last => write!(f, "{first}"),
            Bounds::Within(first, u32::MAX) => write!(f, "{first}.."),
            Bounds::Within(first, last) => write!(f, "{first}..={last}"),
        }
    }
}

/// As it is typed.
impl fmt::Display for Filter {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let names: Vec<&str> = self.purposes.iter().map(|purpose| purpose.name()).collect();
        let conditions = [
            (!names.is_empty()).then(|| format!("purpose={}", names.join("+"))),
            self.kind.map(|kind| {
                format!("kind={}", if kind == kind::OCCLUSION { "occlusion" } else { "closest" })
            }),
            self.depth.map(|depth| format!("depth={depth}")),
            self.path.map(|path| format!("path={path}")),
        ];
        f.write_str(&conditions.into_iter().flatten().collect::<Vec<String>>().join(","))
    }
}

impl FromStr for Filter {
    type Err = FilterError;

    fn from_str(text: &str) -> Result<Filter, FilterError> {
        let mut filter = Filter::default();
        for condition in text.split(',').map(str::trim).filter(|condition| !condition.is_empty()) {
            let (key, value) =
                condition.split_once('=').ok_or_else(|| FilterError::NoValue(condition.to_owned()))?;
            let (key, value) = (key.trim(), value.trim());
            let wrong =
                |expected| FilterError::Value { key: key.to_owned(), found: value.to_owned(), expected };
            let taken = match key {
                "purpose" => {
                    let taken = !filter.purposes.is_empty();
                    let named = |name: &str| Purpose::ALL.into_iter().find(|p| p.name() == name.trim());
                    filter.purposes =
                        value.split('+').map(named).collect::<Option<_>>().ok_or_else(|| {
                            wrong("unknown, camera, shadow, ao, diffuse or specular, joined by +")
                        })?;
                    taken
                }
                "kind" => {
                    let kind = match value {
                        "closest" => kind::CLOSEST_HIT,
                        "occlusion" => kind::OCCLUSION,
                        _ => return Err(wrong("closest or occlusion")),
                    };
                    filter.kind.replace(kind).is_some()
                }
                "depth" | "path" => {
                    let bounds = parse_bounds(value)
                        .ok_or_else(|| wrong("a number, a range such as 1.., 0..4 or 0..=3, or unknown"))?;
                    let slot = if key == "depth" { &mut filter.depth } else { &mut filter.path };
                    slot.replace(bounds).is_some()
                }
                _ => return Err(FilterError::Key(key.to_owned())),
            };
            if taken {
                return Err(FilterError::Twice(key.to_owned()));
            }
        }
        Ok(filter)
    }
}

fn parse_bounds(text: &str) -> Option<Bounds> {
    if text == "unknown" {
        return Some(Bounds::Unknown);
    }
    let range = parse_range(text)?;
    Some(Bounds::Within(*range.start(), *range.end()))
}

/// The range that a text such as `3`, `1..`, `..4`, `0..4` or `0..=3` names; none when it is empty.
pub fn parse_range(text: &str) -> Option<RangeInclusive<u32>> {
    let number = |text: &str| text.trim().parse::<u32>().ok();
    let Some((first, last)) = text.split_once("..") else {
        return number(text).map(|n| n..=n);
    };
    let first = if first.is_empty() { 0 } else { number(first)? };
    let last = match last.strip_prefix('=') {
        Some(last) => number(last)?,
        None if last.is_empty() => u32::MAX,
        None => number(last)?.checked_sub(1)?,
    };
    (first <= last).then_some(first..=last)
}

/// A sample of `size` of `total` queries: the file is cut into `size` equal strata, and each gives one, at a place that
/// looks random (a fixed stride would fall in step with image rows) but is always the same.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    size: u64,
    total: u64,
}

impl Sample {
    /// None when all of them are wanted.
    pub fn new(size: u64, total: u64) -> Option<Sample> {
        (size < total).then_some(Sample { size, total })
    }

    /// The chosen indices in `range`, ascending.
    pub fn within(self, range: Range<u64>) -> impl Iterator<Item = u64> {
        let scaled = |a: u64, b: u64, c: u64| (u128::from(a) * u128::from(b) / u128::from(c)) as u64;
        // One stratum before and after, so that rounding loses none.
        let first = scaled(range.start, self.size, self.total).saturating_sub(1);
        let last = scaled(range.end, self.size, self.total).saturating_add(1).min(self.size);
        (first..last)
            .map(move |stratum| {
                let start = scaled(stratum, self.total, self.size);
                let end = scaled(stratum + 1, self.total, self.size);
                start + mixed(stratum) % (end - start)
            })
            .filter(move |index| range.contains(index))
    }
}

/// Queries that follow each other count as one pixel where the pixel is not known: neighbours must not leak.
pub const NEIGHBOURS: u64 = 256;

/// Parts queries by pixel, all queries of a pixel on one side: about `share` of the pixels train a tree, the others are
/// held out. What is decided depends on the seed and the pixel alone, so a builder and a comparison agree without a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Portion {
    /// Share of the pixels that train, 0 to 1.
    pub share: f64,
    pub seed: u64,
}

/// The pixel of the query that has this number in the file: its path, or where that is not known, a
/// number above all paths.
pub fn pixel(record: &Record, number: u64) -> u64 {
    match record.path {
        NO_PATH => (1 << 32) + number / NEIGHBOURS,
        path => u64::from(path),
    }
}

impl Portion {
    /// Whether the query, which has this number in the file, is for training.
    pub fn trains(&self, record: &Record, number: u64) -> bool {
        self.has(pixel(record, number))
    }

    /// Whether the queries of a [`pixel`] are for training.
    pub fn has(&self, pixel: u64) -> bool {
        let uniform = (mixed(pixel ^ mixed(self.seed)) >> 11) as f64 / (1u64 << 53) as f64;
        uniform < self.share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn record(purpose: Purpose, kind: u8, depth: u8, path: u32) -> Record {
        Record { purpose: purpose as u8, kind, depth, path, ..Record::zeroed() }
    }

    #[test]
    fn filters_say_what_they_mean() {
        let shadow = record(Purpose::Shadow, kind::OCCLUSION, 1, 77);
        let camera = record(Purpose::Camera, kind::CLOSEST_HIT, 0, 78);
        let unknown = record(Purpose::Unknown, kind::CLOSEST_HIT, NO_DEPTH, u32::MAX);
        for (text, expected) in [
            ("", [true, true, true]),
            ("purpose=shadow", [true, false, false]),
            ("purpose=shadow+camera", [true, true, false]),
            ("purpose=shadow,depth=1..", [true, false, false]),
            ("purpose=shadow,depth=2..", [false, false, false]),
            ("depth=0..1", [false, true, false]),
            ("depth=0..=1", [true, true, false]),
            ("depth=..", [true, true, false]),
            ("depth=unknown", [false, false, true]),
            ("kind=closest", [false, true, true]),
            (" kind = occlusion , depth = 1 ", [true, false, false]),
            ("path=78", [false, true, false]),
            ("path=unknown", [false, false, true]),
        ] {
            let filter: Filter = text.parse().expect(text);
            assert_eq!([shadow, camera, unknown].map(|r| filter.accepts(&r)), expected, "{text}");
            assert_eq!(filter.to_string().parse(), Ok(filter), "{text}");
        }
    }

    #[test]
    fn wrong_filters_are_refused() {
        for text in [
            "shadow",
            "purpose=",
            "purpose=sun",
            "purpose=shadow+",
            "kind=any",
            "depth=",
            "depth=-1",
            "depth=3..2",
            "depth=2..2",
            "depth=1..x",
            "size=3",
            "kind=closest,kind=closest",
            "depth=1,depth=2",
            "path=1..2..3",
        ] {
            let error = text.parse::<Filter>().expect_err(text).to_string();
            assert!(error.starts_with("filter "), "{error}");
        }
    }

    #[test]
    fn portions_keep_pixels_whole_and_have_their_share() {
        let portion = Portion { share: 0.1, seed: 7 };
        let at = |path| record(Purpose::Camera, kind::CLOSEST_HIT, 0, path);
        let training = (0..100_000).filter(|&path| portion.trains(&at(path), u64::from(path))).count();
        assert!((9_500..10_500).contains(&training), "{training}");
        for path in 0..1000 {
            let (a, b) = (portion.trains(&at(path), 1), portion.trains(&at(path), 1 << 40));
            assert_eq!(a, b, "a known pixel decides alone");
        }
        let unknown = |number| portion.trains(&at(NO_PATH), number);
        assert!((0..1000).all(|block| unknown(block * 256) == unknown(block * 256 + 255)));
        let other = Portion { seed: 8, ..portion };
        assert!((0..1000).any(|path| portion.trains(&at(path), 0) != other.trains(&at(path), 0)));
        assert!((0..1000).all(|path| !Portion { share: 0.0, seed: 1 }.trains(&at(path), 0)));
        assert!((0..1000).all(|path| Portion { share: 1.0, seed: 1 }.trains(&at(path), 0)));
    }

    #[test]
    fn samples_have_their_size_and_do_not_depend_on_how_the_file_is_cut() {
        for (size, total) in [(1u64, 10u64), (3, 10), (9, 10), (1000, 65_537), (7, u64::MAX / 3)] {
            let sample = Sample::new(size, total).expect("a part");
            let whole: Vec<u64> = sample.within(0..total).collect();
            assert_eq!(whole.len() as u64, size);
            assert!(whole.windows(2).all(|pair| pair[0] < pair[1]) && whole[whole.len() - 1] < total);
            let cut = total / 3;
            let parts: Vec<u64> = [0..cut, cut..cut, cut..2 * cut, 2 * cut..total]
                .into_iter()
                .flat_map(|part| sample.within(part))
                .collect();
            assert_eq!(parts, whole);
        }
        assert!(Sample::new(10, 10).is_none() && Sample::new(0, 0).is_none());
        assert_eq!(Sample::new(0, 5).expect("none of 5").within(0..5).count(), 0);
    }
}
