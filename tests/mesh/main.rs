//! The mesh readers and generators as other programs use them: odd files, real scenes, fixtures. Hostile files: tests/readers.

mod fixtures;
mod obj;
mod ply;
mod polygons;
mod scenes;

use embree_trace::mesh::{Mesh, Warnings};

/// Reads OBJ text without material libraries.
fn read_obj(text: impl AsRef<[u8]>) -> (Mesh, Warnings) {
    embree_trace::mesh::obj::parse(text.as_ref(), &Default::default(), &mut |_| None)
}

/// The faces of all parts, as they are stored.
fn indices(mesh: &Mesh) -> Vec<u32> {
    mesh.parts.iter().flat_map(|part| part.indices.iter().copied()).collect()
}
