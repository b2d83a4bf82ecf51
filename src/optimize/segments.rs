//! Recorded rays, made ready to be counted against many boxes: what a measure that uses rays is fast or slow by.
//!
//! A ray is 32 bytes. Its test against N boxes is written over arrays of N lanes, which compilers turn into vector
//! instructions; on x86-64 a second copy of the loop, compiled for AVX2, is chosen when the processor has it. Both copies do
//! the same operations in the same order, so counts do not depend on the machine.
//!
//! The test is the conservative one of traversal ([`PreparedRay::entry`]): a ray is counted for
//! exactly those boxes that a traversal of its effective segment would enter. So P_R here is P_R as `bvh-compare` counts it.

use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Ray, Vec3};
use crate::traverse::ray::{PADDING, PreparedRay};
use glam::Vec4;
use rayon::prelude::*;

/// A ray over its effective segment.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Segment {
    /// In the fourth lane tnear.
    origin: Vec4,
    /// 1 / direction; NaN on an axis that cannot bound the ray. In the fourth lane tfar.
    inverse: Vec4,
}

impl Segment {
    /// None for a ray that overlaps no box: not finite, or with an empty interval.
    fn new(ray: &Ray) -> Option<Segment> {
        let ray = PreparedRay::new(ray);
        let lanes = |v: Vec3, w: f32| Vec4::new(v.x, v.y, v.z, w);
        (ray.tnear <= ray.tfar).then_some(Segment {
            origin: lanes(ray.origin, ray.tnear),
            inverse: lanes(ray.near_inverse, ray.tfar),
        })
    }

    /// Which of the boxes the segment overlaps: 1 or 0 a lane.
    #[inline(always)]
    fn overlaps<const N: usize>(&self, boxes: &Lanes<N>) -> [u32; N] {
        let mut entry = [self.origin.w; N];
        let mut exit = [self.inverse.w; N];
        let (origin, inverse) = (self.origin.to_array(), self.inverse.to_array());
        for axis in 0..3 {
            let (origin, inverse) = (origin[axis], inverse[axis]);
            let far_inverse = inverse * (1.0 + PADDING);
            let downwards = (inverse < 0.0) as usize;
            let near = &boxes.faces[axis][downwards];
            let far = &boxes.faces[axis][1 - downwards];
            for lane in 0..N {
                // Written so that NaN changes nothing, as MAXPS and MINPS do.
                let distance = (near[lane] - origin) * inverse;
                entry[lane] = if distance > entry[lane] { distance } else { entry[lane] };
                let distance = (far[lane] - origin) * far_inverse;
                exit[lane] = if distance < exit[lane] { distance } else { exit[lane] };
            }
        }
        std::array::from_fn(|lane| (entry[lane] <= exit[lane]) as u32)
    }

    /// Whether the segment overlaps one box: the same operations, with an axis a lane.
    #[inline(always)]
    fn overlaps_one(&self, bounds: &PaddedAabb) -> bool {
        let (tnear, tfar) = (self.origin.w, self.inverse.w);
        let downwards = self.inverse.cmplt(Vec4::ZERO);
        let near = Vec4::select(downwards, bounds.upper, bounds.lower);
        let far = Vec4::select(downwards, bounds.lower, bounds.upper);
        // The second operand is what a NaN leaves.
        let entry = ((near - self.origin) * self.inverse).max(Vec4::splat(tnear)).with_w(tnear);
        let exit =
            ((far - self.origin) * (self.inverse * (1.0 + PADDING))).min(Vec4::splat(tfar)).with_w(tfar);
        entry.max_element() <= exit.min_element()
    }
}

/// N boxes with their faces side by side.
struct Lanes<const N: usize> {
    /// Per axis: lower faces, upper faces.
    faces: [[[f32; N]; 2]; 3],
}

impl<const N: usize> Lanes<N> {
    fn new(boxes: &[PaddedAabb; N]) -> Lanes<N> {
        let face = |axis: usize, upper: bool| {
            std::array::from_fn(|lane| if upper { boxes[lane].upper[axis] } else { boxes[lane].lower[axis] })
        };
        Lanes { faces: std::array::from_fn(|axis| [face(axis, false), face(axis, true)]) }
    }
}

/// The rays that trees are measured with. Rays that can overlap no box are left out.
#[derive(Clone, Debug)]
pub struct Segments(Vec<Segment>);

/// Rays counted between two looks at whether the answer is known.
const BLOCK: usize = 64;

/// From so many rays on, those counted so far are taken for a sample of the list.
const SAMPLE: usize = 256;

impl Segments {
    /// Prepares effective segments (see [`crate::format::rays::Record::effective_segment`]).
    pub fn new(rays: &[Ray]) -> Segments {
        Segments(rays.par_iter().filter_map(Segment::new).collect())
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A ray as it is tested: origin and tnear, 1 / direction (NaN on an axis that cannot bound the ray) and tfar.
    #[inline(always)]
    pub fn lanes(&self, ray: u32) -> ([f32; 4], [f32; 4]) {
        let Segment { origin, inverse } = self.0[ray as usize];
        (origin.to_array(), inverse.to_array())
    }

    /// How many of the rays in `list` overlap each box.
    pub fn count<const N: usize>(&self, list: &[u32], boxes: &[PaddedAabb; N]) -> [u32; N] {
        let lanes = Lanes::new(boxes);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { count_avx2(&self.0, list, &lanes) };
        }
        count(&self.0, list, &lanes)
    }

    /// How many of the rays in `list` overlap `bounds` (or, unless `inside`, miss it), when that is below `limit`; and how many rays it took to know.
    /// It is taken not to be when, of the first rays of a long list, so many are counted that the limit lies two standard errors below: for a
    /// list in an order that looks random, a wrong guess is rare, and costs a search one place.
    pub fn count_below(
        &self,
        list: &[u32],
        bounds: &PaddedAabb,
        inside: bool,
        limit: u32,
    ) -> (Option<u32>, usize) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { count_below_avx2(&self.0, list, bounds, inside, limit) };
        }
        count_below(&self.0, list, bounds, inside, limit)
    }

    /// The rays in `list` that overlap `bounds`, in the order of `list`.
    pub fn within(&self, list: &[u32], bounds: &PaddedAabb) -> Vec<u32> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { within_avx2(&self.0, list, bounds) };
        }
        within(&self.0, list, bounds)
    }
}

#[inline(always)]
fn within(segments: &[Segment], list: &[u32], bounds: &PaddedAabb) -> Vec<u32> {
    let mut kept = vec![0; list.len()];
    let mut count = 0;
    for &ray in list {
        // Whether a ray overlaps is hard to predict: write in any case, keep by arithmetic.
        kept[count] = ray;
        count += segments[ray as usize].overlaps_one(bounds) as usize;
    }
    kept.truncate(count);
    kept.shrink_to_fit();
    kept
}

#[inline(always)]
fn count_below(
    segments: &[Segment],
    list: &[u32],
    bounds: &PaddedAabb,
    inside: bool,
    limit: u32,
) -> (Option<u32>, usize) {
    let (mut count, mut tested) = (0, 0);
    for block in list.chunks(BLOCK) {
        let seen = f64::from(count);
        let sure = (seen - 2.0 * seen.sqrt()) * list.len() as f64 >= f64::from(limit) * tested as f64;
        if count >= limit || (tested >= SAMPLE && sure) {
            return (None, tested);
        }
        for &ray in block {
            count += (segments[ray as usize].overlaps_one(bounds) == inside) as u32;
        }
        tested += block.len();
    }
    ((count < limit).then_some(count), tested)
}

/// [`count_below`], compiled for AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn count_below_avx2(
    segments: &[Segment],
    list: &[u32],
    bounds: &PaddedAabb,
    inside: bool,
    limit: u32,
) -> (Option<u32>, usize) {
    count_below(segments, list, bounds, inside, limit)
}

/// [`within`], compiled for AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn within_avx2(segments: &[Segment], list: &[u32], bounds: &PaddedAabb) -> Vec<u32> {
    within(segments, list, bounds)
}

#[inline(always)]
fn count<const N: usize>(segments: &[Segment], list: &[u32], lanes: &Lanes<N>) -> [u32; N] {
    let mut counts = [0; N];
    for &ray in list {
        let overlaps = segments[ray as usize].overlaps(lanes);
        for (count, overlap) in counts.iter_mut().zip(overlaps) {
            *count += overlap;
        }
    }
    counts
}

/// [`count`], compiled for AVX2. The multiplications and additions stay separate: fusing would change what is counted.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn count_avx2<const N: usize>(segments: &[Segment], list: &[u32], lanes: &Lanes<N>) -> [u32; N] {
    count(segments, list, lanes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;
    use crate::random::Random;

    /// By how much the segment overlaps the box, in double precision: the length of the common interval of t, negative when they are apart.
    fn overlap(ray: &Ray, bounds: &Aabb) -> f64 {
        let (mut entry, mut exit) = (f64::from(ray.tnear), f64::from(ray.tfar));
        for axis in 0..3 {
            let (origin, direction) = (f64::from(ray.origin[axis]), f64::from(ray.direction[axis]));
            let faces =
                [bounds.lower[axis], bounds.upper[axis]].map(|face| (f64::from(face) - origin) / direction);
            entry = entry.max(faces[0].min(faces[1]));
            exit = exit.min(faces[0].max(faces[1]));
        }
        exit - entry
    }

    #[test]
    fn counts_are_those_of_double_precision() {
        let mut random = Random::new(1);
        let mut vector = || Vec3::from_array([0; 3].map(|_| random.unit() - 0.5));
        let rays: Vec<Ray> = (0..500)
            .map(|_| Ray { origin: vector(), tnear: 0.0, direction: vector(), tfar: vector().x + 0.6 })
            .collect();
        let segments = Segments::new(&rays);
        let all: Vec<u32> = (0..500).collect();
        let mut sure = 0;
        for _ in 0..100 {
            let boxes: [Aabb; 8] = std::array::from_fn(|_| {
                let (a, b) = (vector(), vector());
                Aabb { lower: a.min(b), upper: a.max(b) }
            });
            let padded = boxes.map(PaddedAabb::from);
            let counts = segments.count(&all, &padded);
            for (index, bounds) in boxes.iter().enumerate() {
                let within = segments.within(&all, &padded[index]);
                assert_eq!(within.len(), counts[index] as usize);
                assert_eq!(segments.count(&all, &[padded[index]]), [counts[index]]);
                for (number, ray) in rays.iter().enumerate() {
                    let prepared = PreparedRay::new(ray);
                    let entered = prepared.entry(bounds, prepared.tfar).is_some();
                    assert_eq!(within.contains(&(number as u32)), entered, "traversal decides otherwise");
                    let overlap = overlap(ray, bounds);
                    if overlap.abs() > 1e-5 {
                        assert_eq!(
                            within.contains(&(number as u32)),
                            overlap > 0.0,
                            "{ray:?} {bounds:?} {overlap}"
                        );
                        sure += 1;
                    }
                }
            }
        }
        assert!(sure > 390_000, "{sure}");
    }

    #[test]
    fn rays_that_overlap_nothing_are_left_out() {
        let ray = Ray { origin: Vec3::ZERO, tnear: 0.0, direction: Vec3::X, tfar: 1.0 };
        let bad = [
            Ray { origin: Vec3::NAN, ..ray },
            Ray { direction: Vec3::INFINITY, ..ray },
            Ray { tnear: f32::NAN, ..ray },
            Ray { tfar: -1.0, ..ray },
        ];
        assert!(Segments::new(&bad).is_empty());
        assert_eq!(Segments::new(&[ray]).len(), 1);
    }
}
