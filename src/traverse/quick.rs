//! Queries that nobody watches, depth first over trees of up to eight children a node, at the speed of an x86-64 with AVX2 and FMA, or with AVX-512.
//!
//! The answers are those of every other traversal. The way there is not, box for box: boxes are tested with fewer roundings, whose error is
//! allowed for ([`slabs`]), so that now and then one is opened that a ray only nearly meets. That is why counts are not made here.
//!
//! Where a query waits for memory, children are asked for before they are needed; where it waits for the outcome of a
//! test, little is left between the mask of a test and the address of the next node. How the children that are met come into order is what
//! the two levels differ in: [`avx2`] compares them one by one, [`avx512`] sorts all of them at once and puts them onto the stack without a branch.

mod avx2;
mod avx512;
mod slabs;

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::child_order::OcclusionOrder;
use super::form::{Below, Link};
use super::groups::{Group, Groups};
use super::leaf::{self, Best};
use super::ray::PreparedRay;
use super::simd::{Avx2, prefetch};
use super::{Nodes, Prepared, Scratch};
use slabs::SlabRay;

/// What a processor and a tree allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// The tree, or the processor, has to be followed otherwise.
    None,
    Avx2,
    Avx512,
}

impl Level {
    /// Of a tree in this form; `fused` says that the processor has AVX2 and what came with it.
    pub fn of(nodes: &Nodes, fused: bool) -> Level {
        let fits = matches!(nodes, Nodes::Eights(groups) if groups.is_one_a_node());
        let avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw");
        match (fits && fused, avx512) {
            (false, _) => Level::None,
            (true, false) => Level::Avx2,
            (true, true) => Level::Avx512,
        }
    }
}

/// In which order children that are met are followed to any hit, where none are compared.
pub(super) mod order {
    /// That of the file.
    pub const FIRST: u8 = 0;
    /// The reverse.
    pub const LAST: u8 = 1;
    /// That of the file, those that the ray enters after its start before the others.
    pub const OUTSIDE: u8 = 2;
}

/// Room for what waits, kept from query to query.
#[derive(Debug, Default)]
pub(super) struct Room {
    /// Where to go on.
    below: Vec<Below>,
    /// Where the ray enters each, as an integer of the same bits; its last three bits may say something else.
    entry: Vec<i32>,
}

impl Room {
    /// Most that is written at once.
    const AT_ONCE: usize = 8;

    /// Two stacks for `capacity` entries, on whose end as many more may be written as are written at once.
    #[inline(always)]
    fn stacks(&mut self, capacity: usize) -> (&mut [Below], &mut [i32]) {
        let needed = capacity + Room::AT_ONCE;
        if self.below.len() < needed {
            self.below.resize(needed, Below::NOTHING);
            self.entry.resize(needed, 0);
        }
        (&mut self.below, &mut self.entry)
    }
}

/// A query on its way: what both levels do alike.
struct Walk<'a, C> {
    groups: &'a Groups<8>,
    blocks: &'a Blocks,
    slabs: SlabRay,
    ray: &'a PreparedRay,
    block_ray: BlockRay,
    candidates: &'a C,
    best: Best,
    stack: &'a mut [Below],
    entries: &'a mut [i32],
    top: usize,
}

impl<'a, C: Candidates> Walk<'a, C> {
    /// A query at the root; None where the tree or the ray has to be followed otherwise.
    ///
    /// # Safety
    /// The processor must have AVX2 and FMA.
    #[inline(always)]
    unsafe fn start(
        prepared: &'a Prepared,
        ray: &'a PreparedRay,
        candidates: &'a C,
        room: &'a mut Room,
    ) -> Option<Walk<'a, C>> {
        let Nodes::Eights(groups) = &prepared.nodes else { return None };
        // SAFETY: the caller says that the processor has what it takes.
        let slabs = unsafe { SlabRay::new(ray, groups.extent()) }?;
        let (stack, entries) = room.stacks(prepared.stack_size);
        let (block_ray, best) = (BlockRay::new(ray), Best::end_of(ray));
        let blocks = &prepared.blocks;
        Some(Walk { groups, blocks, slabs, ray, block_ray, candidates, best, stack, entries, top: 0 })
    }

    /// Tests the triangles of a leaf; true when the query is answered: with `ANY`, at the first hit.
    #[inline(always)]
    fn leaf<const ANY: bool>(&mut self, below: Below) -> bool {
        let leaf = Link::to(0, below, f32::NEG_INFINITY);
        let Walk { blocks, ray, block_ray, candidates, best, .. } = self;
        leaf::test::<ANY, Avx2>(&leaf, blocks, ray, block_ray, *candidates, &mut (), best)
    }

    /// Takes the top one of what waits.
    #[inline(always)]
    fn pop(&mut self) -> Option<Below> {
        self.top = self.top.checked_sub(1)?;
        Some(self.stack[self.top])
    }

    /// Takes the top one that is entered no later than at the best hit.
    #[inline(always)]
    fn pop_nearer(&mut self) -> Option<Below> {
        // Distances that are not negative compare like the integers of the same bits; below 0 no ray ends that comes here.
        let end = self.best.t.to_bits().cast_signed();
        loop {
            self.top = self.top.checked_sub(1)?;
            if self.entries[self.top] <= end {
                return Some(self.stack[self.top]);
            }
        }
    }
}

/// Asks for what is below a child.
#[inline(always)]
fn fetch(groups: &Groups<8>, blocks: &Blocks, below: Below) {
    let leaf = blocks.address(below.first as usize);
    let inner: *const Group<8> = groups.all().as_ptr().wrapping_add(below.first as usize);
    prefetch(if below.is_leaf() { leaf } else { inner.cast() });
}

/// Runs a way of the processor's level; None where there is none.
macro_rules! at_level {
    ($prepared:ident, $scratch:ident, $way:ident::<$choice:ident>($($argument:expr),*)) => {
        match $prepared.level {
            Level::None => None,
            // SAFETY: the level says that the processor has these features.
            Level::Avx2 => unsafe { avx2::$way::<$choice>($prepared, $($argument),*, &mut $scratch.quick) },
            // SAFETY: as above.
            Level::Avx512 => unsafe { avx512::$way::<$choice>($prepared, $($argument),*, &mut $scratch.quick) },
        }
    };
}

impl Prepared {
    /// The closest hit, or with `ANY` the first that is found with the nearest child first; None where the processor, the tree or the ray has to be
    /// followed otherwise.
    #[inline]
    pub(super) fn quick_nearest<const ANY: bool>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
    ) -> Option<Best> {
        at_level!(self, scratch, nearest::<ANY>(ray, candidates))
    }

    /// Any hit, with children in `order`; None as above, and where an order compares children.
    #[inline]
    pub(super) fn quick_occluder(
        &self,
        order: &OcclusionOrder,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
    ) -> Option<Best> {
        match order {
            OcclusionOrder::Nearest => self.quick_nearest::<true>(ray, candidates, scratch),
            OcclusionOrder::First => self.quick_any::<{ order::FIRST }>(ray, candidates, scratch),
            OcclusionOrder::Last => self.quick_any::<{ order::LAST }>(ray, candidates, scratch),
            OcclusionOrder::Outside => self.quick_any::<{ order::OUTSIDE }>(ray, candidates, scratch),
            _ => None,
        }
    }

    /// Any hit, with children in an `ORDER` of [`order`]; None as above.
    #[inline]
    fn quick_any<const ORDER: u8>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
    ) -> Option<Best> {
        at_level!(self, scratch, any::<ORDER>(ray, candidates))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{All, OcclusionOrder, Prepared, PreparedRay, Scratch, Traversal};
    use super::Level;
    use crate::geometry::{Ray, Triangle, Vec3};
    use crate::random::Random;
    use crate::tree::{Node, Tree};

    /// A tree of up to eight children a node over triangles as they come, one to nine a leaf.
    fn tree(triangles: &[Triangle]) -> Tree {
        let mut leaves = Vec::new();
        let mut first = 0;
        while first < triangles.len() {
            let size = (1 + leaves.len() * 5 % 9).min(triangles.len() - first);
            let bounds = triangles[first..first + size].iter().map(Triangle::bounds);
            let bounds = bounds.reduce(|a, b| a.union(&b)).unwrap();
            leaves.push(Node::leaf(bounds, first as u32, size as u32));
            first += size;
        }
        let groups: Vec<&[Node]> = leaves.chunks(7).collect();
        let parts: Vec<&[&[Node]]> = groups.chunks(8).collect();
        let bounds = |nodes: &[Node]| nodes.iter().map(Node::bounds).reduce(|a, b| a.union(&b)).unwrap();
        let within = |part: &[&[Node]]| part.iter().map(|g| bounds(g)).reduce(|a, b| a.union(&b)).unwrap();
        let mut nodes = vec![Node::inner(bounds(&leaves), 1, parts.len() as u32)];
        let mut next = 1 + parts.len();
        for part in &parts {
            nodes.push(Node::inner(within(part), next as u32, part.len() as u32));
            next += part.len();
        }
        for group in &groups {
            nodes.push(Node::inner(bounds(group), next as u32, group.len() as u32));
            next += group.len();
        }
        nodes.extend(leaves.iter().copied());
        Tree { nodes, primitives: (0..triangles.len() as u32).collect() }
    }

    #[test]
    fn every_level_gives_the_same_answers() {
        let random = &mut Random::new(3);
        let mut vector = |scale: f64| Vec3::from_array([0; 3].map(|_| (scale * random.signed()) as f32));
        let triangles: Vec<Triangle> = (0..900)
            .map(|_| {
                let at = vector(10.0);
                Triangle([at, at + vector(3.0), at + vector(3.0)])
            })
            .collect();
        let tree = tree(&triangles);
        let mut prepared = Prepared::new(tree.view(), &triangles, &[]);
        let best = prepared.level;
        let levels: &[Level] = match best {
            Level::None => &[],
            Level::Avx2 => &[Level::Avx2],
            Level::Avx512 => &[Level::Avx2, Level::Avx512],
        };
        let rays: Vec<PreparedRay> = (0..3000)
            .map(|number| {
                let origin = vector(14.0);
                let direction = vector(10.0) - origin;
                let tnear = [0.0, f32::MIN_POSITIVE, 0.4, -0.5][number % 4];
                let tfar = [f32::INFINITY, 0.6, 1.0][number % 3];
                // Some run parallel to an axis, which the quick ways leave to others.
                let direction = if number % 50 == 0 { direction * Vec3::X } else { direction };
                PreparedRay::new(&Ray { origin, tnear, direction, tfar })
            })
            .collect();
        let orders =
            [OcclusionOrder::Nearest, OcclusionOrder::First, OcclusionOrder::Last, OcclusionOrder::Outside];
        let mut answers = |level: Level| {
            prepared.level = level;
            let mut scratch = Scratch::default();
            let mut hits = Vec::new();
            for ray in &rays {
                let closest = prepared.closest_hit(Traversal::Odf, ray, &All, &mut (), &mut scratch);
                let occluded: Vec<bool> = orders
                    .iter()
                    .map(|order| prepared.occluder_in(order, ray, &All, &mut (), &mut scratch).is_some())
                    .collect();
                assert_eq!(occluded, [closest.is_some(); 4], "{level:?} {ray:?}");
                hits.push(closest.map(|hit| (hit.t.to_bits(), hit.triangle)));
            }
            hits
        };
        let plain = answers(Level::None);
        // Brute force agrees.
        for (ray, found) in rays.iter().zip(&plain) {
            let of = |index: usize| {
                let triangle = super::super::PreparedTriangle {
                    vertices: triangles[index],
                    index: index as u32,
                    mask: !0,
                    instance_mask: !0,
                };
                triangle.intersect(ray).map(|t| (t, index as u32))
            };
            let nearest = (0..triangles.len()).filter_map(of).min_by(|a, b| a.0.total_cmp(&b.0));
            assert_eq!(nearest.map(|(t, index)| (t.to_bits(), index)), *found, "{ray:?}");
        }
        let hits = plain.iter().flatten().count();
        assert!((500..2900).contains(&hits), "{hits} of 3000 hit");
        for &level in levels {
            assert_eq!(answers(level), plain, "{level:?}");
        }
    }
}
