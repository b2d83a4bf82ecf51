//! Boxes, rays and triangles: the shapes that every other module speaks of, and nothing that needs a tree or a file.
//!
//! Coordinates are world space, in the scene's own unit. `f32` throughout, as in Embree and in the files;
//! where two right answers have to be told apart, callers go to `f64` themselves (see `replay`).

pub mod padded;

use bytemuck::{Pod, Zeroable};
pub use glam::{DVec3, Vec3};

/// Three vertices in world space: the element of the `TRIS` section of a `.bvh`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle(pub [Vec3; 3]);

impl Triangle {
    /// The smallest box around the three vertices; a NaN coordinate gives an unspecified box (test [`Self::is_finite`] first).
    pub fn bounds(&self) -> Aabb {
        let [a, b, c] = self.0;
        Aabb { lower: a.min(b).min(c), upper: a.max(b).max(c) }
    }

    /// Whether all nine coordinates are finite. Embree drops triangles that are not, and no tree holds them.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|vertex| vertex.is_finite())
    }

    /// Twice the area, in double precision: in single, that of a needle far from the origin is
    /// lost.
    pub fn double_area(&self) -> f64 {
        let [a, b, c] = self.0.map(|vertex| vertex.as_dvec3());
        (b - a).cross(c - a).length()
    }

    /// Whether a ray could hit it: it is finite, and no segment or point.
    pub fn has_area(&self) -> bool {
        self.is_finite() && self.double_area() > 0.0
    }

    /// Mean of the three vertices.
    pub fn centroid(&self) -> Vec3 {
        (self.0[0] + self.0[1] + self.0[2]) / 3.0
    }

    /// The normal scaled by twice the area, (v1 - v0) × (v2 - v0).
    pub fn scaled_normal(&self) -> Vec3 {
        (self.0[1] - self.0[0]).cross(self.0[2] - self.0[0])
    }
}

/// An axis-aligned box; empty when a lower bound exceeds its upper bound.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Aabb {
    pub lower: Vec3,
    pub upper: Vec3,
}

impl Aabb {
    /// The identity of [`Self::union`]: +inf below, -inf above.
    pub const EMPTY: Aabb = Aabb { lower: Vec3::INFINITY, upper: Vec3::NEG_INFINITY };

    /// The smallest box around both.
    #[inline]
    pub fn union(&self, other: &Aabb) -> Aabb {
        Aabb { lower: self.lower.min(other.lower), upper: self.upper.max(other.upper) }
    }

    /// What is inside both: an empty box when that is nothing.
    #[inline]
    pub fn intersection(&self, other: &Aabb) -> Aabb {
        Aabb { lower: self.lower.max(other.lower), upper: self.upper.min(other.upper) }
    }

    /// The smallest box around `self` and a point.
    #[inline]
    pub fn grown(&self, point: Vec3) -> Aabb {
        Aabb { lower: self.lower.min(point), upper: self.upper.max(point) }
    }

    /// Edge lengths; negative on an axis where the box is empty.
    #[inline]
    pub fn extent(&self) -> Vec3 {
        self.upper - self.lower
    }

    /// Whether no point is inside.
    #[inline]
    pub fn is_empty(&self) -> bool {
        !self.lower.cmple(self.upper).all()
    }

    /// Surface area, 0 for an empty box. This is P_U of the paper, section 2.4, up to a constant.
    #[inline]
    pub fn area(&self) -> f32 {
        let e = self.extent().max(Vec3::ZERO);
        2.0 * (e.x * e.y + e.y * e.z + e.z * e.x)
    }

    /// The centre of the box.
    #[inline]
    pub fn center(&self) -> Vec3 {
        0.5 * (self.lower + self.upper)
    }

    /// Whether `other` lies inside, borders included.
    #[inline]
    pub fn contains(&self, other: &Aabb) -> bool {
        self.lower.cmple(other.lower).all() && other.upper.cmple(self.upper).all()
    }
}

/// A ray with its interval. A *query* is more: it also asks a kind of question (see [`crate::format::rays::Record`]).
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Ray {
    pub origin: Vec3,
    pub tnear: f32,
    /// As given, not normalised: t is in units of its length.
    pub direction: Vec3,
    pub tfar: f32,
}

impl Ray {
    /// The point at parameter `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + t * self.direction
    }
}
