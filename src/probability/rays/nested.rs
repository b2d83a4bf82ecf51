//! How many rays overlap each of many nested boxes, without testing rays × boxes.
//!
//! A ray that overlaps a box overlaps all larger ones, so it is enough to find the first box that it overlaps; a
//! histogram of those and its running sum give every count. The search is 8-ary: boxes stand in blocks of eight,
//! faces side by side, one vector test for a block; above them, the last (largest) box of each block stands in
//! blocks again, up to a single one. So 8 boxes cost a ray one vector test, 64 two, a million seven.

use super::segment::Segment;
use super::{BLOCK, PARALLEL};
use crate::geometry::padded::PaddedAabb;
use rayon::prelude::*;
use std::cell::Cell;

/// Boxes in a block.
const LANES: usize = 8;

/// Eight boxes: per axis the lower faces, then the upper faces.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Block {
    faces: [[[f32; LANES]; 2]; 3],
}

impl Block {
    const ZERO: Block = Block { faces: [[[0.0; LANES]; 2]; 3] };

    #[inline(always)]
    fn set(&mut self, lane: usize, bounds: &PaddedAabb) {
        for axis in 0..3 {
            self.faces[axis][0][lane] = bounds.lower[axis];
            self.faces[axis][1][lane] = bounds.upper[axis];
        }
    }

    /// Copies the last of `filled` boxes to the lanes behind it: what overlaps them overlaps it, so they are never first.
    fn fill(&mut self, filled: usize) {
        for faces in self.faces.as_flattened_mut() {
            let last = faces[filled - 1];
            faces[filled..].fill(last);
        }
    }
}

/// Nested boxes, made ready for the search. Kept by each thread, so that a node allocates nothing.
#[derive(Debug, Default)]
pub struct Candidates {
    /// All levels, the boxes themselves first.
    blocks: Vec<Block>,
    /// Where each level starts in `blocks`.
    levels: Vec<u32>,
    count: usize,
    /// By box: rays that overlap it first. One entry more, for rays that overlap none.
    histogram: Vec<u32>,
    /// By ray: the first box; only where several threads search.
    first: Vec<u32>,
}

thread_local! {
    static CANDIDATES: Cell<Option<Box<Candidates>>> = const { Cell::new(None) };
}

/// Lends the thread's memory to `work`. Work that is run meanwhile on the same thread (stolen by a wait) gets its own.
pub fn with_candidates<T>(work: impl FnOnce(&mut Candidates) -> T) -> T {
    let mut candidates = CANDIDATES.take().unwrap_or_default();
    let result = work(&mut candidates);
    CANDIDATES.set(Some(candidates));
    result
}

impl Candidates {
    /// Forgets the boxes before, and makes room for `count`.
    pub fn start(&mut self, count: usize) {
        self.blocks.clear();
        // A seventh for the levels above, and their last blocks.
        self.blocks.reserve(count.div_ceil(LANES) * 8 / 7 + 16);
        self.count = 0;
    }

    /// Adds a box that contains the one before.
    #[inline(always)]
    pub fn push(&mut self, bounds: &PaddedAabb) {
        let lane = self.count % LANES;
        if lane == 0 {
            self.blocks.push(Block::ZERO);
        }
        if let Some(block) = self.blocks.last_mut() {
            block.set(lane, bounds);
        }
        self.count += 1;
    }

    /// Builds the levels above the boxes.
    pub fn finish(&mut self) {
        self.levels.clear();
        self.levels.push(0);
        if self.count == 0 {
            return;
        }
        let (mut start, mut filled) = (0, self.count);
        loop {
            let end = self.blocks.len();
            let rest = filled % LANES;
            if rest != 0 {
                self.blocks[end - 1].fill(rest);
            }
            if end - start == 1 {
                return;
            }
            self.levels.push(end as u32);
            filled = end - start;
            for group in (start..end).step_by(LANES) {
                let mut above = Block::ZERO;
                for (lane, block) in self.blocks[group..end.min(group + LANES)].iter().enumerate() {
                    for (to, from) in
                        above.faces.as_flattened_mut().iter_mut().zip(block.faces.as_flattened())
                    {
                        to[lane] = from[LANES - 1];
                    }
                }
                self.blocks.push(above);
            }
            start = end;
        }
    }

    /// For each box, the number of `rays` that overlap it and none of the smaller ones.
    pub fn first_overlaps(&mut self, segments: &[Segment], rays: &[u32]) -> &[u32] {
        self.histogram.clear();
        self.histogram.resize(self.count + 1, 0);
        if self.count == 0 {
            return &[];
        }
        let search = Search { blocks: &self.blocks, levels: &self.levels, none: self.count as u32 };
        if rays.len() <= PARALLEL {
            let histogram = &mut self.histogram;
            search.each(segments, rays, |_, first| histogram[first as usize] += 1);
        } else {
            self.first.resize(rays.len(), 0);
            let blocks = self.first.par_chunks_mut(BLOCK).zip(rays.par_chunks(BLOCK));
            blocks.for_each(|(found, rays)| {
                search.each(segments, rays, |index, first| found[index] = first);
            });
            for &first in &self.first {
                self.histogram[first as usize] += 1;
            }
        }
        &self.histogram[..self.count]
    }
}

/// A search that runs.
#[derive(Clone, Copy)]
struct Search<'a> {
    blocks: &'a [Block],
    levels: &'a [u32],
    /// The answer for a ray that overlaps no box.
    none: u32,
}

impl Search<'_> {
    /// Calls `found` with the index in `rays` and the first box of each ray.
    #[inline(always)]
    fn each(&self, segments: &[Segment], rays: &[u32], found: impl FnMut(usize, u32)) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as was just asked.
            return unsafe { self.each_avx2(segments, rays, found) };
        }
        self.each_with(segments, rays, overlapped, found);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn each_avx2(&self, segments: &[Segment], rays: &[u32], found: impl FnMut(usize, u32)) {
        self.each_with(segments, rays, |block, ray| overlapped_avx2(block, ray), found);
    }

    #[inline(always)]
    fn each_with(
        &self,
        segments: &[Segment],
        rays: &[u32],
        overlapped: impl Fn(&Block, &Segment) -> u32,
        mut found: impl FnMut(usize, u32),
    ) {
        for (index, &ray) in rays.iter().enumerate() {
            let segment = &segments[ray as usize];
            // Only at the top can a ray overlap none of the boxes: below, it overlaps the last of the block.
            let mut first = 0;
            for &level in self.levels.iter().rev() {
                let mask = overlapped(&self.blocks[(level + first) as usize], segment);
                if mask == 0 {
                    first = self.none;
                    break;
                }
                first = first * LANES as u32 + mask.trailing_zeros();
            }
            found(index, first);
        }
    }
}

/// Bit i: the ray overlaps box i of the block.
#[inline(always)]
fn overlapped(block: &Block, ray: &Segment) -> u32 {
    let mut entry = [ray.near_inverse.w; LANES];
    let mut exit = [ray.far_inverse.w; LANES];
    for axis in 0..3 {
        let down = (ray.downwards[axis] & 1) as usize;
        let faces = &block.faces[axis];
        for lane in 0..LANES {
            let near = (faces[down][lane] - ray.origin[axis]) * ray.near_inverse[axis];
            let far = (faces[down ^ 1][lane] - ray.origin[axis]) * ray.far_inverse[axis];
            entry[lane] = if near > entry[lane] { near } else { entry[lane] };
            exit[lane] = if far < exit[lane] { far } else { exit[lane] };
        }
    }
    (0..LANES).map(|lane| ((entry[lane] <= exit[lane]) as u32) << lane).sum()
}

/// [`overlapped`] in eight lanes; the same operations, so the same answers.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn overlapped_avx2(block: &Block, ray: &Segment) -> u32 {
    use std::arch::x86_64::*;
    let mut entry = _mm256_set1_ps(ray.near_inverse.w);
    let mut exit = _mm256_set1_ps(ray.far_inverse.w);
    let origin = ray.origin.to_array();
    let (near_inverse, far_inverse) = (ray.near_inverse.to_array(), ray.far_inverse.to_array());
    for axis in 0..3 {
        let down = (ray.downwards[axis] & 1) as usize;
        let faces = &block.faces[axis];
        // SAFETY: eight floats each, and a block's rows are 32-byte aligned.
        let (near, far) =
            unsafe { (_mm256_load_ps(faces[down].as_ptr()), _mm256_load_ps(faces[down ^ 1].as_ptr())) };
        let origin = _mm256_set1_ps(origin[axis]);
        let near = _mm256_mul_ps(_mm256_sub_ps(near, origin), _mm256_set1_ps(near_inverse[axis]));
        let far = _mm256_mul_ps(_mm256_sub_ps(far, origin), _mm256_set1_ps(far_inverse[axis]));
        // NaN loses: the second operand is returned.
        entry = _mm256_max_ps(near, entry);
        exit = _mm256_min_ps(far, exit);
    }
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Ray, Vec3};

    fn random_stream(seed: u64) -> impl FnMut() -> f32 {
        let mut random = crate::random::Random::new(seed);
        move || random.unit() * 2.0 - 1.0
    }

    /// Truth: every ray against every box, with the plain test.
    #[test]
    fn counts_are_those_of_testing_everything() {
        let mut random = random_stream(7);
        for count in [1, 2, 7, 8, 9, 31, 63, 64, 65, 100, 511, 512, 513, 5000] {
            let mut boxes = Vec::new();
            let mut sum = PaddedAabb::EMPTY;
            for index in 0..count {
                // Leading boxes may be empty, and many are equal to the one before.
                if index > count / 5 && random() > 0.0 {
                    let size = index as f32 / count as f32;
                    sum = sum.grown((Vec3::new(random(), random(), random()) * size).extend(0.0));
                }
                boxes.push(sum);
            }
            let segments: Vec<Segment> = (0..300)
                .filter_map(|index| {
                    let direction =
                        Vec3::new(random(), random(), if index % 7 == 0 { 0.0 } else { random() });
                    let tfar = if index % 3 == 0 { f32::INFINITY } else { random().abs() * 3.0 };
                    let origin = 1.5 * Vec3::new(random(), random(), random());
                    Segment::new(&Ray { origin, tnear: 0.0, direction, tfar })
                })
                .collect();
            let rays: Vec<u32> = (0..segments.len() as u32).collect();
            let found = with_candidates(|candidates| {
                candidates.start(count);
                boxes.iter().for_each(|bounds| candidates.push(bounds));
                candidates.finish();
                candidates.first_overlaps(&segments, &rays).to_vec()
            });
            let mut sum = 0;
            for (index, bounds) in boxes.iter().enumerate() {
                sum += found[index] as usize;
                let truth = segments.iter().filter(|segment| segment.overlaps(bounds)).count();
                assert_eq!(sum, truth, "box {index} of {count}");
            }
        }
    }

    #[test]
    fn vector_and_plain_tests_agree_with_the_traversals() {
        let mut random = random_stream(11);
        for case in 0..2000 {
            let mut block = Block::ZERO;
            let boxes: Vec<PaddedAabb> = (0..LANES)
                .map(|lane| {
                    let (a, b) =
                        (Vec3::new(random(), random(), random()), Vec3::new(random(), random(), random()));
                    let bounds = PaddedAabb::from(Aabb { lower: a.min(b), upper: a.max(b) });
                    block.set(lane, &bounds);
                    bounds
                })
                .collect();
            let zero = |on: bool, value: f32| if on { 0.0 } else { value };
            let ray = Ray {
                origin: Vec3::new(random(), random(), random()) * 2.0,
                tnear: if case % 11 == 0 { -1.0 } else { 0.0 },
                direction: Vec3::new(zero(case % 3 == 0, random()), zero(case % 5 == 0, random()), random()),
                tfar: if case % 2 == 0 { f32::INFINITY } else { random().abs() },
            };
            let segment = Segment::new(&ray).unwrap();
            let prepared = crate::traverse::ray::PreparedRay::new(&ray);
            let truth: u32 = (0..LANES)
                .map(|lane| (prepared.entry(&boxes[lane].into(), prepared.tfar).is_some() as u32) << lane)
                .sum();
            assert_eq!(overlapped(&block, &segment), truth, "{ray:?}");
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                assert_eq!(unsafe { overlapped_avx2(&block, &segment) }, truth, "{ray:?}");
            }
        }
    }
}
