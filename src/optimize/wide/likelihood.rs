//! P of boxes for the optimiser of wide trees: w · share of the queries that overlap it + (1 - w) · area, each relative to the root.
//!
//! A node's moves ask for the same rays again and again, most of them for boxes around boxes that are known. So [`Local`] has the rays of one
//! node side by side, which boxes are tested against eight at a time, and a set of bits for every known box: what overlaps a part
//! overlaps all that is around it, so that only the others are tested, and P of a union has a lower bound that takes no test at all.

use super::super::measure::AreaMeasure;
use super::super::segments::Segments;
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Ray};
use crate::random::Random;
use crate::traverse::ray::PADDING;

/// Queries and area, blended.
#[derive(Debug)]
pub struct Likelihood {
    segments: Segments,
    area: AreaMeasure,
    per_ray: f64,
    area_weight: f64,
}

impl Likelihood {
    /// For boxes inside `scene`, with `weight` for the rays (effective segments). Without rays that overlap the scene area alone is left, and
    /// rays alone for a scene without area.
    pub fn new(rays: &[Ray], weight: f64, scene: &PaddedAabb) -> Likelihood {
        let mut rays = rays.to_vec();
        // In an order that looks random, so that the first of a list are a sample of it.
        let mut random = Random::new(0);
        for place in (1..rays.len()).rev() {
            rays.swap(place, random.below(place as u64 + 1) as usize);
        }
        let segments = Segments::new(&rays);
        let all: Vec<u32> = (0..segments.len() as u32).collect();
        let [root] = segments.count(&all, &[*scene]);
        let area = AreaMeasure::new(scene);
        let nothing = Aabb::from(*scene).is_empty();
        let weight = match (root, !nothing && area.of(scene) > 0.0) {
            (0, true) => 0.0,
            (_, false) => 1.0,
            _ => weight,
        };
        Likelihood { segments, area, per_ray: weight / f64::from(root.max(1)), area_weight: 1.0 - weight }
    }

    /// All rays.
    pub fn everything(&self) -> Vec<u32> {
        (0..self.segments.len() as u32).collect()
    }

    /// Those of `list` that overlap `bounds`, in its order.
    pub fn within(&self, list: &[u32], bounds: &PaddedAabb) -> Vec<u32> {
        self.segments.within(list, bounds)
    }

    /// P of a box that so many rays overlap.
    #[inline]
    pub fn of(&self, bounds: &PaddedAabb, rays: usize) -> f64 {
        self.per_ray * rays as f64 + self.of_area(bounds)
    }

    #[inline]
    fn of_area(&self, bounds: &PaddedAabb) -> f64 {
        // Where area has no weight it may be no number: that of nothing, say.
        if self.area_weight > 0.0 { self.area_weight * self.area.of(bounds) } else { 0.0 }
    }

    /// The rays of a node side by side: all of `list`, or of a longer one the first `most`, each for several.
    pub fn local(&self, list: &[u32], most: usize) -> Local<'_> {
        let sample = &list[..list.len().min(most)];
        let scale = if sample.is_empty() { 0.0 } else { list.len() as f64 / sample.len() as f64 };
        Local { likelihood: self, rays: Side::of(&self.segments, sample), scale }
    }
}

/// Rays of a word.
const WORD: usize = u64::BITS as usize;

/// Rays that are tested together.
const LANES: usize = 8;

/// Rays by lane: what a box test needs of each.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Eight {
    origin: [[f32; LANES]; 3],
    inverse: [[f32; LANES]; 3],
    tnear: [f32; LANES],
    tfar: [f32; LANES],
}

impl Eight {
    /// Rays that overlap nothing.
    const NOTHING: Eight = Eight {
        origin: [[0.0; LANES]; 3],
        inverse: [[1.0; LANES]; 3],
        tnear: [f32::INFINITY; LANES],
        tfar: [f32::NEG_INFINITY; LANES],
    };

    /// A lane for each ray: all bits where it overlaps the box. The operations are those of [`Segments`], in their order.
    #[inline(always)]
    fn overlap(&self, bounds: &PaddedAabb) -> [u32; LANES] {
        let (mut entry, mut exit) = (self.tnear, self.tfar);
        for axis in 0..3 {
            let (lower, upper) = (bounds.lower[axis], bounds.upper[axis]);
            for lane in 0..LANES {
                let (origin, inverse) = (self.origin[axis][lane], self.inverse[axis][lane]);
                let downwards = inverse < 0.0;
                let near = if downwards { upper } else { lower };
                let far = if downwards { lower } else { upper };
                let distance = (near - origin) * inverse;
                entry[lane] = if distance > entry[lane] { distance } else { entry[lane] };
                let distance = (far - origin) * (inverse * (1.0 + PADDING));
                exit[lane] = if distance < exit[lane] { distance } else { exit[lane] };
            }
        }
        std::array::from_fn(|lane| if entry[lane] <= exit[lane] { u32::MAX } else { 0 })
    }
}

/// Rays side by side, in words of 64.
#[derive(Debug)]
struct Side {
    eights: Vec<Eight>,
}

impl Side {
    fn of(segments: &Segments, list: &[u32]) -> Side {
        let words = list.len().div_ceil(WORD);
        let mut eights = vec![Eight::NOTHING; words * (WORD / LANES)];
        for (place, &ray) in list.iter().enumerate() {
            let (eight, lane) = (&mut eights[place / LANES], place % LANES);
            let ([x, y, z, tnear], [ix, iy, iz, tfar]) = segments.lanes(ray);
            for (axis, (origin, inverse)) in [(x, ix), (y, iy), (z, iz)].into_iter().enumerate() {
                (eight.origin[axis][lane], eight.inverse[axis][lane]) = (origin, inverse);
            }
            (eight.tnear[lane], eight.tfar[lane]) = (tnear, tfar);
        }
        Side { eights }
    }

    fn words(&self) -> usize {
        self.eights.len() / (WORD / LANES)
    }

    /// Adds the bits of the rays that overlap `bounds`.
    fn add(&self, bounds: &PaddedAabb, bits: &mut [u64]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { self.add_avx2(bounds, bits) };
        }
        for (word, eights) in bits.iter_mut().zip(self.eights.as_chunks::<{ WORD / LANES }>().0) {
            if *word != u64::MAX {
                for (place, eight) in eights.iter().enumerate() {
                    for (lane, overlap) in eight.overlap(bounds).into_iter().enumerate() {
                        *word |= u64::from(overlap & 1) << (place * LANES + lane);
                    }
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_avx2(&self, bounds: &PaddedAabb, bits: &mut [u64]) {
        use std::arch::x86_64::{__m256, _mm256_movemask_ps};
        for (word, eights) in bits.iter_mut().zip(self.eights.as_chunks::<{ WORD / LANES }>().0) {
            for (place, eight) in eights.iter().enumerate() {
                // What is known already needs no test.
                if *word >> (place * LANES) & 0xFF != 0xFF {
                    let lanes: __m256 = bytemuck::cast(eight.overlap(bounds));
                    *word |= (_mm256_movemask_ps(lanes) as u8 as u64) << (place * LANES);
                }
            }
        }
    }
}

/// A set of the rays of a node.
pub type Bits = Box<[u64]>;

/// The rays of a node, or a sample of them, and P of boxes inside of it.
#[derive(Debug)]
pub struct Local<'a> {
    likelihood: &'a Likelihood,
    rays: Side,
    /// Rays that each of the sample stands for.
    scale: f64,
}

impl Local<'_> {
    /// Whether P is counted, not estimated from a sample.
    pub fn is_exact(&self) -> bool {
        self.scale <= 1.0
    }

    /// The rays that overlap `bounds`.
    pub fn bits(&self, bounds: &PaddedAabb) -> Bits {
        let mut bits = vec![0; self.rays.words()].into_boxed_slice();
        self.rays.add(bounds, &mut bits);
        bits
    }

    /// The rays that overlap `bounds`, which is around the boxes of both sets.
    pub fn around(&self, bounds: &PaddedAabb, a: &[u64], b: &[u64]) -> Bits {
        let mut bits: Bits = a.iter().zip(b).map(|(a, b)| a | b).collect();
        self.rays.add(bounds, &mut bits);
        bits
    }

    /// P of a box that the rays of a set overlap.
    pub fn p(&self, bounds: &PaddedAabb, bits: &[u64]) -> f64 {
        let count: u32 = bits.iter().map(|word| word.count_ones()).sum();
        self.value(bounds, count)
    }

    /// At least so much is P of a box around the boxes of both sets.
    pub fn least(&self, bounds: &PaddedAabb, a: &[u64], b: &[u64]) -> f64 {
        let count: u32 = a.iter().zip(b).map(|(a, b)| (a | b).count_ones()).sum();
        self.value(bounds, count)
    }

    #[inline]
    fn value(&self, bounds: &PaddedAabb, count: u32) -> f64 {
        self.likelihood.per_ray * self.scale * f64::from(count) + self.likelihood.of_area(bounds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;
    use crate::optimize::checks::rays;

    fn boxes(count: usize) -> Vec<PaddedAabb> {
        let mut random = Random::new(3);
        let mut vector = || Vec3::from_array([0; 3].map(|_| random.unit()));
        (0..count)
            .map(|_| {
                let (a, b) = (vector(), vector());
                Aabb { lower: a.min(b), upper: a.max(b) }.into()
            })
            .collect()
    }

    #[test]
    fn sets_are_the_rays_that_a_traversal_would_bring() {
        let scene = Aabb { lower: Vec3::ZERO, upper: Vec3::splat(1.5) }.into();
        for count in [0, 1, 63, 64, 65, 300] {
            let mut rays = rays(count, 4);
            // Along an axis, and within a face.
            rays.extend(rays.clone().iter().map(|ray| Ray { direction: Vec3::Y * ray.direction.y, ..*ray }));
            let likelihood = Likelihood::new(&rays, 0.8, &scene);
            let all = likelihood.everything();
            let local = likelihood.local(&all, usize::MAX);
            assert!(local.is_exact());
            for pair in boxes(40).chunks(2) {
                let [a, b] = [local.bits(&pair[0]), local.bits(&pair[1])];
                let found = |bits: &Bits| bits.iter().map(|word| word.count_ones()).sum::<u32>() as usize;
                assert_eq!(found(&a), likelihood.within(&all, &pair[0]).len());
                let union = pair[0].union(&pair[1]);
                let around = local.around(&union, &a, &b);
                assert_eq!(around, local.bits(&union));
                let exact = likelihood.of(&union, likelihood.within(&all, &union).len());
                assert!((local.p(&union, &around) - exact).abs() < 1e-12);
                assert!(local.least(&union, &a, &b) <= exact + 1e-12);
                // The plain loop agrees with the one for AVX2.
                let mut plain = vec![0; local.rays.words()];
                for (word, eights) in plain.iter_mut().zip(local.rays.eights.as_chunks::<8>().0) {
                    for (place, eight) in eights.iter().enumerate() {
                        for (lane, overlap) in eight.overlap(&union).into_iter().enumerate() {
                            *word |= u64::from(overlap & 1) << (place * LANES + lane);
                        }
                    }
                }
                assert_eq!(*around, plain[..]);
            }
        }
    }

    #[test]
    fn the_root_is_1_with_and_without_rays_and_area() {
        let cube: PaddedAabb = Aabb { lower: Vec3::ZERO, upper: Vec3::ONE }.into();
        let flat: PaddedAabb = Aabb { lower: Vec3::ZERO, upper: Vec3::X }.into();
        let some = rays(100, 1);
        let line = Ray { origin: Vec3::NEG_Y, tnear: 0.0, direction: Vec3::Y, tfar: 9.0 };
        for (rays, scene) in [(&some[..], cube), (&[][..], cube), (&[line][..], flat)] {
            let likelihood = Likelihood::new(rays, 0.8, &scene);
            let count = likelihood.within(&likelihood.everything(), &scene).len();
            assert!((likelihood.of(&scene, count) - 1.0).abs() < 1e-6, "{rays:?}");
        }
        let nothing = Likelihood::new(&[], 0.8, &flat);
        assert_eq!(nothing.of(&flat, 0), 0.0);
    }

    #[test]
    fn a_sample_estimates() {
        let scene = Aabb { lower: Vec3::ZERO, upper: Vec3::splat(1.5) }.into();
        let likelihood = Likelihood::new(&rays(4000, 4), 1.0, &scene);
        let all = likelihood.everything();
        let [whole, part] = [usize::MAX, 512].map(|most| likelihood.local(&all, most));
        assert!(!part.is_exact());
        for bounds in boxes(20) {
            let [exact, estimate] = [&whole, &part].map(|local| local.p(&bounds, &local.bits(&bounds)));
            assert!((exact - estimate).abs() < 0.1, "{exact} {estimate}");
        }
    }
}
