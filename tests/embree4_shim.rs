//! The shim and the preload library, compiled with the headers of Embree 4, which Debian 12 does not have: with those in the crate
//! `embree4-sys` (4.2.0), and linked with the library in the Python package `embreex` (4.4.0). Where these cannot be had, the
//! tests say so and pass.
#![cfg(feature = "embree")]

mod embree4_support;

use embree4_support::{headers, library, package};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The C++ compiler, as build.rs calls it: a warning is an error.
fn compiler(major: u32, headers: &Path) -> Command {
    let mut command = Command::new("c++");
    command
        .args(["-std=c++17", "-O2", "-fPIC", "-Wall", "-Wextra", "-Werror", "-Iembree-shim"])
        .arg(format!("-DEMBREE_MAJOR={major}"))
        .arg("-isystem")
        .arg(headers)
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// Sources of the preload library, or the others.
fn sources(preload: bool) -> Vec<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("embree-shim");
    let paths = std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "cpp"))
        .filter(|path| path.file_name().unwrap().to_string_lossy().starts_with("preload") == preload)
        .collect()
}

fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The answers of Embree 4 are the ones computed by hand, one by one and in packets; its memory is not read as Embree 3's.
#[test]
fn the_shim_asks_embree_4() {
    let (Some(headers), Some(package)) = (headers(), package()) else { return };
    let directory = tempfile::tempdir().unwrap();
    let program = directory.path().join("program");
    let library = library(package);
    printed(
        compiler(4, &headers)
            .arg("tests/embree4_support/shim_program.cpp")
            .args(sources(false))
            .arg(&library)
            .arg(format!("-Wl,-rpath,{}", library.parent().unwrap().display()))
            .arg("-Wl,--allow-shlib-undefined")
            .arg("-o")
            .arg(&program),
    );
    let said = printed(&mut Command::new(&program));
    let lines: Vec<&str> = said.lines().collect();

    // See `shim_program.cpp` for the rays. The quad's triangles are (v0, v1, v3) and (v2, v3, v1), 1 and 2 of the scene.
    let answers = [
        "1 t 5 triangle 0 part 0 u 0.25 v 0.5 normal 0 0 1 occluded 1",
        "1 t 8 triangle 2 part 1 u 0.25 v 0.5 normal 0 0 16 occluded 1",
        "0 occluded 0",
        "0 occluded 0",
        "1 t 8 triangle 1 part 1 u 0.0625 v 0.125 normal 0 0 16 occluded 1",
        "0 occluded 0",
    ];
    let packets = [4, 8, 16].into_iter().flat_map(|width| (0..width).map(|lane| ("packet", lane)));
    let asked: Vec<(&str, usize)> = (0..12).map(|query| ("one", query)).chain(packets).collect();
    assert_eq!(lines.len(), asked.len() + 2, "{said}");
    for (line, (how, query)) in lines.iter().zip(&asked) {
        assert_eq!(*line, format!("{how} {}", answers[query % answers.len()]), "query {query}");
    }
    let trees = [
        "live tree: error 1000: Embree's version is 40400, and the layout is known of 31305 only",
        "embree 4.4.0 rtcBuildBVH: 5 nodes, 3 triangles",
    ];
    assert_eq!(lines[asked.len()..], trees);
}

/// With either version's headers it shows the same names of Embree's, whose definitions the compiler has checked against them.
#[test]
fn the_preload_library_is_the_same_with_either_header() {
    let Some(headers) = headers() else { return };
    let directory = tempfile::tempdir().unwrap();
    let names = |major| {
        let path = directory.path().join(format!("preload{major}.so"));
        // Those that plant trees are shared with the shim, too.
        let of_shim = |path: &PathBuf| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with("plant")
                || ["faces.cpp", "live_bvh.cpp", "memory.cpp", "pages.cpp", "tree.cpp"]
                    .contains(&name.as_str())
        };
        printed(
            compiler(major, &headers)
                .args(["-fvisibility=hidden", "-shared", "-Wl,--version-script=embree-shim/preload.map"])
                .arg("-Wl,--no-undefined")
                // The calls that ask are either recorded or timed.
                .args(sources(true).into_iter().filter(|path| !path.ends_with("preload_clock.cpp")))
                .args(sources(false).into_iter().filter(of_shim))
                .arg("-o")
                .arg(&path),
        );
        let defined = printed(
            Command::new("nm").args(["--dynamic", "--defined-only", "--format=just-symbols"]).arg(&path),
        );
        defined.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let names_4 = names(4);
    assert!(names_4.contains(&"rtcTraversableIntersect16".to_owned()));
    assert_eq!(names_4, names(3));
}
