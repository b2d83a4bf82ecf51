//! Measures of a tree, held to a truth that shares no code with them.

mod compare_support;

use compare_support::*;
use embree_trace::geometry::{DVec3, Triangle};
use embree_trace::tree::Tree;
use embree_trace::tree::epo::end_point_overlap;

/// Triangles of the leaves below a node, by recursion.
fn below(tree: &Tree, node: usize, into: &mut Vec<u32>) {
    let node = &tree.nodes[node];
    if node.is_leaf() {
        into.extend(&tree.primitives[node.range()]);
    } else {
        node.range().for_each(|child| below(tree, child, into));
    }
}

/// End-point overlap by its definition, the surface cut into `n`² small triangles of equal area, each in a box when its centre is.
fn brute_force(tree: &Tree, triangles: &[Triangle], n: usize, c_i: f64, c_p: f64) -> f64 {
    let area = |t: &Triangle| f64::from(t.scaled_normal().length()) / 2.0;
    let surface: f64 = triangles.iter().map(area).sum();
    let centres = |triangle: &Triangle| -> Vec<DVec3> {
        let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
        let at = |u: f64, v: f64| a + (b - a) * (u / n as f64) + (c - a) * (v / n as f64);
        let third = 1.0 / 3.0;
        (0..n)
            .flat_map(|i| (0..n - i).map(move |j| (i as f64, j as f64)))
            .flat_map(|(i, j)| {
                let upside_down = i + j + 2.0 <= n as f64;
                std::iter::once(at(i + third, j + third))
                    .chain(upside_down.then(|| at(i + 2.0 * third, j + 2.0 * third)))
            })
            .collect()
    };
    let points: Vec<Vec<DVec3>> = triangles.iter().map(centres).collect();
    assert!(points.iter().all(|centres| centres.len() == n * n));
    let mut sum = 0.0;
    for (number, node) in tree.nodes.iter().enumerate() {
        let mut own = Vec::new();
        below(tree, number, &mut own);
        let (lower, upper) = (node.lower.as_dvec3(), node.upper.as_dvec3());
        let inside = |p: &&DVec3| p.cmpge(lower).all() && p.cmple(upper).all();
        let foreign = (0..triangles.len()).filter(|&index| !own.contains(&(index as u32)));
        let overlap: f64 = foreign
            .map(|index| {
                let within = points[index].iter().filter(inside).count();
                area(&triangles[index]) * within as f64 / (n * n) as f64
            })
            .sum();
        sum += overlap * node.len() as f64 * if node.is_leaf() { c_p } else { c_i };
    }
    sum / surface
}

#[test]
fn end_point_overlap_is_the_integral_over_the_surface() {
    for seed in 1..=6 {
        let random = &mut Random(seed);
        let triangles = if seed % 2 == 0 { soup(24, 0.8, random) } else { height_field(4, 0.5, random) };
        for (width, max_leaf) in [(2, 1), (4, 3), (8, 2)] {
            let tree = random_tree(&triangles, width, max_leaf, random);
            let exact = end_point_overlap(tree.view(), &triangles, 1.25, 2.0);
            let expected = brute_force(&tree, &triangles, 60, 1.25, 2.0);
            assert!(expected > 0.1, "{seed}: boxes of random trees overlap");
            assert!((exact - expected).abs() < 0.01 * expected, "{seed}, {width}: {exact}, not {expected}");
        }
    }
}

#[test]
fn end_point_overlap_does_not_depend_on_threads_scale_or_order() {
    let random = &mut Random(9);
    let triangles = soup(3000, 0.2, random);
    let tree = random_tree(&triangles, 4, 2, random);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| end_point_overlap(tree.view(), &triangles, 1.0, 1.0))
    };
    assert_eq!(with(1).to_bits(), with(3).to_bits());
    let large: Vec<Triangle> = triangles.iter().map(|t| Triangle(t.0.map(|v| v * 1e30))).collect();
    let mut far = tree.clone();
    for node in &mut far.nodes {
        (node.lower, node.upper) = (node.lower * 1e30, node.upper * 1e30);
    }
    let scaled = end_point_overlap(far.view(), &large, 1.0, 1.0);
    assert!((scaled / with(1) - 1.0).abs() < 1e-4, "{scaled}, {}", with(1));
}
