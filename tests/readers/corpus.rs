//! The committed corpus, run through the fuzz targets again.

use crate::fuzz::{TARGETS, bvh_file, rays_file, repair};
use std::fs;
use std::path::{Path, PathBuf};

/// Every input of a target, by name.
fn inputs(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let mut inputs: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.clone(), fs::read(path).unwrap()))
        .collect();
    inputs.sort();
    inputs
}

/// Runs a target, and says with which input it failed.
fn run(check: fn(&[u8]), path: &Path, bytes: &[u8]) {
    let result = std::panic::catch_unwind(|| check(bytes));
    assert!(result.is_ok(), "with {}", path.display());
}

#[test]
fn the_corpus_is_there_and_passes() {
    for target in &TARGETS {
        let inputs = inputs(target.name);
        assert!(inputs.len() >= 10, "{} inputs of {}", inputs.len(), target.name);
        inputs.iter().for_each(|(path, bytes)| run(target.check, path, bytes));
    }
}

/// A way to make a file from any bytes, and to make its checksums hold.
type Format = (&'static str, fn(&[u8]) -> Option<Vec<u8>>, fn(&mut [u8]));

/// Small files with each byte changed, one at a time, and new checksums.
#[test]
fn damage_behind_checksums_is_refused_or_keeps_every_promise() {
    let formats: [Format; 2] =
        [("rays", rays_file::described, repair::rays), ("bvh", bvh_file::described, repair::bvh)];
    for (name, described, repair) in formats {
        let target = TARGETS.iter().find(|target| target.name == name).unwrap();
        let mut tried = 0;
        for (path, bytes) in inputs(&format!("{name}_structured")) {
            let Some(file) = described(&bytes).filter(|file| file.len() <= 1500 && tried < 8) else {
                continue;
            };
            tried += 1;
            for at in 0..file.len() {
                let mut changed = file.clone();
                changed[at] = changed[at].wrapping_add(1);
                repair(&mut changed);
                run(target.check, &path, &changed);
            }
        }
        assert!(tried >= 3, "{tried} small files of {name}");
    }
}
