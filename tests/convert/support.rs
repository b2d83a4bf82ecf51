//! Files by hand, and the program.

use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, NO_TRIANGLE, Purpose, Rays, RaysWriter, Record, Reject, flag, kind,
};
use embree_trace::geometry::Vec3;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

pub struct Run {
    pub code: i32,
    pub out: String,
    pub error: String,
}

/// A directory with files in it, and the program run there.
pub struct Place(TempDir);

impl Place {
    pub fn new() -> Place {
        Place(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        fs::write(self.path(name), bytes).unwrap();
    }

    pub fn get(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Runs a program of the package with these words.
    pub fn run(&self, program: &str, words: &str) -> Run {
        let output =
            Command::new(program).args(words.split_whitespace()).current_dir(self.0.path()).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Run { code: output.status.code().unwrap_or(-1), out: text(output.stdout), error: text(output.stderr) }
    }

    /// Converts, and returns what the program says as JSON.
    pub fn convert(&self, words: &str) -> Value {
        let run = self.run(env!("CARGO_BIN_EXE_trace-convert"), &format!("{words} --format json"));
        assert_eq!(run.code, 0, "{words}: {}", run.error);
        serde_json::from_str(&run.out).unwrap()
    }

    /// Converts what cannot be, and returns the one line of the error.
    pub fn refuse(&self, words: &str) -> String {
        let run = self.run(env!("CARGO_BIN_EXE_trace-convert"), words);
        assert_eq!((run.code, run.out.as_str()), (2, ""), "{words}: {}", run.error);
        assert_eq!(run.error.lines().count(), 1, "{}", run.error);
        let left: Vec<_> =
            fs::read_dir(self.0.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().ends_with(".part")), "{left:?}");
        run.error.trim_end().to_owned()
    }

    /// Every record and reject of a file, the rejects by the number of their record in the file.
    pub fn queries(&self, name: &str) -> (Header, Vec<Record>, Vec<(u64, u32)>) {
        let bytes = self.get(name);
        let rays = Rays::parse(&bytes).unwrap();
        let (mut records, mut rejects) = (Vec::new(), Vec::new());
        for number in 0..rays.chunks().len() {
            let chunk = rays.chunk(number).unwrap();
            let first = records.len() as u64;
            rejects.extend(
                chunk.rejects.iter().map(|reject| (first + u64::from(reject.record), reject.triangle)),
            );
            records.extend_from_slice(&chunk.records);
        }
        (rays.header, records, rejects)
    }

    /// Runs Python on a script, in the directory; it must succeed.
    pub fn python(&self, script: &str) -> String {
        // Debian's, with Debian's NumPy: see tools/setup.
        let run = Command::new("/usr/bin/python3")
            .args(["-c", script])
            .current_dir(self.0.path())
            .output()
            .unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        String::from_utf8(run.stdout).unwrap().trim_end().to_owned()
    }
}

/// A record of a 2011 ray file, word by word.
pub fn legacy(id: i32, depth: i32, origin: [f32; 3], v: [f32; 3]) -> Vec<u8> {
    let mut bytes = [id.to_le_bytes(), depth.to_le_bytes()].concat();
    for number in origin.into_iter().chain(v) {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes
}

/// A whole 2011 ray file.
pub fn legacy_file(records: &[Vec<u8>]) -> Vec<u8> {
    [records.concat(), 9215_i32.to_le_bytes().to_vec()].concat()
}

/// A closest-hit query along +z that hit triangle 7 at t = 2.5.
pub fn hit() -> Record {
    Record {
        origin: Vec3::new(1.0, 2.0, 3.0),
        tnear: 0.0,
        direction: Vec3::new(0.0, 0.0, 2.0),
        tfar: f32::INFINITY,
        time: 0.0,
        mask: u32::MAX,
        t: 2.5,
        triangle: 7,
        u: 0.25,
        v: 0.5,
        path: 12,
        kind: kind::CLOSEST_HIT,
        depth: 1,
        flags: flag::HIT,
        purpose: Purpose::Diffuse as u8,
    }
}

/// An occlusion query along +z that was blocked.
pub fn blocked() -> Record {
    Record {
        tfar: 4.0,
        t: f32::NEG_INFINITY,
        triangle: NO_TRIANGLE,
        u: 0.0,
        v: 0.0,
        kind: kind::OCCLUSION,
        purpose: Purpose::Shadow as u8,
        ..hit()
    }
}

/// Writes records in chunks: each with its information and rejects.
pub fn write_rays(path: &Path, header: &Header, chunks: &[(ChunkInfo, &[Record], &[Reject])]) {
    let mut writer = RaysWriter::new(fs::File::create(path).unwrap(), header).unwrap();
    for (info, records, rejects) in chunks {
        writer.write_chunk(info, records, rejects, Codec::Raw).unwrap();
    }
    writer.finish().unwrap();
}

/// A recording of every kind of query: 100 in two chunks of two threads, with rejects in the second.
pub fn recording(path: &Path) -> (Header, Vec<Record>, Vec<(u64, u32)>) {
    let header = Header {
        fingerprint: 0xABCD_EF01,
        embree_version: 31305,
        deterministic: true,
        producer: "test".into(),
    };
    let miss =
        Record { t: f32::INFINITY, triangle: NO_TRIANGLE, u: 0.0, v: 0.0, flags: 0, tnear: 1e-3, ..hit() };
    let free = Record { t: f32::INFINITY, flags: flag::COHERENT, tfar: f32::INFINITY, ..blocked() };
    let mut records: Vec<Record> = (0..100)
        .map(|i| Record {
            path: i,
            time: i as f32 / 100.0,
            mask: u32::MAX >> (i % 5),
            ..[hit(), miss, blocked(), free][i as usize % 4]
        })
        .collect();
    for place in [60, 98] {
        records[place].flags |= flag::HAS_REJECTS;
    }
    let reject = |record, triangle| Reject { record, triangle };
    let first = ChunkInfo { scene: 0, thread: 0, sequence: 0 };
    let second = ChunkInfo { scene: 0, thread: 3, sequence: 77 };
    let rejects = [reject(20, 4), reject(58, 9), reject(58, 5)];
    write_rays(path, &header, &[(first, &records[..40], &[]), (second, &records[40..], &rejects)]);
    (header, records, vec![(60, 4), (98, 9), (98, 5)])
}
