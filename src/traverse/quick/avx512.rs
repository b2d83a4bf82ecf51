//! The quick way on a processor with AVX-512: the children that are met are sorted and put onto the stack all at once.
//!
//! Of two children or more the nearest is found first, by three minima, as the next node waits for it; a network of six steps sorts them
//! meanwhile (Batcher 1968, *Sorting Networks and Their Applications*, the bitonic sorter). What is sorted are the distances as integers, whose last three bits give way to
//! the number of the child. Whether there are two children or eight, no branch depends on it.

use super::super::Prepared;
use super::super::candidates::Candidates;
use super::super::form::Below;
use super::super::groups::Group;
use super::super::leaf::Best;
use super::super::ray::PreparedRay;
use super::{Room, Walk, fetch, order};
use std::arch::x86_64::*;

/// See [`Prepared::quick_nearest`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
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
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    loop {
        if current.is_leaf() {
            if walk.leaf::<ANY>(current) && ANY {
                return Some(walk.best);
            }
        } else {
            let group = &walk.groups.all()[current.first as usize];
            let met = walk.slabs.test(group, walk.best.t);
            let mask = _mm256_cmple_epi32_mask(met.entry, met.exit);
            if mask != 0 {
                if mask & (mask - 1) == 0 {
                    current = group.below[mask.trailing_zeros() as usize % 8];
                    continue;
                }
                // (entry & !7) | lane; children that are missed come last.
                let keys = _mm256_ternarylogic_epi32::<0xF8>(lanes, met.entry, _mm256_set1_epi32(!7));
                let keys = _mm256_mask_mov_epi32(_mm256_set1_epi32(i32::MAX), mask, keys);
                current = group.below[least(keys) as usize % 8];
                let sorted = sort(keys);
                let second = _mm_extract_epi32::<1>(_mm256_castsi256_si128(sorted));
                fetch(walk.groups, walk.blocks, group.below[second as usize % 8]);
                // The farthest goes to the bottom; the nearest, on top, is what comes now.
                let count = mask.count_ones() as usize;
                let backwards = _mm256_sub_epi32(_mm256_set1_epi32(count as i32 - 1), lanes);
                let keys = _mm256_permutevar8x32_epi32(sorted, backwards);
                store(
                    all_below(group, _mm256_and_si256(keys, _mm256_set1_epi32(7))),
                    &mut walk.stack[walk.top..],
                );
                store_keys(keys, &mut walk.entries[walk.top..]);
                walk.top += count - 1;
                continue;
            }
        }
        let Some(next) = walk.pop_nearer() else { return Some(walk.best) };
        current = next;
    }
}

/// See [`Prepared::quick_any`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
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
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    loop {
        if current.is_leaf() {
            if walk.leaf::<true>(current) {
                return Some(walk.best);
            }
        } else {
            let group = &walk.groups.all()[current.first as usize];
            let met = walk.slabs.test(group, ray.tfar);
            let mask = _mm256_cmple_epi32_mask(met.entry, met.exit);
            if mask != 0 {
                let outside =
                    if ORDER == order::OUTSIDE { walk.slabs.entered_later(&met) as u8 & mask } else { 0 };
                let inside = mask & !outside;
                let compressed = |mask: u8| _mm256_maskz_compress_epi32(mask, lanes);
                let reversed = |mask: u8| {
                    let last = _mm256_set1_epi32(mask.count_ones() as i32 - 1);
                    _mm256_permutevar8x32_epi32(compressed(mask), _mm256_sub_epi32(last, lanes))
                };
                let order = if ORDER == order::LAST { compressed(inside) } else { reversed(inside) };
                store(all_below(group, order), &mut walk.stack[walk.top..]);
                walk.top += inside.count_ones() as usize;
                if ORDER == order::OUTSIDE {
                    store(all_below(group, reversed(outside)), &mut walk.stack[walk.top..]);
                    walk.top += outside.count_ones() as usize;
                }
                // What is on top now, without waiting for it to be written.
                let lane = match ORDER {
                    order::LAST => 7 - mask.leading_zeros(),
                    order::OUTSIDE if outside != 0 => outside.trailing_zeros(),
                    _ => mask.trailing_zeros(),
                };
                walk.top -= 1;
                current = group.below[lane as usize % 8];
                continue;
            }
        }
        let Some(next) = walk.pop() else { return Some(walk.best) };
        fetch(walk.groups, walk.blocks, walk.stack[walk.top.saturating_sub(1)]);
        current = next;
    }
}

/// What is below the children of these numbers, 0 to 7.
#[target_feature(enable = "avx512f")]
#[inline]
fn all_below(group: &Group<8>, lanes: __m256i) -> __m512i {
    // SAFETY: eight pairs of numbers, 64 bytes.
    let below = unsafe { _mm512_loadu_si512((&raw const group.below).cast()) };
    _mm512_permutexvar_epi64(_mm512_cvtepi32_epi64(lanes), below)
}

/// Writes eight entries.
#[target_feature(enable = "avx512f")]
#[inline]
fn store(below: __m512i, stack: &mut [Below]) {
    let room: &mut [Below] = &mut stack[..Room::AT_ONCE];
    // SAFETY: there is room for eight, 64 bytes; any bits are two numbers.
    unsafe { _mm512_storeu_si512(room.as_mut_ptr().cast(), below) };
}

/// Writes eight distances.
#[target_feature(enable = "avx2")]
#[inline]
fn store_keys(keys: __m256i, entries: &mut [i32]) {
    let room: &mut [i32] = &mut entries[..Room::AT_ONCE];
    // SAFETY: there is room for eight, 32 bytes.
    unsafe { _mm256_storeu_si256(room.as_mut_ptr().cast(), keys) };
}

/// The least of eight.
#[target_feature(enable = "avx2")]
#[inline]
fn least(keys: __m256i) -> i32 {
    let four = _mm_min_epi32(_mm256_castsi256_si128(keys), _mm256_extracti128_si256::<1>(keys));
    let two = _mm_min_epi32(four, _mm_shuffle_epi32::<0b01_00_11_10>(four));
    _mm_cvtsi128_si32(_mm_min_epi32(two, _mm_shuffle_epi32::<0b10_11_00_01>(two)))
}

/// The eight in ascending order.
#[target_feature(enable = "avx2,avx512f,avx512vl")]
#[inline]
fn sort(keys: __m256i) -> __m256i {
    let keys = step::<0b0110_0110>(keys, _mm256_shuffle_epi32::<0b10_11_00_01>(keys));
    let keys = step::<0b0011_1100>(keys, _mm256_shuffle_epi32::<0b01_00_11_10>(keys));
    let keys = step::<0b0101_1010>(keys, _mm256_shuffle_epi32::<0b10_11_00_01>(keys));
    let keys = step::<0b1111_0000>(keys, _mm256_permute4x64_epi64::<0b01_00_11_10>(keys));
    let keys = step::<0b1100_1100>(keys, _mm256_shuffle_epi32::<0b01_00_11_10>(keys));
    step::<0b1010_1010>(keys, _mm256_shuffle_epi32::<0b10_11_00_01>(keys))
}

/// Compares each lane with its partner: those of `GREATER` take the greater of both, the others the lesser.
#[target_feature(enable = "avx2,avx512f,avx512vl")]
#[inline]
fn step<const GREATER: u8>(keys: __m256i, partners: __m256i) -> __m256i {
    _mm256_mask_max_epi32(_mm256_min_epi32(keys, partners), GREATER, keys, partners)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[target_feature(enable = "avx2,avx512f,avx512vl")]
    fn sorted(keys: [i32; 8]) -> ([i32; 8], i32) {
        // SAFETY: both are 32 bytes of plain numbers.
        let keys: __m256i = unsafe { std::mem::transmute(keys) };
        // SAFETY: as above.
        (unsafe { std::mem::transmute::<__m256i, [i32; 8]>(sort(keys)) }, least(keys))
    }

    #[test]
    fn every_network_of_zeros_and_ones_sorts() {
        if !(is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl")) {
            return;
        }
        // A network that sorts all rows of zeros and ones sorts everything (Knuth, volume 3, section 5.3.4, theorem Z).
        for bits in 0..256 {
            let keys: [i32; 8] = std::array::from_fn(|lane| bits >> lane & 1);
            // SAFETY: the processor has both.
            let (sorted, least) = unsafe { sorted(keys) };
            let mut expected = keys;
            expected.sort_unstable();
            assert_eq!((sorted, least), (expected, expected[0]), "{keys:?}");
        }
    }
}
