//! What a tree costs: P(box) for trees that change, with what makes it cheap to ask again after a small change.
//!
//! A greedy builder asks [`crate::probability::Probability`] for many nested boxes of one node. An optimiser asks for a few boxes
//! that are not nested, inside a node whose rays it knows already. So a [`Measure`] has a `List` for every inner node: nothing for
//! area, the rays that overlap the node's box for rays. A box inside another overlaps no ray that the other does not.

use super::segments::Segments;
use crate::geometry::padded::PaddedAabb;
use crate::geometry::Ray;
use crate::probability::area::Area;

/// P of boxes. The root's is about 1, so that costs of different measures can be read side by side.
pub trait Measure: Sync {
    /// What is kept for an inner node.
    type List: Clone + Default + Send + Sync;

    /// The list of a box that holds everything.
    fn whole(&self) -> Self::List;

    /// The list of `bounds`, which lies inside the box that `outer` belongs to.
    fn within(&self, outer: &Self::List, bounds: &PaddedAabb) -> Self::List;

    /// P of a box and its list.
    fn value(&self, bounds: &PaddedAabb, list: &Self::List) -> f64;

    /// P of each of `boxes`, which lie inside the box that `outer` belongs to.
    fn values<const N: usize>(&self, outer: &Self::List, boxes: &[PaddedAabb; N]) -> [f64; N];

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
    type List = ();

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
    fn work(&self, _list: &()) -> u64 {
        1
    }
}

/// Blend of rays and area: w · rays/rays(root) + (1 - w) · area/area(root).
///
/// The area share is what keeps a tree from fitting its training rays alone: near the leaves a box meets few rays, or none, and its
/// count says little about other rays. There area decides; where counts are large, they do. When no ray meets the root, the
/// ray share is the same for all boxes, and what remains is area.
///
/// A floor under the counts, such as the P_R + 10 of the paper's powerplant, helps a builder, which multiplies it with a number of primitives. It means nothing
/// to an optimiser: it adds the same to every inner node of every tree.
pub struct RayMeasure {
    segments: Segments,
    area: AreaMeasure,
    /// Share of one ray.
    per_ray: f64,
    /// Share of the root's area.
    area_weight: f64,
}

impl RayMeasure {
    /// `rays` are effective segments, `weight` is w, 0 to 1.
    pub fn new(rays: &[Ray], weight: f64, scene: &PaddedAabb) -> RayMeasure {
        let segments = Segments::new(rays);
        let all: Vec<u32> = (0..segments.len() as u32).collect();
        let [root] = segments.count(&all, &[*scene]);
        let per_ray = if root > 0 { weight / root as f64 } else { 0.0 };
        RayMeasure { segments, area: AreaMeasure::new(scene), per_ray, area_weight: 1.0 - weight }
    }

    #[inline(always)]
    fn blend(&self, bounds: &PaddedAabb, rays: usize) -> f64 {
        self.per_ray * rays as f64 + self.area_weight * self.area.of(bounds)
    }
}

impl Measure for RayMeasure {
    type List = Vec<u32>;

    fn whole(&self) -> Vec<u32> {
        (0..self.segments.len() as u32).collect()
    }

    fn within(&self, outer: &Vec<u32>, bounds: &PaddedAabb) -> Vec<u32> {
        self.segments.within(outer, bounds)
    }

    #[inline]
    fn value(&self, bounds: &PaddedAabb, list: &Vec<u32>) -> f64 {
        self.blend(bounds, list.len())
    }

    fn values<const N: usize>(&self, outer: &Vec<u32>, boxes: &[PaddedAabb; N]) -> [f64; N] {
        let counts = self.segments.count(outer, boxes);
        std::array::from_fn(|index| self.blend(&boxes[index], counts[index] as usize))
    }

    fn work(&self, list: &Vec<u32>) -> u64 {
        list.len() as u64 + 1
    }
}
