//! A triangle in leaf order, and the test of a ray against it.
//!
//! Möller and Trumbore's test in the form, with the order of operations, and with the fused multiply-adds of Embree's default
//! kernel on AVX2 and later: the same edges of the same rays count as hit. (Without fusing, thin triangles differ for 1
//! ray in 10,000.) A processor without the instruction gets the same bits from a library function, slowly. Two things
//! are added, and both are decided by the triangle's own box, whatever tree it hangs in:
//!
//! - A hit counts only if the ray also overlaps the triangle's box. Every box above holds that box, so no tree can
//!   cull a hit that another tree finds.
//! - t is at least the distance at which the ray enters that box (rounding may say less). So no box above is entered
//!   later than the hit, which makes culling by distance exact, and box tests of RayOrder = queries + 2 T_R hold to the last count.
//!
//! Without spatial splits, answers are therefore the same, bit for bit, for every tree over the same triangles.

use super::ray::PreparedRay;
use crate::geometry::{Triangle, Vec3};

/// A primitive of a leaf.
#[derive(Clone, Copy, Debug)]
pub struct PreparedTriangle {
    pub vertices: Triangle,
    /// Index into `TRIS`.
    pub index: u32,
    /// The mask of its geometry.
    pub mask: u32,
    /// The mask of its instance, where that says more: otherwise all bits.
    pub instance_mask: u32,
}

/// Embree's order of summation, and its rounding.
#[inline(always)]
fn dot(a: Vec3, b: Vec3) -> f32 {
    a.x.mul_add(b.x, a.y.mul_add(b.y, a.z * b.z))
}

/// Embree's rounding of a cross product.
#[inline(always)]
fn cross(a: Vec3, b: Vec3) -> Vec3 {
    let minor = |a1: f32, b2: f32, a2: f32, b1: f32| a1.mul_add(b2, -(a2 * b1));
    Vec3::new(minor(a.y, b.z, a.z, b.y), minor(a.z, b.x, a.x, b.z), minor(a.x, b.y, a.y, b.x))
}

/// The edges that the test works with: first vertex minus second, third minus first.
#[inline(always)]
fn edges(triangle: &Triangle) -> (Vec3, Vec3) {
    let [v0, v1, v2] = triangle.0;
    (v0 - v1, v2 - v0)
}

impl PreparedTriangle {
    /// t of the hit, if there is one with tnear < t <= tfar (as in Embree, the start of the interval is outside of it).
    #[inline(always)]
    pub fn intersect(&self, ray: &PreparedRay) -> Option<f32> {
        let (e1, e2) = edges(&self.vertices);
        let normal = cross(e2, e1);
        let c = self.vertices.0[0] - ray.origin;
        let r = cross(c, ray.direction);
        let den = dot(normal, ray.direction);
        // Flips what follows to the side of a positive denominator.
        let sign = den.to_bits() & 0x8000_0000;
        let flip = |value: f32| f32::from_bits(value.to_bits() ^ sign);
        let den_abs = den.abs();
        let u = flip(dot(r, e2));
        let v = flip(dot(r, e1));
        // One branch, not four: which condition fails is hard to predict. NaN fails all of them.
        if !((den != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= den_abs)) {
            return None;
        }
        let t = flip(dot(normal, c));
        let behind_start = den_abs * (ray.tnear * ray.magnified) < t * ray.magnified;
        if !(behind_start & (t <= den_abs * ray.tfar)) {
            return None;
        }
        self.confirm(ray, t / den_abs)
    }

    /// The part that few candidates reach: agreement with the triangle's box.
    #[inline]
    fn confirm(&self, ray: &PreparedRay, t: f32) -> Option<f32> {
        let entry = ray.entry(&self.vertices.bounds(), ray.tfar)?;
        let t = t.max(entry);
        t.is_finite().then_some(t.min(ray.tfar))
    }
}
