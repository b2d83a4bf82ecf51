//! What part of all work is spent in a node, and below it: the numbers beside a node, and what icicles and colours show.
//!
//! Work is Γ = c_I · box tests + c_P · primitive tests, as the real traversal counts it ([`super::count`]). A test of a box is spent at the node
//! whose child the box is of; that of the root's box at the root.

use super::count::Counted;
use super::walk::Walk;
use crate::replay::tally::Costs;
use crate::traverse::Counts;
use crate::tree::statistics::node_cost;

/// What a node's part of the whole is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Measure {
    /// Triangles in its leaves.
    Triangles,
    /// Γ of the queries that were asked.
    Cost,
    /// Expected cost by surface area: the terms of the SAH cost.
    Area,
}

impl Measure {
    pub const ALL: [Measure; 3] = [Measure::Triangles, Measure::Cost, Measure::Area];
}

/// Counts of one tree, summed along it.
///
/// Takes 32 bytes a node beside the counts.
#[derive(Clone, Debug)]
pub struct Shares {
    pub counted: Counted,
    pub costs: Costs,
    /// Of each node, what is spent at it and below.
    below: Vec<Counts>,
    /// Likewise the terms of the SAH cost.
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
    /// Spent at the node itself.
    pub own: Counts,
    /// Spent at the node and below.
    pub below: Counts,
    /// `own` and `below` as parts of the whole Γ.
    pub own_share: f64,
    pub share: f64,
    /// Of the SAH cost, at the node and below.
    pub area_share: f64,
}

impl Shares {
    /// Sums `counted`, of the tree of `walk`.
    pub fn of(walk: &Walk, counted: Counted, costs: Costs) -> Shares {
        let nodes = walk.tree().nodes;
        let mut shares = Shares {
            counted,
            costs,
            below: vec![Counts::default(); nodes.len()],
            area: vec![0.0; nodes.len()],
        };
        // Children stand behind their parents.
        for (index, node) in nodes.iter().enumerate().rev() {
            let mut below = shares.own(walk, index as u32);
            let mut area = node_cost(node, costs.c_i, costs.c_p);
            if !node.is_leaf() {
                node.range().for_each(|child| below += shares.below[child]);
                area += shares.area[node.range()].iter().sum::<f64>();
            }
            (shares.below[index], shares.area[index]) = (below, area);
        }
        shares
    }

    /// What is spent at a node itself.
    pub fn own(&self, walk: &Walk, node: u32) -> Counts {
        let count = &self.counted.nodes[node as usize];
        let opened = u64::from(count.opened);
        let mut own = Counts { primitive_tests: count.primitive_tests, ..Counts::default() };
        let node_of_file = &walk.tree().nodes[node as usize];
        if !node_of_file.is_leaf() {
            own.node_visits = opened;
            own.box_tests = opened * node_of_file.len() as u64;
        }
        if node == 0 {
            own.box_tests += self.counted.queries;
        }
        own
    }

    /// What is spent at a node and below.
    #[inline]
    pub fn below(&self, node: u32) -> Counts {
        self.below[node as usize]
    }

    /// What all queries cost.
    pub fn total(&self) -> Counts {
        self.below[0]
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
            Measure::Cost => of(&|node| self.costs.gamma(&self.below(node))),
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
        let total = self.costs.gamma(&self.total());
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
            own,
            below,
            own_share: ratio(self.costs.gamma(&own), total),
            share: self.share(walk, Measure::Cost, node),
            area_share: self.share(walk, Measure::Area, node),
        }
    }
}

/// `part` / `whole`; 0 of nothing.
fn ratio(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}
