//! Queries over a tree: closest hit and occlusion, ordered depth first or strictly front to back.
//!
//! A [`Prepared`] tree is made once per tree: inner nodes in a form that is quick to test ([`pairs`] for binary
//! trees, [`groups`] for wider ones), triangles in leaf order in [`blocks`] of four. Each thread has a [`Scratch`]; nothing is allocated per
//! query. The algorithms (`odf`, `ray_order`, `any_hit`) are generic over the form, over who watches ([`Observer`]) and over which
//! triangles count ([`Candidates`]), and are compiled for each combination. Where nobody watches, wide trees are followed more quickly (`quick`).
//!
//! Queries of one kind may also be asked together ([`packet`]).
//!
//! Every form and every order gives the same answer: see [`triangle`] for how rounding is kept out of it.

/// Runs `$run` with `$nodes` as the form of `$prepared`: the one place where layouts are told apart.
macro_rules! with_form {
    ($prepared:expr, $nodes:ident => $run:expr) => {
        match &$prepared.nodes {
            $crate::traverse::Nodes::Pairs($nodes) => $run,
            $crate::traverse::Nodes::Fours($nodes) => $run,
            $crate::traverse::Nodes::Eights($nodes) => $run,
        }
    };
}

mod any_hit;
pub mod blocks;
pub mod candidates;
pub mod child_order;
pub mod encounter;
pub mod form;
pub mod groups;
mod leaf;
pub mod masks;
mod memory;
pub mod observer;
mod odf;
pub mod overlap;
pub mod packet;
pub mod pairs;
#[cfg(target_arch = "x86_64")]
mod quick;
pub mod ray;
mod ray_order;
mod simd;
pub mod triangle;

pub use candidates::{All, Candidates, Recorded};
pub use child_order::{OcclusionOrder, OrderError, OrderName};
pub use encounter::{Encounter, cheapest_proof};
pub use form::Link;
pub use masks::Masks;
pub use observer::{Counts, Observer, Path, Step};
pub use overlap::{Overlap, Overlapped};
pub use packet::{Decisions, PacketCounts, PacketObserver, PacketScratch};
pub use ray::PreparedRay;
pub use triangle::PreparedTriangle;

use crate::format::bvh::Geometry;
use crate::geometry::{Aabb, Ray, Triangle};
use crate::tree::TreeView;
use blocks::Blocks;
use child_order::{Always, ChildOrder, Drawn, LargerFirst, NearestFirst, OutsideFirst, PerNode, rule};
use form::{Below, Room};
use groups::Groups;
use pairs::Pairs;
use serde::{Deserialize, Serialize};
use simd::Machine;

/// In which order nodes are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Traversal {
    /// Ordered depth first: the nearer child first.
    Odf,
    /// Strictly front to back, with a priority queue.
    RayOrder,
}

impl Traversal {
    pub const ALL: [Traversal; 2] = [Traversal::Odf, Traversal::RayOrder];

    /// The key in JSON and CSV.
    pub fn key(self) -> &'static str {
        match self {
            Traversal::Odf => "odf",
            Traversal::RayOrder => "ray_order",
        }
    }

    /// The name for people.
    pub fn name(self) -> &'static str {
        match self {
            Traversal::Odf => "ODF",
            Traversal::RayOrder => "RayOrder",
        }
    }
}

/// The answer to a closest-hit query.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hit {
    /// In units of the direction's length.
    pub t: f32,
    /// Index into `TRIS`.
    pub triangle: u32,
}

/// What one thread keeps from query to query.
#[derive(Debug, Default)]
pub struct Scratch {
    room: Room,
    queue: ray_order::Queue,
    waiting: any_hit::Waiting,
    #[cfg(target_arch = "x86_64")]
    quick: quick::Room,
}

#[derive(Debug)]
enum Nodes {
    Pairs(Pairs),
    Fours(Groups<4>),
    Eights(Groups<8>),
}

/// A tree made ready to be traversed.
///
/// Takes 64 bytes per inner node of a binary tree, 128 per four or 256 per eight children of another, and 48 per primitive.
#[derive(Debug)]
pub struct Prepared {
    nodes: Nodes,
    root: Link,
    root_bounds: Aabb,
    blocks: Blocks,
    /// Nodes in the file.
    node_count: usize,
    /// Most entries that can wait on a stack.
    stack_size: usize,
    /// Whether the processor has AVX2, FMA and the bit instructions that came with them: asked once, not per query.
    #[cfg_attr(
        not(target_arch = "x86_64"),
        expect(dead_code, reason = "x86-64 has processors with and without")
    )]
    fused: bool,
    #[cfg(target_arch = "x86_64")]
    level: quick::Level,
}

impl Prepared {
    /// Prepares `tree` over `triangles`, all of whose indices have been checked.
    ///
    /// A triangle that no geometry names is seen by every mask.
    pub fn new(tree: TreeView, triangles: &[Triangle], geometries: &[Geometry]) -> Prepared {
        let (blocks, slots) = Blocks::new(tree, triangles, &Masks::new(geometries));
        let widest = tree.nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.len()).max();
        let nodes = match Pairs::new(tree, &slots) {
            Some(pairs) => Nodes::Pairs(pairs),
            None if widest > Some(4) => Nodes::Eights(Groups::new(tree, &slots)),
            None => Nodes::Fours(Groups::new(tree, &slots)),
        };
        let below = match &nodes {
            Nodes::Pairs(pairs) => pairs.root(),
            Nodes::Fours(groups) => groups.root(),
            Nodes::Eights(groups) => groups.root(),
        };
        let root = Link::to(0, below, 0.0);
        let root_bounds = tree.nodes[0].bounds();
        let node_count = tree.nodes.len();
        let fused = fused();
        Prepared {
            #[cfg(target_arch = "x86_64")]
            level: quick::Level::of(&nodes, fused),
            nodes,
            root,
            root_bounds,
            blocks,
            node_count,
            stack_size: stack_size(tree),
            fused,
        }
    }

    /// Whether every inner node has two children.
    pub fn is_binary(&self) -> bool {
        matches!(self.nodes, Nodes::Pairs(_))
    }

    /// The closest hit in (tnear, tfar] among `candidates`; of several at the same t, the triangle of the lowest index.
    #[inline]
    pub fn closest_hit<O: Observer>(
        &self,
        traversal: Traversal,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if !O::STEPS
            && traversal == Traversal::Odf
            && let Some(best) = self.quick_nearest::<false>(ray, candidates, scratch)
        {
            return best.hit();
        }
        self.query::<false>(traversal, &NearestFirst, ray, candidates, observer, scratch)
    }

    /// Whether anything among `candidates` is hit in (tnear, tfar], and what was found first.
    #[inline]
    pub fn occluder<O: Observer>(
        &self,
        traversal: Traversal,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if !O::STEPS
            && traversal == Traversal::Odf
            && let Some(best) = self.quick_nearest::<true>(ray, candidates, scratch)
        {
            return best.hit();
        }
        self.query::<true>(traversal, &NearestFirst, ray, candidates, observer, scratch)
    }

    /// [`Self::occluder`], depth first, with children in the order that `order` says.
    #[inline]
    pub fn occluder_in<O: Observer>(
        &self,
        order: &OcclusionOrder,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if !O::STEPS
            && let Some(best) = self.quick_occluder(order, ray, candidates, scratch)
        {
            return best.hit();
        }
        macro_rules! run {
            ($order:expr) => {
                self.query::<true>(Traversal::Odf, &$order, ray, candidates, observer, scratch)
            };
        }
        match order {
            OcclusionOrder::Recorded(orders) => run!(PerNode(orders)),
            OcclusionOrder::Nearest => run!(NearestFirst),
            OcclusionOrder::Farthest => run!(Always::<{ rule::FARTHEST }>),
            OcclusionOrder::Area(areas) => run!(LargerFirst(areas)),
            OcclusionOrder::Outside if O::NODES => run!(OutsideFirst(ray.tnear)),
            OcclusionOrder::Outside => self.any_hit::<true>(ray, candidates, observer, scratch),
            OcclusionOrder::First if O::NODES => run!(Always::<{ rule::FIRST }>),
            OcclusionOrder::First => self.any_hit::<false>(ray, candidates, observer, scratch),
            OcclusionOrder::Last => run!(Always::<{ rule::LAST }>),
            OcclusionOrder::Random(seed) => run!(Drawn::new(*seed, ray)),
        }
    }

    /// [`Self::occluder_in`] for an observer that does not look at numbers of nodes: in the order of the file, or `OUTSIDE` first.
    #[inline]
    fn any_hit<const OUTSIDE: bool>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if self.fused {
            // SAFETY: the processor has these features, or `fused` would be false.
            return unsafe { self.any_hit_fused::<OUTSIDE>(ray, candidates, observer, scratch) };
        }
        self.any_hit_on::<OUTSIDE, simd::Any>(ray, candidates, observer, scratch)
    }

    /// `any_hit_on`, compiled for processors with AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn any_hit_fused<const OUTSIDE: bool>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        self.any_hit_on::<OUTSIDE, simd::Avx2>(ray, candidates, observer, scratch)
    }

    #[inline(always)]
    fn any_hit_on<const OUTSIDE: bool, M: Machine>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        observer.root();
        ray.entry(&self.root_bounds, ray.tfar)?;
        let root = Below { first: self.root.first, count: self.root.count };
        let stack = scratch.waiting.room(self.stack_size);
        let blocks = &self.blocks;
        let best = with_form!(self, form => {
            any_hit::run::<OUTSIDE, M, _>(form, root, blocks, ray, candidates, observer, stack)
        });
        best.hit()
    }

    #[inline]
    fn query<const ANY: bool>(
        &self,
        traversal: Traversal,
        order: &impl ChildOrder,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if self.fused {
            // SAFETY: the processor has these features, or `fused` would be false.
            return unsafe { self.query_fused::<ANY>(traversal, order, ray, candidates, observer, scratch) };
        }
        self.query_on::<ANY, simd::Any>(traversal, order, ray, candidates, observer, scratch)
    }

    /// `query_on`, compiled for processors with AVX2 and fused multiply-add: the same bits, sooner.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn query_fused<const ANY: bool>(
        &self,
        traversal: Traversal,
        order: &impl ChildOrder,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        self.query_on::<ANY, simd::Avx2>(traversal, order, ray, candidates, observer, scratch)
    }

    #[inline(always)]
    fn query_on<const ANY: bool, M: Machine>(
        &self,
        traversal: Traversal,
        order: &impl ChildOrder,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        observer.root();
        let root = Link { entry: ray.entry(&self.root_bounds, ray.tfar)?, ..self.root };
        let blocks = &self.blocks;
        let best = match traversal {
            Traversal::Odf => with_form!(self, form => {
                let stack = scratch.room.stack(self.stack_size);
                let best = leaf::Best::end_of(ray);
                odf::run::<ANY, M, _>(form, root, order, blocks, ray, candidates, observer, best, stack)
            }),
            Traversal::RayOrder => with_form!(self, form => {
                let queue = &mut scratch.queue;
                ray_order::run::<ANY, M, _>(form, root, blocks, ray, candidates, observer, queue)
            }),
        };
        best.hit()
    }

    /// Tells `counter` of every node whose box the segment [tnear, `tfar`] of `ray` overlaps.
    pub fn overlap(
        &self,
        ray: &PreparedRay,
        tfar: f32,
        counter: &mut impl Overlapped,
        scratch: &mut Scratch,
    ) {
        let tfar = tfar.min(ray.tfar);
        if let Some(entry) = ray.entry(&self.root_bounds, tfar) {
            let root = Link { entry, ..self.root };
            let stack = scratch.room.stack(self.stack_size);
            with_form!(self, form => overlap::run::<simd::Any, _>(form, root, ray, tfar, counter, stack));
        }
    }
}

impl Prepared {
    /// P_R of every node: how many of the segments `rays` overlap its box, by its index in the file.
    pub fn overlaps(&self, rays: &[Ray]) -> Vec<u64> {
        let mut counts = overlap::PerNode(vec![0; self.node_count]);
        let mut scratch = Scratch::default();
        for ray in rays.iter().map(PreparedRay::new) {
            self.overlap(&ray, ray.tfar, &mut counts, &mut scratch);
        }
        counts.0
    }

    /// How many nodes' boxes a query's segment overlaps: the encounters that [`Self::encounters`] finds.
    pub fn overlapped(&self, ray: &PreparedRay, scratch: &mut Scratch) -> usize {
        let mut count = encounter::Overlaps::default();
        self.overlap(ray, ray.tfar, &mut count, scratch);
        count.0
    }

    /// Adds everything that an occlusion query could meet to `found`, see [`encounter`].
    pub fn encounters(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
        found: &mut Vec<Encounter>,
    ) {
        #[cfg(target_arch = "x86_64")]
        if self.fused {
            // SAFETY: the processor has these features, or `fused` would be false.
            return unsafe { self.encounters_fused(ray, candidates, scratch, found) };
        }
        self.encounters_on::<simd::Any>(ray, candidates, scratch, found);
    }

    /// `encounters_on`, compiled for processors with AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn encounters_fused(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
        found: &mut Vec<Encounter>,
    ) {
        self.encounters_on::<simd::Avx2>(ray, candidates, scratch, found);
    }

    #[inline(always)]
    fn encounters_on<M: Machine>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
        found: &mut Vec<Encounter>,
    ) {
        let Some(entry) = ray.entry(&self.root_bounds, ray.tfar) else { return };
        let root = Link { entry, ..self.root };
        let stack = scratch.room.stack(self.stack_size);
        let blocks = &self.blocks;
        with_form!(self, form => encounter::run::<M, _>(form, root, blocks, ray, candidates, stack, found));
    }
}

/// Whether the functions compiled for AVX2 and fused multiply-add may run here.
fn fused() -> bool {
    #[cfg(target_arch = "x86_64")]
    let fused = is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt");
    #[cfg(not(target_arch = "x86_64"))]
    let fused = false;
    fused
}

/// Most entries on a stack: on every level of the deepest path all children but the one that is followed, and room for
/// one node's children before they are sorted.
fn stack_size(tree: TreeView) -> usize {
    // Children stand behind their parents, so what waits above a node is known when it is reached.
    let mut waiting = vec![0usize; tree.nodes.len()];
    let (mut most, mut widest) = (0, 0);
    for (index, node) in tree.nodes.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
        let below = waiting[index] + node.len().saturating_sub(1);
        most = most.max(below);
        widest = widest.max(node.len());
        waiting[node.range()].fill(below);
    }
    most + widest + 1
}
