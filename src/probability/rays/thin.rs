//! Dividing the list of rays on a node among its children: each gets, in order, those that overlap its box.

#[cfg(target_arch = "x86_64")]
use super::block::avx2;
use super::segment::{AHEAD, Packed, Segment};
use crate::geometry::padded::PaddedAabb;
use rayon::prelude::*;
use std::cell::Cell;

/// More rays are divided by several threads.
const PARALLEL: usize = 1 << 13;
/// Rays that a thread takes at a time there.
const BLOCK: usize = 1 << 12;

thread_local! {
    /// Room for both lists while their lengths are not known.
    static ROOM: Cell<[Vec<u32>; 2]> = const { Cell::new([Vec::new(), Vec::new()]) };
}

/// The rays on both of `boxes`.
pub fn divide(segments: &[Packed], rays: &[u32], boxes: [&PaddedAabb; 2]) -> [Vec<u32>; 2] {
    if rays.len() <= PARALLEL {
        return divide_part(segments, rays, boxes);
    }
    let parts: Vec<[Vec<u32>; 2]> =
        rays.par_chunks(BLOCK).map(|rays| divide_part(segments, rays, boxes)).collect();
    [0, 1].map(|side| parts.iter().map(|part| &part[side][..]).collect::<Vec<_>>().concat())
}

fn divide_part(segments: &[Packed], rays: &[u32], boxes: [&PaddedAabb; 2]) -> [Vec<u32>; 2] {
    let mut room = ROOM.take();
    for list in &mut room {
        if list.len() < rays.len() {
            list.resize(rays.len(), 0);
        }
    }
    let [left, right] = &mut room;
    let lengths = on_both(segments, rays, boxes, left, right);
    let lists = [left[..lengths[0]].to_vec(), right[..lengths[1]].to_vec()];
    ROOM.set(room);
    lists
}

/// Writes the rays on each box to the list for it, and returns how many they are.
fn on_both(
    segments: &[Packed],
    rays: &[u32],
    boxes: [&PaddedAabb; 2],
    left: &mut [u32],
    right: &mut [u32],
) -> [usize; 2] {
    #[cfg(target_arch = "x86_64")]
    if avx2::available() {
        // SAFETY: the processor can.
        return unsafe { on_both_avx2(segments, rays, boxes, left, right) };
    }
    keep(segments, rays, left, right, |ray| boxes.map(|bounds| ray.overlaps(bounds) as usize))
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn on_both_avx2(
    segments: &[Packed],
    rays: &[u32],
    boxes: [&PaddedAabb; 2],
    left: &mut [u32],
    right: &mut [u32],
) -> [usize; 2] {
    let pair = avx2::Pair::new(boxes);
    keep(segments, rays, left, right, |ray| pair.overlapped(ray))
}

#[inline(always)]
fn keep(
    segments: &[Packed],
    rays: &[u32],
    left: &mut [u32],
    right: &mut [u32],
    overlapped: impl Fn(&Segment) -> [usize; 2],
) -> [usize; 2] {
    let mut lengths = [0; 2];
    for (index, &ray) in rays.iter().enumerate() {
        if let Some(&ahead) = rays.get(index + AHEAD) {
            segments[ahead as usize].prefetch();
        }
        let on = overlapped(&segments[ray as usize].segment());
        // Which side a ray is on is hard to predict: written in any case, kept by arithmetic.
        left[lengths[0]] = ray;
        right[lengths[1]] = ray;
        lengths = [lengths[0] + on[0], lengths[1] + on[1]];
    }
    lengths
}
