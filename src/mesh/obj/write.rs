//! Writes a mesh as OBJ and MTL, so that other programs and our own reader see the same triangles, bit for bit.

use crate::mesh::{Mesh, mtl};
use crate::progress::Progress;
use std::collections::HashSet;
use std::io::{self, Write};

/// Lines between two steps of a progress bar.
const BATCH: usize = 65_536;

/// Lines of the OBJ that hold vertices and faces: the steps of the progress that [`write()`] reports.
pub fn line_count(mesh: &Mesh) -> usize {
    let faces: usize = mesh.parts.iter().map(|part| part.indices.len() / part.faces.corners()).sum();
    mesh.vertices.len() + faces
}

/// Writes `mesh` to `obj` and its materials to `library`, which the OBJ names `library_name`.
///
/// Coordinates are printed with as many digits as it takes to read the same `f32`. A quad is a face of four corners: read it
/// with [`super::Options::quads`] to get a quad again. A name's line breaks become spaces; a material without a
/// name of its own gets one.
///
/// # Errors
/// The writers' own.
pub fn write(
    mesh: &Mesh,
    library_name: &str,
    mut obj: impl Write,
    library: impl Write,
    progress: &Progress,
) -> io::Result<()> {
    let names = material_names(mesh);
    mtl::write(&mesh.materials, &names, library)?;
    writeln!(obj, "mtllib {}", one_line(library_name))?;
    for batch in mesh.vertices.chunks(BATCH) {
        for v in batch {
            writeln!(obj, "v {} {} {}", v.x, v.y, v.z)?;
        }
        progress.advance(batch.len() as u64);
    }
    for part in &mesh.parts {
        writeln!(obj, "o {}", one_line(&part.name))?;
        if let Some(name) = names.get(part.material as usize) {
            writeln!(obj, "usemtl {name}")?;
        }
        let corners = part.faces.corners();
        for batch in part.indices.chunks(BATCH * corners) {
            for face in batch.chunks_exact(corners) {
                write!(obj, "f")?;
                for &index in face {
                    write!(obj, " {}", u64::from(index) + 1)?;
                }
                writeln!(obj)?;
            }
            progress.advance((batch.len() / corners) as u64);
        }
    }
    Ok(())
}

/// A name of its own for every material.
fn material_names(mesh: &Mesh) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut names = Vec::with_capacity(mesh.materials.len());
    for (index, material) in mesh.materials.iter().enumerate() {
        let mut name = one_line(&material.name);
        while name.is_empty() || taken.contains(&name) {
            name = format!("{name}#{index}");
        }
        taken.insert(name.clone());
        names.push(name);
    }
    names
}

/// What the reader will take the name for: one line, without spaces around it, and not going on in the next line.
fn one_line(name: &str) -> String {
    name.replace(|c: char| c.is_control(), " ").trim().to_owned()
}
