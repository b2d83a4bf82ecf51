//! P_U: uniformly distributed rays hit a convex box in proportion to its surface area (Goldsmith and Salmon 1987;
//! MacDonald and Booth 1990). With it, a builder is a SAH builder.

use super::{Cuts, Probability, Scores};
use crate::geometry::padded::PaddedAabb;

/// Half the surface area of a box, in units chosen so that no scene's areas overflow or vanish in `f32`.
#[derive(Clone, Copy, Debug)]
pub struct Area {
    /// A power of two, so that scaling is exact.
    unit: f32,
}

impl Area {
    /// The measure for boxes inside `scene`.
    pub fn of_scene(scene: &PaddedAabb) -> Area {
        Area { unit: unit_for(scene) }
    }

    /// Half the surface area; unspecified for an empty box.
    #[inline(always)]
    pub fn of(&self, bounds: &PaddedAabb) -> f32 {
        // Scaled before subtracting: the difference of two finite coordinates can overflow.
        let edge = bounds.upper * self.unit - bounds.lower * self.unit;
        edge.x * edge.y + edge.y * edge.z + edge.z * edge.x
    }
}

/// The power of two that brings the largest coordinate of a finite box to about 1: from 1 to 8, or less for numbers that
/// are nearly 0. The result and its half are normal numbers.
pub fn unit_for(scene: &PaddedAabb) -> f32 {
    let largest = scene.lower.abs().max(scene.upper.abs()).max_element();
    let exponent = ((largest.to_bits() >> 23) & 0xFF).clamp(2, 252);
    f32::from_bits((254 - exponent) << 23)
}

impl Probability for Area {
    type State = ();

    #[inline(always)]
    fn root(&self, _bounds: &PaddedAabb) {}

    #[inline(always)]
    fn node(&self, _state: &(), bounds: &PaddedAabb) -> f32 {
        self.of(bounds)
    }

    #[inline(always)]
    fn score<C: Cuts>(&self, _state: &(), _free: usize, cuts: &[C], scores: &mut [Scores]) {
        for (cuts, scores) in cuts.iter().zip(scores) {
            for (area, side) in scores.left.iter_mut().zip(cuts.left()) {
                *area = self.of(&side.bounds);
            }
            for (area, side) in scores.right.iter_mut().rev().zip(cuts.right()) {
                *area = self.of(&side.bounds);
            }
        }
    }

    #[inline(always)]
    fn split(&self, _state: (), _children: [Option<&PaddedAabb>; 2]) -> [(); 2] {
        [(); 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};

    #[test]
    fn ratios_are_those_of_surface_areas() {
        let big = Aabb { lower: Vec3::ZERO, upper: Vec3::new(3.0, 4.0, 5.0) };
        let small = Aabb { lower: Vec3::ONE, upper: Vec3::new(2.0, 2.0, 1.0) };
        let area = Area::of_scene(&big.into());
        let ratio = area.of(&small.into()) / area.of(&big.into());
        assert_eq!(ratio, 1.0 / 47.0);
    }

    #[test]
    fn neither_huge_nor_tiny_scenes_lose_their_areas() {
        for size in [f32::MAX, 1e38, 1e20, 1.0, 1e-20, 1e-37] {
            let bounds = Aabb { lower: Vec3::splat(-size), upper: Vec3::splat(size) }.into();
            let area = Area::of_scene(&bounds).of(&bounds);
            assert!((3.0..1000.0).contains(&area), "{size} {area}");
        }
        let point = Aabb { lower: Vec3::ZERO, upper: Vec3::ZERO }.into();
        assert_eq!(Area::of_scene(&point).of(&point), 0.0);
    }
}
