//! The quick way on a processor with AVX2 and FMA: the children that are met are taken from their mask one by one.
//!
//! No child is compared with others while it is alone, and a lone child never goes over the stack.

use super::super::blocks::BlockRay;
use super::super::candidates::Candidates;
use super::super::form::{Below, Link};
use super::super::groups::Group;
use super::super::leaf::{self, Best};
use super::super::ray::PreparedRay;
use super::super::simd::Avx2;
use super::super::{Nodes, Prepared};
use super::slabs::SlabRay;
use super::{Room, fetch, order};

/// See [`Prepared::quick_nearest`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
#[inline(never)] // It needs all registers, and gets them only on its own.
pub fn nearest<const ANY: bool>(
    prepared: &Prepared,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    room: &mut Room,
) -> Option<Best> {
    let Nodes::Eights(groups) = &prepared.nodes else { return None };
    let slabs = SlabRay::new(ray, groups.extent())?;
    let (stack, entries) = room.stacks(prepared.stack_size);
    let mut top = 0;
    let block_ray = BlockRay::new(ray);
    let mut best = Best::end_of(ray);
    let mut current = groups.root();
    loop {
        if current.is_leaf() {
            let leaf = Link::to(0, current, f32::NEG_INFINITY);
            let blocks = &prepared.blocks;
            let found =
                leaf::test::<ANY, Avx2>(&leaf, blocks, ray, &block_ray, candidates, &mut (), &mut best);
            if ANY && found {
                return Some(best);
            }
        } else {
            let group = &groups.all()[current.first as usize];
            let met = slabs.test(group, best.t);
            let mut mask = met.mask();
            if mask != 0 {
                if mask & (mask - 1) == 0 {
                    current = group.below[mask.trailing_zeros() as usize % 8];
                    continue;
                }
                let entered = met.entries();
                let mut next = || {
                    let lane = mask.trailing_zeros() as usize % 8;
                    mask &= mask - 1;
                    fetch(groups, &prepared.blocks, group.below[lane]);
                    (lane, entered[lane], mask != 0)
                };
                let (first, first_entry, _) = next();
                let (second, second_entry, mut more) = next();
                let second_is_nearer = second_entry < first_entry;
                let (mut nearest, mut nearest_entry) =
                    if second_is_nearer { (second, second_entry) } else { (first, first_entry) };
                let (farther, farther_entry) =
                    if second_is_nearer { (first, first_entry) } else { (second, second_entry) };
                let before = top;
                (stack[top], entries[top]) = (group.below[farther], farther_entry);
                top += 1;
                // Few have more than two: insertion keeps the farthest at the bottom.
                while more {
                    let (mut other, mut other_entry);
                    (other, other_entry, more) = next();
                    if other_entry < nearest_entry {
                        std::mem::swap(&mut other, &mut nearest);
                        std::mem::swap(&mut other_entry, &mut nearest_entry);
                    }
                    let mut place = top;
                    while place > before && entries[place - 1] <= other_entry {
                        (stack[place], entries[place]) = (stack[place - 1], entries[place - 1]);
                        place -= 1;
                    }
                    (stack[place], entries[place]) = (group.below[other], other_entry);
                    top += 1;
                }
                current = group.below[nearest];
                continue;
            }
        }
        // Distances that are not negative compare like the integers of the same bits; below 0 no ray ends that comes here.
        let end = best.t.to_bits().cast_signed();
        loop {
            if top == 0 {
                return Some(best);
            }
            top -= 1;
            if entries[top] <= end {
                break;
            }
        }
        current = stack[top];
    }
}

/// See [`Prepared::quick_any`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
#[inline(never)] // As above.
pub fn any<const ORDER: u8>(
    prepared: &Prepared,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    room: &mut Room,
) -> Option<Best> {
    let Nodes::Eights(groups) = &prepared.nodes else { return None };
    let slabs = SlabRay::new(ray, groups.extent())?;
    let (stack, _) = room.stacks(prepared.stack_size);
    let mut top = 0;
    let block_ray = BlockRay::new(ray);
    let mut best = Best::end_of(ray);
    let mut current = groups.root();
    loop {
        if current.is_leaf() {
            let leaf = Link::to(0, current, f32::NEG_INFINITY);
            let blocks = &prepared.blocks;
            if leaf::test::<true, Avx2>(&leaf, blocks, ray, &block_ray, candidates, &mut (), &mut best) {
                return Some(best);
            }
        } else {
            let group = &groups.all()[current.first as usize];
            let met = slabs.test(group, ray.tfar);
            let mask = met.mask();
            if mask != 0 {
                if mask & (mask - 1) == 0 {
                    current = group.below[mask.trailing_zeros() as usize % 8];
                    continue;
                }
                match ORDER {
                    order::LAST => top = push_last(group, mask, stack, top),
                    order::OUTSIDE => {
                        let outside = mask & slabs.entered_later(&met);
                        top = group.push(mask & !outside, stack, top);
                        top = group.push(outside, stack, top);
                    }
                    _ => top = group.push(mask, stack, top),
                }
            }
        }
        if top == 0 {
            return Some(best);
        }
        top -= 1;
        current = stack[top];
    }
}

/// Pushes what is below the lanes in `mask`, the highest on top.
#[inline(always)]
fn push_last(group: &Group<8>, mut mask: u32, stack: &mut [Below], mut top: usize) -> usize {
    while mask != 0 {
        stack[top] = group.below[mask.trailing_zeros() as usize % 8];
        top += 1;
        mask &= mask - 1;
    }
    top
}
