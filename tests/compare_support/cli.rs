//! `bvh-compare` run on files in a directory of its own.

use super::files::*;
use super::{Random, soup};
use embree_trace::format::bvh::fingerprint;
use embree_trace::geometry::Triangle;
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Output};

/// A directory with trees of width 2, 4 and 8 over one scene, and a recording of 3000 queries.
pub struct Files {
    pub directory: tempfile::TempDir,
    pub triangles: Vec<Triangle>,
}

impl Files {
    pub fn new() -> Files {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let triangles = soup(400, 0.25, &mut Random(11));
        let files = Files { directory, triangles };
        let meta = format!("{{\"image\":[{},{}]}}", IMAGE[0], IMAGE[1]);
        files.write("two.bvh", &bvh_bytes(&files.triangles, 2, 1, 1, None));
        files.write("four.bvh", &bvh_bytes(&files.triangles, 4, 2, 2, Some(&meta)));
        files.write("eight.bvh", &bvh_bytes(&files.triangles, 8, 4, 3, None));
        let (records, rejects) = records(&files.triangles, 3000, 5);
        assert!(rejects.len() > 50, "rejects are part of the test");
        let rays = rays_bytes(fingerprint(&files.triangles), &records, &rejects, 700);
        files.write("casts.rays", &rays);
        files
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("writing a test file");
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).expect("reading a test file")
    }

    /// Runs without times, unless the arguments are about these.
    pub fn run(&self, arguments: &[&str]) -> Output {
        const TIMED: [&str; 7] =
            ["--time", "--no-time", "--fit", "--fit-costs", "--fit-reports", "--rounds", "--mpi"];
        let is_timed = arguments.iter().any(|word| TIMED.contains(word));
        self.run_as_given(&[arguments, if is_timed { &[] } else { &["--no-time"] }].concat())
    }

    pub fn run_as_given(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_bvh-compare"))
            .args(arguments)
            .current_dir(self.directory.path())
            .output()
            .expect("running bvh-compare")
    }

    /// Runs with `--format json`, expects success.
    pub fn json(&self, arguments: &[&str]) -> Value {
        let output = self.run(&[arguments, &["--format", "json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("JSON on stdout")
    }

    /// Expects bad input: exit code 2 and one line that says `expected`.
    pub fn refused(&self, arguments: &[&str], expected: &[&str]) {
        let output = self.run(arguments);
        let line = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
        for part in expected {
            assert!(line.contains(part), "{arguments:?}: {line:?} lacks {part:?}");
        }
        assert!(output.stdout.is_empty());
    }
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Without what depends on the clock.
pub fn timeless(mut value: Value) -> Value {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(map) => {
                map.remove("seconds");
                map.values_mut().for_each(strip);
            }
            Value::Array(list) => list.iter_mut().for_each(strip),
            _ => {}
        }
    }
    strip(&mut value);
    value
}
