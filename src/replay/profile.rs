//! Where in a tree the tests of queries fall, level by level, and how many cache lines they read.
//!
//! An observer of its own, for a pass of its own: the counts that every replay makes stay as cheap as they are.
//! Lines are those of a plain layout, the same for every tree whatever form it is traversed in: nodes of 32 bytes in the order of the
//! file, siblings side by side, and triangles of 36 bytes in the order of the leaves.

use crate::geometry::Triangle;
use crate::traverse::{Counts, Link, Observer, PreparedTriangle};
use crate::tree::{Node, TreeView};
use serde::{Deserialize, Serialize};

const LINE: usize = 64;

/// What does not change from query to query.
#[derive(Debug)]
pub struct Levels {
    /// Of each node: the root's is 0.
    level: Vec<u32>,
    /// Of an inner node its first child, of a leaf its first primitive.
    first: Vec<u32>,
    depth: usize,
    node_lines: u64,
}

impl Levels {
    pub fn of(tree: TreeView) -> Levels {
        let level = tree.levels();
        let depth = level.iter().max().map_or(0, |&deepest| deepest as usize + 1);
        let node_lines = std::mem::size_of_val(tree.nodes).div_ceil(LINE) as u64;
        Levels { level, first: tree.nodes.iter().map(|node| node.first).collect(), depth, node_lines }
    }
}

/// Sums over queries.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Profile {
    /// By level, the root's first: boxes of that level tested, inner nodes of it visited, primitives in its leaves tested. The rest is 0.
    pub levels: Vec<Counts>,
    /// Distinct lines of 64 bytes that each query reads, summed.
    pub cache_lines: u64,
}

impl Profile {
    pub fn new(levels: &Levels) -> Profile {
        Profile { levels: vec![Counts::default(); levels.depth], cache_lines: 0 }
    }

    pub fn merge(&mut self, other: &Profile) {
        self.levels.resize(self.levels.len().max(other.levels.len()), Counts::default());
        for (sum, counts) in self.levels.iter_mut().zip(&other.levels) {
            *sum += *counts;
        }
        self.cache_lines += other.cache_lines;
    }
}

/// Watches one query after the other.
pub struct Profiler<'a> {
    levels: &'a Levels,
    profile: &'a mut Profile,
    lines: &'a mut Vec<u64>,
    /// Level of the leaf that is open.
    leaf: usize,
}

impl<'a> Profiler<'a> {
    /// For one query; `lines` is room that is used again and again.
    pub fn new(levels: &'a Levels, profile: &'a mut Profile, lines: &'a mut Vec<u64>) -> Profiler<'a> {
        lines.clear();
        Profiler { levels, profile, lines, leaf: 0 }
    }

    /// The query is answered.
    pub fn finish(self) {
        self.lines.sort_unstable();
        self.lines.dedup();
        self.profile.cache_lines += self.lines.len() as u64;
    }

    fn read<T>(&mut self, base: u64, first: usize, count: usize) {
        if count > 0 {
            let (start, end) = (first * size_of::<T>(), (first + count) * size_of::<T>());
            self.lines.extend((start / LINE..end.div_ceil(LINE)).map(|line| base + line as u64));
        }
    }
}

impl Observer for Profiler<'_> {
    fn root(&mut self) {
        self.profile.levels[0].box_tests += 1;
        self.read::<Node>(0, 0, 1);
    }

    fn inner(&mut self, node: &Link) {
        let level = self.levels.level[node.node as usize] as usize;
        self.profile.levels[level].node_visits += 1;
        self.profile.levels[level + 1].box_tests += u64::from(node.count);
        let first = self.levels.first[node.node as usize] as usize;
        self.read::<Node>(0, first, node.count as usize);
    }

    fn leaf(&mut self, leaf: &Link) {
        self.leaf = self.levels.level[leaf.node as usize] as usize;
        let first = self.levels.first[leaf.node as usize] as usize;
        self.read::<Triangle>(self.levels.node_lines, first, leaf.triangles().len());
    }

    fn primitive(&mut self, _triangle: &PreparedTriangle) {
        self.profile.levels[self.leaf].primitive_tests += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Ray, Vec3};
    use crate::traverse::{All, Prepared, PreparedRay, Scratch, Traversal};
    use crate::tree::Tree;

    /// Cubes in a row along x, three children at the root, the last of them with two more.
    fn row() -> (Tree, Vec<Triangle>) {
        let cube = |x: f32| Aabb { lower: Vec3::new(x, 0.0, 0.0), upper: Vec3::new(x + 1.0, 1.0, 1.0) };
        let nodes = vec![
            Node::inner(cube(0.0).union(&cube(3.0)), 1, 3),
            Node::leaf(cube(0.0), 0, 2),
            Node::leaf(cube(1.0), 2, 1),
            Node::inner(cube(2.0).union(&cube(3.0)), 4, 2),
            Node::leaf(cube(2.0), 3, 1),
            Node::leaf(cube(3.0), 4, 1),
        ];
        let wall = |x: f32| Triangle([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|[y, z]| Vec3::new(x, y, z)));
        let triangles = [0.2, 0.7, 1.5, 2.5, 3.5].map(wall).to_vec();
        (Tree { nodes, primitives: (0..5).collect() }, triangles)
    }

    #[test]
    fn tests_are_told_by_level_and_lines_are_counted_once() {
        let (tree, triangles) = row();
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let levels = Levels::of(tree.view());
        let (mut profile, mut lines) = (Profile::new(&levels), Vec::new());
        let mut cast = |y: f32, tfar: f32| {
            let origin = Vec3::new(-1.0, y, 0.75);
            let ray = PreparedRay::new(&Ray { origin, tnear: 0.0, direction: Vec3::X, tfar });
            let mut profiler = Profiler::new(&levels, &mut profile, &mut lines);
            prepared.closest_hit(Traversal::Odf, &ray, &All, &mut profiler, &mut Scratch::default());
            profiler.finish();
        };
        // Beside the triangles but through every box: everything is tested.
        cast(0.75, 100.0);
        // Past all boxes: the root's only.
        cast(7.0, 100.0);
        let counts = |box_tests, node_visits, primitive_tests| Counts {
            box_tests,
            node_visits,
            primitive_tests,
            ..Counts::default()
        };
        assert_eq!(profile.levels, [counts(2, 1, 0), counts(3, 1, 3), counts(2, 0, 2)]);
        // 6 nodes of 32 bytes on 3 lines, 5 triangles of 36 bytes on 3; then the root's line.
        assert_eq!(profile.cache_lines, 6 + 1);
        let mut twice = profile.clone();
        twice.merge(&profile);
        assert_eq!((twice.cache_lines, twice.levels[1].box_tests), (14, 6));
    }
}
