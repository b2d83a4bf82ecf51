//! Work laid out over triangles and pixels, two trees against each other, and a tree as a diagram.

use super::compare_support::files::IMAGE;
use super::{COSTS, Scene, asked, nanoseconds, price, source};
use embree_trace::explore::count::Counted;
use embree_trace::explore::diagram::{Diagram, Layout, Shown, Sunburst};
use embree_trace::explore::heat::{PixelWork, per_pixel, per_triangle};
use embree_trace::explore::rays::Kept;
use embree_trace::explore::shares::{Measure, Shares};
use embree_trace::explore::versus::{Contrast, Side, Versus};
use embree_trace::explore::walk::Walk;
use embree_trace::format::rays::NO_PATH;
use embree_trace::progress::Progress;
use embree_trace::replay::pixels::ImageSize;
use embree_trace::traverse::{Counts, Link, Observer, Prepared, PreparedTriangle, Scratch, Traversal};
use embree_trace::tree::Tree;

fn shares(scene: &Scene, tree: &Tree, walk: &Walk, prepared: &Prepared) -> Shares {
    let rays = scene.rays();
    let source = source(&rays, "", u64::MAX);
    let counted = Counted::of(walk, &asked(tree, prepared, Traversal::Odf), &source, &Progress::hidden());
    Shares::of(walk, counted.expect("whole"), price(tree), COSTS)
}

/// All queries, as they are asked again.
fn queries(scene: &Scene) -> Vec<Kept> {
    let mut kept = Vec::new();
    let choice = super::choice("");
    let keep = |queries: &[embree_trace::replay::query::Query]| kept.extend(queries.iter().map(Kept::from));
    choice.for_each_chunk(&scene.rays(), keep).expect("whole");
    kept
}

/// Lays what one query spends out over the triangles, step by step.
struct Laid<'a> {
    walk: &'a Walk<'a>,
    occlusion: bool,
    leaf: u32,
    expected: &'a mut [f64],
}

impl Laid<'_> {
    fn spend(&mut self, node: u32, counts: Counts) {
        let below = self.walk.triangles(node);
        let part = nanoseconds(self.occlusion, &counts) / below.len() as f64;
        below.iter().for_each(|&triangle| self.expected[triangle as usize] += part);
    }
}

impl Observer for Laid<'_> {
    fn inner(&mut self, node: &Link) {
        self.spend(node.node, Counts { node_visits: 1, ..Counts::default() });
    }

    fn leaf(&mut self, leaf: &Link) {
        self.leaf = leaf.node;
        self.spend(leaf.node, Counts { leaf_visits: 1, ..Counts::default() });
    }

    fn primitives(&mut self, _triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        self.spend(self.leaf, Counts { block_tests: 1, ..Counts::default() });
    }
}

#[test]
fn costs_of_triangles_are_those_of_each_query_laid_out_one_by_one() {
    let scene = Scene::new(300, 60);
    for tree in scene.trees() {
        let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(&tree));
        let shares = shares(&scene, &tree, &walk, &prepared);
        let costs = per_triangle(&walk, &shares);
        let mut expected = vec![0.0; scene.triangles.len()];
        for query in queries(&scene) {
            let occlusion = query.record.is_occlusion();
            let mut laid = Laid { walk: &walk, occlusion, leaf: 0, expected: &mut expected };
            asked(&tree, &prepared, Traversal::Odf).ask(&query.query(), &mut laid, &mut Scratch::default());
        }
        for (cost, expected) in costs.iter().zip(&expected) {
            assert!((cost - expected).abs() < 1e-6 * expected, "{cost} {expected}");
        }
        let total = 300.0 * shares.mean_cost();
        assert!((costs.iter().sum::<f64>() - total).abs() < 1e-6 * total);
    }
}

#[test]
fn a_triangle_in_several_leaves_bears_its_part_in_each() {
    // As spatial splits make it: triangle 0 in both leaves.
    use embree_trace::tree::Node;
    let scene = Scene::new(200, 50);
    let bounds = scene.trees()[0].nodes[0].bounds();
    let nodes = vec![Node::inner(bounds, 1, 2), Node::leaf(bounds, 0, 3), Node::leaf(bounds, 3, 1)];
    let tree = Tree { nodes, primitives: vec![0, 1, 2, 0] };
    let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(&tree));
    let shares = shares(&scene, &tree, &walk, &prepared);
    let costs = per_triangle(&walk, &shares);
    let total = 200.0 * shares.mean_cost();
    assert!(total > 0.0 && (costs.iter().sum::<f64>() - total).abs() < 1e-6 * total);
    assert!(costs[0] > 1.2 * costs[1] && costs[1] == costs[2] && costs[3] == 0.0);
    let versus = Versus::new(&walk, [&costs, &costs]);
    let Contrast { shares: [both, _], .. } = versus.contrast(&walk, 0);
    assert!((both - 1.0).abs() < 1e-9);
}

#[test]
fn pixels_have_the_costs_of_their_queries() {
    let scene = Scene::new(700, 60);
    let tree = &scene.trees()[3];
    let (prepared, rays) = (scene.prepared(tree), scene.rays());
    let asked = asked(tree, &prepared, Traversal::RayOrder);
    let size = ImageSize::new(IMAGE[0], IMAGE[1]).expect("small");
    let found = per_pixel(&asked, &source(&rays, "", u64::MAX), size, &COSTS, &Progress::hidden());
    let PixelWork { costs, gammas, sampled, .. } = found.expect("whole");
    let (mut expected, mut tests) = (vec![0.0; 16 * 12], vec![0.0; 16 * 12]);
    for query in queries(&scene) {
        let mut counts = Counts::default();
        asked.ask(&query.query(), &mut counts, &mut Scratch::default());
        assert_ne!(query.record.path, NO_PATH);
        expected[query.record.path as usize] += nanoseconds(query.record.is_occlusion(), &counts);
        tests[query.record.path as usize] += COSTS.gamma(&counts);
    }
    // Each query is rounded to 1/1024 ns.
    assert!(costs.iter().zip(&expected).all(|(cost, expected)| (cost - expected).abs() < 0.05));
    assert!(gammas.iter().zip(&tests).all(|(gamma, expected)| (gamma - expected).abs() < 1e-6));
    assert_eq!((sampled.taken, sampled.looked_at), (700, 700));
}

#[test]
fn where_a_tree_is_dearer_is_found() {
    let scene = Scene::new(1, 1);
    for tree in scene.trees() {
        let walk = Walk::new(tree.view(), scene.triangles.len());
        let count = scene.triangles.len();
        let even = vec![1.0; count];
        let same = Versus::new(&walk, [&even, &even]);
        assert!(same.dearest(&walk, Side::First, 0.0001).is_empty());
        // Every inner node in turn is made dear in one of the trees.
        let inner = (1..tree.nodes.len() as u32).filter(|&node| !tree.nodes[node as usize].is_leaf());
        for node in inner.filter(|&node| (6..120).contains(&walk.triangles(node).len())) {
            let below = walk.triangles(node);
            let mut costs = even.clone();
            below.iter().for_each(|&triangle| costs[triangle as usize] = 9.0);
            let versus = Versus::new(&walk, [&costs, &even]);
            let n = below.len() as f64;
            let expected = 9.0 * n / (count as f64 + 8.0 * n) - n / count as f64;
            assert!((versus.contrast(&walk, node).difference() - expected).abs() < 1e-9);
            let listed = versus.dearest(&walk, Side::First, 0.01);
            // A child with nearly all of the triangles may stand for it.
            let is_it = |found: &Contrast| {
                let walked: Vec<u32> = walk.upwards(found.node).collect();
                walked.contains(&node) && found.difference() >= 0.6 * expected
            };
            let several: f64 = listed.iter().map(Contrast::difference).sum();
            assert!(listed.iter().any(is_it) || several >= 0.9 * expected, "{node} {listed:?}");
            assert!(listed.iter().all(|found| walk.path(found.node).contains(&node)), "{node} {listed:?}");
            assert!(versus.dearest(&walk, Side::Second, 0.01).iter().all(|found| !is_it(found)));
            let turned = Versus::new(&walk, [&even, &costs]);
            let nodes = |list: &[Contrast]| list.iter().map(|found| found.node).collect::<Vec<u32>>();
            assert_eq!(nodes(&turned.dearest(&walk, Side::Second, 0.01)), nodes(&listed));
        }
    }
}

#[test]
fn listed_nodes_do_not_overlap_and_differ_enough() {
    let scene = Scene::new(800, 60);
    let trees = scene.trees();
    let [first, second] = [&trees[0], &trees[1]];
    let cost = |tree: &Tree| {
        let walk = Walk::new(tree.view(), scene.triangles.len());
        per_triangle(&walk, &shares(&scene, tree, &walk, &scene.prepared(tree)))
    };
    let costs = [cost(first), cost(second)];
    let walk = Walk::new(first.view(), scene.triangles.len());
    let versus = Versus::new(&walk, [&costs[0], &costs[1]]);
    for side in [Side::First, Side::Second] {
        let listed = versus.dearest(&walk, side, 0.002);
        assert!(listed.len() > 3);
        for (place, contrast) in listed.iter().enumerate() {
            let [a, b] = [0, 1].map(|tree: usize| {
                let total: f64 = costs[tree].iter().sum();
                walk.triangles(contrast.node).iter().map(|&t| costs[tree][t as usize]).sum::<f64>() / total
            });
            assert!((a - contrast.shares[0]).abs() < 1e-9 && (b - contrast.shares[1]).abs() < 1e-9);
            assert!(if side == Side::First { a - b } else { b - a } > 0.002);
            for other in &listed[..place] {
                assert!(other.difference().abs() >= contrast.difference().abs());
                let common = walk.common(contrast.node, other.node);
                assert!(common != contrast.node && common != other.node);
            }
        }
    }
}

#[test]
fn diagrams_are_trees_of_blocks() {
    let scene = Scene::new(300, 60);
    for tree in scene.trees() {
        let (walk, prepared) = (Walk::new(tree.view(), scene.triangles.len()), scene.prepared(&tree));
        let shares = shares(&scene, &tree, &walk, &prepared);
        let roots = [0, walk.children(0).start, walk.children(walk.children(0).start).end - 1];
        for (measure, root, least) in Measure::ALL
            .into_iter()
            .flat_map(|m| roots.map(|r| (m, r, 0.01)).into_iter().chain([(m, 0, 0.0)]))
        {
            let layout = Layout { measure, root, levels: 30, least };
            let diagram = Diagram::new(&walk, &shares, &layout);
            assert_eq!(diagram.blocks[0].shown, Shown::Node(root));
            let width = |node: u32| shares.share(&walk, measure, node) / shares.share(&walk, measure, root);
            for (level, block) in
                (0..diagram.depth()).flat_map(|l| diagram.row(l).iter().map(move |b| (l, b)))
            {
                assert_eq!(block.level, level);
                let middle = 0.5 * (block.x.start + block.x.end);
                assert_eq!(diagram.hit(middle, level), Some(block));
                assert_eq!(diagram.hit(block.x.start, level), Some(block));
                assert!(block.x.end - block.x.start >= least - 1e-9 && block.x.end <= 1.0);
                if level > 0 {
                    let above = diagram.hit(middle, level - 1).expect("a parent");
                    assert!(above.x.start <= block.x.start && block.x.end <= above.x.end);
                    let parent = match block.shown {
                        Shown::Node(node) => walk.parent(node).expect("not the root"),
                        Shown::Rest { parent, .. } => parent,
                    };
                    assert_eq!(above.shown, Shown::Node(parent));
                }
                if let Shown::Node(node) = block.shown {
                    let is_right = (block.x.end - block.x.start - width(node)).abs() < 1e-9;
                    assert!(
                        level == 0 || is_right,
                        "{node} of {root} by {measure:?}: {block:?} {}",
                        width(node)
                    );
                    assert_eq!(diagram.block_of(&walk, node), Some(block));
                }
            }
            // What is not drawn belongs to the lowest drawn node above it.
            for node in 0..tree.nodes.len() as u32 {
                let drawn = |up: &u32| diagram.blocks.iter().any(|block| block.shown == Shown::Node(*up));
                let expected =
                    if walk.path(node).contains(&root) { walk.upwards(node).find(drawn) } else { None };
                assert_eq!(diagram.block_of(&walk, node).map(|block| block.shown.node()), expected);
            }
            if least == 0.0 && measure == Measure::Triangles {
                let levels = (0..tree.nodes.len() as u32).filter(|&node| walk.level(node) < 30).count();
                assert_eq!(diagram.blocks.len(), levels);
            }
            assert!(least == 0.0 || (0..diagram.depth()).all(|level| diagram.row(level).len() <= 101));
            let burst = Sunburst { depth: diagram.depth() };
            for block in &diagram.blocks {
                let (angles, radii) = burst.ring(block);
                let (angle, radius) = (0.5 * (angles.start + angles.end), 0.5 * (radii.start + radii.end));
                let (x, level) = burst.place(radius * angle.sin(), radius * angle.cos()).expect("inside");
                assert_eq!(diagram.hit(x, level), Some(block));
            }
            assert_eq!(burst.place(0.9, 0.9), None);
            assert!(diagram.row(diagram.depth()).is_empty() && diagram.hit(0.5, 1000).is_none());
        }
    }
}
