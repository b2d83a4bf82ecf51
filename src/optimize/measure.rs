//! What a tree costs: P(box) for trees that change, with what makes it cheap to ask again after a small change.
//!
//! A greedy builder asks [`crate::probability::Probability`] for many nested boxes of one node. An optimiser asks for a few boxes
//! that are not nested, inside a node whose rays it knows already. So a [`Measure`] has a `List` for every inner node: nothing for
//! area, the rays that overlap the node's box for rays. A box inside another overlaps no ray that the other does not.

use super::segments::Segments;
use crate::geometry::Ray;
use crate::geometry::padded::{Extent, PaddedAabb};
use crate::probability::area::Area;
use crate::random::Random;

/// P of boxes. The root's is about 1, so that costs of different measures can be read side by side.
pub trait Measure: Sync {
    /// What a node takes up.
    type Bounds: Extent;
    /// What is kept for an inner node.
    type List: Clone + Default + Send + Sync;

    /// Nodes for which places are looked for side by side before any of them moves. Fewer see a fresher tree; more lie nearer to each other, so that
    /// caches help, and keep more threads busy.
    const BATCH: usize;

    /// What a leaf over `primitives` takes up, whose box is `bounds`.
    fn leaf(&self, bounds: PaddedAabb, primitives: &[u32]) -> Self::Bounds;

    /// The box of a node, as it is written.
    fn one(bounds: &Self::Bounds) -> PaddedAabb;

    /// The list of a box that holds everything.
    fn whole(&self) -> Self::List;

    /// The list of `bounds`, which lies inside the box that `outer` belongs to.
    fn within(&self, outer: &Self::List, bounds: &Self::Bounds) -> Self::List;

    /// P of a box and its list.
    fn value(&self, bounds: &Self::Bounds, list: &Self::List) -> f64;

    /// P of each of `boxes`, which lie inside the box that `outer` belongs to.
    fn values<const N: usize>(&self, outer: &Self::List, boxes: &[Self::Bounds; N]) -> [f64; N];

    /// P of `bounds`, which lies inside the box that `outer` belongs to, when it is below `limit`; `None` as soon as it is known not to be.
    /// Adds to `work`.
    fn value_below(
        &self,
        outer: &Self::List,
        bounds: &Self::Bounds,
        limit: f64,
        work: &mut u64,
    ) -> Option<f64>;

    /// Whether P of `union`, the box around `node` and another box whose list is `moved`, can be below `limit`: cheaper to ask than
    /// [`Self::value_below`], because `moved` is short. `list` is that of `node`.
    fn can_be_below(
        &self,
        node: (&Self::Bounds, &Self::List),
        moved: &Self::List,
        union: &Self::Bounds,
        limit: f64,
        work: &mut u64,
    ) -> bool;

    /// How many units of work one box costs that is tested against `list`.
    fn work(&self, list: &Self::List) -> u64;
}

/// P_U: surface area over the root's.
#[derive(Clone, Copy, Debug)]
pub struct AreaMeasure {
    area: Area,
    per_area: f64,
}

impl AreaMeasure {
    /// For boxes inside `scene`.
    pub fn new(scene: &PaddedAabb) -> AreaMeasure {
        let area = Area::of_scene(scene);
        let whole = area.of(scene) as f64;
        AreaMeasure { area, per_area: if whole > 0.0 { 1.0 / whole } else { 0.0 } }
    }

    #[inline(always)]
    pub fn of(&self, bounds: &PaddedAabb) -> f64 {
        self.area.of(bounds) as f64 * self.per_area
    }
}

impl Measure for AreaMeasure {
    type Bounds = PaddedAabb;
    type List = ();

    // A search waits for memory, and for little else.
    const BATCH: usize = 1 << 17;

    #[inline(always)]
    fn leaf(&self, bounds: PaddedAabb, _primitives: &[u32]) -> PaddedAabb {
        bounds
    }

    #[inline(always)]
    fn one(bounds: &PaddedAabb) -> PaddedAabb {
        *bounds
    }

    fn whole(&self) {}

    #[inline(always)]
    fn within(&self, _outer: &(), _bounds: &PaddedAabb) {}

    #[inline(always)]
    fn value(&self, bounds: &PaddedAabb, _list: &()) -> f64 {
        self.of(bounds)
    }

    #[inline(always)]
    fn values<const N: usize>(&self, _outer: &(), boxes: &[PaddedAabb; N]) -> [f64; N] {
        std::array::from_fn(|index| self.of(&boxes[index]))
    }

    #[inline(always)]
    fn value_below(&self, _outer: &(), bounds: &PaddedAabb, limit: f64, work: &mut u64) -> Option<f64> {
        *work += 1;
        let value = self.of(bounds);
        (value < limit).then_some(value)
    }

    #[inline(always)]
    fn can_be_below(
        &self,
        _node: (&PaddedAabb, &()),
        _moved: &(),
        _union: &PaddedAabb,
        _limit: f64,
        _work: &mut u64,
    ) -> bool {
        true
    }

    #[inline(always)]
    fn work(&self, _list: &()) -> u64 {
        1
    }
}

/// How P of a box follows from the rays that overlap it and its area. Rays that a tree has not seen are what counts: near the leaves a box meets
/// few training rays, or none, and that number alone says little about others.
///
/// A floor under the counts, such as the P_R + 10 of the paper's powerplant, helps a builder, which multiplies it with a number of
/// primitives. It means nothing to an optimiser: it adds the same to every inner node of every tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimate {
    /// w · rays/rays(root) + (1 - w) · area/area(root), w from 0 to 1: the same trust in both for all boxes.
    Blend { weight: f64 },
    /// m (k + s)/(m + s) for k rays, where m rays were to be expected from the box's area, and s > 0: the mean of the rate of a Poisson process
    /// that gave k, when before it was thought to be Gamma distributed with mean m and a relative variance of 1/s. Where many
    /// rays are expected the count decides; where few are, the area. There is no weight to be tuned: s from 0.3 to 3 gives nearly the same trees.
    Shrunk { strength: f64 },
}

impl Default for Estimate {
    fn default() -> Estimate {
        Estimate::Shrunk { strength: 1.0 }
    }
}

/// P estimated from recorded rays and area.
pub struct RayMeasure {
    segments: Segments,
    area: AreaMeasure,
    estimate: Estimate,
    /// Rays that overlap the root; 1 when there is none.
    root_rays: f64,
}

impl RayMeasure {
    /// `rays` are effective segments. When none overlaps `scene`, area alone remains; when it has no area, the rays alone.
    pub fn new(rays: &[Ray], estimate: Estimate, scene: &PaddedAabb) -> RayMeasure {
        // In an order that looks random, the first rays of every list are a sample of it, and counting can end early.
        let mut rays = rays.to_vec();
        let mut random = Random::new(0);
        for place in (1..rays.len()).rev() {
            rays.swap(place, random.below(place as u64 + 1) as usize);
        }
        let segments = Segments::new(&rays);
        let area = AreaMeasure::new(scene);
        let all: Vec<u32> = (0..segments.len() as u32).collect();
        let [root] = segments.count(&all, &[*scene]);
        let estimate = if root == 0 {
            Estimate::Blend { weight: 0.0 }
        } else if area.of(scene) == 0.0 {
            Estimate::Blend { weight: 1.0 }
        } else {
            estimate
        };
        RayMeasure { segments, area, estimate, root_rays: f64::from(root.max(1)) }
    }

    /// P of a box that so many rays overlap; grows with both.
    #[inline(always)]
    fn estimate(&self, bounds: &PaddedAabb, rays: usize) -> f64 {
        let rays = rays as f64 / self.root_rays;
        let area = self.area.of(bounds);
        match self.estimate {
            Estimate::Blend { weight } => weight * rays + (1.0 - weight) * area,
            Estimate::Shrunk { strength } => {
                let share = strength / self.root_rays;
                area * (rays + share) / (area + share)
            }
        }
    }
}

impl RayMeasure {
    /// The least number of rays for which P of `bounds` is not below `limit`.
    fn rays_for(&self, bounds: &PaddedAabb, limit: f64) -> u32 {
        let area = self.area.of(bounds);
        let share = match self.estimate {
            Estimate::Blend { weight } => (limit - (1.0 - weight) * area) / weight,
            Estimate::Shrunk { strength } => {
                let share = strength / self.root_rays;
                limit * (area + share) / area - share
            }
        };
        // A weight or an area of 0 gives NaN or infinity: `value_below` compares in any case. The conversion saturates.
        if share.is_nan() { u32::MAX } else { (share * self.root_rays).ceil().max(0.0) as u32 }
    }
}

impl Measure for RayMeasure {
    type Bounds = PaddedAabb;
    type List = Vec<u32>;

    // A search counts rays.
    const BATCH: usize = 1 << 13;

    #[inline(always)]
    fn leaf(&self, bounds: PaddedAabb, _primitives: &[u32]) -> PaddedAabb {
        bounds
    }

    #[inline(always)]
    fn one(bounds: &PaddedAabb) -> PaddedAabb {
        *bounds
    }

    fn whole(&self) -> Vec<u32> {
        (0..self.segments.len() as u32).collect()
    }

    fn within(&self, outer: &Vec<u32>, bounds: &PaddedAabb) -> Vec<u32> {
        self.segments.within(outer, bounds)
    }

    #[inline]
    fn value(&self, bounds: &PaddedAabb, list: &Vec<u32>) -> f64 {
        self.estimate(bounds, list.len())
    }

    fn values<const N: usize>(&self, outer: &Vec<u32>, boxes: &[PaddedAabb; N]) -> [f64; N] {
        let counts = self.segments.count(outer, boxes);
        std::array::from_fn(|index| self.estimate(&boxes[index], counts[index] as usize))
    }

    fn value_below(&self, outer: &Vec<u32>, bounds: &PaddedAabb, limit: f64, work: &mut u64) -> Option<f64> {
        let most = self.rays_for(bounds, limit).saturating_add(1);
        let (count, tested) = self.segments.count_below(outer, bounds, true, most);
        *work += tested as u64 + 1;
        let value = self.estimate(bounds, count? as usize);
        (value < limit).then_some(value)
    }

    fn can_be_below(
        &self,
        (bounds, list): (&PaddedAabb, &Vec<u32>),
        moved: &Vec<u32>,
        union: &PaddedAabb,
        limit: f64,
        work: &mut u64,
    ) -> bool {
        // All rays of either box overlap the union.
        let most = self.rays_for(union, limit).saturating_add(1);
        let Some(most) = most.checked_sub(list.len() as u32) else { return false };
        let (count, tested) = self.segments.count_below(moved, bounds, false, most);
        *work += tested as u64 + 1;
        count.is_some()
    }

    fn work(&self, list: &Vec<u32>) -> u64 {
        list.len() as u64 + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};

    fn cube(size: f32) -> PaddedAabb {
        Aabb { lower: Vec3::ZERO, upper: Vec3::splat(size) }.into()
    }

    #[test]
    fn estimates_grow_with_rays_and_area_and_are_1_for_the_root() {
        let rays: Vec<Ray> = (0..1000)
            .map(|i| Ray { origin: Vec3::splat(1e-3 * i as f32), tnear: 0.0, direction: Vec3::X, tfar: 1e-4 })
            .collect();
        for estimate in [Estimate::Blend { weight: 0.3 }, Estimate::Shrunk { strength: 1.0 }] {
            let measure = RayMeasure::new(&rays, estimate, &cube(1.0));
            assert!((measure.estimate(&cube(1.0), 1000) - 1.0).abs() < 1e-12);
            assert_eq!(
                measure.values(&measure.whole(), &[cube(0.4999)]),
                [measure.estimate(&cube(0.4999), 500)]
            );
            let mut least = -1.0;
            for rays in [0, 1, 10, 999] {
                let [small, large] = [0.1, 0.9].map(|size| measure.estimate(&cube(size), rays));
                assert!(small < large && least < small);
                least = small;
            }
        }
        let shrunk = RayMeasure::new(&rays, Estimate::default(), &cube(1.0));
        // 810 rays were expected: 405 are believed. A thousandth of one was expected: 10 are not.
        assert!((shrunk.estimate(&cube(0.9), 405) / 0.405 - 1.0).abs() < 0.01);
        assert!(shrunk.estimate(&cube(1e-3), 10) < 2e-5);
    }

    #[test]
    fn without_rays_area_remains_and_without_area_the_rays() {
        let none = RayMeasure::new(&[], Estimate::default(), &cube(1.0));
        assert_eq!(none.values(&none.whole(), &[cube(0.5)]), [0.25]);
        let line: PaddedAabb = Aabb { lower: Vec3::ZERO, upper: Vec3::X }.into();
        let ray = |x: f32| Ray { origin: Vec3::new(x, -1.0, 0.0), tnear: 0.0, direction: Vec3::Y, tfar: 2.0 };
        let rays = RayMeasure::new(&[ray(0.2), ray(0.8)], Estimate::default(), &line);
        let half: PaddedAabb = Aabb { lower: Vec3::ZERO, upper: Vec3::X * 0.5 }.into();
        assert_eq!(rays.values(&rays.whole(), &[half]), [0.5]);
    }
}
