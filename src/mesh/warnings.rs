//! What a tolerant reader left out of a file, as counts: one line for each kind of trouble, not one for each line of the file.

use std::fmt;

/// A kind of trouble that a reader steps over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Kind {
    /// A coordinate is missing or is no number (`1.#IND`, `3.1+e2`); it becomes NaN, so that later vertices keep their numbers.
    UnreadableCoordinate,
    /// A coordinate is NaN or infinite, as the file says in so many words. No tree holds its triangles.
    NonFiniteCoordinate,
    /// A face has fewer than three corners.
    TooFewCorners,
    /// A corner of a face is not a number.
    UnreadableCorner,
    /// A face names vertex 0, or one that the file does not have.
    IndexOutOfRange,
    /// A polygon crosses itself; it was cut as a fan.
    PolygonAsFan,
    /// A `p`, `l`, curve or surface statement: no tree of ours holds these.
    PointsLinesCurves,
    /// A statement that is not part of the format.
    UnknownStatement,
    /// A line above 64 MiB.
    LineTooLong,
    /// Vertices beyond the four billion that an index can name.
    TooManyVertices,
    /// A material library that is not there.
    MissingLibrary,
    /// A material that no library defines; it looks like the default.
    UnknownMaterial,
    /// A value in a material library that is no number.
    UnreadableMaterial,
}

const KINDS: usize = Kind::UnreadableMaterial as usize + 1;

impl Kind {
    /// Every kind, in the order in which warnings are printed.
    pub const ALL: [Kind; KINDS] = [
        Kind::UnreadableCoordinate,
        Kind::NonFiniteCoordinate,
        Kind::TooFewCorners,
        Kind::UnreadableCorner,
        Kind::IndexOutOfRange,
        Kind::PolygonAsFan,
        Kind::PointsLinesCurves,
        Kind::UnknownStatement,
        Kind::LineTooLong,
        Kind::TooManyVertices,
        Kind::MissingLibrary,
        Kind::UnknownMaterial,
        Kind::UnreadableMaterial,
    ];

    fn describe(self) -> &'static str {
        match self {
            Kind::UnreadableCoordinate => "vertices with a missing or unreadable coordinate (kept as NaN)",
            Kind::NonFiniteCoordinate => "vertices with a NaN or infinite coordinate",
            Kind::TooFewCorners => "faces skipped: fewer than three corners",
            Kind::UnreadableCorner => "faces skipped: a corner is not a vertex number",
            Kind::IndexOutOfRange => "faces skipped: no such vertex",
            Kind::PolygonAsFan => "polygons that cross themselves, cut as fans",
            Kind::PointsLinesCurves => "points, lines, curves or surfaces skipped",
            Kind::UnknownStatement => "unknown statements skipped",
            Kind::LineTooLong => "lines above 64 MiB skipped",
            Kind::TooManyVertices => "vertices skipped: more than a 32-bit index can name",
            Kind::MissingLibrary => "material libraries not found",
            Kind::UnknownMaterial => "materials without a definition, drawn in grey",
            Kind::UnreadableMaterial => "unreadable values in a material library",
        }
    }
}

/// How often each [`Kind`] of trouble was met, and where first. Displays as one line a kind, and as nothing when there was none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Warnings {
    counts: [u64; KINDS],
    first: [Option<Place>; KINDS],
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    /// What is counted: `line`, or an element of a binary file.
    unit: &'static str,
    number: u64,
    name: String,
}

impl Warnings {
    /// One more of `kind`, at `line` (from 1).
    pub(crate) fn add(&mut self, kind: Kind, line: u64) {
        self.add_at(kind, "line", line, "");
    }

    /// One more of `kind`, about something that has a name.
    pub(crate) fn add_named(&mut self, kind: Kind, line: u64, name: &str) {
        self.add_at(kind, "line", line, name);
    }

    /// One more of `kind`, at the `number`th `unit` (from 1) of a file that has no lines.
    pub(crate) fn add_at(&mut self, kind: Kind, unit: &'static str, number: u64, name: &str) {
        self.counts[kind as usize] += 1;
        let first = &mut self.first[kind as usize];
        if first.is_none() {
            *first = Some(Place { unit, number, name: name.to_owned() });
        }
    }

    /// How many of `kind` there were.
    pub fn count(&self, kind: Kind) -> u64 {
        self.counts[kind as usize]
    }

    /// The line of the first one of `kind`, from 1; in a file without lines, the number of its
    /// element.
    pub fn first_line(&self, kind: Kind) -> Option<u64> {
        self.first[kind as usize].as_ref().map(|place| place.number)
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.counts.iter().all(|&count| count == 0)
    }
}

impl fmt::Display for Warnings {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut separator = "";
        for kind in Kind::ALL {
            let Some(place) = &self.first[kind as usize] else { continue };
            write!(f, "{separator}{} {} (first", self.count(kind), kind.describe())?;
            if !place.name.is_empty() {
                write!(f, ": {}", place.name)?;
            }
            write!(f, " at {} {})", place.unit, place.number)?;
            separator = "\n";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_a_kind_with_the_first_place() {
        let mut warnings = Warnings::default();
        assert!(warnings.is_empty());
        assert_eq!(warnings.to_string(), "");
        warnings.add(Kind::IndexOutOfRange, 7);
        warnings.add(Kind::IndexOutOfRange, 9);
        warnings.add_named(Kind::MissingLibrary, 1, "a b.mtl");
        warnings.add_at(Kind::NonFiniteCoordinate, "vertex", 3, "");
        assert_eq!(
            warnings.to_string(),
            "1 vertices with a NaN or infinite coordinate (first at vertex 3)\n\
             2 faces skipped: no such vertex (first at line 7)\n1 material libraries not found (first: a b.mtl at line 1)"
        );
        assert_eq!(warnings.first_line(Kind::IndexOutOfRange), Some(7));
    }

    #[test]
    fn kinds_stand_at_their_own_number() {
        for (index, kind) in Kind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, index);
        }
    }
}
