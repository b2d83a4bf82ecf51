//! Real scenes, when they are at hand (`$EMBREE_TRACE_SCENES` or `../shared/scenes`): counts and bounds against their manifest, every
//! triangle against tobj. `ALL_SCENES=1` reads the large ones too.

use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::mesh;
use serde_json::Value;
use std::path::{Path, PathBuf};

fn folder() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder =
        std::env::var_os("EMBREE_TRACE_SCENES").map_or_else(|| root.join("../shared/scenes"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no scenes in {}", folder.display());
    None
}

fn vector(value: &Value) -> Vec3 {
    let number = |axis: usize| value[axis].as_f64().unwrap() as f32;
    Vec3::new(number(0), number(1), number(2))
}

#[test]
fn counts_and_bounds_are_the_manifests_and_triangles_are_tobjs() {
    let Some(folder) = folder() else { return };
    let manifest: Value =
        serde_json::from_slice(&std::fs::read(folder.join("MANIFEST.json")).unwrap()).unwrap();
    let all = std::env::var_os("ALL_SCENES").is_some();
    let mut read = 0;
    for (name, facts) in manifest.as_object().unwrap() {
        let path = folder.join(format!("{name}.obj.zst"));
        if !path.exists() || (!all && facts["raw_bytes"].as_u64().unwrap() > 3_000_000) {
            continue;
        }
        let (scene, warnings) = mesh::read(&path).unwrap();
        assert_eq!(warnings.to_string(), "", "{name}");
        assert_eq!(scene.triangle_count() as u64, facts["triangles"].as_u64().unwrap(), "{name}");
        let mut triangles = scene.triangles();
        let bounds = triangles.iter().fold(Aabb::EMPTY, |bounds, triangle| bounds.union(&triangle.bounds()));
        assert_eq!(
            (bounds.lower, bounds.upper),
            (vector(&facts["bbox_min"]), vector(&facts["bbox_max"])),
            "{name}"
        );

        let mut expected = tobj_triangles(&path);
        let key = |triangle: &Triangle| triangle.0.map(|v| v.to_array().map(f32::to_bits));
        triangles.sort_unstable_by_key(key);
        expected.sort_unstable_by_key(key);
        assert!(triangles == expected, "{name}: triangles differ from tobj's");
        read += 1;
    }
    assert!(read > 0);
}

fn tobj_triangles(path: &Path) -> Vec<Triangle> {
    let mut decoder = zstd::Decoder::new(std::fs::File::open(path).unwrap()).unwrap();
    decoder.window_log_max(27).unwrap();
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let mut text = std::io::BufReader::new(decoder);
    let (models, _) =
        tobj::load_obj_buf(&mut text, &options, |_| Ok((Vec::new(), Default::default()))).unwrap();
    let mut triangles = Vec::new();
    for model in models {
        let vertex = |index: u32| Vec3::from_slice(&model.mesh.positions[3 * index as usize..]);
        let (faces, _) = model.mesh.indices.as_chunks::<3>();
        triangles.extend(faces.iter().map(|face| Triangle(face.map(vertex))));
    }
    triangles
}

#[test]
fn files_that_break_readers_are_read() {
    let Some(folder) = folder() else { return };
    // These hold no usable face, and say so.
    let without_faces = [
        "assimp_testline.obj",
        "assimp_testpoints.obj",
        "tinyobj_invalid-relative-texture-index.obj",
        "tinyobj_issue-356-leading-spaces-newmtl.obj",
        "tinyobj_line-prim.obj",
    ];
    for entry in std::fs::read_dir(folder.join("odd")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        match mesh::read(&path) {
            Ok((scene, warnings)) => eprintln!("{name}: {} triangles\n{warnings}", scene.triangle_count()),
            Err(error) => assert!(without_faces.contains(&name.as_str()), "{error}"),
        }
    }
}
