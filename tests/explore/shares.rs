//! Counts by node and triangle, their sums along the tree, and samples.

use super::compare_support::files::geometries;
use super::{COSTS, Scene, asked, choice, nanoseconds, price, source};
use embree_trace::cost::ByKind;
use embree_trace::explore::count::Counted;
use embree_trace::explore::queries::Sampled;
use embree_trace::explore::shares::{Measure, Shares};
use embree_trace::explore::walk::Walk;
use embree_trace::format::rays::Record;
use embree_trace::progress::Progress;
use embree_trace::replay::check::Judge;
use embree_trace::replay::{self, Options};
use embree_trace::traverse::{Counts, Masks, OcclusionOrder, Prepared, PreparedRay, Traversal};
use embree_trace::tree::Tree;

/// What replay counts.
fn replayed(scene: &Scene, tree: &Tree, prepared: &Prepared, traversal: Traversal) -> (ByKind, u64, u64) {
    let geometries = geometries(&scene.triangles);
    let judge = Judge {
        tree: tree.view(),
        triangles: &scene.triangles,
        masks: Masks::new(&geometries),
        flattened: false,
    };
    let options = Options {
        traversal,
        occlusion_order: OcclusionOrder::Nearest,
        choice: choice(""),
        overlap: true,
        costs: COSTS,
        sort: None,
        packet: None,
        profile: None,
        image: None,
    };
    let outcome =
        replay::replay(prepared, &judge, &scene.rays(), &options, &Progress::hidden()).expect("whole");
    let total = outcome.tallies.total;
    assert_eq!((total.mismatches, outcome.violation), (0, None));
    (total.by_kind, total.hits, total.overlap.inner + total.overlap.leaves)
}

#[test]
fn counts_are_those_of_replay_and_of_a_loop_over_all_boxes() {
    let scene = Scene::new(500, 130);
    let rays = scene.rays();
    for tree in scene.trees() {
        let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(&tree));
        for traversal in Traversal::ALL {
            let (by_kind, hits, overlaps) = replayed(&scene, &tree, &prepared, traversal);
            let ByKind { closest_hit, occlusion } = by_kind;
            let mut counts = closest_hit.counts;
            counts += occlusion.counts;
            let source = source(&rays, "", u64::MAX);
            let counted =
                Counted::of(&walk, &asked(&tree, &prepared, traversal), &source, &Progress::hidden())
                    .expect("whole");
            assert_eq!((counted.queries, counted.hits), (500, hits));
            assert_eq!(counted.occlusions, occlusion.queries);
            assert_eq!(counted.sampled, Sampled { taken: 500, looked_at: 500, of: 500 });
            assert_eq!(counted.triangles.iter().map(|t| u64::from(t.hits)).sum::<u64>(), hits);
            let tests = counted.triangles.iter().map(|triangle| u64::from(triangle.tests)).sum::<u64>();
            assert_eq!(tests, counts.primitive_tests);
            assert_eq!(counted.nodes.iter().map(|node| u64::from(node.overlapped)).sum::<u64>(), overlaps);
            for (index, node) in tree.nodes.iter().enumerate() {
                // The effective segment of the recording ends within rounding of that of the answer: boxes that start there may differ.
                let overlapped = |end: f32| {
                    let overlaps = |record: &&Record| {
                        let segment = PreparedRay::new(&record.effective_segment());
                        let tfar = if record.is_occlusion() { segment.tfar } else { segment.tfar * end };
                        segment.entry(&node.bounds(), tfar).is_some()
                    };
                    scene.records.iter().filter(overlaps).count() as u32
                };
                let count = &counted.nodes[index];
                assert!((overlapped(0.999)..=overlapped(1.001)).contains(&count.overlapped), "{index}");
            }
            let shares = Shares::of(&walk, counted, price(&tree), COSTS);
            assert_eq!(shares.total(), counts);
            let cost = nanoseconds(false, &closest_hit.counts) + nanoseconds(true, &occlusion.counts);
            assert!((shares.mean_cost() - cost / 500.0).abs() < 1e-9 * cost);
            assert!((shares.mean_gamma() - COSTS.gamma(&counts) / 500.0).abs() < 1e-9);
        }
    }
    assert!(!scene.rejects.is_empty());
}

#[test]
fn shares_add_up_along_the_tree_and_large_ones_are_found() {
    let scene = Scene::new(300, 100);
    let rays = scene.rays();
    for tree in scene.trees() {
        let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(&tree));
        let asked = asked(&tree, &prepared, Traversal::Odf);
        let source = source(&rays, "", u64::MAX);
        let counted = Counted::of(&walk, &asked, &source, &Progress::hidden()).expect("whole");
        let shares = Shares::of(&walk, counted, price(&tree), COSTS);
        for measure in Measure::ALL {
            let share = |node: u32| shares.share(&walk, measure, node);
            assert_eq!(share(0), 1.0);
            for node in 0..tree.nodes.len() as u32 {
                let children: f64 = walk.children(node).map(share).sum();
                assert!(children <= share(node) + 1e-9, "{measure:?} {node}");
                let facts = shares.node(&walk, node);
                if measure == Measure::Cost && !facts.is_leaf {
                    assert!((facts.own_share + children - share(node)).abs() < 1e-9);
                }
            }
            for least in [0.5, 0.1, 0.01] {
                let mut found = shares.nodes_above(&walk, measure, least);
                found.sort();
                let all: Vec<u32> = (0..tree.nodes.len() as u32).filter(|&n| share(n) >= least).collect();
                assert_eq!(found, all);
            }
        }
        // What is below a node was spent at it and at all below.
        let mut below = vec![Counts::default(); tree.nodes.len()];
        for node in 0..tree.nodes.len() as u32 {
            walk.upwards(node).for_each(|up| below[up as usize] += shares.own(&walk, node));
        }
        assert!((0..tree.nodes.len()).all(|node| below[node] == shares.below(node as u32)));
        let root = shares.node(&walk, 0);
        assert_eq!((root.level, root.triangles, root.area_to_root), (0, 240, 1.0));
        assert!(root.overlapped_share <= 1.0 && root.opened <= 300 && root.own.box_tests >= 300);
    }
}

#[test]
fn nothing_asked_is_nothing_spent() {
    let scene = Scene::new(1, 1);
    let tree = &scene.trees()[0];
    let walk = Walk::new(tree.view(), scene.triangles.len());
    let shares = Shares::of(&walk, Counted::nothing(&walk), price(tree), COSTS);
    assert_eq!(
        (shares.mean_gamma(), shares.mean_cost(), shares.share(&walk, Measure::Cost, 0)),
        (0.0, 0.0, 0.0)
    );
    assert_eq!(shares.share(&walk, Measure::Area, 0), 1.0);
    assert!(shares.node(&walk, 3).own == Counts::default());
}

#[test]
fn threads_change_nothing_and_samples_say_what_they_are() {
    let scene = Scene::new(1500, 13);
    let rays = scene.rays();
    let tree = &scene.trees()[3];
    let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(tree));
    let count = |filter: &str, limit: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let source = source(&rays, filter, limit);
        let progress = Progress::watched(source.steps());
        let asked = asked(tree, &prepared, Traversal::RayOrder);
        let counted = pool.install(|| Counted::of(&walk, &asked, &source, &progress)).expect("whole");
        assert_eq!(progress.fraction(), 1.0);
        counted
    };
    for (filter, limit) in [("", u64::MAX), ("", 1500), ("", 200), ("", 20), ("kind=occlusion", 200)] {
        let (one, many) = (count(filter, limit, 1), count(filter, limit, 3));
        assert_eq!((&one.nodes, &one.triangles), (&many.nodes, &many.triangles), "{filter} {limit}");
        assert_eq!(one.sampled, many.sampled);
        let Sampled { taken, looked_at, of } = one.sampled;
        assert_eq!((looked_at, of), (limit.min(1500), 1500));
        assert_eq!((taken, one.sampled.is_all()), (one.queries, limit >= 1500));
        let occlusions = scene.records.iter().filter(|record| record.is_occlusion()).count() as f64 / 1500.0;
        let expected = if filter.is_empty() { looked_at as f64 } else { occlusions * looked_at as f64 };
        assert!((taken as f64 - expected).abs() <= 0.2 * expected, "{taken} for {expected}");
    }
    assert!(source(&rays, "", 20).steps() < 500, "whole chunks are left out");
    let stopped = Progress::hidden();
    stopped.stop();
    let asked = asked(tree, &prepared, Traversal::Odf);
    let counted = Counted::of(&walk, &asked, &source(&rays, "", u64::MAX), &stopped).expect("whole");
    assert_eq!(counted.sampled, Sampled { taken: 0, looked_at: 0, of: 1500 });
}
