//! What Embree answered, replayed: every recording that `embree-trace` makes is confirmed over Embree's own tree and over
//! others, by every traversal.
#![cfg(feature = "embree")]

mod compare_judge;
mod compare_support;

use compare_support::*;
use embree_trace::builder::{self, Config};
use embree_trace::compare::kernels::Wanted;
use embree_trace::compare::{Candidate, Recording, Settings, check_scenes, compare};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::{self, Bvh, Contents};
use embree_trace::format::rays::Rays;
use embree_trace::mesh::{Mesh, generate, obj};
use embree_trace::progress::Progress;
use embree_trace::ranks::Alone;
use embree_trace::replay::query::Choice;
use embree_trace::replay::select::Filter;
use embree_trace::replay::tally::Costs;
use embree_trace::traverse::Traversal;
use embree_trace::tree::TreeView;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Records `mesh` with `options`, and replays it over Embree's tree, ours, and random ones of other widths.
fn confirm(name: &str, mesh: &Mesh, options: &[&str], borderline: u64) {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = |file: &str| directory.path().join(file);
    let (mut text, mut library) = (Vec::new(), Vec::new());
    obj::write(mesh, "scene.mtl", &mut text, &mut library, &Progress::hidden()).expect("writing to memory");
    std::fs::write(path("scene.obj"), text).expect("writing a scene");
    std::fs::write(path("scene.mtl"), library).expect("writing its materials");
    let output = Command::new(env!("CARGO_BIN_EXE_embree-trace"))
        .arg(path("scene.obj"))
        .arg("--savetrace")
        .args([path("casts.rays"), path("built.bvh")])
        .args(["--size", "64x48", "--spp", "2"])
        .args(options)
        .output()
        .expect("running embree-trace");
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));

    let open = |file: &Path| MappedFile::open(file).expect("a file that was just written");
    let (built, casts) = (open(&path("built.bvh")), open(&path("casts.rays")));
    let built = Bvh::parse(&built).expect("Embree's tree");
    let rays = Rays::parse(&casts).expect("a recording");
    assert!(rays.query_count() > 3000, "{name}");
    let with_tree = |tree: TreeView| {
        let mut bytes = Vec::new();
        let contents = Contents {
            tree,
            triangles: built.triangles,
            geometries: built.geometries,
            order: None,
            meta: None,
            flags: 0,
            producer: "a test",
        };
        bvh::write(&mut bytes, &contents).expect("writing to memory");
        bytes
    };
    let ours = builder::build(built.triangles, &Config::default(), &Progress::hidden()).expect("a tree");
    let others = [
        with_tree(ours.view()),
        with_tree(random_tree(built.triangles, 4, 3, &mut Random(1)).view()),
        with_tree(random_tree(built.triangles, 7, 2, &mut Random(2)).view()),
    ];
    let others: Vec<Bvh> =
        others.iter().map(|bytes| Bvh::parse(bytes).expect("a tree just written")).collect();
    let candidates: Vec<Candidate> = std::iter::once(&built)
        .chain(&others)
        .enumerate()
        .map(|(number, bvh)| Candidate { path: format!("{name} {number}"), bvh })
        .collect();
    let warning = check_scenes(&candidates, name, &rays, None).expect("one scene");
    assert_eq!(warning, (0, None));
    let settings = Settings {
        traversals: Traversal::ALL.to_vec(),
        costs: Costs { c_i: 1.0, c_p: 1.0 },
        machine: Default::default(),
        baseline: None,
        allowed: Default::default(),
        choice: Choice { scene: 0, filter: Filter::default(), held_out: None, sample: None },
        occlusion_order: None,
        pixels: false,
        sort: None,
        packet: None,
        profile: false,
        kernels: Some(Wanted::default()),
        answers: false,
        rounds: Some(1),
        // Too short for anything.
        budget: Some(Duration::ZERO),
        fit: false,
    };
    let recording = Recording { path: name.to_owned(), rays: &rays, scene: 0, image: None };
    let comparison =
        compare(&candidates, &[recording], settings, &Alone, &Progress::hidden()).expect("whole files");
    assert_eq!(comparison.failures(), Vec::<String>::new());
    let why = comparison.left_out.as_deref().expect("a line");
    assert!(why.starts_with("No times: ") && why.contains("--time") && !why.contains('\n'), "{why}");
    assert!(comparison.kernels.is_none() && comparison.recordings[0].timing.is_none());
    for (_, tree, result) in comparison.results() {
        for run in &result.runs {
            let total = &run.outcome.tallies.total;
            assert_eq!(total.queries, rays.query_count());
            assert!(total.borderline <= borderline, "{}: {} borderline", tree.path, total.borderline);
        }
    }
}

#[test]
fn embrees_answers_are_confirmed_on_every_scene_of_our_own() {
    confirm("cornell box", &generate::cornell_box(), &["--isa", "sse42"], 1);
    confirm("courtyard", &generate::courtyard(6, 1), &[], 1);
    confirm("quads", &generate::quads(16), &["--integrator", "ao"], 1);
}

#[test]
fn slivers_and_copies_are_confirmed_too() {
    // Needles thinner than rounding: many rays graze, and none is wrong.
    confirm("slivers", &generate::slivers(300, 1), &["--isa", "sse42"], 10);
    confirm("coincident", &generate::coincident(), &[], 1);
}

#[test]
fn other_trees_of_embree_are_confirmed() {
    let mesh = generate::courtyard(6, 2);
    confirm("high", &mesh, &["--quality", "high"], 1);
    confirm("robust", &mesh, &["--flags", "robust"], 2);
    confirm("compact", &mesh, &["--flags", "compact"], 1);
    confirm("builder", &mesh, &["--bvh", "builder", "--integrator", "shadow"], 1);
}
