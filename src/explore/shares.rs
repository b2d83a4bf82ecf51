//! What part of all work is spent in a node, and below it: the numbers beside a node, and what icicles and colours show.
//!
//! Work is what a query is expected to take ([`super::price`]), from the visits, leaves and blocks
//! that the real traversal counts ([`super::count`]). A visit is spent at the node whose children
//! are tested, a block at its leaf, and what a query takes on any tree at the root. Tests of boxes
//! and triangles, the paper's Γ, stand beside it.

use super::count::{Counted, NodeCount};
use super::price::Price;
use super::walk::Walk;
use crate::replay::tally::Costs;
use crate::traverse::Counts;
use crate::tree::statistics::half_area;

/// What a node's part of the whole is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Measure {
    /// Triangles in its leaves.
    Triangles,
    /// Nanoseconds of the queries that were asked.
    Cost,
    /// What surface area expects of them: every node opened by so many queries as its area is of
    /// the root's, and all in it tested.
    Area,
}

impl Measure {
    pub const ALL: [Measure; 3] = [Measure::Triangles, Measure::Cost, Measure::Area];
}

/// Counts of one tree, summed along it.
///
/// Takes 56 bytes a node beside the counts.
#[derive(Clone, Debug)]
pub struct Shares {
    pub counted: Counted,
    pub price: Price,
    /// Of Γ.
    pub costs: Costs,
    /// Of each node, what is counted at it and below.
    below: Vec<Counts>,
    /// Likewise nanoseconds.
    cost: Vec<f64>,
    /// Likewise what area expects: nanoseconds of one query through the root's box, times half the
    /// root's area.
    area: Vec<f64>,
}

/// What there is to say of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeShare {
    /// The root's is 0.
    pub level: usize,
    pub is_leaf: bool,
    /// Of an inner node its children, of a leaf its triangles.
    pub children: usize,
    /// Triangles in the leaves below; one that stands in several leaves counts in each.
    pub triangles: usize,
    /// Surface of its box, in square units of the scene, and as a part of the root's: P_U.
    pub area: f64,
    pub area_to_root: f64,
    /// Queries whose effective segment overlaps its box: P_R. And as a part of all queries.
    pub overlapped: u64,
    pub overlapped_share: f64,
    /// Queries that opened it.
    pub opened: u64,
    /// Spent at the node and below, in nanoseconds of a query on average, and as a part of the
    /// whole.
    pub cost: f64,
    pub share: f64,
    /// Spent at the node itself, as a part of the whole.
    pub own_share: f64,
    /// What area expects to be spent at the node and below, as a part of the whole.
    pub area_share: f64,
    /// Counted at the node itself.
    pub own: Counts,
    /// Counted at the node and below.
    pub below: Counts,
}

impl Shares {
    /// Sums `counted`, of the tree of `walk`.
    pub fn of(walk: &Walk, counted: Counted, price: Price, costs: Costs) -> Shares {
        let nodes = walk.tree().nodes;
        let occlusions = ratio(counted.occlusions as f64, counted.queries as f64);
        let mut shares = Shares {
            counted,
            price,
            costs,
            below: vec![Counts::default(); nodes.len()],
            cost: vec![0.0; nodes.len()],
            area: vec![0.0; nodes.len()],
        };
        // Children stand behind their parents.
        for (index, node) in nodes.iter().enumerate().rev() {
            let mut below = shares.own(walk, index as u32);
            let mut cost = shares.own_cost(walk, index as u32);
            let mut area = half_area(node) * price.opening(node, occlusions);
            if !node.is_leaf() {
                node.range().for_each(|child| below += shares.below[child]);
                cost += shares.cost[node.range()].iter().sum::<f64>();
                area += shares.area[node.range()].iter().sum::<f64>();
            }
            (shares.below[index], shares.cost[index], shares.area[index]) = (below, cost, area);
        }
        shares
    }

    /// What is counted at a node itself.
    pub fn own(&self, walk: &Walk, node: u32) -> Counts {
        let count = &self.counted.nodes[node as usize];
        let opened = u64::from(count.opened);
        let NodeCount { primitive_tests, block_tests, .. } = *count;
        let mut own = Counts { primitive_tests, block_tests, ..Counts::default() };
        let node_of_file = &walk.tree().nodes[node as usize];
        if node_of_file.is_leaf() {
            own.leaf_visits = opened;
        } else {
            own.node_visits = opened;
            own.box_tests = opened * node_of_file.len() as u64;
        }
        if node == 0 {
            own.box_tests += self.counted.queries;
        }
        own
    }

    /// Nanoseconds that are spent at a node itself by all queries.
    pub fn own_cost(&self, walk: &Walk, node: u32) -> f64 {
        let count = &self.counted.nodes[node as usize];
        let is_leaf = walk.tree().nodes[node as usize].is_leaf();
        let counts = |opened: u32, block_tests: u64| {
            let opened = u64::from(opened);
            let [node_visits, leaf_visits] = if is_leaf { [0, opened] } else { [opened, 0] };
            Counts { node_visits, leaf_visits, block_tests, ..Counts::default() }
        };
        let occlusion_blocks = u64::from(count.occlusion_block_tests);
        let closest_hit = counts(count.opened - count.occlusions, count.block_tests - occlusion_blocks);
        let occlusion = counts(count.occlusions, occlusion_blocks);
        let Counted { queries, occlusions, .. } = self.counted;
        let [closest_hits, occlusions] = if node == 0 { [queries - occlusions, occlusions] } else { [0, 0] };
        self.price.cost(false, closest_hits, closest_hit) + self.price.cost(true, occlusions, occlusion)
    }

    /// The same as a part of the whole.
    pub fn own_share(&self, walk: &Walk, node: u32) -> f64 {
        ratio(self.own_cost(walk, node), self.cost[0])
    }

    /// What is counted at a node and below.
    #[inline]
    pub fn below(&self, node: u32) -> Counts {
        self.below[node as usize]
    }

    /// What is counted of all queries.
    pub fn total(&self) -> Counts {
        self.below[0]
    }

    /// Nanoseconds of a query on average; 0 when none was asked.
    pub fn mean_cost(&self) -> f64 {
        ratio(self.cost[0], self.counted.queries as f64)
    }

    /// Γ of a query on average; 0 when none was asked.
    pub fn mean_gamma(&self) -> f64 {
        ratio(self.costs.gamma(&self.total()), self.counted.queries as f64)
    }

    /// A node's part of the whole, with what is below it: 0 to 1, and never more than its parent's. 0 where there is nothing to share.
    #[inline]
    pub fn share(&self, walk: &Walk, measure: Measure, node: u32) -> f64 {
        let of = |value: &dyn Fn(u32) -> f64| ratio(value(node), value(0));
        match measure {
            Measure::Triangles => of(&|node| walk.triangles(node).len() as f64),
            Measure::Cost => of(&|node| self.cost[node as usize]),
            Measure::Area => of(&|node| self.area[node as usize]),
        }
    }

    /// Every node with at least this share, depth first.
    pub fn nodes_above(&self, walk: &Walk, measure: Measure, share: f64) -> Vec<u32> {
        let mut found = Vec::new();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            if self.share(walk, measure, node) >= share {
                found.push(node);
                open.extend(walk.children(node).rev());
            }
        }
        found
    }

    /// All that is known of a node.
    pub fn node(&self, walk: &Walk, node: u32) -> NodeShare {
        let nodes = walk.tree().nodes;
        let (root, this) = (&nodes[0], &nodes[node as usize]);
        let count = &self.counted.nodes[node as usize];
        let (own, below) = (self.own(walk, node), self.below(node));
        let area = f64::from(this.bounds().area());
        NodeShare {
            level: walk.level(node),
            is_leaf: this.is_leaf(),
            children: this.len(),
            triangles: walk.triangles(node).len(),
            area,
            area_to_root: ratio(area, root.bounds().area().into()),
            overlapped: count.overlapped.into(),
            overlapped_share: ratio(count.overlapped.into(), self.counted.queries as f64),
            opened: count.opened.into(),
            cost: ratio(self.cost[node as usize], self.counted.queries as f64),
            share: self.share(walk, Measure::Cost, node),
            own_share: self.own_share(walk, node),
            area_share: self.share(walk, Measure::Area, node),
            own,
            below,
        }
    }
}

/// `part` / `whole`; 0 of nothing.
fn ratio(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}
