//! Who watches a traversal. Traversals are compiled once per observer, so one that ignores everything costs nothing.

use super::Hit;
use super::form::Link;
use super::triangle::PreparedTriangle;
use serde::{Deserialize, Serialize};

/// Told of each step of a traversal, in order. `()` ignores all of it.
pub trait Observer {
    /// Whether it looks at anything.
    const STEPS: bool = true;

    /// Whether it looks at [`Link::node`]: some traversals know no numbers of nodes.
    const NODES: bool = true;

    /// The root's box is tested.
    #[inline(always)]
    fn root(&mut self) {}

    /// An inner node is visited: the boxes of its `node.count` children are tested.
    #[inline(always)]
    fn inner(&mut self, _node: &Link) {}

    /// After [`Self::inner`]: `followed` is the child that is opened next, if one is already known, and `waiting` all that is put off, of which the
    /// last is taken up first. Children that are neither were missed.
    #[inline(always)]
    fn waiting(&mut self, _followed: Option<&Link>, _waiting: &[Link]) {}

    /// What waited is taken up; it is not `followed` when it begins behind the best hit so far.
    #[inline(always)]
    fn popped(&mut self, _link: &Link, _followed: bool) {}

    /// A leaf is opened.
    #[inline(always)]
    fn leaf(&mut self, _leaf: &Link) {}

    /// A triangle is hit, no later than any before it. Comes before the triangle's own [`Self::primitive`].
    #[inline(always)]
    fn hit(&mut self, _hit: Hit) {}

    /// A triangle is tested.
    #[inline(always)]
    fn primitive(&mut self, _triangle: &PreparedTriangle) {}

    /// These triangles, which lie in one block, are tested, in this order.
    #[inline(always)]
    fn primitives(&mut self, triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        for triangle in triangles {
            self.primitive(&triangle);
        }
    }
}

impl Observer for () {
    const STEPS: bool = false;

    const NODES: bool = false;

    #[inline(always)]
    fn primitives(&mut self, _triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {}
}

/// What a query cost, in the words of the design.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Boxes tested, the root's included.
    pub box_tests: u64,
    /// Inner nodes whose children were tested: on a wide tree, one vector operation each.
    pub node_visits: u64,
    pub primitive_tests: u64,
    /// Leaves whose triangles were tested. Packets count them for rays that go alone only.
    pub leaf_visits: u64,
    /// Blocks of up to four triangles of one leaf that were tested together; of packets as above.
    pub block_tests: u64,
}

impl Observer for Counts {
    const NODES: bool = false;

    #[inline(always)]
    fn root(&mut self) {
        self.box_tests += 1;
    }

    #[inline(always)]
    fn inner(&mut self, node: &Link) {
        self.node_visits += 1;
        self.box_tests += u64::from(node.count);
    }

    #[inline(always)]
    fn leaf(&mut self, _leaf: &Link) {
        self.leaf_visits += 1;
    }

    #[inline(always)]
    fn primitives(&mut self, triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        self.primitive_tests += triangles.len() as u64;
        self.block_tests += 1;
    }
}

/// One step of a recorded path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// An inner node of the file.
    Inner(u32),
    /// A leaf of the file.
    Leaf(u32),
    /// A triangle, as an index into `TRIS`.
    Triangle(u32),
}

/// The nodes and triangles that a query met, in order.
#[derive(Clone, Debug, Default)]
pub struct Path {
    pub steps: Vec<Step>,
}

impl Observer for Path {
    fn inner(&mut self, node: &Link) {
        self.steps.push(Step::Inner(node.node));
    }

    fn leaf(&mut self, leaf: &Link) {
        self.steps.push(Step::Leaf(leaf.node));
    }

    fn primitive(&mut self, triangle: &PreparedTriangle) {
        self.steps.push(Step::Triangle(triangle.index));
    }
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Counts) {
        self.box_tests += other.box_tests;
        self.node_visits += other.node_visits;
        self.primitive_tests += other.primitive_tests;
        self.leaf_visits += other.leaf_visits;
        self.block_tests += other.block_tests;
    }
}
