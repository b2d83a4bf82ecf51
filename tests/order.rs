//! Traversal orders for occlusion queries: answers never change, costs are exact, choices pay.

mod compare_support;

use compare_support::files::{rays_bytes, records, tree_bytes};
use compare_support::*;
use embree_trace::format::bvh::{self, Bvh, Contents, fingerprint};
use embree_trace::geometry::{Ray, Triangle};
use embree_trace::optimize::order::{Chosen, Config, choose, limit, measure};
use embree_trace::training::occlusions::Occlusion;
use embree_trace::traverse::*;
use embree_trace::tree::{Tree, collapse};
use std::process::Command;

fn queries(rays: &[Ray]) -> Vec<Occlusion> {
    rays.iter().map(|&ray| Occlusion { ray, mask: u32::MAX, rejects: Box::default() }).collect()
}

fn recorded(chosen: &Chosen) -> OcclusionOrder {
    OcclusionOrder::Recorded(chosen.orders.clone())
}

/// What the default configuration lowers.
fn tests(counts: Counts) -> u64 {
    counts.box_tests + counts.primitive_tests
}

/// Every order there is, and one that no file may have.
fn orders(tree: &Tree, random: &mut Random) -> Vec<OcclusionOrder> {
    let bytes: Vec<u8> = tree.nodes.iter().map(|_| random.below(4) as u8).collect();
    let mut all: Vec<OcclusionOrder> = OrderName::ALL
        .map(|name| OcclusionOrder::new(Some(name), tree.view(), Some(&bytes)).expect("fits"))
        .into();
    all.push(OcclusionOrder::Recorded(vec![255; tree.nodes.len() / 2]));
    all.push(OcclusionOrder::Area(Vec::new()));
    all
}

#[test]
fn no_order_changes_an_answer() {
    let (random, scratch) = (&mut Random(21), &mut Scratch::default());
    for (scene, triangles) in scenes() {
        let rays = rays(&triangles, 150, random);
        for (width, leaf) in [(2, 1), (2, 4), (5, 2), (8, 3)] {
            let tree = random_tree(&triangles, width, leaf, random);
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            for order in orders(&tree, random) {
                for ray in &rays {
                    let query = PreparedRay::new(ray);
                    let truth = truth(ray, &triangles, |_| true);
                    match prepared.occluder_in(&order, &query, &All, &mut (), scratch) {
                        None => assert!(truth.certain.is_infinite(), "{scene} {order:?} {ray:?}"),
                        Some(hit) => assert!(
                            truth.possible.iter().any(|(triangle, _)| *triangle == hit.triangle),
                            "{scene} {order:?} {ray:?} {hit:?}"
                        ),
                    }
                }
            }
            for ray in hostile_rays(random) {
                let query = PreparedRay::new(&ray);
                let expected =
                    prepared.occluder(Traversal::RayOrder, &query, &All, &mut (), scratch).is_some();
                for order in orders(&tree, random) {
                    let found = prepared.occluder_in(&order, &query, &All, &mut (), scratch);
                    assert_eq!(found.is_some(), expected, "{scene} {order:?} {ray:?}");
                }
            }
        }
    }
}

#[test]
fn the_quick_traversals_go_the_way_of_those_that_compare_children() {
    let (random, scratch) = (&mut Random(27), &mut Scratch::default());
    for (scene, triangles) in scenes() {
        let mut rays = rays(&triangles, 150, random);
        rays.extend(hostile_rays(random));
        for (width, leaf) in [(2, 1), (4, 3), (8, 1), (30, 6)] {
            let tree = random_tree(&triangles, width, leaf, random);
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            for order in [OcclusionOrder::First, OcclusionOrder::Outside] {
                for ray in &rays {
                    let query = PreparedRay::new(ray);
                    let (mut path, mut counts) = (Path::default(), Counts::default());
                    let slow = prepared.occluder_in(&order, &query, &All, &mut path, scratch);
                    let quick = prepared.occluder_in(&order, &query, &All, &mut counts, scratch);
                    let triangle = |hit: Option<Hit>| hit.map(|hit| hit.triangle);
                    assert_eq!(triangle(quick), triangle(slow), "{scene} {width} {order:?} {ray:?}");
                    let steps =
                        |kind: fn(&Step) -> bool| path.steps.iter().filter(|&step| kind(step)).count() as u64;
                    assert_eq!(counts.node_visits, steps(|step| matches!(step, Step::Inner(_))));
                    assert_eq!(counts.primitive_tests, steps(|step| matches!(step, Step::Triangle(_))));
                }
            }
        }
    }
}

#[test]
fn predicted_costs_are_those_of_the_traversal_and_never_above_nearest_first() {
    let random = &mut Random(22);
    let mut better = 0;
    for (scene, triangles) in scenes() {
        let queries = queries(&rays(&triangles, 300, random));
        for (width, leaf) in [(2, 1), (2, 3), (4, 1), (8, 2)] {
            let tree = random_tree(&triangles, width, leaf, random);
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            // Rays that are not occluded cost the same in any order, and the prediction leaves them out.
            let occluded: Vec<Occlusion> = queries
                .iter()
                .filter(|query| {
                    let ray = PreparedRay::new(&query.ray);
                    prepared.occluder(Traversal::Odf, &ray, &All, &mut (), &mut Scratch::default()).is_some()
                })
                .cloned()
                .collect();
            let chosen = choose(&prepared, tree.nodes.len(), &queries, &Config::default());
            assert_eq!(chosen.deciding, occluded.len());
            let roots = occluded.len() as u64;
            let near = measure(&prepared, &OcclusionOrder::Nearest, &occluded);
            let ours = measure(&prepared, &recorded(&chosen), &occluded);
            assert_eq!(tests(near) - roots, chosen.nearest as u64, "{scene} {width}");
            assert_eq!(tests(ours) - roots, chosen.cost as u64, "{scene} {width}");
            assert!(tests(ours) <= tests(near), "{scene} {width}");
            assert!(chosen.cost <= chosen.first);
            better += u32::from(tests(ours) < tests(near));
            let least = tests(limit(&prepared, &queries));
            for order in orders(&tree, random) {
                assert!(tests(measure(&prepared, &order, &queries)) >= least, "{scene} {width} {order:?}");
            }
        }
    }
    assert!(better >= 16, "{better} of 32 got better");
}

/// The least cost over all ways to give each inner node an order of 0 to `rules`.
fn exhaustive(prepared: &Prepared, tree: &Tree, queries: &[Occlusion], rules: &[u8]) -> u64 {
    let inner: Vec<usize> = (0..tree.nodes.len()).filter(|&node| !tree.nodes[node].is_leaf()).collect();
    let ways = rules.len().pow(inner.len() as u32);
    let cost = |way: usize| {
        let mut orders = vec![0; tree.nodes.len()];
        let mut rest = way;
        for &node in &inner {
            orders[node] = rules[rest % rules.len()];
            rest /= rules.len();
        }
        tests(measure(prepared, &OcclusionOrder::Recorded(orders), queries))
    };
    (0..ways).map(cost).min().unwrap_or(0)
}

#[test]
fn choices_come_close_to_the_best_of_all_assignments() {
    let random = &mut Random(23);
    let (mut exact, mut excess, mut fixed_better) = (0, 0.0, 0);
    let scenes = 40;
    for _ in 0..scenes {
        let triangles: Vec<Triangle> = soup(6, 1.0, random);
        let tree = random_tree(&triangles, 2, 1, random);
        assert_eq!(tree.nodes.len(), 11, "five inner nodes");
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let queries = queries(&rays(&triangles, 60, random));
        let chosen = choose(&prepared, tree.nodes.len(), &queries, &Config::default());
        let cost = tests(measure(&prepared, &recorded(&chosen), &queries));
        let best = exhaustive(&prepared, &tree, &queries, &[0, 1, 2, 3]);
        let fixed = exhaustive(&prepared, &tree, &queries, &[1, 2]);
        assert!(best <= cost && best <= fixed, "{best} {cost} {fixed}");
        exact += u32::from(cost == best);
        fixed_better += u32::from(fixed < cost);
        excess += (cost as f64 / best as f64 - 1.0) / f64::from(scenes);
    }
    println!(
        "{exact} of {scenes} are optimal, mean excess {excess:.5}, {fixed_better} above the best fixed order"
    );
    assert!(exact * 10 >= scenes * 8 && excess < 0.005, "{exact} {excess}");
}

#[test]
fn any_number_of_threads_chooses_the_same() {
    let random = &mut Random(24);
    let triangles = soup(500, 0.3, random);
    let tree = random_tree(&triangles, 2, 2, random);
    let queries = queries(&rays(&triangles, 2000, random));
    let choice = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            let chosen = choose(&prepared, tree.nodes.len(), &queries, &Config::default());
            (measure(&prepared, &OcclusionOrder::Random(3), &queries), chosen)
        })
    };
    assert_eq!(choice(1), choice(4));
}

#[test]
fn nothing_to_learn_from_is_nearest_first() {
    let random = &mut Random(25);
    let triangles = soup(50, 0.3, random);
    let tree = random_tree(&triangles, 2, 2, random);
    let prepared = Prepared::new(tree.view(), &triangles, &[]);
    let nodes = tree.nodes.len();
    assert_eq!(choose(&prepared, nodes, &[], &Config::default()).orders, vec![0; nodes]);
    let misses: Vec<Ray> =
        rays(&triangles, 50, random).iter().map(|ray| Ray { origin: ray.origin + 1e6, ..*ray }).collect();
    assert_eq!(choose(&prepared, nodes, &queries(&misses), &Config::default()).orders, vec![0; nodes]);
    let odd = choose(&prepared, nodes, &queries(&hostile_rays(random)), &Config::default());
    assert!(odd.cost <= odd.nearest);
}

#[test]
fn orders_survive_the_file_and_bad_ones_are_refused() {
    let random = &mut Random(26);
    let triangles = soup(30, 0.3, random);
    let tree = random_tree(&triangles, 2, 1, random);
    let bytes: Vec<u8> = tree.nodes.iter().map(|_| random.below(4) as u8).collect();
    let write = |order: &[u8]| {
        let mut file = Vec::new();
        let contents = Contents {
            tree: tree.view(),
            triangles: &triangles,
            geometries: &[],
            order: Some(order),
            meta: None,
            flags: 0,
            producer: "a test",
        };
        bvh::write(&mut file, &contents).map(|_| file)
    };
    let file = write(&bytes).expect("valid");
    let read = Bvh::parse(&file).expect("valid");
    assert_eq!(read.order, Some(bytes.as_slice()));
    let order = OcclusionOrder::new(None, read.tree, read.order);
    assert_eq!(order, Ok(OcclusionOrder::Recorded(bytes.clone())));

    let mut odd = bytes.clone();
    odd[3] = 4;
    assert!(write(&odd).is_err() && write(&bytes[1..]).is_err());
    let refused = |name, order: Option<&[u8]>| OcclusionOrder::new(name, tree.view(), order);
    assert_eq!(refused(None, Some(&odd)), Err(OrderError::Value { node: 3, value: 4 }));
    let length = OrderError::Length { orders: bytes.len() - 1, nodes: bytes.len() };
    assert_eq!(refused(None, Some(&bytes[1..])), Err(length));
    assert_eq!(refused(Some(OrderName::Recorded), None), Err(OrderError::NotRecorded));
    let is_wide = tree.nodes.iter().any(|node| !node.is_leaf() && node.len() > 2);
    assert!(!is_wide);
    assert_eq!(refused(None, None), Ok(OcclusionOrder::Nearest));
    // Embree's kernels follow the last child first.
    let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
    let wide = collapse::collapse(tree.view(), area, &collapse::Config::vector(8)).expect("a binary tree");
    assert_eq!(OcclusionOrder::new(None, wide.view(), None), Ok(OcclusionOrder::Last));
}

#[test]
fn the_commands_choose_store_and_follow_an_order() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let triangles = soup(400, 0.25, &mut Random(11));
    let tree = random_tree(&triangles, 2, 1, &mut Random(12));
    let (records, rejects) = records(&triangles, 3000, 5);
    let rays = rays_bytes(fingerprint(&triangles), &records, &rejects, 700);
    std::fs::write(directory.path().join("in.bvh"), tree_bytes(&triangles, &tree, None)).expect("written");
    std::fs::write(directory.path().join("casts.rays"), rays).expect("written");
    let json = |program: &str, line: &str, code: i32| -> serde_json::Value {
        let output = Command::new(program)
            .args(line.split_whitespace())
            .current_dir(directory.path())
            .output()
            .expect("runs");
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{line}: {error}");
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| error.into_owned().into())
    };
    let (build, compare) = (env!("CARGO_BIN_EXE_bvh-build"), env!("CARGO_BIN_EXE_bvh-compare"));
    let built = json(build, "in.bvh out.bvh --heuristic sah --rays casts.rays --order --format json", 0);
    let only = "out.bvh casts.rays --filter kind=occlusion --traversal odf --no-time --format json";
    for order in ["", "recorded", "nearest", "farthest", "area", "first", "last", "random"] {
        let option = if order.is_empty() { String::new() } else { format!(" --occlusion-order {order}") };
        let report = json(compare, &format!("{only}{option}"), 0);
        let name = if order.is_empty() { "recorded" } else { order };
        assert_eq!(report["trees"][0]["occlusion_order"], name);
        for count in ["box_tests", "node_visits", "primitive_tests"] {
            let replayed = &report["trees"][0]["traversals"]["odf"][count];
            assert_eq!(replayed, &built["order"]["costs_training"][name][count], "{name} {count}");
        }
    }
    let refused = json(compare, "in.bvh casts.rays --occlusion-order recorded", 2);
    assert!(refused.as_str().is_some_and(|line| line.contains("in.bvh: the tree has no section ORDR")));
    json(build, "in.bvh other.bvh --order", 2);
}
