//! What the tests of the recorder share: a program to record, a recorded run, and what a replay says of it.
#![allow(dead_code)] // each test program uses its part

use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Rays, Record};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Compiles `host.cpp`, with further arguments for the compiler.
pub fn compiled_host(arguments: &[&str]) -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("host");
    let compiled = Command::new("c++")
        .args(["-std=c++17", "-O1", "-o"])
        .arg(&path)
        .arg("tests/preload_support/host.cpp")
        .args(arguments)
        .arg("-lpthread")
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("a C++ compiler (tools/setup installs it)");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    (directory, path)
}

/// What the host prints when nobody records it.
pub fn unrecorded_host(host: &Path, what: &str) -> Vec<u8> {
    Command::new(host).arg(what).output().unwrap().stdout
}

/// Replayed queries, those that are not judged as they hit no triangle, and those that are not because something moved.
#[derive(Debug, Default, PartialEq)]
pub struct Judged {
    pub queries: u64,
    pub unchecked: u64,
    pub moving: u64,
}

/// A recorded run of a program.
pub struct Run {
    pub directory: TempDir,
    pub output: Output,
}

impl Run {
    pub fn new(options: &[&str], program: &Path, arguments: &[&str]) -> Run {
        let directory = tempfile::tempdir().unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_embree-trace"))
            .arg("record")
            .args(options)
            .args(["--savetrace", "casts.rays", "built.bvh", "--"])
            .arg(program)
            .args(arguments)
            .current_dir(directory.path())
            .output()
            .unwrap();
        Run { directory, output }
    }

    pub fn of_host(host: &Path, options: &[&str], what: &str) -> Run {
        let run = Run::new(options, host, &[what]);
        assert!(run.output.status.success(), "{what}: {}", run.said());
        run
    }

    pub fn said(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    pub fn rays(&self) -> MappedFile {
        MappedFile::open(&self.path("casts.rays")).unwrap()
    }

    /// Trees by scene number.
    pub fn trees(&self) -> Vec<MappedFile> {
        let path = |number| self.path(&tree_name(number));
        (0..)
            .take_while(|&number| path(number).exists())
            .map(|number| MappedFile::open(&path(number)).unwrap())
            .collect()
    }

    /// Checks both files whole, and replays every scene over its tree. Nothing may disagree.
    pub fn replayed(&self) -> Judged {
        let file = self.rays();
        let rays = Rays::parse(&file).unwrap();
        rays.validate_all().unwrap();
        assert!(rays.recovery.is_none());
        let good = |binary: &str, arguments: &[&str]| {
            let output =
                Command::new(binary).args(arguments).current_dir(self.directory.path()).output().unwrap();
            assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
            output.stdout
        };
        let mut judged = Judged::default();
        for number in 0..self.trees().len() {
            let (tree, scene) = (tree_name(number), number.to_string());
            good(env!("CARGO_BIN_EXE_trace-info"), &[&tree, "--verify"]);
            // Exits with 1 on a mismatch.
            let compared = good(
                env!("CARGO_BIN_EXE_bvh-compare"),
                &[
                    &tree,
                    "casts.rays",
                    "--scene",
                    &scene,
                    "--traversal",
                    "odf",
                    "--no-time",
                    "--format",
                    "json",
                ],
            );
            let compared: serde_json::Value = serde_json::from_slice(&compared).unwrap();
            let counts = &compared["trees"][0]["traversals"]["odf"];
            let count = |name: &str| counts[name].as_u64().unwrap();
            judged.queries += count("queries");
            judged.unchecked += count("unchecked");
            judged.moving += count("moving");
        }
        good(env!("CARGO_BIN_EXE_trace-info"), &["casts.rays", "--verify"]);
        assert_eq!(judged.queries, rays.query_count(), "every scene has its tree");
        judged
    }

    /// The records of each thread, in its order, with the fields that a program sees of them as `host.cpp` prints them.
    pub fn seen(&self) -> BTreeMap<u32, Vec<String>> {
        let (file, trees) = (self.rays(), self.trees());
        let rays = Rays::parse(&file).unwrap();
        let trees: Vec<Bvh> = trees.iter().map(|file| Bvh::parse(file).unwrap()).collect();
        let mut threads: BTreeMap<u32, Vec<String>> = BTreeMap::new();
        for chunk in 0..rays.chunks().len() {
            let chunk = rays.chunk(chunk).unwrap();
            let lines = chunk.records.iter().map(|record| line(record, &trees[chunk.info.scene as usize]));
            threads.entry(chunk.info.thread).or_default().extend(lines);
        }
        threads
    }
}

fn tree_name(scene: usize) -> String {
    if scene == 0 { "built.bvh".to_owned() } else { format!("built.{scene}.bvh") }
}

/// t, geometry, primitive and instance, as `host.cpp` prints them.
fn line(record: &Record, tree: &Bvh) -> String {
    let t = record.t.to_bits();
    if record.is_occlusion() || !record.is_hit() {
        return format!("{t:08x} -1 -1 -1");
    }
    let geometry = tree
        .geometries
        .iter()
        .find(|g| (g.first_triangle..g.first_triangle + g.triangle_count).contains(&record.triangle));
    let geometry = geometry.expect("a triangle of a geometry");
    let primitive = (record.triangle - geometry.first_triangle) / (geometry.kind + 1);
    format!("{t:08x} {} {primitive} {}", geometry.geometry as i32, geometry.instance as i32)
}

pub fn lines(output: &[u8]) -> Vec<String> {
    String::from_utf8(output.to_vec()).unwrap().lines().map(str::to_owned).collect()
}
