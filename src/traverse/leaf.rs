//! The triangles of one leaf against one ray: the part that every traversal shares.

use super::Hit;
use super::blocks::{BlockRay, Blocks, LANES};
use super::candidates::Candidates;
use super::form::Link;
use super::observer::Observer;
use super::ray::PreparedRay;
use super::simd::Machine;
use super::triangle::PreparedTriangle;
use crate::format::rays::NO_TRIANGLE;

/// The best hit so far, or the end of the ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    pub t: f32,
    pub triangle: u32,
    /// No triangle hit behind this, by its plane's distance, is a better one: the number after `t`, as one at the same t may be, and at
    /// most the ray's end.
    pub bound: f32,
}

impl Best {
    #[inline(always)]
    pub fn end_of(ray: &PreparedRay) -> Best {
        Best { t: ray.tfar, triangle: NO_TRIANGLE, bound: ray.tfar }
    }

    #[inline(always)]
    pub fn hit(self) -> Option<Hit> {
        (self.triangle != NO_TRIANGLE).then_some(Hit { t: self.t, triangle: self.triangle })
    }
}

/// With spatial splits a leaf's box is smaller than its triangle's, and a hit on the cut may come out a rounding error
/// before the box. Within this relative distance it is moved to the box, so that hits are never before their leaf.
const SNAP: f32 = 1e-6;

/// Tests the triangles of `leaf`. True when the query is answered: with `ANY`, at the first hit.
///
/// Of equal hits the one with the lowest index wins, whatever the order in which they are found.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // What a traversal holds in registers; a struct would put it into memory.
pub(super) fn test<const ANY: bool, M: Machine>(
    leaf: &Link,
    blocks: &Blocks,
    ray: &PreparedRay,
    block_ray: &BlockRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    best: &mut Best,
) -> bool {
    observer.leaf(leaf);
    let slots = leaf.triangles();
    let mut first = slots.start;
    while first < slots.end {
        let block = first / LANES;
        let end = slots.end.min((block + 1) * LANES);
        let lanes = ((1u32 << (end - first)) - 1) << (first % LANES);
        let (mut mask, distances) = blocks.hits::<M>(block, lanes, ray, block_ray, best.bound);
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % LANES;
            mask &= mask - 1;
            let slot = block * LANES + lane;
            if hit(&blocks.triangle(slot), distances[lane], leaf.entry, candidates, best) {
                observer.hit(Hit { t: best.t, triangle: best.triangle });
                if ANY {
                    observer.primitives(blocks.triangles(first..slot + 1));
                    return true;
                }
            }
        }
        observer.primitives(blocks.triangles(first..end));
        first = end;
    }
    false
}

/// Whether the hit at `t` counts and is the best so far, which it then becomes.
#[inline(always)]
pub(super) fn hit(
    triangle: &PreparedTriangle,
    mut t: f32,
    entry: f32,
    candidates: &impl Candidates,
    best: &mut Best,
) -> bool {
    if t < entry && t >= entry * (1.0 - SNAP) {
        t = entry;
    }
    if t > best.t {
        return false;
    }
    let better = t < best.t || triangle.index < best.triangle;
    if better && candidates.accepts(triangle) {
        *best = Best { t, triangle: triangle.index, bound: t.next_up().min(best.bound) };
        return true;
    }
    false
}
