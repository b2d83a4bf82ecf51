//! Trees made wider and binary again: the same answers, as the command writes them and as traversals follow them.

mod compare_support;

use compare_support::*;
use embree_trace::builder::{self, Config, MAX_DEPTH};
use embree_trace::format::bvh::{self, Bvh, Contents};
use embree_trace::geometry::Triangle;
use embree_trace::progress::Progress;
use embree_trace::traverse::*;
use embree_trace::tree::binary::binary;
use embree_trace::tree::statistics::Statistics;
use embree_trace::tree::validate::validate;
use embree_trace::tree::{Tree, collapse};
use std::path::Path;
use std::process::{Command, Output};

fn built(triangles: &[Triangle]) -> Tree {
    builder::build(triangles, &Config::default(), &Progress::hidden()).expect("a valid configuration")
}

#[test]
fn answers_do_not_depend_on_the_width() {
    let scratch = &mut Scratch::default();
    for (scene, triangles) in scenes() {
        let mut rays = rays(&triangles, 300, &mut Random(21));
        rays.extend(hostile_rays(&mut Random(22)));
        let tree = built(&triangles);
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
        let reference = Prepared::new(tree.view(), &triangles, &[]);
        for width in [2, 3, 4, 5, 8] {
            let config = collapse::Config::vector(width);
            let wide = collapse::collapse(tree.view(), area, &config).expect("a binary tree");
            let again = binary(wide.view(), &triangles);
            for other in [wide, again] {
                let prepared = Prepared::new(other.view(), &triangles, &[]);
                for ray in rays.iter().map(PreparedRay::new) {
                    let expected = reference.closest_hit(Traversal::Odf, &ray, &All, &mut (), scratch);
                    for traversal in Traversal::ALL {
                        let hit = prepared.closest_hit(traversal, &ray, &All, &mut (), scratch);
                        assert_eq!(hit, expected, "{scene}, width {width}, {traversal:?}: {ray:?}");
                        let occluder = prepared.occluder(traversal, &ray, &All, &mut (), scratch);
                        assert_eq!(occluder.is_some(), expected.is_some(), "{scene} {traversal:?} {ray:?}");
                    }
                }
            }
        }
    }
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bvh-build")).args(arguments).output().expect("bvh-build runs")
}

fn read(path: &Path, triangles: &[Triangle]) -> Statistics {
    let bytes = std::fs::read(path).expect("written");
    let written = Bvh::parse(&bytes).expect("a valid file");
    written.verify().expect("a valid tree");
    let tree = Tree { nodes: written.tree.nodes.to_vec(), primitives: written.tree.primitives.to_vec() };
    assert_eq!(validate(&tree, triangles, MAX_DEPTH), Ok(()));
    Statistics::of(tree.view())
}

#[test]
fn the_command_collapses_and_makes_binary() {
    let triangles = soup(3_000, 0.2, &mut Random(23));
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = |name: &str| directory.path().join(name);
    let text = |name: &str| path(name).to_str().expect("UTF-8").to_owned();
    let tree = built(&triangles);
    let contents = Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: &[],
        order: None,
        meta: None,
        flags: 0,
        producer: "test",
    };
    let mut bytes = Vec::new();
    bvh::write(&mut bytes, &contents).expect("written to memory");
    std::fs::write(path("in.bvh"), bytes).expect("written");

    for (width, max_leaf) in [("4", "1"), ("8", "8")] {
        let recipe = ["--splits", "binned", "--width", width, "--max-leaf", max_leaf];
        let output = run(&[&[text("in.bvh").as_str(), &text("wide.bvh")], &recipe[..]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let statistics = read(&path("wide.bvh"), &triangles);
        assert_eq!(statistics.max_children.to_string(), width);
        assert!(statistics.max_leaf <= max_leaf.parse().expect("a number"));
    }
    let output = run(&[&text("wide.bvh"), &text("binary.bvh"), "--binary"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let statistics = read(&path("binary.bvh"), &triangles);
    assert_eq!((statistics.max_children, statistics.max_leaf, statistics.leaves), (2, 1, 3_000));

    for wrong in [
        &["--width", "1"][..],
        &["--width", "9"],
        &["--width", "4", "--binary"],
        &["--width", "4", "--max-leaf", "65"],
    ] {
        let output = run(&[&[text("in.bvh").as_str(), &text("none.bvh")], wrong].concat());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{wrong:?}: {stderr}");
        assert!(!stderr.contains("panicked"), "{stderr}");
        assert!(!path("none.bvh").exists());
    }
}
