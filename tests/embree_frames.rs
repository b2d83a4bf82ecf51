//! Meshes that move: Embree's tree after every commit, and `embree-trace FRAMES… --savetrace DIR`.
#![cfg(feature = "embree")]

mod embree_support;

use embree_support::*;
use embree_trace::embree::{Commit, EmbreeError, Isa, Quality, Scene, Settings, TreeSource};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Rays;
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::mesh::{Faces, Mesh, obj};
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use embree_trace::tree::validate::validate;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// The mesh a few steps later: it twists around y, and rises.
fn moved(mesh: &Mesh, step: u32) -> Mesh {
    let turn = step as f32 * 0.4;
    let twist = |v: &Vec3| {
        let (sin, cos) = (turn * v.y).sin_cos();
        Vec3::new(v.x * cos - v.z * sin, v.y * (1.0 + 0.1 * turn), v.x * sin + v.z * cos)
    };
    Mesh { vertices: mesh.vertices.iter().map(twist).collect(), ..mesh.clone() }
}

/// Triangles and quads: two trees under one root, each of one part.
fn both() -> Mesh {
    let mut mesh = soup(Faces::Quads, 300, 0.2, 3);
    add_soup(&mut mesh, Faces::Triangles, 300, 0.2, &mut Random(4));
    mesh
}

/// Parts from none to many triangles: Embree has a tree over their trees.
fn parts() -> Mesh {
    let mut mesh = Mesh::default();
    for part in 0..12 {
        add_soup(&mut mesh, Faces::Triangles, part % 5 * 30, 0.3, &mut Random(part as u64));
    }
    mesh
}

/// What a refit keeps: every node's children or primitives.
fn topology(tree: &Tree) -> (Vec<(u32, u32)>, Vec<u32>) {
    (tree.nodes.iter().map(|node| (node.first, node.count)).collect(), tree.primitives.clone())
}

/// The same bits, NaN or not.
fn same(a: &[Triangle], b: &[Triangle]) -> bool {
    let bits = |t: &[Triangle]| -> Vec<u32> {
        t.iter().flat_map(|t| t.0).flat_map(|v| v.to_array()).map(f32::to_bits).collect()
    };
    bits(a) == bits(b)
}

/// Embree's answers are those of brute force over `triangles`.
fn check_answers(scene: &Scene, triangles: &[Triangle], what: &str) {
    let mut intersector = scene.intersector().unwrap();
    let mut hits = 0;
    for query in queries(300, 7) {
        let Some((_, truth)) = nearest(&query.ray, triangles, 1e-4) else { continue };
        let hit = intersector.closest_hit(&query).expect("brute force has hit something");
        // Something nearer may be there that is hit near its edge.
        assert!(f64::from(hit.t) <= truth.t * (1.0 + 1e-4) + 1e-5, "{what}: {hit:?}, {truth:?}");
        let found = crossing(&query.ray, &triangles[hit.triangle as usize]).expect("a hit has a crossing");
        assert!(
            found.inside > -1e-3 && (found.t - f64::from(hit.t)).abs() < 1e-3,
            "{what}: {hit:?}, {found:?}"
        );
        hits += 1;
    }
    assert!(hits > 20, "{what}: {hits}");
}

/// The live tree is read with all its checks, is exactly around the new vertices, and answers for them. A refit keeps the tree
/// of a part; a rebuild does not.
#[test]
fn every_commit_has_a_true_tree() {
    let meshes = [
        ("grid", grid(Faces::Triangles, 24), true),
        ("quads", soup(Faces::Quads, 400, 0.2, 2), true),
        ("three", soup(Faces::Triangles, 3, 0.9, 1), true),
        ("both", both(), true),
        ("parts", parts(), false),
    ];
    let settings = [
        Settings::default(),
        Settings { robust: true, ..Settings::default() },
        Settings { compact: true, isa: Some(Isa::Sse42), ..Settings::default() },
    ];
    for (name, mesh, kept) in &meshes {
        for (index, settings) in settings.iter().enumerate() {
            for commit in [Commit::Refit, Commit::Rebuild] {
                let settings = Settings { commit, ..settings.clone() };
                let mut scene = Scene::new(mesh, &settings).unwrap();
                let mut shapes = Vec::new();
                for step in 0..4 {
                    let what = format!("{name}, settings {index}, {commit:?}, step {step}");
                    let frame = moved(mesh, step);
                    if step > 0 {
                        scene.update(&frame.vertices).unwrap();
                    }
                    let built = scene.tree(TreeSource::Live).unwrap();
                    assert_eq!(built.warning, None, "{what}");
                    let triangles = frame.triangles();
                    assert!(same(&built.triangles, &triangles), "{what}");
                    validate(&built.tree, &triangles, 100).unwrap_or_else(|error| panic!("{what}: {error}"));
                    if *name != "three" {
                        check_answers(&scene, &triangles, &what);
                    }
                    shapes.push(topology(&built.tree));
                }
                let all_same = shapes.iter().all(|shape| *shape == shapes[0]);
                match commit {
                    Commit::Refit if *kept => assert!(all_same, "{name}, settings {index}"),
                    Commit::Rebuild if mesh.triangle_count() > 3 => {
                        assert!(!all_same, "{name}, settings {index}: nothing was built anew");
                    }
                    _ => {}
                }
            }
        }
    }
}

/// Every quality can be rebuilt; with spatial splits a triangle stands in several leaves, so each must be in one at least.
#[test]
fn every_quality_can_be_built_anew() {
    let mesh = soup(Faces::Triangles, 300, 2.0, 5);
    for quality in Quality::ALL {
        let mut scene =
            Scene::new(&mesh, &Settings { commit: Commit::Rebuild, quality, ..Settings::default() }).unwrap();
        for step in 1..4 {
            let frame = moved(&mesh, step);
            scene.update(&frame.vertices).unwrap();
            let built = scene.tree(TreeSource::Live).unwrap();
            assert_eq!(built.warning, None, "{quality:?}, step {step}");
            let mut held: Vec<u32> = built.tree.primitives.clone();
            held.sort_unstable();
            held.dedup();
            assert_eq!(held.len(), 300, "{quality:?}, step {step}");
            check_answers(&scene, &frame.triangles(), &format!("{quality:?}, step {step}"));
        }
    }
}

/// A triangle that stops and starts to be finite leaves the tree and comes back: a refit alone would not see it.
#[test]
fn what_embree_drops_may_change() {
    let mesh = soup(Faces::Triangles, 500, 0.2, 1);
    for commit in [Commit::Refit, Commit::Rebuild] {
        let mut scene = Scene::new(&mesh, &Settings { commit, ..Settings::default() }).unwrap();
        for (step, bad) in [0, 20, 40, 0].into_iter().enumerate() {
            let mut frame = moved(&mesh, step as u32);
            frame.vertices.iter_mut().step_by(7).take(bad).for_each(|vertex| vertex.y = f32::NAN);
            scene.update(&frame.vertices).unwrap();
            let built = scene.tree(TreeSource::Live).unwrap();
            assert_eq!(built.warning, None, "{commit:?}, step {step}");
            let triangles = frame.triangles();
            let finite = triangles.iter().filter(|triangle| triangle.is_finite()).count();
            assert_eq!(finite, 500 - bad);
            assert_eq!(built.tree.primitives.len(), finite, "{commit:?}, step {step}");
            validate(&built.tree, &triangles, 100).unwrap();
            check_answers(&scene, &triangles, &format!("{commit:?}, step {step}"));
        }
    }
}

#[test]
fn what_cannot_be_updated_says_why() {
    let mesh = soup(Faces::Triangles, 50, 0.2, 1);
    let message = |error: EmbreeError| error.to_string();
    let mut once = Scene::new(&mesh, &Settings::default()).unwrap();
    assert!(message(once.update(&mesh.vertices).unwrap_err()).contains("committed only once"));
    let refit = Settings { commit: Commit::Refit, ..Settings::default() };
    let mut scene = Scene::new(&mesh, &refit).unwrap();
    let error = message(scene.update(&mesh.vertices[1..]).unwrap_err());
    assert!(error.contains("150 vertices, and 149 are given"), "{error}");
    // Nothing has changed, and the scene can still be updated.
    assert!(same(&scene.triangles().0, &mesh.triangles()));
    scene.update(&moved(&mesh, 1).vertices).unwrap();
    let named = Settings { tri_accel: Some("bvh4.triangle4".into()), ..refit.clone() };
    for settings in [named, Settings { quality: Quality::High, ..refit.clone() }] {
        assert!(Scene::new(&mesh, &settings).err().map(message).unwrap().contains("does not refit"));
    }
    let mut empty = Scene::new(&Mesh { vertices: mesh.vertices.clone(), ..Mesh::default() }, &refit).unwrap();
    empty.update(&mesh.vertices).unwrap();
    assert_eq!(empty.tree(TreeSource::Live).unwrap().tree.primitives.len(), 0);
}

fn run(program: &str, directory: &Path, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).current_dir(directory).output().unwrap()
}

fn trace(directory: &Path, arguments: &[&str]) -> Output {
    run(env!("CARGO_BIN_EXE_embree-trace"), directory, arguments)
}

fn good(directory: &Path, arguments: &[&str]) -> String {
    let output = trace(directory, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Exit code 2, and one line that says all of `expected`.
fn bad(directory: &Path, arguments: &[&str], expected: &[&str]) {
    let output = trace(directory, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
    assert_eq!(stderr.lines().count(), 1, "{arguments:?}: {stderr}");
    for text in expected {
        assert!(stderr.contains(text), "{arguments:?}: expected `{text}` in: {stderr}");
    }
}

fn write_obj(directory: &Path, name: &str, mesh: &Mesh) {
    let mut bytes = Vec::new();
    obj::write(mesh, "none.mtl", &mut bytes, std::io::sink(), &Progress::hidden()).unwrap();
    fs::write(directory.join(name), bytes).unwrap();
}

/// Writes frames of `mesh`; returns their names and what a reader makes of them.
fn write_frames(directory: &Path, mesh: &Mesh, count: u32) -> (Vec<String>, Vec<Mesh>) {
    (0..count)
        .map(|step| {
            let name = format!("frame{step}.obj");
            write_obj(directory, &name, &moved(mesh, step));
            let options = obj::Options { quads: true, ..obj::Options::default() };
            let (read, _) = embree_trace::mesh::read_with(&directory.join(&name), &options).unwrap();
            (name, read)
        })
        .unzip()
}

const SMALL: &[&str] = &["--size", "40x30", "--spp", "2", "--quads"];

#[test]
fn a_sequence_is_a_pair_a_frame() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let (names, frames) = write_frames(here, &both(), 4);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for commit in ["refit", "rebuild"] {
        let arguments =
            [&names[..], SMALL, &["--commit", commit, "--format", "json", "--savetrace", commit]].concat();
        let summary: serde_json::Value = serde_json::from_str(&good(here, &arguments)).unwrap();
        assert_eq!(summary["frames"].as_array().unwrap().len(), 4);
        let mut written: Vec<String> = fs::read_dir(here.join(commit))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        written.sort();
        let expected = (0..4).flat_map(|n| [format!("{n:04}.bvh"), format!("{n:04}.rays")]);
        assert_eq!(written, expected.collect::<Vec<_>>());

        let (mut shapes, mut cameras, mut queries) = (Vec::new(), Vec::new(), 0);
        for (number, frame) in frames.iter().enumerate() {
            let pair = ["bvh", "rays"].map(|ending| format!("{commit}/{number:04}.{ending}"));
            let [tree, rays] = pair.each_ref().map(|path| MappedFile::open(&here.join(path)).unwrap());
            let (bvh, rays) = (Bvh::parse(&tree).unwrap(), Rays::parse(&rays).unwrap());
            bvh.verify().unwrap();
            assert_eq!(bvh.header.fingerprint, rays.header.fingerprint);
            assert!(same(bvh.triangles, &frame.triangles()), "{pair:?}");
            let meta: serde_json::Value = serde_json::from_str(bvh.meta.unwrap()).unwrap();
            let frame =
                serde_json::json!({ "number": number, "of": 4, "file": names[number], "commit": commit });
            assert_eq!(meta, serde_json::json!({ "image": [40, 30], "frame": frame }));
            shapes.push(topology(&Tree {
                nodes: bvh.tree.nodes.to_vec(),
                primitives: bvh.tree.primitives.to_vec(),
            }));
            let records =
                (0..rays.chunks().len()).flat_map(|chunk| rays.chunk(chunk).unwrap().records.to_vec());
            let camera = records.filter(|record| record.depth == 0);
            cameras.push(camera.map(|record| (record.path, record.ray())).collect::<Vec<_>>());
            queries += rays.query_count();
            let line = &summary["frames"][number];
            assert_eq!(
                (&line["number"], &line["file"], &line["rays"]["records"]),
                (&number.into(), &names[number].into(), &rays.query_count().into())
            );
            let compared = run(
                env!("CARGO_BIN_EXE_bvh-compare"),
                here,
                &[&pair[0], &pair[1], "--no-time", "--format", "json"],
            );
            let said = String::from_utf8_lossy(&compared.stderr);
            assert_eq!(compared.status.code(), Some(0), "{pair:?}: {said}");
            let report: serde_json::Value = serde_json::from_slice(&compared.stdout).unwrap();
            for traversal in report["trees"][0]["traversals"].as_object().unwrap().values() {
                assert_eq!(traversal["mismatches"], 0);
                assert!(traversal["queries"].as_u64().unwrap() > 1000);
            }
        }
        // One camera, and the same random numbers: the same camera rays in every frame.
        assert!(cameras[0].len() == 40 * 30 * 2 && cameras.iter().all(|rays| *rays == cameras[0]));
        assert_eq!(shapes.iter().all(|shape| *shape == shapes[0]), commit == "refit");
        let total: u64 =
            summary["queries"].as_array().unwrap().iter().map(|line| line["queries"].as_u64().unwrap()).sum();
        assert_eq!(total, queries);
    }
    // The first frame of both is the same tree as that of one scene.
    let single = [&names[..1], SMALL, &["--savetrace", "a.rays", "a.bvh"]].concat();
    good(here, &single);
    let rays = |path: &str| fs::read(here.join(path)).unwrap();
    assert!(rays("rebuild/0000.rays") == rays("a.rays") && rays("refit/0000.rays") == rays("a.rays"));
}

#[test]
fn threads_do_not_change_a_byte_of_a_sequence() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let (names, _) = write_frames(here, &parts(), 3);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for commit in ["refit", "rebuild"] {
        let files = |threads: &str| {
            let to = format!("{commit}{threads}");
            let asked = ["--commit", commit, "--threads", threads, "--compress", "--savetrace", &to];
            let text = good(here, &[&names[..], SMALL, &asked].concat());
            assert!(
                text.contains("frame0.obj and 2 more frames") && text.contains("0002.rays of frame2.obj")
            );
            (0..3)
                .flat_map(|n| [format!("{n:04}.bvh"), format!("{n:04}.rays")])
                .map(|name| fs::read(here.join(&to).join(name)).unwrap())
                .collect::<Vec<_>>()
        };
        let one = files("1");
        assert!(files("2") == one && files("5") == one, "{commit}");
    }
}

#[test]
fn what_is_no_sequence_is_one_line() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let mesh = grid(Faces::Triangles, 6);
    write_frames(here, &mesh, 2);
    let mut other = mesh.clone();
    other.parts[0].indices.swap(3, 4);
    write_obj(here, "turned.obj", &other);
    other = mesh.clone();
    other.parts[0].indices.truncate(9);
    write_obj(here, "fewer.obj", &other);
    other = mesh.clone();
    other.vertices.push(Vec3::ONE);
    write_obj(here, "more.obj", &other);
    let with = |last: &'static str| ["frame0.obj", "frame1.obj", last, "--size", "8x8", "--savetrace", "out"];
    bad(here, &with("absent.obj"), &["absent.obj", "cannot open"]);
    assert!(!here.join("out").exists(), "a missing frame is known before anything is made");
    bad(here, &with("turned.obj"), &["turned.obj", "face 1 of part 0"]);
    // The frames before it are whole.
    assert!(here.join("out/0001.bvh").exists() && !here.join("out/0002.rays").exists());
    bad(here, &with("fewer.obj"), &["out: cannot record into: the directory is not empty"]);
    for (name, says) in
        [("fewer.obj", "has 3 triangles, and in the first frame 72"), ("more.obj", "50 vertices")]
    {
        fs::remove_dir_all(here.join("out")).unwrap();
        bad(here, &with(name), &[name, "not a frame of the same mesh", says]);
    }
    fs::write(here.join("file"), "").unwrap();
    let frames = ["frame0.obj", "frame1.obj"];
    bad(here, &[&frames[..], &["--savetrace", "file"]].concat(), &["file: cannot create"]);
    bad(here, &["frame0.obj", "--savetrace", "dir"], &["dir", "RAYS BVH"]);
    bad(here, &frames, &["--savetrace DIR"]);
    bad(here, &[&frames[..], &["--savetrace", "a.rays", "a.bvh"]].concat(), &["--savetrace DIR"]);
    bad(here, &[&frames[..], &["--output", "a.png", "--savetrace", "dir"]].concat(), &["a.png", "one scene"]);
    bad(here, &["frame0.obj", "--commit", "refit", "--savetrace", "a", "b"], &["--commit"]);
    bad(here, &[&frames[..], &["--quality", "high", "--savetrace", "dir"]].concat(), &["does not refit"]);
    // In front of the frames the option would take one of them, and write over it.
    let before = fs::read(here.join("frame0.obj")).unwrap();
    bad(here, &["--savetrace", "dir", "frame0.obj", "frame1.obj"], &["frame0.obj", "--savetrace=DIR"]);
    assert_eq!(fs::read(here.join("frame0.obj")).unwrap(), before);
    good(here, &[&["--savetrace=dir", "--size", "8x8"], &frames[..]].concat());
    assert!(here.join("dir/0001.rays").exists());
}

/// A planted tree follows the frames, or each frame has its own: the same answers as Embree's trees
/// give, whatever Embree itself does with its tree at a commit.
#[test]
fn planted_trees_follow_the_frames() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let (names, _) = write_frames(here, &both(), 4);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let isa = &["--isa", "sse42"];
    for commit in ["refit", "rebuild"] {
        let path = |kind: &str| format!("{kind}-{commit}");
        let record = |kind: &str, more: &[&str]| {
            let to = path(kind);
            let common = ["--commit", commit, "--format", "json", "--savetrace", &to];
            let arguments = [&names[..], SMALL, isa, &common, more].concat();
            let output = trace(here, &arguments);
            let stderr = String::from_utf8(output.stderr).unwrap();
            assert!(output.status.success(), "{arguments:?}: {stderr}");
            (serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap(), stderr)
        };
        let (own, _) = record("own", &[]);
        // A tree a frame: split, binary, and the first one's for all that come.
        fs::create_dir(here.join(path("trees"))).unwrap();
        for number in 0..4 {
            let from = format!("{}/{number:04}.bvh", path("own"));
            let to = format!("{}/{number:04}.bvh", path("trees"));
            let built = run(
                env!("CARGO_BIN_EXE_bvh-build"),
                here,
                &[&from, &to, "--splits", "spatial", "--width", "4"],
            );
            assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        }
        let first = format!("{}/0000.bvh", path("trees"));
        for (kind, trees) in [("following", first), ("each", path("trees"))] {
            let (summary, stderr) = record(kind, &["--tree", &trees]);
            // There are warnings of materials, and none of trees.
            assert!(!stderr.contains("plant") && !stderr.contains(".bvh"), "{stderr}");
            for number in 0..4 {
                let line = &summary["frames"][number];
                assert_eq!(line["planted"]["trees"], 2, "{line}");
                assert_eq!(line["rays"]["records"], own["frames"][number]["rays"]["records"]);
                // The tree is one of this frame, and a traversal of it gives the recorded answers.
                let pair = ["bvh", "rays"].map(|ending| format!("{}/{number:04}.{ending}", path(kind)));
                let bytes = MappedFile::open(&here.join(&pair[0])).unwrap();
                let bvh = Bvh::parse(&bytes).unwrap();
                bvh.verify().unwrap();
                assert!(bvh.header.producer.starts_with("planted in embree"));
                let own = format!("{}/{number:04}.bvh", path("own"));
                let words = [own.as_str(), &pair[0], &pair[1], "--no-time"];
                let compared = run(env!("CARGO_BIN_EXE_bvh-compare"), here, &words);
                let said = String::from_utf8_lossy(&compared.stderr);
                assert_eq!(compared.status.code(), Some(0), "{pair:?}: {said}");
            }
        }
        // A tree of the last frame is none of the first: one line, and the recording is Embree's.
        let last = format!("{}/0003.bvh", path("trees"));
        let (summary, stderr) = record("other", &["--tree", &last]);
        assert_eq!(stderr.lines().filter(|line| line.contains("not planted")).count(), 1, "{stderr}");
        assert!(summary["frames"][0].get("planted").is_none());
    }
}
