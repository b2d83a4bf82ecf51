//! Optimisers against validation, brute force and the exact optimum, on random and on degenerate triangles.

mod soup;

use embree_trace::builder::exhaustive::optimum;
use embree_trace::builder::{self, Bins, MAX_DEPTH, Splits};
use embree_trace::geometry::padded::PaddedAabb;
use embree_trace::geometry::{Aabb, Ray, Triangle, Vec3};
use embree_trace::optimize::measure::{AreaMeasure, Estimate, Measure, RayMeasure};
use embree_trace::optimize::{
    Config, OptimizeError, Report, Stage, annealing, insertion, reinsertion, rotations, run, treelets,
};
use embree_trace::progress::Progress;
use embree_trace::tree::validate::validate;
use embree_trace::tree::{Node, Tree};
use soup::{Random, degenerate, soup};

/// Every optimiser on its own, and some together.
fn configurations() -> Vec<Config> {
    let rotations = Stage::Rotations(rotations::Config::default());
    let annealing = Stage::Annealing(annealing::Config { iterations: 60, ..Default::default() });
    let insertion = Stage::Insertion(insertion::Config { rounds: 20, share: 0.1, ..Default::default() });
    let reinsertion = Stage::Reinsertion(reinsertion::Config::default());
    let treelets = Stage::Treelets(treelets::Config::default());
    let all = Stage::Reinsertion(reinsertion::Config { share: 1.0, ..Default::default() });
    let stages = [
        vec![rotations],
        vec![annealing],
        vec![insertion],
        vec![reinsertion],
        vec![treelets],
        vec![all],
        vec![rotations, all, insertion],
    ];
    stages.into_iter().map(|stages| Config { stages, deadline: None }).collect()
}

fn build(triangles: &[Triangle], max_leaf: usize) -> Tree {
    let config =
        builder::Config { splits: Splits::Binned { bins: Bins::Fixed(3) }, max_leaf, ..Default::default() };
    builder::build(triangles, &config, &Progress::hidden()).expect("a valid configuration")
}

fn rays(count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| {
            let (from, to) = (random.vector() * Vec3::new(0.2, 1.0, 1.0), random.vector());
            Ray { origin: from, tnear: 0.0, direction: to - from, tfar: random.unit() }
        })
        .collect()
}

fn blend(tree: &Tree, rays: &[Ray]) -> RayMeasure {
    RayMeasure::new(rays, Estimate::default(), &tree.nodes[0].bounds().into())
}

/// T, counted anew.
fn cost<M: Measure<Bounds = PaddedAabb>>(tree: &Tree, measure: &M) -> f64 {
    let inner = tree.nodes.iter().filter(|node| !node.is_leaf());
    inner.map(|node| measure.values(&measure.whole(), &[node.bounds().into()])[0]).sum()
}

/// Optimises a copy and checks what the report says of it.
fn optimize<M: Measure<Bounds = PaddedAabb>>(tree: &Tree, measure: &M, config: &Config) -> (Tree, Report) {
    let mut better = tree.clone();
    let report = run(&mut better, measure, config, &Progress::hidden()).expect("a valid configuration");
    let (before, after) = (cost(tree, measure), cost(&better, measure));
    assert!(after <= before, "{config:?}: {before} to {after}");
    assert!((report.before - before).abs() <= 1e-9 * before, "{config:?}: {} {before}", report.before);
    assert!((report.after - after).abs() <= 1e-9 * before, "{config:?}: {} {after}", report.after);
    (better, report)
}

#[test]
fn every_optimiser_lowers_the_cost_and_keeps_the_tree_valid() {
    let triangles = soup(400, 1);
    for max_leaf in [1, 4] {
        let tree = build(&triangles, max_leaf);
        let area = AreaMeasure::new(&tree.nodes[0].bounds().into());
        let blend = blend(&tree, &rays(500, 2));
        for config in configurations() {
            for (better, report) in [optimize(&tree, &area, &config), optimize(&tree, &blend, &config)] {
                validate(&better, &triangles, MAX_DEPTH).expect("a valid tree");
                assert!(report.after < 0.999 * report.before, "{report:?}");
            }
        }
    }
}

#[test]
fn the_tree_does_not_depend_on_threads() {
    let triangles = soup(1000, 3);
    let tree = build(&triangles, 1);
    let rays = rays(500, 4);
    for config in configurations() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| {
                let mut tree = tree.clone();
                let measure = blend(&tree, &rays);
                let report = run(&mut tree, &measure, &config, &Progress::hidden());
                (tree, report)
            })
        };
        let one = on(1);
        assert!(one == on(2) && one == on(3), "{config:?}");
    }
}

#[test]
fn degenerate_triangles_and_rays_do_no_harm() {
    let none: [Ray; 0] = [];
    let special = [0.0, 1.0, -1.0, 1e-42, 1e38, f32::NAN, f32::INFINITY];
    let mut random = Random::new(5);
    let mut number = || special[random.below(7) as usize];
    let odd: Vec<Ray> = (0..50)
        .map(|_| Ray {
            origin: Vec3::new(number(), number(), number()),
            tnear: number(),
            direction: Vec3::new(number(), number(), number()),
            tfar: number(),
        })
        .collect();
    let away: Vec<Ray> =
        rays(20, 6).iter().map(|ray| Ray { origin: ray.origin + Vec3::splat(1e20), ..*ray }).collect();
    for (number, (name, triangles)) in degenerate().into_iter().enumerate() {
        let tree = build(&triangles, 1);
        let config = &configurations()[number % 6];
        let rays: &[Ray] = [&none[..], &odd, &away][number / 6 % 3];
        let area = AreaMeasure::new(&tree.nodes[0].bounds().into());
        for (better, _) in [optimize(&tree, &area, config), optimize(&tree, &blend(&tree, rays), config)] {
            if let Err(error) = validate(&better, &triangles, MAX_DEPTH) {
                panic!("{name}, {config:?}: {error}");
            }
        }
    }
}

#[test]
fn up_to_three_primitives_are_no_trouble() {
    for count in 0..=3 {
        let triangles = soup(count, 9);
        let tree = build(&triangles, 1);
        for config in configurations() {
            let (better, _) = optimize(&tree, &blend(&tree, &rays(50, 1)), &config);
            validate(&better, &triangles, MAX_DEPTH).expect("a valid tree");
        }
    }
}

#[test]
fn leaves_of_spatial_splits_keep_their_boxes_and_primitives() {
    // Each triangle's box, cut in two: two leaves of the same triangle.
    let triangles = soup(150, 7);
    let halves: Vec<(Aabb, u32)> = triangles
        .iter()
        .enumerate()
        .flat_map(|(index, triangle)| {
            let bounds = triangle.bounds();
            let middle = bounds.center().x;
            let mut sides = [bounds, bounds];
            sides[0].upper.x = middle;
            sides[1].lower.x = middle;
            sides.map(|side| (side, index as u32))
        })
        .collect();
    let boxes: Vec<Triangle> = halves.iter().map(|(b, _)| Triangle([b.lower, b.upper, b.lower])).collect();
    let mut tree = build(&boxes, 1);
    for primitive in &mut tree.primitives {
        *primitive = halves[*primitive as usize].1;
    }
    let leaves = |tree: &Tree| {
        let leaf = |node: &Node| (tree.primitives[node.range()].to_vec(), node.bounds());
        let mut leaves: Vec<_> = tree.nodes.iter().filter(|node| node.is_leaf()).map(leaf).collect();
        leaves.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.lower.x.total_cmp(&b.1.lower.x)));
        leaves
    };
    for config in configurations() {
        let (better, report) = optimize(&tree, &blend(&tree, &rays(500, 2)), &config);
        assert!(report.after < report.before);
        assert_eq!(leaves(&better), leaves(&tree));
    }
}

#[test]
fn wide_trees_and_bad_numbers_are_refused() {
    let leaf = Node::leaf(Aabb { lower: Vec3::ZERO, upper: Vec3::ONE }, 0, 1);
    let wide = Node::inner(leaf.bounds(), 1, 3);
    let mut tree = Tree { nodes: vec![wide, leaf, leaf, leaf], primitives: vec![0] };
    let area = AreaMeasure::new(&leaf.bounds().into());
    let refused = run(&mut tree, &area, &Config::default(), &Progress::hidden());
    assert_eq!(refused, Err(OptimizeError::NotBinary { node: 0, children: 3 }));
    let mut tree = build(&soup(5, 1), 1);
    for stage in [
        Stage::Annealing(annealing::Config { start: f64::NAN, ..Default::default() }),
        Stage::Annealing(annealing::Config { end: 0.0, ..Default::default() }),
        Stage::Insertion(insertion::Config { share: -1.0, ..Default::default() }),
        Stage::Reinsertion(reinsertion::Config { share: f64::INFINITY, ..Default::default() }),
        Stage::Treelets(treelets::Config { leaves: 15, ..Default::default() }),
        Stage::Treelets(treelets::Config { leaves: 2, ..Default::default() }),
    ] {
        let refused =
            run(&mut tree, &area, &Config { stages: vec![stage], deadline: None }, &Progress::hidden());
        assert_eq!(refused, Err(OptimizeError::OutOfRange(stage.name())));
    }
}

/// The least T over all trees, by trying them.
fn least(boxes: &[Aabb], p: &mut dyn FnMut(&Aabb) -> f64) -> f64 {
    if boxes.len() == 1 {
        return 0.0;
    }
    let around = boxes.iter().fold(Aabb::EMPTY, |sum, b| sum.union(b));
    let ways = (1..1u32 << (boxes.len() - 1)).map(|way| {
        let side = |right: u32| -> Vec<Aabb> {
            (0..boxes.len()).filter(|&i| way >> i & 1 == right).map(|i| boxes[i]).collect()
        };
        least(&side(0), p) + least(&side(1), p)
    });
    ways.fold(f64::INFINITY, f64::min) + p(&around)
}

#[test]
fn the_optimum_is_the_least_of_all_trees() {
    for seed in 0..20 {
        let boxes: Vec<Aabb> = soup(6, seed).iter().map(Triangle::bounds).collect();
        let leaves: Vec<(Aabb, u32)> = boxes.iter().enumerate().map(|(i, b)| (*b, i as u32)).collect();
        let best = optimum(&leaves, |b| Aabb::from(*b).area() as f64).expect("few leaves");
        let expected = least(&boxes, &mut |b| b.area() as f64);
        assert!((best.cost - expected).abs() < 1e-6 * expected);
        validate(&best.tree, &soup(6, seed), 6).expect("a valid tree");
    }
    assert!(optimum(&[(Aabb::EMPTY, 0); 15], |_| 0.0).is_err());
    assert_eq!(optimum(&[], |_| 0.0).map(|best| best.cost), Ok(0.0));
}

#[test]
fn no_optimiser_goes_below_the_optimum_and_the_best_come_close() {
    let mut excess = [[0.0; 2]; 6];
    let scenes = 100;
    for seed in 0..scenes {
        let triangles = soup(10, 1000 + seed);
        let tree = build(&triangles, 1);
        let leaves: Vec<(Aabb, u32)> =
            triangles.iter().enumerate().map(|(i, t)| (t.bounds(), i as u32)).collect();
        let area = AreaMeasure::new(&tree.nodes[0].bounds().into());
        let blend = blend(&tree, &rays(200, seed));
        let all = blend.whole();
        let limits = [
            optimum(&leaves, |b| area.of(b)).expect("few leaves").cost,
            optimum(&leaves, |b| blend.values(&all, &[*b])[0]).expect("few leaves").cost,
        ];
        for (config, excess) in configurations().iter().zip(&mut excess) {
            let costs = [optimize(&tree, &area, config).1.after, optimize(&tree, &blend, config).1.after];
            for side in 0..2 {
                assert!(
                    costs[side] >= limits[side] * (1.0 - 1e-9),
                    "{config:?}: {} < {}",
                    costs[side],
                    limits[side]
                );
                excess[side] += (costs[side] / limits[side] - 1.0) / scenes as f64;
            }
        }
    }
    println!("mean excess over the optimum, area and blend: {excess:?}");
    for (name, index, most) in
        [("rotations", 0, 0.05), ("annealing", 1, 0.05), ("insertion", 2, 0.1), ("reinsertion", 3, 0.03)]
    {
        assert!(excess[index].iter().all(|&mean| mean < most), "{name}: {:?}", excess[index]);
    }
}
