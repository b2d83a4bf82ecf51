//! Packets against brute force, and against single rays, bit for bit.

mod compare_support;

use compare_support::*;
use embree_trace::format::bvh::{Geometry, NO_INSTANCE, geometry_flag};
use embree_trace::format::rays::Reject;
use embree_trace::geometry::{Aabb, Ray, Triangle, Vec3};
use embree_trace::traverse::packet::MOST;
use embree_trace::traverse::*;
use embree_trace::tree::Tree;
use proptest::prelude::*;

fn trees(triangles: &[Triangle], random: &mut Random) -> Vec<Tree> {
    [(2, 1), (2, 4), (4, 1), (8, 3), (13, 2)]
        .map(|(width, leaf)| random_tree(triangles, width, leaf, random))
        .into()
}

/// What a packet found and what it cost.
#[derive(Default)]
struct Found {
    hits: Vec<Option<Hit>>,
    counts: Vec<Counts>,
    decisions: Decisions,
}

/// Asks in packets of `size`; with `order`, for occlusion.
fn ask<C: Candidates>(
    prepared: &Prepared,
    traversal: Traversal,
    order: Option<&OcclusionOrder>,
    rays: &[Ray],
    candidates: &[C],
    size: usize,
) -> Found {
    let scratch = &mut PacketScratch::default();
    let mut found = Found {
        hits: vec![None; rays.len()],
        counts: vec![Counts::default(); rays.len()],
        ..Found::default()
    };
    for start in (0..rays.len()).step_by(size) {
        let range = start..rays.len().min(start + size);
        let (rays, candidates) = (&rays[range.clone()], &candidates[range.clone()]);
        let answers = &mut found.hits[range.clone()];
        let queries = &mut found.counts[range];
        let observer = &mut PacketCounts { queries, decisions: &mut found.decisions };
        match order {
            None => prepared.closest_hits(traversal, rays, candidates, observer, scratch, answers),
            Some(order) => {
                prepared.occluders(traversal, order, rays, candidates, observer, scratch, answers);
            }
        }
    }
    found
}

/// Rays from one point through a grid, row by row: many octets stay together.
fn camera(triangles: &[Triangle], edge: usize) -> Vec<Ray> {
    let around = triangles.iter().fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
    let around = if around.is_empty() { Aabb { lower: -Vec3::ONE, upper: Vec3::ONE } } else { around };
    let (center, size) = (around.center(), around.extent().max_element().max(1.0));
    let origin = center + size * Vec3::new(0.9, 1.1, 1.3);
    let at = |i: usize| 2.0 * i as f32 / edge as f32 - 1.0;
    (0..edge * edge)
        .map(|pixel| {
            let target = center + 0.6 * size * Vec3::new(at(pixel % edge), at(pixel / edge), 0.1);
            Ray { origin, tnear: 0.0, direction: target - origin, tfar: f32::INFINITY }
        })
        .collect()
}

/// All kinds of rays: coherent ones, then trouble.
fn all_rays(triangles: &[Triangle], random: &mut Random) -> Vec<Ray> {
    let mut all = camera(triangles, 32);
    all.extend(rays(triangles, 300, random));
    all.extend(hostile_rays(random));
    all
}

fn orders(tree: &Tree, random: &mut Random) -> Vec<OcclusionOrder> {
    let bytes: Vec<u8> = tree.nodes.iter().map(|_| random.below(4) as u8).collect();
    OrderName::ALL
        .map(|name| OcclusionOrder::new(Some(name), tree.view(), Some(&bytes)).expect("fits"))
        .into()
}

#[test]
fn answers_are_those_of_brute_force() {
    for (scene, triangles) in scenes() {
        let random = &mut Random(31);
        let mut rays = camera(&triangles, 16);
        rays.extend(compare_support::rays(&triangles, 200, random));
        let truths: Vec<Truth> = rays.iter().map(|ray| truth(ray, &triangles, |_| true)).collect();
        let tree = random_tree(&triangles, 2, 1, random);
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let candidates = vec![All; rays.len()];
        for traversal in Traversal::ALL {
            let closest = ask(&prepared, traversal, None, &rays, &candidates, MOST);
            let any = ask(&prepared, traversal, Some(&OcclusionOrder::Nearest), &rays, &candidates, MOST);
            for ((ray, truth), (closest, any)) in
                rays.iter().zip(&truths).zip(closest.hits.iter().zip(&any.hits))
            {
                assert_eq!(closest.is_some(), any.is_some(), "{scene} {ray:?}");
                for hit in [closest, any] {
                    match hit {
                        None => assert!(truth.certain.is_infinite(), "{scene}: {ray:?}"),
                        Some(hit) => assert!(
                            truth.possible.iter().any(|(triangle, _)| *triangle == hit.triangle),
                            "{scene}: {ray:?}: {hit:?}"
                        ),
                    }
                }
                assert!(closest.is_none_or(|hit| f64::from(hit.t) <= truth.certain), "{scene}: {ray:?}");
            }
        }
    }
}

#[test]
fn packets_of_every_size_answer_as_single_rays_do() {
    let scratch = &mut Scratch::default();
    for (scene, triangles) in scenes() {
        let random = &mut Random(32);
        let rays = all_rays(&triangles, random);
        let candidates = vec![All; rays.len()];
        for tree in trees(&triangles, random) {
            let prepared = Prepared::new(tree.view(), &triangles, &[]);
            let expected: Vec<Option<Hit>> = rays
                .iter()
                .map(|ray| {
                    prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), &All, &mut (), scratch)
                })
                .collect();
            for traversal in Traversal::ALL {
                for size in [1, 7, 16, 64, 100, MOST] {
                    let found = ask(&prepared, traversal, None, &rays, &candidates, size);
                    for ((ray, expected), hit) in rays.iter().zip(&expected).zip(&found.hits) {
                        assert_eq!(hit, expected, "{scene} {traversal:?} {size} {ray:?}");
                    }
                    for order in orders(&tree, random) {
                        let found = ask(&prepared, traversal, Some(&order), &rays, &candidates, size);
                        for ((ray, expected), hit) in rays.iter().zip(&expected).zip(&found.hits) {
                            assert_eq!(hit.is_some(), expected.is_some(), "{scene} {order:?} {size} {ray:?}");
                        }
                        if size != MOST {
                            break;
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn rules_decide_and_spare_tests() {
    let triangles = height_field(40, 0.05, &mut Random(33));
    let rays = camera(&triangles, 64);
    let tree = random_tree(&triangles, 2, 1, &mut Random(34));
    let prepared = Prepared::new(tree.view(), &triangles, &[]);
    let candidates = vec![All; rays.len()];
    let scratch = &mut Scratch::default();
    let mut single = Counts::default();
    for ray in &rays {
        prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), &All, &mut single, scratch);
    }
    let found = ask(&prepared, Traversal::Odf, None, &rays, &candidates, MOST);
    let Decisions { early_hits, early_misses, by_rays, few, octets } = found.decisions;
    assert!(early_hits.min(early_misses).min(by_rays).min(few) > 0, "{:?}", found.decisions);
    let mut sum = Counts::default();
    found.counts.iter().for_each(|counts| sum += *counts);
    assert!(sum.box_tests <= 8 * octets, "an octet is eight tests at most");
    assert!(octets < single.box_tests / 2, "{octets} {single:?}");
    assert!(found.hits.iter().flatten().count() > 1000);
    assert!(
        found.counts.iter().zip(&found.hits).all(|(counts, hit)| hit.is_none() || counts.primitive_tests > 0)
    );
}

#[test]
fn masks_and_rejects_are_those_of_each_query() {
    let random = &mut Random(35);
    let triangles = coincident(&height_field(8, 0.3, random));
    let half = triangles.len() as u32 / 2;
    let geometry = |first: u32, mask: u32| Geometry {
        instance: NO_INSTANCE,
        geometry: 0,
        first_triangle: first,
        triangle_count: half,
        mask,
        kind: 0,
        flags: 0,
        instance_mask: 0,
    };
    let two = geometry_flag::INSTANCE_MASK;
    let geometries =
        [geometry(0, 0b01), Geometry { flags: two, instance_mask: 0b101, ..geometry(half, 0b10) }];
    let scratch = &mut Scratch::default();
    let rays = all_rays(&triangles, random);
    for tree in trees(&triangles, random) {
        let prepared = Prepared::new(tree.view(), &triangles, &geometries);
        // Every other query refuses what it would hit.
        let free: Vec<Recorded> = (0..rays.len())
            .map(|i| Recorded { mask: [0b11, 0b01, 0b110, 0b10, 0, 0b100][i % 6], rejects: &[] })
            .collect();
        let single = |candidates: &[Recorded], scratch: &mut Scratch| -> Vec<Option<Hit>> {
            let asked = rays.iter().zip(candidates).map(|(ray, candidates)| {
                prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), candidates, &mut (), scratch)
            });
            asked.collect()
        };
        let first = single(&free, scratch);
        let rejects: Vec<[Reject; 1]> = first
            .iter()
            .map(|hit| [Reject { record: 0, triangle: hit.map_or(u32::MAX, |hit| hit.triangle) }])
            .collect();
        let refusing: Vec<Recorded> = free
            .iter()
            .zip(&rejects)
            .enumerate()
            .map(|(i, (free, rejects))| Recorded { rejects: if i % 2 == 0 { rejects } else { &[] }, ..*free })
            .collect();
        let expected = single(&refusing, scratch);
        assert_ne!(expected, first);
        for traversal in Traversal::ALL {
            for size in [16, MOST] {
                let closest = ask(&prepared, traversal, None, &rays, &refusing, size);
                assert_eq!(closest.hits, expected);
                let any = ask(&prepared, traversal, Some(&OcclusionOrder::Nearest), &rays, &refusing, size);
                for ((hit, expected), candidates) in any.hits.iter().zip(&expected).zip(&refusing) {
                    assert_eq!(hit.is_some(), expected.is_some());
                    let refused = |hit: &Hit| candidates.rejects.iter().any(|r| r.triangle == hit.triangle);
                    assert!(!hit.as_ref().is_some_and(refused));
                }
            }
        }
    }
}

#[test]
fn empty_packets_and_trees_are_answered() {
    let tree =
        Tree { nodes: vec![embree_trace::tree::Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
    let prepared = Prepared::new(tree.view(), &[], &[]);
    let rays = hostile_rays(&mut Random(36));
    for count in [0, 1, MOST] {
        let found = ask(&prepared, Traversal::Odf, None, &rays[..count], &vec![All; count], MOST);
        assert!(found.hits.iter().all(Option::is_none));
    }
}

fn any_ray() -> impl Strategy<Value = Ray> {
    let part = || prop_oneof![8 => -2.0f32..2.0, 1 => Just(0.0f32), 1 => Just(-0.0f32), 1 => any::<f32>()];
    let vector = || (part(), part(), part()).prop_map(|(x, y, z)| Vec3::new(x, y, z));
    let end = || prop_oneof![4 => Just(f32::INFINITY), 4 => 0.0f32..3.0, 1 => any::<f32>()];
    (vector(), vector(), prop_oneof![6 => Just(0.0f32), 2 => -1.0f32..1.0, 1 => any::<f32>()], end())
        .prop_map(|(origin, direction, tnear, tfar)| Ray { origin, tnear, direction, tfar })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn any_packet_answers_as_its_rays_do(
        seed in 1u64..u64::MAX,
        rays in prop::collection::vec(any_ray(), 0..=MOST),
        (width, leaf) in (2usize..10, 1usize..5),
        front_to_back in any::<bool>(),
    ) {
        let random = &mut Random(seed);
        let triangles = soup(120, 0.6, random);
        let tree = random_tree(&triangles, width, leaf, random);
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let traversal = if front_to_back { Traversal::RayOrder } else { Traversal::Odf };
        let candidates = vec![All; rays.len()];
        let closest = ask(&prepared, traversal, None, &rays, &candidates, MOST);
        let any = ask(&prepared, traversal, Some(&OcclusionOrder::Nearest), &rays, &candidates, MOST);
        let scratch = &mut Scratch::default();
        for (i, ray) in rays.iter().enumerate() {
            let expected = prepared.closest_hit(traversal, &PreparedRay::new(ray), &All, &mut (), scratch);
            prop_assert_eq!(closest.hits[i], expected, "{:?}", ray);
            prop_assert_eq!(any.hits[i].is_some(), expected.is_some(), "{:?}", ray);
        }
    }
}
