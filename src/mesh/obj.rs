//! Wavefront OBJ, read as it is found in the wild: what cannot be used is skipped and counted, and never costs the rest of the file.
//!
//! One pass over the lines: `v` lines become vertices, `f` lines become triangles (or quads) of the
//! current [`Part`] as soon as their vertices are known. A face that stands before its vertices
//! waits until the end and then comes last in its part. Colours, weights, normals and texture
//! coordinates do not decide which rays are asked, and are passed over.
//!
//! A vertex of two coordinates has z = 0. `#` begins a comment, wherever it stands among numbers; in
//! a name it does so behind a blank, unless a digit follows. Of several libraries that define a
//! material, the first counts.

mod write;

use super::lines::{self, Sink};
use super::polygon::Cutter;
use super::{Faces, Kind, Material, Mesh, Part, Warnings, mtl, number};
use crate::geometry::Vec3;
use std::collections::HashMap;
use std::io::{self, Read};
pub use write::{line_count, write};

/// What a caller may choose about faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Keep faces of four corners as Embree quads, in parts of their own; otherwise every face is cut into triangles.
    pub quads: bool,
    /// Keep the order of the file: every stretch of faces between two names is a part of its own. Otherwise faces of the same names, wherever they
    /// stand, are one part.
    pub file_order: bool,
}

/// Gives the bytes of a material library by the name that stands in the file, or `None` when there is none.
pub type Loader<'a> = &'a mut dyn FnMut(&str) -> Option<Vec<u8>>;

/// The largest number of vertices; `u32::MAX` stays free, because Embree uses it for "none".
const MAX_VERTICES: usize = u32::MAX as usize;

/// Reads a whole OBJ file. It cannot fail: a file that is no OBJ gives a mesh without faces.
pub fn parse(bytes: &[u8], options: &Options, load: Loader) -> (Mesh, Warnings) {
    let mut reader = Reader::new(*options);
    lines::from_slice(bytes, &mut reader);
    reader.finish(load)
}

/// Reads an OBJ from a stream, a block at a time: memory is the mesh's own.
///
/// # Errors
/// The stream's own, such as a truncated zstd frame.
pub fn parse_stream(stream: impl Read, options: &Options, load: Loader) -> io::Result<(Mesh, Warnings)> {
    let mut reader = Reader::new(*options);
    lines::from_reader(stream, &mut reader)?;
    Ok(reader.finish(load))
}

/// What makes two faces members of the same part: numbers of names, and the kind.
type PartKey = (u32, u32, u32, Faces);

/// A face that names vertices which have not been read yet.
struct LateFace {
    line: u64,
    part: usize,
    corners: u32,
}

struct Reader {
    options: Options,
    vertices: Vec<Vec3>,
    /// With the number of a material name in place of its index.
    parts: Vec<Part>,
    part_of: HashMap<PartKey, usize>,
    /// The part that the next triangle and the next quad go to, once looked up.
    current: [Option<usize>; 2],
    object: u32,
    group: u32,
    material: u32,
    names: Names,
    /// Where each material name was first used.
    material_lines: HashMap<u32, u64>,
    /// Every `mtllib` statement, and its line.
    libraries: Vec<(u64, Vec<u8>)>,
    corners: Vec<u32>,
    late: Vec<LateFace>,
    late_corners: Vec<u32>,
    cutter: Cutter,
    warnings: Warnings,
}

/// Names, each with a number; 0 is the empty one.
struct Names {
    numbers: HashMap<Vec<u8>, u32>,
    texts: Vec<String>,
}

impl Names {
    fn number(&mut self, name: &[u8]) -> u32 {
        if let Some(&number) = self.numbers.get(name) {
            return number;
        }
        let number = self.texts.len() as u32;
        self.texts.push(mtl::text(name));
        self.numbers.insert(name.to_owned(), number);
        number
    }

    fn text(&self, number: u32) -> &str {
        &self.texts[number as usize]
    }
}

/// The next word of a line, and what follows it; a comment is no word, but what follows.
#[inline]
fn word(line: &[u8]) -> (&[u8], &[u8]) {
    let start = line.iter().position(|&byte| byte > b' ').unwrap_or(line.len());
    let line = &line[start..];
    // Of what stands in numbers nothing is below `#`, so there is one comparison for most bytes.
    let ends = |&byte: &u8| byte <= b'#' && (byte <= b' ' || byte == b'#');
    let end = line.iter().position(ends).unwrap_or(line.len());
    line.split_at(end)
}

/// What stands behind the keyword of a statement that gives a name.
fn name(line: &[u8]) -> &[u8] {
    let line = lines::without_comment(line).trim_ascii();
    let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    line[end..].trim_ascii()
}

impl Sink for Reader {
    #[inline]
    fn line(&mut self, number: u64, line: &[u8]) {
        let (keyword, rest) = word(line);
        match keyword {
            b"v" => self.vertex(number, rest),
            b"f" | b"fo" => self.face(number, rest),
            // Nothing, or a comment.
            b"" => {}
            b"vn" | b"vt" | b"vp" | b"s" => {}
            b"o" => {
                self.object = self.names.number(name(line));
                self.group = 0;
                self.current = [None; 2];
            }
            b"g" => {
                self.group = self.names.number(name(line));
                self.current = [None; 2];
            }
            b"usemtl" => {
                self.material = self.names.number(name(line));
                self.material_lines.entry(self.material).or_insert(number);
                self.current = [None; 2];
            }
            b"mtllib" => self.libraries.push((number, line.to_owned())),
            _ => self.other(number, keyword),
        }
    }

    fn too_long(&mut self, number: u64) {
        self.warnings.add(Kind::LineTooLong, number);
    }
}

impl Reader {
    fn new(options: Options) -> Reader {
        Reader {
            options,
            vertices: Vec::new(),
            parts: Vec::new(),
            part_of: HashMap::new(),
            current: [None; 2],
            object: 0,
            group: 0,
            material: 0,
            names: Names { numbers: HashMap::from([(Vec::new(), 0)]), texts: vec![String::new()] },
            material_lines: HashMap::new(),
            libraries: Vec::new(),
            corners: Vec::new(),
            late: Vec::new(),
            late_corners: Vec::new(),
            cutter: Cutter::default(),
            warnings: Warnings::default(),
        }
    }

    #[inline]
    fn vertex(&mut self, line: u64, mut rest: &[u8]) {
        if self.vertices.len() >= MAX_VERTICES {
            self.warnings.add(Kind::TooManyVertices, line);
            return;
        }
        let start = rest;
        let mut vertex = [f32::NAN; 3];
        let mut readable = true;
        for coordinate in &mut vertex {
            let token;
            (token, rest) = word(rest);
            match number::parse_f32(token) {
                Some(value) => *coordinate = value,
                None => readable = false,
            }
        }
        if !readable || rest.first() == Some(&b'#') {
            readable = unusual_vertex(start, &mut vertex);
        }
        let vertex = Vec3::from(vertex);
        if !readable {
            self.warnings.add(Kind::UnreadableCoordinate, line);
        } else if !vertex.is_finite() {
            self.warnings.add(Kind::NonFiniteCoordinate, line);
        }
        self.vertices.push(vertex);
    }

    #[inline]
    fn face(&mut self, line: u64, mut rest: &[u8]) {
        self.corners.clear();
        let known = self.vertices.len() as i64;
        let mut late = false;
        loop {
            let token;
            (token, rest) = word(rest);
            if token.is_empty() {
                break;
            }
            let Some(number) = corner(token) else {
                self.warnings.add(Kind::UnreadableCorner, line);
                return;
            };
            // From 1, or backwards from the last vertex so far.
            let index = if number < 0 { known + number } else { number - 1 };
            if index < 0 || index >= MAX_VERTICES as i64 {
                self.warnings.add(Kind::IndexOutOfRange, line);
                return;
            }
            late |= index >= known;
            self.corners.push(index as u32);
        }
        if self.corners.len() < 3 {
            self.warnings.add(Kind::TooFewCorners, line);
            return;
        }
        let kind =
            if self.options.quads && self.corners.len() == 4 { Faces::Quads } else { Faces::Triangles };
        let part = self.part(kind);
        if late {
            self.late.push(LateFace { line, part, corners: self.corners.len() as u32 });
            self.late_corners.extend_from_slice(&self.corners);
            return;
        }
        add_face(
            &mut self.parts[part],
            &self.vertices,
            &self.corners,
            &mut self.cutter,
            line,
            &mut self.warnings,
        );
    }

    /// The part for a face of this kind under the current names.
    #[inline]
    fn part(&mut self, kind: Faces) -> usize {
        let slot = kind as usize;
        if let Some(part) = self.current[slot] {
            return part;
        }
        let key = (self.object, self.group, self.material, kind);
        if self.options.file_order {
            self.part_of.remove(&key);
        }
        let part = *self.part_of.entry(key).or_insert_with(|| {
            let name = match (self.names.text(self.object), self.names.text(self.group)) {
                (object, "") => object.to_owned(),
                ("", group) => group.to_owned(),
                (object, group) => format!("{object}/{group}"),
            };
            self.parts.push(Part { name, material: self.material, faces: kind, indices: Vec::new() });
            self.parts.len() - 1
        });
        self.current[slot] = Some(part);
        part
    }

    /// Statements that carry no faces.
    fn other(&mut self, line: u64, keyword: &[u8]) {
        match keyword {
            b"p" | b"l" | b"cstype" | b"deg" | b"bmat" | b"step" | b"curv" | b"curv2" | b"surf" | b"parm"
            | b"trim" | b"hole" | b"scrv" | b"sp" | b"end" | b"con" => {
                self.warnings.add(Kind::PointsLinesCurves, line)
            }
            // Grouping, display and other programs' hints: legal, and without meaning here.
            b"mg" | b"bevel" | b"c_interp" | b"d_interp" | b"lod" | b"shadow_obj" | b"trace_obj"
            | b"ctech" | b"stech" | b"usemap" | b"maplib" | b"t" | b"vw" => {}
            _ => self.warnings.add_named(
                Kind::UnknownStatement,
                line,
                &mtl::text(&keyword[..keyword.len().min(32)]),
            ),
        }
    }

    fn finish(mut self, load: Loader) -> (Mesh, Warnings) {
        let mut start = 0;
        for late in &self.late {
            let end = start + late.corners as usize;
            let corners = &self.late_corners[start..end];
            start = end;
            if corners.iter().any(|&corner| corner as usize >= self.vertices.len()) {
                self.warnings.add(Kind::IndexOutOfRange, late.line);
                continue;
            }
            let part = &mut self.parts[late.part];
            add_face(part, &self.vertices, corners, &mut self.cutter, late.line, &mut self.warnings);
        }
        self.parts.retain(|part| !part.indices.is_empty());
        let materials = self.materials(load);
        (Mesh { vertices: self.vertices, parts: self.parts, materials }, self.warnings)
    }

    /// The materials in use, in the order of first use; renumbers the parts to fit.
    fn materials(&mut self, load: Loader) -> Vec<Material> {
        let mut defined = HashMap::new();
        // A file of many parts may name its library before each of them.
        let mut seen = std::collections::HashSet::new();
        for (line, statement) in std::mem::take(&mut self.libraries) {
            let name = mtl::text(name(&statement));
            if name.is_empty() || !seen.insert(name.clone()) {
                continue;
            }
            let mut found = |name: &str| {
                let library = load(name);
                let bytes = library.as_deref();
                bytes.map(|bytes| mtl::parse(bytes, &mut defined, &mut self.warnings)).is_some()
            };
            if found(&name) {
                continue;
            }
            // A name may hold what looks like a comment, or a comment may follow it without a
            // blank.
            let whole = mtl::text(word(&statement).1.trim_ascii());
            let before = whole.split('#').next().unwrap_or_default().trim_end();
            if [&whole, before].into_iter().any(|other| other != name && !other.is_empty() && found(other)) {
                continue;
            }
            // A name may hold spaces; or the line may name several libraries.
            let missing: Vec<&str> = match before.contains(char::is_whitespace) {
                true => before.split_whitespace().filter(|&part| !found(part)).collect(),
                false => vec![&name],
            };
            if missing.len() == before.split_whitespace().count() {
                self.warnings.add_named(Kind::MissingLibrary, line, &name);
            } else {
                missing.iter().for_each(|part| self.warnings.add_named(Kind::MissingLibrary, line, part));
            }
        }
        let mut index_of = HashMap::new();
        let mut materials = Vec::new();
        for part in &mut self.parts {
            let number = part.material;
            part.material = *index_of.entry(number).or_insert_with(|| {
                let name = self.names.text(number);
                let material = defined.get(name).cloned().unwrap_or_else(|| {
                    if number != 0 {
                        let line = self.material_lines.get(&number).copied().unwrap_or(0);
                        self.warnings.add_named(Kind::UnknownMaterial, line, name);
                    }
                    Material { name: name.to_owned(), ..Material::default() }
                });
                materials.push(material);
                materials.len() as u32 - 1
            });
        }
        materials
    }
}

/// Appends one face to its part: as it is when it fits, else as triangles.
#[inline]
fn add_face(
    part: &mut Part,
    vertices: &[Vec3],
    corners: &[u32],
    cutter: &mut Cutter,
    line: u64,
    warnings: &mut Warnings,
) {
    if corners.len() == part.faces.corners() {
        part.indices.extend_from_slice(corners);
    } else if !cutter.cut(vertices, corners, &mut part.indices) {
        warnings.add(Kind::PolygonAsFan, line);
    }
}

/// A vertex with a comment behind it, without z, or with what is no number; whether its coordinates
/// could be read.
#[cold]
fn unusual_vertex(rest: &[u8], vertex: &mut [f32; 3]) -> bool {
    *vertex = [f32::NAN; 3];
    let mut count = 0;
    let mut readable = true;
    for token in rest.split(|&byte| byte <= b' ').filter(|token| !token.is_empty()) {
        let comment = token.iter().position(|&byte| byte == b'#');
        // Some C libraries write `1.#IND` and `1.#QNAN` for what is no number.
        let comment = comment.filter(|&at| !token[..at].ends_with(b"1."));
        let number = &token[..comment.unwrap_or(token.len())];
        if !number.is_empty() {
            match number::parse_f32(number) {
                Some(value) => vertex[count] = value,
                None => readable = false,
            }
            count += 1;
        }
        if comment.is_some() || count == 3 {
            break;
        }
    }
    if count == 2 {
        vertex[2] = 0.0;
    }
    readable && count >= 2
}

/// The vertex number at the start of `7`, `7/1`, `7//2` or `7/1/2`. Numbers that are too large for any file stay too large.
#[inline]
fn corner(token: &[u8]) -> Option<i64> {
    let (negative, digits) = match token {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, token),
    };
    let mut value = 0_i64;
    for (at, &byte) in digits.iter().enumerate() {
        let digit = byte.wrapping_sub(b'0');
        if digit < 10 {
            value = value.saturating_mul(10).saturating_add(i64::from(digit));
        } else if byte == b'/' && at > 0 {
            break;
        } else {
            return None;
        }
    }
    if digits.is_empty() {
        return None;
    }
    Some(if negative { -value } else { value })
}
