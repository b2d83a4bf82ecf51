//! What a mesh keeps, whatever file it was read from.

use embree_trace::geometry::{Triangle, Vec3};
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

/// Reads bytes as an OBJ, and as its own material library.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_obj(bytes: &[u8]) {
    let mut meshes = [false, true].map(|quads| {
        let options = obj::Options { quads };
        let mut load = |_: &str| Some(bytes.to_vec());
        let read = obj::parse(bytes, &options, &mut load);
        check_mesh(&read.0);
        let Ok(streamed) = obj::parse_stream(bytes, &options, &mut load) else {
            panic!("a slice cannot fail")
        };
        // As text, in which a NaN is like another.
        assert!(format!("{read:?}") == format!("{streamed:?}"), "a stream reads as a slice does");
        read
    });
    assert_eq!(meshes[0].0.triangle_count(), meshes[1].0.triangle_count(), "a quad is two triangles");
    check_written(&mut meshes[1].0);
}

/// Reads bytes as a PLY.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check_ply(bytes: &[u8]) {
    let read = |quads| ply::parse(bytes, &obj::Options { quads });
    let [triangles, quads] = [read(false), read(true)];
    match (triangles, quads) {
        (Ok((triangles, _)), Ok((mut quads, _))) => {
            check_mesh(&triangles);
            check_mesh(&quads);
            assert_eq!(triangles.triangle_count(), quads.triangle_count(), "a quad is two triangles");
            check_written(&mut quads);
        }
        (Err(error), Err(other)) => {
            super::check_line(&error);
            assert_eq!(error, other);
        }
        _ => panic!("whether a file can be read does not depend on quads"),
    }
}

/// A mesh written as OBJ is read with the same vertices and triangles; written once more, it is the same to the last name.
fn check_written(mesh: &mut Mesh) {
    let first = written(mesh);
    check_mesh(&first);
    let bits = |mesh: &Mesh| mesh.vertices.iter().map(|&vertex| canonical(vertex)).collect::<Vec<_>>();
    assert_eq!(bits(&first), bits(mesh));
    // Parts of the same name and material become one, so the order of triangles may differ.
    assert_eq!(sorted(&first.triangles()), sorted(&mesh.triangles()));
    let second = written(&first);
    assert_eq!(bits(&second), bits(&first));
    assert_eq!((&second.parts, &second.materials), (&first.parts, &first.materials));
}

fn written(mesh: &Mesh) -> Mesh {
    let (mut text, mut library) = (Vec::new(), Vec::new());
    if let Err(error) = obj::write(mesh, "a.mtl", &mut text, &mut library, &Progress::hidden()) {
        panic!("memory is no full disk: {error}");
    }
    let read: (Mesh, Warnings) =
        obj::parse(&text, &obj::Options { quads: true }, &mut |_| Some(library.clone()));
    read.0
}

/// A NaN is written as NaN, whatever its sign and payload.
fn canonical(vertex: Vec3) -> [u32; 3] {
    vertex.to_array().map(|value| if value.is_nan() { f32::NAN.to_bits() } else { value.to_bits() })
}

fn sorted(triangles: &[Triangle]) -> Vec<[[u32; 3]; 3]> {
    let mut sorted: Vec<_> = triangles.iter().map(|triangle| triangle.0.map(canonical)).collect();
    sorted.sort_unstable();
    sorted
}
