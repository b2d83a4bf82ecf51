//! Frames of one moving mesh: files with the same faces and other vertices.
//!
//! The first frame is read as any scene and gives the [`Pattern`]; of every other one only the vertices are taken, once its
//! faces are seen to be those of the pattern. Names and materials may differ: exporters number them by frame.

use super::{Faces, Mesh, MeshError, Part, Warnings, obj, read_with};
use crate::geometry::Vec3;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What all frames have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    vertices: usize,
    parts: Vec<Part>,
}

/// The first thing in which a frame differs from the first one. Parts and faces are numbered from 0.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Difference {
    #[error("{found} vertices, and the first frame has {expected}")]
    Vertices { found: usize, expected: usize },
    #[error("{found} parts, and the first frame has {expected}")]
    Parts { found: usize, expected: usize },
    #[error("part {part} ({name}) has {found}, and in the first frame {expected}")]
    Faces { part: usize, name: String, found: String, expected: String },
    #[error(
        "face {face} of part {part} ({name}) has the vertices {found:?}, and in the first frame {expected:?} (faces of more \
         than three corners are cut by their shape: triangulate the frames, or keep quads)"
    )]
    Corners { part: usize, name: String, face: usize, found: Vec<u32>, expected: Vec<u32> },
}

/// Why a file is no frame.
#[derive(Debug, Error)]
pub enum FrameError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("{}: not a frame of the same mesh: {difference}", path.display())]
    Differs { path: PathBuf, difference: Difference },
}

impl Pattern {
    /// The pattern of which `mesh` is the first frame.
    pub fn of(mesh: Mesh) -> Pattern {
        Pattern { vertices: mesh.vertices.len(), parts: mesh.parts }
    }

    /// Whether `mesh` has the faces of the first frame.
    ///
    /// # Errors
    /// The first difference.
    pub fn check(&self, mesh: &Mesh) -> Result<(), Difference> {
        let (found, expected) = (mesh.vertices.len(), self.vertices);
        if found != expected {
            return Err(Difference::Vertices { found, expected });
        }
        let (found, expected) = (mesh.parts.len(), self.parts.len());
        if found != expected {
            return Err(Difference::Parts { found, expected });
        }
        for (number, (part, first)) in mesh.parts.iter().zip(&self.parts).enumerate() {
            let name = || part.name.clone();
            if (part.faces, part.indices.len()) != (first.faces, first.indices.len()) {
                let (found, expected) = (face_count(part), face_count(first));
                return Err(Difference::Faces { part: number, name: name(), found, expected });
            }
            let corners = part.faces.corners();
            let faces = part.indices.chunks_exact(corners).zip(first.indices.chunks_exact(corners));
            if let Some((face, (found, expected))) =
                faces.enumerate().find(|(_, (found, first))| found != first)
            {
                let (found, expected) = (found.to_vec(), expected.to_vec());
                return Err(Difference::Corners { part: number, name: name(), face, found, expected });
            }
        }
        Ok(())
    }

    /// Reads another frame: its vertices, and what its reader has to say.
    ///
    /// # Errors
    /// As [`read_with`], or when the faces are not those of the first frame.
    pub fn read(&self, path: &Path, options: &obj::Options) -> Result<(Vec<Vec3>, Warnings), FrameError> {
        let (mesh, warnings) = read_with(path, options)?;
        self.check(&mesh).map_err(|difference| FrameError::Differs { path: path.to_owned(), difference })?;
        Ok((mesh.vertices, warnings))
    }
}

/// Such as `12 quads`.
fn face_count(part: &Part) -> String {
    let kind = match part.faces {
        Faces::Triangles => "triangles",
        Faces::Quads => "quads",
    };
    format!("{} {kind}", part.indices.len() / part.faces.corners())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Material;

    fn mesh() -> Mesh {
        let part = |name: &str, faces, indices: &[u32]| Part {
            name: name.to_owned(),
            material: 0,
            faces,
            indices: indices.to_vec(),
        };
        Mesh {
            vertices: vec![Vec3::ZERO; 6],
            parts: vec![
                part("head", Faces::Triangles, &[0, 1, 2, 2, 1, 3]),
                part("tail", Faces::Quads, &[2, 3, 4, 5]),
            ],
            materials: vec![Material::default()],
        }
    }

    fn difference(change: impl FnOnce(&mut Mesh)) -> Result<(), Difference> {
        let mut changed = mesh();
        change(&mut changed);
        Pattern::of(mesh()).check(&changed)
    }

    #[test]
    fn vertices_names_and_materials_may_change() {
        let moved = difference(|mesh| {
            mesh.vertices[3] = Vec3::splat(f32::NAN);
            mesh.parts[1].name = "tail_0002".to_owned();
            mesh.materials[0].diffuse = Vec3::X;
        });
        assert_eq!(moved, Ok(()));
    }

    #[test]
    fn the_first_difference_is_named() {
        let text = |change: fn(&mut Mesh)| difference(change).unwrap_err().to_string();
        assert_eq!(
            difference(|mesh| mesh.vertices.truncate(5)),
            Err(Difference::Vertices { found: 5, expected: 6 })
        );
        assert_eq!(
            difference(|mesh| mesh.parts.truncate(1)),
            Err(Difference::Parts { found: 1, expected: 2 })
        );
        assert_eq!(
            text(|mesh| mesh.parts[0].indices.truncate(3)),
            "part 0 (head) has 1 triangles, and in the first frame 2 triangles"
        );
        // Twelve indices are four triangles or three quads: the kind counts, too.
        assert_eq!(
            text(|mesh| {
                mesh.parts[1].faces = Faces::Triangles;
                mesh.parts[1].indices.truncate(3);
            }),
            "part 1 (tail) has 1 triangles, and in the first frame 1 quads"
        );
        let turned = text(|mesh| mesh.parts[0].indices[3..].copy_from_slice(&[1, 3, 2]));
        assert!(
            turned.starts_with(
                "face 1 of part 0 (head) has the vertices [1, 3, 2], and in the first frame [2, 1, 3]"
            ),
            "{turned}"
        );
    }
}
