//! `embree-trace record` with programs of Embree 4, which Debian 12 does not have: with the library in the Python package `embreex`, from
//! PyPI. Where that cannot be had, these tests say so and pass.
#![cfg(feature = "embree")]

mod embree4_support;
mod preload_support;

use embree_trace::format::bvh::{Bvh, flag};
use embree_trace::format::rays::{Rays, flag as record_flag};
use embree4_support::{library, package};
use preload_support::{Judged, Run, compiled_host, lines, unrecorded_host};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Of the library.
const VERSION: u32 = 40400;

/// The program of `preload_support/host.cpp` as one of Embree 4.
fn host(package: &Path) -> (tempfile::TempDir, PathBuf) {
    let library = library(package);
    let search = format!("-Wl,-rpath,{}", library.parent().unwrap().display());
    compiled_host(&[
        "-Iembree-shim",
        "-include",
        "tests/preload_support/host_embree4.hpp",
        library.to_str().unwrap(),
        &search,
        "-Wl,--allow-shlib-undefined",
    ])
}

/// That the tree is ours, as the layout of Embree 4's is not known, and that this is said.
fn has_tree_of_ours(run: &Run) {
    assert!(
        run.said().contains("Embree's version is 40400, and the layout is known of 31305 only"),
        "{}",
        run.said()
    );
    for tree in run.trees() {
        let tree = Bvh::parse(&tree).unwrap();
        assert!(tree.header.flags & flag::LIVE == 0 && tree.header.producer == "bvh-build binned");
    }
}

/// In every form of a query that both versions have, the program sees what it saw before, and that is recorded.
#[test]
fn what_a_program_of_embree_4_sees_is_recorded() {
    let Some(package) = package() else { return };
    let (_directory, host) = host(package);
    for what in [
        "plain",
        "robust",
        "splits",
        "packets",
        "instances",
        "commits",
        "coherent",
        "motion",
        "traversable",
        "filters",
        "context-filter",
        "masks",
    ] {
        let run = Run::of_host(&host, &[], what);
        assert!(run.output.stdout == unrecorded_host(&host, what), "{what}");
        let Judged { queries, unchecked, moving } = run.replayed();
        assert!(queries > 5000 && unchecked == 0, "{what}");
        assert_eq!(moving > 0, what == "motion", "{what}");
        let seen = run.seen();
        assert!(seen.len() == 1 && seen[&0] == lines(&run.output.stdout), "{what}");
        has_tree_of_ours(&run);

        let file = run.rays();
        let rays = Rays::parse(&file).unwrap();
        assert_eq!(rays.header.embree_version, VERSION);
        let rejects: u32 = rays.chunks().iter().map(|chunk| chunk.rejects).sum();
        assert_eq!(rejects > 500, what.contains("filter"), "{what}: {rejects} rejects");
        let coherent = rays.chunk(0).unwrap().records[0].flags & record_flag::COHERENT != 0;
        assert_eq!(coherent, what == "coherent", "{what}");
        // Embree 4 gives a geometry one bit, where Embree 3 gives it all.
        let trees = run.trees();
        assert!(
            Bvh::parse(&trees[0]).unwrap().geometries.iter().any(|geometry| geometry.mask == 1),
            "{what}"
        );
    }
}

/// A Python program loads its Embree privately, by a name of its own.
#[test]
fn embreex_is_recorded() {
    let Some(package) = package() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/preload_support/embreex_sphere.py");
    let python = Path::new("/usr/bin/env");
    let path = format!("PYTHONPATH={}", package.display());
    let arguments = [&path, "/usr/bin/python3", script.to_str().unwrap()];
    let run = Run::new(&[], python, &arguments);
    assert!(run.output.status.success(), "python3-numpy, see tools/setup: {}", run.said());
    let plain = Command::new(python).args(arguments).output().unwrap();
    assert!(plain.status.success() && plain.stdout == run.output.stdout);

    assert_eq!(run.replayed(), Judged { queries: 8000, ..Judged::default() });
    has_tree_of_ours(&run);
    // Closest hits as the program prints them: t, geometry, primitive.
    let printed = lines(&run.output.stdout);
    let seen = &run.seen()[&0];
    let mut hits = 0;
    for (printed, seen) in printed.iter().zip(seen).take(4000) {
        let recorded = seen.strip_suffix(" -1").unwrap();
        if recorded.ends_with("-1") {
            assert!(printed.ends_with("-1"), "{printed} {seen}");
        } else {
            assert_eq!(printed, recorded);
            hits += 1;
        }
    }
    assert!((3000..4000).contains(&hits), "{hits}");
}

/// Where Debian's Open3D has loaded Embree 3 beside it, what embreex asks still goes to Embree 4.
#[test]
fn a_program_that_has_loaded_both_versions() {
    let Some(package) = package() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/preload_support/embreex_sphere.py");
    let path = format!("PYTHONPATH={}", package.display());
    let both = "import open3d, runpy, sys; runpy.run_path(sys.argv[1])";
    let arguments = [&path, "/usr/bin/python3", "-c", both, script.to_str().unwrap()];
    let env = Path::new("/usr/bin/env");
    let run = Run::new(&[], env, &arguments);
    assert!(run.output.status.success(), "python3-open3d, see tools/setup: {}", run.said());
    let plain = Command::new(env).args(arguments).output().unwrap();
    assert!(plain.status.success() && plain.stdout == run.output.stdout);
    assert_eq!(run.replayed().queries, 8000);
    assert!(run.said().contains("has loaded Embree 3 and Embree 4"), "{}", run.said());
}
