//! A scene from a path: which format it is, whether it is compressed, where its materials are, and what to say when it is neither.
//!
//! The first bytes decide, not the name: a line `ply` opens a PLY, the zstd magic a compressed
//! scene. What another magic opens is refused by that name; everything else is read as OBJ, which
//! has no magic.

use super::{Faces, Kind, Mesh, Warnings, obj, ply};
use crate::files::{FileError, MappedFile};
use crate::mesh::obj::Options;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Text of a compressed scene that is read at most: a small file must not fill the memory. About 100 M triangles.
const MAX_DECOMPRESSED: u64 = 4 << 30;

/// zstd's window, as a power of two: what `zstd --long=27` writes, and room above it.
const MAX_WINDOW_LOG: u32 = 30;

/// A material library above this size is none.
const MAX_LIBRARY: u64 = 64 << 20;

/// A scene that cannot be read: which file, and why.
#[derive(Debug, Error)]
pub enum MeshError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: {problem}", path.display())]
    Scene { path: PathBuf, problem: Problem },
}

/// Why a file is not a scene.
#[derive(Debug, Error)]
pub enum Problem {
    #[error("the file is empty; expected a scene (OBJ or PLY)")]
    Empty,
    #[error("no vertices and no faces{}: is it an OBJ?", first_of(.0))]
    NoVertices(Box<Warnings>),
    #[error("a point cloud: {0} vertices and no faces; rays need triangles, so make a surface of it first")]
    PointCloud(usize),
    #[error("no faces in {vertices} vertices{}", first_of(.warnings))]
    NoFaces { vertices: usize, warnings: Box<Warnings> },
    #[error("no triangle of {triangles} has three finite corners{}: nothing can be hit", first_of(.warnings))]
    NoFiniteTriangle { triangles: usize, warnings: Box<Warnings> },
    #[error("this is {0}; expected a scene (OBJ or PLY, plain or .zst)")]
    OtherFormat(&'static str),
    #[error("cannot decompress: {0}")]
    Decompress(io::Error),
    #[error("more than {} GiB once decompressed; decompress it to a file if that is meant", MAX_DECOMPRESSED >> 30)]
    TooLarge,
    #[error(transparent)]
    Ply(#[from] ply::PlyError),
}

/// The most telling line of the warnings, in brackets.
fn first_of(warnings: &Warnings) -> String {
    warnings.to_string().lines().next().map(|line| format!(" ({line})")).unwrap_or_default()
}

/// Reads a scene, every face cut into triangles.
///
/// # Errors
/// When the file cannot be read, is of another format, or has no faces.
pub fn read(path: &Path) -> Result<(Mesh, Warnings), MeshError> {
    read_with(path, &Options::default())
}

/// Reads a scene.
///
/// # Errors
/// As [`read`].
pub fn read_with(path: &Path, options: &Options) -> Result<(Mesh, Warnings), MeshError> {
    let file = MappedFile::open(path)?;
    let (mesh, warnings) =
        scene(&file, path, options).map_err(|problem| MeshError::Scene { path: path.to_owned(), problem })?;
    Ok((mesh, warnings))
}

fn scene(bytes: &[u8], path: &Path, options: &Options) -> Result<(Mesh, Warnings), Problem> {
    if bytes.is_empty() {
        return Err(Problem::Empty);
    }
    let mut load = |name: &str| library(path, name);
    let (mesh, warnings) = if bytes.starts_with(&zstd::zstd_safe::MAGICNUMBER.to_le_bytes()) {
        compressed(bytes, options, &mut load)?
    } else if ply::is_ply(bytes) {
        ply::parse(bytes, options)?
    } else if let Some(format) = other_format(bytes) {
        return Err(Problem::OtherFormat(format));
    } else {
        obj::parse(bytes, options, &mut load)
    };
    if mesh.parts.is_empty() {
        return Err(without_faces(mesh.vertices.len(), warnings));
    }
    if !has_finite_triangle(&mesh) {
        let triangles = mesh.triangle_count();
        return Err(Problem::NoFiniteTriangle { triangles, warnings: Box::new(warnings) });
    }
    Ok((mesh, warnings))
}

fn without_faces(vertices: usize, warnings: Warnings) -> Problem {
    let skipped =
        [Kind::TooFewCorners, Kind::UnreadableCorner, Kind::IndexOutOfRange, Kind::PointsLinesCurves];
    match vertices {
        0 => Problem::NoVertices(Box::new(warnings)),
        _ if skipped.iter().all(|&kind| warnings.count(kind) == 0) => Problem::PointCloud(vertices),
        _ => Problem::NoFaces { vertices, warnings: Box::new(warnings) },
    }
}

/// Whether any ray can hit anything.
fn has_finite_triangle(mesh: &Mesh) -> bool {
    let finite = |index: &u32| mesh.vertices[*index as usize].is_finite();
    mesh.parts.iter().any(|part| {
        let triangles = match part.faces {
            Faces::Triangles => &[[0, 1, 2]][..],
            Faces::Quads => &[[0, 1, 3], [2, 3, 1]],
        };
        part.indices.chunks_exact(part.faces.corners()).any(|face| {
            triangles.iter().any(|triangle| triangle.iter().all(|&corner: &usize| finite(&face[corner])))
        })
    })
}

fn compressed(bytes: &[u8], options: &Options, load: obj::Loader) -> Result<(Mesh, Warnings), Problem> {
    let mut decoder = zstd::Decoder::with_buffer(bytes).map_err(Problem::Decompress)?;
    decoder.window_log_max(MAX_WINDOW_LOG).map_err(Problem::Decompress)?;
    let mut text = BufReader::with_capacity(1 << 20, Limited { inner: decoder, left: MAX_DECOMPRESSED });
    let start = text.fill_buf().map_err(decompress_problem)?;
    if ply::is_ply(start) {
        let mut whole = Vec::new();
        text.read_to_end(&mut whole).map_err(decompress_problem)?;
        return Ok(ply::parse(&whole, options)?);
    }
    if let Some(format) = other_format(start) {
        return Err(Problem::OtherFormat(format));
    }
    obj::parse_stream(text, options, load).map_err(decompress_problem)
}

/// A file that is easily taken for a scene: by swapped arguments, or because other tools read it.
fn other_format(bytes: &[u8]) -> Option<&'static str> {
    const MAGICS: [(&[u8], &str); 9] = [
        (b"\x89RAYS", "a .rays file"),
        (b"\x89BVH", "a .bvh file"),
        (b"\x1F\x8B", "a gzip file (gunzip it first)"),
        (b"PK\x03\x04", "a zip file (unzip it first)"),
        (b"glTF", "a binary glTF"),
        (b"{", "JSON, perhaps glTF"),
        (b"solid ", "an STL"),
        (b"Kaydara FBX", "an FBX"),
        (b"\x7FELF", "a program"),
    ];
    MAGICS.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|&(_, format)| format)
}

/// A reader that fails, rather than ends, at a limit.
struct Limited<R> {
    inner: R,
    left: u64,
}

impl<R: Read> Read for Limited<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.left = self
            .left
            .checked_sub(count as u64)
            .ok_or_else(|| io::Error::from(io::ErrorKind::FileTooLarge))?;
        Ok(count)
    }
}

fn decompress_problem(error: io::Error) -> Problem {
    match error.kind() {
        io::ErrorKind::FileTooLarge => Problem::TooLarge,
        _ => Problem::Decompress(error),
    }
}

/// A material library beside the scene; only a regular file of a sensible size is opened.
fn library(scene: &Path, name: &str) -> Option<Vec<u8>> {
    let folder = scene.parent()?;
    // Windows exporters write their own separators.
    [folder.join(name), folder.join(name.replace('\\', "/"))].iter().find_map(|path| {
        let metadata = path.metadata().ok()?;
        if !metadata.is_file() || metadata.len() > MAX_LIBRARY {
            return None;
        }
        let mut bytes = Vec::new();
        File::open(path).ok()?.take(MAX_LIBRARY).read_to_end(&mut bytes).ok()?;
        Some(bytes)
    })
}
