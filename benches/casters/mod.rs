//! Who casts rays: our traversals, other crates' trees with their own traversal and triangle test, and Embree.

#[cfg(feature = "embree")]
mod embree;
mod packets;
mod threads;
mod wide;

#[cfg(feature = "embree")]
pub use embree::{EmbreeCaster, EmbreeScenes};
pub use packets::{Runner, packets, runner};
pub use threads::two_over_one;
pub use wide::*;

use super::peers::Peer;
use super::peers::obvhs_crate::Obvhs;
use super::peers::parry_crate::Parry;
use embree_trace::format::rays::Record;
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::traverse::{
    All, Counts, Observer, OcclusionOrder, Prepared, PreparedRay, Scratch, Traversal,
};
use std::hint::black_box;
use tinybvh_rs::{Intersector, bvh::BVH};

/// Answers queries one at a time.
pub trait Caster {
    /// Distance of the closest hit, infinite on a miss.
    fn closest(&mut self, record: &Record) -> f32;
    fn occluded(&mut self, record: &Record) -> bool;
}

/// Our traversal. Counting, if any, ends in `counts`.
pub struct Ours<'a, O> {
    pub prepared: &'a Prepared,
    pub traversal: Traversal,
    pub scratch: Scratch,
    pub observer: O,
    /// The order of occlusion queries, where it is not nearest first.
    pub order: Option<OcclusionOrder>,
}

impl<'a, O: Observer + Default> Ours<'a, O> {
    pub fn new(prepared: &'a Prepared, traversal: Traversal) -> Ours<'a, O> {
        Ours { prepared, traversal, scratch: Scratch::default(), observer: O::default(), order: None }
    }

    /// Depth first; occlusion queries visit children in `order`.
    pub fn in_order(prepared: &'a Prepared, order: OcclusionOrder) -> Ours<'a, O> {
        Ours { order: Some(order), ..Ours::new(prepared, Traversal::Odf) }
    }
}

/// With counting on, each query has its own counts, as in a replay.
pub trait PerQuery: Default {
    fn done(&self);
}

impl PerQuery for () {
    fn done(&self) {}
}

impl PerQuery for Counts {
    fn done(&self) {
        black_box(self);
    }
}

impl<O: Observer + PerQuery> Caster for Ours<'_, O> {
    fn closest(&mut self, record: &Record) -> f32 {
        self.observer = O::default();
        let ray = PreparedRay::new(&record.ray());
        let hit =
            self.prepared.closest_hit(self.traversal, &ray, &All, &mut self.observer, &mut self.scratch);
        self.observer.done();
        hit.map_or(f32::INFINITY, |hit| hit.t)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.observer = O::default();
        let ray = PreparedRay::new(&record.ray());
        let (observer, scratch) = (&mut self.observer, &mut self.scratch);
        let hit = match &self.order {
            None => self.prepared.occluder(self.traversal, &ray, &All, observer, scratch),
            Some(order) => self.prepared.occluder_in(order, &ray, &All, observer, scratch),
        };
        self.observer.done();
        hit.is_some()
    }
}

/// obvhs' binary tree, its triangles put in leaf order as its documentation advises.
pub struct ObvhsCaster {
    tree: obvhs::bvh2::Bvh2,
    triangles: Vec<obvhs::triangle::Triangle>,
}

impl ObvhsCaster {
    pub fn new(triangles: &[Triangle], parameters: obvhs::BvhBuildParams) -> ObvhsCaster {
        let mut input = Obvhs::prepare(triangles);
        let tree = Obvhs(parameters).build(&mut input);
        let triangles = tree.primitive_indices.iter().map(|&index| input[index as usize]).collect();
        ObvhsCaster { tree, triangles }
    }

    fn ray(record: &Record) -> obvhs::ray::Ray {
        let vector = |v: Vec3| v.to_array().into();
        obvhs::ray::Ray::new(vector(record.origin), vector(record.direction), record.tnear, record.tfar)
    }
}

impl Caster for ObvhsCaster {
    fn closest(&mut self, record: &Record) -> f32 {
        let mut hit = obvhs::ray::RayHit::none();
        let triangles = &self.triangles;
        self.tree.ray_traverse(Self::ray(record), &mut hit, |ray, index| triangles[index].intersect(ray));
        hit.t
    }

    fn occluded(&mut self, record: &Record) -> bool {
        let triangles = &self.triangles;
        !self.tree.ray_traverse_miss(Self::ray(record), |ray, index| triangles[index].intersect(ray))
    }
}

/// tinybvh's binary tree. The crate has no occlusion query and no start of the interval.
pub struct TinyBvhCaster<'a>(pub BVH<'a>);

/// A ray at the alignment that tinybvh's own code counts on, and the crate's type does not have: its constructor and
/// its traversal may overwrite the stack otherwise.
#[repr(align(64))]
struct Aligned(tinybvh_rs::Ray);

impl Aligned {
    /// t in units of the direction's length: it takes any length as long as the inverse agrees.
    fn cast(tree: &impl Intersector, record: &Record) -> f32 {
        let end = record.tfar.min(tinybvh_rs::INFINITE);
        let mut ray = Aligned(tinybvh_rs::Ray {
            origin: record.origin.to_array(),
            dir: record.direction.to_array(),
            r_d: record.direction.recip().to_array(),
            // The mask of instances: all.
            padding_0: 0xFFFF,
            hit: tinybvh_rs::Intersection { t: end, ..Default::default() },
            ..Default::default()
        });
        tree.intersect(&mut ray.0);
        if ray.0.hit.t < end { ray.0.hit.t } else { f32::INFINITY }
    }
}

impl Caster for TinyBvhCaster<'_> {
    fn closest(&mut self, record: &Record) -> f32 {
        Aligned::cast(&self.0, record)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.closest(record).is_finite()
    }
}

/// parry3d's tree with parry3d's triangle test; best first, and without occlusion queries.
pub struct ParryCaster {
    tree: parry3d::partitioning::Bvh,
    triangles: Vec<parry3d::shape::Triangle>,
}

impl ParryCaster {
    pub fn new(triangles: &[Triangle]) -> ParryCaster {
        let vector = |v: Vec3| parry3d::math::Vector::new(v.x, v.y, v.z);
        let convert =
            |t: &Triangle| parry3d::shape::Triangle::new(vector(t.0[0]), vector(t.0[1]), vector(t.0[2]));
        ParryCaster {
            tree: Parry.build(&mut Parry::prepare(triangles)),
            triangles: triangles.iter().map(convert).collect(),
        }
    }
}

impl Caster for ParryCaster {
    fn closest(&mut self, record: &Record) -> f32 {
        use parry3d::query::RayCast;
        let vector = |v: Vec3| parry3d::math::Vector::new(v.x, v.y, v.z);
        let ray = parry3d::query::Ray::new(vector(record.origin), vector(record.direction));
        let hit = self.tree.cast_ray(&ray, record.tfar, |index, best| {
            self.triangles[index as usize].cast_local_ray(&ray, best, false).filter(|t| *t > record.tnear)
        });
        hit.map_or(f32::INFINITY, |(_, t)| t)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.closest(record).is_finite()
    }
}

/// The crate bvh with its iterator that takes the nearer child first. It has no closest-hit query, so hits are compared here.
pub struct BvhCrateCaster {
    tree: bvh::bvh::Bvh<f32, 3>,
    shapes: Vec<Shape>,
}

/// A triangle as that crate wants it.
struct Shape {
    corners: [nalgebra_point::Point; 3],
    node: usize,
}

/// The point type that bvh's interface takes, named through its own types.
mod nalgebra_point {
    pub type Point = <bvh::aabb::Aabb<f32, 3> as std::ops::Index<usize>>::Output;
}

impl bvh::aabb::Bounded<f32, 3> for Shape {
    fn aabb(&self) -> bvh::aabb::Aabb<f32, 3> {
        let [a, b, c] = &self.corners;
        bvh::aabb::Aabb::empty().grow(a).grow(b).grow(c)
    }
}

impl bvh::bounding_hierarchy::BHShape<f32, 3> for Shape {
    fn set_bh_node_index(&mut self, index: usize) {
        self.node = index;
    }

    fn bh_node_index(&self) -> usize {
        self.node
    }
}

impl BvhCrateCaster {
    pub fn new(triangles: &[Triangle]) -> BvhCrateCaster {
        let point = |v: Vec3| nalgebra_point::Point::from(v.to_array());
        let mut shapes: Vec<Shape> =
            triangles.iter().map(|t| Shape { corners: t.0.map(point), node: 0 }).collect();
        BvhCrateCaster { tree: bvh::bvh::Bvh::build(&mut shapes), shapes }
    }

    fn cast(&self, record: &Record, any: bool) -> f32 {
        let point = nalgebra_point::Point::from;
        let direction = point(record.direction.to_array()).coords;
        let ray = bvh::ray::Ray::new(point(record.origin.to_array()), direction);
        let length = record.direction.length();
        let (tnear, tfar) = (record.tnear * length, record.tfar * length);
        let mut best = f32::INFINITY;
        for shape in self.tree.nearest_child_traverse_iterator(&ray, &self.shapes) {
            let [a, b, c] = &shape.corners;
            // Its test culls back faces: the other side is asked for too.
            let t = ray.intersects_triangle(a, b, c).distance.min(ray.intersects_triangle(a, c, b).distance);
            if t > tnear && t <= tfar && t < best {
                best = t;
                if any {
                    break;
                }
            }
        }
        best / length
    }
}

impl Caster for BvhCrateCaster {
    fn closest(&mut self, record: &Record) -> f32 {
        self.cast(record, false)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.cast(record, true).is_finite()
    }
}
