//! Queries that nobody watches, depth first over trees of up to eight children a node, at the speed of an x86-64 with AVX2 and FMA.
//!
//! The answers are those of every other traversal. The way there is not, box for box: boxes are tested with fewer roundings, whose error is
//! allowed for ([`slabs`]), so that now and then one is opened that a ray only nearly meets. That is why counts are not made here.
//!
//! Where a query waits for memory, children are asked for as soon as they are known to be met; where it waits for the outcome of a
//! test, little is left between the mask of a test and the address of the next node: no child is compared with others while it is alone, and a lone
//! child never goes over the stack. (Compressing all that are met onto the stack with AVX-512, whatever their number, takes no branch, but longer.)

mod slabs;

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::form::{Below, Link};
use super::groups::Group;
use super::leaf::{self, Best};
use super::ray::PreparedRay;
use super::simd::{Avx2, prefetch};
use super::{Nodes, Prepared, Scratch};
use slabs::SlabRay;

/// A subtree, and where the ray enters its box.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
struct Entry {
    below: Below,
    entry: f32,
}

/// Room for what waits, kept from query to query.
#[derive(Debug, Default)]
pub(super) struct Room(Vec<Entry>);

impl Prepared {
    /// The closest hit; None where the processor, the tree or the ray has to be followed otherwise.
    #[inline]
    pub(super) fn quick_closest(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
    ) -> Option<Best> {
        let scene = Scene::new(self)?;
        // SAFETY: there is a scene only where the processor has what it takes.
        unsafe { scene.closest(ray, candidates, &mut scratch.quick) }
    }

    /// Any hit, as [`super::any_hit`] looks for it; None as above.
    #[inline]
    pub(super) fn quick_any<const OUTSIDE: bool>(
        &self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        scratch: &mut Scratch,
    ) -> Option<Best> {
        let scene = Scene::new(self)?;
        // SAFETY: as above.
        unsafe { scene.any::<OUTSIDE>(ray, candidates, scratch.waiting.room(self.stack_size)) }
    }
}

/// A tree that can be followed so. The root's box is not tested: it has the same children, and rays mostly meet it.
#[derive(Clone, Copy, Debug)]
struct Scene<'a> {
    groups: &'a [Group<8>],
    root: Below,
    blocks: &'a Blocks,
    /// Most entries that can wait on a stack.
    stack_size: usize,
}

impl<'a> Scene<'a> {
    /// None where a node has more children than a group holds, or the processor lacks something.
    #[inline(always)]
    fn new(prepared: &'a Prepared) -> Option<Scene<'a>> {
        let Nodes::Eights(groups) = &prepared.nodes else { return None };
        let able = prepared.fused && groups.is_one_a_node();
        let (blocks, stack_size) = (&prepared.blocks, prepared.stack_size);
        able.then(|| Scene { groups: groups.all(), root: groups.root(), blocks, stack_size })
    }

    #[inline(always)]
    fn fetch(self, below: Below) {
        let leaf = self.blocks.address(below.first as usize);
        let inner = self.groups.as_ptr().wrapping_add(below.first as usize).cast();
        prefetch(if below.is_leaf() { leaf } else { inner });
    }

    /// The closest hit; None for rays that [`SlabRay`] is not made for.
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    #[inline(never)] // It needs all registers, and gets them only on its own.
    fn closest(self, ray: &PreparedRay, candidates: &impl Candidates, room: &mut Room) -> Option<Best> {
        let slabs = SlabRay::new(ray)?;
        if room.0.len() < self.stack_size {
            room.0.resize(self.stack_size, Entry { below: Below::NOTHING, entry: 0.0 });
        }
        let (stack, mut top) = (&mut room.0[..], 0);
        let block_ray = BlockRay::new(ray);
        let mut best = Best::end_of(ray);
        let mut current = Entry { below: self.root, entry: ray.tnear };
        loop {
            if current.below.is_leaf() {
                let leaf = Link::to(0, current.below, current.entry);
                leaf::test::<false, Avx2>(
                    &leaf,
                    self.blocks,
                    ray,
                    &block_ray,
                    candidates,
                    &mut (),
                    &mut best,
                );
            } else {
                let group = &self.groups[current.below.first as usize];
                let met = slabs.test(group, best.t);
                let mut mask = met.mask();
                if mask != 0 {
                    let entries = met.entries();
                    let mut next = || {
                        let lane = mask.trailing_zeros() as usize % 8;
                        mask &= mask - 1;
                        self.fetch(group.below[lane]);
                        (Entry { below: group.below[lane], entry: entries[lane] }, mask != 0)
                    };
                    let (first, more) = next();
                    if !more {
                        current = first;
                        continue;
                    }
                    let (second, mut more) = next();
                    let (mut nearest, farther) =
                        if second.entry < first.entry { (second, first) } else { (first, second) };
                    let before = top;
                    stack[top] = farther;
                    top += 1;
                    // Few have more than two: insertion keeps the farthest at the bottom.
                    while more {
                        let mut other;
                        (other, more) = next();
                        if other.entry < nearest.entry {
                            std::mem::swap(&mut other, &mut nearest);
                        }
                        let mut place = top;
                        while place > before && stack[place - 1].entry <= other.entry {
                            stack[place] = stack[place - 1];
                            place -= 1;
                        }
                        stack[place] = other;
                        top += 1;
                    }
                    current = nearest;
                    continue;
                }
            }
            loop {
                if top == 0 {
                    return Some(best);
                }
                top -= 1;
                current = stack[top];
                if current.entry <= best.t {
                    break;
                }
            }
        }
    }

    /// Any hit; None as above. Of a node's children, the first of the file first; with `OUTSIDE`, those that the ray
    /// enters after its start before the others. `stack` has room for as many entries as can wait.
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    #[inline(never)] // As above.
    fn any<const OUTSIDE: bool>(
        self,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        stack: &mut [Below],
    ) -> Option<Best> {
        let slabs = SlabRay::new(ray)?;
        let block_ray = BlockRay::new(ray);
        let mut best = Best::end_of(ray);
        let (mut current, mut top) = (self.root, 0);
        loop {
            if current.is_leaf() {
                let leaf = Link::to(0, current, f32::NEG_INFINITY);
                if leaf::test::<true, Avx2>(
                    &leaf,
                    self.blocks,
                    ray,
                    &block_ray,
                    candidates,
                    &mut (),
                    &mut best,
                ) {
                    return Some(best);
                }
            } else {
                let group = &self.groups[current.first as usize];
                let met = slabs.test(group, ray.tfar);
                let mask = met.mask();
                if mask != 0 {
                    if mask & (mask - 1) == 0 {
                        current = group.below[mask.trailing_zeros() as usize % 8];
                        continue;
                    }
                    let outside = if OUTSIDE { mask & slabs.entered_later(&met) } else { mask };
                    top = group.push(mask & !outside, stack, top);
                    top = group.push(outside, stack, top);
                }
            }
            if top == 0 {
                return Some(best);
            }
            top -= 1;
            current = stack[top];
        }
    }
}
