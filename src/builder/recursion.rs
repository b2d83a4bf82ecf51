//! The recursion that all top-down algorithms share: when to stop, where nodes go, and what runs beside what.
//!
//! # Layout
//! Siblings are adjacent; below a pair comes the whole left subtree, then the whole right one. A subtree over n
//! primitives has at most 2 n - 1 nodes, so each knows its place before it is built: subtrees are written by different
//! threads without a lock, and the bytes cannot depend on which came first. Depth first also is what a traversal
//! reads: its next node is usually the pair behind the current one. With leaves of more than one primitive the places
//! that stayed empty are closed at the end.
//!
//! # Leaves
//! Every subtree is built down to single primitives. On the way back, one that holds few enough becomes a leaf when
//! that costs no more (SAH: 2 c_I · P + cost of the children, against c_P · n · P). So the choice is the best for this
//! topology; stopping on the way down would miss splits that pay only two levels later.

use super::binned::BinnedReferences;
use super::cost::Weight;
use super::reference::{Reference, References};
use super::spatial::{self, SpatialReferences};
use super::sweep::SweepReferences;
use super::{Config, MAX_DEPTH, Splits};
use crate::geometry::padded::PaddedAabb;
use crate::probability::{Probability, Side};
use crate::progress::Progress;
use crate::tree::{Node, Tree};
use crate::zeroed::zeroed_vec;

/// Subtrees with fewer primitives are built by one thread.
const SEQUENTIAL: usize = 1 << 12;

/// A way to divide the references of a node.
#[derive(Clone, Copy, Debug)]
pub struct Split<Plane> {
    /// What the algorithm needs to divide accordingly.
    pub plane: Plane,
    pub left: Side,
    pub right: Side,
}

/// The references of one node, as an algorithm keeps them. Memory is borrowed from one allocation for the whole tree.
pub trait NodeReferences: Send + Sized {
    type Plane: Copy + Send;

    /// How many there are; at least one.
    fn len(&self) -> usize;

    /// How many there can be at most in the leaves below, when some are duplicated.
    fn capacity(&self) -> usize {
        self.len()
    }

    /// The candidate of least cost, if there is any. Called for two or more references.
    fn best_split<P: Probability, W: Weight>(
        &mut self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Split<Self::Plane>>;

    /// A split in the middle, for when no candidate will do. Both sides have at least half, rounded down.
    fn halves(&mut self) -> Split<Self::Plane>;

    /// Carries `split` out. Neither side gets more references than the split says.
    fn divide(self, split: &Split<Self::Plane>) -> (Self, Self);

    /// The box of all references, of which a split promised that it would lie in `promised`.
    fn bounds(&self, promised: &PaddedAabb) -> PaddedAabb {
        *promised
    }

    /// Writes the triangles of the references, in order.
    fn triangles(&self, out: &mut [u32]);
}

/// Everything that stays the same during a build.
pub struct Builder<'a, P, W> {
    pub probability: &'a P,
    pub weight: W,
    pub config: &'a Config,
    pub progress: &'a Progress,
}

/// In the list of primitives: a place that no reference came to.
const UNUSED: u32 = u32::MAX;

/// A subtree that is to be built: its input, and where its output goes.
struct Job<'a, R, S> {
    references: R,
    bounds: PaddedAabb,
    state: S,
    /// Levels from the root, which is 1.
    level: usize,
    /// Places for the nodes below this one; the first has number `first_node` in the tree.
    nodes: &'a mut [Node],
    first_node: usize,
    /// The same for primitives.
    primitives: &'a mut [u32],
    first_primitive: usize,
}

/// What was built, without the nodes below that are already in their places.
struct Subtree {
    node: Node,
    /// SAH cost, in the measure of the probability; only right where a leaf is possible.
    cost: f64,
}

impl<P: Probability, W: Weight> Builder<'_, P, W> {
    /// Builds the tree over `references`, of which there is at least one.
    pub fn run(&self, references: References) -> Tree {
        let References { triangles, mut list, bounds, half_unit } = references;
        match self.config.splits {
            Splits::Binned { bins } => {
                // Zeroed by the system, page by page when it is first touched, on the thread that does.
                let mut spare: Vec<Reference> = zeroed_vec(list.len());
                self.root(BinnedReferences::new(&mut list, &mut spare, half_unit, bins), bounds)
            }
            Splits::Sweep => {
                let mut columns = SweepReferences::columns(list, half_unit);
                self.root(columns.references(), bounds)
            }
            Splits::Spatial(options) => {
                let count = list.len();
                let scene = spatial::Scene::new(triangles, &bounds, half_unit, &options);
                let mut list = spatial::with_room(list, &options);
                let mut spare: Vec<Reference> = zeroed_vec(list.len());
                self.root(SpatialReferences::new(&mut list, count, &mut spare, bounds, &scene), bounds)
            }
        }
    }

    fn root<R: NodeReferences>(&self, references: R, bounds: PaddedAabb) -> Tree {
        let (count, capacity) = (references.len(), references.capacity());
        let mut nodes: Vec<Node> = zeroed_vec(2 * capacity - 1);
        let mut primitives = vec![UNUSED; capacity];
        let state = self.probability.root(&bounds);
        let (root, below) = nodes.split_at_mut(1);
        root[0] = self
            .subtree(Job {
                references,
                bounds,
                state,
                level: 1,
                nodes: below,
                first_node: 1,
                primitives: &mut primitives,
                first_primitive: 0,
            })
            .node;
        if self.config.max_leaf > 1 || capacity > count {
            close_gaps(&mut nodes);
        }
        if capacity > count {
            close_primitive_gaps(&mut nodes, &mut primitives);
        }
        Tree { nodes, primitives }
    }

    /// Builds a subtree. Its topmost node is for the caller to put beside its sibling.
    fn subtree<R: NodeReferences>(&self, mut job: Job<R, P::State>) -> Subtree {
        let count = job.references.len();
        let may_be_leaf = count <= self.config.max_leaf;
        // Asked before the state goes to the children, and only where it decides something.
        let probability =
            if may_be_leaf { self.probability.node(&job.state, &job.bounds) as f64 } else { 0.0 };
        let leaf = Subtree {
            // All that is in the places of this subtree, used or not.
            node: Node::leaf(job.bounds.into(), job.first_primitive as u32, job.primitives.len() as u32),
            cost: self.config.c_p * count as f64 * probability,
        };
        if count == 1 {
            job.references.triangles(&mut job.primitives[..1]);
            return leaf;
        }
        let split = job.references.best_split(self.probability, &job.state, &self.weight);
        let split = split.filter(|split| fits(split, job.level)).unwrap_or_else(|| job.references.halves());
        let (left_references, right_references) = job.references.divide(&split);
        let left_bounds = left_references.bounds(&split.left.bounds);
        let right_bounds = right_references.bounds(&split.right.bounds);
        let asked = |references: &R, bounds| self.decides(references.len()).then_some(bounds);
        let [left_state, right_state] = self.probability.split(
            job.state,
            [asked(&left_references, &left_bounds), asked(&right_references, &right_bounds)],
        );
        let (pair, below) = job.nodes.split_at_mut(2);
        let left_capacity = left_references.capacity();
        let left_below = 2 * left_capacity - 2;
        let (left_nodes, right_nodes) = below.split_at_mut(left_below);
        let (left_primitives, right_primitives) = job.primitives.split_at_mut(left_capacity);
        let left = Job {
            references: left_references,
            bounds: left_bounds,
            state: left_state,
            level: job.level + 1,
            nodes: left_nodes,
            first_node: job.first_node + 2,
            primitives: left_primitives,
            first_primitive: job.first_primitive,
        };
        let right = Job {
            references: right_references,
            bounds: right_bounds,
            state: right_state,
            level: job.level + 1,
            nodes: right_nodes,
            first_node: job.first_node + 2 + left_below,
            primitives: right_primitives,
            first_primitive: job.first_primitive + left_capacity,
        };
        let (left, right) = if count >= SEQUENTIAL {
            rayon::join(|| self.reported(left), || self.reported(right))
        } else {
            (self.subtree(left), self.subtree(right))
        };
        let cost = 2.0 * self.config.c_i * probability + left.cost + right.cost;
        if may_be_leaf && leaf.cost <= cost {
            return leaf;
        }
        (pair[0], pair[1]) = (left.node, right.node);
        Subtree { node: Node::inner(job.bounds.into(), job.first_node as u32, 2), cost }
    }

    /// Whether P decides anything about a child: how it is divided, or whether it becomes a leaf.
    fn decides(&self, primitives: usize) -> bool {
        primitives > 2 || self.config.max_leaf > 1
    }

    /// Builds a subtree, and tells the progress when it is one that a single thread builds.
    fn reported<R: NodeReferences>(&self, job: Job<R, P::State>) -> Subtree {
        let count = job.references.len();
        let subtree = self.subtree(job);
        if count < SEQUENTIAL {
            self.progress.advance(count as u64);
        }
        subtree
    }
}

/// Whether the children of a node at `level` could still be finished above [`MAX_DEPTH`] by splits in the middle.
/// As the root can, and halves can where their parent could, no leaf is deeper.
#[inline]
fn fits<Plane>(split: &Split<Plane>, level: usize) -> bool {
    let larger = split.left.primitives.max(split.right.primitives);
    let levels_below = larger.next_power_of_two().trailing_zeros() as usize;
    level + 1 + levels_below <= MAX_DEPTH
}

/// Moves nodes together where subtrees used fewer than the places they had, keeping the layout.
fn close_gaps(nodes: &mut Vec<Node>) {
    // Pairs in depth-first order, with the parent to tell where they went. A pair never moves up past one that
    // is still to be read, because those all stand behind it.
    let mut pairs = Vec::with_capacity(2 * MAX_DEPTH);
    let mut end = 1;
    if !nodes[0].is_leaf() {
        pairs.push((nodes[0].first as usize, 0));
    }
    while let Some((from, parent)) = pairs.pop() {
        let to = end;
        end += 2;
        nodes[parent as usize].first = to as u32;
        for child in [1, 0] {
            let node = nodes[from + child];
            if !node.is_leaf() {
                pairs.push((node.first as usize, (to + child) as u32));
            }
        }
        nodes.copy_within(from..from + 2, to);
    }
    nodes.truncate(end);
    nodes.shrink_to_fit();
}

/// The same for primitives. A triangle of which a leaf got several parts stands in it once.
fn close_primitive_gaps(nodes: &mut [Node], primitives: &mut Vec<u32>) {
    let mut end = 0;
    let mut open = vec![0];
    while let Some(index) = open.pop() {
        let node = nodes[index];
        if !node.is_leaf() {
            open.extend(node.range().rev());
            continue;
        }
        primitives[node.range()].sort_unstable();
        let first = end;
        for place in node.range() {
            let triangle = primitives[place];
            if triangle != UNUSED && (end == first || primitives[end - 1] != triangle) {
                primitives[end] = triangle;
                end += 1;
            }
        }
        nodes[index] = Node::leaf(node.bounds(), first as u32, (end - first) as u32);
    }
    primitives.truncate(end);
    primitives.shrink_to_fit();
}
