//! What the tests with Embree 4 share: where its library and its headers are, which come from registries.
#![allow(dead_code)] // each test program uses its part

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

const PACKAGE: &str = "embreex==4.4.0.post1";

/// Says what is not tested, and why.
fn skip<T>(why: &str) -> Option<T> {
    // Not by a macro: the test harness would show that of failed tests only.
    let _ = std::io::stderr().write_all(format!("SKIPPED: Embree 4 is not tested, for {why}\n").as_bytes());
    None
}

/// Where the package with the library is, installed once per checkout; `None`, after saying so, when that is not possible.
pub fn package() -> Option<&'static Path> {
    static PACKAGE_PATH: OnceLock<Option<PathBuf>> = OnceLock::new();
    let found = PACKAGE_PATH.get_or_init(|| {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(PACKAGE);
        if path.join("embreex.libs").exists() {
            return Some(path);
        }
        let beside = path.with_extension(std::process::id().to_string());
        let installed = Command::new("/usr/bin/python3")
            .args(["-m", "pip", "install", "--quiet", "--no-deps", "--only-binary", ":all:", "--target"])
            .args([beside.as_os_str(), PACKAGE.as_ref()])
            .output();
        let said = match installed {
            Ok(output) if output.status.success() => {
                // Another test program may have been faster.
                let _ = std::fs::rename(&beside, &path);
                let _ = std::fs::remove_dir_all(&beside);
                return Some(path);
            }
            Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
            Err(error) => error.to_string(),
        };
        skip(&format!("{PACKAGE} cannot be installed: {}", said.trim()))
    });
    found.as_deref()
}

/// The package's Embree.
pub fn library(package: &Path) -> PathBuf {
    std::fs::read_dir(package.join("embreex.libs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.file_name().unwrap().to_string_lossy().starts_with("libembree4"))
        .expect("the package's Embree")
}

/// A directory with the headers of Embree 4.2, which the crate `embree4-sys` brings; `None`, after saying so, when it cannot be
/// had.
pub fn headers() -> Option<PathBuf> {
    // Cargo unpacks the crate when it resolves a package that depends on it, and says where; nothing is built.
    let directory = tempfile::tempdir().unwrap();
    let manifest = "[package]\nname = \"headers\"\nedition = \"2024\"\n\
                    [lib]\npath = \"lib.rs\"\n[dependencies]\nembree4-sys = \"=0.0.12\"\n[workspace]\n";
    std::fs::write(directory.path().join("Cargo.toml"), manifest).unwrap();
    std::fs::write(directory.path().join("lib.rs"), "").unwrap();
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--quiet", "--format-version", "1"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(directory.path())
        .output()
        .unwrap();
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return skip(&format!("the crate embree4-sys cannot be had: {}", said.trim()));
    }
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let package =
        metadata["packages"].as_array().unwrap().iter().find(|package| package["name"] == "embree4-sys");
    let manifest = Path::new(package.unwrap()["manifest_path"].as_str().unwrap());
    Some(manifest.parent().unwrap().join("lib"))
}
