//! Trees from recorded rays: counts against brute force, the same bytes for any number of threads, degenerate rays.

use embree_trace::builder::reference::References;
use embree_trace::builder::{Config, Splits};
use embree_trace::experiment::measure::{area_tree, ray_tree};
use embree_trace::experiment::shape::sphere;
use embree_trace::geometry::padded::PaddedAabb;
use embree_trace::geometry::{Aabb, Ray, Vec3};
use embree_trace::probability::blend::Blend;
use embree_trace::probability::rays::{Count, RaySet, Rays};
use embree_trace::probability::shrunk::Shrunk;
use embree_trace::probability::{Cuts, Probability, Scores, Side};
use embree_trace::random::Random;
use embree_trace::traverse::PreparedRay;
use embree_trace::tree::validate::validate;

fn rays(count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random::new(seed);
    let mut point = |size: f64| {
        let [x, y, z] = [0; 3].map(|_| size * random.signed());
        Vec3::new(x as f32, y as f32, z as f32)
    };
    let ray = |index| {
        let tfar = if index % 2 == 0 { f32::INFINITY } else { 1.0 };
        Ray { origin: point(150.0), tnear: 0.0, direction: point(100.0), tfar }
    };
    (0..count).map(ray).collect()
}

/// Left and right sides that are the same boxes.
struct Growing<'a>(&'a [Aabb]);

impl Cuts for Growing<'_> {
    fn candidates(&self) -> usize {
        self.0.len()
    }

    fn left(&self) -> impl Iterator<Item = Side> {
        self.0.iter().map(|&bounds| Side { primitives: 1, bounds: bounds.into() })
    }

    fn right(&self) -> impl Iterator<Item = Side> {
        self.left()
    }
}

#[test]
fn states_and_candidates_count_what_overlaps() {
    // More rays than one thread takes, so that both paths are counted.
    for count in [50, 20_000] {
        let rays = rays(count, 9);
        let set = RaySet::of_rays(rays.iter().copied());
        let scene = Aabb { lower: Vec3::splat(-100.0), upper: Vec3::splat(100.0) };
        let probability = Rays::new(&set, &scene.into(), Count::PLAIN);
        let truth = |bounds: &Aabb| {
            let hit = |ray: &&Ray| PreparedRay::new(ray).entry(bounds, ray.tfar).is_some();
            rays.iter().filter(hit).count() as f32
        };
        let root = probability.root(&scene.into());
        assert_eq!(probability.node(&root, &scene.into()), truth(&scene));
        let boxes: Vec<Aabb> = (1..=20)
            .map(|i| Aabb { lower: scene.lower, upper: Vec3::new(10.0 * i as f32 - 100.0, 100.0, 100.0) })
            .collect();
        // Right sides, from the last candidate to the first, are the same boxes.
        let [mut left, mut right] = [0; 2].map(|_| vec![0.0; boxes.len()]);
        let mut scores = [Scores { left: &mut left, right: &mut right }];
        probability.score(&root, 0, &[Growing(&boxes)], &mut scores);
        right.reverse();
        assert_eq!(left, boxes.iter().map(truth).collect::<Vec<f32>>());
        assert_eq!(left, right);
        let (left, right) = (boxes[4], Aabb { lower: Vec3::ZERO, upper: scene.upper });
        let children = [&left, &right].map(|&bounds| PaddedAabb::from(bounds));
        let [left_state, right_state] = probability.split(root, children.each_ref().map(Some));
        assert_eq!(left_state.count() as f32, truth(&left));
        assert_eq!(right_state.count() as f32, truth(&right));
    }
}

/// With very many rays a part is counted: near the truth, and in the measure of the node's own P.
#[test]
fn a_part_of_very_many_rays_says_what_all_do() {
    let rays = rays(40_000, 3);
    let set = RaySet::of_rays(rays.iter().copied());
    let scene = Aabb { lower: Vec3::splat(-100.0), upper: Vec3::splat(100.0) };
    let boxes: Vec<Aabb> = (1..=20)
        .map(|i| Aabb { lower: scene.lower, upper: Vec3::new(10.0 * i as f32 - 100.0, 100.0, 100.0) })
        .collect();
    let score = |measure: Count| {
        let probability = Rays::new(&set, &scene.into(), measure);
        let root = probability.root(&scene.into());
        let [mut left, mut right] = [0; 2].map(|_| vec![0.0; boxes.len()]);
        let mut scores = [Scores { left: &mut left, right: &mut right }];
        probability.score(&root, 0, &[Growing(&boxes)], &mut scores);
        left
    };
    let all = score(Count::PLAIN);
    for (part, all) in score(Count::default()).into_iter().zip(&all) {
        // Five standard deviations of a share among 4096.
        assert!((part - all).abs() < 5.0 * 0.5 / 4096f32.sqrt() * 40_000.0, "{part} {all}");
    }
    assert!(all.is_sorted() && all[0] < all[19]);
}

#[test]
fn trees_are_valid_and_the_same_for_any_number_of_threads() {
    let triangles = sphere();
    let set = RaySet::of_rays(rays(20_000, 4));
    for splits in [Config::default().splits, Splits::Sweep] {
        let config = Config { splits, ..Config::default() };
        let build = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let trees = pool.install(|| {
                [
                    ray_tree(&triangles, &set, Count::default(), &config),
                    ray_tree(&triangles, &set, Blend::new(0.9).unwrap(), &config),
                    ray_tree(&triangles, &set, Shrunk::new(1.0).unwrap(), &config),
                ]
            });
            trees.map(Result::unwrap)
        };
        let one = build(1);
        assert_eq!(one, build(4));
        for tree in &one {
            validate(tree, &triangles, 200).unwrap();
        }
    }
}

#[test]
fn without_a_ray_the_tree_is_that_of_sah() {
    let triangles = sphere();
    let nowhere = Ray { origin: Vec3::splat(1e4), tnear: 0.0, direction: Vec3::ONE, tfar: 1.0 };
    for splits in [Config::default().splits, Splits::Sweep] {
        let config = Config { splits, ..Config::default() };
        let area = area_tree(&triangles, &config).unwrap();
        for rays in [vec![], vec![nowhere]] {
            let tree = ray_tree(&triangles, &RaySet::of_rays(rays), Count::default(), &config).unwrap();
            let cost = |tree: &embree_trace::tree::Tree| {
                embree_trace::tree::statistics::sah_cost(tree.view(), 1.0, 1.0)
            };
            assert!((cost(&tree) / cost(&area) - 1.0).abs() < 0.01, "{} {}", cost(&tree), cost(&area));
        }
    }
}

#[test]
fn odd_rays_make_valid_trees() {
    let triangles = sphere();
    let ray = |origin: f32, direction: Vec3, tnear: f32, tfar: f32| Ray {
        origin: Vec3::splat(origin),
        tnear,
        direction,
        tfar,
    };
    for odd in [
        ray(0.0, Vec3::ZERO, 0.0, f32::INFINITY),
        ray(f32::NAN, Vec3::ONE, 0.0, 1.0),
        ray(0.0, Vec3::splat(f32::NAN), 0.0, 1.0),
        ray(0.0, Vec3::splat(f32::INFINITY), 0.0, 1.0),
        ray(0.0, Vec3::X, f32::NEG_INFINITY, f32::INFINITY),
        ray(f32::MAX, Vec3::splat(-1e-40), 0.0, f32::MAX),
        ray(0.0, Vec3::ONE, 2.0, 1.0),
        ray(0.0, Vec3::X, f32::NAN, f32::NAN),
    ] {
        let set = RaySet::of_rays(vec![odd; 300]);
        for splits in [Config::default().splits, Splits::Sweep] {
            let config = Config { splits, ..Config::default() };
            for tree in [
                ray_tree(&triangles, &set, Count::PLAIN, &config),
                ray_tree(&triangles, &set, Blend::new(1.0).unwrap(), &config),
                ray_tree(&triangles, &set, Shrunk::new(1.0).unwrap(), &config),
            ] {
                validate(&tree.unwrap(), &triangles, 200).unwrap();
            }
        }
    }
    // Nothing to build from, but rays all the same.
    let set = RaySet::of_rays(rays(10, 1));
    assert_eq!(References::of(&[]).list.len(), 0);
    assert_eq!(ray_tree(&[], &set, Count::default(), &Config::default()).unwrap().nodes.len(), 1);
}
