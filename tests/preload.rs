//! `embree-trace record`: programs that know nothing of it, ours in every way that Embree can be asked, and Debian's. What they
//! print or draw is the same with and without; what is recorded is what they saw, and replays without a mismatch.
#![cfg(feature = "embree")]

mod preload_support;

use embree_trace::files::MappedFile;
use embree_trace::format::bvh::{self, Bvh};
use embree_trace::format::rays::{Purpose, Rays, Record, flag};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::tree::Tree;
use preload_support::{Judged, Run, compiled_host, lines, unrecorded_host};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

/// The program of `preload_support/host.cpp`, compiled once.
fn host() -> &'static Path {
    static HOST: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    &HOST.get_or_init(|| compiled_host(&["-lembree3"])).1
}

fn run_host(options: &[&str], what: &str) -> Run {
    Run::of_host(host(), options, what)
}

fn unrecorded(what: &str) -> Vec<u8> {
    unrecorded_host(host(), what)
}

/// The program sees what it saw before, and that is recorded, in every form of a query and over every kind of tree.
#[test]
fn what_a_program_sees_is_recorded() {
    for what in
        ["plain", "robust", "splits", "packets", "streams", "coherent", "instances", "commits", "motion"]
    {
        let run = run_host(&[], what);
        assert!(run.output.stdout == unrecorded(what), "{what}");
        let Judged { queries, unchecked, moving } = run.replayed();
        assert!(queries > 5000 && unchecked == 0, "{what}");
        assert_eq!(moving > 0, what.starts_with("motion"), "{what}");
        let seen = run.seen();
        assert_eq!(seen.len(), 1, "{what}");
        // A thread's chunks are by scene, so several scenes are not in the order of time; here each comes after the last.
        assert!(seen[&0] == lines(&run.output.stdout), "{what}");
    }
}

/// Candidates that filters reject are recorded with their queries: without them the replay would hit them.
#[test]
fn rejects_of_filters() {
    for what in ["filters", "context-filter", "stream-filters", "coherent-filters"] {
        let run = run_host(&[], what);
        assert!(run.output.stdout == unrecorded(what), "{what}");
        assert_eq!(run.replayed().unchecked, 0, "{what}");
        assert!(run.seen()[&0] == lines(&run.output.stdout), "{what}");
        let file = run.rays();
        let rays = Rays::parse(&file).unwrap();
        let rejects: u32 = rays.chunks().iter().map(|chunk| chunk.rejects).sum();
        assert!(rejects > 1000, "{what}: {rejects} rejects");
        assert!(!run.said().contains("warning"), "{what}: {}", run.said());
    }
}

/// The lines of queries for closest hits, with t, primitive and geometry, of those that found
/// something; in the order of the thread.
fn closest_hits(run: &Run) -> Vec<(Record, String)> {
    let file = run.rays();
    let rays = Rays::parse(&file).unwrap();
    let records = (0..rays.chunks().len()).flat_map(|chunk| rays.chunk(chunk).unwrap().records.into_owned());
    let printed = lines(&run.output.stdout);
    assert_eq!(rays.query_count(), printed.len() as u64);
    let all = records.zip(printed);
    all.filter(|(record, line)| !record.is_occlusion() && !line.ends_with(" -1 -1 -1")).collect()
}

/// t and the numbers behind it, as a line of the program's has them.
fn parsed(line: &str) -> (f32, [i64; 3]) {
    let words: Vec<&str> = line.split(' ').collect();
    let number = |word: usize| words[word].parse().unwrap();
    (f32::from_bits(u32::from_str_radix(words[0], 16).unwrap()), [number(1), number(2), number(3)])
}

/// A filter may end a ray where it likes. The hit is recorded where it was, and flagged, and one
/// warning says how many there are.
#[test]
fn filters_that_end_rays() {
    let run = run_host(&[], "ended");
    assert!(run.output.stdout == unrecorded("ended"));
    let judged = run.replayed();
    let trees = run.trees();
    let tree = Bvh::parse(&trees[0]).unwrap();
    let mut ends = [0; 4];
    let mut interrupted = 0;
    for (record, line) in closest_hits(&run) {
        let (seen, [geometry, primitive, _]) = parsed(&line);
        let own = tree.geometries.iter().find(|g| i64::from(g.geometry) == geometry).unwrap();
        assert_eq!(i64::from((record.triangle - own.first_triangle) / (own.kind + 1)), primitive);
        // Where it is, and not where the program was told.
        let t = distance(&record, &tree.triangles[record.triangle as usize]);
        assert!((t - f64::from(record.t)).abs() < 1e-4, "{t} {record:?}");
        let end = (primitive % 4) as usize;
        let expected = [
            f32::NEG_INFINITY,
            0.5 * record.t,
            if geometry == 5 { f32::NAN } else { 0.25 * record.t },
            record.t,
        ][end];
        assert!(seen == expected || seen.is_nan() && expected.is_nan(), "{seen} {record:?}");
        let flagged = record.flags & flag::INTERRUPTED != 0;
        assert!(flagged || end == 3, "{record:?}");
        interrupted += u64::from(flagged);
        ends[end] += 1;
    }
    assert!(ends.iter().all(|&count| count > 300), "{ends:?}");
    assert_eq!(judged.unchecked, interrupted);
    let warning = format!("{interrupted} closest-hit queries were ended elsewhere");
    assert_eq!(
        (run.said().matches("warning").count(), run.said().matches(&warning).count()),
        (1, 1),
        "{}",
        run.said()
    );
}

/// A filter may make another hit of what it accepts. What Embree found is recorded, and nothing of
/// it is in doubt; another filter rejects it, or not.
#[test]
fn filters_that_change_hits() {
    let run = run_host(&[], "changed");
    assert!(run.output.stdout == unrecorded("changed"));
    assert_eq!(run.replayed().unchecked, 0);
    assert!(!run.said().contains("warning"), "{}", run.said());
    let trees = run.trees();
    let tree = Bvh::parse(&trees[0]).unwrap();
    let hits = closest_hits(&run);
    assert!(hits.len() > 1000);
    for (record, line) in hits {
        let (seen, [geometry, primitive, _]) = parsed(&line);
        let own = tree.geometries.iter().find(|g| i64::from(g.geometry) == geometry).unwrap();
        let recorded = i64::from((record.triangle - own.first_triangle) / (own.kind + 1));
        assert_eq!((seen, primitive), (record.t, recorded + 1_000_000));
        assert!(primitive % 3 != 0 && record.flags & flag::INTERRUPTED == 0);
    }
}

/// What is no triangle may be hit at infinity, or end a ray without a distance.
#[test]
fn geometries_of_the_program_that_end_rays() {
    let run = run_host(&[], "sky");
    assert!(run.output.stdout == unrecorded("sky"));
    run.replayed();
    let mut ends = [0, 0];
    for (record, line) in closest_hits(&run) {
        let (seen, [geometry, ..]) = parsed(&line);
        if geometry != 9 {
            assert_eq!(record.t, seen);
            continue;
        }
        let (end, t) = if seen > 0.0 { (0, f32::MAX) } else { (1, record.tnear) };
        assert_eq!(record.t, t);
        assert_eq!(record.flags & !flag::COHERENT, flag::HIT | flag::UNDECIDED | flag::INTERRUPTED);
        ends[end] += 1;
    }
    assert!(ends.iter().all(|&count| count > 300), "{ends:?}");
    assert!(
        run.said().contains(&format!("{} closest-hit queries were ended", ends[0] + ends[1])),
        "{}",
        run.said()
    );
}

/// A query sees what shares a bit with the mask of the instance and one with that of the geometry,
/// each; masks of 0 and other masks at the next commit included.
#[test]
fn masks_of_instances_and_their_geometries() {
    let run = run_host(&[], "masks");
    assert!(run.output.stdout == unrecorded("masks"));
    assert_eq!(run.replayed().unchecked, 0);
    assert!(run.seen()[&0] == lines(&run.output.stdout) && !run.said().contains("warning"), "{}", run.said());
    let (file, trees) = (run.rays(), run.trees());
    assert_eq!(trees.len(), 2);
    let masks = [[2, 5, 0, 0xC], [9, 5, 0, 0xC]];
    for (commit, tree) in trees.iter().map(|tree| Bvh::parse(tree).unwrap()).enumerate() {
        for geometry in tree.geometries.iter().filter(|geometry| geometry.instance >= 20) {
            let Some(instance) = geometry.instance.checked_sub(20).filter(|&mask| mask < 16) else {
                continue;
            };
            let own = masks[commit][geometry.geometry as usize];
            for query in 0..16 {
                let seen = geometry.masks().iter().all(|mask| query & mask != 0);
                assert_eq!(seen, query & own != 0 && query & instance != 0);
            }
        }
    }
    // Hits that no one mask would have allowed: the bits that both have are not the query's.
    let rays = Rays::parse(&file).unwrap();
    let mut both = 0;
    for chunk in (0..rays.chunks().len()).map(|chunk| rays.chunk(chunk).unwrap()) {
        let tree = Bvh::parse(&trees[chunk.info.scene as usize]).unwrap();
        for record in chunk.records.iter().filter(|record| record.is_hit() && !record.is_occlusion()) {
            let of = |g: &&bvh::Geometry| {
                (g.first_triangle..g.first_triangle + g.triangle_count).contains(&record.triangle)
            };
            let [own, instance] = tree.geometries.iter().find(of).unwrap().masks();
            assert!(record.mask & own != 0 && record.mask & instance != 0);
            both += u64::from(record.mask & own & instance == 0);
        }
    }
    assert!(both > 50, "{both}");
}

/// Masks, disabled geometries, instances and commits are in the trees.
#[test]
fn scenes_are_as_committed() {
    let run = run_host(&["--format", "json"], "instances");
    let trees = run.trees();
    let tree = Bvh::parse(&trees[0]).unwrap();
    let of = |instance: i32| -> Vec<(u32, u32, u32)> {
        let geometries = tree.geometries.iter().filter(|geometry| geometry.instance as i32 == instance);
        geometries.map(|geometry| (geometry.geometry, geometry.triangle_count, geometry.mask)).collect()
    };
    assert_eq!(of(-1), [(3, 2 * 13 * 13, u32::MAX), (5, 2 * 7 * 7, 0xA)]);
    for instance in [6, 7, 8] {
        assert_eq!(of(instance), [(0, 2 * 7 * 7, u32::MAX), (2, 2 * 6 * 6, u32::MAX)]);
    }
    assert!(tree.header.flags & bvh::flag::FLATTENED != 0 && tree.header.flags & bvh::flag::LIVE != 0);
    let report: serde_json::Value = serde_json::from_str(&run.said()).unwrap();
    assert_eq!((&report["records"], &report["scenes"][0]["instances"]), (&8000.into(), &3.into()));

    let run = run_host(&["--format", "json"], "commits");
    let report: serde_json::Value = serde_json::from_str(&run.said()).unwrap();
    let scenes = report["scenes"].as_array().unwrap();
    let scene = |number: usize| {
        let scene = &scenes[number];
        [&scene["scene"], &scene["commit"], &scene["queries"], &scene["triangles"]]
            .map(|v| v.as_u64().unwrap())
    };
    // Commits without a change are none.
    assert_eq!(scenes.len(), 4);
    assert_eq!([scene(0), scene(1)], [[1, 0, 2000, 436], [1, 1, 2000, 486]]);
    assert_eq!([scene(2), scene(3)], [[1, 2, 2000, 388], [2, 0, 1000, 72]]);
}

/// What moves is recorded as it is when the shutter opens: asked at that time, Embree finds what brute force finds among the
/// recorded triangles; asked later, it does not.
#[test]
fn motion_at_its_first_step() {
    // Queries that found something that moves, and those of them that brute force agrees with; the same for what does not move.
    let agreeing = |what: &str| {
        let run = run_host(&["--format", "json"], what);
        let report: serde_json::Value = serde_json::from_str(&run.said()).unwrap();
        assert_eq!(
            report["scenes"][0]["moving"], 5,
            "triangles, two of an instance, those that move in another"
        );
        assert_eq!(report["warnings"].as_array().unwrap().len(), 0);
        let (file, trees) = (run.rays(), run.trees());
        let (rays, tree) = (Rays::parse(&file).unwrap(), Bvh::parse(&trees[0]).unwrap());
        // Embree's tree beside ours.
        assert!(tree.header.producer.starts_with("binned + embree"), "{}", tree.header.producer);
        let moving: Vec<u32> = tree
            .geometries
            .iter()
            .filter(|g| g.flags & bvh::geometry_flag::MOVING != 0)
            .flat_map(|g| g.first_triangle..g.first_triangle + g.triangle_count)
            .collect();
        let (mut moved, mut still) = ([0, 0], [0, 0]);
        for chunk in 0..rays.chunks().len() {
            let chunk = rays.chunk(chunk).unwrap();
            for record in chunk.records.iter().filter(|r| r.is_hit() && !r.is_occlusion()) {
                let moves = moving.contains(&record.triangle);
                assert_eq!(record.flags & flag::UNDECIDED != 0, moves);
                let counts = if moves { &mut moved } else { &mut still };
                let t = distance(record, &tree.triangles[record.triangle as usize]);
                counts[0] += 1;
                counts[1] += u64::from((t - f64::from(record.t)).abs() < 1e-4);
            }
        }
        (moved, still)
    };
    let (moved, still) = agreeing("motion-open");
    assert!(moved[0] > 300 && still[0] > 300, "{moved:?} {still:?}");
    assert_eq!((moved[0], still[0]), (moved[1], still[1]));
    let (moved, still) = agreeing("motion");
    assert_eq!(still[0], still[1]);
    assert!(moved[0] > 300 && moved[1] < moved[0] / 10, "{moved:?}");
}

/// Threads that come and go, more than there are slots, and a fork that ends without destructors.
#[test]
fn threads_and_forks() {
    let run = run_host(&[], "threads");
    assert_eq!(run.replayed().queries, 8 * 40 * 4000);
    let first = run_host(&[], "plain").seen()[&0].iter().step_by(2).cloned().collect::<Vec<_>>();
    let seen = run.seen();
    assert_eq!(seen.len(), 320);
    assert!(seen.values().all(|lines| *lines == first));

    let run = Run::new(&[], host(), &["fork"]);
    assert_eq!(run.output.status.code(), Some(7), "the program's own exit code");
    assert_eq!(run.replayed().queries, 3 * 8000);
    assert_eq!(run.seen().values().map(Vec::len).collect::<Vec<_>>(), [16_000, 8000]);
}

/// Processes that come and go, more than there are slots, or as many at once: killed, ended by
/// another signal, and without destructors. What each has asked is there.
#[test]
fn processes() {
    let first = &run_host(&[], "plain").seen()[&0][..40];
    let recorded = |run: &Run| {
        let file = run.rays();
        let rays = Rays::parse(&file).unwrap();
        rays.verify().unwrap();
        rays.query_count()
    };
    for (count, how) in [("300", "in turn"), ("256", "together")] {
        let run = Run::new(&[], host(), &["children", count, how]);
        assert!(run.output.status.success() && !run.said().contains("warning"), "{}", run.said());
        let asked = 40 * count.parse::<u64>().unwrap();
        assert_eq!(recorded(&run), asked, "{how}");
        let seen = run.seen();
        assert!(seen.len() as u64 * 40 == asked && seen.values().all(|lines| lines == first), "{how}");
    }
    // More living ones than there are slots: what is lost is counted, and the warning is true.
    let run = Run::new(&[], host(), &["children", "270", "together"]);
    assert!(run.said().contains("560 queries are not recorded: more living threads"), "{}", run.said());
    assert_eq!(recorded(&run), 40 * 256);
}

/// Threads that each make, commit and change scenes while they and others ask: every query is there. `tools/sanitizers` looks for races in it.
#[test]
fn threads_with_scenes_of_their_own() {
    let run = run_host(&[], "busy");
    assert!(run.output.stdout == unrecorded("busy") && !run.said().contains("warning"), "{}", run.said());
    let file = run.rays();
    let rays = Rays::parse(&file).unwrap();
    rays.validate_all().unwrap();
    assert_eq!(rays.query_count(), 8 * 6 * 4 * 500);
    // In each round one scene that all commit together and two commits of each thread's; and the one that is there from the start.
    assert_eq!(run.trees().len(), 6 * (1 + 2 * 8) + 1);
    let threads: std::collections::BTreeSet<u32> =
        rays.chunks().iter().map(|chunk| chunk.info.thread).collect();
    assert_eq!(threads.len(), 8 * 6);
}

/// A killed program has lost nothing that it had seen.
#[test]
fn a_killed_program() {
    let run = Run::new(&[], host(), &["kill"]);
    assert_eq!(run.output.status.code(), Some(128 + 9));
    assert!(run.said().contains("signal 9"), "{}", run.said());
    assert_eq!(run.replayed().queries, 8000);
    assert!(run.seen()[&0] == lines(&run.output.stdout));
    // Nothing is left beside the recording.
    assert_eq!(std::fs::read_dir(run.directory.path()).unwrap().count(), 2);
}

/// A signal to the recorder alone ends the recording, whose files are complete, and nothing else: the program runs on.
#[test]
fn a_recording_that_is_ended() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    let said = std::fs::File::create(path("said")).unwrap();
    // It asks, waits until it may go on, and says that it has.
    let program = r#""$0" plain > seen; touch asked; while [ ! -e go ]; do sleep 0.02; done; touch finished"#;
    let mut recorder = Command::new(env!("CARGO_BIN_EXE_embree-trace"))
        .args(["record", "--savetrace", "casts.rays", "built.bvh", "--", "sh", "-c", program])
        .arg(host())
        .current_dir(directory.path())
        .stderr(said)
        .spawn()
        .unwrap();
    let wait_for = |name: &str| {
        for _ in 0..3000 {
            if path(name).exists() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        panic!("{name} did not come");
    };
    wait_for("asked");
    // SAFETY: sends a signal to a child that has not been waited for.
    unsafe { libc::kill(recorder.id() as i32, libc::SIGTERM) };
    let status = recorder.wait().unwrap();
    let names: Vec<String> = std::fs::read_dir(directory.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.contains("casts") || name.contains("built"))
        .collect();
    std::fs::write(path("go"), "").unwrap();
    wait_for("finished");
    let stderr = std::fs::read(path("said")).unwrap();
    let seen = std::fs::read(path("seen")).unwrap();
    let run = Run { directory, output: std::process::Output { status, stdout: seen, stderr } };
    assert_eq!(run.output.status.code(), Some(128 + 15), "{}", run.said());
    assert!(run.said().contains("the recording was ended by signal 15"), "{}", run.said());
    assert_eq!(names.len(), 2, "{names:?}");
    assert_eq!(run.replayed().queries, 8000);
    assert!(run.seen()[&0] == lines(&run.output.stdout));
}

/// Parts of a recording are those of the whole.
#[test]
fn parts_can_be_chosen() {
    let whole = &run_host(&[], "plain").seen()[&0];
    let part = |options: &[&str]| {
        let run = run_host(options, "plain");
        run.replayed();
        run.seen().remove(&0).unwrap_or_default()
    };
    assert!(part(&["--skip", "100", "--limit", "50"]) == whole[100..150]);
    let every: Vec<String> = whole.iter().step_by(10).cloned().collect();
    assert!(part(&["--every", "10", "--purposes", "none"]) == every);
    let occlusions: Vec<String> = whole.iter().skip(1).step_by(2).cloned().collect();
    assert!(part(&["--filter", "kind=occlusion", "--compress"]) == occlusions);
}

/// What embree-trace was not given, or a program that asks nothing: one line.
#[test]
fn bad_input() {
    let bad = |program: &str, arguments: &[&str], expected: &str| {
        let run = Run::new(&[], Path::new(program), arguments);
        assert_eq!(run.output.status.code(), Some(2), "{program}: {}", run.said());
        assert!(run.said().lines().last().unwrap().contains(expected), "{program}: {}", run.said());
    };
    bad("./does-not-exist", &[], "cannot run ./does-not-exist");
    bad("true", &[], "has not called a shared libembree3 or libembree4");
    let failing = Run::new(&[], Path::new("false"), &[]);
    assert_eq!(failing.output.status.code(), Some(1));
    let same = Command::new(env!("CARGO_BIN_EXE_embree-trace"))
        .args(["record", "--savetrace", "a", "a", "--", "true"])
        .output()
        .unwrap();
    assert_eq!(same.status.code(), Some(2));
}

/// Scenes too large once flattened have no tree, and that is said; their queries stay.
#[test]
fn too_many_triangles() {
    let run = run_host(&["--max-triangles", "900"], "instances");
    assert!(run.said().contains("946 triangles once its 3 instances are flattened"), "{}", run.said());
    assert!(run.trees().is_empty());
    let file = run.rays();
    assert_eq!(Rays::parse(&file).unwrap().query_count(), 8000);
}

/// Our own renderer is such a program, too, and records by itself: both recordings are the same, but for what only it knows.
#[test]
fn our_own_renderer() {
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("scene.obj");
    let made = Command::new(env!("CARGO_BIN_EXE_make-scene"))
        .args(["courtyard".as_ref(), scene.as_os_str()])
        .args(["--detail", "1"])
        .output();
    assert!(made.unwrap().status.success());
    let arguments = [
        "--size",
        "32x24",
        "--threads",
        "1",
        "--packet",
        "8",
        "--quality",
        "high",
        "--savetrace",
        "own.rays",
        "own.bvh",
    ];
    let run = Run::new(
        &[],
        env!("CARGO_BIN_EXE_embree-trace").as_ref(),
        &[&[scene.to_str().unwrap()], &arguments[..]].concat(),
    );
    assert!(run.output.status.success(), "{}", run.said());
    run.replayed();
    let own = MappedFile::open(&run.path("own.bvh")).unwrap();
    let trees = run.trees();
    let (own, ours) = (Bvh::parse(&own).unwrap(), Bvh::parse(&trees[0]).unwrap());
    assert!((own.tree.nodes, own.tree.primitives) == (ours.tree.nodes, ours.tree.primitives));
    assert!((own.geometries, own.header.fingerprint) == (ours.geometries, ours.header.fingerprint));
    assert_eq!((own.header.flags, &own.header.producer), (ours.header.flags, &ours.header.producer));

    let records = |path: &str| -> Vec<Record> {
        let file = MappedFile::open(&run.path(path)).unwrap();
        let rays = Rays::parse(&file).unwrap();
        (0..rays.chunks().len()).flat_map(|chunk| rays.chunk(chunk).unwrap().records.into_owned()).collect()
    };
    let (own, ours) = (records("own.rays"), records("casts.rays"));
    // Before it renders, it looks for a view, which it does not record.
    let ours = &ours[ours.len() - own.len()..];
    for (own, ours) in own.iter().zip(ours) {
        let (path, depth, purpose, flags) = (own.path, own.depth, own.purpose, own.flags);
        // Its coherent flag is a packet's, not a query's.
        assert_eq!(flags & !flag::COHERENT, ours.flags & !flag::COHERENT);
        assert_eq!(*own, Record { path, depth, purpose, flags, ..*ours });
    }
}

/// Programs of Debian's `embree-tools`: the picture is the same, the replay agrees. What is no triangle is flagged.
#[test]
fn tutorials_of_embree() {
    // Whether it rejects candidates, and whether it has other geometries.
    let programs = [
        ("triangle_geometry", false, false),
        ("instanced_geometry", false, false),
        ("intersection_filter", true, false),
        ("interpolation", false, true),
        ("curve_geometry", false, true),
        ("motion_blur_geometry", false, true),
        ("user_geometry", false, true),
    ];
    for (program, rejects, others) in programs {
        let picture =
            |name: &str| vec!["--size".to_owned(), "64".into(), "64".into(), "-o".into(), name.to_owned()];
        let arguments = picture("recorded.ppm");
        let run =
            Run::new(&[], Path::new(program), &arguments.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(
            run.output.status.success(),
            "{program} (package embree-tools, see tools/setup): {}",
            run.said()
        );
        let plain = Command::new(program)
            .args(picture("plain.ppm"))
            .current_dir(run.directory.path())
            .output()
            .unwrap();
        assert!(plain.status.success(), "{program}");
        let bytes = |name: &str| std::fs::read(run.path(name)).unwrap();
        assert!(bytes("recorded.ppm") == bytes("plain.ppm"), "{program}: another picture");

        let Judged { queries, unchecked, moving } = run.replayed();
        assert_eq!(moving > 0, program == "motion_blur_geometry", "{program}");
        assert!(queries >= 64 * 64, "{program}: {queries}");
        assert_eq!(unchecked + moving > 0, others, "{program}");
        assert_eq!(run.said().contains("left out of the tree"), others, "{program}: {}", run.said());
        let (mut cameras, mut rejected) = (0, 0);
        let file = run.rays();
        let rays = Rays::parse(&file).unwrap();
        for chunk in 0..rays.chunks().len() {
            let chunk = rays.chunk(chunk).unwrap();
            cameras += chunk.records.iter().filter(|r| r.purpose == Purpose::Camera as u8).count();
            rejected += chunk.records.iter().filter(|r| r.flags & flag::HAS_REJECTS != 0).count();
        }
        // Callbacks of user geometries ask, too, from other origins.
        assert!(cameras >= 64 * 64, "{program}: {cameras}");
        assert_eq!(rejected > 0, rejects, "{program}");
    }
}

/// Debian's Open3D loads Embree privately (RTLD_LOCAL), and asks with a mask that sees nothing: its caster misses everything.
/// The recording shows why (docs/recording.md).
#[test]
fn the_mask_of_open3d() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/preload_support/open3d_sphere.py");
    let run = Run::new(&[], Path::new("/usr/bin/python3"), &[script.to_str().unwrap()]);
    assert!(run.output.status.success(), "python3-open3d and python3-numpy, see tools/setup: {}", run.said());
    assert_eq!(String::from_utf8_lossy(&run.output.stdout), "0 of 4096 rays hit\n");
    assert_eq!(run.replayed(), Judged { queries: 4096, ..Judged::default() });

    let (file, trees) = (run.rays(), run.trees());
    let rays = Rays::parse(&file).unwrap();
    let tree = Bvh::parse(&trees[0]).unwrap();
    let mut hits = 0;
    for chunk in 0..rays.chunks().len() {
        for record in rays.chunk(chunk).unwrap().records.iter() {
            assert_eq!(record.mask, 0);
            hits += u64::from(tree.triangles.iter().any(|triangle| passes(record, triangle)));
        }
    }
    // What passes a unit sphere from a distance of 3, through a square of side 1 at a distance of 1: tan(asin(1/3)) = 0.3536.
    assert!((1550..1620).contains(&hits), "{hits}");
}

/// Whether the ray's line passes the triangle, in double precision.
fn passes(record: &Record, triangle: &Triangle) -> bool {
    let (o, d) = (record.origin.as_dvec3(), record.direction.as_dvec3());
    let [a, b, c] = triangle.0.map(|vertex| vertex.as_dvec3() - o);
    let signs = [a.cross(b).dot(d), b.cross(c).dot(d), c.cross(a).dot(d)];
    signs.iter().all(|&s| s >= 0.0) || signs.iter().all(|&s| s <= 0.0)
}

/// Where the ray meets the triangle's plane, in double precision; NaN when that is outside of the triangle by more than rounding.
fn distance(record: &Record, triangle: &Triangle) -> f64 {
    let (o, d) = (record.origin.as_dvec3(), record.direction.as_dvec3());
    let [a, b, c] = triangle.0.map(|vertex| vertex.as_dvec3());
    let normal = (b - a).cross(c - a);
    let t = (a - o).dot(normal) / d.dot(normal);
    let p = o + d * t;
    let inside = [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(from, to)| (*to - *from).cross(p - *from).dot(normal) >= -1e-4 * normal.length_squared());
    if inside { t } else { f64::NAN }
}

/// Trees of ours for every scene of a recording that has one, as `bvh-build` makes them.
fn build_trees(run: &Run) -> Vec<String> {
    let count = run.trees().len();
    let name = |what: &str, number: usize| match number {
        0 => format!("{what}.bvh"),
        _ => format!("{what}.{number}.bvh"),
    };
    let mut trees = Vec::new();
    for number in 0..count {
        let output = Command::new(env!("CARGO_BIN_EXE_bvh-build"))
            .args([&name("built", number), &name("ours", number)])
            .args(["--width", "8", "--max-leaf", "8"])
            .current_dir(run.directory.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        trees.push(run.path(&name("ours", number)).display().to_string());
    }
    trees
}

/// `embree-trace run` with trees and further arguments.
fn run_planted(options: &[&str], trees: &[String], program: &Path, arguments: &[&str]) -> Output {
    let trees = trees.iter().flat_map(|tree| ["--tree", tree]);
    Command::new(env!("CARGO_BIN_EXE_embree-trace"))
        .arg("run")
        .args(options)
        .args(trees)
        .arg("--")
        .arg(program)
        .args(arguments)
        .output()
        .unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A program sees on planted trees what it sees on Embree's own, in every form of a query; and the line says that they were planted.
#[test]
fn planted_trees_answer_as_embree_does() {
    for what in [
        "plain", "robust", "splits", "packets", "streams", "coherent", "filters", "commits", "sky", "threads",
    ] {
        let run = run_host(&[], what);
        let trees = build_trees(&run);
        let output = run_planted(&[], &trees, host(), &[what]);
        assert!(output.status.success(), "{what}: {}", said(&output));
        assert!(output.stdout == unrecorded(what), "{what}");
        let planted = said(&output).matches("planted  ").count();
        assert_eq!(planted, if what == "commits" { 2 } else { 1 }, "{what}: {}", said(&output));
        assert!(!said(&output).contains("warning"), "{what}: {}", said(&output));
    }
}

/// What is recorded on a planted tree is that tree, and answers that it gives.
#[test]
fn planted_trees_are_recorded() {
    let plain = run_host(&[], "devices");
    let trees = build_trees(&plain);
    let run = run_host(&["--tree", &trees[0], "--limit", "100000"], "devices");
    assert!(run.output.stdout == unrecorded("devices") && run.said().contains("planted  "), "{}", run.said());
    assert_eq!(run.replayed().unchecked, 0);
    let differ = Command::new(env!("CARGO_BIN_EXE_trace-diff"))
        .arg(&trees[0])
        .arg(run.path("built.bvh"))
        .output()
        .unwrap();
    assert_eq!(differ.status.code(), Some(0), "{}", String::from_utf8_lossy(&differ.stdout));
    // Without the order of the file they would not be.
    let read = std::fs::read(run.path("built.bvh")).unwrap();
    assert!(Bvh::parse(&read).unwrap().order.is_some());
}

/// Scenes that move, are committed by several threads at once, of two devices, and released while others are asked; and processes that
/// fork. Refits of Embree's never meet a tree of ours.
#[test]
fn planted_trees_come_and_go_with_their_scenes() {
    for what in ["refits", "rebuilds", "many-frames", "devices", "busy"] {
        let run = run_host(&["--limit", "100000"], what);
        let trees = build_trees(&run);
        // Later scenes of "busy" are flattened instances, which no scene of a program is.
        let trees = if what == "busy" { &trees[..1] } else { &trees[..] };
        let output = run_planted(&[], trees, host(), &[what]);
        assert!(output.status.success(), "{what}: {}", said(&output));
        assert!(output.stdout == unrecorded(what), "{what}");
        assert!(said(&output).contains("planted  "), "{what}: {}", said(&output));
        let frames = ["refits", "rebuilds", "many-frames"].contains(&what);
        assert_eq!(said(&output).matches("again and again").count(), usize::from(frames), "{what}");
    }
    let plain = run_host(&[], "plain");
    let trees = build_trees(&plain);
    let output = run_planted(&[], &trees, host(), &["fork"]);
    assert_eq!(output.status.code(), Some(7), "the program's own exit code");
    // Parent and child write at once: lines are cut, bytes are not lost.
    assert_eq!(output.stdout.len(), 3 * unrecorded("plain").len());
    let output = run_planted(&[], &trees, host(), &["kill"]);
    assert_eq!(output.status.code(), Some(128 + 9));
    assert!(output.stdout == unrecorded("plain"), "{}", said(&output));
}

/// The same tree 10 units along x, in a file.
fn moved(bvh: &Bvh) -> (TempDir, String) {
    let by = Vec3::new(10.0, 0.0, 0.0);
    let mut tree = Tree { nodes: bvh.tree.nodes.to_vec(), primitives: bvh.tree.primitives.to_vec() };
    for node in &mut tree.nodes {
        node.lower += by;
        node.upper += by;
    }
    let triangles: Vec<Triangle> =
        bvh.triangles.iter().map(|triangle| Triangle(triangle.0.map(|vertex| vertex + by))).collect();
    let contents = bvh::Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: bvh.geometries,
        order: bvh.order,
        meta: None,
        flags: bvh.header.flags,
        producer: "test",
    };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("moved.bvh");
    bvh::write(std::fs::File::create(&path).unwrap(), &contents).unwrap();
    (directory, path.display().to_string())
}

/// What cannot be planted is left, and one line says so; what is wrong ends before the program starts.
#[test]
fn planted_trees_are_found_or_left() {
    let (plain, devices) = (run_host(&[], "plain"), run_host(&["--limit", "9"], "devices"));
    let (ours, others) = (build_trees(&plain), build_trees(&devices));
    // A tree of another scene.
    let output = run_planted(&[], &others[..1], host(), &["plain"]);
    assert!(output.status.success() && output.stdout == unrecorded("plain"), "{}", said(&output));
    let warnings = said(&output).matches("warning").count();
    assert!(
        warnings == 1 && said(&output).contains("no scene that the program has committed"),
        "{}",
        said(&output)
    );
    // One with as many triangles, that stands elsewhere: its root says so.
    let (_directory, elsewhere) =
        Bvh::parse(&std::fs::read(&ours[0]).unwrap()).map(|bvh| moved(&bvh)).unwrap();
    let output = run_planted(&[], &[elsewhere], host(), &["plain"]);
    assert!(output.status.success() && output.stdout == unrecorded("plain"), "{}", said(&output));
    assert!(said(&output).contains("the box of its root does not hold"), "{}", said(&output));
    // The same in a directory with that of this one, and something that is no tree.
    let directory = tempfile::tempdir().unwrap();
    for (from, to) in [(&ours[0], "b.bvh"), (&others[0], "a.bvh")] {
        std::fs::copy(from, directory.path().join(to)).unwrap();
    }
    std::fs::write(directory.path().join("c.bvh"), b"no tree").unwrap();
    let path = directory.path().display().to_string();
    let output = run_planted(&["--trees", &path, "--format", "json"], &[], host(), &["plain"]);
    assert!(output.status.success() && output.stdout == unrecorded("plain"), "{}", said(&output));
    let report: serde_json::Value = serde_json::from_str(&said(&output)).unwrap();
    assert!(report["scenes"][0]["tree"].as_str().unwrap().ends_with("b.bvh"), "{report}");
    assert_eq!(report["warnings"].as_array().unwrap().len(), 1, "{report}");
    // Named one by one, what is no tree is an error, and nothing runs.
    let broken = directory.path().join("c.bvh").display().to_string();
    for trees in [vec![broken], vec!["missing.bvh".to_owned()], vec![]] {
        let output = run_planted(&[], &trees, host(), &["plain"]);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{}", said(&output));
        assert_eq!(said(&output).lines().count(), 1, "{}", said(&output));
    }
    // Instances were flattened: no scene has the triangles so.
    let instances = run_host(&[], "instances");
    let flattened = build_trees(&instances);
    let output = run_planted(&[], &flattened, host(), &["instances"]);
    assert!(output.status.success() && output.stdout == unrecorded("instances"), "{}", said(&output));
    assert!(said(&output).contains("placed by instances"), "{}", said(&output));
    // A program without Embree runs as it does.
    for (program, status) in [("true", 0), ("false", 1)] {
        let output = run_planted(&[], &ours, Path::new(program), &[]);
        assert_eq!(output.status.code(), Some(status), "{}", said(&output));
        let warnings = said(&output).matches("warning: nothing is planted").count();
        assert_eq!(warnings, usize::from(status == 0), "{}", said(&output));
    }
}

/// `embree-trace tune` of a shell script, in a directory of its own.
fn tune(directory: &Path, options: &[&str], script: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_embree-trace"))
        .args(["tune", "--budget", "0.1", "--rounds", "2"])
        .args(options)
        .args(["--", "sh", "-c", script])
        .current_dir(directory)
        .output()
        .unwrap()
}

/// A program is run, recorded, given trees and timed; what it writes is compared, and what pays is what a later run plants.
#[test]
fn programs_are_tuned() {
    let directory = tempfile::tempdir().unwrap();
    let script = format!("{} streams > out.txt", host().display());
    let output = tune(directory.path(), &["--output", "out.txt", "--format", "json"], &script);
    assert!(output.status.success(), "{}", said(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // As many queries as there are, in the count and in the recording.
    let queries = run_host(&[], "streams").rays();
    let queries = Rays::parse(&queries).unwrap().query_count();
    assert_eq!(report["queries"].as_u64(), Some(queries), "{report}");
    assert_eq!(report["recorded"].as_u64(), Some(queries), "{report}");
    let file = &report["outputs"][0];
    assert_eq!((&file["plain"]["differing"], &file["planted"]["differing"]), (&0.into(), &0.into()));
    assert_eq!((&file["plain"]["runs"], &file["planted"]["runs"]), (&3.into(), &2.into()));
    let scene = &report["scenes"][0];
    assert_eq!((scene["planted"].as_bool(), scene["queries"].as_u64()), (Some(true), Some(queries)));
    // The tree is where the report says, and is planted from there.
    let tree = directory.path().join(scene["tree"].as_str().unwrap());
    let trees = tree.parent().unwrap().display().to_string();
    let output = run_planted(&["--trees", &trees], &[], host(), &["streams"]);
    assert!(output.status.success() && said(&output).contains("planted  "), "{}", said(&output));
    let kept = scene["kept"].as_bool().unwrap();
    assert_eq!(trees.ends_with("trees"), kept, "{report}");
    let next = format!("embree-trace run --trees trees -- sh -c '{script}'");
    assert_eq!(report["next"].as_str(), kept.then_some(next.as_str()));
}

/// A file that planted trees change is told from one that changes by itself.
#[test]
fn changes_of_what_a_tuned_program_writes_are_told() {
    // The table of trees is longer than its header where there are any.
    let planted = "[ $(stat -Lc %s $EMBREE_TRACE_TREES) -gt 1100 ] && echo planted > out.txt; true";
    for (changes, status) in [(planted, 1), ("date +%N > out.txt", 0), ("true", 0)] {
        let directory = tempfile::tempdir().unwrap();
        let script = format!("{} plain > out.txt; {changes}", host().display());
        let output = tune(directory.path(), &["--output", "out.txt"], &script);
        assert_eq!(output.status.code(), Some(status), "{changes}: {}", said(&output));
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        let line = told.lines().find(|line| line.starts_with("output")).unwrap_or_default();
        let same = line.contains("the same in 2 runs");
        assert_eq!(
            (same, line.contains("Embree's trees, too")),
            (changes == "true", changes.contains("date")),
            "{line}"
        );
    }
}

/// Nothing that can be tuned: one line.
#[test]
fn what_cannot_be_tuned_is_told() {
    let host = host().display();
    for (script, what) in [
        ("true".to_owned(), "asked Embree nothing"),
        ("exit 3".to_owned(), "ended with 3 in its first run"),
        (format!("{host} plain; exit 4"), "ended with 4"),
        (format!("{host} plain"), "has not written it"),
        (format!("{host} instances; touch out.txt"), "nothing to plant"),
    ] {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join("out.txt"), "old").unwrap();
        std::thread::sleep(std::time::Duration::from_millis(60));
        let output = tune(directory.path(), &["--output", "out.txt"], &script);
        assert_eq!(output.status.code(), Some(2), "{script}: {}", said(&output));
        assert!(
            said(&output).lines().count() == 1 && said(&output).contains(what),
            "{script}: {}",
            said(&output)
        );
    }
    // A directory that is not ours is left as it is; that of the last time is not.
    let directory = tempfile::tempdir().unwrap();
    let other = directory.path().join("trees/tune/precious");
    std::fs::create_dir_all(other.parent().unwrap()).unwrap();
    std::fs::write(&other, "precious").unwrap();
    let output = tune(directory.path(), &[], &format!("{host} plain"));
    assert!(output.status.code() == Some(2) && other.exists(), "{}", said(&output));
    std::fs::rename(&other, directory.path().join("trees/tune/said.txt")).unwrap();
    let output = tune(directory.path(), &[], &format!("{host} plain"));
    assert!(output.status.success(), "{}", said(&output));
    for wrong in [["--rounds", "0"], ["--budget", "-1"], ["--queries", "0"]] {
        let directory = tempfile::tempdir().unwrap();
        let output = tune(directory.path(), &wrong, "true");
        assert_eq!((output.status.code(), said(&output).lines().count()), (Some(2), 1), "{}", said(&output));
    }
}
