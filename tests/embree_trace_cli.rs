//! `embree-trace` as it is typed: what it writes, that threads do not matter, and how it fails.
#![cfg(feature = "embree")]

use embree_trace::embree::{Query, Scene, Settings};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Purpose, Rays, flag};
use embree_trace::mesh;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// A room with a lamp and two boxes, 38 triangles, and its camera.
fn room(directory: &Path) -> PathBuf {
    let mut obj = String::from("mtllib room.mtl\n");
    let mut corners = 0;
    let mut cuboid = |obj: &mut String, material: &str, low: [f32; 3], high: [f32; 3]| {
        obj.push_str(&format!("usemtl {material}\n"));
        for corner in 0..8 {
            let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
            obj.push_str(&format!("v {} {} {}\n", pick(0), pick(1), pick(2)));
        }
        for face in [[1, 2, 4, 3], [5, 6, 8, 7], [1, 2, 6, 5], [3, 4, 8, 7], [1, 3, 7, 5], [2, 4, 8, 6]] {
            let [a, b, c, d] = face.map(|corner| corner + corners);
            obj.push_str(&format!("f {a} {b} {c} {d}\n"));
        }
        corners += 8;
    };
    cuboid(&mut obj, "white", [0.0, 0.0, 0.0], [4.0, 3.0, 5.0]);
    cuboid(&mut obj, "mirror", [0.5, 0.0, 3.0], [1.5, 1.5, 4.0]);
    cuboid(&mut obj, "white", [2.4, 0.0, 2.0], [3.4, 0.8, 3.0]);
    cuboid(&mut obj, "lamp", [1.5, 2.9, 2.0], [2.5, 2.95, 3.0]);
    let path = directory.join("room.obj");
    fs::write(&path, obj).unwrap();
    let materials = "newmtl white\nKd 0.7 0.7 0.7\nnewmtl mirror\nKd 0.2 0.2 0.2\nKs 0.6 0.6 0.6\nillum 3\nnewmtl lamp\nKd 0 0 0\nKe 9 9 8\n";
    fs::write(directory.join("room.mtl"), materials).unwrap();
    path
}

fn command(directory: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_embree-trace")).args(arguments).current_dir(directory).output().unwrap()
}

fn good(directory: &Path, arguments: &[&str]) -> String {
    let output = command(directory, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Exit code 2, and one line that says all of `expected`.
fn bad(directory: &Path, arguments: &[&str], expected: &[&str]) {
    let output = command(directory, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
    for text in expected {
        assert!(stderr.contains(text), "{arguments:?}: expected `{text}` in: {stderr}");
    }
    if stderr.starts_with("embree-trace: error") {
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
}

const CAMERA: &[&str] = &["--camera", "2,1.6,0.4/2,1.2,4", "--fov", "70"];

#[test]
fn threads_do_not_change_a_byte() {
    let directory = TempDir::new().unwrap();
    room(directory.path());
    for extra in [&["--packet", "1"][..], &["--packet", "8", "--compress"], &["--integrator", "ao"]] {
        let files = |threads: &str| {
            let mut arguments = vec!["room.obj", "--size", "70x50", "--spp", "6", "--threads", threads];
            arguments.extend_from_slice(&["--savetrace", "a.rays", "a.bvh", "--output", "a.exr"]);
            arguments.extend_from_slice(CAMERA);
            arguments.extend_from_slice(extra);
            good(directory.path(), &arguments);
            ["a.rays", "a.bvh", "a.exr"].map(|name| fs::read(directory.path().join(name)).unwrap())
        };
        let one = files("1");
        assert!(files("2") == one && files("7") == one, "{extra:?}");
    }
}

/// Every recorded answer is that of a plain intersector, and every record says what it is.
#[test]
fn records_are_what_was_asked() {
    let directory = TempDir::new().unwrap();
    let path = room(directory.path());
    let mut arguments = vec!["room.obj", "--size", "40x30", "--spp", "2", "-savetrace", "a.rays", "a.bvh"];
    arguments.extend_from_slice(CAMERA);
    arguments.extend_from_slice(&["--format", "json"]);
    let summary: serde_json::Value = serde_json::from_str(&good(directory.path(), &arguments)).unwrap();

    let (mesh, _) = mesh::read(&path).unwrap();
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let mut intersector = scene.intersector().unwrap();
    let file = MappedFile::open(&directory.path().join("a.rays")).unwrap();
    let rays = Rays::parse(&file).unwrap();
    assert!(rays.recovery.is_none() && rays.header.deterministic);
    let tree = MappedFile::open(&directory.path().join("a.bvh")).unwrap();
    assert_eq!(Bvh::parse(&tree).unwrap().header.fingerprint, rays.header.fingerprint);

    let mut counts = [0u64; 6];
    for index in 0..rays.chunks().len() {
        for record in rays.chunk(index).unwrap().records.iter() {
            let purpose = Purpose::from_byte(record.purpose);
            counts[purpose as usize] += 1;
            assert!(record.path < 40 * 30 && record.depth <= 4);
            assert_eq!(purpose == Purpose::Camera, record.depth == 0);
            assert_eq!(record.flags & flag::COHERENT != 0, record.depth == 0);
            assert_eq!(purpose == Purpose::Shadow, record.is_occlusion());
            let query = Query { mask: record.mask, ..Query::new(record.ray()) };
            if record.is_occlusion() {
                assert_eq!(intersector.occluded(&query), record.is_hit());
            } else {
                match intersector.closest_hit(&query) {
                    Some(hit) => {
                        assert_eq!(
                            (hit.t, hit.triangle, hit.u, hit.v),
                            (record.t, record.triangle, record.u, record.v)
                        );
                    }
                    None => assert!(!record.is_hit() && record.t == f32::INFINITY),
                }
            }
        }
    }
    assert_eq!(counts[Purpose::Camera as usize], 40 * 30 * 2);
    assert!([Purpose::Shadow, Purpose::Diffuse, Purpose::Specular].iter().all(|&p| counts[p as usize] > 100));
    assert_eq!(summary["rays"]["records"], counts.iter().sum::<u64>());
    for line in summary["queries"].as_array().unwrap() {
        let purpose = Purpose::ALL.into_iter().find(|p| p.name() == line["purpose"]).unwrap();
        assert_eq!(line["queries"], counts[purpose as usize]);
    }
    assert_eq!(summary["lights"], "emitters");
}

/// A camera that is chosen stands in the room and sees it; every integrator makes a picture that is not black.
#[test]
fn pictures_show_something() {
    let directory = TempDir::new().unwrap();
    room(directory.path());
    for integrator in ["path", "ao", "primary", "shadow"] {
        let arguments =
            ["room.obj", "--size", "32x24", "--spp", "4", "--integrator", integrator, "--output", "a.png"];
        let text = good(directory.path(), &arguments);
        assert!(text.contains("closest hit") && text.contains("picture"), "{text}");
        let picture = image::open(directory.path().join("a.png")).unwrap().into_luma8();
        let bright = picture.pixels().filter(|pixel| pixel.0[0] > 25).count();
        assert!(bright > 32 * 24 / 3, "{integrator}: {bright}");
    }
}

#[test]
fn errors_are_one_line() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    room(here);
    fs::write(here.join("empty.obj"), "").unwrap();
    fs::write(here.join("points.obj"), "v 0 0 0\nv 1 1 1\n").unwrap();
    let trace = ["--savetrace", "a.rays", "a.bvh"];
    let with = |scene: &'static str, more: &[&'static str]| [&[scene], more, &trace[..]].concat();
    bad(here, &with("absent.obj", &[]), &["absent.obj", "cannot open"]);
    bad(here, &with("empty.obj", &[]), &["empty.obj", "empty"]);
    bad(here, &with("points.obj", &[]), &["points.obj", "no faces"]);
    for (option, value) in [
        ("--size", "0x10"),
        ("--size", "65536x65536"),
        ("--size", "12"),
        ("--spp", "0"),
        ("--max-depth", "0"),
        ("--threads", "0"),
        ("--packet", "5"),
        ("--ao-rays", "0"),
        ("--camera", "1,2,3"),
        ("--camera", "nan,0,0/1,1,1"),
        ("--camera", "1,1,1/1,1,1"),
        ("--fov", "nan"),
        ("--fov", "180"),
        ("--isa", "mmx"),
        ("--tri-accel", "bvh3"),
    ] {
        bad(here, &with("room.obj", &[option, value]), &[]);
    }
    assert!(!here.join("a.rays").exists() && !here.join("a.bvh").exists());
    bad(here, &["room.obj", "--output", "a.jpg"], &["a.jpg", ".png"]);
    bad(here, &["room.obj", "--output", "no/such/a.png"], &["a.png", "cannot create"]);
    bad(here, &["room.obj", "--savetrace", "same", "same"], &["same"]);
    bad(here, &["room.obj", "--savetrace", "no/a.rays", "a.bvh"], &["no/a.rays"]);
    bad(here, &["room.obj", "--savetrace", "a.rays", "no/a.bvh"], &["no/a.bvh"]);
}

/// Errors speak of what was given: no camera was.
#[test]
fn without_a_camera_no_error_is_about_one() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    room(here);
    for (corners, expected) in [
        ("v 5 5 5\nv 5 5 5\nv 5 5 5\n", "no triangle of the scene has an area"),
        ("v 0 0 0\nv 1 1 1\nv 2 2 2\n", "no triangle of the scene has an area"),
        ("v 0 0 0\nv 1e16 0 0\nv 0 1e16 0\n", "the scene is too large"),
        // Embree leaves it out.
        ("v 0 0 0\nv 1e30 0 0\nv 0 1e30 0\n", "and coordinates below 1.8e18"),
    ] {
        fs::write(here.join("p.obj"), format!("{corners}f 1 2 3\n")).unwrap();
        bad(here, &["p.obj", "--size", "8x8"], &[expected]);
    }
    // A point is looked at when somebody says from where.
    fs::write(here.join("p.obj"), "v 5 5 5\nv 5 5 5\nv 5 5 5\nf 1 2 3\n").unwrap();
    good(here, &["p.obj", "--size", "8x8", "--camera", "0,0,0/1,1,1"]);
    bad(here, &["room.obj", "--camera", "1,1,1/1,1,1"], &["eye and target are the same point"]);
}

/// One range for a number, whatever is wrong with it.
#[test]
fn ranges_do_not_contradict_each_other() {
    let directory = TempDir::new().unwrap();
    room(directory.path());
    for (option, range) in [
        ("--spp", "1..=16777216"),
        ("--max-depth", "1..=254"),
        ("--ao-rays", "1..=1024"),
        ("--threads", "1..=1024"),
    ] {
        for value in ["0", "255", "1025", "65536", "16777217", "4294967296"] {
            let most: u64 = range.trim_start_matches("1..=").parse().unwrap();
            if value == "0" || value.parse::<u64>().unwrap() > most {
                bad(directory.path(), &["room.obj", option, value], &[option, range]);
            }
        }
    }
}

/// What is typed into a source with a backslash has none on the screen.
#[test]
fn no_help_has_backslashes_before_quotes() {
    for program in [
        env!("CARGO_BIN_EXE_embree-trace"),
        env!("CARGO_BIN_EXE_bvh-build"),
        env!("CARGO_BIN_EXE_bvh-compare"),
        env!("CARGO_BIN_EXE_bvh-experiment"),
        env!("CARGO_BIN_EXE_make-scene"),
        env!("CARGO_BIN_EXE_trace-convert"),
        env!("CARGO_BIN_EXE_trace-diff"),
        env!("CARGO_BIN_EXE_trace-info"),
    ] {
        let commands: &[&str] = match () {
            () if program.ends_with("bvh-experiment") => &["", "shapes", "alpha", "scenes", "optimum"],
            () if program.ends_with("embree-trace") => &["", "record"],
            () => &[""],
        };
        for command in commands {
            let words = [*command, "--help"].into_iter().filter(|word| !word.is_empty());
            let help = Command::new(program).args(words).output().unwrap();
            let text = String::from_utf8(help.stdout).unwrap();
            assert!(help.status.success() && text.contains("Usage"), "{program} {command}");
            assert!(!text.contains("\\\"") && !text.contains("\\'"), "{program} {command}: {text}");
        }
    }
}

/// Without anything to write it renders all the same, for whoever wants to know how long that takes.
#[test]
fn without_savetrace_it_only_renders() {
    let directory = TempDir::new().unwrap();
    room(directory.path());
    let before = fs::read_dir(directory.path()).unwrap().count();
    let summary = good(directory.path(), &["room.obj", "--size", "16x16", "--spp", "1"]);
    assert!(summary.contains("queries/s") && !summary.contains("rays "), "{summary}");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), before);
}

/// Killed at any moment, a recording keeps every whole chunk, and each query in it replays as it was recorded.
#[test]
fn a_killed_recording_can_be_replayed_up_to_its_last_chunk() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    room(here);
    for least_bytes in [1, 3_000_000, 20_000_000] {
        let mut recording = Command::new(env!("CARGO_BIN_EXE_embree-trace"))
            .args(["room.obj", "--size", "1024x1024", "--spp", "64", "--savetrace", "a.rays", "a.bvh"])
            .args(CAMERA)
            .current_dir(here)
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let written = || fs::metadata(here.join("a.rays")).map_or(0, |metadata| metadata.len());
        while written() < least_bytes {
            assert!(recording.try_wait().unwrap().is_none(), "it ended before it could be killed");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        // SIGKILL: no handler, no destructor.
        recording.kill().unwrap();
        recording.wait().unwrap();
        let (mapped, tree) =
            (MappedFile::open(&here.join("a.rays")).unwrap(), MappedFile::open(&here.join("a.bvh")).unwrap());
        let rays = Rays::parse(&mapped).unwrap();
        let recovery = rays.recovery.expect("no end mark was written");
        assert!(recovery.lost_bytes <= 64 + 65_536 * 64, "{recovery:?}");
        assert!(Bvh::parse(&tree).is_ok());
        let replayed = Command::new(env!("CARGO_BIN_EXE_bvh-compare"))
            .args(["a.bvh", "a.rays", "--sample", "20000", "--no-time", "--format", "json"])
            .current_dir(here)
            .output()
            .unwrap();
        let expected = if rays.query_count() == 0 { 2 } else { 0 };
        let stderr = String::from_utf8_lossy(&replayed.stderr);
        assert_eq!(replayed.status.code(), Some(expected), "{stderr}");
        assert!(stderr.contains("cut off"), "{stderr}");
        fs::remove_file(here.join("a.rays")).unwrap();
    }
}

/// A full disk ends the recording at once, says what was kept, and spares the device.
#[test]
fn a_full_disk_is_an_error() {
    let directory = TempDir::new().unwrap();
    room(directory.path());
    let full = ["room.obj", "--size", "256x256", "--savetrace", "/dev/full", "a.bvh"];
    bad(directory.path(), &full, &["/dev/full", "stopped after", "queries"]);
    assert!(!fs::metadata("/dev/full").unwrap().is_file());
}

/// Runs another command of ours; true when it ends with 0.
fn ends_well(directory: &Path, program: &str, arguments: &[&str]) -> bool {
    let output = Command::new(program).args(arguments).current_dir(directory).output().unwrap();
    output.status.success()
}

/// The loop is closed: recorded, rebuilt, planted, and recorded again.
#[test]
fn a_planted_tree_renders_the_same_picture_and_is_recorded() {
    let directory = TempDir::new().unwrap();
    let directory = directory.path();
    room(directory);
    let trace = |arguments: &[&str]| {
        let mut all = vec!["room.obj", "--isa", "sse42", "--size", "60x40", "--spp", "2", "--threads", "1"];
        all.extend_from_slice(CAMERA);
        all.extend_from_slice(arguments);
        let output = command(directory, &all);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{all:?}: {stderr}");
        (String::from_utf8(output.stdout).unwrap(), stderr)
    };
    trace(&["--savetrace", "own.rays", "own.bvh", "--output", "own.exr"]);
    let file = |name: &str| fs::read(directory.join(name)).unwrap();
    let build = |arguments: &[&str]| {
        assert!(ends_well(directory, env!("CARGO_BIN_EXE_bvh-build"), arguments), "{arguments:?}");
    };
    build(&["own.bvh", "ours.bvh", "--splits", "spatial", "--width", "4", "--rays", "own.rays", "--order"]);
    build(&["own.bvh", "wide.bvh", "--width", "8"]);
    let (stdout, stderr) =
        trace(&["--tree", "ours.bvh", "--savetrace", "p.rays", "p.bvh", "--output", "p.exr"]);
    assert!(stdout.contains("planted  ours.bvh: ") && stderr.is_empty(), "{stdout} {stderr}");
    assert_eq!(file("p.exr"), file("own.exr"));
    let ours = file("ours.bvh");
    let (ours, planted) = (Bvh::parse(&ours).unwrap(), file("p.bvh"));
    let planted = Bvh::parse(&planted).unwrap();
    assert_eq!(planted.tree.nodes, ours.tree.nodes);
    assert_eq!(planted.tree.primitives, ours.tree.primitives);
    assert!(ours.order.is_some() && planted.order == ours.order);
    assert_eq!(planted.header.fingerprint, ours.header.fingerprint);
    assert_eq!(planted.header.producer, "planted in embree 3.13.5 sse2 BVH4<triangle4>");
    let same = ["ours.bvh", "p.bvh"];
    assert!(ends_well(directory, env!("CARGO_BIN_EXE_trace-diff"), &same));
    assert!(ends_well(
        directory,
        env!("CARGO_BIN_EXE_bvh-compare"),
        &["p.bvh", "ours.bvh", "p.rays", "--no-time"]
    ));
    let (json, _) = trace(&["--tree", "ours.bvh", "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["planted"]["path"], &json["planted"]["width"]), (&"ours.bvh".into(), &4.into()));

    // What is no tree for this scene is left out, with one line: of another scene, too wide.
    good(directory, &["room.obj", "--quads", "--size", "8x8", "--savetrace", "q.rays", "quads.bvh"]);
    for (name, reason) in [
        ("wide.bvh", "children, and the scene's are 4 wide"),
        ("quads.bvh", "the scene's own tree is not one of the file's triangles"),
    ] {
        let (stdout, stderr) = trace(&["--tree", name, "--output", "p.exr"]);
        assert!(!stdout.contains("planted"), "{stdout}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        let start =
            format!("embree-trace: warning: {name}: not planted, and Embree's own tree is traversed: ");
        assert!(stderr.starts_with(&start) && stderr.contains(reason), "{stderr}");
        assert_eq!(file("p.exr"), file("own.exr"));
    }
    // What is no tree at all is an error.
    let mut damaged = file("ours.bvh");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    fs::write(directory.join("damaged.bvh"), damaged).unwrap();
    bad(directory, &["room.obj", "--tree", "damaged.bvh"], &["damaged.bvh: ", "expected"]);
    bad(directory, &["room.obj", "--tree", "missing.bvh"], &["missing.bvh"]);
    bad(directory, &["room.obj", "--tree", "own.rays"], &["own.rays: "]);
}
