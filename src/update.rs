//! Trees for moving scenes (paper, section 2.5): the triangles of the next frame are the same faces with other vertices, and the tree of the frame
//! before is nearly right.
//!
//! A [`Moving`] tree follows its triangles: [`Moving::refit`] gives it new boxes, [`Moving::rotate`] also exchanges nodes where boxes have grown into each other,
//! both in one pass from the leaves. [`policy`] is what a program does from frame to frame: one of these or a rebuild, or a
//! rebuild only when a recorded ray has become too expensive. Probabilities are areas or the rays of the frame *before*: nobody has the next frame's.
//!
//! One tree for a whole animation, to be refitted only, is made by [`crate::optimize::frames`].

mod pieces;
pub mod policy;
mod refit;
mod rotate;

use crate::geometry::Triangle;
use crate::tree::depth_first::depth_first;
use crate::tree::statistics::Statistics;
use crate::tree::{Tree, TreeView};
use pieces::Cut;
use thiserror::Error;

/// Levels beyond which a tree is not followed: passes over it are recursive.
pub const MAX_LEVELS: usize = 1024;

/// Why a tree cannot follow a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum UpdateError {
    /// Frames of one mesh have the same faces.
    #[error(
        "the tree is over {tree} triangles, and the frame has {frame}: frames of one mesh have the same faces"
    )]
    OtherMesh { tree: usize, frame: usize },
    #[error("triangle {0} is not finite in only one of the frames: no tree can follow it, rebuild")]
    NotFinite(usize),
    #[error(
        "node {node} has {children} children: only binary trees can be rotated (bvh-build --binary makes them)"
    )]
    NotBinary { node: usize, children: usize },
    #[error("the tree has {0} levels, and at most {MAX_LEVELS} can be followed")]
    TooDeep(usize),
}

/// A tree that follows its triangles.
#[derive(Clone, Debug)]
pub struct Moving {
    /// Subtrees of the cut are ranges of its nodes; in depth-first order only if `ordered`.
    tree: Tree,
    cut: Cut,
    ordered: bool,
}

impl Moving {
    /// A copy of a tree of any width.
    ///
    /// # Errors
    /// When the tree is too deep.
    pub fn new(tree: TreeView) -> Result<Moving, UpdateError> {
        let levels = Statistics::of(tree).depth;
        if levels > MAX_LEVELS {
            return Err(UpdateError::TooDeep(levels));
        }
        let tree = depth_first(tree);
        let cut = Cut::of(&tree.nodes);
        Ok(Moving { tree, cut, ordered: true })
    }

    /// Whether all inner nodes have two children, as rotations need it.
    ///
    /// # Errors
    /// The first node that has not.
    pub fn check_binary(&self) -> Result<(), UpdateError> {
        let wide = self.tree.nodes.iter().position(|node| !node.is_leaf() && node.len() != 2);
        wide.map_or(Ok(()), |node| {
            Err(UpdateError::NotBinary { node, children: self.tree.nodes[node].len() })
        })
    }

    /// Whether the tree can follow a frame: as many triangles as `before`, finite where they were.
    ///
    /// # Errors
    /// What is different.
    pub fn check_frame(before: &[Triangle], frame: &[Triangle]) -> Result<(), UpdateError> {
        if before.len() != frame.len() {
            return Err(UpdateError::OtherMesh { tree: before.len(), frame: frame.len() });
        }
        let differs = before.iter().zip(frame).position(|(a, b)| a.is_finite() != b.is_finite());
        differs.map_or(Ok(()), |triangle| Err(UpdateError::NotFinite(triangle)))
    }

    /// The nodes in whatever order rotations left them: children may stand before their parents, which no file may have.
    pub fn nodes(&self) -> &[crate::tree::Node] {
        &self.tree.nodes
    }

    /// The tree as builders return it.
    pub fn tree(&mut self) -> &Tree {
        self.put_in_order();
        &self.tree
    }

    /// Depth-first order, and a new cut, where rotations disturbed them.
    fn put_in_order(&mut self) {
        if !self.ordered {
            self.tree = depth_first(self.tree.view());
            self.cut = Cut::of(&self.tree.nodes);
            self.ordered = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{self, Config, MAX_DEPTH};
    use crate::geometry::{Aabb, Vec3};
    use crate::mesh::generate::circle;
    use crate::progress::Progress;
    use crate::random::Random;
    use crate::tree::statistics::sah_cost;
    use crate::tree::validate::validate;
    use crate::tree::{Node, collapse};

    /// Small triangles in a cube that is twisted by a turn a unit of time, its upper face against its lower one.
    fn frame(count: usize, time: f32) -> Vec<Triangle> {
        let mut random = Random::new(9);
        let mut vector = |scale: f32| Vec3::from_array([0; 3].map(|_| random.unit() - 0.5)) * scale;
        (0..count)
            .map(|_| {
                let at = vector(1.0);
                let (cos, sin) = circle(f64::from(time * at.y));
                let (cos, sin) = (cos as f32, sin as f32);
                let at = Vec3::new(cos * at.x - sin * at.z, at.y, sin * at.x + cos * at.z);
                Triangle([at, at + vector(0.02), at + vector(0.02)])
            })
            .collect()
    }

    fn build(triangles: &[Triangle], config: &Config) -> Tree {
        builder::build(triangles, config, &Progress::hidden()).unwrap()
    }

    /// Boxes worked out one by one from the triangles below.
    fn assert_exact(nodes: &[Node], primitives: &[u32], triangles: &[Triangle]) {
        fn exact(index: usize, nodes: &[Node], primitives: &[u32], triangles: &[Triangle]) -> Aabb {
            let node = &nodes[index];
            let mut bounds = Aabb::EMPTY;
            for below in node.range() {
                let part = if node.is_leaf() {
                    triangles[primitives[below] as usize].bounds()
                } else {
                    exact(below, nodes, primitives, triangles)
                };
                bounds = bounds.union(&part);
            }
            assert_eq!(node.bounds(), bounds, "node {index}");
            bounds
        }
        exact(0, nodes, primitives, triangles);
    }

    #[test]
    fn refitted_boxes_are_exact_for_trees_of_any_width() {
        for count in [1, 2, 3, 700, 20_000] {
            let triangles = frame(count, 0.0);
            let binary = build(&triangles, &Config { max_leaf: 4, ..Config::default() });
            let area = |node: usize| f64::from(binary.nodes[node].bounds().area());
            let wide = collapse::collapse(binary.view(), area, &collapse::Config::vector(8)).unwrap();
            for tree in [&binary, &wide] {
                let mut moving = Moving::new(tree.view()).unwrap();
                for time in [0.1, 0.5, 1.0] {
                    let triangles = frame(count, time);
                    moving.refit(&triangles);
                    let tree = moving.tree();
                    assert_exact(&tree.nodes, &tree.primitives, &triangles);
                    validate(tree, &triangles, MAX_DEPTH).unwrap();
                }
            }
        }
    }

    #[test]
    fn rotated_trees_are_valid_and_cost_less_than_refitted_ones() {
        let count = 20_000;
        let start = build(&frame(count, 0.0), &Config::default());
        let [mut refitted, mut rotated] = [(); 2].map(|()| Moving::new(start.view()).unwrap());
        let mut rotations = 0;
        for step in 1..=20 {
            let triangles = frame(count, step as f32 / 20.0);
            refitted.refit(&triangles);
            rotations += rotated.rotate(&triangles);
            // As they are left, and as they are written.
            assert_exact(rotated.nodes(), &rotated.tree.primitives.clone(), &triangles);
            let mut copy = rotated.clone();
            validate(copy.tree(), &triangles, MAX_DEPTH).unwrap();
        }
        let [refitted, rotated] =
            [refitted.tree(), rotated.tree()].map(|tree| sah_cost(tree.view(), 1.0, 1.0));
        assert!(rotations > 1000, "{rotations}");
        assert!(rotated < 0.7 * refitted, "{rotated} {refitted}");
    }

    #[test]
    fn no_rotation_is_left_that_the_pass_was_to_take_on_a_tree_of_four() {
        // Two pairs that lie together, built crosswise: one rotation mends it, by hand.
        let at = |x: f32| Triangle([Vec3::X * x, Vec3::new(x + 1.0, 1.0, 0.0), Vec3::new(x, 1.0, 1.0)]);
        let triangles = [at(0.0), at(10.0), at(0.5), at(10.5)];
        let leaf = |index: u32| Node::leaf(triangles[index as usize].bounds(), index, 1);
        let inner = |a: usize, b: usize, first| {
            Node::inner(triangles[a].bounds().union(&triangles[b].bounds()), first, 2)
        };
        let nodes = vec![
            Node::inner(triangles[0].bounds().union(&triangles[3].bounds()), 1, 2),
            inner(0, 1, 3),
            inner(2, 3, 5),
            leaf(0),
            leaf(1),
            leaf(2),
            leaf(3),
        ];
        let tree = Tree { nodes, primitives: vec![0, 1, 2, 3] };
        let mut moving = Moving::new(tree.view()).unwrap();
        assert_eq!(moving.rotate(&triangles), 1);
        let tree = moving.tree();
        let mut widths: Vec<f32> = tree.nodes[1..3].iter().map(|node| node.bounds().extent().x).collect();
        widths.sort_by(f32::total_cmp);
        assert_eq!(widths, [1.5, 1.5]);
        assert_eq!(moving.rotate(&triangles), 0, "and nothing is left to do");
    }

    #[test]
    fn trees_do_not_depend_on_threads_and_stay_within_their_levels() {
        let trees = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut moving = Moving::new(build(&frame(30_000, 0.0), &Config::default()).view()).unwrap();
                for step in 1..=8 {
                    moving.rotate(&frame(30_000, step as f32 / 8.0));
                }
                moving.tree().clone()
            })
        });
        assert!(trees[0] == trees[1] && trees[0] == trees[2]);
        assert!(Statistics::of(trees[0].view()).depth <= MAX_DEPTH);
    }

    #[test]
    fn frames_of_another_mesh_are_refused() {
        let triangles = frame(5, 0.0);
        let mut broken = triangles.clone();
        broken[3].0[1].x = f32::NAN;
        assert_eq!(Moving::check_frame(&triangles, &broken), Err(UpdateError::NotFinite(3)));
        assert_eq!(
            Moving::check_frame(&triangles, &triangles[..4]),
            Err(UpdateError::OtherMesh { tree: 5, frame: 4 })
        );
        assert_eq!(Moving::check_frame(&broken, &broken), Ok(()));
    }
}
