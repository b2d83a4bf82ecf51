//! Every traversal of every tree against brute force.

mod compare_support;

use compare_support::*;
use embree_trace::format::bvh::{Geometry, NO_INSTANCE, geometry_flag};
use embree_trace::format::rays::Reject;
use embree_trace::geometry::{Aabb, Ray, Triangle, Vec3};
use embree_trace::traverse::*;
use embree_trace::tree::{Node, Tree};

/// Trees of every width and leaf size over the same triangles.
fn trees(triangles: &[Triangle]) -> Vec<Tree> {
    let random = &mut Random(7);
    [(2, 1), (2, 1), (2, 4), (3, 2), (4, 1), (5, 3), (6, 8), (7, 2), (8, 1), (8, 4), (13, 3)]
        .map(|(width, leaf)| random_tree(triangles, width, leaf, random))
        .into()
}

/// All triangles in one leaf: the tests' own kernel, without any tree.
fn lone_leaf(triangles: &[Triangle]) -> Tree {
    random_tree(triangles, 2, usize::MAX, &mut Random(12))
}

fn one_leaf(triangles: &[Triangle]) -> Tree {
    let everything = Aabb { lower: Vec3::splat(f32::MIN), upper: Vec3::splat(f32::MAX) };
    Tree {
        nodes: vec![Node::leaf(everything, 0, triangles.len() as u32)],
        primitives: (0..triangles.len() as u32).collect(),
    }
}

#[test]
fn answers_are_those_of_brute_force() {
    let scratch = &mut Scratch::default();
    for (scene, triangles) in scenes() {
        let rays = rays(&triangles, 600, &mut Random(1));
        let tree = &trees(&triangles)[0];
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let (mut hits, mut certain) = (0, 0);
        for ray in &rays {
            let truth = truth(ray, &triangles, |_| true);
            let query = PreparedRay::new(ray);
            let hit = prepared.closest_hit(Traversal::Odf, &query, &All, &mut (), scratch);
            let occluder = prepared.occluder(Traversal::Odf, &query, &All, &mut (), scratch);
            assert_eq!(hit.is_some(), occluder.is_some(), "{scene} {ray:?}");
            certain += truth.certain.is_finite() as u32;
            match hit {
                None => assert!(truth.certain.is_infinite(), "{scene}: {ray:?} misses {}", truth.certain),
                Some(hit) => {
                    hits += 1;
                    let t = f64::from(hit.t);
                    assert!(t <= truth.certain, "{scene}: {ray:?}: {hit:?} behind {}", truth.certain);
                    let (_, exact) = truth
                        .possible
                        .iter()
                        .find(|(triangle, _)| *triangle == hit.triangle)
                        .unwrap_or_else(|| panic!("{scene}: {ray:?}: {hit:?} is none"));
                    let close = (t - exact).abs() <= 1e-4 * t.abs() + 1e-5;
                    assert!(
                        close || exact.is_nan() || truth.certain.is_infinite(),
                        "{scene}: {hit:?} {exact}"
                    );
                }
            }
        }
        assert!(
            triangles.len() < 2 || (hits > 50 && certain > 30),
            "{scene}: too few hits to mean anything: {hits} {certain}"
        );
    }
}

#[test]
fn every_tree_and_order_gives_the_same_bits() {
    let scratch = &mut Scratch::default();
    for (scene, triangles) in scenes() {
        let mut rays = rays(&triangles, 400, &mut Random(2));
        rays.extend(hostile_rays(&mut Random(3)));
        let flat = one_leaf(&triangles);
        let reference = Prepared::new(flat.view(), &triangles, &[]);
        for tree in trees(&triangles).iter().chain([&lone_leaf(&triangles)]) {
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            for ray in &rays {
                let query = PreparedRay::new(ray);
                let expected = reference.closest_hit(Traversal::Odf, &query, &All, &mut (), scratch);
                for traversal in Traversal::ALL {
                    let hit = prepared.closest_hit(traversal, &query, &All, &mut (), scratch);
                    assert_eq!(hit, expected, "{scene} {traversal:?} {ray:?}");
                    let occluder = prepared.occluder(traversal, &query, &All, &mut (), scratch);
                    assert_eq!(occluder.is_some(), expected.is_some(), "{scene} {traversal:?} {ray:?}");
                }
            }
        }
    }
}

/// T_R and its companions by recursion over the file's nodes, with the plain box test.
fn naive_overlap(tree: &Tree, node: usize, ray: &PreparedRay, tfar: f32) -> Overlap {
    let mut sum = Overlap::default();
    let node = &tree.nodes[node];
    let overlapped = ray.entry(&node.bounds(), tfar).is_some();
    if node.is_leaf() {
        sum.leaves = overlapped as u64;
        sum.primitives = if overlapped { node.len() as u64 } else { 0 };
    } else {
        // Every node is asked, those below a missed one too.
        sum.inner = overlapped as u64;
        sum.children = if overlapped { node.len() as u64 } else { 0 };
        for child in node.range() {
            sum += naive_overlap(tree, child, ray, tfar);
        }
    }
    sum
}

#[test]
fn ray_order_tests_exactly_what_the_effective_segment_overlaps() {
    let scratch = &mut Scratch::default();
    for (scene, triangles) in scenes() {
        let mut rays = rays(&triangles, 300, &mut Random(4));
        rays.extend(hostile_rays(&mut Random(5)));
        for tree in trees(&triangles) {
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            let binary = tree.nodes.iter().all(|node| node.is_leaf() || node.len() == 2);
            assert_eq!(prepared.is_binary(), binary);
            for ray in &rays {
                let query = PreparedRay::new(ray);
                for occlusion in [false, true] {
                    let mut counts = Counts::default();
                    let hit = if occlusion {
                        prepared.occluder(Traversal::RayOrder, &query, &All, &mut counts, scratch)
                    } else {
                        prepared.closest_hit(Traversal::RayOrder, &query, &All, &mut counts, scratch)
                    };
                    let end = if occlusion { ray.tfar } else { hit.map_or(ray.tfar, |hit| hit.t) };
                    let mut overlap = Overlap::default();
                    prepared.overlap(&query, end, &mut overlap, scratch);
                    assert_eq!(
                        overlap,
                        naive_overlap(&tree, 0, &query, end.min(query.tfar)),
                        "{scene} {ray:?}"
                    );
                    if occlusion && hit.is_some() {
                        assert!(counts.box_tests <= 1 + overlap.children);
                        continue;
                    }
                    assert_eq!(counts.box_tests, 1 + overlap.children, "{scene} {ray:?}");
                    assert_eq!(counts.node_visits, overlap.inner, "{scene} {ray:?}");
                    assert_eq!(counts.primitive_tests, overlap.primitives, "{scene} {ray:?}");
                    if binary {
                        assert_eq!(counts.box_tests, 1 + 2 * overlap.inner);
                    }
                }
            }
        }
    }
}

#[test]
fn depth_first_order_culls_what_waits_behind_a_hit() {
    // Two unit walls before a far cluster; the near one is found first, so nothing behind it is opened.
    let wall =
        |x: f32| Triangle([Vec3::new(x, -5.0, -5.0), Vec3::new(x, 10.0, -5.0), Vec3::new(x, -5.0, 10.0)]);
    let triangles = [wall(3.0), wall(1.0), wall(2.0), wall(4.0)];
    let bounds =
        |list: &[usize]| list.iter().fold(Aabb::EMPTY, |all, &index| all.union(&triangles[index].bounds()));
    let leaf = |index: u32| Node::leaf(triangles[index as usize].bounds(), index, 1);
    let tree = Tree {
        nodes: vec![
            Node::inner(bounds(&[0, 1, 2, 3]), 1, 2),
            Node::inner(bounds(&[0, 3]), 3, 2),
            Node::inner(bounds(&[1, 2]), 5, 2),
            leaf(0),
            leaf(3),
            leaf(1),
            leaf(2),
        ],
        primitives: vec![0, 1, 2, 3],
    };
    let ray =
        PreparedRay::new(&Ray { origin: Vec3::ZERO, tnear: 0.0, direction: Vec3::X, tfar: f32::INFINITY });
    let prepared = Prepared::new(tree.view(), &triangles, &[]);
    for traversal in Traversal::ALL {
        let (mut counts, mut path) = (Counts::default(), Path::default());
        let scratch = &mut Scratch::default();
        let hit = prepared.closest_hit(traversal, &ray, &All, &mut counts, scratch);
        assert_eq!(hit, Some(Hit { t: 1.0, triangle: 1 }));
        // Root, its two children, the near one's two children; one triangle.
        let expected =
            Counts { box_tests: 5, node_visits: 2, primitive_tests: 1, leaf_visits: 1, block_tests: 1 };
        assert_eq!(counts, expected);
        prepared.closest_hit(traversal, &ray, &All, &mut path, scratch);
        assert_eq!(path.steps, [Step::Inner(0), Step::Inner(2), Step::Leaf(5), Step::Triangle(1)]);
    }
}

#[test]
fn masks_and_rejects_are_honoured() {
    let random = &mut Random(9);
    let triangles = coincident(&height_field(8, 0.3, random));
    let half = triangles.len() as u32 / 2;
    let geometry = |first: u32, count: u32, mask: u32| Geometry {
        instance: NO_INSTANCE,
        geometry: 0,
        first_triangle: first,
        triangle_count: count,
        mask,
        kind: 0,
        flags: 0,
        instance_mask: 0,
    };
    // Out of order, and an empty one in between; the first needs a bit of each of two masks, the last has a word that does not count.
    let two =
        Geometry { flags: geometry_flag::INSTANCE_MASK, instance_mask: 0b101, ..geometry(half, half, 0b10) };
    let one = Geometry { instance_mask: 0b100, ..geometry(0, half, 0b01) };
    let geometries = [two, geometry(half, 0, 0), one];
    let sees = |mask: u32, triangle: u32| {
        if triangle < half { mask & 0b01 != 0 } else { mask & 0b10 != 0 && mask & 0b101 != 0 }
    };
    let scratch = &mut Scratch::default();
    for tree in trees(&triangles) {
        let prepared = Prepared::new(tree.view(), &triangles, &geometries);
        for (i, ray) in rays(&triangles, 300, random).iter().enumerate() {
            let query = PreparedRay::new(ray);
            let mask = [0b01, 0b10, 0b11, 0b110, 0, 0b100][i % 6];
            let free = Recorded { mask, rejects: &[] };
            let first = prepared.closest_hit(Traversal::Odf, &query, &free, &mut (), scratch);
            assert!(first.is_none_or(|hit| sees(mask, hit.triangle)));
            if matches!(mask, 0 | 0b10 | 0b100) {
                assert_eq!(first, None);
            }
            // Refuse the first answer: the next is another triangle, not before it.
            let Some(first) = first else { continue };
            let rejects = [Reject { record: 0, triangle: first.triangle }];
            let refusing = Recorded { mask, rejects: &rejects };
            let truth = truth(ray, &triangles, |index| sees(mask, index) && index != first.triangle);
            for traversal in Traversal::ALL {
                let second = prepared.closest_hit(traversal, &query, &refusing, &mut (), scratch);
                let occluder = prepared.occluder(traversal, &query, &refusing, &mut (), scratch);
                assert_eq!(second.is_some(), occluder.is_some());
                assert!(occluder.is_none_or(|hit| hit.triangle != first.triangle));
                match second {
                    None => assert!(truth.certain.is_infinite()),
                    Some(hit) => {
                        assert!(hit.triangle != first.triangle && hit.t >= first.t);
                        assert!(f64::from(hit.t) <= truth.certain);
                        assert!(truth.possible.iter().any(|(index, _)| *index == hit.triangle));
                    }
                }
            }
        }
    }
}

/// A chain: each inner node has a leaf and the rest of the chain as children.
fn chain(triangles: &[Triangle]) -> Tree {
    let mut tree = Tree::default();
    let mut rest = Aabb::EMPTY;
    let bounds: Vec<Aabb> = triangles
        .iter()
        .rev()
        .map(|triangle| {
            rest = rest.union(&triangle.bounds());
            rest
        })
        .collect();
    tree.nodes.push(Node::leaf(bounds[bounds.len() - 1], 0, 0));
    for (index, triangle) in triangles[..triangles.len() - 1].iter().enumerate() {
        let this = tree.nodes.len() - 1;
        tree.nodes[this] = Node::inner(bounds[bounds.len() - 1 - index], this as u32 + 1, 2);
        tree.nodes.push(Node::leaf(triangle.bounds(), index as u32, 1));
        tree.nodes.push(Node::leaf(bounds[bounds.len() - 2 - index], index as u32 + 1, 1));
    }
    tree.primitives = (0..triangles.len() as u32).collect();
    tree
}

#[test]
fn deep_trees_need_no_recursion() {
    // Coincident triangles: every box is overlapped, and on the way down one sibling waits on every level.
    let triangles = vec![soup(1, 1.0, &mut Random(3))[0]; 100_000];
    let tree = chain(&triangles);
    let prepared = Prepared::new(tree.view(), &triangles, &[]);
    let center = triangles[0].centroid();
    let direction = triangles[0].scaled_normal();
    let query = PreparedRay::new(&Ray { origin: center - direction, tnear: 0.0, direction, tfar: 2.0 });
    let scratch = &mut Scratch::default();
    for traversal in Traversal::ALL {
        let mut counts = Counts::default();
        let hit = prepared.closest_hit(traversal, &query, &All, &mut counts, scratch).expect("a hit");
        assert_eq!(hit.triangle, 0, "of equal hits the first in the file");
        assert!(counts.primitive_tests > 0);
    }
    let mut overlap = Overlap::default();
    prepared.overlap(&query, 2.0, &mut overlap, scratch);
    assert_eq!(overlap.inner, 99_999);
    assert_eq!(overlap.primitives, 100_000);
}

#[test]
fn empty_trees_are_missed() {
    let tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
    let prepared = Prepared::new(tree.view(), &[], &[]);
    for ray in hostile_rays(&mut Random(6)) {
        let mut counts = Counts::default();
        let query = PreparedRay::new(&ray);
        let hit = prepared.closest_hit(Traversal::Odf, &query, &All, &mut counts, &mut Scratch::default());
        assert_eq!((hit, counts.box_tests), (None, 1));
    }
}
