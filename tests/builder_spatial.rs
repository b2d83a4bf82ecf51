//! Spatial splits: no part of a triangle is lost, no ray either, the budget is kept, threads do not matter, and it pays.

mod soup;

use embree_trace::builder::spatial::Options;
use embree_trace::builder::{self, Config, MAX_DEPTH, Splits};
use embree_trace::files::OutputFile;
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::geometry::{Aabb, DVec3, Ray, Triangle, Vec3};
use embree_trace::optimize::{Stage, reinsertion};
use embree_trace::progress::Progress;
use embree_trace::recipe::{Heuristic, Recipe};
use embree_trace::traverse::{All, Prepared, PreparedRay, Scratch, Traversal};
use embree_trace::tree::statistics::{Statistics, sah_cost};
use embree_trace::tree::{Node, Tree};
use soup::{Random, degenerate, soup};
use std::collections::HashSet;

fn spatial(max_duplication: f64, overlap: f64) -> Config {
    Config { splits: Splits::Spatial(Options { max_duplication, overlap }), ..Config::default() }
}

/// One configuration of every kind.
fn configurations() -> Vec<Config> {
    vec![
        spatial(0.5, 1e-5),
        spatial(4.0, 0.0),
        spatial(0.0, 0.0),
        Config { max_leaf: 4, ..spatial(2.0, 0.0) },
        Config { alpha: 0.8, max_leaf: 9, ..spatial(0.3, 1e-3) },
    ]
}

fn build(triangles: &[Triangle], config: &Config) -> Tree {
    builder::build(triangles, config, &Progress::hidden()).expect("the configuration is valid")
}

/// Long thin triangles in all directions: the scene that boxes are worst for.
fn needles(count: usize, seed: u64) -> Vec<Triangle> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| {
            let at = random.vector();
            let along = 0.5 * (random.vector() - 0.5);
            Triangle([at, at + along, at + 0.5 * along + 0.002 * random.vector()])
        })
        .collect()
}

/// Small triangles, and long ones all through them: what a building is like.
fn beams(small: usize, long: usize, seed: u64) -> Vec<Triangle> {
    let mut random = Random::new(seed);
    let mut triangles = soup(small, seed + 1);
    triangles.extend((0..long).map(|_| {
        let (from, to) = (random.vector(), random.vector());
        Triangle([from, to, to + 0.01 * random.vector()])
    }));
    triangles
}

/// Scenes whose splits cut triangles.
fn scenes() -> Vec<(&'static str, Vec<Triangle>)> {
    let grid = |v: Vec3| (v * 4.0).round();
    let on_grid = needles(400, 3).iter().map(|t| Triangle(t.0.map(grid))).collect();
    let mut twice = needles(150, 4);
    twice.extend_from_within(..);
    // Large walls that touch planes exactly, with small things between them.
    let mut room = vec![];
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let corner = |u: f32, v: f32| {
                let mut point = Vec3::ZERO;
                (point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]) = (side, u, v);
                point
            };
            room.push(Triangle([corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)]));
            room.push(Triangle([corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]));
        }
    }
    room.extend(soup(400, 5));
    vec![
        ("needles", needles(600, 1)),
        ("few needles", needles(7, 2)),
        ("needles on a grid", on_grid),
        ("needles twice", twice),
        ("room", room),
        ("beams", beams(600, 40, 7)),
        ("soup", soup(1000, 6)),
    ]
}

/// Structure, boxes and content, without trusting what built it; returns the boxes of each triangle's leaves.
fn check(tree: &Tree, triangles: &[Triangle], config: &Config, what: &str) -> Vec<Vec<Aabb>> {
    let statistics = Statistics::of(tree.view());
    assert!(
        statistics.depth <= MAX_DEPTH && statistics.max_leaf <= config.max_leaf,
        "{what}: {statistics:?}"
    );
    let mut boxes = vec![Vec::new(); triangles.len()];
    let mut parents = vec![0; tree.nodes.len()];
    let mut used = vec![false; tree.primitives.len()];
    for (index, node) in tree.nodes.iter().enumerate() {
        if node.is_leaf() {
            for entry in node.range() {
                assert!(!std::mem::replace(&mut used[entry], true), "{what}: entry {entry} in two leaves");
            }
            let held: HashSet<u32> = tree.primitives[node.range()].iter().copied().collect();
            assert_eq!(held.len(), node.len(), "{what}: a triangle twice in one leaf");
            for triangle in held {
                boxes[triangle as usize].push(node.bounds());
            }
        } else {
            assert_eq!(node.len(), 2, "{what}");
            assert!(node.first as usize > index, "{what}");
            for child in node.range() {
                parents[child] += 1;
                assert!(node.bounds().contains(&tree.nodes[child].bounds()), "{what}: node {child}");
            }
        }
    }
    assert!(parents[1..].iter().all(|&count| count == 1) && used.iter().all(|&used| used), "{what}");
    for (index, triangle) in triangles.iter().enumerate() {
        assert_eq!(boxes[index].is_empty(), !triangle.is_finite(), "{what}: triangle {index}");
        assert!(
            config.max_leaf > 1 || boxes[index].iter().all(|part| triangle.bounds().contains(part)),
            "{what}"
        );
    }
    boxes
}

fn holds(bounds: &Aabb, point: DVec3, slack: f64) -> bool {
    (bounds.lower.as_dvec3() - slack).cmple(point).all() && point.cmple(bounds.upper.as_dvec3() + slack).all()
}

/// Every point of every triangle is in a leaf that holds the triangle.
fn check_cover(triangles: &[Triangle], boxes: &[Vec<Aabb>], what: &str) {
    let mut random = Random::new(77);
    for (triangle, boxes) in triangles.iter().zip(boxes).filter(|(triangle, _)| triangle.is_finite()) {
        let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
        let largest = [a, b, c].iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        for point in 0..40 {
            let (u, v) = (random.unit() as f64, random.unit() as f64);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let at = match point {
                0 => a,
                1 => b,
                2 => c,
                3..10 => a + u * (b - a),
                10..17 => b + u * (c - b),
                _ => a + u * (b - a) + v * (c - a),
            };
            // The point itself is rounded.
            let held = boxes.iter().any(|bounds| holds(bounds, at, 8.0 * f64::EPSILON * largest));
            assert!(held, "{what}: {at} of {triangle:?} is in none of {boxes:?}");
        }
    }
}

#[test]
fn all_of_every_triangle_is_in_the_leaves() {
    for (name, triangles) in scenes() {
        for config in configurations() {
            let tree = build(&triangles, &config);
            let boxes = check(&tree, &triangles, &config, name);
            check_cover(&triangles, &boxes, name);
        }
    }
}

#[test]
fn degenerate_triangles_lose_nothing() {
    for (name, triangles) in degenerate() {
        for config in configurations() {
            let tree = build(&triangles, &config);
            let boxes = check(&tree, &triangles, &config, &name);
            check_cover(&triangles, &boxes, &name);
        }
    }
    for triangles in [&[][..], &[Triangle([Vec3::NAN; 3])]] {
        let tree = build(triangles, &spatial(1.0, 0.0));
        assert!(tree.nodes.len() == 1 && tree.nodes[0].is_empty() && tree.primitives.is_empty());
    }
}

#[test]
fn rays_find_what_brute_force_finds() {
    let mut random = Random::new(8);
    let mut hits = 0;
    for (name, triangles) in scenes() {
        let all = Tree {
            nodes: vec![Node::leaf(
                triangles.iter().fold(Aabb::EMPTY, |sum, t| sum.union(&t.bounds())),
                0,
                triangles.len() as u32,
            )],
            primitives: (0..triangles.len() as u32).collect(),
        };
        let all = Prepared::new(all.view(), &triangles, &[]);
        for config in configurations() {
            let prepared = Prepared::new(build(&triangles, &config).view(), &triangles, &[]);
            let mut scratch = Scratch::default();
            for _ in 0..300 {
                // From anywhere to a point of a triangle, sometimes along an axis.
                let target = triangles[random.below(triangles.len() as u64) as usize].centroid();
                let mut direction = target - (random.vector() * 3.0 - 1.0);
                if random.below(4) == 0 {
                    direction *= [Vec3::X, Vec3::Y, Vec3::Z][random.below(3) as usize];
                }
                let ray = Ray { origin: target - direction, tnear: 0.0, direction, tfar: f32::INFINITY };
                let ray = PreparedRay::new(&ray);
                let expected = all.closest_hit(Traversal::Odf, &ray, &All, &mut (), &mut scratch);
                for traversal in [Traversal::Odf, Traversal::RayOrder] {
                    let found = prepared.closest_hit(traversal, &ray, &All, &mut (), &mut scratch);
                    let key = |hit: Option<embree_trace::traverse::Hit>| hit.map(|hit| (hit.t, hit.triangle));
                    assert_eq!(key(found), key(expected), "{name}, {config:?}");
                    let occluded = prepared.occluder(traversal, &ray, &All, &mut (), &mut scratch);
                    assert_eq!(occluded.is_some(), expected.is_some(), "{name}, {config:?}");
                }
                hits += expected.is_some() as u32;
            }
        }
    }
    assert!(hits > 2000, "{hits}");
}

#[test]
fn the_budget_is_kept_and_spent() {
    let triangles = beams(3000, 100, 12);
    let mut before = 0;
    for max_duplication in [0.0, 0.01, 0.1, 0.5, 2.0] {
        let entries = build(&triangles, &spatial(max_duplication, 0.0)).primitives.len();
        let most = 3100 + (3100.0 * max_duplication) as usize;
        assert!((before..=most).contains(&entries), "{entries} of {most}, after {before}");
        before = entries;
    }
    assert!(before > 3500, "beams are cut where that is allowed: {before}");
    assert_eq!(
        build(&triangles, &spatial(2.0, 1e6)).primitives.len(),
        3100,
        "overlaps this small are left alone"
    );
}

#[test]
fn the_number_of_threads_does_not_matter() {
    // Enough for every parallel path.
    let mut triangles = needles(70_000, 13);
    triangles.extend(soup(20_001, 14));
    triangles[5].0[1].y = f32::NAN;
    for config in [spatial(0.5, 1e-5), Config { max_leaf: 8, ..spatial(0.2, 0.0) }] {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let tree = pool.install(|| build(&triangles, &config));
            (bytemuck::cast_slice::<Node, u8>(&tree.nodes).to_vec(), tree.primitives)
        };
        let one = on(1);
        for threads in [2, 3] {
            assert!(on(threads) == one, "{threads} threads, {config:?}");
        }
    }
}

#[test]
fn cutting_pays_where_triangles_are_long_and_costs_nothing_elsewhere() {
    let cost = |triangles: &[Triangle], config| sah_cost(build(triangles, &config).view(), 0.6, 1.0);
    let sweep = Config { splits: Splits::Sweep, ..Config::default() };
    let long = beams(5000, 200, 15);
    let (before, after) = (cost(&long, sweep), cost(&long, spatial(1.0, 1e-5)));
    assert!(after < 0.8 * before, "{after} {before}");
    let needles = needles(5000, 15);
    assert!(cost(&needles, spatial(1.0, 1e-5)) <= 1.01 * cost(&needles, Config::default()));
    let small = soup(5000, 16);
    let (before, after) = (cost(&small, Config::default()), cost(&small, spatial(1.0, 1e-5)));
    assert!(after < 1.02 * before, "{after} {before}");
}

#[test]
fn optimised_trees_with_merged_leaves_are_whole_and_cheaper() {
    let stages = vec![Stage::Reinsertion(reinsertion::Config::default())];
    let (mut cheaper, mut fewer) = (0, 0);
    for (name, triangles) in scenes() {
        let builder = Config { max_leaf: 4, ..spatial(1.0, 0.0) };
        let recipe = Recipe { heuristic: Heuristic::Sah, builder, stages: stages.clone(), budget: None };
        let optimised = recipe.make(&triangles, &[], &Progress::hidden()).expect("a valid recipe").tree;
        let boxes = check(&optimised, &triangles, &builder, name);
        check_cover(&triangles, &boxes, name);
        let built = build(&triangles, &builder);
        let cost = |tree: &Tree| sah_cost(tree.view(), builder.c_i, builder.c_p);
        assert!(cost(&optimised) <= cost(&built) * (1.0 + 1e-6), "{name}");
        cheaper += (cost(&optimised) < 0.99 * cost(&built)) as usize;
        fewer += (optimised.nodes.len() < built.nodes.len()) as usize;
    }
    assert!(cheaper > 1, "moving subtrees pays");
    assert!(fewer > 1, "leaves are merged where moves made that pay");
}

#[test]
fn files_say_that_triangles_were_cut_and_pass_verification() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, triangles) in scenes() {
        let tree = build(&triangles, &spatial(1.0, 0.0));
        let path = folder.path().join("tree.bvh");
        let mut file = OutputFile::create(&path).expect("a file");
        let contents = Contents {
            tree: tree.view(),
            triangles: &triangles,
            geometries: &[],
            order: None,
            meta: None,
            flags: flag::SPATIAL_SPLITS,
            producer: "test",
        };
        bvh::write(&mut file, &contents).expect("written");
        file.commit().expect("committed");
        let bytes = std::fs::read(&path).expect("read");
        let verified = Bvh::parse(&bytes).and_then(|bvh| bvh.verify());
        let duplicates = tree.primitives.len() - triangles.len();
        assert_eq!(verified.map(|verified| verified.duplicates).ok(), Some(duplicates), "{name}");
    }
}

#[test]
fn options_out_of_range_are_refused() {
    for (max_duplication, overlap) in
        [(-0.1, 0.0), (16.0, 0.0), (f64::NAN, 0.0), (1.0, -1.0), (1.0, f64::INFINITY), (1.0, f64::NAN)]
    {
        let config = spatial(max_duplication, overlap);
        let error = builder::build(&soup(3, 0), &config, &Progress::hidden()).expect_err("out of range");
        assert!(!error.to_string().contains('\n'));
    }
}
