//! How many rays overlap each side of all candidates of a node, without testing rays × boxes one by one.
//!
//! Boxes that are few are tested in blocks of eight, one vector test for each ray and block, whose result is the
//! difference that the ray makes to eight counts. Of many, the nesting saves most: a ray that overlaps a box overlaps
//! all larger ones, so it is enough to find the first box of each sequence that it overlaps; a histogram of those and
//! its running sum are the counts. That search is 8-ary. The boxes of a sequence stand in blocks; above them, the last
//! (largest) box of each block stands in blocks again, until there are no more than eight. To know which of k blocks
//! to go to, k - 1 last boxes are enough; those of all sequences share blocks, where a ray meets them first.
//! So 32 bins on three axes, 186 boxes, cost a ray 9 vector tests, and 1000 boxes of one sequence about four.
//!
//! Boxes equal to the one before, empty ones and those of sides that cost nothing take no place.

use super::block::{Block, LANES};
use super::segment::{AHEAD, Packed, Segment};
use crate::geometry::padded::PaddedAabb;
use crate::probability::Side;
use rayon::prelude::*;
use std::cell::Cell;

/// Of no more boxes than this, each is tested.
const FEW: usize = 48;
/// Rays that are tested against one block after another while they are in the nearest cache.
const NEAR: usize = 256;
/// More rays are counted by several threads, each of which takes so many at a time, or more when the counts are many.
const PARALLEL: usize = 1 << 13;
/// Sequences that can be counted at a time: their places at the top fit in 64 bits.
pub const SEQUENCES: usize = 8;

/// The place of a side that is not counted.
const NOWHERE: u32 = u32::MAX;

/// Sequences of nested boxes, made ready to be counted. Kept by each thread, so that a node allocates nothing.
#[derive(Debug, Default)]
pub struct Nested {
    few: bool,
    blocks: Vec<Block>,
    /// The last boxes between which a ray chooses first, of all sequences.
    top: Vec<Block>,
    top_boxes: usize,
    sequences: Vec<Sequence>,
    /// By side, in the order in which they came: its place in `counts`.
    places: Vec<u32>,
    /// Places that are taken.
    boxes: usize,
    /// By place: rays that overlap the box.
    counts: Vec<u32>,
}

/// A sequence of many boxes.
#[derive(Clone, Copy, Debug)]
struct Sequence {
    /// The place of its first box.
    first: u32,
    /// Its boxes in `top`: the first bit, and one for each.
    top_shift: u32,
    top_mask: u32,
    levels: [Level; LEVELS],
    /// Levels that there are.
    height: u32,
}

/// Blocks of boxes, or of the last boxes of other blocks.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    /// The first block.
    start: u32,
    /// The answer when no box is overlapped: the last block of the level below, or the number of boxes.
    none: u32,
}

/// Enough for 2³² boxes.
const LEVELS: usize = 11;

thread_local! {
    static NESTED: Cell<Option<Box<Nested>>> = const { Cell::new(None) };
}

/// Lends the thread's memory to `work`. Work that is run meanwhile on the same thread (stolen by a wait) gets its own.
pub fn with_nested<T>(work: impl FnOnce(&mut Nested) -> T) -> T {
    let mut nested = NESTED.take().unwrap_or_default();
    let result = work(&mut nested);
    NESTED.set(Some(nested));
    result
}

impl Nested {
    /// Forgets what was before. At most `sides` will come, in at most [`SEQUENCES`] sequences.
    pub fn start(&mut self, sides: usize) {
        self.few = sides <= FEW;
        self.blocks.clear();
        self.top.clear();
        self.top_boxes = 0;
        self.sequences.clear();
        self.places.clear();
        self.places.reserve(sides);
        self.boxes = 0;
    }

    /// Adds a sequence; `note` is called for each of its sides. Those of at most `free` primitives are not counted.
    #[inline(always)]
    pub fn add(&mut self, sides: impl Iterator<Item = Side>, free: usize, mut note: impl FnMut(&Side)) {
        let first = self.boxes;
        let start = self.blocks.len();
        let mut last = PaddedAabb::EMPTY;
        let mut place = NOWHERE;
        // Few boxes fill the blocks without gaps.
        let mut lane = if self.few { first } else { 0 };
        for side in sides {
            note(&side);
            if side.primitives > free && side.bounds != last {
                if lane.is_multiple_of(LANES) {
                    self.blocks.push(Block::EMPTY);
                }
                if let Some(block) = self.blocks.last_mut() {
                    block.set(lane % LANES, &side.bounds);
                }
                lane += 1;
                place = self.boxes as u32;
                self.boxes += 1;
                last = side.bounds;
            }
            self.places.push(place);
        }
        if !self.few && self.boxes > first {
            self.build(first, start);
        }
    }

    /// Makes the levels above the boxes of a sequence, whose first place and first block are given.
    fn build(&mut self, first: usize, mut start: usize) {
        let mut boxes = self.boxes - first;
        let mut levels = [Level::default(); LEVELS];
        let mut height = 0;
        let mut none = boxes;
        loop {
            levels[height] = Level { start: start as u32, none: none as u32 };
            height += 1;
            let blocks = boxes.div_ceil(LANES);
            if blocks <= LANES {
                break;
            }
            let end = start + blocks;
            for block in 0..blocks {
                if block.is_multiple_of(LANES) {
                    self.blocks.push(Block::EMPTY);
                }
                let from = self.blocks[start + block];
                // The last block may not be full: its last box is the last of all.
                let from_lane = (boxes - 1 - block * LANES).min(LANES - 1);
                let above = self.blocks.len() - 1;
                self.blocks[above].copy(block % LANES, &from, from_lane);
            }
            (start, boxes, none) = (end, blocks, blocks - 1);
        }
        let separators = boxes.div_ceil(LANES) - 1;
        let top_shift = self.top_boxes as u32;
        for block in 0..separators {
            if self.top_boxes.is_multiple_of(LANES) {
                self.top.push(Block::EMPTY);
            }
            let lane = self.top_boxes % LANES;
            if let Some(top) = self.top.last_mut() {
                top.copy(lane, &self.blocks[start + block], LANES - 1);
            }
            self.top_boxes += 1;
        }
        let top_mask = (1 << separators) - 1;
        self.sequences.push(Sequence {
            first: first as u32,
            top_shift,
            top_mask,
            levels,
            height: height as u32,
        });
        // A place more, for the rays that overlap none of the boxes.
        self.boxes += 1;
    }

    /// For each side, in the order in which they came, the number of `rays` that overlap it; 0 for one that is not
    /// counted.
    pub fn count(&mut self, segments: &[Packed], rays: &[u32]) -> impl Iterator<Item = u32> {
        let mut counts = std::mem::take(&mut self.counts);
        counts.clear();
        counts.resize(self.boxes.next_multiple_of(LANES), 0);
        if self.boxes > 0 {
            if rays.len() <= PARALLEL {
                self.count_part(segments, rays, &mut counts);
            } else {
                let part = PARALLEL.max(counts.len());
                let parts = rays.par_chunks(part).map(|rays| {
                    let mut counts = vec![0; counts.len()];
                    self.count_part(segments, rays, &mut counts);
                    counts
                });
                let add = |mut a: Vec<u32>, b: Vec<u32>| {
                    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                    a
                };
                counts = parts.reduce_with(add).unwrap_or(counts);
            }
        }
        for (index, sequence) in self.sequences.iter().enumerate() {
            let end = self.sequences.get(index + 1).map_or(self.boxes, |next| next.first as usize);
            // What overlaps a box overlaps all larger ones.
            let mut sum = 0;
            for count in &mut counts[sequence.first as usize..end] {
                sum += *count;
                *count = sum;
            }
        }
        self.counts = counts;
        self.places.iter().map(|&place| self.counts.get(place as usize).copied().unwrap_or(0))
    }

    fn count_part(&self, segments: &[Packed], rays: &[u32], counts: &mut [u32]) {
        #[cfg(target_arch = "x86_64")]
        if super::block::avx2::available() {
            // SAFETY: the processor can.
            return unsafe { self.count_avx2(segments, rays, counts) };
        }
        self.count_plain(segments, rays, counts);
    }

    fn count_plain(&self, segments: &[Packed], rays: &[u32], counts: &mut [u32]) {
        if self.few {
            self.count_few(rays, counts, |block, rays, counts| {
                rays.iter().for_each(|&ray| block.count(&segments[ray as usize].segment(), counts));
            });
        } else {
            self.search(segments, rays, counts, Block::overlapped);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,popcnt")]
    fn count_avx2(&self, segments: &[Packed], rays: &[u32], counts: &mut [u32]) {
        use super::block::avx2;
        if self.few {
            self.count_few(rays, counts, |block, rays, counts| {
                avx2::count_all(block, rays.iter().map(|&ray| segments[ray as usize].segment()), counts);
            });
        } else {
            self.search(segments, rays, counts, |block, ray| avx2::overlapped(block, ray));
        }
    }

    /// Tests every box; place by place these are the counts.
    #[inline(always)]
    fn count_few(&self, rays: &[u32], counts: &mut [u32], count: impl Fn(&Block, &[u32], &mut [u32; LANES])) {
        for rays in rays.chunks(NEAR) {
            for (block, counts) in self.blocks.iter().zip(counts.as_chunks_mut().0) {
                count(block, rays, counts);
            }
        }
    }

    /// Adds, for each box, the rays that overlap it and none of the smaller ones of its sequence.
    #[inline(always)]
    fn search(
        &self,
        segments: &[Packed],
        rays: &[u32],
        counts: &mut [u32],
        overlapped: impl Fn(&Block, &Segment) -> u32,
    ) {
        for (index, &ray) in rays.iter().enumerate() {
            if let Some(&ahead) = rays.get(index + AHEAD) {
                segments[ahead as usize].prefetch();
            }
            let ray = &segments[ray as usize].segment();
            let mut top = 0;
            for (index, block) in self.top.iter().enumerate() {
                top |= (overlapped(block, ray) as u64) << (index * LANES);
            }
            for sequence in &self.sequences {
                // Of those last boxes, the smaller ones are not overlapped: their number is the block to go to.
                let missed = !(top >> sequence.top_shift) as u32 & sequence.top_mask;
                let mut at = missed.count_ones();
                for level in sequence.levels[..sequence.height as usize].iter().rev() {
                    let mask = overlapped(&self.blocks[(level.start + at) as usize], ray);
                    // No bit: 32, which is more than there are in this block, the last.
                    at = (at * LANES as u32 + mask.trailing_zeros()).min(level.none);
                }
                counts[(sequence.first + at) as usize] += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Ray, Vec3};

    fn random_stream(seed: u64) -> impl FnMut() -> f32 {
        let mut random = crate::random::Random::new(seed);
        move || random.unit() * 2.0 - 1.0
    }

    /// Truth: every ray against every box, with the plain test.
    #[test]
    fn counts_are_those_of_testing_everything() {
        let mut random = random_stream(7);
        for lengths in [
            &[1][..],
            &[2, 3],
            &[7, 8, 9, 24],
            &[8, 8, 8, 8, 8, 8],
            &[49],
            &[31, 31, 31, 31, 31, 31],
            &[63, 64, 65, 1, 9, 17],
            &[8, 0, 64, 64, 64, 64, 64, 64],
            &[511, 512, 513],
            &[5000, 600],
        ] {
            let sequences: Vec<Vec<Side>> = lengths
                .iter()
                .map(|&length| {
                    let mut bounds = PaddedAabb::EMPTY;
                    let grow = |index| {
                        // Leading boxes may be empty, and many are equal to the one before.
                        if index > length / 5 && random() > 0.0 {
                            let size = index as f32 / length as f32;
                            let point = Vec3::new(random(), random(), random()) * size;
                            bounds = bounds.grown(point.extend(0.0));
                        }
                        Side { primitives: index, bounds }
                    };
                    (0..length).map(grow).collect()
                })
                .collect();
            let segments: Vec<Packed> = (0..300)
                .filter_map(|index| {
                    let z = if index % 7 == 0 { 0.0 } else { random() };
                    let direction = Vec3::new(random(), random(), z);
                    let tfar = if index % 3 == 0 { f32::INFINITY } else { random().abs() * 3.0 };
                    let origin = 1.5 * Vec3::new(random(), random(), random());
                    Packed::new(&Ray { origin, tnear: 0.0, direction, tfar })
                })
                .collect();
            let rays: Vec<u32> = (0..segments.len() as u32).collect();
            for free in [0, 4] {
                let counted: Vec<u32> = with_nested(|nested| {
                    nested.start(lengths.iter().sum());
                    for sequence in &sequences {
                        nested.add(sequence.iter().copied(), free, |_| ());
                    }
                    nested.count(&segments, &rays).collect()
                });
                assert_eq!(counted.len(), lengths.iter().sum::<usize>());
                for (side, counted) in sequences.iter().flatten().zip(counted) {
                    let truth = segments.iter().filter(|ray| ray.segment().overlaps(&side.bounds)).count();
                    let truth = if side.primitives > free { truth } else { 0 };
                    assert_eq!(counted as usize, truth, "box {} of {lengths:?}", side.primitives);
                }
            }
        }
    }

    #[test]
    fn plain_and_vector_searches_agree() {
        let mut random = random_stream(5);
        for sides in [10, 200] {
            let mut bounds = PaddedAabb::EMPTY;
            let sequence: Vec<Side> = (0..sides)
                .map(|primitives| {
                    bounds = bounds.grown(Vec3::new(random(), random(), random()).extend(0.0));
                    Side { primitives, bounds }
                })
                .collect();
            let segments: Vec<Packed> = (0..200)
                .filter_map(|_| {
                    let [origin, direction] = [0; 2].map(|_| Vec3::new(random(), random(), random()));
                    Packed::new(&Ray { origin: 2.0 * origin, tnear: 0.0, direction, tfar: 2.0 })
                })
                .collect();
            let rays: Vec<u32> = (0..segments.len() as u32).collect();
            let mut nested = Nested::default();
            nested.start(sides);
            nested.add(sequence.iter().copied(), 0, |_| ());
            let [mut plain, mut chosen] = [0; 2].map(|_| vec![0; nested.boxes.next_multiple_of(LANES)]);
            nested.count_plain(&segments, &rays, &mut plain);
            nested.count_part(&segments, &rays, &mut chosen);
            assert_eq!(plain[..nested.boxes], chosen[..nested.boxes]);
        }
    }
}
