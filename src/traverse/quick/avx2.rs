//! The quick way on a processor with AVX2 and FMA: the children that are met are taken from their mask one by one.
//!
//! No child is compared with others while it is alone, and a lone child never goes over the stack.

use super::super::Prepared;
use super::super::candidates::Candidates;
use super::super::form::Below;
use super::super::groups::Group;
use super::super::leaf::Best;
use super::super::ray::PreparedRay;
use super::{Room, Walk, fetch, order};

/// See [`Prepared::quick_nearest`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
#[inline(never)] // It needs all registers, and gets them only on its own.
pub fn nearest<const ANY: bool>(
    prepared: &Prepared,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    room: &mut Room,
) -> Option<Best> {
    // SAFETY: this is compiled for AVX2 and FMA.
    let mut walk = unsafe { Walk::start(prepared, ray, candidates, room) }?;
    let mut current = walk.groups.root();
    loop {
        if current.is_leaf() {
            if walk.leaf::<ANY>(current) && ANY {
                return Some(walk.best);
            }
        } else {
            let group = &walk.groups.all()[current.first as usize];
            let met = walk.slabs.test(group, walk.best.t);
            let mut mask = met.mask();
            if mask != 0 {
                if mask & (mask - 1) == 0 {
                    current = group.below[mask.trailing_zeros() as usize % 8];
                    continue;
                }
                let entered = met.entries();
                let (groups, blocks) = (walk.groups, walk.blocks);
                let mut next = || {
                    let lane = mask.trailing_zeros() as usize % 8;
                    mask &= mask - 1;
                    fetch(groups, blocks, group.below[lane]);
                    (lane, entered[lane], mask != 0)
                };
                let (first, first_entry, _) = next();
                let (second, second_entry, mut more) = next();
                let second_is_nearer = second_entry < first_entry;
                let (mut nearest, mut nearest_entry) =
                    if second_is_nearer { (second, second_entry) } else { (first, first_entry) };
                let (farther, farther_entry) =
                    if second_is_nearer { (first, first_entry) } else { (second, second_entry) };
                let (stack, entries) = (&mut *walk.stack, &mut *walk.entries);
                let before = walk.top;
                let mut top = before;
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
                walk.top = top;
                current = group.below[nearest];
                continue;
            }
        }
        let Some(next) = walk.pop_nearer() else { return Some(walk.best) };
        current = next;
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
    // SAFETY: this is compiled for AVX2 and FMA.
    let mut walk = unsafe { Walk::start(prepared, ray, candidates, room) }?;
    let mut current = walk.groups.root();
    loop {
        if current.is_leaf() {
            if walk.leaf::<true>(current) {
                return Some(walk.best);
            }
        } else {
            let group = &walk.groups.all()[current.first as usize];
            let met = walk.slabs.test(group, ray.tfar);
            let mask = met.mask();
            if mask != 0 {
                if mask & (mask - 1) == 0 {
                    current = group.below[mask.trailing_zeros() as usize % 8];
                    continue;
                }
                let (stack, top) = (&mut *walk.stack, walk.top);
                walk.top = match ORDER {
                    order::LAST => push_last(group, mask, stack, top),
                    order::OUTSIDE => {
                        let outside = mask & walk.slabs.entered_later(&met);
                        let top = group.push(mask & !outside, stack, top);
                        group.push(outside, stack, top)
                    }
                    _ => group.push(mask, stack, top),
                };
            }
        }
        let Some(next) = walk.pop() else { return Some(walk.best) };
        current = next;
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
