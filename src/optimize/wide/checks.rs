//! The optimiser of wide trees against counting anew, exhaustive search and brute force.

use super::likelihood::Likelihood;
use super::working::{Below, Node, Prices};
use super::{Config, optimize};
use crate::builder::spatial::Options;
use crate::builder::{self, MAX_DEPTH, Splits};
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::optimize::checks::{poor_tree, rays, triangles};
use crate::progress::Progress;
use crate::traverse::{All, Prepared, PreparedRay, PreparedTriangle, Scratch, Traversal};
use crate::tree::collapse::{self, collapse};
use crate::tree::validate::validate;
use crate::tree::{Tree, TreeView};

fn prices(width: usize, max_leaf: usize) -> Prices {
    Prices { width, max_leaf, visit: 1.0, leaf: 1.2, block: 0.45 }
}

fn built(triangles: &[Triangle], splits: Splits) -> Tree {
    builder::build(triangles, &builder::Config::of(splits), &Progress::hidden()).unwrap()
}

/// What a tree costs, counted from nothing but its nodes.
fn cost(tree: &Tree, rays: &[Ray], weight: f64, prices: &Prices) -> f64 {
    let likelihood = Likelihood::new(rays, weight, &tree.nodes[0].bounds().into());
    let all = likelihood.everything();
    let node = |node: &crate::tree::Node| {
        let bounds = node.bounds().into();
        let p = likelihood.of(&bounds, likelihood.within(&all, &bounds).len());
        if node.is_leaf() { prices.of_leaf(p, node.len()) } else { p * prices.visit }
    };
    tree.nodes.iter().map(node).sum()
}

/// Each triangle that can be hit is in some leaf, and no other in any.
fn assert_complete(tree: &Tree, triangles: &[Triangle]) {
    let mut found = vec![false; triangles.len()];
    tree.primitives.iter().for_each(|&triangle| found[triangle as usize] = true);
    for (triangle, found) in triangles.iter().zip(found) {
        assert_eq!(triangle.is_finite(), found, "{triangle:?}");
    }
}

/// Closest hits and occlusion are those of testing every triangle.
fn assert_answers(tree: &Tree, triangles: &[Triangle], rays: &[Ray]) {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let mut scratch = Scratch::default();
    for ray in rays.iter().map(PreparedRay::new) {
        let each = triangles.iter().zip(0..).filter(|(triangle, _)| triangle.is_finite());
        let hits = each.filter_map(|(&vertices, index)| {
            PreparedTriangle { vertices, index, mask: u32::MAX, instance_mask: u32::MAX }
                .intersect(&ray)
                .map(|t| (t, index))
        });
        let expected = hits.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let found = prepared.closest_hit(Traversal::Odf, &ray, &All, &mut (), &mut scratch);
        // After a spatial split a hit on the cut is moved to the box that it is found in.
        let agrees = match (found, expected) {
            (Some(found), Some((t, _))) => (found.t - t).abs() <= 2e-6 * t.abs(),
            (found, expected) => found.is_none() && expected.is_none(),
        };
        assert!(agrees, "{ray:?}: {found:?} instead of {expected:?}");
        let occluded = prepared.occluder(Traversal::Odf, &ray, &All, &mut (), &mut scratch);
        assert_eq!(occluded.is_some(), expected.is_some());
    }
}

#[test]
fn no_round_makes_a_tree_worse_and_costs_are_those_of_counting_anew() {
    let triangles = triangles(400, 1);
    for splits in [Splits::Sweep, Splits::Spatial(Options { overlap: 0.0, ..Options::default() })] {
        let tree = built(&triangles, splits);
        for rays in [rays(1000, 2), Vec::new()] {
            for (width, max_leaf) in [(2, 4), (4, 8), (8, 16), (8, 1)] {
                let config = Config::new(prices(width, max_leaf));
                let optimized = optimize(tree.view(), &triangles, &rays, &config).unwrap();
                let costs = &optimized.costs;
                assert!(costs.is_sorted_by(|before, after| after <= before), "{costs:?}");
                assert!(costs[costs.len() - 1] < 0.995 * costs[0] || max_leaf == 1, "{width} {costs:?}");
                let anew = cost(&optimized.tree, &rays, config.weight, &config.prices);
                let counted = costs[costs.len() - 1];
                assert!((anew - counted).abs() < 1e-9 * anew, "{width} {max_leaf}: {anew} {counted}");
                assert_complete(&optimized.tree, &triangles);
                let widest = optimized.tree.nodes.iter().filter(|node| !node.is_leaf()).map(|n| n.len());
                assert!(widest.max().unwrap() <= width);
                let largest = optimized.tree.nodes.iter().filter(|node| node.is_leaf()).map(|n| n.len());
                assert!(largest.max().unwrap() <= max_leaf);
                assert_answers(&optimized.tree, &triangles, &rays[..rays.len().min(300)]);
                if splits == Splits::Sweep {
                    assert_eq!(validate(&optimized.tree, &triangles, MAX_DEPTH), Ok(()));
                }
            }
        }
    }
}

#[test]
fn the_collapse_is_that_of_the_binary_programme() {
    let triangles = triangles(500, 6);
    let tree = built(&triangles, Splits::Sweep);
    let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
    for (width, max_leaf) in [(4, 1), (8, 8)] {
        // Leaves cost nothing themselves in that programme.
        let prices = Prices { leaf: 0.0, ..prices(width, max_leaf) };
        let config = collapse::Config { max_leaf, block: prices.block, ..collapse::Config::vector(width) };
        let expected = collapse(tree.view(), area, &config).unwrap();
        let ours = optimize(tree.view(), &triangles, &[], &Config { rounds: 0, ..Config::new(prices) });
        let expected = cost(&expected, &[], 0.0, &prices);
        let found = ours.unwrap().costs[0];
        assert!((found - expected).abs() < 1e-5 * expected, "{found} {expected}");
    }
}

#[test]
fn wide_trees_are_read_as_they_are() {
    let triangles = triangles(300, 7);
    let tree = built(&triangles, Splits::Sweep);
    let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
    let wide = collapse(tree.view(), area, &collapse::Config::vector(8)).unwrap();
    assert_eq!(Node::read(wide.view(), &triangles).written(), wide);
    let refused = optimize(wide.view(), &triangles, &[], &Config::new(prices(4, 8)));
    assert!(refused.unwrap_err().to_string().contains("more than the 4"), "too wide");
    let rays = rays(1000, 3);
    let better = optimize(wide.view(), &triangles, &rays, &Config::new(prices(8, 8))).unwrap();
    assert!((better.costs[0] - cost(&wide, &rays, super::WEIGHT, &prices(8, 8))).abs() < 1e-9);
    assert!(better.costs.last() < better.costs.first());
    assert_eq!(validate(&better.tree, &triangles, MAX_DEPTH), Ok(()));
}

#[test]
fn the_tree_does_not_depend_on_threads() {
    let triangles = triangles(600, 3);
    let tree = built(&triangles, Splits::Sweep);
    let rays = rays(2000, 4);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| optimize(tree.view(), &triangles, &rays, &Config::new(prices(8, 16))).unwrap())
    };
    let one = on(1);
    assert!(one == on(2) && one == on(3));
}

/// The least cost of all trees over triangles, by trying every partition of every set of them into children.
fn optimum(boxes: &[Aabb], likelihood: &Likelihood, prices: &Prices) -> f64 {
    let all = likelihood.everything();
    let mut best = vec![f64::INFINITY; 1 << boxes.len()];
    for set in 1usize..1 << boxes.len() {
        let members = (0..boxes.len()).filter(|member| set >> member & 1 == 1);
        let bounds: PaddedAabb =
            members.fold(Aabb::EMPTY, |bounds, member| bounds.union(&boxes[member])).into();
        let p = likelihood.of(&bounds, likelihood.within(&all, &bounds).len());
        let count = set.count_ones() as usize;
        if count <= prices.max_leaf {
            best[set] = prices.of_leaf(p, count);
        }
        // Children: the first holds the lowest member, so that each partition comes once.
        fn least(rest: usize, whole: usize, room: usize, best: &[f64]) -> f64 {
            if rest == 0 {
                return 0.0;
            }
            if room == 0 {
                return f64::INFINITY;
            }
            let lowest = rest & rest.wrapping_neg();
            let others = rest ^ lowest;
            let (mut sub, mut found) = (others, f64::INFINITY);
            loop {
                let child = sub | lowest;
                if child != whole {
                    found = found.min(best[child] + least(rest ^ child, whole, room - 1, best));
                }
                if sub == 0 {
                    return found;
                }
                sub = (sub - 1) & others;
            }
        }
        if count > 1 {
            best[set] = best[set].min(p * prices.visit + least(set, set, prices.width, &best));
        }
    }
    best[best.len() - 1]
}

#[test]
fn small_trees_are_the_best_of_all_or_nearly() {
    let mut reached = 0;
    let mut tried = 0;
    for seed in 0..12 {
        for (count, width, max_leaf) in [(3, 2, 2), (5, 3, 2), (6, 4, 4), (7, 8, 1), (7, 3, 3)] {
            let triangles = triangles(count, seed);
            let rays = rays(200, seed);
            let config = Config { rounds: 4, ..Config::new(prices(width, max_leaf)) };
            let tree = poor_tree(&triangles);
            let found = optimize(tree.view(), &triangles, &rays, &config).unwrap();
            let likelihood = Likelihood::new(&rays, config.weight, &tree.nodes[0].bounds().into());
            let boxes: Vec<Aabb> = triangles.iter().map(Triangle::bounds).collect();
            let best = optimum(&boxes, &likelihood, &config.prices);
            let cost = found.costs[found.costs.len() - 1];
            assert!(cost >= best * (1.0 - 1e-9), "{cost} is less than the least, {best}");
            assert!(cost <= best * 1.10, "{count} {width} {max_leaf}: {cost}, the least is {best}");
            reached += (cost <= best * (1.0 + 1e-9)) as usize;
            tried += 1;
        }
    }
    assert!(reached * 10 >= tried * 7, "{reached} of {tried}");
}

#[test]
fn nothing_degenerate_does_harm() {
    let one_way: Vec<Ray> = (0..100)
        .map(|n| Ray {
            origin: Vec3::new(-1.0, 0.01 * n as f32, 0.5),
            tnear: 0.0,
            direction: Vec3::X,
            tfar: 5.0,
        })
        .collect();
    let odd = [f32::NAN, f32::INFINITY, 0.0, 1e38].map(|value| Ray {
        origin: Vec3::splat(value),
        tnear: value,
        direction: Vec3::new(value, 1.0, 0.0),
        tfar: value,
    });
    let same = vec![triangles(1, 1)[0]; 200];
    let mut holes = triangles(30, 2);
    for (place, triangle) in holes.iter_mut().enumerate().filter(|(place, _)| place % 3 == 0) {
        triangle.0[place % 2].y = if place % 2 == 0 { f32::NAN } else { f32::INFINITY };
    }
    let flat: Vec<Triangle> = triangles(50, 3).iter().map(|t| Triangle(t.0.map(|v| v * Vec3::X))).collect();
    let huge: Vec<Triangle> = triangles(50, 4).iter().map(|t| Triangle(t.0.map(|v| v * 1e37))).collect();
    let mut scenes = vec![same, holes, flat, huge];
    scenes.extend((0..4).map(|count| triangles(count, 5)));
    for triangles in &scenes {
        for rays in [&one_way[..], &odd, &[]] {
            for (width, max_leaf) in [(2, 1), (8, 16)] {
                let tree = built(triangles, Splits::Sweep);
                let config = Config::new(prices(width, max_leaf));
                let optimized = optimize(tree.view(), triangles, rays, &config).unwrap();
                assert_eq!(validate(&optimized.tree, triangles, MAX_DEPTH), Ok(()));
                assert!(optimized.costs.is_sorted_by(|before, after| after <= before));
                assert_answers(&optimized.tree, triangles, &one_way);
            }
        }
    }
}

#[test]
fn what_is_out_of_range_is_refused() {
    let tree = built(&triangles(5, 1), Splits::Sweep);
    let refused = |width, max_leaf| {
        optimize(tree.view(), &triangles(5, 1), &[], &Config::new(prices(width, max_leaf))).is_err()
    };
    assert!(refused(1, 4) && refused(9, 4) && refused(8, 0) && refused(8, 65) && !refused(8, 64));
}

#[test]
fn doubles_in_one_leaf_become_one_with_the_box_of_both() {
    // The halves of one triangle, far from a second.
    let triangles = triangles(2, 8);
    let [mut left, mut right] = [triangles[0].bounds(); 2];
    left.upper.x = left.center().x;
    right.lower.x = left.upper.x;
    let leaf = |bounds: Aabb, first| crate::tree::Node::leaf(bounds, first, 1);
    let far = triangles[1].bounds();
    let near = left.union(&right);
    let nodes = vec![
        crate::tree::Node::inner(near.union(&far), 1, 2),
        crate::tree::Node::inner(near.union(&far), 3, 2),
        leaf(left, 2),
        leaf(right, 0),
        leaf(far, 1),
    ];
    let tree = TreeView { nodes: &nodes, primitives: &[0, 1, 0] };
    let optimized = optimize(tree, &triangles, &[], &Config::new(prices(8, 4))).unwrap();
    let holding: Vec<_> = optimized
        .tree
        .nodes
        .iter()
        .filter(|node| node.is_leaf() && optimized.tree.primitives[node.range()].contains(&0))
        .collect();
    assert_eq!(holding.len(), 1, "{optimized:?}");
    assert!(holding[0].bounds().contains(&near) && optimized.tree.primitives.len() == 2);
}

#[test]
fn boxes_of_nodes_hold_their_references() {
    fn check(node: &Node) {
        let inside = |outer: &PaddedAabb, inner: &PaddedAabb| Aabb::from(*outer).contains(&(*inner).into());
        match &node.below {
            Below::Inner(children) => {
                assert!(children.iter().all(|child| inside(&node.bounds, &child.bounds)));
                children.iter().for_each(check);
            }
            Below::Leaf(references) => {
                assert!(references.iter().all(|reference| inside(&node.bounds, &reference.bounds)));
            }
        }
    }
    let triangles = triangles(300, 9);
    let tree = built(&triangles, Splits::Spatial(Options { overlap: 0.0, ..Options::default() }));
    check(&Node::read(tree.view(), &triangles));
}
