//! In which order an occlusion query visits the children of a node. Any order gives the same answer; what it costs to find an
//! occluder differs a lot.
//!
//! A [`ChildOrder`] compares two children; the depth-first traversal is compiled once for each, and closest-hit queries only
//! ever with `NearestFirst`. Two orders need no comparison, and have a traversal of their own (`any_hit`), which is quicker: that of the file,
//! and the same with those children first that the ray does not start in. A ray that starts in a box mostly leaves it: what it started from is convex,
//! or looks outwards. One that enters from outside is mostly stopped. An [`OcclusionOrder`] is what a user chooses and what is chosen for a tree: one rule for all
//! nodes, or a rule per node as the section `ORDR` of a `.bvh` has it.

use super::form::{Form, Link, Stack};
use super::ray::PreparedRay;
use super::simd::Machine;
use crate::geometry::Ray;
use crate::random::mixed;
use crate::tree::TreeView;
use thiserror::Error;

/// Rules of a node, as bytes of `ORDR`.
pub mod rule {
    /// The child entered first; of equals the first in the file.
    pub const NEAREST: u8 = 0;
    /// In the order of the file.
    pub const FIRST: u8 = 1;
    /// In the reverse order of the file.
    pub const LAST: u8 = 2;
    /// Exactly the reverse of [`NEAREST`].
    pub const FARTHEST: u8 = 3;
    /// How many there are.
    pub const COUNT: usize = 4;
}

/// Which of two children is visited first: a strict order, whatever the ray.
pub trait ChildOrder {
    /// Whether `a` is visited before `b`; both are children of `parent` that the ray overlaps.
    fn precedes(&self, parent: &Link, a: &Link, b: &Link) -> bool;

    /// A way to [`Self::enter`] that the form of the tree has of its own; without one, children are sorted.
    const SHORTCUT: Option<Shortcut> = None;

    /// The child visited first, if any is overlapped; the others go onto the stack, the last of them first. `found`
    /// is called with each.
    #[inline(always)]
    fn enter<M: Machine, F: Form<M>>(
        &self,
        form: &F,
        parent: &Link,
        ray: &F::Ray,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        match Self::SHORTCUT {
            Some(Shortcut::Nearest) => return form.nearest(parent, ray, tfar, found, stack),
            Some(Shortcut::First) => return form.first(parent, ray, tfar, found, stack),
            None => {}
        }
        let before = stack.len();
        form.each(parent, ray, tfar, |link| {
            found(&link);
            stack.push(link);
        });
        let pushed = stack.above(before);
        for end in 1..pushed.len() {
            let mut place = end;
            while place > 0 && self.precedes(parent, &pushed[place - 1], &pushed[place]) {
                pushed.swap(place - 1, place);
                place -= 1;
            }
        }
        if stack.len() > before { stack.pop() } else { None }
    }
}

/// See [`ChildOrder::SHORTCUT`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shortcut {
    /// [`Form::nearest`].
    Nearest,
    /// [`Form::first`].
    First,
}

/// Rule [`rule::NEAREST`] for every node.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearestFirst;

impl ChildOrder for NearestFirst {
    const SHORTCUT: Option<Shortcut> = Some(Shortcut::Nearest);

    #[inline(always)]
    fn precedes(&self, _parent: &Link, a: &Link, b: &Link) -> bool {
        nearer(a, b)
    }
}

#[inline(always)]
fn nearer(a: &Link, b: &Link) -> bool {
    a.entry < b.entry || (a.entry == b.entry && a.node < b.node)
}

/// One rule for every node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Always<const RULE: u8>;

impl<const RULE: u8> ChildOrder for Always<RULE> {
    const SHORTCUT: Option<Shortcut> = if RULE == rule::FIRST { Some(Shortcut::First) } else { None };

    #[inline(always)]
    fn precedes(&self, _parent: &Link, a: &Link, b: &Link) -> bool {
        by_rule(RULE, a, b)
    }
}

#[inline(always)]
fn by_rule(rule: u8, a: &Link, b: &Link) -> bool {
    match rule {
        rule::FIRST => a.node < b.node,
        rule::LAST => b.node < a.node,
        rule::FARTHEST => nearer(b, a),
        _ => nearer(a, b),
    }
}

/// A rule per node.
#[derive(Clone, Copy, Debug)]
pub(super) struct PerNode<'a>(pub &'a [u8]);

impl ChildOrder for PerNode<'_> {
    #[inline(always)]
    fn precedes(&self, parent: &Link, a: &Link, b: &Link) -> bool {
        by_rule(self.0.get(parent.node as usize).copied().unwrap_or(rule::NEAREST), a, b)
    }
}

/// Those that the ray enters after its start, at this distance, first; of either sort, the first of the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutsideFirst(pub f32);

impl ChildOrder for OutsideFirst {
    #[inline(always)]
    fn precedes(&self, _parent: &Link, a: &Link, b: &Link) -> bool {
        let (a_outside, b_outside) = (a.entry > self.0, b.entry > self.0);
        if a_outside == b_outside { a.node < b.node } else { a_outside }
    }
}

/// The larger box first.
#[derive(Clone, Copy, Debug)]
pub(super) struct LargerFirst<'a>(pub &'a [f32]);

impl ChildOrder for LargerFirst<'_> {
    #[inline(always)]
    fn precedes(&self, _parent: &Link, a: &Link, b: &Link) -> bool {
        let area = |link: &Link| self.0.get(link.node as usize).copied().unwrap_or(0.0);
        let (area_a, area_b) = (area(a), area(b));
        area_a > area_b || (area_a == area_b && a.node < b.node)
    }
}

/// Drawn anew for every query and node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn(u64);

impl Drawn {
    /// What is drawn depends on the seed and the ray's bits, not on which thread follows it or when.
    #[inline]
    pub fn new(seed: u64, ray: &PreparedRay) -> Drawn {
        let words = ray.origin.to_array().into_iter().chain(ray.direction.to_array());
        Drawn(words.fold(mixed(seed), |state, word| mixed(state ^ u64::from(word.to_bits()))))
    }
}

impl ChildOrder for Drawn {
    #[inline(always)]
    fn precedes(&self, _parent: &Link, a: &Link, b: &Link) -> bool {
        let draw = |link: &Link| (mixed(self.0 ^ u64::from(link.node)), link.node);
        draw(a) < draw(b)
    }
}

/// Any order, asked once for many rays, so that it need not be known when the traversal is compiled.
#[derive(Clone, Copy, Debug)]
pub(super) struct ByRule<'a> {
    order: &'a OcclusionOrder,
    /// For the random order.
    drawn: Drawn,
    /// Where the last of the rays starts, for the order that asks who starts in a box.
    start: f32,
}

impl ByRule<'_> {
    /// A random order is drawn from the first ray.
    pub fn new<'a>(order: &'a OcclusionOrder, rays: &[Ray]) -> ByRule<'a> {
        let drawn = match (order, rays.first()) {
            (OcclusionOrder::Random(seed), Some(first)) => Drawn::new(*seed, &PreparedRay::new(first)),
            _ => Drawn(0),
        };
        let start = match order {
            OcclusionOrder::Outside => rays.iter().fold(f32::NEG_INFINITY, |start, ray| ray.tnear.max(start)),
            _ => f32::NEG_INFINITY,
        };
        ByRule { order, drawn, start }
    }

    pub fn is_nearest(&self) -> bool {
        *self.order == OcclusionOrder::Nearest
    }
}

impl ChildOrder for ByRule<'_> {
    #[inline(always)]
    fn precedes(&self, parent: &Link, a: &Link, b: &Link) -> bool {
        match self.order {
            OcclusionOrder::Nearest => nearer(a, b),
            OcclusionOrder::Recorded(orders) => PerNode(orders).precedes(parent, a, b),
            OcclusionOrder::Farthest => by_rule(rule::FARTHEST, a, b),
            OcclusionOrder::Area(areas) => LargerFirst(areas).precedes(parent, a, b),
            OcclusionOrder::Outside => OutsideFirst(self.start).precedes(parent, a, b),
            OcclusionOrder::First => by_rule(rule::FIRST, a, b),
            OcclusionOrder::Last => by_rule(rule::LAST, a, b),
            OcclusionOrder::Random(_) => self.drawn.precedes(parent, a, b),
        }
    }
}

/// The name of an order for occlusion queries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum OrderName {
    /// What was chosen for each node, from the tree's ORDR section
    Recorded,
    /// The child that the ray enters first
    Nearest,
    /// The reverse of nearest
    Farthest,
    /// The child of larger surface area (SATO)
    Area,
    /// Children that the ray enters from outside before those that it starts in, else in the order of the file
    Outside,
    /// In the order of the file
    First,
    /// In the reverse order of the file
    Last,
    /// Drawn anew for every query and node
    Random,
}

impl OrderName {
    pub const ALL: [OrderName; 8] = [
        OrderName::Recorded,
        OrderName::Nearest,
        OrderName::Farthest,
        OrderName::Area,
        OrderName::Outside,
        OrderName::First,
        OrderName::Last,
        OrderName::Random,
    ];

    /// The name in options, tables and JSON.
    pub fn key(self) -> &'static str {
        match self {
            OrderName::Recorded => "recorded",
            OrderName::Nearest => "nearest",
            OrderName::Farthest => "farthest",
            OrderName::Area => "area",
            OrderName::Outside => "outside",
            OrderName::First => "first",
            OrderName::Last => "last",
            OrderName::Random => "random",
        }
    }
}

/// The order of occlusion queries over one tree.
#[derive(Clone, Debug, PartialEq)]
pub enum OcclusionOrder {
    /// A byte of [`rule`] per node; another value counts as nearest first.
    Recorded(Vec<u8>),
    Nearest,
    Farthest,
    /// Larger surface area first (SATO: Nah and Manocha, "SATO: Surface Area Traversal Order for Shadow Ray Tracing", 2014).
    /// The area of each node's box.
    Area(Vec<f32>),
    /// Meant for trees whose children stand as [`crate::tree::likely`] sorts them.
    Outside,
    First,
    Last,
    /// With this seed.
    Random(u64),
}

/// Why a tree cannot be followed in an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum OrderError {
    #[error(
        "the tree has no section ORDR to take the order from; make one with bvh-build --order, or choose another order"
    )]
    NotRecorded,
    #[error("{orders} traversal orders for {nodes} nodes: there must be one for each")]
    Length { orders: usize, nodes: usize },
    #[error("traversal order {value} of node {node}: expected 0 to 3")]
    Value { node: usize, value: u8 },
}

impl OcclusionOrder {
    /// The order called `name` over `tree`, whose section `ORDR` is `recorded`. Without a name, what is recorded; else last first in a tree with more
    /// than two children a node, as Embree's kernels follow it, and nearest first in a binary one. A section that says
    /// the same of every node, that children are visited in the order of the file, is that order.
    ///
    /// # Errors
    /// When the recorded order is asked for and is not there, or does not fit the tree.
    pub fn new(
        name: Option<OrderName>,
        tree: TreeView,
        recorded: Option<&[u8]>,
    ) -> Result<OcclusionOrder, OrderError> {
        let is_wide = || tree.nodes.iter().any(|node| !node.is_leaf() && node.len() > 2);
        let default = || match recorded {
            Some(_) => OrderName::Recorded,
            None if is_wide() => OrderName::Last,
            None => OrderName::Nearest,
        };
        Ok(match name.unwrap_or_else(default) {
            OrderName::Recorded => {
                let orders = recorded.ok_or(OrderError::NotRecorded)?;
                if orders.len() != tree.nodes.len() {
                    return Err(OrderError::Length { orders: orders.len(), nodes: tree.nodes.len() });
                }
                if let Some(node) = orders.iter().position(|&value| usize::from(value) >= rule::COUNT) {
                    return Err(OrderError::Value { node, value: orders[node] });
                }
                // Where children stand as they are to be visited, there is nothing to look up.
                if orders.iter().all(|&order| order == rule::FIRST) {
                    return Ok(OcclusionOrder::First);
                }
                OcclusionOrder::Recorded(orders.to_vec())
            }
            OrderName::Nearest => OcclusionOrder::Nearest,
            OrderName::Farthest => OcclusionOrder::Farthest,
            OrderName::Area => {
                OcclusionOrder::Area(tree.nodes.iter().map(|node| node.bounds().area()).collect())
            }
            OrderName::Outside => OcclusionOrder::Outside,
            OrderName::First => OcclusionOrder::First,
            OrderName::Last => OcclusionOrder::Last,
            OrderName::Random => OcclusionOrder::Random(1),
        })
    }

    /// What it is called.
    pub fn name(&self) -> OrderName {
        match self {
            OcclusionOrder::Recorded(_) => OrderName::Recorded,
            OcclusionOrder::Nearest => OrderName::Nearest,
            OcclusionOrder::Farthest => OrderName::Farthest,
            OcclusionOrder::Area(_) => OrderName::Area,
            OcclusionOrder::Outside => OrderName::Outside,
            OcclusionOrder::First => OrderName::First,
            OcclusionOrder::Last => OrderName::Last,
            OcclusionOrder::Random(_) => OrderName::Random,
        }
    }
}
