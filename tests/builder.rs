//! Builders against an independent validator, on random and on degenerate triangles.

mod soup;

use embree_trace::builder::{self, Bins, Config, Count, MAX_DEPTH, Splits};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::progress::Progress;
use embree_trace::tree::statistics::{Statistics, sah_cost};
use embree_trace::tree::validate::validate;
use embree_trace::tree::{Node, Tree};
use soup::{Random, degenerate, soup};

/// One configuration of every kind.
fn configurations() -> Vec<Config> {
    let default = Config::default();
    vec![
        default,
        Config { splits: Splits::Sweep, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(2) }, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(7) }, max_leaf: 3, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(256) }, count: Count::All, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(16) }, alpha: 0.7, max_leaf: 8, ..default },
        Config { splits: Splits::Sweep, alpha: 0.0, count: Count::All, ..default },
        Config { splits: Splits::Sweep, alpha: 1.3, max_leaf: 4, ..default },
    ]
}

fn build(triangles: &[Triangle], config: &Config) -> Tree {
    builder::build(triangles, config, &Progress::hidden()).expect("the configuration is valid")
}

fn check(triangles: &[Triangle], config: &Config, what: &str) -> Tree {
    let tree = build(triangles, config);
    if let Err(error) = validate(&tree, triangles, MAX_DEPTH) {
        panic!("{what}, {config:?}: {error}");
    }
    let statistics = Statistics::of(tree.view());
    assert!(statistics.max_leaf <= config.max_leaf, "{what}, {config:?}: {statistics:?}");
    assert!(statistics.max_children == 2 || statistics.nodes == 1, "{what}, {config:?}: {statistics:?}");
    tree
}

fn on_threads<T: Send>(threads: usize, task: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool").install(task)
}

#[test]
fn trees_over_random_triangles_are_valid() {
    for count in (1..40).chain([100, 1000, 5000]) {
        let triangles = soup(count, count as u64);
        for config in configurations() {
            check(&triangles, &config, &format!("{count} random triangles"));
        }
    }
}

#[test]
fn degenerate_triangles_give_valid_trees() {
    for (name, triangles) in degenerate() {
        for config in configurations() {
            check(&triangles, &config, &name);
        }
    }
}

#[test]
fn nothing_gives_an_empty_leaf() {
    let nan = [Triangle([Vec3::NAN; 3])];
    for config in configurations() {
        for triangles in [&[][..], &nan] {
            let tree = check(triangles, &config, "nothing");
            assert_eq!(tree.nodes.len(), 1);
            assert!(tree.nodes[0].is_leaf() && tree.nodes[0].is_empty());
        }
    }
}

#[test]
fn a_million_identical_triangles_are_halved() {
    let triangles = vec![Triangle([Vec3::ZERO, Vec3::X, Vec3::Y]); 1_000_000];
    for splits in [Splits::Binned { bins: Bins::Adaptive }, Splits::Sweep] {
        let tree = check(&triangles, &Config { splits, ..Config::default() }, "identical triangles");
        assert!(Statistics::of(tree.view()).depth <= MAX_DEPTH);
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    // Enough for every parallel path, and not a multiple of a block.
    let mut triangles = soup(150_001, 7);
    triangles[77_777].0[1].y = f32::NAN;
    // Equal boxes and zeros of both signs would show an order that depends on threads.
    for index in (0..50_000).step_by(3) {
        triangles[index + 1] = triangles[index];
        triangles[index].0[0] = Vec3::new(-0.0, 0.0, if index % 2 == 0 { -0.0 } else { 0.0 });
    }
    for config in [configurations()[0], configurations()[1], configurations()[3]] {
        let bytes = |threads| {
            let tree = on_threads(threads, || check(&triangles, &config, "threads"));
            (bytemuck::cast_slice::<Node, u8>(&tree.nodes).to_vec(), tree.primitives)
        };
        let one = bytes(1);
        for threads in [2, 3, 8] {
            assert!(bytes(threads) == one, "{threads} threads, {config:?}");
        }
    }
}

#[test]
fn depth_is_bounded_where_the_heuristic_has_no_bound() {
    // Triangles that grow by a factor: the best split always separates the largest one.
    let triangles: Vec<Triangle> = (0..240)
        .map(|i| {
            let size = 2f32.powi(i - 120);
            Triangle([Vec3::ZERO, Vec3::new(size, 0.0, 0.0), Vec3::new(0.0, size, size)])
        })
        .collect();
    let mut deepest = 0;
    for config in configurations() {
        let tree = check(&triangles, &config, "growing triangles");
        deepest = deepest.max(Statistics::of(tree.view()).depth);
    }
    assert_eq!(deepest, MAX_DEPTH, "the bound was reached, and held");
}

#[test]
fn a_better_search_costs_less() {
    let triangles = soup(20_000, 3);
    let cost = |splits| {
        let config = Config { splits, ..Config::default() };
        sah_cost(build(&triangles, &config).view(), 0.6, 1.0)
    };
    let two_bins = cost(Splits::Binned { bins: Bins::Fixed(2) });
    let adaptive = cost(Splits::Binned { bins: Bins::Adaptive });
    let sweep = cost(Splits::Sweep);
    assert!(sweep < adaptive && adaptive < two_bins, "{sweep} {adaptive} {two_bins}");
}

#[test]
fn termination_lowers_the_sah_cost_and_obeys_the_limit() {
    let triangles = soup(5_000, 11);
    let of = |config: Config| {
        let tree = check(&triangles, &config, "termination");
        (sah_cost(tree.view(), config.c_i, config.c_p), Statistics::of(tree.view()))
    };
    let single = Config { splits: Splits::Sweep, ..Config::default() };
    let (one_cost, one) = of(single);
    assert_eq!((one.leaves, one.nodes), (5_000, 9_999));
    let (eight_cost, eight) = of(Config { max_leaf: 8, ..single });
    assert!(eight_cost < one_cost && eight.leaves < one.leaves, "{eight_cost} {one_cost}");
    // When box tests cost nothing, every split that shrinks a box pays; when they cost everything, none does.
    let free = of(Config { max_leaf: 8, c_i: 0.0, ..single }).1;
    let dear = of(Config { max_leaf: 8, c_i: 1e6, ..single }).1;
    assert!(free.leaves > eight.leaves && dear.leaves < eight.leaves);
}

#[test]
fn configurations_out_of_range_are_refused() {
    let default = Config::default();
    for bad in [
        Config { alpha: -1.0, ..default },
        Config { alpha: f64::NAN, ..default },
        Config { alpha: f64::INFINITY, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(1) }, ..default },
        Config { splits: Splits::Binned { bins: Bins::Fixed(257) }, ..default },
        Config { max_leaf: 0, ..default },
        Config { max_leaf: usize::MAX, ..default },
        Config { c_i: -1.0, ..default },
        Config { c_p: f64::NAN, ..default },
    ] {
        let error = builder::build(&soup(3, 0), &bad, &Progress::hidden()).expect_err("out of range");
        assert!(!error.to_string().contains('\n'));
    }
}

#[test]
fn random_splits_cost_more_than_a_sweep() {
    let triangles = soup(1_000, 5);
    let config = Config { splits: Splits::Sweep, ..Config::default() };
    let sweep = sah_cost(build(&triangles, &config).view(), 0.6, 1.0);
    let mut random = Random::new(9);
    for _ in 0..5 {
        // A tree over the same leaves, cut at random places of the sweep's own order.
        let mut tree = build(&triangles, &config);
        let order: Vec<u32> = tree.primitives.clone();
        tree.nodes.clear();
        tree.nodes.push(Node::leaf(embree_trace::geometry::Aabb::EMPTY, 0, 0));
        let mut open = vec![(0, 0, order.len())];
        while let Some((node, first, end)) = open.pop() {
            let bounds = order[first..end].iter().fold(embree_trace::geometry::Aabb::EMPTY, |sum, &t| {
                sum.union(&triangles[t as usize].bounds())
            });
            if end - first == 1 {
                tree.nodes[node] = Node::leaf(bounds, first as u32, 1);
                continue;
            }
            let children = tree.nodes.len();
            tree.nodes[node] = Node::inner(bounds, children as u32, 2);
            tree.nodes.extend([Node::leaf(bounds, 0, 0); 2]);
            let middle = first + 1 + random.below((end - first - 1) as u64) as usize;
            open.push((children, first, middle));
            open.push((children + 1, middle, end));
        }
        assert_eq!(validate(&tree, &triangles, usize::MAX), Ok(()));
        assert!(sweep < sah_cost(tree.view(), 0.6, 1.0));
    }
}
