//! `fixtures/` holds what the generators write, byte for byte. `UPDATE_FIXTURES=1 cargo test` rewrites the files after a change
//! that is meant to change them.

use embree_trace::mesh::{self, Mesh, generate, obj};
use embree_trace::progress::Progress;
use std::path::Path;

fn scenes() -> [(&'static str, Mesh); 5] {
    [
        ("cornell-box", generate::cornell_box()),
        ("courtyard", generate::courtyard(1, 1)),
        ("slivers", generate::slivers(600, 1)),
        ("coincident", generate::coincident()),
        ("quads", generate::quads(16)),
    ]
}

#[test]
fn the_generators_write_the_committed_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    for (name, scene) in scenes() {
        let (mut text, mut library) = (Vec::new(), Vec::new());
        obj::write(&scene, &format!("{name}.mtl"), &mut text, &mut library, &Progress::hidden()).unwrap();
        assert!(text.len() < 200_000, "{name} has {} bytes", text.len());
        for (extension, bytes) in [("obj", text), ("mtl", library)] {
            let path = folder.join(format!("{name}.{extension}"));
            if std::env::var_os("UPDATE_FIXTURES").is_some() {
                std::fs::write(&path, bytes).unwrap();
            } else {
                assert!(
                    std::fs::read(&path).unwrap() == bytes,
                    "{} is not what the generator writes",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn reading_a_fixture_gives_the_scene_that_was_written() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    for (name, scene) in scenes() {
        let path = folder.join(format!("{name}.obj"));
        let (read, warnings) =
            mesh::read_with(&path, &obj::Options { quads: true, ..obj::Options::default() }).unwrap();
        assert!(warnings.is_empty(), "{name}: {warnings}");
        assert_eq!(read.vertices, scene.vertices, "{name}");
        // Parts of the same name and material are one after reading; each keeps its faces in order.
        assert_eq!(read.triangle_count(), scene.triangle_count(), "{name}");
        for part in &read.parts {
            let material = &read.materials[part.material as usize];
            let written: Vec<u32> = scene
                .parts
                .iter()
                .filter(|p| {
                    (&p.name, p.faces) == (&part.name, part.faces)
                        && scene.materials[p.material as usize] == *material
                })
                .flat_map(|p| p.indices.iter().copied())
                .collect();
            assert_eq!(part.indices, written, "{name}: {}", part.name);
        }
    }
}

#[test]
fn scenes_are_what_they_promise() {
    let cornell = generate::cornell_box();
    assert_eq!(cornell.triangle_count(), 36);
    assert!(cornell.materials.iter().any(|material| material.emission.max_element() > 1.0));
    assert_eq!(generate::soup(1000, 7).triangle_count(), 1000);
    assert_ne!(generate::soup(10, 7), generate::soup(10, 8));
    let terrain = generate::terrain(20_000, 1).triangle_count();
    assert!((19_000..21_000).contains(&terrain));
    let no_area =
        |mesh: &Mesh| mesh.triangles().iter().filter(|t| t.scaled_normal().length_squared() == 0.0).count();
    assert!(no_area(&generate::coincident()) >= 96);
    let (coarse, fine) =
        (generate::courtyard(1, 1).triangle_count(), generate::courtyard(4, 1).triangle_count());
    assert!(coarse < 7_000 && (10 * coarse..17 * coarse).contains(&fine), "{coarse} {fine}");
    for mesh in scenes().map(|(_, mesh)| mesh) {
        assert!(mesh.triangles().iter().all(|t| t.is_finite()));
    }
}
