//! The split of a root against every candidate, evaluated one by one in double precision.

mod soup;

use embree_trace::builder::{self, Bins, Config, Count, Splits};
use embree_trace::geometry::{Aabb, Triangle};
use embree_trace::progress::Progress;
use embree_trace::tree::Tree;
use soup::{degenerate, soup};
use std::collections::BTreeSet;

/// A candidate: the triangles that go left, and what it costs.
type Candidate = (BTreeSet<u32>, f64);

fn cost(triangles: &[Triangle], left: &BTreeSet<u32>, config: &Config) -> f64 {
    let less = if config.count == Count::MinusOne { 1.0 } else { 0.0 };
    let side = |goes_left: bool| {
        let members = (0..triangles.len()).filter(|&t| left.contains(&(t as u32)) == goes_left);
        let bounds = members.map(|t| triangles[t].bounds()).fold(Aabb::EMPTY, |sum, b| sum.union(&b));
        let edge = bounds.upper.as_dvec3() - bounds.lower.as_dvec3();
        let count = if goes_left { left.len() } else { triangles.len() - left.len() };
        (count as f64 - less).powf(config.alpha) * (edge.x * edge.y + edge.y * edge.z + edge.z * edge.x)
    };
    side(true) + side(false)
}

fn center(triangle: &Triangle, axis: usize) -> f32 {
    let bounds = triangle.bounds();
    0.5 * bounds.lower[axis] + 0.5 * bounds.upper[axis]
}

/// Every cut of every axis' order.
fn sweep_candidates(triangles: &[Triangle], config: &Config) -> Vec<Candidate> {
    let mut candidates = Vec::new();
    for axis in 0..3 {
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        order.sort_by(|&a, &b| {
            let at = |t: u32| center(&triangles[t as usize], axis);
            at(a).total_cmp(&at(b)).then(a.cmp(&b))
        });
        for cut in 1..order.len() {
            let left: BTreeSet<u32> = order[..cut].iter().copied().collect();
            candidates.push((left.clone(), cost(triangles, &left, config)));
        }
    }
    candidates
}

/// Every plane between equal bins of every axis.
fn binned_candidates(triangles: &[Triangle], bins: usize, config: &Config) -> Vec<Candidate> {
    let mut candidates = Vec::new();
    for axis in 0..3 {
        let centers: Vec<f32> = triangles.iter().map(|t| center(t, axis)).collect();
        let lower = centers.iter().copied().fold(f32::INFINITY, f32::min);
        let upper = centers.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        if upper == lower {
            continue;
        }
        let bin = |center: f32| (((center - lower) * (bins as f32 / (upper - lower))) as usize).min(bins - 1);
        for plane in 1..bins {
            let goes_left = |t: &u32| bin(centers[*t as usize]) < plane;
            let left: BTreeSet<u32> = (0..triangles.len() as u32).filter(goes_left).collect();
            if !left.is_empty() && left.len() < triangles.len() {
                candidates.push((left.clone(), cost(triangles, &left, config)));
            }
        }
    }
    candidates
}

/// The triangles below the root's first child. Leaves are in depth-first order.
fn left_of(tree: &Tree) -> BTreeSet<u32> {
    let mut left = BTreeSet::new();
    let mut open = vec![tree.nodes[0].first as usize];
    while let Some(node) = open.pop() {
        let node = tree.nodes[node];
        if node.is_leaf() {
            left.extend(&tree.primitives[node.range()]);
        } else {
            open.extend(node.range());
        }
    }
    left
}

fn check(triangles: &[Triangle], config: &Config, candidates: &[Candidate], what: &str) {
    let tree = builder::build(triangles, config, &Progress::hidden()).expect("valid");
    let left = left_of(&tree);
    let chosen = candidates.iter().find(|(candidate, _)| *candidate == left);
    let (_, chosen) = chosen.unwrap_or_else(|| panic!("{what}, {config:?}: no candidate"));
    let least = candidates.iter().map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
    assert!(*chosen <= least * (1.0 + 1e-5), "{what}, {config:?}: {chosen} instead of {least}");
}

/// α and count in all the ways that differ.
fn costs() -> impl Iterator<Item = (f64, Count)> {
    [0.0, 0.5, 0.88, 1.0, 2.0].into_iter().flat_map(|alpha| [(alpha, Count::MinusOne), (alpha, Count::All)])
}

/// Small soups, and what of the degenerate sets is an ordinary scene but for one property.
fn scenes() -> Vec<(String, Vec<Triangle>)> {
    let soups = (3..=40).map(|count| (format!("{count} random"), soup(count, 100 + count as u64)));
    let odd = degenerate().into_iter().filter(|(name, _)| {
        ["flat, mask 3", "flat, mask 5", "on a coarse grid", "33 nested", "scaled by 1e-1", "scaled by 1e15"]
            .contains(&name.as_str())
    });
    soups
        .chain(odd)
        .map(|(name, mut triangles)| {
            triangles.truncate(60);
            (name, triangles)
        })
        .collect()
}

#[test]
fn a_sweep_finds_the_best_of_all_cuts() {
    for (name, triangles) in scenes() {
        for (alpha, count) in costs() {
            let config = Config { splits: Splits::Sweep, alpha, count, ..Config::default() };
            check(&triangles, &config, &sweep_candidates(&triangles, &config), &name);
        }
    }
}

#[test]
fn bins_find_the_best_of_their_planes() {
    for (name, triangles) in scenes() {
        for (bins, number) in [
            (Bins::Adaptive, 4 + triangles.len() / 20),
            (Bins::Fixed(2), 2),
            (Bins::Fixed(9), 9),
            (Bins::Fixed(200), 200),
        ] {
            for (alpha, count) in costs() {
                let config = Config { splits: Splits::Binned { bins }, alpha, count, ..Config::default() };
                let candidates = binned_candidates(&triangles, number, &config);
                if !candidates.is_empty() {
                    check(&triangles, &config, &candidates, &name);
                }
            }
        }
    }
}

#[test]
fn blocks_on_several_threads_find_the_same_plane() {
    // More triangles than one thread takes; few enough candidates to evaluate each.
    let triangles = soup(70_000, 4);
    let config = Config { splits: Splits::Binned { bins: Bins::Fixed(4) }, ..Config::default() };
    check(&triangles, &config, &binned_candidates(&triangles, 4, &config), "a large soup");
}
