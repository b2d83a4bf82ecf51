//! The library as a C or C++ program has it: the header, compiled as C11 and C++17; the example;
//! and a program of our own (host.cpp) that records, plants and does what is not possible, linked
//! with the shared library and with the static one.
//!
//! What is recorded is held to what the program itself has asked and was answered, and to brute
//! force over the recorded triangles.

use embree_trace::builder::{self, Config, Splits, spatial};
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::format::rays::{NO_TRIANGLE, Rays, Record, Reject, flag as ray_flag};
use embree_trace::geometry::{DVec3, Triangle};
use embree_trace::progress::Progress;
use embree_trace::tree::{LEAF_BIT, Node, Tree, collapse};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Where the header, the example and the sources of the tests are.
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// How a program has the library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Linked {
    Shared,
    Static,
}

/// A directory with the libraries under the names that they are installed with.
struct Installed(tempfile::TempDir);

impl Installed {
    fn new() -> Installed {
        let directory = tempfile::tempdir().unwrap();
        let built = std::env::current_exe().unwrap().parent().unwrap().to_owned();
        for (from, to) in [
            ("libembree_trace_c.so", "libembree_trace.so.0"),
            ("libembree_trace_c.so", "libembree_trace.so"),
            ("libembree_trace_c.a", "libembree_trace.a"),
        ] {
            std::os::unix::fs::symlink(built.join(from), directory.path().join(to)).unwrap();
        }
        Installed(directory)
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Compiles and links a program, of which every warning is an error.
    fn program(&self, source: &str, linked: Linked) -> PathBuf {
        let program = self.path().join(format!("{}-{linked:?}", source.replace(['/', '.'], "-")));
        let c = source.ends_with(".c");
        let mut command = Command::new(if c { "cc" } else { "c++" });
        command.args(if c { &["-std=c11", "-pedantic"][..] } else { &["-std=c++17", "-O1"] });
        command
            .args(["-Wall", "-Wextra", "-Werror"])
            .arg(format!("-I{ROOT}/include"))
            .arg(Path::new(ROOT).join(source));
        match linked {
            Linked::Shared => {
                command.arg("-L").arg(self.path()).arg("-lembree_trace");
                command.arg(format!("-Wl,-rpath,{}", self.path().display()));
            }
            // A debug build has much that nobody calls, with needs of its own.
            Linked::Static => {
                command.arg(self.path().join("libembree_trace.a")).arg("-Wl,--gc-sections");
            }
        }
        command.args(["-lembree3", "-lstdc++", "-lm", "-ldl", "-lpthread", "-o"]).arg(&program);
        passed(command.output().unwrap());
        program
    }
}

fn passed(output: Output) -> String {
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said} {}", String::from_utf8_lossy(&output.stderr));
    said
}

/// Runs a program in a directory.
fn run(program: &Path, directory: &Path, words: &[&str]) -> String {
    passed(Command::new(program).args(words).current_dir(directory).output().unwrap())
}

/// The bytes of a `.bvh` with another tree.
fn with_tree(bvh: &Bvh, tree: &Tree, flags: u32) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let contents = Contents {
        tree: tree.view(),
        triangles: bvh.triangles,
        geometries: bvh.geometries,
        order: None,
        meta: None,
        flags,
        producer: "a test",
    };
    bvh::write(&mut bytes, &contents).ok().map(|_| bytes)
}

/// A tree of a recorded scene that has nothing to do with Embree's.
fn other_tree(bvh: &Bvh, width: usize, split: bool) -> Tree {
    let splits = if split {
        Splits::Spatial(spatial::Options { max_duplication: 2.0, ..Default::default() })
    } else {
        Splits::Sweep
    };
    let built =
        builder::build(bvh.triangles, &Config { splits, ..Config::default() }, &Progress::hidden()).unwrap();
    let area = |node: usize| f64::from(built.nodes[node].bounds().area());
    collapse::collapse(built.view(), area, &collapse::Config::vector(width)).unwrap()
}

/// Scenes of each kind of node and block: RTCSceneFlags, device, and how wide nodes are.
const SCENES: [(&str, &str, usize); 4] =
    [("0", "threads=1", 8), ("4", "threads=2", 8), ("2", "isa=sse42", 4), ("4", "isa=sse42", 4)];

#[test]
fn the_header_is_c() {
    let installed = Installed::new();
    for linked in [Linked::Shared, Linked::Static] {
        run(&installed.program("crates/c-library/tests/header.c", linked), installed.path(), &[]);
    }
}

/// Programs find it by the name that it is installed with, and there is nothing else in it to be
/// found.
#[test]
fn the_shared_library_shows_its_functions_only() {
    let installed = Installed::new();
    let library = installed.path().join("libembree_trace.so");
    let said = passed(
        Command::new("nm")
            .args(["--dynamic", "--defined-only", "--format=just-symbols"])
            .arg(&library)
            .output()
            .unwrap(),
    );
    let mut names: Vec<&str> = said.lines().collect();
    names.sort_unstable();
    let header = std::fs::read_to_string(format!("{ROOT}/include/embree_trace/plant.h")).unwrap();
    let mut declared: Vec<&str> = header
        .lines()
        .filter(|line| line.ends_with(';') && !line.starts_with([' ', '/', '#', 't']))
        .filter_map(|line| line.split('(').next()?.rsplit([' ', '*']).next())
        .filter(|name| name.starts_with("et_"))
        .collect();
    declared.sort_unstable();
    assert_eq!((names.len(), &names), (9, &declared));
    let said = passed(Command::new("readelf").arg("--dynamic").arg(&library).output().unwrap());
    assert!(said.contains("soname: [libembree_trace.so.0]"), "{said}");
    assert_eq!(said.matches("[libembree3.so.3]").count(), 1, "{said}");
}

/// The example of the documentation, from what it says on its first lines.
#[test]
fn the_example_records_and_plants() {
    let installed = Installed::new();
    let directory = installed.path();
    for linked in [Linked::Shared, Linked::Static] {
        let program = installed.program("docs/examples/plant.cpp", linked);
        let said = run(&program, directory, &[]);
        let bytes = std::fs::read(directory.join("built.bvh")).unwrap();
        let built = Bvh::parse(&bytes).unwrap();
        built.verify().unwrap();
        assert_eq!(built.triangles.len(), 20_000);
        let bytes = std::fs::read(directory.join("casts.rays")).unwrap();
        let rays = Rays::parse(&bytes).unwrap();
        rays.verify().unwrap();
        assert_eq!(said, format!("{} queries in casts.rays, the tree in built.bvh\n", rays.query_count()));
        assert_eq!(rays.header.fingerprint, built.header.fingerprint);
        let ours = with_tree(&built, &other_tree(&built, 8, true), flag::SPATIAL_SPLITS).unwrap();
        std::fs::write(directory.join("ours.bvh"), ours).unwrap();
        let said = run(&program, directory, &["ours.bvh"]);
        assert!(said.starts_with("0 of 19200 pixels differ; "), "{said}");
        let wrong = Command::new(&program).arg("casts.rays").current_dir(directory).output().unwrap();
        assert_eq!(wrong.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&wrong.stderr).starts_with("plant: error: casts.rays: "));
    }
}

/// What `host.cpp` asked, `Asked` there.
struct Asked<'a>(&'a [u8]);

impl Asked<'_> {
    fn word(&self, index: usize) -> u32 {
        u32::from_ne_bytes(self.0[4 * index..4 * index + 4].try_into().unwrap())
    }
}

/// The triangle of a primitive of Embree's; of a quad, the first.
fn triangle_of(bvh: &Bvh, geometry: u32, primitive: u32) -> u32 {
    let row = bvh.geometries.iter().find(|row| row.geometry == geometry).unwrap();
    row.first_triangle + primitive * (1 + row.kind)
}

/// Where a ray meets a triangle, by Cramer's rule in double precision, and how far from an edge.
fn meets(record: &Record, triangle: &Triangle) -> Option<(f64, f64)> {
    let [a, b, c] = triangle.0.map(|corner| corner.as_dvec3());
    let (origin, direction) = (record.origin.as_dvec3(), record.direction.as_dvec3());
    let normal: DVec3 = (b - a).cross(c - a);
    let determinant = -direction.dot(normal);
    let from = origin - a;
    let t = from.dot(normal) / determinant;
    let across = from.cross(direction);
    let u = (c - a).dot(across) / determinant;
    let v = -(b - a).dot(across) / determinant;
    let inside = u.min(v).min(1.0 - u - v);
    (t.is_finite() && t >= f64::from(record.tnear) && t <= f64::from(record.tfar)).then_some((t, inside))
}

/// Whether an answer is what brute force finds; `None` where rounding decides.
fn is_right(bvh: &Bvh, record: &Record, rejects: &[Reject]) -> Option<bool> {
    let mut nearest = f64::INFINITY;
    for row in bvh.geometries {
        if row.mask & record.mask == 0 {
            continue;
        }
        for triangle in row.first_triangle..row.first_triangle + row.triangle_count {
            if rejects.iter().any(|reject| reject.triangle == triangle) {
                continue;
            }
            match meets(record, &bvh.triangles[triangle as usize]) {
                Some((_, inside)) if inside.abs() < 1e-5 => return None,
                Some((t, inside)) if inside > 0.0 => nearest = nearest.min(t),
                _ => {}
            }
        }
    }
    if record.is_occlusion() || !record.is_hit() {
        return Some(record.is_hit() == nearest.is_finite());
    }
    Some((nearest - f64::from(record.t)).abs() <= 1e-3 * nearest)
}

/// Every query is in the file, in its order, with the answer that the program got, and those
/// answers follow from what is in the files.
#[test]
fn what_a_program_asks_is_recorded() {
    let installed = Installed::new();
    let program = installed.program("crates/c-library/tests/host.cpp", Linked::Shared);
    for (flags, device, _) in SCENES {
        let directory = tempfile::tempdir_in(installed.path()).unwrap();
        let said = run(&program, directory.path(), &["record", flags, device]);
        let read = |name: &str| std::fs::read(directory.path().join(name)).unwrap();
        let (rays, built, asked) = (read("casts.rays"), read("built.bvh"), read("asked.bin"));
        let (rays, built) = (Rays::parse(&rays).unwrap(), Bvh::parse(&built).unwrap());
        rays.verify().unwrap();
        built.verify().unwrap();
        assert_eq!(rays.header.fingerprint, built.header.fingerprint);
        assert_eq!((rays.header.embree_version, built.header.flags & flag::LIVE), (31305, flag::LIVE));
        let masks: Vec<(u32, u32, u32)> =
            built.geometries.iter().map(|row| (row.geometry, row.mask, row.kind)).collect();
        assert_eq!(masks, [(3, 1, 0), (4, 2, 0), (7, 2, 1)]);

        let mut asked = asked.chunks(64).map(Asked);
        let (mut judged, mut hits, mut doubtful) = (0, 0, 0);
        for chunk in 0..rays.chunks().len() {
            let chunk = rays.chunk(chunk).unwrap();
            for (place, record) in chunk.records.iter().enumerate() {
                let asked = asked.next().expect("no more than was asked");
                let words: &[u32] = bytemuck::cast_slice(std::slice::from_ref(record));
                for (number, &word) in words[..10].iter().enumerate() {
                    assert_eq!(word, asked.word(number), "{record:?}");
                }
                assert_eq!(
                    (record.path, record.kind, record.is_hit()),
                    (asked.word(15), asked.word(10) as u8, asked.word(11) == 1)
                );
                if record.path != u32::MAX {
                    assert_eq!((record.depth, record.purpose), ((record.path % 4) as u8, 4));
                }
                if record.is_hit() && !record.is_occlusion() {
                    assert_eq!(record.t.to_bits(), asked.word(12));
                    let first = triangle_of(&built, asked.word(13), asked.word(14));
                    assert!(record.triangle == first || record.triangle == first + 1, "{record:?}");
                    hits += 1;
                } else {
                    assert_eq!(record.triangle, NO_TRIANGLE);
                }
                assert_eq!(record.flags & (ray_flag::UNDECIDED | ray_flag::INTERRUPTED), 0);
                match is_right(&built, record, chunk.rejects_of(place)) {
                    Some(right) => {
                        assert!(right, "{record:?}");
                        judged += 1;
                    }
                    None => doubtful += 1,
                }
            }
        }
        assert!(asked.next().is_none(), "no less than was asked");
        assert!(hits > 300 && doubtful * 50 < judged, "{hits} hits, {doubtful} of {judged} doubtful");
        let streams = read("streams.rays");
        let streams = Rays::parse(&streams).unwrap();
        let mut occluded = 0;
        for chunk in 0..streams.chunks().len() {
            let chunk = streams.chunk(chunk).unwrap();
            for (place, record) in chunk.records.iter().enumerate() {
                assert!(
                    record.is_occlusion() && is_right(&built, record, chunk.rejects_of(place)) != Some(false)
                );
                occluded += u64::from(record.is_hit());
            }
        }
        assert_eq!(said, format!("{occluded} of {} occluded in streams\n", streams.query_count()));
        for name in ["threads", "instanced"] {
            let (rays, built) = (read(&format!("{name}.rays")), read(&format!("{name}.bvh")));
            Rays::parse(&rays).unwrap().verify().unwrap();
            assert_eq!(Bvh::parse(&built).unwrap().triangles.len(), 300 + 2 * 150 + 100);
        }
        assert!(!directory.path().join("top.rays").exists() && !directory.path().join("top.bvh").exists());
    }
}

/// A recorded scene in a directory of its own, and files to plant in it.
fn recorded(program: &Path, directory: &Path, flags: &str, device: &str) -> Vec<u8> {
    run(program, directory, &["record", flags, device]);
    std::fs::read(directory.join("built.bvh")).unwrap()
}

#[test]
fn trees_are_planted_and_given_back() {
    let installed = Installed::new();
    for linked in [Linked::Shared, Linked::Static] {
        let program = installed.program("crates/c-library/tests/host.cpp", linked);
        for (flags, device, width) in SCENES {
            let directory = tempfile::tempdir_in(installed.path()).unwrap();
            let built = recorded(&program, directory.path(), flags, device);
            let built = Bvh::parse(&built).unwrap();
            for (split, flag) in [(false, 0), (true, flag::SPATIAL_SPLITS)] {
                let tree = other_tree(&built, width, split);
                std::fs::write(directory.path().join("ours.bvh"), with_tree(&built, &tree, flag).unwrap())
                    .unwrap();
                let said = run(&program, directory.path(), &["plant", flags, device, "ours.bvh"]);
                assert!(said.starts_with(&format!("2 trees, {width} wide, ")), "{said}");
                // What was recorded is what was planted: a root over one tree a kind of face.
                let planted = std::fs::read(directory.path().join("planted.bvh")).unwrap();
                let planted = Bvh::parse(&planted).unwrap();
                planted.verify().unwrap();
                assert!(planted.header.producer.starts_with("planted in embree 3.13.5"));
                assert_eq!(planted.header.flags & flag::SPATIAL_SPLITS, flag);
            }
        }
    }
}

#[test]
fn what_is_not_possible_is_said() {
    let installed = Installed::new();
    for linked in [Linked::Shared, Linked::Static] {
        let program = installed.program("crates/c-library/tests/host.cpp", linked);
        for (flags, device, width) in [SCENES[0], SCENES[2]] {
            let directory = tempfile::tempdir_in(installed.path()).unwrap();
            let built = recorded(&program, directory.path(), flags, device);
            let built = Bvh::parse(&built).unwrap();
            let ours = with_tree(&built, &other_tree(&built, width, false), 0).unwrap();
            std::fs::write(directory.path().join("ours.bvh"), ours).unwrap();
            run(&program, directory.path(), &["states", flags, device, "ours.bvh"]);
            // What was recorded before the commit can be read.
            let cut = std::fs::read(directory.path().join("cut.rays")).unwrap();
            assert_eq!(Rays::parse(&cut).unwrap().query_count(), 800);
        }
    }
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) % n as u64) as usize
    }
}

/// Files that are none of the scene's, or no files: cut, with bytes flipped, of other geometries,
/// with leaves too large, too wide, too deep, with words changed under right checksums.
fn hostile_files(built: &Bvh, width: usize, other: &Bvh) -> Vec<Vec<u8>> {
    let mut random = Random(5);
    let tree = other_tree(built, width, false);
    let whole = with_tree(built, &tree, 0).unwrap();
    let mut files = Vec::new();
    for _ in 0..60 {
        files.push(whole[..random.below(whole.len())].to_vec());
        let mut flipped = whole.clone();
        flipped[random.below(whole.len())] ^= 1 << random.below(8);
        files.push(flipped);
    }
    files.extend(with_tree(other, &other_tree(other, width, false), 0));
    files.extend(with_tree(built, &other_tree(built, 2, false), flag::FLATTENED));
    for (geometry, mask) in [(5, 1), (3, 2)] {
        let mut geometries = built.geometries.to_vec();
        (geometries[0].geometry, geometries[0].mask) = (geometry, mask);
        files.extend(with_tree(&Bvh { geometries: &geometries, ..built.clone() }, &tree, 0));
    }
    // All in one leaf, in as many leaves under one node as no node of Embree's has room for, or
    // each triangle one level below the one before.
    let all: Vec<u32> = (0..built.triangles.len() as u32).collect();
    let bounds = tree.nodes[0].bounds();
    let mut wide = Tree { nodes: vec![Node::inner(bounds, 1, 0)], primitives: all.clone() };
    for (number, leaf) in all.chunks(20).enumerate() {
        wide.nodes[0].count += 1;
        wide.nodes.push(Node::leaf(bounds, 20 * number as u32, leaf.len() as u32));
    }
    files.extend(with_tree(built, &wide, 0));
    let leaf = Tree { nodes: vec![Node::leaf(bounds, 0, all.len() as u32)], primitives: all.clone() };
    files.extend(with_tree(built, &leaf, 0));
    let mut nodes = vec![Node::inner(bounds, 1, 2)];
    for (triangle, &first) in all.iter().enumerate().take(all.len() - 1) {
        nodes.push(Node::leaf(bounds, first, 1));
        let next = nodes.len() as u32 + 1;
        let last = triangle + 2 == all.len();
        nodes.push(if last { Node::leaf(bounds, first + 1, 1) } else { Node::inner(bounds, next, 2) });
    }
    files.extend(with_tree(built, &Tree { nodes, primitives: all }, 0));
    for round in 0..300 {
        let mut changed = tree.clone();
        let mut triangles = built.triangles.to_vec();
        for _ in 0..=round % 3 {
            let node = random.below(changed.nodes.len());
            let node = &mut changed.nodes[node];
            let bit = 1u32 << random.below(32);
            match random.below(6) {
                0 => node.count ^= bit & !LEAF_BIT,
                1 => node.first ^= bit,
                2 => {
                    let at = random.below(changed.primitives.len());
                    changed.primitives[at] = random.below(triangles.len()) as u32;
                }
                3 => {
                    let at = random.below(triangles.len());
                    let corner = &mut triangles[at].0[random.below(3)];
                    corner.x = f32::from_bits(corner.x.to_bits() ^ bit);
                }
                4 => node.lower[random.below(3)] += 0.1,
                _ => node.upper[random.below(3)] -= 0.1,
            }
        }
        files.extend(with_tree(&Bvh { triangles: &triangles, ..built.clone() }, &changed, 0));
    }
    files
}

/// Whatever a file holds, the program goes on, with right answers, and is told why in one line.
#[test]
fn hostile_files_are_refused_in_one_line() {
    let installed = Installed::new();
    let program = installed.program("crates/c-library/tests/host.cpp", Linked::Shared);
    let example = installed.program("docs/examples/plant.cpp", Linked::Shared);
    let directory = installed.path();
    run(&example, directory, &[]);
    let lawn = std::fs::read(directory.join("built.bvh")).unwrap();
    let lawn = Bvh::parse(&lawn).unwrap();
    for (flags, device, width) in [SCENES[0], SCENES[2]] {
        let built = recorded(&program, directory, flags, device);
        let built = Bvh::parse(&built).unwrap();
        let files = hostile_files(&built, width, &lawn);
        assert!(files.len() > 250, "{}", files.len());
        let mut names = String::new();
        for (number, bytes) in files.iter().enumerate() {
            std::fs::write(directory.join(format!("{number}.bvh")), bytes).unwrap();
            names += &format!("{number}.bvh\n");
        }
        let mut child = Command::new(&program)
            .args(["files", flags, device])
            .current_dir(directory)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(names.as_bytes()).unwrap();
        let said = passed(child.wait_with_output().unwrap());
        assert_eq!(said.lines().count(), files.len());
        let planted = said.lines().filter(|line| *line == "0 ").count();
        for (number, line) in said.lines().enumerate().filter(|(_, line)| *line != "0 ") {
            let named = format!("{number}.bvh: ");
            assert!(
                line.starts_with(&format!("2 {named}")) || line.starts_with(&format!("3 {named}")),
                "{line}"
            );
        }
        // Some changes do not matter: a box that has room, a byte that nobody reads.
        assert!(planted * 3 < files.len(), "{planted} of {}", files.len());
    }
}
