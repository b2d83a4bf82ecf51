//! PLY (the Stanford polygon file format): ascii and binary, either byte order, whatever its elements and properties are.
//!
//! The header lists elements in file order; `header` parses it, `values` walks the numbers behind
//! it. The vertex element gives positions (`x`, `y`, and `z`, which is 0 where there is none), the
//! face element polygons (`vertex_indices` or `vertex_index`), `tristrips` triangle strips in which
//! -1 starts a new one. Everything else is stepped over. A face may stand before the vertices.

mod header;
mod values;

use super::obj::Options;
use super::polygon::Cutter;
use super::{Faces, Kind, Material, Mesh, Part, Warnings};
use crate::geometry::Vec3;
pub use header::is_ply;
use header::{Element, Header, Property};
use std::fmt;
use thiserror::Error;
use values::Values;

/// Why a PLY file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PlyError {
    #[error("line {line} of the PLY header: {what}")]
    Header { line: usize, what: String },
    #[error("the PLY header does not end within {0} bytes: expected `end_header`")]
    NoEndOfHeader(usize),
    #[error("the PLY header declares no vertex element with x and y")]
    NoVertices,
    #[error("the PLY header declares faces, but no list `vertex_indices` or `vertex_index` of theirs")]
    NoIndices,
    #[error(
        "offset {offset}: {count} `{element}` elements declared, but only {left} bytes follow: the file is cut off"
    )]
    TooShort { offset: usize, element: String, count: u64, left: usize },
    #[error("{place}: the file ends inside `{element}` {index} of {count}")]
    CutOff { place: Place, element: String, index: u64, count: u64 },
    #[error(
        "{place}: the line ends inside `{element}` {index}; in an ascii PLY each line holds one whole element"
    )]
    TooFewValues { place: Place, element: String, index: u64 },
    #[error("{place}: `{element}` {index}: expected {expected}, found `{found}`")]
    Value { place: Place, element: String, index: u64, expected: &'static str, found: String },
    #[error("{0} vertices declared: a 32-bit index cannot name them")]
    TooManyVertices(u64),
}

/// Where in a file: an ascii one has lines (from 1), a binary one has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    Line(u64),
    Offset(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Place::Line(line) => write!(f, "line {line}"),
            Place::Offset(offset) => write!(f, "offset {offset}"),
        }
    }
}

/// Reads a whole PLY file. Warnings about a binary file carry the number of the element, from 1, in
/// place of a line.
///
/// # Errors
/// When the header is not one, or declares more than the file holds.
pub fn parse(bytes: &[u8], options: &Options) -> Result<(Mesh, Warnings), PlyError> {
    let header = Header::parse(bytes)?;
    let has_faces = |element: &Element| element.name == "face" && element.count > 0;
    if header.elements.iter().any(has_faces) && !header.elements.iter().any(is_faces) {
        return Err(PlyError::NoIndices);
    }
    let mut warnings = Warnings::default();
    let mut vertices = None;
    // Faces may come first, so positions are read in a first walk and faces in a second.
    let mut values = Values::new(bytes, &header);
    for element in &header.elements {
        if element.name == "vertex" && vertices.is_none() {
            let read = read_vertices(&mut values, element, &mut warnings)?;
            vertices = Some((element, read, values.clone()));
        } else if vertices.is_none() || !is_faces(element) {
            values.skip(element)?;
        } else {
            // What is behind a vertex element is read in the second walk.
            break;
        }
    }
    let (vertex_element, vertices, behind_vertices) = vertices.ok_or(PlyError::NoVertices)?;

    let mut faces = FaceReader::new(&vertices, *options, warnings);
    let mut values = Values::new(bytes, &header);
    for element in &header.elements {
        if std::ptr::eq(element, vertex_element) {
            values = behind_vertices.clone();
        } else if is_faces(element) {
            faces.read(&mut values, element)?;
        } else {
            values.skip(element)?;
        }
    }
    let (parts, warnings) = faces.finish();
    Ok((Mesh { vertices, parts, materials: vec![Material::default()] }, warnings))
}

fn is_faces(element: &Element) -> bool {
    matches!(element.name.as_str(), "face" | "tristrips") && indices_property(element).is_some()
}

/// The list that holds an element's vertex numbers.
fn indices_property(element: &Element) -> Option<usize> {
    let named = |name: &str| {
        element
            .properties
            .iter()
            .position(|property: &Property| property.name == name && property.list.is_some())
    };
    named("vertex_indices").or_else(|| named("vertex_index"))
}

fn read_vertices(
    values: &mut Values,
    element: &Element,
    warnings: &mut Warnings,
) -> Result<Vec<Vec3>, PlyError> {
    let axes = ["x", "y", "z"].map(|name| {
        let scalar = |property: &Property| property.name == name && property.list.is_none();
        element.properties.iter().position(scalar)
    });
    let [Some(_), Some(_), z] = axes else { return Err(PlyError::NoVertices) };
    if element.count >= u64::from(u32::MAX) {
        return Err(PlyError::TooManyVertices(element.count));
    }
    values.check_length(element)?;
    let mut vertices = Vec::with_capacity(element.count as usize);
    for index in 0..element.count {
        values.begin();
        let mut vertex = [f32::NAN, f32::NAN, if z.is_some() { f32::NAN } else { 0.0 }];
        for (number, property) in element.properties.iter().enumerate() {
            match axes.iter().position(|&axis| axis == Some(number)) {
                Some(axis) => vertex[axis] = values.coordinate(element, index, property)?,
                None => values.skip_property(element, index, property)?,
            }
        }
        let vertex = Vec3::from(vertex);
        if !vertex.is_finite() {
            values.warn(warnings, Kind::NonFiniteCoordinate, "vertex", index);
        }
        vertices.push(vertex);
    }
    Ok(vertices)
}

struct FaceReader<'a> {
    vertices: &'a [Vec3],
    options: Options,
    triangles: Vec<u32>,
    quads: Vec<u32>,
    list: Vec<i64>,
    corners: Vec<u32>,
    cutter: Cutter,
    warnings: Warnings,
}

impl<'a> FaceReader<'a> {
    fn new(vertices: &'a [Vec3], options: Options, warnings: Warnings) -> FaceReader<'a> {
        FaceReader {
            vertices,
            options,
            triangles: Vec::new(),
            quads: Vec::new(),
            list: Vec::new(),
            corners: Vec::new(),
            cutter: Cutter::default(),
            warnings,
        }
    }

    fn read(&mut self, values: &mut Values, element: &Element) -> Result<(), PlyError> {
        let Some(indices) = indices_property(element) else { return values.skip(element) };
        values.check_length(element)?;
        for index in 0..element.count {
            values.begin();
            for (number, property) in element.properties.iter().enumerate() {
                if number == indices {
                    self.list.clear();
                    values.list(element, index, property, &mut self.list)?;
                } else {
                    values.skip_property(element, index, property)?;
                }
            }
            if element.name == "tristrips" {
                for _ in 0..self.strips() {
                    values.warn(&mut self.warnings, Kind::IndexOutOfRange, "tristrips", index);
                }
            } else if let Some(kind) = self.polygon() {
                values.warn(&mut self.warnings, kind, "face", index);
            }
        }
        Ok(())
    }

    /// The list's numbers as corners, when there are such vertices.
    fn vertex(&self, index: i64) -> Option<u32> {
        u32::try_from(index).ok().filter(|&index| (index as usize) < self.vertices.len())
    }

    /// Adds the face that `list` names, and says what was wrong with it.
    fn polygon(&mut self) -> Option<Kind> {
        self.corners.clear();
        for &index in &self.list {
            let Some(corner) = self.vertex(index) else { return Some(Kind::IndexOutOfRange) };
            self.corners.push(corner);
        }
        if self.corners.len() < 3 {
            return Some(Kind::TooFewCorners);
        }
        if self.options.quads && self.corners.len() == 4 {
            self.quads.extend_from_slice(&self.corners);
            return None;
        }
        let right = self.cutter.cut(self.vertices, &self.corners, &mut self.triangles);
        (!right).then_some(Kind::PolygonAsFan)
    }

    /// Every three neighbours are a triangle, every second one turned over; a negative number
    /// starts a new strip. Returns how many triangles name a vertex that is not there.
    fn strips(&mut self) -> usize {
        let mut skipped = 0;
        for strip in self.list.split(|&index| index < 0) {
            for (at, window) in strip.windows(3).enumerate() {
                let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|corner| self.vertex(window[corner])) else {
                    skipped += 1;
                    continue;
                };
                // Strips turn corners with triangles that name a vertex twice; these carry nothing.
                if a == b || b == c || c == a {
                    continue;
                }
                self.triangles.extend(if at % 2 == 0 { [a, b, c] } else { [b, a, c] });
            }
        }
        skipped
    }

    fn finish(self) -> (Vec<Part>, Warnings) {
        let parts = [(Faces::Triangles, self.triangles), (Faces::Quads, self.quads)]
            .into_iter()
            .filter(|(_, indices)| !indices.is_empty())
            .map(|(faces, indices)| Part { name: String::new(), material: 0, faces, indices })
            .collect();
        (parts, self.warnings)
    }
}
