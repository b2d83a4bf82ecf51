//! What a mesh keeps, whatever file it was read from.

use embree_trace::geometry::Vec3;
use embree_trace::mesh::{Mesh, Warnings, obj, ply};
use embree_trace::progress::Progress;

/// Every index of a mesh is in range, and colours are those of a surface.
pub fn check_mesh(mesh: &Mesh) {
    for part in &mesh.parts {
        assert!(!part.indices.is_empty());
        assert_eq!(part.indices.len() % part.faces.corners(), 0);
        assert!(part.indices.iter().all(|&index| (index as usize) < mesh.vertices.len()));
        assert!((part.material as usize) < mesh.materials.len());
    }
    for material in &mesh.materials {
        let unit = |colour: Vec3| colour.cmpge(Vec3::ZERO).all() && colour.cmple(Vec3::ONE).all();
        assert!(unit(material.diffuse) && unit(material.specular), "{material:?}");
        assert!(material.emission.is_finite() && material.emission.cmpge(Vec3::ZERO).all(), "{material:?}");
    }
    assert_eq!(mesh.triangles().len(), mesh.triangle_count());
}

fn options(quads: bool) -> obj::Options {
    obj::Options { quads, ..obj::Options::default() }
}

/// Reads bytes as an OBJ, and as its own material library.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_obj(bytes: &[u8]) {
    let mut load = |_: &str| Some(bytes.to_vec());
    let [triangles, quads] = [false, true].map(|quads| {
        let read = obj::parse(bytes, &options(quads), &mut load);
        check_mesh(&read.0);
        read
    });
    assert_eq!(triangles.0.triangle_count(), quads.0.triangle_count(), "a quad is two triangles");
    let in_order = obj::parse(bytes, &obj::Options { file_order: true, ..options(false) }, &mut load).0;
    check_mesh(&in_order);
    assert_eq!(in_order.triangle_count(), triangles.0.triangle_count());
    let Ok(streamed) = obj::parse_stream(bytes, &options(true), &mut load) else {
        panic!("a slice cannot fail")
    };
    assert_same(&streamed.0, &quads.0);
    assert_eq!(streamed.1.to_string(), quads.1.to_string(), "a stream reads as a slice does");
    check_written(&quads.0);
}

/// Reads bytes as a PLY.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_ply(bytes: &[u8]) {
    let read = |quads| ply::parse(bytes, &options(quads));
    let [triangles, quads] = [read(false), read(true)];
    match (triangles, quads) {
        (Ok((triangles, _)), Ok((quads, _))) => {
            check_mesh(&triangles);
            check_mesh(&quads);
            assert_eq!(triangles.triangle_count(), quads.triangle_count(), "a quad is two triangles");
            check_written(&quads);
        }
        (Err(error), Err(other)) => {
            super::check_line(&error);
            assert_eq!(error, other);
        }
        _ => panic!("whether a file can be read does not depend on quads"),
    }
}

/// A mesh written as OBJ is read with the same vertices and faces; written once more, it is the same to the last name.
fn check_written(mesh: &Mesh) {
    let first = written(mesh);
    check_mesh(&first);
    assert_eq!(bits(&first), bits(mesh));
    let faces = |mesh: &Mesh| -> Vec<_> {
        mesh.parts.iter().map(|part| (part.faces, part.indices.clone())).collect()
    };
    assert_eq!(faces(&first), faces(mesh));
    assert_same(&written(&first), &first);
}

/// Two meshes are the same, where one NaN is like another.
pub fn assert_same(mesh: &Mesh, other: &Mesh) {
    assert_eq!(bits(mesh), bits(other));
    assert_eq!((&mesh.parts, &mesh.materials), (&other.parts, &other.materials));
}

fn bits(mesh: &Mesh) -> Vec<[u32; 3]> {
    mesh.vertices.iter().map(|vertex| vertex.to_array().map(super::bits)).collect()
}

/// The mesh written as OBJ, and read again.
pub fn written(mesh: &Mesh) -> Mesh {
    let (mut text, mut library) = (Vec::new(), Vec::new());
    if let Err(error) = obj::write(mesh, "a.mtl", &mut text, &mut library, &Progress::hidden()) {
        panic!("memory is no full disk: {error}");
    }
    let options = obj::Options { quads: true, file_order: true };
    let read: (Mesh, Warnings) = obj::parse(&text, &options, &mut |_| Some(library.clone()));
    read.0
}
